"""A policy of two layers of 256 units on a table of twelve columns, untrained, for measuring its use."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.kinds import Categorical
from deadreckon.runs.reading import noted

COLUMNS = 12


def table(rows: int, seed: int = 0) -> pd.DataFrame:
    """Eight columns of numbers, one with missing values, a flag, a count, two of levels; and the action and the reward."""
    rng = np.random.default_rng(seed)
    columns: dict[str, Any] = {f"number_{i}": rng.normal(20.0, 5.0, rows) for i in range(8)}
    columns["number_7"][::7] = np.nan
    columns |= {"member": rng.random(rows) < 0.5, "offers": rng.integers(0, 9, rows)}
    columns["plan"] = rng.choice(["free", "pro", "team"], rows)
    columns["country"] = rng.choice([f"country {i}" for i in range(20)], rows)
    return pd.DataFrame(columns | {"offer": rng.choice(["call", "mail", "none", "visit"], rows), "paid": rng.normal(size=rows)})


def saved(path: Path) -> Path:
    """The policy's file."""
    log = Dataset.from_frame(table(2_000), action="offer", reward="paid")
    policy = EnvPolicy.of(Categorical.create(log.spec, (256, 256), jax.random.key(0)), Normalizer.of(log.spec, True))
    store.save(path, policy, {"log": noted(log)})
    return path
