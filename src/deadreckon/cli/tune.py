"""`deadreckon tune`: settings of an agent, chosen on training tasks or from a log alone."""

import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from deadreckon.cli.fits import Fits, estimators
from deadreckon.cli.parse import parse
from deadreckon.errors import UserError
from deadreckon.interrupts import resumable

# Episodes that chose settings flatter them, and another hold-out than the default is made of such episodes, too.
_JUDGING = (
    "to evaluate it, train with the default hold-out of the same log, without --holdout, --holdout-by, --cross-fit, --horizon "
    "and --mmap, or use new episodes: other episodes of this log may have chosen it"
)
_WHOLE = (
    "its settings were trained and estimated on all episodes of {}, so that estimates on any of them are too high: evaluate it "
    "in the simulator"
)
_SELECTED = (
    "its score is the best of {} settings on the seeds that chose it, which is too high on average; train it with new seeds to "
    "know its score"
)


@dataclass
class Tune:
    """Try settings of an agent and choose: from the log alone by estimates, or in the simulators of training tasks.

    The episodes of your own log that `deadreckon train` holds out by default are not used; what it holds out with --holdout,
    --holdout-by or --cross-fit may be.
    """

    agent: str  # agent to tune, among `deadreckon agents`
    data: tuple[str, ...]  # logs to train on: names or files; one log where estimates choose
    by: Literal["ope", "simulator"] = "ope"
    """criterion: off-policy estimates from the log, or scores in the simulators of training tasks"""
    values: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FIELD=V,V...")] = ()
    """values to try per field, or with --sampler optuna a range (lr=1e-4..1e-2:log); none: those that the paper varied"""
    fixed: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FIELD=V")] = ()  # fields with one value in all settings
    trials: int | None = None
    """largest number of settings; None: all combinations of the values, or 20 with --sampler optuna"""
    sampler: Literal["grid", "optuna"] = "grid"
    """how settings are proposed: all combinations or a random part (grid), or in rounds that use earlier results (optuna)"""
    steps: int = 20_000  # updates of each setting and seed
    seeds: int = 3  # number of seeds of each setting
    rows: int | None = None  # rows of logs that have a recipe; None: all
    estimators: str = "fqe"  # names of estimators with commas; the first one chooses
    fit: Fits = field(default_factory=Fits)  # sizes of what the estimators fit
    discount: float = 0.99  # discount factor per step of the estimated returns
    seed: int = 0  # random seed of the drawn settings
    workers: int | None = None  # number of processes; None: one per core, or one for a GPU
    out: str = "runs/tune"  # folder of results; existing results are not computed again
    dry_run: bool = False  # whether to print what would be tried, and how long it may take, and run nothing


def tune(args: Sequence[str]) -> None:
    """Tunes and prints."""
    options = parse(Tune, args, "tune")
    from deadreckon.bench import tune as found
    from deadreckon.bench.local import Local
    from deadreckon.bench.plan import plan
    from deadreckon.bench.store import Store
    from deadreckon.cli.bench import announce
    from deadreckon.cli.lines import Lines
    from deadreckon.cli.progress import Watch
    from deadreckon.ope.coverage import MODEL
    from deadreckon.ope.registry import with_fields

    given = {name: _values(text) for name, text in map(_pair, options.values)} or None
    fixed = {name: _value(text) for name, text in map(_pair, options.fixed)}
    if options.sampler == "optuna":
        return _in_rounds(options, given, fixed)
    if ranges := [name for name, values in (given or {}).items() if not isinstance(values, list)]:
        raise UserError(f"{ranges[0]} is a range, which has no combinations; use --sampler optuna, or list values")
    settings = found.candidates(options.agent, given, options.trials, options.seed)
    sizes = {"steps": options.steps, "seeds": options.seeds, "rows": options.rows}
    asked = found.suite(options.agent, options.data, settings, by=options.by, fixed=fixed, **sizes)
    store = Store(Path(options.out))
    executor = Local(store.path, options.workers)
    jobs = plan(asked, executor.lanes)
    waiting = announce(asked.name, jobs, store, executor, options.dry_run)
    if options.dry_run:
        return
    with resumable(store.path), Watch() as watch:
        result = found.tune(
            asked, settings, by=options.by, store=store, executor=executor, on_event=Lines(len(waiting)),
            estimators=estimators(options.estimators, options.fit), model=with_fields(MODEL, options.fit.given),
            discount=options.discount, watch=watch,
        )  # fmt: skip
    _told(result, fixed, options.data)


