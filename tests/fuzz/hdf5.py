"""Damage to HDF5 files by their own library: links, types, shapes, storage and attributes."""

import io

import h5py
import numpy as np

from tests.fuzz.mutate import Rng, havoc, pick

_SECRET = "/etc/passwd"


def hdf5(data: bytes, rng: Rng) -> bytes:
    """An HDF5 file with one to three odd things in it, or whose bytes are damaged, or both."""
    if rng.random() < 0.55:
        return _heads(data, rng)
    made = io.BytesIO(data)
    with h5py.File(made, "r+") as file:
        for _ in range(int(rng.integers(1, 4))):
            try:
                _odd(file, rng)
            except (ValueError, KeyError, TypeError, RuntimeError, OSError):  # not possible in this file
                continue
    found = made.getvalue()
    return _heads(found, rng) if rng.random() < 0.2 else found


def _heads(data: bytes, rng: Rng) -> bytes:
    """Damage near the signatures of the library's structures, where its pointers and sizes are, else anywhere."""
    marks = (b"TREE", b"SNOD", b"HEAP", b"GCOL", b"OHDR", b"FRHP", b"deadreckon", b"\x03\x00\x20\x00")
    at = data.find(pick(rng, marks), int(rng.integers(max(len(data) // 2, 1))))
    if at < 0 or rng.random() < 0.4:
        return havoc(data, rng)
    size = int(pick(rng, (16, 64, 512)))
    return data[:at] + havoc(data[at : at + size], rng, 4) + data[at + size :]


def _odd(file: h5py.File, rng: Rng) -> None:
    names: list[str] = []
    file.visit(names.append)
    name = pick(rng, names) if names else "x"
    new = pick(rng, (name, "infos/x", "metadata/x", "x", "observations", "actions", "final_known", "a/b/c", "\x1b[31m"))
    value = file.get(name)
    rows = len(value) if isinstance(value, h5py.Dataset) and value.ndim else 3
    if new in file and rng.random() < 0.9:
        del file[new]
    match int(rng.integers(16)):
        case 0:
            file[new] = h5py.ExternalLink(pick(rng, ("other.h5", _SECRET, "fifo")), "/actions")
        case 1:
            file[new] = h5py.SoftLink(pick(rng, ("/", "/x", new, "/actions", "infos")))
        case 2:
            layout = h5py.VirtualLayout((rows, 2), "<f4")
            layout[:] = h5py.VirtualSource(pick(rng, (_SECRET, "other.h5", "fifo", ".")), "actions", (rows, 2))
            file.create_virtual_dataset(new, layout)
        case 3:
            file.create_dataset(new, (rows,), "<f4", external=[(pick(rng, (_SECRET, "fifo")), 0, rows * 4)])
        case 4:
            big = pick(rng, ((2**40,), (2**20, 2**20), (rows, 2**33), (0,), (rows, 0), (1,) * 32, (2**31, 2)))
            file.create_dataset(new, big, pick(rng, ("<f4", "u1", "<f8")), chunks=pick(rng, (None, (1,) * len(big))))
        case 5:
            kinds = (
                h5py.string_dtype(), h5py.ref_dtype, h5py.vlen_dtype("<f4"), h5py.enum_dtype({"A": 1}), np.dtype("V8"),
                np.dtype([("a", "<f4"), ("b", "<i8")]), np.dtype("S5"), np.dtype("<c16"), np.dtype("<f2"), np.dtype("bool"),
                np.dtype(("<f4", (2, 2))),
            )  # fmt: skip
            file.create_dataset(new, (rows,), pick(rng, kinds))
        case 6:
            target = pick(rng, (file, value)) if value is not None else file
            what = (np.zeros(3), "text", b"\xff", np.int64(2**62), h5py.Empty("f"), np.array(["a", "b"], object),
                    np.void(b"abc"), "{}", "[" * 5000, '{"deadreckon": 1}',
                    '{"deadreckon": 1e99}', np.zeros((100, 70)))  # fmt: skip
            target.attrs[pick(rng, ("deadreckon", "x", "action_space", "env"))] = pick(rng, what)
        case 7:
            file.create_group(new)
        case 8:
            file.create_dataset(new, data=np.full((rows, 2), np.nan, pick(rng, ("<f4", ">f8"))), compression="gzip")
        case 9:
            file.create_dataset(new, data=rng.integers(-9, 9, (rows, 3)), chunks=(1, 1), fletcher32=True, shuffle=True)
        case 10:
            file[f"loop{int(rng.integers(9))}"] = file["/"]
        case 11:
            del file[name]
        case 12:
            file.move(name, new)
        case 13:
            file[new] = file[name]
        case 14:
            file.create_dataset(new, data=h5py.Empty("<f4"))
        case _:
            group = file.create_group(f"deep{int(rng.integers(99))}")
            for _ in range(int(pick(rng, (5, 300)))):
                group = group.create_group("g")
