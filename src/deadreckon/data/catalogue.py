"""Named logs: their entries (`entries`) and their files."""

import difflib
from dataclasses import replace
from pathlib import Path
from typing import Any

from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import ENTRIES, ORIGINAL, TWIN, VERSION, Entry
from deadreckon.data.formats import minari_ids as minaris
from deadreckon.data.formats.build import ENDINGS, TABLE_ENDINGS
from deadreckon.data.formats.io import read
from deadreckon.errors import UserError, unknown
from deadreckon.files import home, is_there, read_json
from deadreckon.names import file_part

TWINS = {found.minari: name for name, found in ENTRIES.items() if found.minari is not None}  # by Minari's ids


def version_of(name: str) -> str:
    """The version of our recipe of that name."""
    return ENTRIES[name].version if name in ENTRIES else VERSION


def plain_name(name: str) -> str:
    """The name of the downloaded copy for a Minari id (`hopper-medium-v2@minari`); other names unchanged."""
    return f"{TWINS[name]}@{TWIN}" if name in TWINS else name


def entry(name: str) -> Entry:
    """The entry of a log, by D4RL's name, that of a copy (`maze2d-umaze-v1@dr1`, `@d4rl`, `@minari`) or its twin's Minari id.

    Raises:
        UserError: no such name, with a similar name if there is one; or no such copy.
    """
    base, _, version = plain_name(name).partition("@")
    if base not in ENTRIES:
        if not difflib.get_close_matches(base, ENTRIES, 1, 0.5):
            raise UserError(f"no file {name}, and no data set of that name (`deadreckon data list` lists them)")
        raise unknown("data set", base, ENTRIES)
    found = ENTRIES[base]
    own = () if found.recipe is None else (found.version, *found.earlier)
    if version and version not in (*own, *found.sources):
        known = [f"{base}@{each} (collected{' earlier' * (i > 0)})" for i, each in enumerate(own)]
        known += [f"{base}@{source} (downloaded)" for source in found.sources]
        raise UserError(f"unknown version {version!r} of {base}: known are {', '.join(known)}")
    return found


def is_elsewhere(name: str) -> bool:
    """Whether originals of a log, by its name, are of another world than the task that the catalogue names."""
    found = ENTRIES.get(name.partition("@")[0])
    return found is not None and found.elsewhere


def cached_path(name: str) -> Path:
    """The path of the log `name`, which need not exist: a catalogue name means the collected version.

    Raises:
        UserError: the name would lead out of the cache.
    """
    if name.startswith("~") or file_part(name) != name:
        raise UserError(f"{name!r} is no file here and not the name of a log, such as maze2d-umaze-v1")
    if name in ENTRIES:
        name = ENTRIES[name].collected
    return home() / "data" / f"{name}.hdf5"


def record_path(path: Path) -> Path:
    """Where it is recorded what the original at `path`, which is kept byte for byte, was downloaded from."""
    return path.with_suffix(".json")


def at_hand(found: Entry) -> list[str]:
    """Which copies of a log are in the cache, in the order in which `load` takes them: collected, original, twin."""
    return [kind for kind in (found.version, *found.sources) if cached_path(f"{found.name}@{kind}").exists()]


def load(name: Path | str, mmap: bool | None = None, strict: bool = False, **options: Any) -> Dataset:
    """The log `name` from the cache, or the log in the file `name`.

    A plain name such as `hopper-medium-v2` selects the first copy in the cache among the log collected by our recipe
    (`hopper-medium-v2@dr1`), the downloaded original (`@d4rl`) and the downloaded Minari version (`@minari`); the name of the
    loaded log includes the version. The longer names select that copy.

    Args:
        name: from the catalogue, or an existing file or folder, or a Minari id, such as `mujoco/hopper/medium-v0`, of an
            installed data set or else of a Minari version in the cache.
        mmap: memory-map the columns; see `read`.
        strict: refuse actions out of bounds instead of warning.
        **options: further options of `read`.

    Raises:
        UserError: one line: no such name, or how to obtain the log.
    """
    text = str(name)
    if text.startswith("minari:") or is_there(name) or (text not in ENTRIES and minaris.installed(text)):
        return read(name, mmap=mmap, strict=strict, **options)
    looks_like_a_file = Path(text).suffix in (*ENDINGS, *TABLE_ENDINGS, ".txt")
    if isinstance(name, Path) or looks_like_a_file:
        raise UserError(f"no file {text}")
    text = plain_name(text)
    if minaris.is_id(text):
        near = difflib.get_close_matches(text, TWINS, 1, 0.8)
        raise unknown("Minari data set", text, TWINS) if near else UserError(minaris.missing(text))
    if text in ENTRIES and (there := at_hand(ENTRIES[text])):
        text = f"{text}@{there[0]}"
    path = cached_path(text)
    if not path.exists():
        raise UserError(_how(entry(text), text.partition("@")[2]))
    if not text.endswith(f"@{ORIGINAL}"):
        return read(path, mmap=mmap, strict=strict, **options)
    asked: dict[str, Any] = {"name": text, **options}
    return _with_record(read(path, mmap=mmap, strict=strict, **asked), path)


def _how(found: Entry, version: str) -> str:
    """What can be done about a log that is not there: any copy of it, or the one of that version."""
    gets = [
        f"`deadreckon data get {found.name} --source {source}` downloads {'the original' if source == ORIGINAL else 'a twin'}"
        for source in found.sources
        if version in ("", source)
    ][:1]
    if found.recipe is None:
        return f"{found.name} is not in the cache yet: {gets[0]}; it cannot be collected here"
    collect = f"`deadreckon data collect {found.recipe}` makes"
    if version == "" and (old := [each for each in found.earlier if cached_path(f"{found.name}@{each}").exists()]):
        return f"{found.name} is cached only as {found.name}@{old[0]}, of an earlier recipe: {collect} {found.collected} here"
    if version in found.earlier:
        return f"{found.name}@{version} is not in the cache, and is of an earlier recipe: {collect} {found.collected} here"
    if version in found.sources:
        return f"{found.name}@{version} is not in the cache yet: {gets[0]}, or {collect} {found.collected} here"
    name = f"{found.name}@{version}" if version else found.name
    parts = sorted(each.stem for each in (home() / "data").glob(f"{found.collected}-*.hdf5"))  # of other lengths or seeds
    beside = f"; in the cache under other names: {', '.join(parts)}" if parts and version in ("", found.version) else ""
    return f"{name} is not in the cache yet: {', or '.join([f'{collect} it here', *gets])}{beside}"


def _with_record(log: Dataset, path: Path) -> Dataset:
    """The original read from `path`, with what was recorded when it was downloaded."""
    record = record_path(path)
    about = read_json(record) if record.exists() else None
    if not isinstance(about, dict) or about.get("bytes") != path.stat().st_size:
        text = f"where it came from is not recorded: no {record.name} that fits the file"
        return replace(log, warnings=(*log.warnings, text))
    return replace(log, provenance=replace(log.provenance, extra={**log.provenance.extra, **about}))
