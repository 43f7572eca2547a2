"""`deadreckon data list|collect|get|sample|info|describe|convert`."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from deadreckon.cli.collect import Collect, collect
from deadreckon.cli.parse import parse
from deadreckon.cli.progress import Bar
from deadreckon.errors import UserError, unknown
from deadreckon.text_table import table


@dataclass
class List:
    """List the known logs and which of them are available locally."""


_COLUMN = tyro.conf.arg(metavar="COLUMN")
_COLUMNS = tyro.conf.arg(metavar="COLUMN [COLUMN ...]")


@dataclass
class Get:
    """Download a known log, the original or its Minari version, with resume and checksum."""

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """name of the log, such as hopper-medium-v2, or the id of its Minari version"""
    source: Literal["d4rl", "minari"] | None = None
    """source of the log: the original (d4rl) or its version on Minari (minari); None: minari for a Minari id, else d4rl"""
    sha256: Annotated[str | None, tyro.conf.arg(metavar="HEX")] = None
    """checksum that the file must have; for minari that of main_data.hdf5"""
    force: bool = False  # whether to download the file again


@dataclass
class Sample:
    """Download a sample table as CSV; without NAME, list the sample tables."""

    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")] = None
    """name of the sample table, such as open-bandit-random-men"""
    out: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None  # file to write; None: NAME.csv
    force: bool = False  # whether to replace an existing file


@dataclass
class Reading:
    """How the file of a table is read; what is not given is detected."""

    separator: Annotated[str | None, tyro.conf.arg(metavar="CHARACTER")] = None
    """character that separates the columns of a text file, or comma, semicolon, tab, pipe, space; None: detected"""
    decimal: Annotated[str | None, tyro.conf.arg(metavar="point|comma")] = None
    """decimal separator of a text file; None: detected"""
    thousands: Annotated[str | None, tyro.conf.arg(metavar="none|point|comma|space|apostrophe")] = None
    """thousands separator of a text file; None: detected"""
    encoding: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """encoding of a text file, such as utf-8, utf-16 or latin-1; None: detected"""
    dates: Annotated[str | None, tyro.conf.arg(metavar="iso|day-first|month-first")] = None
    """order of dates such as 03/04/2024; None: detected"""
    sheet: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None  # sheet of a spreadsheet, by name or number from 1
    query: Annotated[str | None, tyro.conf.arg(metavar="SQL")] = None  # query (one SELECT) that gives the rows of a database
    table: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None  # table of a database


@dataclass
class Mapping(Reading):
    """Which columns of a table (CSV, JSON, Parquet, a spreadsheet, a database) are what, and how its file is read.

    Columns that are not given get a role by name.
    """

    schema: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """schema of the table (TOML), drafted by `deadreckon data describe`; it replaces all other options of columns"""
    action: Annotated[tuple[str, ...] | None, _COLUMNS] = None
    """action columns, or their prefix: `a` stands for a_0, a_1 and so on"""
    reward: Annotated[str | None, _COLUMN] = None  # column of the reward
    observations: Annotated[tuple[str, ...] | None, _COLUMNS] = None
    """columns or prefixes of the observations; None: all others"""
    next_observations: Annotated[tuple[str, ...] | None, _COLUMNS] = None
    """columns or prefixes of the next observations, one per observation; None: by names such as next_x"""
    ignore: Annotated[tuple[str, ...] | None, _COLUMNS] = None  # columns or prefixes that are not observations
    episode: Annotated[str | None, _COLUMN] = None  # column that identifies episodes
    time: Annotated[str | None, _COLUMN] = None  # column that orders the steps of an episode
    terminal: Annotated[str | None, _COLUMN] = None  # column that marks terminals: the task itself ended
    timeout: Annotated[str | None, _COLUMN] = None  # column that marks timeouts: only the recording ended
    propensity: Annotated[str | None, _COLUMN] = None  # column of the probability of the logged action
    keep: Annotated[tuple[str, ...] | None, _COLUMNS] = None
    """columns to keep that are not observations, such as a user to hold out by"""
    group: Annotated[str | None, _COLUMN] = None  # column, such as a user, whose episodes are held out together
    cost: Annotated[tuple[str, ...] | None, _COLUMNS] = None  # columns of costs, which are neither observation nor reward
    legal: Annotated[tuple[str, ...] | None, _COLUMNS] = None
    """column that lists the legal actions (a|b), or one 0/1 column per action: `legal` stands for legal_a, legal_b and so on"""
    next_legal: Annotated[tuple[str, ...] | None, _COLUMNS] = None
    """columns of the legal actions of the next observations, in the same form as --legal"""
    weight: Annotated[str | None, _COLUMN] = None  # column of the weights of rows, which are only stored
    kinds: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="COLUMN=KIND [COLUMN=KIND ...]")] = None
    """kinds of columns whose values suggest another: number, integer, category or flag, such as dose=number"""


@dataclass
class Info:
    """Describe a log, and warn of possible problems."""

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]  # file, folder or name of a known log
    map: Annotated[Mapping, tyro.conf.arg(name="")]  # columns of a table, and how its file is read
    horizon: int | None = None  # steps after which episodes were cut off, if the file does not mark time limits
    html: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """HTML page to write: the columns, returns, actions and coverage as charts; an old one is replaced"""


@dataclass
class Describe:
    """Draft a schema for a table: role, kind, levels and range of each column, with reasons and doubts."""

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TABLE")]
    """table to describe: a CSV, JSON or Parquet file, a spreadsheet or a database"""
    map: Annotated[Mapping, tyro.conf.arg(name="")]  # columns whose roles are known already, and how the file is read
    save: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """file to write the schema to (.toml); None: print it"""
    force: bool = False  # whether to overwrite an existing file


@dataclass
class Convert:
    """Convert a log to another format, chosen by the target's extension: .hdf5 .parquet .csv .npz, a folder, minari:ID."""

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]  # file or folder to read
    target: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TARGET")]  # file, folder or minari:ID to write
    map: Annotated[Mapping, tyro.conf.arg(name="")]  # columns of a table, and how its file is read
    horizon: int | None = None  # steps after which episodes were cut off, if the file does not mark time limits
    force: bool = False  # whether to overwrite an existing target


