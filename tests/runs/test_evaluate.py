"""What an evaluation in a simulator refuses before it begins."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.policies import BlackBoxPolicy
from deadreckon.runs.evaluate import Evaluation, evaluate
from deadreckon.tasks import task

STILL = BlackBoxPolicy(lambda seen, rng: np.zeros((len(seen), 2)))


@pytest.mark.parametrize(("options", "words"), [
    ({"discount": 5.0}, r"discount must be in \[0, 1\], got 5.0"),
    ({"discount": [0.9, -1.0]}, r"discount must be in .*, got -1.0"),
    ({"discount": [0.9, 0.9, 0.9]}, r"one for all policies or one each \(2\), got 3"),
    ({"horizon": -1}, "horizon must be a number of steps, 1 or more, got -1"), ({"horizon": 0}, "1 or more, got 0"),
    ({"seed": -1}, r"seed must be 0 .. 2\^32 - 1, got -1"),
])  # fmt: skip
def test_settings_out_of_range_are_refused(options, words):
    with pytest.raises(UserError, match=words):
        evaluate([STILL, STILL], "maze2d-umaze", episodes=1, **options)


@pytest.mark.parametrize(("name", "theirs"), [("maze2d-umaze", 100.0), ("hopper", None), ("maze2d-eval-umaze", None)])
def test_a_score_by_the_benchmarks_own_references_is_told_where_ours_are_others(name, theirs):
    returns = np.tile([160.86, 161.86, 162.86], (2, 1))
    result = Evaluation(task(name), returns, returns, np.ones((2, 3), int), (0.99,) * 2, ("a", "b"))
    if theirs is None:
        assert result.published_score() is None
        assert "D4RL" not in str(result)
    else:
        assert result.published_score(1).value == pytest.approx(theirs)
        assert str(result).count("by D4RL's references 100.0") == 3
        assert result.score(1).value < 70.0
