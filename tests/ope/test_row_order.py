"""Rows of episodes that are not in the order of time, and rewards that stand one row early."""

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.ope import OPEInput
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.decide import decide
from deadreckon.ope.row_order import out_of_order
from deadreckon.policies import BlackBoxPolicy

from .test_over_time import OFTEN, SELDOM, constant

MODEL = BehaviorModel(hidden=(16,), steps=300, lr=1e-2)


def walk(seed, kind="plain", episodes=130, steps=20):
    """A level that an action raises and that costs something, and a number of no use: (episodes, steps, ...) arrays.

    The behaviour policy acts by the level (`plain`), by it and its last action (`sticky`, `hysteresis`), by a habit of its
    episode (`habits`), by what it measures of the level (`measured`), or by its last reward (`reacts`).
    """
    rng = np.random.default_rng(seed)
    seen, taken, rewards = [], [], []
    level, other, last, reward = (rng.normal(size=episodes) for _ in range(4))
    last = (last > 0).astype(int)
    habit = np.where(np.arange(episodes) % 2, 1.4, -1.4)
    for _ in range(steps):
        shown = level + (rng.normal(size=episodes) if kind == "measured" else 0.0)
        odds = {
            "sticky": 3 * (last - 0.5) + shown, "habits": habit, "reacts": 4 * reward,
            "hysteresis": np.where(np.abs(shown) > 0.7, 9 * shown, 6 * (last - 0.5)),
        }.get(kind, shown)  # fmt: skip
        action = (rng.random(episodes) < 1 / (1 + np.exp(-odds))).astype(int)
        reward = 0.5 * action - 0.3 * level + 0.5 * rng.normal(size=episodes)
        seen.append(np.stack([shown, other], 1))
        taken.append(action)
        rewards.append(reward)
        level = 0.9 * level + 0.6 * (action - 0.5) + 0.4 * rng.normal(size=episodes)
        other, last = 0.5 * other + rng.normal(size=episodes), action
    return [np.stack(each, 1) for each in (seen, taken, rewards)]


def case_of(seen, taken, rewards, **options):
    episodes, steps = taken.shape
    ends = np.tile(np.arange(steps) == steps - 1, episodes)
    log = Dataset.from_arrays(
        observations=seen.reshape(episodes * steps, -1), actions=taken.ravel(), rewards=rewards.ravel(), timeouts=ends,
        terminals=np.zeros(len(ends)), **options,
    )  # fmt: skip
    return OPEInput(log, [OFTEN, SELDOM], names=["often", "seldom"], logged=True, discount=0.9)


@pytest.mark.parametrize("kind", ["plain", "sticky", "hysteresis", "habits", "measured"])
def test_rows_in_the_order_of_time_are_not_doubted(kind):
    for seed in range(2):
        assert out_of_order(case_of(*walk(seed, kind)), MODEL) is None


def test_a_column_that_is_the_same_in_all_rows_of_an_episode_tells_no_order():
    """What least squares leave of it is rounding, which tells the previous action, and this the next one."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        taken = np.zeros((130, 20), int)
        for step in range(1, 20):
            taken[:, step] = np.where(rng.random(130) < 0.9, taken[:, step - 1], 1 - taken[:, step - 1])
        same = np.repeat(rng.integers(20, 80, (130, 1, 1)).astype(float), 20, 1)
        assert out_of_order(case_of(same, taken, rng.normal(size=taken.shape)), MODEL) is None


def test_continuous_actions_with_a_noise_that_lasts_are_not_doubted():
    """Their noise is known of the last action by the observation that it was taken at."""
    normal = BlackBoxPolicy(
        lambda seen, rng: np.tanh(rng.normal(seen, 0.5)),
        lambda seen, actions: -2 * np.square(np.arctanh(actions) - seen).sum(1) - np.log1p(-np.square(actions)).sum(1) - 0.226,
    )
    rng = np.random.default_rng(0)
    level, noise, seen, taken, rewards = np.zeros(150), np.zeros(150), [], [], []
    for _ in range(20):
        action = np.tanh(level + noise)
        seen.append(level[:, None])
        taken.append(action)
        rewards.append(-np.square(level) + 0.3 * action + 0.2 * rng.normal(size=150))
        level = 0.9 * level + 0.1 * action + 0.3 * rng.normal(size=150)
        noise = 0.85 * noise + 0.3 * rng.normal(size=150)
    seen, taken, rewards = (np.stack(each, 1) for each in (seen, taken, rewards))
    for early in (False, True):
        own = rewards[:, 1:] if early else rewards[:, :-1]
        flat = case_of(seen[:, :-1], taken[:, :-1], own + (3 * taken[:, 1:] if early else 0.0))
        case = OPEInput(flat.given, [normal], logged=True, discount=0.9)
        assert (out_of_order(case, MODEL) is not None) == early


def test_what_goes_with_the_last_action_alone_is_not_of_earlier_rows():
    """A behaviour policy that mostly repeats its last action, which the last reward shows, too."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        seen, taken, _ = walk(seed, "sticky")
        for step in range(1, taken.shape[1]):
            taken[:, step] = np.where(rng.random(len(taken)) < 0.9, taken[:, step - 1], taken[:, step])
        rewards = taken + 0.3 * rng.normal(size=taken.shape)
        assert out_of_order(case_of(seen, taken, rewards), MODEL) is None


