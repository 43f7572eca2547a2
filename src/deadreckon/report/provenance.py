"""Where a page's numbers come from: changed settings, versions, and the command that makes a run again."""

import dataclasses
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deadreckon.agents import AGENTS, agent_class
from deadreckon.agents.agent import Agent
from deadreckon.data.schema import Schema
from deadreckon.data.split import RANDOM, Holdout
from deadreckon.online import Online
from deadreckon.report.entries import Entry, Page
from deadreckon.report.markup import Markup, join, tag
from deadreckon.report.parts import note, scroll
from deadreckon.runs.card import seen_by
from deadreckon.runs.online import turns_of
from deadreckon.runs.reading import HORIZON
from deadreckon.runs.steps import course, simulated

# Of what `data convert` writes, which table a file of this kind may be; a log of another one knows its columns itself.
CONVERTED = {".csv": "csv", ".parquet": "parquet", ".hdf5": "", ".npz": "", "": ""}


def settings(entry: Entry) -> dict[str, Any]:
    """Hyperparameters that differ from the agent's defaults, also those that were derived from the log."""
    given = entry.config["agent"]["fields"]
    if entry.agent not in AGENTS:
        return given
    default = agent_class(entry.agent)()
    known = {f.name: _plain(getattr(default, f.name)) for f in dataclasses.fields(default)}
    return {name: value for name, value in given.items() if name not in known or known[name] != value}


NO_COMMAND = "# no command: it was trained in a task that its name does not find; dr.train_online takes the task itself"


def command(entry: Entry) -> str:
    """The command line that makes this run again, or one per folder; a comment where none does."""
    if "task_fields" in entry.config:
        return NO_COMMAND
    options = [word for name, value in settings(entry).items() for word in option(name, value)]
    lines = []
    for folder, seeds in entry.folders:
        words = ["deadreckon", "train", *([] if "start" in entry.config else ["--agent", entry.agent])]
        words += _from_log(entry, seeds) if entry.online is None else _online(entry, entry.online, seeds)
        fold = "fold" in (entry.config["data"].get("holdout") or {})
        lines.append(shlex.join(map(str, [*words, *options, "--out", folder.path.parent if fold else folder.path])))
    return "\n".join(dict.fromkeys(lines))


def schema_file(entry: Entry) -> tuple[Path, str] | None:
    """The file by which `command` reads a table as the run did, and its text; None where the log was no table in a file."""
    known = entry.config["data"].get("provenance") or {}
    if (found := _extra(entry).get("schema")) is None or known.get("path") is None:
        return None
    path, source = Path(known["path"]), known.get("source")
    if CONVERTED.get(path.suffix, source) != source:
        return None
    schema = Schema.from_json(found, str(entry.folder.config))
    text = dataclasses.replace(schema, table={"path": path.name, **schema.options()}).to_toml()
    return path.with_name(f"{path.stem}-schema.toml"), text.strip()


def _extra(entry: Entry) -> dict[str, Any]:
    return (entry.config["data"].get("provenance") or {}).get("extra") or {}


