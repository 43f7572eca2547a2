"""Logs from tables larger than memory: Parquet, also as a folder of files, Arrow and CSV become a folder of .npy columns.

Parquet and Arrow are first copied, some row groups at a time, to parts that are memory-mapped; a conversion that was killed
resumes after the last finished part. The memory-mapped table is then read by the same code as tables in memory, so that the log
is the same. Arrays with as many rows as the table are kept in files, except for the column that is being processed.
"""

import functools
import os
import shlex
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import dataset

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.build import build
from deadreckon.data.formats.delimited import read_delimited
from deadreckon.data.formats.dialect import Dialect
from deadreckon.data.formats.folder import HEADER, write_folder
from deadreckon.data.formats.kind import DIALECT, READING, no_options, sniff
from deadreckon.data.formats.open_bandit import open_bandit
from deadreckon.data.formats.spool import Spool
from deadreckon.data.formats.spread import from_anybody
from deadreckon.data.formats.totals import of_totals
from deadreckon.data.formats.words import levels_in
from deadreckon.data.schema import as_schema
from deadreckon.data.schema_file import table_of
from deadreckon.data.scratch import Scratch
from deadreckon.data.text_columns import with_dates
from deadreckon.errors import UserError, cannot_write, reading
from deadreckon.files import alone, read_json, write_json
from deadreckon.foreign.arrow import check_arrow
from deadreckon.foreign.door import file_size
from deadreckon.foreign.parquet import ROWS, check_parquet
from deadreckon.interrupts import resumable
from deadreckon.memory import memory
from deadreckon.names import natural
from deadreckon.progress import Progress, unwatched

_PART = 1_000_000  # least number of rows of a part
_LARGE = 2**28  # bytes of a text file above which it is not read as a whole
_PARTS = 256  # largest number of parts, because each is an open file
SHARE = 0.1  # of the machine's memory above which a table should be converted first, as reading it takes several copies
_OURS = b"deadreckon"  # metadata of a Parquet file that `write_parquet` has written
_FORMATS = {b"PAR1": "parquet", b"ARROW1": "ipc"}


def streamed_format(source: Path | str, separator: str | None = None) -> str | None:
    """`parquet`, `ipc` or `csv` (large files) if a table can be converted part by part; None for what is read as a whole."""
    source = Path(source)
    if source.is_dir():
        if (source / HEADER).is_file():
            return None
        files = [each for each in source.rglob("*") if not each.is_dir()]
        if not any(each.suffix == ".parquet" for each in files):
            return None
        for each in files:  # refuses pipes, for which Arrow would wait
            file_size(each)
        return "parquet"
    if not source.is_file():
        return None
    with reading(source, "a table"), open(source, "rb") as file:
        head = file.read(6)
    kind = next((kind for magic, kind in _FORMATS.items() if head.startswith(magic)), None)
    if kind == "parquet":
        from pyarrow import parquet

        with reading(source, "Parquet"):
            return None if _OURS in (parquet.read_schema(source).metadata or {}) else kind
    if kind is None and source.stat().st_size > _LARGE and sniff(source, separator) == "csv":
        return "csv"
    return kind


def advice(source: Path | str, separator: str | None = None, schema: Path | str | None = None) -> str | None:
    """A message to convert a table first, if it takes more than `SHARE` of this machine's memory; else None.

    The size is that of the file on disk, for Parquet that of the unpacked columns. A schema's file stands for its table, and
    says, like a `schema` beside the table, what separates columns if `separator` does not.
    """
    table, ways = table_of(source)
    ways = ways or ({} if schema is None else as_schema(schema).options())
    if (kind := streamed_format(table, separator or ways.get("separator"))) is None:
        return None
    files = sorted(Path(table).rglob("*.parquet")) if Path(table).is_dir() else [Path(table)]
    size = sum(file.stat().st_size for file in files)
    if kind == "parquet":
        from pyarrow import parquet

        with reading(table, "Parquet"):
            about = [parquet.read_metadata(file) for file in files]
        size = sum(each.row_group(group).total_byte_size for each in about for group in range(each.num_row_groups))
    if size <= SHARE * memory():
        return None
    told = f"{size / 1e9:.1f} GB, more than {SHARE:.0%} of the memory"
    command = f"deadreckon data convert {shlex.quote(str(source))} FOLDER"
    return f"{source} holds {told}: `{command}` first, and give FOLDER, which is not read whole"


