"""Downloading known logs, D4RL's originals and their Minari twins, with resume, checksum and progress.

A transfer goes into a hidden part beside the place where the log will be, with what the server said of the file beside it;
whatever breaks or kills it, the next one goes on from there. The log gets its name only when it is whole and can be read.
"""

import base64
import binascii
import contextlib
import hashlib
import http.client
import os
import re
import shutil
import socket
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from email.message import Message
from itertools import pairwise
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote, urlsplit

import numpy as np

from deadreckon._version import __version__
from deadreckon.data.catalogue import ORIGINAL, TWIN, Entry, cached_path, entry, record_path
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError, unknown
from deadreckon.files import alone, read_json, reserve, write_json

# source: (environment variable that overrides the root, the root)
ROOTS = {
    ORIGINAL: ("DEADRECKON_D4RL_URL", "http://rail.eecs.berkeley.edu/datasets/offline_rl"),
    TWIN: ("DEADRECKON_MINARI_URL", "https://huggingface.co/datasets/farama-minari"),
}
Progress = Callable[[int, int | None], None]  # bytes that are there, bytes in all where the server says
Sums = Mapping[str, tuple[str, str]]  # {who says so: (algorithm, hexadecimal)}

_BLOCK = 1 << 20  # bytes taken from the connection at a time, at most
_LONGEST = 30.0  # seconds between two tries, at most
_MAGIC = b"\x89HDF\r\n\x1a\n"
_TRY_AGAIN = (408, 425, 429)  # as may everything from 500 on


@dataclass(frozen=True)
class Patience:
    """How long a transfer is kept up.

    Attributes:
        tries: without a single further byte, before it is given up.
        timeout: seconds without an answer that end a try.
        sleep: waits for some seconds.
    """

    tries: int = 5
    timeout: float = 30.0
    sleep: Callable[[float], None] = time.sleep


@dataclass(frozen=True)
class Got:
    """A downloaded log.

    Attributes:
        name: such as `hopper-medium-v2@d4rl`.
        path: in the cache.
        new: whether it came now, or was there before.
        sha256: of the file that came, which for a twin is Minari's `main_data.hdf5`; None where it was not recorded.
        vouched: who named a checksum that the file has; None if nobody did.
    """

    name: str
    path: Path
    new: bool
    sha256: str | None
    vouched: str | None


@dataclass(frozen=True)
class Received:
    """What is known of a file that came whole: address, checksum, size in bytes, and who vouched for the checksum."""

    url: str
    sha256: str
    size: int
    vouched: str | None


class TransferError(UserError):
    """A file did not come; the log may still be had another way."""


class _Broken(Exception):
    """A try failed in a way that another may not."""


def get(
    name: str,
    source: str = ORIGINAL,
    *,
    sha256: str | None = None,
    force: bool = False,
    progress: Progress | None = None,
    patience: Patience | None = None,
) -> Got:
    """Downloads a known log into the cache, where `deadreckon.load` finds it as `NAME@d4rl` or `NAME@minari`.

    Two processes may ask for the same log: the second is refused while the first is at it.

    Args:
        name: from the catalogue, such as `hopper-medium-v2`.
        source: `d4rl` for the original, `minari` for its twin, which others collected and which differs.
        sha256: what the file's must be, in hexadecimal; for a twin that of its `main_data.hdf5`.
        force: download it again if it is there.
        progress: called with the bytes that are there, and the bytes in all or None.
        patience: of the transfer.

    Raises:
        UserError: one line: no such log, or what went wrong with which address and how the log can be had instead.
    """
    found = _known(name, source)
    wanted = _checked_sum(sha256)
    path = cached_path(f"{found.name}@{source}")
    if path.exists() and not force:
        return _there(found, source, path, wanted)
    sums = {"the caller": ("sha256", wanted)} if wanted else {}
    if source == ORIGINAL and found.sha256:
        sums["the catalogue"] = ("sha256", found.sha256.lower())
    try:
        with alone(path):
            if path.exists() and not force:  # another process was faster
                return _there(found, source, path, wanted)
            make = _original if source == ORIGINAL else _twin
            received = make(found, path, sums, progress or (lambda done, total: None), patience or Patience())
    except TransferError as error:
        raise UserError(f"{error}; `deadreckon data collect {found.recipe}` makes it offline") from error
    except OSError as error:  # of the disk: those of the network were told apart before
        raise UserError(f"cannot write {path}: {error.strerror or error} (what has come is kept)") from error
    return Got(f"{found.name}@{source}", path, True, received.sha256, received.vouched)


