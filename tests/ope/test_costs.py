"""Totals of costs beside the value, and limits of them: exact worlds, coverage, and what is refused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError
from deadreckon.ope import ImportanceSampling, OPEInput, behavior
from deadreckon.ope.behavior_model import BehaviorModel
from deadreckon.ope.costs import Cost, cost_columns, costs_of, limits_of, totals
from deadreckon.ope.decide import decide
from deadreckon.ope.doubly_robust import DoublyRobust
from deadreckon.ope.estimates import Estimates
from deadreckon.ope.estimator import Estimator
from deadreckon.ope.linear import LinearFQE
from deadreckon.ope.support import Support
from deadreckon.policies import BlackBoxPolicy

CHANCES = np.array([[0.5, 0.5], [0.9, 0.1], [0.2, 0.8]])  # of three policies, whatever is seen; the first made the log


SMALL = BehaviorModel(hidden=(8,), steps=200)


def policy(chances):
    return BlackBoxPolicy(
        lambda seen, rng: rng.choice(2, len(seen), p=chances), action_probs=lambda seen: np.tile(chances, (len(seen), 1))
    )


def bandit(rows: int, seed: int) -> Dataset:
    """One step: action 1 earns 1 and costs 3 in the mean, action 0 earns 0 and costs 1."""
    rng = np.random.default_rng(seed)
    action = rng.integers(0, 2, rows)
    return Dataset.from_arrays(
        observations=rng.normal(size=(rows, 2)), actions=action, rewards=action + rng.normal(size=rows),
        terminals=np.ones(rows, bool), behavior_log_probs=np.full(rows, np.log(0.5)),
        cost=rng.exponential(np.where(action == 1, 3.0, 1.0)), energy=np.where(action == 1, 0.2, 0.4) * rng.random(rows),
    )  # fmt: skip


TRUE = {"cost": CHANCES @ [1.0, 3.0], "energy": CHANCES @ [0.2, 0.1]}


@cache
def case() -> OPEInput:
    return OPEInput(bandit(2000, 0), [policy(p) for p in CHANCES[1:]], logged=True)


def decided(limit, estimators="auto"):
    return decide(case(), estimators, cost_limit=limit, model=SMALL)


def test_costs_are_estimated_beside_the_value():
    found = decided({"cost": 2.8}, [ImportanceSampling()])
    assert cost_columns(case().given) == ("cost",)  # energy is an extra like any other
    (cost,) = found.more["costs"]
    ends = np.array(cost["ends"])
    assert (cost["column"], cost["limit"]) == ("cost", 2.8)
    exact = TRUE["cost"][[1, 2, 0]]
    assert (ends[:, 1] < exact).all()
    assert (exact < ends[:, 2]).all()
    assert (ends[:, 2] - ends[:, 1] < 0.5).all()
    (told,) = [line for line in found.choice.evidence if line.startswith("its cost is")]
    assert told == cost_of(found.choice.name, ends)


def cost_of(name, ends):
    value, low, high = ends[int(name.removeprefix("policy "))]
    between = f"its cost is {value:.4g} [{low:.4g}, {high:.4g}] (95 %, for all policies at once, limit 2.8)"
    return f"{between}; that of the behaviour policy is {ends[-1, 0]:.4g}"


@pytest.mark.parametrize(
    ("limit", "deployed"), [(None, True), ("cost=3", True), ({"cost": 3}, True), (2.65, False), (2.0, False)]
)
def test_who_may_cost_too_much_is_not_deployed(limit, deployed):
    """The second policy gains 0.3 and costs 2.6; whether 2.65 is enough, two thousand rows do not tell."""
    limit = (limit,) if isinstance(limit, str) else limit
    choice = decided(limit, [ImportanceSampling()]).choice
    assert choice.deploy == deployed
    assert choice.objections[0] == ()
    told = f", which may be above its limit of {limit:g}" if isinstance(limit, float) else ""
    assert [told in line for line in choice.objections[1]] == ([True] if told else [])


@pytest.mark.slow
def test_a_limit_chooses_among_those_within():
    """The best beyond the limit does not keep the second best from being chosen."""
    cheap = np.array([0.3, 0.7])
    own = OPEInput(bandit(4000, 1), [policy(CHANCES[2]), policy(cheap)], names=["dear", "cheap"], logged=True)
    assert decide(own, [ImportanceSampling()], model=SMALL).choice.name == "dear"
    choice = decide(own, [ImportanceSampling()], cost_limit=2.55, model=SMALL).choice
    assert (choice.name, choice.deploy) == ("cheap", True)


@pytest.mark.slow
def test_what_does_not_depend_on_rewards_is_fitted_once(monkeypatch):
    fit = behavior._fit
    log = bandit(600, 2)
    without = {key: getattr(log, key) for key in ("observations", "actions", "rewards", "terminals")}
    log = Dataset.from_arrays(**without, cost=log.extras["cost"])
    begun = []
    monkeypatch.setattr(behavior, "_fit", lambda *given: begun.append(1) or fit(*given))
    own = OPEInput(log, [policy(CHANCES[2])], logged=True)
    found = decide(own, [DoublyRobust(kind="dr", fqe=LinearFQE(), model=SMALL)], cost_limit=9.0, model=SMALL)
    assert begun == [1]
    assert len(found.more["costs"][0]["ends"]) == 2


def test_unsupported_policies_have_endless_costs():
    lonely = OPEInput(bandit(2000, 0), [policy([0.5, 0.5])], logged=True)
    found = ImportanceSampling().on(lonely)
    ends = totals(found, 0.05, np.array([False, True]))
    assert np.isinf(ends[0, 1:]).all()
    assert np.isfinite(ends[1]).all()
    cost = Cost("cost", 2.0, ends, ())
    assert cost.objection(0, 0.95) == "it is not known whether its cost stays within 2"


class Members(Estimator):
    """Three critics that nearly learn the mean."""

    label = "members"

    def solve(self, case):
        value = np.full(case.count, case.data.rewards.mean())
        found = value + 1e-6 * np.arange(3.0)[:, None]
        return Estimates("members", case.names, value, value, value, case.estimand, bootstrap=found)


@pytest.mark.parametrize("judge", [ImportanceSampling(), Members()], ids=["weights", "critics"])
def test_a_cost_that_never_occurred_has_no_upper_end(judge):
    """A hundred rows without an event that one of a hundred has: often enough there is none, and the limit is not met."""
    log = bandit(100, 0)
    never = replace(log, extras=log.extras | {"cost": np.zeros(100)})
    case = OPEInput(never, [policy(CHANCES[2])], discount=0.0, horizon=1, logged=True)
    (cost,) = costs_of(case, judge, _support(case), {"cost": 0.001}, 0.025, SMALL)
    assert cost.ends[0].tolist() == [0.0, -np.inf, np.inf]
    assert cost.objection(0, 0.975) == (
        "it is not known whether its cost stays within 0.001: in every evaluated episode with a weight for it the total is 0; "
        "how rare other totals are is not known"
    )


def test_a_cost_whose_fit_has_not_settled_is_not_known():
    class Diverging(Estimator):
        label = "diverging"

        def solve(self, case):
            return replace(ImportanceSampling().solve(case), diagnostics={"settled": np.array([0.0, 1.0, 1.0])})

    (cost,) = costs_of(case(), Diverging(), _support(case()), {"cost": 99.0}, 0.05, SMALL)
    assert np.isinf(cost.ends[0, 1:]).all()
    why = "the fit of its estimate has not converged"
    assert cost.objection(0, 0.95) == f"it is not known whether its cost stays within 99: {why}"
    assert cost.objection(1, 0.95) is None


def test_warnings_of_costs_are_on_the_card(monkeypatch):
    """But those that the value has too stand there once."""
    cost = Cost("cost", None, np.zeros((3, 3)), ("the critics of policy 0 diverge", "known"))
    monkeypatch.setattr("deadreckon.ope.decide.costs_of", lambda *given: [cost])
    monkeypatch.setattr("deadreckon.ope.decide.support", lambda case, model: _support(case))
    monkeypatch.setattr("deadreckon.ope.decide._confounded", lambda case, choice, *given: ({}, choice))
    monkeypatch.setattr("deadreckon.ope.decide.dependent", lambda *given: None)
    told = decide(case(), [_Warning()], model=SMALL).choice.warnings
    assert told == ("known", "cost: the critics of policy 0 diverge")


class _Warning(ImportanceSampling):
    """With a warning of its own."""

    def solve(self, case):
        return replace(super().solve(case), warnings=("known",))


def test_totals_are_values_with_intervals_for_all_at_once():
    found = ImportanceSampling().on(case())
    ends = totals(found, 0.05, np.ones(3, bool))
    np.testing.assert_allclose(ends[:, 0], found.value)
    # Of all at once they are wider than each for itself, and not by much.
    ratio = (ends[:, 2] - ends[:, 1]) / (found.high - found.low)
    assert (ratio > 1.0).all()
    assert (ratio < 1.4).all()


def test_several_costs_share_the_level():
    """Each of two has the ends of one alone at half of the level."""
    two = costs_of(case(), ImportanceSampling(), _support(case()), {"cost": None, "energy": None}, 0.05, SMALL)
    for each in two:
        (alone,) = costs_of(case(), ImportanceSampling(), _support(case()), {each.column: None}, 0.025, SMALL)
        np.testing.assert_allclose(each.ends, alone.ends)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [100, 1000])
def test_intervals_of_costs_cover(rows):
    """At 95 % for all policies at once; costs are skewed. 300 logs, so that 92 % would be two standard errors below."""
    covered = 0
    for seed in range(300):
        own = OPEInput(bandit(rows, seed), [policy(p) for p in CHANCES[1:]], logged=True)
        (cost,) = costs_of(own, ImportanceSampling(), _support(own), {"cost": None}, 0.05, SMALL)
        exact = TRUE["cost"][[1, 2, 0]]
        covered += bool(((cost.ends[:, 1] <= exact) & (exact <= cost.ends[:, 2])).all())
    assert covered >= 0.92 * 300


def _support(own):
    return Support(np.zeros(2), np.ones(2), np.ones(2), np.zeros(2, bool))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"energy": 1.0}, "unknown cost 'energy'"),
        ("cost=much", "--cost-limit cost: a limit is a finite number, got 'much'"),
        (float("nan"), "a limit is a finite number"),
    ],
)
def test_limits_that_are_none_are_refused(given, words):
    with pytest.raises(UserError, match=words):
        limits_of((given,) if isinstance(given, str) else given, case().given)


@pytest.mark.slow
def test_limits_need_costs_and_a_name_where_there_are_several():
    log = case().given
    plain = Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards, terminals=log.terminals
    )
    assert limits_of(None, plain) == {}
    with pytest.raises(UserError, match=r"does not have; name it when it is read \(--cost COLUMN\)"):
        limits_of(3.0, plain)
    table = {"x": log.observations[:, 0], "action": log.actions, "reward": log.rewards, **log.extras}
    table.pop("behavior_log_probs")
    several = Dataset.from_frame(table, cost=["cost", "energy"])
    assert cost_columns(several) == ("cost", "energy")
    assert limits_of(["energy=0.3"], several) == {"cost": None, "energy": 0.3}
    with pytest.raises(UserError, match="the log has several costs; say which, such as cost=3"):
        limits_of("3", several)
    assert limits_of("energy=0.3", several) == {"cost": None, "energy": 0.3}  # one text is one limit, not a sequence of letters
    assert limits_of(np.int64(3), case().given) == limits_of(np.float32(3), case().given) == {"cost": 3.0}
    with pytest.raises(UserError, match="--cost-limit energy: a cost needs a limit, such as energy=25"):
        limits_of(["energy"], several)
    with pytest.raises(UserError, match="energy has the limit 1 already; give one"):
        limits_of(["energy=1", "energy=2"], several)
