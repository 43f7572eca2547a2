"""Cross-fitting: each fold's policies have not seen it, the policy to deploy, and resuming after a kill."""

import dataclasses
import json

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.cli.ope import use
from deadreckon.collect import generate
from deadreckon.data.spec import Box
from deadreckon.data.split import folds
from deadreckon.errors import DivergedError, UserError
from deadreckon.files import read_json
from deadreckon.policies import portable, store
from deadreckon.policies.deployed import Mixture
from deadreckon.runs import crossfit
from deadreckon.runs.gather import for_case, gather
from deadreckon.runs.player import chosen
from deadreckon.runs.subject import subject
from deadreckon.runs.train import train
from deadreckon.training.fit import Failure

BC = dr.agents.BC(hidden=(8,), batch_size=8)
OPTIONS = {"folds": 3, "steps": 4, "chunk": 2, "evaluate_every": 4}
X = np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def log():
    rng, rows = np.random.default_rng(0), 36
    return dr.Dataset.from_arrays(
        observations=rng.normal(size=(rows, 3)), actions=rng.uniform(-1, 1, (rows, 2)), rewards=rng.normal(size=rows),
        terminals=np.arange(rows) % 3 == 2, action_space=Box((-1, -1), (1, 1)), user=np.arange(rows) // 6, name="mine",
    )  # fmt: skip


@pytest.fixture(scope="module")
def fitted(log, tmp_path_factory):
    return dr.cross_fit(BC, log, out=tmp_path_factory.mktemp("runs") / "c", **OPTIONS)


@pytest.mark.slow
def test_every_episode_is_held_out_once(fitted, log):
    fold = folds(log, 3)
    np.testing.assert_array_equal(fitted.fold_of(log), fold)
    np.testing.assert_array_equal(fitted.fold_of(log.select([5, 2])), fold[[5, 2]])
    assert (fitted.fold_of(log.select([0, 1])) >= 0).all()
    for k, run in enumerate(fitted.runs):
        assert run.path == fitted.path / f"fold{k}"
        np.testing.assert_array_equal(run.held, log.episode_ids[fold == k])
        np.testing.assert_array_equal(run.taught, log.episode_ids[fold != k])
        assert run.config["data"]["holdout"]["fold"] == k
    assert fitted.config["episodes"] == [4, 4, 4]
    strange = dr.Dataset.from_arrays(observations=X, actions=np.zeros((60, 2)), rewards=np.zeros(60), terminals=np.ones(60))
    assert (fitted.fold_of(strange) == -1).all()
    assert "3 folds of up to 4 of 12 episodes, each held out once" in str(fitted)


@pytest.mark.slow
def test_the_mixture_is_of_all_folds_and_has_seen_everything(fitted, log):
    assert isinstance(fitted.policy.inner, Mixture)
    acts = fitted.policy(X)
    fits = np.array([np.isclose(acts, run.policy(X), atol=1e-6).all(1) for run in fitted.runs])
    assert fits.any(0).all()
    assert fits.sum(1).min() > 5
    np.testing.assert_array_equal(np.sort(store.load_all(fitted.policy_path).taught), np.sort(log.episode_ids))
    assert fitted.config["members"] == [[0, 0], [1, 0], [2, 0]]
    again = dr.load_cross_fit(fitted.path)
    assert again.config == fitted.config == read_json(fitted.path / "crossfit.json")
    np.testing.assert_array_equal(again.policy(X), acts)


