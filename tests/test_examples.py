"""The examples that a newcomer would copy, on a short setting."""

from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
MOST = 60  # lines of one


@pytest.fixture
def example(monkeypatch, tmp_path, home):
    """Imports an example by name, in an empty folder."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    monkeypatch.chdir(tmp_path)
    return __import__


def test_examples_are_five_and_short():
    files = sorted((ROOT / "examples").glob("*.py"))
    assert [path.stem for path in files] == ["own_agent", "own_design", "own_environment", "own_estimator", "own_table"]
    assert all(len(path.read_text().splitlines()) < MOST for path in files)
    for page in ("README.md", "docs/index.md"):
        assert all(path.name in (ROOT / page).read_text() for path in files), page


NOTEBOOKS = ("benchmark_agent", "design_experiment", "own_table")


@pytest.fixture
def pages(monkeypatch):
    """The tool that runs notebooks and makes pages of them."""
    pytest.importorskip("nbclient")
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return __import__("notebook_pages")


@pytest.mark.slow  # nbformat is of the group `slow`
def test_pages_show_the_code_of_the_notebooks(pages):
    import nbformat

    files = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
    assert [path.stem for path in files] == list(NOTEBOOKS)
    for path in files:
        book = nbformat.read(path, as_version=4)
        cells = [cell for cell in book.cells if cell.cell_type == "code"]
        assert not any(cell.outputs or cell.execution_count for cell in cells), "notebooks are kept without outputs"
        text = (ROOT / "docs" / "use" / f"notebook-{path.stem.replace('_', '-')}.md").read_text()
        assert pages.code(text) == [cell.source for cell in cells], "run tools/notebook_pages.py"
        assert "<script" not in text
        assert text.count("<style>") == 1  # once a page


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebooks_run(name, pages, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".cache" / "jax"))
    book = pages.executed(ROOT / "examples" / "notebooks" / f"{name}.ipynb", tmp_path)
    shown = [output for cell in book.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("text/html" in output.get("data", {}) for output in shown)
    assert pages.page(book, name).startswith("# ")


@pytest.mark.slow
def test_own_table(example, capsys):
    example("own_table").main(rows=4_000, steps=300)
    assert capsys.readouterr().out.startswith("DEPLOY own-table seed 0")


@pytest.mark.slow
def test_own_design(example, capsys):
    example("own_design").main(steps=50)
    said = capsys.readouterr().out
    assert "COMs: the first of 8 is (" in said
    assert "nan" not in said
    for name in ("forward", "coms"):
        assert Path(f"runs/own-design-{name}.csv").read_text().startswith('"heat","layers","metal","predicted"')


@pytest.mark.slow
def test_own_agent(example, capsys):
    example("own_agent").main(rows=2_000, steps=20, episodes=2)
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["RWR", "policy", "BC", "policy"]


@pytest.mark.slow
def test_own_environment(example, capsys):
    from deadreckon import tasks
    from deadreckon.tasks import registry

    try:
        example("own_environment").main(steps=10_128)
        assert "score" in capsys.readouterr().out
        first, again = tasks.task("room").simulate([0, 1]), tasks.task("room").simulate([5, 6])
        first.reset()
        again.restore(first.state())
        actions = np.array([[0.5], [0.1]])
        for ours, theirs in zip(first.step(actions), again.step(actions)):
            np.testing.assert_array_equal(ours, theirs)
    finally:
        registry._TASKS.pop("room", None)


@pytest.mark.slow
def test_own_estimator(example, capsys):
    example("own_estimator").main(kinds=("medium",), steps=4_000)
    assert "| log | nearest |" in capsys.readouterr().out
