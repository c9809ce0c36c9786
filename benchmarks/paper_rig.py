"""The paper's whole test on the simulated rig, from its protocol file to Eq. 3: time, memory, and what is found.

    python benchmarks/paper_rig.py [PROTOCOL.yaml]

The muscle in the clamps has friction. It is found and taken off (`identify_hysteresis`); points under 30 N are left
out, where the friction fades and the screw's play comes in, and those within 2 mm of a turn, where the friction is on
its way from one side to the other. Then Eq. 3's numbers should lie within their intervals. Without the correction
friction adds in one direction what it takes in the other: the intervals are wide, and should hold the numbers too.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mckibben import ExponentialLaw, catalog, identify, read_dataset
from mckibben.dataset import IsobaricDataset
from mckibben.identification import identify_hysteresis
from mckibben.rig import away_from_turns

PROTOCOL = Path(__file__).parents[1] / "examples/rig/paper-protocol.yaml"
BELOW = 30.0  # N


def main() -> int:
    protocol = Path(sys.argv[1]) if len(sys.argv) > 1 else PROTOCOL
    with tempfile.TemporaryDirectory() as name:
        folder, begin = Path(name) / "test", time.perf_counter()
        load = os.getloadavg()[0]
        subprocess.run([sys.executable, "-m", "mckibben", "rig", "run", protocol, "--out", folder], check=True)
        wall, used = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        size = sum(path.stat().st_size for path in folder.glob("record-*"))
        data = read_dataset(folder / "isobaric.nc")
    samples = data.table["force_samples"].size
    print(
        f"{len(data)} points, {samples} samples: {wall:.0f} s, of which {used.ru_utime + used.ru_stime:.0f} s of one "
        f"core (load {load:.1f} before); memory {used.ru_maxrss / 1024:.0f} MB, record {size / 1e6:.0f} MB"
    )
    held = IsobaricDataset(data.table.assign_attrs(slack_force=BELOW))
    way = identify_hysteresis(ExponentialLaw, held)
    print(way.report(), end="\n\n")
    inside = True
    for title, points in (("friction taken off", way.corrected(held)), ("as measured", data)):
        inside &= told(title, away_from_turns(points))
    return 0 if inside else 1


def told(title: str, points: IsobaricDataset) -> bool:
    """Print a fit beside Eq. 3: whether that lies within its intervals."""
    fit, truth = identify(ExponentialLaw, points), catalog.law("lei-mas-10-180n")
    intervals = fit.intervals()
    print(f"{title}: RMSE {fit.rmse:.3f} N")
    inside = True
    for name, (low, high) in intervals.items():
        value = float(getattr(truth, name))
        holds = low <= value <= high
        inside &= holds
        print(f"  {name}: {value:.6g} in {low:.6g} .. {high:.6g}: {'yes' if holds else 'NO'}")
    return inside


if __name__ == "__main__":
    sys.exit(main())
