"""Worker that times the peers' updates. Started by speed.py with the peer's Python: it never sees our package.

Timed is the body of d3rlpy's own offline loop: sample a batch from its replay buffer, `algo.update(batch)`. Its logger,
its progress bar and its per-step stopwatch are left out, which flatters it a little.
"""

import math
import warnings
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

warnings.filterwarnings("ignore")

import peer_nemo  # noqa: E402
import protocol  # noqa: E402
import torch  # noqa: E402
from d3rlpy.algos import (  # noqa: E402
    AWACConfig,
    BCConfig,
    BCQConfig,
    BEARConfig,
    CQLConfig,
    IQLConfig,
    ReBRACConfig,
    SACConfig,
    TD3PlusBCConfig,
)
from d3rlpy.dataset import MDPDataset  # noqa: E402
from d3rlpy.models.encoders import VectorEncoderFactory  # noqa: E402
from d3rlpy.ope import FQE, FQEConfig  # noqa: E402
from torch.utils.flop_counter import FlopCounterMode  # noqa: E402


def encoder(width: int) -> VectorEncoderFactory:
    return VectorEncoderFactory(hidden_units=[width, width], activation="relu")


def evaluators(opts: dict[str, Any]) -> list[Any]:
    """An FQE for each policy, which is what judging several takes there; the policies are fresh SAC actors."""
    shape, made = ((opts["observation"],), opts["action"]), []
    for _ in range(protocol.POLICIES):
        policy = SACConfig(actor_encoder_factory=encoder(opts["width"])).create(device=False)
        policy.create_impl(*shape)
        settings = FQEConfig(batch_size=opts["batch"], gamma=0.995, learning_rate=3e-4, encoder_factory=encoder(opts["width"]))
        made.append(FQE(policy, settings))
        made[-1].create_impl(*shape)
    return made


def learners(opts: dict[str, Any]) -> list[Any]:
    """What an update updates."""
    if opts["peer"] == "fqe":
        return evaluators(opts)
    algo = config(opts).create(device=False)
    algo.create_impl((opts["observation"],), opts["action"])
    return [algo]


def config(opts: dict[str, Any]) -> Any:
    hidden = encoder(opts["width"])
    if opts["peer"] == "bc":
        return BCConfig(batch_size=opts["batch"], encoder_factory=hidden, policy_type="deterministic")
    common = {"batch_size": opts["batch"], "actor_encoder_factory": hidden, "critic_encoder_factory": hidden}
    if opts["peer"] == "td3_bc":
        return TD3PlusBCConfig(**common, update_actor_interval=2)
    if opts["peer"] == "sac":
        return SACConfig(**common)
    if opts["peer"] == "iql":
        return IQLConfig(**common, value_encoder_factory=hidden)
    if opts["peer"] == "awac":
        return AWACConfig(**common)
    if opts["peer"] == "rebrac":
        layers = [opts["width"]] * 2
        normalised = VectorEncoderFactory(hidden_units=layers, activation="relu", use_layer_norm=True)
        return ReBRACConfig(**common | {"critic_encoder_factory": normalised}, update_actor_interval=2)
    if opts["peer"] == "cql":
        return CQLConfig(**common, n_action_samples=opts["cql_samples"])
    if opts["peer"] == "bcq":
        behaviour = encoder(opts["behaviour_width"])
        return BCQConfig(**common, imitator_encoder_factory=behaviour, n_action_samples=opts["target_samples"])
    return BEARConfig(
        **common,
        imitator_encoder_factory=encoder(opts["behaviour_width"]),
        n_mmd_action_samples=opts["mmd_samples"],
        n_target_samples=opts["target_samples"],
        mmd_kernel="laplacian",
        vae_kl_weight=0.5,
        warmup_steps=0,  # the warm start leaves out the critics under the actor: time the full update
    )


def build(opts: dict[str, Any]) -> tuple[Callable[[int], int], dict[str, Any]]:
    torch.set_num_threads(opts["threads"])
    torch.manual_seed(opts["seed"])
    if opts["peer"] == "nemo":
        return timed(peer_nemo.learner(opts))
    log = protocol.synthetic_log(opts)
    data = MDPDataset(
        log["observations"],
        log["actions"],
        log["rewards"],
        log["terminals"].astype("float32"),
        log["timeouts"].astype("float32"),
    )
    algos = learners(opts)

    def run(updates: int) -> int:
        metrics: dict[str, float] = {}
        for _ in range(updates):
            for i, algo in enumerate(algos):
                found = algo.update(data.sample_transition_batch(opts["batch"]))
                metrics |= {f"{name} {i}": value for name, value in found.items()}
        bad = [name for name, value in metrics.items() if not math.isfinite(value)]
        if bad:
            raise protocol.BenchError(f"d3rlpy's {bad[0]} is not finite")  # its speed would not be the real one
        return updates

    return timed(run)


def timed(run: Callable[[int], int]) -> tuple[Callable[[int], int], dict[str, Any]]:
    """With the operations of an update, counted by torch."""
    run(2)  # optimisers make their state in the first step
    with FlopCounterMode(display=False) as counter:
        run(2)  # two, for the delayed actor
    return run, {"flops": counter.get_total_flops() / 2}


def versions(_: dict[str, Any]) -> dict[str, Any]:
    return {"versions": {name: version(name) for name in ("d3rlpy", "torch", "numpy")}}


if __name__ == "__main__":
    case = protocol.Case(build)
    protocol.serve({"build": case.build, "run": case.run, "versions": versions})
