"""Chapter 4 and appendix A: operators by hand, bounds over thousands of random worlds, counter-examples to what is printed."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.theory import constrained as con
from deadreckon.theory import solve
from deadreckon.theory.tabular import garnets, policies

COUNT = 2000
ITERATIONS = 40
SLACK = 1e-9


def run(function, *arguments, over=None, **static):
    return solve.exactly(function, over=over, static=tuple(static))(*arguments, **static)


@pytest.fixture(scope="module")
def many():
    """Random worlds with a behaviour policy, its support set at a random level, its data, and a discount."""
    rng = np.random.default_rng(0)
    worlds, behavior, discount = garnets(COUNT, rng), policies(COUNT, rng), rng.uniform(0.02, 0.95, COUNT)
    epsilon = rng.uniform(0.0, 1.0, COUNT) * behavior.max(2).min(1)
    sets = np.stack([con.support(b, e) for b, e in zip(behavior, epsilon)])
    data = run(solve.occupancy, worlds.transitions, worlds.initial, behavior, discount, over=(0, 0, 0, 0)).sum(2)
    return worlds, behavior, epsilon, sets, data, discount, rng


@pytest.fixture(scope="module")
def shifts(many):
    """c(k) of the support sets and of the behaviour policies alone."""
    worlds, behavior, _, sets, data, _, _ = many
    shift = solve.exactly(con.concentrability, over=(0, 0, 0, 0))
    return tuple(shift(worlds.transitions, worlds.initial, each, data) for each in (sets, behavior[:, None]))


def errors_of(delta, discount, worlds, sets, rng):
    """(n, k, s, a) errors within ±delta: some random, some always against the best action, some always the same."""
    signs = rng.choice([-1.0, 1.0], (COUNT, ITERATIONS, *delta.shape[1:]))
    signs[::3] = signs[::3, :1]
    best = run(con.fixed_point, worlds.transitions, worlds.rewards, sets, discount, over=(0, 0, 0, 0))
    against = 1.0 - 2.0 * (best == best.max(2, keepdims=True))
    signs[1::3] = against[1::3, None]
    return signs * delta[:, None]


def losses(worlds, sets, discount, errors):
    """Per world and iteration: E_ρ0 |V^{π_k} - V*| and E_ρ0 |V_k - V*|, from Q_0 = Q^Π."""

    def one(transitions, rewards, initial, choices, discount, errors):
        import jax

        first = con.fixed_point(transitions, rewards, choices, discount)
        star = solve.policy_iteration(transitions, rewards, discount).max(1)
        q = con.iterates(transitions, rewards, choices, discount, errors, first)

        def lost(q):
            own = solve.values(transitions, rewards, con.greedy(q, choices), discount)
            return initial @ abs(own - star), initial @ abs(con.best(q, choices) - star)

        return jax.vmap(lost)(q)

    return run(one, *worlds, sets, discount, errors, over=(0,) * 6)


# ---- the operator -----------------------------------------------------------------------------------------------------


def test_sets_of_policies():
    behavior = np.array([[0.7, 0.3, 0.0], [0.2, 0.3, 0.5]])
    q = np.array([[1.0, 2.0, 9.0], [1.0, 2.0, 0.0]])
    assert run(con.best, q, con.support(behavior, 0.3)).tolist() == [2.0, 2.0]
    assert run(con.best, q, con.support(behavior, 0.4)).tolist() == [1.0, 0.0]
    assert run(con.best, q, con.everything(2, 3)).tolist() == [9.0, 2.0]
    np.testing.assert_allclose(run(con.best, q, behavior[None]), [1.3, 0.8])
    assert run(con.greedy, q, con.support(behavior, 0.3)).argmax(1).tolist() == [1, 1]
    with pytest.raises(UserError, match="state 1 has no allowed action"):
        con.support(behavior, 0.6)


@pytest.mark.slow
def test_the_operator_is_bellmans_in_the_modified_world(many):
    """T' E_Π q = E_Π T^Π q for any q; the fixed points agree, and iteration comes to them. Without E_π[r], nothing does."""
    worlds, _, _, sets, _, discount, rng = many
    q = rng.standard_normal(worlds.rewards.shape)
    expected = np.einsum("nksa,nsa->nsk", sets, q)
    moves, pays = run(con.modified, worlds.transitions, worlds.rewards, sets, over=(0, 0, 0))
    left = pays + discount[:, None, None] * np.einsum("nskt,nt->nsk", moves, expected.max(2))
    backed = run(con.backup, worlds.transitions, worlds.rewards, q, sets, discount, over=(0,) * 5)
    np.testing.assert_allclose(left, np.einsum("nksa,nsa->nsk", sets, backed), atol=1e-12)
    fixed = run(con.fixed_point, worlds.transitions, worlds.rewards, sets, discount, over=(0, 0, 0, 0))
    again = run(con.backup, worlds.transitions, worlds.rewards, fixed, sets, discount, over=(0,) * 5)
    np.testing.assert_allclose(fixed, again, atol=1e-10)
    # A contraction, as A.1 says.
    other = run(con.backup, worlds.transitions, worlds.rewards, fixed + q, sets, discount, over=(0,) * 5)
    assert (np.abs(other - again).max((1, 2)) <= discount * np.abs(q).max((1, 2)) + SLACK).all()


