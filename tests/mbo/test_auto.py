"""The rule by which a method is taken."""

import dataclasses

import numpy as np
import pytest

from deadreckon.errors import DivergedError
from deadreckon.mbo import auto, designer
from deadreckon.mbo.auto import chosen, standard_error
from deadreckon.mbo.designer import DesignInput, Proposals
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.forward import Forward
from deadreckon.mbo.gp import GP
from deadreckon.mbo.validation import judged
from deadreckon.mbo.variables import Variable
from deadreckon.progress import unwatched

RNG = np.random.default_rng(0)
Y = RNG.normal(size=400)


def quality(method, noise, scored=True):
    """Of predictions that are the scores and noise, among three methods."""
    rng = np.random.default_rng(len(method))
    mean = Y + noise * rng.normal(size=len(Y))
    found = judged(Y, mean, np.ones(len(Y)), np.arange(len(Y)) % 2, method, scored=scored)
    return dataclasses.replace(found, tried=3)


def weak(method, rank, **more):
    """The same with another rank correlation, of predictions that hardly go with the scores themselves."""
    off, noise = Y - Y.mean(), np.random.default_rng(len(method)).normal(size=len(Y))
    predicted = noise - (noise @ off) / (off @ off) * off + 1e-3 * off
    return dataclasses.replace(quality(method, 1.0), predicted=predicted, rank_correlation=rank, **more)


def test_the_best_order_is_taken_unless_the_process_is_as_good():
    assert chosen([quality("GP", 1.0), quality("net", 2.0), quality("rank", 3.0)])[0] == 0
    at, reason = chosen([quality("GP", 3.0), quality("net", 0.5), quality("rank", 0.3, scored=False)])
    assert at == 2
    assert "rank ranks unseen designs best" in reason
    gp = quality("GP", 1.0)
    nearly = dataclasses.replace(quality("other", 1.0), rank_correlation=gp.rank_correlation + 1e-3)
    at, reason = chosen([gp, nearly])
    assert at == 0
    assert reason.endswith("so GP is taken")


@pytest.mark.slow
def test_the_standard_error_is_that_of_independent_correlations():
    """Of predictions that tell nothing each correlation has a variance of 1 / (rows - 1), their difference twice that."""
    a, b = np.random.default_rng(1).normal(size=(2, len(Y)))
    assert standard_error(Y, a, b) == pytest.approx((2 / (len(Y) - 1)) ** 0.5, rel=0.2)
    assert standard_error(Y, a, a) == 0.0


def test_of_noise_no_method_is_praised():
    """The limit for the best of three is higher than for one."""
    a = weak("GP", 0.105, tried=1)
    assert a.skilled
    among = dataclasses.replace(a, tried=3)
    assert not among.skilled
    at, reason = chosen([among, dataclasses.replace(among, method="net", rank_correlation=0.11)])
    assert at == 0
    assert reason == f"of net, which ranks unseen designs best of 2 methods, {among.doubt}; GP is taken"
    assert among.doubt == "the model's order of unseen rows cannot be distinguished from chance"


def test_of_a_single_method_no_order_among_methods_is_told():
    """The others diverged."""
    good = dataclasses.replace(quality("GP", 1.0), tried=1)
    alone = "GP is the only method that could be compared"
    assert chosen([good]) == (0, f"{alone} ({good.rank_correlation:.3f})")
    none = weak("GP", 0.0, tried=1)
    assert chosen([none]) == (0, f"of {alone.replace(' is', ',')}, {none.doubt}; GP is taken")