def fetch(
    url: str,
    part: Path,
    sums: Sums | None = None,
    *,
    progress: Progress | None = None,
    patience: Patience | None = None,
) -> Received:
    """Makes `part` the file at `url`, from where an earlier transfer stopped if the server still has the same file.

    Args:
        url: http or https; redirects are followed, though never from https to http.
        part: the file. What the server said of it is kept beside it in `part` + `.json`.
        sums: that the file must have, beside those that the server names.
        progress: as for `get`.
        patience: as for `get`.

    Raises:
        TransferError: one line with the address. A file whose checksum is wrong is removed, a broken one kept.
    """
    progress, patience = progress or (lambda done, total: None), patience or Patience()
    best, failed = _size(part), 0
    while True:
        try:
            said, hashes = _try(url, part, {algorithm for algorithm, _ in (sums or {}).values()}, progress, patience.timeout)
            break
        except _Broken as error:
            have = _size(part)
            best, failed = max(best, have), 1 if have > best else failed + 1
            if failed >= patience.tries:
                kept = f" ({have:,} bytes are kept, the same command goes on from there)" if have else ""
                raise TransferError(f"{url}: {error}, {failed} times in a row{kept}") from error
            patience.sleep(min(2.0 ** (failed - 1), _LONGEST))
    vouched = None
    for who, (algorithm, wanted) in {**said.sums, **(sums or {})}.items():
        if hashes[algorithm] != wanted:
            forget(part)
            text = f"expected {algorithm} {wanted} (by {who}), got {hashes[algorithm]}"
            raise TransferError(f"{url}: {text}; the file was removed")
        vouched = who
    return Received(url, hashes["sha256"], _size(part), vouched)


def download_file(
    url: str, place: Path, check: Callable[[Path], Any], *, progress: Progress | None = None, patience: Patience | None = None
) -> Path:
    """Makes `place` the file at `url`, unless there is one already, and gives it.

    Args:
        url: as for `fetch`.
        place: the file.
        check: reads a file, and raises a `UserError` if it is not what is wanted; then it is not kept.
        progress: as for `get`.
        patience: as for `get`.

    Raises:
        UserError: it did not come, is something else, or cannot be written.
    """
    if place.is_file():
        return place
    try:
        with alone(place):
            part = place.with_name(f".{place.name}.part")
            fetch(url, part, progress=progress, patience=patience)
            try:
                check(part)
            except UserError as error:
                forget(part)
                raise TransferError(f"{url}: {str(error).removeprefix(f'{part}: ')}; the file was removed") from error
            part.replace(place)
            forget(part)
    except OSError as error:
        raise UserError(f"cannot write {place}: {error.strerror or error}") from error
    return place


def forget(part: Path) -> None:
    """Removes a part and what was said of it."""
    part.unlink(missing_ok=True)
    _beside(part).unlink(missing_ok=True)


# ---- the two sources ---------------------------------------------------------------------------------------------------


def _original(found: Entry, path: Path, sums: Sums, progress: Progress, patience: Patience) -> Received:
    """Downloads D4RL's file to `path`, byte for byte; where it came from is recorded beside it."""
    from deadreckon.data.formats.hdf5 import read_hdf5

    part = path.with_name(f".{path.name}.part")
    received = fetch(_address(ORIGINAL, found.original or ""), part, sums, progress=progress, patience=patience)
    with _readable(received.url, part, part):
        read_hdf5(part, name=found.name)
    with open(part, "rb+") as file:
        os.fsync(file.fileno())
    # Killed between any two of these steps, a file may lack its record, which `load` tells, but never has another's.
    record_path(path).unlink(missing_ok=True)
    part.replace(path)
    write_json(record_path(path), _record(received))
    forget(part)
    return received


