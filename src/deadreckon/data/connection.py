"""One answer of a server over http: redirects that are followed, what its errors mean, and the checksums that it names."""

import base64
import binascii
import contextlib
import hashlib
import http.client
import re
import socket
import ssl
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from email.message import Message
from typing import IO, Any
from urllib.parse import urlsplit

from deadreckon.errors import UserError

_BLOCK = 1 << 20  # bytes taken from the connection at a time, at most
_TRY_AGAIN = (408, 425, 429)  # as may everything from 500 on


class TransferError(UserError):
    """A file did not come; the log may still be had another way."""


class Broken(Exception):
    """A try failed in a way that another may not."""


class NoSuchRest(Broken):
    """The server has no such part of the file, because it has another file now."""


class Redirects(urllib.request.HTTPRedirectHandler):
    """Follows redirects, to http or https, and never from https to http. Remembers the checksum named on the way."""

    linked: str | None = None

    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        """The next request; refused where the new place is less safe."""
        scheme = urlsplit(newurl).scheme
        if scheme not in ("http", "https") or (req.type == "https" and scheme == "http"):
            fp.close()
            raise TransferError(f"{req.full_url}: redirects to {newurl}, which is less safe and not followed")
        self.linked = headers.get("X-Linked-ETag") or self.linked
        return super().redirect_request(req, fp, code, msg, headers, newurl)


@contextlib.contextmanager
def open_url(
    url: str, headers: Mapping[str, str], timeout: float
) -> Iterator[tuple[http.client.HTTPResponse, str | None]]:
    """The answer, and the checksum that Hugging Face names while it redirects."""
    redirects = Redirects()
    opener = urllib.request.OpenerDirector()  # with nothing that would open files or anything else than these two
    for handler in (urllib.request.ProxyHandler(), urllib.request.HTTPHandler(), urllib.request.HTTPSHandler(), redirects,
                    urllib.request.HTTPDefaultErrorHandler(), urllib.request.HTTPErrorProcessor()):  # fmt: skip
        opener.add_handler(handler)
    try:
        response = opener.open(urllib.request.Request(url, headers=dict(headers)), timeout=timeout)
    except urllib.error.HTTPError as error:
        with error:
            raise _refusal(url, error) from error
    except UserError:
        raise
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise _no_answer(url, error, timeout) from error
    with response:
        yield response, response.headers.get("X-Linked-ETag") or redirects.linked


def _refusal(url: str, error: urllib.error.HTTPError) -> Exception:
    """What an answer means that is an error."""
    text = f"the server answered {error.code} {error.reason}".strip()
    if error.code == 416:
        return NoSuchRest(text)
    if error.code in _TRY_AGAIN or error.code >= 500:
        return Broken(text)
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
    return Broken(_told(reason, timeout))


def _told(error: Any, timeout: float) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer for {timeout:g} s"
    text = getattr(error, "strerror", None) or " ".join(str(error).split()) or type(error).__name__
    return f"the connection broke ({text})"


def blocks(response: http.client.HTTPResponse, timeout: float) -> Iterator[bytes]:
    """The body, a few bytes at a time."""
    try:
        while block := response.read1(_BLOCK):
            yield block
    except (OSError, http.client.HTTPException) as error:
        raise Broken(_told(error, timeout)) from error


def checksums(headers: Message, linked: str | None) -> dict[str, tuple[str, str]]:
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
