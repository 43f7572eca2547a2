"""Everything in the package has an origin and a licence on the page, and so has every direct dependency."""

import re
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from tools import licence_table

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "src" / "deadreckon"


def data_rows(page: str) -> dict[str, list[str]]:
    """Of the first table: pattern -> the other cells of its row."""
    lines = page.partition("## Data in the package")[2].partition("\n## ")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines if line.startswith("| `")]
    return {pattern.strip("` "): rest for pattern, *rest in rows}


def shipped(package: Path) -> list[str]:
    """All files that are not Python, as the wheel holds them."""
    files = (path for path in package.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return sorted(path.relative_to(package).as_posix() for path in files if path.suffix != ".py")


def unaccounted(files: list[str], patterns: list[str]) -> list[str]:
    """Files with no row or several, and rows without files."""
    count = {file: sum(fnmatchcase(file, pattern) for pattern in patterns) for file in files}
    unused = [pattern for pattern in patterns if not any(fnmatchcase(file, pattern) for file in files)]
    return [file for file, rows in count.items() if rows != 1] + unused


@pytest.fixture(scope="module")
def rows():
    return data_rows((ROOT / "docs" / "licences.md").read_text(encoding="utf-8"))


def test_every_shipped_file_has_one_row(rows):
    assert unaccounted(shipped(PACKAGE), list(rows)) == []


def test_a_new_file_without_a_row_is_seen(rows):
    files, patterns = shipped(PACKAGE), list(rows)
    assert unaccounted([*files, "mbo/problems/new.csv"], patterns) == ["mbo/problems/new.csv"]
    assert unaccounted(files, [*patterns, "gone/*.npz"]) == ["gone/*.npz"]
    assert unaccounted(files, [*patterns, "bench/rates*"]) == ["bench/rates.toml"]


def test_what_made_it_is_there_and_no_cell_is_empty(rows):
    for pattern, cells in rows.items():
        assert len(cells) == 4, pattern
        assert all(cells), pattern
        if tool := re.fullmatch(r"`(.+\.py)`", cells[1]):
            assert (ROOT / tool[1]).is_file(), cells[1]
        else:
            assert cells[1] in ("by hand", "the command in its header"), pattern


def test_direct_dependencies_are_those_of_the_table():
    wanted = {name: ", ".join(needs) or "the package" for name, needs in licence_table.dependencies().items()}
    assert {name: needed for name, (_, needed) in licence_table.rows().items()} == wanted
    assert "jax" in wanted
    assert wanted["libsumo"] == "extra `flow`, group `dev`"


def test_installed_dependencies_state_the_licences_of_the_table():
    told = {name: found for name in licence_table.dependencies() if (found := licence_table.licence(name))}
    table = licence_table.rows()
    assert {name: table[name][0] for name in told} == told
    assert "?" not in {found for found, _ in table.values()}


def test_the_package_itself_needs_no_copyleft():
    """What comes without asking for an extra is under permissive licences alone."""
    own = {found for found, needed in licence_table.rows().values() if needed == "the package"}
    assert not [found for found in own if re.search(r"GPL|EPL|MPL|SSPL", found)]
