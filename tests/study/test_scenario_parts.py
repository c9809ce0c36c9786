"""Parts of scenario files: valves with air, friction, real sensors, and control by inversion."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import mckibben as mk
from mckibben.control import PressureObserver
from mckibben.errors import RangeError, ScenarioError, SimulationError
from mckibben.reachability.envelope import envelope
from mckibben.scenario import batched, find_parameter, run_many, run_scenario
from mckibben.simulation import Outcome
from mckibben.study.tune import gain_ranges
from mckibben.units import bar, deg, ms

EXAMPLES = Path(__file__).parents[2] / "examples"
BASE = (EXAMPLES / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
SHORT = BASE.replace("duration: 10 s", "duration: 0.4 s").replace("at: 5 s", "at: 0.2 s")
BEFORE, LOOPS = BASE.split("controller:\n")
AFTER = LOOPS[LOOPS.index("reference:") :]
MUSCLE = "{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}"
DECOUPLING = "  class: decoupling\n  feedback: {bandwidth: 50 rad/s}\n"


def controlled(controller, before=BEFORE):
    """A scenario with another controller."""
    return mk.Scenario.parse(f"{before}controller:\n{controller}{AFTER}")


# Valves with air ------------------------------------------------------------------------------------------------------

FLOW = (
    "{class: FlowValve, conductance: 0.4 L/(s*bar), supply: 7 bar, "
    "reservoir_volume: 500 cm^3, line_conductance: 0.2 L/(s*bar)}"
)

TUBES = (
    "{class: unequal, muscle: {class: tube, valve: {from: smc-itv0050, supply: 7 bar, hysteresis: 0.05 bar}, "
    "volume: 3 cm^3, conductance: 0.2 L/(s*bar)}, reservoir_volume: 500 cm^3, line_conductance: 0.2 L/(s*bar)}"
)


def with_valve(valve):
    return mk.Scenario.parse(re.sub(r"valve:.*", f"valve: {valve}", SHORT))


@pytest.fixture(scope="module")
def flow():
    return with_valve(FLOW)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("{class: FlowValve, conductance: 1 L/(s*bar), supply: 7 bar, direct: true}", "controller"),
        ("{from: festo-mh2, supply: 7 bar, period: 20 ms}", "valve"),
    ],
)
def test_a_wrong_valve_is_named(text, field):
    with pytest.raises(ScenarioError) as caught:
        with_valve(text)
    assert [problem.field for problem in caught.value.problems] == [field]


def test_a_valve_too_fast_for_the_substeps_is_refused_with_their_number():
    plant = with_valve("{class: FlowValve, conductance: 4 L/(s*bar), supply: 7 bar, band: 0.1 bar}").plant()
    with pytest.raises(SimulationError) as caught:
        plant.check_substeps([0.0, 0.1], 15.0, 1e-3, 4)
    assert caught.value.field == "substeps"
    plant.check_substeps([0.0, 0.1], 15.0, 1e-3, caught.value.lower)


@pytest.mark.slow
def test_openings_and_reservoir_are_in_the_result_and_its_file(flow, tmp_path):
    result = run_scenario(flow)
    assert not result.outcome.failed
    result.to_netcdf(tmp_path / "result.nc")
    with xr.open_dataset(tmp_path / "result.nc") as saved:
        assert float(abs(saved["opening1"]).max()) > 0.05
        assert 6 * bar < float(saved["reservoir"].min()) < 6.999 * bar
        assert saved["opening2"].attrs["units"] == "1" and saved["reservoir"].attrs["units"] == "Pa"


@pytest.mark.slow
def test_unequal_valves_with_tubes_are_a_file_parameters_and_columns():
    read = with_valve(TUBES)
    valve = read.plant().valve
    assert isinstance(valve, mk.UnequalValves) and valve.muscle1 == valve.muscle2
    assert valve.muscle1.valve.conductance == pytest.approx(0.0091e-8) and valve.muscle2.volume == pytest.approx(3e-6)
    assert mk.Scenario.parse(read.dumps()).plant().valve == valve
    batch = run_many(
        read,
        {
            "valve.muscle.valve.supply": np.array([7e5, 6.5e5]),
            "valve.muscle1.valve.conductance": np.array([0.9e-10, 2e-10]),
            "valve.muscle2.conductance": np.array([2e-9, 1e-9]),
            "valve.muscle2.valve.hysteresis": np.array([1e3, 1e4]),
        },
    )
    assert np.ptp(batch.table["angle_rmse"].values) > 0
    result = run_scenario(read)
    assert not result.outcome.failed
    assert float(np.abs(result["outlet1"] - result["pressure1"]).max()) > 100.0
    assert float(result["reservoir"].min()) < 6.9999 * bar


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((EXAMPLES / "valves").glob("*.yaml")), ids=lambda path: path.stem)
def test_the_gains_to_start_from_control_their_valves(path):
    result = run_scenario(mk.Scenario.read(path))
    assert not result.outcome.failed and result.outcome is not Outcome.LIMIT_CYCLE
    assert result.metrics["angle_rmse"] < 2 * deg


# Control by inversion -------------------------------------------------------------------------------------------------


def test_what_is_left_out_is_that_of_the_plant_and_the_classes():
    short = controlled(DECOUPLING)
    control = short.control()
    assert isinstance(control, mk.DecouplingControl) and control.feedback == mk.PolePlacement(50.0)
    assert control.observer == mk.ExtendedStateObserver() and control.pressure_observer == PressureObserver()
    assert control.valve.time_constant == pytest.approx(20 * ms)
    assert control.load == short.plant().load
    assert control.minimum_tension == 5.0 and not control.friction_compensation
    ideal = controlled(DECOUPLING, re.sub("valve:.*", "valve: ideal", BEFORE))
    assert isinstance(ideal.control().valve, mk.IdealValve)


def test_bandwidths_count_as_gains():
    decoupling = controlled(DECOUPLING)
    nyquist = np.pi / decoupling.control_period  # rad/s
    assert gain_ranges(decoupling, 3.0)["controller.feedback.bandwidth"].high == pytest.approx(nyquist)
    sliding = "  class: decoupling\n  feedback: {class: sliding, slope: 30 1/s, reach: 50 rad/s^2}\n"
    assert "controller.feedback.reach" in gain_ranges(controlled(sliding))


# Friction -------------------------------------------------------------------------------------------------------------

RUBBING = BEFORE.replace(
    MUSCLE,
    MUSCLE.removesuffix("}")
    + ", friction: {half_width: 12 N, presliding_length: 0.5 mm, growth: 1 N/bar, reference_pressure: 3 bar, "
    "viscous: 20 N*s/m}}",
)


@pytest.mark.parametrize(
    "loops", [LOOPS[: LOOPS.index("reference:")], DECOUPLING, "  class: predictive\n  bandwidth: 80 rad/s\n"]
)
def test_the_stiffness_of_a_motion_is_controlled_by_any_controller(loops):
    scenario = controlled(f"  stiffness_amplitude: 1 deg\n{loops}", RUBBING)
    assert mk.Scenario.parse(scenario.dumps()) == scenario
    assert scenario.control().stiffness_amplitude == pytest.approx(1 * deg)
    assert find_parameter(scenario, "controller.stiffness_amplitude").unit == "rad"
    assert controlled(loops).control().stiffness_amplitude is None


def test_an_envelope_of_the_isobaric_stiffness_refuses_another():
    with pytest.raises(RangeError) as refused:
        envelope(controlled(f"  stiffness_amplitude: 1 deg\n{LOOPS[: LOOPS.index('reference:')]}", RUBBING))
    assert refused.value.field == "controller.stiffness_amplitude"


# Real sensors, pushes, muscles of another strength, and a law corrected on line ---------------------------------------


def test_the_model_keeps_its_own_strength():
    model = f"  model: {{geometry: {{from: knee-table-2, connector_length: 208 mm}}, muscle: {MUSCLE}}}\n"
    own = controlled(model + LOOPS[: LOOPS.index("reference:")])
    many = batched(own, {"joint.muscle.strength": [0.9, 1.1], "controller.model.muscle.strength": [1, 1]})
    np.testing.assert_array_equal(many.plant().joint.muscle1.strength, [0.9, 1.1])
    np.testing.assert_array_equal(many.control().model.muscle1.strength, [1.0, 1.0])
    assert batched(own, {"joint.muscle.strength": [0.9, 1.1]}).control().model.muscle1.strength is None
