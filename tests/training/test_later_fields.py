"""Fields that agents did not have at first: runs and cells of before keep their names."""

import dataclasses

import pytest

from deadreckon import agents
from deadreckon.agents import agent_class
from deadreckon.runs.lanes import agents_of, fields_of
from deadreckon.training.later_fields import told

LATER = ("abm", "algae_dice", "bc", "bcq", "bear", "brac", "d4pg", "edac", "fql", "kl_control", "mopo", "rlpd", "sac", "sac_n")


def names(*learners):
    return [f.name for f in told(*learners)]


@pytest.mark.parametrize("name", LATER)
def test_they_are_told_where_they_say_something(name):
    agent = agent_class(name)
    every = [f.name for f in dataclasses.fields(agent)]
    later = {"standardise", "standardise_rewards", "first_weights", "model_first_weights"}
    assert "standardise" in every
    assert names(agent()) == [each for each in every if each not in later]
    told_once = [each for each in every if each not in later - {"standardise"}]
    assert names(agent(standardise=True)) == told_once
    assert names(agent(), agent(standardise=True)) == told_once


def test_a_field_that_a_class_had_before_its_base_stands_where_it_stood():
    for agent in (agents.CQL(), agents.CalQL()):
        found = names(agent)
        assert found[found.index("warm_start") + 1] == "standardise"
        later = {"standardise_rewards", "first_weights"}
        later |= {"critic_hidden"} if type(agent) is agents.CQL else set()  # Cal-QL had it from the beginning
        assert sorted(found) == sorted({f.name for f in dataclasses.fields(agent)} - later)


def test_runs_of_before_are_read_and_gone_on_with():
    raw, standard = agents.BC(), agents.BC(standardise=True)
    assert "standardise" not in fields_of([raw, raw])
    for agent in (raw, standard):
        config = {"agent": {"name": "bc", "fields": fields_of([agent])}, "seeds": [0]}
        assert agents_of(config)[0].standardise is agent.standardise
