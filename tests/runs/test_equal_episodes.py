"""Logs in which many episodes are equal, such as those of few contexts: what was trained on, cross-fits and looks."""

import types

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.split import folds
from deadreckon.errors import UserError
from deadreckon.ope import OPEInput
from deadreckon.policies import BlackBoxPolicy
from deadreckon.runs.gather import Gathered, for_case, fresh
from deadreckon.runs.holdout import divided
from deadreckon.runs.looks import look
from deadreckon.runs.reading import Read
from deadreckon.runs.seen import seen


def contexts(seed, rows=300, success=0.5):
    """A log of single steps with three contexts, two actions and rewards of 0 or 1: each episode has many equal ones."""
    rng = np.random.default_rng(seed)
    return Dataset.from_arrays(
        observations=rng.integers(0, 3, (rows, 1)), actions=rng.integers(0, 2, rows), terminals=np.ones(rows, bool),
        rewards=(rng.random(rows) < success).astype(float), behavior_log_probs=np.full(rows, np.log(0.5)),
    )  # fmt: skip


def reread(log, rows):
    """A part of a log as a file of these rows alone would be read: nothing tells which part it is."""
    return Dataset.from_arrays(
        observations=log.observations[rows], actions=log.actions[rows], rewards=log.rewards[rows],
        terminals=log.terminals[rows], behavior_log_probs=log.extras["behavior_log_probs"][rows],
    )  # fmt: skip


def takes(action):
    chances = np.eye(2)[[action]]
    return BlackBoxPolicy(
        lambda x, rng: np.full(len(x), action), action_probs=lambda x: np.repeat(chances, len(x), 0)
    )  # fmt: skip


def test_a_part_of_a_log_with_equal_episodes_is_not_taken_for_held_out():
    """Read from a file of its own, the training part looked held out: its episodes are numbered anew."""
    log = contexts(0)
    training = np.arange(200)
    read = Read({}, None, log.episode_ids)
    policy = Gathered(takes(0), "p", None, log.episode_ids[training], read=read)
    assert fresh([policy], log, False).held.tolist() == list(range(200, 300))
    assert fresh([policy], log.select(np.arange(150, 250)), False).held.tolist() == list(range(50, 100))  # in this process
    with pytest.raises(UserError, match=r"200 of 200 episodes of .* equal several of the log that p was trained on, so only"):
        fresh([policy], reread(log, training), False)


def stored_twice(rows=100):
    """A log with decimals whose table was stored twice."""
    rng = np.random.default_rng(0)
    which = np.tile(np.arange(rows), 2)
    return Dataset.from_arrays(
        observations=rng.normal(size=(rows, 2))[which], actions=rng.integers(0, 2, rows)[which],
        terminals=np.ones(2 * rows, bool), rewards=rng.normal(size=rows)[which],
        behavior_log_probs=np.full(2 * rows, np.log(0.5)),
    )  # fmt: skip


def test_copies_of_training_episodes_are_not_fresh():
    """As where an older version, or a column, has divided them."""
    log = stored_twice()
    read = Read({}, None, log.episode_ids)
    policy = Gathered(takes(0), "p", None, log.episode_ids[:150], read=read)
    assert fresh([policy], log.select(np.arange(200)), False).held.tolist() == list(
        range(200)
    )  # none is left, and that is told
    policy = Gathered(takes(0), "p", None, log.episode_ids[:80], read=read)
    assert fresh([policy], log, False).held.tolist() == [*range(80, 100), *range(180, 200)]
    fits = Fits(log)
    fits.runs[0].held, fits.runs[1].held = log.episode_ids[:110], log.episode_ids[110:]  # 100 .. 109 are copies of 0 .. 9
    given = Gathered(None, "c", 0, None, cross=fits, read=read)
    held = fresh([given], log, False).held
    assert set(held) == set(range(200)) - set(range(10, 100)) - set(range(110, 200))


def test_an_older_run_is_not_continued_on_copies_of_its_held_out_episodes():
    log = stored_twice()
    told = divided(log, None, None, None).told
    assert told["different"] == 100
    before = {"data": {"holdout": told}}
    assert divided(log, None, None, before).told == told
    with pytest.raises(UserError, match="begun before copies of an episode were held out together"):
        divided(log, None, None, {"data": {"holdout": {key: told[key] for key in told if key != "different"}}})


