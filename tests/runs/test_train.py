"""From a log to a judged run folder, and taking it up again."""


import numpy as np
import pytest
from scipy import stats

import deadreckon as dr
from deadreckon import temporaries
from deadreckon.collect import generate
from deadreckon.data.spec import Box
from deadreckon.files import read_json, write_json
from deadreckon.policies import BlackBoxPolicy
from deadreckon.runs.diagnostics import LogProbe, logged_value, mmd_of_copy, two_sample_mmd
from deadreckon.runs.evaluate import evaluate
from deadreckon.stats.crossed import mean_interval
from deadreckon.tasks import task
from deadreckon.tasks.task import Task
from deadreckon.temporaries import SUFFIX
from tests.agents.worlds import corridor, swinging


@pytest.fixture(scope="module")
def log():
    return generate("maze2d-umaze-v1", steps=2000, seed=0)


def agent(**fields):
    return dr.agents.TD3BC(hidden=(16, 16), batch_size=32, **fields)


SETTINGS = {"steps": 60, "seeds": 2, "chunk": 20, "evaluate_every": 30, "episodes": 3}


@pytest.fixture(scope="module")
def run(log, tmp_path_factory):
    return dr.train(agent(), log, out=tmp_path_factory.mktemp("runs") / "whole", **SETTINGS)


@pytest.mark.slow
def test_run_folder_holds_what_was_asked_and_what_came_out(run, log):
    config = run.config
    assert config["agent"]["name"] == "td3_bc"
    assert config["agent"]["fields"]["hidden"] == [16, 16]
    assert config["data"]["fingerprint"] == log.fingerprint
    assert config["task"] == "maze2d-umaze"  # a known log knows its task
    assert config["versions"]["lanes"] == 2
    assert read_json(run.path / "status.json") == {"step": 60, "steps": 60, "finished": True, "failures": [None, None]}
    metrics = run.metrics.to_pydict()
    assert metrics["step"] == [20, 20, 30, 30, 50, 50, 60, 60]  # evaluations end a chunk
    evaluations = run.evaluations.to_pydict()
    assert len(evaluations["return"]) == 2 * 2 * 3
    assert np.isfinite(evaluations["estimated_value"]).all()
    scores = task("maze2d-umaze").reference.normalise(np.asarray(evaluations["return"]))
    np.testing.assert_allclose(evaluations["score"], scores)
    with np.load(run.path / "evaluations" / "trajectories.npz") as file:
        assert file["trajectories"].shape == (2, 3, 300, 4)


@pytest.mark.slow
def test_the_last_evaluation_is_that_of_the_last_policies(run):
    again = evaluate(run, "maze2d-umaze", episodes=3)
    last = run.evaluations.to_pydict()
    np.testing.assert_allclose(np.ravel(again.returns), last["return"][-6:])


@pytest.mark.slow
def test_interrupted_and_resumed_is_the_same_as_unbroken(run, log, tmp_path, monkeypatch):
    class Stop(Exception):
        pass

    def watch(progress, steps):
        if progress.step == 50:
            raise Stop

    with pytest.raises(Stop):
        dr.train(agent(), log, out=tmp_path / "r", watch=watch, **SETTINGS)
    with pytest.raises(dr.UserError, match="holds a run already"):
        dr.train(agent(), log, out=tmp_path / "r", **SETTINGS)
    with pytest.raises(dr.UserError, match="not finished"):
        dr.load_run(tmp_path / "r")
    (tmp_path / "r" / "metrics" / f".0000000050.parquet.x{SUFFIX}").write_text("left by a kill")
    monkeypatch.setattr(temporaries, "_cleared", set())  # as in another process
    resumed = dr.train(agent(), log, out=tmp_path / "r", resume=True, **SETTINGS)
    assert resumed.metrics.equals(run.metrics)
    assert resumed.evaluations.equals(run.evaluations)
    x = np.zeros((5, 4), np.float32)
    for a, b in zip(resumed.policies, run.policies, strict=True):
        np.testing.assert_array_equal(a(x), b(x))
    assert not list((tmp_path / "r").rglob("*.tmp"))


