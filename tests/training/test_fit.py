"""The loop with toy learners whose states can be computed by hand: batches, windows, phases, lanes."""

import signal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.data.batch import BatchSpec, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.interrupts import Interrupted, listening
from deadreckon.training.checkpoint import checkpoints, folder_of, inherit, load_arrays, load_tree, save_arrays, save_tree
from deadreckon.training.fit import Fit, fit
from deadreckon.training.hyperparameters import CountOrZero, check_fields, described, static
from deadreckon.training.learner import lift
from tests.agents.worlds import corridor

LOG = corridor(400)


class Collector(eqx.Module):
    """Sums what it sees, so that every kind of batch can be looked into."""

    scale: float = 1.0
    asks: BatchSpec = static(BatchSpec())
    refresh: CountOrZero = static(0)

    def needs(self, spec):
        return self.asks

    def init(self, spec, key):
        return {"seen": jnp.zeros(()), "prepared": jnp.zeros(())}

    def update(self, state, batch, *, step, key):
        total = sum(jnp.sum(x) for x in batch if x is not None)
        return {**state, "seen": state["seen"] + self.scale * total}, {"batch": total, "rows": jnp.float32(len(batch[0]))}


class Phased(Collector):
    """Has a phase on the host: trains another learner there and counts how often."""

    def prepare(self, state, rows, key, fit):
        inner = fit(Collector(asks=self.asks), 3, key)
        return {**state, "prepared": state["prepared"] + 1.0, "seen": state["seen"] + 0 * inner["seen"]}


def columns(asks, log=LOG):
    rows = TransitionSource(log, asks)
    return rows, rows.take(np.arange(rows.count))


def test_n_step_rewards_stop_at_the_episode_end():
    log = Dataset.from_arrays(
        observations=np.arange(6.0), actions=np.zeros((6, 1)), rewards=[1, 2, 4, 8, 16, 32.0],
        terminals=[0, 0, 1, 0, 0, 0], timeouts=[0, 0, 0, 0, 0, 1], final_observations=[[90.0], [91.0]],
    )  # fmt: skip
    names = ("reward", "next_observation", "terminal", "discount", "next_action", "time", "return_to_go")
    asks = BatchSpec(names, n_step=2, gamma=0.5)
    _, got = columns(asks, log)
    np.testing.assert_allclose(got["reward"], [2, 4, 4, 16, 32, 32])
    np.testing.assert_allclose(got["next_observation"][:, 0], [2, 90, 90, 5, 91, 91])
    np.testing.assert_allclose(got["terminal"], [0, 1, 1, 0, 0, 0])
    np.testing.assert_allclose(got["discount"], [0.25, 0, 0, 0.25, 0.25, 0.5])
    np.testing.assert_allclose(got["time"], [0, 1, 2, 0, 1, 2])
    np.testing.assert_allclose(got["return_to_go"], [3, 4, 4, 24, 32, 32])


def test_what_the_log_did_next_is_known_inside_of_episodes():
    some = {"observations": np.arange(5.0), "actions": np.array([[0.1], [0.0], [0.3], [0.4], [0.5]]), "rewards": np.zeros(5),
            "terminals": [0, 0, 1, 0, 0], "timeouts": [0, 0, 0, 0, 1], "action_space": Box((-1.0,), (1.0,))}  # fmt: skip
    asks = BatchSpec(("next_action", "follows"))
    _, got = columns(asks, Dataset.from_arrays(**some))
    np.testing.assert_allclose(got["next_action"][:, 0], [0, 0.3, 0, 0.5, 0], atol=1e-6)
    np.testing.assert_array_equal(got["follows"], [1, 1, 0, 1, 0])
    with pytest.raises(UserError, match="rows do not follow each other, so the next logged actions are not known"):
        columns(asks, Dataset.from_arrays(**some, next_observations=np.arange(5.0) + 0.5))


def test_rows_without_successor_are_never_drawn():
    ends = [0, 0, 1, 0, 0, 1]
    log = Dataset.from_arrays(observations=np.arange(6.0), actions=np.zeros((6, 1)), rewards=np.zeros(6), timeouts=ends)
    rows, got = columns(BatchSpec(), log)
    assert rows.count == 4
    np.testing.assert_array_equal(got["observation"][:, 0], [0, 1, 3, 4])
    np.testing.assert_array_equal(got["next_observation"][:, 0], [1, 2, 4, 5])
    rows, got = columns(BatchSpec(n_step=2), log)  # two steps on, the successor of rows 1 and 4 is unknown too
    np.testing.assert_array_equal(got["next_observation"][:, 0], [2, 5])
    assert columns(BatchSpec(("observation", "action")), log)[0].count == 6  # cloning needs no successors


