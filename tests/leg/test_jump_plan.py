"""Plan of a jump with a soft landing: laws of mechanics along it, its commands, and its controller."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben import catalog
from mckibben.errors import FileError, RangeError, ScenarioError, UnreachableError
from mckibben.leg import (
    EnergyBalance,
    Ground,
    JumpPlan,
    JumpStudy,
    LegMeasurement,
    LegPlant,
    LegScenario,
    PlannedControl,
    foot_matrix,
    jump_search,
    limit_jump,
    plan_jump,
    read_leg,
    simulate_leg,
    study_jump,
)
from mckibben.leg.dynamics import at_rest as resting
from mckibben.leg.dynamics import motion, posture_of
from mckibben.leg.stiffness_map import map_at
from mckibben.units import bar, deg, mm

SQUAT, TAKE_OFF = (0.0, -20 * deg), (0.0, 0.0)
HEIGHTS: Any = {"height": 30 * mm, "landing_depth": 45 * mm}


@pytest.fixture(scope="module")
def plan(plant: LegPlant) -> JumpPlan:
    return plan_jump(plant, SQUAT, TAKE_OFF, **HEIGHTS)


@pytest.mark.slow
def test_flight_is_ballistic_and_forces_are_newtons(plant: LegPlant, plan: JumpPlan) -> None:
    mass, gravity = float(plant.leg.total_mass), float(plant.gravity)
    flying = (plan.times > plan.take_off) & (plan.times < plan.touchdown)
    speed = np.sqrt(2 * gravity * HEIGHTS["height"])
    assert plan.touchdown - plan.take_off == pytest.approx(2 * speed / gravity, rel=1e-12)
    top = plan.mass_height[flying].max()
    at = plan.times[flying] - plan.take_off
    fall = plan.mass_height[flying] - speed * at + gravity / 2 * at**2
    np.testing.assert_allclose(fall, fall[0], atol=1e-12)
    assert top == pytest.approx(fall[0] + HEIGHTS["height"], abs=0.1 * mm)  # of a grid of 4 ms
    np.testing.assert_array_equal(plan.ground_force[flying], 0.0)
    # the impulse of the ground between rest and rest is that of the weight
    impulse = np.trapezoid(plan.ground_force, plan.times)
    assert impulse == pytest.approx(mass * gravity * plan.times[-1], rel=2e-3)
    assert plan.ground_force[[0, -1]] == pytest.approx([mass * gravity] * 2, rel=1e-6)


@pytest.mark.slow
def test_muscles_do_the_work_of_the_plan(plant: LegPlant, plan: JumpPlan) -> None:
    """Power of the torques over the push-off is the energy at take-off and what damping takes."""
    pushed = plan.times <= plan.take_off
    rates = np.gradient(plan.angles, plan.times, axis=1, edge_order=2)[:, pushed]
    damping = np.array([float(joint.damping) for joint in plant.leg.joints])
    power = (plan.torques[:, pushed] * rates).sum(0) - damping @ rates**2
    last = int(pushed.nonzero()[0][-1])
    work = np.trapezoid(power, plan.times[pushed])
    leg, gravity = plant.leg, plant.gravity
    posture = posture_of(leg, plan.angles[:, last].tolist())
    speed = np.gradient(plan.mass_height, plan.times)[last]
    still = resting(posture)._replace(angles=tuple(jnp.asarray(one) for one in rates[:, -1]))
    inner = motion(leg, posture, still, gravity)  # with the hip at rest
    hip = speed - float(inner.upward_speed)
    mass = float(leg.total_mass)
    kinetic = float(inner.kinetic) + mass * hip * float(inner.upward_speed) + mass * hip**2 / 2
    lifted = mass * gravity * (plan.mass_height[last] - plan.mass_height[0])
    assert work == pytest.approx(kinetic + lifted, rel=0.02)


@pytest.mark.slow
def test_pressures_give_the_torques(plant: LegPlant, plan: JumpPlan) -> None:
    wanted = [foot_matrix(*one) for one in (((25.0, 770.0), -0.24), ((21.0, 1830.0), -0.04), ((25.0, 820.0), -0.22))]
    stiff = plan_jump(plant, SQUAT, TAKE_OFF, **HEIGHTS, stiffness=tuple(wanted))  # type: ignore[arg-type]
    np.testing.assert_allclose(stiff.torques, plan.torques, atol=1e-12)
    for one in (plan, stiff):
        for k in range(0, one.times.size, 9):
            found = map_at(plant.leg, one.angles[:, k].tolist()).torque_at(one.pressures[:, k])
            np.testing.assert_allclose(found, one.torques[:, k], atol=1e-6)
    assert plan.foot == () and len(stiff.foot) == stiff.times.size
    errors, least = (np.array([getattr(one, name) for one in stiff.foot]) for name in ("error", "least"))
    assert (errors < 0.2).all()
    np.testing.assert_allclose(least, errors, rtol=1e-3, atol=1e-5)  # no pressures do better
    assert "stiffness" in stiff.describe() and "stiffness" not in plan.describe()


@pytest.mark.slow
def test_leg_in_space_that_does_not_swing_is_the_planar_one(scenario: LegScenario, plan: JumpPlan) -> None:
    leg = read_leg("lei-leg")
    space = plan_jump(LegPlant(leg, scenario.valve, Ground(friction=0.0)), (0.0, *SQUAT), (0.0, *TAKE_OFF), **HEIGHTS)
    np.testing.assert_allclose(space.torques[1:], plan.torques, atol=1e-9)
    np.testing.assert_allclose(space.torques[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(space.ground_force, plan.ground_force, atol=1e-8)


@pytest.mark.slow
def test_ideal_valves_and_firm_ground_follow_the_plan(plant: LegPlant) -> None:
    firm = LegPlant(plant.leg, mk.IdealValve(), Ground(stiffness=200e3, damping=0.5, friction=0.0))
    plan = plan_jump(firm, SQUAT, TAKE_OFF, **HEIGHTS)
    np.testing.assert_allclose(plan.attained, plan.pressures, atol=0.02 * bar)
    run = simulate_leg(firm, plan.controller(), plan.start(), duration=0.6, control_period=0.25e-3)
    before = run["time"] < plan.touchdown
    followed = np.array([np.interp(run["plan_time"], plan.times, one) for one in plan.angles])
    assert np.abs(run["angle"] - followed)[:, before].max() < 1.5 * deg
    assert run.metrics["apex"] == pytest.approx(plan.mass_height.max(), abs=1.5 * mm)
    balance = EnergyBalance.of(firm, run)
    assert abs(balance.residual) < 3e-3  # J
    assert balance.resisting < 0 and balance.ground < 0


@pytest.mark.slow
@pytest.mark.parametrize("valve", [None, mk.FirstOrderValve(0.01, supply=7 * bar)])
def test_jump_with_valves(plant: LegPlant, valve: mk.FirstOrderValve | None) -> None:
    used = plant if valve is None else dataclasses.replace(plant, valve=valve)
    plan = plan_jump(used, SQUAT, TAKE_OFF, **HEIGHTS)
    assert plan.valve_error < 0.2 * bar
    run = simulate_leg(used, plan.controller(), plan.start(), duration=0.6, control_period=0.25e-3)
    metrics, weight = run.metrics, float(used.leg.total_mass) * used.gravity
    assert metrics["apex"] == pytest.approx(plan.mass_height.max(), abs=5 * mm)
    assert metrics["peak_landing_force"] < 4 * weight  # a leg that drops as far bounces with more than 7
    balance = EnergyBalance.of(used, run)
    assert abs(balance.residual) < 3e-3  # J
    assert metrics["stop_energy"] == pytest.approx(0.0, abs=1e-9)


def test_touchdown_sets_the_time_of_the_plan() -> None:
    control = PlannedControl(np.array([[0.0], [1e5], [2e5], [3e5]]), 0.1, take_off=0.1, touchdown=0.2)

    def after(forces: list[float]) -> list[float]:
        state, times = control.init(_measured(0.0)), []
        for number, force in enumerate(forces):
            state, _ = control.step(state, 0.01 * number, _measured(force), 0.01)
            times.append(float(state.time))
        return times

    late = after([20.0] * 10 + [0.0] * 15 + [20.0] * 3)
    assert late[20:25] == pytest.approx([0.21] * 5)  # waits for the ground
    assert late[-3:] == pytest.approx([0.21, 0.22, 0.23])
    early = after([20.0] * 10 + [0.0] * 5 + [20.0] * 3)
    assert early[-4:] == pytest.approx([0.15, 0.21, 0.22, 0.23])
    bounced = after([20.0] * 10 + [0.0] * 5 + [20.0] + [0.0] * 3)
    assert bounced[-3:] == pytest.approx([0.22, 0.23, 0.24])
    state = control.init(_measured(0.0))._replace(time=jnp.asarray(0.145))
    assert float(control.step(state, 0.0, _measured(0.0), 0.01)[1][0]) == pytest.approx(1.5e5)
    with pytest.raises(RangeError):
        PlannedControl(np.zeros((1, 4)), 0.1, take_off=0.1, touchdown=0.2)


def _measured(force: float) -> LegMeasurement:
    return LegMeasurement((), (), jnp.asarray(force))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("squat", "take_off", "changes", "kind", "field"),
    [
        (TAKE_OFF, SQUAT, {}, RangeError, "take_off"),
        (SQUAT, (0.0, 10 * deg), {"height": 60 * mm}, RangeError, "height"),
        (SQUAT, TAKE_OFF, {"landing_depth": 90 * mm}, RangeError, "landing_depth"),
        (SQUAT, TAKE_OFF, {"height": 50 * mm}, UnreachableError, None),
        (SQUAT, TAKE_OFF, {"height": 0.0}, RangeError, "height"),
    ],
)
def test_plans_that_are_not_possible(
    plant: LegPlant,
    squat: tuple[float, float],
    take_off: tuple[float, float],
    changes: dict[str, float],
    kind: type[Exception],
    field: str | None,
) -> None:
    with pytest.raises(kind) as caught:
        plan_jump(plant, squat, take_off, **{**HEIGHTS, **changes})
    assert caught.value.remedy  # type: ignore[attr-defined]
    assert field is None or caught.value.field == field  # type: ignore[attr-defined]


@pytest.mark.parametrize(("squat", "take_off"), [((8 * deg, -20 * deg), TAKE_OFF), (SQUAT, (0.0, np.nan))])
def test_angle_beyond_a_stop(plant: LegPlant, squat: tuple[float, float], take_off: tuple[float, float]) -> None:
    hip, knee = plant.leg.joints
    leg = dataclasses.replace(plant.leg, joints=(dataclasses.replace(hip, lower=-5 * deg, upper=5 * deg), knee))
    with pytest.raises(RangeError) as caught:
        plan_jump(dataclasses.replace(plant, leg=leg), squat, take_off, **HEIGHTS)
    assert caught.value.field == "angle"
    assert caught.value.value == pytest.approx(8 * deg if squat != SQUAT else np.nan, nan_ok=True)


@pytest.mark.slow
def test_plan_within_the_supply(plant: LegPlant) -> None:
    weak = dataclasses.replace(plant, valve=catalog.valve("festo-mpye-5-m5", supply=3 * bar))
    with pytest.raises(UnreachableError) as caught:
        plan_jump(weak, SQUAT, TAKE_OFF, **HEIGHTS)
    assert caught.value.upper == 3 * bar < caught.value.value  # type: ignore[operator]
    assert any(name in str(caught.value) for name in plant.leg.muscle_names)
    assert caught.value.remedy


def test_trunk_that_is_not_on_a_slider(plant: LegPlant) -> None:
    trunk = dataclasses.replace(plant.leg.trunk, freedom="planar")
    with pytest.raises(RangeError) as caught:
        plan_jump(
            dataclasses.replace(plant, leg=dataclasses.replace(plant.leg, trunk=trunk)), SQUAT, TAKE_OFF, **HEIGHTS
        )
    assert caught.value.field == "freedom"


@pytest.mark.parametrize(
    ("plan", "line", "word"),
    [
        ("{take_off: {kne: 0 deg}, height: 30 mm, landing_depth: 40 mm}", 3, "kne"),
        ("{take_off: {knee: 70 deg}, height: 30 mm, landing_depth: 40 mm}", 3, "stops"),
        ("{height: 0 mm, landing_depth: 40 mm}", 3, "height"),
        ("{height: 30 mm}", 3, "landing_depth"),
        (
            "{height: 30 mm, landing_depth: 40 mm, stiffness: {squat: {principal: [1 N/m, 2 N/m]}, "
            "take_off: {principal: [1 N/m, 2 N/m], sideways: 3 N/m}, landing: {principal: [1 N/m, 2 N/m]}}}",
            3,
            "sideways",
        ),
    ],
)
def test_bad_plans_name_line_and_remedy(plan: str, line: int, word: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        LegScenario.parse(f"name: x\nleg: lei-leg-planar\njump: {{plan: {plan}}}\n")
    problem = caught.value.problems[0]
    assert word in str(problem) and problem.line == line and problem.remedy


@pytest.fixture(scope="module")
def short_searches() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name in ("_GENERATIONS", "_POPULATION", "_POLISHING"):
            patch.setattr(jump_search, name, 2)
        yield


@pytest.fixture(scope="module")
def whole(scenario: LegScenario, short_searches: None) -> JumpStudy:
    return study_jump(scenario)


@pytest.mark.slow
def test_timed_jump_is_no_lower_than_the_constant_one(scenario: LegScenario, whole: JumpStudy) -> None:
    assert whole.timed.heights[0] >= whole.constant.heights[0] - 1e-9 > 0
    assert 0 < whole.timed.work < whole.timed.air_energy
    assert (whole.timed.rises[0] > 0) and whole.timed.work < 20
    assert whole.constant.run.engine == "native"
    record = whole.records()
    for jump in (record["constant"], record["timed"]):
        assert jump["integration"]["error_estimate_rad"] < scenario.accuracy
        assert jump["integration"]["substeps"] >= 1
    assert record["gain_mm"] == pytest.approx(record["timed"]["height_mm"] - record["constant"]["height_mm"])
    assert len(whole.rows()[1]) == 3 and "mm" in whole.describe()


@pytest.mark.slow
def test_study_with_a_plan_goes_on(
    scenario: LegScenario, whole: JumpStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = tmp_path / "jump.journal"
    assert whole.planned is not None and whole.plan is not None
    assert 1 < whole.planned.landing_force[0] < 4
    record = whole.records()
    low, high = record["planned"]["landing_force_interval"]
    assert low < high and record["planned"]["stop_energy_J"] >= 0
    for jump in whole.jumps.values():
        assert abs(jump.balance.residual) < 0.01  # J
    computed, run = [], jump_search.JumpRuns.heights

    def counted(self: jump_search.JumpRuns, variables: np.ndarray) -> np.ndarray:
        computed.append(1)
        if len(computed) == 3:
            raise KeyboardInterrupt
        return run(self, variables)

    monkeypatch.setattr(jump_search.JumpRuns, "heights", counted)
    with pytest.raises(KeyboardInterrupt):
        study_jump(scenario, journal=journal)
    with pytest.raises(FileError):  # it exists
        study_jump(scenario, journal=journal)
    assert scenario.jump is not None and scenario.jump.plan is not None
    plan = scenario.jump.plan.model_copy(update={"height": 25 * mm})  # does not belong to the search
    other = scenario.model_copy(update={"jump": scenario.jump.model_copy(update={"plan": plan})})
    again = study_jump(other, journal=journal, resume=True)
    np.testing.assert_array_equal(again.timed.heights, whole.timed.heights)
    assert again.planned is not None and again.planned.heights[0] < whole.planned.heights[0]
    before = len(computed)
    assert study_jump(scenario, journal=journal, resume=True).records() == record
    assert len(computed) == before
    with pytest.raises(FileError):
        study_jump(scenario.model_copy(update={"step": 0.2e-3}), journal=journal, resume=True)


@pytest.mark.slow
def test_limit_of_the_height_is_the_knee_and_not_the_work(plant: LegPlant, plan: JumpPlan) -> None:
    """A plan at the limit is possible and one above it is not; the work is that of the muscles' torques."""
    found = limit_jump(plant, SQUAT, TAKE_OFF, **HEIGHTS)
    assert HEIGHTS["height"] < found.height < found.work_height
    assert isinstance(found.binding, UnreachableError)
    assert found.binding.message.startswith("knee")
    with pytest.raises(UnreachableError):
        plan_jump(plant, SQUAT, TAKE_OFF, height=found.height + 0.5 * mm, landing_depth=HEIGHTS["landing_depth"])
    knee = np.linspace(-20 * deg, 0.0, 65)
    highest = float(plant.leg.muscles[3].domain.pressure_max)
    torques = np.asarray(plant.leg.torques((0.0, knee), (0.0, 0.0, 0.0, highest))[1])
    assert found.work == pytest.approx(np.trapezoid(torques, knee), rel=1e-9)
    stroke = plan.mass_height.max() - HEIGHTS["height"] - plan.mass_height[0]
    assert found.stroke == pytest.approx(stroke, abs=0.1 * mm)  # of a grid of 4 ms
    weight = float(plant.leg.total_mass * plant.gravity)
    assert found.work == pytest.approx(weight * (found.stroke + found.work_height), rel=1e-9)


@pytest.mark.slow
def test_planned_jump_in_space_on_sloped_ground() -> None:
    """With real valves the leg swings upright, jumps and lands as planned."""
    scenario = LegScenario.read("examples/leg/lei-leg-jump-in-space.yaml")
    jump, plant = scenario.jump, scenario.plant()
    assert jump is not None and jump.plan is not None and not plant.leg.is_planar
    squat, take_off = (plant.leg.posture_angles(one) for one in (jump.squat, jump.plan.take_off))
    heights: Any = {"height": jump.plan.height, "landing_depth": jump.plan.landing_depth}
    plan = plan_jump(plant, squat, take_off, **heights)
    run = simulate_leg(plant, plan.controller(), plan.start(), duration=0.6, control_period=0.25e-3, substeps=2)
    assert float(run.metrics["apex"]) == pytest.approx(plan.mass_height.max(), abs=2 * mm)
    weight = float(plant.leg.total_mass * plant.gravity)
    assert plan.landing_force / weight < float(run.metrics["peak_landing_force"]) / weight < 3.5
    assert run["angle"][0][0] == pytest.approx(5 * deg)
    assert np.abs(run["angle"][0]).max() < 6 * deg
