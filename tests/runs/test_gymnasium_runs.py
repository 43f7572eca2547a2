"""What a Gymnasium environment is used for as a task: learned in, gone on with, collected in, judged in, without a scale."""

import dataclasses
import functools
import json
import warnings
from collections.abc import Mapping
from dataclasses import replace

import gymnasium
import minari
import numpy as np
import pyarrow.parquet as pq
import pytest

import deadreckon as dr
from deadreckon import agents, report
from deadreckon.bench.jobs import Job
from deadreckon.bench.suite import Method, Suite
from deadreckon.bench.tables import METRICS, _metrics
from deadreckon.bench.work import _result
from deadreckon.cli.main import main
from deadreckon.cli.train import summary
from deadreckon.collect import collect_in_task
from deadreckon.data.formats.minari import read_minari, write_minari
from deadreckon.errors import UserError
from deadreckon.files import read_json
from deadreckon.online import Online
from deadreckon.runs import online
from deadreckon.runs.callback import StopTraining
from deadreckon.runs.offline import simulated
from tests import toy_environments as toys

CART = "gymnasium:CartPole-v1?max_episode_steps=30"
OTHERS = "Pendulum-v1?max_episode_steps=20", "FrozenLake-v1?max_episode_steps=15"
SETTINGS = Online(copies=4, explore=32, updates_per_step=0.25, block=16)  # 4 updates a block
AGENT = agents.SAC(hidden=(16,), batch_size=16)
OPTIONS = {"steps": 32 + 6 * 16, "settings": SETTINGS, "chunk": 4, "evaluate_every": 64, "episodes": 3, "seeds": 2}


def train(out, task=CART, **change):
    return dr.train_online(AGENT, task, out=out, **(OPTIONS | change))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return train(tmp_path_factory.mktemp("runs") / "cart")


def rows_of(run, task=CART):
    """Replay rows of the first seed: observation 4, action, reward, next observation 4, terminal, timeout."""
    return np.fromfile(run.path / "replay" / "seed0.bin", np.float32).reshape(-1, 12)


@pytest.mark.slow
def test_discrete_actions_are_learned_from_as_numbers(run):
    rows = rows_of(run)
    assert set(np.unique(rows[:, 4])) == {0.0, 1.0}
    assert 8 <= rows[:32, 4].sum() <= 24  # by chance at first
    env = gymnasium.make("CartPole-v1").unwrapped
    for row in rows[::7]:  # what follows is what the action does
        env.reset(seed=0)
        env.state = row[:4].astype(np.float64)
        np.testing.assert_allclose(env.step(int(row[4]))[0], row[6:10], atol=1e-5)
    assert run.policy.low is None
    assert run.config["task"] == CART
    assert run.config["versions"]["gymnasium"] == gymnasium.__version__


@pytest.mark.parametrize("task", [CART, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)])
def test_a_run_that_was_stopped_goes_on_bit_for_bit(tmp_path, run, task):
    whole = run if task == CART else train(tmp_path / "whole", task)

    def stop(progress, steps):
        if progress.step >= 12:
            raise StopTraining

    train(tmp_path / "parts", task, watch=stop)
    parts = train(tmp_path / "parts", task, resume=True)
    for seed in whole.seeds:
        name = f"replay/seed{seed}.bin"
        assert (whole.path / name).read_bytes() == (parts.path / name).read_bytes()
    assert whole.metrics.equals(parts.metrics)


def test_wrappers_are_told_apart_by_their_arguments_when_a_run_is_gone_on_with(tmp_path, monkeypatch):
    def killed(*given):
        raise StopTraining

    def clipped(least):
        return gymnasium.wrappers.ClipReward(gymnasium.make("CartPole-v1"), least, 1.0)

    monkeypatch.setattr(online, "Recorder", killed)  # once the folder has been begun
    for _ in range(2):
        with pytest.raises(StopTraining):
            train(tmp_path / "run", clipped(-1.0), resume=True)
    with pytest.raises(UserError, match="holds another run: task_fields.env_spec was"):
        train(tmp_path / "run", clipped(0.0), resume=True)


def test_going_on_in_an_environment_that_nothing_tells_from_others_is_warned_about(tmp_path, monkeypatch):
    def killed(*given):
        raise StopTraining

    monkeypatch.setattr(online, "Recorder", killed)  # once the folder has been begun
    for given, warned in ((functools.partial(toys.Shifted), True), (toys.Shifted, False), (toys.short_cart, False)):
        for again in (False, True):
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                with pytest.raises(StopTraining):
                    train(tmp_path / str(given), dr.task(given, horizon=9), resume=again)
            texts = [str(each.message) for each in told if "has no spec: whether" in str(each.message)]
            assert len(texts) == (warned and again), texts


