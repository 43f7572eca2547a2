"""Exports a policy for other programs: ONNX, StableHLO, numpy alone, or an MLflow model; each export is checked.

The exported actions are the greedy ones. On rows of the policy's own log the export has to return the policy's actions, within
1e-5 of half an action's range (or of 1, if that is less), and exactly if actions are discrete; otherwise nothing is kept.
"""

from pathlib import Path
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp

from deadreckon.errors import UserError, extra, unknown
from deadreckon.files import write_json
from deadreckon.names import shown
from deadreckon.policies import portable
from deadreckon.policies.deployed import history_of
from deadreckon.policies.pure import MEMBER, Pure, pure
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.runs.card import card
from deadreckon.runs.export_mlflow import write_mlflow
from deadreckon.runs.export_onnx import write_onnx
from deadreckon.runs.exported import ENCODER, Rows, building, check, played, put_modules, put_player, rows_of
from deadreckon.runs.subject import Subject, estimates_of, subject

Format = Literal["onnx", "stablehlo", "numpy", "mlflow"]
FORMATS = get_args(Format)
CARD, ENCODING = "card.md", "encoding.json"


def export(
    run: Any,
    format: Format,
    out: Path | str,
    *,
    log: Any = None,
    estimates: Path | str | None = None,
    seed: int | None = None,
) -> Path:
    """Writes a policy's greedy actions for other programs, with a model card beside them.

    Args:
        run: the run, its folder, a cross-fit's folder or a policy file.
        format: "onnx" (with the encoding of the table if there is one), "stablehlo" (of `jax.export`: numbers only, the
            encoding as JSON beside it), "numpy" (the policy file and the modules that run it) or "mlflow" (a pyfunc model).
        out: folder to write, which must not exist.
        log: the log on whose rows the export is checked, a `Dataset`, a file or a data frame; None: the one that the policy was
            trained on.
        estimates: the folder of `deadreckon ope --out` or `recommend`, for the card; None searches the run's folder and the
            folders beside it.
        seed: of the run's policy; None: the first that has not failed.

    Returns:
        The folder.

    Raises:
        UserError: the policy cannot be exported, or the export returns other actions. Nothing is left behind.
    """
    if format not in FORMATS:
        raise unknown("format", str(format), FORMATS)
    out = Path(out)
    if out.exists():
        raise UserError(f"{out} exists already; choose another --out")
    one = subject(run, seed)
    function = pure(one.policy)
    told = estimates_of(one, estimates)
    data = one.log(log, option="--log (in Python log=)")
    rows = rows_of(one, function, data)
    with building(out) as folder:
        writer = {"onnx": write_onnx, "stablehlo": _stablehlo, "numpy": _numpy, "mlflow": write_mlflow}[format]
        used = writer(one, function, rows, folder)
        text = card(one, data, told, format, used, len(rows.observations))
        (folder / CARD).write_text(shown(text, keep="\n"), encoding="utf-8")
    return out


def _stablehlo(one: Subject, function: Pure, rows: Rows, folder: Path) -> list[str]:
    """Writes `policy.stablehlo`, for any number of rows, on CPU, GPU and TPU, and the encoding; returns lines about its use."""
    from jax import export as exporting

    (count,) = exporting.symbolic_shape("rows")
    given = [jax.ShapeDtypeStruct((count, *rows.observations.shape[1:]), jnp.float32)]
    if MEMBER in function.inputs:
        given.append(jax.ShapeDtypeStruct((count,), jnp.int32))
    made = exporting.export(jax.jit(function.call), platforms=("cpu", "cuda", "tpu"))(*given)
    try:
        (folder / "policy.stablehlo").write_bytes(made.serialize())
    except ImportError as error:
        raise UserError(f"the format stablehlo needs flatbuffers ({error}): {extra('export')}") from error
    write_json(folder / ENCODING, dict(one.told))
    again = exporting.deserialize(bytearray((folder / "policy.stablehlo").read_bytes()))
    values = (rows.observations, rows.member) if MEMBER in function.inputs else (rows.observations,)
    check("the StableHLO program", rows, again.call(*map(jnp.asarray, values))[0])
    lines = ["from jax import export", "", 'policy = export.deserialize(bytearray(open("policy.stablehlo", "rb").read()))']
    results = f"{', '.join(function.outputs)}{',' if len(function.outputs) == 1 else ''}"
    call = [f"{results} = policy.call({', '.join(function.inputs)})"]
    if MEMBER in function.inputs:
        lines.insert(0, "import numpy as np")
        drawn = f'{MEMBER} = np.random.default_rng().integers({function.members}, size=len(observation), dtype="int32")'
        call.insert(0, f"{drawn}   # member of the mixture, the same in all rows of an episode")
    encoder = TableEncoder(one.told)
    if not encoder.observed or history_of(one.policy) > 1:
        return ["`policy.stablehlo` takes observations as they are encoded:", "", "```python", *lines, *call, "```"]
    put_modules(folder, ENCODER)
    # If no column of the table says which actions are legal, a function that was given with the log did.
    legal = ", legal=[[True, ...], ...]" if encoder.masked and not encoder.allowed.columns else ""
    return [
        "`policy.stablehlo` takes observations. `table_encoder.py` and what it needs make them of rows, with numpy alone:",
        "", "```python", "import json", *lines[:-2], "from table_encoder import TableEncoder", *lines[-2:],
        'encoder = TableEncoder(json.load(open("encoding.json")))',
        f'observation = encoder.encode({{"column": [value, ...], ...}}{legal}).observations   # or a data frame',
        *call, "encoder.named(action)", "```",
    ]  # fmt: skip


def _numpy(one: Subject, function: Pure, rows: Rows, folder: Path) -> list[str]:
    """Writes `policy.npz` and the modules that run it; returns lines about its use."""
    put_player(one, folder)
    play = portable.load(folder / "policy.npz")
    check("the numpy player", rows, played(play, rows))
    use = 'play.predict({"column": value, ...})   # or a data frame, or a list of dictionaries'
    encoder = TableEncoder(one.told)
    if not encoder.observed:
        begins = history_of(one.policy) > 1 or MEMBER in function.inputs
        more = [*(["first=first"] if begins else []), *(["legal=legal"] if encoder.masked else [])]
        use = f"play({', '.join(['observations', *more])})"
        use += "   # first: (rows,), true where an episode begins; every call continues with the same rows" if begins else ""
        use += "   # legal: (rows, actions) truth values" if encoder.masked else ""
    return [
        "numpy alone is needed, and the files of this folder:", "",
        "```python", "import portable", "", 'play = portable.load("policy.npz")', use, "```",
    ]  # fmt: skip
