"""Rows of one site are no news of many: clusters are exchanged as a whole."""

import numpy as np
import pandas as pd
import pytest

import deadreckon as dr
from deadreckon.runs import compared


def sites(count, rows, rng, group):
    """Each site has a level of its own, which its rows nearly repeat."""
    level = np.repeat(rng.normal(size=count), rows)
    frame = pd.DataFrame({
        "x": level + 0.05 * rng.normal(size=count * rows), "site": np.repeat([f"s{i}" for i in rng.permutation(count)], rows),
        "action": rng.choice(["a", "b"], count * rows), "reward": 0.0,
    })  # fmt: skip
    options = {"group": "site"} if group else {"ignore": "site"}
    return dr.Dataset.from_frame(frame, action="action", reward="reward", **options)


def accused(group):
    rng, found = np.random.default_rng(0), 0
    for _ in range(10):
        old, new = sites(40, 10, rng, group), sites(20, 10, rng, group)
        before = compared.sample(old, np.arange(old.episodes), False)
        assert len(before.starts) == (40 if group else 400)
        found += any(each.found for each in compared.drifts(before, new, compared.whats(old), False, 0.05)[0])
    return found


@pytest.mark.slow
def test_sites_are_exchanged_as_a_whole():
    assert accused(group=True) <= 1
    assert accused(group=False) >= 5  # what exchanging rows would do


def test_of_a_long_episode_rows_at_regular_distances_are_looked_at():
    lengths = [3, 250]
    ends = np.zeros(253, bool)
    ends[[2, 252]] = True
    log = dr.Dataset.from_arrays(
        observations=np.arange(253.0)[:, None], actions=np.arange(253) % 2, rewards=np.zeros(253), terminals=ends
    )
    rows, starts = compared.rows_of(log, np.arange(2), False)
    assert starts.tolist() == [0, 3]
    assert rows[:3].tolist() == [0, 1, 2]
    assert len(rows) == 3 + compared.WITHIN
    assert rows[3] == 3
    assert 245 < rows[-1] <= 252
    assert set(np.diff(rows[3:]).tolist()) == {2, 3}
    assert compared.rows_of(log, np.arange(2), True)[0].tolist() == [0, 3]
    assert log.lengths.tolist() == lengths


@pytest.mark.parametrize(("over", "guilty"), [(5, False), (7, True)])
def test_what_lies_outside_is_tested_for_all_columns_at_once(over, guilty):
    """The five largest of 40 are all among the 20 new ones with a chance of 0.024, the seven largest with one of 0.0042.

    The first test has half of 0.1, and two numbers may lie outside in six ways (above, below, missing): 0.0083 for each.
    """

    def log(beyond):
        x = np.stack([np.arange(20.0), np.arange(20.0)], 1)
        x[:beyond, 0] = 100.0
        return dr.Dataset.from_arrays(
            observations=x, actions=np.arange(20) % 2, rewards=np.zeros(20), terminals=np.ones(20, bool)
        )

    old = log(0)
    found = compared.outside(old, log(over), compared.whats(old), False, 0.1)
    assert found.columns == (("observation 0", "above", over, guilty),)


def test_what_lies_outside_is_counted_in_parts_where_rows_follow_each_other():
    """Fifty neighbours beyond the reference are one event of a slow system, and a fifth of the parts by chance."""

    def log(x):
        return dr.Dataset.from_arrays(
            observations=x[:, None], actions=np.arange(len(x)) % 2, rewards=np.zeros(len(x)), terminals=np.ones(len(x), bool)
        )

    old, new = log(np.arange(1000.0) // 50), np.arange(250.0) // 50
    which = compared.whats(old)
    new[:50] = 100.0
    for lengths, guilty in ({}, True), (dict.fromkeys(which, 50), False):
        found = compared.outside(old, log(new), which, False, 0.1, lengths)
        assert found.columns == (("observation 0", "above", 50, guilty),)
    assert compared.outside(old, log(new + 100.0), which, False, 0.1, dict.fromkeys(which, 50)).columns[0][3]


def test_shares_of_missing_cells_stand_beside_the_differences():
    def log(gaps):
        x = np.arange(40.0)
        x[:gaps] = np.nan
        kind = np.array(["a", "b"] * 20, object)
        kind[20 : 20 + gaps] = None
        frame = pd.DataFrame({"x": x, "kind": kind, "y": 1.0 * np.arange(40), "action": ["a", "b"] * 20, "reward": 0.0})
        return dr.Dataset.from_frame(frame, action="action", reward="reward")

    old, new = log(4), log(10)
    found = compared.drifts(compared.sample(old, np.arange(40), False), new, compared.whats(old), False, 0.05)[0]
    shares = {each.what.name: each.missing for each in found}
    assert shares == {"x": (0.1, 0.25), "kind": (0.1, 0.25), "y": (0.0, 0.0), "action": (0.0, 0.0)}
