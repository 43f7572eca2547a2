"""Monitors a policy in use: changes of observations and actions since its log, and the realised value.

Each call computes everything from the whole new log, and repeats the findings of earlier calls. So it may be called any number
of times: the probability that anything is reported although nothing has changed is at most `alpha`, over all calls together.
Half of it is for the realised value, two fifths for drift, a tenth for values outside the log.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.late import rewards_to_come
from deadreckon.data.leaks import LEVEL as RARE
from deadreckon.data.split import units_of
from deadreckon.errors import UserError
from deadreckon.policies.deployed import first_actions
from deadreckon.provided import Shown
from deadreckon.runs import compared
from deadreckon.runs.compared import Compared, Order, Outside
from deadreckon.runs.realised import Realised, finished, realised
from deadreckon.runs.subject import Subject, estimates_of, subject
from deadreckon.stats import drift
from deadreckon.stats.interval import ALPHA, PERCENT, decimals, level_in_words

VALUE, DRIFT, OUTSIDE = 0.5, 0.4, 0.1  # shares of alpha
SHOWN = 5  # most new levels that are named
MadeBy = Literal["policy", "reference"]


class Finding(NamedTuple):
    """One line of the report.

    Attributes:
        about: "observation", "action", "outside" or "value".
        name: of the column; for the value, its description.
        alarm: whether it makes the exit code 1.
        text: the finding.
    """

    about: str
    name: str
    alarm: bool
    text: str

    def __str__(self) -> str:
        return f"{'!' if self.alarm else ' '} {self.about} {self.name}: {self.text}"


@dataclass(frozen=True)
class Monitored(Shown):
    """The result of `monitor`.

    Attributes:
        name: of the policy.
        reference, log: names of the logs that were compared.
        rows, episodes: of the new log.
        compared: a description of the rows and actions that were compared.
        untested: the reason why no column could be tested; empty if they were tested.
        alpha: probability of a false alarm, over all calls.
        columns: observations and actions, with their changes.
        outside: rows of the new log that lie outside the reference.
        value: the realised value, or the reason why it is not known.
        findings: one line each, alarms first.
    """

    name: str
    reference: str
    log: str
    rows: int
    episodes: int
    compared: str
    untested: str
    alpha: float
    columns: tuple[Compared, ...]
    outside: Outside
    value: Realised | str
    findings: tuple[Finding, ...]

    @property
    def alarm(self) -> bool:
        """Whether something drifts, lies outside the log, or has a lower value than estimated."""
        return any(each.alarm for each in self.findings)

    def __str__(self) -> str:
        head = f"{self.name} on {self.log}: {self.rows:,} rows in {self.episodes:,} finished episodes, against {self.reference}"
        return "\n".join([head, self.compared, *map(str, self.findings)])


def monitor(
    run: Any,
    log: Any,
    *,
    reference: Any = None,
    made_by: MadeBy | None = None,
    estimates: Path | str | None = None,
    return_range: tuple[float, float] | None = None,
    seed: int | None = None,
    greedy: bool | None = None,
    alpha: float = ALPHA,
) -> Monitored:
    """Compares a new log with the one that a policy was trained on, and the realised value with the estimate.

    Args:
        run: the run, its folder, a cross-fit's folder or a policy file.
        log: the new log, in the order of time: a `Dataset`, or a file or data frame, which is read like the policy's own log.
        reference: the log to compare with, likewise; None: the one that the policy was trained on.
        made_by: who made the new log. "policy": the policy of the run. Its actions are compared with those of the policy in the
            reference, and if episodes have several steps, only first steps are compared, because a new policy visits other
            states; actions are compared in the episodes of the reference that the policy was not trained on, if there are any.
            "reference": the same policy or people as the reference; then all rows and logged actions are compared, and the
            realised value is not compared with the policy's. None: "policy"; if a reference other than the training log is
            given, the policy is taken to have made it, too, and all rows and logged actions are compared.
        estimates: the folder of `deadreckon ope --out` or `recommend`; None searches the run's folder and the folders beside
            it.
        return_range: smallest and largest return that an episode can have; None: see `runs.realised`.
        seed: of the run's policy; None: the first that has not failed.
        greedy: whether the policy takes its deterministic (greedy) actions in use; None: as in the estimate, or else yes.
        alpha: probability that anything is reported without a change, over all calls together.

    Raises:
        UserError: input that does not fit, in one line.
    """
    if log is None:
        raise UserError("monitor needs the new log: a Dataset, a file or a data frame")
    if not 0 < alpha < 1:
        raise UserError(f"alpha must be between 0 and 1, got {alpha:g}")
    if made_by not in (None, "policy", "reference"):
        raise UserError(f"made_by is policy or reference, got {made_by!r}")
    said = {"--return-range": return_range, "--greedy": greedy}
    if made_by == "reference" and (idle := next((option for option, value in said.items() if value is not None), None)):
        raise UserError(f"{idle} is about the policy's actions or value, and --made-by reference compares neither")
    one = subject(run, seed)
    told = estimates_of(one, estimates)
    option = "--reference (in Python reference=)"
    old = one.log(reference, gaps=reference is not None, option=option)
    new = one.log(log, gaps=True, option=option)
    sizes = [(log.spec.observation_shape, log.spec.action_size, log.spec.discrete) for log in (old, new)]
    if sizes[0] != sizes[1]:
        shapes = (f"{log.name} has observations {log.spec.observation_shape}, {log.action_space}" for log in (old, new))
        raise UserError(f"the logs cannot be compared: {' and '.join(shapes)}")
    # A copy of the policy's training log was not made by the policy, wherever the copy is.
    own = reference is None or one.learned_from(old)
    by_policy = (made_by or ("policy" if own else "reference")) == "policy"
    new = finished(new, old)
    if greedy is None:
        greedy = True if told is None else bool(told[0]["estimand"]["greedy"])
    first = by_policy and bool(old.lengths.max() > 1 or new.lengths.max() > 1)
    which = compared.whats(old)
    before = compared.sample(old, compared.some(np.arange(old.episodes), "reference"), first)
    parts, fresh = [(before, which)], False
    acts = (lambda seen: compared.acted(old, _done(one, seen, old, greedy))) if by_policy else None
    if acts is not None:
        done, fresh = _acts(one, old, first, acts)
        sides = [[what for what in which if (what.about == "action") == acting] for acting in (False, True)]
        parts = [(each, side) for each, side in zip((before, done), sides) if side]
    columns, untested, order = [], "", Order.of(new, which, first)
    lengths = compared.lengths_of(old, which, first, acts)
    for each, side in parts:
        for size in (None, *sorted({lengths[what] for what in side if what in lengths})):
            own = [what for what in side if lengths.get(what) == size]
            if not own:
                continue
            level = DRIFT * alpha * len(own) / len(which)
            found, made = compared.drifts(each, new, own, first, level, size, order if size is None else None)
            if size is None and not made:
                untested = _untested(len(each.starts), new)
                found = [replace(one, untested=untested.removeprefix("not tested: ")) for one in found]
            columns = [*columns, *found]
    outside = compared.outside(old, new, which, first, OUTSIDE * alpha, lengths, order)
    value: Realised | str = "not compared: the new log was not made by the policy of the run"
    if told is not None and bool(told[0]["estimand"]["greedy"]) != greedy:
        used, judged = ("greedy", "sampled") if greedy else ("sampled", "greedy")
        value = f"not compared: the policy's {used} actions are in use, and its {judged} ones were estimated"
    elif made_by != "reference":
        value = realised(new, old, told, return_range, VALUE * alpha)
    untested = untested if all(each.untested for each in columns) else ""
    findings = [*_of_value(value, alpha), *_of_columns(columns), *_of_outside(outside, columns, len(new))]
    if by_policy and (line := rewards_to_come(new, RARE)) is not None:
        findings.append(Finding("value", "latest", False, line))
    findings.sort(key=lambda each: not each.alarm)
    words = _words(by_policy, first, greedy, fresh)
    return Monitored(
        one.name, old.name, new.name, len(new), new.episodes, words, untested, alpha, tuple(columns), outside, value,
        tuple(findings),
    )  # fmt: skip


def _acts(
    one: Subject, old: Dataset, first: bool, acts: Callable[[np.ndarray], np.ndarray]
) -> tuple[compared.Sample, bool]:
    """The policy's actions in the reference, in episodes that it was not trained on if these are enough, and whether they are:
    in training episodes its actions may be memorised."""
    every = np.arange(old.episodes)
    unseen = every if one.taught is None else every[~np.isin(old.episode_ids, one.taught)]
    fresh = one.taught is not None and len(np.unique(units_of(old)[unseen])) >= compared.FEWEST
    done = compared.sample(old, compared.some(unseen if fresh else every, "reference"), first)
    return replace(done, actions=acts(done.observations)), fresh


def _untested(units: int, new: Dataset) -> str:
    """The reason why no column was tested.

    Args:
        units: number of units of the reference.
        new: the new log.
    """
    if new.episodes < drift.FIRST:
        return f"not tested: {drift.FIRST} finished episodes are needed"
    if units < compared.FEWEST:
        return f"not tested: the reference has {units} episodes or clusters, {compared.FEWEST} are needed"
    own = len(np.unique(units_of(new)))
    return f"not tested: the new log has {own} episodes or clusters, {compared.FEWEST} are needed"


def _done(one: Subject, observations: np.ndarray, log: Dataset, greedy: bool) -> np.ndarray:
    """The policy's actions at these observations, each as the first of an episode."""
    shaped = jnp.asarray(observations.reshape(len(observations), *log.spec.observation_shape))
    return np.asarray(first_actions(one.policy, shaped, jax.random.key(0), greedy))


