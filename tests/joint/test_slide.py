"""A slide: one muscle against a spring or a weight, or two, in mm, N and N/mm."""

import dataclasses
import re

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mckibben as mk
from mckibben.calibration import JointPrior, Sweeps, calibrate_scenario
from mckibben.calibration.experiment import simulated
from mckibben.calibration.service import Service
from mckibben.control import OpenLoopControl
from mckibben.errors import RangeError, ScenarioError
from mckibben.export.controller import controller_functions
from mckibben.export.gym import JointEnv
from mckibben.joint import Slide, SlidingMass
from mckibben.muscle import no_muscle
from mckibben.rig import prepare
from mckibben.scenario.parameters import find_parameter
from mckibben.units import GRAVITY, SLIDE, N, bar, deg, kg, mm, ms

SPECIMEN = mk.Specimen("linear", 200 * mm, domain=mk.Domain(-0.03, 0.3, 0.0, 6 * bar))
RATES = (2e3, 2e3, 2e3)  # N per contraction
LINEAR = mk.Muscle(SPECIMEN, mk.muscle.PiecewiseLaw((1 * bar, 3 * bar, 6 * bar), (200.0, 600.0, 1200.0), RATES))
REAL = mk.Muscle(mk.catalog.specimen("MAS-10-180N-AA-MC-O"), mk.catalog.law("lei-mas-10-180n"))
SPRING = mk.return_spring(4 * N / mm, 120 * mm)
MASS, DAMPING = 2 * kg, 60.0


def released(joint, load, pressure, start):
    """Positions [m] after a release at rest from a position, at a constant pressure of muscle 2 [Pa]."""
    plant = mk.JointPlant(joint, load, mk.IdealValve())
    control, reference = OpenLoopControl(0.0, pressure, joint), mk.Reference(0.0)
    options = {"duration": 0.5, "control_period": 1 * ms, "accuracy": 1e-9}
    return mk.simulate(plant, control, reference, initial=plant.init_state(start, (0.0, pressure)), **options)


@pytest.mark.slow
@pytest.mark.parametrize("incline", [0.0, 90 * deg])
def test_a_mass_between_spring_and_linear_muscle_oscillates_in_closed_form(incline):
    joint = mk.AntagonisticJoint(Slide(150 * mm, 190 * mm), SPRING, LINEAR)
    run = released(joint, SlidingMass(MASS, DAMPING, incline), 3 * bar, 0.0)
    stiffness = 4 * N / mm + RATES[0] / (200 * mm)
    force = 600.0 - RATES[0] * 10 / 200 - 4 * 30 - MASS * GRAVITY * np.sin(incline)  # of all, at position 0
    decay, middle = DAMPING / (2 * MASS), force / stiffness
    rate = np.sqrt(stiffness / MASS - decay**2)
    swing = np.cos(rate * run.times) + decay / rate * np.sin(rate * run.times)
    np.testing.assert_allclose(run["angle"], middle * (1 - np.exp(-decay * run.times) * swing), atol=1e-8)
    np.testing.assert_allclose(run["stiffness"], stiffness, rtol=1e-9)


