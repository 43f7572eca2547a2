import datetime as dt

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_logs import quick

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.io import read
from deadreckon.data.frame import ALONE
from deadreckon.data.info import warnings_for
from deadreckon.data.schema import Schema
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError

TABLE = {
    "who": ["b", "b", "a", "a", "a"],
    "when": [1, 2, 1, 2, 3],
    "x": [1.0, 2.0, 3.0, 4.0, 5.0],
    "kind": ["red", "blue", "red", "red", "blue"],
    "action_0": [0.1, 0.2, 0.3, 0.4, 0.5],
    "action_1": [1.0, 2.0, 3.0, 4.0, 5.0],
    "gain": [1, 0, 0, 0, 2],
    "done": [True, False, False, False, True],
}
NAMED = {"episode": "who", "time": "when", "action": "action", "reward": "gain", "terminal": "done"}


def test_a_propensity_beside_names_of_ours_is_one_as_in_a_file():
    table = {"observation_0": [0.1, 0.2, 0.3], "action": [0, 1, 1], "reward": [1.0, 0.0, 1.0], "propensity": [0.5, 0.25, 0.5]}
    log = Dataset.from_frame(table)
    np.testing.assert_allclose(log.extras["behavior_log_probs"], np.log(table["propensity"]), rtol=1e-6)
    assert "column propensity is read as the probability of the logged action (--propensity)" in log.warnings
    assert log.observations.shape == (3, 1)
    other = Dataset.from_frame(table | {"treat": [1, 0, 1]}, action="treat")  # it is not known whose probability it is
    assert not other.extras
    table["x"] = table.pop("observation_0")
    assert not Dataset.from_frame(table).extras


def test_the_whole_of_it():
    table = {**TABLE, "done": [False, True, False, False, False]}
    log = Dataset.from_frame(table, **NAMED, name="shop")
    assert log.name == "shop"
    # Episode a and b both begin at 1, so names decide.
    assert log.rewards.tolist() == [0, 0, 2, 1, 0]
    assert log.lengths.tolist() == [3, 2]
    assert log.terminals.tolist() == [False, False, False, False, True]
    assert log.timeouts.tolist() == [False, False, True, False, False]
    np.testing.assert_allclose(log.actions[:, 0], [0.3, 0.4, 0.5, 0.1, 0.2], rtol=1e-6)
    assert log.provenance.extra["observation_names"] == ["x", "kind=blue", "kind=red"]
    assert log.provenance.extra["observation_levels"] == {"kind": ["blue", "red"]}
    assert log.observations.tolist() == [[3, 0, 1], [4, 0, 1], [5, 1, 0], [1, 0, 1], [2, 1, 0]]
    assert log.dropped == 1


@quick
@given(st.permutations(range(5)))
def test_the_order_of_the_rows_does_not_matter(order):
    shuffled = {key: [value[row] for row in order] for key, value in TABLE.items()}
    a, b = Dataset.from_frame(TABLE, **NAMED), Dataset.from_frame(shuffled, **NAMED)
    assert a.fingerprint == b.fingerprint


@pytest.mark.parametrize("library", ["pyarrow", "pandas", "polars", "arrays"])
def test_tables_of_all_kinds(library):
    if library == "pyarrow":
        frame = pa.table(TABLE)
    elif library == "arrays":
        frame = {key: np.array(value) for key, value in TABLE.items()}
    else:
        frame = pytest.importorskip(library).DataFrame(TABLE)
    if library == "pandas":
        frame["kind"] = frame["kind"].astype("category")
        frame = frame.set_index(np.arange(10, 15))
    assert Dataset.from_frame(frame, **NAMED).fingerprint == Dataset.from_frame(TABLE, **NAMED).fingerprint


def test_each_row_is_an_episode_of_a_bandit():
    log = Dataset.from_frame(
        {"x": [1, 2], "arm": [0, 1], "click": [0, 1], "p": [0.5, 0.25]}, action="arm", reward="click", propensity="p"
    )
    assert log.terminals.all()
    assert log.episodes == 2
    assert log.dropped == 0
    np.testing.assert_allclose(np.exp(log.extras["behavior_log_probs"]), [0.5, 0.25], rtol=1e-6)


def test_densities_of_continuous_actions_may_be_above_1():
    log = Dataset.from_frame(
        {"x": [1, 2], "dose": [0.1, 0.7], "r": [0, 1], "p": [2.5, 0.25]}, action="dose", reward="r", propensity="p"
    )
    np.testing.assert_allclose(np.exp(log.extras["behavior_log_probs"]), [2.5, 0.25], rtol=1e-6)


