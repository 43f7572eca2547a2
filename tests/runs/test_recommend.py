"""From a log and so much time to a decision: in time whatever happens, and from the log alone."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.cli.options import Ope
from deadreckon.cli.parse import parse
from deadreckon.data.formats.folder import write_folder
from deadreckon.data.info import warnings_for
from deadreckon.data.leaks import leaks
from deadreckon.data.split import Holdout
from deadreckon.errors import UserError
from deadreckon.files import alone, read_json
from deadreckon.policies.deployed import history_of
from deadreckon.report import recommended
from deadreckon.runs import attempt as work
from deadreckon.runs import follow as module
from deadreckon.runs.attempt import Attempt, Job, Pilot, Unfinished
from deadreckon.runs.callback import StopTraining
from deadreckon.runs.candidates import Candidate
from deadreckon.runs.clock import Clock
from deadreckon.runs.durations import in_words, seconds_of
from deadreckon.runs.recommend import _few_updates, options_of, recommend
from deadreckon.runs.settings import RecommendSettings


def a_log(episodes=60, length=10, seed=0):
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


# ---- the side that knows the clock --------------------------------------------------------------------------------------


@pytest.fixture
def time_is_over(monkeypatch):
    """What ends the time of an attempt at once: when all is said, however long the work took to begin."""
    over, left = threading.Event(), Clock.left
    monkeypatch.setattr(Clock, "left", lambda clock: 0.0 if over.is_set() else left(clock))
    return over.set


@pytest.fixture
def doing(monkeypatch, tmp_path):
    """Lets a script do the work instead; it has `job` and `send`."""

    def use(script):
        head = (
            "import json, os, sys, time\n"
            "job = json.loads(sys.stdin.readline())\n"
            "def send(what, value):\n"
            "    print(json.dumps({what: value}), flush=True)\n"
        )
        path = tmp_path / "work.py"
        path.write_text(head + textwrap.dedent(script))
        monkeypatch.setattr(module, "COMMAND", (sys.executable, "-S", str(path)))

    return use


STATES = textwrap.dedent("""
    own = {"why": "-", "deterministic": False, "planned": 90}
    known = [{"name": "bc", "agent": "bc", "updates": 90, "state": "learned", **own},
             {"name": "iql", "agent": "iql", "updates": 0, "state": "learning", **own}]
    send("state", {"log": "near", "rows": 400, "episodes": 40, "stage": "training", "since": time.time(), "need": 200.0})
    send("state", {"candidates": known})
    send("watch", ["iql", 30, 90])
