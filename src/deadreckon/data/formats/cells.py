"""Conversion of columns of texts: flags such as yes and no, numbers with thousands separators, dates."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import pyarrow as pa

from deadreckon.data.arrow import SAMPLE, all_match, is_string
from deadreckon.data.arrow import compute as _compute
from deadreckon.data.formats.dates import dates_of
from deadreckon.data.formats.dialect import Dialect
from deadreckon.data.formats.marks import LARGEST, of_large
from deadreckon.data.formats.spool import Spool
from deadreckon.data.likeness import likeness

# Texts that stand for a missing value among numbers, dates and flags.
MISSING = ("", "NA", "N/A", "n/a", "NaN", "nan", "NULL", "Null", "null", "None", "none", "#N/A", "#NV", "#NA")
DASH = "-"  # among numbers only
PLAIN = Dialect(",", ".", "", "utf-8", '"')
_PAIRS = (("yes", "no"), ("ja", "nein"), ("oui", "non"), ("si", "no"), ("sí", "no"), ("sì", "no"), ("true", "false"),
          ("y", "n"), ("j", "n"), ("t", "f"), ("on", "off"))  # fmt: skip
TRUTHS = {word: truth for pair in _PAIRS for word, truth in zip(pair, ("true", "false"))}  # by words in lower case
_LONE = ("yes", "no", "ja", "nein", "oui", "true", "false")  # words of flags even if the other of the pair never occurs
_SPACES = " \\x{a0}\\x{202f}\\x{2009}"
_THOUSANDS = {" ": f"[{_SPACES}]", "'": "['’]", ".": "[.]", ",": ","}
_SHOWN = 10  # largest number of messages on columns that stay texts


class Known(NamedTuple):
    """The types of some columns, as in a schema, regardless of what their cells look like.

    Attributes:
        texts: names of columns that stay texts.
        flags: names of columns of truth values.
        lists: names of columns that list actions; None: those named like one.
        words: names of categorical columns, whose levels may all be words of `MISSING`; None: those named like an action.
        plain: a dict with columns as keys, whose values reading sets to these columns before conversion; None: none.
        pairs: whether the words of a pair, such as yes and no, become truth values in columns that are not among `flags`.
    """

    texts: frozenset[str] = frozenset()
    flags: frozenset[str] = frozenset()
    lists: frozenset[str] | None = None
    words: frozenset[str] | None = None
    plain: dict[str, Any] | None = None
    pairs: bool = True

    def keep(self, name: str, values: Any) -> None:
        """Stores the values of a column in `plain` if it is a key there."""
        if self.plain is not None and name in self.plain:
            self.plain[name] = values


NOTHING = Known()


def converted(
    table: pa.Table, dialect: Dialect = PLAIN, spool: Spool | None = None, known: Known = NOTHING
) -> tuple[pa.Table, str | None, list[str]]:
    """The table with each column of texts converted if all of them are numbers, flags or dates.

    Empty cells are missing. Among flags, numbers and dates the words of `MISSING` are missing, too; in a column that stays text
    they are texts, with a message. A column is converted as a whole or not at all.

    Args:
        table: of any columns; only those of texts are converted.
        dialect: separators of decimals and thousands, and the order of dates if it is given.
        spool: where columns are kept; None: in memory.
        known: the types of some columns.

    Returns:
        The table, the order of dates that was used (None: none, or not the same in all columns), and messages.
    """
    keep = spool.keep if spool is not None else lambda values: values
    told: list[str] = []
    done: dict[str, Any] = {}
    texts: dict[str, Any] = {}  # columns that may hold dates, without missing values
    flags: list[str] = []
    grouped: list[str] = []
    for name, values in zip(table.column_names, table.columns, strict=True):
        known.keep(name, without(values, ("",)) if is_string(values.type) else values)
        if not is_string(values.type) or name in known.texts:
            continue
        trimmed = _compute.utf8_trim_whitespace(values)
        present = without(trimmed, MISSING)
        if present.null_count == len(present):
            continue
        found = flags_of(present, name in known.flags)
        if found is not None and (known.pairs or name in known.flags or not found[1]):
            done[name], words = keep(found[0]), found[1]
            flags += [f"{name} ({words})"] if words and name not in known.flags else []
        elif (number := _numbers(without(trimmed, (*MISSING, DASH)), dialect)) is not None:
            done[name], lines, marked = keep(number[0]), *number[1:]
            told += [f"column {name}: {line}" for line in lines]
            grouped += [name] if marked else []
            dashes = done[name].null_count - present.null_count
            told += [f"column {name}: '{DASH}' is a missing number in {_rows(dashes)}"] if dashes else []
        else:
            texts[name] = keep(present)
    if flags:
        told.append(f"read as true and false: {', '.join(flags)}")
    if grouped:
        told.append(f"marks of thousands are taken out of the numbers in {', '.join(grouped)}")
    european = dialect.separator == ";" or dialect.decimal == ","
    moments, order, lines = dates_of(texts, dialect.dates, european)
    done |= {name: keep(values) for name, values in moments.items()}
    told += lines
    columns, lines = [], []
    for name, values in zip(table.column_names, table.columns, strict=True):
        if name in done:
            values = done[name]
        elif is_string(values.type):
            values = keep(without(values, ("",)))
            lines += [] if name in known.texts else _of_texts(f"column {name}", values)
        columns.append(values)
    told += lines[:_SHOWN]
    if len(lines) > _SHOWN:
        told.append(f"and so on: {len(lines) - _SHOWN} more lines of columns that are read as texts")
    return pa.table(columns, names=table.column_names), order, told


def with_dates(dialect: Dialect, order: str | None) -> Dialect:
    """The dialect, with the order of dates that was found."""
    return dialect if order is None else replace(dialect, dates=order)


def without(values: Any, words: tuple[str, ...]) -> Any:
    """The texts, with those in `words` replaced by missing values."""
    gone = _compute.is_in(values, value_set=pa.array(words, values.type))
    return _compute.if_else(gone, pa.scalar(None, values.type), values)


def flags_of(texts: Any, known: bool) -> tuple[Any, str] | None:
    """(rows,) truth values and their pair of words, empty for true and false, if all texts are of one pair; else None.

    A single word is enough if it is one of `_LONE`, or if it is `known` that these are flags.
    """
    for some in (texts[:SAMPLE], texts):
        words = {text for text in _compute.unique(_compute.utf8_lower(some)).to_pylist()[:4] if text is not None}
        if len(words) > 2:
            return None
    for yes, no in _PAIRS:
        if words == {yes, no} or (len(words) == 1 and words <= {yes, no} and (known or words <= set(_LONE))):
            values = _compute.equal(_compute.utf8_lower(texts), yes)
            return values, "" if yes == "true" else f"{yes}/{no}"
    return None


def truths(levels: Sequence[Any], numbers: bool) -> list[Any]:
    """Levels of a flag converted to true and false, or to 1 and 0 if `numbers`; other levels are unchanged."""
    words: dict[Any, bool] = {word: yes for pair in _PAIRS for word, yes in zip(pair, (True, False))} | {1: True, 0: False}
    found = [words.get(level.lower() if isinstance(level, str) else level) for level in levels]
    return [level if yes is None else int(yes) if numbers else yes for level, yes in zip(levels, found)]


def _numbers(texts: Any, dialect: Dialect) -> tuple[Any, list[str], bool] | None:
    """(rows,) numbers, messages, and whether thousands were separated, if all texts are numbers of one form; else None."""
    decimal = re.escape(dialect.decimal or ".")
    bodies = [rf"(?:(?:0|[1-9]\d*)(?:{decimal}\d*)?|{decimal}\d+)"]
    if dialect.thousands:
        bodies.append(rf"(?:\d{{1,3}}|[1-9]\d{{0,2}}(?:{_THOUSANDS[dialect.thousands]}\d{{3}})+)(?:{decimal}\d+)?")
    # A sign is before a number or, in exports of accounting software, after it, and not on both sides.
    forms = [rf"^(?:[+\-−]?{body}(?:[eE][+-]?\d+)?|{body}-)$" for body in bodies]
    for marked, form in enumerate(forms):
        if all_match(texts, form):
            return *_parsed(texts, dialect), bool(marked)
    return None


def _parsed(texts: Any, dialect: Dialect) -> tuple[Any, list[str]]:
    behind = _compute.ends_with(texts, "-")
    plain = _compute.replace_substring(texts, "−", "-")
    if dialect.thousands:
        plain = _compute.replace_substring_regex(plain, _THOUSANDS[dialect.thousands], "")
    plain = _compute.replace_substring(plain, dialect.decimal or ".", ".")
    plain = _compute.utf8_ltrim(plain, "+")
    plain = _compute.if_else(behind, _compute.binary_join_element_wise("-", _compute.utf8_rtrim(plain, "-"), ""), plain)
    told = []
    if _compute.any(behind).as_py():
        example = texts.filter(_compute.fill_null(behind, False))[0].as_py()
        told.append(f"a minus sign behind a number is one before it ({example!r})")
    if _any(plain, "[.eE]"):
        return _compute.cast(plain, pa.float64()), told
    try:
        return _compute.cast(plain, pa.int64()), told
    except pa.ArrowInvalid:  # beyond 64 bits
        large = next(cell for cell in plain.to_pylist() if cell is not None and not -LARGEST <= int(cell) < LARGEST)
        return _compute.cast(plain, pa.float64()), [*told, of_large(large)]


def _any(texts: Any, pattern: str) -> bool:
    return bool(_compute.any(_compute.match_substring_regex(texts, pattern)).as_py())


def _rows(count: int) -> str:
    return f"{count} row{'s' * (count != 1)}"


def _of_texts(called: str, values: Any) -> list[str]:
    """Messages on a column that stays text."""
    gone = _compute.is_in(values, value_set=pa.array((*MISSING[1:], DASH), values.type))
    told = []
    if count := _compute.sum(gone).as_py():
        word = values.filter(gone)[0].as_py()
        told.append(f"{called}: {word!r} is a text like others in {_rows(count)}; empty such cells if they are missing")
    found = likeness(without(values, (*MISSING, DASH)))
    if found.alike and (found.row < 0 or found.numbers):
        where = f"; row {found.row} has {found.odd[:40]!r}" if found.numbers and found.odd != found.first else ""
        told.append(f"{called} is read as texts, though {found.first!r} looks like a number or a date{where}")
    elif found.mistaken or 2 * found.alike >= found.cells > 0:
        told.append(
            f"{called} is read as texts: {found.alike} of {found.cells} cells look like numbers or dates, row {found.row} "
            f"has {found.odd[:40]!r}"
        )
    return told
