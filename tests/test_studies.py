"""The studies of docs/results, on a short setting."""

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_nemo_sine_measures_and_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(ROOT))
    import evidence.studies.nml_sine as example

    options = example.Options(
        queries=16, bins=8, points=80, hidden=(8,), steps=200, lr=0.02, seeds=1, picture=str(tmp_path / "sine.svg")
    )
    example.main(options)
    assert "| NML |" in capsys.readouterr().out
    assert (tmp_path / "sine.svg").read_text().startswith("<svg")
    # The point of the figure: outside of the data NML becomes less sure than the ensemble does, and is less surprised.
    _, _, queries, nml, boot = example.beliefs(options, 0)
    inside = np.any([(queries >= low) & (queries <= high) for low, high in example.SEEN], 0)
    truth = np.minimum((np.sin(queries) + 1) / 2 * 8, 7).astype(int)
    surprise = lambda probs: -np.log(probs[np.arange(16), truth])[~inside].mean()  # noqa: E731
    less_sure = lambda probs: example.entropy(probs)[~inside].mean() - example.entropy(probs)[inside].mean()  # noqa: E731
    assert less_sure(nml) > less_sure(boot) + 0.1  # seeds 0 to 4: 0.2 to 0.35 more
    assert surprise(nml) < surprise(boot)


@pytest.mark.slow
def test_model_returns_measures_and_draws(tmp_path, monkeypatch, capsys, home):
    monkeypatch.syspath_prepend(str(ROOT))
    import deadreckon as dr
    import evidence.studies.model_returns as example
    from deadreckon.errors import UserError
    from deadreckon.online import Online

    small = {"hidden": (8,), "batch_size": 16}
    model = {"model_hidden": (16,), "model_weight_decay": (), "members": 2, "elites": 2, "model_epochs": 3,
             "model_train_freq": 50}  # fmt: skip
    settings = Online(copies=2, explore=200, updates_per_step=0.2, block=50)
    plan = {"steps": 300, "settings": settings, "evaluate_every": 50, "episodes": 1}
    agent = dr.agents.MBPO(**small, **model, rollouts_per_step=2, retain_steps=50)
    run = dr.train_online(agent, "hopper", out=tmp_path / "run", **plan)
    options = example.Options(
        str(run.path), policies=2, rows=300, episodes=20, horizon=30, sequence=10, picture=str(tmp_path / "fan.svg")
    )
    example.main(options)
    said = capsys.readouterr().out
    assert "| 0 | " in said
    assert "| 300 | " in said
    assert "| 10 | " in said
    assert "correlation over the policies" in said
    assert "<svg" in (tmp_path / "fan.svg").read_text()
    plain = dr.train_online(dr.agents.SAC(**small), "hopper", out=tmp_path / "sac", **plan)
    with pytest.raises(UserError, match="a run of SAC, which has no model"):
        example.main(example.Options(str(plain.path)))


@pytest.mark.slow
def test_returns_in_a_model_are_compared_with_those_of_its_run(monkeypatch, home):
    monkeypatch.syspath_prepend(str(ROOT))
    import evidence.studies.model_returns as study

    small = {"hidden": (8,), "model_hidden": (16,), "model_weight_decay": (), "members": 2, "elites": 2, "model_epochs": 3}
    found = study.agreement("hopper", seed=0, steps=5_600, updates_per_step=0.08, every=200, **small)
    assert -1.0 <= found["correlation"] <= 1.0
    assert found["ratio"] > 0


@pytest.mark.slow
def test_what_a_run_of_mbpo_shows_of_its_falls(monkeypatch, home):
    monkeypatch.syspath_prepend(str(ROOT))
    import evidence.studies.mbpo_falls as study

    small = {"hidden": (8,), "model_hidden": (16,), "model_weight_decay": (), "members": 2, "elites": 2, "model_epochs": 3}
    found = study.falls("hopper", seed=0, steps=5_400, updates_per_step=0.08, every=200, rollout_length=[1, 2, 1, 2], **small)
    assert np.isfinite(list(found.values())).all()
    assert found["last"] <= found["best"]
    assert 0.0 < found["behind"] < 1.0
    assert found["error_of_falls"] > 0.0


