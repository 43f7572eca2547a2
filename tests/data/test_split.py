"""Holding episodes out: shares, whole clusters, folds, and what cannot be held out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_logs import logs, make_log, quick

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import Fold, Holdout, clusters, folds
from deadreckon.errors import UserError


def users(sizes, seed=0):
    """Episodes of two steps, `sizes` of each user, mixed."""
    owner = np.random.default_rng(seed).permutation(np.repeat(np.arange(len(sizes)), sizes))
    return make_log((2,) * len(owner), user=np.repeat(10 * owner + 3, 2)), owner


@quick
@given(logs(), st.floats(0.05, 0.95), st.sampled_from(["random", "time"]), st.integers(0, 3))
def test_two_parts_are_the_whole(log, share, by, seed):
    if log.episodes < 2:
        with pytest.raises(UserError, match="1 episodes, at least 2"):
            Holdout(share, by, seed).parts(log)
        return
    learning, held = Holdout(share, by, seed).parts(log)
    np.testing.assert_array_equal(np.sort(np.concatenate([learning, held])), np.arange(log.episodes))
    assert (np.diff(learning) > 0).all()
    assert (np.diff(held) > 0).all()
    assert len(held) == min(max(log.episodes - round((1 - share) * log.episodes), 1), log.episodes - 1)
    if by == "time":
        assert held[0] > learning[-1]
    again = Holdout(share, by, seed).parts(log)
    np.testing.assert_array_equal(again.held, held)


def test_another_seed_holds_out_others():
    log = make_log((1,) * 50)
    first, second = (Holdout(seed=seed).parts(log).held for seed in (0, 1))
    assert len(first) == len(second) == 10
    assert set(first) != set(second)


@pytest.mark.parametrize("sizes", [[5] * 20, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10], [60, *[1] * 40]])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_clusters_are_held_out_whole_until_the_share_is_there(sizes, seed):
    log, owner = users(sizes)
    learning, held = Holdout(0.2, "user", seed).parts(log)
    assert not set(owner[learning]) & set(owner[held])
    assert abs(len(held) - 0.2 * log.episodes) <= 0.06 * log.episodes


def test_one_cluster_at_least_and_never_all():
    log, owner = users([9, 1])
    assert set(owner[Holdout(0.5, "user").parts(log).held]) <= {0, 1}
    assert len(set(owner[Holdout(0.01, "user").parts(log).held])) == 1
    assert len(set(owner[Holdout(0.99, "user").parts(log).held])) == 1
    log, owner = users([3, 3])
    assert len(Holdout(0.01, "user").parts(log).held) == 3


def test_clusters_are_numbered_by_value():
    log, owner = users([2, 3, 4])
    np.testing.assert_array_equal(clusters(log, "user"), owner)
    np.testing.assert_array_equal(clusters(log, "time"), np.arange(9))
    np.testing.assert_array_equal(clusters(log.select([4, 1]), "user"), [int(owner[4] > owner[1]), int(owner[1] > owner[4])])


@quick
@given(st.lists(st.integers(1, 6), min_size=4, max_size=12), st.integers(2, 4), st.integers(0, 3))
def test_folds_are_balanced_and_keep_clusters_together(sizes, k, seed):
    log, owner = users(sizes)
    for by in ("random", "time", "user"):
        fold = folds(log, k, by, seed)
        count = np.bincount(fold, minlength=k)
        assert count.min() >= 1
        assert len(count) == k
        assert np.ptp(count) <= (max(sizes) if by == "user" else 1)
        if by == "user":
            assert all(len(set(fold[owner == each])) == 1 for each in range(len(sizes)))
        if by == "time":
            assert (np.diff(fold) >= 0).all()
        parts = [Fold(i, k, by, seed).parts(log) for i in range(k)]
        np.testing.assert_array_equal(np.sort(np.concatenate([p.held for p in parts])), np.arange(log.episodes))
        assert all(not set(p.learning) & set(p.held) and len(p.learning) + len(p.held) == log.episodes for p in parts)


def test_folds_are_drawn_by_the_seed():
    log = users([1] * 20)[0]
    first, second = folds(log, 4, seed=0), folds(log, 4, seed=1)
    np.testing.assert_array_equal(first, folds(log, 4, seed=0))
    for fold in (first, second):
        assert not np.array_equal(fold, np.arange(20) % 4)
    assert not np.array_equal(first, second)


def stored_again(log, times, order):
    """The episodes of a log of single steps several times, in an order of the rows."""
    rows = np.tile(np.arange(len(log)), times)[order]
    return Dataset.from_arrays(
        observations=log.observations[rows], actions=log.actions[rows], rewards=log.rewards[rows],
        terminals=np.ones(len(rows), bool), action_space=log.action_space,
    ), rows  # fmt: skip


@pytest.mark.parametrize("by", ["random", "time"])
@pytest.mark.parametrize("mixed", [False, True])
def test_copies_are_held_out_together(by, mixed):
    once = make_log((1,) * 60, terminal=(True,), finals=False, discrete=True)
    order = np.random.default_rng(1).permutation(180) if mixed else np.arange(180)
    log, which = stored_again(once, 3, order)
    learning, held = Holdout(0.2, by).parts(log)
    assert not set(which[learning]) & set(which[held])
    assert len(held) == 36
    np.testing.assert_array_equal(np.sort(np.concatenate([learning, held])), np.arange(180))
    if by == "time":  # those of which the last copy is among the latest
        last = [int(np.flatnonzero(which == i).max()) for i in range(60)]
        assert set(which[held]) == set(np.argsort(last)[-12:])
    fold = folds(log, 5, by)
    assert all(len(set(fold[which == i])) == 1 for i in range(60))
    assert np.bincount(fold).tolist() == [36] * 5
    assert len(np.unique(clusters(log, by))) == 60


def test_whole_episodes_that_were_stored_again_are_one_cluster():
    once = make_log((3, 5, 1, 4) * 10, finals=False)
    rows = np.concatenate([np.arange(len(once)), np.arange(5 * 13)])
    log = Dataset.from_arrays(**{name: getattr(once, name)[rows] for name in ("observations", "actions", "rewards")},
                              terminals=once.terminals[rows], timeouts=once.timeouts[rows])  # fmt: skip
    np.testing.assert_array_equal(clusters(log), clusters(log)[np.append(np.arange(40), np.arange(20))])
    assert len(np.unique(clusters(log))) == 40


def test_episodes_that_are_equal_by_chance_are_not_copies():
    """Three contexts, two actions, rewards of 0 or 1: nearly every episode equals another one."""
    rng = np.random.default_rng(0)
    log = Dataset.from_arrays(
        observations=rng.integers(0, 3, (300, 1)), actions=rng.integers(0, 2, 300), rewards=rng.integers(0, 2, 300),
        terminals=np.ones(300, bool),
    )  # fmt: skip
    np.testing.assert_array_equal(clusters(log), np.arange(300))
    many = Dataset.from_arrays(  # of 150 contexts, some have been seen with one action and one reward alone
        observations=rng.integers(0, 150, (300, 1)), actions=rng.integers(0, 2, 300), rewards=rng.integers(0, 2, 300),
        terminals=np.ones(300, bool),
    )  # fmt: skip
    np.testing.assert_array_equal(clusters(many), np.arange(300))
    few, _ = stored_again(make_log((1,) * 400, terminal=(True,), finals=False), 2, np.r_[:400, 400:404])
    np.testing.assert_array_equal(clusters(few), np.arange(404))  # 1 % is neglected


def test_rows_of_empty_cells_are_not_copies():
    """Visitors of whom nothing is known have the values that stand for empty cells; the others differ."""
    rng = np.random.default_rng(0)
    seen = rng.normal(size=(1000, 3)) * (rng.random((1000, 1)) > 0.3)
    log = Dataset.from_arrays(
        observations=seen, actions=rng.integers(0, 2, 1000), rewards=rng.random(1000) < 0.2, terminals=np.ones(1000, bool)
    )  # fmt: skip
    np.testing.assert_array_equal(clusters(log), np.arange(1000))
    twice, which = stored_again(log, 2, rng.permutation(2000))
    found = clusters(twice)
    known = (log.observations[which] != 0).any(1)
    assert len(np.unique(found[known])) == known.sum() / 2
    assert len(np.unique(found[~known])) == (~known).sum()  # which of them are copies is not known


def test_contexts_that_take_turns_are_not_copies():
    """The hour of the day, an action that is rare and a reward that is rare."""
    rng = np.random.default_rng(0)
    log = Dataset.from_arrays(
        observations=(np.arange(2400.0) % 24)[:, None], actions=(rng.random(2400) < 0.05).astype(int),
        rewards=rng.random(2400) < 0.05, terminals=np.ones(2400, bool),
    )  # fmt: skip
    np.testing.assert_array_equal(clusters(log), np.arange(2400))


def test_copies_of_very_different_numbers_leave_no_fold_empty():
    once = make_log((1,) * 200, terminal=(True,), finals=False, discrete=True)
    log, which = stored_again(once, 1, np.append(np.arange(200), np.full(800, 199)))
    for by in ("random", "time"):
        fold = folds(log, 5, by)
        assert (np.bincount(fold, minlength=5) > 0).all()
        held = Holdout(0.2, by).parts(log).held
        assert len(held) in ((199,) if by == "random" else (801,))  # the latest is the one that was stored 801 times
        assert (199 in which[held]) == (by == "time")


def test_the_latest_of_a_memory_mapped_log_with_copies_are_refused(tmp_path):
    """Both parts would be copied into memory."""
    once = make_log((1,) * 60, terminal=(True,), finals=False, discrete=True)
    log, _ = stored_again(once, 3, np.arange(180))
    np.save(tmp_path / "seen.npy", log.observations)
    log = replace(log, observations=np.load(tmp_path / "seen.npy", mmap_mode="r"))
    with pytest.raises(UserError, match="120 of 180 episodes repeat an earlier one, and the latest of a memory-mapped log"):
        Holdout(0.2, "time").parts(log)


def test_visitors_who_come_again_are_not_copies():
    """Some do the same with the same success, and others do not."""
    rng = np.random.default_rng(0)
    visitor = rng.integers(0, 3000, 1000)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(3000, 3))[visitor], actions=rng.integers(0, 2, 1000), rewards=rng.random(1000) < 0.05,
        terminals=np.ones(1000, bool),
    )  # fmt: skip
    assert log.copied is None


def test_what_cannot_be_held_out():
    log, _ = users([2, 2])
    changing = make_log((2, 2), site=[1, 1, 4, 5], flat=[7, 7, 7, 7], pair=np.zeros((4, 2)))
    cases = [
        (lambda: Holdout(0.0).parts(log), "must lie between 0 and 1, got 0.0"),
        (lambda: Holdout(1.0).parts(log), "must lie between 0 and 1, got 1.0"),
        (lambda: Holdout(by="usr").parts(log), "unknown column 'usr': did you mean user?"),
        (lambda: Holdout(by="x").parts(log), "known: user"),
        (lambda: Holdout(by="pair").parts(changing), "unknown column 'pair'"),
        (lambda: Holdout(by="site").parts(changing), r"site changes within episode 1 \(4 in row 2 and 5 in row 3\)"),
        (lambda: Holdout(by="flat").parts(changing), "1 values of flat, at least 2 are needed"),
        (lambda: folds(log, 1), "at least 2 folds are needed, got 1"),
        (lambda: folds(log, 5), "4 episodes, at least 5 are needed"),
        (lambda: folds(log, 3, "user"), "2 values of user, at least 3"),
    ]
    for call, words in cases:
        with pytest.raises(UserError, match=words) as error:
            call()
        assert "\n" not in str(error.value)


def test_a_log_is_split_by_users_too():
    log, owner = users([4] * 5)
    first, second = log.split(0.8, by="user")
    assert (first.episodes, second.episodes) == (16, 4)
    assert not set(np.unique(first.extras["user"])) & set(np.unique(second.extras["user"]))
