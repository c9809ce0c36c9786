"""Jumps from a squat: pressures and their timing for the highest jump, compared with the best constant pressures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.errors import McKibbenError, Problem, ScenarioError, SimulationError
from mckibben.leg.control import PressureSchedule
from mckibben.leg.dynamics import acceleration, at_rest, contact, frames, motion, posture_of
from mckibben.leg.landing import EDGES
from mckibben.leg.plant import LegPlant, LegStart
from mckibben.leg.scenario import LegScenario
from mckibben.leg.simulate import LegResult, leg_metrics, simulate_leg, simulate_legs
from mckibben.leg.uncertainty import drawn_plant
from mckibben.muscle.air import ATMOSPHERE, ENERGY
from mckibben.notebook import Progress
from mckibben.numerics.compiled import compiled, numeric
from mckibben.numerics.spatial import Z
from mckibben.plant.base import MOST_SUBSTEPS
from mckibben.simulation.engine import BatchFunction, dynamic_steps
from mckibben.simulation.problem import sampling_times
from mckibben.simulation.table import Batch
from mckibben.units import bar, deg, mm, ms

Floats = NDArray[np.float64]

_GENERATIONS, _POPULATION = 80, 10  # of differential evolution; the latter for each variable
_POSTURES = 41  # of each joint, tried for the highest
_POLISHING = 30  # iterations of L-BFGS-B


@dataclass(frozen=True)
class Jump:
    """A jump with its schedule, time traces, and heights over the draws, of which the first is nominal.

    Attributes
    ----------
    schedule
        Commands of the muscles.
    run
        Time traces of the nominal jump (`simulate_leg`), with its `resolution`.
    substeps
        Integration steps per control period of the jumps of the draws.
    heights
        Heights [m] of the centre of mass at the apex above that of the standing leg of the same draw.
    rises
        Rise of the centre of mass [m] after take-off.
    work
        Work of the muscles [J] until take-off, nominal.
    air_energy
        Exergy [J], at room temperature, of the air in the muscles at the start and of the inflow until take-off.
    """

    schedule: PressureSchedule
    run: LegResult
    substeps: int
    heights: Floats
    rises: Floats
    work: float
    air_energy: float

    def record(self) -> dict[str, Any]:
        """The results as plain data."""
        low, high = np.nanpercentile(self.heights[1:], EDGES)
        resolution = self.run.resolution
        assert resolution is not None
        return {
            "height_mm": float(self.heights[0] / mm),
            "height_interval_mm": [float(low / mm), float(high / mm)],
            "rise_mm": float(self.rises[0] / mm),
            "muscle_work_J": self.work,
            "air_energy_J": self.air_energy,
            "efficiency": self.work / self.air_energy if self.air_energy > 0 else None,
            "levels_bar": [[float(one) / bar for one in levels] for levels in self.schedule.levels],
            "switches_ms": [[float(one) / ms for one in times] for times in self.schedule.switches],
            "integration": {
                "substeps": self.substeps,
                "error_estimate_rad": resolution.error if math.isfinite(resolution.error) else None,
                "runs_chaotic": int(resolution.chaotic),
            },
        }


@dataclass(frozen=True)
class JumpStudy:
    """The best jump with constant pressures from the start on, and the best with timed ones.

    Attributes
    ----------
    scenario
        File of the leg.
    constant, timed
        Both jumps.
    standing
        Greatest height [m] of the centre of mass with the foot on the ground, over the ranges of the joints; nominal.
    leg_length
        Height of the hip [m] in that posture.
    """

    scenario: LegScenario
    constant: Jump
    timed: Jump
    standing: float
    leg_length: float

    def gain(self) -> tuple[float, float, float]:
        """Height [m] that timing adds: nominal, and 5 to 95 % over the same draws."""
        added = self.timed.heights - self.constant.heights
        low, high = np.nanpercentile(added[1:], EDGES)
        return float(added[0]), float(low), float(high)

    def records(self) -> dict[str, Any]:
        """The results as plain data; intervals are 5 to 95 % of the draws."""
        assert self.scenario.jump is not None
        gain = self.gain()
        return {
            "scenario": self.scenario.name,
            "squat_deg": {name: angle / deg for name, angle in self.scenario.jump.squat.items()},
            "standing_mass_height_mm": self.standing / mm,
            "leg_length_mm": self.leg_length / mm,
            "muscles": list(self.scenario.plant().leg.muscle_names),
            "constant": self.constant.record(),
            "timed": self.timed.record(),
            "gain_mm": gain[0] / mm,
            "gain_interval_mm": [gain[1] / mm, gain[2] / mm],
        }

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headers and rows of a table, one for each jump."""
        headers = ("pressures", "height [mm]", "rise after take-off [mm]", "work of muscles", "of the air's energy")
        rows = []
        for name, jump in (("constant", self.constant), ("timed", self.timed)):
            one = jump.record()
            low, high = one["height_interval_mm"]
            share = "-" if one["efficiency"] is None else f"{one['efficiency'] * 100:.0f} %"
            height = f"{one['height_mm']:.1f} ({low:.1f} to {high:.1f})"
            rows.append((name, height, f"{one['rise_mm']:.1f}", f"{one['muscle_work_J']:.2f} J", share))
        return headers, rows

    def describe(self) -> str:
        """Gain in height by timing, as text."""
        gain, low, high = (one / mm for one in self.gain())
        return f"timing adds {gain:.1f} mm ({low:.1f} to {high:.1f} mm)"

    def __repr__(self) -> str:
        heights = (f"{jump.heights[0] / mm:.0f} mm" for jump in (self.constant, self.timed))
        return f"<JumpStudy of {self.scenario.name!r}: constant {', timed '.join(heights)}>"


