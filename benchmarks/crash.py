"""Hosts of a test on a card that crash at random instants: the card has to be vented by the second process.

    python benchmarks/crash.py [TIMES]

Of each way to die so many: SIGKILL, `os._exit`, a segmentation fault, SIGABRT; and SIGQUIT and SIGTERM, for which the
host vents itself. The card is a device server in this process with a simulated rig at its terminals (that of the
tests), whose relay would wait for ten minutes. After each: lines and valve are at rest, the motor stands, the true
pressure is below 0.2 bar a second later, and the record is read without a word of damage.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "rig" / "ni"))

import device_server as device

from mckibben import catalog
from mckibben.muscle import Muscle
from mckibben.rig.record import read_record
from mckibben.rig.simulated import SimulatedRig
from mckibben.units import bar

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
PATIENCE = 600.0  # s
PROTOCOL = """name: a test whose host crashes
muscle: {{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}}
rig: {{nidaqmx: {{server: "{address}", calibration: bench.json, patience: {patience} s}}}}
limits: {{pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm}}
protocol:
  isobaric: {{pressures: [3 bar, 4 bar], contraction_min: 2 %, contraction_max: 6 %, repeats: 50, speed: 4 mm/s,
    dwell: 200 ms, acquisition: 100 ms, samples: 100}}
"""
HOST = """
import ctypes, os, resource, sys, threading
from pathlib import Path
from mckibben.study.rig.document import read_test
from mckibben.study.rig.running import check, run_test
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
folder, after, way = Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3]
crashes = {"exit": lambda: os._exit(0), "segfault": lambda: ctypes.string_at(0)}
begun = []
def report(progress):
    if not begun:
        begun.append(print("begun", flush=True))
        if way in crashes:
            threading.Timer(after, crashes[way]).start()
run_test(check(*read_test(folder / "p.yaml")), folder / "out", report=report)
"""
WAYS = ("SIGKILL", "exit", "segfault", "SIGABRT", "SIGQUIT", "SIGTERM")
LONGEST = 3.0  # s after the beginning


def crashed(way: str, after: float, folder: Path) -> tuple[float, float]:
    """Pressure [bar] when the host died, and the time until the card was at rest [s]."""
    card = device.Card(SimulatedRig(MUSCLE, patience=PATIENCE))
    server, address = device.serve(card)
    calibrations = {name: one.to_json() for name, one in card.twin.calibrations.items()}
    (folder / "bench.json").write_text(json.dumps(calibrations))
    (folder / "p.yaml").write_text(PROTOCOL.format(address=address, patience=PATIENCE))
    try:
        host = [sys.executable, "-c", HOST, str(folder), str(after), way]
        with subprocess.Popen(host, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "begun\n"
            if way.startswith("SIG"):
                time.sleep(after)
                os.kill(process.pid, signal.Signals[way])
            process.wait()
        begin, pressure = time.monotonic(), card.twin.truth.pressure / bar
        while (card.lines[device.HOLD] or card.valve or card.twin.is_open) and time.monotonic() < begin + 60.0:
            time.sleep(1e-3)
        taken = time.monotonic() - begin
        assert not card.lines[device.HOLD] and card.valve == 0.0, f"{way} after {after:.3g} s: not vented"
        card.twin.pass_time(1.0)
        assert card.twin.truth.pressure < 0.2 * bar and not card.twin.moving
    finally:
        server.stop(None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_record(folder / "out")
    return pressure, taken


def main() -> int:
    times = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    generator = np.random.default_rng(4)
    for way in WAYS:
        found = []
        for _ in range(times):
            with tempfile.TemporaryDirectory() as name:
                found.append(crashed(way, float(generator.uniform(0, LONGEST)), Path(name)))
        pressures, taken = zip(*found, strict=True)
        print(
            f"{way}: {times} crashes, at {min(pressures):.2g} to {max(pressures):.2g} bar: all vented, the card at "
            f"rest within {max(taken):.2g} s",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
