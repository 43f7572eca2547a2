"""Damage to pickles, by their operations."""

import pickletools

from tests.fuzz.mutate import Rng, havoc, pick

_OPCODES = (
    b"(", b".", b"0", b"1", b"2", b"F1.5\n", b"I01\n", b"K\x01", b"M\x01\x00", b"J\xff\xff\xff\x7f", b"N", b"Pid\n", b"Q", b"R",
    b"a", b"b", b"cos\nsystem\n", b"cbuiltins\nexec\n", b"cbuiltins\ngetattr\n", b"cnumpy\nload\n", b"cnumpy\nndarray\n",
    b"cnumpy\ndtype\n", b"cnumpy.core.multiarray\n_reconstruct\n", b"cnumpy.core.multiarray\nscalar\n", b"d", b"e", b"g0\n",
    b"h\x00", b"j\x01\x00\x00\x00", b"l", b"p7\n", b"q\x07", b"r\xff\xff\xff\x1f", b"s", b"t", b"u", b"}", b"]", b")", b"\x85",
    b"\x86", b"\x87", b"\x81", b"\x88", b"\x8a\xff", b"\x8b\xff\xff\xff\x7f", b"\x8c\x02os", b"\x8f", b"\x90", b"\x91", b"\x92",
    b"\x93", b"\x94", b"\x95\xff\xff\xff\xff\xff\xff\xff\x7f", b"\x96\xff\xff\xff\xff\xff\xff\xff\x00", b"\x97", b"\x98",
    b"ios\nsystem\n", b"(lp0\n", b"X\xff\xff\xff\x7f", b"B\xff\xff\xff\x7f", b"ccollections\nOrderedDict\n",
    b"cbuiltins\nbytearray\n", b"c_codecs\nencode\n", b"cbuiltins\nset\n", b"cbuiltins\nlist\n",
    b"S'echo owned > owned'\n", b"c__main__\nx\n",
)  # fmt: skip


def pickled(data: bytes, rng: Rng) -> bytes:
    """A pickle with operations put in, taken out or exchanged."""
    if rng.random() < 0.4:
        return havoc(data, rng)
    try:
        places = [at for _, _, at in pickletools.genops(data)]
    except Exception:  # noqa: BLE001 - the seed itself is odd
        return havoc(data, rng)
    parts = [data[a:b] for a, b in zip(places, [*places[1:], len(data)])]
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(len(parts)))
        match int(rng.integers(6)):
            case 0 | 1 | 2:
                parts.insert(at, pick(rng, _OPCODES))
            case 3:
                parts[at] = pick(rng, _OPCODES)
            case 4:
                del parts[at]
            case _:
                parts.insert(at, pick(rng, parts))
        if not parts:
            return b"."
        if rng.random() < 0.02:
            parts.insert(at, pick(rng, (b")", b"(", b"]", b"\x85", b"}")) * int(rng.integers(100, 20_000)))
    return b"".join(parts)
