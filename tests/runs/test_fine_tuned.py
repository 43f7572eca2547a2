"""Runs on a log that go on in a simulator: what they begin with, kills, what is refused, what is told."""

import shutil
from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import deadreckon as dr
from deadreckon import tasks
from deadreckon.agents import agent_class
from deadreckon.cli.main import main
from deadreckon.cli.train import summary
from deadreckon.data.batch import BatchSpec
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.normalizer import STD_FLOOR
from deadreckon.files import read_json
from deadreckon.online import Online
from deadreckon.report.entries import read
from deadreckon.report.provenance import command, section
from deadreckon.runs import online as module
from deadreckon.runs import started
from deadreckon.runs.evaluate import evaluate
from deadreckon.runs.gather import gather
from deadreckon.runs.reading import Read
from deadreckon.training.checkpoint import load_arrays
from deadreckon.training.fit import Failure
from tests.agents.corridor_task import CORRIDOR
from tests.agents.little import Little
from tests.agents.worlds import corridor
from tests.runs.test_online import Stop, assert_same

HOPPER = replace(tasks.task("hopper"), horizon=20)
SETTINGS = Online(copies=4, explore=0, updates_per_step=0.5, block=16)  # 8 updates a block
STEPS, UPDATES = 96, 48
OPTIONS = {"steps": STEPS, "settings": SETTINGS, "chunk": 8, "evaluate_every": 32, "episodes": 2, "threads": 1}


class Returned(Little):
    """Also imitates by what episodes returned, in standardised observations, and keeps a target."""

    fine_tunes: ClassVar[bool] = True

    def needs(self, spec):
        return BatchSpec((*BatchSpec.columns, "monte_carlo"), self.batch_size, standardise=True)

    def init(self, spec, key):
        net = super().init(spec, key)
        return {"net": net, "target": jax.tree.map(jnp.copy, net)}

    def update(self, state, batch, *, step, key):
        known = jnp.where(jnp.isfinite(batch.monte_carlo[:, 0]), batch.monte_carlo.sum(1), 0.0)
        net, metrics = super().update(state["net"], batch._replace(reward=batch.reward + 0.1 * known), step=step, key=key)
        target = jax.tree.map(lambda t, n: t + 0.1 * (n - t), state["target"], net)
        return {"net": net, "target": target}, metrics

    def policy(self, state):
        return super().policy(state["net"])


def log_of(seed=0, episodes=12, length=10, name="hops"):
    rng = np.random.default_rng(seed)
    rows = episodes * length
    ends = np.arange(rows) % length == length - 1
    return Dataset.from_arrays(
        observations=rng.normal(1.0, 2.0, (rows, 11)), actions=rng.uniform(-1, 1, (rows, 3)), rewards=rng.normal(size=rows),
        terminals=ends & (np.arange(rows) < 50), timeouts=ends & (np.arange(rows) >= 50),
        final_observations=rng.normal(1.0, 2.0, (episodes, 11)), action_space=HOPPER.action_space, name=name,
    )  # fmt: skip


LOG = log_of()


@pytest.fixture(scope="module")
def offline(tmp_path_factory):
    """Two seeds on the log, of which a quarter is held out."""
    out = tmp_path_factory.mktemp("runs") / "offline"
    return dr.train(Returned(), LOG, steps=20, seeds=2, seed=5, task=HOPPER, holdout=0.25, episodes=2, out=out)


def tuned(start, out, **change):
    return dr.train_online(out=out, **{"task": HOPPER, "start": start, "data": LOG, **OPTIONS, **change})


@pytest.fixture(scope="module")
def run(offline, tmp_path_factory):
    return tuned(offline, tmp_path_factory.mktemp("runs") / "whole")


def states(run, step=None):
    names = sorted(run.path.joinpath("checkpoints").glob("*.npz"))
    return load_arrays(names[-1] if step is None else run.path / "checkpoints" / f"{step:010d}.npz")[0]


