"""Gymnasium's spaces as tasks have them: observations as vectors, actions as bounded vectors or as numbers 0 .. n-1."""

import copy
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces

from deadreckon.data.formats.flatten import MOST_JOINED, MOST_NUMBERS, bounds
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError

PICTURE = 32  # pixels: uint8 observations of this height and width or more are pictures, which keep their shape

ROUNDED = 1e-6  # of an action's size or range, by which 32 bits may be beyond a bound

DISCRETE = spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary
_LEAVES = spaces.Box, *DISCRETE
_READ = "Box, Discrete, MultiBinary, MultiDiscrete, and Dict and Tuple of these are taken"


@dataclass(frozen=True)
class Spaces:
    """Between an environment of Gymnasium and a task.

    Attributes:
        observed: space of the observations that are taken: the environment's, without texts.
        acted: space of the environment's actions.
        shape: of one observation of the task.
        dtype: of observations of the task, uint8 of pictures and float32 of all others.
        actions: of the task.
        choices: what the environment takes for each discrete action; empty where actions are continuous.
        left_out: names of texts in observations, which are not taken.
    """

    observed: spaces.Space
    acted: spaces.Space
    shape: tuple[int, ...]
    dtype: str
    actions: Box | Discrete
    choices: tuple[Any, ...]
    left_out: tuple[str, ...]

    @classmethod
    def of(cls, env: Any, name: str) -> "Spaces":
        """Those of an environment; `name` is for errors.

        Raises:
            UserError: a space that is no vector of fixed size, an image of another form than (height, width, channels), or
                actions without finite bounds.
        """
        left_out: list[str] = []
        observed = _numeric(env.observation_space, f"{name}: the observation", left_out)
        if (count := spaces.flatdim(observed)) > MOST_NUMBERS:
            raise UserError(f"{name}: an observation has {count:,} numbers, at most {MOST_NUMBERS:,} are taken")
        pixels = tuple(observed.shape or ()) if isinstance(observed, spaces.Box) and observed.dtype == np.uint8 else ()
        picture = len(pixels) == 3 and min(pixels[:2]) >= PICTURE
        if not picture and sum(size >= PICTURE for size in pixels) > 1:  # several pictures, or one of another form
            how = "put its channels last (gymnasium.wrappers.TransformObservation, numpy.moveaxis)"
            if len(pixels) == 2:
                how = "give it channels (gymnasium.wrappers.GrayscaleObservation with keep_dim=True, or ReshapeObservation)"
            raise UserError(f"{name}: an observation of {pixels} is no image of (height, width, channels); {how}")
        shape, dtype = (pixels, "uint8") if picture else ((count,), "float32")
        actions, choices = _actions(env.action_space, name)
        return cls(observed, env.action_space, shape, dtype, actions, choices, tuple(left_out))

    def observe(self, observation: Any) -> np.ndarray:
        """`dtype` of `shape`: as `gymnasium.spaces.flatten` gives it, so that discrete ones are one-hot."""
        if isinstance(self.observed, spaces.Box):
            return np.asarray(observation, self.dtype).reshape(self.shape)
        return np.asarray(spaces.flatten(self.observed, _kept(self.observed, observation)), np.float32)

    def act(self, action: np.ndarray) -> Any:
        """What the environment takes for (size,) continuous actions, or for the number of a discrete one."""
        if self.choices:
            return copy.deepcopy(self.choices[int(action)])  # an environment may change its action in place
        flat = self._flat
        action = _within(action.reshape(flat.shape).astype(flat.dtype), flat.low, flat.high)
        return action if flat is self.acted else spaces.unflatten(self.acted, action)

    @cached_property
    def _flat(self) -> spaces.Box:
        """Of continuous actions the space as one box."""
        return _one_box(self.acted)


