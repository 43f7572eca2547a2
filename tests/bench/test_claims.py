"""Claims: what is refused in their file, and what results say of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from deadreckon.bench.claims import verdict
from deadreckon.bench.claims_file import claims
from deadreckon.bench.jobs import curve_end, updates
from deadreckon.bench.ledger import store_of
from deadreckon.bench.plan import plan
from deadreckon.bench.store import JobResult, Store
from deadreckon.bench.suite import read
from deadreckon.errors import UserError
from deadreckon.stats.comparison import paired
from deadreckon.stats.interval import Interval
from evidence.pages import _effect
from tests.results import keep

SUITE = """
kind = "learn"
ledger = "ledger"
seeds = 4
steps = 100
evaluations = 1
logs = ["hopper-medium-v2", "walker2d-medium-v2"]

[methods]
BC = { agent = "bc" }
BEAR = { agent = "bear" }
TD3 = { agent = "td3" }

[full]
seeds = 6
"""

CLAIMS = """
[tuned]
bear = ["hopper-medium-v2"]

[[claims]]
id = "A"
says = "BEAR is better."
place = "1"
tests = [{ suite = "suite.toml", method = "BEAR", than = ["BC", "TD3"] }]

[[claims]]
id = "B"
says = "TD3 is no worse than BC by ten points."
place = "2"
tests = [{ suite = "suite.toml", method = "TD3", than = ["BC"], margin = -10.0, each = true }]

[[claims]]
id = "C"
says = "TD3's score is low."
place = "3"
tests = [{ suite = "suite.toml", method = "TD3", than = 20.0, less = true, on = ["walker2d-medium-v2"] }]

