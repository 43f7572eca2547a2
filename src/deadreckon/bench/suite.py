"""A benchmark, declared: which methods, on what, with which settings and seeds. One TOML file per suite.

    about = "One line."
    kind = "learn"                    # from logs; or "online" in simulators, "design", or "ope" (estimators as methods)
    seeds = 3
    steps = 10_000                    # updates (learn) or environment steps (online); or { NAME = ... } for each of these
    logs = ["hopper-medium-v2"]       # or tasks = [...] (online), or problems = [...] (design)
    rows = 200_000                    # of each log; all of them where it is absent

    [methods]
    BC = { agent = "bc" }
    BEAR = { agent = "bear", fields = { kernel = "gaussian" } }
    ReBRAC = { agent = "rebrac", preset = true }      # with the settings published for the log, where there are any
"""

import tomllib
from dataclasses import dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

from deadreckon.errors import UserError, unknown

Kind = Literal["learn", "online", "design", "ope"]
PLACES = {"learn": "logs", "online": "tasks", "design": "problems", "ope": "logs"}  # what a suite of a kind lists
# Options that not all kinds have.
OWN = {
    "learn": ("rows", "steps", "episodes", "evaluations"), "online": ("steps", "episodes", "evaluations"),
    "design": ("designs", "budget"), "ope": ("rows", "budget"),
}  # fmt: skip
BUDGETS = ("full", "cpu")
STEPS = 100_000  # where a suite says nothing


@dataclass(frozen=True)
class Method:
    """A way to learn, to design or to estimate.

    Attributes:
        name: in tables.
        agent: its name in `deadreckon agents`, or of a designer in `deadreckon design methods`, or of an estimator in
            `deadreckon ope --list`.
        fields: settings that differ from the defaults, or from the preset.
        preset: whether it begins from the settings published for what it is run on, where there are any.
    """

    name: str
    agent: str
    fields: dict[str, Any] = field(default_factory=dict)
    preset: bool = False


@dataclass(frozen=True)
class Suite:
    """What is to be run, and how often.

    Attributes:
        name: of the suite.
        kind: `learn` from logs, `online` in simulators, `design`, or `ope`: the DOPE protocol.
        on: names of logs, tasks or problems.
        methods: each of them is run on each of those.
        seeds: of each: 0 .. seeds - 1.
        steps: updates (learn) or environment steps (online), on each of `on`.
        episodes: an evaluation, a seed.
        evaluations: of a run, the last one at its end.
        rows: of each log; None: all.
        designs: that a designer proposes.
        budget: sizes of what designers or estimators fit: `full`, or `cpu`.
        lanes: cells of one program at most, which differ in their seeds or in float settings; None: the executor says.
        about: one line.
        divided: whether estimates choose among its cells: of a log that no simulator judges they learn from a part alone, see
            `runs.holdout.trial_parts`. No key of a file: `bench.tune` sets it.
    """

    name: str
    kind: Kind
    on: tuple[str, ...]
    methods: tuple[Method, ...]
    seeds: int = 3
    steps: dict[str, int] = field(default_factory=dict)
    episodes: int = 20
    evaluations: int = 10
    rows: int | None = None
    designs: int = 128
    budget: str = "full"
    lanes: int | None = None
    about: str = ""
    divided: bool = False


def names() -> list[str]:
    """The suites of the package."""
    return sorted(path.name.removesuffix(".toml") for path in _shipped().iterdir() if path.name.endswith(".toml"))


def read(name: Path | str) -> Suite:
    """A suite of the package by name, or one of your own by its file.

    Raises:
        UserError: there is no such suite; it is no TOML; or it says something that cannot be: one line says what.
    """
    path = Path(name)
    if path.suffix != ".toml":
        if str(name) not in names():
            raise unknown("suite", str(name), names())
        text, where = _shipped().joinpath(f"{name}.toml").read_text("utf-8"), str(name)
    else:
        try:
            text, where = path.read_text("utf-8"), str(path)
        except (OSError, UnicodeDecodeError) as error:
            raise UserError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error
    try:
        told = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{where} is not TOML: {error}") from error
    return _suite(path.stem, where, told)


def _shipped() -> Any:
    return files("deadreckon.bench").joinpath("suites")


def _suite(name: str, where: str, told: dict[str, Any]) -> Suite:
    kind = told.get("kind", "learn")
    if kind not in get_args(Kind):
        raise UserError(f"{where}: kind must be one of {', '.join(get_args(Kind))}, got {kind!r}")
    foreign = {option for options in OWN.values() for option in options} - set(OWN[kind])
    known = {f.name for f in fields(Suite)} - {"name", "on", "divided"} - foreign | {PLACES[kind]}
    for key in told:
        if key not in known:
            raise UserError(f"{where}: {unknown(f'key of a suite of kind {kind}', key, known)}")
    on = told.get(PLACES[kind])
    if not isinstance(on, list) or not on or not all(isinstance(one, str) for one in on) or len(set(on)) < len(on):
        raise UserError(f"{where}: {PLACES[kind]} must be a list of different names, got {on!r}")
    methods = told.get("methods")
    if not isinstance(methods, dict) or not methods:
        raise UserError(f"{where}: [methods] must name at least one, such as BC = {{ agent = 'bc' }}")
    whole = "seeds", "episodes", "evaluations", "rows", "designs", "lanes"
    counts = {key: told[key] for key in whole if key in told}
    for key, value in counts.items():
        _check_count(where, key, value)
    if told.get("budget", "full") not in BUDGETS:
        raise UserError(f"{where}: budget must be one of {', '.join(BUDGETS)}, got {told['budget']!r}")
    steps = _steps(where, told.get("steps", STEPS), on)
    rest = {key: told[key] for key in ("budget", "about") if key in told}
    ways = tuple(_method(where, *each) for each in methods.items())
    suite = Suite(name, kind, tuple(on), ways, steps=steps, **counts, **rest)
    if "steps" in OWN[kind] and suite.evaluations > min(steps.values()):
        raise UserError(f"{where}: {suite.evaluations} evaluations are more than its {min(steps.values())} steps")
    return suite


def _check_count(where: str, what: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise UserError(f"{where}: {what} must be a whole number of 1 or more, got {value!r}")


def _steps(where: str, told: Any, on: list[str]) -> dict[str, int]:
    """Of each of `on`, from one number for all or one each."""
    each: dict[str, Any] = told if isinstance(told, dict) else dict.fromkeys(on, told)
    if set(each) != set(on):
        raise UserError(f"{where}: steps must be one number, or name each of {', '.join(on)}; it names {', '.join(each)}")
    for name, value in each.items():
        _check_count(where, f"steps on {name}", value)
    return {name: each[name] for name in on}


def _method(where: str, name: str, told: Any) -> Method:
    kinds = {"agent": str, "fields": dict, "preset": bool}
    if not isinstance(told, dict) or "agent" not in told:
        raise UserError(f"{where}: method {name!r} must say its agent, such as {name} = {{ agent = 'bc' }}")
    for key in told:
        if key not in kinds:
            raise UserError(f"{where}: {unknown(f'key of method {name!r}', key, kinds)}")
    for key, value in told.items():
        if not isinstance(value, kinds[key]):
            raise UserError(f"{where}: {key} of method {name!r} must be a {kinds[key].__name__}, got {value!r}")
    for key, value in told.get("fields", {}).items():
        if not isinstance(value, bool | int | float | str | list):
            raise UserError(f"{where}: {key} of method {name!r} must be a number, text, truth value or list, got {value!r}")
    return Method(name, **told)
