"""`deadreckon ope`: what policies are worth, from a log alone; `deadreckon ope bench`: how good such estimates are."""

import dataclasses
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from deadreckon.cli.data import advise, mapping_options
from deadreckon.cli.fits import NAMES, Fits, estimators
from deadreckon.cli.parse import parse
from deadreckon.cli.progress import Watch
from deadreckon.errors import UserError
from deadreckon.interrupts import resumable


@dataclass
class Bench:
    """The DOPE protocol: estimate the package's policies from its logs, and compare with their true values."""

    half: Literal["d4rl", "unplugged"] = "d4rl"
    """half of DOPE: tasks of Gym-MuJoCo with logs of several kinds (d4rl; others by --logs), or of dm_control (unplugged)"""
    tasks: Annotated[str | None, NAMES] = None  # tasks whose policies and logs are used; None: hopper, or all of unplugged
    kinds: Annotated[str, NAMES] = "random,medium,expert,medium-replay,medium-expert"  # kinds of logs, of half d4rl
    logs: Annotated[str | None, NAMES] = None  # logs instead of --kinds, such as door-human-v1, of any tasks with policies
    estimators: Annotated[str, NAMES] = "fqe,fqe-d,is,dr,dice,vpm,mb-ff,mb-ar"  # names of the estimators to compare
    public: bool = False  # whether to compute weights as the public code: learned behaviour policy, log-ratios in [-6, 2]
    budget: Literal["full", "cpu"] = "full"  # sizes of fitted models: published (full), or feasible on one core (cpu)
    clip: bool = False  # whether to clip normalised estimates at 2, as the public notebook does
    seeds: int = 1  # number of fits of each estimator; tables show their means
    seed: int = 0  # first random seed
    log_steps: int | None = None  # rows of each log; None: all
    out: str = "runs/dope"  # folder of results; existing results are not computed again
    fits: Annotated[Fits, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Fits)


def ope(args: Sequence[str]) -> None:
    """Estimates and prints."""
    if args and args[0] == "bench":
        return bench(args[1:])
    if "--list" in args:
        from deadreckon.ope.registry import ESTIMATORS
        from deadreckon.text_table import table

        print(table([["estimator", "algorithm and source"], *([name, line] for name, (_, line) in ESTIMATORS.items())]))
        return None
    from deadreckon.cli.options import Ope

    options = parse(Ope, args, "ope")
    from deadreckon.data import catalogue
    from deadreckon.ope.behavior_model import PROPENSITIES
    from deadreckon.ope.registry import titled, with_fields
    from deadreckon.runs.gather import fresh, gather
    from deadreckon.runs.offline import checked, grounds, groups, judge, supports

    if options.estimators == "auto" and options.fits.given:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in options.fits.given)
        raise UserError(f"{names}: sizes are set for estimators that are named (--estimators fqe), not for auto")
    wanted = options.estimators if options.estimators == "auto" else estimators(options.estimators, options.fits)
    advise(options.data, options.map)
    data = catalogue.load(options.data, horizon=options.log_horizon, **mapping_options(options.map))
    if options.episodes is not None:
        if not 1 <= options.episodes <= data.episodes:
            raise UserError(f"--episodes must be 1 .. {data.episodes}, the log's own, got {options.episodes}")
        held = fresh(gather(options.policies), data, options.settings.unseen).held
        data = data.select(held[: options.episodes])
    with Watch() as watch:
        judged = judge(
            options.policies, data, wanted, task=options.task,
            **vars(options.settings) | {"model": with_fields(PROPENSITIES, options.fits.given), "watch": watch},
        )  # fmt: skip
    print("\n".join(f"{name}: {words}" for name, words in grounds(judged.results)) + "\n")
    for each in judged.estimates:
        print(f"{dataclasses.replace(each, method=titled(each.method))}\n")
    print(f"{supports(judged.results)}\n")
    if options.select:
        print(judged.choice)
        print(usage(judged.results, options.policies), end="")
    if options.settings.by_group:
        print(f"\n{groups(judged.results)}")
    if options.task:
        print(f"checked: {checked(judged.results)}")
    return None