def convert_table(
    source: Path | str,
    target: Path | str,
    kind: str,
    *,
    force: bool = False,
    strict: bool = False,
    name: str | None = None,
    horizon: int | None = None,
    progress: Progress = unwatched,
    **mapping: Any,
) -> Dataset:
    """Converts a table to a folder, with memory that does not grow with the number of columns.

    A call that is killed leaves a hidden folder beside `target`, from which the next call with the same source resumes.

    Args:
        source: Parquet file, folder of Parquet files (`name=value` folders are columns), Arrow (Feather) file or text file.
        target: folder to write.
        kind: of the source, by `streamed_format`.
        force: replace `target` if it exists.
        strict: refuse actions out of bounds.
        name: of the log; the source's if absent.
        horizon: as for `read_tabular`.
        progress: called after each of several parts with the number of rows read, and the total if it is known.
        **mapping: the roles of columns, as for `from_frame`, and options of the reader, as for `table_of_kind`.

    Returns:
        The log, as in `target`. Its columns are memory-mapped from deleted files, which take disk space as long as the log
        exists.

    Raises:
        UserError: one line with file, column and row. Nothing is left behind.
    """
    target = Path(target)
    work = target.with_name(f".{target.name}.stream")
    with alone(work, what=str(target)), resumable(work):
        try:
            if kind == "csv":
                mapping, table, dialect, told = _of_text(source, work, mapping, progress)
            else:
                schema = None if mapping.get("schema") is None else as_schema(mapping["schema"])
                own = {} if schema is None else schema.options()
                no_options(source, "parquet", {key: value for key, value in own.items() if key not in DIALECT})
                dates = Dialect.asked(dates=mapping.pop("dates", None)).dates or own.get("dates")
                table, told = _spooled(source, kind, work, progress)
                table, order, lines = with_dates(table, dates, levels_in({"schema": schema}).texts)
                told += lines
                dialect = None if order is None else Dialect(dates=order)
            columns = work / "columns"
            shutil.rmtree(columns, ignore_errors=True)  # of a call that was killed
            columns.mkdir()
            found, extra, warnings, space = from_anybody(source, table, mapping, horizon, Scratch(columns), dialect)
            log = build(
                source, found, source=kind, extra=extra, warnings=[*told, *warnings], strict=strict, name=name, horizon=horizon,
                action_space=space,
            )  # fmt: skip
            write_folder(log, target, force=force)
        except UserError:
            shutil.rmtree(work, ignore_errors=True)
            raise
        except OSError as error:
            shutil.rmtree(work, ignore_errors=True)
            raise cannot_write(target, error) from error
        shutil.rmtree(work, ignore_errors=True)
    return log


def _of_text(
    source: Path | str, work: Path, mapping: dict[str, Any], progress: Progress
) -> tuple[dict[str, Any], pa.Table, Dialect, list[str]]:
    """The roles of columns, a text file's table, memory-mapped below `work`, its dialect, and messages."""
    if "schema" in mapping:
        mapping["schema"] = as_schema(mapping["schema"])
        mapping = mapping["schema"].options() | mapping
    no_options(source, "csv", mapping)
    mapping, known = open_bandit(source, "csv", mapping)
    ways = {key: mapping.pop(key) for key in READING if key in mapping}
    cells = work / "cells"
    shutil.rmtree(cells, ignore_errors=True)  # of a call that was killed
    cells.mkdir(parents=True)
    table, dialect, told = read_delimited(source, Dialect.asked(**ways), Spool(cells, progress), levels_in(mapping))
    return mapping, table, dialect, [*known, *told, *of_totals(table)]


