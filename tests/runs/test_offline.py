"""Policies judged from a log and checked in the simulator, and what a page shows of it."""

import dataclasses
import types
from dataclasses import replace

import numpy as np
import pytest

from deadreckon.agents.bc import BC
from deadreckon.collect import generate
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.folder import write_folder
from deadreckon.data.provenance import Provenance
from deadreckon.data.spec import Discrete
from deadreckon.data.split import Holdout
from deadreckon.errors import UserError
from deadreckon.files import write_json
from deadreckon.ope import FQE, BehaviorModel, ImportanceSampling
from deadreckon.ope.support import Support
from deadreckon.policies import BlackBoxPolicy, store
from deadreckon.report import write
from deadreckon.runs import offline
from deadreckon.runs.crossfit import cross_fit
from deadreckon.runs.gather import LEARNED, NOBODY, fresh, gather
from deadreckon.runs.offline import checked, grounds, judge, read_estimates
from deadreckon.runs.train import train
from deadreckon.stats.interval import level_in_words

SMALL = FQE(members=2, hidden=(8,), steps=100)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("judged")
    log = generate("maze2d-umaze-v1", steps=3000, seed=0)
    train(BC(hidden=(8,)), log, steps=20, seeds=2, episodes=2, task="maze2d-umaze", out=folder / "bc")
    judged = judge(
        [folder / "bc"], log, [SMALL, ImportanceSampling(model=BehaviorModel(hidden=(8,), steps=50))],
        out=folder / "ope", task="maze2d-umaze", episodes=4, model=BehaviorModel(hidden=(8,), steps=50),
    )  # fmt: skip
    return folder, log, judged


@pytest.mark.slow
def test_what_is_told(made):
    folder, _, (estimates, choice, told) = made
    assert told == read_estimates(folder / "ope")
    assert [each["method"] for each in told["results"]] == ["FQE-L2", "WPDIS"]
    assert [each["name"] for each in told["policies"]] == ["bc seed 0", "bc seed 1"]
    np.testing.assert_allclose(told["results"][0]["value"], estimates[0].value)
    assert len(told["results"][0]["value"]) == 3  # the behaviour policy is the last
    assert len(told["truth"]["mean"]) == 2
    assert choice.name in ("bc seed 0", "bc seed 1")


def test_the_check_in_words():
    told = {
        "truth": {"task": "t", "episodes": 4, "mean": [1.0, 4.0, 3.0], "error": [0.1, 0.1, 0.2]},
        "policies": [{"name": name} for name in "abc"], "choice": {"name": "c"},
    }  # fmt: skip
    line = checked(told)
    assert line.startswith("in the simulator c has 3.00 (standard error 0.20) and is in place 2 of 3; the best, b, has 4.00: ")
    assert line.endswith("a regret of 1.00, 33 % of the range of all")
    assert checked(told | {"truth": None}).startswith("not checked")
    limited = checked(told | {"truth": told["truth"] | {"beyond": 0.37}})
    assert limited.endswith("of all; its time limit leaves 37 % of the discounted time out, which the estimates include")
    told["truth"]["apart"] = [[0.0, 0.1, 0.2], [0.1, 0.0, 0.3], [0.2, 0.3, 0.0]]
    assert "a regret of 1.00 (standard error 0.30), 33 % of the range" in checked(told)
    small = told | {"truth": told["truth"] | {"mean": [0.001, 0.004, 0.003], "error": [1e-4, 1e-4, 2e-4]}}
    assert "c has 0.0030 (standard error 0.0002)" in checked(small)
    assert "a regret of 0.0010" in checked(small)
    behind = checked(told | {"choice": {"name": "b"}})
    assert behind.endswith("the best of 3; the next, c, is lower by 1.00 (standard error 0.30)")


