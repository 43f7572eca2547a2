"""The speed measurements that a page has places for: `python benchmarks/report.py` (half an hour on an idle machine).

The page is text with places for figures, each between two comment lines that name the command; what stands there is replaced by
what the command prints, with the date. What people have written around the places stays. `--only NAME` runs some of them.
"""

import argparse
import platform
import re
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import protocol

HERE = Path(__file__).resolve().parent
PLACE = re.compile(r"(<!-- (?P<name>[a-z0-9-]+): python (?P<command>[^\n]+?) -->\n)(?P<old>.*?)(<!-- end -->)", re.S)


def parse() -> argparse.Namespace:
    add = (parser := argparse.ArgumentParser(description=__doc__.splitlines()[0])).add_argument
    add("--out", type=Path, default=HERE.parent / "docs" / "results" / "speed.md", help="the page")
    add("--only", nargs="*", default=None, help="names of places; none: all")
    add("--list", action="store_true", help="names and commands, and nothing is run")
    return parser.parse_args()


def figures(command: str) -> str:
    """What a command prints, under a line that says when and on what."""
    words = [sys.executable, *shlex.split(command)]
    done = subprocess.run(words, cwd=HERE.parent, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode > 1:  # 1: a promise was not kept, which the figures say
        raise protocol.BenchError(f"python {command} ended with code {done.returncode}; what it said stands above")
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return f"`python {command}`, {now}, {platform.system()} {platform.machine()}\n\n{done.stdout.strip()}\n"


def report() -> int:
    arguments = parse()
    text = arguments.out.read_text()
    places = {found["name"]: found["command"] for found in PLACE.finditer(text)}
    for name in arguments.only or ():
        if name not in places:
            raise protocol.BenchError(f"{arguments.out} has no place {name!r}; it has {', '.join(places)}")
    for name, command in places.items():
        print(f"{name}: python {command}", flush=True)
        if arguments.list or (arguments.only is not None and name not in arguments.only):
            continue
        new = figures(command)
        # Read again: an hour is long, and somebody may have written on.
        text = arguments.out.read_text()
        text = PLACE.sub(lambda m, name=name, new=new: m[1] + "\n" + new + "\n" + m[5] if m["name"] == name else m[0], text)
        arguments.out.write_text(text)
    return 0


if __name__ == "__main__":
    raise SystemExit(protocol.told(report))
