"""One suite for every designer: what it proposes, the same from the same seed, within bounds, for every kind of variable."""

import numpy as np
import pytest

from deadreckon.data.batch import redrawn
from deadreckon.errors import UserError
from deadreckon.mbo import DESIGNERS, COMs, designer
from deadreckon.mbo.designer import DesignInput
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.registry import CPU_BUDGET
from deadreckon.mbo.variables import Variable

SMALL = {
    "nemo": {"bins": 6, "hidden": (16,), "steps": 100, "pretrain": 100, "lr": 0.01, "design_lr": 0.03, "batch_size": 32},
    "auto": {"hidden": (16,), "steps": 100, "networks_from": 100},
    "nemo-adversarial": {"bins": 6, "hidden": (16,), "steps": 100, "pretrain": 100, "lr": 0.01, "batch_size": 32},
    "coms": {"hidden": (16,), "steps": 200, "batch_size": 32, "ascent_steps": 5, "lr": 3e-3},
    "gp-bo": {"max_rows": 100, "ascent_steps": 50},
    "ddom": {"hidden": (32,), "steps": 1000, "batch_size": 64, "lr": 3e-3, "sampling_steps": 50},
    "mins": {"hidden": (32,), "latent_size": 2, "steps": 2000, "batch_size": 64, "lr": 1e-3, "forward_hidden": (16,),
             "forward_steps": 200, "forward_lr": 3e-3},
    "ram": {"hidden": (16,), "steps": 200, "list_size": 32, "ascent_steps": 20, "lr": 3e-3, "design_lr": 0.05},
} | {name: {"hidden": (16,), "steps": 200, "batch_size": 32, "ascent_steps": 20, "lr": 3e-3, "design_lr": 0.05}
     for name in ("forward", "ensemble", "ensemble-min")} | {
    name: {"hidden": (16,), "latent_size": 2, "steps": 300, "members": 2, "rounds": 5, "updates": 50, "samples": 200,
           "batch_size": 32, "lr": 3e-3} for name in ("cbas", "autofocus")}  # fmt: skip
# What draws designs instead of climbing from the best ones has worse ones among them.
DRAWN = ("jitter", "cbas", "autofocus", "ddom", "mins")


def small(name):
    return designer(name, **SMALL.get(name, {}))


@pytest.fixture(scope="module")
def mixed():
    """A slope in a number, a whole number and a level; the best corner is not in the data."""
    rng = np.random.default_rng(0)
    x = np.stack([rng.uniform(-2, 2, 400), rng.integers(0, 6, 400), rng.integers(0, 3, 400)], 1)
    y = x[:, 0] + 0.5 * x[:, 1] + np.array([0.0, 1.0, 2.0])[x[:, 2].astype(int)]
    keep = y < np.quantile(y, 0.7)
    level = Variable("c", "categorical", levels=tuple("xyz"))
    variables = [Variable("a", low=-2, high=2), Variable("b", "integer", 0, 5), level]
    return Designs.from_arrays(x[keep], y[keep], variables, name="mixed")


def worth(x):
    return x[:, 0] + 0.5 * x[:, 1] + x[:, 2]


def test_the_small_budget_changes_fields_that_exist():
    for name, fields in CPU_BUDGET.items():
        made = vars(designer(name, "superconductor", **fields))
        assert {field: made[field] for field in fields} == fields
    assert made["bins"] == 40  # NEMO keeps the problem's published settings


