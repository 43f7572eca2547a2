"""Arrays in .npy and .npz files: what they say of themselves is checked before anything is unpacked."""

import ast
import math
import os
import struct
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from deadreckon.errors import UserError, reading
from deadreckon.foreign.door import file_size, opened
from deadreckon.foreign.limits import MEMBERS, check, check_unpacked

_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # which numpy writes
_ENCRYPTED = 1  # flag of a member
_KINDS = "biufcSU"
_LONGEST = 64_000  # bytes of the header of an array; numpy's own are below 200


def read_arrays(path: Path | str, kind: str = "npz") -> dict[str, np.ndarray]:
    """All arrays of an npz file; texts and numbers alone, nothing is unpickled.

    Args:
        path: of the file.
        kind: what it should be, in words, for errors.

    Raises:
        UserError: it is no such file, is damaged, has members of one name, holds Python objects, or unpacks to more than it
            may (`foreign.limits`).
    """
    with opened(path) as file, reading(path, kind), zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        size = os.fstat(file.fileno()).st_size
        check(path, len(members), MEMBERS, "holds")
        check_unpacked(path, sum(each.file_size for each in members), size)
        found: dict[str, np.ndarray] = {}
        for each in members:
            name = each.filename.removesuffix(".npy")
            if name in found:
                raise UserError(f"{path}: two of its members are called {name!r}, and only one can be meant")
            if each.compress_type not in _PACKINGS or each.flag_bits & _ENCRYPTED:
                raise UserError(f"{path}: member {name!r} is packed in a way that numpy does not write")
            with archive.open(each) as member:
                found[name] = _array(f"{path}: member {name!r}", member, each.file_size)
    return found


def read_array(path: Path | str, *, mmap: bool = False) -> np.ndarray:
    """The array of a .npy file.

    Args:
        path: of the file.
        mmap: memory-map it.

    Raises:
        UserError: it is no such file, is cut short, or holds Python objects.
    """
    size = file_size(path)
    with opened(path) as file, reading(path, "a .npy column"):
        if not mmap:
            return _array(str(path), file, size)
        shape, fortran, dtype = _header(str(path), file, size)
        if 0 in shape:  # which cannot be mapped
            return np.zeros(shape, dtype)
        return np.memmap(path, dtype, "r", file.tell(), shape, "F" if fortran else "C")


def _array(where: str, file: Any, size: int) -> np.ndarray:
    shape, fortran, dtype = _header(where, file, size)
    whole = math.prod(shape) * dtype.itemsize
    data = np.empty(whole, np.uint8)
    view = data.data
    done = 0
    while done < whole:
        part = file.read(min(whole - done, 1 << 24))
        if not part:
            raise UserError(f"{where} is cut short")
        view[done : done + len(part)] = part
        done += len(part)
    if file.read(1):
        raise UserError(f"{where} has bytes behind its array")
    return data.view(dtype).reshape(shape, order="F" if fortran else "C") if whole else np.zeros(shape, dtype)


def _header(where: str, file: BinaryIO, size: int) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether columns are adjacent, and type of an array whose header is read; its bytes are `size`, header included."""
    major, _ = np.lib.format.read_magic(file)
    if major > 3:
        raise UserError(f"{where} is in a version of the format that is not known")
    start = file.read(2 if major == 1 else 4)
    (length,) = struct.unpack("<H" if major == 1 else "<I", start)
    if length > min(size, _LONGEST):
        raise UserError(f"{where} has a header of {length} bytes, which is no array's")
    text = file.read(length)
    shape, fortran, dtype = _parsed(where, text.decode("utf-8" if major == 3 else "latin1"))
    left = size - 6 - 2 - len(start) - length
    if math.prod(shape) * dtype.itemsize > left:
        raise UserError(f"{where} is cut short: shape {shape} of {dtype} needs {math.prod(shape) * dtype.itemsize:,} bytes, "
                        f"there are {max(left, 0):,}")  # fmt: skip
    return shape, fortran, dtype


def _parsed(where: str, text: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    if text.count("(") + text.count("[") + text.count("{") > 9:  # more would be no shape, and the parser would go deep
        raise UserError(f"{where} has a header that is no array's")
    found = ast.literal_eval(text)
    if not isinstance(found, dict) or found.keys() != {"descr", "fortran_order", "shape"}:
        raise UserError(f"{where} has a header that is no array's")
    shape, fortran, kind = found["shape"], found["fortran_order"], found["descr"]
    if not isinstance(shape, tuple) or len(shape) > 32 or not all(type(each) is int and each >= 0 for each in shape):
        raise UserError(f"{where} has the shape {str(shape)[:60]}, whole numbers of 0 or more are needed")
    dtype = np.dtype(kind) if isinstance(kind, str) else np.dtype(object)
    if not dtype.itemsize and 0 not in shape:  # of texts without a character: no bytes, and as many as the header likes
        raise UserError(f"{where} holds texts of no characters, which take no bytes; leave the array out")
    if dtype.kind not in _KINDS or type(fortran) is not bool:
        what = "Python objects" if dtype.kind == "O" else f"{kind!r:.60}"
        raise UserError(f"{where} holds {what}; arrays of numbers, truth values or texts are read")
    return shape, fortran, dtype
