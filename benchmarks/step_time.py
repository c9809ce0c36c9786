"""Time of a step of each controller of examples/comparison/valves.yaml in exported C, relative to the PID's.

    python benchmarks/step_time.py [--setup NAME] [--repeats 9]

Needs a C compiler (cc). Each controller is exported with the gains of the suite and replays its run, in turn with the
others; the times are the least of the repeats, on this processor.
"""

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

from mckibben.export import export
from mckibben.study.compare import Suite

SUITE = Path(__file__).parents[1] / "examples" / "comparison" / "valves.yaml"
STEPS = 30_000  # of a repeat


def replay(folder):
    """Build the program of an exported controller, and return its command."""
    subprocess.run(("make", "-s", "check"), cwd=folder, check=True, capture_output=True)
    return folder / "replay", folder / "replay.csv", str(STEPS)


def step_time(command):
    """Time of a step [ns]."""
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(re.findall(r"(\d+) ns per step", done.stdout)[0])


def main():
    suite = Suite.read(SUITE)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--setup", choices=suite.setups)
    parser.add_argument("--repeats", type=int, default=9)
    given = parser.parse_args()
    names = [name for name in suite.controllers if name not in suite.true_model]
    print("| setup | " + " | ".join(names) + " |")
    print("|---" * (len(names) + 1) + "|")
    for setup in [given.setup] if given.setup else suite.setups:
        own, commands = suite.of_setup(setup), []
        with tempfile.TemporaryDirectory() as made:
            for number, name in enumerate(names):
                folder = Path(made) / str(number)
                export(own.scenario(name, next(iter(own.references))), "c", folder, name="controller")
                commands.append(replay(folder))
            times = [map(step_time, commands) for _ in range(given.repeats)]
            least = [min(column) for column in zip(*times, strict=True)]
        print(f"| {setup} | " + " | ".join(f"{one:.0f} ns, {one / least[0]:.1f}" for one in least) + " |", flush=True)


if __name__ == "__main__":
    main()
