"""Batches: rules hold exactly in what is written, nothing is proposed twice, and what cannot be is refused in one line."""

import dataclasses
from decimal import Decimal
from itertools import pairwise

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.mbo import designer
from deadreckon.mbo.baselines import BestOfData
from deadreckon.mbo.batch import batch, check_batch, keys, moved, pulled, repaired, repeats_told
from deadreckon.mbo.designer import DesignInput
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.forward import Forward
from deadreckon.mbo.gp import GP
from deadreckon.mbo.nn_distance import distance_to_tried, nn_distance, usual_distance
from deadreckon.mbo.process import fit
from deadreckon.mbo.ram import RaM
from deadreckon.mbo.replicates import birge_ratio
from deadreckon.progress import unwatched
from tests.mbo.practice import SIZES, TABLES


def rows_of(data, x, tmp_path):
    """Proposals as dictionaries of the texts that the CSV holds."""
    import csv

    with open(data.write(tmp_path / "p.csv", x), newline="") as file:
        return list(csv.DictReader(file))


# What the rules of each table say, in words of their own: none of the package's checks is asked.
HELD = {
    "mixed": lambda row: Decimal(row["heat"]) % 5 == 0 and row["layers"] in "12345678",
    "mixture": lambda row: sum(Decimal(row[part]) for part in "ABCD") == 1 and all(Decimal(row[part]) >= 0 for part in "ABCD"),
    "replicated": lambda row: all(0 <= Decimal(row[name]) <= 10 for name in "abc"),
    "constrained": lambda row: (
        Decimal(row["a"]) + Decimal(row["b"]) <= Decimal("0.8")
        and 2 * Decimal(row["c"]) - Decimal(row["a"]) >= Decimal("0.3")
        and not (row["solvent"] == "water" and Decimal(row["a"]) > Decimal("0.4"))
    ),
    "wide": lambda row: all(-1 <= Decimal(value) <= 1 for value in row.values()),
    "ordinal": lambda row: (
        row["size"] in SIZES and row["dose"] in ("10", "20", "50", "100") and Decimal(row["temp"]) == 60
        and Decimal(row["dose"]) + 20 * Decimal(row["time"]) <= 130
    ),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*are pooled")
@pytest.mark.parametrize("name", TABLES)
def test_rules_hold_exactly_and_no_proposal_is_there_twice(name, tmp_path):
    for seed in range(3):
        data = TABLES[name](seed=seed).designs()
        made = designer("random").propose(data, 24, seed=seed)
        rows = rows_of(data, made.x, tmp_path)
        assert len(rows) == 24
        assert all(HELD[name](row) for row in rows)
        assert len({tuple(row.values()) for row in rows}) == 24
        assert not set(keys(data, made.x)) & set(keys(data, data.x))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mixture", "constrained", "ordinal"])
def test_methods_that_know_no_rules_keep_them_too(name, tmp_path):
    """A network is climbed without them; what it proposes is moved to where they hold."""
    data = TABLES[name]().designs()
    made = designer("forward", hidden=(8,), steps=50, ascent_steps=20, design_lr=0.2).propose(data, 16)
    rows = rows_of(data, made.x, tmp_path)
    assert all(HELD[name](row) for row in rows)
    assert len({tuple(row.values()) for row in rows}) == 16
    assert np.isfinite(made.predicted).all()


def test_duplicates_are_replaced_and_the_first_stays():
    data = TABLES["wide"]().designs()
    twice = np.repeat(data.x[:2] * 0.8, 4, axis=0)
    found = batch(data, twice, 6, lambda x: x[:, 0])
    np.testing.assert_allclose(found[:2], data.x[:2] * 0.8)
    assert len(set(keys(data, found))) == 6
    # Those that fill it were made around these, by their value.
    assert (found[2:, 0] > np.median(data.x[:, 0])).all()


def test_a_method_that_predicts_an_order_alone_fills_its_batch_by_it():
    data = TABLES["wide"]().designs()
    z = np.repeat(data.coordinates.encode(data.x[:1] * 0.9), 6, axis=0)
    setting = DesignInput(data, 6, [0], None, unwatched, distinct=True)
    made = RaM().decoded(setting, 0, z, climbed=lambda z: z[:, 0])
    np.testing.assert_allclose(made.x[0], data.x[0] * 0.9, rtol=1e-5)
    assert (made.x[1:, 0] > np.quantile(data.x[:, 0], 0.9)).all()
    assert np.isnan(made.predicted).all()


def test_methods_that_take_all_rows_for_equally_exact_say_so(monkeypatch, recwarn):
    columns = TABLES["wide"](variables=4).columns
    columns["se"] = list(np.linspace(0.1, 1.0, len(columns["y"])))
    for method in (Forward, GP, BestOfData):
        monkeypatch.setattr(method, "solve", lambda method, setting: [])
    read = lambda **more: Designs.from_frame(columns, "y", **more)  # noqa: E731
    data, plain = read(std_error="se"), read(ignore=["se"])
    alike = dataclasses.replace(data, std_error=np.ones(len(data)))
    lines = {}
    for name, given in (("forward", data), ("gp", data), ("best", data), ("ensemble", plain), ("ensemble-min", alike)):
        recwarn.clear()
        designer(name).propose_many(given, 2, seeds=[0])
        lines[name] = [str(each.message) for each in recwarn]
    assert lines.pop("forward") == [
        "frame: Forward treats all rows as equally exact in its fit, regardless of their standard errors and replicates; the "
        "Gaussian process does not (--method gp)"
    ]
    assert not any(lines.values())


def test_designs_of_the_data_are_proposed_only_where_asked():
    data = TABLES["wide"]().designs()
    found = batch(data, data.x[:5], 5)
    assert not set(keys(data, found)) & set(keys(data, data.x))
    np.testing.assert_array_equal(batch(data, data.x[:5], 5, repeat=True), data.x[:5])
    with pytest.raises(UserError, match="a proposal is there twice, or is in the data"):
        check_batch(data, data.x[:5], repeat=False)


def test_near_repeats_of_the_table_are_proposed_only_where_asked_or_where_there_are_no_others():
    """On a grid of whole numbers neighbours lie one typical distance apart."""
    cells = [(float(a), float(b)) for a in range(9) for b in range(9)]
    frame = {"a": [a for a, _ in cells], "b": [b for _, b in cells], "y": [*range(79), None, None]}  # two planned runs
    read = lambda **more: Designs.from_frame(frame, "y", kinds=dict.fromkeys("ab", "continuous"), **more)  # noqa: E731
    with pytest.warns(UserWarning, match="2 rows without y left out"):
        data, fine = read(), read(apart=1e-4)
    x = np.array([[0.0, 4.0015], [8.0, 7.9], [4.0, 4.2], [0.05, 4.05]], np.float32)
    assert batch(data, x, 1).tolist() == [x[2].tolist()]
    assert (distance_to_tried(data, batch(data, x, 8)) >= 0.1 * usual_distance(data)).all()
    assert batch(data, x, 1, repeat=True).tolist() == batch(fine, x, 1).tolist() == [x[0].tolist()]
    assert repeats_told(data, x) == [
        "3 of 4 proposals nearly repeat a design of the table (less than 0.1 typical distances away): there are too few "
        "others, or repeats were allowed"
    ]
    assert repeats_told(data, x[2:3]) == repeats_told(data, data.x[:3]) == repeats_told(fine, x) == []
    none = Designs.from_frame(frame | {"y": range(81)}, "y", kinds=dict.fromkeys("ab", "continuous"), constraints=[
        "a >= 2.98", "a <= 3.02", "b >= 4.98", "b <= 5.02"])  # fmt: skip
    found = batch(none, none.x, 4)
    check_batch(none, found, repeat=False)
    assert repeats_told(none, found)[0].startswith("4 of 4 proposals nearly repeat a design")


@pytest.mark.filterwarnings("ignore:a orders the rows")
def test_a_process_proposes_next_to_no_measured_optimum():
    """The model's optimum is at the measured row (0, 4), up to noise; what is proposed tells something new."""
    cells = np.array([(a, b) for a in range(-4, 5) for b in range(9)], float)
    y = -(np.square(cells[:, 0]) + np.square(cells[:, 1] - 4)) / 8 + 0.05 * np.random.default_rng(0).standard_normal(81)
    frame = {"a": cells[:, 0], "b": cells[:, 1], "y": y}
    data = Designs.from_frame(frame, "y", kinds=dict.fromkeys("ab", "continuous"))
    ask = lambda **more: designer("gp", rounds=20, folds=0).propose(data, 1, **more)  # noqa: E731
    near, new = ask(repeat=True), ask()
    assert nn_distance(data, near.x)[0] < 0.1 <= nn_distance(data, new.x)[0] < 0.25
    assert new.predicted[0] > near.predicted[0] - 0.004  # 0.0012; 0.008 where only a few of the best candidates are looked at


def test_the_terminal_and_the_page_tell_of_near_repeats(tmp_path, monkeypatch, capsys):
    from deadreckon.cli.main import main

    monkeypatch.chdir(tmp_path)
    rows = "\n".join(f"{a},{(a - 5) ** 2 % 7}" for a in range(12))
    (tmp_path / "t.csv").write_text(f"a,y\n{rows}\n")
    asked = ["design", "t.csv", "--target", "y", "--kinds", "a", "continuous", "--method", "random", "-n", "2", "--out", "x"]
    line = "2 of 2 proposals nearly repeat a design of the table"
    for rule, told in (("a >= 4.96", False), ("a <= 4.04", True)):
        assert main([*asked, "--constraints", "a >= 3.96", rule]) == 0
        assert (f"! {line}" in capsys.readouterr().err) == told
        assert (line in (tmp_path / "x" / "report.html").read_text()) == told


def test_proposals_lie_apart():
    data = TABLES["wide"]().designs()
    close = data.x[:1] * 0.8 + 1e-3 * np.arange(8)[:, None]
    found = data.coordinates.encode(batch(data, close, 8)).astype(float)
    least = min(np.linalg.norm(a - b) for i, a in enumerate(found) for b in found[:i])
    before = data.coordinates.encode(close)
    assert least > 5 * max(np.linalg.norm(a - b) for a, b in pairwise(before))


def test_more_than_there_are_is_refused():
    grid = [(a, b) for a in (1, 2, 3) for b in (1, 2, 3, 4)]
    frame = {"a": [a for a, _ in grid[:10]], "b": [b for _, b in grid[:10]], "y": list(range(10))}
    data = Designs.from_frame(frame, "y", bounds={"b": (1, 4), "a": (1, 3)})
    assert sorted(map(tuple, batch(data, data.x, 2).tolist())) == [(3.0, 3.0), (3.0, 4.0)]
    with pytest.raises(UserError, match="3 proposals that differ and are not in the data .* only 2 were found") as told:
        batch(data, data.x, 3)
    assert "\n" not in str(told.value)


def test_a_largest_distance_to_the_data_is_kept():
    data = TABLES["wide"]().designs()
    bold = designer("random").propose(data, 16).x
    near = Designs.from_frame(TABLES["wide"]().columns, "y", max_distance=0.5)
    safe = designer("random").propose(near, 16).x
    assert nn_distance(data, bold).min() > 0.5
    assert nn_distance(data, safe).max() <= 0.5
    away = {"bounds": {"x0": (-9, 9)}, "fixed": ["x0 = 9"]}
    with pytest.raises(UserError, match="were found within .* to the data; ask for fewer, make --max-distance larger, or"):
        batch(Designs.from_frame(TABLES["wide"]().columns, "y", max_distance=0.5, **away), data.x, 16)


def near_rows(**rules):
    """Four numbers and a category, whose proposals lie near rows of the data."""
    rng = np.random.default_rng(2)
    x, kind = rng.uniform(size=(60, 4)).round(3), np.arange(60) % 3
    y = 3 * x[:, 0] + 2 * x[:, 1] - 2 * (x[:, 2] - 0.6) ** 2 + np.sin(3 * x[:, 3]) + 0.3 * kind
    return Designs.from_frame(dict(zip("abcd", x.T)) | {"s": np.array(list("uvw"))[kind], "y": y}, "y", **rules)


@pytest.mark.parametrize("fixed", [["a = 0.5"], ["s = u"], ["a = 0.5", "s = w"]])
def test_designs_that_are_moved_near_the_data_keep_fixed_values(fixed):
    data = near_rows(max_distance=0.8, fixed=fixed)
    rng = np.random.default_rng(0)
    x, good = data.repair.exact(np.concatenate([rng.uniform(size=(200, 4)), rng.integers(0, 3, (200, 1))], 1))
    assert good.all()
    found = pulled(data, x, 0.8)
    assert nn_distance(data, found).max() <= 0.8
    assert len(repaired(data, x)) == 200  # none is left out
    for column, value in data.rules.fixed:
        assert (found[:, column] == value).all()


@pytest.mark.parametrize(("reach", "level"), [(1.0, 0), (1.5, 1), (4.0, 1)])
def test_a_category_that_no_row_has_stays_where_the_numbers_can_be_near_enough(reach, level):
    frame = {"a": np.linspace(0, 1, 20), "s": ["u"] * 20, "y": np.arange(20.0) % 7}
    read = lambda **rule: Designs.from_frame(frame, "y", bounds={"a": (0, 3)}, levels={"s": ["u", "v"]}, **rule)  # noqa: E731
    limit = reach / usual_distance(read())  # levels are the square root of 2 apart
    found = pulled(read(max_distance=limit), np.array([[3.0, 1.0]]), limit)
    assert found[0, 1] == level
    assert nn_distance(read(), found) == pytest.approx(0.98 * limit, rel=1e-5)


def test_the_best_design_near_the_data_is_found_within_the_rules():
    """Many rows break the constraint, so that a move towards the nearest one leaves what is allowed."""
    data = near_rows(max_distance=0.8, constraints=["a + b <= 0.8"], fixed=["c = 0.1"])
    made = designer("gp", folds=0).propose(data, 4)
    rng = np.random.default_rng(0)
    some = np.concatenate([rng.uniform(size=(20_000, 4)), rng.integers(0, 3, (20_000, 1))], 1).astype(np.float32)
    some[:, 2] = 0.1
    some = some[some[:, 0] + some[:, 1] <= 0.8]
    some = some[nn_distance(data, some) <= 0.8]
    assert made.predicted.min() > made.fitted.predict(some)[0].max()


@pytest.mark.filterwarnings("ignore:.*are pooled")
@pytest.mark.parametrize("method", ["random", "gp"])
def test_a_least_distance_between_proposals_is_kept(method):
    columns = TABLES["replicated"]().columns
    data = Designs.from_frame(columns, "y", apart=0.7)
    z = data.coordinates.encode(designer(method).propose(data, 8).x).astype(float)
    nearest = [np.linalg.norm(z[i + 1 :] - z[i], axis=1).min() for i in range(7)]
    assert min(nearest) >= 0.7 * usual_distance(data)
    with pytest.raises(UserError, match=r"8 proposals that differ, are not in the data \(.*\) and lie 9 typical distances"):
        designer(method).propose(Designs.from_frame(columns, "y", apart=9.0), 8)
    with pytest.raises(UserError, match=r"two proposals lie less than 0\.7 typical distances apart"):
        check_batch(data, data.x[:1] + [[0.0] * (data.x.shape[1] - 1) + [i * 1e-3] for i in range(2)], repeat=True)


@pytest.mark.filterwarnings("ignore:.*are pooled")
def test_copies_of_rows_say_nothing_of_the_noise():
    rng = np.random.default_rng(0)
    a, y, count = rng.uniform(size=20), rng.normal(size=20) / 3, [3] * 10 + [5, 5, 4, 4] + [1] * 6
    with pytest.warns(UserWarning, match="48 rows are replicates of 14 designs with the same y to the last digit; one of each"):
        data = Designs.from_frame({"a": np.repeat(a, count), "y": np.repeat(y, count)}, "y")
    assert data.std_error is None
    assert data.replicates is None
    np.testing.assert_allclose(np.sort(data.y), np.sort(y))
    assert np.isclose(fit(data).noise, fit(Designs.from_frame({"a": a, "y": y}, "y")).noise)
    error = np.repeat(np.linspace(0.1, 0.2, 20), count)
    told = Designs.from_frame({"a": np.repeat(a, count), "y": np.repeat(y, count), "se": error}, "y", std_error="se")
    np.testing.assert_allclose(np.sort(told.std_error), np.linspace(0.1, 0.2, 20))
    assert told.replicates is None


def test_replicates_are_pooled_with_their_noise():
    frame = {"a": [0, 0, 0, 1, 1, *range(2, 12)], "y": [1.0, 2.0, 3.0, 5.0, 7.0, *[0.5] * 10]}
    with pytest.warns(UserWarning, match="5 rows are replicates of 2 designs and are pooled; .* between replicates is 1.15"):
        data = Designs.from_frame(frame, "y")
    assert len(data) == 12
    assert data.y[:2].tolist() == [2.0, 6.0]
    assert data.replicates[:3].tolist() == [3, 2, 1]
    scatter = ((1 + 0 + 1 + 1 + 1) / 3) ** 0.5  # three degrees of freedom
    np.testing.assert_allclose(data.std_error[:3], scatter / np.sqrt([3, 2, 1]))
    given = Designs.from_frame(frame | {"se": [1.0, 1.0, 0.5, *[2.0] * 12]}, "y", std_error="se")
    np.testing.assert_allclose(given.y[0], (1 + 2 + 4 * 3) / 6)  # weighed by 1, 1 and 4
    np.testing.assert_allclose(given.std_error[0], 6**-0.5)
    assert len(Designs.from_frame(frame, "y", pool=False)) == 15


def test_standard_errors_are_not_believed_against_the_scatter_of_replicates():
    """Multiplied by Birge's ratio where replicates scatter significantly more than these say, and else taken as given."""
    y = [1.0, 2.0, 3.0, 5.0, 7.0, *[0.5] * 10]
    frame = {"a": [0, 0, 0, 1, 1, *range(2, 12)], "y": y, "se": [0.1, 0.1, 0.2, 0.1, 0.1, *[0.2] * 10]}
    with pytest.warns(
        UserWarning, match="1.15, more than their standard errors explain: all standard errors are multiplied by 10$"
    ):
        data = Designs.from_frame(frame, "y", std_error="se")
    mean = (1 + 2 + 3 / 4) / (1 + 1 + 1 / 4)
    chi2 = ((1 - mean) ** 2 + (2 - mean) ** 2 + (3 - mean) ** 2 / 4 + 1 + 1) / 0.1**2
    assert data.pooling.endswith(f"multiplied by {(chi2 / 3) ** 0.5:.3g}")
    given = [(100 + 100 + 25) ** -0.5, 200**-0.5, *[0.2] * 10]
    np.testing.assert_allclose(data.std_error, (chi2 / 3) ** 0.5 * np.array(given))
    assert birge_ratio(np.array([2.0, 2.0, 1.0]), 3) == 1.0  # 9 of three degrees of freedom: 3 % by chance
    assert birge_ratio(np.array([2.0, 2.0, 2.0]), 3) == 2.0
    with pytest.warns(UserWarning, match="between replicates is 1.15$"):
        kept = Designs.from_frame(frame | {"se": [0.8] * 15}, "y", std_error="se")
    np.testing.assert_allclose(kept.std_error[:3], 0.8 / np.sqrt([3, 2, 1]))


def test_a_standard_error_of_zero_is_unknown():
    frame = {
        "a": list(range(12)),
        "y": [float(i % 5) for i in range(12)],
        "se": [0.0, 0.0, *[0.1 * i for i in range(1, 10)], 50.0],
    }
    with pytest.warns(
        UserWarning, match="column se is 0 in 2 rows, which is taken for unknown: 0.9 is used instead, the 90% quant"
    ):
        data = Designs.from_frame(frame, "y", std_error="se")
    np.testing.assert_allclose(data.std_error, [0.9, 0.9, *frame["se"][2:]])
    assert any("0 in 2 rows" in line for line in data.noticed)
    with pytest.warns(UserWarning, match="column se is 0 in all rows: no standard errors are known"):
        assert Designs.from_frame(frame | {"se": [0.0] * 12}, "y", std_error="se").std_error is None


def test_several_targets_are_one_weighted_score():
    frame = {"a": list(range(12)), "good": [float(i) for i in range(12)], "cost": [2.0] * 6 + [4.0] * 6}
    data = Designs.from_frame(frame, "good", weights={"cost": -0.5})
    np.testing.assert_allclose(data.y, np.arange(12) - 0.5 * np.array(frame["cost"]))
    assert [v.name for v in data.variables] == ["a"]
    assert data.target == "good - 0.5 cost"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"constraints": ["a + b >= 3"]}, "no design within the bounds satisfies all constraints; without 'a \\+ b >= 3'"),
        ({"constraints": ["a + b"]}, "needs one relation"),
        ({"constraints": ["a + z <= 1"]}, "unknown variable 'z'"),
        ({"constraints": ["a + solvent <= 1"]}, "is of numbers, and solvent has levels"),
        ({"constraints": ["a < 1"]}, "takes <=, >= or =, not <"),
        ({"constraints": ["a ^ 2 <= 1"]}, "cannot be read at '\\^ 2'"),
        ({"constraints": ["1 <= 2"]}, "names no variable"),
        ({"fixed": ["a = 7"]}, "a is fixed at 7, outside its bounds"),
        ({"fixed": ["solvent = gin"]}, "unknown level of solvent 'gin'"),
        ({"fixed": ["a = 0.5", "a = 0.6"]}, "a is fixed twice"),
        ({"mixtures": [["a", "b", "a"]]}, "a is in a mixture twice; name each of its variables once"),
        ({"forbidden": ["solvent > water"]}, "solvent has levels, which are compared by = and != alone"),
        ({"forbidden": ["a = 0.5"]}, "a is a number; compare it with <"),
        ({"steps": {"a": 5}}, "a has no multiple of 5 in"),
        ({"steps": {"solvent": 5}}, "a step and a log scale are for numbers, and it is categorical"),
        ({"logs": ["a"], "bounds": {"a": (0, 1)}}, "a log scale needs a lower bound above 0, got 0"),
        ({"kinds": {"solvent": "ordinal"}}, "column solvent is ordinal: give its levels in their order"),
        ({"max_distance": 0.0}, "the largest distance to the data must be above 0"),
        ({"apart": 0.0}, "the least distance between proposals must be a finite number above 0, got 0"),
    ],
)
def test_rules_that_cannot_be_are_refused_in_one_line(options, words):
    columns = TABLES["constrained"]().columns
    columns = columns | {"a": [0.001 + value * 0.99 for value in columns["a"]]}
    with pytest.raises(UserError, match=words) as told:
        Designs.from_frame(columns, "y", **options)
    assert "\n" not in str(told.value)


