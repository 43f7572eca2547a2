"""What ratios of occupancies assume: that observations hold all that matters, and that no row is left out selectively."""

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.ope import OPEInput
from deadreckon.ope.decide import decide
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.estimand import Estimand
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.markov import hidden_state, left_out
from deadreckon.policies.policy import BlackBoxPolicy
from tests.ope.test_decide import constant

DRL = DoublyRobust(kind="marginal", fqe=LinearFQE())


def log_of(actions, rewards, lengths=None, ended=True, seen=None, seed=0):
    """Episodes with an observation that takes three values and means nothing; actions and rewards are (episodes, steps)."""
    count, steps = actions.shape
    kept = np.arange(steps) < (np.full(count, steps) if lengths is None else lengths)[:, None]
    ends = np.arange(steps) == kept.sum(1)[:, None] - 1
    seen = np.random.default_rng(seed + 10_000).integers(0, 3, actions.shape) if seen is None else seen
    return Dataset.from_arrays(
        observations=seen[kept][:, None].astype(float), actions=actions[kept], rewards=rewards[kept],
        **{"terminals" if ended else "timeouts": ends[kept]},
    )  # fmt: skip


def stepwise(chances, seed=0, seen=None):
    """Rewards fall from step to step, whatever the action, whose probability changes with the step."""
    rng = np.random.default_rng(seed)
    shape = (400, len(chances))
    actions = (rng.random(shape) < np.asarray(chances)).astype(int)
    return log_of(actions, (np.arange(shape[1])[::-1] / 2) + rng.normal(size=shape), seed=seed, seen=seen)


def doubt_of(log, discount=0.99, **options):
    case = OPEInput(log, [constant([0.1, 0.9])], logged=True, discount=discount, **options)
    return hidden_state(case, DRL.nuisances(case)[0].errors)


def test_a_step_that_decides_actions_and_rewards_is_a_confounder():
    """The gain of more of the early action was estimated as 8.5 [6.5, 10.4], and deployed; it is 0."""
    log = stepwise(np.linspace(0.7, 0.3, 8))
    assert "depends on the step of the episode" in doubt_of(log)
    found = decide(OPEInput(log, [constant([0.1, 0.9])], logged=True, discount=0.99))
    assert found.estimates[0].method == "DRL"
    assert found.choice.gains[0, 1] > 0
    assert not found.choice.deploy
    assert "add the step as a column" in found.choice.reason


def test_a_step_that_actions_do_not_depend_on_and_one_that_is_observed_are_none():
    assert doubt_of(stepwise(np.full(8, 0.5))) is None
    steps = np.tile(np.arange(8), (400, 1))
    assert doubt_of(stepwise(np.linspace(0.7, 0.3, 8), seen=steps)) is None


def tired(memory, seed=0):
    """An action pays less after itself."""
    rng = np.random.default_rng(seed)
    actions = (rng.random((300, 6)) < 0.5).astype(int)
    before = np.concatenate([np.zeros((300, 1), int), actions[:, :-1]], 1)
    return log_of(actions, actions - memory * before + rng.normal(size=actions.shape), seed=seed)


def test_effects_of_the_previous_action_need_it_as_a_column():
    assert "depends on the previous action" in doubt_of(tired(0.8))
    for seed in range(5):
        assert doubt_of(tired(0.0, seed)) is None
    assert doubt_of(tired(0.05)) is None  # too weak to matter


def wearing(kind, seed=0, episodes=130):
    """An action pays, and costs more over its episode: by a slow fatigue, four steps later, or not."""
    rng = np.random.default_rng(seed)
    actions = (rng.random((episodes, 25)) < 0.5).astype(int)
    rewards = 1 + 0.3 * actions + 0.6 * rng.normal(size=actions.shape)
    if kind == "fatigue":
        tired = np.zeros(episodes)
        for step in range(25):
            rewards[:, step] -= 0.07 * tired
            tired = 0.9 * tired + actions[:, step]
    if kind == "late":
        rewards[:, 4:] -= 0.5 * actions[:, :-4]
    return log_of(actions, rewards, seed=seed, ended=False)


@pytest.mark.parametrize("kind", ["fatigue", "late"])
def test_effects_of_earlier_actions_need_them_as_columns(kind):
    """More of the action was deployed with a gain of 1.6 and 1.8, where it loses 0.8."""
    assert sum("depends on earlier actions" in (doubt_of(wearing(kind, seed)) or "") for seed in range(5)) >= 4
    found = decide(OPEInput(wearing(kind), [constant([0.1, 0.9])], logged=True, discount=0.99))
    assert not found.choice.deploy
    assert "add how often each action was taken before in the episode as columns" in found.choice.reason


def test_rewards_of_an_action_alone_are_no_effect_of_earlier_ones():
    assert [doubt_of(wearing("none", seed)) for seed in range(6)] == [None] * 6


