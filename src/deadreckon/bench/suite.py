"""A benchmark, declared: which methods, on what, with which settings and seeds. One TOML file per suite.

    about = "One line."
    kind = "learn"                    # from logs; or "online" in simulators, "design", "ope" (estimators as methods) or "study"
    seeds = 3
    steps = 10_000                    # updates (learn) or environment steps (online); or { NAME = ... } for each of these
    logs = ["hopper-medium-v2"]       # or tasks = [...] (online), or problems = [...] (design)
    rows = 200_000                    # of each log; all of them where it is absent
    data = { hopper = "hopper-medium-v2" }   # online: the log of each task, for methods that have a `log`
    offline = 50_000                  # online: updates on the log of methods that learn from it first

    [methods]
    BC = { agent = "bc" }
    BEAR = { agent = "bear", fields = { kernel = "gaussian" } }
    ReBRAC = { agent = "rebrac", preset = true }      # with the settings published for the log, where there are any
    "SAC, 20 updates" = { agent = "sac", acting = { updates_per_step = 20 } }   # online: where acting is not the agent's own
    "Cal-QL" = { agent = "cal_ql", log = "first" }   # online: learns from the task's log first, which then is in the replay
    RLPD = { agent = "rlpd", log = "beside" }        # online: the task's log is in the replay alone

    [full]                            # what differs at full size, with `--full`
    steps = 500_000

A file that has `suites = ["a.toml", ...]` instead is a queue: its suites in the order in which they are run.
"""

import re
import tomllib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from deadreckon.bench.methods import Method, check_count, method
from deadreckon.errors import UserError, is_control, unknown
from deadreckon.files import read_toml
from deadreckon.names import safe_name, safe_path

Kind = Literal["learn", "online", "design", "ope", "study"]
# What a suite of a kind lists.
PLACES = {"learn": "logs", "online": "tasks", "design": "problems", "ope": "logs", "study": "cases"}
# Options that not all kinds have.
OWN = {
    "learn": ("rows", "steps", "episodes", "evaluations", "lanes"),
    "online": ("rows", "steps", "episodes", "evaluations", "data", "offline", "lanes"),
    "design": ("designs", "budget", "files", "lanes"), "ope": ("rows", "budget", "lanes"), "study": ("metrics",),
}  # fmt: skip
BUDGETS = ("full", "cpu")
SIZES = {"seeds", "steps", "offline", "episodes", "evaluations", "rows", "designs", "budget"}  # what [full] may change
_ELSEWHERE = re.compile(r"^[/\\~]|^[A-Za-z]:|(^|[/\\])\.\.($|[/\\])")  # beginnings and parts of paths, on any system
_SEED = 1_000_000  # the first one at most: programs take their seeds as 32-bit numbers
_CELLS = 1_000_000  # of a suite at most, as all are planned before the first is run
_DIGITS = 12  # that a table shows at most
STEPS = 100_000  # where a suite says nothing


class Metric(NamedTuple):
    """A number of which a suite has a table.

    Attributes:
        column: of the store's rows, or a name in their `more`.
        words: what it is.
        higher: whether more is better.
        digits: that are shown.
        joint: whether numbers of different logs or problems are on one scale.
    """

    column: str
    words: str
    higher: bool = True
    digits: int = 1
    joint: bool = True


@dataclass(frozen=True)
class Suite:
    """What is to be run, and how often.

    Attributes:
        name: of the suite.
        kind: `learn` from logs, `online` in simulators, `design`, `ope` (the DOPE protocol), or `study`.
        on: names of logs, tasks or problems, or the cases of a study.
        methods: each of them is run on each of those.
        seeds: of each: `first_seed` and those after it.
        first_seed: above 0 where seeds are to be fresh, beside those of another suite.
        steps: updates (learn) or environment steps (online), on each of `on`.
        episodes: an evaluation, a seed.
        evaluations: of a run, the last one at its end.
        rows: of each log; None: all.
        data: online, the log of each task, where methods have one.
        offline: online, updates of methods that learn from the log first.
        designs: that a designer proposes.
        files: digest of the file of each problem that is read from one, which tells its cells from those of other files (the
            BLAKE2b of 8 bytes, in hexadecimal digits); of those that are not named it is that of the file that is there.
        budget: sizes of what designers or estimators fit: `full`, or `cpu`.
        lanes: cells of one program at most, which differ in their seeds or in float settings; None: the executor says.
        about: one line.
        metrics: of a study; other kinds have their own.
        full: whether the file says what differs at full size.
        ledger: folder of one file per finished cell, see `bench.ledger`; None: results lie where the command says.
        divided: whether estimates choose among its cells: of a log that no simulator judges they learn from a part alone, see
            `runs.holdout.trial_parts`. No key of a file: `bench.tune` sets it.
    """

    name: str
    kind: Kind
    on: tuple[str, ...]
    methods: tuple[Method, ...]
    seeds: int = 3
    first_seed: int = 0
    steps: dict[str, int] = field(default_factory=dict)
    episodes: int = 20
    evaluations: int = 10
    rows: int | None = None
    data: dict[str, str] = field(default_factory=dict)
    offline: int = STEPS
    designs: int = 128
    files: dict[str, str] = field(default_factory=dict)
    budget: str = "full"
    lanes: int | None = None
    about: str = ""
    metrics: tuple[Metric, ...] = ()
    full: bool = False
    ledger: Path | None = None
    divided: bool = False


