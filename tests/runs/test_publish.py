"""Policies of an online run, shipped with their measured returns."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from deadreckon.agents.sac import SAC
from deadreckon.errors import UserError
from deadreckon.online import Online
from deadreckon.policies import library, store
from deadreckon.runs.evaluate import evaluate
from deadreckon.runs.online import train_online
from deadreckon.runs.publish import Publish, Shipping, publish, publish_runs


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "hopper"
    settings = Online(copies=4, explore=64, updates_per_step=0.25, block=32)
    train_online(
        SAC(hidden=(8, 8), batch_size=16), "hopper", steps=64 + 32 * 10, settings=settings, evaluate_every=32, episodes=1,
        out=out,
    )  # fmt: skip
    return out


@pytest.fixture(scope="module")
def shipped(run, tmp_path_factory):
    out = tmp_path_factory.mktemp("library")
    publish(Publish(str(run), medium=24, expert=80, episodes=4, most=4, out=str(out)))
    return out


@pytest.mark.slow
def test_what_is_measured_is_what_is_shipped(shipped, monkeypatch):
    monkeypatch.setattr(library, "ROOT", shipped)
    library.about.cache_clear()
    try:
        found = library.library("hopper")
        assert len(found) == 13
        assert len(library.load_policies("hopper")) == 11
        assert [s.updates for s in found] == [*range(0, 81, 8), 24, 80]
        assert found[3].environment_steps == 64 + 3 * 32
        each = found[5]
        again = evaluate(each.policy(), "hopper", episodes=4, seed=1_000_000, greedy=False, discount=0.995)
        assert each.sampled.mean == pytest.approx(again.returns.mean())
        assert each.sampled.discounted == pytest.approx(again.discounted.mean())
        assert each.sampled.error == pytest.approx(again.returns.std(ddof=1) / 2)
        assert library.about("hopper")["medium_replay"]["environment_steps"] == found[11].environment_steps
    finally:
        library.about.cache_clear()


@pytest.mark.slow
def test_weights_are_half_and_act_alike(run, shipped):
    small = np.load(shipped / "hopper" / "snapshot-04.npz")
    weights = [small[name] for name in small.files if name.startswith("policy.inner.")]
    assert weights
    assert all(w.dtype == np.float16 for w in weights)
    seen = np.random.default_rng(0).normal(size=(50, 11)).astype(np.float32)
    original = store.load(run / "policies" / "0000000032-seed0.npz")
    np.testing.assert_allclose(store.load(shipped / "hopper" / "snapshot-04.npz")(seen), original(seen), atol=3e-3)


@pytest.mark.slow
def test_measuring_goes_on_where_it_was_stopped(run, shipped, tmp_path):
    class Killed(Exception):
        pass

    told = []

    def kill(line):
        told.append(line)
        if len(told) == 7:
            raise Killed

    options = Publish(str(run), medium=24, expert=80, episodes=4, most=4, out=str(tmp_path))
    with pytest.raises(Killed):
        publish(options, kill)
    told.clear()
    path = publish(options, told.append)
    assert len(told) == 1 + 2 * 11 - 7  # medium and expert are among the snapshots
    assert json.loads(path.read_text()) == json.loads((shipped / "hopper.json").read_text())


@pytest.mark.slow
def test_episodes_are_added_until_the_error_is_small(run, tmp_path):
    path = publish(Publish(str(run), medium=24, expert=80, episodes=4, most=12, error=0.0, out=str(tmp_path)))
    assert json.loads(path.read_text())["policies"]["snapshot-01"]["sampled"]["episodes"] == 12


@pytest.mark.slow
def test_more_episodes_are_measured_when_asked_for(run, tmp_path):
    options = Publish(str(run), medium=24, expert=80, episodes=2, most=2, out=str(tmp_path))
    publish(options)
    path = publish(dataclasses.replace(options, episodes=3, most=3))
    about = json.loads(path.read_text())
    counts = {each[mode]["episodes"] for each in about["policies"].values() for mode in ("sampled", "greedy")}
    assert counts | {about["uniform"]["episodes"]} == {3}
    publish(dataclasses.replace(options, episodes=3, most=7, error=0.0))
    about = json.loads(path.read_text())
    assert {each["greedy"]["episodes"] for each in about["policies"].values()} == {6}


@pytest.mark.slow
def test_processes_measure_the_same(run, shipped, tmp_path):
    publish(Publish(str(run), medium=24, expert=80, episodes=4, most=4, out=str(tmp_path), processes=2))
    assert json.loads((tmp_path / "hopper.json").read_text()) == json.loads((shipped / "hopper.json").read_text())


@pytest.mark.slow
def test_a_library_stays_whole_while_another_is_measured(run, shipped, tmp_path):
    shutil.copytree(shipped, tmp_path, dirs_exist_ok=True)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def kill(line):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        publish(Publish(str(run), medium=16, expert=72, episodes=5, most=5, out=str(tmp_path)), kill)
    assert {path: path.read_bytes() for path in before} == before
    assert [path.name for path in tmp_path.glob("*.json")] == ["hopper.json"]


@pytest.mark.slow
def test_snapshots_alone_are_shipped_where_no_logs_are_made_with_them(run, tmp_path):
    path = publish(Publish(str(run), episodes=2, most=2, out=str(tmp_path)))
    about = json.loads(path.read_text())
    assert list(about["policies"]) == [f"snapshot-{i:02d}" for i in range(11)]
    assert len(list((tmp_path / "hopper").glob("*.npz"))) == 11
    assert "medium_replay" not in about
    assert about["agent"] == "sac"


@pytest.mark.slow
def test_refusals(run, tmp_path):
    with pytest.raises(UserError, match="no policy was kept after 25 updates; those kept are"):
        publish(Publish(str(run), medium=25, expert=80, out=str(tmp_path)))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_runs_on_a_log_are_shipped_from_their_first_eleventh_on(tmp_path):
    from deadreckon.agents.bc import BC
    from deadreckon.collect import generate
    from deadreckon.runs.train import train

    log = generate("hopper-medium-v2", steps=300)
    train(BC(hidden=(8,), batch_size=16), log, steps=22, evaluate_every=2, episodes=1, out=tmp_path / "run")
    with pytest.raises(UserError, match="it has no medium-replay, leave medium out"):
        publish(Publish(str(tmp_path / "run"), medium=2, episodes=2, most=2, out=str(tmp_path / "library")))
    about = json.loads(publish(Publish(str(tmp_path / "run"), episodes=2, most=2, out=str(tmp_path / "library"))).read_text())
    assert [each["updates"] for each in about["policies"].values()] == [*range(2, 23, 2)]
    assert {each["environment_steps"] for each in about["policies"].values()} == {0}
    assert about["run"]["data"]["name"] == log.name


@pytest.mark.slow
def test_policies_of_several_runs_keep_what_they_have_learned_from(tmp_path):
    from deadreckon.agents.bc import BC
    from deadreckon.collect import generate
    from deadreckon.runs.train import train

    logs = [generate("hopper-random-v2", steps=400, seed=seed) for seed in (0, 1)]
    small = {"steps": 4, "evaluate_every": 2, "episodes": 1, "holdout": 0.3}
    folders = {name: tmp_path / name for name in ("clone", "wide", "other")}
    train(BC(hidden=(8,), batch_size=16), logs[0], seeds=2, out=folders["clone"], **small)
    train(BC(hidden=(9,), batch_size=16), logs[0], seeds=1, out=folders["wide"], **small)
    train(BC(hidden=(8,), batch_size=16), logs[1], seeds=1, out=folders["other"], **small)
    options = Shipping(episodes=2, most=2, out=str(tmp_path / "library"))
    told = []
    path = publish_runs({name: folders[name] for name in ("clone", "wide")}, (2, 4), options, told.append)
    about = json.loads(path.read_text())
    names = ["clone-0-2", "clone-1-2", "clone-0-4", "clone-1-4", "wide-0-2", "wide-0-4"]
    assert list(about["policies"]) == names
    assert len(told) == 1 + len(names)
    assert {"sampled", "updates", "environment_steps"} == set(about["policies"]["wide-0-4"])
    assert about["run"]["runs"]["wide"]["agent"]["fields"]["hidden"] == [9]
    kept = store.load_all(tmp_path / "library" / "hopper" / "wide-0-4.npz").taught
    np.testing.assert_array_equal(kept, store.load_all(folders["wide"] / "policies" / "seed0.npz").taught)
    assert 0 < len(kept) < logs[0].episodes
    # Measured once: the same command has nothing to do.
    told.clear()
    publish_runs({name: folders[name] for name in ("clone", "wide")}, (2, 4), options, told.append)
    assert not told
    with pytest.raises(UserError, match="runs on one log are needed, these are on 2"):
        publish_runs({name: folders[name] for name in ("clone", "other")}, (2, 4), options)
    train(BC(hidden=(8,), batch_size=16), logs[0], out=tmp_path / "all", **small | {"holdout": 0.5})
    with pytest.raises(UserError, match="the runs have different training episodes of their log"):
        publish_runs({"clone": folders["clone"], "all": tmp_path / "all"}, (2, 4), options)
    with pytest.raises(UserError, match="no policy was kept after 3 updates; those kept are"):
        publish_runs({"clone": folders["clone"]}, (3,), options)