""")


# Mercy hides what takes twice as long as 1 s: one of 3 s is among the fast tests, too.
HANG = [pytest.param(3.0, "ignores signals")] + [
    pytest.param(budget, what, marks=pytest.mark.slow if budget > 1.0 else ())
    for what in ("hangs", "ignores signals", "talks for ever", "has ended but lives on")
    for budget in (1.0, 3.0) if (budget, what) != (3.0, "ignores signals")
]  # fmt: skip


@pytest.mark.parametrize(("budget", "what"), HANG)
def test_there_is_a_card_in_time_whatever_the_work_does(doing, tmp_path, budget, what):
    doing({
        "hangs": "time.sleep(600)",
        "ignores signals": "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)",
        "talks for ever": "while True: send('watch', ['bc', 1, 2])",
        "has ended but lives on": "os.close(1); time.sleep(600)",
    }[what])  # fmt: skip
    lines, began = [], time.perf_counter()
    found = recommend(a_log(), budget, out=tmp_path / "out", tell=lines.append, page=recommended.write)
    took = time.perf_counter() - began
    assert took < 1.1 * budget + 1.5  # mercy for a machine that is very busy; work here never ends
    assert not found.judged
    assert not found.choice.deploy
    told = read_json(tmp_path / "out" / "estimates.json")
    assert told["choice"]["deploy"] is False
    assert "Do not deploy" in (tmp_path / "out" / "report.html").read_text()
    assert lines[0].startswith(f"time plan for {in_words(budget)}: about ")
    if what != "has ended but lives on":
        assert "not enough time" in str(found)
        assert "a budget of 2m should be sufficient" in str(found)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["estimates.json", "report.html"]


def test_what_was_found_is_told(doing, time_is_over, tmp_path):
    doing(STATES + "time.sleep(600)")
    seen = []

    def watch(*each):
        seen.append(each)
        time_is_over()

    found = recommend("near.csv", 60.0, out=tmp_path / "out", watch=watch, page=recommended.write)
    said = str(found)
    why = "not enough time: the budget of 60 s was used up (at this stage: training)"
    assert said.startswith(f"DO NOT DEPLOY: {why}; 1 of 2 candidates")
    assert "bc: trained, 90 of 90 updates" in said
    assert "iql: was training, 30 of 90 updates" in said
    assert "to be done: training, evaluation" in said
    assert "a budget of 4m should be sufficient" in said  # 1.2 times the 200 s that the work came to
    assert f"deadreckon ope --data near.csv --discount 0.99 --seed 0 --policies {tmp_path / 'out' / 'bc'} --select" in said
    assert seen == [("iql", 30, 90)]
    assert "was" not in found.results["recommend"]["candidates"][1]["state"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "iql: was training, 30 of 90 updates" in page
    with pytest.raises(UserError, match="holds no estimates: not enough time"):
        dr.report.write([], tmp_path / "page.html", estimates=tmp_path / "out")


def test_suspected_leaks_are_on_the_card_once(doing, tmp_path):
    line = "column <bill> may be the reward by another name"
    doing(STATES + f"send('state', {{'leaks': [{line!r}]}})\nsend('unfinished', 'all of them diverged (NaN or Inf)')")
    lines = []
    found = recommend(a_log(), 60.0, out=tmp_path / "out", tell=lines.append, page=recommended.write)
    assert found.choice.warnings == (line,)
    assert str(found).count(f"warning: {line}") == 1
    assert not any(line in each for each in lines)
    assert (tmp_path / "out" / "report.html").read_text().count("column &lt;bill&gt; may be the reward") == 1


@pytest.mark.parametrize(("end", "reason"), [
    ("os.kill(os.getpid(), 9)", "ended unexpectedly (exit code -9)"),
    ("sys.exit(3)", "ended unexpectedly (exit code 3)"),
    ("send('fault', 'TypeError: of ours')", "TypeError: of ours"),
    ("send('unfinished', 'all of them diverged (NaN or Inf)')", "all of them diverged (NaN or Inf)"),
    ("send('refused', 'the log has one action')", "the log has one action"),
])  # fmt: skip
def test_work_that_dies_leaves_a_card(doing, tmp_path, end, reason):
    doing(STATES + end)
    found = recommend(a_log(), 60.0, out=tmp_path / "out", page=recommended.write)
    assert found.seconds < 30
    assert reason in found.choice.reason
    assert found.failed == (not any(word in end for word in ("unfinished", "refused")))
    assert reason in (tmp_path / "out" / "report.html").read_text()


def test_more_time_is_advised_where_it_would_have_helped_and_nowhere_else(doing, tmp_path):
    """Candidates that diverged do so in any time, also where it is known how long all would have taken."""
    need = STATES + "send('state', {'need': 300.0})\n"
    short = need + "send('state', {'short': True})\n"
    for name, told in (("diverged", need), ("short", short)):
        doing(told + "send('unfinished', 'nothing was judged')")
        found = recommend(a_log(), 60.0, out=tmp_path / name)
        assert any("should be sufficient" in line for line in found.choice.evidence) == (name == "short")


def test_input_that_does_not_fit_is_an_error_and_leaves_nothing(doing, tmp_path):
    doing("send('refused', 'no file x.csv')")
    with pytest.raises(UserError, match="no file x.csv"):
        recommend("x.csv", 60.0, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_estimates_that_are_there_are_the_card_even_if_the_check_hangs(doing, time_is_over, tmp_path):
    result = {"method": "DR", "title": "dr (DR)", "value": [2.0, None], "low": [1.5, None], "high": [2.5, None],
              "gain": [[1.0, 0.4, 1.6]], "effective": None}  # fmt: skip
    choice = {"name": "bc seed 0", "deploy": True, "gain": [1.0, 0.4, 1.6], "level": 0.975, "reason": "it is better",
              "evidence": [], "warnings": [], "objections": [[]]}  # fmt: skip
    told = {"log": "near", "estimand": {"words": "expected return"}, "truth": None, "results": [result], "choice": choice,
            "policies": [{"name": "bc seed 0", "run": "bc", "seed": 0}],
            "judged": {"words": "8 held-out episodes of 40", "episodes": 8, "of": 40, "fresh": True, "cluster": None},
            "looks": {"number": 1, "policies": 1, "counted": True},
            "support": {"missing": [0.1], "ratio": [1.0]}}  # fmt: skip
    doing(
        f"{STATES}with open(job['out'] + '/estimates.json', 'w') as file:\n    file.write({json.dumps(told)!r})\n"
        "send('state', {'need for worth': 290.0})\n"
        "send('line', 'written'); time.sleep(600)"
    )
    tell = lambda line: time_is_over() if line == "written" else None  # noqa: E731
    found = recommend(a_log(), 60.0, out=tmp_path / "out", tell=tell, page=recommended.write)
    assert found.judged
    assert found.choice.deploy
    assert "DEPLOY bc seed 0: it is better." in str(found)
    few = "few updates: bc 90 (10,000 are advised); a budget of about 6m should be sufficient for them"
    assert few in found.choice.warnings
    assert "bc seed 0 2.00 [1.50, 2.50] behaviour policy - [-, -]" in " ".join(str(found).split())
    assert read_json(tmp_path / "out" / "estimates.json")["recommend"]["late"]
    assert "it is better" in (tmp_path / "out" / "report.html").read_text()


def test_an_interruption_ends_the_work(doing, tmp_path):
    doing(f"open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); send('line', 'begun'); time.sleep(600)")

    def tell(line):
        if line == "begun":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recommend(a_log(), 60.0, out=tmp_path / "out", tell=tell)
    pid = int((tmp_path / "pid").read_text())
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert not (tmp_path / "out" / ".log").exists()


@pytest.mark.parametrize(("budget", "options", "words"), [
    (0.0, {}, "the budget must be above 0"), (-5.0, {}, "the budget must be above 0"),
    ("soon", {}, "a time is written"), (60.0, {"discount": 1.0}, r"discount must be in \[0, 1\), got 1"),
    (60.0, {"holdout": 0.0}, "the share held out must lie between 0 and 1"),
    (60.0, {"seed": -1}, r"seed must be 0 .. 2\^32 - 1, got -1"), (60.0, {"seed": 2**32}, "seed must be 0"),
    (60.0, {"columns": {"reward": "gain"}}, "a Dataset has its columns already: leave them out"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_at_once(tmp_path, budget, options, words):
    with pytest.raises(UserError, match=words):
        recommend(a_log(), budget, out=tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("given", [a_log, lambda: "near.csv"], ids=["log", "file"])
def test_what_fails_at_the_start_leaves_nothing_in_the_way(doing, tmp_path, monkeypatch, given):
    doing("send('done', True)")
    with pytest.raises(UserError, match="settings of recommend must be numbers, texts and lists of these: got object"):
        recommend(given(), 60.0, out=tmp_path / "out", holdout=Holdout(by=object()))
    assert not (tmp_path / "out").exists()

    def fails(*given, **options):
        raise OSError("no more processes")

    with monkeypatch.context() as patched:
        patched.setattr(module.subprocess, "Popen", fails)
        with pytest.raises(OSError, match="no more processes"):
            recommend(given(), 60.0, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    found = recommend(given(), 60.0, out=tmp_path / "out", seed=np.int64(1), discount=np.float32(0.5), holdout=np.float64(0.25))
    assert not found.judged


def test_an_old_folder_is_left_alone(tmp_path):
    with pytest.raises(UserError, match="exists already"):
        recommend(a_log(), 60.0, out=tmp_path)


# ---- the side that works ------------------------------------------------------------------------------------------------


@pytest.fixture
def small(monkeypatch):
    """Sizes at which it takes seconds, and two candidates."""
    sizes = {"TRIED": 20, "MOST": 60, "WORTH": 40, "ENOUGH": 2, "LARGE": (8,), "SMALL": (4,), "LONGEST": 0.01, "LOOKS": 0.01}
    for name, value in sizes.items():
        monkeypatch.setattr(work, name, value)
    monkeypatch.setattr(work, "FEWEST", 1)
    monkeypatch.setattr(work, "PROPENSITIES", dr.ope.BehaviorModel(hidden=(8,), lr=1e-3, steps=60))
    bold = Candidate("bold", "bc", {"batch_size": 16, "lr": 1e-3}, "-")
    monkeypatch.setattr(work, "CONTINUOUS", (Candidate("bc", "bc", {"batch_size": 16}, "-"), bold))


def job_of(data, out, seconds=60.0, **options):
    """As it comes out of the pipe."""
    settings = RecommendSettings.of({"discount": 0.9} | options)
    job = Job(data, str(out), 60.0, time.time(), time.time() + seconds, settings)
    return Job.of_json(json.loads(json.dumps(job.as_json())))


def attempt(tmp_path, log, seconds=300.0, **options):
    """The work, in this process: what it sends, and the folder."""
    write_folder(log, tmp_path / "log")
    sent = []
    (out := tmp_path / "out").mkdir()
    job = job_of(str(tmp_path / "log"), out, seconds, **options)
    with alone(out):  # as whoever asked for it does
        work.attempt(job, lambda what, value: sent.append((what, json.loads(json.dumps(value)))))
    return sent, out


def of(sent, what):
    return [value for name, value in sent if name == what]


def test_policies_learn_from_one_part_and_are_judged_by_the_other(small, tmp_path, monkeypatch):
    log, seen = a_log(), []
    real = Attempt._pilot

    def pilot(self, candidate, hidden, part):
        seen.append(part.episode_ids)
        assert part.spec.observation_size == 3 * 2 + 2 * 1
        return real(self, candidate, hidden, part)

    monkeypatch.setattr(Attempt, "_pilot", pilot)
    sent, out = attempt(tmp_path, log, history=3)
    assert of(sent, "done") == [True]
    assert [state for state in of(sent, "state") if "leaks" in state] == [{"leaks": []}]
    assert [line for line in of(sent, "line") if line.startswith("! ")] == [f"! {line}" for line in warnings_for(log)]
    runs = [dr.load_run(out / name) for name in ("bc", "bold")]
    for run in runs:  # on the last three steps, and judged so
        assert run.config["history"] == history_of(run.policy) == 3
    assert runs[1].config["agent"]["fields"]["lr"] == 1e-3
    held = runs[0].held
    assert len(held) == 12
    for part in (*seen, *(run.taught for run in runs)):  # pilots have not seen the rest either
        assert len(part) == 48
        assert not np.isin(part, held).any()
    told = read_json(out / "estimates.json")
    # The first is how many episodes there are to judge by, the second how many the estimates rest on.
    assert (told["judged"]["episodes"], told["judged"]["units"]) == (12, 12)
    assert told["judged"]["fresh"]
    assert not told["estimand"]["greedy"]
    assert told["truth"] is None
    assert np.isfinite(told["results"][0]["value"]).all()
    stages = [state["stage"] for state in of(sent, "state") if "stage" in state]
    assert stages == ["reading the log", "pilots", "training", "evaluation"]
    assert of(sent, "line")[-1].startswith("about ")
    assert [each["state"] for each in [s for s in of(sent, "state") if "candidates" in s][-1]["candidates"]] == ["learned"] * 2


def test_warnings_of_the_log_are_lines_and_suspected_leaks_are_for_the_card(tmp_path, monkeypatch):
    """The log's second observation is its reward."""
    log = a_log()
    observations = np.stack([log.observations[:, 0], log.rewards], 1)
    log = dr.Dataset.from_arrays(
        observations=observations, actions=log.actions, rewards=100_000 * log.rewards, timeouts=log.timeouts, name="near"
    )
    sent = []
    Attempt(job_of("-", tmp_path), lambda what, value: sent.append((what, value)))._warn(log)
    assert of(sent, "state") == [{"leaks": leaks(log)}]
    assert leaks(log)[0].startswith("column observation 1 may be the reward by another name: 1e+05 times it")
    assert of(sent, "line") == [f"! {line}" for line in warnings_for(log)]
    assert any("rewards are" in line for line in of(sent, "line"))
    sent.clear()
    monkeypatch.setattr(work, "DESCRIBED", 599)
    Attempt(job_of("-", tmp_path), lambda what, value: sent.append((what, value)))._warn(log)
    more = "the log is long; `deadreckon data info` checks its rewards, observations and episodes too"
    assert of(sent, "line") == [f"! {line}" for line in (*log.warnings, more)]


