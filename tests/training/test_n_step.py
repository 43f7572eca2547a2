"""Transitions of several steps, summed up when they are drawn from rows that grow."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from deadreckon.training.program import Plan, advance, draw, layout_of

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


@pytest.mark.parametrize("lanes", [1, 2])
@pytest.mark.parametrize("n", [1, 4])
def test_rewards_go_on_as_far_as_the_episode_and_the_rows(rows, lanes, n):
    layout = layout_of({name: (shape, np.dtype(np.float32)) for name, shape in FIELDS.items()})
    plan = Plan(layout, 40, 0, 0, resident=True, grows=True, n_step=n, stride=COPIES, gamma=GAMMA)
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
