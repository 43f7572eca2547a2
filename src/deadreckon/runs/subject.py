"""One policy with its origin and its log, and further logs that are read like its training log."""

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deadreckon.data import catalogue
from deadreckon.data.arrow import to_arrow
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.any_table import read_rows
from deadreckon.data.formats.io import read
from deadreckon.data.held import HELD
from deadreckon.data.schema import Schema
from deadreckon.errors import UserError
from deadreckon.files import is_there, read_json
from deadreckon.names import shown
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.runs.crossfit import MIXTURE
from deadreckon.runs.decision_record import ESTIMATES, is_from, is_same, read_results, records_beside
from deadreckon.runs.folder import Folder
from deadreckon.runs.gather import gather
from deadreckon.runs.player import chosen
from deadreckon.runs.reading import HORIZON, Read, check_encoding, read_like, schema_for
from deadreckon.runs.records import CROSS_FIT
from deadreckon.runs.run import Run, load

GAPS = "missing "  # prefix of the names of extra columns that say where values of a column are missing
FIRST = "fold0"  # first run of a cross-fit; the `run.json` of each describes the whole log
OPTIONAL = ("propensity", "cost", "weight", "group", "keep")  # roles of columns that are not compared


@dataclass(frozen=True)
class Subject:
    """A policy, and its origin as far as it is known.

    Attributes:
        name: of the run or file, and the seed.
        policy: the policy.
        run: name of the run or file, as in `estimates.json`.
        seed: of the run's seeds; None if there is none.
        file: the policy's file; None: none.
        read: how its training log was read.
        told: the record of its log in the policy's file, by which `policies.table_encoder` encodes rows.
        config: `run.json`; None for policies without a run.
        made: `run.json`, of a cross-fit that of its first run; empty for a single file.
        folder: of the run or cross-fit; None for a single file.
        decision: folder of the decision that chose it; None if there is none.
        taught: (episodes,) uint64 `episode_ids` of its training episodes; None if not known.
    """

    name: str
    policy: EnvPolicy
    run: str
    seed: int | None
    file: Path | None
    read: Read
    told: Mapping[str, Any]
    config: Mapping[str, Any] | None = None
    made: Mapping[str, Any] = field(default_factory=dict)
    folder: Path | None = None
    decision: Path | None = None
    taught: np.ndarray | None = None

    @property
    def data(self) -> Mapping[str, Any]:
        """The part of `run.json` about the log; empty for a single file."""
        return self.made.get("data", {})

    @property
    def schema(self) -> Schema | None:
        """The schema of its training table, with the levels and fills that were found; None if there was no table."""
        found = (self.read.extra or {}).get("schema")
        return None if found is None else Schema.from_json(found, self.name)

    def log(self, given: Any = None, gaps: bool = False, *, option: str) -> Dataset:
        """A log, read like the policy's training log; if none is given, the training log.

        Args:
            given: the log, its file or data frame.
            gaps: whether values may be missing in columns that were complete in the training log; see `_with_gaps`.
            option: by which a user gives a log, for errors.

        Raises:
            UserError: it cannot be read in this way, or the training log is not where it was or has changed.
        """
        if isinstance(given, Dataset):
            return self._checked(given)
        if given is not None:
            if not isinstance(given, str | Path | Mapping) and not hasattr(given, "columns"):
                raise UserError(f"a log is a Dataset, a file or a data frame, got {type(given).__name__}")
            return self._checked(self._like(given, gaps))
        known, path = self.data, self.read.path
        if path is None and "name" not in known:
            raise UserError(f"{self.name} does not record where its log is; name it with {option}")
        if "online" in (self.config or {}):
            raise UserError(f"{self.name} was trained in a simulator and has no log of its own; name one with {option}")
        where = shown(known["name"] if path is None else path)[:500]
        if path is not None and not is_there(path):
            raise UserError(f"the log that {self.name} was trained on is not at {where} any more; name it with {option}")
        if is_there(known["name"] if path is None else path) and known.get("fingerprint") is None:
            text = f"it is not known whether {where} is the log that {self.name} was trained on"
            raise UserError(f"{text}: its run.json has no fingerprint; name it with {option}")
        try:
            found = self._like(path) if path is not None else catalogue.load(known["name"])
        except UserError:  # it may quote the file, and a folder from elsewhere may name any file as its log
            text = f"the log that {self.name} was trained on cannot be read again, so name it with {option}"
            raise UserError(f"{text} (it was {where})") from None
        if "fingerprint" in known and found.fingerprint != known["fingerprint"]:
            raise UserError(f"the log that {self.name} was trained on has changed ({where}); name a copy of it with {option}")
        return found

    def learned_from(self, log: Dataset) -> bool:
        """Whether a log is the policy's training log, by its content and not its path; for a single policy file, whether the
        file lists all of the log's episodes."""
        if "fingerprint" not in self.data:
            return self.read.episodes is not None and bool(np.isin(log.episode_ids, self.read.episodes).all())
        kept = {name: column for name, column in log.extras.items() if not name.startswith(GAPS)}
        return replace(log, extras=kept).fingerprint == self.data["fingerprint"]

    def _checked(self, log: Dataset) -> Dataset:
        """The log, if its observations fit the policy."""
        check_encoding(self.name, self.read, log)
        size, here = self.told.get("observation_shape"), log.observations.shape[1:]
        if size is not None and tuple(size) != here:
            text = f"{self.name} takes observations of shape {tuple(size)}, those of {log.name} have {here}"
            if (self.told.get("action_space") or {}).get("masked") and not getattr(log.action_space, "masked", False):
                text += "; its log had legal actions from a function: give a Dataset made with legal=FUNCTION"
            raise UserError(text)
        return log

    def _like(self, given: Any, gaps: bool = False) -> Dataset:
        horizon = (self.read.extra or {}).get(HORIZON)
        if not isinstance(given, str | Path):
            if self.schema is None or horizon is not None:
                raise UserError(f"{self.name} was not trained on a table alone; give the log as a Dataset or a file")
            table, make = to_arrow(given, "frame"), partial(Dataset.from_frame, name="frame")
            there = set(table.column_names)
            return self._with_gaps(partial(make, table), self.schema, there) if gaps else make(table, schema=self.schema)
        schema, path = schema_for(self.name, self.read, given) if gaps else (None, given)
        if schema is None:
            return read_like(self.name, self.read, given)
        there = set(read_rows(path, schema)[0].column_names) if schema.having(*OPTIONAL) else set()
        return self._with_gaps(partial(read, path, horizon=horizon), schema, there)

    def _with_gaps(self, make: Callable[..., Dataset], schema: Schema, there: Container[str]) -> Dataset:
        """A log that may lack values in columns that were complete in the policy's log: these become its mean, or no level.

        The extra columns `missing NAME` say where. A column may not lack values if there is another one called NAME_missing.
        Columns that a log of a policy in use need not have, such as propensities, are left out if they are not `there`.
        """
        extra = self.read.extra or {}
        held = extra.get(HELD) or {}
        observed = schema.having("observation")
        taken = {column.name for column in observed}  # a column may have the name that a mark of missing values would have
        unmarked = [column for column in observed if not column.marked]
        complete = [column for column in unmarked if f"{column.name}_missing" not in taken]
        whole = [replace(column, marked=False) for column in unmarked if column not in complete]
        lenient = [
            replace(column, marked=True, fill=held.get(column.name, {}).get("mean") if column.fill is None else column.fill)
            for column in complete
        ]
        kept = tuple(column for column in schema.columns if column.role not in OPTIONAL or column.name in there)
        schema = replace(schema, columns=kept)
        log = make(schema=schema.resolved([*lenient, *whole]))
        told = dict(log.provenance.extra)
        names = list(told["observation_names"])
        marks = {f"{column.name}_missing": f"{GAPS}{column.name}" for column in complete}
        kept = [i for i, name in enumerate(names) if name not in marks]
        flags = {marks[name]: log.observations[:, i] > 0.5 for i, name in enumerate(names) if name in marks}
        following = None if log.successors is None else log.successors[:, kept]
        told |= {"observation_names": [names[i] for i in kept], "schema": schema.to_json()}
        return replace(
            log, observations=log.observations[:, kept], final_observations=log.final_observations[:, kept],
            successors=following, extras={**log.extras, **flags}, provenance=replace(log.provenance, extra=told),
        )  # fmt: skip


