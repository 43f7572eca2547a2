"""Bad input from the command line: one clear line on stderr, exit code 2, nothing left behind."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from deadreckon.cli.main import main
from deadreckon.collect import generate
from deadreckon.data.formats.hdf5 import write_hdf5


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    """A whole small log, to be spoilt."""
    path = tmp_path_factory.mktemp("logs") / "good.hdf5"
    write_hdf5(generate("maze2d-umaze-v1", steps=2000, seed=0), path)
    return path


def columns(n=50, **change):
    rng = np.random.default_rng(0)
    base = {"observations": rng.normal(size=(n, 3)), "actions": rng.uniform(-1, 1, (n, 2)), "rewards": rng.normal(size=n),
            "terminals": np.arange(n) % 10 == 9, "timeouts": np.zeros(n, bool)}  # fmt: skip
    return base | change


def hdf5(path: Path, **change) -> Path:
    with h5py.File(path, "w") as file:
        for key, value in columns(**change).items():
            if value is not None:
                file[key] = value
    return path


class Bomb:
    """What an attacker would pickle."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return os.system, (f"touch {self.path}",)


def with_bad(column, row, value):
    out = columns()[column].astype(float)
    out[row] = value
    return out


BC = ["train", "--agent", "bc", "--out", "OUT", "--steps", "2", "--data"]
ONLINE = ["train", "--online", "--agent", "sac", "--out", "OUT", "--task"]


