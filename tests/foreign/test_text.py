"""Keys of TOML are as deep as they have parts, and are counted before they are read."""

import time

import pytest

from deadreckon.errors import UserError
from deadreckon.foreign.text import read_toml

DOTS = ".".join("a" * 150)


@pytest.mark.parametrize(
    "text",
    [
        f"{DOTS} = 1", f"[{DOTS}]\nx = 1", f"x = {{ {DOTS} = 1 }}", DOTS.replace(".", " . ") + " = 1",
        ".".join(['"a b"', "'c'"] * 75) + " = 1", "x." * 3_000 + "y = 1",
        "x = " + ("{ " + ".".join("a" * 50) + " = ") * 9 + "1" + " }" * 9,  # none of these has many parts, all together have
    ],
)  # fmt: skip
def test_keys_with_many_parts_are_deep(tmp_path, text):
    path = tmp_path / "x.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=r"x\.toml: is nested in .* levels, more than the 100 .* DEADRECKON_MAX_DEPTH"):
        read_toml(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (f'x = "{DOTS}"', DOTS), (f"x = '{DOTS}'", DOTS), (f'x = """\n{DOTS}"""', DOTS), (f"x = '''\n{DOTS}'''", DOTS),
        (f"# it's {DOTS}\nx = 1.5", 1.5), (f'x = "\\"{DOTS}"', f'"{DOTS}'), ("x = [" + "1.5, " * 200 + "]", [1.5] * 200),
    ],
)  # fmt: skip
def test_dots_elsewhere_are_none(tmp_path, text, value):
    path = tmp_path / "x.toml"
    path.write_text(text)
    assert read_toml(path) == {"x": value}


@pytest.mark.parametrize("text", ['"' * 60_000, '"""\\' * 20_000, "a " * 60_000, "'''a" * 20_000, "a" * 90_000 + " ." * 200])
def test_looking_for_keys_takes_no_time(tmp_path, text):
    path, began = tmp_path / "x.toml", time.monotonic()
    path.write_text(text + "." * 200)
    with pytest.raises(UserError, match="is not TOML"):
        read_toml(path)
    assert time.monotonic() - began < 5
