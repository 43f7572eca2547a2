"""Requests to an ASGI application without a network."""

import asyncio
import json


def ask(service, method, path, body=b"", query="", parts=None, headers=()):
    """Status, headers and body of an answer."""
    said, parts = [], [body] if parts is None else parts
    asked = iter([{"type": "http.request", "body": part, "more_body": i + 1 < len(parts)} for i, part in enumerate(parts)])

    async def receive():
        return next(asked, {"type": "http.disconnect"})

    async def send(message):
        said.append(message)

    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method, "path": path, "raw_path": b"",
        "query_string": query.encode(), "root_path": "", "scheme": "http", "headers": list(headers), "server": ("t", 80),
    }  # fmt: skip
    asyncio.run(service(scope, receive, send))
    found = {key.decode(): value.decode() for key, value in said[0]["headers"]}
    return said[0]["status"], found, b"".join(message.get("body", b"") for message in said[1:])


def post(service, value, query="", **how):
    """Status and JSON of the answer to rows at /predict."""
    body = value if isinstance(value, bytes) else json.dumps(value).encode()
    status, _, answer = ask(service, "POST", "/predict", body, query, **how)
    return status, json.loads(answer)