def test_it_begins_with_the_parameters_targets_and_coordinates_of_the_run(offline, tmp_path):
    def stop(progress, steps):
        raise Stop

    with pytest.raises(Stop):
        tuned(offline, tmp_path / "r", watch=stop)
    first = load_arrays(tmp_path / "r" / "checkpoints" / f"{0:010d}.npz")[0]
    mine = {name.removeprefix("['learner']"): value for name, value in first.items() if name.startswith("['learner']")}
    theirs = states(offline)
    assert mine.keys() == theirs.keys()
    assert any("target" in name for name in mine)
    for name, value in theirs.items():
        np.testing.assert_array_equal(mine[name], value, err_msg=name)
    seen = np.random.default_rng(0).normal(size=(5, 11)).astype(np.float32)
    for seed, policy in zip(offline.seeds, offline.policies):
        begins = dr.policies.store.load(tmp_path / "r" / "policies" / f"{0:010d}-seed{seed}.npz")
        np.testing.assert_array_equal(begins(seen), policy(seen))
        learned = LOG.select(np.flatnonzero(np.isin(LOG.episode_ids, offline.taught)))
        np.testing.assert_allclose(begins.std, learned.observations.std(0) + STD_FLOOR, rtol=1e-5)


@pytest.mark.slow
def test_its_curve_begins_with_the_policy_of_the_run(offline, run):
    told = run.evaluations.to_pydict()
    assert sorted(set(told["step"])) == [0, 16, 32, 48]
    np.testing.assert_allclose(evaluate(offline, HOPPER, episodes=2).returns.ravel(), told["return"][:4])
    assert run.metrics["environment_steps"].to_pylist()[::2] == [16, 32, 48, 64, 80, 96]  # none before the policy acts


def test_the_folder_tells_what_it_began_with(offline, run):
    log, start = run.config["log"], run.config["start"]
    assert start["updates"] == 20
    assert start["path"] == str(offline.path)
    assert (log["name"], log["fingerprint"], log["share"], log["episodes"]) == ("hops", LOG.fingerprint, 0.5, 9)
    assert run.config["seeds"] == [5, 6]
    assert np.isin(offline.taught, run.taught).all()
    assert len(run.taught) > len(offline.taught)  # the others are of its own steps
    np.testing.assert_array_equal(run.held, offline.held)  # what was held out is still unseen
    assert len(run.held) == 3


@pytest.mark.parametrize("change", [{"seed": 0}, {"seeds": 3}, {"seed": 5, "seeds": 1}, {"seed": 6}])
def test_other_seeds_than_those_of_the_run_are_refused(offline, change, tmp_path):
    with pytest.raises(dr.UserError, match=r"has the seeds \[5, 6\]; leave seeds and seed out"):
        tuned(offline, tmp_path / "no", **change)


def test_how_its_log_was_read_and_what_was_held_out_together_are_known(run):
    """As of a run on the log: what `ope` refuses for that one, it refuses for this."""
    told = run.config | {"log_read": {"extra": {"horizon": 200}, "path": "hops.hdf5"}}
    told["log"] = run.config["log"] | {"holdout": {"by": "site"}}
    found = gather(replace(run, config=told))[0]
    assert (found.by, found.read.extra, found.read.path) == ("site", {"horizon": 200}, "hops.hdf5")


def test_held_out_episodes_are_not_in_the_replay(offline, run):
    job = module.reopened(run.path, LOG, HOPPER)
    assert job.source.experience.log.episodes == 9
    np.testing.assert_array_equal(np.sort(job.source.experience.log.episode_ids), np.sort(offline.taught))


def test_the_last_lines_count_the_steps_of_simulation(run):
    told = summary(run)
    lengths = sum(run.evaluations["length"].to_pylist()) // 2
    assert f"simulated: {STEPS} environment steps per seed in training, {lengths} in 4 evaluations" in told
    assert "from return" in told


