"""The Flow recipes and the controllers."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.collect import recipe, references
from deadreckon.collect.flow import FollowerStopper, Idm, PISaturation
from deadreckon.collect.references import controlled_returns
from deadreckon.data.catalogue import entry
from deadreckon.tasks import task
from deadreckon.tasks.flow_roads import Ring

sumo = pytest.mark.skipif(find_spec("libsumo") is None, reason="SUMO is not installed (the extra `flow`)")
NAMES = [f"flow-{road}-{kind}-v0" for road in ("ring", "merge") for kind in ("random", "controller")]


def ring(speed, leading, gap):
    """An observation."""
    return np.array([[speed / 15, (leading - speed) / 15, (gap + 5) / 270]], np.float32)


def test_every_log_has_a_recipe():
    for name in NAMES:
        assert recipe(name).steps == entry(name).rows == 1_000_000
        assert entry(name).original.endswith(("random.hdf5", "idm.hdf5"))


@sumo
@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n == NAMES[0] else pytest.mark.slow) for n in NAMES])
def test_short_logs(name):
    steps = 230 if "ring" in name else 700  # two episodes and a part, and a part of one
    log = dr.collect.generate(name, steps=steps)
    found = task(recipe(name).task)
    assert len(log) == steps
    assert log.observations.shape[1:] == found.observation_shape
    ends = [*range(found.horizon - 1, steps - 1, found.horizon), steps - 1]
    np.testing.assert_array_equal(np.flatnonzero(log.timeouts), ends)
    assert not log.terminals.any()
    bound = found.action_space.high[0]
    assert np.abs(log.actions).max() <= bound
    if "random" in name:
        np.testing.assert_allclose(log.extras["behavior_log_probs"], -found.action_space.size * np.log(2 * bound), rtol=1e-6)
        assert log.actions.std() == pytest.approx(bound / np.sqrt(3), rel=0.1)
    else:
        assert "behavior_log_probs" not in log.extras
        np.testing.assert_array_equal(log.actions, Idm(found)(log.observations))
        assert np.ptp(log.actions) > 0.5
    assert log.provenance.recipe == name
    # What the seed and the episodes' numbers make: the same again, and the beginning of a longer log.
    simulator = found.simulate([int(np.random.SeedSequence([0, 0, 0]).generate_state(1, np.uint64)[0])])
    np.testing.assert_array_equal(simulator.reset()[0], log.observations[0])
    for t in range(20):
        seen, rewards, *_ = simulator.step(log.actions[t : t + 1])
        np.testing.assert_array_equal(seen[0], log.observations[t + 1])
        assert rewards[0] == log.rewards[t]


def test_idm_by_hand():
    controller = Idm(task("flow-ring"))
    for speed, leading, gap in ((0.0, 0.0, 20.0), (5.0, 4.0, 12.0), (5.0, 9.0, 12.0), (8.0, 8.0, 10.0)):
        wanted = 2.0 + max(0.0, speed * 1.0 + speed * (speed - leading) / (2 * np.sqrt(1.0 * 1.5)))
        expected = 1.0 - (speed / 30.0) ** 4 - (wanted / gap) ** 2
        np.testing.assert_allclose(controller(ring(speed, leading, gap)), [[max(expected, -1.0)]], atol=1e-5)
    seen = np.zeros((1, 25), np.float32)  # on the merge, the second of two learners has nobody before it
    seen[0, :10] = [0.2, -0.1, 0.01, 0, 0.01, 0.2, 0.8, 1.0, 0, 0.01]
    action = Idm(task("flow-merge"))(seen)[0]
    assert action[0] == -1.5
    assert action[1] == pytest.approx(1.0 - 0.2**4, abs=1e-3)
    assert not action[2:].any()


def test_follower_stopper_by_hand():
    """The three regions of Stern et al. 2018, where nobody closes in: below 4.5 m, to 5.25, to 6, and beyond."""
    controller = FollowerStopper(replace(task("flow-ring")), 6.0)
    for gap, leading, command in (
        (4.0, 5.0, 0.0), (4.875, 5.0, 2.5), (4.875, 9.0, 3.0), (5.625, 5.8, 5.9), (5.625, 9.0, 6.0), (7.0, 5.9, 6.0),
        (7.0, 9.0, 6.0),
    ):  # fmt: skip
        speed = abs(command - 0.25)  # so that half a second's acceleration is within the bounds
        assert speed <= leading  # a lower speed of the leader widens the regions
        np.testing.assert_allclose(controller(ring(speed, leading, gap)), [[2 * (command - speed)]], atol=1e-4)
    # Half a metre per second slower: 5.25 + 0.5^2 / 2 and 6 + 0.5^2.
    np.testing.assert_allclose(controller(ring(4.5, 4.0, 5.5)), [[2 * (4 + 2 * 0.125 / 0.875 - 4.5)]], atol=1e-4)
    assert controller(ring(3.0, 3.0, 4.0)) == -1.0
    assert controller(ring(6.0, 4.0, 6.0)) == -1.0  # 4.5 + 2^2 / 3 is not above 6, but 6 + 2^2 is


def test_pi_with_saturation_keeps_its_mean_speed():
    controller = PISaturation(task("flow-ring"))
    steady = ring(5.0, 5.0, 7.0)  # a gap at which it does not catch up
    for _ in range(60):
        action = controller(steady)
    np.testing.assert_allclose(action, 0.0, atol=1e-4)
    assert controller(ring(5.0, 5.0, 30.0)) > 0.9  # it catches up
    assert len(controller.speeds) == 61 < PISaturation.WINDOW / 0.5


@pytest.mark.slow
@sumo
def test_what_the_scores_are_made_of(monkeypatch):
    """Ten episodes of each give what the table says, within five standard errors."""
    monkeypatch.setattr(references, "EPISODES", 10)
    ring_task = task("flow-ring")
    random, expert = references.measure(ring_task)
    wanted = ring_task.reference
    assert random == pytest.approx(wanted.random, abs=5 * 16 / np.sqrt(10))
    assert expert == pytest.approx(wanted.expert, abs=5 * 19 / np.sqrt(10))
    drivers = controlled_returns(ring_task, Idm(ring_task), range(10))
    assert wanted.random < drivers.mean() < wanted.expert
    assert Ring.CARS == 22