@pytest.mark.slow
def test_what_diverges_or_runs_out_of_time_is_told(small, tmp_path, monkeypatch):
    real = Attempt._pilot
    pilot = lambda self, candidate, *rest: None if candidate.name == "bold" else real(self, candidate, *rest)  # noqa: E731
    monkeypatch.setattr(Attempt, "_pilot", pilot)
    monkeypatch.setattr(work, "LEAST", 1e-9)
    monkeypatch.setattr(work, "LATE", 1e9)
    monkeypatch.setattr(work, "LOOKS", 1e-9)  # one update at a time
    monkeypatch.setattr(Attempt, "_steps", lambda self, seconds, rates: 60)
    sent, out = attempt(tmp_path, a_log())
    lines = of(sent, "line")
    assert "pilot: bold is left out, because it diverges (NaN or Inf) on this log" in lines
    assert any(line.startswith("bc was stopped after") for line in lines)
    assert dr.load_run(out / "bc").config["steps"] < 60
    assert (out / "estimates.json").exists()


@pytest.mark.slow
def test_candidates_that_hardly_began_to_learn_are_not_judged(small, tmp_path, monkeypatch):
    """That they are no better would say nothing of what the log has to teach; nor is a look spent on them."""
    monkeypatch.setattr(work, "FEWEST", 200)
    monkeypatch.setattr(work, "WORTH", 400)
    monkeypatch.setattr(Attempt, "_steps", lambda self, seconds, rates: 20)
    sent, out = attempt(tmp_path, a_log())
    (unfinished,) = of(sent, "unfinished")
    words = "not enough time: 20 updates of each candidate would fit, and at least 200 are needed; reading, compiling"
    assert unfinished.startswith(words)
    assert [each["need"] > 0 for each in of(sent, "state") if "need" in each] == [True]
    assert [each["need for worth"] > each["need"] for each in of(sent, "state") if "need" in each] == [True]
    assert {"short": True} in of(sent, "state")
    assert not (out / "estimates.json").exists()


