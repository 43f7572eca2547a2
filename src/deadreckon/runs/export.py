"""A policy in a folder that other programs run: ONNX, StableHLO, numpy alone, or an MLflow model, each checked before it is kept.

What is exported are greedy actions. On rows of the policy's own log the export has to do what the policy does, to 1e-5 of half
an action's range (or of 1, where that is less) and exactly where actions are discrete; else nothing is kept.
"""

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon._version import __version__
from deadreckon.data.dataset import Dataset
from deadreckon.data.history import stacked
from deadreckon.errors import UserError, unknown
from deadreckon.files import write_json
from deadreckon.policies import onnx_graph, portable, store
from deadreckon.policies.deployed import history_of
from deadreckon.policies.mlflow_loader import Model
from deadreckon.policies.pure import MEMBER, Pure, pure
from deadreckon.policies.table_decoded import decoded
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.policies.table_rows import text_of
from deadreckon.runs.card import card
from deadreckon.runs.subject import Subject, estimates_of, subject

Format = Literal["onnx", "stablehlo", "numpy", "mlflow"]
FORMATS = get_args(Format)
CLOSE = 1e-5  # of half an action's range
ROWS = 1_000  # of the log, on which an export is checked
CARD, ENCODING = "card.md", "encoding.json"
LOADER = "mlflow_loader.py"
PLAYER = ("portable.py", "table_columns.py", "table_encoder.py", "table_predict.py", "table_rows.py")


class Rows(NamedTuple):
    """Rows on which an export is checked.

    Attributes:
        observations: (rows, *shape) as the policy takes them; histories of a policy on these.
        member: (rows,) int32, which member of a mixture acts.
        actions: what the policy does.
        room: (size,) half of each action's range, 1 at least.
    """

    observations: np.ndarray
    member: np.ndarray
    actions: np.ndarray
    room: np.ndarray


def export(
    run: Any,
    format: Format,
    out: Path | str,
    *,
    log: Dataset | Path | str | None = None,
    estimates: Path | str | None = None,
    seed: int | None = None,
) -> Path:
    """Writes a policy's greedy actions for other programs, with a model card beside them.

    Args:
        run: the run, its folder, a cross-fit's folder or a policy file.
        format: "onnx" (with the encoding of the table where there is one), "stablehlo" (of `jax.export`: numbers alone, the
            encoding as JSON beside it), "numpy" (the policy file and what plays it) or "mlflow" (a pyfunc model).
        out: folder to write, which must not be there yet.
        log: the log on whose rows the export is checked; None: the one that the policy learned from.
        estimates: the folder of `deadreckon ope --out` or `recommend`, for the card; None looks in the run's folder and beside.
        seed: which of the run's policies; None: the first that has not failed.

    Raises:
        UserError: the policy cannot be exported, or the export does something else. Nothing is left behind.
    """
    if format not in FORMATS:
        raise unknown("format", str(format), FORMATS)
    out = Path(out)
    if out.exists():
        raise UserError(f"{out} exists already; choose another --out")
    one = subject(run, seed)
    function = pure(one.policy)
    told = estimates_of(one, estimates)
    data = one.log(log)
    rows = _rows(one, function, data)
    with _folder(out) as folder:
        writer = {"onnx": _onnx, "stablehlo": _stablehlo, "numpy": _numpy, "mlflow": _mlflow}[format]
        used = writer(one, function, rows, folder)
        text = card(one, data, told, format, used, len(rows.observations))
        (folder / CARD).write_text(text, encoding="utf-8")
    return out