@pytest.mark.slow
def test_killed_and_gone_on_with_no_fold_is_done_again(fitted, log, tmp_path):
    class Killed(Exception):
        pass

    def watch(progress, steps):
        done.append(progress.step)
        if len(done) == 3:  # in the second fold
            raise Killed

    done = []
    with pytest.raises(Killed):
        dr.cross_fit(BC, log, out=tmp_path / "c", watch=watch, **OPTIONS)
    with pytest.raises(UserError, match="is not finished; .*--cross-fit 3"):
        dr.load_cross_fit(tmp_path / "c")
    with pytest.raises(UserError, match="holds a cross-fit already"):
        dr.cross_fit(BC, log, out=tmp_path / "c", **OPTIONS)
    for change, words in (
        ({"folds": 4}, "folds was 3, now 4"), ({"by": "user"}, "by was random, now user"), ({"seed": 1}, "seed was 0, now 1"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=f"holds another cross-fit: {words}"):
            dr.cross_fit(BC, log, out=tmp_path / "c", resume=True, **(OPTIONS | change))
    first = (tmp_path / "c" / "fold0" / "policies" / "seed0.npz").stat().st_mtime_ns
    steps = []
    again = dr.cross_fit(BC, log, out=tmp_path / "c", resume=True, watch=lambda p, n: steps.append(p.step), **OPTIONS)
    assert steps == [2, 4, 2, 4]  # the second fold was killed before its first checkpoint
    assert (tmp_path / "c" / "fold0" / "policies" / "seed0.npz").stat().st_mtime_ns == first
    for ours, whole in zip(again.runs, fitted.runs):
        np.testing.assert_array_equal(ours.policy(X), whole.policy(X))
    np.testing.assert_array_equal(again.policy(X), fitted.policy(X))


@pytest.mark.slow
def test_the_policy_to_deploy_may_have_learned_from_everything(log, tmp_path):
    found = dr.cross_fit(BC, log, out=tmp_path / "c", by="user", deliver="refit", **OPTIONS)
    assert found.policy_path == tmp_path / "c" / "refit"
    refit = dr.load_run(found.policy_path)
    np.testing.assert_array_equal(refit.taught, log.episode_ids)
    alone = dr.train(BC, log, out=tmp_path / "alone", holdout=0, **{k: v for k, v in OPTIONS.items() if k != "folds"})
    np.testing.assert_array_equal(found.policy(X), alone.policy(X))
    users = log.extras["user"][log.starts]
    fold = found.fold_of(log)
    assert all(len(set(fold[users == user])) == 1 for user in users)
    assert dr.load_cross_fit(found.path).policy_path == found.policy_path
    assert chosen(found.path).file == subject(found.path).file == found.policy_path / "policies" / "seed0.npz"
    other = dr.cross_fit(BC, log, out=tmp_path / "c", by="user", resume=True, **OPTIONS)
    assert isinstance(other.policy.inner, Mixture)


def test_parts_of_unequal_lengths_are_not_finished(log, tmp_path, monkeypatch):
    """As a cross-fit is whose training for longer was interrupted before its last run."""
    options = OPTIONS | {"folds": 2, "deliver": "refit"}
    dr.cross_fit(BC, log, out=tmp_path / "c", **options)
    assert len(dr.load_cross_fit(tmp_path / "c").runs) == 2

    class Killed(Exception):
        pass

    for part in ("fold1", "refit"):

        def killed(*given, out, part=part, train=train, **more):
            if out.name == part:
                raise Killed
            return train(*given, out=out, **more)

        monkeypatch.setattr(crossfit, "train", killed)
        with pytest.raises(Killed):
            dr.cross_fit(BC, log, out=tmp_path / "c", resume=True, **options | {"steps": 2 * OPTIONS["steps"]})
        with pytest.raises(UserError, match=r"c is not finished; .*--cross-fit 2 --out .*c --resume"):
            dr.load_cross_fit(tmp_path / "c")
    monkeypatch.setattr(crossfit, "train", train)
    dr.cross_fit(BC, log, out=tmp_path / "c", resume=True, **options | {"steps": 2 * OPTIONS["steps"]})
    assert len(dr.load_cross_fit(tmp_path / "c").runs) == 2


@pytest.mark.slow
def test_a_failed_seed_is_left_out_and_a_failed_fold_is_told(log, tmp_path):
    bad = dr.agents.BC(hidden=(8,), batch_size=8, lr=1e38)
    found = dr.cross_fit([BC, bad], log, out=tmp_path / "one", seeds=2, **OPTIONS)
    assert [run.failures[1] is None for run in found.runs] == [False] * 3
    assert found.config["members"] == [[0, 0], [1, 0], [2, 0]]
    with pytest.raises(DivergedError, match="fold0 failed: .* was not finite at update"):
        dr.cross_fit(bad, log, out=tmp_path / "all", **OPTIONS)


@pytest.mark.slow
def test_as_many_policies_of_each_fold_are_mixed(log, tmp_path, monkeypatch):
    def fails(agent, data, **options):
        run = train(agent, data, **options)
        if run.path.name == "fold1":
            run.failures[0] = Failure("loss", 1)
        return run

    monkeypatch.setattr(crossfit, "train", fails)
    found = dr.cross_fit(BC, log, out=tmp_path / "c", seeds=2, **OPTIONS)
    assert found.config["members"] == [[0, 0], [1, 1], [2, 0]]
    np.testing.assert_array_equal(found.policy.inner.members[1](X), found.runs[1].policies[1](X))
    assert chosen(found.path).file == subject(found.path).file == found.policy_path  # `predict` and `export` use the same one


def test_what_does_not_fit_is_told_before_anything_is_written(log, tmp_path):
    for change, words in (
        ({"folds": 1}, "at least 2 folds"), ({"folds": 13}, "12 episodes, at least 13"), ({"by": "usr"}, "did you mean user"),
        ({"deliver": "mean"}, "unknown delivery 'mean'"), ({"stepz": 4}, "unknown setting 'stepz'"),
        ({"steps": 0}, "steps must be >= 1, got 0"), ({"seed": -1}, "seed must be from 0 to"),
        ({"holdout": 0.2}, "holds every fold out in turn: leave holdout out, got 0.2"),
        ({"task": "maze2d-umaz"}, "unknown task"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=words):
            dr.cross_fit(BC, log, out=tmp_path / "no", **(OPTIONS | change))
    assert not (tmp_path / "no").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("x")
    with pytest.raises(UserError, match="is not a cross-fit"):
        dr.cross_fit(BC, log, out=tmp_path / "mine", **OPTIONS)
    with pytest.raises(UserError, match="holds no cross-fit"):
        dr.load_cross_fit(tmp_path / "mine")


def test_what_is_refused_leaves_the_finished_mixture(log, tmp_path):
    found = dr.cross_fit(BC, log, out=tmp_path / "c", folds=2, steps=2, chunk=2, evaluate_every=2)
    before = {path: path.read_bytes() for path in (found.policy_path, found.path / "crossfit.json")}
    other = dr.agents.BC(hidden=(8,), batch_size=8, lr=0.5)
    with pytest.raises(UserError, match="fold0 holds another run: .*lr"):
        dr.cross_fit(other, log, out=found.path, folds=2, steps=2, chunk=2, evaluate_every=2, resume=True)
    assert {path: path.read_bytes() for path in before} == before
    dr.load_cross_fit(found.path)


def test_the_command(log, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rows = [f"u{i // 4},{np.sin(i):.3f},{i % 2},{np.cos(i):.3f}" for i in range(40)]
    (tmp_path / "log.csv").write_text("\n".join(["user,x,arm,click", *rows]) + "\n")
    given = ["train", "--agent", "bc", "--data", "log.csv", "--action", "arm", "--reward", "click", "--steps", "2",
             "--agent.hidden", "8", "--agent.batch-size", "8", "--out", "c", "--cross-fit", "2"]  # fmt: skip
    assert main([*given, "--holdout", "0.2"]) == 2
    assert "leave --holdout out" in capsys.readouterr().err
    assert main([*given, "--holdout-by", "user"]) == 0
    shown = capsys.readouterr().out
    assert "2 folds of up to 20 of 40 episodes, each held out once" in shown
    assert "policy: c/mixture.npz" in shown
    found = dr.load_cross_fit("c")
    log = dr.read("log.csv", action="arm", reward="click", keep="user")
    fold = found.fold_of(log)
    assert np.bincount(fold).tolist() == [20, 20]
    assert (fold.reshape(10, 4) == fold[::4, None]).all()


@pytest.mark.slow
def test_each_episode_of_a_mixture_is_one_of_its_members(tmp_path):
    known = generate("maze2d-umaze-v1", steps=1800, seed=0)  # six episodes: all folds learn in the same program
    found = dr.cross_fit(BC, known, out=tmp_path / "c", episodes=1, **OPTIONS)
    assert found.runs[0].config["task"] == "maze2d-umaze"
    alone = np.array([dr.evaluate(run.policy, "maze2d-umaze-dense", episodes=8).returns[0] for run in found.runs])
    mixed = dr.evaluate(found.policy_path, "maze2d-umaze-dense", episodes=8).returns[0]
    near = np.isclose(alone, mixed, rtol=1e-4)
    assert near.any(0).all()
    assert near.any(1).sum() > 1


@pytest.mark.slow
@pytest.mark.parametrize(("deliver", "seeds"), [("mixture", 1), ("mixture", 2), ("refit", 2)])
def test_what_is_judged_of_a_seed_is_what_is_deployed_of_it(log, tmp_path, deliver, seeds):
    found = dr.cross_fit(BC, log, out=tmp_path / "c", deliver=deliver, seeds=seeds, **OPTIONS)
    given = gather(found)
    assert [each.seed for each in given] == list(range(seeds))
    elsewhere = log.select([0])
    for each in given:
        own = found.policy_of(each.seed)
        state = json.loads(json.dumps({"file": None if each.file is None else str(each.file), "run": "c", "seed": each.seed}))
        said = use(state, [str(found.path)], True)
        if each.file is None:
            assert said == f"deadreckon.load_cross_fit({str(found.path)!r}).policy_of({each.seed})"
            members = [run.policies[each.seed] for run in found.runs]
            for member, expected in zip(own.inner.members, members, strict=True):
                np.testing.assert_array_equal(member(X), expected(X))
            continue
        play = portable.load(each.file)
        assert ("first" in said) == (deliver == "mixture")
        acts = play(X[0], first=True) if deliver == "mixture" else play(X[0])
        possible = own.inner.members if deliver == "mixture" else [own]
        assert any(np.allclose(acts, member(X[0]), atol=1e-5) for member in possible)
    new = dataclasses.replace(elsewhere, rewards=elsewhere.rewards + 1.0, part_of=None)
    judged = for_case(given[-1], new)  # on another log each episode has one of the mixture's members, which has a memory
    if deliver == "refit":
        np.testing.assert_array_equal(judged(X), found.policy_of(seeds - 1)(X))
        return
    for member, expected in zip(judged.policies, found.policy_of(seeds - 1).inner.members, strict=True):
        np.testing.assert_array_equal(member(X), expected(X))
