"""The table of direct dependencies and their licences in `docs/licences.md`, from what installed packages say of themselves.

    python tools/licence_table.py            (rows of packages that are not installed stay as they are)
"""

import re
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "licences.md"
BEGIN, END = "<!-- dependencies -->\n", "<!-- end of dependencies -->"
# Licences by what stands in the texts that packages give, where they give no SPDX expression; the first that fits counts.
TEXTS = (
    (r"Apache", "Apache-2.0"), (r"\bMIT\b", "MIT"), (r"BSD.2.Clause", "BSD-2-Clause"),
    (r"BSD.3.Clause|Neither the name", "BSD-3-Clause"),
)  # fmt: skip
SAID_ELSEWHERE = {"jax2onnx": "Apache-2.0"}  # in a file alone, not in the metadata


def dependencies() -> dict[str, list[str]]:
    """Direct dependencies of the package, and what needs each: nothing for all, else extras and groups."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        project: dict[str, Any] = tomllib.load(file)
    asked = {"": project["project"]["dependencies"], "build": project["build-system"]["requires"]}
    asked |= {f"extra `{name}`": listed for name, listed in project["project"]["optional-dependencies"].items()}
    asked |= {f"group `{name}`": listed for name, listed in project["dependency-groups"].items()}
    found: dict[str, list[str]] = {}
    for why, listed in asked.items():
        for requirement in listed:
            needs = found.setdefault(re.split(r"[^\w.-]", requirement, maxsplit=1)[0], [])
            needs += [why] if why not in needs else []
    return {name: [] if "" in needs else needs for name, needs in found.items()}


def licence(name: str) -> str | None:
    """What an installed package says of its licence, as an SPDX expression; None where it is not installed.

    Raises:
        ValueError: it says nothing that is known.
    """
    try:
        told: Any = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return None
    if expression := told.get("License-Expression") or SAID_ELSEWHERE.get(name):
        return expression
    classifiers = [each for each in told.get_all("Classifier") or [] if each.startswith("License ::")]
    for text in (told.get("License") or "", *classifiers):
        for pattern, found in TEXTS:
            if re.search(pattern, text):
                return found
    raise ValueError(f"{name} says nothing of its licence that is known here")


def rows() -> dict[str, tuple[str, str]]:
    """Of the page: package -> licence, and what needs it."""
    table = PAGE.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]
    cells = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in table.splitlines()[2:] if line.startswith("|")]
    return {name.strip("`"): (found, needed) for name, found, needed in cells}


def table() -> str:
    """The table as it should be."""
    before, lines = rows(), ["| package | licence | needed by |", "|---|---|---|"]
    for name, needs in sorted(dependencies().items(), key=lambda item: item[0].lower()):
        found = licence(name) or before.get(name, ("?", ""))[0]
        lines.append(f"| `{name}` | {found} | {', '.join(needs) or 'the package'} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    head, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(head + BEGIN + table() + END + rest.partition(END)[2], encoding="utf-8")
