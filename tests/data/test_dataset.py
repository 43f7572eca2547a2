import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_logs import images, logs, make_log, quick, same

from deadreckon.data.dataset import Dataset
from deadreckon.data.episodes import returns_to_go
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.spec import Box, Discrete
from deadreckon.errors import UserError


@quick
@given(logs(), st.sampled_from([1.0, 0.9, 0.0]))
def test_returns_to_go_are_those_of_a_plain_loop(log, discount):
    expected = np.zeros(len(log))
    for start, end in zip(log.starts, log.ends):
        ahead = 0.0
        for row in range(end, start - 1, -1):
            ahead = float(log.rewards[row]) + discount * ahead
            expected[row] = ahead
    np.testing.assert_allclose(log.returns_to_go(discount), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(log.returns(discount), expected[log.starts], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("discount", [1.0, 0.99])
def test_returns_of_few_long_episodes_are_those_of_a_plain_loop(discount):
    lengths = np.array([3, 5_000, 1, 4_099])
    rewards, expected = np.random.default_rng(0).standard_normal(lengths.sum()), np.zeros(lengths.sum())
    ends = np.cumsum(lengths) - 1
    for end, steps in zip(ends, lengths):
        for row in range(end, end - steps, -1):
            expected[row] = rewards[row] + (discount * expected[row + 1] if row < end else 0.0)
    np.testing.assert_allclose(returns_to_go(rewards, ends, lengths, discount), expected, rtol=1e-9, atol=1e-9)


@quick
@given(logs())
def test_next_observations_stay_in_their_episode(log):
    following = log.next_observations
    for index, (start, end) in enumerate(zip(log.starts, log.ends)):
        np.testing.assert_array_equal(following[start:end], log.observations[start + 1 : end + 1])
        np.testing.assert_array_equal(following[end], log.final_observations[index])
    some = np.arange(len(log))[::2]
    np.testing.assert_array_equal(log.next_observations_at(some), following[some])


@quick
@given(logs())
def test_with_and_without_next_observations_agree(log):
    again = Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards, terminals=log.terminals,
        timeouts=log.timeouts, next_observations=log.next_observations, action_space=log.action_space, name=log.name,
    )  # fmt: skip
    same(log, again)
    assert log.fingerprint == again.fingerprint
    inferred = Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards, terminals=log.terminals,
        next_observations=log.next_observations, action_space=log.action_space,
    )  # fmt: skip
    same(log, inferred)


@quick
@given(logs(), st.data())
def test_select_keeps_episodes_whole_and_in_order(log, data):
    chosen = data.draw(st.lists(st.integers(0, log.episodes - 1), min_size=1, max_size=5, unique=True))
    part = log.select(chosen)
    assert part.episodes == len(chosen)
    for new, old in enumerate(chosen):
        a, b = slice(part.starts[new], part.ends[new] + 1), slice(log.starts[old], log.ends[old] + 1)
        np.testing.assert_array_equal(part.observations[a], log.observations[b])
        np.testing.assert_array_equal(part.next_observations[a], log.next_observations[b])
        np.testing.assert_array_equal(part.rewards[a], log.rewards[b])


@quick
@given(logs(), st.floats(0.05, 0.95), st.integers(0, 5), st.sampled_from(["episode", "time"]))
def test_split_gives_every_episode_to_one_part(log, fraction, seed, by):
    if log.episodes < 2:
        with pytest.raises(UserError, match="2 episodes"):
            log.split(fraction, seed, by)
        return
    first, second = log.split(fraction, seed, by)
    assert first.episodes + second.episodes == log.episodes
    assert len(first) + len(second) == len(log)
    together = np.concatenate([first.returns(), second.returns()])
    np.testing.assert_allclose(np.sort(together), np.sort(log.returns()))
    if by == "time":
        np.testing.assert_array_equal(first.observations, log.observations[: len(first)])


