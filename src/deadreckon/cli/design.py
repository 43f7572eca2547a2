"""`deadreckon design`: designs that should score high, from scored ones alone; and `design describe`, `problems`, `get`,
`methods`, `bench`."""

import dataclasses
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from deadreckon.cli import design_front
from deadreckon.cli.data import Reading, mapping_options
from deadreckon.cli.design_asked import asked, check_budget, check_problem, designs, size_told
from deadreckon.cli.parse import chosen, parse
from deadreckon.cli.progress import Bar, Watch
from deadreckon.cli.sheets import write_beside
from deadreckon.errors import UserError
from deadreckon.files import alone
from deadreckon.interrupts import resumable
from deadreckon.names import file_part

_NAMES = tyro.conf.arg(metavar="NAME[,NAME...]")


@dataclass
class Design:
    """Propose designs expected to score high, from a table of scored ones; --method NAME, by default what predicts best.

    The table may stand first, without --data. See also `deadreckon design describe|problems|get|methods|bench`.
    """

    data: str | None = None  # table of scored designs (CSV, JSON, Parquet, spreadsheet, database), a row per design
    target: str | None = None  # column of the scores, to be maximised
    schema: str | None = None  # schema of the table, a TOML file with roles, kinds and constraints (see `design describe`)
    kinds: dict[str, str] = dataclasses.field(default_factory=dict)
    """kinds of columns (continuous, integer, ordinal or categorical), as COLUMN KIND pairs"""
    levels: dict[str, str] = dataclasses.field(default_factory=dict)
    """levels of a categorical column, if some are not in the data, or of an ordinal one in order, as COLUMN A,B,C pairs"""
    bounds: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    """bounds of columns, as COLUMN LOW HIGH; default: the range of the data"""
    ignore: tuple[str, ...] = ()  # columns that are not inputs
    file: Annotated[Reading, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Reading)  # how the table is read
    targets: tuple[str, ...] = ()  # columns of several scores at once, for a front of designs, instead of --target
    minimise: tuple[str, ...] | None = None
    """whether to minimise the target instead; with --targets the names of those to minimise"""
    reference: dict[str, float] = dataclasses.field(default_factory=dict)
    """point that hypervolumes of --targets are measured from, as TARGET NUMBER pairs; default: a tenth below the front"""
    steps: dict[str, float] = dataclasses.field(default_factory=dict)
    """step sizes of numeric columns, as COLUMN STEP pairs: proposals are multiples of the step"""
    logs: tuple[str, ...] = ()  # columns of positive numbers that are modelled on a logarithmic scale
    fix: tuple[str, ...] = ()  # values that all proposals have, as COLUMN=VALUE
    constraints: tuple[str, ...] = ()  # linear constraints, each in quotes, such as "a + 2 b <= 0.8"
    mixtures: tuple[str, ...] = ()  # groups of columns that sum to one, each as A,B,C
    forbid: tuple[str, ...] = ()  # combinations that are not proposed, each in quotes, such as "solvent = water & temp > 80"
    std_error: str | None = None  # column with the standard error of the target
    groups: str | None = None  # column with the group of each row, such as its batch: a group is held out as a whole
    weights: dict[str, float] = dataclasses.field(default_factory=dict)
    """further columns in the score, such as costs, as COLUMN WEIGHT pairs: the score is target + sum of weight x column"""
    max_distance: float | None = None
    """largest distance of proposals to the nearest scored design, in typical distances of scored designs; None: no limit"""
    apart: float | None = None
    """smallest distance between proposals, in typical distances; None: 0.1, or less if otherwise there are too few proposals"""
    repeat: bool = False  # whether designs that are in the data, or nearly, may be proposed
    problem: str | None = None  # problem with an oracle, instead of --data (see `design problems`)
    budget: Literal["full", "cpu"] | None = None
    """sizes of fitted models, of methods that have published ones; None: full for a problem, cpu (minutes) for --data"""
    path: str | None = None  # file with the data of the problem, if it needs one
    n: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 128  # number of designs to propose
    seed: int = 0  # random seed of the method
    out: str | None = None  # folder of the proposals (CSV, spreadsheet), a page and checkpoints; None: runs/design/METHOD-DATA


@dataclass
class Bench:
    """Evaluate methods on problems: the best and the median of their designs over seeds, with the thesis's values."""

    problems: Annotated[str, _NAMES] = "branin,hartmann6,ackley,nk"  # names of problems with commas (see `design problems`)
    methods: Annotated[str, _NAMES] = "best,random,forward,ensemble,coms,ram,nemo"
    """names of methods with commas (see `design methods`)"""
    n: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 128  # number of designs that a method proposes
    budget: Literal["full", "cpu"] = "full"  # sizes of fitted models: published (full), or feasible on one core (cpu)
    seeds: int = 16  # number of consecutive random seeds
    seed: int = 0  # first random seed
    together: int | None = None  # seeds per compiled program; None: all. Fewer need less memory
    paths: dict[str, str] = dataclasses.field(default_factory=dict)
    """files of problems, as PROBLEM FILE pairs; default: those in the package's folder of designs"""
    out: str = "runs/design-bench"  # folder of results; existing results are not computed again


