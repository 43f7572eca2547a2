"""Options by tyro, and its error boxes as one line."""

import contextlib
import dataclasses
import difflib
import io
import re
import sys
from collections.abc import Sequence
from typing import Annotated, Any, TypeVar

import tyro

from deadreckon.errors import UserError
from deadreckon.training.field_names import COMMON, meant

T = TypeVar("T")
_POLICY = (
    "run folder (its first seed that has not failed), folder of `ope` or `recommend` (the policy to deploy), cross-fit, or "
    "policy file (.npz)"
)
RUN = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN", help=_POLICY)]  # whose policy a command uses
_OF_A_PART = re.compile(r"--(\w+)\.(no-)?([\w-]+)(=.*)?")  # such as --agent.no-layer-norm
_WRONG = ("could not convert", "invalid literal", "no type matching", "Could not find valid parse", "input length")
_NOT_PARSED = re.compile(rf"Error parsing (--[\w.-]+): .*(?:{'|'.join(_WRONG)}).*")
_NUMBERS = {"INT": "a whole number", "FLOAT": "a number", "SHARE": "a number"}


def parse(kind: type[T], args: Sequence[str], command: str) -> T:
    """Command-line arguments as an instance of a dataclass; field comments are the help.

    Raises:
        UserError: what is wrong, in one line, with what it may have meant.
    """
    prog, args = f"deadreckon {command}", _with_field_names(kind, args)
    if any(a in ("-h", "--help") for a in args):
        return tyro.cli(kind, args=args, prog=prog)
    err, out = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out):
            found = tyro.cli(kind, args=args, prog=prog)
    except SystemExit as error:
        if not error.code:
            sys.stdout.write(out.getvalue())
            raise
        raise UserError(_line(kind, err.getvalue(), prog)) from error
    _check_values(kind, "", found)
    return found


