"""Agents beside what they were: which runs are paired, and the mean over logs."""

from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.store import JobResult
from deadreckon.bench.suite import read
from evidence.changed import changed

PAIRS = """
kind = "learn"
ledger = "ledger"
seeds = 2
steps = 100
evaluations = 1
logs = ["hopper-medium-v2", "door-human-v1"]

[methods]
CRR = { agent = "crr" }
"CRR, before" = { agent = "crr", fields = { likelihood = "tanh_normal" } }
BC = { agent = "bc" }
"""
MORE = PAIRS.replace(', "door-human-v1"', "").replace("seeds = 2", "seeds = 3").replace("CRR, before", "CRR, tanh-normal")


def test_differences_are_of_the_same_seeds_of_all_suites(tmp_path, monkeypatch):
    for name, text in ("one", PAIRS), ("two", MORE):
        (tmp_path / f"{name}.toml").write_text(text)
    monkeypatch.setattr("evidence.changed.PAIRS", ["one"])
    monkeypatch.setattr("evidence.changed.MORE", ["two"])
    monkeypatch.chdir(tmp_path)
    suites = [read("one.toml"), read("two.toml")]
    store = store_of(suites, tmp_path)
    scores = {
        ("CRR", "hopper-medium-v2"): [11.0, 13.0, 15.0], ("CRR, tanh-normal", "hopper-medium-v2"): [10.0, 11.0, 12.0],
        ("CRR", "door-human-v1"): [3.0, 5.0], ("CRR, before", "door-human-v1"): [9.0, 7.0],
    }  # fmt: skip
    one = {"raw": 0.0, "steps": 100, "seconds": 1.0, "failure": "", "versions": "{}", "more": "{}"}
    for job in (job for suite in suites for job in plan(suite)):
        values = scores.get((job.method, job.on), [])[: len(job.seeds)]
        if values:
            store.keep(job, JobResult([{"seed": s, "score": v, **one} for s, v in zip(job.seeds, values)], []))
    # 1, 2, 3: 2 -+ 4.303 / sqrt(3); -6 and -2: -4 -+ 12.706 * 2; their mean -1, of variance (1/3 + 4) / 4 with 1.17 degrees.
    (line,) = changed(suites, store).splitlines()[2:]
    assert line.startswith("| CRR | 2.0 [-0.5, 4.5] (3) | -4.0 [-29.4, 21.4] (2) | -1.0 [")
