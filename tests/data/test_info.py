import re

import numpy as np
import pytest
from small_logs import images, make_log

from deadreckon.data.dataset import Dataset
from deadreckon.data.info import _quantiles, _quantiles_of, describe, render, warnings_for
from deadreckon.data.spec import Box, Discrete


def test_the_numbers(log):
    info = describe(log)
    assert (info.rows, info.episodes, info.dropped) == (13, 4, 0)
    assert info.lengths == (1.0, 2.5, 3.5, 4.25, 5.0)
    assert (info.terminal_share, info.timeout_share) == (0.5, 0.5)
    np.testing.assert_allclose(info.mean_return, log.returns().mean())
    np.testing.assert_allclose(info.returns[0], log.returns().min())
    assert info.constant_observations == ()
    assert info.repeats.many == 0
    assert info.fingerprint == log.fingerprint
    text = render(info, warnings_for(log, info))
    assert "13 in 4 episodes" in text
    assert "! 1 episode has one step only" in text


def test_every_kind_of_log_can_be_described(variant):
    assert render(describe(variant), warnings_for(variant))
    assert describe(images()).observation_dtype == "uint8"


def _log(**changed):
    rng = np.random.default_rng(0)
    columns = {
        "observations": rng.normal(size=(40, 3)), "actions": rng.uniform(-0.9, 0.9, (40, 2)), "rewards": rng.normal(size=40),
        "terminals": np.isin(np.arange(40), (6, 17, 39)), "action_space": Box((-1, -1), (1, 1)),
    }  # fmt: skip
    return Dataset.from_arrays(**{**columns, **changed})


def test_a_good_log_gives_no_advice():
    assert warnings_for(_log()) == ()


def _observations(scale):
    return np.random.default_rng(0).normal(size=(40, 3)) * scale


@pytest.mark.parametrize("rows", [1, 2, 3, 4, 5, 1000])
def test_quantiles_of_a_column(rows):
    column = np.random.default_rng(rows).normal(size=rows).astype(np.float32)
    assert _quantiles_of(column) == _quantiles(column)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"terminals": np.arange(40) == 39}, "one single episode"),
        ({"terminals": np.arange(40) % 10 == 9}, "all 4 terminal episodes have 10 steps: if that is a time limit"),
        ({"terminals": np.isin(np.arange(40), (6, 17)), "timeouts": np.arange(40) % 4 == 0}, "of the rows have neither"),
        (
            {"rewards": np.full(40, 2.0), "terminals": np.zeros(40), "timeouts": np.isin(np.arange(40), (6, 17, 39))},
            "all rewards are 2",
        ),
        ({"rewards": np.zeros(40)}, "all rewards are 0"),
        ({"rewards": np.arange(40) % 4 == 0}, r"mostly zero \(75%"),
        ({"rewards": np.arange(40.0) * 1000}, r"rewards are 2.27e\+04 in size .*--agent.reward-scale 0.0001"),
        ({"rewards": np.arange(40.0) * 1e-6}, "rewards are 2.27e-05 in size .*--agent.reward-scale 10000"),
        ({"observations": _observations([1, 0, 1])}, "never change: 1;"),
        ({"observations": _observations([1, 1e6, 1])}, "observation 1 is .* in size .* standardise observations"),
        ({"actions": np.sign(_observations(1)[:, :2])}, "100% of the action entries are at the bounds"),
        ({"actions": np.full((40, 2), 3.0)}, "actions out of bounds"),
        ({"actions": np.arange(40) % 2, "action_space": Discrete(5)}, "3 of 5 actions never occur"),
        ({"observations": np.zeros((40, 3)), "actions": np.zeros((40, 2)), "rewards": np.arange(40) % 2}, "repeat an earlier"),
        ({"next_observations": _observations(2), "timeouts": np.zeros(40)}, "37 rows have a next observation that"),
    ],
)
def test_advice(changed, words):
    log = _log(**changed)
    lines = warnings_for(log)
    assert any(__import__("re").search(words, line) for line in lines), lines
    assert not any("\n" in line for line in lines)


def test_a_table_that_was_stored_twice_is_told_and_equal_people_are_not():
    rng = np.random.default_rng(0)
    once = {"x": rng.normal(size=200), "act": rng.integers(0, 2, 200), "reward": rng.normal(size=200)}
    twice = {name: np.tile(values, 2) for name, values in once.items()}
    told = [line for line in warnings_for(Dataset.from_frame(twice, action="act", reward="reward")) if "repeat" in line]
    words = "if a part of the table was stored twice, leave the copies out; until then, equal episodes are held out together"
    assert told == [f"200 of 400 rows repeat an earlier one, in the same order: {words} and counted as one"]
    order = rng.permutation(400)
    mixed = {name: values[order] for name, values in twice.items()}
    told = [line for line in warnings_for(Dataset.from_frame(mixed, action="act", reward="reward")) if "repeat" in line]
    assert "completely, although nearly all others differ: if the table was stored twice, leave the copies out" in told[0]
    rounded = {"age": rng.integers(20, 60, 900), "gain": rng.integers(0, 40, 900) / 2}
    rounded |= {"act": rng.integers(0, 2, 900), "reward": rng.integers(0, 9, 900)}
    overlap = {name: np.append(values, values[-100:]) for name, values in rounded.items()}
    assert "in the same order" in str(warnings_for(Dataset.from_frame(overlap, action="act", reward="reward")))
    assert "repeat" not in str(warnings_for(Dataset.from_frame(rounded, action="act", reward="reward")))
    people = {"age": rng.integers(20, 30, 400), "act": rng.integers(0, 2, 400), "reward": rng.integers(0, 2, 400)}
    prices = {"price": rng.integers(1, 40, 400) / 4, "act": rng.integers(0, 2, 400), "reward": rng.integers(0, 2, 400)}
    for honest in (once, people, prices):
        assert "repeat" not in str(warnings_for(Dataset.from_frame(honest, action="act", reward="reward")))


