"""Runs the notebooks of `examples/notebooks` and writes them, with what they show, as pages of the documentation.

    python tools/notebook_pages.py

Pages are Markdown with the outputs as HTML, so that the site needs no notebook software; a test compares their code with that
of the notebooks, and a slow one runs the notebooks.
"""

import re
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS, PAGES = ROOT / "examples" / "notebooks", ROOT / "docs" / "use"
SECONDS = 1_200  # for one cell; a notebook takes less than a minute on an idle machine


def executed(path: Path, folder: Path) -> Any:
    """A notebook after it has run in `folder`.

    Raises:
        nbclient.exceptions.CellExecutionError: one of its cells did not end.
    """
    book = nbformat.read(path, as_version=4)
    NotebookClient(book, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    return book


def page(book: Any, name: str) -> str:
    """A notebook as Markdown."""
    parts, styled = [], False
    for cell in book.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in cell.get("outputs", ()):
            shown, styled = _output(output, styled)
            parts.append(shown)
    parts.insert(1, f"*This page shows the notebook `examples/notebooks/{name}.ipynb`.*")
    return "\n\n".join(part for part in parts if part) + "\n"


def _output(output: Any, styled: bool) -> tuple[str, bool]:
    """What a cell showed, and whether the page has the style of objects by now, which it needs once."""
    if output.output_type == "stream":
        return (f"```text\n{output.text.rstrip()}\n```" if output.name == "stdout" else ""), styled
    data = output.get("data", {})
    if "text/html" in data:
        text = data["text/html"]
        return (re.sub(r"<style>.*?</style>", "", text, flags=re.S) if styled else text), True
    return f"```text\n{data.get('text/plain', '')}\n```", styled


def code(text: str) -> list[str]:
    """The code of a page's cells."""
    return re.findall(r"```python\n(.*?)\n```", text, re.S)


if __name__ == "__main__":
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        with tempfile.TemporaryDirectory() as folder:
            (PAGES / f"notebook-{path.stem.replace('_', '-')}.md").write_text(page(executed(path, Path(folder)), path.stem))
        print(path.stem)
