"""Times of rows: what is later is greater, in whatever form a time comes, and texts of dates are read as logs' are."""

import datetime

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from deadreckon.data.formats.dates import dates_of
from deadreckon.policies.table_rows import RowsError
from deadreckon.policies.table_times import times_of


def times(values, **how):
    values = np.asarray(values, getattr(values, "dtype", object))
    return times_of("at", values, "rows", **{"dates": True} | how)


@pytest.mark.parametrize(
    ("texts", "order"),
    [
        (["30.06.2024", "07.07.2024", "01.01.2025"], None),
        (["05/06/2024", "13/06/2024"], None),
        (["06/05/2024", "06/13/2024"], None),
        (["05/06/2024", "06/06/2024"], "day-first"),
        (["05/06/2024", "06/06/2024"], "month-first"),
        (["05/06/2024", "06/06/2024"], None),
        (["3.4.2024 9:05", "3.4.2024 14:30:10.25"], "day-first"),
        (["4/13/2024 12:10 AM", "4/13/2024 2:30:00 PM"], None),
        (["2024/04/03", "2024-04-03 10:00", "2024-04-03T10:00:00.5"], None),
    ],
)
def test_texts_are_read_as_in_logs(texts, order):
    want = dates_of({"at": pa.chunked_array([texts])}, order, european=False)[0]["at"].to_pylist()
    found = times(texts, order=order)
    assert found.tolist() == [each.replace(tzinfo=datetime.UTC).timestamp() for each in want]
    assert (np.diff(found) > 0).all()


def test_dates_of_all_kinds_are_the_same_moment():
    days = ["2024-05-06", "2024-05-07"]
    want = times(days).tolist()
    for unit in ("D", "s", "ms", "us", "ns"):
        assert times(np.array(days, f"datetime64[{unit}]")).tolist() == want
    stamps = pd.to_datetime(pd.Series(days))
    numpy = list(np.array(days, "datetime64[s]"))
    for values in (list(stamps), [each.date() for each in stamps], ["06.05.2024", "07.05.2024"], numpy):
        assert times(values).tolist() == want
    assert times(["2024-05-06T02:00:00+02:00", "2024-05-07T00:00Z"]).tolist() == want
    assert times([3, "4.5"], dates=False).tolist() == [3.0, 4.5]


@pytest.mark.parametrize(
    ("values", "how", "words"),
    [
        (["07/30/2024"], {"order": "day-first"}, "column at has '07/30/2024' in row 0, a date with the day first is needed"),
        (["2024-01-01", None], {}, "column at is empty in row 1; it orders the rows of an episode"),
        (["2024-01-01", " "], {}, "column at is empty in row 1"),
        ([float("nan")], {"dates": False}, "column at is empty in row 0"),
        ([pd.NaT], {}, "column at is empty in row 0"),
        (np.array(["2024", "NaT"], "datetime64[D]"), {}, "column at is empty in row 1"),
        ([5], {}, "column at has 5 in row 0, a date is needed"),
        ([{}], {}, "column at has {} in row 0, a date is needed"),
        (["2024-02-30"], {}, "column at has '2024-02-30' in row 0, a date is needed"),
        (["1.1.2024 25:00"], {}, "a date with the day first is needed"),
        (["01.01.2024x"], {}, "with the day first is needed"),
        (["x"], {"dates": False}, "column at has 'x' in row 0, a number is needed"),
        (["2024-01-01T00:00+99:99"], {}, "a date is needed"),
        (["0000-01-01"], {}, "a date is needed"),
    ],
)
def test_what_is_no_time_is_refused(values, how, words):
    with pytest.raises(RowsError, match=words):
        times(values, **how)
