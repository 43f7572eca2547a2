"""Runs on logs without a simulator learn from a part of them, say which, and never look at the rest."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.cli.train import columns_of, summary
from deadreckon.collect import generate
from deadreckon.data.formats.folder import write_folder
from deadreckon.data.spec import Box
from deadreckon.data.split import Fold, Holdout
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.policies import store
from deadreckon.runs.seen import seen, unseen_by

BC = dr.agents.BC(hidden=(8,), batch_size=8)
TD3BC = dr.agents.TD3BC(hidden=(8,), batch_size=8)  # standardises what it sees
OPTIONS = {"steps": 4, "chunk": 2, "evaluate_every": 4}
X = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)


def make(episodes=20, spoilt=(), seed=0):
    """Episodes of three steps, two a user; those that are spoilt hold very large numbers."""
    rng = np.random.default_rng(seed)
    rows = 3 * episodes
    scale = np.where(np.isin(np.arange(episodes), spoilt), 1000.0, 1.0).repeat(3)
    return dr.Dataset.from_arrays(
        observations=rng.normal(size=(rows, 3)) * scale[:, None], actions=rng.uniform(-1, 1, (rows, 2)),
        rewards=rng.normal(size=rows) * scale, terminals=np.arange(rows) % 3 == 2, action_space=Box((-1, -1), (1, 1)),
        user=np.arange(rows) // 6, name="mine",
    )  # fmt: skip


def train(log, out, agent=BC, **change):
    return dr.train(agent, log, out=out, **(OPTIONS | change))


@pytest.fixture(scope="module")
def log():
    return make()


@pytest.fixture(scope="module")
def run(log, tmp_path_factory):
    return train(log, tmp_path_factory.mktemp("runs") / "r", seeds=2)


@pytest.mark.slow
def test_a_fifth_is_held_out_where_nothing_else_judges(run, log):
    parts = Holdout().parts(log)
    assert run.config["data"]["holdout"] == {"share": 0.2, "by": "random", "seed": 0, "learning": 16, "held": 4}
    assert run.config["data"]["episodes"] == 20
    assert run.config["data"]["fingerprint"] == log.fingerprint
    np.testing.assert_array_equal(run.taught, log.episode_ids[parts.learning])
    np.testing.assert_array_equal(run.held, log.episode_ids[parts.held])
    assert run.held.dtype == run.taught.dtype == np.uint64
    kept = sorted((run.path / "policies").iterdir())
    assert len(kept) == 4
    for path in kept:
        np.testing.assert_array_equal(store.load_all(path).taught, run.taught)
    assert "trained on 16 of 20 episodes; 4 are held out for `deadreckon ope`" in summary(run)


@pytest.mark.slow
@pytest.mark.parametrize("by", ["time", "user"])
def test_what_is_held_out_changes_nothing(by, tmp_path):
    held = Holdout(0.2, by).parts(make()).held
    assert len(held) == 4
    plain, spoilt = (train(make(spoilt=s), tmp_path / str(len(s)), TD3BC, holdout=Holdout(0.2, by)) for s in ((), held))
    np.testing.assert_array_equal(plain.policy(X), spoilt.policy(X))
    np.testing.assert_array_equal(plain.policy.mean, spoilt.policy.mean)
    assert plain.metrics.equals(spoilt.metrics)
    assert plain.evaluations.equals(spoilt.evaluations)  # distance to the log and share beyond its range
    assert plain.config["data"]["fingerprint"] != spoilt.config["data"]["fingerprint"]


def test_what_was_seen_is_known_in_any_part_of_the_log(run, log):
    known = seen(run.taught, log)
    np.testing.assert_array_equal(np.flatnonzero(known), Holdout().parts(log).learning)
    assert seen(run.taught, log.select([3, 1, 7])).tolist() == known[[3, 1, 7]].tolist()
    assert not seen(run.taught, make(seed=1)).any()
    ids = log.episode_ids
    unseen = unseen_by([ids[:5], None, ids[3:8], ids[3:8], ids[:0]], log)
    assert np.flatnonzero(~unseen).tolist() == list(range(8))
    assert unseen_by([None], log).all()


@pytest.mark.slow
def test_nothing_is_held_out_where_a_simulator_judges_or_nobody_wants_it(log, tmp_path):
    known = generate("maze2d-umaze-v1", steps=1500, seed=0)
    judged = train(known, tmp_path / "judged", episodes=1)
    assert judged.config["data"]["holdout"] is None
    np.testing.assert_array_equal(judged.taught, known.episode_ids)
    assert len(judged.held) == 0
    asked = train(known, tmp_path / "asked", episodes=1, holdout=0.5)
    assert asked.config["task"] == "maze2d-umaze"
    assert len(asked.held) == known.episodes - len(asked.taught) == round(0.5 * known.episodes)
    whole = train(log, tmp_path / "whole", holdout=0)
    np.testing.assert_array_equal(whole.taught, log.episode_ids)
    assert "trained on all 20 episodes, none is held out" in summary(whole)


def test_a_run_that_is_gone_on_with_keeps_what_it_held_out(run, log, tmp_path):
    again = train(log, run.path, seeds=2, resume=True)
    assert again.metrics.equals(run.metrics)
    with pytest.raises(UserError, match=r"holds another run: data.holdout.share was 0.2, now 0.5"):
        train(log, run.path, seeds=2, resume=True, holdout=0.5)
    with pytest.raises(UserError, match=r"data.holdout was \{.*\}, now None"):
        train(log, run.path, seeds=2, resume=True, holdout=0)
    # Of another kind, without asking again.
    half = train(log, tmp_path / "half", holdout=Holdout(0.2, "user", 3))  # as many as before: the same program
    (half.path / "episodes.npz").unlink()  # killed just before it was written
    longer = train(log, half.path, resume=True, steps=6)
    assert longer.config["data"]["holdout"] == half.config["data"]["holdout"]
    np.testing.assert_array_equal(longer.held, log.episode_ids[Holdout(0.2, "user", 3).parts(log).held])
    np.testing.assert_array_equal(longer.held, log.episode_ids[np.isin(log.episode_ids, half.taught, invert=True)])
    np.testing.assert_array_equal(store.load_all(longer.path / "policies" / "seed0.npz").taught, longer.taught)
    fold = train(log, tmp_path / "fold", holdout=Fold(1, 5, "time"))
    assert train(log, fold.path, resume=True, steps=6).config["data"]["holdout"]["fold"] == 1


@pytest.mark.slow
def test_a_run_from_before_goes_on_with_all_episodes(log, tmp_path):
    whole = train(log, tmp_path / "whole", holdout=0, steps=6)
    old = train(log, tmp_path / "old", holdout=0).path
    (old / "episodes.npz").unlink()
    config = read_json(old / "run.json")
    del config["data"]["holdout"]
    write_json(old / "run.json", config)
    for path in (old / "policies").iterdir():
        store.save(path, store.load(path), store.meta(path))
    assert dr.load_run(old).taught is None
    assert dr.load_run(old).held is None
    assert store.load_all(old / "policies" / "seed0.npz").taught is None
    with pytest.raises(UserError, match="holds another run: data"):
        train(log, old, resume=True, holdout=0.2, steps=6)
    again = train(log, old, resume=True, steps=6)
    np.testing.assert_array_equal(again.policy(X), whole.policy(X))
    np.testing.assert_array_equal(again.taught, log.episode_ids)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("few", "holdout", "words"),
    [(make(9), None, "mine: 9 episodes are too few"), (make(18), Holdout(by="user"), "mine: 9 values of user are too few")],
)
def test_of_very_few_episodes_none_is_held_out(few, holdout, words, tmp_path):
    with pytest.warns(UserWarning, match=words) as told:
        run = train(few, tmp_path / "r", holdout=holdout)
    assert told[0].filename == __file__
    assert run.config["data"]["holdout"] is None
    assert len(run.taught) == few.episodes


def test_what_cannot_be_held_out_is_told_before_anything_is_written(log, tmp_path):
    for holdout, words in ((1.5, "between 0 and 1, got 1.5"), (-1, "got -1"), (Holdout(by="usr"), "did you mean user")):
        with pytest.raises(UserError, match=words):
            train(log, tmp_path / "no", holdout=holdout)
    assert not (tmp_path / "no").exists()


def test_of_a_memory_mapped_log_the_latest_are_held_out_and_nothing_is_copied(log, tmp_path):
    write_folder(log, tmp_path / "log")
    run = train(dr.read(tmp_path / "log", mmap=True), tmp_path / "r")
    assert run.config["data"]["holdout"]["by"] == "time"
    np.testing.assert_array_equal(run.held, log.episode_ids[-4:])


@pytest.mark.slow
def test_runs_that_share_a_program_hold_the_same_out(log, tmp_path):
    agents = {name: dr.agents.BC(hidden=(8,), batch_size=8, lr=lr) for name, lr in (("a", 1e-3), ("b", 1e-2))}
    runs = dr.train_together(agents, log, out=tmp_path / "all", holdout=Holdout(0.5), **OPTIONS)
    for run in runs.values():
        np.testing.assert_array_equal(run.held, log.episode_ids[Holdout(0.5).parts(log).held])
        np.testing.assert_array_equal(store.load_all(run.path / "policies" / "seed0.npz").taught, run.taught)


@pytest.mark.slow
def test_the_command_holds_out_whole_users_and_does_not_observe_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    rows = [f"u{i // 4},{rng.normal():.3f},{i % 2},{rng.normal():.3f}" for i in range(80)]
    (tmp_path / "log.csv").write_text("\n".join(["user,x,arm,click", *rows]) + "\n")
    columns = ["--data", "log.csv", "--action", "arm", "--reward", "click"]
    options = ["--steps", "2", "--agent.hidden", "8", "--agent.batch-size", "8"]
    given = ["train", "--agent", "bc", *columns, *options]
    assert main([*given, "--holdout-by", "user", "--holdout", "0.3", "--out", "run"]) == 0
    assert "trained on 56 of 80 episodes; 24 are held out" in capsys.readouterr().out
    run = dr.load_run("run")
    assert run.config["data"]["holdout"] == {"share": 0.3, "by": "user", "seed": 0, "learning": 56, "held": 24}
    assert run.policy.inner.net.weights[0].shape[0] == 1
    log = dr.read("log.csv", action="arm", reward="click", keep="user")
    unseen = ~seen(run.taught, log)
    assert unseen.sum() == 24
    assert len(set(log.extras["user"][unseen])) == 6
    assert main([*given, "--holdout-by", "time", "--ignore", "user", "--out", "late"]) == 0
    assert "trained on 64 of 80 episodes; 16" in capsys.readouterr().out
    np.testing.assert_array_equal(seen(dr.load_run("late").taught, log), np.arange(80) < 64)
    assert main([*given, "--holdout", "0", "--ignore", "user", "--out", "all"]) == 0
    assert "trained on all 80 episodes, none is held out" in capsys.readouterr().out
    assert main([*given, "--holdout-by", "usr", "--out", "no"]) == 2
    assert "unknown column 'usr': did you mean user?" in capsys.readouterr().err


def test_copies_of_a_run_keep_what_they_know(run, log, tmp_path):
    shutil.copytree(run.path, tmp_path / "moved")
    renamed = replace(log, name="other")
    assert seen(dr.load_run(tmp_path / "moved").taught, renamed).sum() == 16


def test_a_schema_says_itself_which_column_is_kept():
    assert columns_of(SimpleNamespace(schema="log.toml"), "user") == {"schema": "log.toml"}
    assert columns_of(SimpleNamespace(action=("arm",)), "user") == {"action": ("arm",), "keep": ("user",)}
