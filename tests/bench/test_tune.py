"""Settings are chosen on training tasks or from the log alone, and what a choice loses is told."""

import json
import shlex
from dataclasses import replace

import numpy as np
import pytest

from deadreckon.agents import agent_class
from deadreckon.bench import tune as module
from deadreckon.bench.jobs import Program
from deadreckon.bench.plan import plan
from deadreckon.bench.store import JobResult, Store
from deadreckon.bench.suite import Method, Suite
from deadreckon.bench.tune import Trial, Tuned, candidates, chosen, named, suite, tune
from deadreckon.bench.work import perform
from deadreckon.cli.main import main
from deadreckon.data.formats.io import read
from deadreckon.data.split import Holdout
from deadreckon.errors import UserError
from deadreckon.report.provenance import option
from deadreckon.runs.holdout import divided
from deadreckon.runs.offline import judge
from deadreckon.runs.run import load
from deadreckon.training.hyperparameters import check_fields
from tests.bench.in_process import InProcess

UMAZE = "maze2d-umaze-v1"


def test_all_combinations_are_tried_with_the_defaults_among_the_first():
    found = candidates("iql")
    assert len(found) == 9
    assert found[0] == {"expectile": 0.7, "beta": 3.0}
    few = candidates("iql", most=4, seed=3)
    assert few[0] == found[0]
    assert len({named(each) for each in few}) == 4
    assert few == candidates("iql", most=4, seed=3) != candidates("iql", most=4, seed=4)


def test_every_known_space_is_of_fields_that_take_its_values():
    from deadreckon.agents import AGENTS, space

    known = 0
    for agent in AGENTS:
        try:
            values = space(agent)
        except UserError:
            continue
        known += 1
        kind = agent_class(agent)
        for name, choices in values.items():
            assert hasattr(kind(), name), (agent, name)
            for choice in choices:
                check_fields(kind(**{name: choice}))
    assert known >= 22


@pytest.mark.parametrize("agent", ["mopo", "combo", "mobile"])
def test_agents_with_a_model_try_published_values_from_the_least_to_the_greatest(agent):
    from deadreckon.agents import presets, space

    for name, choices in space(agent).items():
        published = {each[name] for each in presets()[agent].values()}
        assert choices == sorted(choices)
        assert (choices[0], choices[-1]) == (min(published), max(published))


@pytest.mark.parametrize(
    ("agent", "given", "message"),
    [
        ("iql", {"expektile": [1.0]}, "unknown field of iql 'expektile': did you mean expectile"),
        ("iql", {"expectile": []}, "expectile has no values to try"),
        ("iql", {"expectile": ["much"]}, "expectile"),
        ("bc", None, "no values to try are known for bc"),
    ],
)
def test_what_cannot_be_tried_is_refused(agent, given, message):
    with pytest.raises(UserError, match=message):
        candidates(agent, given)


def test_simulators_of_evaluation_tasks_choose_nothing():
    settings = candidates("td3_bc")
    with pytest.raises(UserError, match=r"hopper is kept for evaluation \(thesis Table D.3\)"):
        suite("td3_bc", ["hopper-medium-v2"], settings, by="simulator", steps=10)
    with pytest.raises(UserError, match="has no simulator to tune in; --by ope"):
        suite("td3_bc", ["mine.csv"], settings, by="simulator", steps=10)
    with pytest.raises(UserError, match="estimates choose for one log"):
        suite("td3_bc", [UMAZE, "maze2d-medium-v1"], settings, by="ope", steps=10)
    assert suite("td3_bc", ["hopper-medium-v2"], settings, by="ope", steps=10).on == ("hopper-medium-v2",)


SCORES = {1.0: 10.0, 2.5: 30.0, 5.0: 50.0}


def given(program, folder, watch):
    """A score that the setting decides, without training."""
    out = []
    for job in program.jobs:
        score = SCORES[job.settings["alpha"]]
        told = {"raw": score, "steps": 1, "seconds": 1.0, "failure": "", "versions": "{}"}
        out.append(JobResult([{"seed": seed, "score": score + seed} | told for seed in job.seeds], []))
    return out


