"""The planted bugs of `tests/mutants.py` still fit the source, and the tests that are to see them are there."""

from pathlib import Path

import pytest

from tests.mutants import MUTANTS, PAGE, ROOT


def test_there_are_many_with_names_of_their_own():
    assert len(MUTANTS) >= 60
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)


def test_the_page_has_a_row_for_each_and_counts_them():
    page = PAGE.read_text()
    lacking = [mutant.name for mutant in MUTANTS if f"| {mutant.breaks} | `{mutant.file}` | `" not in page]
    assert not lacking
    assert page.count("\n| ") == len(MUTANTS) + 1  # and the heads
    assert f"holds {len(MUTANTS)} bugs" in page


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_bug_can_be_planted_and_its_tests_are_there(mutant):
    compile(mutant.source(), mutant.file, "exec")  # also: what it replaces stands there once
    assert mutant.replacement != mutant.original
    for each in mutant.tests:
        path, _, name = each.partition("::")
        assert (ROOT / "tests" / path).exists()
        assert not name or f"def {name}(" in Path(ROOT / "tests" / path).read_text()
