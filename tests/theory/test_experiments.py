"""The small worlds behind the pictures: errors on a grid, a diverging projection, stitching, Algorithm 2."""

import numpy as np
import pytest

from deadreckon.theory import branching, constrained, fitted, monotonic, propagation, solve
from deadreckon.theory.tabular import garnets, policies

# ---- Figure 4.2 -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def on():
    return propagation.grid(5, 5, rows=500)


@pytest.mark.slow
def test_errors_on_a_grid():
    on = propagation.grid()
    found = propagation.propagate(on, 0.3, shown=(1, 60), draws=40)
    assert found.best == pytest.approx(on.world.initial @ on.world.optimal(0.9).max(1))
    # Where the data has next to nothing, maximisation takes errors for values; within the support it does not.
    late = {name: errors[1] for name, errors in found.errors.items()}
    assert late["unconstrained"].mean() > 1.3 * late["support"].mean()
    assert found.returns["support"] > found.returns["unconstrained"] > found.returns["behaviour"]
    # Without errors iteration comes to the fixed points.
    exact = propagation.Grid(**{**vars(on), "delta": np.zeros_like(on.delta)})
    none = propagation.propagate(exact, 0.3, shown=(300,), draws=1)
    np.testing.assert_allclose(none.errors["unconstrained"][0], 0.0, atol=1e-9)
    assert none.returns["unconstrained"] == pytest.approx(none.best)
    sets = constrained.support(on.behavior, 0.3)
    own = solve.exactly(constrained.fixed_point)(on.world.transitions, on.world.rewards, sets, 0.9)
    np.testing.assert_allclose(none.errors["support"][0], on.world.optimal(0.9) - own, atol=1e-9)


@pytest.mark.slow
def test_a_threshold_trades_one_constant_for_the_other(on):
    trade = propagation.tradeoff(on, thresholds=7, draws=30, steps=60)
    assert (np.diff(trade.coefficient) <= 1e-6).all()
    assert (np.diff(trade.gap) >= -1e-9).all()
    assert trade.gap[0] == 0.0
    assert (trade.worst <= trade.bound).all()
    assert (trade.printed_coefficient <= trade.support_bound).all()
    best = trade.loss.argmin()
    assert 0 < best < 6
    assert trade.loss[best] < 0.8 * min(trade.loss[0], trade.loss[-1])


# ---- chapter 2 and 7 --------------------------------------------------------------------------------------------------


def test_a_projection_makes_iteration_diverge():
    """T contracts by 0.9; with the world's own data so does Π T; with half of the data in state 1 it grows by 1.08."""
    world, features = fitted.doubling()
    first = features.reshape(2, 1)
    for share in (0.0, 0.2, 0.5, 0.9):
        q = fitted.fitted_iterates(world, features, np.array([[share], [1 - share]]), 0.9, first, 20)
        np.testing.assert_allclose(q[1:, 0, 0] / q[:-1, 0, 0], fitted.growth(np.array(share), 0.9))
    assert fitted.growth(np.array(0.0), 0.9) == pytest.approx(0.9)
    assert fitted.growth(np.array(0.5), 0.9) == pytest.approx(1.08)
    # 5/6 is where half and half begins to diverge.
    assert fitted.growth(np.array(0.5), 5 / 6) == pytest.approx(1.0)
    # With a feature for every pair a projection changes nothing.
    table = garnets(1, np.random.default_rng(0)).world(0)
    weight = np.random.default_rng(1).dirichlet(np.ones(18)).reshape(6, 3)
    last = fitted.fitted_iterates(table, np.eye(18), weight, 0.8, np.zeros((6, 3)), 200)[-1]
    np.testing.assert_allclose(last, table.optimal(0.8), atol=1e-9)


def test_projections_are_least_squares():
    rng = np.random.default_rng(0)
    features, weight, target = rng.standard_normal((8, 3)), rng.dirichlet(np.ones(8)), rng.standard_normal(8)
    root = np.sqrt(weight)
    wanted = features @ np.linalg.lstsq(root[:, None] * features, root * target, rcond=None)[0]
    np.testing.assert_allclose(fitted.projection(features, weight) @ target, wanted)