def test_what_is_tried_is_tried_once_and_the_defaults_first():
    assert candidates("td3_bc", {"alpha": [5.0, 2.5, 2.5]}) == [{"alpha": 2.5}, {"alpha": 5.0}]
    found = [candidates("td3_bc", {"alpha": [1.0, 5.0, 7.0]}, most=1, seed=seed)[0]["alpha"] for seed in range(20)]
    assert set(found) == {1.0, 5.0, 7.0}  # the defaults are none of these, so none is kept


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fixed": {"alpha": 1.0}}, "alpha cannot be tried and be the same in all"),
        ({"seeds": 0}, "must be >= 1"),
        ({"steps": 0}, "must be >= 1"),
    ],
)
def test_searches_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(UserError, match=message):
        suite("td3_bc", [UMAZE], candidates("td3_bc"), by="ope", **{"steps": 10} | changes)


def diverged(program, folder, watch):
    out = given(program, folder, watch)
    for job, found in zip(program.jobs, out, strict=True):
        for row in found.rows:
            row["failure"] = "loss was not finite at update 3" if job.settings["alpha"] == 5.0 else ""
    return out


def test_what_diverged_is_not_chosen(tmp_path):
    settings = [{"alpha": value} for value in SCORES]
    asked = suite("td3_bc", [UMAZE], settings, by="simulator", steps=10, seeds=1)
    local = InProcess(tmp_path, 1, diverged)
    run = {"by": "simulator", "store": Store(tmp_path), "executor": local, "on_event": lambda event: None}
    found = tune(asked, settings, **run)
    assert found.best.fields == {"alpha": 2.5}
    assert "alpha = 5.0  score 50.0  FAILED, not chosen: loss was not finite at update 3" in str(found)


def test_the_best_mean_over_tasks_and_seeds_is_chosen(tmp_path):
    settings = [{"alpha": value} for value in SCORES]
    asked = suite("td3_bc", [UMAZE, "maze2d-medium-v1"], settings, by="simulator", steps=10, seeds=2)
    local = InProcess(tmp_path, 1, given)
    run = {"by": "simulator", "store": Store(tmp_path), "executor": local, "on_event": lambda event: None}
    found = tune(asked, settings, **run)
    assert found.best.fields == {"alpha": 5.0}
    assert found.best.scores.tolist() == [[50.0, 51.0]] * 2
    assert "the chosen setting has the best of these scores, by chance too: evaluate it again with fresh seeds" in str(found)
    assert json.loads((tmp_path / "tuned.json").read_text())["best"] == {"alpha": 5.0}


def test_what_a_choice_by_estimates_loses_is_told():
    known = [(10.0, [1.0, 2.0]), (40.0, [5.0, 7.0]), (50.0, [4.0, 4.0])]
    trials = tuple(Trial({"alpha": float(i)}, np.full((1, 2), s), np.array(values)) for i, (s, values) in enumerate(known))
    text = str(Tuned("td3_bc", "ope", trials, trials[1], None, 10.0))
    assert "the choice loses 10.0 points of score, 25 % of the range of all; a random choice would lose 16.7" in text
    assert text.startswith("* alpha = 1.0")


def test_what_the_episodes_of_the_log_tell_of_a_choice_is_told():
    gains = [[[1.0, -70.0, 81.0], [2.0, -60.0, 70.0]], [[0.5, -80.0, 60.0]] * 2, [[-90.0, -99.0, -85.0]] * 2]
    none = np.full((1, 2), np.nan)
    trials = tuple(Trial({"alpha": i}, none, np.array([3.0 - i] * 2), "", np.array(g)) for i, g in enumerate(gains))
    text = str(Tuned("cql", "ope", trials, trials[0], None, None))
    assert "over the behaviour policy are between -70.00 and 81.00; those of 1 of the 2 other settings may be as large" in text