@pytest.mark.slow
def test_a_muscle_that_lifts_a_weight_moves_as_by_scipy():
    joint = mk.AntagonisticJoint(Slide(rest_length2=165 * mm), no_muscle(), REAL)
    run = released(joint, SlidingMass(5 * kg, 200.0, 90 * deg), 4 * bar, 0.0)

    tension_at = jax.jit(lambda position: REAL.tension((15 * mm + position) / (180 * mm), 4 * bar))

    def rates(_, state):
        tension = float(tension_at(state[0]))
        return state[1], (tension - 200.0 * state[1]) / (5 * kg) - GRAVITY

    known = solve_ivp(rates, (0.0, 0.5), (0.0, 0.0), t_eval=run.times, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(run["angle"], known.y[0], atol=1e-8)
    assert not run["slack"].any()
    assert np.ptp(run["angle"]) > 1 * mm


AXIS = """
name: axis
joint:
  geometry: {class: slide, rest_length1: 150 mm, rest_length2: 165 mm}
  muscle1: {class: return_spring, rate: 4 N/mm, free_length: 120 mm}
  muscle2: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
load: {class: sliding_mass, mass: 2 kg, damping: 100 N*s/m}
valve: {time_constant: 20 ms}
sensors: {encoder: 0.01 mm, pressure_noise: 0 kPa}
friction: {force: 2 N, presliding: 0.1 mm}
controller: {position: {kp: 0.06 bar/mm, ki: 2.5 bar/(mm*s), kd: 0.002 bar*s/mm}}
reference: {position: {class: sine, amplitude: 4 mm, frequency: 0.5 Hz, phase: 90 deg}}
start: {position: 4 mm}
duration: 1 s
control_period: 1 ms
"""


def test_a_file_has_the_units_of_a_slide():
    axis = mk.Scenario.parse(AXIS)
    read = axis.start.angle, axis.signals.angle.amplitude, axis.signals.angle.phase, axis.controller.position.kp
    assert read == pytest.approx((4 * mm, 4 * mm, 90 * deg, 0.06 * bar / mm))
    assert (axis.sensors.encoder, axis.friction.torque, axis.friction.presliding) == (1e-5, 2.0, 1e-4)
    assert mk.Scenario.parse(axis.dumps()) == axis
    assert axis.replace(start={"angle": "3 mm"}).start.angle == 3 * mm
    for text in (
        "amplitude: 4 mm",
        "kp: 0.06 bar/mm",
        "force: 2 N",
        "position: 4 mm",
        "position: {class: sine",
        "encoder: 0.01 mm",
    ):
        assert text in axis.dumps()


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("amplitude: 4 mm", "amplitude: 4 deg", "reference.position.amplitude"),
        ("{class: sliding_mass, mass: 2 kg, damping: 100 N*s/m}", "{class: pendulum, mass: 2 kg, length: 1 m}", "load"),
        ("reference: {", "reference: {stiffness: 10 N/mm, ", "reference.stiffness"),
        ("start: {", "start: {stiffness: 10 N/mm, ", "start.stiffness"),
        ("controller: {", "controller: {stiffness: {kp: 0 bar/(N/mm), ki: 0 bar/(N*s/mm), kd: 0 bar*s/(N/mm)}, ", None),
    ],
)
def test_what_is_not_of_a_slide_is_refused(old, new, field):
    assert AXIS.count(old) == 1
    with pytest.raises(ScenarioError) as error:
        mk.Scenario.parse(AXIS.replace(old, new))
    (problem,) = error.value.problems
    assert problem.field == field or field is None
    assert problem.remedy


def test_a_load_that_turns_is_refused_on_a_slide():
    joint = mk.AntagonisticJoint(Slide(150 * mm, 165 * mm), REAL, REAL)
    with pytest.raises(RangeError) as error:
        mk.JointPlant(joint, mk.PendulumLoad(1.0, 0.3), mk.IdealValve())
    assert error.value.field == "load"


def test_only_a_muscle_that_is_not_there_needs_no_length():
    with pytest.raises(RangeError) as error:
        mk.AntagonisticJoint(Slide(rest_length2=165 * mm), SPRING, REAL)
    assert error.value.field == "geometry.rest_length1"


def test_what_is_in_units_of_a_hinge_alone_refuses_a_slide():
    axis = mk.Scenario.parse(AXIS)
    with pytest.raises(ScenarioError) as error:
        axis.suite()
    assert error.value.problems[0].field == "joint"


@pytest.mark.slow
def test_a_sweep_has_names_and_units_of_a_slide():
    axis = mk.Scenario.parse(AXIS).replace(duration=0.02)
    assert find_parameter(axis, "position.amplitude").name == "reference.position.amplitude"
    over = ["reference.position.amplitude=3..4 mm", "start.position=3..4 mm"]
    swept = mk.sweep(axis, over, samples=4, metrics=["angle_rmse"])
    assert swept.label("angle_rmse").shown_unit == "mm" and swept.table["angle_rmse"].attrs["units"] == "m"
    assert [row[:2] for row in swept.statistics()] == [("position rmse", "mm")]


@pytest.mark.slow
def test_a_rig_has_limits_and_units_of_a_slide(tmp_path):
    axis = mk.Scenario.parse(AXIS).replace(duration=0.05)
    session = prepare(axis, paced=False, ideal=True)
    start, at_rest = 4 * mm, session.start.angle
    assert session.limits.highest_angle == pytest.approx(max(start, at_rest) + 10 * mm)
    assert session.limits.angle_rate == pytest.approx(0.72)
    shown = []
    ran = session.run(tmp_path, progress=shown.append)
    assert shown[0].joint_type is SLIDE
    assert ran.result.joint_type is SLIDE and not ran.result["outside_domain"].any()
    np.testing.assert_allclose(ran.result["angle"], axis.run_once()["angle"], atol=1e-6)  # which has an encoder


