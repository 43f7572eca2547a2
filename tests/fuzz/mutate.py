"""Damage to bytes, by the structure that they have: every mutation follows from a generator of numbers alone."""

import gzip
import io
import json
import math
import struct
import tomllib
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np

Rng = np.random.Generator
Mutation = Callable[[bytes, Rng], bytes]

_INTEGERS = (0, 1, 2, 7, 8, 63, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
_WORDS = (
    b"\0", b"\xff\xfe", b"\n", b"\r", b",", b";", b'"', b"'", b"../", b"/etc/passwd", b"\x1b[31m", b"NaN", b"1e400", b"-1",
    b"{}", b"[]", b"null", b"\x80\x04", b"PK\x03\x04", b"PAR1", b"\x89HDF", b"\x1f\x8b", b"%s%n", b"(",
    b"\xed\xa0\x80", b"=cmd|",
)  # fmt: skip
_ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**200, -(2**70), 0.5, -0.0, math.nan, math.inf, -math.inf, 1e308, "", "x",
    "../x", "/tmp/x", "\x1b[31m", "\ud800", "a" * 300, "\n", [], [1], [[]], [None], ["x"], {}, {"x": 1}, {"kind": "x"}, "@x",
    "nan", "1",
)  # fmt: skip


def pick(rng: Rng, of: Any) -> Any:
    """One of a sequence."""
    return of[int(rng.integers(len(of)))]


def havoc(data: bytes, rng: Rng, most: int = 8) -> bytes:
    """A few edits of single bytes, integers, pieces and the length, wherever they fall."""
    found = bytearray(data)
    for _ in range(int(rng.integers(1, most + 1))):
        at = int(rng.integers(len(found) + 1))
        if rng.random() < 0.3:  # where headers are
            at = min(at, int(rng.integers(1, 200)))
        match int(rng.integers(9)):
            case 0 | 1:
                found[at : at + 1] = bytes([int(rng.integers(256))])
            case 2:
                if at < len(found):
                    found[at] ^= 1 << int(rng.integers(8))
            case 3:
                value, size = pick(rng, _INTEGERS), int(pick(rng, (1, 2, 4, 8)))
                found[at : at + size] = (value % 2 ** (8 * size)).to_bytes(size, pick(rng, ("little", "big")))
            case 4:
                del found[at : at + int(rng.integers(1, 64))]
            case 5:
                found[at:at] = rng.bytes(int(rng.integers(1, 16)))
            case 6:
                found[at:at] = pick(rng, _WORDS)
            case 7:
                other, size = int(rng.integers(len(found) + 1)), int(rng.integers(1, 64))
                found[at : at + size] = found[other : other + size]
            case _:
                if rng.random() < 0.3:
                    del found[at:]
    return bytes(found)


def tree(value: Any, rng: Rng) -> Any:
    """A JSON value of which one to three parts are exchanged, left out, doubled or of another kind."""
    value = json.loads(json.dumps(value))
    for _ in range(int(rng.integers(1, 4))):
        places = list(_places(value))
        if not places:
            return pick(rng, _ODD)
        holder, key = pick(rng, places)
        match int(rng.integers(8)):
            case 0 | 1 | 2:
                holder[key] = pick(rng, _ODD)
            case 3:
                del holder[key]
            case 4:
                holder[key] = [holder[key]] if rng.random() < 0.5 else {"x": holder[key]}
            case 5:
                other, at = pick(rng, places)
                if at in other if isinstance(other, dict) else at < len(other):
                    holder[key] = json.loads(json.dumps(other[at]))
            case 6:
                if isinstance(holder, list):
                    holder.append(holder[key])
                else:
                    holder[pick(rng, ("x", "", "kind", "../x", f"{key} "))] = holder[key]
            case _:
                if isinstance(holder[key], (int, float)):
                    holder[key] = -holder[key] * 1000
                elif isinstance(holder[key], str):
                    holder[key] = havoc(holder[key].encode(), rng, 2).decode("latin1")
                elif isinstance(holder[key], list):
                    holder[key] = holder[key][:-1]
    return value


def _places(value: Any) -> Any:
    """(container, key) of every part."""
    items = list(value.items()) if isinstance(value, dict) else list(enumerate(value)) if isinstance(value, list) else []
    for key, part in items:
        yield value, key
        yield from _places(part)


def json_text(data: bytes, rng: Rng) -> bytes:
    """JSON whose tree is damaged; now and then its text, or it is nested deep."""
    chance = rng.random()
    if chance < 0.15:
        return havoc(data, rng)
    if chance < 0.16:
        return b"[" * 100_000
    try:
        return json.dumps(tree(json.loads(data), rng)).encode()
    except ValueError:
        return havoc(data, rng)


def json_lines(data: bytes, rng: Rng) -> bytes:
    """One of several lines of JSON is damaged."""
    lines = data.split(b"\n")
    at = int(rng.integers(len(lines)))
    lines[at] = json_text(lines[at], rng)
    return b"\n".join(lines)


def toml_text(data: bytes, rng: Rng) -> bytes:
    """TOML whose tree or text is damaged."""
    chance = rng.random()
    if chance < 0.25:
        return havoc(data, rng)
    if chance < 0.27:
        return b"x = " + b"[" * 50_000 if chance < 0.26 else b"x = " + b"{a=" * 50_000
    found = tree(tomllib.loads(data.decode()), rng)
    lines = found.items() if isinstance(found, dict) else [("x", found)]
    return "".join(f"{json.dumps(key)} = {_toml(value)}\n" for key, value in lines).encode("utf-8", "replace")


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(key))} = {_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value).replace("inf", "inf")
    return '""' if value is None else json.dumps(value).replace("\x7f", "\\u007f")


