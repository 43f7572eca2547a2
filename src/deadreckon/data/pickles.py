"""Pickles, read without running what they ask for: plain values and numeric numpy arrays, nothing else.

The one exception that is known by name: networks that torch 1 pickled within objects, as the published policies of DAPG are. Of
these, too, only the fields are read, as dicts, and the tensors, as arrays; none of the classes is looked up.
"""

import collections
import gzip
import io
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.layout import COLUMNS, NEEDED, build, naming, reading, stem
from deadreckon.data.spec import Box
from deadreckon.errors import UserError

_BUILTINS = {"list": list, "dict": dict, "tuple": tuple, "set": set, "frozenset": frozenset, "bytearray": bytearray}
_DEEPEST = 50
# What a damaged pickle makes the standard library raise.
_BROKEN = (pickle.UnpicklingError, EOFError, ValueError, KeyError, IndexError, AttributeError, TypeError, OverflowError,
           MemoryError, ImportError, AssertionError)  # fmt: skip


def load_pickle(path: Path | str) -> Any:
    """The plain value in a pickle: containers, numbers, texts and numeric numpy arrays; nothing in it is run.

    Also Python 2's; gzipped files are unpacked.

    Raises:
        UserError: one line that names what was refused, or that the file is damaged.
    """
    return _load(path, _Unpickler)


def load_network(path: Path | str) -> Any:
    """The plain value in a pickle that may also hold mjrl's policies and torch 1's layers: objects as dicts, tensors as arrays.

    Nothing in it is run, and neither package is needed.

    Raises:
        UserError: one line that names what was refused, or that the file is damaged.
    """
    return _load(path, _NetworkUnpickler)


def _load(path: Path | str, kind: "type[_Unpickler]") -> Any:
    with reading(path, "a pickle", *_BROKEN), naming(path, ""), open(path, "rb") as file:
        data = file.read()
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
        return _plain(kind(data).load(), {})


def read_pickle(path: Path | str, *, strict: bool = False, name: str | None = None, horizon: int | None = None) -> Dataset:
    """Reads a pickled log: a dict of D4RL's columns, or a list of such dicts, one an episode.

    The human demonstrations of Adroit (dicts with `init_state_dict`, which is not kept) have T observations for T
    actions, so the last row of each episode has no known successor; their actions are bounded by -1 and 1, and
    `door-v0_demos.pickle` is called `door-human`.

    Raises:
        UserError: one line that names file, episode, column and row.
    """
    value = load_pickle(path)
    if isinstance(value, Mapping):
        columns = {str(key): column for key, column in value.items() if isinstance(column, np.ndarray)}
        return build(path, columns, source="pickle", name=name, strict=strict, horizon=horizon)
    if not isinstance(value, list) or not value or not all(isinstance(episode, Mapping) for episode in value):
        raise UserError(f"{path}: a list of episodes (dicts of arrays) is needed, found {type(value).__name__}")
    columns = _joined(path, value)
    adroit = "init_state_dict" in value[0]
    space = None
    if adroit:
        size = columns["actions"].shape[-1]
        space = Box((-1.0,) * size, (1.0,) * size)
    if name is None:
        name = stem(path)
        task, _, rest = name.partition("-v0_")
        name = f"{task}-human" if adroit and rest == "demos" else name
    source = "adroit-demonstrations" if adroit else "pickle"
    return build(path, columns, source=source, name=name, action_space=space, strict=strict, horizon=horizon)