def test_concentrability_by_hand_and_by_trying_every_policy():
    """Of two states that any action may choose: c(k) is 1 over the rarer state's share. Else: as found by enumeration."""
    choose = np.zeros((2, 2, 2))
    choose[:, [0, 1], [0, 1]] = 1.0
    data = np.array([0.2, 0.8])
    np.testing.assert_allclose(run(con.concentrability, choose, data, con.everything(2, 2), data, steps=3), [1, 5, 5, 5])
    np.testing.assert_allclose(run(con.concentrability, choose, data, np.tile(data, (1, 2, 1)), data, steps=3), 1.0)
    rng = np.random.default_rng(0)
    world = garnets(1, rng, states=3, actions=2).world(0)
    data = rng.dirichlet(np.ones(3))
    every = [np.eye(2)[list(which)] for which in np.ndindex(2, 2, 2)]
    flows = [np.einsum("sat,sa->st", world.transitions, policy) for policy in every]
    wanted = [(world.initial / data).max(), max((world.initial @ f / data).max() for f in flows)]
    wanted.append(max((world.initial @ f @ g / data).max() for f in flows for g in flows))
    found = run(con.concentrability, world.transitions, world.initial, con.everything(3, 2), data, steps=2)
    np.testing.assert_allclose(found, wanted)
    gone = run(con.concentrability, choose, np.array([0.0, 1.0]), con.everything(2, 2), np.array([0.0, 1.0]), steps=1)
    assert gone.tolist() == [1.0, np.inf]  # the data never saw where a policy may go


def test_one_policy_has_coefficient_one_only_where_its_data_is_stationary():
    """4.2 says "C = 1" for a singleton; from another first state it is larger, and larger than any given number."""
    flip = np.zeros((2, 1, 2))
    flip[0, 0], flip[1, 0] = [0.99, 0.01], [0.5, 0.5]
    alone = np.ones((1, 2, 1))
    stationary = np.array([50 / 51, 1 / 51])
    c = run(con.concentrability, flip, stationary, alone, stationary)
    assert run(con.coefficient, c, 0.9) == pytest.approx(1.0, abs=1e-6)
    elsewhere = run(con.concentrability, flip, np.array([0.0, 1.0]), alone, stationary)
    assert run(con.coefficient, elsewhere, 0.5) > 10.0


