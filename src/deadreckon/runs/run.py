"""A run in its folder: its settings, its results and its policies."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from deadreckon.errors import UserError
from deadreckon.files import copy_folder
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.loaded import TablePolicy
from deadreckon.provided import Shown
from deadreckon.runs.folder import TRACKED, Folder, policy_seed
from deadreckon.runs.records import checked_rows, read_status
from deadreckon.training.fit import Failure


@dataclasses.dataclass
class Run(Shown):
    """A finished (or failed) run: its folder and its results.

    Attributes:
        path: the run folder.
        config: its settings.
        seeds: one per lane.
        policies: one per seed; for a failed lane, the last good one.
        failures: per seed None, or the metric and step at which it diverged.
    """

    path: Path
    config: dict[str, Any]
    seeds: list[int]
    policies: list[EnvPolicy]
    failures: list[Failure | None]
    _predictor: TablePolicy | None = dataclasses.field(default=None, init=False, repr=False, compare=False)

    @property
    def policy(self) -> EnvPolicy:
        """The first seed's policy."""
        return self.policies[0]

    @property
    def metrics(self) -> pa.Table:
        """step, seed and one column per metric, with a row per chunk and seed."""
        return checked_rows(self.path / "metrics", "metrics", Folder(self.path).table("metrics"))

    @property
    def evaluations(self) -> pa.Table:
        """One row per episode of every periodic evaluation."""
        return checked_rows(self.path / "evaluations", "evaluations", Folder(self.path).table("evaluations"))

    @property
    def taught(self) -> np.ndarray | None:
        """(learning,) uint64 `episode_ids` of its training episodes; None if not known: for unfinished online runs, and for
        online runs of versions that did not record their own steps."""
        found = Folder(self.path).episodes("taught")
        return None if found is not None and not len(found) and "online" in self.config else found

    @property
    def held(self) -> np.ndarray | None:
        """(held,) uint64 `episode_ids` of the episodes of its log that it was not trained on; None as for `taught`."""
        return Folder(self.path).episodes("held")

    def save(self, path: Path | str) -> Path:
        """Copies the run folder, from which the run can be loaded and resumed, to a new place; returns the copy's path. Files
        of Weights & Biases are left out.

        Raises:
            UserError: the path exists already, or cannot be written.
        """
        return copy_folder(self.path, path, TRACKED)

    @classmethod
    def load(cls, path: Path | str) -> "Run":
        """A run that was saved, or its own folder; the same as `deadreckon.load_run`."""
        return load(path)

    def predictor(self, seed: int | None = None) -> TablePolicy:
        """A seed's policy as a predictor for rows of a table with the log's column names.

        Args:
            seed: one of `seeds`; None: the first that has not failed.

        Raises:
            UserError: the run has no such seed.
        """
        which = policy_seed(str(self.path), self.seeds, self.failures, seed)
        log = store.meta(Folder(self.path).policy(which)).get("log", {})
        return TablePolicy(self.policies[self.seeds.index(which)], log)

    def predict(self, rows: Any, **options: Any) -> Any:
        """Named actions for rows of a table, by the policy of the first seed that has not failed.

        See `policies.table_predict.Predictor.predict`, whose options it takes; `predictor(seed).predict` takes another seed.

        Raises:
            UserError: one line with the column, the row (counted from 0) and a valid value.
        """
        if self._predictor is None:
            self._predictor = self.predictor()
        return self._predictor.predict(rows, **options)

    def __repr__(self) -> str:
        return f"Run({self.path}, {self.config['agent']['name']}, seeds {self.seeds})"


def load(path: Path | str) -> Run:
    """A run from its folder.

    Raises:
        UserError: the folder holds no run, or one that is not finished.
    """
    folder = Folder(Path(path))
    if not folder.config.exists():
        raise UserError(f"{path} holds no run (no run.json)")
    config = folder.read_config()
    if not folder.has_policies():
        again = "train_together" if "together" in config else f"deadreckon train ... --out {path} --resume"
        raise UserError(f"{path} is not finished; `{again}` resumes it")
    status = read_status(folder.status, len(config["seeds"]))
    policies = [store.load(folder.policy(seed)) for seed in config["seeds"]]
    failures = [None if f is None else Failure(*f) for f in status.get("failures") or [None] * len(config["seeds"])]
    return Run(folder.path, config, config["seeds"], policies, failures)
