"""Hypervolumes against closed forms and drawn points, and batches for several targets."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.mbo import front as fronts
from deadreckon.mbo.batch import keys
from deadreckon.mbo.calibration import OWN, Calibration
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.effects import permitted
from deadreckon.mbo.front import Gains, Scalarised, contenders, on_front, propose_front, targets_of
from deadreckon.mbo.hypervolume import hypervolume, improvement, non_dominated, reference_of
from deadreckon.mbo.nn_distance import distance_to_others
from deadreckon.mbo.process import fit
from deadreckon.mbo.validation import judged

ORIGIN = np.zeros(3)


def test_hypervolumes_have_their_closed_forms():
    assert hypervolume(np.array([[3.0], [2.0]]), np.array([1.0])) == 2.0
    stairs = np.array([[1.0, 3.0], [2.0, 2.0], [3.0, 1.0], [1.0, 1.0], [2.0, 2.0]])
    assert hypervolume(stairs, np.zeros(2)) == 6.0
    assert hypervolume(stairs, np.array([1.0, 1.0])) == 1.0  # two of them have nothing above the reference
    assert hypervolume(stairs, np.array([4.0, 0.0])) == 0.0
    # By inclusion and exclusion of two boxes, and of three that have a common corner.
    assert hypervolume(np.array([[2.0, 3, 4], [4.0, 3, 2]]), ORIGIN) == 24 + 24 - 12
    three = np.array([[2.0, 1, 1], [1.0, 2, 1], [1.0, 1, 2]])
    assert hypervolume(three, ORIGIN) == 4.0
    assert hypervolume(np.array([[1.0, 2, 3, 4], [2.0, 1, 3, 4]]), np.zeros(4)) == 24 + 24 - 12


@pytest.mark.parametrize("scores", [2, 3])
def test_hypervolumes_are_the_share_of_drawn_points(scores):
    rng = np.random.default_rng(scores)
    y = rng.uniform(0.2, 1, (12, scores))
    drawn = rng.uniform(0, 1, (40_000, scores))
    inside = (y[None] >= drawn[:, None]).all(2).any(1).mean()
    assert hypervolume(y, np.zeros(scores)) == pytest.approx(inside, abs=0.01)
    point, more = rng.uniform(0.5, 1, scores), hypervolume
    want = more(np.concatenate([y, point[None]]), np.zeros(scores)) - more(y, np.zeros(scores))
    assert improvement(point, y, np.zeros(scores)) == pytest.approx(want, abs=1e-12)


def test_what_no_row_dominates():
    y = np.array([[1.0, 3], [2, 2], [2, 2], [1, 2], [3, 0]])
    assert non_dominated(y).tolist() == [True, True, True, False, True]
    np.testing.assert_allclose(reference_of(y), [1 - 0.2, 0 - 0.3])
    counts = np.array([False, True, True, True, False])  # one point remains, so that the ranges are those of all rows
    np.testing.assert_allclose(reference_of(y, counts), [2 - 0.2, 2 - 0.3])
    many = np.random.default_rng(0).uniform(size=(600, 2))  # more than are compared at once
    alone = [not ((many >= row).all(1) & (many > row).any(1)).any() for row in many]
    assert non_dominated(many).tolist() == alone


@pytest.fixture(scope="module")
def two():
    """A gain and a cost that pull apart: true fronts lie where a + b = 1 is all but used up."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 1, (2, 40)).round(3)
    frame = {"a": a, "b": b, "gain": 1 - (a - 1) ** 2 - (b - 0.5) ** 2, "cost": a**2 + (b - 0.5) ** 2}
    read = lambda target, **more: Designs.from_frame(frame, target, constraints=["a + b <= 1.2"], **more)  # noqa: E731
    return targets_of(read, ["gain", "cost"], ["cost"])


