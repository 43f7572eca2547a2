"""Tables that try to be misread: each is read right, or what is doubtful is told by the name of the column."""

import datetime as dt
import re
import subprocess
import sys

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet
import pytest

from deadreckon.data import arrow
from deadreckon.data.dataset import Dataset
from deadreckon.data.describe import describe_table
from deadreckon.data.formats.io import read
from deadreckon.data.formats.totals import of_totals
from deadreckon.data.frame import ALONE
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError

N = 120
RNG = np.random.default_rng(0)
X, R = RNG.normal(size=N), RNG.normal(size=N)
STEP = np.tile(np.arange(12), 10)
EPISODE = np.repeat(np.arange(10), 12)
WALK = np.stack([np.arange(N), np.arange(N) * 0.5], 1) + RNG.normal(size=(N, 2))


@pytest.fixture
def rng():
    """Of the test's own: what is drawn above is the same for all of them."""
    return np.random.default_rng(1)


def named(log):
    return log.provenance.extra["observation_names"]


def told(log, words):
    return any(re.search(words, line) for line in log.warnings)


def base(**more):
    return {"x": X, "action": np.arange(N) % 3, "reward": R, **more}


def following(values, fill=np.nan):
    return np.where(STEP[:, None] == 11, fill, np.roll(values, -1, 0))


def walk(names, nexts, fill=0.25):
    after = following(WALK, fill)
    return {"ep": EPISODE, **dict(zip(names, WALK.T)), "action": np.arange(N) % 3, "reward": R, **dict(zip(nexts, after.T))}


@pytest.mark.parametrize(
    ("names", "nexts"),
    [
        (("s0", "s1"), ("next_s0", "next_s1")),
        (("s0", "s1"), ("s0_next", "s1_next")),
        (("obs_0", "obs_1"), ("obs2_0", "obs2_1")),
        (("obs1_0", "obs1_1"), ("obs2_0", "obs2_1")),
        (("obs_0", "obs_1"), ("next_obs_0", "next_obs_1")),
        (("obs_0", "obs_1"), ("new_obs_0", "new_obs_1")),
        (("obs_0", "obs_1"), ("obs_next_0", "obs_next_1")),
        (("s_0", "s_1"), ("sp_0", "sp_1")),
        (("Temp", "Load"), ("NEXT_TEMP", "NEXT_LOAD")),
        (("temp", "load"), ("temp_prime", "load_prime")),
        (("temp_t", "load_t"), ("temp_t1", "load_t1")),
    ],
)
def test_next_observations_are_known_by_their_names(names, nexts):
    log = Dataset.from_frame(walk(names, nexts), episode="ep")
    assert named(log) == list(names)
    assert log.episodes == 10
    np.testing.assert_allclose(log.next_observations, following(WALK, 0.25).astype(np.float32), rtol=1e-6)
    assert log.dropped == 0
    assert told(log, f"columns {nexts[0]}, {nexts[1]} are read as next observations")


def test_next_observations_may_have_any_name_and_are_matched_by_place():
    table = walk(("s0", "s1"), ("u", "v"))
    log = Dataset.from_frame(table, episode="ep", next_observations=["u", "v"])
    assert named(log) == ["s0", "s1"]
    np.testing.assert_allclose(log.next_observations, following(WALK, 0.25).astype(np.float32), rtol=1e-6)
    with pytest.raises(UserError, match="1 next observations, but 3 observations"):
        Dataset.from_frame(table, episode="ep", next_observations=["u"])


def test_next_observations_in_any_order_are_those_of_the_observations_asked_for():
    table = walk(("s0", "s1"), ("u", "v"))
    log = Dataset.from_frame(table, episode="ep", observations=["s1", "s0"], next_observations=["v", "u"])
    assert named(log) == ["s1", "s0"]
    np.testing.assert_allclose(log.next_observations, following(WALK, 0.25)[:, ::-1].astype(np.float32), rtol=1e-6)


def test_what_tells_episodes_and_their_ends_is_read_beside_observations_that_are_named():
    table = {
        "episode": EPISODE,
        "step": STEP[::-1],
        "v": X,
        **base(terminal=STEP == 0, propensity=np.full(N, 0.3), done=STEP == 0),
    }
    log = Dataset.from_frame(table, observations=["v"])
    assert named(log) == ["v"]
    assert log.lengths.tolist() == [12] * 10
    assert log.terminals.sum() == 10
    assert log.observations[0, 0] == np.float32(X[11])  # in the order of their steps
    assert told(log, "column terminal is read as the flag of true ends")
    assert told(log, "column propensity looks like a probability of the logged action")
    assert told(log, "column done marks ends")


def test_what_belongs_to_the_next_row_is_no_observation():
    table = walk(("x",), ("next_x",)) | {"next_action": np.roll(np.arange(N) % 3, -1), "next_reward": np.roll(R, -1)}
    log = Dataset.from_frame(table | {"next_done": np.roll(STEP == 11, -1)}, episode="ep")
    assert named(log) == ["x"]
    np.testing.assert_allclose(log.next_observations, following(WALK, 0.25)[:, :1].astype(np.float32), rtol=1e-6)
    for column, of in (("next_action", "action"), ("next_reward", "reward"), ("next_done", "done")):
        assert told(log, f"column {column} looks like the {of} of the next row and is left out")
    kept = Dataset.from_frame(base(next_action=X), observations=["x", "next_action"])
    assert named(kept) == ["x", "next_action"]


def test_a_time_without_episodes_is_an_observation_that_needs_a_next_one():
    table = base(t=np.arange(N), next_x=np.roll(X, -1))
    log = Dataset.from_frame(table)
    assert named(log) == ["x", "t"]
    assert told(log, "columns next_x look like .* left out, because t has none; with --ignore t they are used")
    assert told(Dataset.from_frame(table, ignore="t"), "are read as next observations")
    dates = [f"2024-04-{1 + i % 28:02d} 10:{i % 60:02d}" for i in range(N)]  # not observed, so that they need no next one
    assert told(Dataset.from_frame(base(time=dates, next_x=np.roll(X, -1))), "are read as next observations")
    # What was asked for is observed whatever its name.
    log = Dataset.from_frame(base(cost=R, next_x=np.roll(X, -1)), observations=["x", "cost"])
    assert told(log, "left out, because cost has none")
    # Two columns of episodes: nobody knows which one it is.
    with pytest.raises(UserError, match="observation ep has no next observation"):
        Dataset.from_frame(base(ep=EPISODE, traj_id=EPISODE, next_x=np.roll(X, -1)))
    assert named(Dataset.from_frame(table, observations=["t", "x"])) == ["t", "x"]
    for more in ({"ep": EPISODE}, {"next_t": np.arange(N) + 1}):  # the order within an episode; an observation with a next one
        log = Dataset.from_frame(table | more)
        assert told(log, "are read as next observations")
    assert log.next_observations[3].tolist() == [np.float32(X[4]), 4.0]


