"""Plain values as JSON, with the bytes of their arrays beside it: what one process hands to another without pickling.

A value is a table of nodes that name each other by number, so that what is shared stays so, and depth costs nothing. Arrays lie
one behind the other in a file without a name, which both processes map.
"""

import base64
import math
import mmap
import os
import tempfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from deadreckon.errors import UserError

_ALIGNED = 64
_KINDS = "biufcSU"  # of arrays
Nodes = list[list[Any]]


class Shared:
    """A file without a name that grows by arrays, for the process that fills it."""

    def __init__(self):
        self.handle = os.memfd_create("deadreckon") if hasattr(os, "memfd_create") else _unnamed()
        self.size = 0

    def take(self, bytes_: int) -> int:
        """Room for so many bytes; gives where it begins."""
        at = -(-self.size // _ALIGNED) * _ALIGNED
        self.size = at + bytes_
        os.ftruncate(self.handle, max(self.size, 1))
        return at

    def put(self, array: np.ndarray) -> int:
        """Writes an array in the order of C; gives where it begins."""
        whole = np.ascontiguousarray(array).reshape(-1)
        data = whole.view(np.uint8).data if whole.size else memoryview(b"")
        at = self.take(len(data))
        done = 0
        while done < len(data):
            done += os.pwrite(self.handle, data[done : done + (1 << 28)], at + done)
        return at

    def mapped(self, at: int, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        """An array in room that was taken, to be filled."""
        start = at // mmap.ALLOCATIONGRANULARITY * mmap.ALLOCATIONGRANULARITY
        count = math.prod(shape)
        memory = mmap.mmap(self.handle, at - start + count * dtype.itemsize, offset=start)
        return np.frombuffer(memory, dtype, count, at - start).reshape(shape)


def _unnamed() -> int:
    handle, name = tempfile.mkstemp(prefix="deadreckon-")
    os.unlink(name)
    return handle


class Placed:
    """An array that lies in room of a `Shared` already."""

    def __init__(self, at: int, shape: tuple[int, ...], dtype: np.dtype):
        self.at, self.shape, self.dtype = at, shape, dtype


def pack(value: Any, shared: Shared) -> Nodes:
    """The nodes of a plain value, the last of which is the value itself; arrays go to `shared`.

    Args:
        value: None, truth values, numbers, texts, bytes, arrays of numbers and texts, `Placed`, and containers of these.
        shared: takes the bytes of arrays.

    Raises:
        UserError: there is something else in it.
    """
    nodes: Nodes = []
    known: dict[int, int] = {}
    keep: list[Any] = []  # so that no id is given twice

    def child(part: Any) -> int:
        if id(part) in known:
            return known[id(part)]
        keep.append(part)
        nodes.append(_leaf(part, shared))
        known[id(part)] = len(nodes) - 1
        return known[id(part)]

    stack = [(value, False)]
    while stack:
        part, ready = stack.pop()
        if id(part) in known:
            continue
        numbers = _numbers(part)
        if numbers is not None:
            keep.append(part)
            nodes.append(["n", type(part) is list, shared.put(numbers), len(numbers), numbers.dtype.str])
            known[id(part)] = len(nodes) - 1
            continue
        parts = _parts(part)
        if parts is None:
            child(part)
        elif not ready:
            keep.append(part)
            stack.append((part, True))
            stack += [(each, False) for each in parts]
        else:
            if any(id(each) not in known for each in parts):
                raise UserError("refused: containers that hold themselves")
            kind = _container(part)
            assert kind is not None  # it has parts
            nodes.append([_TAGS[kind], [known[id(each)] for each in parts]])
            known[id(part)] = len(nodes) - 1
    return [*nodes, ["root", known[id(value)]]]


_TAGS: dict[type, str] = {dict: "d", list: "l", tuple: "t", set: "s", frozenset: "z"}


def _numbers(part: Any) -> np.ndarray | None:
    """A list or tuple of floats alone, or of whole numbers alone, as an array; None of all else."""
    if type(part) not in (list, tuple) or len(part) < 16:
        return None
    kinds = set(map(type, part))
    if kinds == {float}:
        return np.array(part, np.float64)
    if kinds == {int} and min(part) >= -(2**63) and max(part) < 2**63:
        return np.array(part, np.int64)
    return None


def _container(part: Any) -> type | None:
    if isinstance(part, Mapping):
        return dict
    return next((kind for kind in (list, tuple, set, frozenset) if isinstance(part, kind)), None)


def _parts(part: Any) -> list[Any] | None:
    """What a container holds, of a mapping keys and values by turns; None of what is none."""
    kind = _container(part)
    if kind is None:
        if isinstance(part, np.ndarray) and part.dtype.kind == "O":
            raise UserError("refused: a numpy array of Python objects")
        return None
    if kind is dict:
        # Held in a list of the mapping's own objects: their ids stay theirs.
        return [each for pair in part.items() for each in pair]
    return list(part)


def _leaf(part: Any, shared: Shared) -> list[Any]:
    if isinstance(part, Placed):
        return ["a", part.at, list(part.shape), part.dtype.str]
    if isinstance(part, np.ndarray):
        if part.dtype.kind not in _KINDS:
            raise UserError(f"refused: a numpy array of {part.dtype}")
        return ["a", shared.put(part), list(part.shape), part.dtype.str]
    if isinstance(part, np.generic):
        if part.dtype.kind not in _KINDS:
            raise UserError(f"refused: a number of {part.dtype}")
        return ["g", shared.put(np.asarray(part)), [], part.dtype.str]
    if part is None or isinstance(part, bool):
        return ["v", part]
    if isinstance(part, int):
        return ["i", format(part, "x")]  # JSON's whole numbers have at most 4,300 digits
    if isinstance(part, float):
        return ["f", part.hex()]
    if isinstance(part, complex):
        return ["c", part.real.hex(), part.imag.hex()]
    if isinstance(part, str):
        return ["u", base64.b64encode(part.encode("utf-8", "surrogatepass")).decode()] if _odd(part) else ["w", part]
    if isinstance(part, bytes | bytearray):
        return ["y" if isinstance(part, bytes) else "Y", base64.b64encode(part).decode()]
    raise UserError(f"refused: an object of {type(part).__name__}")


def _odd(text: str) -> bool:
    return any("\ud800" <= c <= "\udfff" for c in text) if not text.isascii() else False


def unpack(nodes: Nodes, memory: Any) -> Any:
    """The value of `nodes`; arrays are views of `memory`, the mapped bytes."""
    values: list[Any] = []
    for tag, *rest in nodes:
        match tag:
            case "d":
                (of,) = rest
                values.append({values[key]: values[item] for key, item in zip(of[::2], of[1::2], strict=True)})
            case "l" | "t" | "s" | "z":
                make = {"l": list, "t": tuple, "s": set, "z": frozenset}[tag]
                values.append(make(values[i] for i in rest[0]))
            case "a" | "g":
                at, shape, kind = rest
                array = np.frombuffer(memory, np.dtype(kind), math.prod(shape), at).reshape(shape)
                values.append(array if tag == "a" else array.copy()[()])
            case "n":
                is_list, at, count, kind = rest
                numbers = np.frombuffer(memory, np.dtype(kind), count, at).tolist()
                values.append(numbers if is_list else tuple(numbers))
            case "v" | "w":
                values.append(rest[0])
            case "i":
                values.append(int(rest[0], 16))
            case "f":
                values.append(float.fromhex(rest[0]))
            case "c":
                values.append(complex(float.fromhex(rest[0]), float.fromhex(rest[1])))
            case "u":
                values.append(base64.b64decode(rest[0]).decode("utf-8", "surrogatepass"))
            case "y" | "Y":
                data = base64.b64decode(rest[0])
                values.append(data if tag == "y" else bytearray(data))
            case _:
                return values[rest[0]]
    raise ValueError("nodes without a root")
