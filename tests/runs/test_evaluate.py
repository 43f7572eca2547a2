"""What an evaluation in a simulator refuses before it begins."""

import dataclasses

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.policies import BlackBoxPolicy
from deadreckon.runs.evaluate import Evaluation, evaluate
from deadreckon.tasks import task
from deadreckon.tasks.driving import LaneDriving
from deadreckon.tasks.turns import first_observations

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


def test_every_policy_has_a_name():
    with pytest.raises(UserError, match="2 policies need as many names, got 1"):
        evaluate([STILL, STILL], "maze2d-umaze", episodes=1, names=["one"])


@pytest.mark.parametrize(("name", "theirs"), [("maze2d-umaze", 100.0), ("hopper", None), ("maze2d-eval-large-dense", None)])
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


class FewCopies(LaneDriving):
    """Driving with no more than three cars side by side."""

    most_copies = 3

    def simulate(self, seeds, threads=None):
        assert len(seeds) <= self.most_copies
        simulator = super().simulate(seeds)
        simulator.close = lambda: closed.append(len(seeds))
        return simulator


closed: list[int] = []
DRAWN = BlackBoxPolicy(lambda seen, rng: rng.uniform(-1, 1, (len(seen), 2)) * [0.0, 0.8] + [1.0, 0.0])


def test_episodes_in_turns_are_those_side_by_side():
    closed.clear()
    given = {each.name: getattr(task("carla-lane-state"), each.name) for each in dataclasses.fields(LaneDriving)}
    given |= {"horizon": 120}
    run = [evaluate([STILL, DRAWN], of(**given), episodes=4, seed=3, record=2) for of in (LaneDriving, FewCopies)]
    assert closed == [3]
    for name in ("returns", "discounted", "lengths", "trajectories"):
        np.testing.assert_array_equal(*(getattr(each, name) for each in run))
    assert run[0].trajectories.shape == (2, 2, 120, 8)
    assert (run[0].lengths[0] == 120).all()
    assert len(set(run[0].lengths[1].tolist())) > 1  # turns end at different times
    np.testing.assert_array_equal(*(first_observations(of(**given), range(7)) for of in (LaneDriving, FewCopies)))


class SeedsAlone(LaneDriving):
    """A user's task, whose simulator takes no threads."""

    def simulate(self, seeds):
        return super().simulate(seeds)


def test_a_users_task_may_take_seeds_alone():
    given = {each.name: getattr(task("carla-lane-state"), each.name) for each in dataclasses.fields(LaneDriving)}
    given |= {"horizon": 20}
    run = [evaluate(DRAWN, of(**given), episodes=2, seed=3) for of in (LaneDriving, SeedsAlone)]
    np.testing.assert_array_equal(*(each.returns for each in run))


class NothingAfterEnds(LaneDriving):
    """Driving whose rewards are no numbers once an episode is over."""

    def simulate(self, seeds, threads=None):
        simulator, over = super().simulate(seeds), np.zeros(len(seeds), bool)
        plain = simulator.step

        def step(actions):
            seen, rewards, terminals, timeouts = plain(actions)
            rewards = np.where(over, np.nan, rewards)
            over[:] |= terminals | timeouts
            return seen, rewards, terminals, timeouts

        simulator.step = step
        return simulator


def test_rewards_after_an_episodes_end_are_not_looked_at():
    class Paid(BlackBoxPolicy):
        def act(self, step, carry, key, *, greedy=False):
            assert np.isfinite(step.reward).all()
            return super().act(step, carry, key, greedy=greedy)

    given = {each.name: getattr(task("carla-lane-state"), each.name) for each in dataclasses.fields(LaneDriving)}
    given |= {"horizon": 120}
    run = [evaluate(Paid(DRAWN.fn), of(**given), episodes=4, seed=3) for of in (LaneDriving, NothingAfterEnds)]
    assert len(set(run[0].lengths[0].tolist())) > 1
    for name in ("returns", "discounted", "lengths"):
        np.testing.assert_array_equal(*(getattr(each, name) for each in run))


def test_a_simulator_is_closed_whatever_happens():
    closed.clear()
    given = {each.name: getattr(task("carla-lane-state"), each.name) for each in dataclasses.fields(LaneDriving)}

    def interrupted(seen, rng):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate(BlackBoxPolicy(interrupted), FewCopies(**given), episodes=4)
    assert closed == [3]
