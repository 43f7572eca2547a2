"""Identities of logs and episodes: numbers computed from their contents, the same in any file and part."""

import hashlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from deadreckon.data.scratch import BLOCK

if TYPE_CHECKING:
    from deadreckon.data.dataset import Dataset

_BLOCK = 2**22  # bytes looked at together: they stay in the processor's cache, and no memory-mapped column is loaded whole
_TOGETHER = 4_194_304  # rows whose returns are made together, or one episode where that is longer
_LONG = 4_096  # steps up to which episodes are walked back together even where they are few
_STEP = np.uint64(0x9E3779B97F4A7C15)


def index_type(count: int) -> Any:
    """The smallest of int32 and int64 that can number `count` things: an index with a row each is half as large."""
    return np.int32 if count <= np.iinfo(np.int32).max else np.int64


def fingerprint(log: "Dataset") -> str:
    """Hex digest of a log's columns and its action space."""
    digest = hashlib.blake2b(repr(log.action_space).encode(), digest_size=16)
    named = {"observations": log.observations, "actions": log.actions, "rewards": log.rewards,
             "terminals": log.terminals, "timeouts": log.timeouts, "final_observations": log.final_observations,
             "final_known": log.final_known, **dict(sorted(log.extras.items()))}  # fmt: skip
    if log.successors is not None:
        named["successors"] = log.successors
    for key, column in named.items():
        digest.update(f"{key}{column.shape}{column.dtype}".encode())
        for start in range(0, len(column), BLOCK):
            digest.update(np.ascontiguousarray(column[start : start + BLOCK]).tobytes())
    return digest.hexdigest()


def content_ids(log: "Dataset") -> np.ndarray:
    """(episodes,) uint64, one for each episode and different from all others in the log.

    It follows from the observations, actions, rewards, ends and the final observation, and, because episodes may be equal, from
    the number of equal ones before it in the log. Extra columns do not count: the episodes are the same whether a log is read
    with or without propensities or users. The numbers are the same on every machine and in every version; they do not protect
    against deliberately constructed collisions.
    """
    found = log.episode_contents
    return _mixed(found ^ _places("alike", _alike_before(found)))


def alike_in(log: "Dataset", ids: np.ndarray) -> np.ndarray:
    """(episodes,) bool: whether several episodes of another log, whose `content_ids` are given, are equal to the episode.

    Equal episodes are numbered in the order of their log, so a part that is read from a file of its own numbers them otherwise:
    which of them an episode is can be told only in the whole log.
    """
    return np.isin(_mixed(log.episode_contents ^ _places("alike", np.ones(log.episodes, np.uint64))), ids)


def contents(log: "Dataset") -> np.ndarray:
    """(episodes,) uint64 hashes of what episodes hold, the same for equal ones."""
    ids = np.zeros(log.episodes, np.uint64)
    for start in range(0, len(log), BLOCK):
        row = np.arange(start, min(start + BLOCK, len(log)))
        block, episode = slice(start, start + len(row)), log.episode_at(row)
        rows = np.zeros(len(row), np.uint64)
        for name in ("observations", "actions", "rewards"):
            _add(rows, name, getattr(log, name)[block])
        rows += _mixed(_seed("ends") ^ (log.terminals[block] + np.uint64(2) * log.timeouts[block]))
        if log.successors is not None:
            # Only where they say something new: a part in which they do not has no such column.
            new = np.zeros(len(row), bool)
            inside = row[row < len(log) - 1]
            said = log.successors[block][: len(inside)] != log.observations[start + 1 : start + 1 + len(inside)]
            new[: len(inside)] = said.reshape(len(inside), -1).any(1) & ~log.is_end[inside]
            found = np.zeros(int(new.sum()), np.uint64)
            _add(found, "successors", log.successors[block][new])
            rows[new] += found
        rows = _mixed(rows ^ _places("step", (row - log.starts[episode]).astype(np.uint64)))
        first = np.flatnonzero(np.append(True, episode[1:] != episode[:-1]))
        ids[episode[first]] += np.add.reduceat(rows, first)
    last = np.zeros(log.episodes, np.uint64)
    _add(last, "final_observations", log.final_observations)
    return _mixed(ids + np.where(log.final_known, _mixed(last), np.uint64(0)))


def returns_to_go(rewards: np.ndarray, ends: np.ndarray, lengths: np.ndarray, discount: float) -> np.ndarray:
    """(rows,) float64 return from each row to the end of its episode.

    Args:
        rewards: (rows,).
        ends: (episodes,) index of each episode's last row.
        lengths: (episodes,) steps in each.
        discount: of one step.
    """
    to_go = rewards.astype(np.float64)
    if (longest := int(lengths.max())) > max(len(lengths), _LONG):
        # Few and long: sums of 1, 2, 4, ... rewards, each of two sums of half as many.
        left = np.repeat(ends, lengths) - np.arange(len(rewards))
        steps, factor = 1, discount
        while steps < longest:
            rows = np.flatnonzero(left >= steps)
            to_go[rows] += factor * to_go[rows + steps]
            steps, factor = 2 * steps, factor * factor
        return to_go
    # Many: all are walked back together, longest first, so that there are as many numpy calls as steps.
    order = np.argsort(-lengths, kind="stable")
    ends, lengths = ends[order], lengths[order]
    for back in range(1, longest):
        rows = ends[: np.searchsorted(-lengths, -back, side="left")] - back
        to_go[rows] += discount * to_go[rows + 1]
    return to_go