def usage(results: Mapping[str, Any], given: Sequence[str]) -> str:
    """A line with the command or call that gives the actions of the policy to deploy; empty where there is none.

    Args:
        results: what is in `estimates.json`.
        given: folders and files that policies were taken from.
    """
    choice = results["choice"]
    if not choice["deploy"]:
        return ""
    policy = next(each for each in results["policies"] if each["name"] == choice["name"])
    how = use(policy, given, results["estimand"]["greedy"])
    return f"  use it: {how}\n" if how else ""


def use(policy: Mapping[str, Any], given: Sequence[str], greedy: bool) -> str | None:
    """The command or call that gives a policy's actions as they were judged; None where it is saved nowhere.

    Args:
        policy: of `estimates.json`.
        given: folders and files that policies were taken from.
        greedy: how it was judged.
    """
    from deadreckon.policies import portable
    from deadreckon.policies.resolve import PICKLES
    from deadreckon.runs.records import CROSS_FIT

    file = policy["file"]
    if file is None:
        crossed = [each for each in given if Path(each).name == policy["run"] and (Path(each) / CROSS_FIT).exists()]
        # Of several seeds there is one file for all, which is another policy than the one that was judged.
        return f"deadreckon.load_cross_fit({crossed[0]!r}).policy_of({policy['seed']})" if crossed else None
    if Path(file).suffix in PICKLES:
        call = f"deadreckon.policies.load_dope({file!r})"
        return f"{call}(observations)" if greedy else f"{call}, whose act(step, carry, key, greedy=False) samples actions"
    tree = portable.read(file)[0]
    if "schema" in tree["meta"].get("log", {}).get("extra", {}):  # of a table: rows by names of columns
        command = f"deadreckon predict {shlex.quote(file)} TABLE --out actions.csv{'' if greedy else ' --sampled True'}"
        return f"{command}, in Python deadreckon.load_policy({file!r}).predict(rows{'' if greedy else ', greedy=False'})"
    more = "" if greedy else ", rng, greedy=False"
    if tree["policy"]["inner"]["kind"] in ("Mixture", "History"):
        more += ", first=first"
    if tree["meta"].get("log", {}).get("action_space", {}).get("masked"):
        more += ", legal=legal"
    call = f"deadreckon.policies.portable.load({file!r})(observations{more})"
    return f"{call}, where first is True at the first step of an episode" if "first" in more else call


def bench(args: Sequence[str]) -> None:
    """Runs the protocol, prints its tables and writes a page beside the results."""
    options = parse(Bench, args, "ope bench")
    from deadreckon.ope import dope
    from deadreckon.ope.metrics import PUBLIC_CLIP
    from deadreckon.ope.registry import CPU_BUDGET, PUBLIC, titled, with_fields
    from deadreckon.report.dope import write_bench
    from deadreckon.runs import dope as protocol

    found = estimators(options.estimators, options.fits, CPU_BUDGET if options.budget == "cpu" else {})
    if options.public:
        found = [with_fields(estimator, PUBLIC) for estimator in found]
    tasks, kinds, logs = (
        None if names is None else [name.strip() for name in names.split(",")]
        for names in (options.tasks, options.kinds, options.logs)
    )
    told = lambda r: print(f"{r.log} {titled(r.method)}: {r.seconds:,.0f} s", flush=True)  # noqa: E731
    with resumable(Path(options.out)), Watch() as watch:
        results = protocol.dope(
            found, tasks, kinds or (), half=options.half, logs=logs or (), log_steps=options.log_steps, seeds=options.seeds,
            seed=options.seed, out=options.out, watch=watch, told=told,
            collecting=lambda name, done, steps: watch(f"collecting {name}", done, steps, "steps"),
        )  # fmt: skip
    clip = PUBLIC_CLIP if options.clip else None
    if clip is not None:
        print(f"\nnormalised estimates are cut at {clip:g}, as in the public notebook")
    for each in dope.shown_metrics(results):
        print(f"\n{each.title}\n\n{dope.markdown(results, each.metric, clip=clip, k=each.k)}")
    print(f"\nAbsolute error, in discounted returns\n\n{dope.markdown(results, 'absolute_error', normalised=False)}")
    print(f"\nDeploying by estimates: gain for risk, and errors against the behaviour policy\n\n{dope.risks(results)}")
    print(f"\n{write_bench(results, Path(options.out) / 'report.html', clip=clip)}")