@pytest.mark.slow
@pytest.mark.parametrize("stream", [False, True])
def test_windows_are_masked_beyond_their_episode(stream):
    class Probe(Collector):
        def update(self, state, batch, *, step, key):
            inside = batch.mask.astype(bool)
            steps = jnp.diff(batch.time, axis=1)
            broken = (jnp.where(inside[:, 1:], steps != 1.0, False)).sum()  # inside, time goes on by one
            shape = jnp.float32(batch.observation.shape[0] * 100 + batch.observation.shape[1])
            return state, {"broken": broken.astype(jnp.float32), "shape": shape,
                           "outside": (~inside).mean()}  # fmt: skip

    asks = BatchSpec(("observation", "time"), batch_size=8, window=7)
    seen = []
    fit([Probe(asks=asks)], TransitionSource(LOG, asks), [0], 20, chunk=10, stream=stream, on_chunk=seen.append)
    assert seen[-1].metrics["broken"][0] == 0
    assert seen[-1].metrics["shape"][0] == 807
    assert 0.05 < seen[-1].metrics["outside"][0] < 0.3  # episodes of 20, windows of 7: 6/2/20 = 0.15


def test_initial_observations_come_from_episode_starts():
    class Probe(Collector):
        def update(self, state, batch, *, step, key):
            known = jnp.asarray(LOG.observations[LOG.starts])
            hit = (batch.initial_observation[:, None] == known[None]).all(-1).any(1)
            return state, {"hit": hit.mean(), "count": jnp.float32(len(hit))}

    asks = BatchSpec(("observation",), batch_size=4, initial=16)
    seen = []
    fit([Probe(asks=asks)], TransitionSource(LOG, asks), [0], 5, chunk=5, on_chunk=seen.append)
    assert (seen[0].metrics["hit"][0], seen[0].metrics["count"][0]) == (1.0, 16.0)


