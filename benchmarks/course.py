"""How soon a lab begins, and how fast its page answers a slider.

    python benchmarks/course.py
    python benchmarks/course.py --image docs/images/course.png

A lab begins in the browser when its first curves are drawn, and in a notebook when its first cells have run, from
the start of the program. The answer of a slider is the time from its event to the end of the task that draws the new
curves; `cpu_ms` is the time of the processor for it, which other programs do not disturb. Needs Chromium.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from web import Tab, browser

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "course"))
from notebooks import LABS, cells, page  # noqa: E402

MOVE = """(async () => {
  const sliders = [...document.querySelectorAll("form input")], times = [];
  for (let k = 0; k < %d; ++k) {
    const slider = sliders[k %% sliders.length], before = document.querySelector(".charts").innerHTML;
    slider.value = Number(slider.min) + (0.3 + 0.6 * (k * 0.37 %% 1)) * (slider.max - slider.min);
    const start = performance.now();
    slider.dispatchEvent(new Event("input", {bubbles: true}));
    await new Promise((done) => requestAnimationFrame(() => {
      const channel = new MessageChannel();  // runs after the work of the frame
      channel.port1.onmessage = done;
      channel.port2.postMessage(0);
    }));
    if (document.querySelector(".charts").innerHTML === before) throw new Error(slider.name + " changed no curve");
    times.push(performance.now() - start);
  }
  return times;
})()"""
PATH = "document.querySelector('.charts polyline')"


def first_cells(lab: str) -> float:
    """Time [s] until the code before the first task of a lab has run in a new program."""
    code = []
    for one in cells(lab):
        if one.kind == "task":
            break
        if one.kind == "code":
            code.append(one.source)
    program = "import matplotlib; matplotlib.use('agg')\n" + "\n".join(code)
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT / "course")
    return time.perf_counter() - start


def busy(tab: Tab) -> float:
    """Processor time [s] of the tasks of the page so far."""
    found = tab.send("Performance.getMetrics")["metrics"]
    return next(one["value"] for one in found if one["name"] == "TaskDuration")


def picture(target: Path) -> None:
    """Save the upper part of a page."""
    with tempfile.TemporaryDirectory() as folder, browser() as tab:
        tab.open(page("attainable_stiffness", Path(folder) / "page.html").as_uri())
        tab.wait(PATH)
        tab.picture(target)
    with Image.open(target) as image:
        image.crop((100, 0, 1100, 900)).save(target, optimize=True)


def measure(labs: list[str], moves: int) -> None:
    """Measure labs, and print a table and JSON."""
    found = {}
    with tempfile.TemporaryDirectory() as folder, browser() as tab:
        for lab in labs:
            path = page(lab, Path(folder) / f"{lab}.html")
            start = time.perf_counter()
            tab.open(path.as_uri())
            tab.wait(PATH)
            opened = time.perf_counter() - start
            tab.send("Performance.disable")
            tab.send("Performance.enable", timeDomain="threadTicks")
            before = busy(tab)
            times = sorted(tab.evaluate(MOVE % moves))
            used = busy(tab) - before
            found[lab] = {
                "page_s": round(opened, 2),
                "notebook_s": round(first_cells(lab), 1),
                "cpu_ms": round(1e3 * used / moves, 1),
                "median_ms": round(statistics.median(times), 1),
                "percentile_95_ms": round(times[int(0.95 * len(times))], 1),
            }
            print(f"{lab:22}", *(f"{name} {value:<8}" for name, value in found[lab].items()))
    print(json.dumps(found))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--labs", nargs="+", choices=LABS, default=list(LABS))
    parser.add_argument("--moves", type=int, default=120, help="number of moves of sliders per page")
    parser.add_argument("--image", type=Path, help="save a picture of a page instead")
    options = parser.parse_args()
    if options.image:
        picture(options.image)
    else:
        measure(options.labs, options.moves)


if __name__ == "__main__":
    main()
