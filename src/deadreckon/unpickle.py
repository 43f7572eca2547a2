"""Pickles, read without running what they ask for: plain values and numeric numpy arrays, nothing else.

They are read in a process of their own (`foreign.child`), because a damaged one can ask for any time and any memory.
"""

import collections
import importlib
import io
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.errors import UserError, naming
from deadreckon.foreign.child import read_apart
from deadreckon.foreign.door import file_size, opened, unpacked
from deadreckon.foreign.limits import DEPTH, MEMBERS, beyond
from deadreckon.foreign.reader import bound_memory

_BUILTINS = {"list": list, "dict": dict, "tuple": tuple, "set": set, "frozenset": frozenset, "bytearray": bytearray}
_GROWS = 64  # bytes that a value may take for each byte of its pickle: a number of one byte is an object of 32 and its place
# The unpicklers that may be named: nothing that a request says is looked up elsewhere.
_UNPICKLERS = {
    "plain": "deadreckon.unpickle:PlainUnpickler",
    "log": "deadreckon.data.formats.pickles:BufferUnpickler",
    "network": "deadreckon.policies.torch_pickle:NetworkUnpickler",
}


def load_pickle(path: Path | str) -> Any:
    """The plain value in a pickle: containers, numbers, texts and numeric numpy arrays; nothing in it is run.

    Also Python 2's; gzipped files are unpacked.

    Raises:
        UserError: one line that names what was refused, or that the file is damaged.
    """
    return unpickle(path, "plain")


def unpickle(path: Path | str, unpickler: str) -> Any:
    """The plain value in a pickle, gzipped or not, by an unpickler of this package; raises as `load_pickle`.

    Args:
        path: of the file.
        unpickler: `plain`; `log`, which knows replay buffers; or `network`, which knows the layers of policies.
    """
    size = file_size(path)
    with naming(path, str(path)):
        return read_apart("pickle", path, "a pickle", size=size, file=str(path), unpickler=unpickler)


def inside(file: str, unpickler: str, shared: Any) -> Any:
    """The work of `unpickle`, in a process of its own."""
    module, _, name = _UNPICKLERS[unpickler].partition(":")
    kind = getattr(importlib.import_module(module), name)
    with opened(file) as source:
        data = unpacked(file, source).read()
    bound_memory(_GROWS * len(data))  # so that an index of 2 ** 29 is no table of as many places
    return _plain(file, kind(data).load())


class _Type:
    """Stands for a numpy dtype: only numbers, so that no crafted state reaches numpy."""

    __slots__ = ("code", "order")

    def __init__(self, code: Any):
        self.code, self.order = str(code), "="

    def __setstate__(self, state: tuple) -> None:
        if any(part is not None for part in state[2:5]):
            raise UserError("refused: a structured numpy dtype")
        self.order = state[1]

    @property
    def real(self) -> np.dtype:
        dtype = np.dtype(self.code).newbyteorder(">" if self.order == ">" else "<" if self.order == "<" else "=")
        if dtype.kind not in "biufcSU":
            raise UserError(f"refused: a numpy array of {dtype}")
        return dtype


class ArrayDouble:
    """Stands for a numpy array until its bytes have come."""

    __slots__ = ("value",)

    def __init__(self, value: np.ndarray | None = None):
        self.value = value

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, fortran, data = state
        self.value = _from_bytes(data, dtype, shape, "F" if fortran else "C")


class ObjectDouble:
    """Stands for an object of a class that is not looked up; its fields are kept."""

    __slots__ = ("fields",)

    def __init__(self):
        self.fields: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, dict):
            raise UserError("refused: an object without named fields")
        self.fields = state


class PlainUnpickler(pickle.Unpickler):
    """Finds containers and the few functions that numpy arrays are made of, as harmless doubles of our own.

    numpy's own would not be safe: `numpy.ndarray` called with a buffer of objects takes the process down.
    """

    def __init__(self, data: bytes):
        super().__init__(io.BytesIO(data), encoding="latin1")  # Python 2 kept bytes in texts

    def find_class(self, module_name: str, global_name: str) -> Any:
        """The double of what the pickle asks for; all else is refused."""
        if module_name in ("builtins", "__builtin__") and global_name in _BUILTINS:
            return _BUILTINS[global_name]
        if module_name in ("builtins", "__builtin__") and global_name == "bytes":
            return self._no_bytes
        if (module_name, global_name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if (module_name, global_name) == ("_codecs", "encode"):
            return self._encode
        root, _, rest = module_name.partition(".")
        if root == "numpy" and rest in ("", "core.multiarray", "_core.multiarray", "core.numeric", "_core.numeric"):
            known = {"ndarray": "ndarray", "dtype": self._dtype, "_reconstruct": self._reconstruct,
                     "scalar": self._scalar, "_frombuffer": self._frombuffer}  # fmt: skip
            if global_name in known:
                return known[global_name]
        raise UserError(f"refused: the pickle asks for {module_name}.{global_name}; only plain arrays are read")

    def persistent_load(self, pid: Any) -> Any:
        """Refuses what lies outside the pickle."""
        raise UserError("refused: the pickle refers to something outside itself")

    # Bound methods, on which a pickle cannot set attributes.
    def _encode(self, text: str, encoding: str = "latin1") -> bytes:
        return text.encode("latin1")

    def _no_bytes(self) -> bytes:
        return b""

    def _dtype(self, code: Any, align: Any = False, copy: Any = False) -> _Type:
        return _Type(code)

    def _reconstruct(self, kind: Any, shape: Any, code: Any) -> ArrayDouble:
        return ArrayDouble()

    def _scalar(self, dtype: _Type, data: Any) -> Any:
        return _from_bytes(data, dtype, (), "C")[()]

    def _frombuffer(self, data: Any, dtype: _Type, shape: Any, order: Any) -> ArrayDouble:
        return ArrayDouble(_from_bytes(data, dtype, shape, order))


def _from_bytes(data: Any, dtype: _Type, shape: tuple, order: Any) -> np.ndarray:
    if isinstance(data, str):
        data = data.encode("latin1")
    if not isinstance(data, (bytes, bytearray)):
        raise UserError("refused: a numpy array of Python objects")
    # A copy, because arrays over bytes are read-only.
    return np.frombuffer(data, dtype.real).reshape(shape, order=order).copy()


def _plain(path: Path | str, value: Any) -> Any:
    """`value` with arrays in place of their doubles; `done` keeps what is shared from being copied over and over."""
    done: dict[int, Any] = {}
    most, deepest = MEMBERS.value * 100, DEPTH.value
    count = 0

    def plain(value: Any, depth: int) -> Any:
        nonlocal count
        count += 1
        if depth > deepest:
            raise beyond(path, depth, deepest, DEPTH, "has containers nested in")
        if count > most:
            raise beyond(path, count / 100, most / 100, MEMBERS, "holds hundreds of values:")
        if isinstance(value, ArrayDouble):
            if value.value is None:
                raise UserError("refused: a numpy array without data")
            return value.value
        if isinstance(value, ObjectDouble):
            value = value.fields
        if isinstance(value, _Type):
            return value.code
        if not isinstance(value, (Mapping, list, tuple)):
            return value
        if id(value) not in done:
            if isinstance(value, Mapping):
                done[id(value)] = {plain(key, depth + 1): plain(item, depth + 1) for key, item in value.items()}
            else:
                done[id(value)] = type(value)(plain(item, depth + 1) for item in value)
        return done[id(value)]

    return plain(value, 0)
