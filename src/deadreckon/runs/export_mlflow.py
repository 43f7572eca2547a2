"""A policy as an MLflow model (pyfunc): the numpy player as its code, which is text, and the policy's file as its data."""

import os
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.errors import UserError, extra
from deadreckon.policies import portable
from deadreckon.policies.decoded_rows import decoded
from deadreckon.policies.mlflow_loader import Model
from deadreckon.policies.pure import Pure
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.runs.exported import PLAYER, Rows, check, played, put_player
from deadreckon.runs.subject import Subject

LOADER = "mlflow_loader.py"


def write_mlflow(one: Subject, function: Pure, rows: Rows, folder: Path) -> list[str]:
    """Writes the model; returns lines about its use."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_UV_AUTO_DETECT", "false")  # otherwise it copies the lock file of the current folder
    try:
        import mlflow.pyfunc  # pyrefly: ignore[missing-import] - an extra
        import pandas
        from mlflow.models import ModelSignature, infer_signature  # pyrefly: ignore[missing-import]
        from mlflow.types import ColSpec, Schema  # pyrefly: ignore[missing-import]
        from mlflow.types.schema import AnyType  # pyrefly: ignore[missing-import]
    except ImportError as error:
        text = f"the format mlflow needs mlflow-skinny and pandas ({error}): {extra('mlflow')}"
        raise UserError(text) from error
    encoder = TableEncoder(one.told)
    if function.history > 1 and not encoder.observed:
        text = "a model of MLflow is given rows and not where episodes begin"
        raise UserError(f"{one.name} acts on the last {function.history} observations of arrays: {text}; the format numpy is")
    named = bool(encoder.observed) and not encoder.masked and function.history == 1
    given: Any = pandas.DataFrame(decoded(encoder, rows.observations)) if named else rows.observations
    episode = encoder.one.get("episode")
    key = next(iter(encoder.ends), None) if episode is None else episode
    if named and function.members > 1 and key is not None and not encoder.alone:  # one member acts to the end of an episode
        given[key] = 0 if episode is None else np.arange(len(given))
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        code, data = Path(place) / "code", Path(place) / "data"
        put_player(one, code, (*PLAYER, LOADER))
        data.mkdir()
        (code / "policy.npz").rename(data / "policy.npz")
        play = portable.load(data / "policy.npz")
        check("the numpy player", rows, played(play, rows))
        sign: dict[str, Any] = {}
        if named:  # MLflow checks names, the encoder kinds, because it knows missing values and levels
            inputs = Schema([ColSpec(AnyType(), key) for key in given])
            sign["signature"] = ModelSignature(inputs, infer_signature(None, Model(play).predict(given)).outputs)
        warnings.simplefilter("ignore")  # MLflow wants an input example, which would put rows of the log into the model
        mlflow.pyfunc.save_model(
            path=str(folder), loader_module=Path(LOADER).stem, data_path=str(data),
            code_paths=[str(code / name) for name in (*PLAYER, LOADER)], pip_requirements=["numpy>=2.1", "pandas>=2.2"], **sign,
        )  # fmt: skip
    plain = not encoder.observed and encoder.levels is None and rows.observations.ndim == 2
    if (named or plain) and function.members == 1:
        again = mlflow.pyfunc.load_model(str(folder)).predict(given)
        check("the MLflow model", rows, _coded(encoder, again))
    takes = "a data frame with the columns of the table" if encoder.observed else "an array of observations, a row for each"
    return [f"`mlflow.pyfunc.load_model(FOLDER).predict({'frame' if encoder.observed else 'observations'})` takes {takes}."]


def _coded(encoder: TableEncoder, actions: Any) -> np.ndarray:
    """Named actions of a data frame in the policy's encoding."""
    if not encoder.discrete:
        return actions.to_numpy(np.float64)
    if not encoder.actions:  # codes, of arrays
        return actions["action"].to_numpy()
    found = encoder.logged({key: actions[key].to_numpy() for key in encoder.actions})
    assert found is not None
    return found
