"""Planted leaks are told by name, and tables without any are not accused."""

import re

import numpy as np
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.leaks import leaks
from deadreckon.data.spec import Discrete

STEPS, EPISODES = 20, 60


def table(seed=0, **more):
    """An honest table: a state that moves, an action drawn at random, a reward of both with noise."""
    rng = np.random.default_rng(seed)
    rows = STEPS * EPISODES
    state, act = np.zeros(rows), rng.integers(0, 2, rows)
    for row in range(rows):
        state[row] = rng.normal() if row % STEPS == 0 else 0.7 * state[row - 1] + act[row - 1] + 0.3 * rng.normal()
    reward = state * (2 * act - 1) + 0.2 * rng.normal(size=rows)
    frame = {"day": np.repeat(np.arange(EPISODES), STEPS), "state": state, "noise": rng.normal(size=rows),
             "act": act, "reward": reward}  # fmt: skip
    frame |= {name: make(frame) for name, make in more.items()}
    return frame


def read(frame, **more):
    return Dataset.from_frame(frame, action="act", reward="reward", episode="day", **more)


def shifted(values, by):
    """The values `by` rows earlier of the same episode, 0 before its first."""
    out = np.zeros_like(values)
    out.reshape(EPISODES, STEPS)[:, by:] = values.reshape(EPISODES, STEPS)[:, :-by]
    return out


@pytest.mark.parametrize(("change", "words"), [
    (lambda reward: 3 * reward + 3e3, "0.3333 times it - 1000 in"), (lambda reward: -reward, "-1 times it in"),
    (lambda reward: reward.copy(), "equal to it in"), (lambda reward: 1e-3 * reward - 5, "1000 times it + 5000 in"),
])  # fmt: skip
def test_offsets_of_float32_do_not_hide_a_reward(change, words):
    frame = table(bill=lambda frame: change(frame["reward"]))
    told = [line for line in leaks(read(frame)) if "by another name" in line]
    assert [words in line for line in told] == [True], told
    frame["bill"] = frame["bill"] + 0.01 * np.std(frame["bill"]) * np.random.default_rng(1).normal(size=len(frame["bill"]))
    assert leaks(read(frame)) == ()  # what tells it nearly, as states do, is not accused


def cured(seed, sign=1.0, every=0.0):
    """An honest table whose last reward shows how the episode ended, which a column has in all rows."""
    frame = table(seed)
    ended = np.random.default_rng(seed).integers(0, 2, EPISODES)
    end = np.arange(STEPS * EPISODES) % STEPS == STEPS - 1
    frame["reward"] = frame["reward"] + np.repeat(ended, STEPS) * np.where(end, 6.0 * sign, every)
    return frame | {"cured": np.repeat(ended, STEPS), "days": np.repeat(10 + ended, STEPS)}


def test_the_outcome_of_an_episode_in_all_of_its_rows_is_told():
    for seed in range(3):
        lines = leaks(read(cured(seed)))
        assert [line.partition(" may be")[0] for line in lines] == ["column cured", "column days"]
        assert all("the same in all rows, and explains " in line for line in lines)
        assert leaks(read(cured(seed, sign=0.1))) == ()  # what tells it in part, as the state at the start does
        assert leaks(read(cured(seed, every=3.0))) == ()  # what matters from the start on is known then
        few = {name: values[: 40 * STEPS] for name, values in cured(seed).items()}
        assert leaks(read(few)) == ()
    alone, end = cured(0), np.arange(STEPS * EPISODES) % STEPS == STEPS - 1
    for noise in (0.1, 0.25):  # where no other rewards are, known contexts explain much
        alone["reward"] = np.where(end, alone["cured"] + noise * alone["noise"], 0.0)
        assert any("outcome" in line for line in leaks(read(alone))) == (noise == 0.1)
    numbers = cured(0)
    numbers["cured"] = numbers["cured"] + np.repeat(np.random.default_rng(1).uniform(0, 0.2, EPISODES), STEPS)
    assert "column cured may be the outcome" in leaks(read(numbers))[0]  # many values


