"""What a policy file holds, read without JAX: its JSON tree and its arrays."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NotRequired, TypedDict, TypeVar

import numpy as np

from deadreckon.errors import UserError, as_one_line, reading
from deadreckon.foreign.archive import read_arrays
from deadreckon.foreign.shapes import checked, wrong
from deadreckon.foreign.text import parse_json
from deadreckon.policies import portable
from deadreckon.policies.log_values import LogValues, check_log
from deadreckon.policies.table_predict import Predictor

P = TypeVar("P", bound=Predictor)

_NUMBER = 1_000_000  # any whole number
_PICTURE = 20_000_000  # numbers of a picture
ROWS = (2, 3)  # of observations that a policy is tried on: a layer may take one number of them alone
_POLICIES = 1_000  # in a file, of mixtures and what is around others


class _Policy(TypedDict):
    kind: str
    inner: dict[str, Any]


class _Tree(TypedDict):
    format: int
    policy: _Policy
    meta: NotRequired["_Meta"]


class _Meta(TypedDict):
    log: NotRequired[LogValues | None]
    by: NotRequired[str]


def read_policy(path: Path | str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The JSON tree of a policy file, which has a `meta` (empty where the file has none), and its arrays.

    Raises:
        UserError: the file is missing, broken or not a policy file.
    """
    arrays = read_arrays(path, "a policy file")
    if (text := arrays.get("policy.json")) is not None:
        told = checked(parse_json(path, text.tobytes()), _Tree, path)
        own = [array for name, array in arrays.items() if name.startswith("policy.") and name != "policy.json"]
        _check_numbers(path, told, own)
        check_log(path, told.get("meta", {}).get("log") or {})
    with reading(path, "a policy file"):
        tree, rest = portable.tree_of(arrays)
    known = {key: value for key, value in tree.get("meta", {}).items() if key != "log" or value is not None}
    return tree | {"meta": known}, rest


def _check_numbers(path: Path | str, tree: dict[str, Any], arrays: Iterable[np.ndarray]) -> None:
    """Refuses numbers by which few bytes would ask for more memory or time than policies of this package take."""
    widest = max(
        (size for array in arrays if array.size for size in array.shape), default=1
    )  # of what a network takes or gives
    nodes, policies = [("policy", tree["policy"])], 0
    while nodes:
        name, node = nodes.pop()
        if type(node) is int:
            _whole(path, name, node, _NUMBER, least=-_NUMBER)
        elif isinstance(node, list):
            nodes += [(f"{name}.{i}", part) for i, part in enumerate(node)]
        elif isinstance(node, dict):
            if node.get("kind") == "EnvPolicy" and (policies := policies + 1) > _POLICIES:
                raise UserError(f"{path}: it is made of more than {_POLICIES:,} policies, which no mixture needs")
            if node.get("kind") == "History":
                steps, size, actions = (node.get(key, 1) for key in ("steps", "observation_size", "action_size"))
                for key, value in (("steps", steps), ("observation_size", size), ("action_size", actions)):
                    _whole(path, f"{name}.{key}", value, widest)
                _whole(path, f"{name}: the size of its histories", steps * size + (steps - 1) * actions, widest)
            if node.get("kind") == "Encoder" and isinstance(shape := node.get("shape"), list):
                for size in shape:
                    _whole(path, f"{name}.shape", size, _NUMBER)
                _whole(path, f"{name}.shape: the numbers of an image", math.prod(shape), _PICTURE)
            nodes += [(f"{name}.{key}", part) for key, part in node.items()]


def _whole(path: Path | str, name: str, value: Any, most: int, least: int = 1) -> None:
    if type(value) is not int or not least <= value <= most:
        raise wrong(path, name[:200], f"a whole number from {least:,} to {most:,}", value)


def numpy_player(path: Path | str, tree: dict[str, Any], arrays: dict[str, np.ndarray]) -> portable.NumpyPolicy | None:
    """The policy of a file by numpy alone, which has acted once; None of a kind that numpy alone does not play.

    Args:
        path: of the file, for errors.
        tree: see `read_policy`.
        arrays: see there.

    Raises:
        UserError: its parts are of wrong kinds or do not fit together.
    """
    with reading(path, "a policy file"):
        if portable.unknown_kind(tree["policy"]) is not None:
            return None
        player, inner = portable.NumpyPolicy(tree, arrays), tree["policy"]["inner"]
        parts = portable.parts_of(inner)
    for part in parts:
        numpy_player(path, {"policy": part}, arrays)
    if inner["kind"] == "Seeing":
        with reading(path, "a policy file"):
            _try(player, inner["encoder"]["shape"], np.uint8)
    if parts:
        return player
    with reading(path, "a policy file"):
        mean = tree["policy"].get("mean")
        layers = [array.shape[-2:] for array in arrays.values() if array.ndim >= 2]
        sizes = observation_sizes(layers) if mean is None else [arrays[mean[1:]].shape[-1]]
    error = None
    for size in sizes:
        try:
            with np.errstate(all="ignore"):
                _try(player, (size,), np.float32)
        except Exception as found:  # noqa: BLE001 - whatever wrong parts make numpy raise
            error = error or found
        else:
            return player
    raise UserError(f"{path}: the parts of its policy do not fit together ({as_one_line(error or ValueError('no networks'))})")


def _try(play: Callable[[np.ndarray], np.ndarray], shape: Iterable[int], kind: Any) -> None:
    """Acts on different numbers of observations, since a layer may fit one number alone; on ones, so that all is legal."""
    for rows in ROWS:
        if (actions := len(play(np.ones((rows, *shape), kind)))) != rows:
            raise ValueError(f"{rows} observations give {actions} actions")


def observation_sizes(layers: Iterable[tuple[int, int]]) -> list[int]:
    """What an observation of a policy without a mean may measure, by (inputs, outputs) of its networks, or of all their layers.

    A network takes the observation alone, or beside an action, or noise, as wide as what another one gives.
    """
    inputs, outputs = zip(*layers) if (layers := list(layers)) else ((), ())
    return [size for size in dict.fromkeys(taken - beside for beside in (0, *outputs) for taken in inputs) if size > 0]


def fitting(path: Path | str, predictor: P) -> P:
    """What takes rows by the columns of a log, which its policy fits.

    Args:
        path: of the file, for errors.
        predictor: made of it.

    Raises:
        UserError: the policy takes other observations, or gives other actions, than its file says of the log.
    """
    with reading(path, "a policy file"):
        if found := predictor.misfit():
            raise UserError(f"{path}: its policy is not of its log: {found}")
    return predictor