def test_a_finished_run_is_given_back_and_another_is_refused(run, log):
    again = dr.train(agent(), log, out=run.path, resume=True, **SETTINGS)
    assert again.metrics.equals(run.metrics)
    with pytest.raises(dr.UserError, match=r"holds another run: agent.fields.alpha was 2.5, now 3.0"):
        dr.train(agent(alpha=3.0), log, out=run.path, resume=True, **SETTINGS)


@pytest.mark.slow
def test_a_finished_run_made_longer_equals_one_that_was_long_from_the_beginning(run, log, tmp_path):
    import shutil

    shutil.copytree(run.path, tmp_path / "r")
    more = SETTINGS | {"steps": SETTINGS["steps"] + 20}
    period = run.config["evaluation"]["every"]
    long = dr.train(agent(), log, out=tmp_path / "long", **more | {"evaluate_every": period})
    again = dr.train(agent(), log, out=tmp_path / "r", resume=True, **{k: v for k, v in more.items() if k != "evaluate_every"})
    assert again.config["steps"] == more["steps"]
    assert again.metrics.equals(long.metrics)
    x = np.zeros((5, 4), np.float32)
    for a, b in zip(again.policies, long.policies, strict=True):
        np.testing.assert_array_equal(a(x), b(x))
    # What was judged stays, and only the new end is new.
    old = again.evaluations.filter(np.asarray(again.evaluations["step"]) <= SETTINGS["steps"])
    assert old.equals(run.evaluations)
    with pytest.raises(dr.UserError, match="holds another run: steps was"):
        dr.train(agent(), log, out=tmp_path / "r", resume=True, **SETTINGS)


def test_a_period_beyond_the_end_is_the_same_in_a_run_made_longer(tmp_path):
    settings = {"out": tmp_path / "r", "chunk": 4, "evaluate_every": 1000, "holdout": 0}
    little = dr.agents.BC(hidden=(8,), batch_size=16)
    dr.train(little, corridor(100), steps=4, **settings)
    longer = dr.train(little, corridor(100), steps=8, resume=True, **settings)
    assert longer.config["evaluation"]["every"] == longer.config["steps"] == 8
    assert longer.evaluations["step"].to_pylist() == [4, 8]
    with pytest.raises(dr.UserError, match="holds another run: evaluation.every was 8, now 2"):
        dr.train(little, corridor(100), steps=16, resume=True, **settings | {"evaluate_every": 2})


def test_a_run_that_a_callback_ends_by_its_evaluations_keeps_trajectories_too(tmp_path):
    little, log = dr.agents.BC(hidden=(8,), batch_size=16), swinging()
    settings = {"task": "inverted-pendulum", "evaluate_every": 4, "chunk": 4, "episodes": 2}
    planned = dr.train(little, log, steps=4, out=tmp_path / "planned", **settings)
    seen = lambda progress: progress.evaluations.num_rows > 0  # noqa: E731
    ended = dr.train(little, log, steps=8, out=tmp_path / "ended", callback=seen, **settings)
    assert ended.config["steps"] == 4
    assert ended.evaluations.equals(planned.evaluations)
    kept = [np.load(run.path / "evaluations" / "trajectories.npz")["trajectories"] for run in (planned, ended)]
    np.testing.assert_array_equal(*kept)


@pytest.mark.parametrize(("asked", "words"), [({"encoder": "drq"}, "encoder"), ({"shift": 2}, "shift")])
def test_a_log_without_pictures_takes_nothing_that_sees(asked, words, log, tmp_path):
    with pytest.raises(dr.UserError, match=f"has no images: leave {words} out"):
        dr.train(agent(), log, out=tmp_path / "r", **SETTINGS, **asked)
    assert not (tmp_path / "r").exists()


def test_other_versions_are_told_on_resume(run, log, tmp_path):
    import shutil

    shutil.copytree(run.path, tmp_path / "r")
    config = read_json(tmp_path / "r" / "run.json")
    config["versions"]["jax"] = "0.0.1"
    write_json(tmp_path / "r" / "run.json", config)
    with pytest.warns(UserWarning, match=r"versions.jax was 0.0.1"):
        dr.train(agent(), log, out=tmp_path / "r", resume=True, **SETTINGS)


