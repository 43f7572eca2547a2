"""The model card beside an exported policy, in Markdown: its origin, its estimates and its limits."""

import datetime
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from deadreckon._version import __version__
from deadreckon.data.dataset import Dataset
from deadreckon.data.told import action_names, columns_of
from deadreckon.names import in_markdown
from deadreckon.policies.deployed import Mixture, history_of
from deadreckon.policies.kinds import Categorical, Deterministic
from deadreckon.runs.offline import grounds
from deadreckon.runs.subject import Subject
from deadreckon.stats.interval import PERCENT, Interval, decimals, level_in_words

LISTED = 60  # most columns that are listed


def card(
    one: Subject, log: Dataset, estimates: tuple[dict[str, Any], int] | None, format: str, use: Sequence[str], checked: int
) -> str:
    """The text of the card.

    Args:
        one: the policy.
        log: on whose rows the export was checked.
        estimates: of the policy, and its index there; None if there are none.
        format: of the export.
        use: how it is used, lines of Markdown.
        checked: number of rows on which it was checked.
    """
    # Text from files is escaped, so that it cannot pass for text of the card.
    told = {"name": in_markdown(one.name), "config": in_markdown(one.config), "made": in_markdown(one.made)}
    one, estimates = replace(one, **told), in_markdown(estimates)
    parts = [
        ("", [f"A policy exported by deadreckon {__version__} on {datetime.date.today().isoformat()}, as {format}."]),
        ("Use", [*use, "", f"Checked against the policy on {checked:,} rows of {in_markdown(log.name)}."]),
        ("Decision", _decision(estimates)),
        ("Estimates", _estimates(estimates)),
        ("Log", _log(one, log)),
        ("Agent", _agent(one)),
        ("Columns", _columns(log)),
        ("Limits", [f"- {line}" for line in _limits(one, log, estimates, format)]),
        ("Versions", _versions(one)),
    ]
    lines = [f"# {one.name}"]
    for heading, text in parts:
        lines += ["", *([f"## {heading}", ""] if heading else []), *text]
    return "\n".join(lines) + "\n"


def _decision(estimates: tuple[dict[str, Any], int] | None) -> list[str]:
    if estimates is None:
        return ["No estimates are known, so nothing shows whether this policy should be deployed (`deadreckon ope --select`)."]
    told, place = estimates
    choice, mine = told["choice"], told["policies"][place]["name"]
    words = "DEPLOY" if choice["deploy"] else "DO NOT DEPLOY"
    lines = [f"**{words}** {choice['name']}: {choice['reason']}."]
    if choice["name"] != mine:
        lines += ["", f"The decision is about another policy than this one, which is {mine}."]
    lines += ["", *(f"- {name}: {text}" for name, text in grounds(told))]
    against = [*choice["evidence"], *choice["objections"][place], *choice["warnings"]]
    heading = ["", "Objections, warnings and other estimates:", ""] if against else []
    return [*lines, *heading, *(f"- {line}" for line in against)]


def _estimates(estimates: tuple[dict[str, Any], int] | None) -> list[str]:
    if estimates is None:
        return ["None."]
    told, place = estimates
    lines = [f"Estimated: {told['estimand']['words']}.", ""]
    level = f"{level_in_words(told['choice']['level'])} for all policies at once"
    lines += [f"| estimator | value [{PERCENT}] | gain over the behaviour policy [{level}] |", "|---|---|---|"]
    for each in told["results"]:
        value = Interval(*(each[key][place] for key in ("value", "low", "high")))
        gain = Interval(*each["gain"][place])
        d = decimals(value.value, gain.value)
        lines.append(f"| {each['title']} | {value:.{d}f} | {gain:+.{d}f} |")
    return lines


def _log(one: Subject, log: Dataset) -> list[str]:
    data = one.data
    known = {name: data[name] for name in ("name", "fingerprint", "rows", "episodes") if name in data}
    if not known:
        known = {"name": in_markdown(log.name), "fingerprint": log.fingerprint, "rows": len(log), "episodes": log.episodes}
    facts = [(name, f"{value:,}" if isinstance(value, int) else value) for name, value in known.items()]
    facts.append(("actions", _actions(log)))
    if not data:
        facts.append(("origin", "the log of the check; the policy's file does not say which log it was trained on"))
    held = data.get("holdout")
    if held is not None and one.config is None:
        facts.append(("held out", f"each episode by one of the {held['folds']} folds, by {held['by']}"))
    elif held is not None:
        facts.append(("held out", f"{held['held']:,} of {held['held'] + held['learning']:,} episodes, by {held['by']}"))
    return [*(f"- {name}: {value}" for name, value in facts), *(f"- warning: {line}" for line in data.get("warnings", ()))]