def test_placeholders_among_actions_are_told():
    dose = np.where(np.arange(N) % 20 == 0, -999.0, np.linspace(0, 5, N))
    log = Dataset.from_frame(base(action=dose))
    assert told(log, "column action has -999 in 6 rows, far from its other values, .*; leave such rows out if they mean")
    assert not told(Dataset.from_frame(base(action=np.linspace(0, 5, N))), "leave such rows out")


def test_next_observations_that_are_missing_are_unknown_at_ends_and_refused_inside():
    log = Dataset.from_frame(walk(("s0", "s1"), ("next_s0", "next_s1"), np.nan), episode="ep")
    assert log.dropped == 10
    table = walk(("s0", "s1"), ("next_s0", "next_s1"))
    table["next_s0"][3] = table["next_s1"][3] = np.nan
    with pytest.raises(UserError, match="next observation is missing in step 3, which is not the last of its episode"):
        Dataset.from_frame(table, episode="ep")
    table["next_s1"][3] = 0.0
    with pytest.raises(UserError, match="column next_s0 is empty in row 3, whose other next observations are known"):
        Dataset.from_frame(table, episode="ep")


def test_without_a_column_of_episodes_they_end_where_the_next_row_does_not_continue():
    table = walk(("s0", "s1"), ("next_s0", "next_s1"))
    del table["ep"]
    log = Dataset.from_frame(table)
    assert log.lengths.tolist() == [12] * 10
    assert log.dropped == 0


def test_next_observations_are_encoded_as_the_observations_are():
    kind = np.array(["red", "blue"])[EPISODE % 2]
    table = {"ep": EPISODE, "kind": kind, "next_kind": np.array(["blue", "blue"])[EPISODE % 2], "a": STEP % 2, "r": R}
    log = Dataset.from_frame(table, episode="ep", action="a", reward="r")
    assert named(log) == ["kind=blue", "kind=red"]
    assert (log.next_observations == [1, 0]).all()


def test_one_of_several_actions_cannot_be_discrete():
    for kind in ("integer", "category"):
        with pytest.raises(UserError, match=rf"column b is discrete \({kind}\) and one of several actions"):
            Dataset.from_frame(base(b=np.arange(N) % 2), action=["action", "b"], kinds={"b": kind})


def test_the_first_name_of_the_time_orders_rows(rng):
    order = rng.permutation(N)
    table = {key: np.asarray(value)[order] for key, value in base(ep=EPISODE, step=STEP, timestamp=STEP * 60.0).items()}
    log = Dataset.from_frame(table)
    np.testing.assert_array_equal(log.observations[:, 0], X.astype(np.float32))


def test_some_next_observations_without_the_others_are_left_out():
    table = walk(("s0", "s1"), ("next_s0", "next_s1"))
    del table["next_s1"]
    log = Dataset.from_frame(table, episode="ep")
    assert named(log) == ["s0", "s1"]
    assert told(log, "columns next_s0 look like next observations and are left out, because s1 has none")


