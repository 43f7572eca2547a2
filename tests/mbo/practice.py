"""Six synthetic tables as people have them, with the function that scores their designs: nothing here is shown to methods."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from deadreckon.mbo.designs import Designs

COLOURS = {"red": 0.0, "green": 1.0, "blue": -1.0}
SIZES = ("small", "medium", "large", "huge")


class Table(NamedTuple):
    """A table of designs, what it is read with, the true score of a design given as a row, and a measurement's deviation."""

    columns: dict[str, list[Any]]
    options: dict[str, Any]
    truth: Callable[[dict[str, Any]], float]
    noise: float = 0.0

    def designs(self, **more: Any) -> Designs:
        """As designs; `more` are options beside the table's own."""
        return Designs.from_frame(self.columns, "y", **self.options, **more)

    def true(self, data: Designs, x: np.ndarray) -> np.ndarray:
        """(n,) true scores of designs."""
        decoded = data.decode(x)
        return np.array([self.truth({name: values[i] for name, values in decoded.items()}) for i in range(len(x))])


def _table(rows: list[dict], truth: Callable, noise: float, rng: np.random.Generator, **options: Any) -> Table:
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    return Table(columns | {"y": [truth(row) + noise * rng.standard_normal() for row in rows]}, options, truth, noise)


def mixed(rows: int = 80, seed: int = 0) -> Table:
    """Two numbers, a whole number and a category; one number on a log scale, one in steps."""
    rng = np.random.default_rng(seed)
    made = [
        {"heat": 5 * int(rng.integers(0, 21)), "rate": round(10 ** rng.uniform(-3, 0), 5), "layers": int(rng.integers(1, 9)),
         "colour": str(rng.choice(list(COLOURS)))} for _ in range(rows)
    ]  # fmt: skip

    def truth(row: dict) -> float:
        numbers = (row["heat"] / 25 - 2.4) ** 2 + (np.log10(row["rate"]) + 1.5) ** 2 + 0.2 * (row["layers"] - 6) ** 2
        return 10 - numbers + COLOURS[row["colour"]]

    return _table(made, truth, 0.2, rng, steps={"heat": 5}, logs=["rate"])


def mixture(rows: int = 60, seed: int = 0) -> Table:
    """Four parts that sum to one, and a temperature."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(rows):
        parts = np.round(rng.dirichlet([2.0] * 4), 3)
        parts[-1] = round(1 - parts[:3].sum(), 3)
        made.append({**dict(zip("ABCD", map(float, parts))), "temp": round(rng.uniform(20, 90), 1)})

    def truth(row: dict) -> float:
        far = (row["A"] - 0.45) ** 2 + (row["B"] - 0.35) ** 2 + (row["C"] - 0.15) ** 2 + 3 * row["D"] ** 2
        return 5 - 10 * far - ((row["temp"] - 65) / 30) ** 2

    return _table(made, truth, 0.05, rng, mixtures=[list("ABCD")])


def replicated(designs: int = 25, seed: int = 0) -> Table:
    """Three numbers, each design measured one to four times with much noise."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(designs):
        row = {name: round(rng.uniform(0, 10), 1) for name in "abc"}
        made += [dict(row)] * int(rng.integers(1, 5))

    def truth(row: dict) -> float:
        return 20 - (row["a"] - 6) ** 2 / 4 - (row["b"] - 3) ** 2 / 4 + row["c"] / 2

    return _table(made, truth, 1.0, rng)


def constrained(rows: int = 70, seed: int = 0) -> Table:
    """Three numbers under two linear constraints, and a combination that is forbidden; data break some of them."""
    rng = np.random.default_rng(seed)
    drawn = lambda: {name: round(rng.uniform(0, 1), 3) for name in "abc"}  # noqa: E731
    made = [{**drawn(), "solvent": str(rng.choice(["water", "oil"]))} for _ in range(rows)]

    def truth(row: dict) -> float:
        return 3 * row["a"] + 2 * row["b"] - (row["c"] - 0.6) ** 2 + (row["solvent"] == "water")

    rules = {"constraints": ["a + b <= 0.8", "2 c - a >= 0.3"], "forbidden": ["solvent = water & a > 0.4"]}
    return _table(made, truth, 0.05, rng, **rules)


def wide(rows: int = 120, seed: int = 0, variables: int = 24) -> Table:
    """Many numbers, of which four matter."""
    rng = np.random.default_rng(seed)
    names = [f"x{i}" for i in range(variables)]
    made = [dict(zip(names, map(float, rng.uniform(-1, 1, variables).round(3)))) for _ in range(rows)]

    def truth(row: dict) -> float:
        return 2 * row["x0"] - (row["x1"] - 0.5) ** 2 - (row["x2"] + 0.5) ** 2 + row["x3"] * row["x0"]

    return _table(made, truth, 0.05, rng)


def ordinal(rows: int = 60, seed: int = 0) -> Table:
    """Ordered texts, ordered numbers with gaps under a constraint, one number that is fixed, and one that is free."""
    rng = np.random.default_rng(seed)
    made = [
        {"size": str(rng.choice(SIZES)), "dose": int(rng.choice([10, 20, 50, 100])), "temp": float(rng.choice([40, 50, 60])),
         "time": round(rng.uniform(1, 5), 2)} for _ in range(rows)
    ]  # fmt: skip

    def truth(row: dict) -> float:
        ordered = (SIZES.index(row["size"]) - 2) ** 2 + ((row["dose"] - 50) / 40) ** 2
        return row["temp"] / 30 - ordered - (row["time"] - 3) ** 2

    return _table(
        made, truth, 0.1, rng, kinds={"size": "ordinal", "dose": "ordinal"}, levels={"size": list(SIZES)}, fixed=["temp = 60"],
        constraints=["dose + 20 time <= 130"],
    )  # fmt: skip


TABLES = {each.__name__: each for each in (mixed, mixture, replicated, constrained, wide, ordinal)}


def hill(rng: np.random.Generator, inputs: int) -> Callable[[np.ndarray], np.ndarray]:
    """A random function of (n, inputs) designs in [0, 1], of deviation 1: a hill, a slope, and a wave of two inputs."""
    centre, weight = rng.uniform(0.2, 0.8, inputs), rng.uniform(0, 2, inputs)
    slope, wave = rng.normal(size=inputs), rng.uniform(0, 0.5)
    raw = lambda x: (  # noqa: E731
        -(weight * np.square(x - centre)).sum(1) + 0.3 * x @ slope + wave * np.sin(6 * x[:, 0]) * x[:, 1]
    )
    drawn = raw(rng.uniform(size=(4000, inputs)))
    return lambda x: (raw(x) - drawn.mean()) / drawn.std()
