"""Downloads of the files that problems are made of, into the package's folder of designs."""

import zipfile
from pathlib import Path
from typing import NamedTuple

from deadreckon.data.transfer import Progress, RetryPolicy, fetch, forget
from deadreckon.errors import UserError, unknown
from deadreckon.files import alone, home, replacing
from deadreckon.mbo.problems.gfp import FILE as GFP_FILE
from deadreckon.mbo.problems.molecule import FILE as MOLECULE_FILE
from deadreckon.mbo.problems.superconductor import FILE as SUPERCONDUCTOR_FILE


class Source(NamedTuple):
    """Where a problem's file comes from: its address, the member that is wanted if it is a zip, and its name here."""

    url: str
    member: str | None
    file: str


SOURCES = {
    # UCI's spelling.
    "superconductor": Source(
        "https://archive.ics.uci.edu/static/public/464/superconductivty+data.zip", "train.csv", SUPERCONDUCTOR_FILE
    ),
    "gfp": Source("https://raw.githubusercontent.com/gitter-lab/nn4dms/master/data/avgfp/avgfp.tsv", None, GFP_FILE),
    "molecule": Source(
        "https://raw.githubusercontent.com/molML/MoleculeACE/main/MoleculeACE/Data/benchmark_data/CHEMBL234_Ki.csv",
        None, MOLECULE_FILE,
    ),
}  # fmt: skip


def get(
    name: str, *, force: bool = False, progress: Progress | None = None, retry: RetryPolicy | None = None
) -> tuple[Path, bool]:
    """Downloads a problem's file and gives its path, and whether it came now or was there before.

    A transfer that breaks goes on where it stopped.

    Args:
        name: among `SOURCES`.
        force: download it again if it is there.
        progress: see `data.transfer.fetch`.
        retry: see `data.transfer.fetch`.

    Raises:
        UserError: a problem without a source, or a file that does not come or holds something else.
    """
    if name not in SOURCES:
        raise unknown("problem to download", name, SOURCES)
    source, place = SOURCES[name], home() / "designs" / SOURCES[name].file
    if place.is_file() and not force:
        return place, False
    with alone(place):
        part = place.with_name(f".{place.name}.part")
        fetch(source.url, part, progress=progress, retry=retry)
        try:
            content = part.read_bytes() if source.member is None else _member(part, source.member)
        except (KeyError, zipfile.BadZipFile) as error:
            forget(part)
            raise UserError(f"{source.url}: no zip with {source.member} in it; the file was removed") from error
        with replacing(place) as temporary:
            temporary.write_bytes(content)
        forget(part)
    return place, True


def _member(path: Path, name: str) -> bytes:
    with zipfile.ZipFile(path) as archive:
        return archive.read(name)
