"""`fit`, `save` and `load` in Python, with the familiar meaning."""

import numpy as np
import pytest

import deadreckon as dr


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(0)
    return dr.Dataset.from_arrays(
        observations=rng.normal(size=(80, 3)), actions=rng.uniform(-1, 1, (80, 1)), rewards=rng.normal(size=80),
        timeouts=np.arange(80) % 20 == 19, name="mine",
    )  # fmt: skip


@pytest.mark.slow
def test_fit_is_train_in_a_new_folder_every_time(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    agent = dr.agents.BC(hidden=(16, 16), batch_size=32)
    first, second = agent.fit(log, steps=20), agent.fit(log, steps=20, seed=0)
    assert [str(run.path) for run in (first, second)] == ["runs/bc-mine", "runs/bc-mine-2"]
    assert first.metrics.equals(second.metrics)
    assert first.metrics.equals(dr.train(agent, log, steps=20, out="same").metrics)
    with pytest.raises(dr.UserError, match="holds a run already"):
        agent.fit(log, steps=20, out=first.path)
    with pytest.raises(dr.UserError, match="unknown setting 'step'"):
        agent.fit(log, step=20)


def test_a_saved_run_is_loaded_and_resumed_elsewhere(log, tmp_path):
    agent = dr.agents.BC(hidden=(16, 16), batch_size=32)
    run = agent.fit(log, steps=20, out=tmp_path / "r")
    (run.path / ".x.tmp").write_text("left by a kill")
    place = run.save(tmp_path / "copy" / "r")
    again = dr.Run.load(place)
    x = np.ones((2, 3), np.float32)
    np.testing.assert_array_equal(again.policy(x), run.policy(x))
    assert not (place / ".x.tmp").exists()
    with pytest.raises(dr.UserError, match="exists already"):
        run.save(place)
    longer = agent.fit(log, steps=30, out=place, resume=True)
    assert longer.config["steps"] == 30
    assert dr.load_run(run.path).config["steps"] == 20
    with pytest.raises(dr.UserError, match="cannot write"):
        dr.Run(tmp_path / "gone", {}, [], [], []).save(tmp_path / "elsewhere")
    assert not (tmp_path / "elsewhere").exists()
