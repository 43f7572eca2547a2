"""One decision an episode: noise, classes, actions that the log lacks, users, many actions, and changes along the log."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.spec import Discrete
from decision_study.problem import BETTER, LOG, TRUTH, WORLD, Choices, Estimand, Family, Problem, choose, softmax, tilted

BLOCK, MOST = 20_000, 60  # contexts at a time, and blocks, of the truth
ONE = Estimand(0.0, 1)
LATE = 2 / 3  # where the latest third of a log begins
NEAR = 0.3  # share of the logs whose own policy is all but the best


@dataclass(frozen=True)
class Bandit:
    """A world of one decision.

    Attributes:
        contexts: of a generator and a number, draws what is seen (n, d) and what is not (n, h).
        mean: (n, actions) expected reward, of both.
        chances: (n, actions) of the log's own policy, of what is seen.
        seed: of the truth's contexts.
        changing: (n, actions) the same of both, if it changes with what is not seen; None: it does not.
    """

    contexts: Callable[[np.random.Generator, int], tuple[np.ndarray, np.ndarray]]
    mean: Callable[[np.ndarray, np.ndarray], np.ndarray]
    chances: Callable[[np.ndarray], np.ndarray]
    seed: int
    changing: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    def own(self, seen: np.ndarray, unseen: np.ndarray) -> np.ndarray:
        """(n, actions) probabilities of the log's own policy."""
        return self.chances(seen) if self.changing is None else self.changing(seen, unseen)

    def gains(self, policies: Sequence[Any], errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Over contexts that are the same for all policies, until the errors are small enough."""
        sums, squares, own, count = np.zeros(len(policies)), np.zeros(len(policies)), 0.0, 0
        for block in range(MOST):
            seen, unseen = self.contexts(np.random.default_rng([self.seed, TRUTH, block]), BLOCK)
            mean, chances = self.mean(seen, unseen), self.own(seen, unseen)
            for i, policy in enumerate(policies):
                each = ((policy.probs(seen) - chances) * mean).sum(1)
                sums[i] += each.sum()
                squares[i] += np.square(each).sum()
            own += (chances * mean).sum()
            count += BLOCK
            gain = sums / count
            error = np.sqrt(np.maximum(squares / count - gain**2, 0.0) / count)
            if (error <= errors).all():
                break
        return gain, error, own / count

    def scores(self, policy: Any, log: Dataset, hidden: Any) -> np.ndarray:
        """Doubly robust, with the true means and probabilities."""
        rows, mean, chances = np.arange(len(log)), hidden["mean"], hidden["chances"]
        probs = policy.probs(log.observations)
        ratio = probs[rows, log.actions] / chances[rows, log.actions]
        return ((probs - chances) * mean).sum(1) + (ratio - 1.0) * (log.rewards - mean[rows, log.actions])


def problem(
    world: Bandit,
    rows: int,
    noise: Callable[[np.random.Generator, np.ndarray], np.ndarray],
    candidates: dict[str, Any],
    name: str,
    drawn: tuple[np.ndarray, np.ndarray] | None = None,
    extras: dict[str, np.ndarray] | None = None,
    **facts: Any,
) -> Problem:
    """A log of a world: its contexts, or those that are given."""
    rng = np.random.default_rng([world.seed, LOG])
    seen, unseen = world.contexts(rng, rows) if drawn is None else drawn
    seen = seen.astype(np.float32)
    mean, chances = world.mean(seen, unseen), world.own(seen, unseen)
    actions = choose(chances, np.random.default_rng([world.seed, LOG, 1]))
    got = noise(np.random.default_rng([world.seed, LOG, 2]), mean[np.arange(rows), actions])
    columns = dict(extras or {})
    if facts.get("known", True):
        columns["behavior_log_probs"] = np.log(chances[np.arange(rows), actions])
    log = Dataset.from_arrays(
        observations=seen, actions=actions, rewards=got, terminals=np.ones(rows, bool), next_observations=seen,
        action_space=Discrete(chances.shape[1]), name=name, **columns,
    )  # fmt: skip
    return Problem(log, ONE, world, candidates, {"mean": mean, "chances": chances, "unseen": unseen}, **facts)


def linear(rng: np.random.Generator, size: int, actions: int) -> np.ndarray:
    """(size, actions) weights whose sums over standard normal contexts have deviation one."""
    return rng.standard_normal((size, actions)) / np.sqrt(size)


# ---- noise ----------------------------------------------------------------------------------------------------------

NOISES: dict[str, Callable[[np.random.Generator, np.ndarray], np.ndarray]] = {
    "normal": lambda rng, mean: mean + rng.standard_normal(len(mean)),
    "exponential": lambda rng, mean: mean - 1.0 + rng.exponential(size=len(mean)),
    "bernoulli": lambda rng, mean: (rng.random(len(mean)) < mean).astype(float),
    "rare": lambda rng, mean: (rng.random(len(mean)) < mean).astype(float),
    "heavy": lambda rng, mean: mean + rng.standard_t(3, len(mean)),
}
SHAPES = ((2, 3), (5, 5), (20, 10))  # features and actions; few, so that programs are compiled for few


def null(known: bool) -> Callable[[int, int], Problem]:
    """Rewards are noise of one mean, whatever is seen and done."""

    def make(seed: int, rows: int) -> Problem:
        rng = np.random.default_rng([seed, WORLD])
        size, actions = SHAPES[rng.integers(len(SHAPES))]
        kind = list(NOISES)[rng.integers(len(NOISES))]
        level = {"bernoulli": 0.5, "rare": 0.03}.get(kind, 1.0)
        weights, decided = linear(rng, size, actions), rng.choice([0.0, 1.0, 2.0])
        chances = lambda seen: softmax(decided * seen @ weights)  # noqa: E731
        world = Bandit(
            lambda rng, n: (rng.standard_normal((n, size), np.float32), np.zeros((n, 0))),
            lambda seen, unseen: np.full((len(seen), actions), level), chances, seed,
        )  # fmt: skip
        turns = [linear(rng, size, actions) for _ in range(2)]
        candidates = {
            f"turned {i}": Choices(lambda seen, turn=turn: tilted(chances(seen), seen @ turn, 1.0))
            for i, turn in enumerate(turns)
        }
        return problem(world, rows, NOISES[kind], candidates, f"null-{kind}", known=known, null=True)

    return make


# ---- classes --------------------------------------------------------------------------------------------------------


@cache
def generative(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A data set of scikit-learn as one Gaussian a class, of its first principal components in their deviations.

    Returns:
        Shares of the classes, means (classes, d), and factors of the covariances (classes, d, d).
    """
    from sklearn import datasets

    x, y = getattr(datasets, f"load_{name}")(return_X_y=True)
    x = (x - x.mean(0)) / np.maximum(x.std(0), 1e-9)
    most = {"iris": 4, "wine": 8, "breast_cancer": 8, "digits": 16}[name]
    _, _, axes = np.linalg.svd(x, full_matrices=False)
    x = x @ axes[:most].T
    x = x / x.std(0)
    means, factors = [], []
    for c in range(y.max() + 1):
        own = x[y == c]
        # Wider than the classes are, so that they overlap and no action is right for certain.
        covariance = 2.0 * (0.9 * np.cov(own.T) + 0.1 * np.eye(most))
        means.append(own.mean(0))
        factors.append(np.linalg.cholesky(covariance))
    return np.bincount(y) / len(y), np.array(means), np.array(factors)


def posterior(name: str, seen: np.ndarray) -> np.ndarray:
    """(n, classes) exact probabilities of the classes."""
    shares, means, factors = generative(name)
    logs = np.empty((len(seen), len(shares)))
    for c, (share, mean, factor) in enumerate(zip(shares, means, factors)):
        z = (seen - mean) @ np.linalg.inv(factor).T
        logs[:, c] = np.log(share) - np.log(np.diag(factor)).sum() - 0.5 * np.square(z).sum(1)
    return softmax(logs)


def discriminant(name: str, seen: np.ndarray) -> np.ndarray:
    """(n, classes) scores of linear discriminant analysis: log-probabilities if the classes had one covariance."""
    shares, means, factors = generative(name)
    pooled = np.einsum("c,cij,ckj->ik", shares, factors, factors)
    weights = np.linalg.solve(pooled, means.T)
    return seen @ weights - 0.5 * (means * weights.T).sum(1) + np.log(shares)


def contexts(name: str) -> Callable[[np.random.Generator, int], tuple[np.ndarray, np.ndarray]]:
    """Draws of the generative model."""
    shares, means, factors = generative(name)

    def draw(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
        which, z = rng.choice(len(shares), n, p=shares), rng.standard_normal((n, means.shape[1]))
        seen = np.empty_like(z)
        for c in range(len(shares)):
            own = which == c
            seen[own] = means[c] + z[own] @ factors[c].T
        return seen, np.zeros((n, 0))

    return draw


def classes(known: bool, linear_own: bool) -> Callable[[int, int], Problem]:
    """An action is a guess of the class; a reward is 1 where it is right, and the other way round by chance.

    The log's own policy is drawn to the right classes as a linear classifier sees them, or as they are, which no model learns
    from a few thousand rows where there are many classes.
    """

    def make(seed: int, rows: int) -> Problem:
        rng = np.random.default_rng([seed, WORLD])
        name = ("iris", "wine", "breast_cancer", "digits")[rng.integers(4)]
        flips = rng.choice([0.0, 0.2, 0.4])
        draw, (shares, means, _) = contexts(name), generative(name)
        probs = lambda seen: posterior(name, seen)  # noqa: E731
        mean = lambda seen, unseen: flips + (1.0 - 2.0 * flips) * probs(seen)  # noqa: E731
        right = (lambda seen: discriminant(name, seen)) if linear_own else (lambda seen: np.log(probs(seen) + 1e-6))
        if rng.random() < NEAR:

            def chances(seen):
                best = softmax(right(seen)) if linear_own else np.eye(len(shares))[right(seen).argmax(1)]
                return 0.05 / len(shares) + 0.95 * best
        else:
            weights = linear(rng, means.shape[1], len(shares))
            blend, share, decided = rng.uniform(0.0, 1.0), rng.uniform(0.05, 0.3), rng.uniform(0.5, 1.5)

            def chances(seen):
                logits = blend * right(seen) / 3.0 + (1.0 - blend) * seen @ weights
                return share / len(shares) + (1.0 - share) * softmax(decided * logits)

        world = Bandit(draw, mean, chances, seed)
        by = (rng.uniform(0.3, 1.0), -rng.uniform(0.3, 1.0))
        candidates = {
            word: Choices(lambda seen, by=by: tilted(chances(seen), probs(seen), by))
            for word, by in zip(("better", "worse"), by)
        }
        bernoulli = lambda rng, mean: (rng.random(len(mean)) < mean).astype(float)  # noqa: E731
        return problem(world, rows, bernoulli, candidates, f"classes-{name}", known=known)

    return make


# ---- actions that the log lacks --------------------------------------------------------------------------------------


def missing(supported: bool, known: bool) -> Callable[[int, int], Problem]:
    """Candidates take the last action 30 % of the time; the log never does, or in the twin in 10 to 15 % of its rows.

    Twins share world, contexts and candidates: the seed decides these, and the support the log's probabilities alone.
    """

    def make(seed: int, rows: int) -> Problem:
        rng = np.random.default_rng([seed, WORLD])
        size, actions = ((5, 4), (10, 6))[rng.integers(2)]
        weights, turn = linear(rng, size, actions), linear(rng, size, actions - 1)
        level, share, scale = rng.uniform(-1.0, 1.0), rng.uniform(0.10, 0.15), rng.choice([0.5, 1.0, 2.0])
        near = rng.random() < 0.5

        def mean(seen, unseen):
            out = 0.5 * np.sin(seen @ weights)
            out[:, -1] += level  # what the log does not show may be good or bad
            return out

        def base(seen):
            logits = 8.0 * np.sin(seen @ weights[:, :-1]) if near else seen @ turn
            return np.pad(0.2 / (actions - 1) + 0.8 * softmax(logits), ((0, 0), (0, 1)))

        last = np.eye(actions)[-1]
        chances = (lambda seen: (1.0 - share) * base(seen) + share * last) if supported else base
        always = Choices(lambda seen: 0.7 * base(seen) + 0.3 * last)
        others = linear(rng, size, 1)

        def sometimes(seen):
            often = 0.6 / (1.0 + np.exp(-3.0 * seen @ others))  # 30 % on average
            return (1.0 - often) * base(seen) + often * last

        world = Bandit(lambda rng, n: (rng.standard_normal((n, size), np.float32), np.zeros((n, 0))), mean, chances, seed)
        noise = lambda rng, mean: mean + scale * rng.standard_normal(len(mean))  # noqa: E731
        candidates = {"always": always, "sometimes": Choices(sometimes)}
        name = "supported" if supported else "missing"
        return problem(world, rows, noise, candidates, name, known=known, supported=supported)

    return make


# ---- users ----------------------------------------------------------------------------------------------------------


def users(seed: int, rows: int) -> Problem:
    """Episodes of users, each of whom has a taste of actions, a mood and a place among the contexts, in all its episodes."""
    rng = np.random.default_rng([seed, WORLD])
    count, size, actions = int(rng.choice([20, 40, 100])), 6, 4
    rows = max(rows, 5 * count)
    mood, taste = rng.choice([0.0, 0.5, 1.5]), rng.choice([0.3, 1.0])
    effect, weights, turn = rng.choice([0.0, 0.5]), linear(rng, size, actions), linear(rng, size, actions)

    def of_users(rng, n):
        return rng.standard_normal((n, 1 + actions + size))

    def context(rng, own):
        return (0.7 * own[:, 1 + actions :] + 0.7 * rng.standard_normal((len(own), size))).astype(np.float32)

    def draw(rng, n):
        own = of_users(rng, n)
        return context(rng, own), own

    def mean(seen, own):
        return effect * (seen @ weights) + mood * own[:, :1] + taste * own[:, 1 : 1 + actions]

    chances = lambda seen: 0.1 / actions + 0.9 * softmax(seen @ turn)  # noqa: E731
    rng_log = np.random.default_rng([seed, LOG])
    # Some users come more often than others.
    often = rng_log.dirichlet(np.full(count, 3.0))
    user = np.sort(np.concatenate([np.repeat(np.arange(count), 2), rng_log.choice(count, rows - 2 * count, p=often)]))
    own = of_users(rng_log, count)[user]
    turns = [linear(rng, size, actions) for _ in range(1)]
    candidates = {
        "better": Choices(lambda seen: tilted(chances(seen), seen @ weights, rng_by)),
        "turned": Choices(lambda seen: tilted(chances(seen), seen @ turns[0], 0.7)),
    }
    rng_by = float(rng.uniform(0.3, 1.0))
    noise = lambda rng, mean: mean + rng.standard_normal(len(mean))  # noqa: E731
    world = Bandit(draw, mean, chances, seed)
    return problem(
        world, rows, noise, candidates, "users", (context(rng_log, own), own), {"user": user}, cluster="user",
        null=bool(effect == 0.0),
    )  # fmt: skip


# ---- many actions ----------------------------------------------------------------------------------------------------


def many(seed: int, rows: int) -> Problem:
    """Fifty actions, of which the log prefers some; those that are good are so for some contexts."""
    rng = np.random.default_rng([seed, WORLD])
    size, actions = 10, 50
    near = rng.random() < NEAR
    weights, level = linear(rng, size, actions), rng.normal(0.0, 0.5, actions)
    turn, share = linear(rng, size, actions), rng.uniform(0.1, 0.5)
    probs = lambda seen: 1.0 / (1.0 + np.exp(1.0 - level - 0.7 * seen @ weights))  # noqa: E731
    mean = lambda seen, unseen: probs(seen)  # noqa: E731

    def chances(seen):
        return share / actions + (1.0 - share) * softmax(8.0 * probs(seen) if near else 1.5 * seen @ turn)

    world = Bandit(lambda rng, n: (rng.standard_normal((n, size), np.float32), np.zeros((n, 0))), mean, chances, seed)
    by = float(rng.uniform(0.3, 1.0))
    candidates = {
        "better": Choices(lambda seen: tilted(chances(seen), probs(seen), by)),
        "worse": Choices(lambda seen: tilted(chances(seen), probs(seen), -by)),
    }
    return problem(world, rows, NOISES["bernoulli"], candidates, "many-actions")


# ---- changes along the log -------------------------------------------------------------------------------------------


def course(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """A function of time in [0, 1] with values from -1 to 1: a trend, a step, or one or two seasons."""
    kind, sign, when = rng.integers(3), rng.choice([-1.0, 1.0]), rng.uniform(0.25, 0.75)
    seasons = rng.integers(1, 3)
    if kind == 0:
        return lambda t: sign * (2.0 * t - 1.0)
    if kind == 1:
        return lambda t: sign * np.where(t < when, -1.0, 1.0)
    return lambda t: sign * np.sin(2.0 * np.pi * (seasons * t + when))


def drifting(null: bool, constant: bool) -> Callable[[int, int], Problem]:
    """The log's own policy changes along the log, and so do rewards, alike or not, unless these are constant in time.

    What changes in the rewards is the same for all actions, so that gains do not depend on it. The log does not tell the
    probabilities of its actions.
    """

    def make(seed: int, rows: int) -> Problem:
        rng = np.random.default_rng([seed, WORLD])
        size, actions = ((2, 2), (5, 3), (5, 5))[rng.integers(3)]
        policy, alike = course(rng), rng.random() < 0.5
        rewards = policy if alike else course(rng)
        by, much = rng.choice([0.3, 1.0, 2.0]), rng.choice([0.1, 0.3, 1.0]) * (not constant)
        turn, weights = linear(rng, size, actions), linear(rng, size, actions)
        liked, effect = rng.permutation(np.linspace(-1.0, 1.0, actions)), rng.choice([0.3, 1.0]) * (not null)
        mean = lambda seen, t: much * rewards(t) + effect * (seen @ weights)  # noqa: E731
        mixed = lambda logits: 0.1 / actions + 0.9 * softmax(logits)  # noqa: E731
        chances = lambda seen: mixed(seen @ turn)  # noqa: E731
        world = Bandit(
            lambda rng, n: (rng.standard_normal((n, size), np.float32), rng.random((n, 1))), mean, chances, seed,
            lambda seen, t: mixed(seen @ turn + by * policy(t) * liked),
        )  # fmt: skip
        strength = rng.uniform(0.3, 1.0, 2)
        candidates = {
            "liked": Choices(lambda seen: tilted(chances(seen), liked + 0.0 * seen[:, :1], strength[0])),
            "better": Choices(lambda seen: tilted(chances(seen), seen @ weights, strength[1])),
        }
        drawn, _ = world.contexts(np.random.default_rng([seed, LOG]), rows)
        time = ((np.arange(rows) + 0.5) / rows)[:, None]
        return problem(world, rows, NOISES["normal"], candidates, "drifting", (drawn, time), known=False, null=null)

    return make


def fate(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """What becomes of an effect over time in [0, 1]: it stays, reverses, wears off or grows."""
    kind, when, rest = rng.integers(4), rng.uniform(0.4, 0.65), rng.uniform(0.3, 1.0)
    if kind == 0:
        return np.ones_like
    if kind == 1:
        return lambda t: np.where(t < when, 1.0, -rest)
    return (lambda t: np.exp(-t / (0.5 * when))) if kind == 2 else (lambda t: t)


class Latest(Bandit):
    """A world whose unseen part is the time, and in which what is true is so in the latest third of the log."""

    def scores(self, policy: Any, log: Dataset, hidden: Any) -> np.ndarray:
        """Of the latest third alone."""
        late = hidden["unseen"][:, 0] >= LATE
        return np.where(late, super().scores(policy, log, hidden) / max(late.mean(), 1e-12), 0.0)


def reversing(seed: int, rows: int) -> Problem:
    """Effects of actions that change along the log. What is true of a policy is so in the latest third of the log."""
    rng = np.random.default_rng([seed, WORLD])
    size, actions = ((2, 2), (5, 3), (5, 5))[rng.integers(3)]
    effect, time, known = rng.choice([0.3, 1.0]), fate(rng), bool(rng.random() < 0.5)
    turn, weights = linear(rng, size, actions), linear(rng, size, actions)
    chances = lambda seen: 0.1 / actions + 0.9 * softmax(seen @ turn)  # noqa: E731
    world = Latest(
        lambda rng, n: (rng.standard_normal((n, size), np.float32), rng.uniform(LATE, 1.0, (n, 1))),
        lambda seen, t: effect * time(t) * (seen @ weights), chances, seed,
    )  # fmt: skip
    by = float(rng.uniform(0.3, 1.0))
    candidates = {
        "early": Choices(lambda seen: tilted(chances(seen), seen @ weights, by)),
        "other": Choices(lambda seen: tilted(chances(seen), seen @ weights, -by)),
    }
    drawn, _ = world.contexts(np.random.default_rng([seed, LOG]), rows)
    place = ((np.arange(rows) + 0.5) / rows)[:, None]
    return problem(world, rows, NOISES["normal"], candidates, "reversing", (drawn, place), known=known)


NEVER = "none: all policies have the same value"
FAMILIES = (
    Family("null-bandit", null(True), NEVER),
    Family("null-bandit-unknown", null(False), NEVER),
    Family("classes", classes(True, False), BETTER),
    Family("classes-unknown", classes(False, True), "as in `classes`"),
    Family("classes-rough", classes(False, False), "as in `classes`, of which it is a variant"),
    Family(
        "missing", missing(False, True),
        "where the action that the log lacks is good or the behaviour policy is not nearly optimal",
    ),
    Family("missing-unknown", missing(False, False), "as in `missing`"),
    Family("supported", missing(True, True), "as in `missing`, of which it is a variant"),
    Family("supported-unknown", missing(True, False), "as in `supported`"),
    Family("users", users, "in half of the logs; in the others the preferences cancel and all policies have the same value"),
    Family("many-actions", many, BETTER, split="confirmatory"),
    Family("drifting-null", drifting(True, False), NEVER),
    Family("drifting", drifting(False, False), "in nearly all logs (`better`)"),
    Family("drifting-constant", drifting(False, True), "as in `drifting`, of which it is a variant with constant rewards"),
    Family("reversing", reversing, "in all logs, judged by the latest third: `early`, or `other` where effects have reversed"),
)
