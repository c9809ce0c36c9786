"""Messy measurement files whose true numbers are known: read right, asked about, or read wrong.

``python benchmarks/messy.py`` writes 1,000 files of all kinds (functions of the modules `messy_...`), reads each with
`mckibben.dataset.read_dataset`, and compares pressures, contractions and forces with the truth. A file is right if all
agree; asked if the reader refused it; wrong with a warning; or wrong in silence: these are
listed with the seeds that `--repeat KIND SEED` writes and reads again. Where a file does not determine its numbers (two
columns of forces, say), its kind's function states which are true, and only a question or a warning is not silent.
``--limits`` reads files whose numbers are wrong and plausible, and which say nothing of it (pounds named newtons, say).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import messy_exports  # noqa: F401 - adds kinds
import messy_labs  # noqa: F401 - adds kinds
import messy_limits  # noqa: F401 - adds kinds
import messy_loggers  # noqa: F401 - adds kinds
import messy_machines  # noqa: F401 - adds kinds
import messy_notations  # noqa: F401 - adds kinds
import messy_restarts  # noqa: F401 - adds kinds
import messy_rows  # noqa: F401 - adds kinds
import messy_sensors  # noqa: F401 - adds kinds
import messy_structures  # noqa: F401 - adds kinds
import messy_traps  # noqa: F401 - adds kinds
import numpy as np
from messy_kinds import KINDS, LIMITS, Points

from mckibben.dataset import read_dataset
from mckibben.errors import McKibbenError, McKibbenWarning

OUTCOMES = ("right", "asked", "wrong with a warning", "wrong in silence")


class Read(NamedTuple):
    """How a file was read: one of `OUTCOMES`, and messages or differences."""

    outcome: str
    text: str


def read(kind: str, seed: int, folder: Path) -> Read:
    """Write a file of a kind, read it, and compare it with the truth."""
    rng = np.random.default_rng([seed, *kind.encode()])
    file = (KINDS | LIMITS)[kind](Points.drawn(rng), rng)
    path = folder / file.name
    path.write_bytes(file.content)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = read_dataset(path, **file.options)
        except McKibbenError as error:
            return Read("asked", str(error))
    warned = [str(one.message) for one in caught if issubclass(one.category, McKibbenWarning)]
    wrong = different(file.truth, found)
    if not wrong:
        return Read("right", "; ".join(warned))
    return Read("wrong with a warning" if warned else "wrong in silence", "; ".join([wrong, *warned]))


def different(truth: Points, found: object) -> str:
    """First difference between the truth and a dataset; empty if there is none."""
    for name, factor in (("pressure", 1e5), ("contraction", 0.01), ("force", 1.0)):
        expected, values = getattr(truth, name) * factor, getattr(found, name)
        if len(values) != len(expected):
            return f"{len(values)} points instead of {len(expected)}"
        off = np.abs(values - expected) > 1e-6 * np.abs(expected).max()
        if off.any():
            at = int(np.argmax(off))
            return f"{name} {values[at] / factor:g} instead of {expected[at] / factor:g} at point {at}"
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=1000, metavar="N", help="number of files of all kinds together")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--only", nargs="+", choices=sorted(KINDS), metavar="KIND", help="some kinds")
    parser.add_argument("--limits", action="store_true", help="only kinds whose files do not say that they are wrong")
    parser.add_argument("--repeat", nargs=2, metavar=("KIND", "SEED"), help="one file, written to the current folder")
    options = parser.parse_args()
    if options.repeat:
        print(*read(options.repeat[0], int(options.repeat[1]), Path()), sep=": ")
        return 0
    kinds = options.only or list(LIMITS if options.limits else KINDS)
    each: dict[str, Counter[str]] = {kind: Counter() for kind in kinds}
    silent = []
    with tempfile.TemporaryDirectory() as folder:
        for index in range(options.files):
            kind, seed = kinds[index % len(kinds)], options.seed + index // len(kinds)
            found = read(kind, seed, Path(folder))
            each[kind][found.outcome] += 1
            if found.outcome == OUTCOMES[-1]:
                silent.append(f"{kind} {seed}: {found.text}")
    width = max(map(len, kinds))
    print(f"{'kind':{width}}  " + "  ".join(OUTCOMES))
    for kind, counts in each.items():
        print(f"{kind:{width}}  " + "  ".join(f"{counts[one] or '-':>{len(one)}}" for one in OUTCOMES))
    total = sum(each.values(), Counter())
    print(f"{'all':{width}}  " + "  ".join(f"{total[one]:>{len(one)}}" for one in OUTCOMES))
    print(f"{len(kinds)} kinds, {options.files} files: {100 * total['right'] / max(options.files, 1):.1f} % right")
    for one in silent:
        print(f"in silence: {one}")
    return 1 if silent else 0


if __name__ == "__main__":
    sys.exit(main())
