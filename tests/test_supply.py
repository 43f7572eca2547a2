"""What reaches users: the README on an index, the size of what is shipped, and what the hosted workflows check."""

import re
import tomllib
from pathlib import Path

import pytest

from hatch_build import for_an_index

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
RELATIVE = re.compile(r"\]\((?!https?:|#)([^)]+)\)")
WORKFLOWS = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / ".github" / "workflows").glob("*.yml")}


def test_links_of_the_readme_lead_somewhere_in_the_repository():
    found = RELATIVE.findall(README)
    assert len(found) > 30
    assert [target for target in found if not (ROOT / target.partition("#")[0]).exists()] == []


def test_links_on_an_index_need_no_repository_beside_them():
    alone = for_an_index(README, "", "1.2")
    assert RELATIVE.findall(alone) == []
    assert "![" not in alone
    assert "| Your own logs, a decision in the time you have | Agents, estimators," in alone
    assert "[Installation](#use-it)" in alone
    linked = for_an_index(README, "https://example.org/user/name/", "1.2")
    assert RELATIVE.findall(linked) == []
    assert "](https://example.org/user/name/blob/v1.2/docs/architecture.md#what-is-exact)" in linked
    assert "](https://example.org/user/name/raw/v1.2/docs/assets/path.svg)" in linked
    assert linked.count("](") == README.count("](")


@pytest.mark.parametrize(
    ("text", "alone"),
    [
        ("[a](b.md)", "a"), ("[`a[0]`](b.md#c)", "`a[0]`"), ("![x [y] z](p.png)\n\n\n\nb", "\n\nb"), ("[a](https://b.c)", "[a](https://b.c)"),
        ("[a](mailto:b@c.d) [e](#f)", "[a](mailto:b@c.d) [e](#f)"), ("x[0](1)", "x0"),
    ],
)  # fmt: skip
def test_links_of_each_kind(text, alone):
    assert for_an_index(text, "", "1") == alone


def test_shipped_data_leave_room_for_code_in_a_wheel_of_25_mb():
    """The wheel itself is built and measured in `test_wheel.py`."""
    files = [path for path in (ROOT / "src" / "deadreckon").rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert sum(path.stat().st_size for path in files if path.suffix != ".py") < 23_000_000


def test_hosted_checks_run_on_every_python_that_the_package_names():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    assert named == ["3.11", "3.12", "3.13"]
    assert f"python: {str(named).replace(chr(39), chr(34))}" in WORKFLOWS["ci"]
    assert project["requires-python"] == ">=3.11,<3.14"


def test_hosted_workflows_audit_dependencies_and_publish_a_bill_of_materials():
    assert re.search(r"pip-audit[@=\d.]* --strict", WORKFLOWS["audit"])  # a package that could not be looked up is an error
    assert "schedule:" in WORKFLOWS["audit"]  # weaknesses become known after a commit
    assert "cyclonedx-py environment" in WORKFLOWS["release"]
    assert ".cdx.json" in WORKFLOWS["release"]
    for name, text in WORKFLOWS.items():
        assert re.search(r"^permissions:\n  contents: (read|write)$", text, re.M), name
        assert "secrets." not in text, name
