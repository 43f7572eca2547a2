"""Policies as ONNX graphs: the numbers by jax2onnx, and before them the table's columns by operators of ONNX alone.

A graph that encodes has an input for each column that is observed. Numbers are float32 with NaN where a value is missing;
levels that are texts are strings, empty where missing; levels that are numbers are doubles with NaN. What `table_encoder` does
with them is done by comparison to constants. Where the policy chooses among actions with names, a further output names the
chosen one; and the output `outside_the_log` says which rows `TableEncoder.encode(outside="flag")` would mark.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.errors import UserError, extra
from deadreckon.policies.pure import MEMBER, Pure
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.policies.table_predict import OUTSIDE
from deadreckon.policies.table_rows import text_of

OPSET, ML_OPSET = 21, 4  # of the operators, and of those for tables, whose LabelEncoder takes texts
LEGAL, NAME = "legal", "action_name"
OBSERVATION = "observation"


def libraries() -> tuple[Any, Any, Any]:
    """jax2onnx's converter, onnx and onnxruntime.

    Raises:
        UserError: they are not installed.
    """
    try:
        import onnx  # pyrefly: ignore[missing-import] - an extra, as the others
        import onnxruntime  # pyrefly: ignore[missing-import]
        from jax2onnx import to_onnx  # pyrefly: ignore[missing-import]
    except ImportError as error:
        text = f"the format onnx needs jax2onnx and onnxruntime ({error}): {extra('export')}"
        raise UserError(text) from error
    return to_onnx, onnx, onnxruntime


def graph_of(policy: Pure, shape: Sequence[int]) -> Any:
    """An ONNX model of a policy's function of numbers.

    Args:
        policy: what `pure` gave.
        shape: of one observation.
    """
    to_onnx, _, _ = libraries()
    (rows,) = jax.export.symbolic_shape("rows")
    inputs = [jax.ShapeDtypeStruct((rows, *shape), jnp.float32)]
    if MEMBER in policy.inputs:
        inputs.append(jax.ShapeDtypeStruct((rows,), jnp.int32))
    return to_onnx(
        policy.call, inputs, model_name="policy", opset=OPSET, input_names=list(policy.inputs),
        output_names=list(policy.outputs),
    )  # fmt: skip


def with_columns(model: Any, encoder: TableEncoder) -> None:
    """Makes an input for each column of the table out of the one of numbers, in place.

    Raises:
        UserError: a column is called as another part of the graph is, whose names must all differ.
    """
    made = _Encoding(encoder)
    graph = model.graph
    parts = [*graph.input, *graph.output, *graph.initializer, *made.constants, *made.inputs[len(encoder.observed) :]]
    taken = {NAME, *(each.name for each in parts), *(name for node in (*made.nodes, *graph.node) for name in node.output)}
    if wrong := [key for key in encoder.observed if key in taken]:
        text = f"column {wrong[0]} is called as a part of the ONNX graph is, whose names must differ"
        raise UserError(f"{text}: rename it and train again, or export in another format")
    kept = [each for each in graph.input if each.name != OBSERVATION]
    del graph.input[:]
    graph.input.extend([*made.inputs, *kept])
    nodes = list(graph.node)
    del graph.node[:]
    graph.node.extend([*made.nodes, *nodes])
    graph.initializer.extend(made.constants)
    graph.output.append(made.value(OUTSIDE, made.onnx.TensorProto.BOOL))


def with_names(model: Any, names: Sequence[Any]) -> None:
    """Makes an output that names the discrete action that was chosen, in place."""
    _, onnx, _ = libraries()
    texts = [text_of(name) for name in names]
    graph, helper = model.graph, onnx.helper
    graph.node.append(helper.make_node("Cast", ["action"], ["action:int64"], to=onnx.TensorProto.INT64))
    graph.node.append(
        helper.make_node(
            "LabelEncoder", ["action:int64"], [NAME], domain="ai.onnx.ml", keys_int64s=list(range(len(texts))),
            values_strings=texts, default_string="",
        )
    )  # fmt: skip
    graph.output.append(helper.make_tensor_value_info(NAME, onnx.TensorProto.STRING, ["rows"]))


def finished(model: Any, told: Mapping[str, str]) -> bytes:
    """The model as bytes, with texts that are kept beside it, once ONNX has found it sound."""
    _, onnx, _ = libraries()
    if not any(each.domain == "ai.onnx.ml" for each in model.opset_import):
        model.opset_import.append(onnx.helper.make_opsetid("ai.onnx.ml", ML_OPSET))
    onnx.helper.set_model_props(model, dict(told))
    onnx.checker.check_model(model)
    return model.SerializeToString()


def numeric(levels: Sequence[Any]) -> bool:
    """Whether a column's levels are numbers, so that it is one of doubles and not of texts."""
    return all(isinstance(level, int | float) and not isinstance(level, bool) for level in levels)


