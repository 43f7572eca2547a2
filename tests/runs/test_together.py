"""Runs of several settings as lanes of one program: each is a run of its own, and they are gone on with together."""

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.collect import generate
from deadreckon.report.entries import read
from deadreckon.runs.callback import StopTraining
from deadreckon.training.learner import lift
from tests.agents.worlds import corridor

SETTINGS = {"steps": 60, "seeds": 2, "seed": 3, "chunk": 20, "evaluate_every": 30, "episodes": 3}
X = np.random.default_rng(0).uniform(-1, 1, (20, 4)).astype("f4")


@pytest.fixture(scope="module")
def log():
    return generate("maze2d-umaze-v1", steps=2000, seed=0)


def td3_bc(**fields):
    return dr.agents.TD3BC(**{"hidden": (16, 16), "batch_size": 32} | fields)


AGENTS = {"plain": td3_bc(), "near": td3_bc(alpha=0.5, discount=0.9), "bad": td3_bc(critic_lr=1e30)}


@pytest.fixture(scope="module")
def runs(log, tmp_path_factory):
    return dr.train_together(AGENTS, log, out=tmp_path_factory.mktemp("runs") / "all", **SETTINGS)


def assert_alike(run, alone):
    """A run of several is the run of one: its settings, numbers and policies, within rounding."""
    config = {key: value for key, value in run.config.items() if key != "together"}
    assert config | {"versions": None} == alone.config | {"versions": None}
    for kind in ("metrics", "evaluations"):
        mine, theirs = (getattr(each, kind).to_pydict() for each in (run, alone))
        assert mine.keys() == theirs.keys()
        for column, values in theirs.items():
            np.testing.assert_allclose(mine[column], values, rtol=2e-3, atol=2e-3, err_msg=f"{run.path.name} {column}")
    for a, b in zip(run.policies, alone.policies, strict=True):
        np.testing.assert_allclose(a(X), b(X), atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["near", "plain"])
def test_each_is_the_run_that_it_would_be_alone(runs, log, tmp_path, name):
    assert list(runs) == ["plain", "near", "bad"]
    alone = dr.train(AGENTS[name], log, out=tmp_path / name, **SETTINGS)
    assert_alike(runs[name], alone)
    assert runs[name].config["versions"]["lanes"] == 6
    assert [p.name for p in sorted((runs[name].path / "policies").iterdir())] == [
        p.name for p in sorted((alone.path / "policies").iterdir())
    ]
    # What the settings do shows, far beyond that tolerance.
    assert np.abs(runs["plain"].policies[0](X) - runs["near"].policies[0](X)).max() > 0.01


@pytest.mark.slow  # that lanes fail alone is in tests/agents/test_conformance.py
def test_what_went_bad_is_told_of_its_own_run_alone(runs):
    assert runs["plain"].failures == runs["near"].failures == [None, None]
    assert all(failure.step < 20 for failure in runs["bad"].failures)
    assert all(np.isfinite(policy(X)).all() for policy in runs["bad"].policies)


@pytest.mark.slow
def test_a_report_shows_them_as_runs_with_their_own_settings(runs, tmp_path):
    first, second, third = read([run.path for run in runs.values()]).entries
    assert (first.seeds, second.seeds) == ([3, 4], [3, 4])
    assert second.config["agent"]["fields"]["alpha"] == 0.5
    assert second.last("score").shape == (2, 3)
    assert [seed for seed, *_ in third.failed] == [3, 4]