def test_the_last_steps_before_a_fall_are_those_of_episodes_that_ended_so(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    import evidence.studies.mbpo_falls as study
    from deadreckon.data.dataset import Dataset

    terminals, timeouts = np.zeros(40, bool), np.zeros(40, bool)
    terminals[[14, 39]], timeouts[35] = True, True  # of 15 steps, 21 steps that ran out of time, and 4
    log = Dataset.from_arrays(
        observations=np.zeros((40, 2)), actions=np.zeros((40, 1)), rewards=np.zeros(40), terminals=terminals, timeouts=timeouts
    )
    assert list(np.flatnonzero(study._falling(log))) == [*range(5, 15), *range(36, 40)]


def test_drawn_actions_are_averaged_over_policies_and_not_over_episodes(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    import evidence.studies.mbpo_falls as study
    from deadreckon.data.dataset import Dataset

    def played(length):  # 40 rows at a reward of 1
        ends = np.arange(40) % length == length - 1
        nothing = {"observations": np.zeros((40, 2)), "actions": np.zeros((40, 1))}
        return Dataset.from_arrays(**nothing, rewards=np.ones(40), terminals=ends)

    assert study._drawn([played(40), played(4)]) == 22.0


@pytest.mark.slow
def test_pictures_of_mazes(tmp_path, home):
    command = [sys.executable, str(ROOT / "evidence" / "studies" / "maze_coverage.py"), "--steps", "1500", "--shown", "2"]
    files = {name: tmp_path / f"{name}.svg" for name in ("trajectories", "coverage")}
    command += [str(word) for name, path in files.items() for word in (f"--{name}", path)]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280).stdout
    assert len(re.findall(r"-v[12]: \d+% of the free ground", told)) == 6
    assert [path.read_text().count('class="maze"') for path in files.values()] == [6, 6]


def test_the_threshold_of_a_grid_is_chosen_by_other_errors_than_it_is_judged_by(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    import evidence.studies.grid_errors as study

    asked = []

    def propagate(on, epsilon, shown, *, seed):
        asked.append((epsilon, seed))
        return SimpleNamespace(returns={"support": -abs(epsilon - 0.2), "unconstrained": 9.0})

    monkeypatch.setattr(study, "propagate", propagate)
    monkeypatch.setattr(study, "THRESHOLDS", 4)
    on = SimpleNamespace(behavior=np.array([[0.6, 0.4], [0.2, 0.8]]))
    assert study.chosen(on, 7) == pytest.approx(0.15)
    assert np.allclose([epsilon for epsilon, _ in asked], [0.15, 0.3, 0.45, 0.6])  # up to where a state has no action; never 0
    assert {seed for _, seed in asked} == {study.APART + 7}


@pytest.mark.slow
def test_a_model_of_more_data_errs_less(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    import evidence.studies.model_shift as study

    Options = study.Options
    monkeypatch.setattr(study, "Options", lambda **given: Options(**given, collected=2_000, judged=500, epochs=100))
    few, many = (study.error("hopper medium", seed=0, rows=rows) for rows in (200, 2_000))
    assert set(few) == {"own", "far", "slope", "rise"}
    assert np.isfinite(list(few.values())).all()
    assert many["own"] < few["own"]


@pytest.fixture
def few_superconductors(real_data, home, monkeypatch):
    """The first 399 materials of the list, by which the judges are learned."""
    monkeypatch.syspath_prepend(str(ROOT))
    from evidence.studies.superconductor_judges import judges

    lines = (real_data / "supercon" / "Supercon_data.csv").read_text().splitlines()
    (home / "designs").mkdir(parents=True)
    (home / "designs" / "superconductor.csv").write_text("\n".join(lines[:400]))
    judges.cache_clear()
    yield
    judges.cache_clear()  # of another list


@pytest.mark.slow
@pytest.mark.usefixtures("few_superconductors")
def test_the_same_superconductors_are_scored_by_four_oracles():
    from evidence.studies.superconductor_judges import designs, everything

    found = designs("80", seed=0, method="best")
    shown = everything().visible
    assert found["shown"] == np.sort(shown.y)[: round(0.8 * len(shown.y))].max()
    assert found["best"] > found["median"]
    assert len({found[name] for name in found if name.startswith("best")}) == 4
    assert min(found["best_half"], found["best_shallow"], found["best_histogram"]) > 0.5 * found["shown"]


@pytest.mark.slow
@pytest.mark.usefixtures("few_superconductors")
def test_settings_are_searched_with_the_judges_in_view_and_run_again_with_another_seed(monkeypatch):
    from evidence.studies import superconductor_search as study

    monkeypatch.setattr(study, "RATES", (0.005,))
    short = {"updates": 20, "every": 10, "pretrain": 20, "bins": 4}
    found = study.searched("80", seed=0, **short)
    assert found["rate"] == 0.005
    assert found["step"] in study.STEPS
    assert found["after"] in (10, 20)
    monkeypatch.setattr(study, "STEPS", (found["step_half"],))  # the chosen one alone is seen as it was
    alone = study.searched("80", seed=0, **short)
    assert alone["seen_half"] == pytest.approx(found["seen_half"])
    assert alone["best_half"] == pytest.approx(found["best_half"])
    assert alone["seen"] <= found["seen"] + 1e-6
    assert found["best_half"] != found["seen_half"]
