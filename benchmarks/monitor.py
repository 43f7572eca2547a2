"""False alarms and power of `deadreckon monitor`, on simulated logs whose truth is known.

    python benchmarks/monitor.py --logs 200            # the tables of docs/use/monitor.md
    python benchmarks/monitor.py --logs 60 --memorised   # a policy that has overfitted

Each new log is looked at after every episode. Where nothing has changed, an alarm at any look is a false one, and the interval
of the realised value misses if it ever leaves out the true mean. The estimate's lower end is that true mean itself: the worst
case in which the policy still brings what was estimated.
"""

import argparse
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import deadreckon as dr
from deadreckon.data.spec import Box
from deadreckon.files import write_json
from deadreckon.runs.monitor import monitor
from deadreckon.runs.realised import Realised
from deadreckon.stats.confidence_sequence import refuted_at

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from tests.recorded import decision

TRUE = {"rows": 0.4, "episodes": 4.0, "series": 0.4}  # mean returns
SIZES = {"rows": (500, 320), "episodes": (100, 160), "series": (1000, 640)}  # episodes of the reference and of the new log


def rows(n, rng, shift=0.0, late=0.0, level=0.0, worse=0.0):
    """Single decisions: three numbers, a flag, one of three actions, a reward of 0 or 1."""
    x = rng.normal(size=(n, 3))
    x[:, 0] += shift
    x[n // 2 :, 1] += late
    flag = rng.random(n) < 0.3 + level
    return dr.Dataset.from_arrays(
        observations=np.column_stack([x, flag]), actions=rng.integers(0, 3, n),
        rewards=(rng.random(n) < TRUE["rows"] - worse).astype(float), terminals=np.ones(n, bool), name="rows",
    )  # fmt: skip


def episodes(n, rng, shift=0.0, late=0.0, level=0.0, worse=0.0):
    """Episodes of 20 steps whose numbers hang together: AR(1) of 0.9 around a level of the episode's own."""
    steps = 20
    x = np.empty((n, steps, 4))
    x[:, 0] = rng.normal(size=(n, 4))
    for t in range(1, steps):
        x[:, t] = 0.9 * x[:, t - 1] + np.sqrt(1 - 0.81) * rng.normal(size=(n, 4))
    x += rng.normal(size=(n, 1, 4))
    x[:, :, 0] += np.sqrt(2) * shift
    x[n // 2 :, :, 1] += np.sqrt(2) * late
    x[:, :, 3] = x[:, :, 3] + np.sqrt(2) * 3 * level > 0.7
    reward = (TRUE["episodes"] - 10 * worse) / steps + 0.05 * x[:, :, 2]
    ends = np.zeros((n, steps), bool)
    ends[:, -1] = True
    action = np.tanh(x[:, :, :2] + 0.5 * rng.normal(size=(n, steps, 2)))
    return dr.Dataset.from_arrays(
        observations=x.reshape(-1, 4), actions=action.reshape(-1, 2), rewards=reward.ravel(), terminals=ends.ravel(),
        action_space=Box((-1.0, -1.0), (1.0, 1.0)), name="episodes",
    )  # fmt: skip


def series(n, rng, shift=0.0, late=0.0, level=0.0, worse=0.0):
    """Single decisions of a slowly changing system: a number that is AR(1) of 0.9 over rows, another one, a flag, and actions
    that depend on the first."""
    slow, noise = np.empty(n), rng.normal(size=n)
    slow[0] = noise[0]
    for t in range(1, n):
        slow[t] = 0.9 * slow[t - 1] + np.sqrt(1 - 0.81) * noise[t]
    action = (slow + 0.5 * rng.normal(size=n) > 0).astype(int)
    x = np.stack([slow + shift, rng.normal(size=n)], 1)
    x[n // 2 :, 1] += late
    return dr.Dataset.from_arrays(
        observations=np.column_stack([x, rng.random(n) < 0.3 + level]), actions=action,
        rewards=(rng.random(n) < TRUE["series"] - worse).astype(float), terminals=np.ones(n, bool), name="series",
    )  # fmt: skip


MAKE = {"rows": rows, "episodes": episodes, "series": series}
CHANGES = {
    "nothing": {},
    "one column by 0.3 SD": {"shift": 0.3},
    "one column by 0.5 SD": {"shift": 0.5},
    "one column by 1 SD, from the middle on": {"late": 1.0},
    "one column by 3 SD, from the middle on": {"late": 3.0},
    "one column by 1 SD": {"shift": 1.0},
    "a flag's share from 30 % to 50 %": {"level": 0.2},
    "the mean return by a quarter": {"worse": 0.1},
}


def measure(kind, change, logs, folder):
    """Shares of logs with an alarm (of any kind, drift, outside, value), and whose interval ever left out the true mean.

    Whatever an earlier look finds the last one finds too (`tests/runs/test_monitor.py`), so the last one tells of all looks.
    The interval is looked at after every episode.
    """
    run, counts = folder / kind, np.zeros(5)
    old_size, new_size = SIZES[kind]
    for number in range(logs):
        rng = np.random.default_rng([number, 7])
        old, new = MAKE[kind](old_size, rng), MAKE[kind](new_size, rng, **change)
        seen = monitor(run, new, reference=old, estimates=folder / "estimates")
        about = {each.about for each in seen.findings if each.alarm}
        assert isinstance(seen.value, Realised)
        x, (low, high), half = new.returns(), seen.value.range, seen.alpha / 2
        missed = [refuted_at(x, (low, high), TRUE[kind], half), refuted_at(-x, (-high, -low), -TRUE[kind], half)]
        counts += [bool(about), bool(about & {"observation", "action"}), "outside" in about, "value" in about, any(missed)]
    return counts / logs


def memorised(logs, folder):
    """Shares of logs with an alarm, and with drift of the actions, where nothing has changed and a policy that has overfitted
    is in use: by default its actions are compared with its own in the episodes of the reference that it has not learned from.
    """
    counts = np.zeros(2)
    for number in range(logs):
        rng = np.random.default_rng([number, 11])
        old, new = (
            dr.Dataset.from_arrays(
                observations=rng.normal(size=(n, 8)), actions=rng.choice([-0.9, 0.9], (n, 1)), rewards=rng.random(n),
                terminals=np.ones(n, bool), action_space=Box((-1.0,), (1.0,)), name="noise",
            )
            for n in (160, 640)
        )  # fmt: skip
        agent = dr.agents.BC(hidden=(128, 128), lr=1e-2, batch_size=64)
        run = dr.train(agent, old, steps=300, task=False, out=folder / f"memorised{number}")
        seen = monitor(run, replace(new, actions=run.policies[0](new.observations)), reference=old)
        about = {each.about for each in seen.findings if each.alarm}
        counts += [bool(about), "action" in about]
    return counts / logs


def main():
    """Prints the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--kinds", nargs="*", default=list(MAKE))
    parser.add_argument("--memorised", action="store_true", help="a policy that has overfitted, where nothing has changed")
    parser.add_argument("--changes", nargs="*", default=list(CHANGES))
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if not options.memorised:
        print("| logs | what has changed | any alarm | drift | outside the log | value below the estimate | interval misses |")
        print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if options.memorised:
            print(" | ".join(f"{100 * share:.1f} %" for share in memorised(options.logs, folder)))
            return
        for kind in options.kinds:
            log = MAKE[kind](64, np.random.default_rng(0))
            dr.train(dr.agents.BC(hidden=(4,), batch_size=8), log, steps=1, task=False, out=folder / kind, holdout=0)
            value = {"method": "truth", **{name: [TRUE[kind]] * 2 for name in ("value", "low", "high")}}
            told = decision([{"name": kind, "run": kind, "seed": 0}], [value])
            told["estimand"] |= {"discount": 1.0, "horizon": None, "greedy": True}
            write_json(folder / "estimates" / "estimates.json", told)
            for change in options.changes:
                begun = time.perf_counter()
                found = measure(kind, CHANGES[change], options.logs, folder)
                cells = " | ".join(f"{100 * share:.1f} %" for share in found)
                print(f"| {kind} | {change} | {cells} |  <!-- {time.perf_counter() - begun:,.0f} s -->", flush=True)


if __name__ == "__main__":
    main()
