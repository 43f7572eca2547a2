"""Numbers by which a policy file of few bytes would ask for memory or time are refused when it is read."""

import json

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.policies import portable, store
from deadreckon.policies.file import numpy_player, read_policy

NET = {"kind": "MLP", "weights": ["@policy.w"], "biases": ["@policy.b"], "activation": "relu", "normalise": False, "mask": 0}
CHOICE = {"kind": "Categorical", "net": NET}


def env(inner):
    return {"kind": "EnvPolicy", "inner": inner, "mean": None, "std": None, "low": None, "high": None}


def history(**changed):
    return {"kind": "History", "member": env(CHOICE), "steps": 2, "observation_size": 1, "action_size": 1} | changed


def greedy(samples):
    return {"kind": "GreedyQ", "samples": samples, "actor": {"kind": "TanhGaussian", "net": NET}, "critic": NET}


def mixture(depth):
    policy = env(CHOICE)
    for _ in range(depth):
        policy = env({"kind": "Mixture", "members": [policy, policy]})
    return policy["inner"]


def seeing(*shape):
    return {"kind": "Seeing", "encoder": {"kind": "Encoder", "shape": list(shape)}, "member": env(CHOICE)}


@pytest.fixture
def written(tmp_path):
    def write(inner, n=2):
        meta = {"log": {"action_space": {"kind": "Discrete", "n": n}}}
        text = json.dumps({"format": 1, "meta": meta, "policy": env(inner)}).encode()
        arrays = {"policy.w": np.ones((3, 2), np.float32), "policy.b": np.zeros(2, np.float32)}
        np.savez(tmp_path / "x.npz", **{"policy.json": np.frombuffer(text, np.uint8)}, **arrays)
        return tmp_path / "x.npz"

    return write


def test_policies_that_obey_legal_actions_are_played(written):
    path = written({"kind": "Categorical", "net": NET | {"mask": 2}})
    player = numpy_player(path, *read_policy(path))
    assert player(np.array([[5.0, 0.0, 1.0], [5.0, 1.0, 0.0]])).tolist() == [1, 0]


@pytest.mark.parametrize(
    ("inner", "words"),
    [
        (greedy(20_000_000), r"policy\.inner\.samples must be a whole number from"),
        (greedy(500_000), "samples must be from 1 to 100,000"),
        (greedy("x"), "samples must be from 1 to 100,000"),
        (history(steps=10**9), r"policy\.inner\.steps must be a whole number from 1 to "),
        (history(steps=2.5), r"policy\.inner\.steps must be a whole number"),
        (history(action_size=2**31 - 1), r"policy\.inner\.action_size must be a whole number from 1 to "),
        (history(steps=3, action_size=3), "the size of its histories must be a whole number from 1 to "),
        (mixture(11), "is made of more than 1,000 policies"),
        (seeing(60_000, 60_000, 3), "the numbers of an image must be a whole number from 1 to 20,000,000"),
        ({"kind": "Categorical", "net": NET | {"mask": 10**9}}, r"policy\.inner\.net\.mask must be a whole number"),
    ],
)
def test_numbers_that_ask_for_too_much(written, inner, words):
    path = written(inner)
    for read in (read_policy, store.load):
        with pytest.raises(UserError, match=words) as caught:
            read(path)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("n", "words"),
    [(10**9, "from 1 to 1,000,000, got 1000000000"), (-5, "from 1 to 1,000,000, got -5"), (2.5, "got 2.5"), ("x", "got 'x'")],
)
def test_numbers_of_actions(written, n, words):
    with pytest.raises(UserError, match=rf"meta\.log\.action_space\.n must be a whole number,? {words}"):
        read_policy(written(CHOICE, n))


def test_the_reader_that_needs_numpy_alone_draws_no_more_either(written):
    with pytest.raises(ValueError, match="samples must be from 1 to 100,000"):
        portable.load(written(greedy(4 * 10**8)))


def test_what_policies_take_is_read(written):
    for inner in (CHOICE, history(), mixture(3), greedy(10)):
        assert read_policy(written(inner))[0]["policy"]["inner"]["kind"] == inner["kind"]
