"""The command: finds the sub-command, runs it, and turns bad input into one line and exit code 2.

Nothing heavy is imported here, so that `deadreckon --help` answers at once.
"""

import contextlib
import errno
import importlib
import os
import re
import shlex
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import TextIO, cast

from deadreckon import interrupts
from deadreckon._version import __version__
from deadreckon.errors import DivergedError, UserError, printable, unknown
from deadreckon.names import Terminal

# name: (module, function, one line)
COMMANDS = {
    "demo": ("demo", "demo", "run an end-to-end demo in minutes: collect a log, train five agents, decide, report"),
    "tasks": ("show", "tasks", "list the simulators for evaluation, and the logs and policies made in them, with scores"),
    "agents": ("show", "agents", "list the learning algorithms and their sources"),
    "data": ("data", "data", "collect, inspect and convert logs (data list|collect|get|sample|info|describe|convert)"),
    "train": ("train", "train", "train a policy on a log, or online in a simulator, with several seeds in one program"),
    "ope": ("ope", "ope", "estimate the values of policies from a log alone, and choose one; ope bench compares estimators"),
    "tune": ("tune", "tune", "choose an agent's settings by estimates from a log alone, or on training tasks"),
    "recommend": ("recommend", "recommend", "train on a log within a time budget, and recommend a policy to deploy, if any"),
    "design": ("design", "design", "propose designs from a table of scored ones (design describe|problems|get|methods|bench)"),
    "predict": ("predict", "predict", "write a policy's actions for the rows of a new table, named as in its log"),
    "serve": ("serve", "serve", "serve a policy over HTTP: rows as JSON in, named actions out"),
    "evaluate": ("evaluate", "evaluate", "run policies in a simulator, for returns and scores with intervals"),
    "bench": ("bench", "bench", "run a benchmark suite and show its table with published numbers; bench list, bench show"),
    "theory": ("theory", "theory", "run experiments on the thesis's theory in small exact MDPs: gridworld, mmd, bounds, cnml"),
    "explain": ("explain", "explain", "explain a policy by a small decision tree, and name the columns that matter"),
    "export": ("export", "export", "write a policy for other programs: ONNX, StableHLO, numpy or MLflow, with a model card"),
    "monitor": ("monitor", "monitor", "compare a new log with a policy's own: drift, rows outside the log, realised value"),
    "report": ("report", "report", "write a self-contained HTML page about run folders"),
}

# What a path, or the machine, does not allow, wherever it is met.
_OF_THE_SYSTEM = {errno.ENAMETOOLONG, errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EMFILE, errno.ENFILE}
_FAILED = 70  # of the command itself (EX_SOFTWARE): 1 is an alarm, which nobody has found then
# How JAX and NumPy begin where an array does not fit, beside the errors of memory that Python, NumPy and Arrow have.
_TOO_LARGE = "RESOURCE_EXHAUSTED|array is too big|Maximum allowed dimension exceeded"

HELP = """usage: deadreckon COMMAND [OPTIONS]

From logged data to decisions: train policies on a fixed log, estimate their values, and decide which one to deploy, if any.

commands:
{commands}

  deadreckon COMMAND --help   options of a command
  deadreckon --version        the version
  --debug                     with any command: full tracebacks

start with: deadreckon demo, or with your own log: deadreckon data info FILE
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command line.

    Returns:
        The exit code: 0, 1 for a failed run, a fit that diverged or an alarm of `monitor`, 2 for bad input, 70 for a mistake of
        ours or where memory was not enough, 130 or 143 when interrupted by SIGINT or SIGTERM.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    with interrupts.listening(lambda number: _interrupted(args)), _terminal(args):
        return _run(args)


def _terminal(args: Sequence[str]) -> contextlib.AbstractContextManager:
    """While it lasts, no name in what is printed can steer the terminal. Help holds no such names, but colours."""
    if "-h" in args or "--help" in args:
        return contextlib.nullcontext()
    streams = contextlib.ExitStack()
    streams.enter_context(contextlib.redirect_stdout(cast(TextIO, Terminal(sys.stdout))))
    streams.enter_context(contextlib.redirect_stderr(cast(TextIO, Terminal(sys.stderr))))
    return streams


def _run(given: list[str]) -> int:
    debug = "--debug" in given
    args = [a for a in given if a != "--debug"]
    warnings.showwarning = _one_line
    try:
        if not args or args[0] in ("-h", "--help", "help"):
            width = max(map(len, COMMANDS))
            lines = (f"  {name:<{width}}  {line}" for name, (_, _, line) in COMMANDS.items())
            print(HELP.format(commands="\n".join(lines)))
            return 0
        if args[0] == "--version":
            print(f"deadreckon {__version__}")
            return 0
        if args[0] not in COMMANDS:
            raise unknown("command", args[0], COMMANDS)
        module, function, _ = COMMANDS[args[0]]
        cache_compiled_programs()
        code = getattr(importlib.import_module(f"deadreckon.cli.{module}"), function)(args[1:])
        return code or 0
    except KeyboardInterrupt:
        return _interrupted(given)
    except UserError as error:
        if interrupts.arrived():  # which something on its way has made another error of
            return _interrupted(given)
        if debug:
            raise
        print(f"deadreckon: {' '.join(str(error).split())}", file=sys.stderr)
        return 1 if isinstance(error, DivergedError) else 2
    except BrokenPipeError:  # `deadreckon data info x | head`: the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:  # our mistake, not the user's: told shortly, and in full with --debug
        if interrupts.arrived():
            return _interrupted(given)
        if debug:
            raise
        if isinstance(error, OSError) and error.errno in _OF_THE_SYSTEM:
            path = printable(str(error.filename or "a file"))
            print(f"deadreckon: {path}: {(error.strerror or '').lower()}", file=sys.stderr)
            return 2
        what = " ".join(str(error).split())[:300]
        lacking = isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM
        if lacking or re.match(_TOO_LARGE, what):
            hint = "" if lacking else " (--debug shows where)"
            print(f"deadreckon: not enough memory: {what or 'none is left'}{hint}", file=sys.stderr)
            return _FAILED
        print(f"deadreckon: internal error, {type(error).__name__}: {what} (--debug shows where)", file=sys.stderr)
        return _FAILED


def _interrupted(args: Sequence[str]) -> int:
    """Says which command goes on, if any; gives the exit code."""
    if args and args[0] == "recommend":  # its time cannot be taken up again
        what = "recommend cannot be resumed; start again with another --out"
    elif not interrupts.goes_on():
        what = "the same command starts again"
    else:
        more = ["--resume"] if args[0] == "train" and "--resume" not in args else []
        what = f"to continue: {shlex.join(['deadreckon', *args, *more])}"
    print(f"deadreckon: interrupted; {what}", file=sys.stderr, flush=True)
    return 128 + (interrupts.arrived() or signal.SIGINT)


def _one_line(message, category, filename, lineno, file=None, line=None):
    print(f"deadreckon: warning: {message}", file=sys.stderr)


def cache_compiled_programs() -> None:
    """Compiled programs outlive the command. By environment, so that no numerical library is loaded for `data info`.

    Only the command does this: the package, imported, leaves JAX's global settings alone.
    """
    from deadreckon.files import home

    with contextlib.suppress(OSError, UserError):  # a read-only home, or none, costs compile time, nothing else
        folder = home() / "jax"
        folder.mkdir(parents=True, exist_ok=True)
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")


if __name__ == "__main__":
    sys.exit(main())