def test_users_whose_rows_follow_each_other_are_told_if_no_column_names_them():
    rng = np.random.default_rng(0)
    user = np.repeat(np.arange(40), 10)
    columns = {"age": rng.normal(size=40)[user] + rng.normal(size=400), "noise": rng.normal(size=400)}
    columns |= {"act": rng.integers(0, 2, 400), "reward": rng.normal(size=400), "user": user}
    read = lambda order, **how: Dataset.from_frame(  # noqa: E731
        {name: column[order] for name, column in columns.items()}, action="act", reward="reward",
        observations=["age", "noise"], **how,
    )  # fmt: skip
    told = [line for line in warnings_for(read(np.arange(400))) if "episode before" in line]
    assert len(told) == 1
    assert "episodes begin like the episode before (rank correlation of age: 0." in told[0]
    assert "name its column (--group)" in told[0]
    assert "episode before" not in str(warnings_for(read(np.arange(400), group="user")))
    assert "episode before" not in str(warnings_for(read(rng.permutation(400))))


def test_users_with_the_same_features_in_all_their_rows_are_told():
    """They come and go, so that neighbours are not alike."""
    rng = np.random.default_rng(0)
    user = rng.integers(0, 200, 800)
    columns = {"income": rng.normal(size=200)[user], "act": rng.integers(0, 2, 800), "reward": rng.integers(0, 2, 800)}
    columns |= {"user": user}
    read = lambda **how: Dataset.from_frame(  # noqa: E731
        columns | how.pop("more", {}), action="act", reward="reward", observations=["income"], **how
    )  # fmt: skip
    told = [line for line in warnings_for(read()) if "of one user" in line]
    assert len(told) == 1
    assert told[0].startswith("76% of the episodes begin exactly as an earlier one: if these are of one user or machine")
    assert "of one user" not in str(warnings_for(read(group="user")))
    for others in ({"income": rng.normal(size=800)}, {"income": rng.integers(0, 200, 800)}):
        assert "of one user" not in str(warnings_for(read(more=others)))