def test_next_observations_cut_a_stream_that_only_a_time_orders():
    table = {"ts": [3, 4, 0, 1], "x": [5, 6, 1, 2], "next_x": [6, 7, 2, 3], "a": [0, 1, 0, 1], "r": [0] * 4}
    log = Dataset.from_frame(table, time="ts", action="a", reward="r")
    assert (log.observations[:, 0].tolist(), log.lengths.tolist()) == ([1, 2, 5, 6], [2, 2])
    assert log.final_observations[:, 0].tolist() == [3, 7]


def test_times_of_large_integers_are_not_rounded():
    start = 1_767_225_600_000_000_000  # nanoseconds since 1970, of which float64 holds every 256th
    table = {"t": [start + 2, start + 3, start + 1, start], "x": [2, 3, 1, 0], "a": [0, 1, 0, 1], "r": [0] * 4}
    log = Dataset.from_frame(table, time="t", action="a", reward="r")
    assert log.observations[:, 0].tolist() == [0, 1, 2, 3]
    assert not [line for line in log.warnings if "of the row before" in line]
    by_episode = Dataset.from_frame({**table, "e": [1, 1, 2, 2]}, episode="e", time="t", action="a", reward="r")
    assert by_episode.observations[:, 0].tolist() == [0, 1, 2, 3]  # also episodes among one another


def test_one_stream_cut_by_its_flags():
    table = {"x": [1, 2, 3, 4], "a": [0, 1, 0, 1], "r": [0, 0, 0, 0], "end": [0, 1, 0, 0]}
    log = Dataset.from_frame(table, action="a", reward="r", terminal="end")
    assert log.lengths.tolist() == [2, 2]
    assert Dataset.from_frame(table, action="a", reward="r", timeout="end").lengths.tolist() == [2, 2]
    by_time = Dataset.from_frame({**table, "t": [4, 3, 2, 1]}, action="a", reward="r", time="t")
    assert by_time.observations[:, 0].tolist() == [4, 3, 2, 1]
    assert by_time.lengths.tolist() == [4]


def test_episodes_follow_one_another_in_time():
    moments = [dt.datetime(2026, 1, day) for day in (5, 6, 1, 2)]
    log = Dataset.from_frame({"e": [1, 1, 2, 2], "t": moments, "x": [1, 2, 3, 4], "a": [0, 1, 0, 1], "r": [0] * 4},
                     episode="e", time="t", action="a", reward="r")  # fmt: skip
    assert log.observations[:, 0].tolist() == [3, 4, 1, 2]


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ([[0, 1, 2, 3], [0, 1], [0, 1, 2]], []),
        ([[0, 1, 3, 4], [0, 1], [0, 1, 2]], ["1 of 6 steps skip values of t; their rows are taken as following one another"]),
        ([[0, 1, 2, 3], [5, 6], [0, 1, 2]], ["1 of 3 episodes start after t 0, where most do; their first rows"]),
        ([[1, 2], [2, 3, 9], [1, 2, 3]], ["1 of 5 steps skip", "1 of 3 episodes start after t 1, where most do"]),
        ([[0, 1, 2], [7, 8, 9], [20, 21, 22]], []),  # a clock that runs on: no start is usual
        ([[0, 10, 20, 30], [0, 10], [5, 15, 16]], []),  # most rows are not one apart, so these are no steps
        ([[0.0, 0.5, 1.5], [0.0, 1.0], [0.0, 1.0, 3.0]], []),
    ],
)
@pytest.mark.parametrize("dates", [False, True])
def test_rows_that_are_missing_by_their_time_are_told(times, words, dates):
    moments = [t for episode in times for t in episode]
    rows, start = len(moments), dt.date(2026, 1, 1)
    table = {"e": [e for e, episode in enumerate(times) for _ in episode], "x": [0.0] * rows, "a": [0] * rows, "r": [0] * rows,
             "t": [start + dt.timedelta(days=t) for t in moments] if dates else moments}  # fmt: skip
    order = np.random.default_rng(0).permutation(rows)
    shuffled = {key: [column[i] for i in order] for key, column in table.items()}
    told = Dataset.from_frame(shuffled, episode="e", time="t", action="a", reward="r").warnings
    told = [text for text in told if "skip" in text or "start" in text]
    assert len(told) == (0 if dates else len(words))
    assert all(word in text for word, text in zip(words, told))


