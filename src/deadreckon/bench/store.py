"""Results: one row per cell, and the curves behind them, in Parquet parts that are written once and never changed.

    results/JOB.parquet    a row per cell
    curves/JOB.parquet     a row an evaluation of a cell
    failed/CELL.json       why a cell's job ended without results; gone when it has some
    runs/JOB               the job's run folder; of jobs that shared a program runs/PROGRAM/JOB

Every part has a name of its own and appears whole, so any number of writers may share a folder.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from deadreckon.bench.checked import check_part
from deadreckon.bench.jobs import Job, Program, estimator_class, file_name, job_of
from deadreckon.errors import reading
from deadreckon.files import read_json, replacing, write_json
from deadreckon.foreign.parquet import read_parquet
from deadreckon.names import safe_path

RESULT = pa.schema(
    [
        ("cell", pa.string()),  # content-derived name, the revisions included
        ("content", pa.string()),  # the same without the revisions
        ("suite", pa.string()),
        ("kind", pa.string()),
        ("method", pa.string()),
        ("agent", pa.string()),
        ("settings", pa.string()),  # JSON
        ("preset", pa.string()),
        ("on", pa.string()),
        ("data", pa.string()),
        ("asked", pa.string()),  # JSON
        ("seed", pa.int64()),
        ("score", pa.float64()),  # normalised; of designs the best
        ("raw", pa.float64()),  # undiscounted return, or the best design's score by the oracle
        ("more", pa.string()),  # JSON: further numbers by name; of runs the metrics of their last chunk
        ("episodes", pa.list_(pa.float64())),  # the scores of the last evaluation, which `score` is the mean of
        ("log", pa.string()),  # fingerprint of the log that was learned from
        ("failure", pa.string()),  # of this seed: which metric was not finite, and when
        ("seconds", pa.float64()),  # of a processor, and of the whole program, however often it was taken up again
        ("steps", pa.int64()),
        ("revisions", pa.string()),  # JSON; missing where the source was hashed instead, which is no revision of today's
        ("versions", pa.string()),  # JSON
        ("finished", pa.string()),  # date and time, UTC
        ("job", pa.string()),  # its run folder in `runs`
    ]
)
CURVE = pa.schema(
    [("cell", pa.string()), ("step", pa.int64()), ("score", pa.float64()), ("raw", pa.float64()), ("spread", pa.float64())]
)


@dataclass(frozen=True)
class JobResult:
    """The results of a job: its rows and its learning curves."""

    rows: list[dict[str, Any]]
    curves: list[dict[str, Any]]


@dataclass(frozen=True)
class Store:
    """A folder of results."""

    path: Path

    @property
    def place(self) -> Path:
        """Where results lie."""
        return self.path

    def folder(self, program: Program) -> Path:
        """What its runs are in, or its only run's folder."""
        return self.path / "runs" / program.name

    def run_of(self, row: Mapping[str, Any]) -> Path:
        """The run folder of a row, which may come from another machine's results.

        Raises:
            UserError: what the row names lies elsewhere.
        """
        return self.path / "runs" / safe_path(str(row["job"]), f"{self.path}: run")  # of a shared program in that one's folder

    def _part(self, kind: str, job: Job) -> Path:
        return self.path / kind / f"{job.name}.parquet"

    def undone(self, jobs: Sequence[Job]) -> list[Job]:
        """What is to be done for cells without results, each of them once: of a job that is done in part the rest."""
        done = set(self.results()["cell"].to_pylist())
        waiting = []
        for job in jobs:
            missing = [seed for seed, cell in zip(job.seeds, job.cells) if cell not in done]
            done.update(job.cells)
            # A run has consecutive seeds.
            starts = [i for i, seed in enumerate(missing) if i == 0 or seed != missing[i - 1] + 1]
            for start, end in zip(starts, [*starts[1:], len(missing)]):
                waiting.append(dataclasses.replace(job, seeds=tuple(missing[start:end])))
        return waiting

    def keep(self, job: Job, found: JobResult, run: str | None = None) -> None:
        """Writes a job's results; the rows come last, as they say that it is done.

        Args:
            job: the job.
            found: its results.
            run: its run folder in `runs`, where that is not of its name.
        """
        self._write(job, rows_of(job, found, run), found.curves)
        for seed in job.seeds:
            self._failed(job, seed).unlink(missing_ok=True)

    def _write(self, job: Job, rows: list[dict[str, Any]], curves: list[dict[str, Any]]) -> None:
        for kind, schema, table in (("curves", CURVE, curves), ("results", RESULT, rows)):
            with replacing(self._part(kind, job)) as temporary:
                pq.write_table(pa.Table.from_pylist(table, schema=schema), temporary)

    def fail(self, job: Job, error: str, trace: str) -> None:
        """Takes note of why a job ended without results."""
        about = {"method": job.method, "on": job.on, "seeds": list(job.seeds), "error": error, "trace": trace}
        for seed in job.seeds:
            write_json(self._failed(job, seed), about)

    def _failed(self, job: Job, seed: int) -> Path:
        return self.path / "failed" / f"{file_name(f'{job.method}-{job.on}')}-{job.cell(seed)}.json"

    def failure(self, job: Job, seed: int) -> dict[str, Any] | None:
        """Why the job of that cell ended without results, where that is the last thing that happened to it."""
        path = self._failed(job, seed)
        return read_json(path) if path.exists() else None

    def results(self) -> pa.Table:
        """All rows."""
        return self._all("results", RESULT)

    def curves(self) -> pa.Table:
        """All curves."""
        return self._all("curves", CURVE)

    def _all(self, kind: str, schema: pa.Schema) -> pa.Table:
        # The newest last, of which `tables` makes use.
        parts = sorted((part.stat().st_mtime_ns, part.name, part) for part in (self.path / kind).glob("*.parquet"))
        tables = [_read(part, when, kind) for when, _, part in parts]
        with reading(self.path / kind, "tables of results"):  # older parts may lack a column
            return pa.concat_tables([schema.empty_table(), *tables], promote_options="default")

    def of(self, jobs: Sequence[Job], any_revision: bool = False) -> pa.Table:
        """The rows of these jobs' cells; with `any_revision` also those that other revisions of the code made."""
        wanted = [name(seed) for job in jobs for name in [job.content if any_revision else job.cell] for seed in job.seeds]
        found = _with_present_names(self.results()) if any_revision else self.results()
        found = found.filter(np.isin(found["content" if any_revision else "cell"].to_numpy(), wanted))
        # Two commands that pack seeds otherwise may have done a cell both; the newer counts.
        last = {cell: i for i, cell in enumerate(found["cell"].to_pylist())}
        return found.take(pa.array(sorted(last.values()), pa.int64()))