def _twin(found: Entry, path: Path, sums: Sums, progress: Progress, patience: Patience) -> Received:
    """Downloads Minari's files and makes `path` of them, with the columns that every log has."""
    from deadreckon.data.formats.hdf5 import write_hdf5
    from deadreckon.data.formats.minari import read_minari

    twin = found.minari or ""
    repository, _, rest = twin.partition("/")  # on the hub the first part of an id is a repository, the rest a folder
    root = _address(TWIN, f"{repository}/resolve/main/{rest}/data")
    data = path.with_name(f".{path.name}.part") / "data"
    about, main = data / "metadata.json", data / "main_data.hdf5"
    data.mkdir(parents=True, exist_ok=True)
    try:
        forget(about)  # it is small, and that of another time might not fit
        fetch(f"{root}/{about.name}", about, patience=patience)
        steps = _checked_metadata(f"{root}/{about.name}", about)
        received = fetch(f"{root}/{main.name}", main, sums, progress=progress, patience=patience)
        with _readable(received.url, main, data):
            log = read_minari(data)
            if len(log) != steps:
                raise UserError(f"it has {len(log):,} steps, but {about.name} says {steps:,}")
            if found.twin_layout is not None:
                log = _laid_out(log, *found.twin_layout)
    except UserError:
        if not _size(main):  # nothing that the next transfer could go on from
            shutil.rmtree(data.parent)
        raise
    extra = {**log.provenance.extra, "dataset_id": twin, **_record(received)}
    origin = replace(log.provenance, source="minari", recipe=None, path=None, extra=extra)
    log = replace(log, name=f"{found.name}@{TWIN}", provenance=origin)
    write_hdf5(log, path)
    shutil.rmtree(data.parent)
    return received


def _laid_out(log: Dataset, width: int, kept: tuple[int, ...], constants: tuple[float, ...]) -> Dataset:
    """The log with these columns of each observation and constants behind them; the provenance says so.

    Raises:
        UserError: observations have not the `width` that the layout is for.
    """
    if log.spec.observation_size != width:
        raise UserError(f"it has {log.spec.observation_size} numbers an observation, not the {width} that are known of it")

    def change(seen: np.ndarray | None) -> np.ndarray | None:
        if seen is None:
            return None
        behind = np.broadcast_to(np.asarray(constants, seen.dtype), (len(seen), len(constants)))
        return np.concatenate([seen[:, list(kept)], behind], 1)

    columns = {key: change(getattr(log, key)) for key in ("observations", "final_observations", "successors")}
    note = f"columns {_ranges(kept)} of {width}, then {len(constants)} constants"
    return replace(log, **columns, provenance=replace(log.provenance, extra={**log.provenance.extra, "observations": note}))


def _ranges(columns: tuple[int, ...]) -> str:
    """Columns that follow each other as `first-last`."""
    breaks = [i for i in range(1, len(columns)) if columns[i] != columns[i - 1] + 1]
    return ", ".join(f"{columns[a]}-{columns[b - 1]}" for a, b in pairwise([0, *breaks, len(columns)]))


def _checked_metadata(url: str, about: Path) -> int:
    """The number of steps that Minari's metadata says; refuses metadata that our reader could not take safely."""
    try:
        metadata = read_json(about)
        if not isinstance(metadata, dict) or not isinstance(metadata.get("total_steps"), int):
            raise UserError("it is not the metadata of a Minari data set")
        if metadata.get("data_format") != "hdf5":
            raise UserError(f"the data set is stored as {metadata.get('data_format')}; hdf5 is needed")
        # Without them Minari makes the environment that the metadata names, which runs code that a server chose.
        if not all(isinstance(metadata.get(key), str) for key in ("observation_space", "action_space")):
            raise UserError("it names no observation_space and action_space")
    except UserError as error:
        forget(about)
        raise TransferError(f"{url}: {str(error).removeprefix(f'{about} ')}") from error
    return metadata["total_steps"]


@contextlib.contextmanager
def _readable(url: str, part: Path, place: Path) -> Iterator[None]:
    """Removes a part that is no log, and says so with its address in place of `place`, which is read."""
    try:
        with open(part, "rb") as file:
            head = file.read(40)
        if not head.startswith(_MAGIC):
            begins = f"begins with {head.decode('latin-1')!r}" if head else "is empty"
            raise UserError(f"what the server sent is no hdf5 file, it {begins}")
        yield
    except UserError as error:
        forget(part)
        raise TransferError(f"{url}: {str(error).removeprefix(f'{place}: ')}; the file was removed") from error


def _record(received: Received) -> dict[str, Any]:
    """What the provenance of a downloaded log says."""
    date = datetime.now(UTC).isoformat(timespec="seconds")
    return {"url": received.url, "sha256": received.sha256, "vouched": received.vouched, "bytes": received.size, "date": date}


def _known(name: str, source: str) -> Entry:
    """The entry of a log that can be had from `source`."""
    if source not in ROOTS:
        raise unknown("source", source, ROOTS)
    base, _, version = name.partition("@")
    found = entry(base)
    if version not in ("", source):
        raise UserError(f"{name} and the source {source} contradict each other; leave @{version} out")
    if source not in found.sources:
        what = {ORIGINAL: "original at D4RL's", TWIN: "Minari twin"}
        others = "".join(f"--source {other} downloads its {what[other]}, " for other in found.sources)
        raise UserError(f"{base} has no {what[source]}: {others}`deadreckon data collect {found.recipe}` makes it offline")
    return found