@pytest.mark.slow
def test_episodes_that_cannot_be_repeated_begin_anew_with_a_warning(tmp_path):
    def stop(progress, steps):
        if progress.step >= 12:
            raise StopTraining

    train(tmp_path / "run", dr.task(toys.Unseeded, horizon=50), watch=stop)
    with pytest.warns(UserWarning, match="it draws from elsewhere; 8 episodes start again"):
        found = train(tmp_path / "run", dr.task(toys.Unseeded, horizon=50), resume=True)
    rows = np.fromfile(found.path / "replay" / "seed0.bin", np.float32).reshape(-1, 6)
    per_copy = rows.reshape(-1, 4, 6)
    breaks = (per_copy[1:, :, 0] != per_copy[:-1, :, 3]).any(1)
    assert breaks.sum() == 1  # where it went on, between two blocks: no row has a successor of another episode


@pytest.mark.slow
def test_returns_without_a_scale_are_shown_as_such(tmp_path, run, capsys):
    evaluations = run.evaluations.to_pydict()
    assert "score" not in evaluations
    assert min(evaluations["return"]) >= 1
    told = summary(run)
    assert f"{CART}: return" in told
    assert "score" not in told.split("run folder")[0]
    found = dr.evaluate(run, CART, episodes=3)
    assert found.scores is None
    assert found.score() is None
    assert "score" not in str(found)
    assert main(["evaluate", str(run.path), "--episodes", "3", "--out", str(tmp_path / "e.parquet")]) == 0
    assert "score" not in capsys.readouterr().out
    assert pq.read_table(tmp_path / "e.parquet").column_names == ["policy", "episode", "return", "length"]
    page = report.write([run.path], tmp_path / "page.html").read_text()
    assert "100 expert" not in page
    assert ">return<" in page


def test_suites_show_returns_where_there_are_no_scores(run):
    job = Job("online", "sac", "sac", {}, "", CART, CART, {"steps": 128}, (0, 1))
    rows = _result(job, run).rows
    assert np.isnan(rows[0]["score"])
    last = np.asarray(run.evaluations["step"]) == run.config["steps"]
    own = last & (np.asarray(run.evaluations["seed"]) == 0)
    assert rows[0]["raw"] == pytest.approx(np.asarray(run.evaluations["return"])[own].mean())
    assert rows[0]["episodes"] == []
    metrics = {tasks: [m.column for m in _metrics(Suite("s", "online", tasks, (Method("sac", "sac"),)))]
               for tasks in ((CART,), ("hopper",), ("hopper", CART))}  # fmt: skip
    assert list(metrics.values()) == [["raw"], ["score"], ["score", "raw"]]
    assert METRICS["online"] == METRICS["learn"]


# ---- logs -------------------------------------------------------------------------------------------------------------


def test_a_log_by_chance(tmp_path):
    path = collect_in_task(CART, steps=200, seed=3, out=tmp_path / "a.hdf5")
    log = dr.read(path)
    assert len(log) == 200
    assert log.spec.discrete
    assert 70 <= np.asarray(log.actions).sum() <= 130
    np.testing.assert_allclose(np.asarray(log.extras["behavior_log_probs"]), np.log(0.5), rtol=1e-6)
    again = dr.read(collect_in_task(CART, steps=200, seed=3, out=tmp_path / "b.hdf5"))
    assert log.fingerprint == again.fingerprint
    assert (log.lengths < 31).all()
    assert log.provenance.extra["task"] == CART
    assert log.provenance.versions["gymnasium"] == gymnasium.__version__


def test_versions_of_a_task_may_be_any_mapping(tmp_path):
    class Versions(Mapping):
        def __getitem__(self, name):
            return {"simulator": "3"}[name]

        def __iter__(self):
            return iter(["simulator"])

        def __len__(self):
            return 1

    task = replace(dr.task(CART), packages=Versions())
    assert dr.read(collect_in_task(task, steps=20, out=tmp_path / "a.hdf5")).provenance.versions["simulator"] == "3"


def test_a_log_of_a_policy(tmp_path, run, capsys):
    out = tmp_path / "log.hdf5"
    asked = ["data", "collect", "--task", CART, "--policy", str(run.path), "--steps", "60", "--out", str(out)]
    assert main(asked) == 2  # two seeds: which?
    assert "has 2 policies; one makes a log: name one of" in capsys.readouterr().err
    log = dr.read(collect_in_task(CART, run.policies[1], steps=60, out=out))
    found = run.policies[1].log_prob(np.asarray(log.observations), np.asarray(log.actions))
    np.testing.assert_allclose(np.asarray(log.extras["behavior_log_probs"]), found, atol=1e-5)
    assert not np.allclose(found, found[0])


