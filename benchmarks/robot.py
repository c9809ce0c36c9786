"""Landings of a robot on one core: our batches against MuJoCo with the plugin for the same muscles."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rows import Candidate, Table
from timing import Bench, inverted

import mckibben as mk
from mckibben import catalog
from mckibben import robot as robots
from mckibben.errors import SimulationError
from mckibben.units import deg, mm, ms

DURATION, PERIOD, STEP = 0.3, 2 * ms, 0.25 * ms
SUBSTEPS = round(PERIOD / STEP)
IN_SPACE = ", in space"
GROUNDS = {
    "friction 0.8 from 100 mm/s": robots.Ground(friction=0.8),
    "no friction": robots.Ground(friction=0.0),
}
ANGLES = {"": (2 * deg, -5 * deg), IN_SPACE: (2 * deg, 2 * deg, -5 * deg)}
SPEEDS = 0.6, 1.2  # m/s, downwards at the touch
LANES, REPEATED = 256, 20
ANGLE_ERROR, FORCE_ERROR = 0.1 * deg, 0.01
"""Largest error of the knee's angle [rad], and of the peak force, relative, at equal accuracy."""
COUNTS = (1, 2, 3, 4, 6, 8, 10, 12, 16, 24, 32, 48, 64)  # steps a period
FINER = 16
INTEGRATORS = ("RK4", "implicitfast")
EQUAL = "equal accuracy"
Force = Callable[[int], tuple[NDArray[np.float64], float]]


def robot_plant(where: str) -> robots.RobotPlant:
    """Hip and knee with two muscles each, on a slider; or side swing, hip and knee of the catalog's robot."""
    valve = mk.FirstOrderValve(20 * ms)
    if where.endswith(IN_SPACE):
        return robots.RobotPlant(robots.read_robot("lei-leg"), valve, GROUNDS[where.removesuffix(IN_SPACE)])
    muscle = mk.Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    pair = mk.AntagonisticJoint(mk.KneeGeometry(370 * mm, 30 * mm, 208 * mm), muscle, muscle)
    forwards = (0.0, -1.0, 0.0)
    hip = robots.Joint("hip", forwards, -15 * deg, 15 * deg, "thigh", damping=0.05)
    knee = robots.Joint(
        "knee", forwards, -25 * deg, 30 * deg, "shank", None, robots.Place(z=-0.4), -30 * deg, damping=0.05
    )
    bodies = (
        robots.Body("trunk", 1.0),
        robots.Body("thigh", 0.5, robots.Place(z=-0.19), (0.009, 0.0)),
        robots.Body("shank", 0.3, robots.Place(z=-0.15), (0.005, 0.0)),
    )
    pairs = tuple(robots.MusclePair(name, pair.geometry, muscle, muscle) for name in ("hip", "knee"))
    own = robots.Robot(bodies, (hip, knee), pairs, "vertical", robots.Foot("shank", robots.Place(z=-0.37), 20 * mm))
    return robots.RobotPlant(own, valve, GROUNDS[where])


def robot(folder: Path, *, quick: bool) -> Table:
    """The table of landings."""
    bench = Bench(rounds=5 if quick else 15, budget=1.0 if quick else 5.0)
    for number, where in enumerate(ground + kind for kind in ANGLES for ground in GROUNDS):
        _add(bench, folder, where, f"robot{number}")
    return Table(
        "Landings of a robot",
        f"landing of {DURATION:g} s",
        "speed",
        "knee angle [rad]",
        inverted(bench.timed()),
        (
            "Vertical slider, hip and knee with four muscles, valves of 20 ms, contact; one core. In space: `lei-leg`, "
            "side swing, hip and knee with six muscles. Friction from a slip speed as given. Ours: "
            f"{LANES} landings of different speeds in a batch, with all metrics. MuJoCo: the emitted plugin, `mj_step` "
            "with `nstep`, its own contact.",
            f"Equal accuracy: the largest step with which the angle of the knee is within {ANGLE_ERROR / deg:g} deg, "
            f"and the peak force within {100 * FORCE_ERROR:g} %, of the same engine's run with {FINER} times finer "
            f"steps than {STEP / ms:g} ms, as are all smaller steps; both every {PERIOD / ms:g} ms. Our ratio is "
            "against the faster of MuJoCo's two integrators; deviation: that angle, for 32 bits that with 64.",
            f"First batch of a robot that was never compiled, in a new process: {first_batch(folder):.1f} s.",
        ),
    )


