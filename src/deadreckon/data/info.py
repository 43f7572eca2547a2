"""The contents of a log in numbers, and warnings for a practitioner before training on it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deadreckon.data.copies import about_copies, copies
from deadreckon.data.dataset import Dataset
from deadreckon.data.neighbours import about_neighbours
from deadreckon.data.propensities import about_propensities
from deadreckon.data.repeats import Copies
from deadreckon.data.sizes import about_observations, about_rewards, reward_options
from deadreckon.data.spec import Box, Discrete
from deadreckon.data.told import action_names, observation_names, schema_of

# Words of columns that one minimises, and words beside these with which one does not.
_COSTS = {
    "cost", "costs", "loss", "losses", "penalty", "regret", "error", "errors", "damage", "delay", "waste", "downtime", "churn",
    "churned", "complaint", "complaints", "complained", "defect", "defects", "defective", "failure", "failures", "failed",
    "death", "deaths", "died", "mortality", "readmission", "readmitted", "refund", "refunded", "default", "defaulted",
    "duration", "latency", "unsubscribed", "returned", "rework", "scrap",
}  # fmt: skip
_DURATIONS = "days_to", "hours_to", "minutes_to", "seconds_to", "time_to", "days_until", "hours_until", "time_until"
_GAINS = {"saving", "savings", "saved", "free", "avoided", "reduction", "reduced", "less", "weight", "fewer", "no", "not"}
# Of this many different rewards, one that this share of the rows has, and this many times as many as any other, is told.
_MANY, _SHARE, _TIMES_MORE = 50, 0.01, 10
_SAMPLE = 200_000  # rows looked at where looking at all would be slow
_SEVERAL = 10  # episodes, and different rewards of theirs, from which on equal rewards within episodes are told
_SURE = 2.6  # standard errors
_STEPS, _LIKE, _TIMES = 4, 0.5, 1.5  # least length of episodes whose rewards may be running totals, and what is like the first
_NAMED = 8  # columns or actions named in a line
_QUANTILES = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class Info:
    """Numbers that describe a log; shares are between 0 and 1, quantiles are 0, 25, 50, 75 and 100 %.

    Attributes:
        name: of the log.
        source: kind of source, of the provenance.
        rows: steps.
        episodes: number of them.
        dropped: rows without a known successor.
        observation_shape: of one observation.
        observation_dtype: numpy name.
        action: the action space in words.
        extras: names of further columns.
        lengths: quantiles of episode lengths.
        terminal_share: share of episodes that end in a terminal.
        timeout_share: share of episodes that end in a timeout.
        returns: quantiles of undiscounted returns.
        mean_return: their mean.
        rewards: quantiles of rewards.
        reward_mean: mean reward.
        reward_std: standard deviation of rewards.
        reward_zero_share: share of rows whose reward is 0.
        reward_values: number of distinct rewards, in a sample if the log is long.
        saturated_share: share of action entries at a bound or beyond; 0 for discrete actions.
        out_of_bounds: rows with an action beyond its bounds.
        unused_actions: discrete actions that never occur.
        constant_observations: dimensions (of the flattened observation, without masks of actions) that never change.
        observation_scales: smallest and largest standard deviation among those that do.
        repeats: rows that repeat an earlier one (observation, action, reward), in a sample if the log is long.
        sampled: rows that were checked for duplicates and distinct rewards.
        own_successors: rows inside an episode whose next observation differs from the following row's.
        fingerprint: of the log.
    """

    name: str
    source: str
    rows: int
    episodes: int
    dropped: int
    observation_shape: tuple[int, ...]
    observation_dtype: str
    action: str
    extras: tuple[str, ...]
    lengths: tuple[float, ...]
    terminal_share: float
    timeout_share: float
    returns: tuple[float, ...]
    mean_return: float
    rewards: tuple[float, ...]
    reward_mean: float
    reward_std: float
    reward_zero_share: float
    reward_values: int
    saturated_share: float
    out_of_bounds: int
    unused_actions: int
    constant_observations: tuple[int, ...]
    observation_scales: tuple[float, float]
    repeats: Copies
    sampled: int
    own_successors: int
    fingerprint: str


def describe(log: Dataset) -> Info:
    """The numbers of `log`; about a second for a million rows."""
    spec, terminal = log.spec, np.asarray(log.terminals)[log.ends]
    returns = log.returns()
    saturated, outside, unused = _actions(log)
    std = spec.observation.std.ravel()
    constant = (spec.observation.min == spec.observation.max).ravel()
    moving = std[~constant] if not constant.all() else np.zeros(1)
    sample = slice(0, min(len(log), _SAMPLE))
    return Info(
        name=log.name,
        source=log.provenance.source,
        rows=len(log),
        episodes=log.episodes,
        dropped=log.dropped,
        observation_shape=spec.observation_shape,
        observation_dtype=spec.observation_dtype,
        action=_action_words(log),
        extras=tuple(sorted(log.extras)),
        lengths=_quantiles(log.lengths),
        terminal_share=float(terminal.mean()),
        timeout_share=float((~terminal).mean()),
        returns=_quantiles(returns),
        mean_return=float(returns.mean()),
        rewards=_quantiles_of(log.rewards),
        reward_mean=float(spec.reward.mean),
        reward_std=float(spec.reward.std),
        reward_zero_share=_zeros(log.rewards) / len(log),
        reward_values=len(np.unique(log.rewards[sample])),
        saturated_share=saturated,
        out_of_bounds=outside,
        unused_actions=unused,
        # What is legal everywhere carries nothing either, and cannot be left out.
        constant_observations=tuple(np.flatnonzero(constant[: len(constant) - spec.mask_size]).tolist()),
        observation_scales=(float(moving.min()), float(moving.max())),
        repeats=copies(log, sample.stop),
        sampled=sample.stop,
        own_successors=int(log.apart.sum()),
        fingerprint=log.fingerprint,
    )


def warnings_for(log: Dataset, info: Info | None = None) -> tuple[str, ...]:
    """Warnings before training on `log`, one line of advice each, those from loading first.

    Args:
        log: the log.
        info: the result of `describe`, if it was called already.
    """
    info = info or describe(log)
    return (*log.warnings, *_ends(log, info), *_rewards(log, info), *_columns(log, info))


def render(info: Info, warnings: tuple[str, ...] = ()) -> str:
    """`info` as plain text, one line per fact, followed by the warnings."""
    scale = f"{info.observation_scales[0]:.3g} .. {info.observation_scales[1]:.3g}"
    facts = {
        "log": f"{info.name} ({info.source}, fingerprint {info.fingerprint})",
        "rows": f"{info.rows:,} in {info.episodes:,} episodes, {info.dropped:,} without a next observation or terminal",
        "lengths": f"{_line(info.lengths)} (least, quartiles, most)",
        "ends": f"{info.terminal_share:.1%} terminal, {info.timeout_share:.1%} timeout",
        "returns": f"{_line(info.returns)}, mean {info.mean_return:.4g}",
        "rewards": f"{_line(info.rewards)}, mean {info.reward_mean:.4g}, {info.reward_zero_share:.1%} zero",
        "observations": f"{info.observation_shape} {info.observation_dtype}, standard deviations {scale}",
        "actions": f"{info.action}, {info.saturated_share:.1%} at the bounds, {info.out_of_bounds:,} rows beyond",
        "extras": ", ".join(info.extras) or "none",
    }
    width = max(map(len, facts))
    lines = [f"{key:<{width}}  {value}" for key, value in facts.items()]
    return "\n".join([*lines, *(f"! {line}" for line in warnings)])


def _ends(log: Dataset, info: Info) -> list[str]:
    """Advice on episodes."""
    out = []
    shortest, longest = info.lengths[0], info.lengths[-1]
    if info.episodes == 1 and info.rows > 1:
        out.append("the log is one single episode: if it was several, mark where they end (timeouts or an episode column)")
    terminal = np.asarray(log.terminals)[log.ends]
    lengths = log.lengths[terminal]
    if len(lengths) >= 3 and lengths[0] > 1 and (lengths == lengths[0]).all():
        text = f"all {len(lengths)} terminal episodes have {lengths[0]} steps: if that is a time limit, mark timeouts"
        out.append(f"{text}, or values will be too low")
    elif len(lengths) >= 10 and longest > 1 and (share := float((lengths == longest).mean())) >= 0.2:
        text = f"{share:.0%} of the terminal episodes have the longest length, {longest:.0f}"
        out.append(f"{text}: if that is a time limit, mark them as timeouts")
    if info.own_successors:
        text = f"{info.own_successors:,} rows have a next observation that differs from the following row's observation"
        out.append(f"{text}: rows were shuffled, left out, or episode ends are not marked")
    if info.dropped > 0.05 * info.rows:
        text = f"{info.dropped / info.rows:.0%} of the rows have neither a next observation nor a terminal"
        out.append(f"{text}: log the final observations, or mark terminals, to keep them")
    if shortest == 1 and longest > 1:
        count = int((log.lengths == 1).sum())
        some = "1 episode has one step" if count == 1 else f"{count:,} episodes have one step"
        out.append(f"{some} only: check that their ends are marked correctly")
    return out


def _rewards(log: Dataset, info: Info) -> list[str]:
    """Advice on rewards."""
    out = []
    largest = max(abs(info.rewards[0]), abs(info.rewards[-1]))
    # A constant reward, where episodes can end sooner or later, says how long to go on.
    length_tells = largest > 0 and info.terminal_share > 0 and info.lengths[0] != info.lengths[-1]
    if info.rewards[0] == info.rewards[-1] and not length_tells:
        out.append(f"all rewards are {info.rewards[0]:g}: agents learn nothing from them")
    elif info.reward_zero_share > 0.98:
        share = 1 - info.reward_zero_share
        out.append(f"rewards are sparse: {share:.2%} of the rows have one; prefer methods that stay close to the data")
    elif info.reward_zero_share > 0.5:
        out.append(f"rewards are mostly zero ({info.reward_zero_share:.0%} of the rows)")
    if _totals(log):
        out.append("rewards are the same in all rows of an episode: if they are its total, give it in the last row alone")
    if _running_totals(log):
        out.append("rewards add up within episodes, as running totals do: if they are, give each row what it adds alone")
    out += _piled(log)
    if (column := _cost(log)) is not None and info.rewards[-1] > 0:
        out.append(f"the reward is column {column}: larger is taken to be better; negate it if smaller is")
    if told := about_rewards(log.spec):
        out.append(f"{told}; agents are made for about 1: train with {reward_options(log)}")
    return out


def _totals(log: Dataset) -> bool:
    """Whether rewards change between episodes, often, and within none of those of several steps."""
    rewards, longer = np.asarray(log.rewards), log.lengths > 1
    if longer.sum() < _SEVERAL:
        return False
    first = rewards[log.starts][longer]
    same = (np.maximum.reduceat(rewards, log.starts) == np.minimum.reduceat(rewards, log.starts))[longer]
    return bool(same.all()) and len(np.unique(first)) >= _SEVERAL


def _running_totals(log: Dataset) -> bool:
    """Whether what each row adds to the reward before it is like the first reward, does not depend on that before, and the last
    ones vary more.

    Rewards that are not added up differ from the reward before by more than the last ones vary, begin as they go on, or, as
    those of states that begin at rest, return to where they were.
    """
    longer = np.flatnonzero(log.lengths >= _STEPS)
    if len(longer) < _SEVERAL:
        return False
    rewards = np.asarray(log.rewards, np.float64)
    within = np.ones(len(log), bool)
    within[log.starts] = False
    added = (rewards[1:] - rewards[:-1])[within[1:]]
    first, last, spread = rewards[log.starts[longer]], rewards[log.ends[longer]], added.std()
    if abs(first.mean() - added.mean()) >= _LIKE * spread or last.std() <= _TIMES * spread:
        return False
    before = rewards[:-1][within[1:]]
    off = before - before.mean()
    if not off.any():
        return False
    slope = off @ added / (off @ off)
    error = spread / np.sqrt(off @ off)
    return bool(slope > -_SURE * error)  # states go back to where they were


def _piled(log: Dataset) -> list[str]:
    """Advice on one value that many rewards have and that is not 0, where others have many values."""
    rewards = np.asarray(log.rewards[:_SAMPLE])
    values, counts = np.unique(rewards[rewards != 0], return_counts=True)
    if len(values) < _MANY:
        return []
    often = int(counts.argmax())
    share, rest = counts[often] / len(rewards), int(np.delete(counts, often).max())
    if share < _SHARE or counts[often] < _TIMES_MORE * rest:
        return []
    where = {0: "the smallest value", len(values) - 1: "the largest value"}.get(often, "a value between others")
    text = f"{share:.1%} of the rewards are {values[often]:.6g}, {where}"
    if isinstance(log.action_space, Discrete) and 2 <= log.action_space.n <= _NAMED:
        taken, names = np.asarray(log.actions[:_SAMPLE]), action_names(log)
        shares = [(name, rewards[taken == i]) for i, name in enumerate(names) if (taken == i).any()]
        text += f" ({', '.join(f'{(own == values[often]).mean():.1%} of those of {name}' for name, own in shares)})"
    return [f"{text}: if they were cut off, held or filled in, the true ones are not known, and may differ by action"]


def _cost(log: Dataset) -> str | None:
    """The reward's column, if its name is that of something to minimise."""
    schema = schema_of(log)
    names = schema.named("reward") if schema else []
    for name in names:
        words = [word.lower() for word in re.findall("[A-Z]?[a-z]+|[A-Z]+", name)]
        waited = "_".join(words).startswith(_DURATIONS)
        if (waited or _COSTS & set(words)) and not _GAINS & set(words):
            return name
    return None


