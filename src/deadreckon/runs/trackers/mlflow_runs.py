"""Runs in MLflow, one for each seed, in the experiment `MLFLOW_EXPERIMENT_NAME`, else `deadreckon`."""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from deadreckon.runs.trackers.tracker import files_of, needed

_SECONDS = 5.0  # between two writes: one of many points takes as long as one of a single point
_MOST = 500  # metrics in one write; MLflow takes 1,000
_PARAMETERS = 100  # in one write, which is MLflow's limit
_LONGEST = 5_000  # letters of a parameter's value
_ID = "deadreckon.id"  # tag by which a run is found when it is resumed


class MLflow:
    """Logs to the server or database that `MLFLOW_TRACKING_URI` names, else to MLflow's default."""

    def __init__(self):
        self.mlflow = needed("mlflow")
        needed("sqlalchemy")  # MLflow's databases, its default among them, need it, and its light package does not bring it
        self.metric = needed("mlflow.entities").Metric

    def start(self, config: Mapping[str, Any]) -> None:
        """See `Tracker`."""
        self.client = self.mlflow.MlflowClient()
        name = os.environ.get("MLFLOW_EXPERIMENT_NAME") or "deadreckon"
        known = self.client.get_experiment_by_name(name)
        experiment = self.client.create_experiment(name) if known is None else known.experiment_id
        self.runs: dict[int, str] = {}
        self.last: dict[tuple[int, str], int] = {}  # (seed, metric): the last step that MLflow has
        self.waiting: dict[int, list[Any]] = {seed: [] for seed in config["seeds"]}
        self.written = time.monotonic()
        for seed in config["seeds"]:
            found = self.client.search_runs([experiment], f"tags.`{_ID}` = '{config['id']}-seed{seed}'")
            self.runs[seed] = found[0].info.run_id if found else self._created(experiment, config, seed)
            if found:
                self.client.update_run(self.runs[seed], status="RUNNING")
                for key in found[0].data.metrics:
                    points = self.client.get_metric_history(self.runs[seed], key)
                    self.last[seed, key] = max(point.step for point in points)

    def _created(self, experiment: str, config: Mapping[str, Any], seed: int) -> str:
        tags = {_ID: f"{config['id']}-seed{seed}", "deadreckon.folder": config["folder"]}
        run = self.client.create_run(experiment, tags=tags, run_name=f"{config['name']} seed {seed}").info.run_id
        told = {"agent": config["agent"]["name"], "data": config["data"]["name"], "task": config["task"], "seed": seed}
        told |= {f"agent.{name}": value for name, value in config["agent"]["fields"].items()}
        told["steps"] = config["steps"]
        parameters = [self.mlflow.entities.Param(name, str(value)[:_LONGEST]) for name, value in told.items()]
        for first in range(0, len(parameters), _PARAMETERS):
            self.client.log_batch(run, params=parameters[first : first + _PARAMETERS])
        return run

    def log(self, step: int, seed: int, metrics: Mapping[str, float]) -> None:
        """See `Tracker`."""
        now = int(1000 * time.time())
        new = {name: value for name, value in metrics.items() if step > self.last.get((seed, name), -1)}
        self.waiting[seed] += [self.metric(name, value, now, step) for name, value in new.items()]
        if time.monotonic() - self.written > _SECONDS:
            self._write()

    def _write(self) -> None:
        for seed, points in self.waiting.items():
            for first in range(0, len(points), _MOST):
                self.client.log_batch(self.runs[seed], metrics=points[first : first + _MOST])
            points.clear()
        self.written = time.monotonic()

    def finish(self, files: Sequence[Path] | None) -> None:
        """See `Tracker`."""
        self._write()
        for seed, run in self.runs.items():
            for path in files_of(seed, files or ()):
                self.client.log_artifact(run, str(path))
            self.client.set_terminated(run, "KILLED" if files is None else "FINISHED")