def _from_log(entry: Entry, seeds: list[int]) -> list[Any]:
    config = entry.config
    data, every = config["data"], config.get("evaluation", {})
    table, extra = schema_file(entry), _extra(entry)
    words = ["--data", table[0] if table else (data.get("provenance") or {}).get("path") or data["name"]]
    words += ["--horizon", extra[HORIZON]] if extra.get(HORIZON) is not None else []
    words += ["--task", config["task"]] if config["task"] else []
    words += ["--steps", config["steps"], *_seeds(seeds)]
    if every.get("every") not in (None, max(config["steps"] // 10, 1)):
        words += ["--evaluate-every", every["every"]]
    words += ["--episodes", every["episodes"]] if every.get("episodes") not in (None, 20) else []
    words += _holdout(data.get("holdout"), config["task"] is not None, extra.get("group") or RANDOM)
    return words + [word for name in ("history", "encoder", "shift") if name in config for word in (f"--{name}", config[name])]


def _holdout(told: dict[str, Any] | None, simulated: bool, usual: str) -> list[Any]:
    """What has to be said for the same episodes to be held out; a seed is no option. `usual` is how they are chosen unasked."""
    if told is None:
        return [] if simulated else ["--holdout", 0]  # where no simulator judges, a fifth is held out unasked
    if "fold" in told:
        return ["--cross-fit", told["folds"], *(["--holdout-by", told["by"]] if told["by"] != usual else [])]
    if told["share"] == Holdout.share and told["by"] == usual and not simulated:
        return []
    return ["--holdout", told["share"], "--holdout-by", told["by"]]


def _online(entry: Entry, turns: Online, seeds: list[int]) -> list[Any]:
    """Steps are the environment's on the command line, and updates in the record."""
    every, steps = entry.config.get("evaluation", {}), turns.steps(entry.config["steps"])
    start, log = entry.config.get("start"), entry.config.get("log")
    words = ["--from", start["path"]] if start else _seeds(seeds)
    words += ["--data", log["path"] or log["name"]] if log else []
    words += ["--log-share", log["share"]] if log and log["share"] != 0.5 else []
    words = ["--online", "--task", entry.config["task"], "--steps", steps, *words]
    kind = agent_class(entry.agent) if entry.agent in AGENTS else Agent
    usual = dataclasses.asdict(turns_of(kind, entry.config["task"], start is not None))
    changed = {name: value for name, value in dataclasses.asdict(turns).items() if value != usual[name]}
    for name, value in changed.items():
        words += [f"--{name.replace('_', '-')}", value]
    block = turns.updates_per_block
    if every.get("every") not in (None, -(-round(max(steps // 50, 1) * turns.updates_per_step) // block) * block):
        words += ["--evaluate-every", every["every"] // block * turns.block]
    return words + (["--episodes", every["episodes"]] if every.get("episodes") not in (None, 10) else [])


def _seeds(seeds: list[int]) -> list[Any]:
    return ["--seeds", len(seeds)] + (["--seed", seeds[0]] if seeds[:1] != [0] else [])


def option(name: str, value: Any) -> list[Any]:
    """The words by which `deadreckon train` sets a field of an agent."""
    name = name.replace("_", "-")
    if isinstance(value, bool):
        return [f"--agent.{name}" if value else f"--agent.no-{name}"]
    if value is None:
        return [f"--agent.{name}", "None"]
    return [f"--agent.{name}", *(value if isinstance(value, Sequence) and not isinstance(value, str) else [value])]


def _plain(value: Any) -> Any:
    return [_plain(v) for v in value] if isinstance(value, (tuple, list)) else value


def versions(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    """What the runs were made with; several values where they differ."""
    names = dict.fromkeys(name for e in entries for name in e.config.get("versions", {}) if name != "lanes")
    return [(name, ", ".join(dict.fromkeys(str(e.config.get("versions", {}).get(name)) for e in entries))) for name in names]


def section(page: Page) -> Markup:
    """A card for each run, and the versions."""
    cards = [_run(e) for e in page.entries]
    pairs = versions(page.entries)
    lines = [tag("tr", tag("th", name, scope="row"), tag("td", value)) for name, value in pairs]
    table = tag("table", lines, class_="versions")
    return join(
        note(
            "The numbers on this page come from the run folders below and nowhere else; only the table of published numbers "
            "is quoted."
        ),
        tag("div", cards, class_="runs"),
        tag("details", tag("summary", "Versions"), scroll(table)),
    )


def _run(entry: Entry) -> Markup:
    data, config = entry.config["data"], entry.config
    changed = settings(entry)
    done = f"{entry.status.get('step', 0):,} of {config['steps']:,} updates"
    state = "finished" if entry.status.get("finished") else f"not finished: {done}"
    facts: list[tuple[str, Any]] = [
        ("state", state),
        ("updates", f"{config['steps']:,}, seeds {', '.join(map(str, entry.seeds))}"),
        ("settings", ", ".join(f"{name} = {value}" for name, value in changed.items()) or "all by default"),
    ]
    if entry.online is None:
        facts += [
            ("images", seen_by(config)),
            ("history", f"{config['history']} observations, with the actions between them" if "history" in config else ""),
            ("log", f"{data['name']}, {data.get('rows', 0):,} rows, {data.get('episodes', 0):,} episodes"),
            ("held out", _held(data.get("holdout"))),
            ("fingerprint", tag("code", data["fingerprint"])),
            ("collected with", _made(data.get("provenance") or {})),
            ("warnings", join(*(tag("div", w) for w in data.get("warnings", []))) or "none"),
        ]
    else:
        facts += [("experience", _acted(entry.online, entry.online.steps(config["steps"]))), *_begun(entry)]
    facts.append(("folder", join(*(tag("div", tag("code", folder.path)) for folder, _ in entry.folders))))
    again = command(entry)
    return tag(
        "article",
        tag("h3", entry.label),
        tag("dl", [join(tag("dt", name), tag("dd", value)) for name, value in facts if value]),
        tag("pre", tag("code", again), tabindex="0", aria_label="command to reproduce"),
        _columns(entry),
    )


def _columns(entry: Entry) -> Markup | None:
    """What the command needs beside it where a table was learned from."""
    if (found := schema_file(entry)) is not None:
        summary = tag("summary", f"{found[0].name}, to be put beside the table")
        return tag("details", summary, tag("pre", tag("code", found[1]), tabindex="0", aria_label="schema of the table"))
    data = entry.config["data"]
    if _extra(entry).get("schema") is None or data["provenance"].get("path") is not None:
        return None
    name = tag("code", data["name"])
    return note("The table was a data frame: ", name, " stands for a file of it, whose columns have to be given as they were.")


def _held(told: dict[str, Any] | None) -> str:
    if told is None:
        return ""
    how = f"fold {told['fold'] + 1} of {told['folds']}" if "fold" in told else f"{told['share']:.3g} of all"
    seed = f", seed {told['seed']}" if told["seed"] else ""
    return f"{told['held']:,} episodes, {how}, by {told['by']}{seed}"


def _acted(turns: Online, steps: int) -> str:
    return (
        f"{steps:,} environment steps per seed, the first {turns.explore:,} with uniform actions; {turns.copies} copies, "
        f"{turns.updates_per_block} updates after every {turns.block} steps"
    )


def _begun(entry: Entry) -> list[tuple[str, Any]]:
    """Of an online run: what was simulated, and what it went on from, where it did not begin with nothing."""
    config, facts = entry.config, []
    if "length" in entry.evaluations:
        facts.append(("simulated", str(simulated(config, entry.evaluations))))
    if start := config.get("start"):
        facts.append(("continues", join(tag("code", start["path"]), f", after {start['updates']:,} updates on the log")))
        if "return" in entry.evaluations:
            facts.append(("course", str(course(config, entry.evaluations))))
    if log := config.get("log"):
        held = f"; {log['holdout']['held']:,} episodes are held out" if log["holdout"] else ""
        facts.append(("log in the replay", f"{log['name']}, {log['rows']:,} rows, {log['share']:.0%} of each batch{held}"))
    return facts


def _made(known: dict[str, Any]) -> str:
    parts = [known.get("source"), f"recipe {known['recipe']}" if known.get("recipe") else None]
    parts.append(f"seed {known['seed']}" if known.get("seed") is not None else None)
    parts += [f"{name} {version}" for name, version in (known.get("versions") or {}).items()]
    return ", ".join(str(part) for part in parts if part)
