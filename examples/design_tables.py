"""Chapter 6's tables and ablations: which method on which problem, and what NEMO's parts are worth (thesis 6.6).

    python examples/design_tables.py --groups table --budget cpu --seeds 3 --out runs/mbo-cpu
    python examples/design_tables.py --groups nml architecture ratio --problems superconductor --seeds 8

What is there is not computed again, so a run that was stopped goes on.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

import tyro

import deadreckon as dr
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Watch
from deadreckon.mbo.protocol import judge, tables
from deadreckon.mbo.registry import DESIGNERS, sized

PROBLEMS = ("hopper-controller", "superconductor", "tfbind8", "gfp", "molecule", "ant-morphology", "dkitty-morphology")
RISES = (100, 300, 1000)  # steps of the designs, of which ablations show the progress
DESIGN_RATES = 0.01, 0.1  # learning rates of the designs
WEIGHTS = {"a row of the data": None, "a row of the batch": 1 / 128, "the batch": 1.0}  # what a claim counts as much as
RATIOS, RATES = (1, 5, 20), (0.0005, 0.05)  # updates of the models for each of the designs; their learning rates


@dataclass
class Options:
    """Tables and ablations of chapter 6."""

    groups: tuple[Literal["table", "nml", "architecture", "ratio", "weight"], ...] = ("table",)  # of runs
    problems: tuple[str, ...] = PROBLEMS  # of these
    paths: dict[str, str] = dataclasses.field(default_factory=dict)  # PROBLEM FILE, ...; else the package's folder of designs
    only: tuple[str, ...] = tuple(DESIGNERS)  # methods of the group table
    budget: Literal["full", "cpu"] = "full"  # sizes of what is fitted
    seeds: int = 8  # how many
    together: int | None = None  # seeds of one program; None: all
    n: int = 128  # designs a method proposes
    settings: Literal["printed", "own"] = "printed"  # of NEMO: the thesis's, or those of a table of one's own
    rises: tuple[int, ...] = RISES  # steps of the designs in ablations
    out: str = "runs/mbo"  # folder of results


def variants(group: str, problem: str, options: Options) -> list[tuple[str, Any]]:
    """Labels and designers."""
    nemo: Any = sized("nemo", problem, options.budget)
    if options.settings == "own":
        own: Any = sized("nemo", None, options.budget)
        nemo = nemo.replace(lr=own.lr, design_lr=own.design_lr, label_weight=own.label_weight)
    if group == "table":
        of = lambda name: nemo if name == "nemo" else sized(name, problem, options.budget)  # noqa: E731
        return [("nemo-own" if name == "nemo" and options.settings == "own" else name, of(name)) for name in options.only]
    changes: dict[str, dict[str, Any]] = {
        "nml": {"NML": {"start": "worst"}, "none": {"start": "worst", "search_lr": 0.0}},
        "architecture": {"logistic": {}, "categorical": {"architecture": "categorical"}},
        "weight": {f"{name}, designs {rise:g}": {"lr": 0.005, "design_lr": rise, "label_weight": weight}
                   for name, weight in WEIGHTS.items() for rise in DESIGN_RATES},
        "ratio": {f"{ratio}:1, {lr:g}": {"model_updates": ratio, "lr": lr} for lr in RATES for ratio in RATIOS},
    }[group]  # fmt: skip
    return [
        (f"{label}, {rise} steps", nemo.replace(**fields, steps=rise * fields.get("model_updates", 1)))
        for label, fields in changes.items()
        for rise in options.rises
    ]


def main(options: Options) -> None:
    """Runs what is not there yet, and prints tables."""
    cache_compiled_programs()
    asked = {(g, p): variants(g, p, options) for g in options.groups for p in options.problems}  # names are checked first
    problems = {}
    for group in options.groups:
        results = []
        for name in options.problems:
            if name not in problems:
                more = {"path": options.paths[name]} if name in options.paths else {}
                problems[name] = dr.mbo.problem(name, **more)
            told = lambda r: print(f"{r.method} on {r.problem}: {r.seconds:,.0f} s", flush=True)  # noqa: E731
            with Watch() as watch:
                results += judge(
                    problems[name], asked[group, name], options.n, seeds=range(options.seeds), together=options.together,
                    out=options.out, watch=watch, told=told,
                )  # fmt: skip
        print(f"\n## {group}\n\n{tables(results)}")


if __name__ == "__main__":
    main(tyro.cli(Options))