def names() -> list[str]:
    """The suites of the package."""
    return sorted(path.name.removesuffix(".toml") for path in _shipped().iterdir() if path.name.endswith(".toml"))


def read(name: Path | str, full: bool = False) -> Suite:
    """A suite of the package by name, or one of your own by its file.

    Args:
        name: of the suite, or its file.
        full: at full size, which the file says under `[full]`.

    Raises:
        UserError: there is no such suite; it is no TOML; or it says something that cannot be: one line says what.
    """
    path, where, found = _toml(name)
    return _suite(path, where, found, full)


def queue(name: Path | str, full: bool = False) -> list[Suite]:
    """The suites of a queue, a file that has `suites = ["a.toml", ...]`, in their order; of another file its one suite.

    Args:
        name: of a suite, or a file.
        full: at full size: of suites that say what that is.

    Raises:
        UserError: as `read` does; a queue has no suites, none of a full size, or two of one name.
    """
    path, where, found = _toml(name)
    if "suites" not in found:
        return [_suite(path, where, found, full)]
    listed = found.pop("suites")
    if found:
        raise UserError(f"{where}: a queue has the key suites alone, got {', '.join(found)} too")
    if not isinstance(listed, list) or not listed or not all(isinstance(one, str) for one in listed):
        raise UserError(f"{where}: suites must be a list of files or names of suites, got {listed!r}")
    each = [_toml(path.parent / safe_path(one, f"{where}: suite") if one.endswith(".toml") else one) for one in listed]
    suites = [_suite(*parts, full) for parts in each if not full or "full" in parts[2]]
    if not suites:
        raise UserError(f"{where}: none of its suites says what differs at full size, in a section [full]")
    for name, count in Counter(suite.name for suite in suites).items():
        if count > 1:
            raise UserError(f"{where}: {count} of its suites are named {name}; give each a name of its own")
    return suites


def _toml(name: Path | str) -> tuple[Path, str, dict[str, Any]]:
    """A file's path, what it is called in errors, and what it says."""
    path = Path(name)
    if path.suffix == ".toml":
        return path, str(path), read_toml(path)
    if str(name) not in names():
        raise unknown("suite", str(name), names())
    return path, str(name), tomllib.loads(_shipped().joinpath(f"{name}.toml").read_text("utf-8"))


def _shipped() -> Any:
    return files("deadreckon.bench").joinpath("suites")


def _suite(path: Path, where: str, document: dict[str, Any], full: bool) -> Suite:
    changes, document = document.get("full", {}), {key: value for key, value in document.items() if key != "full"}
    if not isinstance(changes, dict) or not set(changes) <= SIZES:
        raise UserError(f"{where}: [full] may change {', '.join(sorted(SIZES))}, got {changes!r}")
    if full:
        if not changes:
            raise UserError(f"{where} does not say what differs at full size: give it a section [full]")
        document |= changes
    kind = document.get("kind", "learn")
    if kind not in get_args(Kind):
        raise UserError(f"{where}: kind must be one of {', '.join(get_args(Kind))}, got {kind!r}")
    foreign = {option for options in OWN.values() for option in options} - set(OWN[kind])
    name = safe_name(path.stem, f"{where}: suite")
    known = {f.name for f in fields(Suite)} - {"name", "on", "full", "divided"} - foreign | {PLACES[kind]}
    for key in document:
        if key not in known:
            raise UserError(f"{where}: {unknown(f'key of a suite of kind {kind}', key, known)}")
    on = document.get(PLACES[kind])
    if not isinstance(on, list) or not on or not all(isinstance(one, str) for one in on) or len(set(on)) < len(on):
        raise UserError(f"{where}: {PLACES[kind]} must be a list of different names, got {on!r}")
    _check_logs(where, on if PLACES[kind] == "logs" else ())
    methods = document.get("methods")
    if not isinstance(methods, dict) or not methods:
        raise UserError(f"{where}: [methods] must name at least one, such as BC = {{ agent = 'bc' }}")
    whole = "seeds", "episodes", "evaluations", "rows", "offline", "designs", "lanes"
    counts = {key: document[key] for key in whole if key in document}
    for key, value in counts.items():
        check_count(where, key, value)
    first = document.get("first_seed", 0)
    if isinstance(first, bool) or not isinstance(first, int) or not 0 <= first <= _SEED:
        raise UserError(f"{where}: first_seed must be a whole number from 0 to {_SEED:,}, got {first!r}")
    counts["first_seed"] = first
    if document.get("budget", "full") not in BUDGETS:
        raise UserError(f"{where}: budget must be one of {', '.join(BUDGETS)}, got {document['budget']!r}")
    if not isinstance(document.get("about", ""), str):
        raise UserError(f"{where}: about must be a text, got {document['about']!r}")
    steps = _steps(where, document.get("steps", STEPS), on)
    rest: dict[str, Any] = {key: document[key] for key in ("budget", "about") if key in document}
    rest |= _metrics(where, kind, document.get("metrics"))
    if "ledger" in document:
        if not isinstance(document["ledger"], str):
            raise UserError(f"{where}: ledger must be a folder's name, got {document['ledger']!r}")
        if _ELSEWHERE.search(document["ledger"]):
            said = f"must be a folder beside the suite's file or below it, got {document['ledger']!r}"
            raise UserError(f"{where}: ledger {said}")
        rest["ledger"] = path.parent / safe_path(document["ledger"], f"{where}: ledger")
    rest["files"] = _files(where, document.get("files", {}), on)
    rest["data"] = _logs(where, document.get("data", {}), on, methods)
    ways = tuple(method(where, kind, *each) for each in methods.items())
    suite = Suite(name, kind, tuple(on), ways, steps=steps, full=bool(changes), **counts, **rest)
    if (cells := len(suite.on) * len(ways) * suite.seeds) > _CELLS:
        raise UserError(f"{where}: {cells:,} cells ({suite.seeds:,} seeds of each), more than {_CELLS:,}; lower seeds")
    if "steps" in OWN[kind] and suite.evaluations > min(steps.values()):
        raise UserError(f"{where}: {suite.evaluations} evaluations are more than its {min(steps.values())} steps")
    return suite