[[claims]]
id = "D"
says = "Nobody knows."
place = "4"
note = "Nothing decides it."
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "suite.toml").write_text(SUITE)
    (tmp_path / "claims.toml").write_text(CLAIMS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def kept(scores, full=False):
    """A store that has these scores: (method, log) -> one a seed."""
    suite = read("suite.toml", full)
    store = store_of([suite], suite.ledger.parent)
    for job in plan(suite):
        values = scores.get((job.method, job.on.partition("-")[0]))
        if values is not None:
            keep(store, job, values)
    return store


BC, TD3 = [40.0, 42.0, 41.0, 43.0], [12.0, 11.0, 13.0, 12.0]
BEAR = [60.0, 61.0, 65.0, 62.0]


def states(store, full=False):
    return {claim.id: verdict(claim, store, full).state for claim in claims("claims.toml")}


def test_claims_are_read_without_the_logs_that_decide_nothing(folder):
    a, b, c, d = claims("claims.toml")
    assert a.tests[0].on == ("walker2d-medium-v2",)
    assert b.tests[0].on == ("hopper-medium-v2", "walker2d-medium-v2")
    assert (c.tests[0].than, c.tests[0].less) == (20.0, True)
    assert (d.tests, d.note) == ((), "Nothing decides it.")


def test_they_are_open_until_all_cells_are_there(folder):
    assert states(kept({})) == {"A": "open", "B": "open", "C": "open", "D": "open"}
    store = kept({("BEAR", "walker2d"): BEAR, ("BC", "walker2d"): BC})
    assert states(store)["A"] == "open"
    a = verdict(claims("claims.toml")[0], store)
    assert (a.cells, a.missing) == (12, 4)  # BEAR's cells count once, though both comparisons need them
    assert math.isnan(a.comparisons[1].gain.value)


def test_a_score_that_is_not_finite_is_there_and_decides_nothing(folder):
    store = kept({("BEAR", "walker2d"): [math.nan, *BEAR[1:]], ("BC", "walker2d"): BC})
    beside, missing = verdict(claims("claims.toml")[0], store).comparisons
    assert (beside.state, len(beside.missing), len(beside.undefined)) == ("open", 0, 1)
    assert (len(missing.missing), len(missing.undefined)) == (4, 1)


def test_they_hold_and_are_contradicted_by_the_interval_of_the_gain(folder):
    every = {("BC", "walker2d"): BC, ("TD3", "walker2d"): TD3, ("BEAR", "walker2d"): BEAR, ("BC", "hopper"): BC}
    store = kept(every | {("TD3", "hopper"): [41.0, 40.0, 43.0, 44.0], ("BEAR", "hopper"): [0.0] * 4})
    assert states(store) == {"A": "holds", "B": "contradicted", "C": "holds", "D": "open"}
    (bc, td3) = verdict(claims("claims.toml")[0], store).comparisons
    expected = paired({"w": np.array(BEAR)}, {"w": np.array(BC)})
    assert (bc.gain.value, bc.gain.low, bc.gain.high) == (expected.value, expected.low, expected.high)
    assert td3.gain.value == pytest.approx(50.0)
    hopper, walker = verdict(claims("claims.toml")[1], store).comparisons
    assert (hopper.on, hopper.state) == (("hopper-medium-v2",), "holds")
    assert (walker.state, walker.gain.value) == ("contradicted", pytest.approx(-29.5))
    low = verdict(claims("claims.toml")[2], store).comparisons[0]
    assert (low.gain.value, len(low.cells)) == (pytest.approx(8.0), 4)
    # One size says nothing of the other.
    assert set(states(store, full=True).values()) == {"open"}


def test_collections_of_a_log_that_differ_are_told(folder):
    store = kept({("BEAR", "walker2d"): BEAR, ("TD3", "walker2d"): TD3})
    suite = read("suite.toml")
    [job] = [job for job in plan(suite) if (job.method, job.on) == ("BC", "walker2d-medium-v2")]
    for log, told in (("second", ("walker2d-medium-v2",)), ("first", ())):
        with_logs = Store(folder / log)
        for row in store.of(plan(suite)).to_pylist():
            row_job = next(each for each in plan(suite) if row["cell"] in each.cells)
            with_logs.keep(replace(row_job, seeds=(row["seed"],)), JobResult([row | {"log": "first"}], []))
        rows = [{"seed": i, "score": x, "raw": 0.0, "steps": 1, "seconds": 1.0, "failure": "", "versions": "{}", "log": log}
                for i, x in enumerate(BC)]  # fmt: skip
        with_logs.keep(job, JobResult(rows, []))
        assert [each.collections for each in verdict(claims("claims.toml")[0], with_logs).comparisons] == [told, ()]


def test_a_gain_that_chance_may_have_made_decides_nothing(folder):
    store = kept({("BC", "walker2d"): BC, ("BEAR", "walker2d"): [70.0, 30.0, 60.0, 20.0], ("TD3", "walker2d"): TD3})
    assert states(store)["A"] == "open"


def test_of_many_comparisons_each_contradicts_at_a_level_of_its_own(folder):
    # The interval at 95 % ends below zero, that at 97.5 % does not.
    close = [float(b - g) for b, g in zip(BC, (3.0, 0.4, 2.6, 2.0))]
    store = kept({("BC", "walker2d"): BC, ("BEAR", "walker2d"): close, ("TD3", "walker2d"): TD3})
    bc, _ = verdict(claims("claims.toml")[0], store).comparisons
    assert bc.gain.high < 0.0 < bc.strict.high
    assert states(store)["A"] == "open"


def test_equal_gains_of_all_seeds_decide_nothing(folder):
    """Three goals of three: too few runs to see any doubt, and not a proof."""
    store = kept({("TD3", "walker2d"): [10.0] * 4})
    [low] = verdict(claims("claims.toml")[2], store).comparisons
    assert (low.gain.value, low.missing, low.state) == (10.0, frozenset(), "open")


@pytest.mark.parametrize(("last", "constant", "state"), [(40.5, (), "holds"), (40.0, ("hopper-medium-v2",), "open")])
def test_a_log_on_which_all_seeds_differ_by_the_same_decides_nothing(folder, last, constant, state):
    """Of one log of two: how its seeds vary is not known, so the interval that the other alone makes is too narrow."""
    (folder / "claims.toml").write_text(CLAIMS.replace(", each = true", "").replace("margin = -10.0", "margin = -40.0"))
    known = {("BC", "walker2d"): BC, ("TD3", "walker2d"): TD3, ("BC", "hopper"): [40.0] * 4}
    [one] = verdict(claims("claims.toml")[1], kept(known | {("TD3", "hopper"): [40.0] * 3 + [last]})).comparisons
    assert one.gain.low > -40.0
    assert (one.constant, one.state) == (constant, state)


@pytest.mark.parametrize(("margin", "state"), [(-40.0, "open"), (-90.0, "holds")])
def test_within_a_range_such_a_log_widens_the_interval(folder, margin, state):
    """Differences of 0 four times of four: each other one may have a probability of 1 - 0.025 ** (1 / 4) = 0.60."""
    text = CLAIMS.replace(", each = true", ", range = [0, 100]").replace("margin = -10.0", f"margin = {margin}")
    (folder / "claims.toml").write_text(text)
    known = {("BC", "walker2d"): BC, ("TD3", "walker2d"): TD3, ("BC", "hopper"): [40.0] * 4, ("TD3", "hopper"): [40.0] * 4}
    [one] = verdict(claims("claims.toml")[1], kept(known)).comparisons
    gaps = [np.array(TD3) - BC, np.zeros(4)]
    assert (one.constant, one.state) == (("hopper-medium-v2",), state)
    assert one.gain.low == pytest.approx(paired(gaps, [np.zeros(4)] * 2, 0.975).low - (1 - 0.025**0.25) * 100 / 2)


@pytest.mark.parametrize(
    ("bear", "said"),
    [
        ((), "open: 8 of 12 scores"),
        (BEAR, "holds"),
        (BC, "open: all scores are there, and do not decide"),
        ([math.nan, *BEAR[1:]], "open: all scores are there, 1 of them not finite"),
    ],
)
def test_a_verdict_says_why_it_is_open(folder, bear, said):
    a, _, _, d = claims("claims.toml")
    store = kept({("BC", "walker2d"): BC, ("TD3", "walker2d"): TD3, ("BEAR", "walker2d"): bear})
    assert (str(verdict(a, store)), str(verdict(d, store))) == (said, "open: it has no tests")


def test_a_result_beyond_the_range_is_told_with_its_suite(folder):
    (folder / "claims.toml").write_text(CLAIMS.replace("than = 20.0", "than = 20.0, range = [0, 25]"))
    with pytest.raises(UserError, match=r"suite.toml: a result has the score 30, beyond the range \[0, 25\]"):
        verdict(claims("claims.toml")[2], kept({("TD3", "walker2d"): [10.0, 12.0, 30.0, 11.0]}))


def test_a_metric_that_no_result_has_is_refused(folder):
    text = CLAIMS.replace("than = 20.0", 'metric = "scores", than = 20.0')
    (folder / "claims.toml").write_text(text)
    claim = claims("claims.toml")[2]
    assert verdict(claim, kept({})).state == "open"
    with pytest.raises(UserError, match="suite.toml: unknown metric 'scores': did you mean score"):
        verdict(claim, kept({("TD3", "walker2d"): TD3}))


def test_the_average_score_is_the_mean_of_a_runs_curve_once_it_has_learned(folder):
    """And not of the score before that; the last evaluation, which comes as the run ends, counts as long as its interval."""
    (folder / "claims.toml").write_text(CLAIMS.replace("than = 20.0", 'metric = "average score", than = 20.0'))
    claim, store = claims("claims.toml")[2], kept({})
    curves = [[0.0, 10.0, 14.0, 22.0], [0.0, 11.0, 11.0, 21.0], [0.0, 13.0, 13.0, 23.0], [0.0, 10.0, 14.0, 22.0]]
    job = next(each for each in plan(read("suite.toml")) if (each.method, each.on) == ("TD3", "walker2d-medium-v2"))
    points = [
        {"cell": cell, "step": step, "score": score, "raw": 0.0, "spread": 0.0}
        for cell, curve in zip(job.cells, curves) for step, score in zip((0, 45, 90, 100), curve)
    ]  # fmt: skip
    keep(store, job, [99.0] * 4, curves=points)
    found = verdict(claim, store)
    assert (found.state, found.comparisons[0].gain.value) == ("holds", pytest.approx(20.0 - (0.9 * 12.0 + 0.1 * 22.0)))


def test_runs_that_diverged_are_counted_and_keep_their_last_score(folder):
    (folder / "claims.toml").write_text(CLAIMS.replace("than = 20.0", 'metric = "average score", than = 20.0'))
    claim, store = claims("claims.toml")[2], kept({})
    job = next(each for each in plan(read("suite.toml")) if (each.method, each.on) == ("TD3", "walker2d-medium-v2"))
    points = [
        {"cell": cell, "step": step, "score": score, "raw": 0.0, "spread": 0.0}
        for cell, own in zip(job.cells, (10.0, 11.0, 13.0, 10.0)) for step, score in ((0, 0.0), (20, 1.0), (40, own))
    ]  # fmt: skip
    keep(store, job, [99.0] * 4, curves=points, failure="q was not finite at update 45")
    [found] = verdict(claim, store).comparisons
    assert found.gain.value == pytest.approx(20.0 - (0.2 * 1.0 + 0.8 * 11.0))
    assert len(found.diverged) == 4
    assert "the last good policies of 4 runs that diverged" in _effect(found)


def diverged(folder, suite, curve):
    """The job of an online suite of SAC, whose seeds all have this curve and then diverged, and by how much their average score
    is below 20."""
    common = 'kind = "online"\nledger = "ledger"\nseeds = 2\nsteps = 500\nepisodes = 2\nevaluations = 2\ntasks = ["hopper"]\n'
    (folder / "suite.toml").write_text(common + suite)
    (folder / "claims.toml").write_text(
        '[[claims]]\nid = "A"\nsays = "SAC scores low."\nplace = "1"\n'
        'tests = [{ suite = "suite.toml", method = "SAC", metric = "average score", than = 20.0, less = true }]\n'
    )
    [job] = plan(read("suite.toml"))
    store = Store(folder / "ledger")
    points = [
        {"cell": cell, "step": step, "score": score, "raw": 0.0, "spread": 0.0} for cell in job.cells for step, score in curve
    ]
    keep(store, job, [99.0] * 2, curves=points, failure="q was not finite afterwards")
    [found] = verdict(claims("claims.toml")[0], store).comparisons
    return job, found.gain.value


def test_an_online_run_that_diverged_keeps_its_last_score_for_all_of_its_updates(folder):
    """Curves are by updates, of which an online run has another number than steps in the environment."""
    suite = "[methods]\nSAC = { agent = 'sac', acting = { copies = 5, explore = 100, block = 25, updates_per_step = 2 } }\n"
    job, gain = diverged(folder, suite, ((0, 0.0), (400, 2.0), (600, 10.0)))
    assert updates(job) == 800
    assert gain == pytest.approx(20.0 - (400 * 2.0 + 400 * 10.0) / 800)


def test_the_curve_of_a_run_that_goes_on_from_a_log_ends_without_the_updates_on_it(folder):
    """Its curve counts from 0 again when it begins to act."""
    method = "SAC = { agent = 'sac', log = 'first', acting = { copies = 5, block = 25, updates_per_step = 1 } }\n"
    suite = f"offline = 2000\ndata = {{ hopper = 'hopper-medium-v2' }}\n[methods]\n{method}"
    job, gain = diverged(folder, suite, ((0, 0.0), (250, 2.0), (400, 10.0)))
    assert (curve_end(job), updates(job)) == (500, 2500)
    assert gain == pytest.approx(20.0 - (250 * 2.0 + 250 * 10.0) / 500)


def test_the_full_size_of_a_claim_is_that_of_the_suites_that_have_one(folder):
    (folder / "other.toml").write_text(SUITE.partition("[full]")[0])
    both = 'tests = [{ suite = "other.toml", method = "TD3", than = 20.0 }, { suite'
    (folder / "claims.toml").write_text(CLAIMS.replace("tests = [{ suite", both))
    assert [len(one.cells) for one in verdict(claims("claims.toml")[2], kept({}), full=True).comparisons] == [8, 6]


BESIDE = """[[claims]]
id = "E"
says = "The first suite is easier."
place = "8.5"
tests = [{ suite = "suite.toml", method = ["BC", "TD3"], beside = "other.toml" }]
"""


@pytest.mark.parametrize("less", [False, True])
def test_the_same_methods_are_compared_on_the_tasks_of_another_suite(folder, less):
    """By hand: of both methods means over seeds and the logs of a task; then Welch's t over the tasks of either side."""
    logs = "ant-medium-v2", "halfcheetah-medium-v2", "ant-expert-v2"
    listed = f"logs = [{', '.join(repr(log) for log in logs)}]"
    own = 'logs = ["hopper-medium-v2", "walker2d-medium-v2"]'
    (folder / "other.toml").write_text(SUITE.replace(own, listed))
    (folder / "claims.toml").write_text(BESIDE.replace(" }]", ", less = true }]") if less else BESIDE)
    [claim] = claims("claims.toml")
    assert claim.tests[0].method == ("BC", "TD3")
    suites = read("suite.toml"), read("other.toml")
    store = store_of(suites, folder)
    scores = {
        ("BC", "hopper-medium-v2"): [50.0, 54.0, 50.0, 54.0], ("TD3", "hopper-medium-v2"): [40.0] * 4,
        ("BC", "walker2d-medium-v2"): [60.0] * 4, ("TD3", "walker2d-medium-v2"): [44.0, 48.0, 44.0, 48.0],
        ("BC", logs[0]): [10.0] * 4, ("TD3", logs[0]): [20.0] * 4, ("BC", logs[1]): [30.0] * 4, ("TD3", logs[1]): [32.0] * 4,
        ("BC", logs[2]): [18.0] * 4, ("TD3", logs[2]): [20.0] * 4,
    }  # fmt: skip
    for job in (job for suite in suites for job in plan(suite)):
        values = scores.get((job.method, job.on))
        if values is not None:
            keep(store, job, values)
    [one] = verdict(claim, store).comparisons
    expected = scipy.stats.ttest_ind([46.0, 53.0], [(15.0 + 19.0) / 2, 31.0], equal_var=False)
    limits = expected.confidence_interval(0.95)
    assert (len(one.cells), len(one.missing), one.rival) == (40, 0, None)
    found = one.gain.value, one.gain.low, one.gain.high
    wanted = (-25.5, -limits.high, -limits.low) if less else (25.5, limits.low, limits.high)
    assert found == pytest.approx(wanted)


@pytest.mark.parametrize(("changed", "words"), [
    (('BC = { agent = "bc" }', 'BC = { agent = "awr" }'), "BC is not the same in suite.toml as in other.toml"),
    (("evaluations = 1", "evaluations = 2"), "evaluations is not the same in suite.toml as in other.toml"),
    (("steps = 100", "steps = 200"), "steps is not the same in suite.toml as in other.toml"),
    (("[full]\n", "[full]\nsteps = 300\n"), "steps is not the same in suite.toml as in other.toml"),
    (("[full]\nseeds = 6\n", ""), "the section .full. is not the same in suite.toml as in other.toml"),
])  # fmt: skip
def test_what_is_compared_across_suites_is_the_same_method_by_the_same_protocol(folder, changed, words):
    own = 'logs = ["hopper-medium-v2", "walker2d-medium-v2"]'
    other = SUITE.replace(own, 'logs = ["ant-medium-v2"]')
    assert changed[0] in other
    (folder / "other.toml").write_text(other.replace(*changed))
    (folder / "claims.toml").write_text(BESIDE)
    with pytest.raises(UserError, match=words):
        claims("claims.toml")


def test_what_is_compared_across_suites_has_logs_of_its_own(folder):
    (folder / "other.toml").write_text(SUITE)
    (folder / "claims.toml").write_text(BESIDE)
    with pytest.raises(UserError, match="hopper-medium-v2 is in suite.toml and in other.toml, which must have"):
        claims("claims.toml")
    (folder / "claims.toml").write_text(BESIDE.replace('["BC", "TD3"]', '["BC", "BC"]'))
    with pytest.raises(UserError, match="method must be a method, or different ones, got"):
        claims("claims.toml")
    tuned = '[tuned]\ntd3 = ["hopper-medium-v2", "walker2d-medium-v2"]\n\n'
    (folder / "claims.toml").write_text(tuned + BESIDE)
    with pytest.raises(UserError, match="all its logs are ones on which an agent was tuned"):
        claims("claims.toml")


AMONG = """
[[claims]]
id = "F"
says = "The log makes a difference."
place = "8.5"
tests = [{ suite = "suite.toml", method = ["BC", "TD3"], among = true }]
"""


@pytest.mark.parametrize(("gap", "state"), [(8.0, "holds"), (0.0, "open")])
def test_logs_of_a_task_are_compared_with_each_other(folder, gap, state):
    """By the F test of the methods' mean; a task with one log does not count."""
    logs = "hopper-medium-v2", "hopper-expert-v2", "walker2d-medium-v2"
    (folder / "suite.toml").write_text(SUITE.replace('"hopper-medium-v2", ', '"hopper-medium-v2", "hopper-expert-v2", '))
    (folder / "claims.toml").write_text(AMONG)
    [claim], suite = claims("claims.toml"), read("suite.toml")
    assert suite.on == logs
    store, noise = store_of([suite], folder), np.array([0.5, -1.0, 1.5, -1.0])
    runs = {logs[0]: 40 + noise, logs[1]: 40 + gap + noise[::-1], logs[2]: np.full(4, 90.0)}
    for job in plan(suite):
        shift = {"BC": 3.0, "TD3": -3.0}.get(job.method, 0.0)
        keep(store, job, runs[job.on] + shift)
    [one] = verdict(claim, store).comparisons
    f = scipy.stats.f_oneway(runs[logs[0]], runs[logs[1]]).statistic
    limits = [(f / scipy.stats.f.ppf(p, 1, 6) - 1) / 4 for p in (0.975, 0.025)]
    assert (len(one.cells), one.state) == (24, state)
    assert (one.gain.value, one.gain.low, one.gain.high) == pytest.approx(((f - 1) / 4, *limits))
    (folder / "suite.toml").write_text(SUITE)
    # No variance is below 0: such an interval is due to seeds that vary unequally, and contradicts nothing.
    below = replace(one, gain=Interval(-0.2, -0.24, -0.1), strict=Interval(-0.2, -0.24, -0.1))
    assert below.state == "open"
    with pytest.raises(UserError, match="no two of hopper-medium-v2, walker2d-medium-v2 share one"):
        claims("claims.toml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"BC", "TD3"', '"BCQ"', "claim A: unknown method of suite.toml 'BCQ'"),
        ('place = "1"\n', "", "claim A: place is missing"),
        ("margin = -10.0", "margins = 3", "claim B: unknown key 'margins'"),
        ('on = ["walker2d-medium-v2"]', 'on = ["ant"]', "claim C: unknown log, task, problem or case of suite.toml 'ant'"),
        ("than = 20.0", 'than = "BC"', "claim C: than must be a list of methods, or a number, got 'BC'"),
        ('on = ["walker2d-medium-v2"]', 'on = "walker2d-medium-v2"', "claim C: on must be a list of names, got 'walker2d-"),
        ("than = 20.0", 'than = 20.0, beside = "suite.toml"', "one of than, beside and among, got than and beside"),
        ("than = 20.0, ", "", "claim C: a test has one of than, beside and among, got none"),
        ("than = 20.0, less = true", "among = true, each = true", "claim C: with among, all logs are taken together"),
        ("than = 20.0, less = true", "among = true, less = true", "claim C: with among, neither more nor less is claimed"),
        ('"BC", "TD3"', "", "claim A: than must be methods other than BEAR, each once, or a number, got []"),
        ('"BC", "TD3"', '"BC", "BC"', "claim A: than must be methods other than BEAR, each once, or a number, got ['BC'"),
        ('"BC", "TD3"', '"BEAR"', "claim A: than must be methods other than BEAR, each once, or a number, got ['BEAR']"),
        ('on = ["walker2d-medium-v2"]', "on = []", "claim C: on must be different names, or be left out for all of the suite"),
        ("margin = -10.0", "margin = nan", "claim B: margin must be finite, got nan"),
        ("than = 20.0", "than = inf", "claim C: than must be finite, got inf"),
        ('suite = "suite.toml", method = "BEAR"', 'suite = "none.toml", method = "BEAR"', "claim A: no file none.toml"),
        ("than = 20.0", "than = 20.0, range = [0, inf]", "claim C: range must be two numbers, the lower one first"),
        ("than = 20.0", "than = 20.0, range = [1, 0]", "claim C: range must be two numbers, the lower one first, got [1, 0]"),
        ("than = 20.0", 'than = 20.0, range = [0, "1"]', "claim C: range must be two numbers, the lower one first, got [0"),
        ("than = 20.0", "than = 20.0, range = [0, 1]", "claim C: than must be within the range, got 20"),
        ("than = 20.0", "than = 20.0, range = [0, 99], log = true", "claim C: range is for tests with than and without log"),
        ("than = 20.0", "among = 1", "claim C: among must be true or false, got 1"),
        ("less = true", "less = 1", "claim C: less must be true or false, got 1"),
        ('id = "B"', 'id = "A"', "claims.toml: 2 claims have the id A; give each its own"),
        ("[[claims]]", "[[claim]]", "claims.toml: unknown key 'claim': did you mean claims?"),
        ("bear = [", "BEAR = [", "claims.toml, [tuned]: unknown agent 'BEAR'"),
        ('["hopper-medium-v2"]', '["hoper-medium-v2"]', "claims.toml, [tuned], bear: unknown log 'hoper-medium-v2'"),
        ('["hopper-medium-v2"]', '"hopper-medium-v2"', "claims.toml, [tuned]: bear must be a list of logs, got 'hopper-"),
        ("bear = [", 'td3 = ["walker2d-medium-v2"]\nbear = [', "claim A: all its logs are ones on which an agent was tuned"),
    ],
)
def test_wrong_claims_are_refused_in_one_line(folder, old, new, message):
    assert old in CLAIMS
    (folder / "claims.toml").write_text(CLAIMS.replace(old, new))
    with pytest.raises(UserError) as error:
        claims("claims.toml")
    assert message in str(error.value)


@pytest.mark.parametrize("key", ["suite", "beside"])
@pytest.mark.parametrize("name", ["../suite.toml", "{}/suite.toml"])
def test_suites_that_lie_elsewhere_are_not_read(folder, key, name):
    (folder / "inner").mkdir()
    (folder / "inner" / "own.toml").write_text(SUITE)
    test = {"suite": "own.toml", key: name.format(folder)}
    text = ", ".join(f'{each} = "{value}"' for each, value in test.items())
    rest = 'method = "BC"' + (', than = ["TD3"]' if key == "suite" else "")
    path = folder / "inner" / "claims.toml"
    path.write_text(f'[[claims]]\nid = "A"\nsays = "x"\nplace = "1"\ntests = [{{ {text}, {rest} }}]\n')
    with pytest.raises(UserError, match=r"claims\.toml, claim A: suite .*: part .*(lead to another folder|is empty)"):
        claims(path)