@pytest.mark.slow
def test_rows_that_break_a_rule_are_on_no_front(two):
    a, b = two[0].x.T.astype(float)
    kept = np.flatnonzero(a + b <= 1.2)
    assert 0 < len(kept) < len(a)
    y = np.stack([each.y for each in two], 1)
    front = on_front(two)
    assert set(np.flatnonzero(front)) == set(kept[non_dominated(y[kept])])
    assert set(np.flatnonzero(non_dominated(y))) - set(kept)  # else nothing is seen here
    found = propose_front(two, 2)
    assert found.before == pytest.approx(hypervolume(y[kept], found.reference))
    assert found.best.tolist() == front.tolist()


@pytest.mark.slow
def test_a_batch_moves_the_front(two):
    front = propose_front(two, 6)
    x = front.made[0].x
    assert len(set(keys(two[0], x))) == 6
    assert two[0].repair.good(x).all()
    true = np.stack([1 - (x[:, 0] - 1) ** 2 - (x[:, 1] - 0.5) ** 2, -(x[:, 0] ** 2) - (x[:, 1] - 0.5) ** 2], 1)
    kept = front.observed[permitted(two[0])]
    gained = hypervolume(np.concatenate([kept, true]), front.reference) - front.before
    assert gained > 0
    assert gained == pytest.approx(front.gain, rel=0.35)
    assert np.ptp(x[:, 0]) > 0.4  # all along the front, not at one of its places
    np.testing.assert_allclose(front.shown(front.predicted)[:, 1], -front.predicted[:, 1])
    assert all(made.quality.rank_correlation > 0.9 for made in front.made)
    rows, worth = np.flatnonzero(permitted(two[0])), [made.quality.calibration for made in front.made]
    again = Gains([fit(each) for each in two], front.made[0].x, two[0].x[rows], front.reference, 0, worth).total()
    assert front.gain == pytest.approx(again)


def test_the_batch_is_chosen_given_those_before(two):
    processes = [fit(each) for each in two]
    x = np.concatenate([two[0].x[:4], two[0].x[:4] + 1e-4])
    y = np.stack([each.y for each in two], 1)
    gains = Gains(processes, x, two[0].x[:0], reference_of(y) - 1, 0)
    worth = Calibration(1.0, 0.5, 6.0 * OWN**0.5, 2.0)  # of what is promised only what came true
    promised = Gains(processes, x, two[0].x[:0], reference_of(y) - 1, 0, [worth] * len(processes)).y
    mean = np.stack([process.mean(x) for process in processes], -1)
    np.testing.assert_allclose(promised, 1.0 + 0.5 * mean + 6.0 * (gains.y - mean))
    order = gains.greedy(8, np.zeros(8))
    assert sorted(order.tolist()) == list(range(8))
    assert order[0] % 4 != order[1] % 4  # the twin of the first adds nothing
    assert gains.total() == pytest.approx(hypervolume(y[:4], reference_of(y) - 1), rel=0.05)


def test_where_none_adds_anything_predictions_choose(two):
    processes = [fit(each) for each in two]
    x, value = two[0].x[:6], np.array([3.0, 1.0, 5.0, 0.0, 4.0, 2.0])
    gains = Gains(processes, x, two[0].x[:0], np.full(2, 1e3), 0)
    assert gains.greedy(6, value).tolist() == [2, 4, 0, 5, 1, 3]
    assert gains.greedy(6, value, x, 1e3).tolist() == [2]  # all others lie too near


def with_skill(front):
    """The same front, of which all models are said to predict unseen rows well."""
    y = np.arange(20.0)
    quality = judged(y, y, np.ones(20), np.arange(20) % 5, "GP")
    return dataclasses.replace(front, made=tuple(dataclasses.replace(made, quality=quality) for made in front.made))


