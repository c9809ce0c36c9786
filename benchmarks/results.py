"""A page of docs/results: the tables of a comparison as Markdown.

    python benchmarks/results.py SUITE.yaml --out PAGE.md [--study DIR]
        [--runs N] [--generations N] [--starts N] [--finalists N]

With --study, the folder of `mckibben compare SUITE.yaml --out DIR`, whose searches are continued: a finished one takes
the evaluation runs only. The other options make it small: fewer unseen runs, shorter searches, fewer starts of the
controllers that have more than one. Of a suite with setups, the page has the tables of all runs and of each setup.
"""

import argparse
import sys
from datetime import date
from pathlib import Path

from mckibben.simulation.stability import LEAST_DISK_MARGIN
from mckibben.storage.store import STUDY
from mckibben.study.compare import Suite, compare
from mckibben.study.compare.checks import filename
from mckibben.study.compare.result import PooledResult


def markdown(listing):
    """A table with its title."""
    header = [f"{title} [{unit}]" if unit not in ("", "1") else title for title, unit in listing.header()]
    rows = [header, ["---"] * len(header), *listing.rows()]
    return "\n".join([f"## {listing.title or 'Controllers'}\n", *(f"| {' | '.join(row)} |" for row in rows)])


def smaller(suite, runs, starts, **searches):
    """The suite with fewer unseen runs, starts, and other numbers of its searches."""
    tuning, evaluation = suite.tuning, suite.evaluation
    changes = {name: number for name, number in searches.items() if number is not None}
    if starts:
        changes |= {"starts": min(tuning.starts, starts)}
    if runs:
        evaluation = evaluation.model_copy(update={"runs": runs})
    return suite.model_copy(update={"tuning": tuning.model_copy(update=changes), "evaluation": evaluation})


def main(arguments=None):
    """Compare, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suite", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--study", type=Path)
    for name in ("runs", "generations", "starts", "finalists"):
        parser.add_argument(f"--{name}", type=int)
    options = parser.parse_args(arguments)
    suite = Suite.read(options.suite)
    suite = smaller(suite, options.runs, options.starts, generations=options.generations, finalists=options.finalists)
    setups = {name: suite.of_setup(name) for name in suite.setups} or {"": suite}
    results = {}
    for name, setup in setups.items():
        folder = options.study / filename(name) if options.study and name else options.study
        resume = folder is not None and (folder / STUDY).exists()
        results[name] = compare(setup, out=folder, resume=resume)
    pages = [PooledResult(suite.name, results)] * bool(suite.setups) + [*results.values()]
    command = " ".join(["python benchmarks/results.py", *(arguments or sys.argv[1:])])
    disks = [loop.disk.min() for part in results.values() for loop in part.margins.values()]
    low = f"- {sum(disk < LEAST_DISK_MARGIN for disk in disks)} of {len(disks)} loops have a disk margin below 0.2"
    remarks = [low] if suite.setups else [f"- {remark}" for remark in pages[0].remarks()]
    parts = [f"# {suite.name}", f"Made on {date.today()} by", f"```sh\n{command}\n```", f"{pages[0].verdict()}."]
    parts += remarks + [markdown(listing) for page in pages for listing in page.listings() if not listing.detail]
    options.out.write_text("\n\n".join(filter(None, parts)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
