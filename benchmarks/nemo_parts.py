"""Where an update of NEMO's time goes, beside the bare products it is made of: what share of the machine's rate it can reach.

    python benchmarks/nemo_parts.py      # two minutes

The sizes are those of the case nemo-40 of `speed.py`. All parts take turns, each with the whole machine.
"""

import statistics
from collections.abc import Callable
from typing import Any

import flops
import jax
import jax.numpy as jnp
import numpy as np
import protocol

from deadreckon.bench.idle import measuring
from deadreckon.mbo.designer import DesignInput
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nemo import NEMO, STACKS
from deadreckon.mbo.nml import quantise
from deadreckon.mbo.variables import Variable
from deadreckon.nets.mlp import split
from deadreckon.nets.optim import apply_gradients, polyak_update

SHARE, PROMISE, TURNS, REPEATS = 0.6, 1.3, 9, 10
BINS, WIDTH, SIZE, BATCH = (protocol.NEMO[key] for key in ("bins", "width", "size", "batch"))


def products() -> dict[str, tuple[Callable[..., Any], list[tuple[int, ...]], int]]:
    """The products of an update by kind: what it does, the shapes of its operands, how many of them an update has."""
    x, hidden, weights, first = (BATCH, SIZE), (BINS, BATCH, WIDTH), (BINS, WIDTH, WIDTH), (BINS, SIZE, WIDTH)
    return {
        "hidden layer, forward": (lambda a, b: jnp.einsum("kbi,kio->kbo", a, b), [hidden, weights], 2),
        "hidden layer, to its input": (lambda a, b: jnp.einsum("kbo,kio->kbi", a, b), [hidden, weights], 2),
        "hidden layer, to its weights": (lambda a, b: jnp.einsum("kbi,kbo->kio", a, b), [hidden, hidden], 1),
        "first layer, forward": (lambda a, b: jnp.einsum("bi,kio->kbo", a, b), [x, first], 2),
        "first layer, to the designs": (lambda a, b: jnp.einsum("kbo,kio->kbi", a, b).sum(0), [hidden, first], 1),
        "first layer, to its weights": (lambda a, b: jnp.einsum("bi,kbo->kio", a, b), [x, hidden], 1),
    }


def stacked(product: Callable[..., Any], shapes: list[tuple[int, ...]]) -> Callable[[], Any]:
    """One product as an update makes it, its stacks beside each other."""
    rng = np.random.default_rng(0)
    operands = [jnp.asarray(rng.standard_normal(shape), jnp.float32) for shape in shapes]
    parts = [split(o, STACKS) if o.ndim == 3 else (o,) * STACKS for o in operands]
    run = jax.jit(lambda parts: [product(*each) for each in zip(*parts)])
    return lambda: jax.block_until_ready(run(parts))


def repeated(step: Callable[..., Any], *state: Any) -> Callable[[], Any]:
    """`step` from its own result on, `REPEATS` times in one call."""
    run = jax.jit(lambda state: jax.lax.fori_loop(0, REPEATS, lambda _, s: step(*s), state))
    return lambda: jax.block_until_ready(run(state))


def parts() -> dict[str, Callable[[], Any]]:
    """Of an update: the gradients of the models, their optimiser with the targets, and the rise of the designs."""
    x, y = protocol.synthetic_designs({"seed": 0, "rows": 5000})
    data = Designs.from_arrays(x, y, [Variable(f"x{i}") for i in range(SIZE)])
    designer = NEMO(bins=BINS, hidden=(WIDTH,) * 2, batch_size=BATCH, pretrain=0, model_updates=1, lr=0.005)
    learner = designer.training(DesignInput(data, protocol.NEMO["designs"], [0], None, lambda *_: None))
    state = learner.init(data.coordinates, jax.random.key(0))
    batch, label = jnp.asarray(x[:BATCH], jnp.float32), quantise(jnp.asarray(y[:BATCH]), BINS)
    claim = state.search.x[:1]

    def gradients(nets: Any) -> Any:
        grads, _ = jax.grad(learner.loss, has_aux=True)(nets, batch, label, claim, jnp.float32(1.0))
        return (jax.tree.map(lambda p, g: p - 1e-9 * g, nets, grads),)  # so that nothing of it can be left out

    def optimiser(nets: Any, opt: Any, targets: Any) -> Any:
        nets, opt = apply_gradients(nets, targets, opt, 1e-3)  # any gradients
        return nets, opt, polyak_update(targets, nets, 0.05)

    def rise(search: Any) -> Any:
        return (search.ascend(lambda z: learner.worth(state.targets, z), 0.01, *learner.bounds),)

    return {
        "gradients of the models": repeated(gradients, state.nets),
        "Adam and target networks": repeated(optimiser, state.nets, state.opt, state.targets),
        "rise of the designs": repeated(rise, state.search),
    }


def main() -> None:
    """The table of docs/results/speed.md."""
    square = jnp.asarray(np.random.default_rng(0).standard_normal((1024, 1024)), jnp.float32)
    multiply = jax.jit(lambda a: a @ a)
    calls = {"rate": lambda: multiply(square).block_until_ready()}
    kinds = products()
    calls |= {name: stacked(product, shapes) for name, (product, shapes, _) in kinds.items()}
    own = parts()
    calls |= own
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(TURNS):
        for name, call in calls.items():
            seconds[name].append(1.0 / protocol.product_rate(call, 1.0, 0.3) / (REPEATS if name in own else 1))
    middle = {name: statistics.median(each) for name, each in seconds.items()}
    rate = 2 * 1024**3 / middle["rate"]

    def line(name: str, taken: float, work: float) -> None:
        print(f"| {name} | {1e3 * taken:.1f} | {work / taken / 1e9:.0f} | {work / taken / rate:.0%} |")

    print(f"XLA, 1024x1024x1024: {rate / 1e9:.0f} GFLOP/s\n")
    print("| part of an update | ms | GFLOP/s | share of the rate |\n|---|---:|---:|---:|")
    bare = work = 0.0
    for name, (_, _, count) in kinds.items():
        once = 2.0 * BINS * BATCH * WIDTH * (WIDTH if name.startswith("hidden") else SIZE)
        work, bare = work + count * once, bare + count * middle[name]
        line(f"{count} x {name}", count * middle[name], count * once)
    line("**all products, bare**", bare, work)
    for name in own:
        print(f"| {name} | {1e3 * middle[name]:.1f} | | |")
    whole, counted = sum(middle[name] for name in own), flops.nemo(BATCH)
    line("**all parts**", whole, counted)
    print(f"\n{SHARE:.0%} of the rate would be an update in {1e3 * counted / rate / SHARE:.1f} ms. An update's parts take")
    verdict = "kept" if whole <= PROMISE * bare else "missed"
    print(f"{whole / bare:.2f} times what its products take alone; we promise at most {PROMISE:g}: {verdict}.")


if __name__ == "__main__":
    with measuring():
        main()
