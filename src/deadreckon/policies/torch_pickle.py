"""Networks that torch 1 pickled within objects, as the published policies of DAPG are, read without torch.

Nothing in a file is run: of its objects only the fields are read, as dicts, and the tensors, as arrays; none of the classes
is looked up.
"""

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.errors import UserError
from deadreckon.unpickle import ArrayDouble, ObjectDouble, PlainUnpickler, unpickle


def load_network(path: Path | str) -> Any:
    """The plain value in a pickle that may also hold mjrl's policies and torch 1's layers: objects as dicts, tensors as arrays.

    Nothing in it is run, and neither package is needed.

    Raises:
        UserError: one line that names what was refused, or that the file is damaged.
    """
    return unpickle(path, "network")


class NetworkUnpickler(PlainUnpickler):
    """Knows the names that mjrl's policies and torch 1's layers are pickled under, too, as doubles that hold their fields."""

    OBJECTS = (
        ("mjrl.policies.gaussian_mlp", "MLP"), ("mjrl.utils.fc_network", "FCNetwork"),
        ("torch.nn.modules.container", "ModuleList"), ("torch.nn.modules.linear", "Linear"),
    )  # fmt: skip

    def find_class(self, module_name: str, global_name: str) -> Any:
        """The double of what the pickle asks for; all else is refused."""
        if (module_name, global_name) in self.OBJECTS:
            return ObjectDouble
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

    def _tensor(self, storage: np.ndarray, offset: int, size: Any, stride: Any, *rest: Any) -> ArrayDouble:
        whole = int(np.prod(size, dtype=np.int64))
        if tuple(stride) != tuple(np.cumprod([1, *size[:0:-1]])[::-1].tolist()) or not 0 <= offset <= len(storage) - whole:
            raise UserError("refused: a tensor whose numbers do not lie one after the other")
        return ArrayDouble(storage[offset : offset + whole].reshape(size).copy())

    def _storage(self, data: bytes) -> np.ndarray:
        return _StorageUnpickler.read(data)

    def _nothing(self) -> None:
        return None

    def _name(self, owner: Any, name: str) -> str:
        return str(name)


class _StorageUnpickler(PlainUnpickler):
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