def design(args: Sequence[str]) -> None:
    """Proposes, writes and prints."""
    if args and args[0] in _MORE:
        return _MORE[args[0]](args[1:])
    if args and not args[0].startswith("-"):
        args = ["--data", *args]
    from deadreckon.mbo.registry import DESIGNERS, USUAL, sized

    name, rest = chosen("method", args)
    problem, budget = chosen("problem", rest)[0], chosen("budget", rest)[0]
    method = sized(name or USUAL, problem, budget or ("full" if problem else "cpu"))  # with the settings published for it
    own = "method", type(method), dataclasses.field(default_factory=lambda: method)
    fields: list[tuple] = [("design", Annotated[Design, tyro.conf.arg(name="")]), own]
    kind = dataclasses.make_dataclass("DesignMethod", fields)
    kind.__doc__ = Design.__doc__ if name else f"{Design.__doc__} Methods: {', '.join(DESIGNERS)}."
    parsed = parse(kind, rest, "design")
    if parsed.design.targets and vars(parsed.method) != vars(method):
        raise UserError("fields of a method do not go with --targets, which have a Gaussian process each; leave --method.* out")
    _propose(name or USUAL, parsed.method, parsed.design)


def _propose(name: str, method: Any, options: Design) -> None:
    if options.targets:
        design_front.check(name, options)
        return design_front.write_proposals(options, asked(options))
    if options.budget is not None:
        check_budget(name)
    if options.reference:
        raise UserError("--reference is the point that hypervolumes of --targets are measured from; leave it out without these")
    if options.minimise not in (None, (), (options.target,)):
        raise UserError(f"--minimise {' '.join(options.minimise or ())}: names stand there with --targets alone")
    if (options.data is None) == (options.problem is None):
        raise UserError("design needs --data FILE --target COLUMN, or --problem NAME")
    problem = None
    if options.problem is not None:
        check_problem(options)
        problem = _problem(options.problem, options.path)
        data = problem.visible
    else:
        data = designs(options)
    out = Path(options.out or Path("runs", "design", file_part(f"{name}-{data.name}")))
    with alone(out, what=str(out)), resumable(out / "fits"):
        _write_proposals(method, data, problem, options, out)


def _write_proposals(method: Any, data: Any, problem: Any, options: Design, out: Path) -> None:
    """Proposes, writes and prints, for whoever has the folder `out` to itself."""
    with Watch() as watch:
        ways: dict[str, Any] = {"repeat": options.repeat, "validate": problem is None}
        made = method.propose(data, options.n, seed=options.seed, out=out / "fits", watch=watch, **ways)
    scores = None if problem is None else problem.score(made)
    from deadreckon.mbo.batch import repeats_told
    from deadreckon.mbo.misfits import misfits_told
    from deadreckon.mbo.nn_distance import nn_distance
    from deadreckon.mbo.proposal_table import about, added_columns
    from deadreckon.mbo.unscored import unscored_told
    from deadreckon.report.design import write_design

    far = nn_distance(data, made.x)
    more = added_columns(data, made, None if scores is None else scores.true)
    written = data.write(out / "proposals.csv", made.x, more)
    for line in _told(data, made):
        print(line)
    fit = [*misfits_told(data, made.quality), *([made.warning] if made.warning else [])] if problem is None else []
    for line in [*repeats_told(data, made.x), *unscored_told(data, made.x), *fit]:
        print(f"! {line}", file=sys.stderr)
    if scores is not None:
        print(f"{scores}\nthe oracle is {problem.about if problem else ''}")
    print(written)
    write_beside(data.decode(made.x) | more, about(data, made), out / "proposals.xlsx")
    print(write_design(data, made, far, out / "report.html", scores))


def _told(data: Any, made: Any) -> list[str]:
    from deadreckon.mbo.effects import best_permitted, most_expected

    best, most = (float(data.shown(scores.max())) for scores in (data.y, made.predicted))
    tied = int((data.y == data.y.max()).sum())
    ties = f" (shared by {tied:,} designs)" if tied > 1 else ""
    within = float(data.shown(data.y[best_permitted(data)]))
    inside = f", within the rules {within:,.4g}" if within != best else ""
    lines = [f"{size_told(data)}; best {data.target} {best:,.4g}{ties}{inside}"]
    how = made.how
    predicted = f", best {how} {data.target} {most:,.4g}" if made.predicts else ""
    if made.predicts and made.fitted is not None:
        predicted += f" (for a measured design {float(data.shown(most_expected(data, made.fitted)[1])):,.4g})"
    lines.append(f"{made.method}: {len(made):,} proposals{predicted} ({made.seconds:,.0f} s)")
    if made.compared:
        return [*lines, *map(str, made.compared), made.reason]
    return lines if made.quality is None else [*lines, str(made.quality)]