def test_a_run_of_code_that_learns_otherwise_is_not_gone_on_with(run, log, tmp_path):
    import shutil

    shutil.copytree(run.path, tmp_path / "r")
    config = read_json(tmp_path / "r" / "run.json")
    config["revisions"]["training"] -= 1
    write_json(tmp_path / "r" / "run.json", config)
    with pytest.raises(dr.UserError, match=r"started by code that trains differently: revisions.training was"):
        dr.train(agent(), log, out=tmp_path / "r", resume=True, **SETTINGS)


def test_a_run_that_notes_no_revisions_is_not_gone_on_with(run, log, tmp_path):
    """It was begun before they were noted, and its random streams are no longer ours."""
    import shutil

    shutil.copytree(run.path, tmp_path / "r")
    config = read_json(tmp_path / "r" / "run.json")
    del config["revisions"]
    write_json(tmp_path / "r" / "run.json", config)
    with pytest.raises(dr.UserError, match="was started by code of other revisions, which trains differently; start again"):
        dr.train(agent(), log, out=tmp_path / "r", resume=True, **SETTINGS)
    assert read_json(tmp_path / "r" / "run.json") == config


@pytest.mark.slow
def test_an_evaluation_lost_to_a_kill_is_done_again(run, log, tmp_path):
    import shutil

    shutil.copytree(run.path, tmp_path / "r")
    (tmp_path / "r" / "evaluations" / "0000000030.parquet").unlink()
    again = dr.train(agent(), log, out=tmp_path / "r", resume=True, **SETTINGS)
    assert again.evaluations.equals(run.evaluations)


@pytest.mark.slow
def test_a_failed_lane_keeps_its_last_good_policy(log, tmp_path):
    lanes = [agent(), agent(critic_lr=1e30)]
    run = dr.train(lanes, log, out=tmp_path / "r", **SETTINGS)
    assert run.failures[0] is None
    assert run.failures[1].step < 20
    assert np.isfinite(run.policies[1](np.zeros((3, 4), np.float32))).all()
    assert run.config["agent"]["fields"]["critic_lr"] == [3e-4, 1e30]


@pytest.mark.slow
def test_without_a_task_there_are_losses_and_distances(log, tmp_path):
    from dataclasses import replace

    run = dr.train("bc", replace(log, name="mine"), steps=4, out=tmp_path / "r", chunk=2)
    assert run.config["task"] is None
    assert "return" not in run.evaluations.column_names
    assert np.isfinite(run.evaluations["mmd_to_data"].to_numpy()).all()


def test_what_does_not_fit_is_told_before_anything_is_written(log, tmp_path):
    from dataclasses import replace

    cases = [
        ({"steps": 0}, "^steps must be >= 1, got 0$"),
        ({"task": "maze2d-umze"}, "did you mean maze2d-umaze"),
        ({"evaluate_every": 0}, "evaluate_every"),
    ]
    for change, words in cases:
        with pytest.raises(dr.UserError, match=words):
            dr.train(agent(), log, out=tmp_path / "no", **(SETTINGS | change))
    narrow = replace(log, observations=log.observations[:, :3], final_observations=log.final_observations[:, :3])
    with pytest.raises(dr.UserError, match=r"shows observations of shape \(4,\)"):
        dr.train(agent(), narrow, out=tmp_path / "no", task="maze2d-umaze", **SETTINGS)
    with pytest.raises(dr.UserError, match="one agent per seed"):
        dr.train([agent()], log, out=tmp_path / "no", **SETTINGS)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("mine")
    with pytest.raises(dr.UserError, match="is not a run"):
        dr.train(agent(), log, out=tmp_path / "other", **SETTINGS)
    assert not (tmp_path / "no").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("x/../../../RUN", "td3_bc-x-..-..-..-RUN"),
        ("/abs/x", "td3_bc--abs-x"),
        ("C:\\x", "td3_bc-C--x"),
        ("mujoco/hopper/medium-v0", "td3_bc-mujoco-hopper-medium-v0"),
        ("maze2d-umaze-v1@dr1", "td3_bc-maze2d-umaze-v1@dr1"),
        ("n" * 300, "td3_bc-" + "n" * 193),
    ],
)
def test_a_run_named_after_its_log_lies_in_runs_whatever_the_log_is_called(log, tmp_path, monkeypatch, name, folder):
    (tmp_path / "a" / "b").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "a" / "b")

    class Begun(Exception):
        pass

    def watch(progress, steps):
        raise Begun

    with pytest.raises(Begun):
        dr.train(agent(), log.select(range(3), name), watch=watch, **SETTINGS)
    assert [path.name for path in tmp_path.iterdir() if path.name != "home"] == ["a"]
    assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == ["runs"]
    assert [path.name for path in (tmp_path / "a" / "b" / "runs").iterdir()] == [folder]


