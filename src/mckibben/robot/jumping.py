"""Jumps from a squat: the best constant and the best timed pressures for the highest jump."""

from __future__ import annotations

import functools
import itertools
import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.errors import McKibbenError, Problem, ScenarioError, SimulationError
from mckibben.muscle.air import ATMOSPHERE, ENERGY
from mckibben.notebook import Progress
from mckibben.numerics.compiled import jit
from mckibben.numerics.spatial import ZERO, Z
from mckibben.plant.base import MOST_SUBSTEPS
from mckibben.result import Column, Listing, Result
from mckibben.robot.control import PressureSchedule
from mckibben.robot.dynamics import acceleration, at_rest, contacts, frames, motion, posture_of
from mckibben.robot.landing import EDGES
from mckibben.robot.plant import RobotPlant, RobotStart
from mckibben.robot.scenario import JumpSettings, RobotScenario
from mckibben.robot.simulate import RobotResult, simulate_robot, simulate_robots
from mckibben.robot.uncertainty import drawn_plant
from mckibben.simulation.batch import Batch
from mckibben.simulation.software import engine_of_job, software
from mckibben.storage.store import STUDY, Job, open_store
from mckibben.units import bar, deg, mm, ms

Floats = NDArray[np.float64]

_POSTURES = 41  # of each joint, tried for the highest
_LANDING = 0.25  # s of a jump after the duration of its search


_GENERATIONS, _POPULATION = 80, 10  # of differential evolution; the latter for each variable
LANES = 16
"""Runs of one vector: a single height is computed as one of so many."""


class ScheduleVariables(eqx.Module):
    """Schedules by variables from 0 to 1: levels of the muscles, and, if timed, two switching times of each."""

    held: tuple[Any, ...]  # pressures of the start [Pa]
    low: Any  # range of the levels [Pa]
    high: Any
    latest: Any  # switching time [s]
    timed: bool = eqx.field(static=True)  # each muscle switches twice; else all change once, at the start

    @property
    def size(self) -> int:
        """Number of variables."""
        return len(self.held) * (4 if self.timed else 1)

    def schedule(self, variables: Any) -> PressureSchedule:
        """Return the schedule of variables, shape (size, ...)."""
        n = len(self.held)
        x = [variables[i] for i in range(self.size)]
        level: list[Any] = [self.low + (self.high - self.low) * one for one in x[: n * (2 if self.timed else 1)]]
        if not self.timed:
            return PressureSchedule(tuple((own,) for own in level))
        first = [self.latest * one for one in x[2 * n : 3 * n]]
        second = [at + (self.latest - at) * one for at, one in zip(first, x[3 * n :], strict=True)]
        levels: Any = tuple((self.held[i], level[i], level[n + i]) for i in range(n))
        return PressureSchedule(levels, tuple(zip(first, second, strict=True)))


class JumpRuns(NamedTuple):
    """Jumps of a plant from a start: heights to which the centre of mass rises."""

    plant: RobotPlant
    start: RobotStart
    variables: ScheduleVariables
    duration: float
    step: float
    substeps: int  # those that the first schedule needs, so that all jumps have the same
    engine: str = "auto"

    def simulate(self, variables: Floats) -> Batch:
        """Metrics of jumps for columns of variables."""
        steps = {"control_period": self.step, "substeps": self.substeps, "engine": self.engine}
        schedule = self.variables.schedule(np.asarray(variables))
        return simulate_robots(self.plant, schedule, self.start, duration=self.duration, **steps)

    def heights(self, variables: Floats) -> Floats:
        """Height [m] of the apex for columns of variables; 0 where the foot stays on the ground."""
        found = self.simulate(variables)["apex"]
        return np.where(np.isfinite(found), found, 0.0)


class Evaluations:
    """Evaluations of a search by their number, kept or computed; a search repeats them in the same order."""

    def __init__(self, job: Job) -> None:
        self._job, self._number = job, itertools.count()

    def __call__(self, compute: Callable[[Floats], Floats], x: Floats) -> Floats:
        number, key = next(self._number), np.array([float(zlib.crc32(np.ascontiguousarray(x).tobytes()))])
        if number in self._job.numbers:
            block = self._job.read_arrays(number)
            if np.array_equal(block["key"], key):
                return block["found"]
        found = compute(x)
        self._job.add_arrays(number, {"key": key, "found": found})
        return found