def _columns(log: Dataset, info: Info) -> list[str]:
    """Advice on observations, actions and rows."""
    out, pictures = [], len(log.spec.observation_shape) > 1  # whose pixels may rest, and differ as they like
    if info.constant_observations and not pictures:
        names = observation_names(log)
        shown = _shortened([names[i].removeprefix("observation ") for i in info.constant_observations])
        out.append(f"observation dimensions that never change: {shown}; they carry no information and may be left out")
    if told := about_observations(log):
        out.append(f"{told}; networks learn best from numbers of about 1: standardise observations (train --agent.standardise)")
    if info.saturated_share > 0.3:
        text = f"{info.saturated_share:.0%} of the action entries are at the bounds ({_shortened(action_names(log))})"
        out.append(f"{text}: log-probabilities of tanh policies are uncertain there; check that the bounds are right")
    if info.unused_actions:
        names, used = action_names(log), _used(log)
        unused = [name for i, name in enumerate(names) if i not in used]
        never = "never occurs" if len(unused) == 1 else "never occur"
        text = f"{len(unused)} of {len(names)} actions {never} in the log ({_shortened(unused)})"
        out.append(f"{text}: their effects are not known")
    return [*out, *about_propensities(log), *about_copies(log, info.repeats, info.sampled), *about_neighbours(log)]


