"""Warnings about a log whose numbers are far from 1 in size, if an agent does not scale them."""

from deadreckon.agents.agent import Agent
from deadreckon.data.dataset import Dataset
from deadreckon.data.sizes import about_observations, about_rewards, reward_options, reward_words
from deadreckon.tasks.registry import of_log


def about_sizes(log: Dataset, agent: Agent) -> list[str]:
    """One line each about observations and rewards that should be scaled for an agent.

    None for logs of known tasks, which agents use as in their papers, or for what the settings scale already.
    """
    if of_log(log.name) is not None:
        return []
    own, needs, lines = vars(agent), agent.needs(log.spec), []
    if not needs.standardise and (told := about_observations(log)):
        do = "standardise them (--agent.standardise, in Python standardise=True)"
        do = do if "standardise" in own else "change the units"
        lines.append(f"{log.name}: {told}; networks learn best from observations of about 1: {do}")
    usual = own.get("reward_scale", 1.0) == 1.0 and own.get("reward_shift", 0.0) == 0.0
    if "reward" in needs.columns and usual and (told := about_rewards(log.spec)):
        do = f"give {reward_options(log)}" if "reward_scale" in own else reward_words(log)
        lines.append(f"{log.name}: {told}; {type(agent).__name__} is made for rewards of about 1: {do}")
    return lines
