"""Many updates as one compiled program: rows are packed, drawn and trained on, for all lanes at once.

All randomness follows from the seed, a purpose (see `randomness`) and the step, and a chunk's length is an argument of the
program, so neither the chunk length nor where rows come from changes a bit of the result.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray

from deadreckon.data.batch import Batch
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError
from deadreckon.randomness import key_for
from deadreckon.training import pictures
from deadreckon.training.learner import stack, unstack
from deadreckon.training.pictures import USUAL, Sight

REVISION = 2  # of the loop: rows drawn, keys, order of updates; raised where numbers change (see bench/identity.py)
PARAMETERS = "parameters"  # stands for the metric that failed if all metrics are finite, but a state is not


class Column(NamedTuple):
    """The position of a batch's field in the packed matrix (`start` >= 0); images are separate arrays (`start` of -1)."""

    name: str
    start: int
    shape: tuple[int, ...]
    dtype: str


def layout_of(fields: dict[str, tuple[tuple[int, ...], Any]]) -> tuple[Column, ...]:
    """The positions of fields of given shapes and types."""
    columns, start = [], 0
    for name, (shape, dtype) in fields.items():
        packed = dtype != np.uint8
        columns.append(Column(name, start if packed else -1, tuple(shape), str(dtype)))
        start += int(np.prod(shape)) if packed else 0
    return tuple(columns)


def pack(columns: dict[str, np.ndarray], layout: tuple[Column, ...], axes: int) -> dict[str, np.ndarray]:
    """Columns as one float32 matrix, so that a batch is one gather; images stay separate. `axes`: leading index axes."""
    packed = [columns[c.name] for c in layout if c.start >= 0]
    lead = packed[0].shape[:axes]
    out = {"packed": np.concatenate([p.reshape(*lead, -1).astype(np.float32, copy=False) for p in packed], -1)}
    return out | {c.name: columns[c.name] for c in layout if c.start < 0}


def unpack(taken: dict[str, Array], layout: tuple[Column, ...], axes: int) -> dict[str, Array]:
    """The inverse of `pack`."""
    out = {}
    for c in layout:
        if c.start < 0:
            out[c.name] = taken[c.name]
            continue
        matrix = taken["packed"]
        part = matrix[..., c.start : c.start + int(np.prod(c.shape))].reshape(*matrix.shape[:axes], *c.shape)
        out[c.name] = part.astype(c.dtype)
    return out


class Plan(NamedTuple):
    """The settings that determine the compiled program of a chunk; hashable."""

    layout: tuple[Column, ...]
    batch_size: int
    window: int
    initial: int
    resident: bool
    grows: bool  # each lane has rows of its own, on the device
    logged: int = 0  # rows of each batch that come from a log, which all lanes share; the others are the lane's own
    n_step: int = 0  # of growing rows: transitions that are summed to one (`summed`); 0: rows are used as they are
    stride: int = 1  # distance in rows between a row and the next one of its episode
    gamma: float = 1.0  # discount of these sums


def draw(plan: Plan, root: PRNGKeyArray, step: Int[Array, ""], rows: Int[Array, ""]) -> Int[Array, "b *w"]:
    """Indices of the rows of one batch: the same function whether the rows are on the device or are fetched."""
    key = key_for(root, "rows", step)
    index = jax.random.randint(key, (plan.batch_size - plan.logged,), 0, rows)
    if plan.window:
        index = jnp.minimum(index[:, None] + jnp.arange(plan.window), rows - 1)
    return index


def draw_logged(plan: Plan, root: PRNGKeyArray, step: Int[Array, ""], rows: Int[Array, ""]) -> Int[Array, "b"]:
    """Indices of the rows of one batch that come from the log."""
    return jax.random.randint(key_for(root, "logged rows", step), (plan.logged,), 0, rows)


@eqx.filter_jit
def indices(
    plan: Plan, roots: Key[Array, "lanes"], start: Int[Array, ""], rows: Int[Array, ""], length: int
) -> Int[Array, "t lanes b *w"]:
    """The indices of `draw` for `length` steps of all lanes."""
    steps = start + jnp.arange(length)
    return jax.vmap(lambda step: jax.vmap(lambda root: draw(plan, root, step, rows))(roots))(steps)


