"""MBPO's experience: what is made up, when and how much of it, and a run that a kill does not change."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

import deadreckon as dr
from deadreckon.agents import MBPO
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.online import Online, branched_rollouts
from deadreckon.online.branched_rollouts import BranchedRollouts
from deadreckon.online.model_learning import ModelLearning
from deadreckon.tasks import task
from deadreckon.training.fit import Fit

TASK = task("inverted-pendulum")
TINY = {"hidden": (8,), "batch_size": 16, "model_hidden": (8,), "model_weight_decay": (), "members": 3, "elites": 2,
        "model_epochs": 2, "rollouts_per_step": 3, "model_train_freq": 20, "retain_steps": 40, "rollout_length": (1, 3, 1, 2),
        "target_entropy": -0.05}  # fmt: skip
SETTINGS = Online(copies=2, explore=40, updates_per_step=0.5, block=10)
UPDATES = SETTINGS.updates(120)


def job(seeds=(0,), paths=(), folder=None, updates=UPDATES, **changes):
    agent = MBPO(**TINY | changes).resolve(Spec.empty(TASK.observation_shape, TASK.action_space, TASK.name), updates)
    experience = BranchedRollouts(TASK, agent, list(seeds), updates, SETTINGS, paths, threads=1)
    return Fit([agent] * len(seeds), experience, list(seeds), updates, 5, folder), experience


def walk(fit, updates=None):
    for progress in fit.chunks():
        if progress.step == updates:
            return


def columns(buffer):
    return np.split(np.asarray(buffer), np.cumsum([4, 1, 1, 4]), axis=1)


@pytest.mark.slow
def test_what_is_learned_from():
    fit, experience = job(real_ratio=0.2)
    walk(fit)
    assert experience.environment_steps == 120
    assert sorted(experience._batches) == [2, 3]  # of fits to 40, 60, 80 and 100 steps the last two are kept
    made_up = [len(rows[0]) for rows in experience._batches.values()]
    # 3 rollouts a step, 20 steps; 1 step long at first, 3 after a thousand.
    assert made_up == [60, 60]
    assert experience.count == 120 + 30
    rows = np.asarray(experience._buffer[0, : experience.count])
    observation, action, reward, following, terminal = columns(rows)
    assert (np.abs(action) <= 1).all()
    assert set(np.unique(terminal)) <= {0.0, 1.0}
    np.testing.assert_array_equal(terminal[:120, 0] > 0, np.asarray(TASK.ends(following[:120])))  # it is known when it ends
    real = np.asarray(experience.replay.buffer[0, :120])
    assert all((real[:, :4] == row).all(1).any() for row in observation[:120])  # rollouts of one step begin at real states
    assert all((real[:, : rows.shape[1]] == row).all(1).any() for row in rows[120:])
    assert not any((real[:, : rows.shape[1]] == row).all(1).any() for row in rows[:120])
    np.testing.assert_allclose(reward[120:], 1.0 - terminal[120:])  # of real rows: 1 while the pole stands
    assert set(experience.metrics) == {"model_error", "model_epochs", "rollout_length"}


@pytest.mark.slow
def test_lengths_of_rollouts():
    agent = MBPO().resolve(Spec.empty((11,), task("hopper").action_space, "hopper"), 1)
    assert agent.target_entropy == -1.0
    assert [agent.rollout_length_at(e) for e in (0, 20, 25, 26, 60, 99, 100, 500)] == [1, 1, 1, 2, 8, 14, 15, 15]
    constant = MBPO(rollout_length=(3, 3, 1, 2)).resolve(Spec.empty((11,), task("hopper").action_space, "hopper"), 1)
    assert constant.rollout_length_at(7) == 3
    assert MBPO.acting("halfcheetah")["updates_per_step"] == 40
    fit, experience = job(rollout_length=(2, 2, 1, 2))
    walk(fit, 5)
    # Rollouts that ended after a step are made up for by others.
    assert len(experience._batches[0][0]) == 2 * 60


@pytest.mark.slow
def test_of_long_rollouts_no_more_is_kept_than_asked_for():
    fit, experience = job(rollout_length=(5, 5, 1, 2), model_buffer_size=100)
    walk(fit)
    assert [rows.shape[1] for rows in experience._batches.values()] == [50, 50]
    real = fit.learners[0].real_ratio
    assert experience._buffer.shape[1] >= experience.count == 100 + round(100 * real / (1 - real))
    for rows in experience._batches.values():
        assert len(np.unique(rows[0], axis=0)) == 50  # drawn without replacement
    with pytest.raises(UserError, match=r"model_buffer_size \(1\) must hold a row of each of the 2 fits"):
        job(model_buffer_size=1)


@pytest.mark.parametrize("ends_at_once", [False, True])
def test_long_rollouts_are_made_in_portions_until_there_are_enough(monkeypatch, ends_at_once):
    """Of 60 rollouts of 40 steps, 2,400 rows, 50 are kept: 500 are made up at a time at most."""
    begun = []

    def branches(model, ensemble, policy, starts, length, key, ends):
        begun.append(len(starts))
        return [starts] * (1 if ends_at_once else length)

    monkeypatch.setattr(branched_rollouts, "branches", branches)
    monkeypatch.setattr(branched_rollouts, "packed", lambda found: np.zeros((sum(map(len, found)), 10), np.float32))
    _, experience = job(model_buffer_size=100)
    state = SimpleNamespace(actor=None, model=None)
    rows = experience._made_up(experience.agent, state, np.zeros((60, 4)), 40, jax.random.key(0))
    assert begun == [7] * (8 if ends_at_once else 1)  # 60 halved three times
    assert len(rows) == (56 if ends_at_once else 280)


@pytest.mark.slow
def test_several_seeds_are_what_each_is_alone():
    both, experience = job(seeds=(3, 4))
    walk(both)
    alone, single = job(seeds=(4,))
    walk(alone)
    np.testing.assert_allclose(experience.replay.buffer[1], single.replay.buffer[0], atol=1e-4)
    np.testing.assert_allclose(experience._buffer[1], single._buffer[0], atol=1e-3)


@pytest.fixture(scope="module")
def whole():
    fit, _ = job()
    walk(fit)
    return fit


@pytest.mark.slow
@pytest.mark.parametrize("killed", [15, 25])  # where a fit of the model is due, and between two
def test_a_run_goes_on_where_it_stopped(whole, tmp_path, killed):
    paths = [tmp_path / "replay" / "seed0.bin"]
    first, _ = job(paths=paths, folder=tmp_path / "c")
    walk(first, killed)
    second, experience = job(paths=paths, folder=tmp_path / "c")
    second.resume()
    assert 0 < second.step < killed
    assert all(np.isfinite(value).all() for value in experience.metrics.values())  # told from the first chunk on, too
    walk(second)
    for one, other in zip(*map(leaves, (whole, second))):
        np.testing.assert_array_equal(one, other)
    # Files that no checkpoint asks for are gone.
    assert len(list((tmp_path / "replay").glob("*made-up*"))) <= 3
    next((tmp_path / "replay").glob(f"*made-up-{max(experience._batches):06d}.npy")).unlink()
    third, _ = job(paths=paths, folder=tmp_path / "c")
    with pytest.raises(UserError, match="seed0-made-up-000003.npy.*no such file|no file .*seed0-made-up-000003.npy"):
        third.resume()


def test_a_checkpoint_holds_the_rollouts_that_are_still_learned_from(tmp_path):
    """Of more fits between two checkpoints than are kept, those of the first are gone."""
    _, experience = job(paths=[tmp_path / "replay" / "seed0.bin"])
    experience._waiting, experience._batches = [0, 1, 2, 3], {turn: np.full((1, 2, 3), turn) for turn in (2, 3)}
    experience.flush()
    assert sorted(file.name for file in (tmp_path / "replay").glob("*made-up*")) == [
        "seed0-made-up-000002.npy", "seed0-made-up-000003.npy",
    ]  # fmt: skip
    assert experience._waiting == []


def test_damaged_rollouts_are_told(tmp_path, monkeypatch):
    _, experience = job(paths=[tmp_path / "replay" / "seed0.bin"])
    experience._waiting, experience._batches = [0, 1], {turn: np.full((1, 2, 11), turn, np.float32) for turn in (0, 1)}
    experience.flush()
    monkeypatch.setattr(ModelLearning, "restore", lambda self, state: None)
    monkeypatch.setattr(BranchedRollouts, "environment_steps", 70)  # three blocks: the model was fitted twice
    experience.restore({})
    assert experience._batches[1][0, 0, 0] == 1
    file = tmp_path / "replay" / "seed0-made-up-000001.npy"
    whole = file.read_bytes()
    for data, words in ((b"", "cannot be read"), (whole[:-4], "cut short"), (None, "no file|no such file")):
        file.unlink() if data is None else file.write_bytes(data)
        with pytest.raises(UserError, match=words) as told:
            experience.restore({})
        assert str(file) in str(told.value)


def leaves(fit):
    return jax.tree.leaves(fit.states)


@pytest.mark.parametrize(("changes", "words"), [
    ({"model_train_freq": 25}, r"model_train_freq, .* a multiple of block \(10 .*\), got 25"),
    ({"retain_steps": 50}, r"retain_steps \(50\) must be a multiple of model_train_freq \(20\)"),
    ({"rollout_length": (1, 2, 3, 3)}, r"MBPO.rollout_length takes first, last >= first, .* got \(1, 2, 3, 3\)"),
    ({"rollout_length": (15, 1, 20, 100)}, r"MBPO.rollout_length takes first, last >= first, .* got \(15, 1, 20, 100\)"),
    ({"real_ratio": 1.0}, r"MBPO.real_ratio must be in \[0, 1\), got 1"),
    ({"elites": 4}, "MBPO.elites are members at most, got 4 of 3"),
    ({"model_weight_decay": (0.1, 0.1, 0.1)}, "MBPO.model_weight_decay needs 2 numbers, one a layer of the model, got 3"),
])  # fmt: skip
def test_refusals(changes, words):
    with pytest.raises(UserError, match=words):
        job(**changes)


def test_rollouts_may_grow_from_the_first_epoch_on():
    agent = MBPO(rollout_length=(1, 15, 0, 100)).resolve(Spec.empty((11,), task("hopper").action_space, "hopper"), 1)
    assert [agent.rollout_length_at(epoch) for epoch in (0, 50, 100)] == [1, 8, 15]


def test_it_does_not_learn_from_a_log():
    rng = np.random.default_rng(0)
    log = dr.Dataset.from_arrays(
        observations=rng.standard_normal((30, 2)), actions=rng.uniform(-1, 1, (30, 1)), rewards=np.ones(30),
        terminals=np.arange(30) % 10 == 9, name="log",
    )  # fmt: skip
    with pytest.raises(UserError, match="MBPO trains by acting in a simulator, not on a log; use --online --task TASK"):
        dr.train(MBPO(), log, steps=10)