@pytest.mark.parametrize("seed", range(3))
def test_an_honest_table_is_not_accused(seed):
    assert leaks(read(table(seed))) == ()


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("bill", lambda f: f["reward"], "column bill may be the reward by another name: equal to it"),
        ("cents", lambda f: 100 * f["reward"] - 3, "column cents may be the reward"),
        ("rank", lambda f: np.exp(f["reward"] / 4), "column rank may be the reward"),
        ("valve", lambda f: 1.0 - f["act"], "column valve may come after the action: it tells act"),
        ("label", lambda f: np.where(f["act"] == 1, "open", "shut"), "column label may come after the action: it tells act"),
        ("then", lambda f: np.append(f["state"][1:], 0.0), "column then equals the next row's state"),
    ],
)
def test_a_planted_column_is_told_by_name(name, make, words):
    found = leaks(read(table(**{name: make})))
    assert len(found) == 1, found
    assert words in found[0]


def test_a_next_value_that_is_empty_in_last_rows_is_told_wherever_episodes_begin():
    frame = table()
    walk = np.random.default_rng(5).normal(size=(EPISODES, STEPS))
    walk[:, 0] = 0.0
    place = walk.cumsum(1)
    ahead = np.concatenate([place[:, 1:], np.full((EPISODES, 1), np.nan)], 1)
    assert (
        "column next_info equals the next row's place"
        in leaks(read(frame | {"place": place.ravel(), "next_info": ahead.ravel()}))[0]
    )


def emptied(values, share, seed=9):
    """The values with some of them missing."""
    gone = np.random.default_rng(seed).random(len(values)) < share
    return np.where(gone, np.nan, values)


@pytest.mark.parametrize("share", [0.005, 0.1])
def test_empty_cells_hide_no_leak(share):
    bill = {"bill": lambda f: emptied(1.19 * f["reward"], share)}
    label = {"label": lambda f: [v if k else None for v, k in zip(f["act"].astype(str), emptied(f["act"], share) >= 0)]}
    assert "bill may be the reward by another name: 0.8403 times it" in leaks(read(table(**bill)))[0]
    assert "where it is known" in leaks(read(table(**bill)))[0]
    assert "label may come after the action: it tells act" in leaks(read(table(**label), kinds={"label": "category"}))[0]


@pytest.mark.parametrize("round_reward", [False, True])
def test_rounding_hides_no_leak(round_reward):
    frame = table()
    if round_reward:
        frame["reward"] = np.round(frame["reward"], 2)
    frame["gross"] = np.round(1.1 * frame["reward"], 2)
    (found,) = leaks(read(frame))
    assert re.match(r"column gross may be the reward by another name: 0\.9\d+ times it . [\d.e-]+, rounded in all 1,200", found)
    noisy = table(gross=lambda f: np.round(1.1 * f["reward"] + 0.05 * np.random.default_rng(3).normal(size=len(f["act"])), 2))
    assert leaks(read(noisy)) == ()
    coarse = table(points=lambda f: np.round(f["reward"]))  # so coarse that it may be told by chance
    assert leaks(read(coarse)) == ()


def test_a_next_value_is_told_where_all_episodes_begin_alike():
    """A balance that begins at 100 everywhere; a column of earlier values that begins at 0 is not accused."""
    frame = table()
    walk = np.random.default_rng(5).normal(size=(EPISODES, STEPS))
    walk[:, 0] = 100.0
    account = walk.cumsum(1)
    frame |= {"account": account.ravel(), "after": np.append(account.ravel()[1:], 0.0)}
    assert "column after equals the next row's account" in leaks(read(frame))[0]


def test_a_column_of_earlier_values_is_no_leak():
    assert leaks(read(table(before=lambda f: shifted(f["state"], 1), last=lambda f: shifted(f["reward"], 1)))) == ()


@pytest.mark.parametrize("lag", [1, 3])
def test_a_late_reward_is_told_with_its_delay(lag):
    frame = table()
    (line,) = leaks(read({**frame, "reward": shifted(frame["reward"], lag)}))
    assert f"may arrive {lag} row" in line


def test_propensities_decide_whether_a_rule_without_chance_acted():
    rng = np.random.default_rng(0)
    actions = rng.integers(0, 2, 400)
    columns = {"observations": np.stack([actions, rng.normal(size=400)], 1), "actions": actions,
               "rewards": rng.normal(size=400), "terminals": np.ones(400, bool), "action_space": Discrete(2)}  # fmt: skip
    sure = Dataset.from_arrays(**columns, behavior_log_probs=np.zeros(400))
    drawn = Dataset.from_arrays(**columns, behavior_log_probs=np.full(400, np.log(0.5)))
    assert leaks(sure) == ()
    (line,) = leaks(drawn)
    assert "observation 0 may come after the action" in line
    assert "probability 1e-120" in line


