"""Claims as a TOML file declares them, with the cells and the rule that decide them.

    [tuned]                                 # logs on which the defaults of an agent were chosen: they decide nothing about it
    bear = ["hopper-medium-v2"]

    [[claims]]
    id = "C3"
    says = "BEAR is better than BC and TD3 on medium data."
    place = "thesis 4.6, Figure 4.3"

    [[claims.tests]]
    suite = "constraint.toml"               # beside this file, or below it
    method = "BEAR"                         # or a list, whose mean is taken
    than = ["BC", "TD3"]                    # methods of the suite; or one number
    on = ["walker2d-medium-v2"]             # of the suite's logs, tasks, problems or cases; all where it is absent
    metric = "score"                        # a column of results, a name in their `more`, or "average score": the mean of a
                                            # learning curve, but for the evaluation before the run has learned
    less = false                            # whether less is better
    margin = 0.0                            # the gain that is claimed; below zero where it is "no worse"
    each = false                            # whether it is claimed of each log by itself, and not of their mean
    beside = "other.toml"                   # in the place of `than`: a suite on whose tasks the same methods do worse
    among = true                            # in the place of `than`: logs of a task differ, by more than seeds do
    log = false                             # whether a number x, and `than`, counts as sign(x) log10(1 + |x|)
    range = [0.0, 1.0]                      # least and greatest number that the metric can have: logs on which all seeds differ
                                            # by the same then widen the interval, instead of leaving the test open
    again = { suite = "fresh.toml" }        # a suite of the same methods and logs and other seeds (`first_seed`), which decides
                                            # where this one is open with all its cells; it may have a `log` of its own, and
                                            # an `again`, which decides where it is open too
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from deadreckon.bench.claims import Claim, Test, task_of
from deadreckon.bench.methods import Method
from deadreckon.bench.suite import Suite, read
from deadreckon.errors import UserError, unknown
from deadreckon.files import read_toml
from deadreckon.foreign.shapes import checked
from deadreckon.names import safe_path


class _Said(TypedDict):
    id: NotRequired[str]
    says: NotRequired[str]
    place: NotRequired[str]
    note: NotRequired[str]
    tests: NotRequired[list[dict[str, Any]]]


class _Claims(TypedDict):
    """How a file is built; what stands where is looked at one by one."""

    claims: list[_Said]
    tuned: NotRequired[dict[str, Any]]


def claims(path: Path | str) -> list[Claim]:
    """Those of a file, without the logs that decide nothing.

    Raises:
        UserError: the file cannot be read, or says something that cannot be: one line says what.
    """
    path = Path(path)
    found = read_toml(path, dict)
    _check_keys(str(path), found, {"claims", "tuned"}, ("claims",))
    checked(found, _Claims, path)
    for agent, own in found.get("tuned", {}).items():
        if not isinstance(own, list) or not all(isinstance(log, str) for log in own):
            raise UserError(f"{path}, [tuned]: {agent} must be a list of logs, got {own!r}")
    suites: dict[str, Suite] = {}
    all_claims = [_claim(path, one, found.get("tuned", {}), suites) for one in found["claims"]]
    for name, count in Counter(claim.id for claim in all_claims).items():
        if count > 1:
            raise UserError(f"{path}: {count} claims have the id {name}; give each its own")
    _check_tuned(path, found.get("tuned", {}), suites.values())
    return all_claims


def _check_tuned(path: Path, tuned: Mapping[str, Sequence[str]], suites: Iterable[Suite]) -> None:
    """Refuses names that mean nothing, as the logs that were tuned on would decide claims then."""
    from deadreckon.agents import AGENTS
    from deadreckon.collect.recipes import recipe_names

    agents = {*AGENTS, *(method.agent for suite in suites for method in suite.methods)}
    logs = {*recipe_names(), *(on for suite in suites for on in suite.on)}
    for agent, own in tuned.items():
        if agent not in agents:
            raise UserError(f"{path}, [tuned]: {unknown('agent', agent, agents)}")
        for log in own:
            if log not in logs:
                raise UserError(f"{path}, [tuned], {agent}: {unknown('log', log, logs)}")


_PROTOCOL = ("kind", "episodes", "evaluations", "rows", "offline", "designs", "budget")  # alike in both stages of a test
_PLACED = ("steps", "files", "data")  # the same, of each log, task or problem
_TEXT, _NAMES, _TRUTH = (str, "text"), (list, "a list of names"), (bool, "true or false")
_KINDS: dict[str, tuple[Any, str]] = {
    "suite": _TEXT, "beside": _TEXT, "method": (str | list, "a method, or a list of methods"),
    "than": (list | int | float, "a list of methods, or a number"), "on": _NAMES, "metric": _TEXT, "less": _TRUTH,
    "margin": (int | float, "a number"), "each": _TRUTH, "among": _TRUTH, "log": _TRUTH,
    "range": (list, "two numbers, the lower one first"), "again": (dict, "a table with a suite"),
}  # fmt: skip


def _claim(path: Path, said: dict[str, Any], tuned: Mapping[str, Sequence[str]], suites: dict[str, Suite]) -> Claim:
    where = f"{path}, claim {said.get('id', '?')}"
    _check_keys(where, said, {f.name for f in fields(Claim)}, ("id", "says", "place"))
    tests = []
    for test in said.get("tests", ()):
        known = {f.name for f in fields(Test)} - {"beside_on"}
        _check_keys(where, test, known, ("suite", "method"))
        forms = [key for key in ("than", "beside", "among") if test.get(key, False) is not False]
        if len(forms) != 1:
            raise UserError(f"{where}: a test has one of than, beside and among, got {' and '.join(forms) or 'none'}")
        if forms != ["than"] and test.get("each", False):
            raise UserError(f"{where}: with {forms[0]}, all logs are taken together; leave each out")
        for key, value in test.items():
            wanted, kind = _KINDS[key]
            alike = _rising(value) if key == "range" else not isinstance(value, list) or all(isinstance(v, str) for v in value)
            if not isinstance(value, wanted) or (isinstance(value, bool) and wanted is not bool) or not alike:
                raise UserError(f"{where}: {key} must be {kind}, got {value!r}")
        own: list[str] = [test["method"]] if isinstance(test["method"], str) else test["method"]
        than: list[str] | float = test.get("than", []) if isinstance(test.get("than", []), list) else float(test["than"])
        if "range" in test and (forms != ["than"] or test.get("log", False)):
            raise UserError(f"{where}: range is for tests with than and without log; leave range or the others out")
        if "range" in test and isinstance(than, float) and not test["range"][0] <= than <= test["range"][1]:
            raise UserError(f"{where}: than must be within the range, got {than:g}")
        if not own or len(set(own)) < len(own):
            raise UserError(f"{where}: method must be a method, or different ones, got {own!r}")
        if isinstance(than, list) and "than" in test and (not than or len({*own, *than}) < len(own) + len(than)):
            raise UserError(f"{where}: than must be methods other than {', '.join(own)}, each once, or a number, got {than!r}")
        if "on" in test and (not test["on"] or len(set(test["on"])) < len(test["on"])):
            raise UserError(f"{where}: on must be different names, or be left out for all of the suite, got {test['on']!r}")
        numbers = {"margin": test.get("margin", 0.0), "than": than if isinstance(than, float) else 0.0}
        if bad := [f"{key} must be finite, got {value}" for key, value in numbers.items() if not math.isfinite(value)]:
            raise UserError(f"{where}: {bad[0]}")
        names = [test["suite"], *([test["beside"]] if "beside" in test else [])]
        places = {name: path.parent / safe_path(name, f"{where}: suite") for name in names}
        compared = [*own, *(than if isinstance(than, list) else ())]
        ways: list[dict[str, Method]] = []
        for name in names:
            ways.append({method.name: method for method in _read(where, name, places[name], suites).methods})
            for method in compared:
                if method not in ways[-1]:
                    raise UserError(f"{where}: {unknown(f'method of {name}', method, ways[-1])}")
        suite = suites[names[0]]
        if "beside" in test:
            beside = suites[names[1]]
            other = [method for method in own if ways[0][method] != ways[1][method]]
            pairs = [(suite, beside)]
            if suite.full and beside.full:
                pairs.append((read(places[names[0]], True), read(places[names[1]], True)))
            other += [key for one, two in pairs for key in _PROTOCOL if getattr(one, key) != getattr(two, key)]
            other += ["steps" for one, two in pairs if {*one.steps.values()} != {*two.steps.values()}]
            other += ["the section [full]"] if suite.full != beside.full else []
            if other:
                raise UserError(f"{where}: {other[0]} is not the same in {names[0]} as in {names[1]}, which are compared")
        for on in test.get("on", ()):
            if on not in suite.on:
                raise UserError(f"{where}: {unknown(f'log, task, problem or case of {names[0]}', on, suite.on)}")
        judged = {ways[0][method].agent for method in compared}
        void = {log for agent in judged for log in tuned.get(agent, ())}
        left = tuple(on for on in test.get("on", suite.on) if on not in void)
        other = tuple(on for on in suites[names[1]].on if on not in void) if "beside" in test else ()
        if not left or ("beside" in test and not other):
            raise UserError(f"{where}: all its logs are ones on which an agent was tuned, so they decide nothing")
        if "among" in forms and test.get("less", False):
            raise UserError(f"{where}: with among, neither more nor less is claimed; leave less out")
        if "among" in forms and max(Counter(map(task_of, left)).values()) < 2:
            raise UserError(f"{where}: with among, logs of a task are compared, but no two of {', '.join(left)} share one")
        if both := set(left) & set(other):
            raise UserError(f"{where}: {min(both)} is in {names[0]} and in {names[1]}, which must have logs of their own")
        given = test | {"suite": places[names[0]], "method": tuple(own), "on": left}
        given |= {"than": tuple(than) if isinstance(than, list) else than}
        given |= {"range": tuple(map(float, test["range"]))} if "range" in test else {}
        given |= {"beside": places[names[1]], "beside_on": other} if "beside" in test else {}
        again = given.pop("again", None)
        first = Test(**given)
        tests.append(first if again is None else replace(first, again=_again(path, where, first, again, (suite,), suites)))
    return Claim(said["id"], said["says"], said["place"], tuple(tests), said.get("note", ""))


def _read(where: str, name: str, path: Path, suites: dict[str, Suite]) -> Suite:
    """The suite of this name, which is read once."""
    if name not in suites:
        try:
            suites[name] = read(path)
        except UserError as error:
            raise UserError(f"{where}: {error}") from error
    return suites[name]


def _rising(value: Any) -> bool:
    """Whether it is two numbers, the lower one first."""
    numbers = isinstance(value, list) and all(isinstance(each, int | float) and not isinstance(each, bool) for each in value)
    return numbers and len(value) == 2 and -math.inf < value[0] < value[1] < math.inf


def _again(
    path: Path, where: str, first: Test, said: dict[str, Any], before: tuple[Suite, ...], suites: dict[str, Suite]
) -> Test:  # fmt: skip
    """The next stage of a test, which shares no run with those before, whose suites are given."""
    where, own = f"{where}, again", before[-1]
    _check_keys(where, said, {"suite", "log", "again"}, ("suite",))
    for key, value in said.items():
        wanted, kind = _KINDS[key]
        if not isinstance(value, wanted):
            raise UserError(f"{where}: {key} must be {kind}, got {value!r}")
    if first.beside is not None:
        raise UserError(f"{where}: a test with beside has no second stage")
    if first.range is not None and said.get("log", False):
        raise UserError(f"{where}: range is for tests without log; leave range or log out")
    place = path.parent / safe_path(file := said["suite"], f"{where}: suite")
    suite = _read(where, file, place, suites)
    if first.margin and said.get("log", first.log) != first.log:
        raise UserError(f"{where}: the margin {first.margin:g} would be of logarithms there; leave log or the margin out")
    if suite.seeds < 2 or suite.full:
        raise UserError(f"{where}: {file} must have two seeds or more, and no section [full]")
    theirs, ours = ({each.name: each for each in one.methods} for one in (suite, own))
    for method in [*first.method, *(first.than if isinstance(first.than, tuple) else ())]:
        if method not in theirs:
            raise UserError(f"{where}: {unknown(f'method of {file}', method, theirs)}")
        if theirs[method] != ours[method]:
            raise UserError(f"{where}: {method} is not the same in {file} as in {first.suite.name}")
    for on in first.on:
        if on not in suite.on:
            raise UserError(f"{where}: {unknown(f'log, task, problem or case of {file}', on, suite.on)}")
    other = [key for key in _PROTOCOL if getattr(own, key) != getattr(suite, key)]
    other += [key for key in _PLACED for on in first.on if getattr(own, key).get(on) != getattr(suite, key).get(on)]
    if other:
        raise UserError(f"{where}: {other[0]} of {file} and of {first.suite.name} differ, so it is no further stage of it")
    for one in before:
        if one.first_seed < suite.first_seed + suite.seeds and suite.first_seed < one.first_seed + one.seeds:
            least = max(each.first_seed + each.seeds for each in before)
            raise UserError(f"{where}: {file} has seeds of {one.name}.toml; its first_seed must be {least} or more")
    found = replace(first, suite=place, log=said.get("log", first.log))
    if "again" not in said:
        return found
    return replace(found, again=_again(path, where, found, said["again"], (*before, suite), suites))


def _check_keys(where: str, said: dict[str, Any], known: set[str], needed: Sequence[str]) -> None:
    for key in said:
        if key not in known:
            raise UserError(f"{where}: {unknown('key', key, known)}")
    if missing := [key for key in needed if key not in said]:
        raise UserError(f"{where}: {missing[0]} is missing")
