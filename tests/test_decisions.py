"""The study of decisions: what it takes for the truth is the truth."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
ROWS = 4_000
DISCRETE = (
    "null-bandit", "null-sequential", "classes", "missing", "supported", "users", "many-actions", "tabular-short",
    "tabular-long", "tabular-cut", "inventory",
)  # fmt: skip
CONTINUOUS = ("linear-quadratic", "pendulum", "pricing")


@pytest.fixture
def study(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    import decision_study

    return decision_study


@pytest.mark.slow
@pytest.mark.parametrize("name", [*DISCRETE, *CONTINUOUS])
def test_the_value_of_the_logs_own_policy_is_what_the_log_got(study, name):
    problem = study.FAMILIES[name].log(3, 20_000)
    horizon, log = problem.estimand.horizon, problem.log
    if horizon is None and log.timeouts.any():  # what was cut off, exactly
        world = problem.world
        log = replace(log, rewards=log.rewards.copy())
        ends = log.ends[log.timeouts[log.ends]]
        log.rewards[ends] += problem.estimand.discount * world.values(world.own)[1][0][problem.hidden["after"][ends]]
    got = log.returns(problem.estimand.discount)
    if problem.cluster:
        user = log.extras[problem.cluster]
        count = np.bincount(user)
        # Of users, who come more or less often.
        spread = np.sqrt((np.square(np.bincount(user, got - got.mean()))).sum()) / len(got)
        assert len(count) >= 20
    else:
        spread = got.std() / np.sqrt(len(got))
    assert abs(got.mean() - problem.behavior) < 4.5 * spread


@pytest.mark.parametrize("name", DISCRETE)
def test_probabilities_sum_to_one_and_are_those_of_the_log(study, name):
    problem = study.FAMILIES[name].log(5, ROWS)
    log, world = problem.log, problem.world
    chances = problem.hidden["chances"] if "chances" in problem.hidden else world.own[problem.hidden["state"]]
    assert np.allclose(chances.sum(1), 1.0)
    rows = np.arange(len(log))
    assert np.allclose(np.log(chances[rows, log.actions]), log.extras["behavior_log_probs"], atol=1e-5)
    often = np.bincount(log.actions, minlength=chances.shape[1])
    assert (np.abs(often - chances.sum(0)) <= 5.0 * np.sqrt((chances * (1 - chances)).sum(0)) + 1e-6).all()
    for policy in problem.candidates.values():
        assert np.allclose(policy.action_probs(log.observations).sum(1), 1.0)


@pytest.mark.parametrize("name", CONTINUOUS)
def test_densities_are_those_of_the_draws(study, name):
    problem = study.FAMILIES[name].log(5, ROWS)
    log = problem.log
    for policy in problem.candidates.values():
        # The mean of the ratio of two densities is one.
        ratio = np.exp(policy.log_prob(log.observations, log.actions) - log.extras["behavior_log_probs"])
        assert abs(ratio.mean() - 1.0) < 5.0 * ratio.std() / np.sqrt(len(ratio)) + 1e-6


def played(problem, policy, count: int, rng) -> np.ndarray:
    """Returns of episodes of a policy in a finite world, drawn step by step."""
    world = problem.world
    table, discount, steps = world.table(policy), problem.estimand.discount, problem.estimand.horizon or 400
    return world.world.log(table, count, steps, rng).returns(discount)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["null-sequential", "tabular-short", "tabular-long", "tabular-cut", "inventory"])
def test_values_of_finite_worlds_are_those_of_episodes_that_are_played(study, name):
    problem = study.FAMILIES[name].log(2, 200)
    for policy in problem.candidates.values():
        got = played(problem, policy, 2_000, np.random.default_rng(0))
        assert abs(got.mean() - problem.truth(policy)) < 4.5 * got.std() / np.sqrt(len(got)) + 1e-6


def test_values_of_linear_worlds_are_those_of_episodes_that_are_played(study):
    for seed in range(3):
        problem = study.FAMILIES["linear-quadratic"].log(seed, 200)
        for policy in (*problem.candidates.values(), problem.world.own):
            got = problem.world.returns(policy, np.random.default_rng(0), 20_000)
            assert abs(got.mean() - problem.truth(policy)) < 4.5 * got.std() / np.sqrt(len(got))


def test_a_tanh_gaussian_beside_a_linear_policy_is_worth_what_it_plays(study):
    from decision_study.problem import Normal

    problem = study.FAMILIES["linear-quadratic"].log(1, 200)
    size = problem.world.size
    bounds = np.full(size, -2.0), np.full(size, 2.0)
    policy = Normal(lambda seen: (-0.5 * seen[:, :1] * np.ones(size), np.full((len(seen), size), 0.4)), bounds)
    gain, error, own = problem.world.gains([policy], np.array([0.01]))
    got = problem.world.returns(policy, np.random.default_rng(9), 20_000)
    assert abs(got.mean() - own - gain[0]) < 4.5 * np.hypot(error[0], got.std() / np.sqrt(len(got)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["classes", "missing", "supported", "users", "many-actions", "pricing"])
def test_values_of_one_decision_are_those_of_draws(study, name):
    """Other contexts, actions drawn: not the sums over actions that the truth is made of."""
    problem = study.FAMILIES[name].log(4, 200)
    rng = np.random.default_rng(1)
    for policy in problem.candidates.values():
        if name == "pricing":
            seen = rng.standard_normal((50_000, 3))
            got = problem.world.mean(seen, policy.fn(seen, rng))
        else:
            seen, unseen = problem.world.contexts(rng, 50_000)
            got = problem.world.mean(seen, unseen)[np.arange(50_000), policy.fn(seen, rng)]
        gains, error, own = problem.world.gains([policy], np.array([0.003]))
        assert abs(got.mean() - own - gains[0]) < 4.5 * (got.std() / np.sqrt(50_000) + got.std() / np.sqrt(20_000))


@pytest.mark.parametrize("name", [*DISCRETE, *CONTINUOUS, "drifting", "reversing", "pricing-unknown"])
def test_the_oracles_scores_are_without_bias(study, name):
    from decision_study.rules import Task, units

    problem = study.FAMILIES[name].log(6, ROWS)
    gains, wrong, _ = problem.world.gains(list(problem.candidates.values()), np.full(2, 0.002))
    for policy, gain, error in zip(problem.candidates.values(), gains, wrong):
        scores = problem.world.scores(policy, problem.log, problem.hidden)
        task = Task(problem, {}, problem.log, problem.log, problem.hidden, None, 0)
        each = units(task, scores[None])[0]
        assert each.mean() == pytest.approx(scores.mean())
        assert abs(scores.mean() - gain) < 4.5 * np.hypot(each.std() / np.sqrt(len(each)), error) + 1e-6


@pytest.mark.parametrize("name", ["null-bandit", "null-sequential"])
def test_noise_is_worth_the_same_to_all(study, name):
    for seed in range(4):
        problem = study.FAMILIES[name].log(seed, 300)
        assert problem.null
        assert np.allclose(problem.world.gains(list(problem.candidates.values()), np.ones(2))[0], 0.0, atol=1e-6)


def test_twins_differ_by_what_the_log_shows(study):
    lacks, shows = (study.FAMILIES[name].log(8, 3_000) for name in ("missing", "supported"))
    assert np.array_equal(lacks.log.observations, shows.log.observations)
    assert np.array_equal(lacks.hidden["mean"], shows.hidden["mean"])
    last = lacks.log.action_space.n - 1
    assert (lacks.log.actions != last).all()
    assert not lacks.supported
    assert 0.08 < (shows.log.actions == last).mean() < 0.17
    for name, policy in lacks.candidates.items():
        probs = policy.probs(lacks.log.observations)
        assert np.array_equal(probs, shows.candidates[name].probs(shows.log.observations))
        assert 0.2 < probs[:, -1].mean() < 0.4


@pytest.mark.parametrize("name", ["users", "tabular-short"])
def test_parts_share_no_episode_and_no_user(study, name):
    problem = study.FAMILIES[name].log(1, 1_000)
    learning, held = problem.parts(1)
    assert len(learning) + len(held) == problem.log.episodes
    assert not set(learning) & set(held)
    if problem.cluster:
        user = problem.log.extras[problem.cluster][problem.log.starts]
        assert not set(user[learning]) & set(user[held])


def test_a_log_is_its_seeds(study):
    one, two = (study.FAMILIES["classes"].log(11, 300).log.fingerprint for _ in range(2))
    assert one == two
    assert one != study.FAMILIES["classes"].log(12, 300).log.fingerprint


@pytest.mark.slow
def test_learned_policies_are_those_of_the_package(study, monkeypatch):
    """Probabilities and densities without a compiler are those of what was learned."""
    from decision_study import learn

    for name in ("missing", "pendulum"):
        problem = study.FAMILIES[name].log(0, 300)
        monkeypatch.setattr(learn, "STEPS", 5)
        with monkeypatch.context() as patched:
            patched.setattr(learn, "plain", lambda policy: policy)
            kept = learn.learned(problem.log, problem.estimand.discount, 0).values()
        found = {str(i): learn.plain(policy) for i, policy in enumerate(kept)}
        seen, taken = problem.log.observations[:50], problem.log.actions[:50]
        for policy, theirs in zip(found.values(), kept, strict=True):
            if name == "missing":
                assert np.allclose(policy.probs(seen), theirs.action_probs(seen), atol=1e-5)
            elif policy.draws:
                assert np.allclose(policy.log_prob(seen, taken), theirs.log_prob(seen, taken), atol=1e-2)
            assert np.allclose(policy.at(seen, np.zeros((50, 1))), theirs(seen), atol=1e-4) if name == "pendulum" else True


def test_fitted_values_of_the_old_rules_are_those_of_single_decisions(study):
    """Of an action that is always taken, and of the log itself: the mean reward of the rows with it, and of all rows."""
    from decision_study.fqe import fqe
    from decision_study.problem import Choices

    rng = np.random.default_rng(0)
    actions = rng.integers(0, 2, 600)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(600, 2)), actions=actions, rewards=actions + 0.1 * rng.normal(size=600),
        terminals=np.ones(600, bool), action_space=Discrete(2),
    )  # fmt: skip
    always = [Choices(lambda seen, a=action: np.eye(2)[np.full(len(seen), a)]) for action in (0, 1)]
    found = fqe(log, always, 0.0, 0).mean(0)
    assert np.allclose(found, [0.0, 1.0, log.rewards.mean()], atol=0.15)


@pytest.mark.slow
def test_fitted_values_of_the_old_rules_are_those_of_long_episodes(study):
    """A reward of 1 for ever, and half of it on average: 1 / (1 - 0.8) = 5, times the mean reward of the action."""
    from decision_study.fqe import fqe
    from decision_study.problem import Choices

    rng = np.random.default_rng(0)
    actions = rng.integers(0, 2, 1_000)
    log = Dataset.from_arrays(
        observations=rng.normal(size=(1_000, 2)), actions=actions, rewards=actions.astype(float),
        timeouts=np.arange(1_000) % 20 == 19, action_space=Discrete(2),
    )  # fmt: skip
    always = [Choices(lambda seen, a=action: np.eye(2)[np.full(len(seen), a)]) for action in (0, 1)]
    found = fqe(log, always, 0.8, 0).mean(0)
    assert np.allclose(found, [0.0, 5.0, 2.5], atol=0.6)


def test_trials_are_kept_and_rules_added(study, tmp_path, monkeypatch):
    import decision_study.trial
    from decision_study import rules
    from decision_study.problem import Choices
    from decision_study.summary import tables
    from decision_study.trial import trial

    evenly = {name: Choices(lambda seen: np.full((len(seen), 4), 0.25)) for name in ("bc", "iql", "cql")}
    monkeypatch.setattr(decision_study.trial, "learned", lambda log, discount, seed: evenly)
    monkeypatch.setattr(decision_study.trial, "NONE_BETTER", 0.0)
    path = tmp_path / "missing" / "0.json"
    first = trial("missing", 4, ["oracle", "argmax-wis"], path, 200)
    assert set(first["rules"]) == {"oracle", "argmax-wis"}
    text = path.read_text()
    assert trial("missing", 4, ["oracle"], path, 200) == json.loads(text)
    assert path.read_text() == text
    card = rules.Verdict(0, np.zeros(5), np.full(5, -np.inf), np.full(5, np.inf))
    monkeypatch.setitem(rules.RULES, "new", lambda task: card)
    again = trial("missing", 4, ["oracle", "new"], path, 200)
    assert again["rules"]["new"]["low"] == [None] * 5
    assert {**again, "rules": first["rules"], "seconds": 0} == {**first, "seconds": 0}
    page = tables([again], ["new", "oracle"], {})
    assert "| missing | 1 | 0.0 % | 100.0 % |" in page
    assert "| the package | 100.0 % |" in page
    mixed = {**again, "rules": {"new": again["rules"]["new"] | {"code": "other"}}}
    assert f"the package {again['rules']['new']['code']}, other" in tables([again, mixed], ["new"], {})
    # An interval without ends holds, but not among those that have some.
    row = page.splitlines()[2].split(" | ")
    columns = page.splitlines()[0].split(" | ")
    assert row[columns.index("all intervals cover")] == "100.0 %"
    assert row[columns.index("… where any is finite")] == "–"
    assert row[columns.index("infinite intervals")] == "100 %"


def test_results_are_kept_as_one_file(study, tmp_path):
    from decisions import pack, place, unpack

    trial = {"family": "missing", "seed": 1_000_003, "gains": [0.123456789, -1.0], "rules": {"new": {"low": [None, 0.25]}}}
    other = {**trial, "seed": 1_000_004}
    pack(tmp_path / "record.jsonl.xz", [trial, other])
    path = place(tmp_path / "out", "missing", 1_000_004)
    path.parent.mkdir(parents=True)
    path.write_text("{}")  # what is there stays
    unpack(tmp_path / "record.jsonl.xz", tmp_path / "out")
    assert path.read_text() == "{}"
    kept = json.loads(place(tmp_path / "out", "missing", 1_000_003).read_text())
    assert kept == {**trial, "gains": [0.123457, -1.0]}
    unpack(tmp_path / "none.jsonl.xz", tmp_path / "out")  # a record that is not there yet has nothing


@pytest.mark.slow
@pytest.mark.parametrize(
    ("split", "names"),
    [
        ("confirmatory", ["families", "rules"]), ("second", ["second"]), ("confirmatory", ["drifting"]),
        ("third", ["third"]), ("confirmatory", ["latest"]), ("confirmatory", ["continuous"]),
    ],
)
def test_the_page_has_the_tables_of_the_kept_results(study, tmp_path, split, names):
    page = (FOLDER.parent / "docs" / "results" / "decisions.md").read_text()
    places = re.findall(r"<!-- ([a-z-]+): python benchmarks/(decisions.py [^\n]+) -->\n(.*?)<!-- end -->", page, re.S)
    assert [name for name, *_ in places] == ["families", "second", "third", "drifting", "latest", "continuous", "rules"]
    commands, shown = zip(*((command, text.strip()) for name, command, text in places if name in names))
    assert len(set(commands)) == 1
    program, *words = commands[0].split()
    assert f"--split {split} " in commands[0]
    assert " --table " in commands[0]
    command = [sys.executable, FOLDER / program, *words, "--out", tmp_path]
    printed = subprocess.run(command, cwd=FOLDER.parent, capture_output=True, text=True, check=True).stdout
    families, _, rules = printed.strip().partition("\n\n")
    assert list(shown) == [rules if name not in ("families", "second", "third") else families for name in names]


def test_in_some_logs_nothing_is_better(study, monkeypatch):
    import decision_study.trial
    from decision_study.problem import Choices

    evenly = {"bc": Choices(lambda seen: np.full((len(seen), 3), 1 / 3))}
    monkeypatch.setattr(decision_study.trial, "learned", lambda log, discount, seed: evenly)
    for share, names in ((0.0, {"bc", "better", "worse"}), (1.0, {"worse"})):
        monkeypatch.setattr(decision_study.trial, "NONE_BETTER", share)
        task = decision_study.trial.prepared(study.FAMILIES["tabular-short"], 3, 300)
        assert {"better", "worse"} & set(task.policies) == {"better", "worse"} & names
        assert task.clone is evenly["bc"]


def test_wilsons_interval(study):
    from decision_study.summary import wilson

    assert wilson(0, 100)[1] == pytest.approx(0.0370, abs=1e-4)
    assert wilson(50, 100) == pytest.approx((0.4038, 0.5962), abs=1e-4)