def _within(action: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Actions, where those that lie beyond the bounds by rounding alone lie on them."""
    inside = np.clip(action, low, high)
    return np.where(np.abs(action - inside) <= ROUNDED * np.maximum(np.abs(inside), high - low), inside, action)


def _numeric(space: Any, name: str, left_out: list[str]) -> spaces.Space:
    """The space without the texts in its dicts, whose names are added to `left_out`.

    Raises:
        UserError: something else that is not numbers, or nothing but texts.
    """
    if isinstance(space, spaces.Dict):
        parts: dict[str, spaces.Space] = {}
        for key, inner in space.spaces.items():
            if isinstance(inner, spaces.Text) or isinstance(inner.sample(), str):
                left_out.append(str(key))
            else:
                parts[key] = _numeric(inner, f"{name}/{key}", left_out)
        if parts:
            return spaces.Dict(list(parts.items()))  # of a dictionary it would sort the names
    if isinstance(space, spaces.Tuple):
        return spaces.Tuple([_numeric(inner, f"{name}/{i}", left_out) for i, inner in enumerate(space.spaces)])
    if not isinstance(space, _LEAVES):
        raise UserError(f"{name} is {type(space).__name__}, which is no vector of fixed size; {_READ}")
    return space


def _kept(space: spaces.Space, value: Any) -> Any:
    """Of an observation what stands in the space."""
    if isinstance(space, spaces.Dict):
        return {key: _kept(inner, value[key]) for key, inner in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(_kept(inner, each) for inner, each in zip(space.spaces, value))
    return value


def _leaves(space: Any) -> list[Any]:
    if isinstance(space, spaces.Dict | spaces.Tuple):
        inner = space.spaces.values() if isinstance(space.spaces, Mapping) else space.spaces
        return [leaf for each in inner for leaf in _leaves(each)]
    return [space]


def _actions(space: Any, name: str) -> tuple[Box | Discrete, tuple[Any, ...]]:
    """The task's action space, and what the environment takes for each discrete action.

    Raises:
        UserError: neither all continuous and bounded, nor all discrete, or too many combinations.
    """
    leaves = _leaves(space)
    if all(isinstance(leaf, spaces.Box) and np.issubdtype(leaf.dtype, np.floating) for leaf in leaves):
        found = bounds(_one_box(space))
        if found is None:
            infinite = "actions have infinite bounds; give them some by gymnasium.wrappers.RescaleAction or ClipAction"
            raise UserError(f"{name}: {infinite} around an environment whose action_space is finite")
        return found, ()
    if all(isinstance(leaf, DISCRETE) for leaf in leaves):
        count = math.prod(_count(leaf) for leaf in leaves)
        if count > MOST_JOINED:
            raise UserError(f"{name}: actions have {count:,} combinations, at most {MOST_JOINED:,} are joined into one")
        choices = tuple(_choices(space))
        return Discrete(len(choices)), choices
    kinds = ", ".join(dict.fromkeys(type(leaf).__name__ for leaf in leaves))
    raise UserError(f"{name}: actions are {kinds}; either floating-point Box, or Discrete, MultiDiscrete and MultiBinary")


def _one_box(space: Any) -> spaces.Box:
    """Boxes within a space side by side."""
    flat = space if isinstance(space, spaces.Box) else spaces.flatten_space(space)
    assert isinstance(flat, spaces.Box)
    return flat


def _count(space: Any) -> int:
    if isinstance(space, spaces.Discrete):
        return int(space.n)
    return math.prod(np.ravel(getattr(space, "nvec", np.full(space.shape, 2))).tolist())


def _choices(space: Any) -> list[Any]:
    """All actions of a space, in the order of `itertools.product`, as `join_actions` has them of logs."""
    if isinstance(space, spaces.Discrete):
        return [space.dtype.type(space.start + i) for i in range(int(space.n))]
    if isinstance(space, spaces.Dict):
        every = itertools.product(*map(_choices, space.spaces.values()))
        return [dict(zip(space.spaces, values)) for values in every]
    if isinstance(space, spaces.Tuple):
        return list(itertools.product(*map(_choices, space.spaces)))
    counts = np.ravel(getattr(space, "nvec", np.full(space.shape, 2))).tolist()
    starts = np.ravel(getattr(space, "start", np.zeros(space.shape, int))).tolist()
    every = itertools.product(*(range(start, start + count) for start, count in zip(starts, counts)))
    return [np.array(values, space.dtype).reshape(space.shape) for values in every]
