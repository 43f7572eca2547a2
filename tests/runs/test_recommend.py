"""From a log and so much time to a decision, in time, and from the log alone."""

import itertools
import time
from types import SimpleNamespace

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.errors import UserError
from deadreckon.runs import recommend as module
from deadreckon.runs.durations import in_words, seconds_of
from deadreckon.runs.recommend import Candidate, recommend
from deadreckon.runs.recorder import Enough


def a_log(episodes=40, length=10, seed=0):
    """The reward is how near the action is to the observation's first entry; the log acts at random."""
    rng = np.random.default_rng(seed)
    observations = rng.uniform(-0.8, 0.8, (episodes * length, 2)).astype(np.float32)
    actions = rng.uniform(-0.9, 0.9, (episodes * length, 1)).astype(np.float32)
    ends = np.arange(1, episodes * length + 1) % length == 0
    rewards = 1.0 - np.abs(actions[:, 0] - observations[:, 0])
    return dr.Dataset.from_arrays(observations=observations, actions=actions, rewards=rewards, timeouts=ends, name="near")


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90), ("30m", 1800), ("2h", 7200), ("1h30m", 5400), ("0.5h", 1800)])
def test_times_are_read(text, seconds):
    assert seconds_of(text) == seconds


@pytest.mark.parametrize("text", ["", "30", "m", "0m", "-1h", "1.2.3h", "soon"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(UserError, match="a time is written 90s, 30m, 2h or 1h30m, got"):
        seconds_of(text)


def test_times_are_told():
    assert [in_words(seconds) for seconds in (5, 300, 7200)] == ["5 s", "5 min", "2.0 h"]


@pytest.fixture
def small(monkeypatch):
    """Sizes at which it takes seconds, and two candidates."""
    sizes = {"CHUNK": 20, "TOLD": 10, "FEWEST": 20, "FEWEST_FITS": 20, "MOST": 60, "WORTH": 40, "ENOUGH": 2}
    sizes |= {"LARGE": (8,), "SMALL": (4,)}
    for name, value in sizes.items():
        monkeypatch.setattr(module, name, value)
    loose = Candidate("loose", "td3_bc", {"batch_size": 16, "alpha": 9.0}, "-")
    monkeypatch.setattr(module, "CONTINUOUS", (Candidate("bc", "bc", {"batch_size": 16}, "-"), loose))


def test_a_decision_comes_from_the_log_alone(small, tmp_path):
    lines, seen = [], []
    watch = lambda what, step, steps: seen.append(what)  # noqa: E731
    found = recommend(a_log(), 120.0, out=tmp_path / "out", tell=lines.append, watch=watch)
    assert [run.config["agent"]["name"] for run in found.runs] == ["bc", "td3_bc"]
    assert found.runs[1].config["agent"]["fields"]["alpha"] == 9.0
    assert found.plan.steps == 60
    assert lines[-1].startswith("about ")  # the time is said before anything is done with it
    assert [name for name, _ in itertools.groupby(seen)] == ["bc", "loose", "coverage", "fqe"]
    assert found.judged.choice.name in ("bc seed 0", "loose seed 0")
    assert found.judged.told["truth"] is None
    assert (tmp_path / "out" / "estimates.json").exists()
    with pytest.raises(UserError, match="is there already"):
        recommend(a_log(), 120.0, out=tmp_path / "out")


def test_too_little_time_is_told_with_how_much_it_takes(small, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "FEWEST", 10**9)
    monkeypatch.setattr(module, "MOST", 10**10)
    with pytest.raises(UserError, match=r"too short for this log on this machine; give it .* or more"):
        recommend(a_log(), 60.0, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_run_may_be_ended_early(tmp_path):
    def watch(progress, steps):
        if progress.step == 40:
            raise Enough

    asked = {"steps": 100, "chunk": 20, "evaluate_every": 100}
    run = dr.train("bc", a_log(), out=tmp_path / "run", watch=watch, **asked)
    assert run.metrics["step"].to_pylist() == [20, 40]
    assert run.evaluations["step"].to_pylist() == [40]
    assert run.config["steps"] == 40
    # It can be gone on with, and then is what it would have been without the break.
    resumed = dr.train("bc", a_log(), out=tmp_path / "run", resume=True, **asked)
    whole = dr.train("bc", a_log(), out=tmp_path / "whole", **asked)
    x = np.linspace(-0.5, 0.5, 8, dtype=np.float32).reshape(4, 2)
    assert resumed.config["steps"] == 100
    assert np.array_equal(resumed.policy(x), whole.policy(x))
    assert not np.array_equal(resumed.policy(x), run.policy(x))


def test_what_diverges_or_runs_out_of_time_is_told(small, tmp_path, monkeypatch):
    lines, real = [], module._pilot
    monkeypatch.setattr(module, "_pilot", lambda agent, log, seed: None if hasattr(agent, "alpha") else real(agent, log, seed))
    monkeypatch.setattr(module, "SHARES", {"train": 1e-9, "estimate": 0.25})
    monkeypatch.setattr(module, "_steps", lambda left, rates: 60)
    found = recommend(a_log(), 120.0, out=tmp_path / "out", tell=lines.append)
    assert "pilot: loose is left out, its numbers go bad on this log" in lines
    assert "bc was ended after 20 updates: its time was over" in lines
    assert found.runs[0].config["steps"] == 20


def test_when_the_time_is_over_before_the_estimates_the_command_that_goes_on_is_told(small, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "judge", lambda runs, log, found, *, watch, **options: watch("fqe", 1, 2))

    def late(what, step, steps):
        if what == "fqe":
            monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=lambda: 1e12))

    told = r"are over before fqe is; this goes on: deadreckon ope --data near --policies .*/bc .*--hidden 8 --select"
    with pytest.raises(UserError, match=told):
        recommend(a_log(), 120.0, out=tmp_path / "out", watch=late)


def test_a_discount_of_one_is_refused_at_once(tmp_path):
    with pytest.raises(UserError, match=r"discount must be 0 \.\. 1 without 1, got 1"):
        recommend(a_log(), 60.0, out=tmp_path / "out", discount=1.0)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", ["door", "csv", "maze"])
def test_logs_of_all_kinds_end_in_a_card_in_time(kind, tmp_path, capsys, request, monkeypatch):
    if kind == "door":
        data = request.getfixturevalue("real_data") / "adroit" / "door-v0_demos.pickle"
    elif kind == "csv":
        pd = pytest.importorskip("pandas")
        log = a_log(200, 12)
        table = pd.DataFrame({"patient": np.repeat(np.arange(200), 12), "day": np.tile(np.arange(12), 200),
                              "x": log.observations[:, 0], "y": log.observations[:, 1],
                              "dose": log.actions[:, 0], "gain": log.rewards})  # fmt: skip
        made = dr.Dataset.from_frame(table, episode="patient", time="day", action="dose", reward="gain")
        found = recommend(made, "3m", out=tmp_path / "out")
        assert found.seconds < 180
        assert found.judged.choice.deploy  # the log acts at random, and any of them does better
        return
    else:
        data = dr.collect.collect("maze2d-umaze-v1", steps=50_000, out=tmp_path / "maze.hdf5")
    began = time.perf_counter()
    assert main(["recommend", str(data), "--budget", "4m", "--out", str(tmp_path / "out")]) == 0
    assert time.perf_counter() - began < 260  # with the page and the card
    told = capsys.readouterr().out
    assert told.index("about ") < told.index("DEPLOY")
    assert ("checked: in the simulator" in told) == (kind == "maze")
    assert (tmp_path / "out" / "report.html").exists()