def controlled_by(controller):
    return mk.Scenario.parse(re.sub("controller: .*", f"controller: {controller}", AXIS))


@pytest.mark.slow
def test_a_single_muscle_follows_under_predictive_control():
    run = controlled_by("{class: predictive}").run_once()
    assert not run.outcome.failed and float(run.metrics["angle_rmse"]) < 0.1 * mm


def test_a_single_muscle_has_no_impedance():
    with pytest.raises(ScenarioError) as error:
        controlled_by("{class: decoupling, feedback: {bandwidth: 20 rad/s}, impedance: true}")
    (problem,) = error.value.problems
    assert problem.field == "controller.impedance" and problem.remedy


@pytest.mark.slow
def test_a_controller_of_one_muscle_has_finite_inputs_for_an_fmu():
    setpoint = controller_functions(mk.Scenario.parse(AXIS)).setpoint
    assert (setpoint.angle, setpoint.stiffness) == pytest.approx((4 * mm, 0.0))


@pytest.mark.slow
def test_the_sweeps_of_a_slide_find_the_strength_of_its_muscle():
    nominal = mk.Scenario.parse(AXIS).with_fixed_model()
    stronger = dataclasses.replace(nominal.joint.muscle2, strength=1.1)
    axis = nominal.replace(joint=dataclasses.replace(nominal.joint, muscle2=stronger))
    sweeps, results = Sweeps(-6 * mm, 6 * mm, 20.0), {}
    for name, part in sweeps.parts(axis, results):
        results[name] = simulated(part)
    fit = calibrate_scenario(axis, sweeps.recordings(results), JointPrior(mass=0.02))
    force, zero = fit.quantities["muscle2.force"], fit.quantities["zero"]
    assert abs(force.value - 1.1) < 3 * force.deviation < 0.2
    assert zero.unit == "m" and "load.inertia" not in fit.quantities


@pytest.mark.slow
def test_an_environment_of_one_muscle_has_finite_rewards():
    env = JointEnv(mk.Scenario.parse(AXIS).replace(duration=0.1))
    observation, _ = env.reset(seed=0)
    after, reward, terminated, *_ = env.step(env.action_space.sample())
    assert np.isfinite([*observation, *after, reward]).all() and not terminated and 0 < reward


LOOP = "stiffness: {kp: 0.02 bar/(N/mm), ki: 1 bar/(N*s/mm), kd: 0 bar*s/(N/mm)}"


def test_controllers_of_two_muscles_on_a_slide_are_compared_in_its_units():
    one = mk.Scenario.parse(AXIS)
    text = (
        re.sub(r"  muscle1: .*\n", "", AXIS)
        .replace("muscle2", "muscle")
        .replace("rest_length1: 150", "rest_length1: 165")
    )
    text = text.replace("controller: {", f"controller: {{{LOOP}, ").replace(
        "phase: 90 deg}", "phase: 90 deg}, stiffness: 16 N/mm"
    )
    two = mk.Scenario.parse(text)
    suite = two.suite()
    assert [*suite.controllers] == ["scenario", "decoupling"]
    assert [term.scale for term in suite.cost.terms] == pytest.approx([0.1 * mm, 0.5 * N / mm])
    for scenario, field, settings in (
        (one, "joint", {}),
        (two, "tuning.cost", {"tuning": {"cost": "angle_rmse/1 deg"}}),
    ):
        with pytest.raises(ScenarioError) as caught:
            scenario.suite(**settings)
        assert [problem.field for problem in caught.value.problems] == [field]


def test_the_stiffness_of_a_slide_in_service_is_in_its_unit():
    stiffness, deviation, none = np.array([[12e3]]), np.array([[100.0]]), np.empty((1, 0))
    told = np.array([True]), ("",), (("",), ()), SLIDE
    service = Service(np.array([2.0]), stiffness, deviation, stiffness, 9 * deviation, none, none, *told)
    assert "12 +- 0.2 N/mm" in service.verdict()
    column, values = service.listing().for_joint(SLIDE).columns["stiffness"]
    assert (column.shown_unit, values[0] / column.size) == ("N/mm", 12.0)
