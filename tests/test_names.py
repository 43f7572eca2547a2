"""Names from outside as names of files, and as they are shown."""

import io

import pytest

from deadreckon.bench.jobs import file_name
from deadreckon.errors import UserError
from deadreckon.names import LONGEST, Terminal, file_part, natural, safe_name, safe_path, shown

PLAIN = ["console", "com", "com10", "nulls", "a.con", "-rf", "é.x"]  # not quite what Windows keeps


@pytest.mark.parametrize("name", ["speed", "a b", "é", ".hidden", "x..y", "maze2d-umaze-v1@dr1", "a" * LONGEST, *PLAIN])
def test_plain_names_are_names_of_files(name):
    assert safe_name(name, "column") == file_part(name) == name


HOSTILE = {
    "": "is empty", ".": "another folder", "..": "another folder", "../x": "another folder", "/abs/x": "another folder",
    "a/b": "another folder", "a/": "another folder", "C:\\x": "another folder", "C:x": "another folder",
    "..\\x": "another folder", "nul\0": "control characters", "two\nlines": "control characters",
    "\ud800": "control characters", "é" * 101: "longer than 200 bytes", "\x1b[2J": "control characters",
    "\u202egpj.exe": "control characters", "line\u2028": "control characters",
    "dot.": "which Windows drops", "blank ": "which Windows drops",
    "CON": "device on Windows", "nul.tar.gz": "device on Windows", "Com1 .x": "device on Windows", "lpt³": "device on Windows",
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_names_that_lead_elsewhere_are_refused_or_made_plain(name):
    with pytest.raises(UserError, match=f"^column '.*{HOSTILE[name]}, so no file can be called that; rename it$") as told:
        safe_name(name, "column")
    assert len(str(told.value)) < 200
    assert str(told.value).isprintable()
    made = file_part(name)
    assert safe_name(made, "folder") == made != name


def test_a_name_made_plain_can_still_be_read():
    assert file_part("mujoco/hopper/medium-v0") == "mujoco-hopper-medium-v0"
    assert file_part("bc-x/../../../RUN") == "bc-x-..-..-..-RUN"
    assert file_part("é" * 150) == "é" * 100
    assert [file_part(name) for name in ("CON", "aux.txt", "com1.tar.gz", "dot..", "blank ", "C:RUN", "", "..")] == [
        "CON-", "aux-.txt", "com1-.tar.gz", "dot-", "blank-", "C-RUN", "-", "-",
    ]  # fmt: skip
    assert file_name(".hidden 50 %/day") == "hidden_50___day"


def test_paths_in_files_stay_in_the_files_folder():
    assert safe_path("results/./cells", "ledger").as_posix() == "results/cells"
    for path in ("/abs", "../x", "a/../x", "a//b", "", "C:/x", "a/nul", "a\\..\\x", "a/b\n"):
        with pytest.raises(UserError, match=r"^ledger .*: part "):
            safe_path(path, "ledger")


def test_what_is_shown_cannot_steer_a_terminal():
    assert shown("naïve 語 \u00a0😀 \\x1b") == "naïve 語 \u00a0😀 \\x1b"
    assert shown("\x1b[2J\x07 a\nb\tc\x9b\u202e\ud800") == r"\x1b[2J\x07 a\nb\tc\x9b\u202e\ud800"
    out = io.StringIO()
    print("two\nlines", "tab\tbed", "\x1b[31m", file=Terminal(out))
    assert out.getvalue() == "two\nlines tab\tbed \\x1b[31m\n"


def test_numbers_in_names_count_as_numbers():
    names = ["run_10", "run_2", "run_02b", "b", "run", "run_9" + "9" * 5000, "2", "10"]
    assert sorted(names, key=natural) == ["b", "run", "run_2", "run_02b", "run_10", names[5], "2", "10"]