# Slow are those that have tests of their own beside golden numbers.
SELDOM = {*DESIGNERS} - {"forward", "best", "jitter", "random"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in SELDOM else ()) for n in DESIGNERS])
def test_proposals(mixed, name):
    found, other = small(name).propose_many(mixed, 8, seeds=[3, 4])
    assert found.x.shape == (8, 3)
    mixed.check(found.x)
    assert (found.seed, other.seed) == (3, 4)
    assert found.predicted.shape == found.predicted_std.shape == (8,)
    # The model that comes with them is the one that made the predictions, where there is one of the score.
    assert (found.fitted is None) == (name in ("random", "best", "jitter", "ddom"))
    if found.fitted is not None:
        assert found.fitted.is_order == (name == "ram")
        mean, std = found.fitted.predict(found.x)
        np.testing.assert_allclose(np.nan if name == "ram" else mean, found.predicted, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(np.nan if std is None else std, found.predicted_std, rtol=1e-4, atol=1e-4)
    if name == "random":
        assert not np.array_equal(found.x, other.x)
        return
    if name in DRAWN:
        assert np.median(worth(found.x)) >= np.quantile(mixed.y, 0.8)
        assert not np.array_equal(found.x, other.x)
    else:
        # The best of the data is where they begin, and there is a slope to climb.
        assert np.median(worth(found.x)) >= (mixed.y.max() - 0.3 if name == "best" else mixed.y.max())
    again = small(name).propose_many(mixed, 8, seeds=[3, 4])[0]
    np.testing.assert_array_equal(again.x, found.x)


def test_redrawn_designs_count():
    np.testing.assert_array_equal(redrawn(20, 1, 0), np.ones((20, 1)))
    weight = redrawn(20, 3, 0)
    assert weight.shape == (20, 3)
    np.testing.assert_array_equal(weight.sum(0), 20)


@pytest.mark.slow
def test_coms_learns_not_to_promise_beyond_the_data():
    """With the penalty its ascent ends on lower promises than without."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (300, 2))
    data = Designs.from_arrays(x, x.sum(1))
    fields = SMALL["coms"] | {"steps": 600, "ascent_steps": 20}
    held = COMs(**fields, margin=0.0, alpha_lr=0.05).propose(data, 16)
    free = COMs(**fields, margin=1e6).propose(data, 16)
    assert held.predicted.mean() < free.predicted.mean() - 0.1 * data.y.std()


def test_names():
    with pytest.raises(UserError, match="unknown designer 'nimo': did you mean nemo"):
        designer("nimo")
    for field in ("bin", "propose"):  # a method is no field
        with pytest.raises(UserError, match=f"unknown field '{field}'"):
            designer("nemo", **{field: 3})
    with pytest.raises(UserError, match="unknown field 'bin': did you mean bins"):
        designer("nemo", bin=3)


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("ensemble-min", "coms", "nemo", "cbas", "mins")]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["forward", "gp-bo", *SLOW])
def test_beliefs_are_about_the_designs_that_are_proposed(mixed, name):
    """Not about the coordinates on the way there: two proposals that are the same design are believed the same."""
    found = small(name).propose(mixed, 40, seed=0)
    _, first, again = np.unique(found.x, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_allclose(found.predicted, found.predicted[first][again.reshape(-1)], rtol=1e-3, atol=1e-3)
    setting = DesignInput(mixed, 40, [0], None, lambda what, step, steps: None)
    twice = small(name).decoded(setting, 0, mixed.coordinates.encode(found.x), lambda z: (z[:, 0], None))
    np.testing.assert_allclose(twice.predicted, mixed.coordinates.score(mixed.coordinates.encode(found.x)[:, 0]), rtol=1e-5)


@pytest.mark.slow
def test_few_rows_give_many_different_designs():
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 1, (12, 2))
    data = Designs.from_arrays(x, x.sum(1), [Variable("a", low=0, high=1), Variable("b", low=0, high=1)])
    found = designer("forward", hidden=(8,), steps=50, batch_size=8, ascent_steps=1, design_lr=1e-4).propose(data, 60)
    data.check(found.x)
    assert len(np.unique(found.x.round(4), axis=0)) > 50
    with pytest.raises(UserError, match="designs has 12 designs, fewer than the 60 asked for"):
        designer("best").propose(data, 60)


def test_margins_and_percentiles(mixed):
    assert not mixed.coordinates.discrete
    levels = [Variable(c, "categorical", levels=tuple("xyz")) for c in "ab"]
    assert Designs.from_arrays(np.arange(20).reshape(10, 2) % 3, np.arange(10.0), levels).coordinates.discrete
    with pytest.raises(UserError, match="CbAS.percentile takes a finite number >= 0 and < 100, got 150"):
        designer("cbas", percentile=150.0).propose(mixed, 4)