def rows_of(job: Job, found: JobResult, run: str | None = None) -> list[dict[str, Any]]:
    """Whole rows: what a job found, and what it was asked; `run` is its run folder, where that is not of its name."""
    common = {
        "finished": datetime.now(UTC).isoformat(timespec="seconds"), "suite": job.suite,
        "kind": job.kind, "method": job.method, "agent": job.agent, "settings": json.dumps(job.settings),
        "preset": job.preset, "on": job.on, "data": job.data, "asked": json.dumps(job.options), "job": run or job.name,
        "revisions": json.dumps(job.revisions),
    }  # fmt: skip
    return [common | {"cell": job.cell(row["seed"]), "content": job.content(row["seed"])} | row for row in found.rows]


def _with_present_names(rows: pa.Table) -> pa.Table:
    """Rows with `content` recomputed under the present names of fields, of which some were written under other names."""
    from deadreckon.agents import agent_class, known_agent
    from deadreckon.mbo.registry import designer
    from deadreckon.training.field_names import with_field_names

    contents = []
    for row in rows.to_pylist():
        settings, options = json.loads(row["settings"]), json.loads(row["asked"])
        if row["kind"] in ("learn", "online") and known_agent(row["agent"]):
            settings = with_field_names(agent_class(row["agent"]), settings)
        elif row["kind"] == "design":
            kind = type(designer(row["agent"]))
            settings = with_field_names(kind, settings)
            options |= {"fields": with_field_names(kind, options.get("fields", {}))}
        elif row["kind"] == "ope":
            options |= {"fields": with_field_names(estimator_class(row["agent"]), options.get("fields", {}))}
        contents.append(job_of(row, settings, options).content(row["seed"]))
    return rows.set_column(rows.schema.get_field_index("content"), "content", pa.array(contents, pa.string()))


@cache
def _read(part: Path, written: int, kind: str) -> pa.Table:
    """A part of a kind, read and checked once; `written` tells it from what may lie there later."""
    # A third of the time of reading small parts with threads.
    found = read_parquet(part, "a table of results", threads=False)
    return check_part(part, kind, RESULT if kind == "results" else CURVE, found)