# ---- Theorem 4.2.1 ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_loss_of_constrained_iteration_is_bounded(many, shifts):
    worlds, _, _, sets, data, discount, rng = many
    delta = rng.exponential(0.1, worlds.rewards.shape) * rng.choice([0.0, 1.0, 3.0], worlds.rewards.shape)
    greedy, value = losses(worlds, sets, discount, errors_of(delta, discount, worlds, sets, rng))
    error = run(con.worst_error, delta, sets, data, over=(0, 0, 0))
    gap = run(con.suboptimality, worlds.transitions, worlds.rewards, sets, discount, over=(0, 0, 0, 0))
    wide = run(con.coefficient, shifts[0], discount, over=(0, 0))
    bound = con.loss_bound(wide, error, gap, discount)
    assert np.isfinite(bound).all()
    assert (greedy.max(1) <= bound + SLACK).all()
    assert (value.max(1) <= run(con.value_bound, shifts[0], error, gap, discount, over=(0,) * 4) + SLACK).all()
    assert (greedy.max(1) > 0.0).mean() > 0.5  # there is something to bound


@pytest.mark.slow
def test_what_a_set_costs_is_bounded(many):
    """V* - V^Π <= α_V / (1 - γ); Q* - Q^Π <= α / (1 - γ), which is all that the printed constant bounds: of V it fails."""
    worlds, _, _, sets, _, discount, _ = many
    arguments = worlds.transitions, worlds.rewards, sets, discount
    star = run(solve.policy_iteration, worlds.transitions, worlds.rewards, discount, over=(0, 0, 0))
    fixed = run(con.fixed_point, *arguments, over=(0,) * 4)
    lost = (star.max(2) - run(con.best, fixed, sets, over=(0, 0))).max(1)
    right = run(con.suboptimality, *arguments, over=(0,) * 4) / (1.0 - discount)
    printed = run(con.printed_suboptimality, *arguments, over=(0,) * 4) / (1.0 - discount)
    assert (lost <= right + SLACK).all()
    assert (np.abs(star - fixed).max((1, 2)) <= printed + SLACK).all()
    assert (lost > printed + 1e-6).mean() > 0.05
    # One state whose better action is not in the set: the gap is lost at every step, so both are as large as can be.
    one = np.ones((1, 2, 1)), np.array([[0.0, 1.0]]), con.supported(np.array([[True, False]])), 0.4
    assert run(con.suboptimality, *one) / 0.6 == pytest.approx(1.0 / 0.6)
    assert run(con.printed_suboptimality, *one) / 0.6 == pytest.approx(0.4 / 0.6)  # of a loss of 1 / 0.6


def two_arms(discount, delta=0.5, steps=5):
    """Loss and bounds where one state has arms that pay 0 and (almost) 2 delta, and errors of +delta and -delta."""
    transitions, rewards = np.ones((1, 2, 1)), np.array([[0.0, 2 * delta - 1e-9]])
    arguments = transitions, rewards, con.everything(1, 2), discount
    errors = np.tile([[delta, -delta]], (steps, 1, 1))
    q = run(con.iterates, *arguments, errors, run(con.fixed_point, *arguments))[-1]
    greedy = run(con.greedy, q, arguments[2])
    lost = rewards.max() / (1 - discount) - run(solve.values, transitions, rewards, greedy, discount)[0]
    c = run(con.concentrability, transitions, np.ones(1), arguments[2], np.ones(1))
    return lost, run(con.coefficient, c, discount), run(con.printed_coefficient, c, discount), delta


@pytest.mark.parametrize(("discount", "fails"), [(0.1, True), (0.6, True), (0.7, False)])
def test_two_arms_break_the_printed_bound(discount, fails):
    """They lose 2 δ / (1 - γ); γ δ / (1 - γ)² is less for γ < 2/3, and 2 γ δ / (1 - γ)², the proof's, for γ < 1/2."""
    lost, own, printed, delta = two_arms(discount)
    assert lost == pytest.approx(2 * delta / (1 - discount), rel=1e-6)
    assert printed == pytest.approx(1.0, abs=1e-6)
    assert (lost > con.printed_loss_bound(printed, delta, 0.0, discount) + 1e-6) == fails
    assert (lost > 2 * con.printed_loss_bound(printed, delta, 0.0, discount) + 1e-6) == (discount < 0.5)
    assert lost <= con.loss_bound(own, delta, 0.0, discount)


