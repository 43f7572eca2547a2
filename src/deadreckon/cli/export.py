"""`deadreckon export`: a policy in a folder that other programs run."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from deadreckon.cli.parse import RUN, parse, with_policy_seed


@dataclass
class Export:
    """Write a policy's deterministic actions for other programs, checked on rows of its log, with a model card."""

    run: RUN
    format: Literal["onnx", "stablehlo", "numpy", "mlflow"]
    """form of the export: an ONNX graph, a program of jax.export, files for numpy alone, or an MLflow model"""
    out: str  # folder to write, which must not exist yet
    log: str | None = None  # log on whose rows the export is checked; None: the one that the policy was trained on
    estimates: Annotated[str | None, tyro.conf.arg(metavar="FOLDER")] = None
    """folder of `deadreckon ope --out` or `recommend`, for the card; None: found in the run's folder or beside it"""
    policy_seed: int | None = None  # seed of the run whose policy is exported; None: the first that has not failed


def export(args: Sequence[str]) -> None:
    """Writes the folder and prints its path."""
    options = parse(Export, with_policy_seed(args), "export")
    from deadreckon.runs.export import export as write

    folder = write(
        options.run, options.format, options.out, log=options.log, estimates=options.estimates, seed=options.policy_seed
    )
    print(folder)
