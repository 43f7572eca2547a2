"""Trackers show what the run folder holds, once each, and callbacks end runs."""

import socket
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.files import read_json, write_json
from deadreckon.runs.callback import StopTraining, TrainingProgress
from deadreckon.runs.folder import Folder
from deadreckon.runs.trackers import feed
from deadreckon.runs.trackers.mlflow_runs import MLflow
from deadreckon.runs.trackers.tensorboard import TensorBoard
from deadreckon.runs.trackers.tracker import trackers_of
from deadreckon.runs.trackers.wandb_runs import WandB

SETTINGS = {"steps": 60, "seeds": 2, "chunk": 20, "evaluate_every": 30, "task": False, "holdout": 0}

DATA = {"name": "log", "fingerprint": "0" * 32}
CONFIG = {"agent": {"name": "bc", "fields": {}}, "data": DATA, "task": None, "seeds": [0], "steps": 50}


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(0)
    rows, ends = 200, np.arange(200) % 20 == 19
    return dr.Dataset.from_arrays(
        observations=rng.normal(size=(rows, 3)), actions=rng.uniform(-1, 1, (rows, 1)), rewards=rng.normal(size=rows),
        timeouts=ends,
    )  # fmt: skip


def agent():
    return dr.agents.TD3BC(hidden=(16, 16), batch_size=32)


class Kept:
    """Keeps all calls, and as a server would, over interruptions."""

    def __init__(self):
        self.configs, self.points, self.ended = [], [], []

    def start(self, config):
        self.configs.append(config)

    def log(self, step, seed, metrics):
        self.points.append((step, seed, dict(metrics)))

    def finish(self, files):
        self.ended.append(files)


@pytest.fixture(scope="module")
def whole(log, tmp_path_factory):
    """A run and what a tracker was told of it."""
    kept = Kept()
    run = dr.train(agent(), log, out=tmp_path_factory.mktemp("runs") / "whole", track=kept, **SETTINGS)
    return run, kept


class Interrupted(Exception):
    pass


def interrupted(log, out, track, at=50):
    """A run that ended in the chunk that ends at `at`, and was then resumed."""

    def watch(progress, steps):
        if progress.step == at:
            raise Interrupted

    with pytest.raises(Interrupted):
        dr.train(agent(), log, out=out, track=track, watch=watch, **SETTINGS)
    return dr.train(agent(), log, out=out, track=track, resume=True, **SETTINGS)


def test_a_tracker_is_told_everything_once_and_in_order(whole):
    run, kept = whole
    assert [(step, seed) for step, seed, _ in kept.points] == [(s, seed) for s in (20, 30, 50, 60) for seed in (0, 1)]
    metrics, evaluations = run.metrics.to_pydict(), run.evaluations.to_pydict()
    for step, seed, point in kept.points:
        row = next(i for i in range(8) if (metrics["step"][i], metrics["seed"][i]) == (step, seed))
        assert point["train/critic_loss"] == metrics["critic_loss"][row]
        judged = [i for i, at in enumerate(evaluations["step"]) if (at, evaluations["seed"][i]) == (step, seed)]
        assert ("evaluation/mmd_to_data" in point) == bool(judged) == (step in (30, 60))
        if judged:
            assert point["evaluation/mmd_to_data"] == pytest.approx(evaluations["mmd_to_data"][judged[0]])
    [config], [files] = kept.configs, kept.ended
    assert config["agent"]["name"] == "td3_bc"
    assert config["name"] == f"{run.path.parent.name}/whole"
    assert [path.name for path in files] == ["run.json", "seed0.npz", "seed1.npz"]
    assert all(path.exists() for path in files)


def test_a_resumed_run_is_the_same_tracked_run_and_gives_all_points_again(whole, log, tmp_path):
    kept = Kept()
    interrupted(log, tmp_path / "r", kept)
    assert len({config["id"] for config in kept.configs}) == 1
    assert kept.ended[0] is None
    assert kept.ended[1] is not None
    before = kept.points[: -len(whole[1].points)]
    assert {step for step, _, _ in before} <= {20, 30}  # what no checkpoint holds yet is not told
    assert kept.points[len(before) :] == whole[1].points