def test_the_report_tells_what_it_began_with_and_how_it_is_made_again(offline, run):
    page = read([run.path])
    [entry] = page.entries
    assert entry.label.endswith(" fine-tuned")
    assert command(entry).startswith("# no command: ")  # the horizon is not hopper's
    named = {name: value for name, value in entry.config.items() if name != "task_fields"}
    words = command(replace(entry, config=named)).split()
    assert words[:5] == ["deadreckon", "train", "--online", "--task", "hopper"]
    assert words[words.index("--from") + 1] == str(offline.path)
    assert words[words.index("--data") + 1] == "hops"
    told = str(section(page))
    for fact in ("continues", "after 20 updates on the log", "90 rows, 50% of each batch; 3 episodes are held out"):
        assert fact in told
    assert f"{STEPS} environment steps per seed in training" in told


@pytest.mark.slow
@pytest.mark.parametrize("step", [8, 16, 48])
def test_killed_and_resumed_is_the_same_as_unbroken(offline, run, step, tmp_path):
    def stop(progress, steps):
        if progress.step == step:
            raise Stop

    with pytest.raises(Stop):
        tuned(offline, tmp_path / "r", watch=stop)
    again = tuned(offline, tmp_path / "r", resume=True)
    assert_same(again, run, STEPS)
    assert again.metrics.equals(run.metrics)


@pytest.mark.slow
def test_made_longer_it_equals_one_that_was_long(offline, run, tmp_path):
    short = tuned(offline, tmp_path / "r", steps=64)
    assert short.config["steps"] == 32
    again = tuned(offline, tmp_path / "r", resume=True)
    assert_same(again, run, STEPS)


@pytest.mark.slow
def test_another_start_share_or_log_is_another_run(offline, run, tmp_path):
    with pytest.raises(dr.UserError, match=r"holds another run: log.share was 0.5, now 0.25"):
        tuned(offline, run.path, resume=True, log_share=0.25)
    other = dr.train(Returned(), LOG, steps=25, seeds=2, seed=5, task=HOPPER, holdout=0.25, episodes=2, out=tmp_path / "o")
    with pytest.raises(dr.UserError, match=r"holds another run: start.updates was 20, now 25"):
        tuned(other, run.path, resume=True)
    with pytest.raises(dr.UserError, match=r"another log \(\w+\) than hops \(\w+\), the log of the run"):
        tuned(offline, tmp_path / "r", data=log_of(seed=1))
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
def test_one_of_several_runs_that_shared_a_program_goes_on(offline, tmp_path):
    options = {"steps": 20, "seeds": 2, "seed": 5, "task": HOPPER, "holdout": 0.25, "episodes": 2}
    agents = {"slow": Returned(lr=1e-3), "same": Returned()}
    runs = dr.train_together(agents, LOG, out=tmp_path / "together", **options)
    other = tuned(runs["same"], tmp_path / "r", steps=16)
    alone = tuned(offline, tmp_path / "s", steps=16)
    for name, value in states(alone, 0).items():
        np.testing.assert_allclose(states(other, 0)[name], value, rtol=1e-4, atol=1e-5, err_msg=name)
    assert other.config["agent"]["fields"]["lr"] == 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("change", "words"), [
    ({"seeds": 3}, r"the run to continue has the seeds \[5, 6\]; leave seeds and seed out"),
    ({"agent": "sac"}, "is a run of tests.runs.test_fine_tuned:Returned, sac cannot continue it"),
    ({"agent": Returned(hidden=(5,))}, r"checkpoints/0000000020.npz does not fit: .* is \(\(2, .*\) is needed"),
    ({"log_share": 1.0}, "log_share must be 0 or more and below 1, got 1.0"),
    ({"task": "maze2d-umaze"}, r"hops has observations \(11,\) and 3 actions, maze2d-umaze has \(4,\) and 2"),
    ({"demonstrations": LOG}, "give one of them"),
    ({"start": None, "data": None}, "train_online needs an agent, or an offline run to continue"),
    ({"start": None, "agent": "ppo"}, "PPO does not learn online with a log in its replay; these agents do: "),
    ({"start": None, "agent": "sac", "data": None}, "must be 1 or more where no log is learned from, got 0"),
])  # fmt: skip
def test_what_does_not_fit_is_told_before_anything_is_written(offline, change, words, tmp_path):
    options = OPTIONS | {"task": HOPPER, "start": offline, "data": LOG} | change
    with pytest.raises(dr.UserError, match=words):
        dr.train_online(out=tmp_path / "no", **{name: value for name, value in options.items() if value is not None})
    assert not (tmp_path / "no").exists()


