"""What `Predictor` does with a player, whatever that is."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.nets.mlp import MLP
from deadreckon.policies import EnvPolicy, portable, store
from deadreckon.policies.candidates import GreedyActions, ThresholdedPolicy
from deadreckon.policies.kinds import Categorical
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


@pytest.mark.parametrize("kind", ["categorical", "greedy", "thresholded"])
def test_probabilities_by_numpy_are_those_of_the_package(kind, tmp_path):
    nets = [MLP.create(3, (8,), 4, jax.random.key(i)) for i in range(2)]
    inner = {
        "categorical": Categorical(nets[0]), "greedy": GreedyActions(nets[0]),
        "thresholded": ThresholdedPolicy(nets[0], Categorical(nets[1]), jnp.asarray(0.9)),
    }[kind]  # fmt: skip
    policy = EnvPolicy.of(inner, Normalizer(np.array([1.0, -1.0, 0.0]), np.array([2.0, 0.5, 1.0]), None, None))
    store.save(tmp_path / "p.npz", policy)
    x = np.random.default_rng(0).normal(0.0, 9.0, (50, 3)).astype("f4")
    found = portable.load(tmp_path / "p.npz").probs(x)
    np.testing.assert_allclose(found, policy.action_probs(x), atol=1e-6)
    assert len(set(found.argmax(1).tolist())) > 1