def highest(
    runs: JumpRuns, guess: Floats | None, seed: int, evaluations: Evaluations, report: Callable[[float], object]
) -> Floats:
    """Return the variables of the highest jump found."""
    from scipy.optimize import differential_evolution

    size, generation = runs.variables.size, iter(range(1, 10_000))

    def lost_heights(x: Floats) -> Any:
        if x.ndim > 1:
            return -evaluations(runs.heights, x)
        return -evaluations(runs.heights, np.tile(x[:, None], LANES))[0]

    found = differential_evolution(
        lost_heights,
        [(0.0, 1.0)] * size,
        maxiter=_GENERATIONS,
        popsize=_POPULATION,
        rng=seed,
        x0=guess,
        polish=False,
        vectorized=True,
        updating="deferred",
        callback=lambda *_, **__: report(0.9 * next(generation) / _GENERATIONS) and None,
    )
    report(1.0)
    return np.asarray(found.x)


@dataclass(frozen=True)
class Jump:
    """A jump with its controller, time traces, and results over the draws, of which the first is nominal."""

    controller: PressureSchedule
    run: RobotResult  # of the nominal jump, with its `resolution`
    substeps: int  # of the jumps of the draws
    heights: Floats  # of the centre of mass at the apex above that of the standing robot of the same draw [m]
    rises: Floats  # of the centre of mass after take-off [m]
    push_force: float  # largest force of the ground before the apex [weight of the robot]; nominal
    landing_force: Floats  # the same after the flight, over the draws
    work: float  # of the muscles until take-off [J]; nominal
    stop_energy: float  # that the stops absorb until then [J]
    air_energy: float  # exergy at room temperature of the air in the muscles at the start, and of the inflow [J]

    def record(self) -> dict[str, Any]:
        """The results as plain data."""
        resolution = self.run.resolution
        assert resolution is not None
        found: dict[str, Any] = {
            "height_mm": float(self.heights[0] / mm),
            "height_interval_mm": interval(self.heights / mm),
            "rise_mm": float(self.rises[0] / mm),
            "rise_interval_mm": interval(self.rises / mm),
            "push_off_force_weights": self.push_force,
            "landing_force": float(self.landing_force[0]),
            "landing_force_interval": interval(self.landing_force),
            "muscle_work_J": self.work,
            "stop_energy_J": self.stop_energy,
            "air_energy_J": self.air_energy,
            "efficiency": self.work / self.air_energy if self.air_energy > 0 else None,
            "integration": {
                "substeps": self.substeps,
                "error_estimate_rad": resolution.error if math.isfinite(resolution.error) else None,
                "runs_chaotic": int(resolution.chaotic),
            },
        }
        found["levels_bar"] = [[float(level) / bar for level in levels] for levels in self.controller.levels]
        found["switches_ms"] = [[float(time) / ms for time in times] for times in self.controller.switches]
        return found


def interval(values: Floats) -> list[float]:
    """Return 5 and 95 % of the draws, without the nominal one."""
    return np.nanpercentile(values[1:], EDGES).tolist()


class JumpStudy(Result):
    """The best jump with constant pressures from the start on, and the best with timed ones.

    Attributes
    ----------
    scenario
        File of the robot.
    constant, timed
        The jumps.
    standing
        Greatest height [m] of the centre of mass with the foot on the ground, over the ranges of the joints; nominal.
    robot_length
        Height of the hip [m] in that posture.
    """

    figures = ("jump_traces",)
    files = ("robot.yaml", "constant.nc", "timed.nc")

    scenario: RobotScenario
    constant: Jump
    timed: Jump
    standing: float
    robot_length: float

    @property
    def jumps(self) -> dict[str, Jump]:
        """The jumps by name."""
        return {"constant": self.constant, "timed": self.timed}

    def gain(self) -> tuple[float, float, float]:
        """Height [m] that timing adds: nominal, and 5 to 95 % over the same draws."""
        added = self.timed.heights - self.constant.heights
        low, high = interval(added)
        return float(added[0]), low, high

    def to_dict(self) -> dict[str, Any]:
        """The results as plain data; intervals are 5 to 95 % of the draws."""
        assert self.scenario.jump is not None
        gain = self.gain()
        return {
            "scenario": self.scenario.name,
            "squat_deg": {name: angle / deg for name, angle in self.scenario.jump.squat.items()},
            "standing_mass_height_mm": self.standing / mm,
            "robot_length_mm": self.robot_length / mm,
            "muscles": list(self.scenario.plant().robot.muscle_names),
            **{name: jump.record() for name, jump in self.jumps.items()},
            "gain_mm": gain[0] / mm,
            "gain_interval_mm": [gain[1] / mm, gain[2] / mm],
        }

    def listings(self) -> Iterator[Listing]:
        """Yield a table with a row for each jump; intervals are 5 to 95 % of the draws."""
        jumps = [jump.record() for jump in self.jumps.values()]

        def intervals(quantity: str, unit: str = "") -> list[str]:
            pairs = ((jump[quantity + unit], jump[f"{quantity}_interval{unit}"]) for jump in jumps)
            return [_with_interval(*pair) if pair[0] else "-" for pair in pairs]

        def values(key: str) -> list[Any]:
            return [jump[key] for jump in jumps]

        columns: dict[str, tuple[Column, Any]] = {
            "pressures": (Column(), list(self.jumps)),
            "height": (Column("mm", "height"), intervals("height", "_mm")),
            "rise": (Column("mm", "rise after take-off"), intervals("rise", "_mm")),
            "push_off": (Column("1", "weights at push-off", digits=2), values("push_off_force_weights")),
            "landing": (Column("1", "weights at landing"), intervals("landing_force")),
            "work": (Column("J", "work of muscles", digits=3), values("muscle_work_J")),
            "efficiency": (Column("1", "of the air's energy", "%", digits=2), values("efficiency")),
            "stops": (Column("J", "into the stops", digits=2), values("stop_energy_J")),
        }
        yield Listing(f"{self.scenario.name}; intervals are 5 to 95 % of the draws", columns)

    def write(self, folder: Path) -> None:
        """Write the file of the robot, and both jumps over time."""
        self.scenario.to_yaml(folder / "robot.yaml")
        for name, jump in self.jumps.items():
            jump.run.to_netcdf(folder / f"{name}.nc")

    def verdict(self) -> str:
        """Return the gain in height by timing."""
        gain, low, high = (height / mm for height in self.gain())
        return f"timing adds {gain:.1f} mm ({low:.1f} to {high:.1f} mm)"


