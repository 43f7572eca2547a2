"""A policy as an HTTP service: rows of a table in, named actions out, both as JSON.

`Service` computes answers without a network; `app` serves them by Starlette, which the extra `serve` installs with uvicorn.
Requests cannot name code, files or classes: they are JSON, with rows for the policy's encoder.
"""

import asyncio
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from deadreckon._version import __version__
from deadreckon.errors import UserError, unknown
from deadreckon.policies.table_predict import Prediction, Predictor
from deadreckon.randomness import check_seed
from deadreckon.runs.service_page import described, openapi, page

SHORT = 1_000  # bytes of a body, of a few rows, whose actions are computed at once and not in a thread
SLOWEST = 10.0  # seconds in which the whole of a request's body must have arrived
_WORDS = {"true": True, "1": True, "false": False, "0": False}
_OPTIONS = ("probabilities", "greedy", "outside", "seed")


@dataclass(frozen=True)
class Limits:
    """Largest size of a request.

    Attributes:
        body: of its body, in bytes.
        rows: number of rows.
    """

    body: int = 1_000_000
    rows: int = 10_000


class Refused(Exception):
    """A request that is answered with an error.

    Attributes:
        status: HTTP status code.
        text: the error, in one line.
    """

    def __init__(self, status: int, text: str):
        super().__init__(text)
        self.status, self.text = status, text


class Service:
    """A policy that answers requests.

    Args:
        policy: predictor for rows.
        words: a description of the policy.
        limits: of a request.
        seed: of sampled actions in requests without a seed, which follow each other in one stream; None: a random seed.
        sampled: whether requests without the option `greedy` get sampled actions.

    Raises:
        UserError: a seed out of range.
    """

    def __init__(
        self, policy: Predictor, words: str, limits: Limits | None = None, seed: int | None = None, sampled: bool = False
    ):  # fmt: skip
        if seed is not None:
            check_seed(seed)
        self.policy, self.words, self.limits, self.sampled = policy, words, limits or Limits(), sampled
        self.rng = np.random.default_rng(seed)

    def predict(self, body: bytes, query: Mapping[str, str]) -> dict[str, Any]:
        """The answer to rows.

        Args:
            body: JSON: a row {column: value}, or a list of rows; numbers, or lists of them, for policies without a schema.
            query: `probabilities`, `greedy`, `outside` and `seed` as texts.

        Returns:
            `action`, or `actions` of several rows, each {column: value}; `probabilities` and `outside` if requested.

        Raises:
            Refused: the body is not JSON, or too many rows, or rows that the policy refuses.
        """
        rows = _parsed(body)
        if not isinstance(rows, dict | list):
            raise Refused(422, "the body must be a row {column: value}, or a list of rows")
        plain = bool(rows) and not isinstance(rows, dict) and not isinstance(rows[0], dict)  # then a row is a list of numbers
        single = isinstance(rows, dict) or (plain and _depth(rows) <= len(self.policy.encoder.shape or (1,)))
        given = [rows] if single else rows  # so that a dictionary is a row, and never one of columns
        if not given:
            raise Refused(422, "the list of rows is empty")
        if len(given) > self.limits.rows:
            raise Refused(413, f"{len(given):,} rows are too many for a request; at most {self.limits.rows:,} are taken")
        options = self._options(query)
        try:
            done = self.policy.predict(given, **options)
        except UserError as error:
            raise Refused(422, " ".join(str(error).split())) from error
        told = done if isinstance(done, Prediction) else Prediction(done)
        names = [*self.policy.encoder.actions, "action"]
        found = {"actions": _by_row(told.actions if isinstance(told.actions, dict) else {names[0]: told.actions})}
        if told.probabilities is not None:
            found["probabilities"] = _by_row({str(key): values for key, values in told.probabilities.items()})
        if told.outside is not None:
            found["outside"] = told.outside.tolist()
        if not single:
            return found
        return {"action" if key == "actions" else key: values[0] for key, values in found.items()}

    def _options(self, query: Mapping[str, str]) -> dict[str, Any]:
        """The options of `Predictor.predict` that a query names."""
        options: dict[str, Any] = {"seed": self.rng, "greedy": not self.sampled}
        for key, value in query.items():
            if key not in _OPTIONS:
                raise Refused(422, str(unknown("option", key, _OPTIONS)))
            if key == "outside":
                if value not in ("raise", "flag"):
                    raise Refused(422, f"outside must be raise or flag, got {value[:40]!r}")
                options[key] = value
            elif key == "seed":
                if not (value.isascii() and value.isdigit() and len(value) < 16):
                    raise Refused(422, f"seed must be a whole number from 0 to 999999999999999, got {value[:40]!r}")
                options[key] = int(value)
            elif value.lower() not in _WORDS:
                raise Refused(422, f"{key} must be true or false, got {value[:40]!r}")
            else:
                options[key] = _WORDS[value.lower()]
        return options