KINDS = {
    "list": List, "collect": Collect, "get": Get, "sample": Sample, "info": Info, "describe": Describe, "convert": Convert,
}  # fmt: skip


def mapping_options(given: Reading) -> dict[str, Any]:
    """Only what was given, as `deadreckon.read` takes it."""
    return {key: value for key, value in vars(given).items() if value is not None}


def advise(source: str, given: Mapping) -> None:
    """Says that a table which is large for this machine should be converted first; before it is read."""
    from deadreckon.data.formats.stream import advice

    if (line := advice(source, given.separator, given.schema)) is not None:
        print(f"! {line}", file=sys.stderr, flush=True)


def data(args: Sequence[str]) -> None:
    """Runs one of the data commands."""
    if not args or args[0] in ("-h", "--help"):
        print("usage: deadreckon data COMMAND [OPTIONS]\n")
        for name, kind in KINDS.items():
            print(f"  {name:<8}  {(kind.__doc__ or '').splitlines()[0]}")
        return
    if args[0] not in KINDS:
        raise unknown("data command", args[0], KINDS)
    options = parse(KINDS[args[0]], args[1:], f"data {args[0]}")
    run: dict[str, Callable[[Any], None]] = {
        "list": _list, "collect": collect, "get": _get, "sample": _sample, "info": _info, "describe": _describe,
        "convert": _convert,
    }  # fmt: skip
    run[args[0]](options)