@pytest.mark.parametrize(("reached", "kept"), [((60, 500), ["bold"]), ((60, 80), None)])
def test_a_candidate_that_hardly_began_is_left_out_beside_others(small, tmp_path, monkeypatch, reached, kept):
    monkeypatch.setattr(work, "FEWEST", 200)
    monkeypatch.setattr(work, "MOST", 5_000)
    monkeypatch.setattr(Attempt, "_steps", lambda self, seconds, rates: 5_000)
    trained = iter([SimpleNamespace(failures=[None], config={"steps": steps}) for steps in reached])
    monkeypatch.setattr(Attempt, "_learned", lambda self, *given: next(trained))
    sent = []
    made = Attempt(job_of("-", tmp_path), lambda what, value: sent.append((what, value)))
    made.told = [{"name": each.name, "why": "-", "deterministic": False, "state": "not begun"} for each in work.CONTINUOUS]
    learn = lambda: made._learn(work.CONTINUOUS, (4,), [Pilot(1.0, 10.0)] * 2, 1.0, None, None)  # noqa: E731
    if kept is None:
        with pytest.raises(Unfinished, match="no candidate reached 200 updates"):
            learn()
        return
    assert len(learn()) == 1
    assert [each["name"] for each in made.told if each["state"] == "learned"] == kept
    assert "bc is left out: its time was over after 60 updates" in of(sent, "line")
    assert {each["state"] for each in made.told} <= recommended.recommending.STATES.keys()  # which are shown in words