def test_a_finished_run_can_be_shown_afterwards(whole, log, tmp_path):
    kept = Kept()
    place = whole[0].save(tmp_path / "again")
    dr.train(agent(), log, out=place, resume=True, track=kept, **SETTINGS)
    assert kept.points == whole[1].points
    assert kept.configs[0]["id"] == whole[1].configs[0]["id"]


def test_a_point_is_told_when_its_checkpoint_and_its_evaluation_are_there(tmp_path):
    folder, kept = Folder(tmp_path), Kept()
    write_json(folder.config, CONFIG)
    tracking = feed.Tracking(folder, [kept])
    tracking.start()
    for step in (20, 30, 50):  # the checkpoint of a chunk is written when the next one begins
        folder.write_part("metrics", step, {"step": [step], "seed": [0], "loss": [1.0]})
        if step == 30:
            folder.policy(0, 30).parent.mkdir()
            folder.policy(0, 30).touch()  # whose evaluation is under way
        tracking.told(step)
    tracking.pending[-1].result()
    assert [step for step, _, _ in kept.points] == [20]
    folder.write_part("evaluations", 30, {"step": [30], "seed": [0], "episode": [0], "score": [5.0]})
    folder.write_part("metrics", 60, {"step": [60], "seed": [0], "loss": [1.0]})
    tracking.told(60)
    tracking.pending[-1].result()
    assert [step for step, _, _ in kept.points] == [20, 30, 50]
    assert kept.points[1][2] == {"train/loss": 1.0, "evaluation/score": 5.0}
    tracking.finish([])
    assert kept.points[-1][0] == 60


def events(folder):
    """(tag, step, value) of all event files, read by their format alone."""
    from tensorboardX.proto import event_pb2

    found = []
    for path in sorted(folder.glob("events.*")):
        data, at = path.read_bytes(), 0
        while at < len(data):
            size = int.from_bytes(data[at : at + 8], "little")
            event = event_pb2.Event.FromString(data[at + 12 : at + 12 + size])
            found += [(v.tag, event.step, v.simple_value) for v in event.summary.value if v.HasField("simple_value")]
            at += 16 + size
    return found


@pytest.mark.slow
def test_event_files_of_tensorboard_have_no_doubled_points(log, whole, tmp_path):
    pytest.importorskip("tensorboardX")
    run = interrupted(log, tmp_path / "r", "tensorboard")
    for seed in run.seeds:
        told = {(name, step): value for step, s, point in whole[1].points if s == seed for name, value in point.items()}
        found = events(run.path / "tensorboard" / f"seed{seed}")
        assert len(found) == len(told)
        for name, step, value in found:
            assert value == pytest.approx(told[name, step], rel=1e-5)


@pytest.mark.slow
def test_mlflow_goes_on_in_the_same_runs(log, whole, tmp_path, monkeypatch):
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/mlflow.db")
    monkeypatch.chdir(tmp_path)
    run = interrupted(log, tmp_path / "r", "mlflow")
    client = mlflow.MlflowClient()
    [experiment] = [each for each in client.search_experiments() if each.name == "deadreckon"]
    found = client.search_runs([experiment.experiment_id])
    assert sorted(each.data.params["seed"] for each in found) == ["0", "1"]
    for each in found:
        seed = int(each.data.params["seed"])
        assert each.info.status == "FINISHED"
        assert each.data.params["agent.batch_size"] == "32"
        history = sorted((p.step, p.value) for p in client.get_metric_history(each.info.run_id, "train/critic_loss"))
        assert history == [(step, point["train/critic_loss"]) for step, s, point in whole[1].points if s == seed]
        names = {each.path for each in client.list_artifacts(each.info.run_id)}
        assert names == {"run.json", f"seed{seed}.npz"}
    assert run.seeds == [0, 1]