def test_differences_in_the_simulator_are_of_episodes_that_begin_alike(monkeypatch):
    starts, noise = np.random.default_rng(0).normal(scale=10.0, size=50), np.random.default_rng(1).normal(size=50)
    returns = np.stack([starts, starts + 1.0 + noise])
    played = types.SimpleNamespace(discounted=returns, lengths=np.full((2, 50), 3))
    monkeypatch.setattr(offline, "evaluate", lambda *given, **asked: played)
    task, estimand = types.SimpleNamespace(name="t", horizon=3), {"discount": 1.0, "horizon": None, "greedy": True}
    truth = offline.simulated([None, None], task, estimand, episodes=50, seed=0)
    np.testing.assert_allclose(truth["apart"], np.array([[0.0, 1.0], [1.0, 0.0]]) * noise.std(ddof=1) / np.sqrt(50), atol=1e-12)
    assert min(truth["error"]) > 5 * truth["apart"][0][1]


@pytest.mark.slow
def test_the_page_shows_it(made):
    folder, *_ = made
    page = write([folder / "bc"], folder / "page.html", estimates=folder / "ope").read_text()
    assert 'id="estimates"' in page
    assert "estimate against true value" in page
    assert "Checked afterwards in the simulator" in page
    plain = write([folder / "bc"], folder / "plain.html").read_text()
    assert 'id="estimates"' not in plain
    with pytest.raises(UserError, match="no estimates in"):
        write([folder / "bc"], folder / "page.html", estimates=folder)


@pytest.mark.slow
def test_estimates_from_before_episodes_were_held_out_are_refused(made, tmp_path):
    _, _, (_, _, told) = made
    write_json(tmp_path / "estimates.json", {name: value for name, value in told.items() if name != "estimand"})
    with pytest.raises(UserError, match="evaluated policies on their training rows; estimate them again"):
        read_estimates(tmp_path)


@pytest.mark.slow
def test_where_policies_come_from(made):
    folder, *_ = made
    found = gather([folder / "bc", folder / "bc" / "policies" / "seed0.npz", "hopper"])
    assert len(found) == 2 + 1 + 11
    assert (found[0].run, found[0].seed) == ("bc", 0)
    assert (found[2].run, found[2].seed) == ("seed0", None)
    np.testing.assert_array_equal(found[0].taught, found[2].taught)  # a file tells what a run tells
    assert (found[-1].run, found[-1].taught) == ("hopper snapshot-10", None)
    with pytest.raises(UserError, match="there are no policies of 'nothing'"):
        gather(["nothing"])
    with pytest.raises(UserError, match="no policy to evaluate"):
        gather([])


def test_snapshots_have_seen_the_training_that_a_replay_log_repeats():
    log = Dataset.from_arrays(
        observations=np.zeros((20, 11)), actions=np.zeros((20, 3)), rewards=np.arange(20.0), terminals=np.ones(20, bool),
        provenance=Provenance("collected", "hopper-medium-replay-v2", 0),
    )  # fmt: skip
    assert set(fresh(gather("hopper"), log, False).against) == {LEARNED}
    for other in (Provenance("collected", "hopper-medium-replay-v2", 1), Provenance("collected", "hopper-medium-v2", 0)):
        assert set(fresh(gather("hopper"), replace(log, provenance=other), False).against) == {NOBODY}


