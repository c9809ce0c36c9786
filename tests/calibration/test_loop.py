"""What a calibration makes of a scenario: estimates in plant and model, and the margins of its loop."""

import dataclasses

import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve, UnequalValves
from mckibben.calibration.equations import MotionSamples, Recorded, corrected, problem_of
from mckibben.calibration.estimation import JointCalibration
from mckibben.calibration.experiment import calibrated_scenario
from mckibben.calibration.fitting import JointEstimate
from mckibben.calibration.loop import PLANTS, loop_margins, loop_remarks, with_estimates
from mckibben.calibration.models import HingeModel, Weight
from mckibben.calibration.recordings import JointPrior
from mckibben.errors import McKibbenWarning
from mckibben.result import Severity
from mckibben.scenario import Scenario

OWN = "examples/calibration/knee.yaml"  # whose controller has a model and a load of its own
INHERITED = "examples/pre-contracted-step-pid.yaml"


def samples():
    angle = np.linspace(-0.2, 0.2, 50)[:, None]
    pressures = np.full((50, 2), 2e5)
    return Recorded(MotionSamples(angle, angle, angle, pressures, pressures[:, :0], pressures, pressures), Weight(), 0)


@pytest.mark.parametrize("path", [OWN, INHERITED])
def test_estimates_are_those_of_plant_and_model(path):
    scenario = Scenario.read(path)
    heavier = dataclasses.replace(scenario.load, mass2=0.9)
    after = with_estimates(scenario, {}, load=heavier, valve=FirstOrderValve(0.03), command_delay=0.017)
    plant, control = after.plant(), after.control()
    assert (float(plant.load.mass2), plant.valve.time_constant, plant.command_delay) == (0.9, 0.03, 0.017)
    assert float(getattr(control, "load", heavier).mass2) == 0.9
    assert after.joint == scenario.joint and after.signals == scenario.signals


def test_a_model_of_the_controller_itself_is_replaced_with_the_plant():
    scenario = Scenario.read(OWN)
    stronger = dataclasses.replace(scenario.joint.muscle1, strength=1.3)
    joint = dataclasses.replace(scenario.joint, muscle1=stronger)
    after = with_estimates(scenario, {}, joint=joint)
    assert scenario.controller.model != scenario.joint
    assert after.controller.model == after.joint == joint


def test_deviations_of_parameters_become_the_uncertainty_that_tune_reads(tmp_path):
    scenario = Scenario.read(OWN).model_copy(update={"uncertainty": ("load.mass1=+-5 %", "load.mass2=+-20 %")})
    found = {"muscle1.force": "3.1 %", "load.mass": "0.02 kg", "zero": "0.001 rad", "valve1.time_constant": "0.002 s"}
    after = with_estimates(
        scenario, found | {"valve1.delay": "0.0001 s"}, valve=FirstOrderValve(0.03), command_delay=1e-3
    )
    assert set(after.uncertainty) == {
        "load.mass1=+-5 %",
        "load.mass2=normal 0.02 kg",
        "joint.muscle1.strength=normal 3.1 %",
        "valve.time_constant=normal 0.002 s",
        "command_delay=normal 0.0001 s",
    }
    after.to_yaml(tmp_path / "scenario.yaml")
    assert Scenario.read(tmp_path / "scenario.yaml").uncertainty == after.uncertainty
    pair = UnequalValves(FirstOrderValve(0.03), FirstOrderValve(0.05))
    apart = with_estimates(Scenario.read(OWN), {"valve2.time_constant": "0.003 s"}, valve=pair)
    assert apart.uncertainty == ("valve.muscle2.time_constant=normal 0.003 s",)


@pytest.mark.parametrize(("deviation", "enters"), [(100.0, True), (900.0, False)])
def test_determined_creep_is_that_of_plant_and_model(deviation, enters, tmp_path):
    """Relaxation of two arms, against the three of the estimate with the same total."""
    scenario = Scenario.read(OWN)
    problem = problem_of(HingeModel(scenario.controller.model, scenario.load), [samples()], JointPrior())
    estimate = JointEstimate(1500.0, deviation, 1000.0, "N/m")
    fit = JointCalibration(
        {"muscle1.creep": estimate, "zero": JointEstimate(0.0, 0.001, 0.01, "rad")},
        corrected(problem, np.zeros(problem.size)).model,
        (),
        problem,
        None,
        0.0,
        0.0,
    )
    calibrated_scenario(scenario, fit).to_yaml(tmp_path / "scenario.yaml")
    after = Scenario.read(tmp_path / "scenario.yaml")
    for joint in (after.joint, after.control().model):
        assert joint.muscle1.has_creep == enters and not joint.muscle2.has_creep
    if enters:
        times = np.geomspace(0.1, 10, 30)
        force = after.joint.muscle1.creep.path_response(
            np.array([0.2, 0.201]), 100.0, move_time=1e-4, hold_time=20.0, sample_times=times
        )[1]
        expected = 1.5 * np.mean([np.exp(-times / constant) for constant in (1, 3, 10)], axis=0)
        np.testing.assert_allclose(force, expected, atol=0.2)  # N, of 1.5 N


def test_a_scenario_that_cannot_run_has_no_margins():
    scenario = Scenario.read(OWN).model_copy(update={"duration": 0.0105})
    with pytest.warns(McKibbenWarning, match="margins"):
        assert loop_margins(scenario, command_delay=np.linspace(0.0, 1e-3, PLANTS)) is None


@pytest.mark.parametrize(("margins", "named"), [([0.4, 0.3, 0.25], False), ([0.4, 0.1, 0.3], True), ([0, 0, 0], True)])
def test_a_loop_below_the_floor_on_any_plant_is_remarked_with_the_next_command(margins, named):
    remarks = loop_remarks(np.array(margins))
    assert [remark.field for remark in remarks] == ["controller"] * named
    for remark in remarks:
        assert remark.severity is Severity.WARNING
        assert f"{min(margins):.2g}" in remark.text
        assert "mckibben tune" in remark.remedy