def _in_rounds(options: Tune, given: dict[str, Any] | None, fixed: dict[str, Any]) -> None:
    """Tunes by Optuna's proposals and prints."""
    from deadreckon.bench.local import Local
    from deadreckon.bench.sampler import ROUND, OptunaSampler, tune_in_rounds
    from deadreckon.bench.store import Store
    from deadreckon.bench.tune import suite
    from deadreckon.bench.tuned import named
    from deadreckon.cli.lines import Lines
    from deadreckon.cli.progress import Watch
    from deadreckon.ope.coverage import MODEL
    from deadreckon.ope.registry import with_fields

    sampler = OptunaSampler(options.agent, given, options.seed)
    trials = 20 if options.trials is None else options.trials
    sizes: dict[str, Any] = {name: getattr(options, name) for name in ("by", "steps", "seeds", "rows")} | {"fixed": fixed}
    if options.dry_run:
        first = sampler.ask(min(ROUND, trials))
        asked = suite(options.agent, options.data, first, **sizes)  # what does not fit is refused
        print(f"{asked.name}: {trials} settings in rounds of {ROUND}; the first: {'; '.join(map(named, first))}")
        return
    store = Store(Path(options.out))
    with resumable(store.path), Watch() as watch:
        result = tune_in_rounds(
            options.agent, options.data, sampler, trials=trials, store=store, on_event=Lines(trials), tell=print, **sizes,
            executor=lambda: Local(store.path, options.workers), estimators=estimators(options.estimators, options.fit),
            model=with_fields(MODEL, options.fit.given), discount=options.discount, watch=watch,
        )  # fmt: skip
    _told(result, fixed, options.data)


def _told(result: Any, fixed: dict[str, Any], logs: Sequence[str]) -> None:
    from deadreckon.report.provenance import option

    best = result.best.fields | fixed  # a field that is left to the agent (None) needs no option
    chosen = [word for name, value in best.items() if value is not None for word in option(name, value)]
    print(f"\n{result}\n\nchosen: {shlex.join(map(str, chosen))}")
    if result.by == "ope":
        from deadreckon.tasks.registry import of_log

        known = [log for log in logs if of_log(log) is not None]  # of which no episodes are spared, as they can be collected
        print(_WHOLE.format(known[0]) if known else _JUDGING)
    elif len(result.trials) > 1:
        print(_SELECTED.format(len(result.trials)))


def _pair(text: str) -> tuple[str, str]:
    name, sign, value = text.partition("=")
    if not sign or not value:
        raise UserError(f"a field and its values are written alpha=1,2.5, got {text!r}")
    return name.replace("-", "_"), value


def _values(text: str) -> Any:
    """With commas between; those of lists, such as [64,64],[256,256], are none. Or a range, LOW..HIGH or LOW..HIGH:log.

    Raises:
        UserError: a range whose ends are not in order.
    """
    if match := re.fullmatch(r"([^,]+?)\.\.([^:,]+)(:log)?", text):
        from deadreckon.bench.sampler import Range

        low, high = _value(match[1]), _value(match[2])
        if all(isinstance(end, int | float) and not isinstance(end, bool) for end in (low, high)):
            return Range(low, high, bool(match[3]))
    return [_value(part) for part in re.split(r",(?![^\[]*\])", text)]


def _value(text: str) -> Any:
    """A number, truth value or list as JSON has them, or else text."""
    try:
        found = json.loads(text.lower() if text in ("True", "False") else text)
    except json.JSONDecodeError:
        return text
    return tuple(found) if isinstance(found, list) else found
