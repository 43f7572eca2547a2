"""Runs that make their own rows: the folder, kills, more steps than at first, refusals."""

import shutil
from dataclasses import asdict, replace

import jax
import numpy as np
import pytest

import deadreckon as dr
from deadreckon import tasks
from deadreckon.cli.main import main
from deadreckon.cli.train import summary
from deadreckon.data.formats.hdf5 import read_hdf5, write_hdf5
from deadreckon.data.provenance import Provenance
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.online import Online, replay_log
from deadreckon.online.rows import row_width
from deadreckon.policies import store
from deadreckon.runs import online as module
from deadreckon.runs.evaluate import evaluate
from deadreckon.runs.gather import LEARNED, NOBODY, fresh, gather
from deadreckon.runs.recorder import Recorder
from deadreckon.training.checkpoint import load_arrays
from tests.agents.little import Little

# Some episodes end with a fall and some with the horizon.
HOPPER = replace(tasks.task("hopper"), horizon=20)
SETTINGS = Online(copies=4, explore=32, updates_per_step=0.5, block=16)  # 8 updates a block
STEPS, UPDATES = 32 + 6 * 16, 48
OPTIONS = {"steps": STEPS, "settings": SETTINGS, "chunk": 8, "evaluate_every": 32, "episodes": 3}


def train(out, agent=None, task=HOPPER, **change):
    return dr.train_online(agent or Little(), task, out=out, **(OPTIONS | change))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return train(tmp_path_factory.mktemp("runs") / "whole")


def assert_same(ours, theirs, steps=STEPS):
    """Learner, replay file and tables to the bit."""
    (mine, meta), (other, other_meta) = (load_arrays(max((run.path / "checkpoints").glob("*.npz"))) for run in (ours, theirs))
    assert meta == other_meta
    assert mine.keys() == other.keys()
    for name, array in mine.items():
        np.testing.assert_array_equal(array, other[name], err_msg=name)
    for seed in ours.seeds:
        rows = (ours.path / "replay" / f"seed{seed}.bin").read_bytes()
        assert len(rows) == steps * row_width(HOPPER) * 4
        assert rows == (theirs.path / "replay" / f"seed{seed}.bin").read_bytes()
    assert ours.evaluations.equals(theirs.evaluations)
    seen = np.random.default_rng(0).normal(size=(5, 11)).astype(np.float32)
    for a, b in zip(ours.policies, theirs.policies, strict=True):
        np.testing.assert_array_equal(a(seen), b(seen))


class Stop(Exception):
    pass


def stop_at(step):
    def watch(progress, steps):
        assert steps == UPDATES
        if progress.step == step:
            raise Stop

    return watch


def replayed(run, seed=0, steps=STEPS):
    """A seed's first steps as a log."""
    path = run.path / "replay" / f"seed{seed}.bin"
    return replay_log(path, HOPPER, SETTINGS.copies, steps, name="replay", provenance=Provenance("replay"))


def test_its_own_steps_are_episodes_that_it_was_trained_on(run, tmp_path):
    """Estimates of them are not of held-out episodes, and nothing is deployed by them; other logs it has not seen."""
    log = replayed(run)
    np.testing.assert_array_equal(run.taught, np.unique(log.episode_ids))
    assert run.held.size == 0
    np.testing.assert_array_equal(store.load_all(run.path / "policies" / "seed0.npz").taught, run.taught)
    assert store.load_all(run.path / "policies" / f"{16:010d}-seed0.npz").taught is None  # whose steps had not all been taken
    write_hdf5(log, tmp_path / "replay.hdf5")
    for given in (log, read_hdf5(tmp_path / "replay.hdf5")):
        assert fresh(gather(run), given, False).against == [LEARNED]
    other = replayed(train(tmp_path / "other", seed=1), 1)
    for given in (run, run.path / "policies" / "seed0.npz"):
        assert fresh(gather(given), other, False).against == [None]
        # Fewer of its steps end each copy's last episode elsewhere: these look new, and they are not.
        with pytest.raises(UserError, match="4 of .* are not known to .*, while the others are"):
            fresh(gather(given), replayed(run, steps=STEPS - 8), False)