@pytest.mark.slow
def test_a_kill_while_the_first_file_is_written_can_be_resumed(log, tmp_path):
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / f".run.json.abc{SUFFIX}").write_text("half")
    run = dr.train("bc", log, steps=2, episodes=1, out=tmp_path / "r", resume=True)
    assert not list(run.path.rglob("*.tmp"))


@pytest.mark.slow
def test_lanes_are_judged_by_their_own_settings(log, tmp_path):
    lanes = [agent(discount=0.5), agent(discount=0.99)]
    run = dr.train(lanes, log, out=tmp_path / "r", **(SETTINGS | {"steps": 2, "evaluate_every": 2}))
    own = [evaluate(p, "maze2d-umaze", episodes=3, discount=d).discounted for p, d in zip(run.policies, (0.5, 0.99))]
    np.testing.assert_allclose(run.evaluations["discounted_return"].to_numpy(), np.concatenate(own).ravel())


def test_a_policy_of_another_size_is_refused(run):
    from deadreckon.policies import EnvPolicy
    from deadreckon.policies.kinds import Deterministic

    narrow = EnvPolicy.of(Deterministic(run.policies[0].inner.net), run.policies[0].view)
    wide = evaluate(narrow, "maze2d-umaze", episodes=1)
    assert wide.returns.shape == (1, 1)
    from dataclasses import replace

    other = replace(task("maze2d-umaze"), observation_shape=(7,))
    with pytest.raises(dr.UserError, match=r"policy 0 does not take maze2d-umaze's observations of shape \(7,\)"):
        evaluate(narrow, other, episodes=1)
    with pytest.raises(dr.UserError, match="seed must be"):
        evaluate(narrow, "maze2d-umaze", episodes=1, seed=-1)


@pytest.mark.slow
def test_evaluation_of_a_policy_does_not_depend_on_its_neighbours(run):
    together = evaluate([run.policies[0], run.policies[1]], "maze2d-umaze", episodes=4)
    alone = evaluate(run.policies[1], "maze2d-umaze", episodes=4)
    np.testing.assert_allclose(together.returns[1], alone.returns[0])


def test_uniform_actions_score_about_zero_and_black_boxes_are_judged():
    uniform = BlackBoxPolicy(lambda obs, rng: rng.uniform(-1, 1, (len(obs), 2)))
    result = evaluate(uniform, "maze2d-umaze", episodes=60, record=2)
    assert abs(result.score().value) < 15
    assert result.returns.shape == (1, 60)
    assert result.trajectories.shape == (1, 2, 300, 4)
    assert "policy 0" in str(result)
    with pytest.raises(dr.UserError, match=r"takes actions of shape \(2,\)"):
        evaluate(BlackBoxPolicy(lambda obs, rng: np.zeros((len(obs), 3))), "maze2d-umaze", episodes=2)


def test_discounted_returns_and_lengths():
    still = BlackBoxPolicy(lambda obs, rng: np.zeros((len(obs), 2)))
    result = evaluate(still, "maze2d-umaze-dense", episodes=5, discount=0.5, record=5)
    goal = task("maze2d-umaze-dense").goal
    rewards = np.exp(-np.linalg.norm(result.trajectories[0, :, 1:, :2] - goal, axis=-1))
    np.testing.assert_allclose(result.discounted[0], (rewards * 0.5 ** np.arange(299)).sum(1), rtol=1e-4)
    assert (result.lengths == 300).all()


