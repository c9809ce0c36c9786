"""Executed notebook of a page of the documentation: text and doctest examples become cells.

    python docs/notebook.py docs/your-muscle.md examples/your-muscle/your-muscle.ipynb

It needs the extra `docs`. The notebook runs in its own folder. Its figures are written to docs/images, named after the
page.
"""

from __future__ import annotations

import base64
import re
import sys
from doctest import DocTestParser
from pathlib import Path

import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

IMAGE = re.compile(r"^!\[.*\]\(images/.*\)\n*", re.MULTILINE)  # the notebook shows the figure itself


def cells(page: str) -> list[nbformat.NotebookNode]:
    """Cells of a page: each block of doctest examples is one code cell."""
    found = []
    for index, text in enumerate(re.split(r"```python\n(.*?)```\n", page, flags=re.DOTALL)):
        if index % 2:
            found.append(new_code_cell("".join(each.source for each in DocTestParser().get_examples(text)).rstrip()))
        elif text := IMAGE.sub("", text).strip():
            found.append(new_markdown_cell(text))
    for number, cell in enumerate(found):
        cell["id"] = f"cell-{number}"  # the same in every run
    return found


def main(page: Path, target: Path) -> None:
    """Write the notebook of a page, and its figures."""
    from nbclient import NotebookClient

    book = new_notebook(cells=cells(page.read_text(encoding="utf-8")))
    NotebookClient(book, timeout=600, record_timing=False, resources={"metadata": {"path": target.parent}}).execute()
    nbformat.write(book, target)
    outputs = (output for cell in book.cells for output in cell.get("outputs", ()))
    images = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    for number, image in enumerate(images, 1):
        (page.parent / "images" / f"{page.stem}-{number}.png").write_bytes(base64.b64decode(image))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