def test_deterministic_policies_come_last_and_the_plan_says_what_that_means():
    drawn = [each.deterministic for each in work.CONTINUOUS]
    assert drawn == sorted(drawn)
    assert {each.agent for each in work.CONTINUOUS if each.deterministic} == {"td3_bc", "rebrac"}
    made = Attempt(job_of("", ""), lambda what, value: None)
    made.told = [{"name": "td3_bc", "why": "-", "deterministic": True}]
    plan = made._plan((64,), 100, [10.0], 20.0, 20.0)
    assert "model-based estimate only, so deployed with --accept-model-based only" in plan


@pytest.mark.slow
def test_a_fit_that_has_not_settled_does_not_deploy(small, tmp_path, monkeypatch):
    from deadreckon.ope.linear import Fit

    real = Fit.critic
    monkeypatch.setattr(Fit, "critic", lambda self, *given: real(self, *given)._replace(settled=False))
    sent, out = attempt(tmp_path, a_log())
    assert of(sent, "done") == [True]
    choice = read_json(out / "estimates.json")["choice"]
    assert not choice["deploy"]
    assert all("the fit of its estimate has not converged" in own for own in choice["objections"])


@pytest.mark.slow
def test_model_based_estimates_decide_where_they_are_accepted(small, tmp_path, monkeypatch):
    sizes = {"hidden": (8,), "batch_size": 16}
    loose = Candidate("loose", "td3_bc", {"batch_size": 16}, "-", deterministic=True)
    monkeypatch.setattr(work, "CONTINUOUS", (Candidate("bc", "bc", sizes, "-"), Candidate("more", "bc", sizes, "-"), loose))
    monkeypatch.setattr(work, "FEWEST_FITS", 20)
    monkeypatch.setattr(work, "MOST_FITS", 20)
    sent, out = attempt(tmp_path, a_log(), accept_model_based=True)
    assert of(sent, "done") == [True]
    told = read_json(out / "estimates.json")
    assert [each["run"] for each in told["policies"]][:2] == ["bc", "loose"]  # asked for, so it comes before the others
    assert [each["method"] for each in told["results"]] == ["FQE-L2"]


