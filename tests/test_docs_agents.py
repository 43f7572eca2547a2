"""Every agent has a page, which says what differs from its authors' code and when that was compared."""

import re
from pathlib import Path

import pytest

from deadreckon.agents import AGENTS

PAGES = Path(__file__).resolve().parent.parent / "docs" / "agents"
REFERENCE = re.compile(r"^.*\[agents API\]\(\.\./api/agents\.md\).*$", re.MULTILINE)  # names the classes that a page is about
HEADING = "Differences from the authors' code"


def pages_by_class():
    """Class -> text of its page."""
    found = {}
    for page in sorted(PAGES.glob("*.md")):
        text = page.read_text("utf-8")
        found |= {name: text for line in REFERENCE.findall(text) for name in re.findall(r"`(\w+)`", line)}
    return found


@pytest.mark.parametrize("agent", AGENTS)
def test_the_page_of_an_agent_says_when_it_was_compared_with_its_authors_code(agent):
    """The first paragraph under the heading has the date; a section of this name is there once."""
    text = pages_by_class()[AGENTS[agent][1]]
    sections = [each for each in re.split(r"^## ", text, flags=re.MULTILINE) if each.startswith(HEADING)]
    assert len(sections) == 1
    first = sections[0].split("\n\n")[1]
    assert re.search(r"\b2026-\d\d-\d\d\b", first)