def _checked_sum(sha256: str | None) -> str | None:
    if sha256 is not None and not re.fullmatch("[0-9a-fA-F]{64}", sha256):
        raise UserError(f"sha256 must be 64 hexadecimal digits, got {sha256!r}")
    return sha256 and sha256.lower()


def _there(found: Entry, source: str, path: Path, wanted: str | None) -> Got:
    """The log that is at `path` already, if it is the wanted one."""
    if source == ORIGINAL:
        record = read_json(record_path(path)) if record_path(path).exists() else None
        have = _hashed(path, {"sha256": hashlib.sha256()})["sha256"] if wanted else None
    else:
        from deadreckon.data.formats.hdf5 import read_hdf5

        record, have = read_hdf5(path, mmap=True).provenance.extra, None
    record = record if isinstance(record, Mapping) else {}
    have = have or record.get("sha256")
    if wanted and have != wanted:
        raise UserError(f"{path} is there with another sha256: expected {wanted}, got {have}; --force downloads it again")
    return Got(f"{found.name}@{source}", path, False, have, "the caller" if wanted else record.get("vouched"))


def _address(source: str, place: str) -> str:
    """The address of `place` below the root of `source`."""
    variable, root = ROOTS[source]
    root = os.environ.get(variable) or root
    if not re.match(r"https?://[^/]", root):
        raise UserError(f"{variable} must be an address that begins with http:// or https://, got {root!r}")
    return f"{root.rstrip('/')}/{quote(place)}"


# ---- one transfer ------------------------------------------------------------------------------------------------------


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
        return cls(url, strong, headers.get("Last-Modified"), int(size) if size.isdigit() else None, _sums(headers, linked))

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
        _Broken: another try may do better.
        TransferError: none will.
    """
    known = _remembered(part, url)
    have = 0 if known is None else _size(part)
    if known is not None and have and have == known.size:
        progress(have, have)
        return known, _hashed(part, _hashes(known, algorithms))
    if known is None or known.validator is None or (known.size is not None and have > known.size):
        have = 0
    headers = {"Accept-Encoding": "identity", "User-Agent": f"deadreckon/{__version__}"}
    if known is not None and known.validator is not None and have:
        headers |= {"Range": f"bytes={have}-", "If-Range": known.validator}
    with _open(url, part, headers, timeout) as (response, linked):
        said = _Said.of(url, response.headers, linked)
        if response.status == 206 and known is not None and have:
            if not known.goes_on(response.headers, said, have):
                forget(part)
                raise _Broken("the file changed on the server")
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
            _hashed(part, hashes)
        else:
            write_json(_beside(part), asdict(said))
        with open(part, "ab") as file:
            progress(have, said.size)
            for block in _blocks(response, timeout):
                file.write(block)
                have += len(block)
                for hash_ in hashes.values():
                    hash_.update(block)
                progress(have, said.size)
    if said.size is not None and have != said.size:
        raise _Broken(f"the connection broke after {have:,} of {said.size:,} bytes")
    return said, {algorithm: hash_.hexdigest() for algorithm, hash_ in hashes.items()}


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows redirects, to http or https, and never from https to http. Remembers the checksum named on the way."""

    linked: str | None = None

    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        scheme = urlsplit(newurl).scheme
        if scheme not in ("http", "https") or (req.type == "https" and scheme == "http"):
            fp.close()
            raise TransferError(f"{req.full_url}: redirects to {newurl}, which is less safe and not followed")
        self.linked = headers.get("X-Linked-ETag") or self.linked
        return super().redirect_request(req, fp, code, msg, headers, newurl)


@contextlib.contextmanager
def _open(
    url: str, part: Path, headers: Mapping[str, str], timeout: float
) -> Iterator[tuple[http.client.HTTPResponse, str | None]]:
    """The answer, and the checksum that Hugging Face names while it redirects."""
    redirects = _Redirects()
    opener = urllib.request.OpenerDirector()  # with nothing that would open files or anything else than these two
    for handler in (urllib.request.ProxyHandler(), urllib.request.HTTPHandler(), urllib.request.HTTPSHandler(), redirects,
                    urllib.request.HTTPDefaultErrorHandler(), urllib.request.HTTPErrorProcessor()):  # fmt: skip
        opener.add_handler(handler)
    try:
        response = opener.open(urllib.request.Request(url, headers=dict(headers)), timeout=timeout)
    except urllib.error.HTTPError as error:
        with error:
            raise _refusal(url, part, error) from error
    except UserError:
        raise
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise _no_answer(url, error, timeout) from error
    with response:
        yield response, response.headers.get("X-Linked-ETag") or redirects.linked


