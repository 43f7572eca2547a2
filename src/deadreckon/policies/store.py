"""Policies to files and back; the format is that of `policies.portable`."""

import dataclasses
import json
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from deadreckon.errors import UserError, reading
from deadreckon.files import replacing
from deadreckon.nets.encoder import Encoder
from deadreckon.nets.layer_norm_mlp import LayerNormMLP
from deadreckon.nets.mlp import MLP
from deadreckon.nets.transformer import Block, Transformer
from deadreckon.nets.vae import VAE
from deadreckon.policies import candidates, planner, portable  # noqa: F401 - kinds of policy register themselves
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.file import read_policy
from deadreckon.policies.policy import KINDS
from deadreckon.policies.sequence import DecisionTransformerNet
from deadreckon.policies.whole import check_whole

_TAUGHT, _HELD = "taught", "held"  # arrays beside those of the policy, which all start with `policy.`
_EXACT = ("mean", "std", "low", "high")  # the coordinates of a `EnvPolicy`
# Beside the policies that register themselves (`policy.KINDS`) the only classes that a file can name: reading one runs no code
# of the file's choosing.
_CLASSES = EnvPolicy, MLP, LayerNormMLP, VAE, Encoder, Transformer, Block, DecisionTransformerNet
_PARTS: dict[str, Any] = {part.__name__: part for part in _CLASSES}


def save(
    path: Path | str,
    policy: EnvPolicy,
    meta: dict[str, Any] | None = None,
    *,
    half: bool = False,
    taught: np.ndarray | None = None,
    held: np.ndarray | None = None,
) -> None:
    """Writes a policy as arrays and JSON, atomically.

    Args:
        path: ends in `.npz`.
        policy: as an agent gives it.
        meta: JSON values to keep beside it (agent, data, scores, ...).
        half: store the networks as float16 and compress them, a third of the size; read back, they are float32 again.
        taught: (episodes,) uint64 `episode_ids` of its training episodes; None if they are not known.
        held: (episodes,) uint64 `episode_ids` of the other episodes of its log; None where that is not known.

    Raises:
        UserError: a number is beyond float16, or the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}

    def encode(value: Any, name: str) -> Any:
        if dataclasses.is_dataclass(value):
            fields = {f.name: encode(getattr(value, f.name), f"{name}.{f.name}") for f in dataclasses.fields(value)}
            return {"kind": type(value).__name__, **fields}
        if isinstance(value, tuple):
            return [encode(v, f"{name}.{i}") for i, v in enumerate(value)]
        if hasattr(value, "shape"):
            with np.errstate(over="ignore"):
                # Single numbers stay as they are, and so do the coordinates of a mixture's members.
                exact = value.ndim == 0 or name.rpartition(".")[2] in _EXACT
                small = half and name.startswith("policy.inner.") and not exact
                arrays[name] = np.asarray(value, np.float16 if small else None)
            if np.isfinite(np.asarray(value)).all() and not np.isfinite(arrays[name]).all():
                raise UserError(f"{path}: {name} holds numbers beyond float16; save it with half=False")
            return f"@{name}"
        return value

    tree = {"format": portable.FORMAT, "meta": meta or {}, "policy": encode(policy, "policy")}
    text = np.frombuffer(json.dumps(tree).encode(), np.uint8)
    noted = {name: np.asarray(ids, np.uint64) for name, ids in ((_TAUGHT, taught), (_HELD, held)) if ids is not None}
    with replacing(path) as temporary, open(temporary, "wb") as file:
        write = np.savez_compressed if half else np.savez
        write(file, **{"policy.json": text}, **arrays, **noted)  # pyrefly: ignore[bad-argument-type] - see `save_arrays`


class Saved(NamedTuple):
    """What a policy file holds.

    Attributes:
        policy: the policy.
        meta: the JSON values beside it.
        taught, held: see `save`.
    """

    policy: EnvPolicy
    meta: dict[str, Any]
    taught: np.ndarray | None
    held: np.ndarray | None


def load(path: Path | str) -> EnvPolicy:
    """Reads the policy of a file.

    Raises:
        UserError: the file is missing, broken or not a policy file.
    """
    return load_all(path).policy


def load_all(path: Path | str) -> Saved:
    """Reads a policy file.

    Raises:
        UserError: the file is missing, broken or not a policy file.
    """
    tree, arrays = read_policy(path)

    def decode(value: Any) -> Any:
        if isinstance(value, dict):
            kind = str(value.get("kind"))
            make = _PARTS.get(kind) or KINDS.get(kind)
            if make is None:
                raise UserError(f"{path} names an unknown kind of policy {kind!r}")
            return make(**{k: decode(v) for k, v in value.items() if k != "kind"})
        if isinstance(value, list):
            return tuple(decode(v) for v in value)
        if isinstance(value, str) and value.startswith("@"):
            return jax.device_put(arrays[value[1:]])
        return value

    with reading(path, "a policy file"):
        policy = decode(tree["policy"])
    if not isinstance(policy, EnvPolicy):
        raise UserError(f"{path} does not hold a policy")
    check_whole(path, policy)
    return Saved(policy, tree["meta"], arrays.get(_TAUGHT), arrays.get(_HELD))


def meta(path: Path | str) -> dict[str, Any]:
    """The JSON values kept beside a saved policy."""
    return read_policy(path)[0]["meta"]
