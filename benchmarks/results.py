"""A page of docs/results: the tables of a comparison as Markdown.

    python benchmarks/results.py SUITE.yaml --out PAGE.md [--study DIR] [--runs N --generations N]

With --study, the folder of `mckibben compare SUITE.yaml --out DIR` (without setups), whose searches are continued: a
finished one takes the evaluation runs only. --runs and --generations make it small, as the tests do.
"""

import argparse
import shlex
import sys
from pathlib import Path

from mckibben.storage.store import STUDY
from mckibben.study.compare import Suite, compare


def markdown(listing):
    """A table with its title."""
    header = [f"{title} [{unit}]" if unit not in ("", "1") else title for title, unit in listing.header()]
    rows = [header, ["---"] * len(header), *listing.rows()]
    return "\n".join([f"## {listing.title}\n", *(f"| {' | '.join(row)} |" for row in rows)])


def smaller(suite, runs, generations):
    """The suite with fewer unseen runs and shorter searches."""
    tuning, evaluation = suite.tuning, suite.evaluation
    if runs:
        evaluation = evaluation.model_copy(update={"runs": runs})
    if generations:
        tuning = tuning.model_copy(update={"generations": generations, "starts": 1, "starts_of": {}})
    return suite.model_copy(update={"tuning": tuning, "evaluation": evaluation})


def main(arguments=None):
    """Compare, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suite", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--study", type=Path)
    parser.add_argument("--runs", type=int)
    parser.add_argument("--generations", type=int)
    options = parser.parse_args(arguments)
    suite = smaller(Suite.read(options.suite), options.runs, options.generations)
    resume = options.study is not None and (options.study / STUDY).exists()
    result = compare(suite, out=options.study, resume=resume)
    command = shlex.join(["python", "benchmarks/results.py", *(arguments or sys.argv[1:])])
    remarks = [f"- {remark}" for remark in result.remarks()]
    parts = [f"# {suite.name}", f"Made by\n\n```sh\n{command}\n```", f"{result.verdict()}.", "\n".join(remarks)]
    parts += [markdown(listing) for listing in result.listings() if not listing.detail]
    options.out.write_text("\n\n".join(filter(None, parts)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