def test_the_nearest_design_that_satisfies_all_is_found():
    data = Designs.from_frame(TABLES["constrained"]().columns, "y", constraints=["a + b <= 0.8"], fixed=["solvent = oil"])
    oil = data.variables[3].levels.index("oil")
    x = np.array([[0.3, 0.3, 0.5, 1 - oil], [0.7, 0.5, 0.5, oil]])
    found, good = data.repair.exact(x)
    assert good.all()
    np.testing.assert_allclose(found[0], [0.3, 0.3, 0.5, oil], atol=1e-6)
    np.testing.assert_allclose(found[1].astype(float) @ [1, 1, 0, 0], 0.8, atol=1e-4)
    mixture = TABLES["mixture"]().designs()
    away = mixture.x + np.random.default_rng(0).normal(0, 0.2, mixture.x.shape)
    assert mixture.repair.exact(away)[1].all()  # the grid has a point for each, however it was rounded
    # Projection in units of the data's deviations: both move alike, as these are nearly the same.
    np.testing.assert_allclose(found[1][:2], [0.5, 0.3], atol=0.02)


def test_whole_numbers_are_told_apart_however_large_they_are():
    rng = np.random.default_rng(0)
    count = 1_000_000 + rng.permutation(100)[:40]
    frame = {"count": count, "y": rng.normal(size=40)}
    data = Designs.from_frame(frame, "y", kinds={"count": "integer"})
    assert len(set(keys(data, data.x))) == 40
    near = Designs.from_frame({"a": 1_000 + np.linspace(0, 1, 40), "y": frame["y"]}, "y")
    assert len(set(keys(near, near.x))) == 40


def test_a_whole_number_on_a_log_scale_stays_whole():
    rng = np.random.default_rng(0)
    frame = {"layers": rng.integers(1, 51, 30), "a": rng.uniform(size=30), "y": rng.normal(size=30)}
    data = Designs.from_frame(frame, "y", kinds={"layers": "integer"}, logs=["layers"])
    tried = moved(data, data.x, 0.05, np.random.default_rng(1))
    assert (tried[:, 0] == np.round(tried[:, 0])).all()
    assert (tried != data.x).any(1).all()


def test_whole_numbers_in_steps_move_by_these():
    rng = np.random.default_rng(0)
    frame = {"heat": 25 * rng.integers(0, 9, 30), "a": rng.uniform(size=30), "y": rng.normal(size=30)}
    data = Designs.from_frame(frame, "y", steps={"heat": 25})
    assert data.variables[0].kind == "integer"
    tried = moved(data, data.x, 1e-3, np.random.default_rng(1))[:, 0]
    assert (tried % 25 == 0).all()
    assert (tried != data.x[:, 0]).any()