def test_runs_that_cannot_go_on(offline, run, tmp_path):
    with pytest.raises(dr.UserError, match="is an online run already; --resume with more --steps continues it"):
        tuned(run, tmp_path / "r")
    failed = replace(offline, failures=[None, Failure("loss", 7)])
    with pytest.raises(dr.UserError, match="seed 6 of .* failed at update 7; train it again before continuing it"):
        tuned(failed, tmp_path / "r")
    shutil.copytree(offline.path, tmp_path / "bare")
    shutil.rmtree(tmp_path / "bare" / "checkpoints")
    with pytest.raises(dr.UserError, match="has no checkpoint of update 20, the last of"):
        tuned(tmp_path / "bare", tmp_path / "r")


@pytest.mark.slow
def test_a_log_may_stand_in_the_replay_of_an_agent_that_has_learned_nothing(tmp_path):
    options = OPTIONS | {"settings": replace(SETTINGS, explore=16)}
    made = dr.train_online(Returned(), HOPPER, data=LOG, out=tmp_path / "r", **options)
    assert "start" not in made.config
    assert made.config["log"]["episodes"] == 12
    assert np.isin(LOG.episode_ids, made.taught).all()
    assert made.metrics["environment_steps"].to_pylist()[0] == 32
    job = module.reopened(made.path, LOG, HOPPER)
    assert job.step == 40
    assert job.source.experience.logged == 4


@pytest.mark.slow
def test_from_the_command_line(tmp_path, home, capsys):
    path, agent = tmp_path / "hops.hdf5", "tests.runs.test_fine_tuned:Returned"
    write_hdf5(LOG, path)
    words = ["train", "--agent", agent, "--data", str(path), "--task", "hopper", "--steps", "4", "--episodes", "1"]
    assert main([*words, "--agent.hidden", "5", "--out", str(tmp_path / "a")]) == 0
    turns = ["--copies", "4", "--block", "16", "--updates-per-step", "0.5", "--evaluate-every", "16", "--threads", "1"]
    words = ["train", "--from", str(tmp_path / "a"), "--online", "--task", "hopper", "--steps", "32", "--episodes", "1", *turns]
    capsys.readouterr()
    assert main([*words, "--agent", agent, "--agent.lr", "0.002", "--out", str(tmp_path / "b")]) == 0
    assert "32 environment steps per seed in training" in capsys.readouterr().out
    config = read_json(tmp_path / "b" / "run.json")
    fields = config["agent"]["fields"]
    assert (config["agent"]["name"], fields["lr"], fields["hidden"], config["online"]["explore"]) == (agent, 0.002, [5], 0)
    assert main([*words, "--agent", "sac", "--out", str(tmp_path / "c")]) == 2
    assert f"is a run of {agent}, sac cannot continue it; leave --agent out" in capsys.readouterr().err
    assert main(["train", "--from", str(tmp_path / "a"), "--data", str(path)]) == 2
    assert "--from continues an offline run in a simulator: add --online --task TASK" in capsys.readouterr().err


def test_the_log_is_read_again_as_it_was(monkeypatch):
    seen, read = [], Read({"schema": "that of the run"})
    monkeypatch.setattr(started, "read_like", lambda *given: seen.append(given) or LOG)
    known = {"name": "hops", "path": "hops.csv", "task": "hopper", "holdout": None, "fingerprint": LOG.fingerprint}
    assert started.beside(None, known, read, HOPPER, 0.5).log.episodes == 12
    assert seen == [("hops", read, "hops.csv")]