def fake_wandb(monkeypatch, mode="online"):
    """What WandB uses of its package; runs that are resumed know their next step, as the server tells it."""
    server, module = {}, ModuleType("wandb")

    class Run:
        def __init__(self, **given):
            self.given = given
            self.points = server.setdefault(given["id"], [])
            self.starting_step = self.points[-1][0] + 1 if self.points else 0
            self.saved = []

        def log(self, metrics, step):
            self.points.append((step, metrics))

        def save(self, path, base_path, policy):
            server.setdefault("files", []).append(path)

        def finish(self, exit_code):
            server.setdefault("ended", []).append(exit_code)

    module.init = lambda **given: server.setdefault("runs", []).append(Run(**given)) or server["runs"][-1]
    module.Settings = lambda **given: given
    settings = SimpleNamespace(mode=mode, base_url="https://wandb.invalid", project=None)
    module.setup = lambda: SimpleNamespace(settings=settings)
    monkeypatch.setitem(sys.modules, "wandb", module)
    return server


def test_wandb_takes_only_what_its_server_lacks(log, whole, tmp_path, monkeypatch):
    server = fake_wandb(monkeypatch)
    monkeypatch.setattr("deadreckon.runs.trackers.wandb_runs._answers", lambda url: True)
    interrupted(log, tmp_path / "r", "wandb")
    ids = [each.given["id"] for each in server["runs"]]
    assert len(ids) == 4
    assert ids[:2] == ids[2:]
    assert {each.given["mode"] for each in server["runs"]} == {"online"}
    for seed, name in enumerate(ids[:2]):
        assert server[name] == [(step, point) for step, s, point in whole[1].points if s == seed]
    assert server["ended"] == [1, 1, 0, 0]


def test_wandb_is_offline_where_nothing_answers_and_says_so(tmp_path, monkeypatch):
    def nobody(*asked, **options):
        raise OSError("no network")

    monkeypatch.setattr(socket, "create_connection", nobody)
    server = fake_wandb(monkeypatch)
    old = tmp_path / "wandb" / "offline-run-20260101_000000-abc-seed0"
    other = tmp_path / "wandb" / "offline-run-20260101_000000-xyz-seed0"
    old.mkdir(parents=True)
    other.mkdir()
    with pytest.warns(UserWarning, match=r"no answer from https://wandb.invalid.*wandb sync"):
        WandB().start({"folder": str(tmp_path), "name": "r", "id": "abc", "seeds": [0]})
    assert server["runs"][0].given["mode"] == "offline"
    assert not old.exists()  # it is written anew
    assert other.exists()