def table_text(data: bytes, rng: Rng) -> bytes:
    """Lines and cells of a text file are exchanged, doubled, emptied or replaced."""
    if rng.random() < 0.3:
        return havoc(data, rng)
    lines = data.split(b"\n")
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(lines)))
        at = 0 if rng.random() < 0.4 else at
        cells = lines[at].split(b",")
        cell = int(rng.integers(len(cells)))
        match int(rng.integers(7)):
            case 0 | 1:
                cells[cell] = pick(rng, _WORDS) if rng.random() < 0.5 else str(pick(rng, _ODD)).encode("utf-8", "replace")
            case 2:
                cells[cell] = pick(rng, cells)
            case 3:
                cells.append(cells[cell])
            case 4:
                del cells[cell]
            case 5:
                lines.insert(at, pick(rng, lines))
            case _:
                cells[cell] = havoc(cells[cell], rng, 2)
        lines[at] = b",".join(cells)
    found = b"\n".join(lines)
    chance = rng.random()
    if chance < 0.05:
        found = found.decode("latin1").encode(pick(rng, ("utf-16", "utf-8-sig", "utf-16-be")))
    return found if chance < 0.9 else gzip.compress(found, 1, mtime=0)[: int(rng.integers(10, 400))]


def gzipped(inner: Mutation) -> Mutation:
    """Gzip whose content is damaged, or which is itself."""

    def mutation(data: bytes, rng: Rng) -> bytes:
        if rng.random() < 0.4:
            return havoc(data, rng)
        return gzip.compress(inner(gzip.decompress(data), rng), 1, mtime=0)

    return mutation


def npy(data: bytes, rng: Rng) -> bytes:
    """A .npy file whose header says something else, or whose bytes are damaged."""
    if rng.random() < 0.4 or data[:6] != b"\x93NUMPY":
        return havoc(data, rng)
    size = struct.unpack("<H", data[8:10])[0]
    header = data[10 : 10 + size].decode("latin1")
    swaps = (
        ("'shape': (", f"'shape': ({pick(rng, _INTEGERS)}, "), ("'shape': (", "'shape': (-1, "), ("'<f4'", "'|O'"),
        ("'<f4'", f"'{pick(rng, ('>f8', '<U9', '|S3', '|V8', '<M8[s]', '<c16', '|b1', '<f2', '<i8', 'x', '<f999'))}'"),
        ("'<f4'", "[('a', '<f4')]"), ("False", "True"), ("{", "(" * int(pick(rng, (1, 300)))), ("'descr'", "'x'"),
        ("'shape': (", "'shape': __import__('os').getcwd(), ("), ("}", "]"), ("'", '"'),
    )  # fmt: skip
    header = header.replace(*pick(rng, swaps))
    if rng.random() < 0.3:
        header = havoc(header.encode(), rng, 3).decode("latin1")
    text = header.encode("latin1", "replace")[:65535]
    return data[:8] + struct.pack("<H", len(text)) + text + data[10 + size :]


def archive(member: Callable[[str], Mutation]) -> Mutation:
    """A zip archive of which a member is damaged, doubled, left out, renamed or packed otherwise; or the archive itself is."""

    def mutation(data: bytes, rng: Rng) -> bytes:
        if rng.random() < 0.3:
            return havoc(data, rng)
        with zipfile.ZipFile(io.BytesIO(data)) as whole:
            parts = [(info.filename, whole.read(info)) for info in whole.infolist()]
        packing = zipfile.ZIP_STORED
        for _ in range(int(rng.integers(1, 3))):
            at = int(rng.integers(len(parts)))
            name, content = parts[at]
            match int(rng.integers(9)):
                case 0 | 1 | 2 | 3:
                    parts[at] = name, member(name)(content, rng)
                case 4:
                    parts.insert(at, (name, pick(rng, parts)[1]))
                case 5:
                    parts = parts[:at] + parts[at + 1 :] or parts
                case 6:
                    names = ("x.npy", "../x.npy", "/x", "a/b.npy", "", f"{name}.npy", "\x1b[31m.npy")
                    parts[at] = str(pick(rng, names)), content
                case 7:
                    packing = int(pick(rng, (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)))
                case _:
                    parts[at] = name, content[: len(content) // 2]
        made = io.BytesIO()
        with zipfile.ZipFile(made, "w", packing) as whole:
            for name, content in parts:
                info = zipfile.ZipInfo(name or "x")
                info.compress_type = packing
                whole._didModify = True
                whole.NameToInfo.pop(info.filename, None)  # so that doubled names warn of nothing
                whole.writestr(info, content)
        found = made.getvalue()
        if rng.random() < 0.15:  # the directory at the end, which says sizes, places and methods
            start = found.rfind(b"PK\x01\x02", 0, len(found))
            return found[:start] + havoc(found[start:], rng, 3)
        return found

    return mutation


def of_member(name: str) -> Mutation:
    """How a member of an archive is damaged."""
    if name.endswith(".json.npy"):  # JSON as an array of bytes

        def mutation(data: bytes, rng: Rng) -> bytes:
            start = 10 + struct.unpack("<H", data[8:10])[0]
            made = io.BytesIO()
            np.save(made, np.frombuffer(json_text(data[start:], rng), np.uint8))
            return made.getvalue()

        return lambda data, rng: mutation(data, rng) if rng.random() < 0.8 else npy(data, rng)
    return npy if name.endswith(".npy") else json_text if name.endswith(".json") else havoc
