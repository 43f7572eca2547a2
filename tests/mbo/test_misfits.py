"""What is told of single scores that no other row predicts, of errors that grow, and of regions where runs have no score."""

import html
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from deadreckon.mbo import designer
from deadreckon.mbo.designs import Designs
from deadreckon.mbo.first_choice import first_choice
from deadreckon.mbo.front import Front
from deadreckon.mbo.misfits import LEAST, misfits_told
from deadreckon.mbo.nn_distance import nn_distance
from deadreckon.mbo.unscored import NEAREST, failures, missing_near, prevail, unscored_told
from deadreckon.mbo.validation import judged
from deadreckon.report.design import write_design

GP = designer("gp", rounds=2)


def designs(y, rows=60, seed=0, **more):
    """Three inputs and the scores that a function of them and of a generator gives."""
    rng = np.random.default_rng(seed)
    x = rng.random((rows, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Designs.from_frame(dict(zip("abc", x.T)) | {"y": y(x, rng)}, "y", **more)


def bowl(x, rng):
    return 40 + 20 * x[:, 0] - 30 * (x[:, 1] - 0.5) ** 2 + 2 * rng.normal(size=len(x))


def test_a_score_that_no_other_row_predicts_is_told():
    """It decides what is proposed; a table without one, or with long tails, has no such message."""
    for seed in range(1, 5):
        clean = designs(bowl, seed=seed)
        wrong = clean.y.copy()
        wrong[7] *= 2
        quality = [GP.propose(replace(clean, y=y), 4).quality for y in (clean.y, wrong)]
        assert misfits_told(clean, quality[0]) == []
        (line,) = misfits_told(replace(clean, y=wrong), quality[1])
        assert line.startswith(f"y: row 7 (counted from 0) has {wrong[7]:.4g}, where the other rows predict ")
        assert "measure it again, or leave it out, if it is an error" in line
    for seed in range(4):  # of scores without noise the largest error is none
        for smooth in (lambda x, rng: -np.square(x - 0.4).sum(1), lambda x, rng: np.sin(3 * x).sum(1)):
            data = designs(smooth, seed=seed)
            assert misfits_told(data, GP.propose(data, 4).quality) == []
    steep = 0
    for seed in range(4):  # at a cliff, rows on the same side are alike
        cliff = designs(lambda x, rng: np.where(x[:, 0] > 0.5, 10, 0) + 0.3 * rng.normal(size=len(x)), seed=seed)
        found = GP.propose(cliff, 4).quality
        error = np.abs(found.observed - found.crosswise[0])
        steep += bool(error.max() > 5 * np.median(error) / 0.6745)
        assert misfits_told(cliff, found) == []
    assert steep >= 2


def quality_of(y, mean, std=1.0):
    return judged(y, mean, np.full(len(y), std), np.arange(len(y)) % 3, "m")


def test_rows_are_those_of_the_table_and_at_most_three():
    rng = np.random.default_rng(0)
    data = designs(lambda x, rng: 5 * x[:, 0], rows=80)
    y, mean = data.y.copy(), data.y + rng.normal(size=80)
    for row, more in ((3, 30), (50, -40), (60, 25), (70, 20)):
        y[row] += more
    right, data = data.y, replace(data, y=y)
    (line,) = misfits_told(data, quality_of(y, mean))
    assert re.findall(r"row (\d+)", line) == ["50", "3", "60"]
    assert ", and 1 more: the model is fitted to them" in line
    part, alone = replace(data.part(np.arange(40, 80)), minimise=True), np.where(np.arange(80) == 50, y, right)
    held = replace(quality_of(-alone[50:], -mean[50:]), rows=np.arange(10, 40))  # held-out rows
    (line,) = misfits_told(part, held)
    assert line.startswith(f"y: row 50 (counted from 0) has {y[50]:.4g}, where")
    few = LEAST - 1
    assert misfits_told(data, None) == misfits_told(data, quality_of(y[:few], mean[:few])) == []
    many = right + np.where(np.arange(80) % 14 == 0, 12, 0)
    assert misfits_told(replace(data, y=many), quality_of(many, mean)) == []  # six rows are no single errors
    few_of_them = np.where(np.arange(80) > 50, right, many)
    assert misfits_told(replace(data, y=few_of_them), quality_of(few_of_them, mean)) != []
    assert misfits_told(data, replace(quality_of(y, mean), scored=False)) == []


def test_errors_that_grow_with_predictions_are_told_and_no_rows_then():
    """Of positive scores with relative errors, whose logarithm has errors of one size."""
    told = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        mean = np.exp(rng.uniform(0, 4, 60))
        y = mean * np.exp(0.2 * rng.normal(size=60))
        data = designs(lambda x, rng, y=y: y)
        (line,) = misfits_told(data, quality_of(y, mean))
        assert "grow with the predictions (rank correlation 0." in line
        assert "use the logarithm of y as the target, in a column of its own" in line
        assert misfits_told(data, quality_of(np.log(y), np.log(mean))) == []
        assert not any("grow" in each for each in misfits_told(replace(data, minimise=True), quality_of(y, mean)))
        assert not any("grow" in each for each in misfits_told(data, quality_of(y - 9, mean - 9)))
    for seed in range(100):
        rng = np.random.default_rng(seed)
        mean = rng.uniform(20, 40, 60)
        told += bool(misfits_told(data, quality_of(mean + rng.normal(size=60), mean)))
    assert told <= 3


def failing(seed, rows=80, share=1.3, at_random=0.0):
    """A table whose runs fail, and have no score, where two inputs are large, or at random."""

    def score(x, rng):
        y = 40 + 20 * x[:, 0] + 20 * x[:, 1] + 1.5 * rng.normal(size=len(x))
        return np.where((x[:, 0] + x[:, 1] > share) | (rng.random(len(x)) < at_random), np.nan, y)

    return designs(score, rows, seed)


def said_of(data, made, tmp_path):
    text = write_design(data, made, nn_distance(data, made.x), tmp_path / "page.html").read_text()
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<(style|script).*?</\1>|<[^>]+>", "", text, flags=re.S)))


def test_proposals_among_failed_runs_are_told_on_the_card(tmp_path):
    """The best predictions lie beyond the rows with a score: where runs failed."""
    found = 0
    for seed in range(4):
        data = failing(seed)
        made = GP.propose(data, 4)
        chosen = first_choice(made, nn_distance(data, made.x))
        card = "But rows without a score prevail around it (" in said_of(data, made, tmp_path)
        assert card == bool(prevail(data, made.x)[chosen])
        assert any("where rows without y prevail" in line for line in unscored_told(data, made.x)) or not card
        found += card
    assert found == 4
    for seed in range(4):  # anywhere: proposals are where models expect much
        data = failing(seed, share=9, at_random=0.25)
        made = GP.propose(data, 4)
        assert unscored_told(data, made.x) == []
        assert "prevail around it" not in said_of(data, made, tmp_path)
    whole = failing(0, share=9)
    assert whole.unscored is None
    assert missing_near(whole, whole.x).tolist() == [0] * len(whole)
    assert unscored_told(whole, whole.x) == []


def test_rows_without_a_score_are_counted_among_the_nearest():
    data = failing(0)
    x = np.concatenate([data.unscored[:3], data.x[:3]])
    both = np.concatenate([data.x, data.unscored])
    z = (both - data.x.mean(0)) / data.x.std(0)
    for point, count in zip((x - data.x.mean(0)) / data.x.std(0), missing_near(data, x)):
        nearest = np.argsort(np.linalg.norm(z - point, axis=1))[:NEAREST]
        assert count == (nearest >= len(data)).sum()
    hits = 0
    for seed in range(6):
        anywhere = failing(seed, rows=300, share=9, at_random=0.1)
        both = np.concatenate([anywhere.x, anywhere.unscored])
        share = anywhere.passed.sum() / (len(anywhere) + anywhere.passed.sum())
        counts = missing_near(anywhere, both)
        rare = [count > 1 and binom.sf(count - 1, NEAREST, share) < 0.01 for count in counts]
        assert prevail(anywhere, both).tolist() == rare  # by the nearest alone, as no direction is found
        hits += sum(rare)
    assert hits > 0
    data = failing(0, rows=900)
    rare = replace(data, unscored=data.unscored[:1], passed=None)
    assert binom.sf(0, NEAREST, 1 / (1 + len(rare))) < 0.01
    assert missing_near(rare, data.unscored[:1]).tolist() == [1]
    assert not prevail(rare, data.unscored[:1])[0]  # one row is no region


def test_a_direction_in_which_runs_fail_is_found():
    """Where few rows are near, a regression shows that failures become more frequent."""
    for seed in range(4):
        data = failing(seed, rows=120, share=1.7)
        assert prevail(data, np.array([[1.0, 1.0, 0.5], [0.1, 0.1, 0.5]])).tolist() == [True, False]
        anywhere = failing(seed, rows=120, share=9, at_random=0.05)
        assert prevail(anywhere, np.array([[1.0, 1.0, 0.5], [0.0, 0.0, 0.5]])).tolist() == [False, False]


def test_replicates_of_a_design_that_failed_are_one_failure():
    rng = np.random.default_rng(0)
    each = rng.random((20, 3))
    x, y = np.repeat(each, 4, 0), rng.normal(size=80)
    y[4:8], y[9] = np.nan, np.nan  # all of one design, and one of another
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = Designs.from_frame(dict(zip("abc", x.T)) | {"y": y}, "y")
    assert len(data) == 19
    np.testing.assert_allclose(failures(data), each[[1]], atol=1e-6)
    assert missing_near(data, each[[1]]).tolist() == [1]
    assert unscored_told(data, each) == []


def test_planned_runs_at_the_end_of_a_table_are_no_failures():
    """Proposals that were added to their table and have no score yet are where models expect most."""
    rng = np.random.default_rng(0)
    x = rng.random((60, 3))
    frame = dict(zip("abc", x.T)) | {"y": bowl(x, rng)}
    data = Designs.from_frame(frame, "y")
    made = GP.propose(data, 8)
    more = {name: np.append(frame[name], values) for name, values in data.decode(made.x).items()}
    more["y"] = np.append(frame["y"], np.full(8, np.nan))
    with pytest.warns(UserWarning, match="8 rows without y left out"):
        again = Designs.from_frame(more, "y")
    assert again.passed.tolist() == [False] * 8
    assert unscored_told(again, GP.propose(again, 8).x) == []
    first = {name: np.roll(values, 8) for name, values in more.items()}  # they stand at the beginning, and failed
    with pytest.warns(UserWarning, match="8 rows without y left out"):
        failed_ones = Designs.from_frame(first, "y")
    assert failed_ones.passed.all()
    assert unscored_told(failed_ones, made.x) != []


def test_errors_of_rows_of_one_group_count_once():
    """Ten lots whose errors go with their predictions are ten, and not a hundred rows."""
    data = designs(lambda x, rng: 50 + x[:, 0], rows=100)
    lot = np.arange(100) // 10
    mean = 50 + lot + 0.01 * np.arange(100)
    y = mean + 0.1 * (1 + lot) * np.where(np.arange(100) % 2, 1, -1)
    assert any("grow" in line for line in misfits_told(replace(data, y=y), quality_of(y, mean)))
    assert misfits_told(replace(data, y=y), replace(quality_of(y, mean), units=lot)) == []


def test_planned_runs_at_zero_of_a_log_scale_are_far_from_everything():
    rng = np.random.default_rng(0)
    rate = np.append(10 ** rng.uniform(-3, 0, 30), [0.0, 0.5])
    with pytest.warns(UserWarning, match="2 rows without y left out"):
        data = Designs.from_frame(
            {"rate": rate, "b": rng.random(32), "y": np.append(rng.normal(size=30), [np.nan, np.nan])}, "y", logs=["rate"]
        )
    assert len(data.unscored) == 2
    assert missing_near(data, data.unscored[1:]).tolist() == [0]  # planned ones
    assert missing_near(replace(data, passed=None), data.unscored[1:]).tolist() == [1]


def test_of_several_targets_each_is_told():
    data = designs(lambda x, rng: 5 * x[:, 0] + rng.normal(size=len(x)))
    y = data.y.copy()
    y[4] += 40
    made, data = GP.propose(data, 2), replace(data, y=y)
    made = replace(made, quality=quality_of(y, 5 * data.x[:, 0]))
    front = Front((data, replace(data, target="z")), (made, made), np.zeros(2), 0.0, 0.0)
    assert [line.partition(":")[0] for line in front.warnings if "row 4 " in line] == ["y", "z"]
