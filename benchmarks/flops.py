"""Floating-point operations of one update, counted by hand from the layers; and two ways to check the hand.

Only matrix products count (a product of b x i with i x o is 2 b i o): everything else is linear in the activations.
A pass through an MLP costs, with F its forward products:

    forward         F
    weight gradient F                          only where the network is trained
    input gradient  F without the first layer  the first layer's input is data, so nobody needs its gradient, except the
                                               columns (`into`) that another network made: actions, latents

so training is 3 F less the first layer's last part, and a pass for the input's gradient alone 2 F less the same.

`needed` counts what the algorithm needs and no more: the states' part of a first layer is computed once for all actions
sampled there, critics under an actor get no weight gradients. A program that does more gets no credit for it: the share
of the machine's rate divides these counts by time.

`peer` counts what d3rlpy 2.8.1 does; it equals torch's own counter (`peer_d3rlpy.py` reports that one too).
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import fmean
from typing import Any

from protocol import NEMO, POLICIES


def products(dims: Sequence[int]) -> int:
    return sum(i * o for i, o in pairwise(dims))


def forward(b: int, dims: Sequence[int]) -> int:
    return 2 * b * products(dims)


def forward_many(b: int, n: int, shared: int, dims: Sequence[int]) -> int:
    """`n` inputs a row that have their first `shared` columns in common: that part of the first layer is done once."""
    return forward(b, [shared, dims[1]]) + n * b * 2 * ((dims[0] - shared) * dims[1] + products(dims[1:]))


def input_gradient(b: int, dims: Sequence[int], into: int = 0) -> int:
    return 2 * b * (into * dims[1] + products(dims[1:]))


def train(b: int, dims: Sequence[int], into: int = 0) -> int:
    return 2 * forward(b, dims) + input_gradient(b, dims, into)


def through(b: int, dims: Sequence[int], into: int) -> int:
    """Forward and the input's gradient: a critic under an actor."""
    return forward(b, dims) + input_gradient(b, dims, into)


def train_many(b: int, n: int, shared: int, dims: Sequence[int]) -> int:
    """Training on `n` inputs a row as `forward_many` has them; nobody needs the inputs' own gradient."""
    return 2 * forward_many(b, n, shared, dims) + n * b * 2 * products(dims[1:])


def networks(opts: dict[str, Any]) -> dict[str, list[int]]:
    o, a, h, v = opts["observation"], opts["action"], opts["width"], opts["behaviour_width"]
    return {
        "actor": [o, h, h, a],  # deterministic
        "gaussian": [o, h, h, 2 * a],  # mean and log-std
        "critic": [o + a, h, h, 1],
        "value": [o, h, h, 1],
        "mover": [o + a, h, h, a],  # BCQ's
        "behaviour": [o, v, v, 2 * a],
        "encoder": [o + a, v, v, 4 * a],  # latent 2 a: mean and log-std
        "decoder": [o + 2 * a, v, v, a],
    }


def needed(opts: dict[str, Any]) -> float:
    """An update as the algorithm needs it; a mean where updates differ (TD3's delayed actor)."""
    b, o, a, net = opts["batch"], opts["observation"], opts["action"], networks(opts)
    case = opts["peer"]
    if case == "bc":
        return train(b, net["actor"])
    if case == "fqe":  # what the policies do is looked up
        return POLICIES * (forward(b, net["critic"]) + train(b, net["critic"]))
    if case == "nemo":
        return nemo(b)
    critics = 2 * train(b, net["critic"])
    if case in ("td3_bc", "rebrac"):
        target = forward(b, net["actor"]) + 2 * forward(b, net["critic"])
        valued_by = {"td3_bc": 1, "rebrac": 2}[case]  # critics under the actor
        actor = train(b, net["actor"]) + valued_by * through(b, net["critic"], a)
        return target + critics + actor / 2  # every other update
    # Of IQL and AWAC the actor's deviation is a parameter.
    if case == "iql":  # target critics at the logged action, V before its step, after it, and at s'
        values = 2 * forward(b, net["critic"]) + train(b, net["value"]) + 2 * forward(b, net["value"])
        return values + critics + train(b, net["actor"])
    if case == "awac":  # critics at the logged action and at a drawn one, after their step
        target = forward(b, net["actor"]) + 2 * forward(b, net["critic"])
        return target + critics + 4 * forward(b, net["critic"]) + train(b, net["actor"])
    if case == "bcq":
        n = opts["target_samples"]
        behaviour = train(b, net["encoder"]) + train(b, net["decoder"], 2 * a)
        made = forward_many(b, n, o, net["decoder"]) + forward_many(b, n, o, net["mover"])
        target = made + 2 * forward_many(b, n, o, net["critic"])
        mover = forward(b, net["decoder"]) + train(b, net["mover"]) + through(b, net["critic"], a)
        return behaviour + target + critics + mover
    # SAC and BEAR: one sampled action goes through both critics.
    actor = train(b, net["gaussian"]) + 2 * through(b, net["critic"], a)
    if case in ("sac", "cql"):
        # The actions that CQL holds down come from the passes of the actor that are made anyway.
        held = 2 * train_many(b, 3 * opts["cql_samples"], o, net["critic"]) if case == "cql" else 0
        target = forward(b, net["gaussian"]) + 2 * forward(b, net["critic"])
        return target + critics + held + actor
    target = forward(b, net["gaussian"]) + 2 * forward_many(b, opts["target_samples"], o, net["critic"])
    # The actor's head is evaluated once; its MMD samples are noise around it. The behaviour model is trained at every
    # update, then sampled as it is afterwards.
    if opts["behaviour"] == "gaussian":
        behaviour = train(b, net["behaviour"]) + forward(b, net["behaviour"])
    else:
        behaviour = train(b, net["encoder"]) + train(b, net["decoder"], 2 * a)
        behaviour += forward_many(b, opts["mmd_samples"], o, net["decoder"])
    return target + critics + actor + behaviour