def test_effects_of_the_previous_action_that_cancel_over_actions_are_found():
    """An action that is worth more if it is another one: a policy that repeats itself was deployed, and is worse."""
    rng = np.random.default_rng(0)
    actions = rng.integers(0, 2, (500, 6))
    before = np.concatenate([rng.integers(0, 2, (500, 1)), actions[:, :-1]], 1)
    log = log_of(actions, (actions != before) + 0.2 * actions + 0.5 * rng.normal(size=actions.shape))
    assert "depends on the previous action" in doubt_of(log)


def test_effects_of_the_step_that_cancel_over_observations_are_found():
    rng = np.random.default_rng(0)
    seen, time = rng.integers(0, 2, (600, 8)), np.arange(8) / 7
    actions = (rng.random((600, 8)) < np.where(seen == 1, 0.7 - 0.4 * time, 0.3 + 0.4 * time)).astype(int)
    rewards = np.where(seen == 1, 1, -1) * (1 - 2 * time) + rng.normal(size=(600, 8))
    assert "depends on the step of the episode" in doubt_of(log_of(actions, rewards, seen=seen))


def test_a_behaviour_policy_with_a_memory_is_no_hidden_state():
    """Three policies take turns, or one improves with the step; observations hold all that matters for what follows."""
    rng = np.random.default_rng(1)
    count, steps = 400, 8
    paths, gains = rng.dirichlet(np.ones(6), (6, 2)), rng.normal(size=(6, 2))
    for kind in ("turns", "step"):
        seen, actions = np.zeros((count, steps), int), np.zeros((count, steps), int)
        seen[:, 0] = rng.integers(0, 6, count)
        for t in range(steps):
            chance = np.array([0.2, 0.5, 0.8])[np.arange(count) % 3] if kind == "turns" else 0.2 + 0.6 * t / steps
            actions[:, t] = rng.random(count) < np.where(seen[:, t] % 2 == 0, chance, 1 - chance)
            if t + 1 < steps:
                cut = paths[seen[:, t], actions[:, t]].cumsum(1)
                seen[:, t + 1] = (rng.random(count)[:, None] > cut).sum(1).clip(0, 5)
        rewards = gains[seen, actions] + 0.5 * rng.normal(size=seen.shape)
        lengths = 1 + rng.geometric(0.2, count).clip(1, steps - 1)  # ends by chance, in no observation's favour
        assert doubt_of(log_of(actions, rewards, lengths, seen=seen), 0.95) is None


def sessions(seed, rewards_end=0.0, stops=(0.3, 0.3)):
    """Sessions that end by chance, more often after some actions, without a terminal."""
    rng = np.random.default_rng(seed)
    actions = rng.integers(0, 2, (600, 12))
    stop = rng.random(actions.shape) < np.asarray(stops)[actions]
    stop[:, -1] = True
    lengths = stop.argmax(1) + 1
    rewards = rng.normal(size=actions.shape)
    rewards[np.arange(600), lengths - 1] += rewards_end * (actions[np.arange(600), lengths - 1] == 0)
    return log_of(actions, rewards, lengths, ended=False, seed=seed)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ({}, None),
        ({"rewards_end": 3.0}, "are left out, and their rewards differ from those of other rows"),
        ({"stops": (0.2, 0.5)}, "recordings that end without a terminal do so after action 1, where "),
        ({"stops": (0.5, 0.2)}, "recordings that end without a terminal do so after action 0, where "),
    ],
)
def test_rows_that_are_left_out_must_be_like_the_others(made, words):
    for seed in range(3):
        case = OPEInput(sessions(seed, **made), [constant([0.1, 0.9])], logged=True, discount=0.9)
        found = left_out(case)
        assert found is None if words is None else words in found
        if words is not None and seed == 1:
            assert words in "; ".join(decide(case).choice.objections[0])
    horizon = left_out(OPEInput(sessions(0, **made), [constant([0.1, 0.9])], logged=True, discount=0.9, horizon=3))
    assert (horizon is None) == ("stops" not in made)  # what follows an end before it is not known either
    assert horizon is None or "--horizon" not in horizon


def falling(seed, chances=(0.002, 0.012), episodes=130, steps=25):
    """An action pays, and ends some episodes for good, without a terminal; most end with their recording."""
    rng = np.random.default_rng(seed)
    actions = rng.integers(0, 2, (episodes, steps))
    fell = rng.random(actions.shape) < np.asarray(chances)[actions]
    fell[:, -1] = True
    rewards = 1 + 0.15 * actions + 0.3 * rng.normal(size=actions.shape)
    return log_of(actions, rewards, fell.argmax(1) + 1, ended=False, seed=seed)


