"""What `Predictor` does with a player, whatever that is."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.normalizer import Normalizer
from deadreckon.nets.mlp import MLP
from deadreckon.policies import EnvPolicy, portable, store, table_predict
from deadreckon.policies.candidates import GreedyActions, ThresholdedPolicy
from deadreckon.policies.kinds import Categorical
from deadreckon.policies.table_predict import Predictor
from deadreckon.policies.table_rows import RowsError
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
    """Rows of one episode have one member, which its name determines: in all calls and in all processes."""
    frame = pd.DataFrame({"day": np.arange(200) // 4, "x": 0.0, "action": [0, 1] * 100, "reward": 0.0})
    policy = Predictor(Constant(None, [Constant(0), Constant(1)]), noted(Dataset.from_frame(frame, episode="day")))
    days = policy.predict(frame, seed=1).reshape(50, 4)
    assert (days == days[:, :1]).all()
    assert 10 < days[:, 0].sum() < 40
    one_by_one = [[policy.predict({"day": day, "x": 0.0}) for _ in range(4)] for day in (*range(9), 10.0)]
    np.testing.assert_array_equal(one_by_one, days[[*range(9), 10]])
    np.testing.assert_array_equal(policy.predict(frame, seed=2).reshape(50, 4), days)
    times = pd.DataFrame({"day": pd.to_datetime(np.arange(200) // 4, unit="D"), "x": 0.0})
    dated = Predictor(policy.player, noted(Dataset.from_frame(frame.assign(day=times["day"].astype(str)), episode="day")))
    forms = [times, times.assign(day=times["day"].astype("datetime64[us]")), times.assign(day=times["day"].astype(str))]
    found = [dated.predict(form) for form in forms]
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    with pytest.raises(RowsError, match="one member of which acts in all rows of an episode: give the column day of"):
        policy.predict({"x": 0.0})
    with pytest.raises(RowsError, match="no column x: did you mean xs?"):  # a single row by its episode alone
        policy.predict({"day": 3, "xs": 0.0})
    told = policy.predict(frame, probabilities=True, greedy=False, seed=1)
    acted = np.asarray(told.actions)
    own = [told.probabilities[0], told.probabilities[1]]  # of the one that acts
    np.testing.assert_array_equal(own, [acted == 0, acted == 1])
    told = policy.predict({"day": 3, "x": 0.0}, probabilities=True)
    assert told.probabilities[told.actions] == 1.0  # a row alone is not its episode
    bandit = Predictor(policy.player, noted(Dataset.from_frame(frame.drop(columns="day"))))
    alone = bandit.predict({"x": [0.0] * 200}, probabilities=True, greedy=False).probabilities
    assert 70 < bandit.predict({"x": [0.0] * 200}, seed=2).sum() < 130
    np.testing.assert_array_equal([alone[0], alone[1]], np.full((2, 200), 0.5))


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_the_name_of_an_episode_is_the_whole_time_and_not_that_of_other_rows(unit):
    stamps = ["2024-01-01", "2024-01-02T12:00:00", "2024-01-02T12:00:00.1", "2024-01-02T12:00:00.9"]
    names = ["2024-01-01", "2024-01-02 12:00:00", "2024-01-02 12:00:00.1", "2024-01-02 12:00:00.9"]
    count = 2 if unit == "s" else 4
    times = np.array(stamps[:count], f"datetime64[{unit}]")
    assert table_predict._names(times) == names[:count]
    assert [table_predict._names(times[[i]])[0] for i in range(count)] == names[:count]
    assert table_predict._names(np.array(["2024-01-01", "NaT"], "datetime64[D]")) == ["2024-01-01", None]
    objects = np.array([*times[:2].astype("datetime64[s]").tolist(), "day 1", 3], object)  # as in dictionaries
    assert table_predict._names(objects) == [*names[:2], "day 1", 3]


class Fair(Constant):
    def probs(self, observations):
        return np.full((len(observations), 2), 0.5)


def test_sampled_actions_without_a_seed_are_drawn_anew_in_each_call():
    """One row at a time, a seed that is the same in every call would give the same action for ever."""
    frame = pd.DataFrame({"x": [0.0] * 20, "action": [0, 1] * 10, "reward": 0.0})
    policy = Predictor(Fair(0), noted(Dataset.from_frame(frame)))
    assert {policy.predict({"x": 0.0}, greedy=False) for _ in range(60)} == {0, 1}
    assert len({policy.predict({"x": 0.0}, greedy=False, seed=3) for _ in range(60)}) == 1


def test_a_mixture_that_is_asked_row_by_row_draws_its_member_each_time():
    frame = pd.DataFrame({"x": [0.0] * 20, "action": [0, 1] * 10, "reward": 0.0})
    known, mixture = noted(Dataset.from_frame(frame)), Constant(None, [Constant(0), Constant(1)])
    asked = [
        [policy.predict({"x": 0.0}) for _ in range(60)] for policy in (Predictor(mixture, known), Predictor(mixture, known))
    ]
    assert set(asked[0]) == set(asked[1]) == {0, 1}
    assert asked[0] != asked[1]  # two processes do not draw alike
    assert len({Predictor(mixture, known).predict({"x": 0.0}, seed=seed) for _ in range(9) for seed in (3,)}) == 1


def test_a_mixture_without_memory_needs_no_order_of_rows_and_no_actions():
    """Today's rows, in any order, with a column of doses that is to be filled in."""
    frame = pd.DataFrame({"day": np.arange(8) // 4, "at": np.arange(8), "x": 0.0, "dose": [0, 1] * 4, "reward": 0.0})
    log = Dataset.from_frame(frame, action="dose", reward="reward", episode="day", time="at")
    policy = Predictor(Constant(None, [Constant(0), Constant(1)]), noted(log))
    for today in (frame.assign(dose=None), frame.assign(dose=None, at=None), frame[::-1], frame.assign(dose=[1, None] * 4)):
        days = policy.predict(today, seed=1).reshape(2, 4)
        assert (days == days[:, :1]).all()


class Reminded(Constant):
    """A player on the last three steps, of which it keeps what it was given."""

    def __init__(self, observed):
        super().__init__(0)
        self.steps, self.action_size, self.observed, self.member, self.seen = 3, 2, observed, self, []

    def done(self, actions):
        return np.eye(2)[actions]

    def act(self, observations, rng, greedy):
        assert observations.shape[1] == 3 * self.observed + 2 * 2
        self.seen.append(observations)
        return np.zeros(len(observations), int)


def past_of(frame, rows, **roles):
    """{newest observation: the two before it} as a policy on the last three steps sees them, of a log with these roles."""
    log = Dataset.from_frame(frame, action="action", reward="reward", **roles)
    player = Reminded(1)
    inner = Reminded(1)
    inner.steps, inner.member, player.member = 1, None, inner
    Predictor(player, noted(log)).predict(rows)
    seen = np.concatenate(inner.seen)
    return {row[6]: (row[0], row[3]) for row in seen.tolist()}


@pytest.mark.parametrize("ends", [{"terminal": "done"}, {"timeout": "done"}, {"terminal": "done", "episode": "who"}])
def test_histories_begin_anew_where_the_log_says_that_an_episode_ended(ends):
    """As in training, where the first observation is repeated and not what came before."""
    frame = pd.DataFrame({"x": np.arange(6.0), "action": [0, 1] * 3, "reward": 0.0, "done": [0, 0, 1] * 2, "who": 7})
    frame = frame if "episode" in ends else frame.drop(columns="who")
    rows = frame.astype({"done": object})
    rows.loc[5, "done"] = None  # nobody knows yet
    own = {0: (0, 0), 1: (0, 0), 2: (0, 1), 3: (3, 3), 4: (3, 3), 5: (3, 4)}
    assert past_of(frame, frame, **ends) == past_of(frame, rows, **ends) == own
    assert past_of(frame, rows.assign(action=None), **ends) == own
    alone = rows.drop(columns="done")
    if "episode" in ends:
        assert past_of(frame, alone, **ends) == own | {3: (1, 2), 4: (2, 3)}
        return
    assert past_of(frame, alone[3:4], **ends) == {3: (3, 3)}
    with pytest.raises(RowsError, match="last 3 steps of an episode: give the column done, which says where one ends"):
        past_of(frame, alone, **ends)
    rows.loc[2, "done"] = None
    with pytest.raises(RowsError, match="column done is empty in row 2; it marks where episodes end"):
        past_of(frame, rows, **ends)


def test_an_episode_goes_on_whether_its_name_is_a_number_or_a_text():
    frame = pd.DataFrame({"x": np.arange(4.0), "action": [0, 1] * 2, "reward": 0.0, "who": [1, 1, 2, 2]})
    rows = frame.to_dict("records")
    rows[1]["who"], rows[3]["who"] = "1", 2.0
    assert past_of(frame, rows, episode="who") == {0: (0, 0), 1: (0, 0), 2: (2, 2), 3: (2, 2)}


def test_of_a_log_whose_rows_are_episodes_histories_have_one_step():
    frame = pd.DataFrame({"x": np.arange(3.0), "action": [0, 1, 0], "reward": 0.0})
    assert past_of(frame, frame) == {0: (0, 0), 1: (1, 1), 2: (2, 2)}


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
