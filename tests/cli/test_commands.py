"""The commands as a user types them, on small settings."""

import os
import pickle
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import deadreckon as dr
from deadreckon.cli.main import COMMANDS, main
from deadreckon.collect import generate
from deadreckon.files import read_json, write_json


def test_help_names_every_command(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in COMMANDS)
    assert main([]) == 0
    assert main(["--version"]) == 0


def test_tasks_and_agents(capsys):
    assert main(["tasks", "--domain", "maze2d"]) == 0
    out = capsys.readouterr().out
    assert "maze2d-eval-large-dense" in out
    assert "evaluation" in out
    assert "environment steps" in out
    assert main(["tasks", "--domain", "control"]) == 0
    out = capsys.readouterr().out
    assert "fish-swim-full-replay-v0" in out
    assert "d4pg-0-100000" in out
    assert not any(name in out for name in ("D4RL random", "environment steps", "with mean actions"))  # none has an entry
    assert main(["agents"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ("bc", "bear_is", "thesis 4.3, Algorithm 1"))
    assert "actor_penalty 0.05, critic_penalty 0.5" in out


def test_agent_help_shows_the_comments_behind_fields(capsys):
    with pytest.raises(SystemExit) as done:
        main(["train", "--agent", "bear", "--help"])
    assert done.value.code == 0
    out = capsys.readouterr().out
    assert "--agent.min-weight" in out
    assert "lambda" in out


def test_collect_info_convert_train_evaluate_report(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAX_PLATFORMS", "")
    monkeypatch.delenv("JAX_PLATFORMS")
    assert main(["data", "collect", "maze2d-umaze-v1", "--steps", "3000", "--seed", "1", "--out", "log.hdf5"]) == 0
    assert os.environ.pop("JAX_PLATFORMS") == "cpu"
    assert main(["data", "info", "log.hdf5"]) == 0
    out = capsys.readouterr().out
    assert "maze2d-umaze-v1@dr1" in out
    assert "3,000" in out
    assert main(["data", "convert", "log.hdf5", "log.csv"]) == 0
    small = ["--steps", "40", "--chunk", "20", "--episodes", "2", "--agent.hidden", "8", "8", "--agent.batch-size", "16"]
    assert main(["train", "--agent", "bc", "--data", "log.hdf5", "--seeds", "2", "--out", "run", *small]) == 0
    out = capsys.readouterr().out
    assert "score" in out
    assert "run folder: run" in out
    assert main(["train", "--agent", "bc", "--data", "log.hdf5", "--seeds", "2", "--out", "run", "--resume", *small]) == 0
    capsys.readouterr()
    assert main(["evaluate", "run", "--episodes", "3", "--out", "scores.parquet"]) == 0
    assert "run seed 1" in capsys.readouterr().out
    table = pq.read_table("scores.parquet")
    assert len(table) == 6
    assert np.isfinite(table["score"].to_numpy()).all()
    assert main(["evaluate", "run/policies/seed0.npz", "--task", "maze2d-umaze", "--episodes", "2"]) == 0
    shutil.copytree("run", "other")
    config = read_json(Path("other/run.json"))
    write_json(Path("other/run.json"), config | {"task": "maze2d-large"})
    assert main(["evaluate", "run", "other", "--episodes", "2"]) == 2
    assert "the runs are of several tasks (maze2d-large, maze2d-umaze)" in capsys.readouterr().err
    assert main(["report", "run", "--out", "page.html"]) == 0
    assert (tmp_path / "page.html").stat().st_size > 10_000


@pytest.mark.slow
def test_cross_fits_and_files_of_dope_are_evaluated_too(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    log = generate("maze2d-umaze-v1", steps=1200, seed=0)  # four episodes: both folds learn in the same program
    dr.cross_fit(dr.agents.BC(hidden=(4,), batch_size=8), log, folds=2, seeds=2, steps=2, episodes=1, out="c")
    (tmp_path / "dope.pkl").write_bytes(pickle.dumps({"last_fc/weight": np.zeros((2, 4)), "last_fc/bias": np.zeros(2)}))
    assert main(["evaluate", "c", "dope.pkl", "--episodes", "1"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ("maze2d-umaze: 1 episodes", "c seed 0", "c seed 1", "dope"))


def test_options_that_would_do_nothing_are_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    given = ["train", "--agent", "bc", "--data", "log.csv"]
    (tmp_path / "log.csv").write_text("x,action,reward\n" + "0.1,1,0.5\n0.2,0,0.5\n" * 20)
    for options, words in (
        (["--deliver", "refit"], "--deliver refit is for cross-fits; give --cross-fit FOLDS too"),
        (["--holdout", "0", "--holdout-by", "time"], "--holdout 0 holds nothing out; leave --holdout-by time out"),
    ):
        assert main([*given, "--action", "action", "--reward", "reward", *options]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.slow
def test_a_table_of_ones_own_by_its_columns(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    lines = ["patient,hour,pulse,dose,outcome"]
    lines += [f"{i // 5},{i % 5},{rng.normal():.3f},{rng.uniform():.3f},{rng.normal():.3f}" for i in range(60)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    columns = ["--episode", "patient", "--time", "hour", "--action", "dose", "--reward", "outcome"]
    assert main(["data", "info", "log.csv", *columns]) == 0
    assert "12 episodes" in capsys.readouterr().out
    settings = ["--steps", "10", "--agent.hidden", "8", "--agent.batch-size", "8"]
    assert main(["train", "--agent", "bc", "--data", "log.csv", *columns, "--out", "run", *settings]) == 0
    words = r"MMD to the log \d\.\d{3}: the distance .* for a copy is below .*; \d+\.\d% of its"
    assert re.search(words, capsys.readouterr().out)


@pytest.mark.slow
def test_human_demonstrations_train_and_report_losses_and_mmd(real_data, tmp_path, monkeypatch, capsys):
    """Real input: 25 episodes with as many observations as rewards, most rows out of bounds."""
    monkeypatch.chdir(tmp_path)
    log = real_data / "adroit" / "door-v0_demos.pickle"
    small = ["--steps", "60", "--chunk", "20", "--agent.hidden", "16", "16", "--agent.batch-size", "32"]
    assert main(["train", "--agent", "bear", "--data", str(log), "--out", "run", *small]) == 0
    out = capsys.readouterr().out
    assert "5497 of 6729 rows (82 %) have actions out of bounds" in out
    assert "25 of 6729 rows are left out" in out
    assert "critic_loss" in out
    assert "mmd " in out
    assert "MMD to the log" in out