@contextlib.contextmanager
def _folder(out: Path) -> Iterator[Path]:
    """A folder beside `out` that gets its name once all is in it."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".tmp", dir=out.parent))
    except OSError as error:
        raise UserError(f"cannot write {out}: {error.strerror or error}") from error
    try:
        yield folder
        folder.chmod(0o755)
        folder.rename(out)
    except OSError as error:
        raise UserError(f"cannot write {out}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _rows(one: Subject, function: Pure, data: Dataset) -> Rows:
    """Rows of a log at regular distances, and what the policy does there."""
    seen = stacked(data, history_of(one.policy))
    at = np.unique(np.linspace(0, len(data) - 1, min(len(data), ROWS)).astype(int))
    observations = np.asarray(seen.observations[at], np.float32)
    member = (np.arange(len(at)) % function.members).astype(np.int32)
    given = (observations, member) if MEMBER in function.inputs else (observations,)
    actions = np.asarray(jax.jit(function.call)(*map(jnp.asarray, given))[0])
    room = np.ones(1)
    if not data.spec.discrete:
        room = np.maximum(np.subtract(data.action_space.high, data.action_space.low) / 2, 1.0)
    return Rows(observations, member, actions, room)


def _check(what: str, rows: Rows, actions: Any) -> None:
    """Refuses actions that are not the policy's.

    Raises:
        UserError: by how much they differ, in how many rows.
    """
    actions = np.asarray(actions)
    if actions.shape != rows.actions.shape:
        raise UserError(f"{what} gives actions of shape {actions.shape}, the policy {rows.actions.shape}: it is not kept")
    if rows.actions.dtype.kind in "iu":
        wrong = actions != rows.actions
    else:
        wrong = ~(np.abs(actions - rows.actions) <= CLOSE * rows.room).all(-1)
    if wrong.any():
        most = float(np.abs(actions.astype(float) - rows.actions).max())
        text = f"{what} differs from the policy in {int(wrong.sum()):,} of {len(wrong):,} rows of the log, by up to {most:.2g}"
        raise UserError(f"{text}: it is not kept")


def _onnx(one: Subject, function: Pure, rows: Rows, folder: Path) -> list[str]:
    """`policy.onnx`; gives lines about its use."""
    model = onnx_graph.graph_of(function, rows.observations.shape[1:])
    encoder = TableEncoder(one.told)
    encoded = bool(encoder.observed) and function.history == 1
    if encoded:
        onnx_graph.with_columns(model, encoder)
    if encoder.discrete and encoder.levels is not None:
        onnx_graph.with_names(model, encoder.names)
    notes = {
        "deadreckon": __version__, "policy": one.name, "actions": "greedy", "history": str(function.history),
        "observation_names": json.dumps((one.read.extra or {}).get("observation_names")),
        "action_columns": json.dumps({key: column.get("unit", "") for key, column in encoder.actions.items()}),
        "encoding": json.dumps(one.told),
    }  # fmt: skip
    (folder / "policy.onnx").write_bytes(onnx_graph.finished(model, notes))
    _, _, runtime = onnx_graph.libraries()
    session = runtime.InferenceSession(str(folder / "policy.onnx"), providers=["CPUExecutionProvider"])
    inputs: dict[str, np.ndarray] = {} if MEMBER not in function.inputs else {MEMBER: rows.member}
    if not encoded:
        inputs[onnx_graph.OBSERVATION] = rows.observations
    else:
        inputs |= onnx_inputs(encoder, decoded(encoder, rows.observations))
        if encoder.masked:
            inputs[onnx_graph.LEGAL] = rows.observations[:, -encoder.count :]
    names = [each.name for each in session.get_outputs()]
    found = dict(zip(names, session.run(names, inputs)))
    _check("the ONNX graph", rows, found["action"])
    if onnx_graph.NAME in found and found[onnx_graph.NAME].tolist() != [text_of(encoder.names[i]) for i in rows.actions]:
        raise UserError("the ONNX graph names other actions than the policy: it is not kept")
    if encoded:
        lines = ["`policy.onnx` takes the columns of the table and encodes them itself:", ""]
        lines += [f"- `{each.name}`: {each.type}, {each.shape}" for each in session.get_inputs()]
        lines += ["", "Missing numbers are NaN, missing texts are empty. Its outputs are:", ""]
    else:
        why = "histories of several steps cannot be made in one graph" if encoder.observed else "no table is known"
        lines = [f"`policy.onnx` takes observations as they are encoded ({why}); its metadata has the encoding. Inputs:", ""]
        lines += [f"- `{each.name}`: {each.type}, {each.shape}" for each in session.get_inputs()] + ["", "Outputs:", ""]
    return lines + [f"- `{each.name}`: {each.type}, {each.shape}" for each in session.get_outputs()]


def onnx_inputs(encoder: TableEncoder, columns: dict[str, Any]) -> dict[str, np.ndarray]:
    """Columns of a table as an ONNX graph with the encoding takes them; None is missing.

    Args:
        encoder: of the policy's log.
        columns: (rows,) values each.
    """
    out = {}
    texts = {each.key: not onnx_graph.numeric(each.levels) for each in encoder.categories}
    for key, values in columns.items():
        if texts.get(key, False):
            out[key] = np.array(["" if value is None else text_of(value) for value in values], object)
        else:
            out[key] = np.array([np.nan if value is None else value for value in values], np.float64 if key in texts else np.float32)
    return out


def _stablehlo(one: Subject, function: Pure, rows: Rows, folder: Path) -> list[str]:
    """`policy.stablehlo`, with a free number of rows, for CPU, GPU and TPU; and the encoding beside it."""
    from jax import export as exporting

    (count,) = exporting.symbolic_shape("rows")
    given = [jax.ShapeDtypeStruct((count, *rows.observations.shape[1:]), jnp.float32)]
    if MEMBER in function.inputs:
        given.append(jax.ShapeDtypeStruct((count,), jnp.int32))
    made = exporting.export(jax.jit(function.call), platforms=("cpu", "cuda", "tpu"))(*given)
    (folder / "policy.stablehlo").write_bytes(made.serialize())
    write_json(folder / ENCODING, dict(one.told))
    again = exporting.deserialize(bytearray((folder / "policy.stablehlo").read_bytes()))
    values = (rows.observations, rows.member) if MEMBER in function.inputs else (rows.observations,)
    _check("the StableHLO program", rows, again.call(*map(jnp.asarray, values))[0])
    return [
        "`policy.stablehlo` takes observations as they are encoded; `encoding.json` says how, for `table_encoder.TableEncoder`:",
        "", "```python", "from jax import export", "",
        'policy = export.deserialize(bytearray(open("policy.stablehlo", "rb").read()))',
        f"{', '.join(function.outputs)}{',' if len(function.outputs) == 1 else ''} = policy.call({', '.join(function.inputs)})",
        "```",
    ]  # fmt: skip


def _player(one: Subject, folder: Path, names: Sequence[str] = PLAYER) -> None:
    """The policy's file, and the modules that play it by numpy alone."""
    folder.mkdir(exist_ok=True)
    if one.file is not None:
        shutil.copyfile(one.file, folder / "policy.npz")
    else:  # a cross-fit's policy of one seed of several
        store.save(folder / "policy.npz", one.policy, {"log": dict(one.told)})
    for name in names:
        text = resources.files("deadreckon.policies").joinpath(name).read_text(encoding="utf-8")
        (folder / name).write_text(text, encoding="utf-8")