def test_a_gap_behind_an_end_is_none():
    table = {"t": [0, 1, 2, 8, 9], "end": [0, 0, 1, 0, 0], "x": [0.0] * 5, "a": [0] * 5, "r": [0] * 5}
    log = Dataset.from_frame(table, time="t", terminal="end", action="a", reward="r")
    assert not [text for text in log.warnings if "skip" in text or "start" in text]


@pytest.mark.parametrize("kind", ["texts of dates", "texts", "empty"])
def test_of_several_times_the_first_that_is_none_of_texts_orders_the_rows(kind):
    order = [2, 0, 1, 4, 5, 3]
    dates, texts = [f"2024-01-0{i + 1}T10:00" for i in order], [f"t{i}" for i in order]
    times = {"texts of dates": dates, "texts": texts, "empty": [None] * 6}
    table = {"episode": [0] * 3 + [1] * 3, "time": pa.array(times[kind]), "step": order, "ts": order[::-1],
             "x": order, "action": [0, 1] * 3, "reward": [1.0] * 6}  # fmt: skip
    log = Dataset.from_frame(pa.table(table))
    assert log.observations.tolist() == [[0], [1], [2], [3], [4], [5]]
    assert "column step is read as the time within an episode (--time)" in log.warnings
    for other in ("time", "ts"):
        told = f"column {other} is named like the time, as step is, and is left out"
        assert any(line.startswith(told) for line in log.warnings)


def test_without_time_rows_of_an_episode_keep_their_order():
    log = Dataset.from_frame({"e": ["z", "a", "z", "a"], "x": [1, 2, 3, 4], "a": [0, 1, 0, 1], "r": [0] * 4},
                     episode="e", action="a", reward="r")  # fmt: skip
    assert log.observations[:, 0].tolist() == [1, 3, 2, 4]
    assert log.lengths.tolist() == [2, 2]


def test_missing_values_become_the_mean_and_are_marked_and_counted():
    table = {"x": [1.0, None, 3.0, float("nan")], "k": ["u", None, "v", "u"], "b": [True, False, None, True],
             "a": [0, 1, 0, 1], "r": [0] * 4}  # fmt: skip
    log = Dataset.from_frame(table, action="a", reward="r")
    names = log.provenance.extra["observation_names"]
    assert names == ["x", "x_missing", "k=u", "k=v", "k_missing", "b", "b_missing"]
    columns = dict(zip(names, log.observations.T.tolist()))
    assert columns["x"] == [1, 2, 3, 2]
    assert columns["x_missing"] == [0, 1, 0, 1]
    assert columns["k=u"] == [1, 0, 0, 1]
    assert columns["k_missing"] == [0, 1, 0, 0]
    np.testing.assert_allclose(columns["b"], [1, 0, 2 / 3, 1], rtol=1e-6)
    assert "x 2, k 1, b 1" in log.warnings[0]


@pytest.mark.parametrize(
    ("values", "codes", "n", "levels"),
    [
        ([0, 2, 1, 2], [0, 2, 1, 2], 3, None),
        ([0, 5, 1, 2], [0, 3, 1, 2], 4, [0, 1, 2, 5]),
        ([1, 3, 2, 1], [0, 2, 1, 0], 3, [1, 2, 3]),
        ([700, 5, 700, 90000], [1, 0, 1, 2], 3, [5, 700, 90000]),
        ([-1, 1, 1, -1], [0, 1, 1, 0], 2, [-1, 1]),
        (["stop", "go", "go", "stop"], [1, 0, 0, 1], 2, ["go", "stop"]),
        ([True, False, True, True], [1, 0, 1, 1], 2, ["false", "true"]),
    ],
)
def test_discrete_actions(values, codes, n, levels):
    log = Dataset.from_frame({"x": [1, 2, 3, 4], "a": values, "r": [0] * 4}, action="a", reward="r")
    assert log.actions.tolist() == codes
    assert log.action_space == Discrete(n)
    assert log.provenance.extra.get("action_levels") == levels
    assert bool(set(log.warnings) - {ALONE}) == isinstance(levels and levels[0], int)