def test_stitching():
    """9 steps from A to C, which neither trajectory has taken; where they part, cloning goes either way."""
    found = fitted.stitching()
    assert found.values["Q-iteration on the log"] == pytest.approx(0.9**8)
    assert found.values["behaviour cloning"] == pytest.approx(0.5 * 0.9**8)
    assert found.values["returns of trajectories from A"] == 0.0
    assert (found.stitched[0], found.stitched[-1]) == (found.start, found.end)
    assert found.meeting in found.stitched
    assert all(not set(found.stitched) <= set(way) for way in found.ways)


# ---- Algorithm 2 ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_best_policy_within_a_distance():
    q, old = np.array([[1.0, 3.0, 2.0]]), np.array([[0.5, 0.2, 0.3]])
    within = solve.exactly(monotonic.within)
    np.testing.assert_allclose(within(q, old, 0.0), old)
    np.testing.assert_allclose(within(q, old, 0.4), [[0.1, 0.6, 0.3]])
    np.testing.assert_allclose(within(q, old, 0.6), [[0.0, 0.8, 0.2]])
    np.testing.assert_allclose(within(q, old, 1.0), [[0.0, 1.0, 0.0]])
    # None of many policies at that distance is better in a whole world.
    rng = np.random.default_rng(0)
    world, base = garnets(1, rng).world(0), policies(1, rng)[0]
    best = solve.exactly(monotonic.best_within)(world.transitions, world.rewards, base, 0.3, 0.9)
    assert branching.policy_divergence(base, best) <= 0.3 + 1e-12
    for other in policies(300, rng):
        near = base + 0.3 / max(branching.policy_divergence(base, other), 0.3) * (other - base)
        assert world.value(near, 0.9) <= world.value(best, 0.9) + 1e-9


@pytest.mark.slow
def test_the_printed_penalty_holds_every_policy_where_it_is():
    """In 2,000 worlds no radius gains as much in the model as C grows: the old policy is the maximum."""
    rng = np.random.default_rng(0)
    worlds, old = garnets(2000, rng, states=4, actions=2), policies(2000, rng, states=4, actions=2)
    discount, radii = rng.uniform(0.05, 0.6, 2000), np.array([0.0, 0.01, 0.3, 1.0])
    run = solve.exactly(monotonic._candidates, over=(0, 0, 0, 0, None, 0))
    found, estimated = run(worlds.transitions, worlds.rewards, worlds.initial, old, radii, discount)
    far = np.minimum(branching.policy_divergence(old[:, None], found), 1.0)
    r_max = np.abs(worlds.rewards).max((1, 2))[:, None]
    gain = estimated - estimated[:, :1]
    assert (gain[far > 1e-9] > 0.0).mean() > 0.5
    for penalty, moves in ((branching.full_bound, False), (branching.sharp_full_bound, True)):
        cost = penalty(0.0, far, discount[:, None], r_max) - penalty(0.0, far[:, :1], discount[:, None], r_max)
        assert (gain > cost + 1e-9).any() == moves


def test_improvement_is_monotonic_where_promises_are_kept():
    rng = np.random.default_rng(3)
    worlds = garnets(4, rng, states=4, actions=2)
    gained = 0.0
    for i in range(4):
        world = worlds.world(i)
        course = monotonic.improve(world, 0.2, branching.sharp_full_bound, epochs=3, rows=300, keep=True, seed=i)
        assert (np.diff(course.returns) >= -1e-12).all()
        # A policy is worth its score.
        moved = course.distances > 0
        assert (course.returns[1:] >= course.scores - 1e-9)[moved].all()
        gained += course.returns[-1] - course.returns[0]
        still = monotonic.improve(world, 0.2, branching.full_bound, epochs=2, rows=300, seed=i)
        assert (still.distances == 0).all()
    assert gained > 0.05