@pytest.mark.slow
def test_interrupted_and_resumed_is_the_same_as_unbroken(runs, log, tmp_path):
    class Stop(Exception):
        pass

    def watch(progress, steps):
        if progress.step == 50:
            raise Stop

    with pytest.raises(Stop):
        dr.train_together(AGENTS, log, out=tmp_path / "r", watch=watch, **SETTINGS)
    with pytest.raises(dr.UserError, match="plain is not finished; `train_together`"):
        dr.load_run(tmp_path / "r" / "plain")
    with pytest.raises(dr.UserError, match="holds another run: together was"):
        dr.train(AGENTS["plain"], log, out=tmp_path / "r" / "plain", resume=True, **SETTINGS)
    fewer = {name: AGENTS[name] for name in ("plain", "near")}
    with pytest.raises(dr.UserError, match="holds another run: together was"):
        dr.train_together(fewer, log, out=tmp_path / "r", resume=True, **SETTINGS)
    (tmp_path / "r" / "near" / "evaluations" / "0000000030.parquet").unlink()  # as if it had been killed a little earlier
    resumed = dr.train_together(AGENTS, log, out=tmp_path / "r", resume=True, **SETTINGS)
    for name, run in runs.items():
        assert resumed[name].evaluations.equals(run.evaluations)
        assert [repr(f) for f in resumed[name].failures] == [repr(f) for f in run.failures]
        for a, b in zip(resumed[name].policies, run.policies, strict=True):
            np.testing.assert_array_equal(a(X), b(X))


@pytest.mark.slow
def test_a_watcher_that_has_seen_enough_ends_all(log, tmp_path):
    def watch(progress, steps):
        if progress.step == 20:
            raise StopTraining

    for run in dr.train_together(AGENTS, log, out=tmp_path / "r", watch=watch, **SETTINGS).values():
        assert run.config["steps"] == 20
        assert set(run.evaluations["step"].to_pylist()) == {20}


def test_what_cannot_share_a_program_is_refused_and_nothing_is_written(log, tmp_path):
    out = tmp_path / "r"
    with pytest.raises(dr.UserError, match=r"TD3BC.hidden shapes the program"):
        dr.train_together({"a": td3_bc(), "b": td3_bc(hidden=(8,))}, log, out=out, **SETTINGS)
    for name in ("", ".", "..", "a/b", "a\\b", "/a", "a\0", "a" * 300, "checkpoints"):
        with pytest.raises(dr.UserError, match="agents are named as folders are"):
            dr.train_together({name: td3_bc()}, log, out=out, **SETTINGS)
    with pytest.raises(dr.UserError, match=r"MOBILE.min_target shapes the program"):
        lift([dr.agents.MOBILE(min_target=None), dr.agents.MOBILE(min_target=0.0)])
    with pytest.raises(dr.UserError, match="no agent to train"):
        dr.train_together({}, log, out=out, **SETTINGS)
    (out / "b").mkdir(parents=True)
    (out / "b" / "mine.txt").write_text("not a run")
    with pytest.raises(dr.UserError, match="b exists and is not a run"):
        dr.train_together({"a": td3_bc(), "b": td3_bc(alpha=1.0)}, log, out=out, **SETTINGS)
    assert not (out / "a").exists()


def test_other_runs_do_not_go_on_with_these_checkpoints(runs, log):
    out = runs["plain"].path.parent
    assert any((out / "checkpoints").iterdir())
    with pytest.raises(dr.UserError, match="checkpoints is of other runs; give c, d, e another folder"):
        dr.train_together({name: td3_bc() for name in "cde"}, log, out=out, **SETTINGS)
    assert not (out / "c").exists()


@pytest.mark.slow
def test_agents_that_prepare_themselves_differ_too_also_in_what_they_prepare_with(log, tmp_path):
    small = {"hidden": (8,), "batch_size": 16, "behavior_steps": 10}
    agents = {"a": dr.agents.BRAC(**small, penalty=0.01), "b": dr.agents.BRAC(**small, penalty=10.0, behavior_lr=0.01)}
    options = SETTINGS | {"steps": 10, "seeds": 1, "evaluate_every": 10, "episodes": 1}
    together = dr.train_together(agents, log, out=tmp_path / "all", **options)
    alone = dr.train(agents["b"], log, out=tmp_path / "b", **options)
    np.testing.assert_allclose(together["b"].policy(X), alone.policy(X), atol=1e-3)
    assert np.abs(together["a"].policy(X) - together["b"].policy(X)).max() > 0.01