def batch_of(plan: Plan, taken: dict[str, Array], initial: dict[str, Array] | None, root: PRNGKeyArray, step: Array) -> Batch:
    """A batch from packed rows, with its mask and initial observations where they are needed."""
    fields = unpack(taken, plan.layout, 2 if plan.window or plan.n_step else 1)
    if plan.window:
        left = fields.pop("_left")[:, :1]
        fields["mask"] = (jnp.arange(plan.window) <= left).astype(jnp.float32)
    if initial is not None:
        key = key_for(root, "initial_states", step)
        index = jax.random.randint(key, (plan.initial,), 0, len(initial["initial_observation"]))
        fields |= {name: column[index] for name, column in initial.items()}
    known = {name: fields.pop(name) for name in Batch._fields if name in fields}
    # Keeps the compiler from fusing the fetch into the update, whose bits then do not depend on where rows come from.
    return jax.lax.optimization_barrier(Batch(**known, extra=fields or None))


def summed(batch: Batch, inside: Bool[Array, "b n"], gamma: float) -> Batch:
    """Consecutive transitions as one of n steps, or of fewer where the episode or the rows end; see `Batch`.

    The result has only the columns of a transition and its discount.

    Args:
        batch: (b, n, ...) transitions, with the column "timeout" in `extra`.
        inside: (b, n) whether each of these rows exists.
        gamma: discount of the sum.
    """
    assert batch.extra is not None
    over = (batch.terminal + batch.extra["timeout"] > 0)[:, :-1]
    goes_on = jnp.cumprod(jnp.pad(~over, ((0, 0), (1, 0)), constant_values=True) & inside, 1)
    count = goes_on.sum(1)
    last = lambda column: jax.vmap(lambda rows, i: rows[i - 1])(column, count)  # noqa: E731
    terminal = last(batch.terminal)
    return Batch(
        observation=batch.observation[:, 0], action=batch.action[:, 0], next_observation=last(batch.next_observation),
        reward=(batch.reward * goes_on * gamma ** jnp.arange(inside.shape[1])).sum(1), terminal=terminal,
        discount=gamma**count * (1.0 - terminal),
    )  # fmt: skip


