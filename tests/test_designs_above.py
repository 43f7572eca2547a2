"""NEMO beside two rivals: what counts as above both."""

from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import read
from evidence.designs_above import above
from tests.results import keep

SUITE = """
kind = "design"
ledger = "ledger"
seeds = 3
budget = "cpu"
problems = ["ant-morphology", "dkitty-morphology", "hopper-controller", "tfbind8"]
files = { tfbind8 = "40ac86e1b0836492" }

[methods]
NEMO = { agent = "nemo" }
ensemble = { agent = "ensemble" }
forward = { agent = "forward" }
"best of data" = { agent = "best" }
"""
NEAR, FAR = [1.0, 2.0, 3.0], [11.0, 12.0, 14.0]


def test_above_both_by_the_best_or_by_the_median(tmp_path, monkeypatch):
    (tmp_path / "one.toml").write_text(SUITE)
    monkeypatch.setattr("evidence.designs_above.SUITES", ["one"])
    monkeypatch.chdir(tmp_path)
    suite = read("one.toml")
    store = store_of([suite], tmp_path)
    # (best, median) of NEMO; those of both rivals are near, but for one that is as far as NEMO's on
    # the second problem; so is the best of the data on the last.
    own = {"ant-morphology": (FAR, NEAR), "dkitty-morphology": (FAR, NEAR), "hopper-controller": (FAR, FAR[:2])}
    own["tfbind8"] = FAR, NEAR
    for job in plan(suite):
        best, median = own[job.on] if job.method == "NEMO" else (NEAR, NEAR)
        if (job.method, job.on) in (("forward", "dkitty-morphology"), ("best of data", "tfbind8")):
            best = FAR
        some = min(len(best), len(median))
        keep(store, job, best[:some], median=median[:some])
    ant, dkitty, hopper, tf, _, count = above([suite], store).splitlines()[2:]
    # 10, 10 and 11: 10.33 -+ 4.303 / 3
    same = "10.3 [8.9, 11.8]"
    assert ant == f"| ant-morphology | {same} | {same} | {same} |" + " 0.0 [0.0, 0.0] |" * 3 + " best | best |"
    assert dkitty.endswith("| no | no |")
    assert hopper.endswith("| not all cells are there | |")
    assert tf.endswith("| best | no |")
    assert count == "NEMO is above both rivals on 2 of 3 problems, and above the best of the data as well on 1."
