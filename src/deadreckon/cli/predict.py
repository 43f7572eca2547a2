"""`deadreckon predict`: what a policy does in the rows of a new table."""

import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from deadreckon.cli.data import Reading, mapping_options
from deadreckon.cli.parse import RUN, parse
from deadreckon.errors import UserError, unknown

_ENDINGS = (".csv", ".parquet")


@dataclass
class Predict:
    """Write the actions of a policy in the rows of a table, named as in the log that it was trained on."""

    policy: RUN
    table: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TABLE")]
    """table with the columns of the log's observations: CSV, JSON, Parquet, a spreadsheet or a database"""
    out: Annotated[str, tyro.conf.arg(metavar="FILE")]  # file to write, .csv or .parquet; an old one is replaced
    probabilities: bool = False  # whether to write the probability of every discrete action as well
    sampled: bool | None = None
    """whether to sample actions instead of taking the deterministic (greedy) ones; None: as in the evaluation, else no"""
    seed: int | None = None
    """random seed of sampled actions, and of a mixture's members if rows name no episode; None: another one, printed"""
    outside: Literal["raise", "flag"] = "raise"
    """treatment of rows with unknown levels or values out of range: refuse the table (raise), or mark rows outside (flag)"""
    keep: Annotated[tuple[str, ...], tyro.conf.arg(metavar="COLUMN [COLUMN ...]")] = ()
    """columns of the table to copy as they are beside the actions, such as an id"""
    policy_seed: int | None = None  # seed of the run whose policy is used; None: the first that has not failed
    file: Annotated[Reading, tyro.conf.arg(name="")] = field(default_factory=Reading)  # how the table's file is read


def predict(args: Sequence[str]) -> None:
    """Predicts and writes."""
    options = parse(Predict, args, "predict")
    out = Path(options.out)
    from deadreckon.randomness import check_seed

    seed = secrets.randbits(31) if options.seed is None else options.seed
    check_seed(seed)
    if out.suffix.lower() not in _ENDINGS:
        raise UserError(f"--out {out}: actions are written as .csv or .parquet")
    from deadreckon.data.schema import Schema
    from deadreckon.data.schema_file import table_of

    source, own = table_of(options.table)
    if out.exists() and any(Path(path).exists() and out.samefile(path) for path in (options.table, source)):
        raise UserError(f"--out {out} is the table itself; choose another name")

    from deadreckon.data.formats.any_table import read_rows
    from deadreckon.runs.player import chosen, predictor

    found = chosen(options.policy, options.policy_seed)
    policy = predictor(found.file, options.table)
    if policy.encoder.schema is None:
        raise UserError(
            f"{found.words} has no schema of its log: it was trained on arrays, on images, in a simulator, on a table without "
            "column options, or by an earlier version; train it again from a table with --action and --reward, or call its "
            "policy in Python with arrays"
        )
    schema = Schema.from_json(policy.encoder.schema, str(found.file)).read_as(own)
    kept: dict[str, Any] = dict.fromkeys(options.keep)  # which reading fills in
    table, told = read_rows(source, schema, plain=kept, **(own or {}) | mapping_options(options.file))
    if not table.num_rows:
        raise UserError(f"{source}: the table has no rows")
    sampled = found.sampled if options.sampled is None else options.sampled
    for line in (*found.doubts(sampled), *told):
        print(f"! {line}", file=sys.stderr)
    for column in options.keep:
        if column not in table.column_names:
            raise UserError(f"--keep: {unknown('column', column, table.column_names)}")
    done = policy.predict(
        table, probabilities=options.probabilities, greedy=not sampled, seed=seed, outside=options.outside
    )
    if options.outside == "raise" and policy.encoder.held:
        beyond = policy.encoder.encode(table, outside="flag").outside
        if beyond.any():
            count = f"{int(beyond.sum()):,} of {table.num_rows:,} rows, from row {int(beyond.argmax())} on,"
            print(f"! {count} hold values beyond those of the log; --outside flag marks them", file=sys.stderr)
    columns = policy.columns(done)
    if twice := [column for column in options.keep if column in columns]:
        raise UserError(f"--keep {twice[0]}: the actions are written under this name; leave it out")
    _write(out, {**{column: _kept(table[column], text) for column, text in kept.items()}, **columns})
    rows, outside = table.num_rows, columns.get("outside_the_log")
    note = "" if outside is None else f", {int(outside.sum()):,} of them outside the log"
    unnamed = policy.player.members and policy.encoder.one.get("episode") is None  # else the name chooses the member
    drawn = f", drawn by the seed {seed}" if sampled or unnamed else ""
    plural = "" if rows == 1 else "s"
    print(f"{found.words}: actions in {rows:,} row{plural}{drawn}{note}, in {out}")
    if units := policy.encoder.units:
        print(f"units: {', '.join(f'{column} in {unit}' for column, unit in units.items())}")


def _kept(read: Any, text: Any) -> Any:
    """A column as its file has it: what was read where that is written alike, else the texts, such as 007, 1.50 and dates."""
    import pyarrow as pa

    return read if read.type == text.type or read.cast(pa.string()).equals(text.cast(pa.string())) else text


def _write(out: Path, columns: dict) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    from deadreckon.data.formats.csv_out import write_table
    from deadreckon.files import replacing

    table = pa.table(columns)
    with replacing(out) as temporary:
        (write_table if out.suffix.lower() == ".csv" else parquet.write_table)(table, temporary)