def test_a_method_without_skill_is_not_taken_where_another_has_skill():
    """Neither the process for being about as good, nor the greatest rank, of which the predictions fall with the scores."""
    gp, net = weak("GP", 0.11), weak("net", 0.13)
    assert [gp.skilled, net.skilled] == [False, True]
    assert net.rank_correlation - gp.rank_correlation < standard_error(Y, gp.predicted, net.predicted)
    at, reason = chosen([gp, net])
    assert at == 1
    assert reason == f"of GP (0.110), {gp.doubt}; of the others, net ranks unseen designs best (0.130)"
    turned = dataclasses.replace(net, method="turned", predicted=-net.predicted, rank_correlation=0.9)
    assert not turned.skilled
    assert chosen([gp, turned, net])[0] == 2
    good = dataclasses.replace(gp, rank_correlation=0.3)
    assert chosen([good, turned, net])[0] == 0
    assert chosen([gp, turned])[0] == 0


def test_a_method_that_diverges_is_left_out(monkeypatch):
    """The default ends in no error, because two others are left."""

    def judge(method, setting, scored):
        if method.label == "RaM":
            raise DivergedError("held-out: listnet was not finite at update 3")
        return quality(method.label, {"GP": 3.0, "Ensemble, mean": 0.3}[method.label])

    monkeypatch.setattr(auto, "on_held_out", judge)
    made = Proposals("m", np.zeros((4, 2)), np.zeros(4), np.ones(4), 0)
    monkeypatch.setattr(Forward, "solve", lambda method, setting: [made])
    data = Designs.from_arrays(RNG.uniform(size=(60, 2)), Y[:60])
    with pytest.warns(UserWarning, match="designs: RaM is not compared, because its fit diverged .*at update 3"):
        [found] = designer("auto", networks_from=50).solve(DesignInput(data, 4, [0], None, unwatched))
    assert [each.method for each in found.compared] == ["GP", "Ensemble, mean"]
    assert found.quality is found.compared[1]
    assert {each.tried for each in found.compared} == {2}


def test_with_a_kappa_the_process_is_taken(monkeypatch):
    """No other method ranks by it."""
    monkeypatch.setattr(GP, "solve", lambda method, setting: method.kappa)
    data = Designs.from_arrays(RNG.uniform(size=(60, 2)), Y[:60])
    method = designer("auto", networks_from=50, kappa=-1.0, hidden=(8,), steps=1)
    assert method.solve(DesignInput(data, 4, [0], None, unwatched)) == -1.0


def test_a_network_that_is_taken_says_that_it_does_not_see_standard_errors(monkeypatch):
    x, error = RNG.uniform(size=(60, 2)), np.linspace(0.1, 1.0, 60)
    data = dataclasses.replace(Designs.from_arrays(x, Y[:60]), std_error=error)
    noise = {"GP": 3.0, "Ensemble, mean": 0.3, "RaM": 3.0}
    monkeypatch.setattr(auto, "on_held_out", lambda method, setting, scored: quality(method.label, noise[method.label]))
    monkeypatch.setattr(Forward, "solve", lambda method, setting: [])
    with pytest.warns(UserWarning, match="designs: Ensemble, mean treats all rows as equally exact in its fit"):
        assert designer("auto", networks_from=50).propose_many(data, 4, seeds=[0]) == []


@pytest.mark.slow
def test_few_designs_have_the_process_and_many_are_tried_by_all():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (120, 2))
    variables = [Variable(name, low=-1, high=1) for name in "ab"]
    data = Designs.from_arrays(x, x.sum(1) + 0.1 * rng.normal(size=120), variables)
    few = designer("auto").propose(data, 4)
    assert (few.method, few.compared) == ("GP", ())
    assert few.quality.rank_correlation > 0.9
    many = designer("auto", networks_from=100, hidden=(8,), steps=50).propose(data, 4)
    assert [each.method for each in many.compared] == ["GP", "Ensemble, mean", "RaM"]
    assert [len(each.observed) for each in many.compared] == [24] * 3
    assert many.quality is many.compared[0]
    assert many.method == "GP"
    assert np.isnan(many.compared[2].r2)
    plain = GP(folds=0).propose(data, 4)
    once = many.quality.calibration(plain.predicted, plain.predicted_std)
    np.testing.assert_allclose([many.predicted, many.predicted_std], once, rtol=1e-5)  # and not twice