def subject(given: Run | Path | str, seed: int | None = None) -> Subject:
    """The policy of a run, a decision, a cross-fit or a policy file, as chosen by `player.chosen`.

    Args:
        given: the run, its folder, a cross-fit's folder, a policy file, or a folder of `ope` or `recommend`, for its policy to
            deploy.
        seed: of the run's seeds; None: the first that has not failed.

    Raises:
        UserError: there is no such policy.
    """
    path = given.path if isinstance(given, Run) else given
    if not isinstance(path, str | Path):
        raise UserError(f"a policy is named by its run, its folder or its file, got {type(given).__name__}")
    path = Path(path)
    if seed is not None and (path / CROSS_FIT).exists():  # with several seeds, the mixture of one may have no file
        owner, decision = path, None
        one = next((each for each in gather(path) if each.seed == seed), None)
        if one is None:
            raise UserError(f"{path} has no policy of seed {seed}")
    else:
        file, _, _, owner, decision = chosen(path, seed)
        those = [each for each in gather(owner or file) if each.file is not None and each.file.samefile(file)]
        one = those[0] if those else gather(file)[0]
    if not isinstance(one.acting, EnvPolicy):
        raise UserError(f"{given} holds no policy of this package")
    run = load(owner) if owner is not None and Folder(owner).config.exists() else None
    if (file := one.file) is None:
        assert owner is not None
        file = owner / MIXTURE  # of all seeds, with the record of the same log
    told = store.meta(file).get("log", {})
    config = None if run is None else run.config
    first = None if owner is None else owner / FIRST
    made = config or (load(first).config if first is not None and Folder(first).config.exists() else {})
    return Subject(
        one.name, one.acting, one.run, one.seed, one.file, one.read, told, config, made, owner, decision,
        one.taught,
    )