def _numpy(one: Subject, function: Pure, rows: Rows, folder: Path) -> list[str]:
    """`policy.npz` and the modules that play it."""
    _player(one, folder)
    play = portable.load(folder / "policy.npz")
    _check("the numpy player", rows, _played(play, rows))
    use = 'play.predict({"column": value, ...})   # or a data frame, or a list of dictionaries'
    use = use if TableEncoder(one.told).observed else "play(observations)"
    return [
        "numpy alone is needed, and the files of this folder:", "",
        "```python", "import portable", "", 'play = portable.load("policy.npz")', use, "```",
    ]  # fmt: skip


def _played(play: Any, rows: Rows) -> np.ndarray:
    """What the numpy player does, of a mixture each member in its rows."""
    if play.member is not None:
        return _played(play.member, rows)
    if play.members:
        parts = np.stack([_played(member, rows) for member in play.members])
        return parts[rows.member, np.arange(len(rows.member))]
    return np.asarray(play(rows.observations))


def _mlflow(one: Subject, function: Pure, rows: Rows, folder: Path) -> list[str]:
    """An MLflow model: the numpy player as its code, which is text, and the policy's file as its data."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    try:
        import mlflow.pyfunc
        import pandas
        from mlflow.models import infer_signature
    except ImportError as error:
        raise UserError(f"the format mlflow needs mlflow-skinny and pandas ({error}): pip install 'deadreckon[mlflow]'") from error
    encoder = TableEncoder(one.told)
    named = bool(encoder.observed) and not encoder.masked and function.history == 1
    given: Any = pandas.DataFrame(decoded(encoder, rows.observations)) if named else rows.observations
    with tempfile.TemporaryDirectory() as place:
        code, data = Path(place) / "code", Path(place) / "data"
        _player(one, code, (*PLAYER, LOADER))
        data.mkdir()
        (code / "policy.npz").rename(data / "policy.npz")
        play = portable.load(data / "policy.npz")
        _check("the numpy player", rows, _played(play, rows))
        signature = infer_signature(given, Model(play).predict(given)) if named else None
        mlflow.pyfunc.save_model(
            path=str(folder), loader_module=Path(LOADER).stem, data_path=str(data),
            code_paths=[str(code / name) for name in (*PLAYER, LOADER)], signature=signature,
            pip_requirements=["numpy>=2.1", "pandas>=2.2"],
        )  # fmt: skip
    if named and function.members == 1:
        again = mlflow.pyfunc.load_model(str(folder)).predict(given)
        _check("the MLflow model", rows, _coded(encoder, again))
    return ["`mlflow.pyfunc.load_model(FOLDER).predict(frame)` takes a data frame with the columns of the table."]


def _coded(encoder: TableEncoder, actions: Any) -> np.ndarray:
    """Named actions of a data frame as the policy gives them."""
    if not encoder.discrete:
        return actions.to_numpy(np.float64)
    found = encoder.logged({key: actions[key].to_numpy() for key in encoder.actions})
    assert found is not None
    return found