# ---- fresh episodes -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def noise(tmp_path_factory):
    """A log of one step and rewards that are noise, and a clone that learned from four fifths of it."""
    rng = np.random.default_rng(0)
    log = Dataset.from_arrays(
        observations=rng.standard_normal((300, 2)), actions=rng.integers(0, 3, 300), rewards=rng.standard_normal(300),
        terminals=np.ones(300, bool), behavior_log_probs=np.full(300, -np.log(3)), action_space=Discrete(3), name="noise",
        user=np.repeat(np.arange(30), 10),
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("noise")
    return log, train(BC(hidden=(8,)), log, steps=20, out=folder / "bc"), folder


QUICK = {"model": BehaviorModel(hidden=(8,), steps=50), "discount": 0.0}


@pytest.mark.slow
def test_policies_are_judged_on_the_episodes_that_taught_none_of_them(noise):
    log, run, _ = noise
    told = judge([run], log, **QUICK).results
    assert (told["judged"]["episodes"], told["judged"]["of"], told["judged"]["fresh"]) == (60, 300, True)
    assert np.isin(run.held, log.episode_ids).all()
    # The part that was learned from, under whatever name: nothing of it is fresh.
    part = log.select(np.flatnonzero(np.isin(log.episode_ids, run.taught)), name="another")
    own = judge([run], part, **QUICK)
    assert not own.results["judged"]["fresh"]
    assert not own.choice.deploy
    assert "it was trained on these episodes" in own.choice.reason
    # A log that it has never seen.
    other = log.select(np.arange(300)[::-1])
    new = dataclasses.replace(other, rewards=other.rewards + 1.0, part_of=None)
    assert judge([run], new, **QUICK).results["judged"]["episodes"] == 300


def test_a_policy_is_judged_without_the_episodes_that_taught_it_or_else_not_deployed(noise, monkeypatch):
    log, run, _ = noise
    # The other checks of a decision fit models, and are not looked at here.
    fine = Support(np.zeros(1), np.ones(1), np.ones(1), np.zeros(1, bool))
    monkeypatch.setattr("deadreckon.ope.decide.support", lambda case, model: fine)
    monkeypatch.setattr("deadreckon.ope.decide._confounded", lambda case, choice, *given: ({}, choice))
    told = judge([run], log, "is", counted=False, **QUICK)
    assert told.results["judged"]["units"] == len(run.held) == 60
    assert told.choice.objections == ((),)
    part = log.select(np.flatnonzero(np.isin(log.episode_ids, run.taught)))
    assert judge([run], part, "is", counted=False, **QUICK).choice.objections == (("it was trained on these episodes",),)


@pytest.mark.slow
def test_what_nobody_knows_is_not_deployed_unless_the_user_says_so(noise, tmp_path):
    log, run, _ = noise
    store.save(tmp_path / "mine.npz", run.policy)
    unknown = judge([tmp_path / "mine.npz"], log, **QUICK)
    assert "it is not known whether it was trained on these episodes" in unknown.choice.reason
    said = judge([tmp_path / "mine.npz"], log, unseen=True, **QUICK)
    assert said.results["judged"]["fresh"]
    assert "according to --unseen" in said.results["judged"]["words"]


@pytest.mark.slow
def test_what_a_user_says_of_one_policy_brings_no_episodes_back_that_taught_another(noise):
    log, run, _ = noise
    told = judge([run, run.policy], log, "is", unseen=True, **QUICK).results
    assert told["judged"]["episodes"] == len(run.held) < log.episodes
    assert "equal a policy's training episodes" not in told["judged"]["words"]
    assert judge([run.policy], log, "is", unseen=True, **QUICK).results["judged"]["episodes"] == log.episodes


def test_python_functions_are_judged_too_and_what_they_have_no_support_for_has_no_ends():
    """Action 1 is never taken: nothing that any estimator says of a policy that takes it has an end."""
    rng = np.random.default_rng(0)
    log = Dataset.from_arrays(
        observations=rng.standard_normal((300, 2)), actions=2 * rng.integers(0, 2, 300), rewards=rng.standard_normal(300),
        terminals=np.ones(300, bool), behavior_log_probs=np.full(300, -np.log(2)), action_space=Discrete(3), name="gap",
    )  # fmt: skip

    def policy(share):
        probs = np.array([1.0 - share, share, 0.0])
        return BlackBoxPolicy(
            lambda seen, rng: rng.choice(3, len(seen), p=probs), action_probs=lambda seen: np.tile(probs, (len(seen), 1))
        )

    policies = [policy(0.0), policy(0.3)]
    judged = judge(policies, log, ["dr-linear", "is"], unseen=True, **QUICK)
    told = judged.results
    assert [each["name"] for each in told["policies"]] == ["policy 0", "policy 1"]
    assert "30 % of its actions have no support" in told["choice"]["objections"][1][0]
    for each in told["results"]:
        assert np.isfinite(each["low"][0])
        assert (each["low"][1], each["high"][1]) == (-np.inf, np.inf)
        assert each["gain"][1][1:] == [-np.inf, np.inf]
    assert dict(grounds(told))["log"] == log.name
    alone = judge(policies[1:], log, ["dr-linear", "is"], unseen=True, **QUICK).choice
    assert not any("agrees" in line for line in alone.evidence)
    with pytest.raises(UserError, match="policies to evaluate are runs, folders, files or policies, got int"):
        judge([3], log, unseen=True, **QUICK)


@pytest.mark.parametrize(("number", "words"), [
    (1, "97.5 %"), (2, "98.8 %"), (7, "99.96 %"), (10, "99.995 %"), (40, "99.999999999995 %"),
])  # fmt: skip
def test_late_looks_have_a_level_below_100_percent(number, words):
    assert level_in_words(1.0 - 0.05 / 2.0**number) == words


@pytest.mark.slow
def test_a_column_by_which_episodes_were_held_out_is_redrawn_as_one(noise):
    log, _, folder = noise
    run = train(BC(hidden=(8,)), log, steps=20, out=folder / "users", holdout=Holdout(0.4, "user"))
    told = judge([run], log, **QUICK).results
    assert told["judged"]["cluster"] == "user"
    assert told["judged"]["units"] == len(np.unique(log.extras["user"][np.isin(log.episode_ids, run.held)]))


def test_copies_of_episodes_are_counted_as_one(noise):
    log, _, folder = noise
    columns = {
        name: np.tile(np.asarray(getattr(log, name)).T, 3).T for name in ("observations", "actions", "rewards", "terminals")
    }
    log = Dataset.from_arrays(**columns, behavior_log_probs=np.full(900, -np.log(3)), action_space=Discrete(3), name="thrice")
    run = train(BC(hidden=(8,)), log, steps=20, out=folder / "thrice")
    told = judge([run], log, [ImportanceSampling()], counted=False, **QUICK).results
    assert (told["judged"]["episodes"], told["judged"]["clusters"], told["judged"]["units"]) == (180, 60, 60)
    assert dict(grounds(told))["evaluated on"] == (
        "180 held-out episodes of 900, of which 60 are different: copies are counted as one"
    )


def test_each_look_at_the_same_episodes_spends_half_of_what_is_left(noise, tmp_path, monkeypatch):
    log, run, folder = noise
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path))
    other = train(BC(hidden=(8,)), log, steps=30, seed=5, out=folder / "other", holdout=Holdout())
    levels = [judge(each, log, **QUICK).results["looks"] for each in ([run], [other], [run], [run, other])]
    assert [each["number"] for each in levels] == [1, 2, 1, 3]  # the same policies again are the same look
    assert [each["alpha"] for each in levels] == [0.025, 0.0125, 0.025, 0.00625]
    assert levels[-1]["policies"] == 4
    fewer = judge([run], log.select(range(log.episodes - 5)), **QUICK).results["looks"]
    assert fewer["number"] == 4  # some of the same episodes are no new ones
    uncounted = judge([run], log, counted=False, **QUICK).results["looks"]
    assert (uncounted["alpha"], uncounted["counted"]) == (0.05, False)
    note, _ = (tmp_path / "looks").glob("*.json")
    note.write_text("[]")
    with pytest.raises(UserError, match="is not a note of looks"):
        judge([run], log, **QUICK)


