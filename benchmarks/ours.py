"""The one place where the speed harness meets our API."""

import time
from collections.abc import Callable
from statistics import fmean
from typing import Any

import flops
import jax
import jax.numpy as jnp
import numpy as np
import protocol

from deadreckon.agents import agent_class
from deadreckon.data.batch import Batch, TransitionSource
from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.mbo.design_source import DesignSource
from deadreckon.mbo.designer import DesignInput
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.nemo import NEMO
from deadreckon.mbo.variables import Variable
from deadreckon.nets.mlp import MLP
from deadreckon.ope.case import OPEInput
from deadreckon.ope.fqe import FQE
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.kinds import TanhGaussian
from deadreckon.training.fit import Fit

CHUNK = 100  # updates between two looks from outside; a run makes whole chunks


def make_ours(agent_name: str, options: dict[str, Any]) -> Callable[[int], int]:
    """A callable `run(n_updates)` that makes at least so many updates, blocks until they are done and says how many.

    It walks the chunks that `deadreckon train` walks, with the log on the device, metrics and the check for bad numbers.
    """
    if agent_name not in protocol.CASES:
        raise protocol.BenchError(f"unknown case {agent_name!r}: choose from {', '.join(protocol.CASES)}")
    if options["peer"] == "nemo":
        return _nemo(options)
    log = Dataset.from_arrays(**protocol.synthetic_log(options))
    if options["peer"] == "fqe":
        return _fqe(log, options)
    fields: dict[str, Any] = {"hidden": (options["width"],) * 2, "batch_size": options["batch"]}
    if options["peer"] == "cql":
        fields |= {"samples": options["cql_samples"]}
    if options["peer"] == "bcq":
        fields |= {"behavior_hidden": (options["behaviour_width"],) * 2, "samples": options["target_samples"]}
    if options["peer"] == "bear":
        fields |= {
            "behavior": options["behaviour"], "behavior_hidden": (options["behaviour_width"],) * 2, "warm_start": 0,
            "policy_samples": options["mmd_samples"], "behavior_samples": options["mmd_samples"],
            "target_samples": options["target_samples"],
        }  # fmt: skip
    agent = agent_class(agent_name.split("-")[0])(**fields).resolve(log.spec, 10**9)
    rows = TransitionSource(log, agent.needs(log.spec))
    return _walker(agent, rows, ", ".join(f"{k} {v}" for k, v in fields.items()), options)


def _fqe(log: Dataset, options: dict[str, Any]) -> Callable[[int], int]:
    """The critics of all policies, one each; what the policies do at the log's rows is asked once, and timed apart."""
    view = Normalizer.of(log.spec)
    shape = (options["observation"], (options["width"],) * 2, 2 * options["action"])
    nets = [MLP.create(*shape, jax.random.key(i)) for i in range(protocol.POLICIES)]
    estimator = FQE(members=1, hidden=(options["width"],) * 2, batch_size=options["batch"])
    start = time.perf_counter()
    learner, rows = estimator.problem(OPEInput(log, [EnvPolicy.of(TanhGaussian(net), view) for net in nets]))
    asked = time.perf_counter() - start
    settings = f"{protocol.POLICIES} policies, a critic each; the policies' actions at all rows took {asked:.1f} s, once"
    return _walker(learner, rows, settings, options)


def _nemo(options: dict[str, Any]) -> Callable[[int], int]:
    """Models and designs by turns, from the first update on."""
    x, y = protocol.synthetic_designs(options)
    data = Designs.from_arrays(x, y, [Variable(f"x{i}") for i in range(x.shape[1])])
    fields = {"bins": protocol.NEMO["bins"], "hidden": (options["width"],) * 2, "batch_size": options["batch"]}
    designer = NEMO(**fields, pretrain=0, model_updates=1, lr=0.005)
    nothing = lambda what, step, steps: None  # noqa: E731
    learner = designer.training(DesignInput(data, protocol.NEMO["designs"], [0], None, nothing))
    settings = ", ".join(f"{k} {v}" for k, v in fields.items())
    # Designs rise in every update, which a condition decides: the branch that does more is the one taken.
    return _walker(learner, DesignSource(data, learner.needs(data.coordinates)), settings, options, max)


def _walker(
    learner: Any, rows: Any, settings: str, options: dict[str, Any], branches: Callable[[list[float]], float] = fmean
) -> Callable[[int], int]:
    walk = Fit([learner], rows, [options["seed"]], 10**9, chunk=CHUNK).chunks()

    def run(n_updates: int) -> int:
        done = 0
        while done < n_updates:
            jax.block_until_ready(next(walk).states)
            done += CHUNK
        return done

    columns = rows.take(np.arange(options["batch"]))
    own = rows.extra if isinstance(rows, TransitionSource) else list(columns)
    extra = {name: jnp.asarray(columns.pop(name)) for name in own}
    batch = Batch(**{name: jnp.asarray(column) for name, column in columns.items()}, extra=extra or None)
    state = learner.init(rows.spec, jax.random.key(0))
    update = lambda s, b: learner.update(s, b, step=jnp.int32(0), key=jax.random.key(0))  # noqa: E731
    run.flops = flops.of_program(update, state, batch, branches=branches)  # type: ignore[attr-defined]
    run.settings = settings  # type: ignore[attr-defined]
    return run