def test_what_cannot_be_collected_is_refused(tmp_path, capsys):
    assert main(["data", "collect"]) == 2
    assert "name either a known log" in capsys.readouterr().err
    assert main(["data", "collect", "maze2d-umaze-v1", "--task", CART]) == 2
    assert main(["data", "collect", "maze2d-umaze-v1", "--policy", "x"]) == 2
    assert "--policy x is for --task TASK" in capsys.readouterr().err
    with pytest.raises(UserError, match="steps must be 1 or more"):
        collect_in_task(CART, steps=0)
    (tmp_path / "a.hdf5").touch()
    with pytest.raises(UserError, match="exists already"):
        collect_in_task(CART, out=tmp_path / "a.hdf5")


@pytest.mark.parametrize(
    "name", [CART, "FrozenLake-v1", "Pendulum-v1", "tests.toy_environments:Shifted?max_episode_steps=9", "maze2d-umaze"]
)
def test_minari_opens_the_environment_of_a_log_again(tmp_path, monkeypatch, name):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    log = dr.read(collect_in_task(name, steps=40, seed=1, out=tmp_path / "log.hdf5"))
    write_minari(log, "mine/log-v0")
    found = minari.load_dataset("mine/log-v0")
    back = read_minari("minari:mine/log-v0")
    np.testing.assert_array_equal(back.observations, log.observations)
    np.testing.assert_array_equal(back.actions, log.actions)
    if "toy" in name:  # no id: Gymnasium cannot make it
        assert found.spec.env_spec is None
        assert found.action_space == gymnasium.spaces.Discrete(3, start=5)
        return
    env = found.recover_environment()
    assert env.observation_space.shape == found.observation_space.shape
    np.testing.assert_allclose(env.observation_space.low, found.observation_space.low)
    np.testing.assert_allclose(env.observation_space.high, found.observation_space.high)
    assert env.action_space == found.action_space
    np.testing.assert_array_equal(np.asarray(env.reset(seed=5)[0], np.float32), dr.task(name).simulate([5]).reset()[0])


def test_bounds_hold_every_row(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    log = dr.read(collect_in_task("Pendulum-v1", steps=40, out=tmp_path / "log.hdf5"))
    beyond = dr.Dataset.from_arrays(
        observations=np.asarray(log.observations) * 20, actions=np.asarray(log.actions), rewards=np.asarray(log.rewards),
        action_space=log.action_space, name="beyond", provenance=log.provenance,
    )  # fmt: skip
    write_minari(beyond, "mine/log-v0")
    space = minari.load_dataset("mine/log-v0").observation_space
    assert space.contains(np.asarray(beyond.observations[7]))
    assert space.low[0] < -1
    assert space.low[2] <= -8


def test_a_file_names_no_code_that_runs_when_it_is_written(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    spec = json.dumps({"id": "X-v0", "entry_point": "tests.no_such_module:X", "kwargs": {}, "additional_wrappers": []})
    log = dr.Dataset.from_arrays(
        observations=np.zeros((4, 1), np.float32), actions=np.zeros((4, 1), np.float32), rewards=np.zeros(4), name="x",
        provenance=dr.data.provenance.Provenance(extra={"env_spec": spec, "observation_bounds": [[None], [1.0]]}),
    )  # fmt: skip
    write_minari(log, "mine/log-v0")
    space = minari.load_dataset("mine/log-v0").observation_space
    assert (space.low[0], space.high[0]) == (-np.inf, 1.0)


# ---- judged in --------------------------------------------------------------------------------------------------------


def test_the_choice_is_checked_in_an_environment(run):
    estimand = {"discount": 1.0, "horizon": None, "greedy": True}
    found = simulated(run.policies, dr.task(CART), estimand, episodes=4, seed=2)
    played = dr.evaluate(run, CART, episodes=4, seed=2)
    np.testing.assert_allclose(found["mean"], played.returns.mean(1))
    assert "beyond" not in found  # what has no discount ends
    short = dataclasses.replace(dr.task(CART), horizon=5)
    limited = simulated(run.policies, short, estimand | {"discount": 0.9}, episodes=4, seed=2)
    assert limited["beyond"] == pytest.approx(0.9**5)  # estimates count what follows, and the simulator does not show it


@pytest.mark.slow
def test_a_log_is_judged_in_an_environment_of_its_shape(tmp_path):
    log = dr.read(collect_in_task(CART, steps=120, out=tmp_path / "log.hdf5"))
    options = {"steps": 2, "episodes": 2, "evaluate_every": 2, "chunk": 2}
    cloning, env = agents.BC(hidden=(16,), batch_size=16), gymnasium.make("CartPole-v1")
    found = dr.train(cloning, log, task=env, out=tmp_path / "run", **options)
    assert found.config["task"] == "gymnasium:CartPole-v1"
    assert "score" not in found.evaluations.column_names
    assert read_json(tmp_path / "run" / "status.json")["finished"]
    with pytest.raises(UserError, match=r"gymnasium:Acrobot-v1 shows observations of shape \(6,\)"):
        dr.train("bc", log, task="Acrobot-v1", out=tmp_path / "other", **options)