@pytest.mark.parametrize(("left", "checked"), [(60.0, True), (-1.0, False)])
def test_the_choice_is_checked_if_time_is_left(tmp_path, monkeypatch, left, checked):
    sent, asked = [], []

    def simulated(policies, task, estimand, *, episodes, seed):
        asked.append(episodes)
        assert estimand["horizon"] == 7
        return {"mean": [1.0], "error": [0.1], "episodes": episodes, "task": "there"}

    monkeypatch.setattr(work.offline, "simulated", simulated)
    job = job_of("", tmp_path, left)
    judged = work.offline.Judged([], None, {"estimand": {"horizon": 7}})
    made = Attempt(job, lambda what, value: sent.append((what, value)))
    made._check([], SimpleNamespace(name="there"), judged)
    assert asked == ([2, 2, 20] if checked else [])
    assert (tmp_path / "estimates.json").exists() == checked
    assert bool(of(sent, "line")) != checked


def test_an_error_of_ours_is_told_shortly_and_kept_in_full(small, tmp_path, monkeypatch):
    monkeypatch.setattr(Attempt, "_learn", lambda self, *given: 1 / 0)
    sent, out = attempt(tmp_path, a_log())
    assert of(sent, "fault") == ["ZeroDivisionError: division by zero (fault.txt has all of it)"]
    assert "1 / 0" in (out / "fault.txt").read_text()


