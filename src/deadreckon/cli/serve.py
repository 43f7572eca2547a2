"""`deadreckon serve`: a policy as an HTTP service."""

import contextlib
import socket
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from deadreckon.cli.parse import RUN, parse
from deadreckon.errors import UserError, extra


@dataclass
class Serve:
    """Serve a policy over HTTP: POST /predict takes rows as JSON and returns named actions; GET /docs describes it."""

    policy: RUN
    host: str = "127.0.0.1"  # address to listen on; 127.0.0.1 answers this machine alone, 0.0.0.0 the network
    port: int = 8000  # port to listen on; 0: any free one
    policy_seed: int | None = None  # seed of the run whose policy is served; None: the first that has not failed
    sampled: bool | None = None
    """whether requests that do not say greedy=true or false get sampled actions; None: as in the evaluation, else no"""
    seed: int | None = None
    """random seed of sampled actions, and of a mixture's members if rows name no episode; None: one for each process"""
    max_body: int = 1_000_000  # largest body of a request in bytes; a larger one is refused with status 413
    max_rows: int = 10_000  # largest number of rows in a request; more are refused with status 413


def serve(args: Sequence[str]) -> None:
    """Serves until it is interrupted."""
    options = parse(Serve, args, "serve")
    for name in ("max_body", "max_rows"):
        if getattr(options, name) < 1:
            raise UserError(f"--{name.replace('_', '-')} must be at least 1, got {getattr(options, name)}")
    try:
        import uvicorn

        from deadreckon.runs.service import Limits, Service, app
    except ImportError as error:
        raise UserError(f"serve needs {error.name}: {extra('serve')}") from error
    from deadreckon.runs.player import chosen, predictor

    found = chosen(options.policy, options.policy_seed)
    sampled, limits = found.sampled if options.sampled is None else options.sampled, Limits(options.max_body, options.max_rows)
    for line in found.doubts(sampled):
        print(f"! {line}", file=sys.stderr, flush=True)
    service = Service(predictor(found.file), found.words, limits, options.seed, sampled)
    with _listening(options.host, options.port) as listening:
        host, port = options.host, listening.getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        print(f"{found.words}: http://{shown}:{port}/predict, described at http://{shown}:{port}/docs", flush=True)
        config = uvicorn.Config(
            app(service), log_level="error", access_log=False, lifespan="off", server_header=False, timeout_keep_alive=30,
            timeout_graceful_shutdown=5,
        )  # fmt: skip
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(config).run(sockets=[listening])


def _listening(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=2048)
    except (OSError, OverflowError, UnicodeError) as error:  # the last of names that no host has
        raise UserError(f"cannot listen on {host}, port {port}: {getattr(error, 'strerror', None) or error}") from error
