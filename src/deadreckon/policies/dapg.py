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
    weights, biases = ([_array(path, layer, part).astype(np.float64) for layer in layers] for part in ("weight", "bias"))
    for number, (w, b, inputs) in enumerate(zip(weights, biases, [None, *(len(b) for b in biases)])):
        if w.ndim != 2 or b.shape != w.shape[:1] or (inputs is not None and w.shape[1] != inputs):
            raise UserError(f"{path}: layer {number} has weights {w.shape}, which do not fit its bias and the layer before it")
    shift, scale = _array(path, model, "out_shift"), _array(path, model, "out_scale")
    log_std = _array(path, found, "log_std")
    weights[-1], biases[-1] = scale[:, None] * weights[-1], scale * biases[-1] + shift
    net = MLP(tuple(_single(w.T) for w in weights), tuple(map(_single, biases)), "tanh")
    mean, std = _array(path, model, "in_shift"), _array(path, model, "in_scale") + 1e-8  # as mjrl divides
    return EnvPolicy(Gaussian.of(net, _single(log_std)), _single(mean), _single(std), None, None)


def _single(value: np.ndarray) -> Any:
    return jnp.asarray(np.asarray(value, np.float32))


def _array(path: Path | str, found: dict[str, Any], key: str) -> np.ndarray:
    if not isinstance(found.get(key), np.ndarray):
        raise UserError(f"{path}: no array {key}")
    return found[key]
