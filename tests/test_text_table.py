"""Tables as plain text."""

from deadreckon.text_table import table

ROWS = [["name", "n", "-", "about"], ["a", "10", "", "short"], ["longer", "5", "-", "more words"]]


def test_columns_are_as_wide_as_their_longest_cells():
    assert table(ROWS, right=(1,)).splitlines() == [
        "name     n  -  about",
        "------  --  -  ----------",
        "a       10     short",
        "longer   5  -  more words",
    ]


def test_empty_columns_and_the_line_below_the_heading_can_be_left_out():
    assert table(ROWS, sparse=True, rule=False).splitlines() == [
        "name    n   about",
        "a       10  short",
        "longer  5   more words",
    ]