def test_few_ends_that_do_not_depend_on_a_common_action_are_none():
    """Where no end lacks the action by chance, their scatter says nothing."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        actions = (rng.random((200, 25)) < 0.8).astype(int)
        stop = rng.random(actions.shape) < 0.0025
        stop[:, -1] = True
        log = log_of(actions, rng.normal(size=actions.shape), stop.argmax(1) + 1, ended=False, seed=seed)
        assert left_out(OPEInput(log, [constant([0.1, 0.9])], logged=True, discount=0.99)) is None


def test_ends_of_a_state_and_of_a_step_are_not_those_of_their_action():
    """An action that is frequent where episodes end prevents ends there, and one that is taken late is no reason for ends."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        shape = (600, 25)
        seen = rng.integers(0, 3, shape)
        actions = (rng.random(shape) < np.where(seen == 2, 0.9, 0.1)).astype(int)
        stop = rng.random(shape) < np.where(seen == 2, np.where(actions == 1, 0.03, 0.15), 0.0)
        stop[:, -1] = True
        log = log_of(actions, rng.normal(size=shape), stop.argmax(1) + 1, ended=False, seen=seen)
        line = left_out(OPEInput(log, [constant([0.1, 0.9])], logged=True, discount=0.99))
        assert line is None or "after action 0" in line
        actions = (rng.random((300, 32)) < np.arange(32) / 40).astype(int)  # more and more often
        log = log_of(actions, rng.normal(size=actions.shape), rng.integers(20, 32, 300), ended=False)
        assert left_out(OPEInput(log, [constant([0.1, 0.9])], logged=True, discount=0.99)) is None


def test_few_ends_after_an_action_among_those_of_recordings_are_found():
    """The action was deployed with a gain of 2.2; with what it ends it loses 3.4."""
    found = []
    for seed in range(8):
        case = OPEInput(falling(seed, (0.0, 0.014)), [constant([0.1, 0.9])], logged=True, discount=0.99)
        found.append("if ends did not depend on it" in (left_out(case) or ""))
        assert left_out(OPEInput(falling(seed, (0.007, 0.007)), [constant([0.1, 0.9])], logged=True, discount=0.99)) is None
    assert sum(found) >= 6
    case = OPEInput(falling(0, (0.0, 0.014)), [constant([0.1, 0.9])], logged=True, discount=0.99)
    assert not decide(case).choice.deploy
    early = OPEInput(falling(0, (0.0, 0.014)), [constant([0.1, 0.9])], logged=True, discount=0.99, horizon=25)
    assert "if ends did not depend on it" in left_out(early)


def test_losses_that_rows_of_longer_episodes_lack_by_chance():
    """A rare loss, whatever the action: where no row with the rarer action has one, its gain was deployed."""
    met = 0
    for seed in range(1000, 1020):  # one in four
        rng = np.random.default_rng(seed)
        actions, loss = (rng.random((800, 5)) < 0.1).astype(int), rng.random((800, 5)) < 0.003
        if loss[actions == 1].any():
            continue
        case = OPEInput(
            log_of(actions, 0.2 * rng.normal(size=actions.shape) - 20 * loss, seed=seed), [constant([0.0, 1.0])], logged=True
        )  # fmt: skip
        found = decide(case).choice
        assert not found.deploy
        met += found.low > 0
        assert found.low <= 0 or "this happens by chance in" in found.reason
        if met:
            break
    assert met


def test_losses_of_whole_episodes_that_few_episodes_lack_by_chance():
    """An arm of few episodes, which is observed; losses in all steps of two in a hundred, whatever the arm."""
    met = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        arm = rng.random(600) < 0.06
        lost = rng.random(600) < 0.03
        if lost[arm].any():
            continue
        actions = np.where(np.arange(6) == 0, arm[:, None], rng.integers(0, 2, (600, 6)))
        seen = np.where(np.arange(6) == 0, 0, 1 + arm[:, None])
        rewards = 0.1 * rng.normal(size=(600, 6)) - 5.0 * lost[:, None]
        first = BlackBoxPolicy(None, action_probs=lambda x: np.where(x == 0, [[0.0, 1.0]], 0.5))
        found = decide(OPEInput(log_of(actions, rewards, seen=seen), [first], logged=True)).choice
        assert not found.deploy
        met += "this happens by chance in" in found.reason
        if met:
            break
    assert met


def test_a_few_shorter_recordings_do_not_change_the_horizon():
    rng = np.random.default_rng(0)
    actions, lengths = rng.integers(0, 2, (100, 8)), np.full(100, 8)
    lengths[:4] = 7
    assert Estimand.of(log_of(actions, rng.normal(size=(100, 8)), lengths, ended=False), 0.99).horizon == 8
    lengths[:10] = 7
    assert Estimand.of(log_of(actions, rng.normal(size=(100, 8)), lengths, ended=False), 0.99).horizon is None