def test_nothing_counts_after_an_episodes_end():
    """Episodes of one, two and three steps, side by side, and a reward of one at every step, also after an end."""

    class Ends:
        def reset(self):
            self.steps = 0
            return np.zeros((3, 1), np.float32)

        def step(self, actions):
            self.steps += 1
            return np.zeros((3, 1), np.float32), np.ones(3), self.steps >= np.array([1, 2, 3]), np.zeros(3, bool)

    class EndsTask(Task):
        def simulate(self, seeds, threads=None):
            return Ends()

    ends = EndsTask("ends", "ends", 3, (1,), Box((-1.0,), (1.0,)), "", None)
    result = evaluate(BlackBoxPolicy(lambda obs, rng: np.zeros((len(obs), 1))), ends, episodes=3, discount=0.5)
    np.testing.assert_array_equal(result.returns, [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(result.discounted, [[1.0, 1.5, 1.75]])
    np.testing.assert_array_equal(result.lengths, [[1, 2, 3]])


def test_interval_of_a_mean_by_hand():
    """Two policies far apart say little of a third; one policy in one episode says nothing of its spread."""
    apart = mean_interval(np.array([[0.0] * 50, [10.0] * 50]))
    assert (apart.value, apart.high) == pytest.approx((5.0, 5.0 + 5.0 * 12.7062), rel=1e-4)
    alone = mean_interval(np.array([1.0, 2.0, 3.0]))
    assert (alone.value, alone.high) == pytest.approx((2.0, 2.0 + 4.302653 / 3**0.5), rel=1e-4)
    for few in ([[7.0]], [[7.0] * 10] * 3, [[7.0, 7.0 + 2e-15]]):  # the same values, such as no success at all, show no spread
        one = mean_interval(np.array(few))
        assert one.value == pytest.approx(7.0)
        assert np.isnan([one.low, one.high]).all()
        assert f"{one:.1f}" == "7.0"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policies", "episodes", "between", "starts"),
    [(2, 5, 3, 0), (2, 20, 1, 0), (2, 100, 0.3, 0), (3, 5, 0, 0), (3, 20, 1, 1), (3, 100, 0.3, 0), (3, 100, 0, 1),
     (5, 20, 0.3, 0), (5, 5, 0, 1), (10, 5, 0, 1), (10, 100, 0.3, 0.3)],
)  # fmt: skip
def test_interval_of_a_mean_covers(policies, episodes, between, starts):
    """Whether seeds, starts, both or neither differ, by normal deviations beside the rest's 1; 2,000 times each."""
    rng, hits, times = np.random.default_rng(0), 0, 2000
    for _ in range(times):
        rest = rng.normal(0, 1, (policies, episodes))
        found = mean_interval(rest + rng.normal(0, between, (policies, 1)) + rng.normal(0, starts, episodes))
        hits += found.low <= 0 <= found.high
    assert 0.935 <= hits / times <= 0.998  # a standard error is 0.005 at 0.95


def test_logged_value_of_whole_episodes_and_of_cut_ones(log):
    cut = logged_value(log, task("maze2d-umaze"))
    np.testing.assert_allclose(cut["mean"], log.rewards.mean() * 300, rtol=1e-6)
    returns, lengths = np.add.reduceat(np.asarray(log.rewards, float), log.starts), log.lengths
    left = 300 * (returns - log.rewards.mean() * lengths) / lengths.mean()  # of a ratio, by linearisation
    half = stats.t.ppf(0.975, len(lengths) - 1) * left.std(ddof=1) / np.sqrt(len(lengths))
    np.testing.assert_allclose([cut["low"], cut["high"]], [cut["mean"] - half, cut["mean"] + half], rtol=1e-5)
    assert "times the horizon of 300" in cut["how"]
    whole = dr.Dataset.from_arrays(
        observations=np.zeros((600, 4)), actions=np.zeros((600, 2)), rewards=np.repeat([0.0, 1.0], 300),
        timeouts=np.arange(600) % 300 == 299,
    )  # fmt: skip
    found = logged_value(whole, task("maze2d-umaze"))
    assert found["mean"] == 150.0
    assert found["high"] == pytest.approx(150 + 12.7062 * 150, rel=1e-4)  # of two episodes
    alone = logged_value(whole.select(np.array([1])), task("maze2d-umaze"))
    assert (alone["mean"], alone["low"], alone["high"]) == (300.0, None, None)


def test_two_sample_mmd_equals_numpy_and_the_probe_tells_copies_from_strangers(log, run):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(5, 2)).astype("f4"), rng.normal(1, 1, size=(4, 2)).astype("f4")
    k = lambda a, b: np.exp(-((a - b) ** 2).sum() / 4.0)  # noqa: E731
    xx = sum(k(x[i], x[j]) for i in range(5) for j in range(5) if i != j) / 20
    yy = sum(k(y[i], y[j]) for i in range(4) for j in range(4) if i != j) / 12
    xy = sum(k(a, b) for a in x for b in y) / 20
    np.testing.assert_allclose(two_sample_mmd(x, y, 2.0), np.sqrt(max(xx + yy - 2 * xy, 0)), rtol=1e-4)
    probe = LogProbe(log)
    far = run.policies[0]
    assert probe(far)["mmd_to_data"] > 0.02
    copy = two_sample_mmd(probe.logged, probe.logged[::-1], probe.variance)
    assert float(copy) < 0.05
    assert probe(far)["mmd_of_copy"] == probe.copy < probe(far)["mmd_to_data"]