@eqx.filter_jit
def advance(
    learner: Any,
    plan: Plan,
    states: Any,
    data: dict[str, Any],
    initial: dict[str, Array] | None,
    roots: Key[Array, "lanes"],
    start: Int[Array, ""],
    stop: Int[Array, ""],
    rows: Int[Array, ""],
) -> tuple[Any, dict[str, Float[Array, "lanes"]], dict[str, Int[Array, "lanes"]]]:
    """Updates `start` .. `stop` - 1 of all lanes as one program.

    The log is an argument, never a closure (that would be compiled in). Nothing is donated: a failed lane returns to its state
    before the chunk, which costs one copy of the states. If batches have rows of a log beside the lanes' own, `data` holds
    these rows and their number as "logged"; if lanes are trained on different logs, "spans" has the first row and the number of
    rows of each lane.

    Returns:
        The states, each metric's mean, and per metric the first step at which it was not finite (-1 if none). Under
        `PARAMETERS` it is the last step where the final states are not finite; rows that grow have no such entry.
    """
    single = roots.shape[0] == 1
    logged, known = data.get("logged", ({}, 0))
    spans = data.get("spans")
    data = {name: column for name, column in data.items() if name not in ("logged", "spans")}

    if single and plan.grows:  # before the loop, where it costs nothing
        data = {name: column.reshape(column.shape[1:]) for name, column in data.items()}

    def one(learner: Any, state: Any, root: PRNGKeyArray, fetched: Any, span: Any, step: Array) -> tuple[Any, dict[str, Array]]:
        inside = jnp.ones((plan.batch_size, max(plan.n_step, 1)), bool)
        if plan.resident:
            first, count = (0, rows) if span is None else span
            index = first + draw(plan, root, step, count)
            own = fetched if plan.grows and not single else data
            if plan.n_step:
                index = index[:, None] + plan.stride * jnp.arange(plan.n_step)
                inside, index = index < rows, jnp.minimum(index, rows - 1)
            fetched = {name: column[index] for name, column in own.items()}
            if plan.logged:
                past = draw_logged(plan, root, step, known)
                fetched = {name: jnp.concatenate([logged[name][past], column]) for name, column in fetched.items()}
        batch = batch_of(plan, fetched, initial, root, step)
        if plan.n_step:
            batch = summed(batch, inside, plan.gamma)
        if hasattr(learner, "learned"):
            batch = learner.learned(batch)
        key = key_for(root, "update", step)
        return pictures.update(learner, state, batch, step=step, key=key)

    @partial(jax.jit, inline=True)  # the shapes of the metrics and the loop share one trace
    def all_lanes(states: Any, step: Array) -> tuple[Any, dict[str, Array]]:
        fetched = None if plan.resident else {name: column[step - start] for name, column in data.items()}
        if plan.grows and not single:
            fetched = data
        if single:  # a lane axis of one would make every product a batched one
            squeeze = lambda tree: jax.tree.map(lambda x: x[0], tree)  # noqa: E731
            out = one(squeeze(learner), squeeze(states), roots[0], squeeze(fetched), squeeze(spans), step)
            return jax.tree.map(lambda x: x[None], out)
        return jax.vmap(one, (0, 0, 0, 0, 0, None))(learner, states, roots, fetched, spans, step)

    def body(step: Array, carry: Any) -> Any:
        states, sums, bad = carry
        states, metrics = all_lanes(states, step)
        sums = jax.tree.map(jnp.add, sums, metrics)
        bad = jax.tree.map(lambda b, m: jnp.where((b < 0) & ~jnp.isfinite(m), step, b), bad, metrics)
        return states, sums, bad

    shapes = jax.eval_shape(all_lanes, states, start)[1]
    sums = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    bad = jax.tree.map(lambda s: jnp.full(s.shape, -1, jnp.int32), shapes)
    states, sums, bad = jax.lax.fori_loop(start, stop, body, (states, sums, bad))
    if not plan.grows:  # a chunk of experience is many calls: `Fit` checks its final states
        bad[PARAMETERS] = jnp.where(finite(states), -1, stop - 1)
    count = jnp.maximum(stop - start, 1)
    return states, jax.tree.map(lambda s: s / count, sums), bad


def begin(learner: Any, specs: Sequence[Spec], roots: Key[Array, "lanes"], sight: Sight = USUAL) -> Any:
    """(lanes, ...) first states.

    Args:
        learner: see `learner.lift`.
        specs: of the log of each lane.
        roots: keys of the lanes.
        sight: settings for image observations.

    Raises:
        UserError: states of lanes differ in their sizes, as their logs do.
    """
    # Not compiled as a whole: the initialisation of a layer is compiled once per shape, for all lanes, agents and logs. One
    # program per agent and log would give the same bits and take half a second to ten seconds to compile.
    keys = [key_for(jax.random.wrap_key_data(root), "init") for root in np.asarray(jax.random.key_data(roots))]
    made = zip(unstack(learner, len(specs)), specs, keys)
    states = [pictures.first_state(own, spec, key, sight) for own, spec, key in made]
    sizes = [[np.shape(leaf) for leaf in jax.tree.leaves(state)] for state in states]
    for spec, own in zip(specs, sizes):
        if own != sizes[0]:
            kind, logs = type(learner).__name__, f"{specs[0].name} and {spec.name}"
            raise UserError(f"{kind} has networks of other sizes on {logs}, which cannot share a program: train on each alone")
    return stack(states)


@jax.jit
def finite(states: Any) -> Array:
    """(lanes,) whether every number of a lane is finite."""
    flags = [
        jnp.isfinite(leaf).reshape(leaf.shape[0], -1).all(1)
        for leaf in jax.tree.leaves(states)
        if jnp.issubdtype(leaf.dtype, jnp.floating)
    ]
    return jnp.stack(flags).all(0)


@jax.jit
def choose(take_new: Array, new: Any, old: Any) -> Any:
    """Each lane from `new` (lanes, ...) where `take_new` (lanes,) is true, else from `old`."""
    return jax.tree.map(lambda n, o: jnp.where(take_new.reshape(-1, *[1] * (n.ndim - 1)), n, o), new, old)
