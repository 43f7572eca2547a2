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


def test_times_of_day_durations_and_numbers_order_rows_as_texts_too():
    want = [28_800.0, 30_615.5]
    pieces = [datetime.time(8), datetime.time(8, 30, 15, 500_000)]
    for values in (pieces, ["08:00", "8:30:15.5"], ["0 days 08:00:00", "0 days 08:30:15.500000"]):
        assert times(values).tolist() == want
    spans = pd.Series(pd.to_timedelta([-30, 86_401.5], unit="s"))
    for values in (spans.to_numpy(), list(spans), [str(each) for each in spans], spans.astype(str).tolist()):
        assert times(values).tolist() == [-30.0, 86_401.5]
    assert times([1704067200000, 1704067201000.5]).tolist() == [1704067200000, 1704067201000.5]  # as JSON writes dates


def test_missing_times_are_nan():
    for values in (["2024-01-01", None], ["2024-01-01", " "], [5, float("nan")], [pd.Timestamp(0), pd.NaT],
                   np.array(["2024", "NaT"], "datetime64[D]")):  # fmt: skip
        assert np.isnan(times(values)).tolist() == [False, True]
    assert np.isnan(times([5, " ", None], dates=False)).tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("values", "how", "words"),
    [
        (["07/30/2024"], {"order": "day-first"}, "has '07/30/2024' in row 0, a date with the day first or a time is needed"),
        ([{}], {}, "column at has {} in row 0, a date or a time is needed"),
        ([True], {}, "column at has True in row 0, a date or a time is needed"),
        (["2024-02-30"], {}, "column at has '2024-02-30' in row 0, a date or a time is needed"),
        (["1.1.2024 25:00"], {}, "a date with the day first or a time is needed"),
        (["01.01.2024x"], {}, "with the day first or a time is needed"),
        (["x"], {"dates": False}, "column at has 'x' in row 0, a number is needed"),
        (["2024-01-01T00:00+99:99"], {}, "a date or a time is needed"),
        (["0000-01-01"], {}, "a date or a time is needed"),
        (["2024-01-01", None, "08:00"], {}, "column at has '08:00' in row 2, a time, after a date; give all alike"),
        ([1704067200000, "2024-01-01"], {}, "column at has '2024-01-01' in row 1, a date, after a number; give all alike"),
    ],
)
def test_what_is_no_time_is_refused(values, how, words):
    with pytest.raises(RowsError, match=words):
        times(values, **how)