@pytest.mark.parametrize("n", [40, pytest.param(400, marks=pytest.mark.slow)])
def test_samples_of_one_distribution_stay_below_the_mmd_of_a_copy_as_often_as_it_says(n):
    rng, beyond, far = np.random.default_rng(0), [], []
    for _ in range(300):
        x, y, z = (rng.normal(size=(n, 3)).astype("f4") for _ in range(3))
        bound = mmd_of_copy(x, 6.0, rng)
        beyond.append(two_sample_mmd(y[: n // 2], z[: n // 2], 6.0) > bound)
        far.append(two_sample_mmd(y[: n // 2], z[: n // 2] + 1.0, 6.0) > bound)
    assert np.mean(beyond) == pytest.approx(0.05, abs=0.035)
    assert np.mean(far) > 0.9


@pytest.mark.slow
def test_a_policy_that_remembers_is_given_its_carry_back():
    import jax.numpy as jnp

    from deadreckon.data.normalizer import Normalizer
    from deadreckon.policies import EnvPolicy
    from deadreckon.policies.policy import NormalizedPolicy

    class Counter(NormalizedPolicy):
        """Pushes along x for its first `length` steps, then never again."""

        length: float = 5.0

        def start(self, n):
            return jnp.zeros(n)

        def act(self, step, carry, key, *, greedy):
            push = jnp.where(carry < self.length, 1.0, 0.0)
            return jnp.stack([push, jnp.zeros_like(push)], -1), carry + 1.0

    view = Normalizer(None, None, np.array([-1.0, -1.0], "f4"), np.array([1.0, 1.0], "f4"))
    short, long = (evaluate(EnvPolicy.of(Counter(n), view), "maze2d-umaze", episodes=3, record=3) for n in (2.0, 8.0))
    both = evaluate([EnvPolicy.of(Counter(n), view) for n in (2.0, 8.0)], "maze2d-umaze", episodes=3, record=3)
    np.testing.assert_array_equal(short.trajectories[:, :, :3], long.trajectories[:, :, :3])
    assert (short.trajectories[:, :, 4, 2] < long.trajectories[:, :, 4, 2]).all()
    np.testing.assert_allclose(both.trajectories[1], long.trajectories[0], atol=1e-6)


def test_discrete_logs_are_drawn_probed_and_acted_on():
    import jax.numpy as jnp

    from deadreckon.data.batch import BatchSpec, TransitionSource
    from deadreckon.policies import EnvPolicy
    from deadreckon.policies.policy import NormalizedPolicy

    rng = np.random.default_rng(0)
    s = rng.normal(size=(400, 2)).astype("f4")
    choice = (s[:, 0] > 0).astype(int) + 1
    log = dr.Dataset.from_arrays(observations=s, actions=choice, rewards=np.zeros(400), terminals=np.ones(400))
    rows = TransitionSource(log, BatchSpec())
    assert rows.take(np.arange(3))["action"].dtype == np.int32

    class Rule(NormalizedPolicy):
        """Action 1 or 2 by the sign of the first number, or the other way round."""

        swap: float = 0.0

        def act(self, step, carry, key, *, greedy):
            right = jnp.where(step.observation[:, 0] > 0, 2, 1)
            return jnp.where(self.swap > 0, 3 - right, right), carry

    probe = LogProbe(log)
    same, other = (EnvPolicy.of(Rule(swap), rows.view) for swap in (0.0, 1.0))
    np.testing.assert_array_equal(same(s[:5]), log.actions[:5])
    assert probe(same)["mmd_to_data"] < 0.1 < probe(other)["mmd_to_data"]
    assert probe(same)["outside_range"] == 0.0
