"""Jumps from a squat: the best constant and the best timed pressures for the highest jump, and a planned jump."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.errors import McKibbenError, Problem, ScenarioError, SimulationError
from mckibben.leg.control import PressureSchedule
from mckibben.leg.dynamics import acceleration, at_rest, contact, frames, motion, posture_of
from mckibben.leg.foot_pressures import foot_matrix
from mckibben.leg.jump_control import PlannedControl
from mckibben.leg.jump_limit import JumpLimit, limit_jump
from mckibben.leg.jump_plan import JumpPlan, plan_jump
from mckibben.leg.jump_search import LANES, Evaluations, JumpRuns, ScheduleVariables, highest
from mckibben.leg.landing import EDGES
from mckibben.leg.metrics import EnergyBalance
from mckibben.leg.plant import LegPlant, LegStart
from mckibben.leg.scenario import LegScenario, PlanSettings
from mckibben.leg.simulate import LegResult, simulate_leg, simulate_legs
from mckibben.leg.study_journal import StudyJournal, StudyKind, check_continued
from mckibben.leg.uncertainty import drawn_plant
from mckibben.muscle.air import ATMOSPHERE, ENERGY
from mckibben.notebook import Progress
from mckibben.numerics.compiled import jit
from mckibben.numerics.spatial import Z
from mckibben.plant.base import MOST_SUBSTEPS
from mckibben.simulation.software import engine_of_job
from mckibben.units import bar, deg, mm, ms

Floats = NDArray[np.float64]

_POSTURES = 41  # of each joint, tried for the highest
_LANDING = 0.25  # s of a jump after the duration of its search, or after its plan
_KIND = StudyKind("mckibben jumps", 1, "evaluations of the search")


@dataclass(frozen=True)
class Jump:
    """A jump with its controller, time traces, and results over the draws, of which the first is nominal."""

    controller: PressureSchedule | PlannedControl
    run: LegResult  # of the nominal jump, with its `resolution`
    balance: EnergyBalance  # of the nominal run, landing included
    substeps: int  # of the jumps of the draws
    heights: Floats  # of the centre of mass at the apex above that of the standing leg of the same draw [m]
    rises: Floats  # of the centre of mass after take-off [m]
    push_force: float  # largest force of the ground before the apex [weight of the leg]; nominal
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
            "landing_force_weights": float(self.landing_force[0]),
            "landing_force_interval": interval(self.landing_force),
            "muscle_work_J": self.work,
            "stop_energy_J": self.stop_energy,
            "air_energy_J": self.air_energy,
            "efficiency": self.work / self.air_energy if self.air_energy > 0 else None,
            "energies_J": self.balance._asdict() | {"residual": self.balance.residual},
            "integration": {
                "substeps": self.substeps,
                "error_estimate_rad": resolution.error if math.isfinite(resolution.error) else None,
                "runs_chaotic": int(resolution.chaotic),
            },
        }
        if isinstance(self.controller, PressureSchedule):
            found["levels_bar"] = [[float(one) / bar for one in levels] for levels in self.controller.levels]
            found["switches_ms"] = [[float(one) / ms for one in times] for times in self.controller.switches]
        return found


def interval(values: Floats) -> list[float]:
    """Return 5 and 95 % of the draws, without the nominal one."""
    return np.nanpercentile(values[1:], EDGES).tolist()


@dataclass(frozen=True)
class JumpStudy:
    """The best jump with constant pressures from the start on, the best with timed ones, and the planned one.

    Attributes
    ----------
    scenario
        File of the leg.
    constant, timed, planned
        The jumps; the last is None without a plan.
    plan
        Plan of the last one.
    limit
        Greatest height of such a plan and what limits it, if it was asked for.
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
    planned: Jump | None = None
    plan: JumpPlan | None = None
    limit: JumpLimit | None = None

    @property
    def jumps(self) -> dict[str, Jump]:
        """The jumps by name."""
        found = {"constant": self.constant, "timed": self.timed}
        return found if self.planned is None else {**found, "planned": self.planned}

    def gain(self) -> tuple[float, float, float]:
        """Height [m] that timing adds: nominal, and 5 to 95 % over the same draws."""
        added = self.timed.heights - self.constant.heights
        low, high = interval(added)
        return float(added[0]), low, high

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
            **{name: jump.record() for name, jump in self.jumps.items()},
            "gain_mm": gain[0] / mm,
            "gain_interval_mm": [gain[1] / mm, gain[2] / mm],
            "plan": None if self.plan is None else self.plan.record(self.standing),
            "plan_limit": None if self.limit is None else self.limit.record(),
        }

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headers and rows of a table, one for each jump."""
        headers = (
            "pressures",
            "height [mm]",
            "rise after take-off [mm]",
            "force at push-off, landing [weights]",
            "work of muscles",
            "of the air's energy",
            "absorbed by stops",
        )
        rows: list[tuple[str, ...]] = []
        for name, jump in self.jumps.items():
            one = jump.record()
            share = "-" if one["efficiency"] is None else f"{one['efficiency'] * 100:.0f} %"
            force = "-"  # in a run that ends before it lands
            if one["landing_force_weights"] > 0:
                force = _with_interval(one["landing_force_weights"], one["landing_force_interval"])
            rows.append(
                (
                    name,
                    _with_interval(one["height_mm"], one["height_interval_mm"]),
                    _with_interval(one["rise_mm"], one["rise_interval_mm"]),
                    f"{one['push_off_force_weights']:.1f}, {force}",
                    f"{one['muscle_work_J']:.2f} J",
                    share,
                    f"{one['stop_energy_J']:.2f} J",
                )
            )
        return headers, rows

    def describe(self) -> str:
        """Gain in height by timing, and what the plan foresees, as text."""
        gain, low, high = (one / mm for one in self.gain())
        text = f"timing adds {gain:.1f} mm ({low:.1f} to {high:.1f} mm)"
        if self.plan is not None:
            text += f"; planned: {self.plan.describe(self.standing)}"
        return text if self.limit is None else f"{text}\n{self.limit.describe()}"

    def __repr__(self) -> str:
        heights = ", ".join(f"{name} {jump.heights[0] / mm:.0f} mm" for name, jump in self.jumps.items())
        return f"<JumpStudy of {self.scenario.name!r}: {heights}>"


def _with_interval(value: float, bounds: list[float]) -> str:
    return f"{value:.1f} ({bounds[0]:.1f} to {bounds[1]:.1f})"


def standing_torques(plant: LegPlant, angles: tuple[float, ...]) -> Floats:
    """Return the torques [N*m] of the joints that hold a leg at rest on its foot; those of locked joints are 0.

    The ground carries the weight, without friction.
    """
    return np.asarray(_standing(plant, tuple(angles)))


@jit
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


def study_jump(
    scenario: LegScenario,
    *,
    source: str = "",
    seed: int = 0,
    journal: Path | None = None,
    resume: bool = False,
    limit: bool = False,
    progress: Progress | None = None,
) -> JumpStudy:
    """Find the highest jumps of a scenario, with constant and with timed pressures, and simulate its planned one.

    Both are searched by differential evolution over many runs at once, and polished by L-BFGS-B with gradients of
    forward differentiation. The constant jump changes all commands at the start; the timed one may change each twice.

    Parameters
    ----------
    scenario, source, seed
        File of the leg, its name for errors, and the seed of the search.
    journal, resume
        File that keeps the evaluations of the search, and whether to continue one; its plan may be another.
    limit
        Whether to find the greatest height of the plan as well, which takes as long as ten plans.

    Raises
    ------
    ScenarioError
        If there is no section `jump`, the muscles cannot hold the squat, or the plan is not possible; with the
        attainable range.
    FileError
        As for `study_landing`.
    """
    jump, source = scenario.jump, source or scenario.name
    if jump is None:
        raise ScenarioError(source, [Problem("lacks the section `jump`", remedy="see examples/leg/lei-leg.yaml")])
    check_continued(journal, resume)
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
    plan = None if jump.plan is None else _plan(scenario, jump.plan, plan_jump, source)
    if limit and plan is None:
        raise ScenarioError(source, [Problem("lacks the section `plan`, whose limit is wanted", field="jump")])
    drawn = drawn_plant(scenario)
    standing, length = _standing_heights(plant, drawn)
    found, duration, substeps = [], scenario.whole_steps(jump.duration), scenario.substeps
    best: Floats | None = None
    variables = [ScheduleVariables(pressures, jump.low, jump.high, jump.latest, timed) for timed in (False, True)]
    if substeps is None:
        schedule = variables[0].schedule([0.5] * variables[0].size)
        nominal = simulate_leg(plant, schedule, start, duration=duration, **scenario.steps)
        assert nominal.resolution is not None
        substeps = nominal.resolution.batch_substeps(plant.needed_substeps(angles, None, scenario.step))
    runs = [JumpRuns(plant, start, each, duration, scenario.step, substeps) for each in variables]
    engine = "auto"
    if journal is not None:
        trial = functools.partial(runs[0].simulate, np.full((variables[0].size, LANES), 0.5))
        engine = engine_of_job(lambda: {trial().engine}, _KIND.software(journal) if resume else None)
    searched = scenario.model_copy(update={"jump": jump.model_copy(update={"plan": None})})
    with StudyJournal(journal, _KIND, searched, engine, resume) as kept:
        evaluations = Evaluations(kept)
        for k, (name, each) in enumerate(zip(("constant pressures", "timed pressures"), runs, strict=True)):
            # The constant jump is one of the timed ones.
            guess = None if best is None else np.concatenate([best, best, np.zeros(2 * len(pressures))])
            report = functools.partial(_report, progress, name, k)
            best = highest(each._replace(engine=engine), guess, seed, evaluations, report)
            schedule = each.variables.schedule([float(one) for one in best])
            found.append(_jump(scenario, each, schedule, drawn, standing))
    planned = None
    if plan is not None:
        own = runs[0]._replace(start=plan.start(), duration=max(duration, float(plan.times[-1])))
        planned = _jump(scenario, own, plan.controller(), drawn, standing)
    highest_plan = _plan(scenario, jump.plan, limit_jump, source) if limit and jump.plan is not None else None
    return JumpStudy(scenario, found[0], found[1], float(standing[0]), length, planned, plan, highest_plan)


def _report(progress: Progress | None, name: str, search: int, part: float) -> None:
    if progress:
        progress(name, (search + part) / 2)


def _plan(scenario: LegScenario, plan: PlanSettings, compute: Callable[..., Any], source: str) -> Any:
    """Result of `plan_jump` or `limit_jump` for the planned jump of a scenario."""
    assert scenario.jump is not None
    plant = scenario.plant()
    wanted = None
    if plan.stiffness is not None:
        each = (plan.stiffness.squat, plan.stiffness.take_off, plan.stiffness.landing)
        squat_matrix, take_off_matrix, landing_matrix = (
            foot_matrix(one.principal, one.direction, one.sideways) for one in each
        )
        wanted = squat_matrix, take_off_matrix, landing_matrix
    squat, take_off = (plant.leg.posture_angles(one) for one in (scenario.jump.squat, plan.take_off))
    heights = {"height": plan.height, "landing_depth": plan.landing_depth}
    try:
        return compute(plant, squat, take_off, **heights, stiffness=wanted, period=scenario.step)
    except McKibbenError as error:
        field = "jump.plan" if error.field not in PlanSettings.model_fields else f"jump.plan.{error.field}"
        raise ScenarioError(source, [Problem.of(error, field=field)]) from error


def _jump(
    scenario: LegScenario,
    runs: JumpRuns,
    controller: PressureSchedule | PlannedControl,
    drawn: LegPlant,
    standing: Floats,
) -> Jump:
    """A jump with its traces, and its results for plants that differ."""
    plant, start = runs.plant, runs.start
    duration = scenario.whole_steps(runs.duration + _LANDING)
    run = simulate_leg(plant, controller, start, duration=duration, **scenario.steps)
    steps = {"control_period": runs.step, "substeps": runs.substeps}
    table = simulate_legs(drawn, controller, start, duration=duration, **steps)
    valve: Any = plant.valve
    supply = float(np.asarray(valve.supply if valve.holds_air else runs.variables.high)) + ATMOSPHERE
    inflow = float(table["air_mass"][0]) * ENERGY * math.log(supply / ATMOSPHERE)
    ratio = 1 + run["pressure"][:, 0] / ATMOSPHERE
    stored = run["air_mass"][:, 0] @ (np.log(ratio) + 1 / ratio - 1) * ENERGY
    before = run["ground_up"][: int(run["mass_height"].argmax())]
    weight = np.asarray(drawn.leg.total_mass) * plant.gravity
    return Jump(
        controller,
        run,
        EnergyBalance.of(plant, run),
        runs.substeps,
        heights=table["apex"] - standing,
        rises=table["take_off_speed"] ** 2 / (2 * plant.gravity),
        push_force=float(before.max(initial=0.0)) / float(np.ravel(weight)[0]),
        landing_force=table["peak_landing_force"] / weight,
        work=float(table["muscle_work"][0]),
        stop_energy=float(table["stop_energy"][0]),
        air_energy=inflow + float(stored),
    )


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