def _add(bench: Bench, folder: Path, where: str, model_name: str) -> None:
    """Engines on a ground."""
    plant = robot_plant(where)
    controller, start = _given(plant)
    fast: dict[str, float] = {}

    def named(engine: str, count: int, accuracy: str = "") -> str:
        return ", ".join(filter(None, (engine, f"{PERIOD / count / ms:.3g} ms", accuracy, where)))

    def batch(count: int, engine: str, precision: int = 64) -> Callable[[], Any]:
        given = {"duration": DURATION, "control_period": PERIOD, "substeps": count, "workers": 1, "engine": engine}
        given["precision"] = precision
        over = {"initial.upward_speed": -np.linspace(*SPEEDS, LANES)}
        return lambda: robots.simulate_robots(plant, controller, start, over=over, chunk=LANES, **given)

    base = named("MuJoCo, RK4", SUBSTEPS)

    def others() -> list[Candidate]:
        model = _Mujoco(plant, start, folder, model_name)
        found = [
            Candidate(named(f"MuJoCo, {one}", SUBSTEPS), model.runs(one, SUBSTEPS), REPEATED, base=base)
            for one in INTEGRATORS
        ]
        for integrator in INTEGRATORS:
            count, angle = coarsest(model.traced(integrator))
            name, run = named(f"MuJoCo, {integrator}", count, EQUAL), model.runs(integrator, count)
            begin = time.perf_counter()
            run()
            fast[name] = time.perf_counter() - begin
            found.append(Candidate(name, run, REPEATED, angle, ANGLE_ERROR, base=base))
        return found

    def ours() -> list[Candidate]:
        count, angle = coarsest(lambda count: traced(plant, count))
        fastest = min(fast, key=lambda name: fast[name]) if fast else ""
        name = named("ours", count, EQUAL)
        whole, half = batch(count, "native"), batch(count, "native", 32)
        peaks = [np.asarray(one()["peak_force"], float) for one in (whole, half)]
        apart = float(np.abs(peaks[1] / peaks[0] - 1).max())
        short = Candidate(
            named("ours, 32 bits", count, EQUAL),
            half,
            LANES,
            angle if apart <= FORCE_ERROR else np.inf,
            ANGLE_ERROR,
            note=f"peak forces of all landings within {100 * apart:.1g} % of those with 64 bits",
            base=fastest,
        )
        return [
            Candidate(named("ours", SUBSTEPS), batch(SUBSTEPS, "native"), LANES, base=base),
            Candidate(named("ours, engine='xla'", SUBSTEPS), batch(SUBSTEPS, "xla"), LANES, base=base),
            Candidate(name, whole, LANES, angle, ANGLE_ERROR, base=fastest),
            short,
        ]

    bench.add(f"MuJoCo, {where}", others, install="mujoco")
    bench.add(f"ours, {where}", ours)


def traced(plant: robots.RobotPlant, count: int) -> tuple[NDArray[np.float64], float]:
    """Angle of the knee [rad] over time and peak force [N] of our landing; NaN if the step is refused."""
    try:
        run = robots.simulate_robot(plant, *_given(plant), duration=DURATION, control_period=PERIOD, substeps=count)
    except SimulationError:
        return np.full(round(DURATION / PERIOD), np.nan), np.nan
    return run["angle"][-1], float(run["ground_up"].max())


