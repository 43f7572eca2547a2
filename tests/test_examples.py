"""The declared runs of docs/results, on a short setting."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
@pytest.mark.timeout(450)  # it compiles everything twice where nothing is cached
def test_maze2d_table_runs_and_resumes(tmp_path, home):
    options = {"steps": 20, "seeds": 2, "episodes": 2, "log-steps": 4000, "maze": "eval-umaze", "out": tmp_path / "runs"}
    command = [sys.executable, str(ROOT / "examples" / "maze2d_table.py"), "--hidden", "16", "16"]
    command += ["--only", "bc", "td3", "bear"]
    command += [str(word) for name, value in options.items() for word in (f"--{name}", value)]
    first = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280)
    assert "BEAR" in first.stdout
    assert (tmp_path / "runs" / "report.html").exists()
    again = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert again.stdout == first.stdout


@pytest.mark.slow
def test_gym_tables_run_and_resume(tmp_path, home):
    command = [sys.executable, str(ROOT / "examples" / "gym_tables.py"), "--hidden", "16", "16"]
    command += ["--groups", "table", "ablations", "--logs", "hopper-medium-v2"]
    command += ["--only", "bc", "bear", "bear-no-actor-maximisation"]
    options = {"steps": 20, "seeds": 2, "episodes": 2, "log-steps": 4000, "out": tmp_path / "runs"}
    command += [str(word) for name, value in options.items() for word in (f"--{name}", value)]
    first = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280)
    assert "| hopper-medium-v2 |" in first.stdout
    page = tmp_path / "runs" / "hopper-medium-v2" / "report.html"
    assert "halfcheetah-medium-expert" in page.read_text()  # the published suite
    again = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert again.stdout == first.stdout


@pytest.mark.slow
def test_agents_table_runs_and_resumes(tmp_path, home):
    command = [sys.executable, str(ROOT / "examples" / "agents_table.py"), "--logs", "maze2d-umaze-v1"]
    command += ["--only", "BC", "KL-control", "Decision Transformer"]
    options = {"width": 8, "steps": 20, "seeds": 2, "episodes": 2, "log-steps": 4000, "out": tmp_path / "runs"}
    command += [str(word) for name, value in options.items() for word in (f"--{name}", value)]
    first = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280)
    assert "| agent | maze2d-umaze-v1: score | thesis |" in first.stdout
    assert re.search(r"\| BC \| [-\d.]+.* \| 3.8 \|", first.stdout)
    assert "| Decision Transformer |" in first.stdout
    again = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert again.stdout == first.stdout


@pytest.mark.slow
def test_behavior_policies_are_trained_published_and_drawn(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
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
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
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
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
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
    # The point of the figure: outside of the data NML is less sure than inside, and less surprised than the ensemble.
    _, _, queries, nml, boot = example.beliefs(options, 0)
    inside = np.any([(queries >= low) & (queries <= high) for low, high in example.SEEN], 0)
    truth = np.minimum((np.sin(queries) + 1) / 2 * 8, 7).astype(int)
    surprise = lambda probs: -np.log(probs[np.arange(16), truth])[~inside].mean()  # noqa: E731
    assert example.entropy(nml)[~inside].mean() > example.entropy(nml)[inside].mean()
    assert surprise(nml) < surprise(boot)


@pytest.mark.slow
def test_design_tables_run_and_resume(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    import design_tables as example

    from deadreckon.mbo.registry import PRESETS

    monkeypatch.setitem(PRESETS["nemo"], "branin", {"bins": 4, "hidden": (8,), "pretrain": 10, "lr": 0.005})
    groups, out = ("table", "nml", "ratio"), str(tmp_path)
    options = example.Options(groups, ("branin",), only=("best", "random"), seeds=2, n=8, rises=(5,), out=out)
    example.main(options)
    first = capsys.readouterr().out
    assert "| problem | data | best | random |" in first
    assert "| problem | data | NML, 5 steps | none, 5 steps |" in first
    assert "20:1, 0.05, 5 steps" in first
    example.main(options)
    assert capsys.readouterr().out == first


@pytest.mark.slow
def test_mbpo_curves_run_resume_and_are_drawn(tmp_path, monkeypatch, capsys, home):
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    import mbpo_curves as example

    for group, count in (("compare", 3), ("ratio", 5), ("length", 4)):
        assert len(example.variants(group, "hopper")) == count
    assert example.variants("compare", "hopper")["sac-20"][1].updates_per_step == 20
    cheap = example.variants("length", "halfcheetah", rollouts=20, updates=5)["mbpo-k200"]
    assert (cheap[0].rollouts_per_step, cheap[1].updates_per_step) == (20, 5)
    with pytest.raises(SystemExit, match="no run is called mbpo-k2: choose from mbpo, sac-20, sac-1"):
        example.main(example.Options(only=("mbpo-k2",)))
    tiny = {"hidden": (8,), "batch_size": 16, "model_hidden": (8,), "model_weight_decay": (), "members": 2, "elites": 1,
            "model_epochs": 1, "rollouts_per_step": 2, "model_train_freq": 50, "retain_steps": 50}  # fmt: skip

    def variants(group, task, *_):
        settings = example.Online(copies=2, explore=50, updates_per_step=0.2, block=50)
        return {"mbpo": (example.MBPO(**tiny), settings), "sac": (example.SAC(hidden=(8,), batch_size=16), settings)}

    monkeypatch.setattr(example, "variants", variants)
    drawn = str(tmp_path / "curves.svg")
    options = example.Options("inverted-pendulum", steps=200, seeds=2, every=50, episodes=2, out=str(tmp_path), picture=drawn)
    example.main(options)
    first = capsys.readouterr().out
    assert "| mbpo | 0:" in first
    assert "| sac | 0:" in first
    assert " 200:" in first
    assert "<svg" in Path(drawn).read_text()
    example.main(options)
    assert capsys.readouterr().out == first


@pytest.mark.slow
def test_model_returns_measures_and_draws(tmp_path, monkeypatch, capsys, home):
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    import model_returns as example

    import deadreckon as dr
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
def test_online_table_runs_and_resumes(tmp_path, home):
    command = [sys.executable, str(ROOT / "examples" / "online_table.py"), "--logs", "maze2d-umaze-v1"]
    options = {"steps": 10_064, "seeds": 2, "episodes": 2, "out": tmp_path / "runs"}
    command += [str(word) for name, value in options.items() for word in (f"--{name}", value)]
    first = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280)
    assert re.search(r"\| maze2d-umaze \| 10,064 \| .* \| 62.7 \|", first.stdout)
    again = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert again.stdout == first.stdout


@pytest.mark.slow
def test_pictures_of_mazes(tmp_path, home):
    command = [sys.executable, str(ROOT / "examples" / "maze_coverage.py"), "--steps", "1500", "--shown", "2"]
    files = {name: tmp_path / f"{name}.svg" for name in ("trajectories", "coverage")}
    command += [str(word) for name, path in files.items() for word in (f"--{name}", path)]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280).stdout
    assert len(re.findall(r"-v[12]: \d+% of the free ground", told)) == 6
    assert [path.read_text().count('class="maze"') for path in files.values()] == [6, 6]