def test_another_deciding_estimator_is_another_look(noise, tmp_path, monkeypatch):
    """Whoever tries estimators, or clusters, until one deploys has looked as often; others beside the first may only object."""
    log, run, _ = noise
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path))
    levels = []

    def decide(*given, alpha, **options):
        levels.append(alpha)
        raise UserError("no more than the level is asked")

    def own(data, policies, discount):
        return [data.rewards.mean() for _ in policies]

    monkeypatch.setattr(offline, "decide", decide)
    for estimators, more in (("is", {}), (["is", "pdis"], {}), ("is", {"seed": 3}), ("is", {"tail": 0.5}), ("wis", {}),
                             (own, {}), ("is", {"cluster": "user"}), ("is", {})):  # fmt: skip
        with pytest.raises(UserError, match="no more than the level"):
            judge([run], log, estimators, **QUICK | more)
    assert [0.05 / alpha for alpha in levels] == [2, 2, 2, 2, 4, 8, 16, 2]


@pytest.mark.parametrize(("change", "words"), [
    ({"estimators": []}, "no estimator"), ({"out": "file"}, "file is a file; --out must be a folder"),
    ({"model": BehaviorModel(steps=0)}, "BehaviorModel.steps takes a whole number"),
    ({"episodes": 1, "task": "maze2d-umaze"}, "episodes must be 2 or more, for a standard error, got 1"),
    ({"estimators": "dice", "horizon": 3}, "BestDICE does not take a horizon"),
])  # fmt: skip
def test_what_is_refused_is_no_look(noise, tmp_path, monkeypatch, change, words):
    log, run, _ = noise
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(UserError, match=words):
        judge([run], log, **QUICK | change)
    assert not (tmp_path / "looks").exists()


