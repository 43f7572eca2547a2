"""Settings proposed by Optuna, round by round, by what those before them came to; `tune` proposes all at once.

The protocol is that of `bench.tune`: of a log of one's own, settings learn from one part, another part chooses among them and
tells Optuna what they came to, and the part that `train` holds out is in neither. However many rounds there are, what is
chosen is judged on episodes that no round has looked at. By simulators only training tasks choose.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np

from deadreckon.agents import agent_class, space
from deadreckon.bench.executor import Executor, OnEvent
from deadreckon.bench.store import Store
from deadreckon.bench.tune import chosen, judging_of, suite, tried
from deadreckon.bench.tuned import By, Trial, Tuned, named, standing_of
from deadreckon.errors import UserError, extra, unknown
from deadreckon.randomness import check_seed
from deadreckon.runs.settings import JudgeOptions
from deadreckon.training.field_names import with_field_names
from deadreckon.training.hyperparameters import check_fields

ROUND = 4  # settings that are proposed at once, whatever the number of cores: what is proposed follows from it
_STARTS = 8  # settings at random before the first that follow from others
_DIGITS = 6  # of proposed numbers


@dataclass(frozen=True)
class Range:
    """All numbers between two, on a logarithmic scale where `log`; whole numbers where both are."""

    low: float
    high: float
    log: bool = False

    def __post_init__(self):
        if not self.low < self.high or (self.log and self.low <= 0):
            raise UserError(f"a range is written LOW..HIGH with LOW below HIGH, and above 0 for :log, got {self}")

    def __str__(self) -> str:
        return f"{self.low}..{self.high}{':log' if self.log else ''}"


class OptunaSampler:
    """Proposes settings by Optuna's tree-structured Parzen estimator; the same ones for the same results and seed.

    Args:
        agent: its name.
        given: field -> values, or a `Range`; None: the values that its paper varied.
        seed: of the draws.

    Raises:
        UserError: Optuna is not installed; an unknown field, no values, or values that the field does not take.
    """

    def __init__(self, agent: str, given: Mapping[str, Sequence[Any] | Range] | None = None, seed: int = 0):
        try:
            import optuna
        except ImportError as error:
            raise UserError(f"--sampler optuna proposes by Optuna: {extra('tune')}") from error
        check_seed(seed)
        kind = agent_class(agent)
        self.space = with_field_names(kind, space(agent) if given is None else dict(given))
        defaults = vars(kind())
        for name, values in self.space.items():
            if name not in defaults:
                raise unknown(f"field of {agent}", name, defaults)
            for value in (values.low, values.high) if isinstance(values, Range) else values:
                check_fields(kind(**{name: value}))
            if not isinstance(values, Range) and not values:
                raise UserError(f"{name} has no values to try")
        # A value that stands twice is one choice.
        self.space = {
            name: values if isinstance(values, Range) else list(dict.fromkeys(values)) for name, values in self.space.items()
        }
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self.optuna = optuna
        sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=_STARTS, multivariate=True)
        self.study = optuna.create_study(direction="maximize", sampler=sampler)
        self.asked: list[tuple[Any, dict[str, Any]]] = []
        if all(_holds(values, defaults[name]) for name, values in self.space.items()):  # the defaults are tried first
            self.study.enqueue_trial({name: _code(values, defaults[name]) for name, values in self.space.items()})

    def ask(self, n: int) -> list[dict[str, Any]]:
        """`n` settings, of which some may be the same or have been proposed before."""
        distributions = {name: self._distribution(values) for name, values in self.space.items()}
        found = []
        for _ in range(n):
            trial = self.study.ask(distributions)
            found.append({name: _decode(values, trial.params[name]) for name, values in self.space.items()})
            self.asked.append((trial, found[-1]))
        return found

    def tell(self, values: Mapping[str, float]) -> None:
        """What the settings of the last `ask` came to, by their names (`bench.tuned.named`); not finite where one failed."""
        for trial, fields in self.asked:
            value = values[named(fields)]
            if np.isfinite(value):
                self.study.tell(trial, value)
            else:
                self.study.tell(trial, state=self.optuna.trial.TrialState.FAIL)
        self.asked.clear()

    def _distribution(self, values: Sequence[Any] | Range) -> Any:
        kinds = self.optuna.distributions
        if not isinstance(values, Range):
            return kinds.CategoricalDistribution(list(range(len(values))))  # it takes no tuples, such as widths of layers
        if isinstance(values.low, int) and isinstance(values.high, int):
            return kinds.IntDistribution(values.low, values.high, log=values.log)
        return kinds.FloatDistribution(values.low, values.high, log=values.log)


def _holds(values: Sequence[Any] | Range, value: Any) -> bool:
    if not isinstance(values, Range):
        return value in values
    return isinstance(value, int | float) and values.low <= value <= values.high


def _code(values: Sequence[Any] | Range, value: Any) -> Any:
    """A value as Optuna has it: of several the place of it."""
    return value if isinstance(values, Range) else list(values).index(value)


def _decode(values: Sequence[Any] | Range, code: Any) -> Any:
    if not isinstance(values, Range):
        return values[code]
    return code if isinstance(code, int) else min(max(float(f"{code:.{_DIGITS}g}"), values.low), values.high)


def tune_in_rounds(
    agent: str, logs: Sequence[str], sampler: OptunaSampler, *, by: By, trials: int, steps: int, seeds: int = 3,
    rows: int | None = None, fixed: Mapping[str, Any] | None = None, store: Store, executor: Callable[[], Executor],
    on_event: OnEvent, tell: Callable[[str], None] = lambda line: None, estimators: Sequence[Any] = ("fqe",),
    **options: Unpack[JudgeOptions],
) -> Tuned:  # fmt: skip
    """Proposes, runs and estimates settings in rounds of `ROUND`, and chooses among all of them.

    What is done already is not done again: the same call proposes the same settings.

    Args:
        agent: its name.
        logs: names or files.
        sampler: that proposes.
        by: what chooses, see `tune`.
        trials: settings to propose; those that are proposed twice are tried once.
        steps: updates of each setting, log and seed.
        seeds: of each.
        rows: of logs that are collected; None: all.
        fixed: fields that are the same in all.
        store: where results lie, and `tuned.json` will.
        executor: makes what runs the jobs of a round.
        on_event: called with every event of a job.
        tell: gets a line for each round.
        estimators: the first chooses, by the mean over seeds.
        **options: of `runs.offline.judge`, such as `discount` and `model`; defaults are those of `TrialSettings`.

    Raises:
        BusyError: another command does some of it.
        UserError: see `tune`.
    """
    if trials < 1:
        raise UserError(f"at least one setting must be tried, got {trials}")
    judging = judging_of(options)
    sizes: dict[str, Any] = {"by": by, "steps": steps, "seeds": seeds, "rows": rows, "fixed": fixed}
    known: dict[str, Trial] = {}
    for first in range(0, trials, ROUND):
        asked = sampler.ask(min(ROUND, trials - first))
        new = [fields for name, fields in {named(each): each for each in asked}.items() if name not in known]
        tell(f"settings {first + 1} to {first + len(asked)} of {trials}: {'; '.join(map(named, asked))}")
        if new:
            out = store.path / "estimates" / f"from-{first + 1}"
            search = suite(agent, logs, new, **sizes)
            found = tried(search, new, by, store, executor(), on_event, estimators, replace(judging, out=out))
            known |= {named(trial.fields): trial for trial in found}
        sampler.tell({name: standing_of(trial, by) for name, trial in known.items()})
    every = list(known.values())
    return chosen(suite(agent, logs, [trial.fields for trial in every], **sizes), by, every, store)