def _words(by_policy: bool, first: bool, greedy: bool, fresh: bool) -> str:
    if not by_policy:
        return "compared: all rows and logged actions"
    rows = "the first step of each episode, since a new policy visits other states later" if first else "all rows"
    where = "in the episodes of the reference on which it was not trained" if fresh else "in the reference"
    return f"compared: {rows}; actions with the policy's {'greedy' if greedy else 'sampled'} ones {where}"


def _of_value(value: Realised | str, alpha: float) -> list[Finding]:
    if isinstance(value, str):
        return [Finding("value", "realised", False, value)]
    shown = value.interval
    d = decimals(shown.value, *([] if value.estimated is None else [value.estimated.value]))
    level = level_in_words(1 - alpha)
    text = f"{shown:.{d}f} ({level} confidence sequence, which holds for any number of looks)"
    if value.length > 1:
        text += f", of means of {value.length:,} episodes, as returns depend on those of the episodes before"
    if value.estimated is not None:
        text += f", estimated {value.estimated:.{d}f}"
        if value.among > 1:
            text += f" ({PERCENT} for all of {value.among} policies at once)"
    else:
        text += "; no estimate is known"
    out = []
    if value.below_at is not None:
        text += f": below the estimate since episode {value.below_at:,}"
    out.append(Finding("value", "realised", value.below_at is not None, text))
    if value.beyond:
        low, high = value.range
        lost = f"{value.beyond:,} returns lie outside {low:.4g} .. {high:.4g} ({value.source})"
        out.append(Finding("value", "range", False, f"{lost}: there is no bound on that side; give a range (--return-range)"))
    return out


