"""What `Predictor` does with a player, whatever that is."""

import numpy as np
import pandas as pd

from deadreckon.data.dataset import Dataset
from deadreckon.policies.table_predict import Predictor
from deadreckon.runs.reading import noted


class Constant:
    """A player that always does the same."""

    steps, action_size, member = 1, 0, None

    def __init__(self, code, members=()):
        self.code, self.members = code, list(members)

    def act(self, observations, rng, greedy):
        return np.full(len(observations), self.code)

    def probs(self, observations):
        return np.eye(2)[np.full(len(observations), self.code)]


def test_a_mixture_keeps_its_member_for_an_episode():
    """Rows of one episode have one member; without the column of the episode each row is one of its own."""
    frame = pd.DataFrame({"day": np.arange(200) // 4, "x": 0.0, "action": [0, 1] * 100, "reward": 0.0})
    policy = Predictor(Constant(None, [Constant(0), Constant(1)]), noted(Dataset.from_frame(frame, episode="day")))
    days = policy.predict(frame, seed=1).reshape(50, 4)
    assert (days == days[:, :1]).all()
    assert 10 < days[:, 0].sum() < 40
    assert 70 < policy.predict({"x": [0.0] * 200}).sum() < 130
    told = policy.predict(frame, probabilities=True, greedy=False).probabilities
    np.testing.assert_array_equal([told[0], told[1]], np.full((2, 200), 0.5))