def _spooled(source: Path | str, kind: str, work: Path, progress: Progress) -> tuple[pa.Table, list[str]]:
    """The table, memory-mapped from parts below `work`, of which existing ones are kept, and messages."""
    hive = dataset.HivePartitioning.discover(infer_dictionary=True)  # as pyarrow.parquet.read_table has it
    with reading(source, "a table"):
        opened: Any = functools.partial(
            dataset.dataset, source, format=kind, partitioning=hive if Path(source).is_dir() else None
        )
        try:
            found = opened()
        except pa.ArrowInvalid as error:
            if "duplicate field names" not in str(error):
                raise
            raise UserError(f"{source}: two of its columns have one name, and only one can be meant; rename one") from error
        schema, told = _all_columns(source, found)
        found = found if schema is None else opened(schema=schema)
        _ = found.schema.names  # raises if one is not UTF-8, which has not been checked yet
    for file in found.files:
        check_parquet(file, whole=False) if kind == "parquet" else check_arrow(file)
    with reading(source, "a table"):
        groups = _groups(found, kind)
    rows = sum(count for _, count in groups)
    if not rows:
        raise UserError(f"{source}: the table has no rows")
    ordered = sorted(map(str, found.files), key=natural)  # as `_groups` has them
    files = [[file, os.stat(file).st_size, os.stat(file).st_mtime_ns] for file in ordered]
    journal = {"files": files, "rows": rows, "part": _PART}
    if not (work / "source.json").is_file() or read_json(work / "source.json") != journal:
        shutil.rmtree(work, ignore_errors=True)  # of another source
        work.mkdir(parents=True)
        write_json(work / "source.json", journal)
    parts, done = [], 0
    for index, (fragments, count) in enumerate(_parts(groups, rows)):
        part = work / f"{index}.arrow"
        if not part.is_file():
            unfinished = part.with_suffix(".unfinished")
            with open(unfinished, "wb") as file:
                with pa.ipc.new_stream(file, found.schema) as writer:
                    for batch in _batches(source, fragments, found.schema):
                        writer.write_batch(batch)
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(part)
        with pa.memory_map(str(part)) as mapped:
            parts.append(pa.ipc.open_stream(mapped).read_all())
        done += count
        if count < rows:  # not needed for a single part
            progress(done, rows)
    return pa.concat_tables(parts), told


def _all_columns(source: Path | str, found: Any) -> tuple[pa.Schema | None, list[str]]:
    """A schema with the columns of all files, of types that fit all values, and messages on missing columns; None if all files
    have the same columns.

    By default Arrow takes only the columns of the first file.
    """
    files = {fragment.path: fragment.physical_schema.remove_metadata() for fragment in found.get_fragments()}
    first = next(iter(files.values()), None)
    if first is None or all(schema.equals(first) for schema in files.values()):
        return None, []
    try:
        schema = pa.unify_schemas([found.schema, *files.values()], promote_options="permissive")
    except pa.ArrowException as error:
        raise UserError(f"{source}: its files hold different types in a column ({' '.join(str(error).split())})") from error
    told = []
    for name in dict.fromkeys(name for each in files.values() for name in each.names):
        lacking = [path for path, each in files.items() if name not in each.names]
        if lacking:
            where = f"{len(lacking)} of {len(files)} files, such as {Path(lacking[0]).name}"
            told.append(f"column {name} is missing in {where}, and its cells are empty there")
    return schema, told


def _groups(found: Any, kind: str) -> list[tuple[Any, int]]:
    """The units that are read at once, row groups of Parquet or files of Arrow, in the order of the table; with their rows."""
    fragments = sorted(found.get_fragments(), key=lambda fragment: natural(fragment.path))  # part.2 before part.10
    if kind != "parquet":
        return [(fragment, fragment.count_rows()) for fragment in fragments]
    groups = [group for fragment in fragments for group in fragment.split_by_row_group()]
    # `count_rows` would count the whole file for each of its row groups.
    return [(group, sum(each.num_rows for each in group.row_groups)) for group in groups]


def _parts(groups: Sequence[tuple[Any, int]], rows: int) -> Iterator[tuple[list[Any], int]]:
    """Consecutive groups joined into parts, to limit the number of parts; with their rows."""
    least, part, count = max(_PART, -(-rows // _PARTS)), [], 0
    for group, size in groups:
        part.append(group)
        count += size
        if count >= least:
            yield part, count
            part, count = [], 0
    if part:
        yield part, count


def _batches(source: Path | str, fragments: Sequence[Any], schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    for fragment in fragments:
        with reading(source, "a table"):
            for batch in fragment.to_batches(schema=schema, batch_size=ROWS, batch_readahead=2, fragment_readahead=1):
                batch.validate(full=True)  # texts that are not UTF-8 would else fail later
                yield batch