def _joined(path: Path | str, episodes: list[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Columns of all episodes, one after another, with a timeout at the end of each that has no terminal there."""
    keys = [key for key in COLUMNS if not key.startswith("final_") and key in episodes[0]]
    for number, episode in enumerate(episodes):
        for key in dict.fromkeys((*NEEDED, *keys)):
            if not isinstance(episode.get(key), np.ndarray) or not episode[key].ndim:
                raise UserError(f"{path}: episode {number} has no array {key}")
        for key in keys:
            if len(episode[key]) != len(episode["actions"]):
                have = f"{len(episode[key])} {key} and {len(episode['actions'])} actions"
                raise UserError(f"{path}: episode {number} has {have}; equally many are needed")
        if not len(episode["actions"]):
            raise UserError(f"{path}: episode {number} has no steps")
    columns: dict[str, np.ndarray] = {}
    for key in keys:
        try:
            columns[key] = np.concatenate([episode[key] for episode in episodes])
        except ValueError as error:
            raise UserError(f"{path}: column {key} has another shape in some episode ({error})") from error
    last = np.cumsum([len(episode["actions"]) for episode in episodes]) - 1
    rows = len(columns["actions"])
    timeouts = np.asarray(columns.get("timeouts", np.zeros(rows)), bool).reshape(rows)
    timeouts[last] |= ~np.asarray(columns.get("terminals", np.zeros(rows)), bool).reshape(rows)[last]
    return {**columns, "timeouts": timeouts}


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


class _Array:
    """Stands for a numpy array until its bytes have come."""

    __slots__ = ("value",)

    def __init__(self, value: np.ndarray | None = None):
        self.value = value

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, fortran, data = state
        self.value = _from_bytes(data, dtype, shape, "F" if fortran else "C")


class _Unpickler(pickle.Unpickler):
    """Finds containers and the few functions that numpy arrays are made of, as harmless doubles of our own.

    numpy's own would not be safe: `numpy.ndarray` called with a buffer of objects takes the process down.
    """

    def __init__(self, data: bytes):
        super().__init__(io.BytesIO(data), encoding="latin1")  # Python 2 kept bytes in texts

    def find_class(self, module_name: str, global_name: str) -> Any:
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
        raise UserError("refused: the pickle refers to something outside itself")

    # Bound methods, on which a pickle cannot set attributes.
    def _encode(self, text: str, encoding: str = "latin1") -> bytes:
        return text.encode("latin1")

    def _no_bytes(self) -> bytes:
        return b""

    def _dtype(self, code: Any, align: Any = False, copy: Any = False) -> _Type:
        return _Type(code)

    def _reconstruct(self, kind: Any, shape: Any, code: Any) -> _Array:
        return _Array()

    def _scalar(self, dtype: _Type, data: Any) -> Any:
        return _from_bytes(data, dtype, (), "C")[()]

    def _frombuffer(self, data: Any, dtype: _Type, shape: Any, order: Any) -> _Array:
        return _Array(_from_bytes(data, dtype, shape, order))


class _Object:
    """Stands for an object of a class that is not looked up; its fields are kept."""

    __slots__ = ("fields",)

    def __init__(self):
        self.fields: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, dict):
            raise UserError("refused: an object without named fields")
        self.fields = state


class _NetworkUnpickler(_Unpickler):
    """Knows the names that mjrl's policies and torch 1's layers are pickled under, too, as doubles that hold their fields."""

    OBJECTS = (
        ("mjrl.policies.gaussian_mlp", "MLP"), ("mjrl.utils.fc_network", "FCNetwork"),
        ("torch.nn.modules.container", "ModuleList"), ("torch.nn.modules.linear", "Linear"),
    )  # fmt: skip

    def find_class(self, module_name: str, global_name: str) -> Any:
        if (module_name, global_name) in self.OBJECTS:
            return _Object
        known = {
            ("torch._utils", "_rebuild_parameter"): self._parameter,
            ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
            ("torch.storage", "_load_from_bytes"): self._storage,
            ("torch.nn.backends.thnn", "_get_thnn_function_backend"): self._nothing,
            ("torch._C", "_VariableFunctions"): None,
            ("builtins", "getattr"): self._name,  # of one of torch's functions, such as tanh
        }
        if (module_name, global_name) in known:
            return known[module_name, global_name]
        return super().find_class(module_name, global_name)

    def _parameter(self, data: Any, requires_grad: Any, hooks: Any) -> Any:
        return data

    def _tensor(self, storage: np.ndarray, offset: int, size: Any, stride: Any, *rest: Any) -> _Array:
        whole = int(np.prod(size, dtype=np.int64))
        if tuple(stride) != tuple(np.cumprod([1, *size[:0:-1]])[::-1].tolist()) or not 0 <= offset <= len(storage) - whole:
            raise UserError("refused: a tensor whose numbers do not lie one after the other")
        return _Array(storage[offset : offset + whole].reshape(size).copy())

    def _storage(self, data: bytes) -> np.ndarray:
        return _StorageUnpickler.read(data)

    def _nothing(self) -> None:
        return None

    def _name(self, owner: Any, name: str) -> str:
        return str(name)


class _StorageUnpickler(_Unpickler):
    """The numbers of one tensor, as torch 1 wrote them: five small pickles (what it is, then whose), a count, and the bytes."""

    MAGIC = 0x1950A86A20F9469CFC6C
    TYPES = {"FloatStorage": "<f4", "DoubleStorage": "<f8", "LongStorage": "<i8"}  # noqa: RUF012

    @classmethod
    def read(cls, data: bytes) -> np.ndarray:
        """(numbers,) of the storage in `data`."""
        file = io.BytesIO(data)
        magic, _, about, root, keys = (cls(file).load() for _ in range(5))
        if magic != cls.MAGIC or not isinstance(about, dict) or not about.get("little_endian"):
            raise UserError("refused: a tensor that torch did not write")
        code, key, count = root
        if keys != [key] or int.from_bytes(file.read(8), "little") != count:
            raise UserError("refused: a tensor that shares its numbers with others")
        return np.frombuffer(file.read(), code, count)

    def __init__(self, file: io.BytesIO):
        pickle.Unpickler.__init__(self, file, encoding="latin1")

    def find_class(self, module_name: str, global_name: str) -> Any:
        if module_name == "torch" and global_name in self.TYPES:
            return self.TYPES[global_name]
        return super().find_class(module_name, global_name)

    def persistent_load(self, pid: Any) -> Any:
        kind, code, key, _, count, view = pid
        if kind != "storage" or code not in self.TYPES.values() or view is not None:
            raise UserError("refused: the pickle refers to something outside itself")
        return code, key, count


def _from_bytes(data: Any, dtype: _Type, shape: tuple, order: Any) -> np.ndarray:
    if isinstance(data, str):
        data = data.encode("latin1")
    if not isinstance(data, (bytes, bytearray)):
        raise UserError("refused: a numpy array of Python objects")
    # A copy, because arrays over bytes are read-only.
    return np.frombuffer(data, dtype.real).reshape(shape, order=order).copy()


def _plain(value: Any, done: dict[int, Any], depth: int = 0) -> Any:
    """`value` with arrays in place of their doubles; `done` keeps what is shared from being copied over and over."""
    if depth > _DEEPEST:
        raise UserError("refused: containers nested too deep")
    if isinstance(value, _Array):
        if value.value is None:
            raise UserError("refused: a numpy array without data")
        return value.value
    if isinstance(value, _Object):
        value = value.fields
    if not isinstance(value, (Mapping, list, tuple)):
        return value
    if id(value) not in done:
        if isinstance(value, Mapping):
            done[id(value)] = {key: _plain(item, done, depth + 1) for key, item in value.items()}
        else:
            done[id(value)] = type(value)(_plain(item, done, depth + 1) for item in value)
    return done[id(value)]
