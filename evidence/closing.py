"""What would decide claims that are open: core-hours of the scores that are missing, or more seeds."""

from collections.abc import Iterable, Mapping

from deadreckon.bench.claims import Comparison, Verdict
from deadreckon.bench.suite import read
from deadreckon.bench.times import Forecast
from deadreckon.stats.comparison import Difference, more_runs

MOST = 1_000  # fresh seeds beyond which their number says nothing but that the difference is near to the margin


def hours(expected: Iterable[Forecast | None]) -> str:
    """The sum in hours, with `>` where some are not known, or in part, and `about` where some are rough."""
    every = list(expected)
    known = [each for each in every if each is not None]
    if not known:
        return "not measured"
    whole = len(known) == len(every) and all(each.whole for each in known)
    marks = ("" if whole else "> ") + ("" if all(each.close for each in known) else "about ")
    return f"{marks}{sum(each.seconds for each in known) / 3600:,.1f}"


def to_close(found: Verdict, cost: Mapping[str, Forecast | None]) -> str:
    """What an open claim lacks in words, if differences stay as they are; nothing of one that is decided or has no tests.

    Args:
        found: the verdict at the size that `cost` is of.
        cost: what cells that are missing are expected to take.
    """
    if found.state != "open" or not found.comparisons:
        return ""
    if found.absent:
        time = hours(cost[cell] for cell in sorted(found.absent))
        scores = f"{found.missing:,} score{'s' * (found.missing != 1)}"
        return f"{scores}, {time}{'' if time == 'not measured' else ' core-hours'}"
    if found.undefined:
        return "not estimated: a score is not finite"
    left = [one.stages[-1] for one in found.comparisons if one.state == "open"]
    if any(one.test.beside is not None or one.test.among or not isinstance(one.gain, Difference) for one in left):
        return "not estimated: more than seeds vary"
    if any(one.constant for one in left):
        return "not estimated: all seeds differ by the same on a log"
    counts = [_seeds(one, len(found.comparisons)) for one in left]
    known = [count for count in counts if count is not None]
    against = [count for count, one in zip(counts, left) if count is not None and one.gain.value < one.test.margin]
    if not against and len(known) < len(left):
        return "no number of seeds"
    # One comparison contradicts a claim, and all have to hold.
    chosen, state = (min(against), "contradicted") if against else (max(known), "holds")
    if chosen > MOST:
        return f"more than {MOST:,} fresh seeds: the difference is too near to the margin"
    count = f"{float(f'{chosen:.2g}'):,.0f}"  # two digits: it rests on a difference that is not known better
    return f"about {count} fresh seeds, then {state}"


def _seeds(one: Comparison, comparisons: int) -> int | None:
    """How many fresh seeds of a further stage would decide it (`bench.claims`); None where the difference is the margin."""
    # Of several comparisons each contradicts the claim at a level for as many.
    below = one.gain.value < one.test.margin
    interval, miss = (one.strict, (1.0 - one.level) / comparisons) if below else (one.gain, 1.0 - one.level)
    assert isinstance(interval, Difference)
    runs = read(one.test.suite).seeds
    more = more_runs(interval, runs, one.test.margin, 1.0 - miss, wanted=1.0 - miss / 2.0)
    return None if more is None else runs + more