@pytest.mark.parametrize("seed", range(3))
def test_propensities_of_another_action_are_told(seed):
    """Those of action 0 in all rows; right ones are not accused, also where they are small or some actions are impossible."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=2_000)
    chances = np.exp(np.stack([2 * x, 0 * x, -2 * x, 0 * x - 9], 1))
    chances[x > 1, 1] = 0
    chances /= chances.sum(1, keepdims=True)
    act = (chances.cumsum(1) > rng.random((2_000, 1))).argmax(1)
    table = {"x": x, "act": act, "reward": rng.normal(size=2_000), "p": chances[np.arange(2_000), act]}
    wrong = table | {"p": np.maximum(chances[:, 0], 1e-4)}
    words = "propensities are too small"
    right, other = (Dataset.from_frame(each, action="act", reward="reward", propensity="p") for each in (table, wrong))
    assert words not in str(warnings_for(right))
    assert words in str(warnings_for(other))


def test_a_time_limit_among_other_ends():
    log = make_log((3, 5, 9, 9, 2, 9, 4, 9, 7, 9, 9, 1), terminal=(True,))
    assert any("50% of the terminal episodes have the longest length, 9" in line for line in warnings_for(log))


def test_a_constant_reward_teaches_something_where_episodes_can_end_sooner_or_later():
    assert warnings_for(_log(rewards=np.full(40, 2.0))) == ()


def test_sparse_rewards():
    rewards = np.zeros(400)
    rewards[5] = 1
    log = Dataset.from_arrays(
        observations=np.random.default_rng(0).normal(size=(400, 1)), actions=np.zeros((400, 1)), rewards=rewards
    )
    assert any("rewards are sparse: 0.25% of the rows have one" in line for line in warnings_for(log))


def test_rewards_that_pile_up_at_a_value_are_told_by_action():
    rng = np.random.default_rng(0)
    action, rewards = rng.integers(0, 2, 1_000), rng.normal(80, 20, 1_000)

    def lines(rewards):
        frame = {"x": rng.normal(size=1_000), "action": np.where(action, "b", "a"), "reward": rewards}
        return [line for line in warnings_for(Dataset.from_frame(frame)) if "cut off" in line]

    (line,) = lines(np.where(action, rewards + 15, rewards).clip(max=100))
    assert re.match(r".* of the rewards are 100, the largest value \(1\d\.\d% of those of a, 4\d\.\d% of those of b\):", line)
    (line,) = lines(np.where(action & (rng.random(1_000) < 0.2), 80.5, rewards))
    assert "are 80.5, a value between others (0.0% of those of a, 2" in line
    for fine in (rewards, np.where(action, 0.0, rewards), rng.poisson(80, 1_000), np.round(rewards), rng.integers(0, 2, 1_000)):
        assert not lines(fine)


def test_running_totals_are_told():
    rng = np.random.default_rng(0)

    def told(rewards):
        rows = rewards.size
        frame = {"episode": np.repeat(np.arange(len(rewards)), rewards.shape[1]), "x": rng.normal(size=rows)}
        log = Dataset.from_frame(frame | {"action": rng.integers(0, 2, rows), "reward": rewards.ravel()})
        return any("rewards add up within episodes" in line for line in warnings_for(log))

    normal = (rng.normal(mean, 1, (40, 12)) for mean in (0, 1))
    for added in (*normal, rng.poisson(2, (40, 5)), -rng.exponential(1, (40, 8))):
        assert told(added.cumsum(1))
        assert not told(added)
        assert not told(added.cumsum(1)[:, :3])  # too short
        assert not told(added.cumsum(1)[:9])  # too few
        assert not told(10 + added.cumsum(1))  # which begins elsewhere
    for memory in (0.5, 0.75, 0.9, 0.97):  # slow states
        state = rng.normal(size=(400, 20)) * np.sqrt(1 - memory**2)
        state[:, 0] /= np.sqrt(1 - memory**2)
        for step in range(1, 20):
            state[:, step] += memory * state[:, step - 1]
        assert not told(state)
    for memory, steps in ((0.8, 20), (0.95, 200)):  # states that begin at rest
        state = rng.normal(size=(100, steps))
        for step in range(1, steps):
            state[:, step] += memory * state[:, step - 1]
        assert not told(state)
    assert not told(np.repeat(rng.normal(size=(40, 1)), 12, 1))
    assert not told(np.zeros((40, 12)))


def test_costs_are_no_rewards_to_maximise():
    """Larger is better: what a column of costs is called is the only sign of its direction."""
    frame = {"x": np.arange(30.0), "action": np.arange(30) % 2, "cost_eur": np.arange(30.0), "closs": np.arange(30.0)}
    more = {"TotalCost": True, "cost_savings": False, "churned": True, "no_churn": False, "daysToRecovery": True, "day": False}
    frame |= dict.fromkeys(more, frame["cost_eur"])
    names = ["cost_eur", "closs", *more]
    for name, told in zip(names, (True, False, *more.values())):
        other = [each for each in names if each != name]
        log = Dataset.from_frame(frame, action="action", reward=name, ignore=other)
        assert any("negate it if smaller is" in line for line in warnings_for(log)) is told
    log = Dataset.from_frame({**frame, "cost_eur": -frame["cost_eur"]}, action="action", reward="cost_eur", ignore=names[1:])
    assert not any("negate it" in line for line in warnings_for(log))


@pytest.mark.parametrize(
    ("cell", "told"),
    [
        (lambda i: f"{i},5 C", "leave units out of the cells and give --decimal comma"),
        (lambda i: f"{i} kg", "leave units out of the cells"),
        (lambda i: f"{i + 1},000 kg", "leave units out of the cells and give --thousands comma"),
        (lambda i: f"{1 + i % 28:02d}.{1 + i % 12:02d}.2020", None), (lambda i: f"{i:05d}-AB", None),
        (lambda i: f"{i}{'abc'[i % 3]}", None),
        (lambda i: f"item {i}", None), (lambda i: f"{i % 19} kg", None),
    ],
)  # fmt: skip
def test_texts_that_are_numbers_with_units_are_told(cell, told):
    """They were read as so many levels, without a word."""
    frame = {"x": [cell(i) for i in range(40)], "y": np.arange(40.0), "action": np.arange(40) % 2, "reward": np.arange(40.0)}
    warnings = Dataset.from_frame(frame, action="action", reward="reward").warnings
    lines = [line for line in warnings if "begin with a number" in line]
    assert (not lines) if told is None else (told in lines[0])


def test_totals_of_episodes_in_all_of_their_rows_are_told():
    rng = np.random.default_rng(0)
    totals = np.repeat(rng.normal(size=30), 5)
    ends = np.arange(150) % 5 == 4
    for rewards, told in ((totals, True), (totals + 0.1 * rng.normal(size=150), False), (np.where(ends, totals, 0.0), False)):
        log = Dataset.from_arrays(
            observations=rng.normal(size=(150, 2)), actions=np.arange(150) % 2, rewards=rewards, terminals=ends
        )
        assert any("give it in the last row alone" in line for line in warnings_for(log)) is told
