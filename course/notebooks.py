"""Build the course from its sources, to the folders that nbgrader knows.

    python course/notebooks.py build/course

A source in `course/labs` is a Python script in the percent format: `# %% [markdown]`, `# %%`, `# %% task NAME` and
`# %% check NAME POINTS` begin cells. Text between `### BEGIN SOLUTION` and `### END SOLUTION`, and between
`### BEGIN HIDDEN TESTS` and `### END HIDDEN TESTS`, is for teachers only.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any, NamedTuple

FOLDER = Path(__file__).parent
LABS = "force_law", "attainable_stiffness", "position_control", "valves_and_delay"
"""Labs in their order."""

_HEAD = re.compile(r"^# %%(?: \[(markdown)\]| (task) (\w+)| (check) (\w+) (\d+))?$", re.MULTILINE)
_SOLUTION = re.compile(r"^( *)### BEGIN SOLUTION\n.*?### END SOLUTION$", re.DOTALL | re.MULTILINE)
_HIDDEN = re.compile(r"^ *### BEGIN HIDDEN TESTS\n.*?### END HIDDEN TESTS\n?", re.DOTALL | re.MULTILINE)
_STUB = r"\1# YOUR CODE HERE\n\1raise NotImplementedError()"


class Cell(NamedTuple):
    """A cell of a lab; tasks and checks have an identifier, checks have points."""

    kind: str  # markdown, code, task or check
    source: str
    name: str = ""
    points: int = 0

    @property
    def released(self) -> str:
        """The source without solutions and hidden tests."""
        return _HIDDEN.sub("", _SOLUTION.sub(_STUB, self.source)).rstrip()


def cells(lab: str) -> list[Cell]:
    """Cells of a lab, in order."""
    text = (FOLDER / "labs" / f"{lab}.py").read_text(encoding="utf-8")
    heads = list(_HEAD.finditer(text))
    ends = [one.start() for one in heads[1:]] + [len(text)]
    found = []
    for head, end in zip(heads, ends, strict=True):
        markdown, task, of_task, check, of_check, points = head.groups()
        source = text[head.end() : end].strip()
        if markdown:
            source = re.sub(r"^# ?", "", source, flags=re.MULTILINE)
        kind = markdown or task or check or "code"
        found.append(
            Cell(kind, source, f"{kind}_{of_task or of_check}" if of_task or of_check else "", int(points or 0))
        )
    return found


def notebook(lab: str, *, solutions: bool) -> dict[str, Any]:
    """The notebook of a lab, with the metadata of nbgrader."""
    made = []
    for number, one in enumerate(cells(lab)):
        source = one.source if solutions else one.released
        cell: dict[str, Any] = {"id": one.name or f"cell-{number}", "metadata": {}, "source": source}
        cell["cell_type"] = "markdown" if one.kind == "markdown" else "code"
        if one.kind != "markdown":
            cell |= {"execution_count": None, "outputs": []}
        if one.name:
            check = one.kind == "check"
            marks = {"grade": check, "locked": check, "solution": not check, "task": False}
            cell["metadata"]["nbgrader"] = {"schema_version": 3, "grade_id": one.name, **marks}
            if check:
                cell["metadata"]["nbgrader"]["points"] = one.points
        made.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def main(target: Path) -> None:
    """Write notebooks of teachers and students, and the checks."""
    for lab in LABS:
        for folder, solutions in (("source", True), ("release", False)):
            place = target / folder / lab
            place.mkdir(parents=True, exist_ok=True)
            text = json.dumps(notebook(lab, solutions=solutions), indent=1, ensure_ascii=False) + "\n"
            (place / f"{lab}.ipynb").write_text(text, encoding="utf-8")
            shutil.copy(FOLDER / "grading.py", place)
    shutil.make_archive(str(target / "students"), "zip", target, "release")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python course/notebooks.py FOLDER")
    main(Path(sys.argv[1]))
