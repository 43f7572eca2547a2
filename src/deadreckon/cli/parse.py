"""Options by tyro, and its error boxes as one line."""

import contextlib
import difflib
import io
import re
import sys
from collections.abc import Sequence
from typing import TypeVar

import tyro

from deadreckon.errors import UserError

T = TypeVar("T")
# What publications call hyperparameters, and fields that may be meant.
SYMBOLS = {
    "alpha": "conservatism penalty imitation regularisation multiplier temperature", "beta": "sharpness temperature",
    "epsilon": "threshold clip", "eta": "diversity", "gamma": "discount", "hidden_dim": "hidden", "hidden_size": "hidden",
    "lam": "min_weight trace", "lambda": "min_weight trace", "learning_rate": "lr actor_lr critic_lr",
    "lr": "actor_lr critic_lr", "num_critics": "critics", "phi": "reach", "policy_freq": "actor_every",
    "policy_noise": "noise", "polyak": "target_rate", "tau": "target_rate expectile share",
}  # fmt: skip
_NOT_A_NUMBER = re.compile(
    r"Error parsing (--[\w.-]+): .*(?:could not convert|invalid literal|no type matching).*'([^']*)'[^']*$"
)


def parse(kind: type[T], args: Sequence[str], command: str) -> T:
    """Command-line arguments as an instance of a dataclass; field comments are the help.

    Raises:
        UserError: what is wrong, in one line, with what it may have meant.
    """
    prog = f"deadreckon {command}"
    if any(a in ("-h", "--help") for a in args):
        return tyro.cli(kind, args=args, prog=prog)
    err, out = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out):
            return tyro.cli(kind, args=args, prog=prog)
    except SystemExit as error:
        if not error.code:
            sys.stdout.write(out.getvalue())
            raise
        raise UserError(_line(kind, err.getvalue(), prog)) from error


def chosen(what: str, args: Sequence[str]) -> tuple[str | None, list[str]]:
    """Takes `--WHAT NAME` out, where the name decides which other options there are.

    Raises:
        UserError: it is given twice.
    """
    rest, name, flag = list(args), None, f"--{what}"
    for i, a in enumerate(rest):
        if a == flag and i + 1 < len(rest):
            name, rest = rest[i + 1], rest[:i] + rest[i + 2 :]
            break
        if a.startswith(f"{flag}="):
            name, rest = a.removeprefix(f"{flag}="), rest[:i] + rest[i + 1 :]
            break
    if any(a == flag or a.startswith(f"{flag}=") for a in rest):
        raise UserError(f"{flag} is given twice; one {what} a run")
    return name, rest


def _line(kind: type, box: str, prog: str) -> str:
    """The first paragraph of tyro's box, without its frame, and the nearest option where one was unknown."""
    text = [re.sub(r"[│╭╮╰╯─]", "", line).strip() for line in box.splitlines()]
    parts, current = [], []
    for line in text:
        if not line or set(line) <= {"-"}:
            parts, current = ([*parts, " ".join(current)] if current else parts), []
        else:
            current.append(line)
    message = parts[1] if len(parts) > 1 else " ".join(parts)
    unknown = re.match(r"Unrecognized options: (--[\w.-]+)", message)
    if unknown:
        near = _nearest(unknown[1], _options(kind))
        return f"unknown option {unknown[1]}" + (f": did you mean {' or '.join(near)}?" if near else f" (see {prog} --help)")
    message = re.sub(rf"Missing from {prog}:", "missing", message)
    if number := _NOT_A_NUMBER.match(message):
        return f"{number[1]} takes a number, got {number[2]!r}"
    return message[:1].lower() + message[1:]


def _nearest(given: str, known: list[str]) -> list[str]:
    """Options like the given one; behind a dot, the part before it is taken as right."""
    prefix, dot, last = given.rpartition(".")
    inside = {k.rpartition(".")[2]: k for k in known if dot and k.startswith(f"{prefix}.")}
    if inside:
        fields = {name.replace("-", "_"): option for name, option in inside.items()}
        meant = [fields[name] for name in SYMBOLS.get(last.replace("-", "_"), "").split() if name in fields]
        if meant:
            return meant[:3]
        holding = [k for last_part, k in inside.items() if last in last_part]
        return holding[:2] or [inside[k] for k in difflib.get_close_matches(last, inside, n=2, cutoff=0.5)]
    return difflib.get_close_matches(given, known, n=2, cutoff=0.6)


def _options(kind: type) -> list[str]:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        tyro.cli(kind, args=["--help"])
    return re.findall(r"--[\w.-]+", out.getvalue())
