"""Golden numbers: what short runs of every method, and the pieces of the protocol, gave at the revisions of today.

    python -m tests.golden

writes numbers into `golden.json` that are missing or of earlier revisions. Numbers that changed under the same revision it
tells and leaves: whoever meant to change them raises that revision first. Where nothing of ours has changed them, but a new
version of a dependency, their entries are taken out by hand, with the reason in the message of the commit.

Other instructions of the processor and other optimisations of the compiler change these numbers by 6e-4 at the most (DAPG,
whose step solves a linear system) and mostly by less than 1e-5; a changed loss, target, draw or order of updates changes some
by 1e-2 or more. `RTOL` lies between the two.
"""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

from tests.golden_runs import OFFLINE, RUNS, Numbers

ROOT = Path(__file__).resolve().parent.parent
PATH = ROOT / "tests" / "golden.json"
RTOL = 2e-3
COMMAND = "`python -m tests.golden`"
__all__ = ["OFFLINE", "RUNS", "kept", "problem_of"]


def kept() -> dict[str, dict[str, Any]]:
    """The golden numbers and their revisions by what they are of."""
    return json.loads(PATH.read_text()) if PATH.exists() else {}


def differences(before: Numbers, now: Numbers) -> list[str]:
    """One line for each group of numbers that is another."""
    lines = []
    for group in dict.fromkeys([*before, *now]):
        old, new = (np.asarray(numbers.get(group, []), float) for numbers in (before, now))
        if old.shape != new.shape:
            lines.append(f"{group}: there were {len(old)} numbers, now {len(new)}")
            continue
        finite = np.isfinite(old)
        # Of a number near zero rounding is as large as of its neighbours.
        scale = np.maximum(np.abs(old), 0.01 * np.abs(old[finite]).max(initial=0.0))
        with np.errstate(invalid="ignore"):
            off = np.where(finite & np.isfinite(new), np.abs(new - old) > RTOL * scale, old.astype(str) != new.astype(str))
        if off.any():
            first = int(np.flatnonzero(off)[0])
            told = f"the first {old[first]:.6g} before and {new[first]:.6g} now"
            lines.append(f"{group}: {int(off.sum())} of {len(old)} numbers, {told}")
    return lines


def problem_of(name: str) -> str | None:
    """What is wrong with the run of that name; None where all is as before."""
    run, before = RUNS[name], kept().get(name)
    if before is None:
        return f"{name} has no golden numbers: run {COMMAND}"
    if before["revisions"] != run.revisions:
        return f"{name} has revisions {run.revisions}, its golden numbers are of {before['revisions']}: run {COMMAND}"
    told = differences(before["numbers"], run.numbers())
    if not told:
        return None
    still = f"numbers of {name} changed ({'; '.join(told)}), but its revisions are still {run.revisions}"
    return f"{still}: raise {run.raised}, and run {COMMAND}"


def entry(name: str) -> dict[str, Any]:
    """What is kept of a run."""
    run = RUNS[name]
    numbers = {group: [float(f"{x:.5g}") for x in values] for group, values in run.numbers().items()}
    return {"revisions": run.revisions, "numbers": numbers}


def main() -> int:
    """Writes what is missing or of earlier revisions, and tells what changed under the same one."""
    jax.config.update("jax_disable_most_optimizations", True)  # as in the tests: most of the time is the compiler's
    jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax"))
    known, wrong = kept(), []
    for name, run in RUNS.items():
        if name not in known or known[name]["revisions"] != run.revisions:
            known[name] = entry(name)
        elif told := problem_of(name):
            wrong.append(told)
    entries = [f"{json.dumps(name)}: {json.dumps(known[name])}" for name in RUNS]
    PATH.write_text("{\n" + ",\n".join(entries) + "\n}\n")
    print("\n".join(wrong) or f"{len(entries)} entries in {PATH}")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
