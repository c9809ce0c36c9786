"""Grade submitted notebooks: one row of points per notebook, as CSV.

    python course/grade.py force_law submitted/*.ipynb > marks.csv

Each notebook runs in a separate process, in an empty folder, for at most TIMEOUT seconds. Its checks are replaced by
those of the source, with the hidden tests. The code of a submission runs with your rights: use an account or a
container without access to anything of value.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

from notebooks import LABS, cells

TIMEOUT = 600  # s


def run(lab: str, notebook: Path) -> dict[str, int]:
    """Execute a notebook, and return the points of each check."""
    import matplotlib

    matplotlib.use("agg")
    warnings.simplefilter("ignore")
    checks = {one.name: one for one in cells(lab) if one.kind == "check"}
    points = dict.fromkeys(checks, 0)
    space: dict[str, Any] = {"__name__": "__main__"}
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        check = checks.get(cell["metadata"].get("nbgrader", {}).get("grade_id", ""))
        source = check.source if check else "".join(cell["source"])
        lines = (line for line in source.splitlines() if not line.startswith(("%", "!")))  # commands of IPython
        try:
            exec(compile("\n".join(lines), check.name if check else str(notebook), "exec"), space)
        except Exception as error:
            print(f"{notebook.name}: {check.name if check else 'code'}: {error!r}", file=sys.stderr)
        else:
            if check:
                points[check.name] = check.points
    return points


def grade(lab: str, notebook: Path) -> dict[str, int]:
    """Points of a notebook, executed in another process; none if that fails or takes too long."""
    here = Path(__file__).parent.resolve()
    program = "import json, sys; sys.path.insert(0, sys.argv[1]); from grade import run; from pathlib import Path;"
    program += "print('\\n' + json.dumps(run(sys.argv[2], Path(sys.argv[3]))))"
    command = [sys.executable, "-c", program, str(here), lab, str(notebook.resolve())]
    with tempfile.TemporaryDirectory() as folder:
        try:
            done = subprocess.run(command, cwd=folder, timeout=TIMEOUT, stdout=subprocess.PIPE, text=True, check=True)
            return json.loads(done.stdout.splitlines()[-1])
        except (subprocess.SubprocessError, OSError) as error:
            print(f"{notebook.name}: {error}", file=sys.stderr)
            return {one.name: 0 for one in cells(lab) if one.kind == "check"}


def main(lab: str, notebooks: list[Path]) -> None:
    """Print one row per notebook; a lab or file that does not exist ends the program with one line."""
    if lab not in LABS:
        sys.exit(f"there is no lab {lab!r}; known: {', '.join(LABS)}")
    if missing := [str(one) for one in notebooks if not one.is_file()]:
        sys.exit(f"no such notebook: {', '.join(missing)}")
    names = [one.name for one in cells(lab) if one.kind == "check"]
    writer = csv.writer(sys.stdout)
    writer.writerow(["notebook", *names, "points"])
    for notebook in notebooks:
        points = grade(lab, notebook)
        writer.writerow([notebook.name, *(points[name] for name in names), sum(points.values())])
        sys.stdout.flush()


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(f"usage: python course/grade.py LAB NOTEBOOK...; labs: {', '.join(LABS)}")
    main(sys.argv[1], [Path(one) for one in sys.argv[2:]])
