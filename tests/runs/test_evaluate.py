"""What an evaluation in a simulator refuses before it begins."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.policies import BlackBoxPolicy
from deadreckon.runs.evaluate import evaluate

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
