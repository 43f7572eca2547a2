"""`deadreckon train`: options of the run, and of the agent under `--agent.`"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from deadreckon.cli.data import Mapping, advise, mapping_options
from deadreckon.cli.lines import outcome
from deadreckon.cli.parse import chosen, parse
from deadreckon.cli.progress import Bar
from deadreckon.errors import UserError
from deadreckon.stats.interval import PERCENT

if TYPE_CHECKING:
    from deadreckon.cli.options import Train, TrainOnline


def train(args: Sequence[str]) -> None:
    """Trains, evaluates and says where the run lies."""
    from deadreckon.agents import AGENTS, agent_class, preset
    from deadreckon.cli.options import Train, TrainOnline

    name, rest = chosen("agent", args)
    own, rest = chosen("preset", rest)
    online = "--online" in rest
    begun = _begun(rest, name, online)
    name = name if begun is None else begun[0]
    if name is None and not any(a in ("-h", "--help") for a in rest):
        raise UserError(f"missing --agent, one of {', '.join(AGENTS)}")
    rest = [a for a in rest if a != "--online"]
    run = TrainOnline if online else Train
    # The run's options stay a class of their own: tyro finds the comments behind its fields there.
    fields: list[tuple] = [("run", Annotated[run, tyro.conf.arg(name="")])]
    if name:
        make = functools.partial(agent_class(name), **(preset(name, own) if own else {}))
        make = make if begun is None else functools.partial(begun[1].replace, **(preset(name, own) if own else {}))
        fields.append(("agent", agent_class(name), dataclasses.field(default_factory=make)))
    kind = dataclasses.make_dataclass("TrainAgent", fields)
    kind.__doc__ = run.__doc__ if name else f"{run.__doc__} Agents: {', '.join(AGENTS)}."
    parsed = parse(kind, rest, "train --online" if online else "train")
    judged_in = None if begun is None else begun[2]
    finished = _train_online(name, parsed, judged_in) if online else _train(name, parsed, own)
    from deadreckon.runs.run import Run

    outcome(summary(finished) if isinstance(finished, Run) else finished)
    if isinstance(finished, Run) and all(finished.failures):  # a cross-fit refuses such itself
        raise SystemExit(1)


def _begun(args: Sequence[str], name: str | None, online: bool) -> tuple[str, Any, str | None] | None:
    """Name and settings of the agent of the run that goes on, and its task, if any; None without --from.

    Raises:
        UserError: another agent is asked for, or seeds of the run have settings of their own.
    """
    given, _ = chosen("from", args)
    if given is None:
        return None
    if not online:
        raise UserError("--from continues an offline run in a simulator: add --online --task TASK")
    from deadreckon.agents import agent_class, agent_name
    from deadreckon.runs.started import start_of

    asked = None if name is None else agent_class(name)  # of a user's own, whose module a run's folder does not import
    start = start_of(given)
    first, *others = (agent.going_on() for agent in start.agents)
    if asked is not None and asked is not type(first):
        raise UserError(f"{given} is a run of {agent_name(first)}, {name} cannot continue it; leave --agent out")
    if any(vars(other) != vars(first) for other in others):
        raise UserError(f"the seeds of {given} have settings of their own; dr.train_online(start={given!r}) continues them")
    return agent_name(first), first, start.run.config["task"]


def _train_online(name, parsed, judged_in):
    from deadreckon.runs.online import train_online, turns_of

    options: TrainOnline = parsed.run
    if (task := options.task or judged_in) is None:
        raise UserError("missing --task, the simulator to train in (see `deadreckon tasks`)")
    given = {name: getattr(options, name) for name in ("copies", "explore", "updates_per_step", "block")}
    given = {name: value for name, value in given.items() if value is not None}
    settings = turns_of(type(parsed.agent), task, options.settings.start is not None, **given)
    updates = settings.updates(options.steps)
    with Bar(f"{name} in {task}", updates, "updates") as bar:
        return train_online(
            parsed.agent, options.task, steps=options.steps, seeds=options.seeds, seed=options.seed, out=options.out,
            **vars(options.settings) | {"settings": settings, "watch": _shown(bar)},
        )  # fmt: skip


def _train(name, parsed, preset):
    options: Train = parsed.run
    share = options.settings.holdout
    if options.cross_fit is not None and share is not None:
        raise UserError("--cross-fit holds every fold out in turn; leave --holdout out")
    if options.cross_fit is None and options.deliver != "mixture":
        raise UserError(f"--deliver {options.deliver} is for cross-fits; give --cross-fit FOLDS too, or leave it out")

    from deadreckon.agents import preset_for
    from deadreckon.data.catalogue import load
    from deadreckon.data.leaks import leaks
    from deadreckon.runs.train import train as run_training

    advise(options.data, options.map)
    log = load(
        options.data, mmap=options.mmap or None, strict=options.settings.strict, horizon=options.horizon,
        **columns_of(options.map, options.holdout_by),
    )  # fmt: skip
    suspected = leaks(log) if "schema" in log.provenance.extra else ()  # files of simulators' logs have no columns to mistake
    for text in (*log.warnings, *suspected):
        print(f"{log.name}: {text}")
    published = preset_for(name, log.name)
    if published and not preset:
        print(f"{name}: --preset {published} has the settings published for such a log; `deadreckon agents` shows them")
    with Bar(f"{name} on {log.name}", options.steps, "updates") as bar:
        asked: dict[str, Any] = vars(options.settings) | {
            "steps": options.steps, "seeds": options.seeds, "seed": options.seed, "task": options.task, "out": options.out,
            "watch": _shown(bar), "holdout": holdout_of(share, options.holdout_by),
        }  # fmt: skip
        if options.cross_fit is None:
            return run_training(parsed.agent, log, **asked)
        from deadreckon.runs.crossfit import cross_fit

        del asked["holdout"]  # every fold is held out in turn
        return cross_fit(parsed.agent, log, folds=options.cross_fit, by=options.holdout_by, deliver=options.deliver, **asked)


def columns_of(given: Mapping, by: str | None) -> dict[str, Any]:
    """The mapping of a table, in which the column to hold out by is kept and not observed; a schema says itself what is."""
    from deadreckon.data.formats.kind import READING

    named = mapping_options(given)
    if named.keys() - READING and "schema" not in named and by not in (None, "random", "time"):
        named["keep"] = tuple(dict.fromkeys([*named.get("keep", ()), by]))
    return named


def holdout_of(share: float | None, by: str | None):
    """As `runs.train.train` takes it.

    Raises:
        UserError: nothing is to be held out, but by a column.
    """
    from deadreckon.data.split import Holdout

    if by is None:
        return share
    if share == 0:
        raise UserError(f"--holdout 0 holds nothing out; leave --holdout-by {by} out, or give a share above 0")
    return Holdout(by=by) if share is None else Holdout(share, by)


def _shown(bar: Bar):
    """A watcher that shows each chunk on a progress bar."""
    return lambda progress, steps: bar(progress.step, steps, _note(progress))


def _note(progress) -> str:
    """The few metrics that fit on a line: means over the healthy seeds."""
    import numpy as np

    wanted = [m for m in ("critic_loss", "q", "behavior_nll", "behavior_error", "mmd") if m in progress.metrics][:3]
    alive = [f is None for f in progress.failures]
    if not any(alive):
        return "all seeds failed"
    return "  ".join(f"{m} {np.mean(progress.metrics[m][alive]):.3g}" for m in wanted)


def summary(run) -> str:
    """Last metrics, failures, last score, and where everything lies."""
    import numpy as np

    lines = _learned_from(run.config["data"])
    metrics = run.metrics.to_pydict()
    count = len(run.seeds)
    shown = [f"{k} {np.nanmean(v[-count:]):.4g}" for k, v in metrics.items()
             if k not in ("step", "seed", "environment_steps") and not np.isnan(v[-count:]).all()]  # fmt: skip
    lines.append("last metrics: " + ", ".join(shown) if shown else "no healthy seed at the end")
    evaluations = run.evaluations.to_pydict()
    if evaluations:
        last = np.asarray(evaluations["step"]) == max(evaluations["step"])
        if "mmd_to_data" in evaluations:
            distance, outside = (np.asarray(evaluations[key])[last].mean() for key in ("mmd_to_data", "outside_range"))
            copy = evaluations.get("mmd_of_copy", [math.nan])[-1]
            near = "0 for a copy" if math.isnan(copy) else f"which for a copy is below {copy:.3f} in {PERCENT} of samples"
            lines.append(
                f"MMD to the log {distance:.3f}: the distance of the policy's actions from those logged in the same states, "
                f"{near}; {outside:.1%} of its actions, sampled, are outside the log's range"
            )
        if "return" in evaluations:
            from deadreckon.stats.crossed import mean_interval

            named = [name for name in ("return", "score") if name in evaluations]
            columns = {name: np.asarray(evaluations[name])[last].reshape(count, -1) for name in named}
            values = ", ".join(f"{name} {mean_interval(column):.1f}" for name, column in columns.items())
            lines.append(f"{run.config['task']}: {values}")
        if "online" in run.config:
            from deadreckon.runs.steps import course, simulated

            told = f"; {course(run.config, evaluations)}" if "start" in run.config else ""
            lines.append(f"simulated: {simulated(run.config, evaluations)}{told}")
    for seed, failure in zip(run.seeds, run.failures):
        if failure is not None:
            lines.append(f"seed {seed} failed: {failure.metric} was not finite at update {failure.step}")
    lines.append(f"run folder: {run.path}")
    return "\n".join(lines)


def _learned_from(data: dict[str, Any]) -> list[str]:
    """How many episodes were learned from, and how many are left to judge by; nothing of runs that had no log."""
    if "episodes" not in data:
        return []
    if held := data.get("holdout"):
        told = f"trained on {held['learning']:,} of {data['episodes']:,} episodes"
        return [f"{told}; {held['held']:,} are held out for `deadreckon ope`"]
    return [f"trained on all {data['episodes']:,} episodes, none is held out"]