def nemo(b: int) -> float:
    """Every model learns from a batch and a claimed design; designs go up the mean of the slow copies."""
    dims = [NEMO["size"], NEMO["width"], NEMO["width"], 1]
    return NEMO["bins"] * (train(b, dims) + train(1, dims) + through(NEMO["designs"], dims, NEMO["size"]))


def peer(opts: dict[str, Any]) -> float:
    """An update of d3rlpy 2.8.1, with the work it could have left out; of NEMO in PyTorch, the same as ours."""
    b, o, a, net = opts["batch"], opts["observation"], opts["action"], networks(opts)
    case = opts["peer"]
    if case == "nemo":
        return nemo(b)
    if case == "bc":
        return train(b, net["actor"])
    if case == "fqe":  # the policy is SAC's, of which the mean is taken and the deviation computed too
        return POLICIES * (forward(b, net["gaussian"]) + forward(b, net["critic"]) + train(b, net["critic"]))
    critics = 2 * train(b, net["critic"])
    # Critics under the actor get weight gradients and gradients for the states too, and TD3+BC runs both to use one.
    under_actor = 2 * train(b, net["critic"], o + a)
    if case in ("td3_bc", "rebrac"):
        target = forward(b, net["actor"]) + 2 * forward(b, net["critic"])
        return target + critics + (train(b, net["actor"]) + under_actor) / 2
    if case == "iql":  # the deviation is a parameter; target critics are asked twice
        values = 4 * forward(b, net["critic"]) + train(b, net["value"]) + 2 * forward(b, net["value"])
        return values + critics + train(b, net["actor"])
    if case == "awac":
        target = forward(b, net["actor"]) + 2 * forward(b, net["critic"])
        weights = forward(b, net["actor"]) + 4 * forward(b, net["critic"])
        return target + critics + weights + train(b, net["actor"])
    if case == "bcq":  # the mover's gradient runs on through the decoder
        n = opts["target_samples"]
        made = forward(n * b, net["decoder"]) + forward(n * b, net["mover"])
        target = made + 2 * forward(n * b, net["critic"])
        vae = train(b, net["encoder"]) + train(b, net["decoder"], o + 2 * a)
        mover = train(b, net["decoder"]) + train(b, net["mover"], o + a) + under_actor
        return vae + target + critics + mover
    actor = train(b, net["gaussian"]) + under_actor
    if case == "sac":
        return forward(b, net["gaussian"]) + 2 * forward(b, net["critic"]) + critics + actor
    if case == "cql":  # the actor runs for the target, twice for the penalty and once for itself; critics three times for 10
        target = forward(b, net["gaussian"]) + 2 * forward(b, net["critic"])
        held = 2 * forward(b, net["gaussian"]) + 6 * train(opts["cql_samples"] * b, net["critic"])
        return target + critics + held + 2 * train(b, net["critic"]) + actor
    target = forward(b, net["gaussian"]) + 2 * forward(opts["target_samples"] * b, net["critic"])
    vae = train(b, net["encoder"]) + train(b, net["decoder"], o + 2 * a)
    vae += forward(opts["mmd_samples"] * b, net["decoder"])
    # The MMD evaluates the actor again, and the multiplier's loss runs back through that evaluation once more.
    mmd = 2 * train(b, net["gaussian"]) - forward(b, net["gaussian"])
    return target + critics + actor + vae + mmd


def of_program(function: Callable[..., Any], *arguments: Any, branches: Callable[[list[float]], float] = fmean) -> float:
    """Matrix-product operations in a JAX function, from its jaxpr: what our program says it does.

    `branches` of a `cond` count with their mean (right for an actor that moves every other update), the body of a `while`
    once. Before XLA removes dead code, so an upper bound.
    """
    import jax

    return _count(jax.make_jaxpr(function)(*arguments).jaxpr, branches)


def _count(jaxpr: Any, branches: Callable[[list[float]], float]) -> float:
    total = 0.0
    for equation in jaxpr.eqns:
        name, params = equation.primitive.name, equation.params
        if name == "dot_general":
            left = equation.invars[0].aval.shape
            (contracted, _), _ = params["dimension_numbers"]
            depth = 1
            for axis in contracted:
                depth *= left[axis]
            total += 2 * depth * equation.outvars[0].aval.size
        elif name == "cond":
            total += branches([_count(branch.jaxpr, branches) for branch in params["branches"]])
        else:
            values = [p for value in params.values() for p in (value if isinstance(value, tuple | list) else [value])]
            inner = [getattr(value, "jaxpr", value) for value in values]  # closed jaxprs wrap open ones
            repeats = params["length"] if name == "scan" else 1
            total += repeats * sum(_count(value, branches) for value in inner if hasattr(value, "eqns"))
    return total