def estimates_of(one: Subject, given: Path | str | None = None) -> tuple[dict[str, Any], int] | None:
    """The estimates by `deadreckon ope --out` or `recommend` that include a policy, and its index there.

    It is identified by its file. The names of run and seed, which other policies may have too, are enough if the folder is
    given, or if the estimates are in the run's own folder and the evaluated file is there or is gone.

    Args:
        one: the policy.
        given: the folder or file; None searches the folder of the decision that chose the policy, the run's folder, the folder
            above, where `recommend` writes, and those beside it, where `ope --out` usually does.

    Raises:
        UserError: the given one does not exist, or does not include this policy.
    """
    own = [*([one.decision] if one.decision else []), *([one.folder, one.folder.parent] if one.folder else [])]
    beside = [] if one.folder is None else [each for each in records_beside(one.folder, ESTIMATES) if each not in own]
    places = [*own, *beside] if given is None else [Path(given)]
    for place in places:
        file = place / ESTIMATES if place.is_dir() or given is None else place
        if not file.exists():
            continue
        if "estimand" not in read_json(file, dict):  # of another version; it may only lie beside, so it is ignored
            continue
        told = read_results(file)
        if not told["results"]:
            continue
        policies = told["policies"]
        same = [one.file is None or is_same(each, one.file) for each in policies]
        named = [i for i, each in enumerate(policies) if same[i] and (each["run"], each["seed"]) == (one.run, one.seed)]
        alike = named
        if given is None:
            alike = [i for i in named if place in own and one.folder is not None and is_from(policies[i], one.folder)]
        saved = [i for i, each in enumerate(policies) if same[i] and _is_saved(one, each, i in named)]
        if saved or len(alike) == 1:
            return told, [*saved, *alike][0]
    if given is not None:
        how = f"`deadreckon ope --data LOG --policies {one.folder or one.file or one.run} --out FOLDER` writes them"
        which = one.name if one.file is None else f"{one.name} ({one.file})"
        raise UserError(f"{given} has no estimates of {which} as it is now; {how}")
    return None


def _is_saved(one: Subject, judged: Mapping[str, Any], named: bool) -> bool:
    """Whether an evaluated policy, whose file has the same content, is this one; if neither has a file, by the names of run and
    seed (`named`)."""
    file = judged.get("file")
    if file is None or one.file is None:
        return file is one.file and named
    return judged.get("digest") is not None or (is_there(file) and one.file.samefile(file))