def _with_interval(value: float, bounds: list[float]) -> str:
    return f"{value:.1f} ({bounds[0]:.1f} to {bounds[1]:.1f})"


def standing_torques(plant: RobotPlant, angles: tuple[float, ...]) -> Floats:
    """Return the torques [N*m] of the joints that hold a robot at rest on its foot; those of locked joints are 0.

    The ground carries the weight, without friction.
    """
    return np.asarray(_standing(plant, tuple(angles)))


@jit
def _standing(plant: RobotPlant, angles: tuple[ArrayLike, ...]) -> Array:
    robot = plant.robot
    posture = posture_of(robot, angles)
    still = at_rest(posture)
    weight = robot.total_mass * plant.gravity

    def accelerations(torques: Array) -> Array:
        forces = [Z.scaled(weight), *[ZERO] * len(robot.contacts)]
        found = acceleration(robot, posture, still, tuple(torques), forces, plant.gravity)
        return jnp.stack(found.angles)

    free = jnp.array([joint.locked is None for joint in robot.joints])
    offset = accelerations(jnp.zeros(len(angles)))
    gain = jax.jacfwd(accelerations)(jnp.zeros(len(angles)))
    matrix = jnp.where(free[:, None] & free[None, :], gain, jnp.eye(len(angles)))
    return jnp.linalg.solve(matrix, jnp.where(free, -offset, 0.0))


