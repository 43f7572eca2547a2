"""Features of observations and actions in which linear critics are exact or close: a table, or random Fourier features.

If a discrete log has few different observations, there is a feature for each observation and action: every value function is
linear in them. Otherwise there are cosines of random projections (Rahimi and Recht 2007) at two length scales, together with
the observation and the action themselves and, if these are few numbers, their products, with which linear-quadratic problems
are exact.
"""

from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.randomness import generator

TABLE = 400  # most pairs of an observation and an action with a feature for each
PRODUCTS = 400  # most products of two numbers that are features
SCALES = (1.0, 3.0)  # length scales of the cosines, in units of a typical distance
FAR = 5.0  # standard deviations from the mean at which observations are clipped


class Table:
    """The different observations of a discrete log, numbered.

    Attributes:
        seen: (observations, d) each once.
    """

    def __init__(self, seen: np.ndarray):
        self.seen = seen

    @classmethod
    def of(cls, log: Dataset) -> "Table | None":
        """The table of a log; None if actions are continuous, or observations times actions are more than `TABLE`."""
        if not log.spec.discrete:
            return None
        most = TABLE // log.spec.action_size
        some = np.unique(np.asarray(log.observations[:: max(1, len(log) // 2000)]), axis=0)
        if len(some) > most:
            return None
        several = [log.observations, *([] if log.successors is None else [log.successors])]
        found = [np.unique(np.asarray(each), axis=0) for each in several]
        found = np.unique(np.concatenate([*found, log.final_observations]), axis=0)
        return cls(found) if len(found) <= most else None

    def codes(self, observations: np.ndarray) -> np.ndarray:
        """(rows,) number of each observation, which must be one of the log's."""
        both = np.concatenate([self.seen, np.asarray(observations, self.seen.dtype)])
        _, inverse = np.unique(both, axis=0, return_inverse=True)
        inverse = inverse.reshape(-1)
        place = np.empty(inverse.max() + 1, int)
        place[inverse[: len(self.seen)]] = np.arange(len(self.seen))
        return place[inverse[len(self.seen) :]]

    def shares(self, log: Dataset) -> np.ndarray:
        """(observations, actions) frequency of each action; for an observation without actions, over all observations."""
        count = np.zeros((len(self.seen), log.spec.action_size))
        np.add.at(count, (self.codes(np.asarray(log.observations)), np.asarray(log.actions)), 1.0)
        count[count.sum(1) == 0] = count.sum(0)
        return count / count.sum(1, keepdims=True)


class Features:
    """Maps (rows, *) observations and actions to (rows, size) numbers.

    Args:
        log: with the observations and actions; its rewards are not used.
        cosines: number of random Fourier features, if there is no table.
        seed: of these.
        table: of the log, with a feature for each observation and action; None: there is none.
    """

    def __init__(self, log: Dataset, cosines: int, seed: int, table: Table | None):
        spec = log.spec
        self.cosines = cosines
        self.view, self.discrete = Normalizer.of(spec, standardise=True), spec.discrete
        p, self.actions = spec.observation_size, spec.action_size
        self.table = table
        if table is not None:
            self.size = len(table.seen) * self.actions
            return
        rng = generator(seed, "features")
        inputs = p if self.discrete else p + self.actions
        scale = np.repeat(SCALES, [cosines - cosines // 2, cosines // 2]) * np.sqrt(inputs)
        self.frequencies = (rng.standard_normal((inputs, cosines)) / scale).astype(np.float32)
        phases = rng.uniform(0, 2 * np.pi, (self.actions if self.discrete else 1, cosines)).astype(np.float32)
        if self.discrete:  # a quarter of them does not depend on the action
            phases[:, ::4] = phases[:1, ::4]
        self.phases, self.phase_cos, self.phase_sin = phases, np.cos(phases), np.sin(phases)
        self.amplitude = np.float32(np.sqrt(2.0 / cosines))
        if self.discrete:
            self.crossed = self.actions * p <= PRODUCTS
            more = p + (self.actions if self.actions <= PRODUCTS else 0) + (self.actions * p if self.crossed else 0)
        else:
            self.pairs = np.triu_indices(inputs)
            self.crossed = len(self.pairs[0]) <= PRODUCTS
            more = inputs + (len(self.pairs[0]) if self.crossed else 0)
        self.size = 1 + more + cosines

    def _seen(self, observations: Any) -> np.ndarray:
        return np.clip(np.asarray(self.view.observe(np.asarray(observations)), np.float32), -FAR, FAR)

    def taken(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """(rows, size) features of one action per row: the environment's."""
        if self.discrete:
            chances = np.eye(self.actions, dtype=np.float32)[np.asarray(actions)]
            return self.expected(observations, chances[:, None])[:, 0]
        unit = np.asarray(self.view.to_unit(np.asarray(actions)), np.float32)
        return self._continuous(self._seen(observations), unit)

    def expected(self, observations: np.ndarray, table: np.ndarray) -> np.ndarray:
        """(rows, policies, size) mean features of the policies' actions, from a table of `Actor.table`."""
        rows, policies = table.shape[:2]
        if not self.discrete:
            samples = table.shape[2]
            seen = np.repeat(self._seen(observations), policies * samples, 0)
            found = self._continuous(seen, table.reshape(-1, table.shape[-1]))
            return found.reshape(rows, policies, samples, self.size).mean(2)
        if self.table is not None:
            out = np.zeros((rows, policies, len(self.table.seen), self.actions), np.float32)
            out[np.arange(rows), :, self.table.codes(observations)] = table
            return out.reshape(rows, policies, self.size)
        seen = self._seen(observations)
        angle = seen @ self.frequencies
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        parts = [np.ones((rows, 1, 1), np.float32), seen[:, None]]
        if self.actions <= PRODUCTS:
            parts.append(table)
        if self.crossed:
            parts.append((table[..., None] * seen[:, None, None]).reshape(rows, policies, -1))
        # In place, because a fit spends most of its time here.
        out, begin = np.empty((rows, policies, self.size), np.float32), 0
        for part in parts:
            out[..., begin : begin + part.shape[-1]] = part
            begin += part.shape[-1]
        # cos(x + phase of the action), averaged over actions, by the addition theorem: no row-by-action array of cosines.
        waves, other = np.matmul(table, self.phase_cos), np.matmul(table, self.phase_sin)
        waves *= cos
        other *= sin
        waves -= other
        np.multiply(waves, self.amplitude, out=out[..., begin:])
        return out

    def _continuous(self, seen: np.ndarray, unit: np.ndarray) -> np.ndarray:
        inputs = np.concatenate([seen, unit], 1)
        waves = inputs @ self.frequencies  # in place: this array takes most of the memory and time
        waves += self.phases
        np.cos(waves, out=waves)
        waves *= self.amplitude
        parts = [np.ones((len(inputs), 1), np.float32), inputs]
        if self.crossed:
            parts.append(inputs[:, self.pairs[0]] * inputs[:, self.pairs[1]])
        return np.concatenate([*parts, waves], 1)
