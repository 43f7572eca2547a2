"""What makes the files that the package ships, on a short setting."""

import dataclasses
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_behavior_policies_are_trained_published_and_drawn(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import behavior_policies as example

    from deadreckon.online import Online

    monkeypatch.setattr(example, "RUNS", {"hopper": example.Made(-1.0, 320, 96, 320)})
    monkeypatch.setattr(example, "SETTINGS", Online(explore=64, updates_per_step=0.5))
    monkeypatch.setattr(example, "EVERY", 64)
    library = tmp_path / "library"
    example.main(
        example.Options(
            only=("hopper",), train=True, publish=True, episodes=2, most=2, out=str(tmp_path), library=str(library),
            picture=str(tmp_path / "curves.svg"),
        )
    )  # fmt: skip
    assert len(list((library / "hopper").glob("*.npz"))) == 13
    assert "D4RL expert" in (tmp_path / "curves.svg").read_text()


@pytest.mark.slow
def test_dapg_policies_are_trained_published_and_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import dapg_policies as example

    from deadreckon.agents import DAPG
    from deadreckon.policies import library

    small = example.Made(DAPG(hidden=(4,), critic_hidden=(4,), bc_steps=2), 10)
    monkeypatch.setattr(example, "RUNS", {"maze2d-umaze-dense": small})
    monkeypatch.setattr(example, "BUDGETS", {"cpu": (8, 1)})
    place = tmp_path / "library"
    options = example.Options(
        only=("maze2d-umaze-dense",), budget="cpu", train=True, publish=True, episodes=2, out=str(tmp_path), library=str(place)
    )
    example.main(options)
    about = json.loads((place / "maze2d-umaze-dense.json").read_text())
    assert about["agent"] == "dapg"
    assert about["run"]["demonstrations"]["episodes"] == 25
    assert [each["environment_steps"] for each in about["policies"].values()][:3] == [0, 8 + 2400, 8 + 4800]
    monkeypatch.setattr(library, "ROOT", place)
    library.about.cache_clear()
    try:
        assert len(library.load_policies("maze2d-umaze-dense")) == 11
        example.main(example.Options(only=("maze2d-umaze-dense",), budget="cpu", table=True))
    finally:
        library.about.cache_clear()
    assert "| `maze2d-umaze-dense` | " in capsys.readouterr().out


@pytest.mark.slow
def test_unplugged_policies_learn_from_four_fifths_of_the_log_and_are_estimated(tmp_path, monkeypatch, capsys):
    pytest.importorskip("dm_control", reason="dm_control is not installed (extra `control`)")
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import unplugged_policies as example

    import deadreckon as dr
    from deadreckon.agents import ABM, BC, CRRD, D4PG
    from deadreckon.collect import control, recipes
    from deadreckon.ope.dope import evaluate_log, markdown
    from deadreckon.ope.registry import estimator
    from deadreckon.policies import library
    from deadreckon.runs.dope import dope
    from deadreckon.runs.gather import fresh, gather
    from deadreckon.tasks import registry

    little = {"hidden": (8,), "batch_size": 16}
    agents = {
        "d4pg": D4PG(critic_hidden=(8,), **little), "abm": ABM(samples=2, **little), "bc": BC(model="normal", **little),
        "crr_d": CRRD(critic_hidden=(8,), **little),
    }  # fmt: skip
    monkeypatch.setattr(example, "SIZES", {"cpu": example.Size(agents, (2, 6))})
    monkeypatch.setattr(example, "SEEDS", 1)
    monkeypatch.setattr(control, "AGENT", D4PG(critic_hidden=(8,), n_step=5, **little))
    monkeypatch.setitem(control.TRAINED, "cartpole-swingup", 2_000)
    short = dataclasses.replace(registry.task("cartpole-swingup"), horizon=50)  # forty episodes as they are, but of 50 steps
    monkeypatch.setitem(registry._TASKS, short.name, short)
    name = "cartpole-swingup-full-replay-v0"
    log_of_it = dataclasses.replace(recipes.recipe(name), steps=2_000, make=partial(control.collect_control, short))
    monkeypatch.setitem(recipes._RECIPES, name, log_of_it)
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path / "home"))
    place = tmp_path / "library"
    options = example.Options(
        only=("cartpole-swingup",), budget="cpu", train=True, publish=True, episodes=2, most=2, out=str(tmp_path),
        library=str(place),
    )  # fmt: skip
    example.main(options)
    monkeypatch.setattr(library, "ROOT", place)
    library.about.cache_clear()
    try:
        found = library.evaluated("cartpole-swingup")
        assert [s.name for s in found[:3]] == ["d4pg-0-2", "d4pg-0-6", "abm-0-2"]
        assert len(found) == 4 * 2
        assert found[0].greedy is None
        log = dr.load("cartpole-swingup-full-replay-v0")
        about = library.about("cartpole-swingup")
        assert about["run"]["data"]["fingerprint"] == log.fingerprint
        assert about["run"]["runs"]["crr_d"]["agent"]["fields"]["hidden"] == [8]
        episodes = fresh(gather("cartpole-swingup"), log, unseen=False)
        assert len(episodes.held) == 8  # a fifth of forty
        assert episodes.against == [None] * 8
        [result] = dope([lambda data, policies, discount: np.arange(len(policies))], half="unplugged")
        assert result.log == log.name
        assert "| thesis E.2 |" not in markdown([result], "rank_correlation")  # a function is nobody's estimator
        [result] = evaluate_log(log, "cartpole-swingup", [estimator("is", steps=10, hidden=(8,))])
        assert "| -0.23 ± 0.11 |" in markdown([result], "rank_correlation")
        assert "| 0.73 ± 0.16 |" in markdown([result], "regret", k=5)
        assert "thesis" not in markdown([result], "regret")
        example.main(example.Options(only=("cartpole-swingup",), budget="cpu", table=True))
    finally:
        library.about.cache_clear()
    assert "| `cartpole-swingup` | crr_d | 2, 6 | " in capsys.readouterr().out


@pytest.mark.slow
def test_morphologies_are_made(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import morphologies as example

    monkeypatch.setattr(example, "stored", lambda task: tmp_path / f"{task.name}.npz")
    monkeypatch.setattr(example, "RUNS", 2)
    monkeypatch.setattr(example, "ITERATIONS", {"ant": (1, 1)})
    example.main(example.Options(only=("ant",), gait=True, collect=True, designs=40, runs=(0, 1), out=str(tmp_path)))
    made = np.load(tmp_path / "ant-morphology.npz")
    assert made["gait"].shape == (38,)
    assert made["steps"].shape == (40, 60)
    assert np.isfinite(made["scores"]).all()
    assert made["scores"].shape == (40,)
