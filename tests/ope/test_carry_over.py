"""Rows that are read as single decisions although actions change what later rows hold."""

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.ope import OPEInput
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.carry_over import _sorted, carried_over
from deadreckon.ope.decide import decide
from tests.ope.test_balance import continuous
from tests.ope.test_decide import constant

SMALL = BehaviorModel(hidden=(16,), steps=300, lr=1e-2)


def case_of(seen, actions, rewards, held=None, clusters=None):
    """Single steps in the order of a table, and two policies."""
    log = Dataset.from_frame(
        {"x": seen[:, 0], "noise": seen[:, 1], "action": actions, "reward": rewards}, action="action", reward="reward"
    )
    policies = [constant([0.1, 0.9]), constant([0.9, 0.1])]
    return OPEInput(log, policies, discount=0.0, logged=True, held=held, clusters=clusters)


def store(rows=600, seed=0):
    """A store that action 1 empties and action 0 fills, for a price that changes slowly: nothing is gained in the end."""
    rng = np.random.default_rng(seed)
    seen, actions, rewards, full, price = np.empty((rows, 2)), rng.integers(0, 2, rows), np.zeros(rows), 3, 0.0
    for row, action in enumerate(actions):
        price = 0.9 * price + 0.4 * rng.normal()
        seen[row] = full, price
        if action and full > 0:
            rewards[row], full = 3 + price, full - 1
        elif not action and full < 6:
            rewards[row], full = -3 - price, full + 1
    return seen, actions, rewards


def test_a_store_that_is_emptied_is_no_row_of_single_decisions():
    found = decide(case_of(*store()), model=SMALL, stationary=True)
    assert found.choice.low > 0  # of always emptying it
    assert not found.choice.deploy
    assert "goes with column x of the next row (p < 0.001)" in found.choice.reason
    assert "rows may be steps of episodes (--episode)" in found.choice.reason


def test_rows_are_followed_beyond_those_that_are_evaluated():
    held = np.arange(0, 1_500, 5)  # no evaluated row follows another
    found = carried_over(case_of(*store(1_500), held=held), SMALL)
    assert "column x of the next row" in str(found)


def test_machines_that_take_turns_and_rewards_that_come_late():
    seen, actions, rewards = (np.concatenate(each) for each in zip(*(store(400, seed) for seed in range(3))))
    turns = np.arange(1_200).reshape(3, 400).T.reshape(-1)  # the first row of each, the second of each, ...
    found = carried_over(case_of(seen[turns], actions[turns], rewards[turns]), SMALL)
    assert "column x of the row 3 rows later" in str(found)
    rng = np.random.default_rng(0)
    seen, actions, groups = rng.normal(size=(1_200, 2)), rng.integers(0, 2, 1_200), np.arange(1_200) % 40
    late = np.zeros(1_200)
    late[40:] = actions[:-40]  # of the same cluster, 40 rows before
    case = case_of(seen, actions, late + 0.5 * rng.normal(size=1_200), clusters=groups)
    assert "goes with the reward of the next row" in str(carried_over(case, SMALL))
    assert carried_over(case_of(seen, actions, np.asarray(case.given.rewards)), SMALL) is None  # no order shows it


def test_a_slow_effect_is_seen_behind_what_a_row_tells_of_the_next():
    """A heater changes the temperature by a tenth of its deviation."""
    rng = np.random.default_rng(0)
    seen, actions, level = rng.normal(size=(1_500, 2)), rng.integers(0, 2, 1_500), 0.0
    for row, action in enumerate(actions):
        seen[row, 0] = level
        level += 0.1 * action - 0.05 - 0.005 * level + 0.05 * rng.normal()
    assert "column x of the next row" in str(carried_over(case_of(seen, actions, rng.normal(size=1_500)), SMALL))