@pytest.mark.slow
def test_wandb_itself_offline(log, tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    interrupted(log, tmp_path / "r", "wandb")
    found = sorted((tmp_path / "r" / "wandb").glob("offline-run-*"))
    assert len(found) == 2  # one a seed, though the run was started twice
    assert all(list(folder.glob("run-*.wandb")) for folder in found)


@pytest.mark.slow
def test_a_tracker_that_fails_is_dropped_and_the_run_goes_on(log, whole, tmp_path):
    class Broken(Kept):
        def log(self, step, seed, metrics):
            raise OSError("no space left")

    good = Kept()
    with pytest.warns(UserWarning, match=r"Broken failed and gets no more points of .*OSError: no space left.*run continues"):
        run = dr.train(agent(), log, out=tmp_path / "r", track=[Broken(), good], **SETTINGS)
    assert run.metrics.equals(whole[0].metrics)
    assert good.points == whole[1].points


def test_points_that_cannot_be_read_are_told(tmp_path):
    folder, kept = Folder(tmp_path), Kept()
    write_json(folder.config, CONFIG)
    tracking = feed.Tracking(folder, [kept])
    tracking.start()
    folder.part("metrics", 20).parent.mkdir()
    folder.part("metrics", 20).write_bytes(b"half")
    tracking.told(20)
    with pytest.warns(UserWarning, match="points of .* cannot be read and are not tracked: .*[Pp]arquet"):
        tracking.finish([])
    assert kept.ended == [[]]


def test_a_tracker_that_cannot_start_is_one_line(log, tmp_path):
    class Refuses(Kept):
        def start(self, config):
            raise PermissionError("not logged in")

    with pytest.raises(dr.UserError, match="Refuses cannot start: PermissionError: not logged in; no update was made"):
        dr.train(agent(), log, out=tmp_path / "r", track=Refuses(), **SETTINGS)


def test_a_seed_that_diverged_is_told_without_its_numbers(tmp_path):
    folder = Folder(tmp_path)
    metrics = {"step": [20, 20], "seed": [0, 1], "loss": [1.5, np.nan]}
    folder.write_part("metrics", 20, metrics)
    points = feed.Tracking(folder, [])._points(20)
    assert points == {0: {"train/loss": 1.5}, 1: {"train/failed": 1.0}}


@pytest.mark.parametrize(
    ("track", "runs", "message"),
    [
        ("tensorbord", 1, "unknown tracker 'tensorbord': did you mean tensorboard"),
        ("json:Nothing", 1, "tracker json:Nothing: the module has no such class"),
        (object(), 1, "a tracker needs the methods start, log, finish; .* has no start"),
        (Kept(), 2, "2 runs share a program, and each needs a tracker of its own: give the class"),
    ],
)
def test_what_is_no_tracker_is_refused(track, runs, message):
    with pytest.raises(dr.UserError, match=message):
        trackers_of(track, runs)


@pytest.mark.parametrize(("tracker", "package"), [(TensorBoard, "tensorboardX"), (WandB, "wandb"), (MLflow, "mlflow")])
def test_a_missing_package_is_named_before_anything_is_written(tracker, package, log, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(dr.UserError, match=rf"tracking needs {package}.*install the extra track"):
        dr.train(agent(), log, out=tmp_path / "r", track=tracker, **SETTINGS)
    assert not (tmp_path / "r").exists()


def test_runs_that_share_a_program_are_tracked_apart(log, tmp_path):
    told = []

    class Told(Kept):
        def __init__(self):
            super().__init__()
            told.append(self)

    agents = {"low": agent().replace(alpha=1.0), "high": agent().replace(alpha=4.0)}
    runs = dr.train_together(agents, log, out=tmp_path / "t", track=Told, **SETTINGS | {"seeds": 1, "steps": 20})
    assert [each.configs[0]["name"] for each in told] == ["t/low", "t/high"]
    for each, run in zip(told, runs.values()):
        assert [point["train/critic_loss"] for _, _, point in each.points] == run.metrics["critic_loss"].to_pylist()


@pytest.mark.slow
def test_the_command_line_takes_several_trackers(log, tmp_path, monkeypatch, capsys):
    from deadreckon.cli.main import main
    from deadreckon.data.formats.folder import write_folder

    (tmp_path / "mine.py").write_text(
        "class Lines:\n    def start(self, config): self.at = config['folder']\n"
        "    def log(self, step, seed, metrics): print(step, seed, file=open(self.at + '/lines', 'a'))\n"
        "    def finish(self, files): pass\n"
    )
    write_folder(log, tmp_path / "log")
    monkeypatch.chdir(tmp_path)
    small = ["--agent.hidden", "16", "--agent.batch-size", "32", "--steps", "20", "--out", "r"]
    main(["train", "--agent", "bc", "--data", "log", *small, "--track", "tensorboard", "mine:Lines"])
    assert len((tmp_path / "r" / "lines").read_text().splitlines()) == 10  # an evaluation ends every tenth
    assert (tmp_path / "r" / "tensorboard" / "seed0").is_dir()


# ---- callbacks --------------------------------------------------------------------------------------------------------


def test_a_callback_sees_the_run_and_ends_it(log, whole, tmp_path):
    seen: list[TrainingProgress] = []

    def look(progress):
        seen.append(progress)
        table = progress.evaluations.to_pydict()
        assert max(table.get("step", [0])) == progress.step // 30 * 30 or progress.step == 50
        x = np.zeros((4, 3), np.float32)
        assert [policy(x).shape for policy in progress.policies] == [(4, 1), (4, 1)]
        return progress.step >= 50

    run = dr.train(agent(), log, out=tmp_path / "r", callback=look, **SETTINGS)
    assert [each.step for each in seen] == [20, 30, 50]
    assert seen[0].metrics["critic_loss"].shape == (2,)
    assert seen[0].seeds == [0, 1]
    assert run.config["steps"] == 50
    assert read_json(run.path / "status.json")["finished"]
    assert 50 in run.evaluations["step"].to_pylist()  # where it ended, it is evaluated
    longer = dr.train(agent(), log, out=tmp_path / "r", resume=True, **SETTINGS)
    assert longer.metrics.equals(whole[0].metrics)


def test_a_callback_may_raise_and_must_not_return_something_else(log, tmp_path):
    def stop(progress):
        raise StopTraining

    assert dr.StopTraining is StopTraining
    assert dr.train(agent(), log, out=tmp_path / "a", callback=stop, **SETTINGS).config["steps"] == 20
    with pytest.raises(dr.UserError, match=r"a callback must return True to end the run, or False or None to continue, got"):
        dr.train(agent(), log, out=tmp_path / "b", callback=lambda progress: 0.5, **SETTINGS)


def test_runs_on_several_logs_are_told_of_apart_and_end_together(log, tmp_path):
    told: dict[str, Kept] = {}
    seen: dict[str, list[TrainingProgress]] = {}

    class Told(Kept):
        def start(self, config):
            super().start(config)
            told[config["name"].partition("/")[2]] = self

    def look(progress):
        seen.setdefault(progress.path.name, []).append(progress)
        assert set(progress.evaluations.to_pydict().get("step", [])) == ({30} if progress.step >= 30 else set())
        return progress.path.name == "two" and progress.step == 50

    low, high = (dr.agents.BC(hidden=(8,), batch_size=16, lr=lr) for lr in (1e-3, 1e-2))
    logs = {"one": log, "two": log.select(np.arange(7), name="shorter"), "three": log}
    options = SETTINGS | {"seeds": 1, "out": tmp_path / "t", "track": Told}
    runs = dr.train_together({"one": low, "two": low, "three": high}, logs, callback=look, **options)
    assert told.keys() == seen.keys() == runs.keys()
    x, losses = np.ones((4, 3), np.float32), []
    for name, run in runs.items():
        losses.append(run.metrics["behavior_nll"].to_pylist())
        assert [point["train/behavior_nll"] for _, _, point in told[name].points] == losses[-1]
        assert [each.metrics["behavior_nll"].tolist() for each in seen[name]] == [[loss] for loss in losses[-1]]
        assert [each.step for each in seen[name]] == [step for step, _, _ in told[name].points] == [20, 30, 50]
        np.testing.assert_array_equal(seen[name][-1].policies[0](x), run.policy(x))
        assert [path.name for path in told[name].ended[0]] == ["run.json", "seed0.npz"]
        assert run.config["steps"] == 50
        assert read_json(run.path / "status.json")["finished"]
        assert set(run.evaluations["step"].to_pylist()) == {30, 50}  # where all have ended, all are evaluated
    assert len(set(map(tuple, losses))) == 3
    again = dr.train_together({"one": low, "two": low, "three": high}, logs, resume=True, **options)
    for name, run in again.items():
        assert run.metrics["step"].to_pylist() == [step for step, _, _ in told[name].points] == [20, 30, 50, 60]


@pytest.mark.slow
def test_online_runs_are_tracked_from_their_first_policy_on(tmp_path):
    kept, steps = Kept(), []
    run = dr.train_online(
        dr.agents.SAC(hidden=(16, 16), batch_size=32), "maze2d-umaze", steps=300, evaluate_every=100, episodes=2,
        out=tmp_path / "r", settings=dr.online.Online(copies=2, explore=100, block=50), track=kept,
        callback=lambda progress: steps.append(progress.step),
    )  # fmt: skip
    first, *others = kept.points
    assert first[0] == 0
    assert set(first[2]) >= {"evaluation/score"}
    assert [step for step, _, _ in others] == steps == run.metrics["step"].to_pylist()
    assert others[-1][2]["train/environment_steps"] == run.metrics["environment_steps"].to_pylist()[-1]