def _problem(name: str, path: str | None) -> Any:
    from deadreckon.mbo import problem

    return problem(name) if path is None else problem(name, path=path)


def problems(args: Sequence[str]) -> None:
    """Lists the problems."""
    from deadreckon.files import home
    from deadreckon.mbo import PROBLEMS
    from deadreckon.mbo.problems.download import SOURCES
    from deadreckon.text_table import table

    parse(Problems, args, "design problems")
    rows = [["problem", "file", "what"]]
    for name, known in PROBLEMS.items():
        there = "" if known.file is None or (home() / "designs" / known.file).is_file() else " (missing)"
        rows.append([name, f"{known.file or '-'}{there}", known.about])
    print(table(rows))
    print(f"\nfiles lie in {home() / 'designs'}, or are given with --path; `deadreckon design get NAME` downloads those of")
    print(f"{', '.join(SOURCES)}")


@dataclass
class Get:
    """Download the file of a problem; an interrupted download is continued."""

    name: Annotated[str, tyro.conf.Positional]  # name of the problem
    force: bool = False  # whether to download the file again


def get(args: Sequence[str]) -> None:
    """Downloads a problem's file."""
    from deadreckon.mbo.problems.download import get as download

    options = parse(Get, args, "design get")
    with Bar(f"downloading the file of {options.name}", None, "bytes") as bar:
        path, new = download(options.name, force=options.force, progress=bar)
    if not new:
        print(f"! {path.name} is there already; --force downloads it again", file=sys.stderr)
    print(path)


def methods(args: Sequence[str]) -> None:
    """Lists the methods."""
    from deadreckon.mbo import DESIGNERS
    from deadreckon.text_table import table

    parse(Methods, args, "design methods")
    print(table([["method", "algorithm and source"], *([name, line] for name, (_, line) in DESIGNERS.items())]))


@dataclass
class Problems:
    """List the problems."""


@dataclass
class Methods:
    """List the methods."""


def bench(args: Sequence[str]) -> None:
    """Runs the protocol and prints its tables."""
    options = parse(Bench, args, "design bench")
    from deadreckon.mbo.problems.registry import check_known
    from deadreckon.mbo.protocol import evaluate_designers, tables
    from deadreckon.mbo.registry import sized

    for name, count in (("seeds", options.seeds), ("together", options.together)):
        if count is not None and count < 1:
            raise UserError(f"--{name} must be 1 or more, got {count}")
    names = [name.strip() for name in options.methods.split(",")]
    wanted = [name.strip() for name in options.problems.split(",")]
    if strangers := set(options.paths) - set(wanted):
        raise UserError(f"--paths names {', '.join(sorted(strangers))}, which is not among --problems")
    seeds = range(options.seed, options.seed + options.seeds)
    results = []
    designers = {p: [(name, sized(name, p, options.budget)) for name in names] for p in wanted}  # names are checked first
    for name in wanted:
        check_known(name, **({"path": options.paths[name]} if name in options.paths else {}))
    for name in wanted:
        problem = _problem(name, options.paths.get(name))
        told = lambda r: print(f"{r.method} on {r.problem}: {r.seconds:,.0f} s", flush=True)  # noqa: E731
        asked = {"seeds": seeds, "together": options.together, "out": options.out}
        with resumable(Path(options.out)), Watch() as watch:
            results += evaluate_designers(problem, designers[name], options.n, **asked, watch=watch, on_result=told)
    print(f"\n{tables(results)}")


@dataclass
class Describe:
    """Draft the schema of a table of experiments: role, kind, range and levels of every column."""

    data: Annotated[str, tyro.conf.Positional]  # table of scored designs
    target: str | None = None  # column of the scores; None: the last column of numbers
    file: Annotated[Reading, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Reading)  # how the table is read
    save: str | None = None  # path of the TOML file to write; None: print the schema


def describe(args: Sequence[str]) -> None:
    """Drafts a schema."""
    from deadreckon.mbo.design_draft import describe as drafted

    options = parse(Describe, args, "design describe")
    schema, told = drafted(options.data, options.target, **mapping_options(options.file))
    for line in told:
        print(f"! {line}", file=sys.stderr)
    if options.save is None:
        print(schema.to_toml(Path(options.data).name))
        return
    if Path(options.save).exists():
        raise UserError(f"{options.save} is there already; give another --save, or remove it")
    schema.save(options.save, Path(options.data).name)
    print(options.save)


_MORE = {"describe": describe, "problems": problems, "get": get, "methods": methods, "bench": bench}
