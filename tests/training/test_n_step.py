"""Transitions of several steps, summed up when they are drawn from rows that grow."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.data.batch import TransitionSource
from deadreckon.data.provenance import Provenance
from deadreckon.online.rows import replay_log
from deadreckon.training.program import Plan, advance, draw, layout_of
from deadreckon.training.sources import source_of
from tests.agents.test_online_conformance import PENDULUM, SETTINGS, job
from tests.marks import slow

FIELDS = {"observation": (2,), "action": (1,), "reward": (), "next_observation": (2,), "terminal": (), "timeout": ()}
COPIES, ROWS, ROOM, GAMMA = 3, 200, 256, 0.9


class Telling(eqx.Module):
    """Learns nothing and tells each number of its batches."""

    def update(self, state, batch, *, step, key):
        told = {"reward": batch.reward, "discount": batch.discount, "terminal": batch.terminal}
        told |= {name: getattr(batch, name)[:, 0] for name in ("observation", "action", "next_observation")}
        return state, {f"{name} {i}": column[i] for name, column in told.items() for i in range(len(column))}


@pytest.fixture(scope="module")
def rows():
    """As a replay buffer has them: copies by turns, and room behind the last."""
    rng = np.random.default_rng(0)
    columns = {name: rng.normal(size=(ROOM, *shape)) for name, shape in FIELDS.items()}
    columns["terminal"], columns["timeout"] = rng.random((2, ROOM)) < 0.15
    columns["timeout"] &= ~columns["terminal"].astype(bool)
    return {name: column.astype(np.float32) for name, column in columns.items()}


@pytest.mark.parametrize(("n", "lanes"), [(4, 1), (1, 2), *slow((4, 2), (1, 1))])
def test_rewards_go_on_as_far_as_the_episode_and_the_rows(rows, lanes, n):
    layout = layout_of({name: (shape, np.dtype(np.float32)) for name, shape in FIELDS.items()})
    plan = Plan(layout, 16, 0, 0, resident=True, grows=True, n_step=n, stride=COPIES, gamma=GAMMA)
    packed = np.concatenate([column.reshape(ROOM, -1) for column in rows.values()], 1)
    data, roots = {"packed": jnp.asarray(np.stack([packed] * lanes))}, jax.random.split(jax.random.key(1), lanes)
    learners = jax.tree.map(lambda leaf: jnp.stack([leaf] * lanes), Telling())
    states, at = jnp.zeros(lanes), jnp.asarray(3)
    _, found, _ = advance(learners, plan, states, data, None, roots, at, at + 1, jnp.asarray(ROWS))
    lengths = set()
    for lane in range(lanes):
        for i, first in enumerate(np.asarray(draw(plan, roots[lane], at, jnp.asarray(ROWS)))):
            path = [first]  # of rows of one copy, to the end of the episode or of what there is
            while len(path) < n and path[-1] + COPIES < ROWS and not rows["terminal"][path[-1]] + rows["timeout"][path[-1]]:
                path.append(path[-1] + COPIES)
            last = path[-1]
            by_hand = {
                "reward": sum(GAMMA**k * rows["reward"][row] for k, row in enumerate(path)),
                "discount": GAMMA ** len(path) * (1 - rows["terminal"][last]), "terminal": rows["terminal"][last],
                "observation": rows["observation"][first, 0], "action": rows["action"][first, 0],
                "next_observation": rows["next_observation"][last, 0],
            }  # fmt: skip
            for name, value in by_hand.items():
                assert found[f"{name} {i}"][lane] == pytest.approx(value, abs=1e-5), (name, first, path)
            lengths.add(len(path))
    assert lengths == set(range(1, n + 1))


@pytest.fixture(scope="module")
def acted(tmp_path_factory):
    """Experience of D4PG with returns of three steps, and where its rows lie."""
    folder = tmp_path_factory.mktemp("replay")
    found, experience = job("d4pg", [0], folder=folder)
    for _ in found.chunks():
        pass
    experience.flush()
    return experience, folder / "0.bin"


def test_what_is_learned_from_while_acting_is_what_the_log_of_it_gives(acted):
    experience, path = acted
    count, root = experience.count, jax.random.key(2)
    plan = source_of(experience, root[None], 10, None).plan
    assert (plan.n_step, plan.stride) == (3, SETTINGS.copies)
    log = replay_log(path, PENDULUM, SETTINGS.copies, count, name="r", provenance=Provenance())
    source = TransitionSource(log, experience.needs)
    learner, at = jax.tree.map(lambda leaf: jnp.stack([leaf]), Telling()), jnp.asarray(0)
    data = {"packed": experience.replay.buffer}
    _, found, _ = advance(learner, plan, jnp.zeros(1), data, None, root[None], at, at + 1, jnp.asarray(count))
    index = np.asarray(draw(plan, root, at, jnp.asarray(count)))
    each = count // SETTINGS.copies  # rows of a copy, which lie one after the other in the log
    rows = source.take(index % SETTINGS.copies * each + index // SETTINGS.copies)
    assert len(np.unique(np.round(rows["reward"], 3))) > 2  # episodes end on the way
    for name in ("reward", "discount"):
        np.testing.assert_allclose([found[f"{name} {i}"][0] for i in range(len(index))], rows[name], atol=1e-5)
    nexts = [found[f"next_observation {i}"][0] for i in range(len(index))]
    np.testing.assert_allclose(nexts, rows["next_observation"][:, 0], atol=1e-5)


def test_an_episode_that_could_not_be_taken_up_again_ends_in_its_last_row(acted, monkeypatch):
    experience, path = acted
    state, restore = experience.state(), experience.simulator.restore
    monkeypatch.setattr(experience.simulator, "restore", lambda state: (restore(state), np.array([0, 1]))[1])
    before = np.fromfile(path, np.float32).reshape(experience.count, -1)
    go_on = ~before[:, -2:].any(1).reshape(-1, SETTINGS.copies)
    last = SETTINGS.copies * np.flatnonzero(go_on.all(1))[-1]  # where no copy's episode has ended by itself
    with pytest.warns(UserWarning, match="2 episodes start again"):
        experience.restore(state | {"count": np.asarray(last + SETTINGS.copies)})
    after = np.fromfile(path, np.float32).reshape(before.shape)
    assert np.argwhere(before != after).tolist() == [[last, before.shape[1] - 1], [last + 1, before.shape[1] - 1]]
    assert (after[last : last + 2, -1] == 1.0).all()
    np.testing.assert_array_equal(experience.replay.buffer[0, : experience.count, -2:], after[: experience.count, -2:])