def test_rows_that_break_a_rule_are_no_measure_of_what_is_gained(monkeypatch):
    """Those that are forbidden are far better than what may be proposed; where all are, or nothing counts, it is told."""
    for name in ("ROUNDS", "WEIGHTS"):
        monkeypatch.setattr(fronts, name, 2)
    a, banned = np.linspace(0.1, 1, 10).round(1), np.arange(10) % 2
    frame = {"a": a, "s": [["oil", "water"][i] for i in banned], "gain": a + 9 * banned, "pure": a * a + 9 * banned}
    read = lambda target, **more: Designs.from_frame(frame, target, bounds={"a": (0, 2)}, **more)  # noqa: E731
    two = targets_of(read, ["gain", "pure"], [], forbidden=["s = water"])
    made = propose_front(two, 4)
    assert made.unskilled == ["gain", "pure"]  # ten rows are too few for a test
    made = with_skill(made)
    assert made.notes == []
    assert (made.reference < 1.0).all()
    assert made.before == pytest.approx(hypervolume(made.observed[permitted(two[0])], made.reference))
    assert made.before > 0
    assert made.gain > 0
    far = with_skill(propose_front(two, 4, reference=[1e3, 1e3]))
    assert [line[:24] for line in far.notes] == ["no eligible row lies abo", "no proposal is expected "]
    assert far.made[0].x[:, 0].min() > 1.0  # and not those of the least a
    none = targets_of(read, ["gain", "pure"], [], forbidden=["a < 1.5"])
    assert dataclasses.replace(made, data=tuple(none)).notes[0].startswith("no row of the data satisfies the rules")


def test_rows_beside_the_measured_front_count_in_what_is_gained(monkeypatch):
    """Where noise is large others are truly as good; beside the rows that were measured best a batch is praised too much."""
    for name in ("ROUNDS", "WEIGHTS"):
        monkeypatch.setattr(fronts, name, 2)
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0, 1, (2, 40)).round(3)
    frame = {"a": a, "b": b, "gain": a + 0.25 * rng.standard_normal(40), "cost": a * a + b + 0.25 * rng.standard_normal(40)}
    noisy = targets_of(lambda target, **more: Designs.from_frame(frame, target, **more), ["gain", "cost"], ["cost"])
    found = propose_front(noisy, 4)
    processes, worth = [fit(each) for each in noisy], [made.quality.calibration for made in found.made]
    gain = lambda rows: Gains(processes, found.made[0].x, noisy[0].x[rows], found.reference, 0, worth).total()  # noqa: E731
    assert found.gain == pytest.approx(gain(permitted(noisy[0])))
    assert gain(on_front(noisy)) > 1.2 * found.gain
    low = [f"{name} {made.quality.r2:.2f}" for name, made in zip(("gain", "cost"), found.made)]
    assert found.notes == [f"the expected gain is too high where noise is large (R2 out of fold: {', '.join(low)})"]


def test_of_many_rows_those_count_that_the_fewest_dominate(two, monkeypatch):
    means = [SimpleNamespace(mean=lambda x: x[:, 0]), SimpleNamespace(mean=lambda x: x[:, 1])]
    a, b = two[0].x.T
    may = np.flatnonzero(permitted(two[0]))
    assert len(may) < len(a)
    np.testing.assert_array_equal(contenders(two[0], means), may)
    monkeypatch.setattr(fronts, "MOST", 7)
    beaten = [((a[may] >= a[i]) & (b[may] >= b[i]) & ((a[may] > a[i]) | (b[may] > b[i]))).sum() for i in may]
    np.testing.assert_array_equal(contenders(two[0], means), may[np.argsort(beaten, kind="stable")[:7]])


@pytest.mark.slow
def test_a_spread_batch_is_chosen_for_the_front_too(two):
    near = propose_front(two, 8)
    spread = tuple(dataclasses.replace(each, rules=dataclasses.replace(each.rules, apart=1.0)) for each in two)
    made = propose_front(spread, 8)
    assert distance_to_others(two[0], near.made[0].x).min() < 1.0 <= distance_to_others(two[0], made.made[0].x).min()
    assert made.gain > 0.96 * near.gain  # 1.00; 0.92 where the choice does not know the distance