@pytest.mark.slow
def test_estimates_outlive_a_simulator_that_fails(made, tmp_path, monkeypatch):
    folder, log, _ = made

    def fails(*given, **options):
        raise RuntimeError("unstable")

    monkeypatch.setattr(offline, "evaluate", fails)
    estimators = [ImportanceSampling(model=QUICK["model"])]
    with pytest.raises(RuntimeError, match="unstable"):
        judge(folder / "bc", log, estimators, out=tmp_path, task="maze2d-umaze", unseen=True, **QUICK)
    told = read_estimates(tmp_path)
    assert told["truth"] is None
    assert told["results"][0]["method"] == "WPDIS"


@pytest.mark.slow
def test_one_policy_and_a_file_of_a_log_do(noise, tmp_path, monkeypatch):
    log, run, folder = noise
    write_folder(log, tmp_path / "log")
    monkeypatch.chdir(folder)
    for given in ("bc", run, run.path):
        assert [each["name"] for each in judge(given, tmp_path / "log", "is", **QUICK).results["policies"]] == ["bc seed 0"]
    assert judge(run.policy, str(tmp_path / "log"), "is", unseen=True, **QUICK).choice.name == "policy 0"


@pytest.mark.slow
def test_a_cross_fit_is_judged_on_every_episode(noise):
    log, _, folder = noise
    crossed = cross_fit(BC(hidden=(8,)), log, folds=3, steps=20, out=folder / "crossed")
    judged = judge([folder / "crossed"], log, **QUICK)
    assert judged.results["judged"]["episodes"] == 300
    assert judged.results["judged"]["fresh"]
    [name] = [each["name"] for each in judged.results["policies"]]
    assert name == "crossed seed 0"
    # By hand: each episode weighted by the policy that has not seen it.
    fold = crossed.fold_of(log)
    probs = np.stack([np.asarray(run.policy.action_probs(log.observations)) for run in crossed.runs])
    each = 3 * probs[fold, np.arange(300), log.actions] * log.rewards
    found = judge([crossed], log, [ImportanceSampling(normalised=False)], **QUICK).estimates[0]
    assert found.value[0] == pytest.approx(each.mean(), rel=1e-4)


@pytest.mark.slow
def test_a_log_whose_levels_mean_something_else_is_refused(tmp_path):
    """Site b would be read as site a: both logs have two sites and two doses, under other names."""
    rng = np.random.default_rng(0)

    def table(sites):
        rows = 40
        return {
            "site": rng.choice(sites, rows), "dose": rng.choice(["high", "low"], rows), "gain": rng.normal(size=rows),
        }  # fmt: skip

    known, other = (Dataset.from_frame(table(sites), action="dose", reward="gain") for sites in (["a", "b"], ["b", "c"]))
    run = train(BC(hidden=(4,)), known, steps=4, out=tmp_path / "run")
    with pytest.raises(UserError, match=r"run was trained on a log whose observations are \['site=a', 'site=b'\]"):
        judge([run], other)