def test_the_note_of_an_older_run_which_names_no_episodes_is_not_believed(run, tmp_path):
    shutil.copytree(run.path, tmp_path / "r")
    none = np.zeros(0, np.uint64)
    np.savez(tmp_path / "r" / "episodes.npz", taught=none, held=none)
    old = dr.load_run(tmp_path / "r")
    assert old.taught is None
    assert fresh(gather(old), replayed(run), False).against == [NOBODY]
    (tmp_path / "r" / "policies" / "seed0.npz").unlink()  # and if it had not finished, it is noted now
    np.testing.assert_array_equal(train(tmp_path / "r", resume=True).taught, run.taught)


@pytest.mark.slow
def test_run_folder_holds_what_was_asked_and_what_came_out(run):
    config = run.config
    assert config["agent"] == {"name": "tests.agents.little:Little", "fields": {"lr": 0.01, "hidden": [4], "batch_size": 8}}
    assert config["online"] == asdict(SETTINGS)
    assert config["task"] == "hopper"
    assert config["steps"] == UPDATES
    assert config["evaluation"] == {"every": 16, "episodes": 3}
    assert read_json(run.path / "status.json") == {"step": 48, "steps": 48, "finished": True, "failures": [None]}
    metrics = run.metrics.to_pydict()
    assert metrics["step"] == [8, 16, 24, 32, 40, 48]
    assert metrics["environment_steps"] == [48, 64, 80, 96, 112, 128]
    assert np.isfinite(metrics["loss"]).all()
    evaluations = run.evaluations.to_pydict()
    assert evaluations["step"] == [s for s in (0, 16, 32, 48) for _ in range(3)]  # the untrained policy is judged too
    assert len(set(evaluations["return"])) > 6
    with np.load(run.path / "evaluations" / "trajectories.npz") as file:
        lengths = evaluations["length"][-3:]
        assert file["trajectories"].shape == (1, 3, max(lengths), 11)
    rows = np.fromfile(run.path / "replay" / "seed0.bin", np.float32).reshape(STEPS, -1)
    terminals, timeouts = rows[:, -2] > 0, rows[:, -1] > 0
    assert terminals.any()
    assert timeouts.any()


def test_evaluations_are_of_the_policies_kept(run):
    last = run.evaluations.to_pydict()
    np.testing.assert_allclose(evaluate(run, HOPPER, episodes=3).returns.ravel(), last["return"][-3:])
    first = evaluate(run.path / "policies" / f"{0:010d}-seed0.npz", HOPPER, episodes=3)
    np.testing.assert_allclose(first.returns.ravel(), last["return"][:3])


@pytest.mark.slow
@pytest.mark.parametrize("step", [8, 16, 48])
def test_killed_and_resumed_is_the_same_as_unbroken(run, step, tmp_path):
    with pytest.raises(Stop):
        train(tmp_path / "r", watch=stop_at(step))
    with pytest.raises(dr.UserError, match="not finished"):
        dr.load_run(tmp_path / "r")
    rows = tmp_path / "r" / "replay" / "seed0.bin"
    assert rows.exists() == (step > 8)
    rows.parent.mkdir(exist_ok=True)
    with open(rows, "ab") as file:
        file.write(b"\x7f" * 1003)  # the kill fell into the next write
    with pytest.raises(dr.UserError, match="holds a run already"):
        train(tmp_path / "r")
    again = train(tmp_path / "r", resume=True, threads=1)
    assert_same(again, run)
    assert again.metrics.equals(run.metrics)


@pytest.mark.slow
def test_killed_before_the_first_checkpoint_and_after_the_last(run, tmp_path, monkeypatch):
    def stop(self, *args):
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(Recorder, "judge_now", stop)
        with pytest.raises(Stop):
            train(tmp_path / "r")
    assert not (tmp_path / "r" / "checkpoints").exists()
    with monkeypatch.context() as patch:
        patch.setattr(Recorder, "finish", stop)
        with pytest.raises(Stop):
            train(tmp_path / "r", resume=True)
    assert max((tmp_path / "r" / "checkpoints").iterdir()).stem == f"{48:010d}"
    (tmp_path / "r" / "evaluations" / f"{32:010d}.parquet").unlink()  # its evaluation was still under way
    again = train(tmp_path / "r", resume=True)
    assert_same(again, run)
    assert again.metrics.equals(run.metrics)


@pytest.mark.slow
def test_a_broken_newest_checkpoint_costs_no_more_than_the_chunk_before_it(run, tmp_path):
    with pytest.raises(Stop):
        train(tmp_path / "r", watch=stop_at(40))
    newest = max((tmp_path / "r" / "checkpoints").iterdir())
    newest.write_bytes(newest.read_bytes()[:200])
    again = train(tmp_path / "r", resume=True, chunk=1000)
    assert_same(again, run)
    # What the killed run had told of its later chunks is forgotten; evaluations end a chunk.
    assert again.metrics["step"].to_pylist() == [8, 16, 24, 32, 48]