def test_floats_are_continuous_actions():
    log = Dataset.from_frame({"x": [1, 2], "dose": [0.5, 1.0], "r": [0, 1]}, action="dose", reward="r")
    assert log.actions.tolist() == [[0.5], [1.0]]
    both = Dataset.from_frame({"x": [1, 2], "a": [0, 1], "b": [2, 3], "r": [0, 1]}, action=["b", "a"], reward="r")
    assert both.actions.tolist() == [[2, 0], [3, 1]]


def test_what_is_noticed():
    table = {"": [0, 1, 2], "e": [1, 1, 1], "t": [1, 1, 2], "x": [1, 2, 3], "a": [0, 1, 0], "r": [0] * 3, "d": [1, 0, 0]}
    log = Dataset.from_frame(table, episode="e", time="t", action="a", reward="r", terminal="d")
    assert log.provenance.extra["observation_names"] == ["x"]
    assert [line.split()[0] for line in log.warnings] == ["column", "1", "1", "1"]
    assert "looks like a row number" in log.warnings[0]
    assert "have the t of the row before them" in log.warnings[1]
    assert "not the last of their episode" in log.warnings[2]


@pytest.mark.parametrize(
    ("changed", "options", "words"),
    [
        ({}, {"reward": "gian"}, "unknown column 'gian': did you mean gain"),
        ({}, {"action": "acton"}, "unknown column 'acton'"),
        ({}, {"observations": ["x", "kin"]}, "unknown column 'kin': did you mean kind"),
        ({}, {"episode": "hwo"}, "unknown column 'hwo': did you mean who"),
        ({}, {"action": []}, "no action column is named"),
        ({}, {"observations": []}, "no column is left to be an observation"),
        ({"gain": [1, None, 0, 0, 0]}, {}, "column gain is empty in row 1"),
        ({"gain": [1, float("inf"), 0, 0, 0]}, {}, "column gain has inf in row 1"),
        ({"gain": list("abcde")}, {}, "column gain holds texts, numbers are needed"),
        ({"done": [0, 1, 2, 0, 0]}, {}, "column done has 2 in row 2, 0 or 1 is needed"),
        ({"who": ["a", "b", None, "a", "a"]}, {}, "column who is empty in row 2"),
        ({"when": [1, 2, 3, None, 4]}, {}, "column when is empty in row 3"),
        ({"when": list("abcde")}, {}, "column when orders rows, and holds neither numbers nor dates"),
        ({"action_1": [0, None, 0, 0, 0]}, {}, "column action_1 is empty in row 1"),
        ({"x": [1, 2, float("inf"), 4, 5]}, {}, "column x has inf in row 2"),
        ({"x": [None] * 5}, {"observations": "x"}, "column x is empty; leave it out"),
        (
            {"x": [dt.datetime(2026, 1, 1)] * 5},
            {"observations": "x"},
            r"column x holds timestamp.* give it as time, or leave it out",
        ),
        ({"x": [[1], [2], [3], [4], [5]]}, {}, r"column x holds list"),
        ({"x": [0.0, 0.5, 0.5, 0.5, 1.0]}, {"propensity": "x"}, "column x has 0 in row 0, a density above 0 is needed"),
        (
            {"x": [1.5, 0.5, 0.5, 0.5, 1.0]},
            {"propensity": "x", "action": "kind"},
            "column x has 1.5 in row 0, a probability in .0, 1. is",
        ),
    ],
)
def test_bad_tables_are_told_in_one_line(changed, options, words):
    with pytest.raises(UserError, match=words) as caught:
        Dataset.from_frame({**TABLE, **changed}, **{**NAMED, **options}, name="shop")
    assert str(caught.value).startswith("shop: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("frame", [3, {"a": np.zeros((2, 2))}, {"a": [1], "b": [1, 2]}, {"a": [1, "x"]}, {}, {"a": []}])
def test_what_is_no_table(frame):
    with pytest.raises(UserError, match=r"^frame: ") as caught:
        Dataset.from_frame(frame, action="a", reward="a")
    assert "\n" not in str(caught.value)


def test_identifiers_are_not_encoded():
    table = {"id": [f"user {i}" for i in range(2000)], "a": [0] * 2000, "r": [0] * 2000}
    with pytest.raises(UserError, match="no column is left .*column id has 2,000 different texts in 2,000 rows"):
        Dataset.from_frame(table, action="a", reward="r")
    with pytest.raises(UserError, match="column id has 2000 distinct values, at most 1000 are encoded; leave it out"):
        Dataset.from_frame(table, action="a", reward="r", observations="id")


def test_real_bandit_feedback(real_data):
    log = read(
        real_data / "open_bandit" / "bts_men.csv.gz", action="item_id", reward="click", propensity="propensity_score",
        observations=["user_feature_0", "user_feature_1", "user_feature_2", "user_feature_3", "position"],
    )  # fmt: skip
    assert log.name == "bts_men"
    assert len(log) == log.episodes == 10_000
    assert log.action_space == Discrete(34)
    assert log.dropped == 0
    assert (log.extras["behavior_log_probs"] <= 0).all()
    known = read(real_data / "open_bandit" / "bts_men.csv.gz")  # the names of its columns say what they are
    np.testing.assert_array_equal(known.actions, log.actions)
    np.testing.assert_array_equal(known.rewards, log.rewards)
    np.testing.assert_array_equal(known.extras["behavior_log_probs"], log.extras["behavior_log_probs"])
    assert (known.extras["position"] > 0).all()
    assert known.episodes == 10_000
    assert known.terminals.all()
    names = known.provenance.extra["observation_names"]
    assert sum(name.startswith("user-item_affinity_") for name in names) == 34
    assert not any(name.startswith(("position", "timestamp", "item_id")) for name in names)
    assert known.warnings[0].startswith("read as Open Bandit's layout: each row is an episode of one terminal step")


def test_prefixes_among_several_and_columns_to_ignore():
    table = {"": [0, 1], "t": [dt.datetime(2026, 1, day) for day in (1, 2)], "u_0": [1.0, 2.0], "u_1": [3.0, 4.0], "v": [5, 6],
             "a_0": [0.1, 0.2], "a_1": [0.3, 0.4], "b": [0.5, 0.6], "r": [0, 1]}  # fmt: skip
    log = Dataset.from_frame(table, action=["b", "a"], reward="r")
    np.testing.assert_allclose(log.actions[0], [0.5, 0.1, 0.3], rtol=1e-6)
    assert log.provenance.extra["observation_names"] == ["u_0", "u_1", "v"]
    assert "timestamps are left out of the observations: t (--time t)" in log.warnings
    for options, names in (
        ({"observations": ["v", "u"]}, ["v", "u_0", "u_1"]),
        ({"observations": ["u_1", "u"]}, ["u_1", "u_0"]),
        ({"ignore": ["u"]}, ["v"]),
        ({"ignore": "v"}, ["u_0", "u_1"]),
        ({"observations": ["u", "v"], "ignore": ["u_0"]}, ["u_1", "v"]),
    ):
        log = Dataset.from_frame(table, action=["b", "a"], reward="r", **options)
        assert log.provenance.extra["observation_names"] == names
    with pytest.raises(UserError, match="unknown column 'w'"):
        Dataset.from_frame(table, action="b", reward="r", ignore=["w"])


def test_real_bandit_feedback_needs_two_names_only(real_data):
    log = read(
        real_data / "open_bandit" / "random_men.csv.gz", action="item_id", reward="click", ignore=("user-item_affinity",)
    )
    assert "position" in log.provenance.extra["observation_names"]
    assert "propensity_score" not in log.provenance.extra["observation_names"]
    told = "column propensity_score looks like a probability of the logged action and is left out: --propensity"
    assert any(line.startswith(told) for line in log.warnings)
    assert any("timestamps are left out" in line for line in log.warnings)
    assert not any("split by episodes" in line for line in warnings_for(log))


@pytest.mark.parametrize("library", ["arrays", "pandas", "polars", "categories"])
def test_columns_that_are_kept_are_no_observations(library):
    days = [dt.date(2026, 1, day) for day in (2, 2, 1, 1, 1)]
    table = {**TABLE, "site": ["n", "n", "s", "s", "s"], "day": days, "no": [5, 5, 9, 9, 9]}
    frame = table
    if library == "categories":
        frame = pa.table({**table, "site": pa.array(table["site"]).dictionary_encode()})
    elif library != "arrays":
        frame = pytest.importorskip(library).DataFrame(table)
    log = Dataset.from_frame(frame, **NAMED, keep=("site", "day", "no", "who", "x"))
    assert log.provenance.extra["observation_names"] == ["kind=blue", "kind=red"]
    assert {name: column.tolist() for name, column in log.extras.items()} == {
        "site": [1, 1, 1, 0, 0], "day": [0, 0, 0, 1, 1], "no": [9, 9, 9, 5, 5], "who": [0, 0, 0, 1, 1], "x": [3, 4, 5, 1, 2],
    }  # fmt: skip
    levels = log.provenance.extra["kept_levels"]
    assert {name: levels[name] for name in ("site", "who")} == {"site": ["n", "s"], "who": ["a", "b"]}
    assert [level[:10] for level in levels["day"]] == ["2026-01-01", "2026-01-02"]
    assert log.extras["site"].dtype == log.extras["no"].dtype == np.int64


def test_what_is_kept_may_be_observed_where_it_is_named():
    log = Dataset.from_frame(TABLE, **NAMED, observations=["x", "kind"], keep="kind")
    assert log.provenance.extra["observation_names"] == ["x", "kind=blue", "kind=red"]
    assert log.extras["kind"].tolist() == [1, 1, 0, 1, 0]


def test_very_many_users_are_codes_without_levels():
    table = {"user": [f"u{i:04d}" for i in range(1200)], "arm": [0, 1] * 600, "click": [0.0] * 1200, "x": range(1200)}
    log = Dataset.from_frame(table, action="arm", reward="click", keep="user")
    assert log.extras["user"].tolist() == list(range(1200))
    assert "kept_levels" not in log.provenance.extra


@pytest.mark.parametrize(
    ("keep", "words"),
    [
        ("sit", "unknown column 'sit': did you mean site"), ("site", "column site is empty in row 1"),
        ("name", "a column that is kept cannot be called name"), ("lists", "column lists holds list<.*one plain value"),
    ],
)  # fmt: skip
def test_what_cannot_be_kept(keep, words):
    table = {**TABLE, "site": ["n", None, "s", "s", "s"], "name": ["n"] * 5, "lists": [[1]] * 5}
    with pytest.raises(UserError, match=words):
        Dataset.from_frame(table, **NAMED, observations="x", keep=keep)


@pytest.mark.parametrize(("seen", "words"), [(["x", "r"], "column r is the reward"), (["a", "x"], "column a is an action")])
def test_what_has_another_part_is_no_observation(seen, words):
    table = pa.table({"x": [0.1, 0.2], "a": [0.5, 0.6], "r": [1.0, 2.0]})
    with pytest.raises(UserError, match=words):
        Dataset.from_frame(table, action="a", reward="r", observations=seen)


def test_dimensions_of_one_name_are_refused():
    table = pa.table({"x": [1.0, None, 3.0], "x_missing": [5.0, 6.0, 7.0], "a": [0.5, 0.6, 0.7], "r": [1.0, 2.0, 3.0]})
    with pytest.raises(UserError, match="two dimensions of the observation are called x_missing"):
        Dataset.from_frame(table, action="a", reward="r")


def test_categories_as_polars_has_them():
    """Dictionaries of a kind of text that pyarrow can hardly work with."""
    modes = pa.DictionaryArray.from_arrays([0, 1, 0, None], pa.array(["x", "y"], pa.string_view()))
    table = pa.table({"mode": modes, "action": [0, 1, 0, 1], "reward": [0.0] * 4})
    log = Dataset.from_frame(table)
    assert log.provenance.extra["observation_levels"] == {"mode": ["x", "y"]}
    assert log.observations.tolist() == [[1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]]


def test_a_column_of_a_type_of_its_own_can_be_ignored():
    table = pa.table({"x": [0.5, 1.5, 2.5], "act": [0, 1, 0], "reward": [1.0, 0.0, 1.0],
                      "id": pa.array([bytes(16), None, bytes(16)], pa.uuid())})  # fmt: skip
    with pytest.raises(UserError, match=r"column id holds arrow.uuid, .*; leave it out \(--ignore id\)"):
        Dataset.from_frame(table, action="act", reward="reward")
    log = Dataset.from_frame(table, action="act", reward="reward", ignore="id")
    assert log.provenance.extra["observation_names"] == ["x"]
    assert log.provenance.extra["held"]["id"]["missing"] == 1
    drafted = Schema.from_json(log.provenance.extra["schema"], "log")
    assert Dataset.from_frame(table, schema=drafted).fingerprint == log.fingerprint


def test_columns_of_nan_alone_are_empty():
    log = Dataset.from_frame({"x": [0.5, 1.5], "gone": [np.nan] * 2, "act": [0, 1], "reward": [1.0, 0.0]})
    assert log.provenance.extra["observation_names"] == ["x"]
    assert "column gone is empty and is left out of the observations" in log.warnings