def _actions(log: Dataset) -> str:
    """What an action is, in words and as its type."""
    count = log.action_space.size
    if log.spec.discrete:
        return f"one of {count} discrete actions (type `{log.action_space}`)"
    return f"{count} number{'s' * (count != 1)} within bounds (type `{log.action_space}`)"


def _agent(one: Subject) -> list[str]:
    config = one.made
    kind = type(one.policy.inner)
    told = " ".join((inspect.getdoc(kind) or "").partition("\n\n")[0].split())
    policy = f"The policy has the type `{kind.__name__}`{': ' * bool(told)}{told}"
    if not config:
        return [policy, "", "No run says how it was made."]
    seed = "" if one.seed is None else f", seed {one.seed}"
    head = f"{config['agent']['name']}{seed}, {config['steps']:,} updates{' in each fold' if one.config is None else ''}."
    fields = [f"| {name} | {value} |" for name, value in config["agent"].get("fields", {}).items()]
    if seen := seen_by(config):
        head += f" Pictures: {seen}."
    return [head, "", policy, "", "| setting | value |", "|---|---|", *fields]


def seen_by(config: Mapping[str, Any]) -> str:
    """The encoder and random shifts of a run on images, by its `run.json`; empty without images."""
    if "encoder" not in config:
        return ""
    return f"encoder {config['encoder']}, random shifts of up to {config['shift']} pixels during training"


def _columns(log: Dataset) -> list[str]:
    columns = [each for each in columns_of(log) if each.role in ("observation", "action", "reward", "legal")]
    told = ((each.name, each.role, each.kind, each.holds, each.becomes) for each in columns[:LISTED])
    rows = [f"| {' | '.join(map(in_markdown, cells))} |" for cells in told]
    more = [f"and {len(columns) - LISTED:,} more"] if len(columns) > LISTED else []
    if log.spec.discrete:
        more.append(f"Actions, in the order of their codes: {in_markdown(', '.join(action_names(log)[:LISTED]))}.")
    return ["| column | role | kind | levels or range | becomes |", "|---|---|---|---|---|", *rows, "", *more]


def _limits(one: Subject, log: Dataset, estimates: tuple[dict[str, Any], int] | None, format: str) -> list[str]:
    how = "; the numpy player samples with `greedy=False`" if format == "numpy" else ""
    inner, lines = one.policy.inner, [f"The export takes deterministic (greedy) actions{how}."]
    if estimates is not None and not estimates[0]["estimand"]["greedy"] and not isinstance(inner, Deterministic):
        how = "sample from the output `probabilities`" if isinstance(inner, Categorical) else "the package samples them"
        how = "`greedy=False` samples" if format == "numpy" else how
        lines.append(f"The estimates above are of sampled actions, and do not hold for greedy ones: {how}.")
    lines += [
        "It was trained on a log. If the system has changed since, nothing here holds; `deadreckon monitor` compares.",
        "Rows outside the log (unknown levels, numbers beyond its ranges) get an action too, without any evidence.",
    ]
    if (steps := history_of(one.policy)) > 1:
        text = f"o, a, o, ..., o: {steps} observations with the actions between them, scaled to [-1, 1] or one-hot"
        lines.append(f"It acts on the last steps of an episode: {text}. Before an episode, its first observation is repeated.")
    if isinstance(inner, Mixture):
        last = len(inner.members) - 1
        drawn = "is drawn with equal probabilities at the start of an episode, and kept to its end"
        lines.append(f"It is a mixture of {last + 1} policies: `member`, 0 .. {last}, {drawn}.")
    if log.spec.mask_size:
        lines.append("Which actions are legal has to be given in every row.")
    return lines


def _versions(one: Subject) -> list[str]:
    known = one.made.get("versions", {})
    lines = [f"- {name}: {value}" for name, value in known.items() if name != "lanes"]
    return [*lines, f"- exported with deadreckon: {__version__}"]