CASES = {
    # name: (further columns, options, names of observations or None, action space or None, words that are told or None)
    "whole floats are codes": (
        {"action": np.arange(N) % 3 * 1.0}, {}, ["x"], Discrete(3), "column action holds the whole numbers 0 to 2",
    ),
    "whole floats that are doses": (
        {"action": np.arange(N) % 3 * 1.0}, {"kinds": {"action": "number"}}, ["x"], Box((0.0,), (2.0,)), None,
    ),
    "controls that are -1, 0 and 1": ({"action": np.arange(N) % 3 - 1.0}, {}, ["x"], Box((-1.0,), (1.0,)), None),
    "a dose of many integers": (
        {"action": np.arange(N) * 4}, {}, ["x"], Box((0.0,), (476.0,)), "column action has 120 different .* continuous action",
    ),
    "many items": (
        {"action": np.arange(N) % 40}, {}, ["x"], Discrete(40), "column action has 40 different .* read as 40 discrete actions",
    ),
    "many items by kind": ({"action": np.arange(N)}, {"kinds": ["action=integer"]}, ["x"], Discrete(N), None),
    "an action that never changes": (
        {"action": np.full(N, 0.5)}, {}, ["x"], None, "column action is an action that never changes",
    ),
    "an action of one text": ({"action": ["go"] * N}, {}, ["x"], None, "column action is an action that never changes"),
    "blanks behind a level": (
        {"zone": ["North ", "South", "North"] * (N // 3)}, {}, ["x", "zone=North", "zone=North ", "zone=South"], None,
        "column zone has levels that differ in blanks or capitals alone, such as 'North ' and 'North'",
    ),
    "capitals of a level of the action": (
        {"action": ["Go", "stop", "go"] * (N // 3)}, {}, ["x"], Discrete(3), "column action has levels .*'Go' and 'go'",
    ),
    "comments": (
        {"comment": [f"note {i}" for i in range(N)]}, {}, ["x"], None, "column comment has 120 different texts .* left out",
    ),
    "comments that are wanted": (
        {"note": [f"{i % 60}!" for i in range(N)]}, {"kinds": {"note": "category"}}, None, None, None,
    ),
    "words that are asked for as flags": (
        {"on": ["yes", "no", "no"] * (N // 3)}, {"kinds": {"on": "flag"}}, ["x", "on"], None, None,
    ),
    "flags": ({"on": np.arange(N) % 2 == 0}, {}, ["x", "on"], None, None),
    "numbers as texts": (
        {"y": [str(i / 2) for i in range(N)]}, {}, ["x", "y"], None, "column y holds numbers as texts, and is read as numbers",
    ),
    "codes": ({"zone": np.arange(N) % 4}, {}, ["x", "zone"], None, "column zone holds whole numbers that may be codes"),
    "codes with gaps": (
        {"zone": [None, *(float(i % 3) for i in range(N - 1))]}, {}, ["x", "zone", "zone_missing"], None,
        "column zone holds whole numbers that may be codes",
    ),
    "codes as levels": (
        {"zone": np.arange(N) % 3}, {"kinds": {"zone": "category"}}, ["x", "zone=0", "zone=1", "zone=2"], None, None,
    ),
    "done": ({"done": np.arange(N) % 12 == 11}, {}, ["x"], None, "column done marks ends of episodes and is left out"),
    "terminated": (
        {"terminated": np.arange(N) % 12 == 11}, {}, ["x"], None, "column terminated is read as the flag of true ends",
    ),
    "truncated": (
        {"Truncated": (np.arange(N) % 12 == 11) * 1}, {}, ["x"], None, "column Truncated is read as the flag of ends of rec",
    ),
    "episode": ({"episode_id": EPISODE}, {}, ["x"], None, "column episode_id is read as the name of the episode"),
    "episode in every row": ({"traj_id": np.arange(N)}, {}, ["x"], None, "column traj_id differs in every row and is left out"),
    "time within episodes": ({"ep": EPISODE, "t": STEP}, {}, ["x"], None, "column t is read as the time within an episode"),
    "time alone": ({"t": np.arange(N)}, {}, ["x", "t"], None, "column t looks like a time and is read as an observation"),
    "dates": ({"day": [dt.date(2026, 1, 1)] * N}, {}, ["x"], None, r"left out of the observations: day \(--time day\)"),
    "dates as texts": (
        {"day": ["2026-01-02T03:04:05Z"] * N}, {}, ["x"], None, "column day holds dates and is left out",
    ),
    "propensity": ({"pscore": np.full(N, 0.5)}, {}, ["x"], None, "column pscore looks like a probability of the logged action"),
    "cost": ({"cost": np.abs(X)}, {}, ["x"], None, "column cost looks like a cost"),
    "empty": ({"y": [None] * N}, {}, ["x"], None, "column y is empty and is left out"),
    "identity": ({"user_id": EPISODE}, {}, ["x", "user_id"], None, "column user_id looks like a name"),
    "row numbers": ({"Unnamed: 0": np.arange(N)}, {}, ["x"], None, "column 'Unnamed: 0' looks like a row number"),
    "several actions of whole numbers": (
        {"b": np.arange(N) % 2}, {"action": ["action", "b"]}, ["x"], Box((0.0, 0.0), (2.0, 1.0)),
        "column b holds whole numbers and is one of several actions",
    ),
    "two names of the episode": (
        {"episode": EPISODE, "traj_id": EPISODE}, {}, ["x"], None, "column traj_id is named like the episode, as episode is",
    ),
    "two names of the episode, neither of them its own": (
        {"ep": EPISODE, "traj_id": EPISODE}, {}, None, None, "columns ep, traj_id are all named like the episode: --epis",
    ),
    "two flags of true ends": (
        {"terminal": STEP == 11, "terminated": STEP == 11}, {}, ["x"], None, "column terminated is named like the terminal",
    ),
    "two times": (
        {"ep": EPISODE, "step": STEP, "timestamp": STEP * 60.0}, {}, ["x"], None, "column step is read as the time within",
    ),
    "two names of the action": ({"a": np.arange(N) % 5}, {}, ["x"], Discrete(3), "column a is named like the action, as"),
    "two names of the reward": ({"r": R * 2}, {}, ["x"], None, "column r is named like the reward, as reward is, and is left"),
    "flags as texts": (
        {"terminated": ["yes", "no"] * 60}, {}, ["x"], None, "column terminated is named like a flag of true ends of epi",
    ),
    "flags with empty cells": (
        {"terminated": [1, None] * 60}, {}, ["x"], None, "column terminated is named like a flag of true ends of epi",
    ),
    "rows that are episodes": ({}, {}, ["x"], None, "each row is read as an episode of one step"),
    "starts of episodes": (
        {"is_first": STEP == 0}, {}, ["x"], None, "column is_first marks starts of episodes and is left out: --episode",
    ),
    "numbers of customers": (
        {"customer_no": EPISODE + 7}, {}, ["x", "customer_no"], None, "column customer_no looks like a name",
    ),
    "an empty text as a level": (
        {"zone": ["a", "", "b"] * (N // 3)}, {}, ["x", "zone=", "zone=a", "zone=b"], None,
        "column zone has the empty text '' as a level",
    ),
    "an empty text as an action": (
        {"action": ["go", " "] * (N // 2)}, {}, ["x"], Discrete(2), "column action has the empty text ' ' as a level",
    ),
    "a placeholder": (
        {"y": np.where(STEP == 3, -999.0, X)}, {}, ["x", "y"], None, "column y has -999 in 10 rows, far from its other values",
    ),
    "a placeholder of counts": (
        {"y": [9999, None, 9999, *range(N - 3)]}, {}, None, None, "column y has 9999 in 2 rows, far from .*, 0 .. 116",
    ),
    "dates as integers": (
        {"date": 20_240_101 + STEP}, {}, ["x", "date"], None,
        "column date holds whole numbers beyond 16,777,216, of which 5 become equal to others in float32",
    ),
    "large integers that float32 tells apart": ({"y": 2**25 + STEP * 1024}, {}, ["x", "y"], None, None),
    "a placeholder that is a number": (
        {"y": np.where(STEP == 3, -999.0, X)}, {"kinds": {"y": "number"}}, ["x", "y"], None, None,
    ),
    "values that are no placeholders": ({"y": np.arange(N) % 60 * 20 - 999}, {}, ["x", "y"], None, None),
    "missing cells": (
        {"y": [None, None, *range(N - 2)], "z": [None, *range(N - 1)]}, {}, ["x", "y", "y_missing", "z", "z_missing"], None,
        "3 missing values in 2 of 120 rows .* y 2, z 1",
    ),
}  # fmt: skip


def without_reasons(extra):
    """Why columns were left out is known to the one who decided it, not to a schema."""
    held = {name: {key: value for key, value in told.items() if key != "reason"} for name, told in extra["held"].items()}
    return {**extra, "held": held}


@pytest.mark.parametrize("name", CASES)
def test_read_right_or_told(name):
    more, options, names, space, words = CASES[name]
    log = Dataset.from_frame(base(**more), **options)
    assert names is None or named(log) == names
    assert space is None or log.action_space == space
    if words is None:
        assert [line for line in log.warnings if "is read as the" not in line and line != ALONE] == []
    else:
        assert told(log, words), log.warnings
    # What was decided is in the schema, by which the same table is read alike, with nothing more to decide.
    again = Dataset.from_frame(base(**more), schema=log.provenance.extra["schema"])
    assert again.fingerprint == log.fingerprint
    assert without_reasons(again.provenance.extra) == without_reasons(log.provenance.extra)


def test_a_renamed_level_of_the_action_is_refused_and_one_of_an_observation_is_told():
    table = {"kind": ["a", "b"] * 3, "x": range(6), "arm": ["go", "stop"] * 3, "r": range(6)}
    schema = Dataset.from_frame(table, action="arm", reward="r").provenance.extra["schema"]
    renamed = Dataset.from_frame(table | {"kind": ["a", "c"] * 3}, schema=schema)
    assert told(renamed, "column kind has values that are none of its levels: 'c'; they become no level")
    assert renamed.observations[1].tolist() == [0, 0, 1]
    with pytest.raises(UserError, match="column arm has values that are none of its levels: 'Go'; rename them"):
        Dataset.from_frame(table | {"arm": ["Go", "stop"] * 3}, schema=schema)
    fewer = Dataset.from_frame({key: list(value)[:1] for key, value in table.items()}, schema=schema)
    assert fewer.observations.shape == (1, 3)
    assert fewer.action_space == Discrete(2)


def test_dates_as_texts_order_rows_from_pandas_too():
    table = pd.DataFrame({"when": ["2026-01-03", "2026-01-01", "2026-01-02"], "x": [3, 1, 2], "a": [0, 1, 0], "r": [0, 0, 1]})
    log = Dataset.from_frame(table, time="when", action="a", reward="r")
    assert log.observations[:, 0].tolist() == [1, 2, 3]


DAYS = [dt.date(2024, 1, 28) + dt.timedelta(days=int(i)) for i in range(N)]
ASK = {"%d.%m.%Y": "month-first", "%d/%m/%Y": "month-first", "%m/%d/%Y": "day-first", "%d.%m.%Y %H:%M": "month-first"}


@pytest.mark.parametrize("made", [pd.DataFrame, pa.table, dict, lambda t: pd.DataFrame(t).astype({"day": "category"})])
@pytest.mark.parametrize("form", ASK)
def test_texts_of_dates_in_frames_are_read_as_in_text_files(form, made, rng):
    order = rng.permutation(N)
    texts = [DAYS[i].strftime(form) for i in order]
    table = made({"day": texts, "x": np.arange(N)[order] * 1.0, "action": order % 3, "reward": R[order]})
    log = Dataset.from_frame(table, time="day")
    np.testing.assert_array_equal(log.observations[:, 0], np.arange(N))
    assert told(log, rf"dates such as '{re.escape(texts[0])}' are read as .* \(--dates {ASK[form]}\): column day")
    left = Dataset.from_frame(table)
    assert named(left) == ["x"]
    assert told(left, r"timestamps are left out of the observations: day \(--time day\)")
    again = Dataset.from_frame(table, schema=log.provenance.extra["schema"])
    assert again.fingerprint == log.fingerprint


def test_episodes_of_dates_in_frames_are_in_the_order_of_their_dates():
    days = [DAYS[i].strftime("%d.%m.%Y") for i in EPISODE]
    table = pd.DataFrame({"day": days, "t": STEP, "x": np.arange(N), "action": np.arange(N) % 3, "reward": R})
    log = Dataset.from_frame(table, episode="day", time="t")
    np.testing.assert_array_equal(log.observations[:, 0], np.arange(N))
    short = table.assign(day=[day[:6] + day[8:] for day in days])  # years of two digits
    log = Dataset.from_frame(short, episode="day", time="t")
    assert told(log, "most episodes begin at the same t and are put in the order of day, which is not the table's")
    with pytest.raises(UserError, match="column day orders rows, and holds neither numbers nor dates .*; row 0 has '28.01.24'"):
        Dataset.from_frame(short, time="day")


def test_episodes_that_begin_at_the_same_time_are_in_the_order_of_the_numbers_in_their_names():
    table = {"run": [f"run_{i + 5}" for i in EPISODE], "t": STEP, "x": np.arange(N), "action": np.arange(N) % 3, "reward": R}
    log = Dataset.from_frame(table, episode="run", time="t")
    np.testing.assert_array_equal(log.observations[:, 0], np.arange(N))  # run_5 ... run_14: the latest are the last
    assert not told(log, "begin at the same t")
    ids = np.array(["c9", "a3", "b1", "f0", "e7", "d2", "h5", "g4", "j8", "i6"])[EPISODE]
    named_otherwise = Dataset.from_frame({**table, "run": ids}, episode="run", time="t")
    assert told(named_otherwise, "most episodes begin at the same t and are put in the order of run, which is not the table's")
    rising = np.arange(N)
    assert not told(Dataset.from_frame({**table, "run": ids, "t": rising}, episode="run", time="t"), "begin at the same")


def test_times_of_day_that_shuffle_a_table_without_episodes_are_told():
    clock = [dt.time(6 + i % 12, i % 60) for i in range(N)]
    log = Dataset.from_frame(base(time=pa.array(clock)), time="time")
    assert told(log, "rows are put in another order than the table's by time, which has times of day without a date")
    day = [dt.time(i // 60, i % 60) for i in range(N)]
    assert not told(Dataset.from_frame(base(time=pa.array(day)), time="time"), "another order")


def test_episodes_that_each_robot_counts_for_itself_are_told():
    robot, number = np.repeat(["a", "b", "c"], 40), np.tile(np.repeat(np.arange(10), 4), 3)
    table = base(robot=robot, episode=number, timestamp=np.arange(N))
    log = Dataset.from_frame(table, keep="robot")
    words = "30 pieces of rows have one value of episode and one of robot each, and are read as 10 episodes"
    assert log.episodes == 10
    assert told(log, words)
    apart = base(robot=robot, episode=number + 10 * (np.arange(N) // 40), timestamp=np.arange(N))
    assert not told(Dataset.from_frame(apart, keep="robot"), "pieces of rows")
    shuffled = np.random.default_rng(0).permutation(N)
    mixed = {key: np.asarray(values)[shuffled] for key, values in apart.items()}
    assert not told(Dataset.from_frame(mixed, keep="robot"), "pieces of rows")


def test_an_open_order_of_dates_in_frames_and_parquet_is_told_and_can_be_chosen(tmp_path):
    days = [f"{1 + i % 12:02d}/{1 + i // 12:02d}/2024" for i in range(N)]
    table = pa.table({"day": days, "x": np.arange(N) * 1.0, "action": np.arange(N) % 3, "reward": R})
    path = tmp_path / "log.parquet"
    pa.parquet.write_table(table, path)
    by_month = np.lexsort((np.arange(N) // 12, np.arange(N) % 12))
    for source in (lambda **more: Dataset.from_frame(table, **more), lambda **more: read(path, **more)):
        open_one = source(time="day")
        np.testing.assert_array_equal(open_one.observations[:, 0], by_month)
        assert told(open_one, r"month/day/year, and no cell shows whether that is right \(--dates day-first\): column day")
        np.testing.assert_array_equal(source(time="day", dates="day-first").observations[:, 0], np.arange(N))
        with pytest.raises(UserError, match="column day orders rows, and holds neither numbers nor dates"):
            source(time="day", dates="iso")


@pytest.mark.parametrize("last", ["04998", " 04998", "4998"])
def test_zeros_in_front_are_told_where_they_stand_behind_the_head(tmp_path, last):
    rows = 3_000
    cells = [f"{50_000 + i % 9},{i % 7},{i % 3},1" for i in range(rows)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["code,x,action,reward", *cells, f"{last},0,1,2"]))
    assert told(read(path), "column code: '04998' is read as the number 4998 \\(row 3000\\)") == ("0" in last)
    assert not told(read(path), "column x:")


@pytest.mark.parametrize("last", [2**63 + 1, 2**63 - 1])
def test_integers_beyond_all_integers_are_told_where_they_stand_behind_the_head(tmp_path, last):
    cells = [f"{2**53 + 1 + i},{i % 7},{i % 3},1" for i in range(3_000)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["code,x,action,reward", *cells, f"{last},0,1,2"]))
    words = f"column code: '{last}' is rounded, as no integer is so large; put a letter before"
    if last < 2**63:
        log = read(path, episode="code")
        assert not told(log, words)
        assert log.episodes == 3_001
    else:
        assert told(read(path), words)
        with pytest.raises(UserError, match="column code identifies episodes, .* rounded"):
            read(path, episode="code")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[1, 0, 2], [2, 1, 3]]", "a list of lists in JSON has no names of columns"),
        ("x,action,reward\n12:30,0,2\n13:45,1,3\n", r"no column is left .* \(timestamps are left out .*: x \(--time x\)\)"),
    ],
)
def test_files_that_hold_no_log_say_what_they_hold(tmp_path, text, words):
    path = tmp_path / "rows"
    path.write_text(text)
    with pytest.raises(UserError, match=words):
        read(path)


def test_arrays_of_other_shapes_are_told_by_their_names():
    end = STEP == 11
    buffer = {"observations": WALK, "actions": WALK, "dones": end[:, None], "timeouts": end[:, None]}
    with pytest.raises(UserError, match=r"column observations has shape \(120, 2\), rewards have \(120, 1\); both are"):
        Dataset.from_dict({**buffer, "rewards": R[:, None]})
    ragged = {"obs": [[1, 2], [3]], "act": [[1], [2]], "rew": [1.0, 2.0], "terminated": [0, 1], "truncated": [0, 0]}
    with pytest.raises(UserError, match="column obs is no array of numbers in which every row has the same shape"):
        Dataset.from_dict(ragged)
    texts = {"obs": [[1], [3]], "act": [[1], [2]], "rew": ["a", "b"], "terminated": [0, 1], "truncated": [0, 0]}
    with pytest.raises(UserError, match="column rew is no array of numbers in which every row has the same shape"):
        Dataset.from_dict(texts)
    two = {key: np.stack([column, column], 1) for key, column in {**buffer, "rewards": R, "dones": end}.items()}
    with pytest.raises(UserError, match=r"column timeouts has shape \(120,\), rewards have \(120, 2\); both are"):
        Dataset.from_dict({**two, "timeouts": end})
    with pytest.raises(UserError, match=r"not a table of plain columns \(Could not convert 'a' .* column y with type object\)"):
        Dataset.from_frame(pd.DataFrame(base(y=pd.Series([1, "a"] * (N // 2), dtype=object))))


def test_dates_that_only_fall_within_episodes_are_told(rng):
    def of(days, **more):
        return Dataset.from_frame(base(ep=EPISODE, day=pa.array(days, pa.date32())), **more)

    falling = [dt.date(2024, 3, 1) + dt.timedelta(days=int(i)) for i in EPISODE * 30 - STEP]
    assert told(of(falling), r"column day falls in 110 of 110 steps within episodes and never rises: .* \(--time day\)")
    assert not told(of(falling, time="day"), "never rises")
    assert not told(of(DAYS), "never rises")
    for _ in range(50):
        assert not told(of([DAYS[i] for i in rng.permutation(N)]), "never rises")


def by_schema(table, **columns):
    given = {"x": {"role": "observation"}, "action": {"role": "action", "kind": "integer"}, "reward": {"role": "reward"}}
    return Dataset.from_frame(table, schema={"columns": given | columns})


@pytest.mark.parametrize(
    ("column", "words"),
    [
        ({"action": {"role": "action", "kind": "integer", "levels": [0, 1, 1.0, 2]}}, "a level is listed twice: 0, 1, 1.0, 2"),
        ({"action": {"role": "action", "kind": "flag", "levels": [True, "true"]}}, "a level is listed twice"),
        ({"action": {"role": "action", "kind": "number", "levels": [2, 1, 0]}}, r"levels go with a discrete action \(kind int"),
        ({"action": {"role": "action", "kind": "number", "low": -5}}, "a continuous action needs both of low and high"),
        ({"x": {"role": "observation", "kind": "integer", "levels": [0, 1]}}, "levels go with kind category, not with kind"),
    ],
)
def test_levels_and_bounds_that_would_be_read_otherwise_are_refused(column, words):
    with pytest.raises(UserError, match=words):
        by_schema(base(), **column)


def test_bounds_of_some_actions_alone_are_refused():
    bounded = {"role": "action", "kind": "number", "low": -5, "high": 5}
    with pytest.raises(UserError, match="bounds of some actions, not of b; give low and high of all, or none"):
        by_schema(base(b=R), action=bounded, b={"role": "action"})
    assert by_schema(base(b=R), action=bounded, b=bounded).action_space == Box((-5.0, -5.0), (5.0, 5.0))


def test_what_lies_outside_of_what_the_schema_says_is_told():
    ranged = {"action": {"role": "action", "kind": "integer", "low": 0, "high": 1}, "reward": {"role": "reward", "low": R[1]}}
    log = by_schema(base(reward=[R[1] - 2.5, *R[1:]]), x={"role": "observation", "kind": "integer"}, **ranged)
    assert told(log, "column action is outside 0 .. 1 in 40 rows, first 2 in row 2")
    assert told(log, rf"column reward is outside {R[1]:g} .. inf in .* rows, first {R[1] - 2.5:g} in row 0")
    assert told(log, rf"column x is of kind integer and has {X[0]:g} in row 0, which is not rounded")
    assert not told(by_schema(base(x=[None, *range(N - 1)]), x={"role": "observation", "kind": "integer"}), "which is not")


def test_groups_are_kept_and_held_out_together():
    from deadreckon.runs.holdout import divided

    users = np.repeat(np.arange(20), 6)
    log = Dataset.from_frame(base(user=users), group="user")
    assert named(log) == ["x"]
    parts = divided(log, None, None, None)
    assert parts.told["by"] == "user"
    assert not set(parts.learning.extras["user"]) & (set(users) - set(parts.learning.extras["user"]))
    held = np.isin(log.episode_ids, parts.held)
    assert not set(log.extras["user"][held]) & set(parts.learning.extras["user"])
    assert divided(log, 0.5, None, None).told["by"] == "user"


def written(tmp_path, **columns):
    path = tmp_path / "log.csv"
    pd.DataFrame(base(**columns)).to_csv(path, index=False)
    return path


def test_a_reward_of_percentages_says_what_to_do():
    table = {"x": np.arange(30.0), "action": np.arange(30) % 2, "reward": [f"{i}%" for i in range(30)]}
    with pytest.raises(UserError, match="column reward holds texts, numbers are needed; row 0 has '0%'; write all cells as"):
        Dataset.from_frame(table, action="action", reward="reward")


@pytest.mark.parametrize(
    ("cells", "odd"),
    [
        ([*map(str, range(N - 1)), "1,5"], "'1,5' in row 119, beside '0'"),
        ([f"({i})" for i in range(N)], r"'\(0\)' in row 0;"),
        ([f"{i}.5M" for i in range(N)], "'0.5M' in row 0;"),
        ([f"{i}k" for i in range(N)], "'0k' in row 0;"),
        ([f"{i}.5 %" for i in range(N)], r"'0.5 %' in row 0; write its cells as plain numbers without %, .* \(--ignore y\)"),
        ([f"€{i}" for i in range(N)], "'€0' in row 0; write its cells as plain numbers without €,"),
        ([f"1,{i}00,5" for i in range(N)], None),
        ([f"10.{i}.0.1" for i in range(N)], None),
    ],
)
def test_texts_that_look_like_numbers_are_no_levels(tmp_path, cells, odd):
    path = written(tmp_path, y=cells)
    if odd is None:  # lists and addresses, which are no numbers
        assert told(read(path), "column y has 120 different texts")
        return
    for source in (lambda: read(path), lambda: Dataset.from_frame(base(y=cells))):
        with pytest.raises(UserError, match=f"column y holds texts that look like numbers and cannot be read as such: {odd}"):
            source()


def test_few_texts_that_look_like_numbers_are_told_with_the_odd_one(tmp_path):
    log = read(written(tmp_path, y=["1,5", *map(str, np.arange(N - 1) % 7)]))
    assert told(log, "column y is read as texts, though '1,5' looks like a number or a date")
    log = read(written(tmp_path, y=[*map(str, np.arange(N - 1) % 7), "1,5"]))
    assert told(log, "column y is read as texts, though '0' looks like a number or a date; row 119 has '1,5'")


def test_columns_of_unusual_types_are_read_or_refused_in_one_line():
    from decimal import Decimal

    table = base(half=np.float16(X), action=pa.array([Decimal(i % 3) for i in range(N)], pa.decimal128(18, 3)))
    log = Dataset.from_frame({**table, "episode": pa.array([Decimal(10**20 + int(i)) for i in EPISODE], pa.decimal128(38, 0))})
    assert (log.action_space, log.episodes, named(log)) == (Discrete(3), 10, ["x", "half"])
    assert Dataset.from_frame(base(y=[" 199", "1.5"] * 60)).observations[:2, 1].tolist() == [199, 1.5]
    assert named(Dataset.from_frame(base(y=["1_000", "2"] * 60))) == ["x", "y=1_000", "y=2"]
    with pytest.raises(UserError, match="column action holds list<.*>, an action is one plain value in each row"):
        Dataset.from_frame(base(action=[[i % 2] for i in range(N)]))
    with pytest.raises(UserError, match="column age holds pandas.interval, numbers, texts, dates or truth values are needed"):
        Dataset.from_frame(pd.DataFrame(base(age=pd.cut(np.arange(N), 4))))
    with pytest.raises(UserError, match="column half has .* in row 3"):
        Dataset.from_frame(pd.DataFrame(base(reward=X, half=np.where(np.arange(N) == 3, np.inf, X).astype("f2"))))


def test_what_replaces_missing_values_is_told_as_it_is():
    schema = {"columns": {"x": {"role": "observation", "fill": 0}, "action": {"role": "action", "kind": "integer"},
                          "reward": {"role": "reward"}}}  # fmt: skip
    log = Dataset.from_frame(base(x=[None, *X[1:]]), schema=schema)
    assert log.observations[0].tolist() == [0, 1]
    assert told(log, r"1 missing values in 1 of 120 rows are replaced by the column's fill \(the mean by default\)")


def test_rows_of_an_episode_that_are_not_together_are_told(rng):
    """With the column that counts their steps, where there is one; rows that are together are taken as they stand."""
    step, episode = np.arange(N) % 12, np.arange(N) // 12
    shuffled = rng.permutation(N)
    for order, words in ((shuffled, "column minute counts their steps in another order: --time minute"),
                         (np.argsort(step, kind="stable"), "they are taken in the table's order")):  # fmt: skip
        log = Dataset.from_frame(base(minute=step[order], machine=episode[order]), episode="machine")
        assert told(log, f"rows of an episode are not together \\(10 episodes in \\d+ pieces\\).*{words}")
        assert not told(
            Dataset.from_frame(base(minute=step[order], machine=episode[order]), episode="machine", time="minute"), "together"
        )
    assert not told(Dataset.from_frame(base(minute=step, machine=episode), episode="machine"), "together")


def test_times_of_day_that_pass_midnight_are_told(tmp_path):
    path, words = tmp_path / "log.csv", "10 of 10 episodes are put in another order than the table's by clock"
    table = pd.DataFrame(base(clock=[f"{(22 + i % 6) % 24:02}:00" for i in range(N)], night=np.arange(N) // 12))
    table[table.index % 12 < 6].to_csv(path, index=False)
    assert told(read(path, episode="night", time="clock"), words)
    table["clock"] = [f"{i % 6:02}:00" for i in range(N)]
    table[table.index % 12 < 6].to_csv(path, index=False)
    assert not told(read(path, episode="night", time="clock"), "another order")


def test_columns_that_count_rows_are_told(rng):
    log = Dataset.from_frame(base(order=70_001 + rng.permutation(N)))
    assert told(log, "column order has whole numbers without gaps, each once")
    assert not told(Dataset.from_frame(base(order=rng.permutation(N) * 2)), "column order has")


def test_subtotals_among_levels_are_told():
    log = Dataset.from_frame(base(action=["a Total" if i % 30 == 0 else "ab"[i % 2] for i in range(N)]))
    assert told(log, "column action has 'a Total' beside 'a', as subtotals are called")
    assert not told(Dataset.from_frame(base(action=["Total" if i % 2 else "a" for i in range(N)])), "subtotals")


def test_placeholders_among_rewards_are_told():
    log = Dataset.from_frame(base(reward=[-999.0 if i % 20 == 0 else i / N for i in range(N)]))
    assert told(log, "column reward has -999 in 6 rows")


@pytest.mark.parametrize("word", ["Total", "total:", "AVERAGE", "Summe", "Gesamtsumme", "Mittelwert", "Grand Total"])
def test_a_last_row_that_calls_itself_a_total_is_told(tmp_path, word):
    path = tmp_path / "log.csv"
    path.write_text("site,x,action,reward\n" + "a,1,0,1\nb,2,1,0\n" * 3 + f"{word},9,0,3\n")
    assert told(read(path), f"the last row, 6, looks like a total \\(column site has '{word}'\\)")
    path.write_text("site,x,action,reward\n" + f"{word},1,0,1\nb,2,1,0\n" * 3 + f"{word},9,0,3\n")
    assert not told(read(path), "looks like a total")


@pytest.mark.parametrize("function", [np.sum, np.mean])
def test_a_last_row_of_sums_or_means_is_told(tmp_path, function, rng):
    path = tmp_path / "log.csv"
    table = pd.DataFrame({"x": X, "y": rng.integers(0, 9, N) + 0.25, "action": np.arange(N) % 3, "reward": R})
    total = table[["x", "y", "reward"]].apply(function).to_frame().T.assign(action=0)
    pd.concat([table, total]).to_csv(path, index=False)
    assert told(read(path), r"the last row, 120, looks like a total \(columns x, y, reward have the sums or the means")
    pd.concat([table, total.assign(x=0, y=0)]).to_csv(path, index=False)
    assert not told(read(path), "looks like a total")


@pytest.mark.slow
def test_no_last_row_of_noise_is_taken_for_a_total():
    once, flag = np.zeros((2, 20), int)
    once[[3, 19]] = flag[[7, 19]] = 1  # each sums up to its last cell
    assert of_totals(pa.table({"reward": once, "terminal": flag})) == []
    rng = np.random.default_rng(3)
    for _ in range(2_000):
        rows = int(rng.integers(2, 60))
        few, flags, counts = rng.integers(-1, 2, (2, rows)), rng.random((2, rows)) < 1 / rows, rng.integers(0, 4, (2, rows))
        columns = {f"{i}": column for i, column in enumerate([*few, *flags.astype(int), *counts, *rng.normal(size=(2, rows))])}
        assert of_totals(pa.table(columns)) == []


def test_a_new_customer_is_no_customer_of_the_next_row():
    flag = np.arange(N) % 4 == 0
    table = base(customer=EPISODE, new_customer=flag, amazon=X, amazon_prime=flag)
    log = Dataset.from_frame(table, group="customer", ignore="amazon")
    assert named(log) == ["x", "new_customer", "amazon_prime"]


def test_times_that_are_observed_have_next_ones():
    table = {"t": STEP, "x": X, "action": np.arange(N) % 3, "reward": R, "next_t": STEP + 1, "next_x": np.roll(X, -1)}
    log = Dataset.from_frame(table | {"terminal": STEP == 11})
    assert named(log) == ["t", "x"]
    np.testing.assert_array_equal(log.next_observations[:, 0], STEP + 1)


def test_single_decisions_that_are_not_in_the_order_of_their_dates(rng):
    days = np.datetime64("2024-01-01") + np.arange(60) // 3
    born = np.datetime64("1980-01-01") + rng.integers(0, 9_000, 60)

    def lines(**dates):
        frame = {"x": rng.normal(size=60), "action": rng.integers(0, 2, 60), "reward": np.ones(60)} | dates
        log = Dataset.from_frame(frame, action="action", reward="reward", ignore=list(dates))
        return [line for line in log.warnings if "not in the order of" in line]

    for named in (days[::-1], rng.permutation(days), days[::-1].astype(str)):
        (line,) = lines(day=named)
        assert re.match(r"rows are not in the order of day, which falls in \d+ of 59 steps: .* the oldest row first", line)
    assert not lines(day=days)
    assert not lines(born=born, day=days)  # one column of dates is in order
    assert not lines(day=np.full(60, days[0]))


def test_rows_in_the_order_of_time_over_all_customers_are_no_pieces():
    table = base(customer=np.tile(np.arange(12), 10), visit_no=np.repeat(np.arange(10), 12), date=np.arange(N))
    log = Dataset.from_frame(table, episode="customer", time="date")
    assert log.episodes == 12
    assert not told(log, "pieces of rows")


def test_next_times_and_ends_in_other_spellings_are_of_the_next_row():
    table = {"episode": EPISODE, "t": STEP, "x": X, "action": np.arange(N) % 3, "reward": R, "cost": R, "done": STEP == 11}
    nexts = {"next_t": STEP + 1, "next_x": np.roll(X, -1), "next_cost": R, "done_next": STEP == 10, "reward_next": R}
    log = Dataset.from_frame(table | nexts)
    assert named(log) == ["x"]
    np.testing.assert_array_equal(log.next_observations[:, 0], np.roll(X, -1).astype(np.float32))


def test_times_in_nanoseconds_need_no_package(tmp_path):
    """As robots' logs have them; Python's own times have microseconds, and Arrow asks for pandas."""
    lines = [f"2024-01-01T10:00:{i:02d}.123456789,{i % 5},{i % 2},{i % 3}" for i in range(N // 2)]
    (tmp_path / "log.csv").write_text("\n".join(["stamp,x,action,reward", *lines]) + "\n")
    code = (
        "import sys; sys.modules['pandas'] = None\n"
        "import deadreckon as dr\n"
        "from deadreckon.cli.main import main\n"
        "print(len(dr.read('log.csv', time='stamp')))\n"
        "sys.exit(main(['data', 'describe', 'log.csv']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{N // 2}\n")
    assert "2024-01-01 10:00:00.123456789 .. 2024-01-01 10:00:59.123456789" in done.stdout
    texts = [line.partition(",")[0] for line in lines]
    frame = {"stamp": texts[::-1], "x": X[: N // 2], "action": [0, 1] * (N // 4), "reward": R[: N // 2]}
    log = Dataset.from_frame(frame, time="stamp")
    np.testing.assert_allclose(log.rewards, R[: N // 2][::-1], rtol=1e-6)


def test_durations_are_described(tmp_path):
    table = pa.table({"stay": pa.array(range(N), pa.duration("s")), "x": X, "action": [0, 1] * (N // 2), "reward": R})
    pa.parquet.write_table(table, tmp_path / "log.parquet")
    (line,) = [line for line in str(describe_table(tmp_path / "log.parquet")).splitlines() if "stay" in line and ".." in line]
    assert "0:00:00 .. 0:01:59" in line
    table = table.set_column(0, "stay", table["stay"].cast(pa.duration("ns")))
    pa.parquet.write_table(table, tmp_path / "fine.parquet")
    assert "0:00:00 .. 0:01:59" in str(describe_table(tmp_path / "fine.parquet"))


def test_texts_of_more_bytes_than_offsets_reach_are_one_column(monkeypatch):
    monkeypatch.setattr(arrow, "OFFSETS", 100)
    table = pa.table({"id": pa.chunked_array([[f"{i:036d}" for i in range(5)]] * 2, pa.string()), "few": ["a"] * 10})
    assert arrow.flat(table, "id").type == pa.large_string()
    assert arrow.flat(table, "id").to_pylist() == table["id"].to_pylist()
    assert arrow.flat(table, "few").type == pa.string()


def test_categories_that_are_numbers_may_be_times_numbers_and_rewards():
    day = pd.Categorical(EPISODE * 2)
    frame = pd.DataFrame({"day": day, "x": X, "action": [0, 1] * (N // 2), "reward": pd.Categorical(np.arange(N) % 3)})
    plain = frame.assign(day=EPISODE * 2, reward=np.arange(N) % 3)
    for options in ({"kinds": {"day": "number"}}, {"time": "day"}):
        log, same = (Dataset.from_frame(each, **options) for each in (frame, plain))
        np.testing.assert_array_equal(log.observations, same.observations)
        np.testing.assert_array_equal(log.rewards, same.rewards)
    assert "day=4" in named(Dataset.from_frame(frame))  # as they are given


def test_categories_of_codes_may_be_missing_and_have_64_bits():
    codes = {"zone": np.array([1.0, 2.0, np.nan] * 40), "action": [0, 1] * (N // 2), "reward": R}
    log = Dataset.from_frame(codes, kinds={"zone": "category"})
    assert named(log) == ["zone=1", "zone=2", "zone_missing"]
    np.testing.assert_array_equal(log.observations[:3], np.eye(3))
    hashed = codes | {"zone": np.array([2**63, 2**64 - 1] * (N // 2), np.uint64)}
    words = r"column zone holds 18446744073709551615, a category needs whole numbers below 2 \*\* 63, or texts"
    with pytest.raises(UserError, match=words):
        Dataset.from_frame(hashed, kinds={"zone": "category"})


def test_what_is_ignored_may_be_of_any_type(tmp_path):
    number = pa.array([bytes([i] * 16) for i in range(12)], pa.binary(16))
    table = pa.table({"id": pa.ExtensionArray.from_storage(pa.uuid(), number), "x": X[:12], "action": [0, 1] * 6,
                      "reward": R[:12], "e": [0, 1] * 6})  # fmt: skip
    pa.parquet.write_table(table, tmp_path / "log.parquet")
    assert "id" in str(describe_table(tmp_path / "log.parquet", ignore="id"))
    log = Dataset.from_frame(table, ignore="id", episode="e")
    assert told(log, "rows of an episode are not together")
