"""The policies that DOPE published, as ours: pickles of plain arrays, read without running anything in them.

A file holds `fc0/weight`, `fc0/bias`, `fc1/...`, `last_fc/...` and, of policies that draw, `last_fc_log_std/...` (weights are
(outputs, inputs)), the `nonlinearity` between the layers and the `output_distribution`. `tanh_gaussian` policies act with
tanh(mean + exp(log_std) noise), others with mean + exp(log_std) noise. Those without a log_std never draw.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.kinds import Deterministic, Gaussian, TanhGaussian, UnboundedDeterministic
from deadreckon.unpickle import load_pickle


def load_dope(path: Path | str) -> EnvPolicy:
    """Reads one policy file of DOPE (`.pkl`).

    Raises:
        UserError: the file is missing, no pickle of plain arrays, or no such policy.
    """
    found = load_pickle(path)
    if not isinstance(found, dict) or "last_fc/weight" not in found:
        raise UserError(f"{path} holds no policy of DOPE: a dict with last_fc/weight is needed")
    hidden = sorted({int(m[1]) for key in found if (m := re.fullmatch(r"fc(\d+)/weight", str(key)))})
    if hidden != list(range(len(hidden))):
        raise UserError(f"{path}: the layers are fc{', fc'.join(map(str, hidden))}, one is missing")
    names = [f"fc{i}" for i in hidden]
    weights, biases = ([_array(path, found, f"{name}/{part}") for name in names] for part in ("weight", "bias"))
    head = [_array(path, found, f"last_fc/{part}") for part in ("weight", "bias")]
    if "last_fc_log_std/weight" in found:
        spread = [_array(path, found, f"last_fc_log_std/{part}") for part in ("weight", "bias")]
        if [part.shape for part in spread] != [part.shape for part in head]:
            raise UserError(f"{path}: last_fc_log_std has not the shapes of last_fc")
    else:  # one deviation for all states, or none at all
        bias = np.asarray(found.get("log_std", np.full(len(head[1]), -np.inf)), np.float32).reshape(-1)
        spread = [np.zeros_like(head[0]), bias]
    weights.append(np.concatenate([head[0], spread[0]]))
    biases.append(np.concatenate([head[1], spread[1]]))
    check_layers(path, [f"{name}/weight" for name in (*names, "last_fc")], weights, biases)
    activation = _text(found.get("nonlinearity", "relu"))
    net = MLP(
        tuple(jnp.asarray(w.T) for w in weights), tuple(map(jnp.asarray, biases)), "tanh" if activation == "tanh" else "relu"
    )
    squashed = _text(found.get("output_distribution", "")) == "tanh_gaussian"
    size = len(head[1])
    if np.isneginf(biases[-1][size:]).all():  # it never draws
        only = MLP((*net.weights[:-1], net.weights[-1][:, :size]), (*net.biases[:-1], net.biases[-1][:size]), net.activation)
        if not squashed:
            return EnvPolicy(UnboundedDeterministic(only), None, None, None, None)
        return EnvPolicy(Deterministic(only), None, None, -jnp.ones(size), jnp.ones(size))
    if squashed:  # with deviations as they were published, which are not clipped
        return EnvPolicy(TanhGaussian(net, (-20.0, 20.0)), None, None, -jnp.ones(size), jnp.ones(size))
    return EnvPolicy(Gaussian(net), None, None, None, None)


def check_layers(path: Path | str, names: Sequence[str], weights: Sequence[np.ndarray], biases: Sequence[np.ndarray]) -> None:
    """Refuses layers that do not fit together.

    Args:
        path: of their file, for the error.
        names: of the weights.
        weights: (outputs, inputs) of each layer.
        biases: (outputs,).
    """
    for name, w, b, inputs in zip(names, weights, biases, [None, *(len(b) for b in biases)]):
        if w.ndim != 2 or b.shape != w.shape[:1] or (inputs is not None and w.shape[1] != inputs):
            raise UserError(f"{path}: {name} has shape {w.shape}, which does not fit its bias and the layer before it")


def array_of(path: Path | str, found: Mapping[Any, Any], key: str) -> np.ndarray:
    """An array among the values of a file.

    Raises:
        UserError: there is none under that key.
    """
    if not isinstance(found.get(key), np.ndarray):
        raise UserError(f"{path}: no array {key}")
    return found[key]


def _array(path: Path | str, found: Mapping[Any, Any], key: str) -> np.ndarray:
    return np.asarray(array_of(path, found, key), np.float32)


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)