@pytest.fixture(scope="module")
def logs(log):
    # Of another size, other starts and other rewards: rows, coordinates and scores all tell the logs apart.
    other = generate("maze2d-umaze-v1", steps=900, seed=5)
    return {"one": log, "two": other, "three": log}


@pytest.mark.slow
def test_runs_on_several_logs_are_lanes_of_one_program_and_each_is_the_run_that_it_would_be_alone(logs, tmp_path):
    agents = {"one": td3_bc(), "two": td3_bc(), "three": td3_bc(alpha=0.5)}
    several = dr.train_together(agents, logs, out=tmp_path / "all", **SETTINGS)
    assert several["two"].config["data"]["rows"] == 900
    assert several["two"].config["versions"]["lanes"] == 6
    for name in ("one", "two"):
        alone = dr.train(agents[name], logs[name], out=tmp_path / name, **SETTINGS)
        assert_alike(several[name], alone)
        np.testing.assert_array_equal(several[name].taught, alone.taught)
    assert np.abs(several["one"].policies[0](X) - several["two"].policies[0](X)).max() > 0.01
    assert list(several) == ["one", "two", "three"]


@pytest.mark.slow
def test_several_logs_are_gone_on_with_after_a_kill(logs, tmp_path):
    class Stop(Exception):
        pass

    def watch(progress, steps):
        if progress.step == 20:
            raise Stop

    agents = {name: td3_bc(hidden=(8,)) for name in ("one", "two")}
    own = {name: logs[name] for name in agents}
    whole = dr.train_together(agents, own, out=tmp_path / "whole", **SETTINGS)
    with pytest.raises(Stop):
        dr.train_together(agents, own, out=tmp_path / "r", watch=watch, **SETTINGS)
    resumed = dr.train_together(agents, own, out=tmp_path / "r", resume=True, **SETTINGS)
    for name, run in whole.items():
        assert resumed[name].evaluations.equals(run.evaluations)
        for a, b in zip(resumed[name].policies, run.policies, strict=True):
            np.testing.assert_array_equal(a(X), b(X))


def test_each_log_holds_out_what_it_did_when_its_run_is_gone_on_with(tmp_path):
    agent = dr.agents.BC(hidden=(8,), batch_size=16)
    logs = {"few": corridor(100), "many": corridor(400)}
    settings = {"out": tmp_path / "all", "steps": 4, "chunk": 4, "evaluate_every": 4}
    with pytest.warns(UserWarning, match="5 episodes are too few to hold some out"):
        first = dr.train_together(dict.fromkeys(logs, agent), logs, **settings)
    again = dr.train_together(dict.fromkeys(logs, agent), logs, resume=True, **settings)
    for run, same in ((first[name], again[name]) for name in logs):
        assert same.config == run.config
        np.testing.assert_array_equal(same.held, run.held)
    assert (len(again["few"].held), len(again["many"].held)) == (0, 4)


def test_agents_whose_networks_depend_on_the_length_of_episodes_learn_from_one_log(tmp_path):
    log = corridor(100)
    short = dr.Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards, timeouts=np.arange(100) % 4 == 3,
        action_space=log.action_space, name="short",
    )  # fmt: skip
    agent = dr.agents.DecisionTransformer(hidden=(8,), layers=1, context_length=2, batch_size=4)
    with pytest.raises(dr.UserError, match="networks of other sizes on corridor and short, which cannot share a program"):
        dr.train_together({"a": agent, "b": agent}, {"a": log, "b": short}, out=tmp_path / "all", steps=2, holdout=0)
    assert not (tmp_path / "all").exists()


def test_a_log_is_named_for_every_agent(logs, tmp_path):
    with pytest.raises(dr.UserError, match="data must name the log of each of one, got one, two, three"):
        dr.train_together({"one": td3_bc()}, logs, out=tmp_path / "all", **SETTINGS)
    assert not (tmp_path / "all").exists()