def test_a_part_whose_successors_follow_has_the_form_of_a_plain_log():
    log = make_log((3, 4), terminal=(False,))
    following = log.next_observations.copy()
    following[4] += 1  # inside the second episode
    odd = Dataset.from_arrays(
        observations=log.observations, actions=log.actions, rewards=log.rewards, timeouts=log.timeouts,
        next_observations=following, action_space=log.action_space,
    )  # fmt: skip
    assert odd.successors is not None
    assert odd.select([0]).successors is None
    assert odd.select([0]).fingerprint == log.select([0]).fingerprint


def test_unknown_finals_are_dropped_and_do_not_matter_to_the_fingerprint():
    log = make_log((2, 2), terminal=(False,))
    given = dict(
        observations=log.observations, actions=log.actions, rewards=log.rewards, timeouts=log.timeouts,
        action_space=log.action_space, final_known=[True, False],
    )  # fmt: skip
    a = Dataset.from_arrays(**given, final_observations=log.final_observations)
    b = Dataset.from_arrays(**given, final_observations=log.final_observations * [[1], [9]])
    assert a.dropped == 1
    assert a.usable.tolist() == [True, True, True, False]
    assert a.fingerprint == b.fingerprint
    assert "1 of 4 rows" in a.warnings[0]


def test_pictures_stay_bytes():
    log = images()
    assert log.observations.dtype == np.uint8
    assert log.next_observations.dtype == np.uint8
    assert log.spec.observation_shape == (4, 5, 3)


def _columns(**changed):
    columns = {
        "observations": np.zeros((4, 2)), "actions": np.zeros((4, 1)), "rewards": np.zeros(4),
        "terminals": np.zeros(4), "timeouts": np.zeros(4),
    }  # fmt: skip
    return {**columns, **changed}


def _with(column, place, value):
    changed = np.array(_columns()[column], np.float64)
    changed[place] = value
    return {column: changed}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (_with("observations", (2, 1), np.nan), "log: column observations has nan in row 2"),
        (_with("actions", (1, 0), np.inf), "log: column actions has inf in row 1"),
        (_with("rewards", 3, np.nan), "log: column rewards has nan in row 3"),
        (_with("rewards", 3, 1e300), "log: column rewards has a number in row 3 that float32 cannot hold"),
        (_with("terminals", 1, 2), "log: column terminals has 2.0 in row 1, 0 or 1 is needed"),
        (_with("timeouts", 1, 0.5), "log: column timeouts has 0.5 in row 1, 0 or 1 is needed"),
        ({"rewards": np.zeros(3)}, "log: column rewards has 3 rows, actions have 4"),
        ({"rewards": np.zeros((4, 2))}, r"log: column rewards has shape \(4, 2\), one value per row is needed"),
        ({"goal": np.zeros(5)}, "log: column goal has 5 rows, actions have 4"),
        ({"goal": np.array(list("abcd"))}, "log: column goal holds <U1, numbers are needed"),
        ({"actions": np.zeros((0, 1))}, "log: the log has no rows"),
        ({"actions": np.float32(1)}, "log: the log has no rows"),
        ({"final_observations": np.zeros((2, 2))}, r"final_observations have shape \(2, 2\), \(1, 2\) is needed"),
        ({"final_observations": np.full((1, 2), np.nan)}, "final_observations has nan in row 0"),
        ({"final_observations": np.zeros((1, 2)), "final_known": [1, 1]}, "final_known has 2 values, 1 are needed, one per"),
        ({"next_observations": np.zeros((4, 3))}, r"next_observations have shape \(4, 3\), observations \(4, 2\)"),
        ({"actions": np.array([0, 1, 5, 0]), "action_space": Discrete(3)}, r"actions has 5 in row 2, 0 .. 2 is needed"),
        ({"actions": np.array([0, 2**32 + 1, 0, 0]), "action_space": Discrete(3)}, "4294967297 in row 1, 0 .. 2 is"),
        ({"actions": np.array([0, 5_000_000, 0, 0])}, "up to 5000000, at most 1,000,000 discrete actions"),
        ({"actions": np.array([0, 1.5, 0, 0]), "action_space": Discrete(3)}, "actions has 1.5 in row 1, an integer"),
        ({"action_space": Box((-1, -1), (1, 1))}, "actions have 1 dimensions, the bounds have 2"),
        ({"actions": np.full((4, 1), 2.0), "action_space": Box((-1,), (1,)), "strict": True}, "4 of 4 rows .* first row 0"),
    ],
)
def test_bad_columns_are_named_in_one_line(changed, words):
    with pytest.raises(UserError, match=words) as caught:
        Dataset.from_arrays(**_columns(**changed), name="log")
    assert "\n" not in str(caught.value)