def standing_torques(plant: LegPlant, angles: tuple[float, ...]) -> Floats:
    """Return the torques [N*m] of the joints that hold a leg at rest on its foot; those of locked joints are 0.

    The ground carries the weight, without friction.
    """
    return np.asarray(_standing(plant, tuple(angles)))


@compiled
def _standing(plant: LegPlant, angles: tuple[ArrayLike, ...]) -> Array:
    leg = plant.leg
    posture = posture_of(leg, angles)
    still = at_rest(posture)
    weight = leg.total_mass * plant.gravity

    def accelerations(torques: Array) -> Array:
        found = acceleration(leg, posture, still, tuple(torques), Z.scaled(weight), plant.gravity)
        return jnp.stack(found.angles)

    free = jnp.array([joint.locked is None for joint in leg.joints])
    offset = accelerations(jnp.zeros(len(angles)))
    gain = jax.jacfwd(accelerations)(jnp.zeros(len(angles)))
    matrix = jnp.where(free[:, None] & free[None, :], gain, jnp.eye(len(angles)))
    return jnp.linalg.solve(matrix, jnp.where(free, -offset, 0.0))


class ScheduleVariables(eqx.Module):
    """Schedules by variables from 0 to 1: levels of the muscles, and, if timed, two switching times of each.

    Parameters
    ----------
    held
        Gauge pressures [Pa] of the start.
    low, high
        Range of the levels [Pa].
    latest
        Latest switching time [s].
    timed
        Whether each muscle switches twice; else all change their command once, at the start.
    """

    held: tuple[Any, ...]
    low: Any
    high: Any
    latest: Any
    timed: bool = eqx.field(static=True)

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
    """Jumps of a plant from a start: heights to which the centre of mass rises, and their gradient."""

    plant: LegPlant
    start: LegStart
    variables: ScheduleVariables
    duration: float
    step: float
    substeps: int  # those that the first schedule needs, so that all jumps have the same

    def simulate(self, plant: LegPlant, schedule: PressureSchedule) -> Batch:
        """Metrics of many jumps."""
        steps = {"control_period": self.step, "substeps": self.substeps}
        return simulate_legs(plant, schedule, self.start, duration=self.duration, **steps)

    def heights(self, variables: Floats) -> Floats:
        """Height [m] of the apex for columns of variables; 0 where the foot stays on the ground."""
        found = self.simulate(self.plant, self.variables.schedule(np.asarray(variables)))["apex"]
        return np.where(np.isfinite(found), found, 0.0)

    def height_and_gradient(self, variables: Floats, engine: str = "auto") -> tuple[float, Floats]:
        """Height [m] of `heights`, and its gradient by forward differentiation: a direction in each lane."""
        x = np.asarray(variables, float)
        times, period = sampling_times(self.duration, self.step), np.asarray(self.step)
        steps = dynamic_steps(self.substeps)
        shared = numeric((self.plant, self.start, self.variables, x, times, period)), steps
        (value, gradient), _ = _derivative(engine, shared, np.eye(x.size))
        return float(np.asarray(value)[0]), np.asarray(gradient)


@BatchFunction
def _derivative(shared: Any, direction: Any) -> tuple[Array, Array]:
    """Height of a jump, and its derivative in one direction."""
    (plant, start, given, variables, times, period), steps = shared

    def height(x: Array) -> Array:
        return leg_metrics(plant, given.schedule(x), start, times, period, steps).apex

    return jax.jvp(height, (variables,), (direction,))


