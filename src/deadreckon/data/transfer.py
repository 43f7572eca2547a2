"""Transfers of files over http that survive a broken connection and a killed process, with checksums and progress.

A transfer goes into a part, with the server's information about the file beside it; after any interruption, the next transfer
continues from there.
"""

import hashlib
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from email.message import Message
from pathlib import Path
from typing import Any

from deadreckon._version import __version__
from deadreckon.data.connection import Broken, NoSuchRest, TransferError, blocks, checksums, open_url
from deadreckon.errors import UserError, cannot_write
from deadreckon.files import alone, read_json, reserve, write_json
from deadreckon.interrupts import resumable

Progress = Callable[[int, int | None], None]  # bytes that are there, bytes in all where the server says
Sums = Mapping[str, tuple[str, str]]  # {who says so: (algorithm, hexadecimal)}

_BLOCK = 1 << 20  # bytes read from the disk at a time
_LONGEST = 30.0  # seconds between two tries, at most


@dataclass(frozen=True)
class RetryPolicy:
    """The retries of a transfer.

    Attributes:
        tries: number of tries without a single further byte before giving up.
        timeout: seconds without an answer that end a try.
        sleep: waits for some seconds.
    """

    tries: int = 5
    timeout: float = 30.0
    sleep: Callable[[float], None] = time.sleep


@dataclass(frozen=True)
class Received:
    """A completely received file: address, checksum, size in bytes, and the source of a matching checksum."""

    url: str
    sha256: str
    size: int
    vouched: str | None


def fetch(
    url: str,
    part: Path,
    sums: Sums | None = None,
    *,
    progress: Progress | None = None,
    retry: RetryPolicy | None = None,
) -> Received:
    """Makes `part` the file at `url`, from where an earlier transfer stopped if the server still has the same file.

    Args:
        url: http or https; redirects are followed, though never from https to http.
        part: the file. What the server said of it is kept beside it in `part` + `.json`.
        sums: that the file must have, beside those that the server names.
        progress: called with the bytes that are there, and the bytes in all or None.
        retry: how long it is kept up.

    Raises:
        TransferError: one line with the address. A file whose checksum is wrong is removed, a broken one kept.
    """
    progress, retry = progress or (lambda done, total: None), retry or RetryPolicy()
    best, failed = file_size(part), 0
    while True:
        try:
            said, hashes = _try(url, part, {algorithm for algorithm, _ in (sums or {}).values()}, progress, retry.timeout)
            break
        except Broken as error:
            if isinstance(error, NoSuchRest):
                forget(part)
            have = file_size(part)
            best, failed = max(best, have), 1 if have > best else failed + 1
            if failed >= retry.tries:
                kept = f" ({have:,} bytes are kept; the same command continues)" if have else ""
                raise TransferError(f"{url}: {error}, {failed} times in a row{kept}") from error
            retry.sleep(min(2.0 ** (failed - 1), _LONGEST))
    vouched = None
    for who, (algorithm, wanted) in {**said.sums, **(sums or {})}.items():
        if hashes[algorithm] != wanted:
            forget(part)
            text = f"expected {algorithm} {wanted} (by {who}), got {hashes[algorithm]}"
            raise TransferError(f"{url}: {text}; the file was removed")
        vouched = who
    return Received(url, hashes["sha256"], file_size(part), vouched)


def download_file(url: str, place: Path, check: Callable[[Path], Any], *, retry: RetryPolicy | None = None) -> Path:
    """Makes `place` the file at `url`, unless there is one already, and gives it.

    Args:
        url: as for `fetch`.
        place: the file.
        check: reads a file, and raises a `UserError` if it is not what is wanted; then it is not kept.
        retry: as for `fetch`.

    Raises:
        UserError: it did not come, is something else, or cannot be written.
    """
    if place.is_file():
        return place
    try:
        part = place.with_name(f".{place.name}.part")
        with alone(place), resumable(part):
            fetch(url, part, retry=retry)
            try:
                check(part)
            except UserError as error:
                forget(part)
                raise TransferError(f"{url}: {str(error).removeprefix(f'{part}: ')}; the file was removed") from error
            part.replace(place)
            forget(part)
    except OSError as error:
        raise cannot_write(place, error) from error
    return place


def forget(part: Path) -> None:
    """Removes a part and what was said of it."""
    part.unlink(missing_ok=True)
    _beside(part).unlink(missing_ok=True)