def test_bounds_are_floats_whatever_was_given():
    assert Box((-1,), (1,)) == Box((-1.0,), (1.0,))
    assert repr(Box((-1,), (1,))) == repr(Box((-1.0,), (1.0,)))
    with pytest.raises(UserError, match="low < high"):
        Box((1,), (1,))


def test_strict_refuses_actions_out_of_the_logs_own_bounds():
    log = make_log().with_action_space(Box((-0.1, -0.1), (0.1, 0.1)))
    assert log.with_action_space(log.action_space) is log
    with pytest.raises(UserError, match=r"small: \d+ of 13 rows .* have actions out of bounds"):
        log.with_action_space(log.action_space, strict=True)
    fine = make_log()
    assert fine.with_action_space(fine.action_space, strict=True) is fine


def test_probabilities_are_not_taken_for_their_logarithms(tmp_path):
    from deadreckon.data.formats.io import convert, read

    rows = 13
    sure = np.zeros(rows)
    sure[4] = 9e-7  # rounding
    make_log(discrete=True, behavior_log_probs=sure)
    make_log(behavior_log_probs=np.full(rows, 2.5))  # a density may be above one
    like = "all values lie in 0 .. 1 and look like probabilities, give their logarithms"
    words = "^small: column behavior_log_probs has 0.25 in row 0, a log-probability of a discrete action is <= 0"
    with pytest.raises(UserError, match=f"{words}; {like}$"):
        make_log(discrete=True, behavior_log_probs=np.linspace(0.25, 1, rows))
    mixed = np.where(np.arange(rows) == 7, 0.5, -1.0)
    for column in (mixed, mixed[:, None]):
        with pytest.raises(UserError, match=r"has 0.5 in row 7, a log-probability of a discrete action is <= 0$"):
            make_log(discrete=True, behavior_log_probs=column)
    for value in (np.nan, np.inf, -np.inf):
        for discrete in (True, False):
            never = ", as if the logged action had had no probability" if value == -np.inf else ""
            with pytest.raises(UserError, match=f"column behavior_log_probs has {value} in row 7{never}$"):
                make_log(discrete=discrete, behavior_log_probs=np.where(np.arange(rows) == 7, value, -1.0))
    # Files come through the same door.
    log = make_log(discrete=True)
    columns = {"observations": log.observations, "actions": log.actions, "rewards": log.rewards}
    np.savez(tmp_path / "log.npz", **columns, behavior_log_probs=np.full(rows, 0.5))
    with pytest.raises(UserError, match=like):
        read(tmp_path / "log.npz")
    with pytest.raises(UserError, match=like):
        convert(tmp_path / "log.npz", tmp_path / "out")
    table = {"action": [0, 1, 0], "reward": [0.0] * 3, "x": [0.0] * 3, "p": [0.5, 0.25, 0.5]}
    assert Dataset.from_frame(table, action="action", reward="reward", propensity="p").extras["behavior_log_probs"].max() < 0


@pytest.mark.parametrize("constant", [0.0, 2.5e7, -1e20])
def test_an_action_that_never_moves_has_bounds_that_float32_holds(constant):
    """A pressure of 25 MPa in Pa: bounds of one more and one less were the same numbers, and normalised actions NaN."""
    actions = np.stack([np.linspace(-1, 1, 4), np.full(4, constant)], 1)
    log = Dataset.from_arrays(observations=np.zeros((4, 1)), actions=actions, rewards=np.zeros(4), terminals=np.ones(4))
    unit = np.asarray(Normalizer.of(log.spec, False).to_unit(log.actions))
    assert np.isfinite(unit).all()
    np.testing.assert_allclose(unit[:, 1], 0.0, atol=0.1)