def _check_values(kind: type, name: str, value: Any) -> None:
    """Refuses whole numbers that no library takes, and an output without a name."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            _check_values(kind, f"{name}{name and '.'}{field.name.replace('_', '-')}", getattr(value, field.name))
    elif isinstance(value, tuple | list):
        for each in value:
            _check_values(kind, name, each)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        parts, known = name.split("."), _options(kind)  # what some fields are part of is not in the option
        options = ["--" + ".".join(parts[i:]) for i in range(len(parts))]
        option = next((each for each in options if each in known), options[0])
        raise UserError(f"{option}: whole numbers are from -2^63 to 2^63 - 1")
    elif value == "" and name.rpartition(".")[2] == "out":
        raise UserError("--out is empty; name a file or a folder")


def chosen(what: str, args: Sequence[str]) -> tuple[str | None, list[str]]:
    """Takes `--WHAT NAME` out, where the name decides which other options there are.

    Raises:
        UserError: it is given twice, or without a name.
    """
    rest, name, flag = list(args), None, f"--{what}"
    if rest[-1:] == [flag]:
        raise UserError(f"{flag} needs a name after it")
    for i, a in enumerate(rest):
        if a == flag:
            name, rest = rest[i + 1], rest[:i] + rest[i + 2 :]
            break
        if a.startswith(f"{flag}="):
            name, rest = a.removeprefix(f"{flag}="), rest[:i] + rest[i + 1 :]
            break
    if any(a == flag or a.startswith(f"{flag}=") for a in rest):
        raise UserError(f"{flag} is given twice; one {what} a run")
    return name, rest


def with_policy_seed(args: Sequence[str]) -> list[str]:
    """The arguments of a command that draws nothing at random, in which `--policy-seed` may still be called `--seed`."""
    return [f"--policy-{a[2:]}" if a == "--seed" or a.startswith("--seed=") else a for a in args]


def _parts(kind: type) -> dict[str, type]:
    """What options behind a dot belong to: `agent` -> its class."""
    return {f.name: f.type for f in dataclasses.fields(kind) if isinstance(f.type, type) and dataclasses.is_dataclass(f.type)}


def _with_field_names(kind: type, args: Sequence[str]) -> list[str]:
    """Options behind a dot under the names of their fields: `--agent.gamma` as `--agent.discount`.

    Raises:
        UserError: a field is set twice, under two names.
    """
    parts, known, out = _parts(kind), {}, []
    for arg in args:
        match = _OF_A_PART.fullmatch(arg)
        fields = meant(parts[match[1]], match[3].replace("-", "_")) if match and match[1] in parts else []
        if match and len(fields) == 1:
            given = f"--{match[1]}.{match[3]}"
            field = f"{match[1]}.{fields[0].replace('_', '-')}"
            if known.setdefault(field, given) != given:
                raise UserError(f"{known[field]} and {given} are one setting; give one of them")
            prefix, dot, name = field.partition(".")
            arg = f"--{prefix}{dot}{match[2] or ''}{name}{match[4] or ''}"
        out.append(arg)
    return out


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
        near = _nearest(kind, unknown[1], _options(kind))
        return f"unknown option {unknown[1]}" + (f": did you mean {' or '.join(near)}?" if near else f" (see {prog} --help)")
    message = re.sub(rf"Missing from {prog}:", "missing", message)
    if pairs := re.match(r"Error parsing (--[\w.-]+): Failed to parse key-value pairs", message):
        return f"{pairs[1]} takes names and values in turn, with blanks between them: {_taken(pairs[1], text)}"
    if wrong := _NOT_PARSED.match(message):
        got = re.findall(r"'([^']*)'", message.rpartition("[")[2])  # all that were given, or the one
        return f"{wrong[1]} takes {_taken(wrong[1], text)}, got {' '.join(got)!r}"
    return message[:1].lower() + message[1:]


def _taken(option: str, text: list[str]) -> str:
    """What an option takes, as its line of the help says: `FLOAT FLOAT`, or in words where that is one number."""
    line = next((line for line in text if line.startswith(f"{option} ")), "")
    shown = line.removeprefix(option).strip().removeprefix("{None}|").strip("{}").replace("{", "")
    shown = shown[1:-1] if shown.startswith("[") else shown  # any number of them, none too
    return _NUMBERS.get(shown, shown or "another kind of value")


def _nearest(kind: type, given: str, known: list[str]) -> list[str]:
    """Options that may be meant: by the names that publications use, else like the given one; a part before a dot is taken as
    right."""
    prefix, dot, last = given.removeprefix("--").rpartition(".")
    name, parts = last.replace("-", "_"), _parts(kind)
    asked = {prefix: parts.get(prefix)} if dot else parts
    meant_ = [f"--{part}.{field}" for part, of in asked.items() if of is not None for field in meant(of, name)]
    meant_ = [option.replace("_", "-") for option in [*([] if dot else (f"--{f}" for f in COMMON.get(name, ()))), *meant_]]
    if found := [option for option in meant_ if option in known]:
        return found[:3]
    inside = {k.rpartition(".")[2]: k for k in known if dot and k.startswith(f"--{prefix}.")}
    if inside:
        holding = [k for last_part, k in inside.items() if last in last_part]
        return holding[:2] or [inside[k] for k in difflib.get_close_matches(last, inside, n=2, cutoff=0.5)]
    known = [option for option in known if option.startswith("--no-") <= given.startswith("--no-")]  # --no-X is the same as --X
    return difflib.get_close_matches(given, known, n=2, cutoff=0.6)


def _options(kind: type) -> list[str]:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        tyro.cli(kind, args=["--help"])
    # Options begin the rows of a list, which are framed or indented; prose stands above it, or behind them.
    rows = re.findall(r"^(?:│ | {2})(?=--?\w)(.*)", out.getvalue(), re.MULTILINE)
    names = (re.match(r"(?:-\w, )?--[\w.-]+(?:(?:, |\|)--[\w.-]+)*", row) for row in rows)
    return list(dict.fromkeys(option for found in names if found for option in re.findall(r"--[\w.-]+", found[0])))
