"""Bias and coverage of cross-fitted doubly robust gains: `python benchmarks/dr_coverage.py`, then `... --table`.

Bandit logs of 1,000 rows from generative models of classification data (`decision_study/bandits.py`), all rows judged, by the
package's `dr-linear` with critics (and, where the log does not tell its propensities, a model of these) out of fold. The
policies are the two that are made by hand, better and worse than the log's own; a policy that had learned from the rows would
have seen them. Seeds are those of the confirmatory split. A log is a small file, so what is there is not done again.
"""

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from decisions import ONE_THREAD, forget

ROWS, KINDS, ALPHA = 1_000, ("classes", "classes-unknown"), 0.05


def one(job: tuple[str, int], out: Path) -> None:
    """In a worker: a log, and what is said of its two policies."""
    import numpy as np
    from decision_study import FAMILIES

    from deadreckon.files import write_json
    from deadreckon.ope import OPEInput
    from deadreckon.ope.behavior_model import PROPENSITIES
    from deadreckon.ope.doubly_robust import DoublyRobust
    from deadreckon.ope.linear import LinearFQE
    from deadreckon.ope.select import gains

    kind, seed = job
    if (path := out / kind / f"{seed}.json").exists():
        return
    forget()
    problem = FAMILIES[kind].log(seed, ROWS)
    names, policies = list(problem.candidates), list(problem.candidates.values())
    case = OPEInput(problem.log, policies, discount=0.0, horizon=1, names=names, logged=True, seed=seed % 2**32, noise=None)
    found = DoublyRobust(kind="dr", fqe=LinearFQE(), model=PROPENSITIES).on(case)
    told = gains(found, ALPHA)[: len(policies)]
    true = problem.world.gains(policies, np.full(len(policies), 1e-3))[0]
    gain, low, high = told.T.tolist()
    write_json(path, {"policies": names, "gain": gain, "low": low, "high": high, "true": true.tolist()})


def table(out: Path) -> str:
    """Of what is there."""
    import numpy as np
    from decision_study.summary import wilson
    from scipy import stats

    from deadreckon.files import read_json

    lines = ["| propensities | policy | logs | bias | standard error of the bias | "
             "coverage of both at once | … lower bound (95 %) | binomial p (95 %) |",
             "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for kind in KINDS:
        found = [read_json(path) for path in sorted((out / kind).glob("*.json"))]
        if not found:
            continue
        low, high, gain, true = (np.array([each[x] for each in found]) for x in ("low", "high", "gain", "true"))
        hits, n = int(((low <= true) & (true <= high)).all(1).sum()), len(found)
        for i, name in enumerate(found[0]["policies"]):
            off, both = gain[:, i] - true[:, i], ["", "", ""]
            error = off.std(ddof=1) / np.sqrt(n)
            if i == 0:
                both = [f"{100 * hits / n:.1f} %", f"{100 * wilson(hits, n)[0]:.1f} %", f"{stats.binom.cdf(hits, n, 0.95):.2g}"]
            told = "learned" if kind.endswith("unknown") else "logged"
            lines.append(f"| {told} | `{name}` | {n} | {off.mean():+.4f} | {error:.4f} | {' | '.join(both)} |")
    return "\n".join(lines)


def main() -> int:
    os.environ |= ONE_THREAD
    from decision_study.trial import CONFIRM

    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--logs", type=int, default=300, help="logs, with logged propensities and with learned ones")
    add("--first", type=int, default=CONFIRM, help="the first seed; development logs begin at 0")
    add("--workers", type=int, default=2, help="processes")
    add("--out", type=Path, default=Path("runs/dr-coverage"), help="folder of the results")
    add("--table", action="store_true", help="print the table of what is there, and do nothing")
    options = parser.parse_args()
    if not options.table:
        jobs = [(kind, seed) for kind in KINDS for seed in range(options.first, options.first + options.logs)]
        with ProcessPoolExecutor(options.workers, get_context("spawn"), initializer=os.nice, initargs=(10,)) as pool:
            for done, _ in enumerate(pool.map(partial(one, out=options.out), jobs), 1):
                print(f"\r{done} of {len(jobs)} logs", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
    print(table(options.out))
    return 0


if __name__ == "__main__":
    sys.exit(main())