def _files(where: str, given: Any, on: list[str]) -> dict[str, str]:
    """Of a suite of designs, the digests of problems' files."""
    if not isinstance(given, dict) or not set(given) <= set(on):
        raise UserError(f"{where}: files must give digests of files of some of {', '.join(on)}, got {given!r}")
    for name, digest in given.items():
        if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{16}", digest):
            raise UserError(f"{where}: the digest of the file of {name} must be 16 hexadecimal digits, got {digest!r}")
    return given


def _logs(where: str, data: Any, on: list[str], methods: dict[str, Any]) -> dict[str, str]:
    """Of an online suite, the log of each task."""
    needed = [name for name, table in methods.items() if isinstance(table, dict) and table.get("log")]
    texts = isinstance(data, dict) and all(isinstance(log, str) for log in data.values())
    if not texts or (needed and set(data) != set(on)):
        why = f" for the log of method {needed[0]!r}" if needed else ""
        raise UserError(f"{where}: data must name a log of each of {', '.join(on)}{why}, got {data!r}")
    _check_logs(where, data.values())
    return {name: data[name] for name in on if name in data}


def _check_logs(where: str, logs: Iterable[str]) -> None:
    """Refuses names of logs that lead elsewhere: a suite from elsewhere could have any file read, and quoted in an error."""
    for log in logs:
        if _ELSEWHERE.search(log) or any(map(is_control, log)):
            how = "a suite names logs of the catalogue, and files in the current folder or below it"
            raise UserError(f"{where}: log {log[:200]!r} leads elsewhere; {how}: put the log, or a link to it, there")


def _metrics(where: str, kind: str, table: Any) -> dict[str, tuple[Metric, ...]]:
    """Of a study, from `[metrics]`: NAME = { words = "...", higher = false, digits = 2 }."""
    if kind != "study":
        return {}
    from deadreckon.bench.store import RESULT  # which loads Arrow

    kinds = {"words": str, "higher": bool, "digits": int}
    if not isinstance(table, dict) or not table:
        raise UserError(f"{where}: a study must say its [metrics], such as error = {{ words = 'mean error', higher = false }}")
    for name, one in table.items():
        if not isinstance(one, dict) or "words" not in one or any(not isinstance(one[k], kinds.get(k, ())) for k in one):
            raise UserError(f"{where}: metric {name!r} must say its words, and may say higher (true or false) and digits")
        if name != "score" and name in RESULT.names:
            raise UserError(f"{where}: metric {name!r} is called as a column of results, which would be shown; rename it")
        if isinstance(digits := one.get("digits", 1), bool) or not 0 <= digits <= _DIGITS:
            raise UserError(f"{where}: digits of metric {name!r} must be a whole number from 0 to {_DIGITS}, got {digits!r}")
    return {"metrics": tuple(Metric(name, joint=False, **one) for name, one in table.items())}


def _steps(where: str, steps: Any, on: list[str]) -> dict[str, int]:
    """Of each of `on`, from one number for all or one each."""
    each: dict[str, Any] = steps if isinstance(steps, dict) else dict.fromkeys(on, steps)
    if set(each) != set(on):
        raise UserError(f"{where}: steps must be one number, or name each of {', '.join(on)}; it names {', '.join(each)}")
    for name, value in each.items():
        check_count(where, f"steps on {name}", value)
    return {name: each[name] for name in on}