def _depth(rows: Any) -> int:
    """Depth of nested lists, by the first element of each."""
    depth = 0
    while isinstance(rows, list):
        depth, rows = depth + 1, rows[0] if rows else None
    return depth


def _by_row(columns: Mapping[str, np.ndarray]) -> list[Any]:
    """Columns as one dictionary of plain values per row."""
    return [dict(zip(columns, row)) for row in zip(*(values.tolist() for values in columns.values()))]


def _parsed(body: bytes) -> Any:
    """The value of a JSON text.

    Raises:
        Refused: it is not JSON.
    """

    def no_number(text: str) -> None:
        raise ValueError(f"{text} is not a number of JSON; use null for a missing value")

    try:
        return json.loads(body, parse_constant=no_number)
    except RecursionError as error:
        raise Refused(400, "the body is not JSON that can be read: it is nested too deeply") from error
    except ValueError as error:  # also for bytes that are not UTF-8, and whole numbers of thousands of digits
        raise Refused(400, f"the body is not JSON: {' '.join(str(error).split())[:200]}") from error


def app(service: Service) -> Starlette:
    """The service behind HTTP: POST /predict, GET /health, /schema, /openapi.json and /docs."""
    document = openapi(service.policy, service.words, service.limits, service.sampled)
    health = {"status": "ok", "policy": service.words, "version": __version__}
    texts = {"/health": _json(health), "/schema": _json(described(service.policy, service.words)),
             "/openapi.json": _json(document)}  # fmt: skip
    html = page(service.policy, service.words, document)

    turn = asyncio.Lock()  # one long request at a time has memory for its rows, and others are answered meanwhile

    async def predict(request: Request) -> Response:
        try:
            body = await _body(request, service.limits.body)
            if len(body) <= SHORT:
                return _answer(200, service.predict(body, request.query_params))
            async with turn:
                return _answer(200, await run_in_threadpool(service.predict, body, request.query_params))
        except Refused as error:
            return _answer(error.status, {"error": error.text})

    def fixed(path: str) -> Route:
        async def get(request: Request) -> Response:
            return Response(texts[path], media_type="application/json")

        return Route(path, get, methods=["GET"])

    async def docs(request: Request) -> Response:
        return HTMLResponse(html)

    async def root(request: Request) -> Response:
        return RedirectResponse("/docs")

    async def refused(request: Request, error: Exception) -> Response:
        status = error.status_code if isinstance(error, HTTPException) else 500
        words = {404: f"no such page; the pages are /predict, {', '.join(texts)} and /docs",
                 405: "this method is not for this page",
                 500: "internal error; the log of the service has the cause"}  # fmt: skip
        headers = error.headers if isinstance(error, HTTPException) else None
        return _answer(status, {"error": words.get(status, "the request cannot be answered")}, headers)

    routes = [Route("/predict", predict, methods=["POST"]), *map(fixed, texts), Route("/docs", docs), Route("/", root)]
    return Starlette(routes=routes, exception_handlers={HTTPException: refused, Exception: refused})


async def _body(request: Request, most: int) -> bytes:
    """The body of a request.

    Raises:
        Refused: it is larger than `most` bytes, or does not arrive in time.
    """
    too_large = Refused(413, f"the body is larger than {most:,} bytes")
    length = request.headers.get("content-length", "")
    if length.isdigit() and int(length) > most:
        raise too_large
    parts, size = [], 0
    try:
        async with asyncio.timeout(SLOWEST):
            async for part in request.stream():
                size += len(part)
                if size > most:
                    raise too_large
                parts.append(part)
    except TimeoutError as error:
        raise Refused(408, f"the body has not arrived within {SLOWEST:g} seconds") from error
    except ClientDisconnect as error:
        raise Refused(400, "the connection was closed before the whole body had arrived") from error
    return b"".join(parts)


def _answer(status: int, value: Any, headers: Mapping[str, str] | None = None) -> Response:
    # The rest of a body that was not read completely must not be taken for the next request.
    more = {"connection": "close"} if status in (408, 413) else {}
    return Response(_json(value), status, {**(headers or {}), **more}, "application/json")


def _json(value: Any) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()
