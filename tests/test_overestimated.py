"""Estimates of off-policy Q-learning beside what its policies get."""

from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import read
from evidence.overestimated import overestimated
from tests.results import keep

SUITE = """
kind = "learn"
ledger = "ledger"
seeds = 3
steps = 100
evaluations = 1
rows = {rows}
logs = ["halfcheetah-expert-v2"]

[methods]
SAC-off = {{ agent = "sac" }}
BC = {{ agent = "bc" }}
"""


def test_the_middle_and_both_ends_of_the_overestimates_are_shown_and_what_is_missing_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("evidence.overestimated.SUITES", ["less", "more", "most"])
    for name, rows in (("less", 1_000), ("more", 2_000), ("most", 3_000), ("other", 4_000)):
        (tmp_path / f"{name}.toml").write_text(SUITE.format(rows=rows))
    suites = [read(f"{name}.toml") for name in ("other", "most", "more", "less")]
    store = store_of(suites, tmp_path)
    for suite in suites:
        own, imitation = plan(suite)
        if suite.name == "most":
            continue
        # A run of imitation has no estimate.
        keep(store, imitation, [0.0] * 3, discounted_return=[7.0] * 3)
        few = 1 if suite.name == "more" else 3
        keep(store, own, [0.0] * few, discounted_return=[1.0, 2.0, 3.0][:few], overestimate=[5e6, 10.0, 2000.0][:few])
    less, more, most, *_ = overestimated(suites, store).splitlines()[2:]
    assert less == "| `less.toml` | 1,000 | 3 of 3 | 2 [-0, 4] | 2,000 (10 to 5,000,000) |"  # 2 -+ 4.303 / sqrt(3)
    assert more == "| `more.toml` | 2,000 | 1 of 3 | 1 | 5,000,000 (5,000,000 to 5,000,000) |"
    assert most == "| `most.toml` | 3,000 | 0 of 3 | - | - |"