def continued_returns(
    rewards: np.ndarray, ends: np.ndarray, lengths: np.ndarray, ended: np.ndarray, discount: float
) -> np.ndarray:
    """(rows, 2) float64: the discounted rewards from each row on, and the discounted number of steps that give them.

    An episode that was cut (a timeout, or the end of the recording) continues infinitely with its last reward: from the last
    row
    on there are 1 / (1 - discount) discounted steps of that reward. Rewards r' = scale r + shift have the return
    scale * first + shift * second.

    Args:
        rewards: (rows,).
        ends: (episodes,) index of each episode's last row.
        lengths: (episodes,) steps in each.
        ended: (episodes,) whether the last row is a terminal.
        discount: of one step, below 1.
    """
    columns = []
    for each in (rewards.astype(np.float64), np.ones(len(rewards))):
        each[ends] = np.where(ended, each[ends], each[ends] / (1.0 - discount))
        columns.append(returns_to_go(each, ends, lengths, discount))
    return np.stack(columns, 1)


def episode_returns(rewards: np.ndarray, ends: np.ndarray, lengths: np.ndarray, discount: float) -> np.ndarray:
    """(episodes,) float64 return of each episode, made for some episodes at a time; arguments as for `returns_to_go`."""
    out = np.empty(len(ends))
    first = 0
    while first < len(ends):
        begin = int(ends[first] - lengths[first] + 1)
        stop = max(int(np.searchsorted(ends, begin + _TOGETHER)), first + 1)
        own = slice(first, stop)
        to_go = returns_to_go(np.asarray(rewards[begin : ends[stop - 1] + 1]), ends[own] - begin, lengths[own], discount)
        out[own] = to_go[ends[own] - lengths[own] + 1 - begin]
        first = stop
    return out


def rows_of(starts: np.ndarray, lengths: np.ndarray) -> Any:
    """The rows of episodes that begin at `starts` and have `lengths`: indices, or a slice where they are neighbours, which are
    then not copied, so that memory maps stay such."""
    if (starts[1:] == starts[:-1] + lengths[:-1]).all():
        return slice(int(starts[0]), int(starts[-1] + lengths[-1]))
    offsets = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return np.repeat(starts, lengths) + offsets


def _add(into: np.ndarray, name: str, column: np.ndarray) -> None:
    """Adds a hash of each row of a column."""
    seed = _seed(name)
    for start, words in _words(column):
        keys = _places(seed, np.arange(words.shape[1], dtype=np.uint64))
        # Mixed one by one before they are added: products alone would not see two signs change together.
        into[start : start + len(words)] += _mixed(words ^ keys).sum(1, dtype=np.uint64)


def _words(column: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Blocks of a column's rows, each row as (words,) uint64 that are the same on every machine; with each its first row."""
    size = int(np.prod(column.shape[1:], dtype=np.int64))
    kind = "<f4" if column.dtype.kind == "f" else "u1" if column.dtype == np.uint8 else "<i8"
    width = -(-size * np.dtype(kind).itemsize // 8) * 8
    each = max(_BLOCK // max(width, 1), 1)
    for start in range(0, len(column), each):
        part = np.asarray(column[start : start + each]).reshape(-1, size).astype(kind)
        if kind == "<f4":
            part += np.float32(0.0)  # minus zero is zero
        padded = np.zeros((len(part), width), np.uint8)
        padded[:, : size * part.itemsize] = np.ascontiguousarray(part).view(np.uint8).reshape(len(part), -1)
        yield start, padded.view("<u8").astype(np.uint64)


def _seed(name: str) -> np.uint64:
    return np.uint64(int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little"))


def _places(seed: str | np.uint64, index: np.ndarray) -> np.ndarray:
    """A number for each place 0, 1, ..., so that the same values elsewhere count otherwise."""
    return _mixed((_seed(seed) if isinstance(seed, str) else seed) + (index + np.uint64(1)) * _STEP)


def _mixed(x: np.ndarray | np.uint64) -> np.ndarray:
    """The finaliser of SplitMix64 (Steele, Lea and Flood, 2014): one to one, and every bit depends on all."""
    x = np.array(x, np.uint64, ndmin=1)
    x ^= x >> np.uint64(30)
    x *= np.uint64(0xBF58476D1CE4E5B9)
    x ^= x >> np.uint64(27)
    x *= np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(31)
    return x


def _alike_before(ids: np.ndarray) -> np.ndarray:
    """(episodes,) uint64: how many equal numbers come before each."""
    order = np.argsort(ids, kind="stable")
    first = np.append(True, ids[order][1:] != ids[order][:-1])
    place = np.arange(len(ids))
    out = np.empty(len(ids), np.uint64)
    out[order] = place - np.maximum.accumulate(np.where(first, place, 0))
    return out