def test_rows_whose_newest_comes_first_are_an_objection():
    for seed in range(2):
        case = case_of(*(each[:, ::-1] for each in walk(seed)))
        line = out_of_order(case, MODEL)
        assert " goes with observation 0 of the row before (p < 0.001), beyond what its own row shows: rows may not" in line
        assert "(--time)" in line
        assert "(--history 2)" in line
    placed = OPEInput(case.given, [OFTEN], logged=True, discount=0.9, positions=True)
    assert " goes with observation 0 of the row before" in out_of_order(placed, MODEL)
    assert any("of the row before" in each for each in decide(case, model=MODEL).choice.objections[0])


def test_rows_that_are_mixed_within_many_episodes_are_an_objection():
    for seed in range(2):
        columns = walk(seed, episodes=400, steps=10)
        mixed = np.argsort(np.random.default_rng(seed).random(columns[1].shape), 1)
        columns = [np.take_along_axis(each, mixed[..., None] if each.ndim == 3 else mixed, 1) for each in columns]
        assert "of the row before" in out_of_order(case_of(*columns), MODEL)


@pytest.mark.parametrize("steps", [5, 20])
def test_rewards_that_stand_one_row_early_are_an_objection(steps):
    seen, taken, rewards = walk(0, episodes=3000 // steps, steps=steps)
    line = out_of_order(case_of(seen[:, :-1], taken[:, :-1], rewards[:, 1:]), MODEL)
    assert "goes with the reward of the row before (p < 0.001)" in line
    assert "rewards may stand one row early" in line
    assert out_of_order(case_of(seen[:, :-1], taken[:, :-1], rewards[:, :-1]), MODEL) is None


def test_a_behaviour_policy_that_reacts_to_the_last_reward_needs_it_as_a_column():
    seen, taken, rewards = walk(0, "reacts")
    assert "actions react to the last reward, which then must be a column" in out_of_order(
        case_of(seen, taken, rewards), MODEL
    )
    last = np.concatenate([np.zeros((len(rewards), 1)), rewards[:, :-1]], 1)
    with_it = np.concatenate([seen, last[:, :, None]], 2)
    assert out_of_order(case_of(with_it, taken, rewards), MODEL) is None


def test_logged_propensities_are_those_of_the_rows():
    """With three actions, of which the log tells the probability of the one taken alone."""
    rng = np.random.default_rng(0)
    episodes, steps = 300, 12
    level, seen, taken, rewards, known = np.zeros(episodes), [], [], [], []
    for _ in range(steps):
        chances = np.exp(level[:, None] * [-0.5, 0.0, 0.5])
        chances /= chances.sum(1, keepdims=True)
        action = (rng.random(episodes)[:, None] > chances.cumsum(1)).sum(1)
        seen.append(level[:, None])
        taken.append(action)
        rewards.append(rng.normal(size=episodes) - 0.2 * level)
        known.append(np.log(chances[np.arange(episodes), action]))
        level = 0.7 * level + (action - 1) + 0.5 * rng.normal(size=episodes)
    forward = [np.stack(each, 1) for each in (seen, taken, rewards, known)]
    for order, right in ((slice(None), True), (slice(None, None, -1), False)):
        each, actions, own, logged = (every[:, order] for every in forward)
        case = case_of(each, actions, own, behavior_log_probs=logged.ravel())
        case = OPEInput(case.given, [constant((0.2, 0.3, 0.5))], logged=True, discount=0.9)
        assert (out_of_order(case, MODEL) is None) == right


def test_where_nothing_can_be_said():
    seen, taken, rewards = (each[:, ::-1] for each in walk(0))
    few = case_of(seen[:15], taken[:15], rewards[:15])
    assert out_of_order(few, MODEL) is None
    single = case_of(seen[:, :1], taken[:, :1], rewards[:, :1])
    assert out_of_order(single, MODEL) is None
    episodes, steps = taken.shape
    ends = np.tile(np.arange(steps) == steps - 1, episodes)
    flat = seen.reshape(episodes * steps, -1)
    apart = Dataset.from_arrays(  # next observations of their own
        observations=flat, actions=taken.ravel(), rewards=rewards.ravel(), timeouts=ends, terminals=np.zeros(len(ends)),
        next_observations=flat + 1.0,
    )  # fmt: skip
    assert out_of_order(OPEInput(apart, [OFTEN], discount=0.9), MODEL) is None