def test_a_replay_file_that_lost_rows(run, tmp_path):
    """The checkpoint before is taken up where it counts no more than there are; else it is told in one line."""
    shutil.copytree(run.path, tmp_path / "r")
    rows = tmp_path / "r" / "replay" / "seed0.bin"
    whole = rows.read_bytes()
    rows.write_bytes(whole[:-1])
    assert_same(train(tmp_path / "r", resume=True), run)
    assert rows.read_bytes() == whole
    rows.write_bytes(whole[:1000])
    with pytest.raises(dr.UserError, match=f"seed0.bin holds 8 rows, the checkpoint counts {STEPS - 16}$"):
        train(tmp_path / "r", resume=True)
    rows.unlink()
    with pytest.raises(dr.UserError, match=r"cannot read .*seed0.bin: No such file or directory$"):
        train(tmp_path / "r", resume=True)


def test_chunks_change_nothing(run, tmp_path):
    other = train(tmp_path / "r", chunk=1000)
    assert_same(other, run)
    assert other.metrics["step"].to_pylist() == [16, 32, 48]  # evaluations end a chunk


def test_a_finished_run_is_given_back(run):
    before = {path: path.stat().st_mtime_ns for path in run.path.rglob("*.npz")}
    again = train(run.path, resume=True)
    assert again.metrics.equals(run.metrics)
    assert {path: path.stat().st_mtime_ns for path in run.path.rglob("*.npz")} == before


@pytest.fixture(scope="module")
def longer(tmp_path_factory):
    return train(tmp_path_factory.mktemp("runs") / "longer", steps=STEPS + 48)


@pytest.mark.slow
def test_a_run_made_longer_equals_one_that_was_long_from_the_beginning(run, longer, tmp_path):
    shutil.copytree(run.path, tmp_path / "r")
    # Killed right after it was made longer: it is not finished any more, and the old policy is not taken for its last.
    with pytest.raises(Stop):
        train(tmp_path / "r", steps=STEPS + 48, resume=True, watch=lambda progress, steps: (_ for _ in ()).throw(Stop))
    with pytest.raises(dr.UserError, match="not finished"):
        dr.load_run(tmp_path / "r")
    again = train(tmp_path / "r", steps=STEPS + 48, resume=True)
    assert_same(again, longer, STEPS + 48)
    assert again.metrics.equals(longer.metrics)
    np.testing.assert_array_equal(again.taught, longer.taught)
    assert again.config["steps"] == longer.config["steps"] == UPDATES + 24
    assert longer.metrics.slice(0, 6).equals(run.metrics)
    with pytest.raises(dr.UserError, match="holds another run: steps was 72, now 48"):
        train(tmp_path / "r", resume=True)


