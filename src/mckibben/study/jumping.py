"""Jumps from a squat: the constant and the timed pressures whose jumps are highest over the draws."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.control.robot_control import PressureSchedule
from mckibben.errors import McKibbenError, Problem, ScenarioError
from mckibben.mechanism.dynamics import at_rest, contacts, frames, motion, posture_of
from mckibben.mechanism.point_stiffness import movable, point_jacobian
from mckibben.notebook import Progress
from mckibben.plant.base import MOST_SUBSTEPS
from mckibben.plant.robot_plant import RobotPlant, RobotStart
from mckibben.result import Column, Listing, Result, TableColumns, table
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import SimulationResult, simulate, simulate_many
from mckibben.simulation.batch import Batch
from mckibben.simulation.software import engine_of_job, software
from mckibben.statics.posture import holding_torques
from mckibben.storage.store import STUDY, Job, open_store
from mckibben.study.landing import EDGES
from mckibben.study.robot_draws import drawn_plant, take
from mckibben.units import bar, mm, ms

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
    drawn: RobotPlant  # over the draws, of which the first is nominal
    draws: int
    start: RobotStart
    variables: ScheduleVariables
    duration: float
    step: float
    substeps: int  # those that the first schedule needs, so that all jumps have the same
    engine: str = "auto"

    def simulate(self, variables: Floats, plant: RobotPlant | None = None) -> Batch:
        """Metrics of jumps for columns of variables, of the nominal plant or of one per column."""
        steps = {"control_period": self.step, "substeps": self.substeps, "engine": self.engine}
        schedule = self.variables.schedule(np.asarray(variables))
        return simulate_many(plant or self.plant, schedule, initial=self.start, duration=self.duration, **steps)

    def heights(self, variables: Floats) -> Floats:
        """Height [m] of the apex for columns of variables; 0 where the foot stays on the ground."""
        return np.nan_to_num(self.simulate(variables)["apex"])

    def sure_heights(self, variables: Floats) -> Floats:
        """Height [m] that 95 % of the draws reach, for columns of variables."""
        count = variables.shape[1]
        draw, column = np.divmod(np.arange(self.draws * count), count)
        found = self.simulate(variables[:, column], take(self.drawn, draw + 1))["apex"]
        return np.percentile(np.nan_to_num(found).reshape(self.draws, count), EDGES[0], axis=0)


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
    runs: JumpRuns, guess: Floats | None, seed: int, evaluations: Evaluations, report: Callable[[float], None]
) -> Floats:
    """Return the variables of the jump of the last generation whose height is greatest for 95 % of the draws."""
    from scipy.optimize import differential_evolution

    found = differential_evolution(
        lambda x: -evaluations(runs.heights, x),
        [(0.0, 1.0)] * runs.variables.size,
        maxiter=_GENERATIONS,
        popsize=_POPULATION,
        rng=seed,
        x0=guess,
        polish=False,
        vectorized=True,
        updating="deferred",
        callback=lambda intermediate_result: report(0.9 * intermediate_result.nit / _GENERATIONS),
    )
    sure = evaluations(runs.sure_heights, found.population.T) if runs.draws else -found.population_energies
    report(1.0)
    return np.asarray(found.population[np.argmax(sure)])


@dataclass(frozen=True)
class Jump:
    """A jump with its controller, time traces, and results over the draws, of which the first is nominal."""

    controller: PressureSchedule
    run: SimulationResult  # of the nominal jump, with its `resolution`
    substeps: int  # of the jumps of the draws
    heights: Floats  # of the centre of mass at the apex above that of the standing robot of the same draw [m]
    push_force: float  # largest force of the ground before the apex [weight of the robot]; nominal
    landing_force: Floats  # the same after the flight, over the draws
    lowest: tuple[float, ...]  # angles [rad] where the centre of mass is lowest before the apex; nominal
    depth: float  # by which it is lower there than at the start [m]
    work: float  # of the muscles until take-off [J]; nominal
    stop_energy: float  # that the stops absorb until then [J]
    air: float  # mass that flows into the muscles until then [kg]


def interval(values: Floats) -> list[float]:
    """Return 5 and 95 % of the draws, without the nominal one."""
    return np.nanpercentile(values[1:], EDGES).tolist()


class JumpStudy(Result):
    """The best jumps with constant pressures from the start on, and with timed ones.

    Attributes
    ----------
    scenario
        File of the robot.
    constant, timed
        The jumps from the squat.
    deeper
        That with constant pressures from the lowest posture of the timed one, for what timing adds to depth; None where
        the muscles cannot hold it.
    standing
        Greatest height [m] of the centre of mass with the foot on the ground, over the ranges of the joints; nominal.
    """

    figures = ("jump_traces",)
    files = ("robot.yaml", "constant.nc", "deeper.nc", "timed.nc")

    scenario: RobotScenario
    constant: Jump
    deeper: Jump | None
    timed: Jump
    standing: float

    @property
    def jumps(self) -> dict[str, Jump]:
        """The jumps by name."""
        return {"constant": self.constant} | ({"deeper": self.deeper} if self.deeper else {}) | {"timed": self.timed}

    def gains(self) -> dict[str, tuple[float, list[float]]]:
        """Heights [m] that depth and timing add: nominal, and 5 to 95 % over the same draws."""
        names, jumps = (("depth", "timing"), self.jumps) if self.deeper else (("depth and timing",), self.jumps)
        pairs = zip(names, itertools.pairwise(jumps.values()), strict=True)
        added = {name: after.heights - before.heights for name, (before, after) in pairs}
        return {name: (float(heights[0]), interval(heights)) for name, heights in added.items()}

    def declared(self) -> TableColumns:
        """Return columns with a row for each jump, nominal, and with 5 and 95 % of the draws."""
        jumps = list(self.jumps.values())

        def nominal(name: str, title: str, unit: str, shown: str = "") -> dict[str, tuple[Column, Any]]:
            values = [float(np.ravel(getattr(jump, name))[0]) for jump in jumps]
            return {name: (Column(unit, title, shown, digits=3), values)}

        def drawn(name: str, title: str, unit: str, shown: str = "") -> dict[str, tuple[Column, Any]]:
            ends = np.transpose([interval(getattr(jump, name)) for jump in jumps])
            parts = zip(("low", "high"), EDGES, ends, strict=True)
            columns = {f"{name}_{end}": (Column(unit, f"{edge:g} %", shown, digits=3), own) for end, edge, own in parts}
            return nominal(name, title, unit, shown) | columns

        columns: dict[str, tuple[Column, Any]] = {"pressures": (Column(), list(self.jumps))}
        columns |= drawn("heights", "height", "m", "mm") | nominal("depth", "sinks by", "m", "mm")
        columns |= nominal("push_force", "weights at push-off", "1") | drawn("landing_force", "weights at landing", "1")
        columns |= nominal("work", "work of muscles", "J") | nominal("air", "air", "kg", "g")
        columns |= nominal("stop_energy", "into the stops", "J")
        return columns | {"standing": (Column("m", "height of the centre of mass, standing", "mm"), self.standing)}

    @table()
    def gains_and_commands(self) -> Iterator[Listing]:
        """Yield what depth and timing add, and the commands."""
        gains = [(name, gain / mm, *(end / mm for end in ends)) for name, (gain, ends) in self.gains().items()]
        yield Listing.of("Gains in height", ("by", "mm", "5 %", "95 %"), gains)
        rows = [
            (name, muscle, _command(levels, times))
            for name, jump in self.jumps.items()
            for muscle, levels, times in zip(jump.run.muscles, *jump.controller.by_muscle, strict=True)
        ]
        yield Listing("Commands", Listing.of("", ("jump", "muscle", "command"), rows).columns, detail=True)

    def write(self, folder: Path) -> None:
        """Write the file of the robot, and both jumps over time."""
        self.scenario.to_yaml(folder / "robot.yaml")
        for name, jump in self.jumps.items():
            jump.run.to_netcdf(folder / f"{name}.nc")

    def verdict(self) -> str:
        """Return the gains in height."""
        gains = {name: _with_interval(gain / mm, np.array(ends) / mm) for name, (gain, ends) in self.gains().items()}
        return ", ".join(f"{name} adds {gain} mm" for name, gain in gains.items())


def _command(levels: Sequence[Any], times: Sequence[Any]) -> str:
    parts = (f"{level / bar:.4g} bar until {time / ms:.4g} ms" for level, time in zip(levels, times, strict=False))
    return ", ".join([*parts, f"{levels[-1] / bar:.4g} bar"])


def _with_interval(value: float, bounds: Sequence[float] | Floats) -> str:
    return f"{value:.1f} ({bounds[0]:.1f} to {bounds[1]:.1f})"


def standing_torques(plant: RobotPlant, angles: tuple[float, ...]) -> Floats:
    """Return the torques [N*m] of the joints that hold a robot at rest on its foot; those of locked joints are 0.

    The ground carries the weight, without friction; the base does not turn.
    """
    robot, weight = plant.robot, float(plant.robot.total_mass * plant.gravity)
    lifted = point_jacobian(robot, angles)[0][-1] * weight
    return np.where(movable(robot), holding_torques(robot, angles, plant.gravity) - lifted, 0.0)


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

    They are searched by differential evolution of the nominal height over many runs at once; of its last generation,
    the jump is chosen whose height 95 % of the draws reach; its results are those of fresh draws. Constant pressures
    change all commands at the start, timed ones each twice. Constant pressures are searched also from the lowest
    posture of the timed jump.

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
    plant, drawn, fresh = scenario.plant(), drawn_plant(scenario), drawn_plant(scenario, fresh=True)
    start = _squat(scenario, plant.robot.posture_angles(jump.squat), plant, source)
    standing = _standing_heights(plant, fresh)
    fixed = scenario.timing_over(jump.duration)["duration"], scenario.control_period
    searches = [
        JumpRuns(plant, drawn, scenario.uncertainty.draws, start, variables, *fixed, 1)
        for variables in (
            ScheduleVariables(start.pressures, jump.low, jump.high, jump.latest, timed) for timed in (False, True)
        )
    ]
    substeps = scenario.substeps or _batch_substeps(scenario, searches[0])
    trial = searches[0]._replace(substeps=substeps)
    engine = engine_of_job(lambda: {trial.simulate(np.full((trial.variables.size, LANES), 0.5)).engine})
    about = {"format": "mckibben jumps", "software": software(engine), "robot": scenario.dumps(), "seed": seed}
    with open_store(None if out is None else out / STUDY, resume=resume) as store:
        evaluations = Evaluations(store.job(about))

        def search(runs: JumpRuns, guess: Floats | None, number: int, name: str) -> tuple[Floats, Jump]:
            runs = runs._replace(substeps=substeps, engine=engine)

            def report(part: float) -> None:
                if progress:
                    progress(f"{name} pressures", (number + part) / 3)

            best = highest(runs, guess, seed, evaluations, report)
            schedule = runs.variables.schedule([float(x) for x in best])
            return best, _jump(scenario, runs._replace(drawn=fresh), schedule, standing)

        best, constant = search(searches[0], None, 0, "constant")
        # The constant jump is one of the timed ones.
        guess = np.concatenate([best, best, np.zeros(2 * len(start.pressures))])
        _, timed = search(searches[1], guess, 1, "timed")
        deeper = None
        with contextlib.suppress(ScenarioError):
            lowest = _squat(scenario, timed.lowest, plant, source)
            variables = dataclasses.replace(searches[0].variables, held=lowest.pressures)
            _, deeper = search(searches[0]._replace(start=lowest, variables=variables), best, 2, "deeper, constant")
    return JumpStudy(scenario, constant, deeper, timed, float(standing[0]))


def _squat(scenario: RobotScenario, angles: tuple[float, ...], plant: RobotPlant, source: str) -> RobotStart:
    """Start at rest in a posture."""
    try:
        torques = standing_torques(plant, angles).tolist()
        pressures = plant.robot.pressures_for(angles, torques, [None] * len(angles))
        plant.check_substeps(angles, None, scenario.control_period, scenario.substeps or MOST_SUBSTEPS)
    except McKibbenError as error:
        field = "control_period" if error.field == "substeps" else "jump.squat"
        raise ScenarioError(source, [Problem.of(error, field=field)]) from error
    return RobotStart(angles, pressures)


def _batch_substeps(scenario: RobotScenario, runs: JumpRuns) -> int:
    """Integration steps that the first schedule needs, for all jumps of a search."""
    schedule = runs.variables.schedule([0.5] * runs.variables.size)
    nominal = simulate(runs.plant, schedule, initial=runs.start, **scenario.timing_over(runs.duration))
    assert nominal.resolution is not None
    return nominal.resolution.batch_substeps(
        runs.plant.needed_substeps(runs.start.angles, None, scenario.control_period)
    )


def _jump(scenario: RobotScenario, runs: JumpRuns, controller: PressureSchedule, standing: Floats) -> Jump:
    """A jump with its traces, and its results for plants that differ."""
    plant, drawn, start = runs.plant, runs.drawn, runs.start
    timing = scenario.timing_over(runs.duration + _LANDING)
    run = simulate(plant, controller, initial=start, **timing)
    table = simulate_many(drawn, controller, initial=start, **timing | {"substeps": runs.substeps})
    heights, apex = run["mass_height"], int(run["mass_height"].argmax())
    before, bottom = run["ground_up"][:apex], int(heights[: apex + 1].argmin())
    ends = zip(run["angle"][:, bottom], plant.robot.joints, strict=True)
    weight = np.asarray(drawn.robot.total_mass) * plant.gravity
    return Jump(
        *(controller, run, runs.substeps),
        heights=table["apex"] - standing,
        push_force=float(before.max(initial=0.0)) / float(np.ravel(weight)[0]),
        landing_force=table["peak_landing_force"] / weight,
        lowest=tuple(float(np.clip(angle, joint.lower, joint.upper)) for angle, joint in ends),
        depth=float(heights[0] - heights[bottom]),
        work=float(table["muscle_work"][0]),
        stop_energy=float(table["stop_energy"][0]),
        air=float(table["air_mass"][0]),
    )


def _standing_heights(plant: RobotPlant, drawn: RobotPlant) -> Floats:
    """Heights [m] of the centre of mass of each draw above the foot, in the posture in which it is highest."""

    def heights(of: RobotPlant, angles: Sequence[ArrayLike]) -> Array:
        posture = posture_of(of.robot, angles)
        still = at_rest(posture)
        depth = contacts(of.robot, frames(of.robot, posture, still))[0].position.z
        return motion(of.robot, posture, still, of.gravity).height - depth

    ranges = [np.linspace(joint.lower, joint.upper, _POSTURES) for joint in plant.robot.joints]
    grid = [axis.ravel() for axis in np.meshgrid(*ranges)]
    best = int(np.argmax(heights(plant, grid)))
    found = np.asarray(heights(drawn, [axis[best] for axis in grid]))
    return np.broadcast_to(found, (np.size(drawn.robot.bodies[0].mass),))