def _refusal(url: str, part: Path, error: urllib.error.HTTPError) -> Exception:
    """What an answer means that is an error."""
    text = f"the server answered {error.code} {error.reason}".strip()
    if error.code == 416:  # there is no such rest: it has another file now
        forget(part)
        return _Broken(text)
    if error.code in _TRY_AGAIN or error.code >= 500:
        return _Broken(text)
    if 300 <= error.code < 400:
        return TransferError(f"{url}: redirects in a circle, too often or to nowhere ({error.code} {error.url})")
    return TransferError(f"{url}: {text}" + (f" at {error.url}" if error.url != url else ""))


def _no_answer(url: str, error: Exception, timeout: float) -> Exception:
    """What it means that there is no answer: no network or no such server is certain, anything else may pass."""
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    if isinstance(reason, socket.gaierror):
        return TransferError(f"{url}: no network, or no server of that name ({reason.strerror})")
    if isinstance(reason, ConnectionRefusedError):
        return TransferError(f"{url}: connection refused")
    if isinstance(reason, ssl.SSLCertVerificationError):
        return TransferError(f"{url}: the server's certificate is not trusted ({reason.verify_message})")
    if isinstance(reason, (http.client.InvalidURL, ValueError)):
        return TransferError(f"{url}: not an address ({reason})")
    return _Broken(_told(reason, timeout))


def _told(error: Any, timeout: float) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer for {timeout:g} s"
    text = getattr(error, "strerror", None) or " ".join(str(error).split()) or type(error).__name__
    return f"the connection broke ({text})"


def _blocks(response: http.client.HTTPResponse, timeout: float) -> Iterator[bytes]:
    try:
        while block := response.read1(_BLOCK):
            yield block
    except (OSError, http.client.HTTPException) as error:
        raise _Broken(_told(error, timeout)) from error


def _sums(headers: Message, linked: str | None) -> dict[str, tuple[str, str]]:
    """The checksums that a server names; what is none of a known form vouches for nothing."""
    found: dict[str, tuple[str, str]] = {}
    # Hugging Face names large files by their SHA-256, and small ones by a hash of git's, which is shorter.
    if linked and (match := re.fullmatch(r'"?([0-9a-f]{64})"?', linked.strip())):
        found["the server's X-Linked-ETag"] = ("sha256", match[1])
    for header, pattern, algorithm in (
        ("Digest", r"sha-256=([\w+/]+=*)", "sha256"),
        ("Repr-Digest", r"sha-256=:([\w+/]+=*):", "sha256"),
        ("Content-MD5", r"^\s*([\w+/]+=*)\s*$", "md5"),
    ):
        if match := re.search(pattern, headers.get(header, ""), re.IGNORECASE):
            with contextlib.suppress(binascii.Error):
                value = base64.b64decode(match[1], validate=True)
                if len(value) == hashlib.new(algorithm, usedforsecurity=False).digest_size:
                    found[f"the server's {header}"] = (algorithm, value.hex())
    return found


def _hashes(said: _Said, algorithms: set[str]) -> dict[str, Any]:
    named = {"sha256", *algorithms, *(algorithm for algorithm, _ in said.sums.values())}
    return {algorithm: hashlib.new(algorithm, usedforsecurity=False) for algorithm in named}


def _hashed(path: Path, hashes: Mapping[str, Any]) -> dict[str, str]:
    """Feeds a file to `hashes`, and gives them in hexadecimal."""
    with open(path, "rb") as file:
        while block := file.read(_BLOCK):
            for hash_ in hashes.values():
                hash_.update(block)
    return {algorithm: hash_.hexdigest() for algorithm, hash_ in hashes.items()}


def _beside(part: Path) -> Path:
    return part.with_name(f"{part.name}.json")


def _size(part: Path) -> int:
    return part.stat().st_size if part.exists() else 0


def _remembered(part: Path, url: str) -> _Said | None:
    """What was said of a part of that address; None if there is none, or what is there is of no use."""
    if not part.exists() or not _beside(part).exists():
        return None
    try:
        said = _Said(**read_json(_beside(part)))
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
