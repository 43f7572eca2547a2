"""The policies that DAPG's authors published (Rajeswaran et al. 2018), as ours: pickles of torch's layers, read without torch.

A file holds a network with tanh between its layers, shifts and scales of observations and actions, and one log-deviation an
action: a = mean(s) + exp(log_std) noise, which the environment clips.
"""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.dope import array_of, check_layers
from deadreckon.policies.kinds import Gaussian
from deadreckon.policies.torch_pickle import load_network


def load_dapg(path: Path | str) -> EnvPolicy:
    """Reads one policy file of DAPG, such as `door-v0.pickle`.

    Raises:
        UserError: the file is missing, holds something else, or is damaged.
    """
    found = load_network(path)
    model = found.get("model") if isinstance(found, dict) else None
    if not isinstance(model, dict) or "log_std" not in found or "fc_layers" not in model.get("_modules", {}):
        raise UserError(f"{path}: no policy of DAPG in it; mjrl's MLP, with model and log_std, is needed")
    if model.get("nonlinearity") != "tanh":
        raise UserError(f"{path}: tanh is needed between the layers, found {model.get('nonlinearity')!r}")
    layers = [layer["_parameters"] for layer in model["_modules"]["fc_layers"]["_modules"].values()]
    weights, biases = ([array_of(path, layer, part).astype(np.float64) for layer in layers] for part in ("weight", "bias"))
    check_layers(path, [f"the weight of layer {number}" for number in range(len(layers))], weights, biases)
    shift, scale = array_of(path, model, "out_shift"), array_of(path, model, "out_scale")
    log_std = array_of(path, found, "log_std")
    weights[-1], biases[-1] = scale[:, None] * weights[-1], scale * biases[-1] + shift
    net = MLP(tuple(_single(w.T) for w in weights), tuple(map(_single, biases)), "tanh")
    mean, std = array_of(path, model, "in_shift"), array_of(path, model, "in_scale") + 1e-8  # as mjrl divides
    return EnvPolicy(Gaussian.of(net, _single(log_std)), _single(mean), _single(std), None, None)


def _single(value: np.ndarray) -> Any:
    return jnp.asarray(np.asarray(value, np.float32))