class Fits:
    """A cross-fit whose folds' policies take one action each."""

    def __init__(self, log, deliver="mixture"):
        fold = folds(log, 2)
        self.config = {"deliver": deliver}
        self.runs = [types.SimpleNamespace(policies=[takes(k)], seeds=[0], held=log.episode_ids[fold == k]) for k in range(2)]

    def fold_of(self, log):
        fold = np.full(log.episodes, -1)
        for number, run in enumerate(self.runs):
            fold[seen(run.held, log)] = number
        return fold

    def policy_of(self, seed):
        return "refit"


def test_a_cross_fit_is_evaluated_on_all_of_another_log_whatever_equals_its_episodes():
    """Only the new episodes that equal old ones by chance were kept, which are those with the old outcomes."""
    old, new = contexts(0, success=0.3), contexts(1, success=0.6)
    given = Gathered(None, "c", 0, None, cross=Fits(old), read=Read({}, None, old.episode_ids))
    found = fresh([given], new, True)
    assert found.held.tolist() == list(range(300))
    assert "on which no policy was trained, according to --unseen" in found.told
    own = for_case(given, old, True)
    np.testing.assert_array_equal(own.which, folds(old, 2))  # on its own log each fold's policy is evaluated on the fold


def test_a_part_of_its_own_log_is_no_other_log_for_a_cross_fit():
    """Whatever the user says of it: each fold's policy is evaluated on the fold's episodes."""
    log = contexts(0)
    given = Gathered(None, "c", 0, None, cross=Fits(log), read=Read({}, None, log.episode_ids))
    part = log.select(np.arange(200))
    np.testing.assert_array_equal(for_case(given, part, True).which, folds(log, 2)[:200])


def test_the_mixture_of_a_cross_fit_is_evaluated_on_another_log():
    """It has a memory (which member acts), so each episode is given a member: the value is the mean of the members'."""
    old, new = contexts(0), contexts(1, rows=4000)
    reward = np.where(new.actions == 1, 1.0, 0.0)
    new = Dataset.from_arrays(observations=new.observations, actions=new.actions, rewards=reward, terminals=new.terminals,
                              behavior_log_probs=new.extras["behavior_log_probs"])  # fmt: skip
    given = Gathered(None, "c", 0, None, cross=Fits(old), read=Read({}, None, old.episode_ids))
    policy = for_case(given, new, True)
    assert np.bincount(policy.which).tolist() == [2000, 2000]
    case = OPEInput(new, [policy])
    assert case.inflation.tolist() == [1.0]  # none of them was trained on it
    weights = np.exp(case.log_probs[0] - np.log(0.5))
    assert (weights * reward).mean() == pytest.approx(0.5, abs=0.05)
    assert for_case(given._replace(cross=Fits(old, "refit")), new, True) == "refit"


def test_looks_at_unrelated_logs_are_no_looks_at_each_other(tmp_path, monkeypatch):
    """Three contexts, two actions and two rewards: most episodes of one log equal episodes of any other by chance."""
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path))
    logs = [contexts(seed) for seed in range(3)]
    assert [look(log, np.arange(100), "p", 1).number for log in logs] == [1, 1, 1]
    assert look(logs[0], np.arange(50, 150), "q", 1).number == 2  # some of the same episodes of one log
    assert look(logs[0], np.arange(100, 200), "r", 1).number == 2  # which share some with the last look alone
    assert look(logs[1], np.arange(200, 300), "s", 1).number == 1  # others of that log


def test_looks_at_nearly_the_same_episodes_count_whatever_equals_what(tmp_path, monkeypatch):
    """A part of the log in this process, and a file from which the last row is gone."""
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path))
    log = contexts(0)
    assert look(log, np.arange(100), "p", 1).number == 1
    assert look(log.select(np.arange(10, 300)), np.arange(90), "q", 1).number == 2
    assert look(reread(log, np.arange(299)), np.arange(99), "r", 1).number == 3


def test_looks_at_parts_of_one_log_count_where_episodes_differ(tmp_path, monkeypatch):
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path))
    rng = np.random.default_rng(0)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(300, 1)), actions=rng.integers(0, 2, 300), rewards=rng.normal(size=300),
        terminals=np.ones(300, bool), behavior_log_probs=np.full(300, np.log(0.5)),
    )  # fmt: skip
    assert look(log, np.arange(100), "p", 1).number == 1
    assert look(reread(log, np.arange(50, 300)), np.arange(40), "q", 1).number == 2  # read from another file