def study_jump(
    scenario: LegScenario, *, source: str = "", seed: int = 0, progress: Progress | None = None
) -> JumpStudy:
    """Find the highest jumps of a scenario, with constant and with timed pressures.

    Both are searched by differential evolution over many runs at once, and polished by L-BFGS-B with gradients of
    forward differentiation. The constant jump changes all commands at the start; the timed one may change each twice.

    Raises
    ------
    ScenarioError
        If there is no section `jump`, or the muscles cannot hold the squat; with the attainable range.
    """
    jump, source = scenario.jump, source or scenario.name
    if jump is None:
        raise ScenarioError(source, [Problem("lacks the section `jump`", remedy="see examples/leg/lei-leg.yaml")])
    plant = scenario.plant()
    leg = plant.leg
    angles = leg.posture_angles(jump.squat)
    try:
        pressures = leg.pressures_for(angles, standing_torques(plant, angles).tolist(), [None] * len(angles))
        start = LegStart(angles, pressures)
        plant.check_substeps(angles, None, scenario.step, scenario.substeps or MOST_SUBSTEPS)
    except SimulationError as error:
        raise ScenarioError(source, [Problem(error.message, field="step", remedy="give a shorter `step`")]) from error
    except McKibbenError as error:
        raise ScenarioError(source, [Problem.of(error, field="jump.squat")]) from error
    drawn = drawn_plant(scenario)
    standing, length = _standing_heights(plant, drawn)
    found, duration, substeps = [], scenario.whole_steps(jump.duration), scenario.substeps
    best: Floats | None = None
    for timed in (False, True):
        variables = ScheduleVariables(pressures, jump.low, jump.high, jump.latest, timed)
        if substeps is None:
            schedule = variables.schedule([0.5] * variables.size)
            nominal = simulate_leg(plant, schedule, start, duration=duration, **scenario.steps)
            assert nominal.resolution is not None
            substeps = nominal.resolution.batch_substeps(plant.needed_substeps(angles, None, scenario.step))
        runs = JumpRuns(plant, start, variables, duration, scenario.step, substeps)
        # The constant jump is one of the timed ones.
        guess = None if best is None else np.concatenate([best, best, np.zeros(2 * len(pressures))])
        name = "timed pressures" if timed else "constant pressures"
        best = _highest(runs, guess, seed, lambda part, n=name, k=timed: progress and progress(n, (k + part) / 2))
        found.append(_jump(scenario, runs, best, drawn, standing))
    return JumpStudy(scenario, found[0], found[1], float(standing[0]), length)


def _highest(runs: JumpRuns, guess: Floats | None, seed: int, report: Callable[[float], object]) -> Floats:
    """Variables of the highest jump found."""
    from scipy.optimize import differential_evolution, minimize

    size, generation = runs.variables.size, iter(range(1, 10_000))
    found = differential_evolution(
        lambda x: -runs.heights(x) if x.ndim > 1 else -runs.heights(np.tile(x[:, None], 16))[0],
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

    def lost(x: Floats) -> tuple[float, Floats]:
        height, gradient = runs.height_and_gradient(x)
        return -height, -gradient

    options = {"maxiter": _POLISHING}
    polished = minimize(lost, found.x, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * size, options=options)
    report(1.0)
    return np.asarray(polished.x if polished.fun <= found.fun else found.x)


def _jump(scenario: LegScenario, runs: JumpRuns, variables: Floats, drawn: LegPlant, standing: Floats) -> Jump:
    """A jump with its traces, and its heights for plants that differ."""
    schedule = runs.variables.schedule([float(one) for one in variables])
    run = simulate_leg(runs.plant, schedule, runs.start, duration=runs.duration, **scenario.steps)
    table = runs.simulate(drawn, schedule)
    valve: Any = runs.plant.valve
    supply = float(np.asarray(valve.supply if valve.holds_air else runs.variables.high)) + ATMOSPHERE
    inflow = float(table["air_mass"][0]) * ENERGY * math.log(supply / ATMOSPHERE)
    ratio = 1 + run["pressure"][:, 0] / ATMOSPHERE
    stored = run["air_mass"][:, 0] @ (np.log(ratio) + 1 / ratio - 1) * ENERGY
    rises = table["take_off_speed"] ** 2 / (2 * runs.plant.gravity)
    heights = table["apex"] - standing
    work = float(table["muscle_work"][0])
    return Jump(schedule, run, runs.substeps, heights, rises, work, inflow + float(stored))


def _standing_heights(plant: LegPlant, drawn: LegPlant) -> tuple[Floats, float]:
    """Heights [m] of the centre of mass of each draw in the posture in which it is highest, and that of the hip."""

    def heights(of: LegPlant, angles: Sequence[ArrayLike]) -> tuple[Array, Array]:
        """Heights of the centre of mass and of the hip above the foot."""
        posture = posture_of(of.leg, angles)
        still = at_rest(posture)
        depth = contact(of.leg, frames(of.leg, posture, still)).position.z
        return motion(of.leg, posture, still, of.gravity).height - depth, -depth

    ranges = [np.linspace(joint.lower, joint.upper, _POSTURES) for joint in plant.leg.joints]
    grid = [axis.ravel() for axis in np.meshgrid(*ranges)]
    best = int(np.argmax(heights(plant, grid)[0]))
    angles = [axis[best] for axis in grid]
    found = np.asarray(heights(drawn, angles)[0])
    return np.broadcast_to(found, (np.size(drawn.leg.trunk.mass),)), float(heights(plant, angles)[1])