def _shortened(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")


def _actions(log: Dataset) -> tuple[float, int, int]:
    """Share of entries at a bound or beyond, rows beyond a bound, and discrete actions never taken."""
    space = log.action_space
    if not isinstance(space, Box):
        return 0.0, 0, space.n - len(_used(log))
    low, high = np.asarray(space.low, np.float32), np.asarray(space.high, np.float32)
    entries = outside = 0
    for start in range(0, len(log), _SAMPLE):
        part = log.actions[start : start + _SAMPLE]
        entries += int(((part <= low) | (part >= high)).sum())
        outside += int(((part < low) | (part > high)).any(1).sum())
    return entries / log.actions.size, outside, 0


def _used(log: Dataset) -> np.ndarray:
    """The discrete actions that occur."""
    return np.unique(np.concatenate([np.unique(log.actions[start : start + _SAMPLE]) for start in range(0, len(log), _SAMPLE)]))


def _zeros(column: np.ndarray) -> int:
    return sum(int((column[start : start + _SAMPLE] == 0).sum()) for start in range(0, len(column), _SAMPLE))


def _quantiles(values: np.ndarray) -> tuple[float, ...]:
    return tuple(np.quantile(np.asarray(values, np.float64), _QUANTILES).tolist())


def _quantiles_of(column: np.ndarray) -> tuple[float, ...]:
    """`_quantiles` of a column that has a float32 for each row, which is copied once and no more."""
    at = [share * (len(column) - 1) for share in _QUANTILES]
    beside = [(int(place), min(int(place) + 1, len(column) - 1)) for place in at]
    part = np.array(column)
    part.partition(sorted({place for pair in beside for place in pair}))
    found = [np.quantile(np.asarray(part[list(pair)], np.float64), place - pair[0]) for pair, place in zip(beside, at)]
    return tuple(map(float, found))


def _action_words(log: Dataset) -> str:
    space = log.action_space
    if not isinstance(space, Box):
        return f"{space.n} discrete{', not all of them legal everywhere' if space.masked else ''}"
    low, high = min(space.low), max(space.high)
    return f"{space.size} continuous within {low:g} .. {high:g}"


def _line(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.4g}" for value in values)