def _given(plant: robots.RobotPlant) -> tuple[robots.PressureSchedule, robots.RobotStart]:
    """Constant pressures, and a landing in the middle of the speeds."""
    angles = next(one for one in ANGLES.values() if len(one) == len(plant.robot.joints))
    others = len(angles) - 1
    pressures = plant.robot.pressures_for(angles, (0.0,) * len(angles), ((None,) * others) + (17.0,))
    return robots.PressureSchedule(tuple((one,) for one in pressures)), robots.RobotStart(
        angles, pressures, 0.0, -sum(SPEEDS) / 2
    )


def coarsest(traced: Force) -> tuple[int, float]:
    """Fewest steps a period that are accurate, as are all more; and the error of the knee's angle [rad] with them."""
    true, highest = traced(FINER * SUBSTEPS)
    good, deviation = COUNTS[-1], np.inf
    for count in reversed(COUNTS):
        angles, peak = traced(count)
        off = float(np.abs(angles - true).max())
        if not (off <= ANGLE_ERROR and abs(peak / highest - 1) <= FORCE_ERROR):
            break
        good, deviation = count, off
    return good, deviation


class _Mujoco:
    """The robot in MuJoCo."""

    def __init__(self, plant: robots.RobotPlant, start: robots.RobotStart, folder: Path, name: str) -> None:
        import mujoco

        from mckibben.export.mjcf import mujoco_model
        from mckibben.export.mujoco import load_mujoco
        from mckibben.export.muscle_plugin import plugin_files

        self._engine = mujoco
        begun = plant.init_state(*start[:2], clearance=start.clearance, upward_speed=start.upward_speed)
        plugin_files(mujoco_model(plant, name, start=begun), name).save(folder / name)
        self._model = load_mujoco(folder / name)
        self._data = mujoco.MjData(self._model)

    def _begin(self, integrator: str, count: int) -> None:
        engine, model, data = self._engine, self._model, self._data
        model.opt.integrator = getattr(engine.mjtIntegrator, f"mjINT_{integrator.upper()}")
        model.opt.timestep = PERIOD / count
        engine.mj_resetDataKeyframe(model, data, 0)

    def runs(self, integrator: str, count: int) -> Callable[[], Any]:
        """So many landings that they take as long as a batch of ours."""

        def run() -> None:
            for _ in range(REPEATED):
                self._begin(integrator, count)
                self._engine.mj_step(self._model, self._data, nstep=round(DURATION / PERIOD) * count)

        return run

    def traced(self, integrator: str) -> Force:
        """Angle of the knee and peak force of a landing, at each period."""
        engine, model, data = self._engine, self._model, self._data
        place, force = model.joint("knee").qposadr[0], np.zeros(6)

        def run(count: int) -> tuple[NDArray[np.float64], float]:
            self._begin(integrator, count)
            angles, peak = [], 0.0
            for _ in range(round(DURATION / PERIOD)):
                engine.mj_forward(model, data)
                angles.append(data.qpos[place])
                for number in range(data.ncon):
                    engine.mj_contactForce(model, data, number, force)
                    peak = max(peak, force[0])
                engine.mj_step(model, data, nstep=count)
            return np.array(angles), float(peak)

        return run


def first_batch(folder: Path) -> float:
    """Seconds of a first batch, without what was stored by earlier ones."""
    empty = folder / "nothing stored"
    empty.mkdir()
    environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, __file__], env=environment | {"XDG_CACHE_HOME": str(empty)}, capture_output=True, text=True
    )
    if done.returncode:
        raise OSError(done.stderr[-300:])
    return float(done.stdout)


def main() -> None:
    """Seconds of the first batch of this process."""
    plant = robot_plant(next(iter(GROUNDS)))
    controller, start = _given(plant)
    over = {"initial.upward_speed": -np.linspace(*SPEEDS, LANES)}
    begin = time.perf_counter()
    settings = {"duration": DURATION, "control_period": PERIOD, "substeps": SUBSTEPS}
    robots.simulate_robots(plant, controller, start, over=over, workers=1, **settings)
    print(time.perf_counter() - begin)


if __name__ == "__main__":
    main()
