"""The protocol: percentiles over seeds, kept results, tables."""

import dataclasses

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.mbo import Random, designer, problem
from deadreckon.mbo.protocol import COLUMNS, evaluate_designers, markdown, published, trust
from deadreckon.stats.means import student


@pytest.fixture(scope="module")
def branin():
    return problem("branin", rows=300)


def test_results_are_kept(branin, tmp_path, monkeypatch):
    told = []
    asked = [("best", designer("best")), ("random", designer("random"))]
    first = evaluate_designers(branin, asked, 16, seeds=range(4), out=tmp_path, on_result=told.append)
    assert [r.method for r in told] == ["best", "random"]

    def broken(self, setting):
        raise AssertionError("asked again")

    monkeypatch.setattr(Random, "solve", broken)
    again = evaluate_designers(branin, asked[1:], 16, seeds=range(4), out=tmp_path)
    np.testing.assert_array_equal(again[0].true, first[1].true)
    assert len(list(tmp_path.rglob("*.json"))) == 2
    strange = dataclasses.replace(branin, name="../../x")
    evaluate_designers(strange, [("../../best", designer("best"))], 16, seeds=range(4), out=tmp_path / "out")
    [path] = (tmp_path / "out").rglob("*.json")
    assert path.parent.name == "..-..-x"
    assert path.name.startswith("..-..-best-")
    with pytest.raises(AssertionError, match="asked again"):  # other seeds are another question
        evaluate_designers(branin, asked[1:], 16, seeds=range(5), out=tmp_path)


@pytest.mark.slow
def test_seeds_in_several_programs_are_the_same_seeds(branin):
    small = designer("forward", hidden=(8,), steps=20, ascent_steps=5, batch_size=16)
    whole = evaluate_designers(branin, [("forward", small)], 4, seeds=[3, 5])[0]
    parts = evaluate_designers(branin, [("forward", small)], 4, seeds=[3, 5], together=1)[0]
    np.testing.assert_allclose(parts.true, whole.true, rtol=1e-4)


@pytest.mark.parametrize("together", [0, -1])
def test_fewer_than_one_seed_in_a_program_are_refused(branin, together):
    with pytest.raises(UserError, match=f"together must be 1 or more, got {together}"):
        evaluate_designers(branin, [("best", designer("best"))], 4, seeds=[0], together=together)


def test_percentiles_and_tables(branin):
    results = evaluate_designers(branin, [("best", designer("best")), ("random", designer("random"))], 16, seeds=range(4))
    random = results[1]
    best = random.true.max(1)
    cell = random.percentile(100)
    assert (cell.value, (cell.low, cell.high)) == (pytest.approx(best.mean()), pytest.approx(student(best)))
    ranged = random.percentile(50, normalised=True).value
    assert ranged == pytest.approx((np.median(random.true, 1).mean() - branin.low) / (branin.high - branin.low))
    assert results[0].exploitation.value == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(random.exploitation.value)  # it predicts nothing
    table = markdown(results).splitlines()
    assert table[0] == "| problem | data | best | random |"
    assert table[2].startswith(f"| branin | {branin.visible.y.max():,.4g} | ")
    assert f"{best.mean():,.4g} [" in table[2]
    assert trust(results, "exploitation").splitlines()[2].endswith("|  |")
    assert results[0].distance.value == 0.0  # they are the data's own
    assert random.distance.value > 0.5
    assert [trust(results, what).count("\n") for what in COLUMNS] == [2, 2, 2]
    with pytest.raises(UserError, match="branin has several results of one method"):
        markdown([*results, results[0]])


def test_the_thesis_stands_below(branin):
    from dataclasses import replace

    results = evaluate_designers(branin, [("nemo", designer("random"))], 4, seeds=[0])
    table = markdown([replace(results[0], problem="superconductor")], 100).splitlines()
    assert table[3] == "| thesis | 73.9 | 127 ± 7.292 |"
    assert published()["50"]["superconductor"]["gp-bo"] == published()["50"]["superconductor-boosting"]["gp-bo"] == [72.42, 0.0]
    assert "[" not in table[2]  # one seed has no interval