def test_the_factors_of_the_corrected_bound_are_needed():
    lost, own, _, delta = two_arms(0.01)
    assert lost > 0.95 * con.loss_bound(own, delta, 0.0, 0.01)
    # Of the iterates themselves: one arm whose error has one sign.
    q = run(con.iterates, np.ones((1, 1, 1)), np.zeros((1, 1)), np.ones((1, 1, 1)), 0.8, np.ones((200, 1, 1)), np.zeros((1, 1)))
    assert q[-1, 0, 0] > 0.999 * run(con.value_bound, np.ones(401), 1.0, 0.0, 0.8)
    assert q[-1, 0, 0] > con.printed_loss_bound(1.0, 1.0, 0.0, 0.1)  # A.2.1 prints |V_k - V*|, which fails for γ < 1/2


# ---- Theorem 4.2.2 ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_coefficient_of_a_support_set_is_bounded(many, shifts):
    worlds, _, epsilon, sets, data, discount, _ = many
    come = run(con.reachable, worlds.transitions, worlds.initial, sets, over=(0, 0, 0))
    least = np.where(come, data, np.inf).min(1)
    wide, narrow = shifts
    steps = np.arange(wide.shape[1])
    assert (wide <= narrow + np.minimum(1.0, steps * (1 - epsilon[:, None])) / least[:, None] + 1e-6).all()
    printed, own = (run(con.printed_coefficient, c, discount, over=(0, 0)) for c in (wide, narrow))
    assert (printed <= con.support_bound(own, least, epsilon, discount) * (1 + 1e-6)).all()
    assert (con.support_bound(own, least, epsilon, discount) <= own + 1.0 / least).all()  # it says something
    shifted = [run(con.coefficient, c, discount, over=(0, 0)) for c in (wide, narrow)]
    assert (shifted[0] <= con.shifted_support_bound(shifted[1], least, epsilon, discount) * (1 + 1e-6)).all()


def choosing(epsilon, discount):
    """C(Π_ε), C(β) and f where the next state is the action, and β, ρ0 and μ are (ε, 1 - ε)."""
    choose = np.zeros((2, 2, 2))
    choose[:, [0, 1], [0, 1]] = 1.0
    data = np.array([epsilon, 1 - epsilon])
    beta = np.tile(data, (2, 1))
    sets = con.support(beta, epsilon), beta[None]
    found = [run(con.printed_coefficient, run(con.concentrability, choose, data, s, data), discount) for s in sets]
    least = data[run(con.reachable, choose, data, sets[0])].min()
    return *found, least


@pytest.mark.parametrize(
    ("discount", "printed"), [(0.05, 1.47), (0.1, 2.0), (0.4, 7.0), (0.499, 9.96), (0.501, 10.04), (0.6, 14.5), (0.9, 82.0)]
)
def test_a_counter_example_to_the_printed_theorem(discount, printed):
    """C(Π) = 1 / ε against 1 + γ / (1 - γ) (1 - ε) / ε: too little for γ < 1/2, and for no other γ."""
    wide, own, least = choosing(0.1, discount)
    fails = discount < 0.5
    assert con.printed_support_bound(own, least, 0.1, discount) == pytest.approx(printed, abs=0.005)
    assert (wide, own, least) == (pytest.approx(10.0, abs=1e-5), pytest.approx(1.0, abs=1e-6), 0.1)
    assert (wide > con.printed_support_bound(own, least, 0.1, discount) + 1e-6) == fails
    assert wide <= con.support_bound(own, least, 0.1, discount)


def test_the_added_term_is_needed():
    wide, own, least = choosing(0.1, 0.01)
    assert wide > own + 0.95 * (con.support_bound(own, least, 0.1, 0.01) - own)


def test_states_that_policies_come_to():
    ring = np.zeros((4, 2, 4))
    for s in range(4):
        ring[s, 0, s], ring[s, 1, (s + 1) % 4] = 1.0, 1.0
    start = np.eye(4)[0]
    assert run(con.reachable, ring, start, con.everything(4, 2)).all()
    allowed = np.array([[True, True], [True, False], [True, True], [True, True]])
    assert run(con.reachable, ring, start, con.supported(allowed)).tolist() == [True, True, False, False]