class _Encoding:
    """The nodes that make a policy's observation of columns.

    Attributes:
        onnx: the library.
        inputs, nodes, constants: of the graph.
    """

    def __init__(self, encoder: TableEncoder):
        _, self.onnx, _ = libraries()
        self.inputs: list[Any] = []
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        parts, outside = [], []
        numbers = {name: i for i, name in enumerate(encoder.numbers.names)}
        categories = {each.key: each for each in encoder.categories}
        for key in encoder.observed:
            made, out = self._category(categories[key]) if key in categories else self._number(encoder, key, numbers[key])
            parts += made
            outside += out
        if encoder.masked:
            shape = ["rows", encoder.count]
            self.inputs.append(self.onnx.helper.make_tensor_value_info(LEGAL, self.onnx.TensorProto.FLOAT, shape))
            parts.append(LEGAL)
            outside.append(self._not_legal())
        self._node("Concat", parts, OBSERVATION, axis=1)
        if len(outside) == 1:
            self._node("Identity", outside, OUTSIDE)
        for i, each in enumerate(outside[1:]):
            last = i == len(outside) - 2
            name = OUTSIDE if last else f"{OUTSIDE}:{i}"
            self._node("Or", [outside[0] if i == 0 else f"{OUTSIDE}:{i - 1}", each], name)

    def value(self, name: str, kind: int) -> Any:
        """The description of a column of so many rows."""
        return self.onnx.helper.make_tensor_value_info(name, kind, ["rows"])

    def _node(self, kind: str, inputs: Sequence[str], output: str, **options: Any) -> str:
        self.nodes.append(self.onnx.helper.make_node(kind, list(inputs), [output], **options))
        return output

    def _constant(self, name: str, value: Any) -> str:
        self.constants.append(self.onnx.numpy_helper.from_array(np.asarray(value), name))
        return name

    def _column(self, name: str, values: str) -> str:
        """(rows, 1) of (rows,)."""
        shape = self._constant(f"{name}:shape", np.array([-1, 1], np.int64))
        return self._node("Reshape", [values, shape], f"{name}:column")

    def _float(self, values: str) -> str:
        return self._node("Cast", [values], f"{values}:float", to=self.onnx.TensorProto.FLOAT)

    def _number(self, encoder: TableEncoder, key: str, at: int) -> tuple[list[str], list[str]]:
        """The parts of the observation that a number becomes, and what says whether it is outside the log."""
        of = encoder.numbers
        self.inputs.append(self.value(key, self.onnx.TensorProto.FLOAT))
        absent = self._node("IsNaN", [key], f"{key}:missing")
        filled = key
        if np.isfinite(of.fill[at]):
            fill = self._constant(f"{key}:fill", np.float32(of.fill[at]))
            filled = self._node("Where", [absent, fill, key], f"{key}:filled")
        parts = [self._column(f"{key}:value", filled)]
        if of.marked[at]:
            parts.append(self._column(f"{key}:mark", self._float(absent)))
        outside = []
        ends = (np.fmax(of.low[at], of.seen_low[at]), "Less"), (np.fmin(of.high[at], of.seen_high[at]), "Greater")
        for end, compare in ends:
            if np.isfinite(end):
                limit = self._constant(f"{key}:{compare}", np.float32(end))
                outside.append(self._node(compare, [key, limit], f"{key}:{compare}:outside"))
        if of.complete[at] or not of.marked[at]:
            outside.append(absent)
        if of.flags[at]:
            known = self._either(key, key, absent)
            outside.append(self._node("Not", [known], f"{key}:outside"))
        return parts, outside

    def _either(self, values: str, name: str, known: str | None = None) -> str:
        """Where numbers are 0 or 1, or what is `known` besides."""
        equal = [self._node("Equal", [values, self._constant(f"{name}:{n}", np.float32(n))], f"{name}:is:{n}") for n in (0, 1)]
        both = self._node("Or", equal, f"{name}:either")
        return both if known is None else self._node("Or", [both, known], f"{name}:or:missing")

    def _not_legal(self) -> str:
        """Where no action is legal, or something else than 0 or 1 says so; Python refuses such rows."""
        axis = self._constant(f"{LEGAL}:axis", np.array([1], np.int64))
        half = self._constant(f"{LEGAL}:half", np.float32(0.5))
        each = self._float(self._either(LEGAL, LEGAL))
        most = self._node("ReduceMax", [LEGAL, axis], f"{LEGAL}:most", keepdims=0)
        least = self._node("ReduceMin", [each, axis], f"{LEGAL}:least", keepdims=0)
        wrong = [self._node("Less", [of, half], f"{of}:wrong") for of in (most, least)]
        return self._node("Or", wrong, f"{LEGAL}:outside")

    def _category(self, of: Any) -> tuple[list[str], list[str]]:
        """The same of a column of levels."""
        key, levels = of.key, of.levels
        if not numeric(levels):
            self.inputs.append(self.value(key, self.onnx.TensorProto.STRING))
            names = [text_of(level) for level in levels]
            keys = names if "" in names else [*names, ""]
            codes = self._node(
                "LabelEncoder", [key], f"{key}:code", domain="ai.onnx.ml", keys_strings=keys,
                values_int64s=[*range(len(names)), *([len(names)] if "" not in names else [])], default_int64=-1,
            )  # fmt: skip
            wanted = np.arange(len(levels), dtype=np.int64)
            absent = self._node("Equal", [codes, self._constant(f"{key}:none", np.int64(len(names)))], f"{key}:missing")
        else:
            self.inputs.append(self.value(key, self.onnx.TensorProto.DOUBLE))
            codes, wanted = key, np.asarray(levels, np.float64)
            absent = self._node("IsNaN", [key], f"{key}:missing")
        column = self._column(f"{key}:levels", codes)
        equal = self._node("Equal", [column, self._constant(f"{key}:constants", wanted[None])], f"{key}:equal")
        parts = [self._float(equal)]
        if of.marked:
            parts.append(self._column(f"{key}:mark", self._float(absent)))
        axis = self._constant(f"{key}:axis", np.array([1], np.int64))
        known = self._node("ReduceMax", [parts[0], axis], f"{key}:known", keepdims=0)
        half = self._constant(f"{key}:half", np.float32(0.5))
        unknown = self._node("Less", [known, half], f"{key}:unknown")
        if not (of.complete or not of.marked):  # a missing value is one of the log's own
            there = self._node("Not", [absent], f"{key}:there")
            unknown = self._node("And", [unknown, there], f"{key}:outside")
        return parts, [unknown]