def test_made_longer_without_its_replay_file_it_stays_as_it_is(run, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(run.path, folder)
    shutil.rmtree(folder / "replay")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(UserError, match="cannot read"):
        train(folder, steps=STEPS + 32, resume=True)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_made_longer_it_keeps_its_period_of_evaluations(run, longer, tmp_path):
    shutil.copytree(run.path, tmp_path / "r")
    again = train(tmp_path / "r", steps=STEPS + 48, evaluate_every=None, resume=True)  # by default, a fiftieth of the run
    assert again.evaluations.equals(longer.evaluations)


def everything(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.slow
@pytest.mark.parametrize(("change", "words"), [
    ({"agent": Little(lr=0.5)}, "agent.fields.lr was 0.01, now 0.5"),
    ({"settings": replace(SETTINGS, copies=8)}, "online.copies was 4, now 8"),
    ({"settings": replace(SETTINGS, explore=48)}, "online.explore was 32, now 48"),
    ({"settings": replace(SETTINGS, updates_per_step=0.25), "evaluate_every": 64}, "online.updates_per_step was 0.5, now 0.25"),
    ({"evaluate_every": 64}, "evaluation.every was 16, now 32"),
    ({"seed": 1}, r"seeds was \[0\], now \[1\]"),
    ({"task": replace(HOPPER, name="hopper2")}, "data.name was hopper, online, now hopper2, online"),
])  # fmt: skip
@pytest.mark.parametrize("more", [0, 160])
def test_another_run_is_refused_and_what_is_there_stays(run, change, words, more, tmp_path):
    shutil.copytree(run.path, tmp_path / "r")
    before = everything(tmp_path / "r")
    with pytest.raises(dr.UserError, match=f"holds another run: .*{words}"):
        train(tmp_path / "r", resume=True, **({"steps": STEPS + more} | change))
    assert everything(tmp_path / "r") == before


def test_a_run_is_gone_on_with_in_a_task_of_the_same_fields_alone(run, capsys):
    before = everything(run.path)
    assert run.config["task_fields"] == {"horizon": 20}
    for other, words in ((replace(HOPPER, horizon=30), "horizon was 20, now 30"), ("hopper", "was {'horizon': 20}, now None")):
        with pytest.raises(UserError, match=f"holds another run: task_fields.*{words}"):
            train(run.path, task=other, resume=True)
    assert gather(run)[0].task is None
    assert main(["evaluate", str(run.path)]) == 2  # in which task: that of this name is another one
    assert "missing --task: whole was trained in a task that its name does not find" in capsys.readouterr().err
    assert everything(run.path) == before


def test_a_run_in_a_task_that_its_name_does_not_find_is_not_evaluated_in_the_task_of_another_run(run, tmp_path, capsys):
    shutil.copytree(run.path, tmp_path / "named")
    config = read_json(tmp_path / "named" / "run.json")
    del config["task_fields"]
    write_json(tmp_path / "named" / "run.json", config)
    given = [str(tmp_path / "named"), str(run.path)]
    assert [(each.task, each.unnamed) for each in gather(given)] == [("hopper", False), (None, True)]
    assert main(["evaluate", *given]) == 2
    assert "missing --task: whole was trained in a task that its name does not find" in capsys.readouterr().err


def test_a_run_is_opened_again_in_its_own_task_alone(run):
    for other, words in (
        (None, "was trained in a task that its name does not find; give it as task$"),
        ("hopper", r"was trained in another task: task_fields was {'horizon': 20}, now None; give that one as task$"),
        (replace(HOPPER, horizon=30), "another task: task_fields.horizon was 20, now 30; give that one as task$"),
        ("walker2d", "was trained in another task: task was hopper, now walker2d; give that one as task$"),
    ):
        with pytest.raises(UserError, match=words):
            module.reopened(run.path, task=other)
    assert module.reopened(run.path, task=replace(HOPPER)).step == UPDATES


def test_a_registered_task_with_another_horizon_is_another_task(tmp_path, monkeypatch):
    def killed(*given):
        raise Stop

    monkeypatch.setattr(module, "Recorder", killed)  # once the folder has been begun
    other = "holds another run: task_registered.horizon was 20, now 30"
    for horizon, found, words in ((20, Stop, None), (20, Stop, None), (30, UserError, other)):
        tasks.register(replace(HOPPER, name="own-hopper", horizon=horizon))
        try:
            with pytest.raises(found, match=words):
                train(tmp_path / "run", task="own-hopper", resume=True)
        finally:
            tasks.registry._TASKS.pop("own-hopper")


@pytest.mark.slow
def test_when_all_lanes_fail_the_run_ends_and_says_so(tmp_path):
    seen = []
    failed = train(tmp_path / "r", Little(lr=1e30), watch=lambda progress, steps: seen.append(progress.step))
    assert seen == [8]
    assert failed.failures[0].metric == "loss"
    assert read_json(failed.path / "status.json")["failures"] == [list(failed.failures[0])]
    assert "seed 0 failed: loss was not finite at update" in summary(failed)
    assert failed.evaluations["step"].to_pylist() == [0, 0, 0, 8, 8, 8]
    again = train(tmp_path / "r", Little(lr=1e30), resume=True)
    assert again.failures == failed.failures


@pytest.mark.slow
def test_evaluations_are_at_least_a_block_apart(tmp_path):
    settings = replace(SETTINGS, updates_per_step=0.125)
    few = train(tmp_path / "r", settings=settings, evaluate_every=1, steps=STEPS, episodes=1)
    assert few.config["evaluation"]["every"] == 2  # the updates of a block; an environment step has a seventh of one
    assert few.evaluations["step"].to_pylist() == [0, 2, 4, 6, 8, 10, 12]


@pytest.mark.parametrize(("agent", "change", "words"), [
    ("bc", {}, "BC does not learn online"),
    ("bear", {}, "BEAR does not learn online"),
    ("td3", {}, "TD3 does not learn online"),
    ("td3_bc", {}, "TD3BC does not learn online"),
    ("sax", {}, "unknown agent 'sax': did you mean sac"),
    (None, {"steps": 47}, "47 environment steps are too few: .* give 48 or more"),
    (None, {"seeds": 0}, "seeds must be >= 1, got 0"),
    (None, {"chunk": 0}, "chunk must be >= 1, got 0"),
    (None, {"episodes": 0}, "episodes must be >= 1, got 0"),
    (None, {"seed": -1}, "seed must be"),
    (None, {"evaluate_every": 0}, "evaluate_every must be >= 1, got 0"),
    (None, {"threads": 0}, "threads must be 1 or more, got 0"),
    (None, {"task": "hoper"}, "unknown task 'hoper': did you mean hopper"),
    ([Little()], {"seeds": 2}, "one agent per seed is needed, got 1 agents and 2 seeds"),
    (Little(lr=-1.0), {}, "Little.lr takes a finite number >= 0, got -1"),
    ("mbpo", {"settings": replace(SETTINGS, explore=8)}, "explore, .* the model is first fitted to, must be 10 or more, got 8"),
])  # fmt: skip
def test_what_does_not_fit_is_told_before_anything_is_written(agent, change, words, tmp_path):
    with pytest.raises(dr.UserError, match=words):
        train(tmp_path / "no", agent, **change)
    assert not (tmp_path / "no").exists()


@pytest.mark.slow
def test_a_run_is_opened_again_to_look_into(run, tmp_path):
    lanes = [Little(lr=lr) for lr in (1e-3, 1e-2)]
    trained = train(tmp_path / "run", lanes, seeds=2)
    job = module.reopened(trained.path, task=HOPPER)
    assert job.step == UPDATES
    assert [(agent.lr, agent.hidden) for agent in job.learners] == [(1e-3, (4,)), (1e-2, (4,))]
    seen = np.random.default_rng(0).normal(size=(5, 11)).astype(np.float32)
    for lane, policy in enumerate(trained.policies):
        state = jax.tree.map(lambda leaf, lane=lane: leaf[lane], job.states)
        mean = np.asarray(job.learners[lane].policy(state).pre_actions(seen, jax.random.key(0), greedy=True))
        np.testing.assert_allclose(np.tanh(mean), policy(seen), atol=1e-6)
    assert job.source.experience.replay.buffer[:, :STEPS].shape == (2, STEPS, row_width(HOPPER))
    with pytest.raises(UserError, match="is not the folder of an online run"):
        module.reopened(tmp_path)
    shutil.rmtree(trained.path / "checkpoints")
    with pytest.raises(UserError, match="has no checkpoint with an update yet"):
        module.reopened(trained.path, task=HOPPER)


def test_by_default_a_run_has_its_name_from_agent_and_task(tmp_path, monkeypatch):
    class Told(Exception):
        pass

    def begin(self, config):
        raise Told(self.path, config["evaluation"]["every"])

    monkeypatch.setattr(module.Folder, "begin", begin)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(Told) as told:
        dr.train_online(Little(), "hopper", steps=100_000, settings=Online(updates_per_step=0.5))
    assert str(told.value.args[0]) == "runs/Little-hopper-online"
    assert told.value.args[1] == 1024  # a fiftieth of the run, half an update per step, in whole blocks of 32


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_sac_learns_to_push_a_ball_to_its_goal(tmp_path):
    """Uniform actions earn 73, the planner 237. Eight seeds of these settings were at 146 .. 210 in the end, 178 on average."""
    agent = dr.agents.SAC(hidden=(64, 64), batch_size=64, actor_lr=1e-3, critic_lr=1e-3, temperature_lr=1e-3)
    settings = Online(copies=4, explore=1000, updates_per_step=0.5, block=20)
    run = dr.train_online(agent, "maze2d-umaze-dense", steps=21_000, seeds=3, settings=settings, out=tmp_path / "r",
                          evaluate_every=20_000, chunk=1000)  # fmt: skip
    assert run.failures == [None] * 3
    untrained, trained = (run.evaluations.filter(run.evaluations["step"].to_numpy() == s)["return"].to_numpy().reshape(3, 10)
                          for s in (0, 10_000))  # fmt: skip
    assert untrained.mean() < 90
    assert trained.mean() > 130
    assert trained.mean(1).min() > 100