def truncated(folder, good):
    path = folder / "cut.hdf5"
    path.write_bytes(good.read_bytes()[: good.stat().st_size // 2])
    return [*BC, path]


def pickled(folder, good):
    path = folder / "bomb.pickle"
    path.write_bytes(pickle.dumps([Bomb(path.with_name("was-here"))]))
    return ["data", "info", path]


def text(name, content):
    def make(folder, good):
        (folder / name).write_text(content)
        return ["data", "info", folder / name]

    return make


def file_in_the_way(folder, good):
    (folder / "OUT").write_text("mine")
    return [*BC, good]


def demonstrations(folder):
    """Like the Adroit files: as many observations as rewards, actions beyond [-1, 1]."""
    rng = np.random.default_rng(0)
    path = folder / "door-v0_demos.pickle"
    episode = {"observations": rng.normal(size=(9, 39)), "actions": rng.normal(size=(9, 28)), "rewards": rng.normal(size=9)}
    episode["init_state_dict"] = {"qpos": np.zeros(3)}
    path.write_bytes(pickle.dumps([episode, episode]))
    return path


def other_run(folder, good):
    (folder / "run.json").write_text("{}")
    return ["evaluate", folder]


# name: (arguments, or a function of (folder, a good log) that makes them; words that the line must hold)
OPE = ["ope", "--data", "log.csv", "--policies", "run"]
CASES = {
    "truncated hdf5": (truncated, ["cut.hdf5"]),
    "NaN": (lambda f, g: [*BC, hdf5(f / "x.hdf5", rewards=with_bad("rewards", 7, np.nan))], ["rewards", "row 7"]),
    "infinite observation": (
        lambda f, g: [*BC, hdf5(f / "x.hdf5", observations=with_bad("observations", 3, np.inf))], ["observations", "row 3"]),
    "lengths that differ": (lambda f, g: [*BC, hdf5(f / "x.hdf5", rewards=np.zeros(49))], ["rewards", "49", "50"]),
    "no actions": (lambda f, g: [*BC, hdf5(f / "x.hdf5", actions=None)], ["actions"]),
    "terminals that are no flags": (
        lambda f, g: [*BC, hdf5(f / "x.hdf5", terminals=np.full(50, 3.0))], ["terminals", "0 or 1"]),
    "next observations of another shape": (
        lambda f, g: [*BC, hdf5(f / "x.hdf5", next_observations=np.zeros((50, 9)))], ["next_observations"]),
    "empty log": (lambda f, g: [*BC, hdf5(f / "x.hdf5", n=0)], ["no rows"]),
    "unknown task": (lambda f, g: [*BC, g, "--task", "maze2d-umze"], ["did you mean maze2d-umaze"]),
    "task of another observation size": (
        lambda f, g: [*BC, hdf5(f / "x.hdf5"), "--task", "maze2d-umaze"], ["observations of shape (4,)"]),
    "wrong action size": (
        lambda f, g: [*BC, hdf5(f / "x.hdf5", observations=np.zeros((50, 4)), actions=columns()["actions"][:, :1]),
                      "--task", "maze2d-umaze"], ["actions are"]),
    "actions out of bounds, strict": (
        lambda f, g: [*BC, hdf5(f / "x.hdf5", observations=np.zeros((50, 4)), actions=3 * columns()["actions"]),
                      "--task", "maze2d-umaze", "--strict"], ["out of bounds", "--strict"]),
    "negative steps": (lambda f, g: [*BC, g, "--steps", "-5"], ["steps", ">= 1"]),
    "zero seeds": (lambda f, g: [*BC, g, "--seeds", "0"], ["seeds"]),
    "steps that are no number": (lambda f, g: [*BC, g, "--steps", "many"], ["--steps takes a whole number, got 'many'"]),
    "one number of two": (lambda f, g: [*OPE, "--return-range", "1"], ["--return-range takes FLOAT FLOAT, got '1'"]),
    "texts for two numbers": (lambda f, g: [*OPE, "--return-range", "a", "b"], ["takes FLOAT FLOAT, got 'a b'"]),
    "no horizon": (lambda f, g: [*OPE, "--horizon", "x"], ["--horizon takes INT|auto, got 'x'"]),
    "width that is no number": (lambda f, g: [*BC, g, "--agent.hidden", "x"], ["--agent.hidden takes INT [INT ...], got 'x'"]),
    "option that prose names": (lambda f, g: [*OPE, "--selct"], ["unknown option --selct: did you mean --select or --sheet?"]),
    "unknown agent": (lambda f, g: ["train", "--agent", "baer", "--data", g], ["did you mean", "bear"]),
    "no agent": (lambda f, g: ["train", "--data", g], ["--agent"]),
    "no data": (lambda f, g: ["train", "--agent", "bc"], ["--data"]),
    "unknown option": (lambda f, g: [*BC, g, "--agent.learning", "3"], ["unknown option --agent.learning"]),
    "misspelt hyperparameter": (
        lambda f, g: ["train", "--agent", "bear", "--data", g, "--agent.kernle", "x"], ["did you mean --agent.kernel"]),
    "hyperparameter of the wrong kind": (
        lambda f, g: ["train", "--agent", "bear", "--data", g, "--agent.kernel", "cosine"], ["kernel", "laplacian"]),
    "hyperparameter that is not finite": (lambda f, g: [*BC, g, "--agent.lr", "nan"], ["BC.lr", "finite"]),
    "negative learning rate": (lambda f, g: [*BC, g, "--agent.lr", "-1"], ["BC.lr", ">= 0", "-1"]),
    "discount above one": (
        lambda f, g: ["train", "--agent", "td3", "--data", g, "--agent.discount", "1.5"], ["TD3.discount", "<= 1"]),
    "no candidates to choose from": (
        lambda f, g: ["train", "--agent", "bear", "--data", g, "--agent.test-samples", "0"], ["BEAR.test_samples", ">= 1"]),
    "layers of no width": (lambda f, g: [*BC, g, "--agent.hidden", "0"], ["BC.hidden", "0"]),
    "negative seed": (lambda f, g: [*BC, g, "--seed", "-1"], ["seed", "-1"]),
    "an agent without a name": (lambda f, g: ["train", "--data", g, "--agent"], ["--agent needs a name after it"]),
    "a table for scores": (
        lambda f, g: ["evaluate", "runs/bc", "--out", "scores.csv"], ["must end with .parquet, got scores.csv"]),
    "negative seed of an experiment": (lambda f, g: ["theory", "gridworld", "--seed", "-1"], ["seed must be 0", "-1"]),
    "negative seed of a search": (
        lambda f, g: ["tune", "--agent", "bear", "--data", g, "--trials", "2", "--seed", "-1"], ["seed must be 0", "-1"]),
    "two agents": (lambda f, g: [*BC, g, "--agent", "td3"], ["--agent is given twice"]),
    "strict without a simulator": (
        lambda f, g: [*BC, demonstrations(f), "--strict"], ["out of bounds", "--strict"]),
    "run.json of something else": (other_run, ["run.json", "lacks agent"]),
    "demo of no steps": (lambda f, g: ["demo", "--steps", "0", "--out", "OUT"], [">= 1"]),
    "negative batch": (lambda f, g: [*BC, g, "--agent.batch-size", "-1"], ["batch_size"]),
    "densities of a VAE": (
        lambda f, g: ["train", "--agent", "bear", "--data", g, "--agent.behavior", "vae", "--agent.constraint", "kl"],
        ["needs densities"]),
    "missing file": (lambda f, g: [*BC, f / "nowhere.hdf5"], ["no file", "nowhere.hdf5"]),
    "log that is not collected": (lambda f, g: [*BC, "maze2d-large-v1"], ["deadreckon data collect maze2d-large-v1"]),
    "unknown log": (lambda f, g: [*BC, "maze2d-umaze-v7"], ["did you mean maze2d-umaze-v1"]),
    "path that climbs out of the cache": (lambda f, g: [*BC, "../../secrets"], ["../../secrets"]),
    "pickle that imports os": (pickled, ["bomb.pickle", "system"]),
    "csv without columns": (text("a.csv", "a,b\n1,2\n"), ["--observations COLUMN", "a, b"]),
    "empty file": (text("a.csv", ""), ["empty"]),
    "no log at all": (text("a.bin", "\x00\x01\x02"), ["a.bin"]),
    "online without a task": (lambda f, g: ["train", "--online", "--agent", "sac"], ["--task"]),
    "online in an unknown task": (lambda f, g: [*ONLINE, "hoper"], ["did you mean hopper"]),
    "online with an agent that does not explore": (
        lambda f, g: [*ONLINE[:3], "bear", *ONLINE[4:], "hopper"], ["BEAR does not learn online"]),
    "online with a log of another task": (
        lambda f, g: [*ONLINE, "hopper", "--data", g], ["observations (4,) and 2 actions", "hopper has (11,) and 3"]),
    "online with a log, and an agent that does not go on": (
        lambda f, g: [*ONLINE[:3], "bear", *ONLINE[4:], "maze2d-umaze", "--data", g], ["BEAR", "these agents do"]),
    "online in no simulator": (lambda f, g: ["train", "--agent", "sac", "--online"], ["missing --task", "deadreckon tasks"]),
    "online from what is no run": (
        lambda f, g: ["train", "--from", f / "no", "--online", "--task", "hopper"], ["holds no run"]),
    "online with a share of the whole": (
        lambda f, g: [*ONLINE, "maze2d-umaze", "--data", g, "--log-share", "1"], ["log_share must be 0 or more and below 1"]),
    "offline with an option of online": (lambda f, g: [*BC, g, "--copies", "4"], ["unknown option --copies"]),
    "online with fewer steps than it explores": (
        lambda f, g: [*ONLINE, "hopper", "--steps", "10000"], ["10000 environment steps are too few", "give 10064 or more"]),
    "online with no copies": (lambda f, g: [*ONLINE, "hopper", "--copies", "0"], ["copies", "1 or more, got 0"]),
    "online with blocks that copies do not fill": (
        lambda f, g: [*ONLINE, "hopper", "--block", "12"], ["block", "multiple of copies (8", "got 12"]),
    "online with half an update a block": (
        lambda f, g: [*ONLINE, "hopper", "--updates-per-step", "0.0078125"], ["whole number", "got 0.0078125"]),
    "online with a negative seed": (lambda f, g: [*ONLINE, "hopper", "--seed", "-1"], ["seed", "-1"]),
    "online with no threads": (lambda f, g: [*ONLINE, "hopper", "--threads", "0"], ["threads", "0"]),
    "unknown recipe": (lambda f, g: ["data", "collect", "maze2d-umaz-v1"], ["did you mean maze2d-umaze-v1"]),
    "unknown log to download": (lambda f, g: ["data", "get", "hopper-meduim-v2"], ["did you mean hopper-medium-v2"]),
    "unknown place to download from": (
        lambda f, g: ["data", "get", "hopper-medium-v2", "--source", "hub"], ["--source", "hub", "minari"]),
    "no twin to download": (
        lambda f, g: ["data", "get", "hopper-random-v2", "--source", "minari"],
        ["no Minari twin", "--source d4rl", "deadreckon data collect hopper-random-v2"]),
    "checksum that is none": (
        lambda f, g: ["data", "get", "hopper-medium-v2", "--sha256", "123"], ["64 hexadecimal digits", "123"]),
    "collected log to download": (
        lambda f, g: ["data", "get", "hopper-medium-v2@dr1"], ["hopper-medium-v2@dr1", "leave @dr1 out"]),
    "unknown version of a log": (
        lambda f, g: [*BC, "hopper-medium-v2@dr7"], ["unknown version 'dr7'", "hopper-medium-v2@d4rl (downloaded)"]),
    "negative rows to collect": (
        lambda f, g: ["data", "collect", "maze2d-umaze-v1", "--steps", "-1", "--out", "OUT/x.hdf5"], ["steps", "-1"]),
    "no run to evaluate": (lambda f, g: ["evaluate", f], ["no run"]),
    "no policy file": (lambda f, g: ["evaluate", g, "--task", "maze2d-umaze"], ["policy file"]),
    "no run to report": (lambda f, g: ["report", f / "nothing", "--out", "OUT/x.html"], ["nothing"]),
    "run folder is a file": (file_in_the_way, ["OUT", "is not a run"]),
    "unknown command": (lambda f, g: ["trian"], ["did you mean train"]),
    "unknown data command": (lambda f, g: ["data", "colect"], ["did you mean collect"]),
    "convert without a target format": (lambda f, g: ["data", "convert", g, f / "OUT.xyz"], [".xyz"]),
    "read-only folder": (lambda f, g: [*BC[:3], "--out", "/proc/nowhere/run", "--steps", "2", "--data", g], ["/proc/nowhere"]),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_one_line_exit_code_two_and_nothing_left(case, good, tmp_path, monkeypatch, capsys, home):
    make, words = CASES[case]
    monkeypatch.chdir(tmp_path)
    inputs = tmp_path / "inputs"
    inputs.mkdir()
    arguments = [str(a) for a in make(inputs, good)]
    arguments = [a.replace("OUT", str(inputs / "OUT")) if a.startswith("OUT") else a for a in arguments]
    before = sorted(inputs.rglob("*"))
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = [line for line in err.splitlines() if not line.startswith("deadreckon: warning:")]
    assert len(lines) == 1, err
    assert lines[0].startswith("deadreckon: ")
    for word in words:
        assert word in lines[0]
    assert sorted(inputs.rglob("*")) == before
    assert [p.name for p in tmp_path.iterdir() if p.name not in ("inputs", "home")] == []
    assert not (home / "data").exists()


def test_there_are_at_least_25_kinds():
    assert len(CASES) >= 25


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, good):
    """A file-size limit stands for the full disk: the write fails in the middle."""
    code = (
        "import resource, signal, sys\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
        "from deadreckon.cli.main import main\n"
        f"out = {str(tmp_path / 'new' / 'log.hdf5')!r}\n"
        "sys.exit(main(['data', 'collect', 'maze2d-umaze-v1', '--steps', '4000', '--out', out]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    errors = [line for line in done.stderr.splitlines() if not line.startswith("collecting ")]
    assert done.returncode == 2, done.stderr
    assert len(errors) == 1, done.stderr
    assert "log.hdf5" in errors[0]
    assert [p.name for p in tmp_path.iterdir() if p.name != "home"] == []


def test_debug_shows_the_traceback(good):
    from deadreckon.errors import UserError

    with pytest.raises(UserError):
        main(["trian", "--debug"])