@pytest.mark.slow
def test_a_table_whose_columns_were_named_on_the_command_line_is_read_again_by_its_schema(tmp_path, home, capsys):
    rows = np.concatenate([LOG.observations, LOG.actions, LOG.rewards[:, None]], 1)
    trip = np.repeat(np.arange(12), 10)
    ends = np.stack([LOG.terminals, LOG.timeouts], 1).astype(int)
    names = [*(f"seen {i}" for i in range(11)), "hip", "knee", "foot", "gain", "trip", "fell", "stopped"]
    lines = [";".join([*(f"{x:.4f}" for x in row), str(k), *map(str, end)]) for row, k, end in zip(rows, trip, ends)]
    (tmp_path / "hops.csv").write_text("\n".join([";".join(names), *lines]))
    columns = ["--action", "hip", "knee", "foot", "--reward", "gain", "--episode", "trip", "--terminal", "fell"]
    agent = "tests.runs.test_fine_tuned:Returned"
    words = ["train", "--agent", agent, "--data", str(tmp_path / "hops.csv"), *columns, "--timeout", "stopped"]
    words += ["--task", "hopper", "--steps", "4", "--episodes", "1"]
    assert main([*words, "--out", str(tmp_path / "a")]) == 0
    turns = ["--copies", "4", "--block", "16", "--updates-per-step", "0.5", "--evaluate-every", "16", "--threads", "1"]
    words = ["train", "--from", str(tmp_path / "a"), "--online", "--task", "hopper", "--steps", "32", "--episodes", "1", *turns]
    assert main([*words, "--out", str(tmp_path / "b")]) == 0, capsys.readouterr().err
    config = read_json(tmp_path / "b" / "run.json")
    assert config["log"]["episodes"] == 12
    assert module.reopened(tmp_path / "b").source.experience.log.episodes == 12
    shutil.copy(tmp_path / "hops.csv", tmp_path / "copy.csv")
    (tmp_path / "hops.csv").write_text("gone")
    assert module.reopened(tmp_path / "b", tmp_path / "copy.csv").source.experience.log.episodes == 12


# A log of actions in [-0.5, 0]: nobody has seen what moves to the right brings, so what is left of the middle stays there or
# leaves it further. Six seeds of these settings had these mean returns before they acted, and after 3,000 steps of their own
# (the best there is: -0.27), each seed above its own beginning: Cal-QL -7.5 and -5.9, TD3+BC -1.6 and -0.45, IQL -5.3 and
# -0.45, SAC -1.0 and -0.30.
TUNED = {
    "cal_ql": ({"critic_hidden": (16, 16), "samples": 4, "cql_weight": 0.5, "temperature": 0.01}, -7.0),
    "td3_bc": ({}, -0.8), "iql": ({"beta": 10.0, "expectile": 0.9}, -0.8), "sac": ({"temperature": 0.01}, -0.6),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", TUNED)
def test_what_a_narrow_log_taught_gets_better_online(name, tmp_path):
    fields, least = TUNED[name]
    fast = {"hidden": (16, 16), "batch_size": 64, "actor_lr": 1e-3, "critic_lr": 1e-3, "discount": 0.9}
    log, agent = corridor(actions="half"), agent_class(name)(**fast | fields)
    run = dr.train(agent, log, steps=1500, seeds=3, episodes=20, evaluate_every=1500, task=CORRIDOR, out=tmp_path / "offline")
    online = dr.train_online(
        task=CORRIDOR, start=run, data=log, steps=3000, settings=Online(copies=4, explore=0, block=20), episodes=20,
        evaluate_every=1000, out=tmp_path / "online",
    )  # fmt: skip
    returns = online.evaluations["return"].to_numpy().reshape(4, 3, 20).mean(2)
    assert (returns[-1] > returns[0]).all()  # of every seed
    assert returns[-1].mean() > least
