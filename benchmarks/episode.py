"""One warm episode (10 s, control at 1 kHz, RK4 with 4 substeps) against plain C, in one run, alternating.

    python benchmarks/episode.py [--runs 41] [--json FILE]

The C reference is `episode.c`, compiled with `cc -O3 -march=native`. Before anything is timed, both have to
compute the same episode; the deviation is printed. Times differ from machine to machine and hour to hour: look at the
ratio.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from mckibben import catalog, simulate
from mckibben.control import PID, PositionStiffnessControl, Reference, Sine, Step
from mckibben.joint import AntagonisticJoint, KneeGeometry
from mckibben.numerics.compiled import numeric
from mckibben.plant import FirstOrderValve, JointPlant
from mckibben.simulation.loop import compiled_episode, sampled
from mckibben.units import bar, deg, mm, ms

PERIODS, PERIOD, SUBSTEPS = 10_000, 1 * ms, 4
POSITION = PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar)
STIFFNESS = PID(kp=0.08 * bar, ki=5 * bar, kd=0.0)


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--runs", type=int, default=41, help="counted runs of each engine")
    arguments.add_argument("--json", type=Path, help="write the rows to this file too")
    options = arguments.parse_args()

    printed = catalog.joint("knee-table-2")
    geometry = KneeGeometry(printed.geometry.joint_length, printed.geometry.joint_radius, 208 * mm)
    joint = AntagonisticJoint(geometry, printed.muscle1, printed.muscle2)
    plant = JointPlant(joint, catalog.load("knee-table-2"), FirstOrderValve(20 * ms))
    control = PositionStiffnessControl(POSITION, STIFFNESS, model=joint)
    reference = Reference(Sine(10 * deg, 0.5), Step(13.0, 17.0, 5.0))
    start = plant.at_rest(0.0, stiffness=12.0)
    _, wishes = sampled(reference, PERIODS * PERIOD, PERIOD)

    traced = numeric((plant, control, wishes, start, PERIOD))

    def run_jax() -> np.ndarray:
        _, record = jax.block_until_ready(compiled_episode(*traced, SUBSTEPS))
        columns = (*record.state, record.command1, record.command2, record.telemetry["stiffness_estimate"])
        return np.stack([np.asarray(column) for column in columns], axis=1)

    def loop_only() -> None:
        jax.block_until_ready(compiled_episode(*traced, SUBSTEPS))

    def whole() -> None:
        simulate(plant, control, reference, initial=start)

    with tempfile.TemporaryDirectory() as folder:
        run_c = plain_c(Path(folder), plant, wishes, start)
        deviation = float(np.abs(run_jax() - run_c())[:, 0].max())
        print(f"largest deviation of the angle between the engines: {deviation:.1e} rad")
        if not deviation < 1e-9:
            print("they do not compute the same episode; nothing is timed", file=sys.stderr)
            return 1
        engines = {"plain C, -O3 -march=native": run_c, "JAX, compiled loop": loop_only, "mk.simulate": whole}
        rows = alternate(engines, options.runs)

    base = rows["plain C, -O3 -march=native"]
    print(f"{'one warm episode':28} {'median ms':>10} {'against C':>10}")
    for name, times in rows.items():
        ratio = statistics.median(t / c for t, c in zip(times, base, strict=True))
        print(f"{name:28} {1e3 * statistics.median(times):10.2f} {ratio:9.2f}x")
    if options.json:
        numbers = {"deviation_rad": deviation, "jax": jax.__version__, "seconds": rows}
        options.json.write_text(json.dumps(numbers, indent=2) + "\n")
    return 0


def plain_c(folder: Path, plant: JointPlant, wishes, start) -> Callable[[], np.ndarray]:
    """Compile the C reference and bind it to the same numbers."""
    library = folder / "episode.so"
    source = Path(__file__).with_name("episode.c")
    subprocess.run(
        ["cc", "-O3", "-march=native", "-shared", "-fPIC", "-o", str(library), str(source), "-lm"], check=True
    )
    function = ctypes.CDLL(str(library)).episode
    doubles = ctypes.POINTER(ctypes.c_double)
    law, specimen = plant.joint.muscle1.law, plant.joint.muscle1.specimen
    geometry, load = plant.joint.geometry, plant.load
    domain = plant.joint.muscle1.domain
    loops = (POSITION, STIFFNESS)
    parameters = np.array(
        [law.a1, law.a2, law.b1, law.b2, law.c1, law.c2, law.decay]
        + [specimen.initial_length, geometry.joint_length, geometry.joint_radius, geometry.connector_length]
        + [load.total_inertia, load.damping, load.gravity_moment, load.hanging_angle]
        + [plant.valve.time_constant, domain.pressure_min, domain.pressure_max]
        + [getattr(loop, name) for name in ("kp", "ki", "kd", "filter_time", "tracking_time") for loop in loops],
        dtype=float,
    )
    angle, stiffness = (np.array(wish, dtype=float) for wish in wishes)
    state = np.array([float(x) for x in start])
    out = np.zeros((PERIODS, 7))
    arrays = [array.ctypes.data_as(doubles) for array in (parameters, angle, stiffness, state)]

    def run() -> np.ndarray:
        function(
            *arrays,
            ctypes.c_long(PERIODS),
            ctypes.c_double(PERIOD),
            ctypes.c_long(SUBSTEPS),
            out.ctypes.data_as(doubles),
        )
        return out

    return run


def alternate(engines: dict[str, Callable[[], object]], runs: int) -> dict[str, list[float]]:
    """Seconds of each engine's runs, taken in turn so that a machine that slows down slows all of them."""
    times: dict[str, list[float]] = {name: [] for name in engines}
    for engine in engines.values():
        engine()
    for _ in range(runs):
        for name, engine in engines.items():
            begin = time.perf_counter()
            engine()
            times[name].append(time.perf_counter() - begin)
    return times


if __name__ == "__main__":
    sys.exit(main())
