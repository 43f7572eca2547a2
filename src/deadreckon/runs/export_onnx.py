"""A policy as an ONNX graph in a file, which includes the encoding of the table's columns if possible."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon._version import __version__
from deadreckon.errors import UserError
from deadreckon.names import in_markdown
from deadreckon.policies import onnx_graph
from deadreckon.policies.decoded_rows import decoded
from deadreckon.policies.pure import MEMBER, Pure
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.policies.table_predict import OUTSIDE
from deadreckon.policies.table_rows import text_of
from deadreckon.runs.exported import Rows, check
from deadreckon.runs.subject import Subject

FILE = "policy.onnx"
_WORDS = {
    "tensor(float)": ("number of 32 bits", "numbers of 32 bits"), "tensor(double)": ("number of 64 bits", "numbers of 64 bits"),
    "tensor(int32)": ("whole number", "whole numbers"), "tensor(int64)": ("whole number", "whole numbers"),
    "tensor(string)": ("text", "texts"), "tensor(bool)": ("truth value", "truth values"),
}  # fmt: skip


def write_onnx(one: Subject, function: Pure, rows: Rows, folder: Path) -> list[str]:
    """Writes `policy.onnx`; returns lines about its use."""
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
    (folder / FILE).write_bytes(onnx_graph.finished(model, notes))
    _, _, runtime = onnx_graph.libraries()
    session = runtime.InferenceSession(str(folder / FILE), providers=["CPUExecutionProvider"])
    inputs: dict[str, np.ndarray] = {} if MEMBER not in function.inputs else {MEMBER: rows.member}
    if not encoded:
        inputs[onnx_graph.OBSERVATION] = rows.observations
    else:
        inputs |= onnx_inputs(encoder, decoded(encoder, rows.observations))
        if encoder.masked:
            inputs[onnx_graph.LEGAL] = rows.observations[:, -encoder.count :]
    names = [each.name for each in session.get_outputs()]
    found = dict(zip(names, session.run(names, inputs)))
    check("the ONNX graph", rows, found["action"])
    if encoded and not encoder.masked:
        _check_outside(encoder, inputs, found[OUTSIDE])
    if onnx_graph.NAME in found and found[onnx_graph.NAME].tolist() != [text_of(encoder.names[i]) for i in rows.actions]:
        raise UserError("the ONNX graph names other actions than the policy: it is not kept")
    if encoded:
        lines = ["`policy.onnx` takes the columns of the table and encodes them itself:", ""]
        lines += map(_line, session.get_inputs())
        lines += ["", "Missing numbers are NaN, missing texts are empty. Its outputs are:", ""]
    else:
        why = "histories of several steps cannot be made in one graph" if encoder.observed else "no table is known"
        lines = [f"`policy.onnx` takes observations as they are encoded ({why}); its metadata has the encoding. Inputs:", ""]
        lines += [*map(_line, session.get_inputs()), "", "Outputs:", ""]
    return [*lines, *map(_line, session.get_outputs())]


def _line(given: Any) -> str:
    """An input or output of shape (rows, ...), in words and as its type. Its name may be that of a column, so it is escaped,
    which is not possible between backquotes."""
    one, several = _WORDS.get(given.type, ("value", "values"))
    count = math.prod(given.shape[1:])
    words = f"one {one}" if count == 1 else f"{count} {several}"
    return f"- {in_markdown(given.name)}: {words} per row (`{given.type}`, shape {given.shape})"


def _check_outside(encoder: TableEncoder, inputs: dict[str, np.ndarray], found: np.ndarray) -> None:
    """Refuses a graph that marks other rows as outside the log than the encoder, except for numbers within rounding of a limit.

    Raises:
        UserError: says in how many rows.
    """
    columns = {key: inputs[key].tolist() for key in encoder.observed}
    columns = {key: [None if value == "" else value for value in values] for key, values in columns.items()}
    numbers = np.array([columns[key] for key in encoder.numbers.names], float).reshape(len(encoder.numbers.names), -1).T
    of = encoder.numbers
    limits = (of.low, of.high, of.seen_low, of.seen_high)
    near = np.any([np.isclose(numbers, limit, rtol=1e-6, atol=0.0) for limit in limits], 0).any(1)
    wrong = (encoder.encode(columns, outside="flag").outside != found) & ~(near if len(near) else np.zeros(len(found), bool))
    if wrong.any():
        text = f"the ONNX graph takes {int(wrong.sum()):,} of {len(wrong):,} rows otherwise for outside the log than the policy"
        raise UserError(f"{text}: it is not kept")


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
            kind = np.float64 if key in texts else np.float32
            out[key] = np.array([np.nan if value is None else value for value in values], kind)
    return out