def test_a_setting_without_a_finite_estimate_is_not_chosen_and_the_file_is_json(tmp_path):
    settings = [{"alpha": value} for value in (1.0, 5.0)]
    values = np.array([2.0, np.nan]), np.array([1.0, 3.0])
    trials = [Trial(fields, np.full((1, 2), 4.0), own) for fields, own in zip(settings, values)]
    found = chosen(suite("td3_bc", [UMAZE], settings, by="ope", steps=10, seeds=2), "ope", trials, Store(tmp_path))
    assert found.best.fields == {"alpha": 5.0}
    assert "  alpha = 1.0  an estimate is not finite, not chosen" in str(found)

    def refuse(constant):
        raise ValueError(constant)

    told = json.loads((tmp_path / "tuned.json").read_text(), parse_constant=refuse)
    assert [each["values"] for each in told["trials"]] == [[2.0, None], [1.0, 3.0]]


@pytest.mark.parametrize(("scores", "values", "best", "lost"), [((0, 0), (1, 2), 5.0, 0.0), ((3, 4), (1, 1), 1.0, 1.0)])
def test_settings_of_equal_scores_have_no_order_that_estimates_could_find(scores, values, best, lost, tmp_path):
    """As in a sparse task where nothing reaches the goal, or by estimates that are all the same: the rest is told, and kept."""
    settings = [{"alpha": value} for value in (1.0, 5.0)]
    trials = [Trial(f, np.full((1, 2), s, float), np.full(2, v, float)) for f, s, v in zip(settings, scores, values)]
    found = chosen(suite("td3_bc", [UMAZE], settings, by="ope", steps=10, seeds=2), "ope", trials, Store(tmp_path))
    assert (found.best.fields, found.truth, found.lost) == ({"alpha": best}, None, lost)
    assert (tmp_path / "tuned.json").exists()


@pytest.mark.slow  # a log of one's own is chosen from in the same way below
def test_estimates_choose_from_the_log_alone(tmp_path, capsys):
    small = ["--fixed", "hidden=[8]", "batch_size=16", "--rows", "600", "--steps", "20", "--seeds", "2", "--workers", "1"]
    small += ["--out", str(tmp_path)]
    words = ["tune", "--agent", "td3_bc", "--data", UMAZE, "--values", "alpha=1.0,5.0", *small]
    assert main([*words, "--dry-run"]) == 0
    assert "4 cells, 0 of them done" in capsys.readouterr().out
    assert main([*words, "--fit.steps", "20", "--fit.members", "2", "--fit.hidden", "8"]) == 0
    told = capsys.readouterr().out
    assert "chosen: --agent.alpha " in told
    assert "estimated" in told
    assert "the choice loses" in told  # there is a simulator after all
    # Estimates are those of the settings that they are told for.
    tuned = json.loads((tmp_path / "tuned.json").read_text())
    estimates = json.loads((tmp_path / "estimates" / "estimates.json").read_text())
    runs = {row["job"]: json.loads(row["settings"])["alpha"] for row in Store(tmp_path).results().to_pylist()}
    for trial in tuned["trials"]:
        own = [i for i, each in enumerate(estimates["policies"]) if runs[each["run"]] == trial["fields"]["alpha"]]
        assert trial["values"] == [estimates["results"][0]["value"][i] for i in own]
    assert tuned["best"] == max(tuned["trials"], key=lambda trial: np.mean(trial["values"]))["fields"]


def test_the_command_counts_cells_and_refuses(tmp_path, capsys):
    words = ["tune", "--agent", "td3_bc", "--data", UMAZE, "--values", "alpha=1.0,5.0", "--rows", "600", "--steps", "20"]
    assert main([*words, "--seeds", "2", "--out", str(tmp_path), "--dry-run"]) == 0
    assert "4 cells, 0 of them done" in capsys.readouterr().out
    assert main(["tune", "--agent", "td3_bc", "--data", UMAZE, "--workers", "-1", "--dry-run"]) == 2
    assert "workers must be 1 or more, got -1" in capsys.readouterr().err
    lists = ["--values", "hidden=[8],[8,8]", "--dry-run", "--out", str(tmp_path / "lists"), "--seeds", "1"]
    assert main(["tune", "--agent", "td3_bc", "--data", UMAZE, *lists]) == 0
    assert "2 cells" in capsys.readouterr().out
    assert main(["tune", "--agent", "td3_bc", "--data", UMAZE, "--values", "alpha"]) == 2
    assert "written alpha=1,2.5" in capsys.readouterr().err