def _list(options: List) -> None:
    from deadreckon.collect import recipe
    from deadreckon.data.catalogue import at_hand
    from deadreckon.data.entries import ENTRIES

    rows = [["log", "steps", "task", "in the cache", "original (D4RL)", "Minari version"]]
    for e in ENTRIES.values():
        copies = ", ".join(at_hand(e)) or "-"
        steps = recipe(e.recipe).steps if e.recipe else e.rows
        place = e.task or ("a CARLA server" if e.domain == "carla" else "-")
        rows.append([e.name, f"{steps:,}" if steps else "-", place, copies, e.original or "-", e.minari or "-"])
    print(table(rows, right=(1,)))
    print("\n`deadreckon data collect NAME` collects a log again on this machine; its name is NAME@dr1, of the kitchen @dr2.")
    print("`deadreckon data get NAME --source d4rl|minari` downloads the original (NAME@d4rl) or Minari's (NAME@minari).")


def _get(options: Get) -> None:
    from deadreckon.data.download import get, source_of

    source = source_of(options.name, options.source)
    with Bar(f"downloading {options.name} from {source}", None, "bytes") as bar:
        got = get(options.name, source, sha256=options.sha256, force=options.force, progress=bar)
    if not got.new:
        print(f"! {got.name} is there already; --force downloads it again", file=sys.stderr)
    elif got.vouched is None:
        known = f"no checksum is known for this file; its sha256 is {got.sha256}"
        print(f"! {known}, and --sha256 checks another copy against it", file=sys.stderr)
    print(got.path)


def _sample(options: Sample) -> None:
    from deadreckon.data.samples import SAMPLES, get_sample

    if options.name is None:
        print(table([["table", "rows", "description"], *([n, f"{s.rows:,}", s.about] for n, s in SAMPLES.items())], right=(1,)))
        return
    with Bar(f"downloading {options.name}", None, "bytes") as bar:
        path = get_sample(options.name, options.out, force=options.force, progress=bar)
    print(path)


def _info(options: Info) -> None:
    from deadreckon.data.catalogue import load
    from deadreckon.data.info import describe, render, warnings_for
    from deadreckon.data.leaks import leaks
    from deadreckon.data.told import columns_of, text_of_columns

    if options.html is not None:
        from deadreckon.report.page import check_page

        check_page(options.html, "--html")
    advise(options.file, options.map)
    log = load(options.file, horizon=options.horizon, **mapping_options(options.map))
    info = describe(log)
    warnings = (*warnings_for(log, info), *leaks(log))
    print(f"{render(info)}\n\n{text_of_columns(columns_of(log))}")
    if warnings:
        print("\n" + "\n".join(f"! {line}" for line in warnings))
    if options.html is not None:
        from deadreckon.report.log import write_log

        print(write_log(log, options.html, info, warnings))


def _describe(options: Describe) -> None:
    from deadreckon.data.describe import describe_table

    given = mapping_options(options.map)
    if "schema" in given:
        raise UserError("`data describe` drafts a schema; `data info --schema FILE` shows what a schema makes of a table")
    if options.save is not None and Path(options.save).exists() and not options.force:
        raise UserError(f"{options.save} exists already; --force replaces it")
    schema, told = describe_table(options.file, **given)
    about = f"Schema of {Path(options.file).name}, drafted by `deadreckon data describe`."
    if options.save is None:
        print(schema.to_toml(about))
    else:
        schema.save(options.save, about)
        print(options.save)
    for line in told:
        print(f"! {line}", file=sys.stderr)


def _convert(options: Convert) -> None:
    from deadreckon.data.formats.io import convert

    if options.source == options.target:
        raise UserError("source and target are the same")
    given = mapping_options(options.map)
    with Bar(f"reading {options.source}", None, "rows") as bar:
        log = convert(
            options.source, options.target, force=options.force, horizon=options.horizon, progress=bar, **given
        )  # fmt: skip
    for line in log.warnings:  # those that the new file no longer gives a reason for would not be told again
        print(f"! {line}", file=sys.stderr)
    print(options.target)
