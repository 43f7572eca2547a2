"""Cases one after the other, each once: a study that was ended goes on, and `--table` shows what there is.

    python -m tests.faults --kills 100                           # what `make faults` does
    python -m tests.faults --table                              # tables in Markdown, as docs/reliability.md has them

A line of the results is a case: its number, command, fault, outcome, what was broken, and the processes that were killed. A
file named by `--results` outlasts the folder, and can be kept in the repository.
"""

import argparse
import datetime
import json
import os
import random
import shutil
import time
import traceback
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from tests.faults import cases, inputs, process
from tests.faults.commands import COMMANDS, Command, digests
from tests.faults.scarce import FAULTS

KILL = "SIGKILL"
EACH = 4  # cases of kills between two of another fault


def planned(number: int, commands: list[Command]) -> tuple[Command, str]:
    """Command and fault of a case: every fault on every command in turn, and kills in between."""
    rng = random.Random(number)
    if number % (EACH + 1) == EACH:
        pairs = [(command, fault) for fault in FAULTS for command in commands]
        random.Random(0).shuffle(pairs)
        return pairs[number // (EACH + 1) % len(pairs)]
    return rng.choices(commands, [command.weight for command in commands])[0], KILL


def done_before(path: Path) -> list[dict[str, Any]]:
    """The cases of a file of results."""
    lines = path.read_text().splitlines() if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]  # a kill of the study itself may cut its last line


def baseline(place: cases.Place, command: Command, out: Path) -> None:
    """Two undisturbed commands, which must agree; what they leave and how long the second takes is noted.

    Raises:
        RuntimeError: it fails, or they differ.
    """
    seen = []
    for _ in range(2 if command.goes_on else 1):
        place.clean()
        began = time.monotonic()
        running = process.run(command.words(place.inputs), place.folder, cases.LONG)
        place.seconds[command.name] = time.monotonic() - began
        if running.code != 0:
            raise RuntimeError(f"{command.name} ends with {running.code}: {running.lines()[-3:]}")
        seen.append(process.apart(digests, place.folder, command.others))
    if seen[0] != seen[-1]:
        different = [name for name in seen[0].keys() | seen[1].keys() if seen[0].get(name) != seen[1].get(name)]
        raise RuntimeError(f"{command.name} gives different results, undisturbed: {different}")
    place.whole[command.name] = seen[0]
    kept = place.folder.with_name(f"whole-{command.name.replace(' ', '-')}")
    shutil.rmtree(kept, ignore_errors=True)
    shutil.copytree(place.folder, kept)
    (out / "whole.json").write_text(json.dumps({"whole": place.whole, "seconds": place.seconds}))


def case(place: cases.Place, number: int, commands: list[Command]) -> dict[str, Any] | None:
    """Does one case; None where it is not possible here."""
    command, fault = planned(number, commands)
    began, rng = time.monotonic(), random.Random(f"case {number}")
    act = cases.killed if fault == KILL else FAULTS[fault]
    try:
        outcome = act(place, command, rng)
    except Exception as error:  # noqa: BLE001 - of the study itself, which goes on
        outcome = cases.Outcome("", [f"the study: {type(error).__name__}: {error} {traceback.format_exc().splitlines()[-3]}"])
    if outcome is None:
        return None
    return {
        "case": number, "command": command.name, "fault": fault, "kills": outcome.kills, "outcome": outcome.words,
        "broken": outcome.broken, "seconds": round(time.monotonic() - began, 1),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }  # fmt: skip


def study(out: Path, results: Path, kills: int, only: str, faults: str, workers: int) -> None:
    """Does what is missing until so many processes have been killed."""
    out.mkdir(parents=True, exist_ok=True)
    os.environ |= {"DEADRECKON_HOME": str(out / "home"), "JAX_COMPILATION_CACHE_DIR": str(out / "home" / "jax")}
    process.warm()
    commands = [each for each in COMMANDS if only in each.name]
    with process.private_mounts() as mounts:
        place = cases.Place(out / "work" / "case", inputs.make(out / "inputs"), {}, {}, mounts)
        if (out / "whole.json").exists():
            known = json.loads((out / "whole.json").read_text())
            place.whole, place.seconds = known["whole"], known["seconds"]
        for command in commands:
            if command.name not in place.whole:
                baseline(place, command, out)
        share = next((each for each in range(1, workers) if not os.fork()), 0)
        place.folder = out / "work" / f"case{share}"
        done = {each["case"] for each in done_before(results)}
        number = share
        while sum(each["kills"] for each in done_before(results)) < kills:
            wanted = faults in planned(number, commands)[1] or (faults == "others" and planned(number, commands)[1] != KILL)
            if wanted and number not in done and (row := case(place, number, commands)) is not None:
                with open(results, "a") as file:
                    file.write(json.dumps(row) + "\n")
                told = f"{row['outcome']}  {' | '.join(row['broken'])}"
                print(f"{row['case']:>5}  {row['fault']}  {row['command']}: {told}", flush=True)
            number += workers


def table(rows: list[dict[str, Any]]) -> str:
    """Two tables in Markdown: kills by command, and other faults by what came of them."""
    lines = ["| command | cases | kills | promises broken |", "|---|---:|---:|---:|"]
    killed = [row for row in rows if row["fault"] == KILL]
    for name in (each.name for each in COMMANDS):
        own = [row for row in killed if row["command"] == name]
        if own:
            lines.append(f"| `{name}` | {len(own)} | {sum(r['kills'] for r in own)} | {sum(bool(r['broken']) for r in own)} |")
    lines.append(f"| all | {len(killed)} | {sum(r['kills'] for r in killed)} | {sum(bool(r['broken']) for r in killed)} |")
    lines += ["", "| fault | commands | cases | outcomes | promises broken |", "|---|---:|---:|---|---:|"]
    by: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        if row["fault"] != KILL:
            by[row["fault"]].append(row)
    for fault in FAULTS:
        own = by[fault]
        counts = Counter(row["outcome"] for row in own if not row["broken"])
        words = "; ".join(f"{what} ({count})" for what, count in counts.most_common())
        kinds = len({row["command"] for row in own})
        lines.append(f"| {fault} | {kinds} | {len(own)} | {words} | {sum(bool(row['broken']) for row in own)} |")
    broken = [f"- case {r['case']}, {r['fault']}, `{r['command']}`: {' | '.join(r['broken'])}" for r in rows if r["broken"]]
    return "\n".join([*lines, *(["", "Broken:", "", *broken] if broken else [])])


def main() -> None:
    """Does or shows the study."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(".cache/faults"), help="folder of what the cases write")
    parser.add_argument("--results", type=Path, help="file of results, gone on with (default: OUT/results.jsonl)")
    parser.add_argument("--kills", type=int, default=100, help="processes to kill, those of earlier results included")
    parser.add_argument("--only", default="", help="commands whose names hold this")
    parser.add_argument("--faults", default="", help="faults whose names hold this; others: all but SIGKILL")
    parser.add_argument("--workers", type=int, default=1, help="cases side by side")
    parser.add_argument("--table", action="store_true", help="show the results as tables")
    asked = parser.parse_args()
    results = (asked.results or asked.out / "results.jsonl").absolute()
    if asked.table:
        return print(table(done_before(results)))
    study(asked.out.absolute(), results, asked.kills, asked.only, asked.faults, asked.workers)