def study_jump(
    scenario: RobotScenario,
    *,
    source: str = "",
    seed: int = 0,
    out: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> JumpStudy:
    """Find the highest jumps of a scenario, with constant and with timed pressures.

    Both are searched by differential evolution over many runs at once. The constant jump changes all commands at the
    start; the timed one may change each twice.

    Parameters
    ----------
    scenario, source, seed
        File of the robot, its name for errors, and the seed of the search.
    out, resume
        Folder whose study.sqlite keeps the evaluations of the search, and whether to continue the one in it.

    Raises
    ------
    ScenarioError
        If there is no section `jump`, or the muscles cannot hold the squat; with the attainable range.
    FileError
        As for `study_landing`.
    """
    jump, source = scenario.jump, source or scenario.name
    if jump is None:
        raise ScenarioError(source, [Problem("lacks the section `jump`", remedy="see examples/robot/lei-leg.yaml")])
    plant = scenario.plant()
    start = _squat(scenario, jump, plant, source)
    drawn = drawn_plant(scenario)
    standing, length = _standing_heights(plant, drawn)
    searches = [
        JumpRuns(plant, start, variables, scenario.whole_steps(jump.duration), scenario.control_period, 1)
        for variables in (
            ScheduleVariables(start.pressures, jump.low, jump.high, jump.latest, timed) for timed in (False, True)
        )
    ]
    substeps = scenario.substeps or _batch_substeps(scenario, searches[0])
    trial = searches[0]._replace(substeps=substeps)
    engine = engine_of_job(lambda: {trial.simulate(np.full((trial.variables.size, LANES), 0.5)).engine})
    about = {"format": "mckibben jumps", "software": software(engine), "robot": scenario.dumps(), "seed": seed}
    found: list[Jump] = []
    best: Floats | None = None
    with open_store(None if out is None else out / STUDY, resume=resume) as store:
        evaluations = Evaluations(store.job(about))
        for k, runs in enumerate(search._replace(substeps=substeps, engine=engine) for search in searches):
            # The constant jump is one of the timed ones.
            guess = None if best is None else np.concatenate([best, best, np.zeros(2 * len(start.pressures))])
            report = functools.partial(_report, progress, ("constant pressures", "timed pressures")[k], k)
            best = highest(runs, guess, seed, evaluations, report)
            schedule = runs.variables.schedule([float(x) for x in best])
            found.append(_jump(scenario, runs, schedule, drawn, standing))
    return JumpStudy(scenario, found[0], found[1], float(standing[0]), length)


def _squat(scenario: RobotScenario, jump: JumpSettings, plant: RobotPlant, source: str) -> RobotStart:
    """Start at rest in the squat."""
    angles = plant.robot.posture_angles(jump.squat)
    try:
        torques = standing_torques(plant, angles).tolist()
        pressures = plant.robot.pressures_for(angles, torques, [None] * len(angles))
        plant.check_substeps(angles, None, scenario.control_period, scenario.substeps or MOST_SUBSTEPS)
    except SimulationError as error:
        raise ScenarioError(
            source, [Problem(error.message, field="control_period", remedy="give a shorter one")]
        ) from error
    except McKibbenError as error:
        raise ScenarioError(source, [Problem.of(error, field="jump.squat")]) from error
    return RobotStart(angles, pressures)


def _batch_substeps(scenario: RobotScenario, runs: JumpRuns) -> int:
    """Integration steps that the first schedule needs, for all jumps of a search."""
    schedule = runs.variables.schedule([0.5] * runs.variables.size)
    nominal = simulate_robot(runs.plant, schedule, runs.start, duration=runs.duration, **scenario.steps)
    assert nominal.resolution is not None
    return nominal.resolution.batch_substeps(
        runs.plant.needed_substeps(runs.start.angles, None, scenario.control_period)
    )


def _report(progress: Progress | None, name: str, search: int, part: float) -> None:
    if progress:
        progress(name, (search + part) / 2)


def _jump(
    scenario: RobotScenario,
    runs: JumpRuns,
    controller: PressureSchedule,
    drawn: RobotPlant,
    standing: Floats,
) -> Jump:
    """A jump with its traces, and its results for plants that differ."""
    plant, start = runs.plant, runs.start
    duration = scenario.whole_steps(runs.duration + _LANDING)
    run = simulate_robot(plant, controller, start, duration=duration, **scenario.steps)
    steps = {"control_period": runs.step, "substeps": runs.substeps}
    table = simulate_robots(drawn, controller, start, duration=duration, **steps)
    valve: Any = plant.valve
    supply = float(np.asarray(valve.supply if valve.holds_air else runs.variables.high)) + ATMOSPHERE
    inflow = float(table["air_mass"][0]) * ENERGY * math.log(supply / ATMOSPHERE)
    ratio = 1 + run["pressure"][:, 0] / ATMOSPHERE
    stored = run["air_mass"][:, 0] @ (np.log(ratio) + 1 / ratio - 1) * ENERGY
    before = run["ground_up"][: int(run["mass_height"].argmax())]
    weight = np.asarray(drawn.robot.total_mass) * plant.gravity
    return Jump(
        controller,
        run,
        runs.substeps,
        heights=table["apex"] - standing,
        rises=table["take_off_speed"] ** 2 / (2 * plant.gravity),
        push_force=float(before.max(initial=0.0)) / float(np.ravel(weight)[0]),
        landing_force=table["peak_landing_force"] / weight,
        work=float(table["muscle_work"][0]),
        stop_energy=float(table["stop_energy"][0]),
        air_energy=inflow + float(stored),
    )


def _standing_heights(plant: RobotPlant, drawn: RobotPlant) -> tuple[Floats, float]:
    """Heights [m] of the centre of mass of each draw in the posture in which it is highest, and that of the hip."""

    def heights(of: RobotPlant, angles: Sequence[ArrayLike]) -> tuple[Array, Array]:
        """Heights of the centre of mass and of the hip above the foot."""
        posture = posture_of(of.robot, angles)
        still = at_rest(posture)
        depth = contacts(of.robot, frames(of.robot, posture, still))[0].position.z
        return motion(of.robot, posture, still, of.gravity).height - depth, -depth

    ranges = [np.linspace(joint.lower, joint.upper, _POSTURES) for joint in plant.robot.joints]
    grid = [axis.ravel() for axis in np.meshgrid(*ranges)]
    best = int(np.argmax(heights(plant, grid)[0]))
    angles = [axis[best] for axis in grid]
    found = np.asarray(heights(drawn, angles)[0])
    return np.broadcast_to(found, (np.size(drawn.robot.bodies[0].mass),)), float(heights(plant, angles)[1])
