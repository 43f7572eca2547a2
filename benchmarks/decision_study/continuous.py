"""Continuous actions: a linear world with quadratic costs, a pendulum, and prices."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Box
from decision_study.problem import BETTER, LOG, TRUTH, WORLD, Estimand, Family, Normal, Problem

LEAST = 10  # episodes of a log
BLOCK, MOST, SALES = 2_000, 60, 30  # episodes at a time, and blocks, of the truth; blocks of customers
NEAR = 0.3  # share of the logs whose own policy is all but the best
POINTS, WEIGHTS = (lambda x, w: (np.sqrt(2) * x, w / np.sqrt(np.pi)))(*np.polynomial.hermite.hermgauss(16))
DRAWS = 16  # of a policy, to know what a state is worth under it


def around(actions: np.ndarray) -> Box:
    """Bounds a tenth beyond what was logged: at a bound a tanh-Gaussian has no density to speak of."""
    low, high = actions.min(0), actions.max(0)
    return Box(tuple(low - 0.1 * (high - low)), tuple(high + 0.1 * (high - low)))


class Simulator:
    """A world that is played: `start` and `step`. Values are means over episodes whose noise is the same for all policies."""

    steps: int
    size: int  # of an action
    seed: int
    own: Normal
    estimand: Estimand

    def start(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """(n, s) first states."""
        raise NotImplementedError

    def step(self, state: np.ndarray, action: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Next states and expected rewards."""
        raise NotImplementedError

    def seen(self, state: np.ndarray) -> np.ndarray:
        """(n, d) what is seen of a state."""
        return state

    def returns(self, policy: Normal, rng: np.random.Generator, n: int, first: np.ndarray | None = None) -> np.ndarray:
        """(n,) discounted sums of expected rewards over episodes, from `first` states or any."""
        state, total = self.start(rng, n) if first is None else first, np.zeros(n)
        for t in range(self.steps):
            z, noise = rng.standard_normal((n, self.size)), rng.standard_normal(state.shape)
            state, reward = self.step(state, policy.at(self.seen(state), z), noise)
            total += self.estimand.discount**t * reward
        return total

    def gains(self, policies: Sequence[Any], errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Of pairs of episodes, one of the policy and one of the log's own."""
        found: list[list[np.ndarray]] = [[] for _ in policies]
        owns = []
        open_ = np.ones(len(policies), bool)
        gain, error = np.zeros(len(policies)), np.full(len(policies), np.inf)
        for block in range(MOST):
            owns.append(self.returns(self.own, np.random.default_rng([self.seed, TRUTH, block]), BLOCK))
            for i in np.flatnonzero(open_):
                found[i].append(self.returns(policies[i], np.random.default_rng([self.seed, TRUTH, block]), BLOCK) - owns[-1])
                each = np.concatenate(found[i])
                gain[i], error[i] = each.mean(), each.std() / np.sqrt(len(each))
                open_[i] = error[i] > errors[i]
            if not open_.any():
                break
        return gain, error, float(np.concatenate(owns).mean())

    def log(self, rows: int, noise: float, name: str) -> tuple[Dataset, dict[str, np.ndarray]]:
        """Episodes of the log's own policy, cut off at the end of what is asked."""
        rng, n = np.random.default_rng([self.seed, LOG]), max(round(rows / self.steps), LEAST)
        state, columns = self.start(rng, n), []
        for _ in range(self.steps):
            # What is recorded is what the policy saw, in the precision of the log.
            seen = self.seen(state).astype(np.float32)
            action = self.own.at(seen, rng.standard_normal((n, self.size))).astype(np.float32)
            after, reward = self.step(state, action, rng.standard_normal(state.shape))
            reward = reward + noise * rng.standard_normal(n)
            columns.append((state, after, seen, action, reward, self.own.log_prob(seen, action)))
            state = after
        each = [np.concatenate(np.swapaxes(np.stack(column), 0, 1)) for column in zip(*columns)]
        state, after, seen, action, reward, log_prob = each
        timeouts = np.zeros(len(reward), bool)
        timeouts[self.steps - 1 :: self.steps] = True
        data = Dataset.from_arrays(
            observations=seen, actions=action, rewards=reward, timeouts=timeouts, name=name,
            final_observations=self.seen(after[timeouts]).astype(np.float32), behavior_log_probs=log_prob,
            action_space=around(action),
        )  # fmt: skip
        return data, {"state": state, "after": after}

    def goes_on(
        self, policy: Normal, time: np.ndarray, state: np.ndarray, rng: np.random.Generator, first: Any = None
    ) -> np.ndarray:
        """(rows,) discounted rewards from a state at a step to the end, after a `first` action or the policy's own."""
        total, rows = np.zeros(len(state)), np.arange(len(state))
        for k in range(self.steps):
            on = time[rows] + k < self.steps
            rows, state = rows[on], state[on]
            if not len(rows):
                break
            z = rng.standard_normal((len(rows), self.size))
            action = first if first is not None and k == 0 else policy.at(self.seen(state), z)
            state, reward = self.step(state, action, rng.standard_normal(state.shape))
            total[rows] += self.estimand.discount**k * reward
        return total

    def worth(self, policy: Normal, time: np.ndarray, state: np.ndarray, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(rows,) Q of states and actions and V of states at steps, without bias: played anew."""
        rng = np.random.default_rng([self.seed, TRUTH, MOST])
        q = self.goes_on(policy, time, state, rng, action)
        return q, 0.5 * (self.goes_on(policy, time, state, rng) + self.goes_on(policy, time, state, rng))

    def scores(self, policy: Any, log: Dataset, hidden: Any) -> np.ndarray:
        """Doubly robust per decision with the true probabilities, about values that are played anew or known; of a policy that
        draws nothing what its episodes are worth from the log's first states."""
        discount, time = self.estimand.discount, np.tile(np.arange(self.steps), log.episodes)
        if not policy.draws:
            first, played = hidden["state"][log.starts], np.zeros(log.episodes)
            for kind, sign in ((policy, 1.0), (self.own, -1.0)):
                rng = np.random.default_rng([self.seed, TRUTH, MOST])
                played += sign * sum(self.returns(kind, rng, log.episodes, first) for _ in range(DRAWS)) / DRAWS
            return played
        logs = policy.log_prob(log.observations, log.actions) - self.own.log_prob(log.observations, log.actions)
        ratio = np.exp(np.minimum(np.cumsum(logs.reshape(-1, self.steps), 1).ravel(), 50.0))
        out = np.zeros(log.episodes)
        for kind, sign, weight in ((policy, 1.0, ratio), (self.own, -1.0, np.ones(len(log)))):
            q, v = self.worth(kind, time, hidden["state"], log.actions.astype(float))
            future = np.where(time + 1 < self.steps, np.append(v[1:], 0.0), 0.0)
            pull = discount**time * weight * (log.rewards + discount * future - q)
            out += sign * (v[log.starts] + np.bincount(log.episode_of, pull, log.episodes))
        return out


@dataclass
class Linear(Simulator):
    """s' = A s + B a + w with reward -(s'C s + a'D a) and a fixed number of steps: values of linear policies are quadratic."""

    a: np.ndarray
    b: np.ndarray
    costs: np.ndarray
    pains: np.ndarray
    spread: float  # of w
    gain: np.ndarray  # (actions, states) of the log's own policy
    std: np.ndarray  # (actions,)
    steps: int
    estimand: Estimand
    seed: int

    def __post_init__(self):
        self.size = self.b.shape[1]
        self.own = self.policy(self.gain)

    def policy(self, gain: np.ndarray) -> Normal:
        """Actions about a linear function of the state."""
        return Normal(lambda seen: (seen @ gain.T, np.broadcast_to(self.std, (len(seen), self.size))))

    def start(self, rng, n):
        return rng.standard_normal((n, len(self.a)))

    def step(self, state, action, noise):
        reward = -((state @ self.costs) * state).sum(1) - ((action @ self.pains) * action).sum(1)
        return state @ self.a.T + action @ self.b.T + self.spread * noise, reward

    def quadratic(self, gain: np.ndarray) -> list[tuple[np.ndarray, float]]:
        """V_t(s) = -(s'P_t s) - c_t of a linear policy, at each step and after the last."""
        p, c, out = np.zeros_like(self.a), 0.0, []
        closed, var = self.a + self.b @ gain, np.diag(np.square(self.std))
        discount = self.estimand.discount
        out.append((p, c))
        for _ in range(self.steps):
            later = c + np.trace(self.b.T @ p @ self.b @ var) + self.spread**2 * np.trace(p)
            c = np.trace(self.pains @ var) + discount * later
            p = self.costs + gain.T @ self.pains @ gain + discount * closed.T @ p @ closed
            out.append((p, c))
        return out[::-1]

    def value(self, gain: np.ndarray) -> float:
        """Of a linear policy, exactly."""
        p, c = self.quadratic(gain)[0]
        return -float(np.trace(p)) - c

    def best(self) -> np.ndarray:
        """The gain of the best linear policy of long episodes."""
        p, discount = self.costs, self.estimand.discount
        for _ in range(200):
            k = -np.linalg.solve(self.pains + discount * self.b.T @ p @ self.b, discount * self.b.T @ p @ self.a)
            p = self.costs + k.T @ self.pains @ k + discount * (self.a + self.b @ k).T @ p @ (self.a + self.b @ k)
        return k

    def nearest(self, policy: Normal) -> np.ndarray:
        """The gain of the linear policy that is most like another where the log's own goes."""
        rng = np.random.default_rng([self.seed, TRUTH, MOST + 1])
        state = rng.standard_normal((2_000, len(self.a)))
        mean = policy.at(state, np.zeros((len(state), self.size)))
        return np.linalg.lstsq(state, mean, rcond=None)[0].T

    def worth(self, policy, time, state, action):
        p, c = map(np.array, zip(*self.quadratic(self.nearest(policy))))

        def q(action):
            reward = self.step(state, action, np.zeros_like(state))[1]
            after = state @ self.a.T + action @ self.b.T
            later = np.einsum("ni,nij,nj->n", after, p[time + 1], after)
            more = self.spread**2 * np.trace(p, axis1=1, axis2=2)[time + 1] + c[time + 1]
            return reward - self.estimand.discount * (later + more)

        rng, v = np.random.default_rng([self.seed, TRUTH, MOST]), np.zeros(len(state))
        for _ in range(DRAWS // 2):
            z = rng.standard_normal((len(state), self.size))
            for sign in (1.0, -1.0):  # pairs, whose first moment is right
                v += q(policy.at(state, sign * z)) / DRAWS
        return q(action), v

    def gains(self, policies, errors):
        """By episodes beside those of a linear policy, whose value is known; of linear policies exactly."""
        own, out = self.value(self.gain), []
        for policy, error in zip(policies, errors):
            k = self.nearest(policy)
            base = self.value(k) - own
            linear, found = self.policy(k), []
            gap, wrong = 0.0, 0.0
            for block in range(MOST):
                theirs, known = (
                    self.returns(each, np.random.default_rng([self.seed, TRUTH, block]), BLOCK) for each in (policy, linear)
                )
                found.append(theirs - known)
                each = np.concatenate(found)
                gap, wrong = each.mean(), each.std() / np.sqrt(len(each))
                if wrong <= max(error, 1e-9):
                    break
            out.append((base + gap, wrong))
        gains, found_errors = np.array(out).reshape(-1, 2).T
        return gains, found_errors, own


def regulator(seed: int, rows: int) -> Problem:
    """Two states, one action or two; behaviour anywhere between the best and doing nothing."""
    rng = np.random.default_rng([seed, WORLD])
    size = int(rng.integers(1, 3))
    a = np.array([[1.0, 0.3], [0.0, 1.0]]) * 0.95
    b = np.array([[0.0, 0.1], [0.4, 0.0]])[:, :size] + 0.05 * rng.standard_normal((2, size))
    costs, pains, std = np.diag([1.0, 0.1]), np.eye(size) * rng.choice([0.1, 0.5]), np.full(size, rng.uniform(0.3, 0.6))
    steps = int(rng.choice([5, 10]))
    world = Linear(a, b, costs, pains, 0.2, np.zeros((size, 2)), std, steps, Estimand(0.95, steps), seed)
    best, near = world.best(), rng.random() < NEAR
    share = 0.95 if near else rng.uniform(0.0, 0.7)
    own = share * best
    world.gain = own
    world.own = world.policy(own)
    by = rng.uniform(0.1, 0.3, 2)
    candidates = {"better": world.policy(own + by[0] * (best - own)), "worse": world.policy(own - by[1] * best)}
    log, hidden = world.log(rows, float(rng.choice([0.1, 1.0])), "linear-quadratic")
    return Problem(log, world.estimand, world, candidates, hidden)


@dataclass
class Pendulum(Simulator):
    """A pendulum that hangs, pushed at its hinge by a torque of limited strength: the higher the better."""

    seed: int
    push: float  # how hard the log's own policy drives it
    std: float
    steps: int = 20

    def __post_init__(self):
        self.size, self.estimand, self.own = 1, Estimand(0.97, self.steps), self.policy(self.push)

    def policy(self, push: float) -> Normal:
        """Pushes in the direction of motion, which pumps it up; a negative one brakes."""
        return Normal(lambda seen: (push * np.tanh(2.0 * seen[:, 2:]), np.full((len(seen), 1), self.std)))

    def start(self, rng, n):
        return np.stack([rng.uniform(-1.0, 1.0, n), rng.uniform(-1.0, 1.0, n)], 1)  # angle from below, speed

    def seen(self, state):
        return np.stack([np.sin(state[:, 0]), np.cos(state[:, 0]), state[:, 1] / 4.0], 1)

    def step(self, state, action, noise):
        angle, speed = state.T
        torque = np.clip(action[:, 0], -2.0, 2.0)
        speed = np.clip(speed + 0.1 * (-5.0 * np.sin(angle) + 3.0 * torque) + 0.05 * noise[:, 0], -8.0, 8.0)
        angle = angle + 0.1 * speed
        return np.stack([angle, speed], 1), -np.cos(angle) - 0.05 * np.square(torque)


def pendulum(seed: int, rows: int) -> Problem:
    """Behaviour that pumps more or less, or brakes."""
    rng = np.random.default_rng([seed, WORLD])
    push = float(1.8 if rng.random() < NEAR else rng.uniform(-0.5, 1.0))
    world = Pendulum(seed, push, float(rng.uniform(0.5, 0.8)))
    by = rng.uniform(0.1, 0.3, 2)
    candidates = {"more": world.policy(push + by[0]), "less": world.policy(push - by[1])}
    log, hidden = world.log(rows, float(rng.choice([0.0, 0.5])), "pendulum")
    return Problem(log, world.estimand, world, candidates, hidden)


# ---- prices ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Prices:
    """One decision an episode: a price, at which a customer buys or not.

    Attributes:
        keen, wary: weights of what is seen in how much is paid at most, and in how much that matters.
        own: the log's own policy.
        seed: of the truth's customers.
    """

    keen: np.ndarray
    wary: np.ndarray
    own: Normal
    seed: int

    def mean(self, seen: np.ndarray, price: np.ndarray) -> np.ndarray:
        """Expected takings; nobody is paid for taking it."""
        worth, slope = 1.5 + 0.4 * seen @ self.keen, 2.0 + np.exp(0.3 * seen @ self.wary)
        asked = np.maximum(price[..., 0], 0.0)
        return asked / (1.0 + np.exp(-slope * (worth - asked)))

    def best(self, seen: np.ndarray) -> np.ndarray:
        """(n, 1) the best prices, on a grid."""
        grid = np.linspace(0.2, 4.0, 60)
        found = np.stack([self.mean(seen, np.full((len(seen), 1), each)) for each in grid], 1)
        return grid[found.argmax(1)][:, None]

    def worth(self, policy: Normal, seen: np.ndarray) -> np.ndarray:
        """(n,) takings of a policy, by quadrature over its draws."""
        return sum(w * self.mean(seen, policy.at(seen, np.full((len(seen), 1), z))) for z, w in zip(POINTS, WEIGHTS))

    def gains(self, policies: Sequence[Any], errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Over customers that are the same for all policies."""
        found, owns, open_ = [[] for _ in policies], [], np.ones(len(policies), bool)
        gain, error = np.zeros(len(policies)), np.full(len(policies), np.inf)
        for number in range(SALES):
            seen = np.random.default_rng([self.seed, TRUTH, number]).standard_normal((10_000, len(self.keen)))
            owns.append(self.worth(self.own, seen))
            for i in np.flatnonzero(open_):
                found[i].append(self.worth(policies[i], seen) - owns[-1])
                each = np.concatenate(found[i])
                gain[i], error[i] = each.mean(), each.std() / np.sqrt(len(each))
            open_ &= error > errors
            if not open_.any():
                break
        return gain, error, float(np.concatenate(owns).mean())

    def scores(self, policy: Any, log: Dataset, hidden: Any) -> np.ndarray:
        """Doubly robust; what is known for certain where a policy draws nothing."""
        seen, taken = log.observations, log.actions
        known = self.worth(policy, seen) - self.worth(self.own, seen)
        if not policy.draws:
            return known
        ratio = np.exp(policy.log_prob(seen, taken) - self.own.log_prob(seen, taken))
        return known + (ratio - 1.0) * (log.rewards - self.mean(seen, taken))


def prices(known: bool) -> Callable[[int, int], Problem]:
    """Prices about a linear rule of what is known of the customer; the log tells their densities, or not even bounds."""

    def make(seed: int, rows: int) -> Problem:
        rng = np.random.default_rng([seed, WORLD])
        size = 3
        keen, wary, rule = rng.standard_normal((3, size)) / np.sqrt(size)
        std, off, near = rng.uniform(0.15, 0.4), rng.choice([-0.5, 0.6]) * rng.uniform(0.3, 1.0), rng.random() < NEAR
        world = Prices(keen, wary, Normal(lambda seen: (seen, None)), seed)
        some = np.random.default_rng([seed, WORLD, 1]).standard_normal((2_000, size))
        aim = np.linalg.lstsq(np.column_stack([np.ones(2_000), some]), world.best(some), rcond=None)[0][:, 0]
        rule = aim if near else np.append(aim[0] + off, 0.3 * rule)

        def policy(weights: np.ndarray) -> Normal:
            return Normal(lambda seen: ((weights[0] + seen @ weights[1:])[:, None], np.full((len(seen), 1), std)))

        world = Prices(keen, wary, policy(rule), seed)
        by = rng.uniform(0.1, 0.4, 2)
        away = rule - by[1] * (aim - rule) + (np.array([by[1], 0, 0, 0]) if near else 0.0)
        candidates = {"better": policy(rule + by[0] * (aim - rule)), "worse": policy(away)}
        draws = np.random.default_rng([seed, LOG])
        seen = draws.standard_normal((rows, size)).astype(np.float32)
        taken = world.own.at(seen, draws.standard_normal((rows, 1))).astype(np.float32)
        asked = np.maximum(taken[:, 0], 0.0)
        buys = draws.random(rows) < np.divide(world.mean(seen, taken), asked, out=np.zeros(rows), where=asked > 0)
        told = {"behavior_log_probs": world.own.log_prob(seen, taken), "action_space": around(taken)} if known else {}
        log = Dataset.from_arrays(
            observations=seen, actions=taken, rewards=asked * buys, terminals=np.ones(rows, bool), next_observations=seen,
            name="pricing", **told,
        )  # fmt: skip
        return Problem(log, Estimand(0.0, 1), world, candidates, known=known)

    return make


FAMILIES = (
    Family("linear-quadratic", regulator, BETTER),
    Family("pendulum", pendulum, "where the behaviour policy applies less torque than is optimal (`more`)"),
    Family("pricing", prices(True), BETTER, split="confirmatory"),
    Family("pricing-unknown", prices(False), BETTER),
)