@dataclass(frozen=True)
class _Said:
    """What a server said of a file. Kept beside its part, so that a later process can go on.

    Attributes:
        url: that was asked for, not one that it was redirected to.
        etag: of the file's state; None if there is none, or none that stands for every byte.
        modified: when the file was changed last.
        size: bytes.
        sums: {who says so: (algorithm, hexadecimal)}.
    """

    url: str
    etag: str | None
    modified: str | None
    size: int | None
    sums: Sums

    @classmethod
    def of(cls, url: str, headers: Message, linked: str | None) -> "_Said":
        etag, size = headers.get("ETag"), headers.get("Content-Length", "")
        strong = None if etag is None or etag.startswith("W/") else etag
        return cls(url, strong, headers.get("Last-Modified"), int(size) if size.isdigit() else None, checksums(headers, linked))

    @property
    def validator(self) -> str | None:
        """By which the server knows whether it still has the same file."""
        return self.etag or self.modified

    def goes_on(self, headers: Message, later: "_Said", have: int) -> bool:
        """Whether a partial answer is the rest of this file, after `have` bytes."""
        place = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", headers.get("Content-Range", "").strip())
        if place is None or int(place[1]) != have or (place[2] != "*" and self.size is not None and int(place[2]) != self.size):
            return False
        same = later.etag is None or later.etag == self.etag
        both = later.sums.keys() & self.sums.keys() - {"the server's Content-MD5"}  # that of a part is a part's
        return same and all(later.sums[who] == self.sums[who] for who in both)


def _try(url: str, part: Path, algorithms: set[str], progress: Progress, timeout: float) -> tuple[_Said, dict[str, str]]:
    """Gets what is missing of `part`, in one connection; gives what was said of it and its checksums.

    Raises:
        Broken: another try may do better.
        TransferError: none will.
    """
    known = _remembered(part, url)
    have = 0 if known is None else file_size(part)
    if known is not None and have and have == known.size:
        progress(have, have)
        return known, file_hashes(part, _hashes(known, algorithms))
    if known is None or known.validator is None or (known.size is not None and have > known.size):
        have = 0
    headers = {"Accept-Encoding": "identity", "User-Agent": f"deadreckon/{__version__}"}
    if known is not None and known.validator is not None and have:
        headers |= {"Range": f"bytes={have}-", "If-Range": known.validator}
    with open_url(url, headers, timeout) as (response, linked):
        said = _Said.of(url, response.headers, linked)
        if response.status == 206 and known is not None and have:
            if not known.goes_on(response.headers, said, have):
                forget(part)
                raise Broken("the file changed on the server")
            said = known
        elif response.status != 200:
            raise TransferError(f"{url}: the server answered {response.status} {response.reason}, 200 is needed")
        elif response.headers.get_content_type() == "text/html":
            # What a hotel's network says before one pays; it must not replace what has come.
            raise TransferError(f"{url}: the server sent a web page instead of the file")
        else:
            have = 0
            forget(part)
        _make_room(part, said.size, have)
        hashes = _hashes(said, algorithms)
        if have:
            file_hashes(part, hashes)
        else:
            write_json(_beside(part), asdict(said))
        with open(part, "ab") as file:
            progress(have, said.size)
            for block in blocks(response, timeout):
                file.write(block)
                have += len(block)
                for hash_ in hashes.values():
                    hash_.update(block)
                progress(have, said.size)
    if said.size is not None and have != said.size:
        raise Broken(f"the connection broke after {have:,} of {said.size:,} bytes")
    return said, {algorithm: hash_.hexdigest() for algorithm, hash_ in hashes.items()}


def _hashes(said: _Said, algorithms: set[str]) -> dict[str, Any]:
    named = {"sha256", *algorithms, *(algorithm for algorithm, _ in said.sums.values())}
    return {algorithm: hashlib.new(algorithm, usedforsecurity=False) for algorithm in named}


def file_hashes(path: Path, hashes: Mapping[str, Any]) -> dict[str, str]:
    """Feeds a file to `hashes`, and gives them in hexadecimal."""
    with open(path, "rb") as file:
        while block := file.read(_BLOCK):
            for hash_ in hashes.values():
                hash_.update(block)
    return {algorithm: hash_.hexdigest() for algorithm, hash_ in hashes.items()}


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal."""
    return file_hashes(path, {"sha256": hashlib.sha256()})["sha256"]


def _beside(part: Path) -> Path:
    return part.with_name(f"{part.name}.json")


def file_size(part: Path) -> int:
    """Bytes of a file; 0 if there is none."""
    return part.stat().st_size if part.exists() else 0


def _remembered(part: Path, url: str) -> _Said | None:
    """What was said of a part of that address; None if there is none, or what is there is of no use."""
    if not part.exists() or not _beside(part).exists():
        return None
    try:
        said = _Said(**read_json(_beside(part), _Said))
        said = replace(said, sums={who: (algorithm, value) for who, (algorithm, value) in said.sums.items()})
    except (UserError, TypeError, ValueError, AttributeError):  # costs a transfer from the start, and nothing else
        return None
    return said if said.url == url else None


def _make_room(part: Path, size: int | None, have: int) -> None:
    """Refuses a file that the disk cannot hold before its first byte is fetched."""
    if size is None:
        return
    spare = part.with_name(f"{part.name}.room")  # always the same, so that a killed process's does not stay for ever
    try:
        spare.touch()
        reserve(spare, size - have)
    except OSError as error:
        raise UserError(f"no room for {size - have:,} bytes in {part.parent}: {error.strerror or error}") from error
    finally:
        spare.unlink(missing_ok=True)
