"""Exact solutions against sums by hand and long simulations."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.theory import MDP, chain, garnet, gridworld, solve
from deadreckon.theory.tabular import garnets, policies, softmax


def test_a_chain_by_hand():
    """Without slips, always right: the reward of 1 comes with the last of 5 steps."""
    world = chain(5, slip=0.0)
    right, back = np.tile([0.0, 1.0], (5, 1)), np.tile([1.0, 0.0], (5, 1))
    assert world.value(right, 0.9) == pytest.approx(0.9**4)
    assert world.value(back, 0.9) == 0.0
    np.testing.assert_allclose(world.optimal(0.9)[:, 1], 0.9 ** np.arange(4, -1, -1), atol=1e-9)
    # Each state is seen once, at its own time, and then the episode is over.
    np.testing.assert_allclose(world.occupancy(right, 0.9)[:, 1], 0.1 * 0.9 ** np.arange(5))
    np.testing.assert_allclose(world.visits(right, 3)[:, 1], [1, 1, 1, 0, 0])


WORLDS = {"chain": chain(4), "grid": gridworld(3, 3), "ends": garnet(ending=0.2), "goes on": garnet(seed=1)}


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_solutions_agree_with_each_other(world):
    policy = softmax(np.random.default_rng(0).standard_normal((world.states, world.actions)))
    occupancy = world.occupancy(policy, 0.9)
    assert (occupancy * world.rewards).sum() / 0.1 == pytest.approx(world.value(policy, 0.9))
    long = sum(0.9**t * (world.visits(policy, t + 1) - (world.visits(policy, t) if t else 0)) for t in range(300))
    np.testing.assert_allclose(0.1 * long, occupancy, atol=1e-9)
    best = world.optimal(0.9)
    greedy = np.eye(world.actions)[best.argmax(1)]
    np.testing.assert_allclose(world.q(greedy, 0.9), best, atol=1e-8)


def test_logs_are_what_the_world_does():
    world = garnet(states=5, ending=0.1, noise=0.5)
    policy = softmax(np.random.default_rng(0).standard_normal((5, 3)))
    log = world.log(policy, 4000, 40, np.random.default_rng(1))
    returns = log.returns(0.9)
    assert abs(returns.mean() - world.value(policy, 0.9)) < 4 * returns.std() / np.sqrt(len(returns)) + 0.9**40 * 20
    state, action = log.observations.argmax(1), log.actions
    counts = np.zeros((5, 3))
    np.add.at(counts, (state, action), 1)
    np.testing.assert_allclose(counts / 4000, world.visits(policy, 40), atol=0.25)
    np.testing.assert_allclose(log.extras["behavior_log_probs"], np.log(policy[state, action]), rtol=1e-5)
    assert (log.lengths <= 40).all()
    assert log.timeouts[log.ends][log.lengths < 40].sum() == 0
    # Successors are drawn from the world's transitions, also across what the log leaves implicit.
    following = log.next_observations.argmax(1)
    pair = (state == 2) & (action == 1) & ~log.terminals
    seen = np.bincount(following[pair], minlength=5) / pair.sum()
    np.testing.assert_allclose(seen, world.transitions[2, 1] / world.transitions[2, 1].sum(), atol=0.05)


def test_an_episode_that_has_ended_stays_where_it_was():
    """Its final observation repeats the last one, which says that there is none: a model learns nothing from it."""
    log = garnet(6, 2, 2, ending=0.3, seed=1).log(np.full((6, 2), 0.5), 200, 40, np.random.default_rng(0))
    assert log.terminals.sum() > 150
    np.testing.assert_array_equal(log.next_observations[log.terminals], log.observations[log.terminals])


def test_worlds_that_are_none():
    right = garnet()
    with pytest.raises(UserError, match="sum to at most one"):
        MDP(right.transitions * 1.1, right.rewards, right.initial)
    with pytest.raises(UserError, match=r"need transitions \(10, 3, 10\)"):
        MDP(right.transitions[:, :2], right.rewards, right.initial)
    with pytest.raises(UserError, match="initial must sum to one"):
        MDP(right.transitions, right.rewards, right.initial / 2)


def test_best_values_satisfy_their_equation_and_many_worlds_are_solved_as_one_is():
    rng = np.random.default_rng(0)
    worlds, policy, discounts = garnets(300, rng), policies(300, rng), rng.uniform(0.1, 0.95, 300)
    assert all((world.transitions.sum(-1) == pytest.approx(1.0)) for world in map(worlds.world, range(3)))
    best = solve.exactly(solve.policy_iteration, over=(0, 0, 0))(worlds.transitions, worlds.rewards, discounts)
    assert best.dtype == np.float64
    # The optimality equation itself, in numpy.
    backup = worlds.rewards + discounts[:, None, None] * np.einsum("nsau,nu->nsa", worlds.transitions, best.max(2))
    np.testing.assert_allclose(best, backup, atol=1e-10)
    own = solve.exactly(solve.action_values, over=(0, 0, 0, 0))(worlds.transitions, worlds.rewards, policy, discounts)
    np.testing.assert_allclose(own[7], worlds.world(7).q(policy[7], discounts[7]), atol=1e-12)
    after = np.einsum("nsau,nub,nub->nsa", worlds.transitions, policy, own)
    np.testing.assert_allclose(own, worlds.rewards + discounts[:, None, None] * after, atol=1e-10)
    assert (own <= best + 1e-9).all()
    # Ties are no reason to go on for ever.
    even = MDP(worlds.transitions[0], np.ones((6, 3)), worlds.initial[0])
    np.testing.assert_allclose(even.optimal(0.9), 10.0)


def test_a_grid_with_a_goal_elsewhere():
    """Goal bottom left, from the top left: down, down, and then stay."""
    world = gridworld(3, 3, slip=0.0, goal=6)
    assert world.optimal(0.5).argmax(1)[0] == 2
    assert world.optimal(0.5)[0].max() == pytest.approx(0.5**2 / 0.5)
    assert world.visits(np.eye(4)[np.full(9, 2)], 0).sum() == 0.0
