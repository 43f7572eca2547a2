"""What makes the files that the package ships, on a short setting."""

import json
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