def test_the_slope_of_a_scalarisation_is_that_of_its_value(two):
    processes = tuple(fit(each) for each in two)
    made = Scalarised(processes, np.array([2.0, 5.0]), np.array([0.1, -1.0]), np.array([0.7, 0.4]))
    x, away = two[0].x[:6].astype(np.float64), np.array([1e-3, 0.0])
    change = (made.mean(x + away) - made.mean(x - away)) / 2e-3 * two[0].coordinates.std[0]
    np.testing.assert_allclose(made.slope(x, 0.0)[:, 0], change, rtol=1e-2, atol=1e-3)


def test_what_is_no_front(two):
    read = lambda target, **more: target  # noqa: E731
    for targets, small, said in ((["a"], [], "two different targets or more, got a"), (["a", "b"], ["c"], "c is to be made")):
        with pytest.raises(UserError, match=said):
            targets_of(read, targets, small)
    with pytest.raises(UserError, match="needs 2 numbers, one for each target, got 1"):
        propose_front(two, 2, reference=[0.0])
    with pytest.raises(UserError, match="the reference point needs finite numbers, got nan, 1$"):
        propose_front(two, 2, reference=[float("nan"), 1.0])
    with pytest.raises(UserError, match="seeds must be 0"):
        propose_front(two, 2, seed=-1)
    with pytest.raises(UserError, match="a front needs two targets or more, got 1"):
        propose_front(two[:1], 2)


@pytest.mark.slow
def test_a_front_from_the_command_line(tmp_path, monkeypatch, capsys):
    import csv

    from deadreckon.cli.main import main

    calamine = pytest.importorskip("python_calamine")
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    rows = [(a, b, a + b, a * a - b) for a, b in rng.uniform(0, 1, (16, 2)).round(2)]
    with open("t.csv", "w", newline="") as file:
        csv.writer(file).writerows([["a", "b", "gain", "cost"], *rows])
    asked = ["design", "t.csv", "--targets", "gain", "cost", "--minimise", "cost", "-n", "3", "--out", "f"]
    assert main([*asked, "--reference", "gain", "0", "cost", "2"]) == 0
    out = capsys.readouterr().out
    assert "greatest gain, least cost" in out
    assert "from the reference point gain 0, cost 2; the 3 proposals are expected to add" in out
    with open("f/proposals.csv", newline="") as file:
        found = list(csv.DictReader(file))
    kinds = ("predicted", "predicted_std", "predicted_low", "predicted_high", "mean_std")
    ends = [f"{what}_{target}" for target in ("gain", "cost") for what in kinds]
    near = ["nearest_row", "nearest_score_gain", "nearest_score_cost"]
    assert list(found[0]) == ["a", "b", *ends, "distance", *near]
    row = rows[int(found[0]["nearest_row"])]
    assert [float(found[0][name]) for name in near[1:]] == pytest.approx(row[2:], rel=1e-11)
    assert float(found[0]["predicted_low_cost"]) < float(found[0]["predicted_cost"]) < float(found[0]["predicted_high_cost"])
    assert float(found[0]["predicted_gain"]) == pytest.approx(float(found[0]["a"]) + float(found[0]["b"]), abs=0.3)
    sheets = calamine.CalamineWorkbook.from_path("f/proposals.xlsx")
    head, *cells = sheets.get_sheet_by_name("proposals").to_python()
    assert head == list(found[0])
    np.testing.assert_allclose(cells, [[float(value) for value in row.values()] for row in found], rtol=1e-6)
    assert ["target cost", "to be made small"] in sheets.get_sheet_by_name("about").to_python()
    page = (tmp_path / "f" / "report.html").read_text()
    for said in ("Front of the data", "to be made small", "measured from gain 0, cost 2", "for a new measurement of cost"):
        assert said in page
    for more, said in (
        (["--target", "gain"], "--target does not go with --targets"),
        (["--method", "ram"], "leave out --method ram"),
        (["--path", "t.csv"], "--path does not go with --targets"),
        (["--budget", "full"], "--budget does not go with --targets"),
        (["--method", "gp", "--method.rounds", "5"], "leave --method.* out"),
        (["--reference", "gain", "0"], "--reference needs a number for each of gain, cost"),
    ):
        assert main([*asked, *more]) == 2
        assert said in capsys.readouterr().err