def independent(kind, seed, rows=800):
    """Rows that follow each other in all but what actions change."""
    rng = np.random.default_rng(seed)
    seen, chance = rng.normal(size=(rows, 2)), np.full(rows, 0.5)
    if kind == "weather":
        seen[:, 0] = np.convolve(rng.normal(size=rows + 49), np.full(50, 1 / 7), "valid")
    chance = 1 / (1 + np.exp(-2 * seen[:, 0]))
    actions = (rng.random(rows) < chance).astype(int)
    if kind == "rotation":
        actions = np.arange(rows) % 2
    if kind == "blocks":
        actions = np.arange(rows) // 12 % 2
    rewards = seen[:, 0] + actions + rng.normal(size=rows)
    if kind.startswith("clicks"):  # their spread differs by action
        actions = np.arange(rows) % 2 if kind == "clicks in turns" else np.arange(rows) // 12 % 2
        rewards = (rng.random(rows) < np.where(actions, 0.3, 0.05)).astype(float)
    order = np.arange(rows)
    if kind == "by action":
        order = np.argsort(actions, kind="stable")
    elif kind == "by reward":
        order = np.argsort(rewards)
    elif kind == "by x and action":
        seen[:, 0] = np.round(4 * seen[:, 0])
        order = np.lexsort((actions, seen[:, 0]))
    return seen[order], actions[order], rewards[order]


KINDS = "weather", "rotation", "blocks", "clicks in turns", "clicks in blocks", "by action", "by reward", "by x and action"


@pytest.mark.parametrize("kind", KINDS)
def test_what_follows_without_the_action_is_no_objection(kind):
    assert carried_over(case_of(*independent(kind, seed=0)), SMALL) is None


@pytest.mark.parametrize("actions", [2, 3])
def test_logged_propensities_account_for_what_is_not_in_the_log(actions):
    """Users of two kinds take turns of ten rows; what they are shown, and what they do, depends on their kind alone."""
    rng = np.random.default_rng(0)
    kind = rng.integers(0, 2, 150).repeat(10)
    chances = np.array([[0.8, 0.1, 0.1], [0.1, 0.3, 0.6]])[:, :actions]
    chances = (chances / chances.sum(1, keepdims=True))[kind]
    taken = (rng.random((1_500, 1)) > chances.cumsum(1)).sum(1).clip(max=actions - 1)
    columns = {"x": kind + 1.5 * rng.normal(size=1_500), "action": taken, "reward": 2.0 * kind + rng.normal(size=1_500)}
    logged = columns | {"propensity": chances[np.arange(1_500), taken]}
    policy = constant(np.full(actions, 1 / actions))
    for frame, alarm in ((columns, True), (logged, False)):
        known = "propensity" if "propensity" in frame else None
        log = Dataset.from_frame(frame, action="action", reward="reward", propensity=known)
        found = carried_over(OPEInput(log, [policy], discount=0.0, logged=True), SMALL)
        assert (found is not None) == alarm
    late = logged | {"reward": np.append(0.0, taken[:-1] == 0) * 3 + rng.normal(size=1_500)}
    log = Dataset.from_frame(late, action="action", reward="reward", propensity="propensity")
    assert "the reward of the next row" in str(carried_over(OPEInput(log, [policy], discount=0.0, logged=True), SMALL))


def test_only_orders_that_sort_actions_are_left_out():
    for kind in ("by action", "by reward", "by x and action"):
        case = case_of(*independent(kind, 0))
        assert _sorted(case.given, np.arange(800), np.asarray(case.given.actions)), kind
    seen, actions, rewards = store()
    seen[:, 1] = np.arange(600) // 24  # the day, which sorts rows, but not their actions
    case = case_of(seen, actions, rewards)
    assert not _sorted(case.given, np.arange(600), np.asarray(case.given.actions))
    assert carried_over(case, SMALL) is not None


def test_continuous_actions_are_followed_by_their_ranks():
    rng = np.random.default_rng(0)
    actions = rng.normal(size=1_000)
    level = np.append(0.0, np.cumsum(actions[:-1])) - 0.05 * np.arange(1_000)
    for moved in (True, False):
        seen = np.stack([level if moved else rng.permutation(level), rng.normal(size=1_000)], 1)
        assert (carried_over(continuous(seen, actions, rng.normal(size=1_000)), SMALL) is not None) == moved
