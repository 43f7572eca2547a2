"""Files of the repository that pages name are there."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NAMED = re.compile(r"(?<![\w/.-])((?:src/deadreckon|tests|tools|benchmarks|evidence)/[\w/.-]*\w)")
# What a reader fills in: the task of a library, a folder, and the file of an agent that is yet to be written.
PLACEHOLDERS = {"src/deadreckon/policies/library/TASK.json", "tests/FOLDER", "src/deadreckon/agents/rwr.py"}


def test_files_that_pages_name_are_there():
    """Names of suites may lack their `.toml`. What stood in `examples/` once is explained on the page of results."""
    pages = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")]
    named = {(page.name, name) for page in pages for name in NAMED.findall(page.read_text("utf-8"))}
    assert len(named) > 50
    absent = {
        (page, name)
        for page, name in named
        if name not in PLACEHOLDERS and not (ROOT / name).exists() and not (ROOT / f"{name}.toml").exists()
    }
    assert not absent