def test_standardised_observations_and_unit_actions():
    log = Dataset.from_arrays(observations=np.arange(8.0), actions=np.linspace(10, 20, 8)[:, None], rewards=np.zeros(8))
    rows, got = columns(BatchSpec(standardise=True), log)
    assert abs(got["observation"].mean() + (7 - 3.5) / (7 * 2.29)) < 0.05  # the last row has no successor and is left out
    np.testing.assert_allclose(got["action"][[0, -1], 0], [-1 + 1e-6, 2 * 6 / 7 - 1], atol=1e-6)
    np.testing.assert_allclose(rows.view.from_unit(rows.view.to_unit(np.array([[15.0]]))), [[15.0]], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("stream", [False, True])
def test_phases_run_first_and_at_every_refresh_however_chunks_fall(stream):
    learner = Phased(refresh=10)
    result = fit([learner, learner], TransitionSource(LOG, learner.asks), [0, 1], 25, chunk=7, stream=stream)
    np.testing.assert_array_equal(result.states["prepared"], [3.0, 3.0])  # before updates 0, 10 and 20


def test_a_damaged_file_of_a_prepared_lane_is_made_again(tmp_path):
    rows = TransitionSource(LOG, BatchSpec())
    job = lambda folder: Fit([Phased(refresh=10)], rows, [0], 5, chunk=5, folder=folder)  # noqa: E731
    list(job(tmp_path / "whole").chunks())
    (tmp_path / "again").mkdir()
    (tmp_path / "again" / "prepared-0.npz").write_bytes(b"damaged")
    again = job(tmp_path / "again")
    with pytest.warns(UserWarning, match="a damaged file is skipped, and the lane is prepared again"):
        list(again.chunks())
    np.testing.assert_array_equal(again.states["prepared"], [1.0])


@pytest.mark.slow
def test_a_kill_while_preparing_loses_one_lane_alone(tmp_path, monkeypatch):
    rows, asked = TransitionSource(LOG, BatchSpec()), []

    def prepare(self, state, rows, key, fit, patience=[3]):  # noqa: B006 -- counts calls
        asked.append(float(self.scale))
        patience[0] -= 1
        if patience[0] == 0:
            raise KeyboardInterrupt
        return {**state, "prepared": state["prepared"] + jax.random.uniform(key)}

    lanes = [Phased(scale=s, refresh=10) for s in (1.0, 2.0, 3.0)]
    monkeypatch.setattr(Phased, "prepare", prepare)
    job = lambda: Fit(lanes, rows, [0, 1, 2], 15, chunk=5, folder=tmp_path)  # noqa: E731
    with pytest.raises(KeyboardInterrupt):
        list(job().chunks())
    again = job()
    again.resume()
    list(again.chunks())
    assert asked == [1.0, 2.0, 3.0, 3.0, 1.0, 2.0, 3.0]  # the killed one again, and all of them before update 10
    whole = fit(lanes, rows, [0, 1, 2], 15, chunk=5)
    np.testing.assert_array_equal(again.states["prepared"], whole.states["prepared"])
    assert not list(tmp_path.glob("prepared-*"))


def test_stops_end_chunks_without_changing_bits():
    rows = TransitionSource(LOG, BatchSpec())
    plain = fit([Collector()], rows, [3], 40, chunk=40).states["seen"]
    job = Fit([Collector()], rows, [3], 40, chunk=40, stops=15)
    assert [p.step for p in job.chunks()] == [15, 30, 40]
    np.testing.assert_array_equal(job.states["seen"], plain)


def test_learners_are_told_apart_by_all_their_fields():
    assert str(Collector()) == str(Collector(scale=1.0))
    assert described(Collector()) == f"Collector(scale=1.0, asks={BatchSpec()!r}, refresh=0)"
    assert described(Collector(scale=2.0)) != described(Collector())


def test_lanes_take_floats_and_refuse_shapes():
    lifted = lift([Collector(scale=1.0), Collector(scale=2.0)])
    np.testing.assert_array_equal(lifted.scale, [1.0, 2.0])
    with pytest.raises(UserError, match="Collector.refresh shapes the program"):
        lift([Collector(), Collector(refresh=1)])
    with pytest.raises(UserError, match="of one type"):
        lift([Collector(), Phased()])
    with pytest.raises(UserError, match="Collector.scale takes a finite number, got 'x'"):
        check_fields(Collector(scale="x"))
    with pytest.raises(UserError, match="Collector.refresh takes a whole number >= 0, got -1"):
        check_fields(Collector(refresh=-1))


def test_bad_needs_are_told():
    with pytest.raises(UserError, match="unknown column 'rewards': did you mean reward"):
        TransitionSource(LOG, BatchSpec(("rewards",)))
    with pytest.raises(UserError, match="batch_size and n_step"):
        TransitionSource(LOG, BatchSpec(batch_size=0))
    with pytest.raises(UserError, match="behavior_log_probs"):
        TransitionSource(LOG, BatchSpec(("behavior_log_prob",)))


def test_checkpoints_are_whole_or_absent(tmp_path):
    tree = {"a": jnp.arange(3.0), "b": (jnp.zeros((2, 2)), jnp.int32(4))}
    path = tmp_path / "0000000005.npz"
    save_tree(path, tree, {"step": 5})
    back, meta = load_tree(path, tree)
    assert meta == {"step": 5}
    assert all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(tree), jax.tree.leaves(back), strict=True))
    with pytest.raises(UserError, match=r"does not fit: \['a'\] is \(\(3,\)"):
        load_tree(path, {**tree, "a": jnp.zeros(4)})
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(UserError, match="cannot be read as a checkpoint"):
        load_arrays(path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_broken_newest_checkpoint_is_passed_over(tmp_path):
    rows = TransitionSource(LOG, BatchSpec())
    job = Fit([Collector()], rows, [0], 30, chunk=10, folder=tmp_path)
    for _ in job.chunks():
        pass
    newest = tmp_path / f"{30:010d}.npz"
    newest.write_bytes(newest.read_bytes()[:100])
    again = Fit([Collector()], rows, [0], 30, chunk=10, folder=tmp_path)
    with pytest.warns(UserWarning, match=f"skipped, and training resumes from update 20: {newest}: cannot be read"):
        again.resume()
    assert again.step == 20
    for _ in again.chunks():
        pass
    np.testing.assert_array_equal(again.states["seen"], job.states["seen"])


def test_a_signal_in_a_chunk_ends_the_fit_when_the_chunk_is_on_disk(tmp_path):
    rows, seen = TransitionSource(LOG, BatchSpec()), []
    job = Fit([Collector()], rows, [0], 30, chunk=10, folder=tmp_path)
    with listening(lambda number: None), pytest.raises(Interrupted):  # noqa: PT012
        for progress in job.chunks():
            seen.append(progress.step)
            signal.raise_signal(signal.SIGTERM)
    assert seen == [10]
    assert checkpoints(tmp_path)[-1][0] == 10
    with listening(lambda number: None), pytest.raises(Interrupted):  # noqa: PT012 - in memory nothing is waited for
        for _ in Fit([Collector()], rows, [0], 30, chunk=10).chunks():
            signal.raise_signal(signal.SIGTERM)
            seen.append("never")
    assert seen == [10]


def test_data_is_an_argument_of_the_program_not_a_constant():
    """The same compiled chunk serves two logs of one shape."""
    from deadreckon.training import program

    asks = BatchSpec()
    fit([Collector()], TransitionSource(LOG, asks), [0], 5, chunk=5)
    before = program.advance._cached._cache_size()
    fit([Collector()], TransitionSource(corridor(400, seed=1), asks), [0], 5, chunk=5)
    assert program.advance._cached._cache_size() == before


@pytest.mark.parametrize("more", [{}, {"window": 4}, {"standardise": True}])
def test_lanes_of_several_logs_see_the_rows_of_their_own(more):
    asks = BatchSpec(batch_size=5, **more)
    logs = [LOG, corridor(90, seed=1), LOG]
    sources = {id(log): TransitionSource(log, asks) for log in logs}
    learner, seeds = Collector(asks=asks), [3, 4, 5]
    job = Fit([learner] * 3, [sources[id(log)] for log in logs], seeds, 12, chunk=5)
    metrics = [progress.metrics for progress in job.chunks()]
    for i, (log, seed) in enumerate(zip(logs, seeds)):
        alone = fit([learner], TransitionSource(log, asks), [seed], 12, chunk=5)
        np.testing.assert_allclose(job.states["seen"][i], alone.states["seen"][0], rtol=1e-6)
    assert len(metrics) == 3
    assert len(set(np.asarray(job.states["seen"]).tolist())) == 3


@pytest.mark.slow
def test_lanes_of_several_logs_are_prepared_on_their_own():
    class Counted(Phased):
        def prepare(self, state, rows, key, fit):
            return {**super().prepare(state, rows, key, fit), "prepared": jnp.float32(rows.count)}

    sources = [TransitionSource(log, BatchSpec()) for log in (LOG, corridor(90))]
    done = fit([Counted()] * 2, sources, [0, 1], 2)
    assert done.states["prepared"].tolist() == [source.count for source in sources]


@pytest.mark.slow
def test_several_logs_that_cannot_share_a_program_are_refused():
    asks = BatchSpec(batch_size=5)
    columns = {name: np.zeros(20) for name in ("rewards", "terminals")}
    wide = Dataset.from_arrays(observations=np.zeros((20, 7)), actions=np.zeros((20, 1)), **columns)
    sources = [TransitionSource(log, asks) for log in (LOG, wide)]
    learner = Collector(asks=asks)
    with pytest.raises(UserError, match="must have observations and actions of the same shape"):
        Fit([learner] * 2, sources, [0, 1], 5)
    with pytest.raises(UserError, match="one log a lane is needed, got 2 logs and 3 lanes"):
        Fit([learner] * 3, sources, [0, 1, 2], 5)
    initial = BatchSpec(batch_size=5, initial=5)
    with pytest.raises(UserError, match="draws initial observations learns from one log"):
        Fit([Collector(asks=initial)] * 2, [TransitionSource(log, initial) for log in (LOG, LOG)], [0, 1], 5)
    with pytest.raises(UserError, match="must fit on the device together"):
        Fit([learner] * 2, [TransitionSource(log, asks) for log in (LOG, LOG)], [0, 1], 5, stream=True)


def test_a_longer_fit_goes_on_from_a_shorter_one_whatever_else_lies_there(tmp_path):
    shorter, longer = (folder_of(tmp_path, "model", {"steps": steps}) for steps in (10, 20))
    for step in (5, 10, 30):
        save_arrays(shorter / f"{step:010d}.npz", {"x": np.full(2, float(step))}, {})
    (shorter / "0000000012 (1).npz").write_bytes(b"")
    (longer / "0000000003 (1).npz").write_bytes(b"")
    inherit(longer)
    assert [step for step, _ in checkpoints(longer)] == [10]
    assert load_arrays(longer / "0000000010.npz")[0]["x"].tolist() == [10.0, 10.0]