def test_next_observations_that_repeat_the_observations():
    copied = table(next_state=lambda f: f["state"], next_noise=lambda f: f["noise"])
    (line,) = leaks(read(copied))
    assert "transitions never move" in line
    assert "next_state, next_noise" in line
    one = table(next_state=lambda f: np.append(f["state"][1:], 0.0), next_noise=lambda f: f["noise"])
    (line,) = leaks(read(one))
    assert line.startswith("next_noise equals noise of its own row")


def noise(seed):
    rng = np.random.default_rng(seed)
    rows = 600
    discrete = seed % 2 == 0
    frame = {"day": np.repeat(np.arange(30), 20), "act": rng.integers(0, 3, rows) if discrete else rng.normal(size=rows)}
    frame |= {f"x{i}": rng.normal(size=rows) for i in range(8)} | {f"c{i}": rng.integers(0, 2, rows) for i in range(8)}
    return frame | {"reward": rng.integers(0, 2, rows).astype(float) if seed % 3 else rng.normal(size=rows)}


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 20))])
def test_noise_is_not_accused(seed):
    assert leaks(read(noise(seed))) == ()


def test_a_chain_with_a_goal_and_a_balance_with_constant_rewards_are_not_accused():
    gymnasium = pytest.importorskip("gymnasium")
    rng = np.random.default_rng(0)
    for name in ("FrozenLake-v1", "CartPole-v1"):
        world = gymnasium.make(name)
        rows, n = [], int(world.action_space.n)
        for episode in range(150):
            seen, _ = world.reset(seed=episode)
            over = False
            while not over:
                action = int(rng.integers(n))
                after, reward, terminal, timeout, _ = world.step(action)
                over = terminal or timeout
                rows.append((seen, action, reward, terminal, timeout, after))
                seen = after
        seen, action, reward, terminal, timeout, after = (np.array(column) for column in zip(*rows))
        log = Dataset.from_arrays(
            observations=seen, actions=action, rewards=reward, terminals=terminal, timeouts=timeout & ~terminal,
            next_observations=after, action_space=Discrete(n),
        )  # fmt: skip
        assert leaks(log) == (), name


def test_long_logs_are_sampled():
    rng = np.random.default_rng(0)
    for ends in (None, np.arange(150_000) % 50 == 49):
        rewards = rng.normal(size=150_000)
        seen = np.stack([rng.normal(size=150_000), rewards], 1)
        columns = {"observations": seen, "actions": rng.integers(0, 3, 150_000), "rewards": rewards, "timeouts": ends}
        (line,) = leaks(Dataset.from_arrays(**columns))
        assert "observation 1 may be the reward" in line
        count = int(line.split(" in all ")[1].split()[0].replace(",", ""))
        assert 5_000 <= count <= 10_000


def single(rewards):
    """One-step log with these rewards."""
    rng, rows = np.random.default_rng(1), len(rewards)
    columns = {"observations": rng.normal(size=(rows, 2)), "actions": rng.integers(0, 2, rows), "rewards": rewards}
    return Dataset.from_arrays(**columns, terminals=np.ones(rows))


def arriving(late, rows=600, rare=0.3):
    """Successes, of which the `late` latest are not known yet and are stored as 0."""
    rewards = (np.random.default_rng(0).random(rows) < rare).astype(float)
    rewards[rows - late :] = 0.0
    return rewards


def test_rewards_that_are_not_known_yet_are_told():
    [line] = leaks(single(arriving(60)))
    assert re.fullmatch(
        r"the latest 6\d episodes have a return of 0, and 7\d% of the 5[34]\d before: if their rewards are not known yet, "
        "leave these episodes out", line,
    )  # fmt: skip


@pytest.mark.parametrize(
    "rewards",
    [
        arriving(0), arriving(20), arriving(600), arriving(40, rare=0.05),  # as long as other series of zeros
        np.r_[np.arange(594) % 2, np.zeros(6)], np.r_[np.random.default_rng(0).normal(size=1_999), 0.0],
        np.maximum(np.arange(300, -300, -1), 0), np.minimum(np.arange(-300, 300), 0),  # in the order of the rewards
        np.random.default_rng(0).permutation(arriving(60)),
        np.repeat(np.r_[np.arange(18) % 2, 1, 0], 30),  # rewards of a user are alike, and the last of them has none
    ],
    ids=["none", "few", "all", "rare", "six", "one", "falling", "rising", "shuffled", "users"],
)  # fmt: skip
def test_other_zeros_at_the_end_are_not_said_to_be_unknown(rewards):
    assert not [line for line in leaks(single(rewards)) if "return of 0" in line]
