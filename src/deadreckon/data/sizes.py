"""Whether the numbers of a log are about 1 in size: what networks begin with, and what agents' settings were published for."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Spec, Statistics
from deadreckon.data.told import observation_names
from deadreckon.stats.interval import decimals, fixed

LARGE, SMALL = 10.0, 0.1  # sizes beyond which numbers are told, and changed by `recommend`


def large(seen: Statistics) -> np.ndarray:
    """Bool, of the column's shape: dimensions whose root mean square is above 10, which an offset alone can make."""
    return _size(seen) > LARGE


def unusual(seen: Statistics) -> np.ndarray:
    """The same of those that are large, or that change and never reach 0.1 in size; flags that are rare do."""
    return large(seen) | ((seen.min < seen.max) & (np.maximum(np.abs(seen.min), np.abs(seen.max)) < SMALL))


def usual_observations(spec: Spec) -> bool:
    """Whether all that is observed is about 1 in size; so are pictures, whose pixels encoders scale."""
    return spec.observation_dtype == "uint8" or not unusual(spec.observation).any()


def reward_units(log: Dataset) -> tuple[float, float]:
    """A scale and a shift that bring the rewards of a log to about 1: scale times reward, plus shift.

    Scale 1 and no shift where they are so already. In a log of single steps the mean reward becomes 0, which changes no
    decision: else what remains of differences after the scale would depend on an offset. In longer episodes an offset counts.
    """
    seen = log.spec.reward
    if not unusual(seen).any():
        return 1.0, 0.0
    mean = seen.mean if log.lengths.max() == 1 else np.zeros_like(seen.mean)
    seen = replace(seen, mean=seen.mean - mean, min=seen.min - mean, max=seen.max - mean)
    scale = _scale(seen) if unusual(seen).any() else 1.0
    return scale, -scale * float(mean)


def _scale(seen: Statistics) -> float:
    """The power of ten that brings numbers to about 1: their root mean square, or the largest if all are small."""
    size = float(_size(seen))
    return 10.0 ** -round(math.log10(size if size > LARGE else max(abs(float(seen.min)), abs(float(seen.max)))))


def reward_options(log: Dataset) -> str:
    """The options of `train` that scale and shift rewards by `reward_units`."""
    scale, shift = reward_units(log)
    options = [f"--agent.reward-scale {scale:g}"] if scale != 1.0 else []
    return " ".join([*options, f"--agent.reward-shift={fixed(shift, decimals(shift))}"] if shift else options)


def reward_words(log: Dataset) -> str:
    """`reward_units` of the column of a table, in words."""
    scale, shift = reward_units(log)
    parts = [f"multiply the column by {scale:g}"] if scale != 1.0 else []
    return " and ".join([*parts, f"add {fixed(shift, decimals(shift))}"] if shift else parts)


def about_observations(log: Dataset) -> str:
    """What is unusual about the sizes of a log's observations, in words; empty where nothing is."""
    seen = log.spec.observation
    return "" if usual_observations(log.spec) else about_dimensions(seen, unusual(seen), observation_names(log))


def about_dimensions(seen: Statistics, found: np.ndarray, names: Sequence[str]) -> str:
    """The same of those dimensions that were `found`; `names` are of all."""
    size, odd = _size(seen).ravel(), np.flatnonzero(found.ravel())
    if not len(odd):
        return ""
    far = odd[int(np.argmax(np.abs(np.log(size[odd]))))]
    others = f", and {len(odd) - 1} more {'is' if len(odd) == 2 else 'are'} far from 1" if len(odd) > 1 else ""
    return f"{names[far]} is {size[far]:.3g} in size (root mean square){others}"


def about_rewards(spec: Spec) -> str:
    """The same of its rewards."""
    return "" if not unusual(spec.reward).any() else f"rewards are {float(_size(spec.reward)):.3g} in size (root mean square)"


def _size(seen: Statistics) -> np.ndarray:
    """Root mean square, of the column's shape."""
    return np.hypot(seen.mean, seen.std)