@pytest.mark.parametrize(("change", "words"), [
    ({"data": "nothing.csv"}, "no file nothing.csv"),
    ({"holdout": Holdout(by="user")}, "unknown column 'user'"),
    ({"task": "hopper"}, "observations of shape"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_before_anything_is_learned(small, tmp_path, change, words):
    if "data" in change:
        sent = []
        work.attempt(job_of(change["data"], tmp_path / "out"), lambda what, value: sent.append((what, value)))
    else:
        sent, _ = attempt(tmp_path, a_log(), **change)
    assert words in of(sent, "refused")[0]
    assert not [state for state in of(sent, "state") if "candidates" in state]


@pytest.mark.slow  # holding out by clusters is looked at in test_holdout.py, and judging by them in test_offline.py
def test_clusters_are_held_out_whole(small, tmp_path):
    log = a_log()
    user = np.repeat(np.arange(20), 3)[log.episode_of]
    log = dr.Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards, timeouts=log.timeouts, name="near",
        user=user,
    )  # fmt: skip
    sent, out = attempt(tmp_path, log, holdout=Holdout(by="user"))
    assert of(sent, "done") == [True]
    told = read_json(out / "estimates.json")["judged"]
    assert told["cluster"] == "user"
    assert told["units"] == 4
    assert "600 rows, 60 episodes; 12 of them (20 %) are held out for the card, by user" in of(sent, "line")[0]


def test_a_share_alone_holds_out_whole_groups_as_training_does(tmp_path):
    rows = 600
    frame = {"x": np.arange(rows) % 7, "action": np.arange(rows) % 2, "reward": np.ones(rows), "patient": np.arange(rows) // 20}
    pd.DataFrame(frame).to_csv(tmp_path / "log.csv", index=False)
    columns = {"action": "action", "reward": "reward", "group": "patient"}
    for holdout in (0.3, None):
        job = job_of(str(tmp_path / "log.csv"), tmp_path / "out", holdout=holdout, columns=columns)
        _, _, held = Attempt(job, lambda what, value: None)._log()
        assert held == Holdout(holdout or 0.2, "patient")


def test_what_leaves_no_episode_for_the_card_is_refused(tmp_path):
    log = a_log()
    site = dr.Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards, timeouts=log.timeouts, name="near",
        site=log.episode_of % 2,
    )  # fmt: skip
    sent, _ = attempt(tmp_path, site, holdout=Holdout(by="site"))
    assert "2 values of site are too few to hold some out (10 are needed), and a card rests on them" in of(sent, "refused")[0]
    assert not [state for state in of(sent, "state") if "candidates" in state]


@pytest.mark.slow
def test_a_run_may_be_ended_early(tmp_path):
    def watch(progress, steps):
        if progress.step == 40:
            raise StopTraining

    asked = {"steps": 100, "chunk": 20, "evaluate_every": 100}
    agent = dr.agents.BC(hidden=(8,), batch_size=16)
    run = dr.train(agent, a_log(), out=tmp_path / "run", watch=watch, **asked)
    assert run.metrics["step"].to_pylist() == [20, 40]
    assert run.evaluations["step"].to_pylist() == [40]
    assert run.config["steps"] == 40
    # It can be gone on with, and then is what it would have been without the break.
    resumed = dr.train(agent, a_log(), out=tmp_path / "run", resume=True, **asked)
    whole = dr.train(agent, a_log(), out=tmp_path / "whole", **asked)
    x = np.linspace(-0.5, 0.5, 8, dtype=np.float32).reshape(4, 2)
    assert resumed.config["steps"] == 100
    assert np.array_equal(resumed.policy(x), whole.policy(x))
    assert not np.array_equal(resumed.policy(x), run.policy(x))


# ---- both ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_gives_a_card_where_there_is_no_time_to_speak_of(tmp_path, capsys):
    table = tmp_path / "log.csv"
    log = a_log()
    rows = np.column_stack([np.repeat(np.arange(60), 10), log.observations, log.actions, log.rewards])
    np.savetxt(table, rows, delimiter=",", header="day,x,y,dose,gain", comments="", fmt="%.6g")
    options = ["--action", "dose", "--reward", "gain", "--episode", "day", "--budget", "2s", "--holdout-by", "time"]
    assert main(["recommend", str(table), *options, "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert told.index("time plan for 2 s") < told.index("DO NOT DEPLOY: not enough time")
    assert (tmp_path / "out" / "report.html").exists()
    assert main(["recommend", str(table), "--budget", "0s", "--out", str(tmp_path / "more")]) == 2


@pytest.mark.slow
def test_the_work_ends_with_whoever_asked_for_it():
    environment = os.environ | {"JAX_PLATFORMS": "cpu"}
    process = subprocess.Popen(module.COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
    late = threading.Timer(120.0, process.kill)
    late.start()
    process.stdin.write(json.dumps(job_of("-", "-").as_json()).encode() + b"\n")
    process.stdin.close()
    assert process.wait() != -signal.SIGKILL
    late.cancel()


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", ["door", "csv", "maze"])
def test_logs_of_all_kinds_end_in_a_card_in_time(kind, tmp_path, capsys, request):
    if kind == "door":
        data, options = request.getfixturevalue("real_data") / "adroit" / "door-v0_demos.pickle", []
    elif kind == "csv":
        log = a_log(1600, 3)  # of 400 episodes of 12 steps, the weights of what is better rest on 4 of 80 held-out episodes
        rows = np.column_stack([np.repeat(np.arange(1600), 3), np.tile(np.arange(3), 1600), log.observations, log.actions])
        rows = np.column_stack([rows, log.rewards])
        np.savetxt(data := tmp_path / "a.csv", rows, delimiter=",", header="patient,day,x,y,dose,gain", comments="", fmt="%.6g")
        options = ["--episode", "patient", "--time", "day", "--action", "dose", "--reward", "gain"]
    else:
        data, options = dr.collect.collect("maze2d-umaze-v1", steps=50_000, out=tmp_path / "maze.hdf5"), []
    began = time.perf_counter()
    assert main(["recommend", str(data), *options, "--budget", "4m", "--out", str(tmp_path / "out")]) == 0
    assert time.perf_counter() - began < 1.1 * 240
    told = capsys.readouterr().out
    assert told.index("time plan for ") < told.index("about ") < told.index("DEPLOY")
    estimates = read_json(tmp_path / "out" / "estimates.json")
    assert estimates["results"]
    assert estimates["judged"]["fresh"]
    if kind == "csv":
        assert estimates["choice"]["deploy"]  # the log acts at random, and any of them does better
    assert (estimates["truth"] is not None) <= (kind == "maze")
    assert (tmp_path / "out" / "report.html").exists()


def test_the_command_that_goes_on_decides_by_the_same_settings():
    options = options_of
    assert options(RecommendSettings()) == ["--discount", "0.99", "--seed", "0"]
    for limit in (5, np.int64(5), "5"):
        assert options(RecommendSettings(cost_limit=limit))[-2:] == ["--cost-limit", "5"]
    for limits in ({"energy": 5.0, "cost": 2}, ("energy=5.0", "cost=2")):
        found = options(RecommendSettings(discount=0.9, cost_limit=limits, accept_model_based=True))
        assert found == [
            "--discount", "0.9", "--seed", "0", "--cost-limit", "energy=5.0", "cost=2", "--accept-model-based"
        ]  # fmt: skip
        asked = parse(Ope, ["--data", "log.csv", "--policies", "p", "--select", *found], "ope")
        assert (asked.settings.discount, asked.settings.cost_limit) == (0.9, ("energy=5.0", "cost=2"))
        assert asked.settings.accept_model_based


def test_few_updates_are_told_with_a_budget():
    each = [{"name": name, "state": state, "updates": n} for name, state, n in
            (("bc", "learned", 429), ("iql", "learned", 10_000), ("awac", "diverged", 50))]  # fmt: skip
    state = {"candidates": each, "need for worth": 290.0}
    said = "few updates: bc 429 (10,000 are advised); a budget of about {} should be sufficient for them"
    assert _few_updates(state, Clock.of(120.0, None)) == [said.format("6m")]
    assert _few_updates(state, Clock.of(3600.0, None)) == [said.format("75m")]  # not less than what was too little
    assert _few_updates(state | {"candidates": each[1:]}, Clock.of(120.0, None)) == []