@pytest.mark.slow
def test_of_a_log_of_ones_own_what_is_held_out_is_looked_at_by_nobody(tmp_path, monkeypatch, capsys):
    rng, rows = np.random.default_rng(0), 120
    np.savez(
        tmp_path / "mine.npz", observations=rng.normal(size=(rows, 3)), actions=rng.uniform(-1, 1, (rows, 2)),
        rewards=rng.normal(size=rows), terminals=np.arange(rows) % 2 == 1,
    )  # fmt: skip
    log = read(tmp_path / "mine.npz")
    judged = []
    monkeypatch.setattr("deadreckon.bench.local.Local", InProcess)
    monkeypatch.setattr(module, "judge", lambda given, data, *a, **k: judged.append(data) or judge(given, data, *a, **k))
    words = ["tune", "--agent", "td3_bc", "--data", str(tmp_path / "mine.npz"), "--values", "alpha=1.0,5.0", "--fixed",
             "hidden=[8]", "batch_size=8", "--steps", "10", "--seeds", "1", "--workers", "1", "--out", str(tmp_path / "tune"),
             "--fit.steps", "10", "--fit.members", "2", "--fit.hidden", "8"]  # fmt: skip
    assert main(words) == 0
    assert "chosen: --agent.alpha" in capsys.readouterr().out
    # Estimates are those of the settings that they are told for.
    tuned = json.loads((tmp_path / "tune" / "tuned.json").read_text())
    estimates = json.loads((tmp_path / "tune" / "estimates" / "estimates.json").read_text())
    tried = {row["job"]: json.loads(row["settings"])["alpha"] for row in Store(tmp_path / "tune").results().to_pylist()}
    for trial in tuned["trials"]:
        own = [i for i, each in enumerate(estimates["policies"]) if tried[each["run"]] == trial["fields"]["alpha"]]
        assert trial["values"] == [estimates["results"][0]["value"][i] for i in own]
    assert tuned["best"] == max(tuned["trials"], key=lambda trial: np.mean(trial["values"]))["fields"]
    held = set(log.episode_ids[Holdout().parts(log).held].tolist())
    estimated = set(judged[0].episode_ids.tolist())
    runs = [load(path.parent) for path in (tmp_path / "tune").rglob("run.json")]
    assert len(runs) == 2
    for run in runs:
        taught = set(run.taught.tolist())
        assert (len(taught), len(estimated), len(held)) == (38, 10, 12)
        assert not taught & estimated
        assert taught | estimated | held == set(log.episode_ids.tolist())
    # What `train` holds out afterwards is just that.
    assert set(divided(log, None, None, None).held.tolist()) == held


def test_suites_learn_from_all_of_a_log(tmp_path):
    rng = np.random.default_rng(0)
    columns = {"observations": rng.normal(size=(24, 2)), "actions": np.arange(24) % 2, "rewards": np.zeros(24)}
    np.savez(tmp_path / "mine.npz", **columns, terminals=np.ones(24))
    on = str(tmp_path / "mine.npz")
    methods = (Method("BC", "bc", {"hidden": [4], "batch_size": 4}),)
    asked = Suite("s", "learn", (on,), methods, seeds=1, steps={on: 2}, evaluations=1)
    [job] = plan(asked)
    perform(Program((job,)), tmp_path / "run")
    assert len(load(tmp_path / "run").taught) == 24
    [divided_job] = plan(replace(asked, divided=True))
    assert divided_job.cells != job.cells
    [known] = plan(replace(asked, on=(UMAZE,), steps={UMAZE: 2}, divided=True))
    assert "divided" not in known.options


def test_what_was_chosen_is_told_as_train_takes_it():
    given = {"hidden": (64, 64), "value_penalty": False, "standardise": True, "alpha": 2.5}
    options = "--agent.hidden 64 64 --agent.no-value-penalty --agent.standardise --agent.alpha 2.5"
    assert shlex.join(str(word) for each in given.items() for word in option(*each)) == options
