"""The kitchen's demonstrator and its recipes."""

import numpy as np
import pytest

from deadreckon.collect import generate, kitchen, kitchen_demonstrator, recipe
from deadreckon.collect.kitchen_demonstrator import KNOWN, Demonstrator
from deadreckon.data.catalogue import load
from deadreckon.errors import UserError
from deadreckon.tasks import task
from deadreckon.tasks.kitchen import _FIRST


def demonstrate(elements, copies=1, steps=150):
    """(elements,) share of copies that have done each, as a demonstrator goes through them."""
    found = task("kitchen-mixed")
    simulator, leader = found.simulate(range(copies)), Demonstrator(copies)
    for copy in range(copies):
        leader.begin(copy, elements, np.random.default_rng(copy))
    seen, done = simulator.reset(), np.zeros((copies, len(elements)), bool)
    for _ in range(steps):
        actions = np.stack([leader.act(copy, seen[copy, :30].astype(float), found) for copy in range(copies)])
        assert np.abs(actions).max() <= 1.0
        seen, *_ = simulator.step(actions)
        done |= found.done(seen[:, :30].astype(float), elements)
        if all(leader.finished(copy) for copy in range(copies)):
            break
    return done.mean(0)


@pytest.mark.slow
def test_the_demonstrator_opens_the_microwave():
    assert demonstrate(["microwave"]).tolist() == [1.0]


@pytest.mark.slow
@pytest.mark.parametrize("element", KNOWN)
def test_the_demonstrator_can_do_what_it_knows(element):
    assert demonstrate([element], copies=8)[0] >= 0.6


def test_what_is_done_already_is_not_done_again():
    leader = Demonstrator(1)
    leader.begin(0, ["microwave"], np.random.default_rng(0))
    posture = _FIRST.copy()
    posture[22] = -0.75
    assert not leader.act(0, posture, task("kitchen-mixed")).any()
    assert leader.finished(0)


def test_errands_are_those_of_the_logs():
    def drawn(name):
        found = task(f"kitchen-{name}")
        return found, [kitchen._errand(found, number, np.random.default_rng(number)) for number in range(40)]

    complete, errands = drawn("complete")
    assert all(errand == list(complete.elements) for errand in errands)
    partial, errands = drawn("partial")
    solving = [set(errand) == set(partial.elements) for errand in errands]
    assert solving == [number % 4 == 0 for number in range(40)]
    mixed, errands = drawn("mixed")
    assert not any(set(errand) == set(mixed.elements) for errand in errands)
    assert all(len(set(errand)) == 4 for errand in errands)


@pytest.fixture
def short(monkeypatch):
    """Recipes with two episodes side by side, each with two sub-tasks that are quickly done, and one that nobody wants."""
    monkeypatch.setattr(kitchen, "BATCH", 2)
    quick = {"microwave": kitchen_demonstrator.PLANS["microwave"][:2], "kettle": kitchen_demonstrator.PLANS["kettle"][:1]}
    monkeypatch.setattr(kitchen_demonstrator, "PLANS", {name: quick.get(name, quick["kettle"]) for name in KNOWN})


@pytest.mark.parametrize("kind", ["partial", "mixed"])
def test_a_short_log(kind, short, monkeypatch):
    monkeypatch.setattr(kitchen, "_errand", lambda task, number, generator: ["kettle"] * (1 + number))
    log = generate(f"kitchen-{kind}-v0", steps=45)
    assert log.name == f"kitchen-{kind}-v0@dr2-45-steps"
    assert log.observations.shape == (45, 60)
    assert log.episodes >= 2
    assert log.final_known.all()
    # All but the last, which is cut, end as demonstrations of D4RL do.
    np.testing.assert_array_equal(log.terminals[log.ends], [True] * (log.episodes - 1) + [False])
    np.testing.assert_array_equal(log.timeouts[log.ends], [False] * (log.episodes - 1) + [True])
    np.testing.assert_array_equal(log.observations[:, 30:], np.float32(task(f"kitchen-{kind}").goal) + np.zeros((45, 1)))


def test_rows_earn_what_is_done_in_what_they_observe(short, monkeypatch):
    monkeypatch.setattr(kitchen, "_errand", lambda task, number, generator: ["kettle"])
    # The slide cabinet is near enough from the beginning, and the light is on.
    monkeypatch.setattr("deadreckon.tasks.kitchen.NEAR", 0.4)
    monkeypatch.setattr("deadreckon.tasks.kitchen._FIRST", np.r_[_FIRST[:17], -0.69, -0.05, _FIRST[19:]])
    log = generate("kitchen-partial-v0", steps=30)
    done = task("kitchen-partial").done(log.observations[:, :30].astype(float)).sum(1)
    np.testing.assert_array_equal(log.rewards, done)
    assert (log.rewards >= 1.0).all()
    assert log.rewards[0] >= 2.0
    assert (log.lengths[:-1] > 5).all()  # a reward of every row, not of the first one alone


def test_logs_of_the_earlier_recipe_are_read_and_not_made(tmp_path, monkeypatch):
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path))
    with pytest.raises(UserError, match=r"kitchen-mixed-v0@dr1 .*earlier recipe.*makes kitchen-mixed-v0@dr2"):
        load("kitchen-mixed-v0@dr1")
    with pytest.raises(UserError, match="kitchen-mixed-v0@dr1"):
        recipe("kitchen-mixed-v0@dr1")
    assert recipe("kitchen-mixed-v0@dr2") is recipe("kitchen-mixed-v0")


@pytest.mark.slow
def test_a_killed_collection_is_gone_on_with(short, monkeypatch, tmp_path):
    monkeypatch.setattr(kitchen, "_errand", lambda task, number, generator: ["kettle"])
    make = recipe("kitchen-mixed-v0").make

    class Killed(Exception):
        pass

    def kill(done, total):
        raise Killed

    options = {"name": "kitchen-mixed-v0", "steps": 60, "seed": 1, "threads": 1}
    whole = make(**options, scratch=tmp_path / "a", progress=None)
    with pytest.raises(Killed):
        make(**options, scratch=tmp_path / "b", progress=kill)
    assert [path.name for path in (tmp_path / "b").glob("batch*")] == ["batch-00000.npz"]
    assert make(**options, scratch=tmp_path / "b", progress=None).fingerprint == whole.fingerprint


@pytest.mark.slow
def test_the_complete_log_solves_the_task():
    log = generate("kitchen-complete-v0", steps=400)
    assert log.terminals[log.ends[:-1]].all()
    assert log.rewards[log.ends[:-1]].tolist() == [4.0] * (log.episodes - 1)
    assert (np.diff(log.rewards) <= 1.0).all()
    assert (log.lengths <= 280).all()


def test_rows_are_table_d1s():
    assert [recipe(f"kitchen-{kind}-v0").steps for kind in ("complete", "partial", "mixed")] == [3_680, 136_950, 136_950]