def _of_columns(columns: Sequence[Compared]) -> list[Finding]:
    out = []
    for each in columns:
        what = each.what
        if what.kind == "category":
            effect = f"{each.distance:.1%} of rows would need another level to make shares equal (total variation distance)"
            effect += f"; most in {each.level}, {each.before:.1%} before, {each.now:.1%} now"
        else:
            effect = f"mean {each.before:.4g} before, {each.now:.4g} now ({each.shift:+.2f} standard deviations)"
            effect += f"; largest difference of the distribution functions {each.distance:.2f} (Kolmogorov-Smirnov)"
        if any(each.missing):
            effect += f"; missing in {each.missing[0]:.1%} of rows before, {each.missing[1]:.1%} now"
        if each.others:
            effect += f"; new levels: {others_of(each)}"
        if each.found is None:
            why = f"not tested: {each.untested}" if each.untested else "no drift"
            if each.length is not None and not each.untested:
                why += f" in parts of {each.length:,} episodes, as values depend on those of the episodes before"
            out.append(Finding(what.about, what.name, False, f"{why}; {effect}"))
        else:
            out.append(Finding(what.about, what.name, True, f"drift, {since(each.found)}; {effect}"))
    return out


def since(found: tuple[int, int]) -> str:
    """When a test found a drift, and what it compared, in words; see `Compared.found`."""
    after, last = found
    return f"found after {after:,} new episodes" + (f", in the last {last:,} of them" if last < after else "")


def others_of(each: Compared) -> str:
    """The levels of the new log that the reference does not have, the first ones by name."""
    return ", ".join(map(repr, each.others[:SHOWN])) + (", ..." if len(each.others) > SHOWN else "")


def _of_outside(outside: Outside, columns: Sequence[Compared], rows: int) -> list[Finding]:
    by = {each.what.name: each for each in columns if each.others}
    listed = []
    for name, how, count, guilty in outside.columns:
        which = f": {others_of(by[name])}" if how == compared.UNKNOWN and name in by else ""
        listed.append(Finding("outside", name, guilty, f"{count:,} row{'' if count == 1 else 's'} {_side(how)}{which}"))
    return [Finding("outside", "the log", False, f"{outside.share:.1%} of {rows:,} rows"), *listed]


def _side(how: str) -> str:
    if how == compared.MISSING:
        return "without a value, which no row of the log lacks"
    return f"with {how}" if how == compared.UNKNOWN else f"{how} all of the reference"
