"""Valves with air in scenario files."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mckibben.actuator import UnequalValves
from mckibben.errors import ScenarioError, SimulationError
from mckibben.reachability import check_trackability
from mckibben.scenario import Scenario, run_many, run_scenario
from mckibben.simulation import Outcome
from mckibben.units import bar, deg

EXAMPLE = Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml"
SHORT = EXAMPLE.read_text(encoding="utf-8").replace("duration: 10 s", "duration: 0.4 s").replace("at: 5 s", "at: 0.2 s")
FLOW = (
    "{class: FlowValve, conductance: 0.4 L/(s*bar), supply: 7 bar, "
    "reservoir_volume: 500 cm^3, line_conductance: 0.2 L/(s*bar)}"
)

TUBES = (
    "{class: unequal, muscle: {class: tube, valve: {from: smc-itv0050, supply: 7 bar, hysteresis: 0.05 bar}, "
    "volume: 3 cm^3, conductance: 0.2 L/(s*bar)}, reservoir_volume: 500 cm^3, line_conductance: 0.2 L/(s*bar)}"
)


def scenario(valve):
    return Scenario.parse(re.sub(r"valve:.*", f"valve: {valve}", SHORT))


@pytest.fixture(scope="module")
def flow():
    return scenario(FLOW)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("{class: FlowValv, conductance: 1 L/(s*bar), supply: 7 bar}", "valve"),
        ("{class: FlowValve, conductance: 1 L/s, supply: 7 bar}", "valve.conductance"),
        ("{class: FlowValve, conductance: 1 L/(s*bar), supply: 7 bar, deadzone: 3 %}", "valve.deadzone"),
        ("{class: FlowValve, conductance: 1 L/(s*bar)}", "valve.supply"),
        ("{class: FlowValve, conductance: 1 L/(s*bar), supply: 7 bar, direct: true}", "controller"),
        ("{from: festo-mh2, supply: 7 bar, period: 20 ms}", "valve"),
    ],
)
def test_a_wrong_valve_is_named(text, field):
    with pytest.raises(ScenarioError) as caught:
        scenario(text)
    assert [problem.field for problem in caught.value.problems] == [field]


def test_a_valve_too_fast_for_the_substeps_is_refused_with_their_number():
    plant = scenario("{class: FlowValve, conductance: 4 L/(s*bar), supply: 7 bar, band: 0.1 bar}").plant()
    with pytest.raises(SimulationError) as caught:
        plant.check_substeps([0.0, 0.1], 15.0, 1e-3, 4)
    assert caught.value.field == "substeps"
    plant.check_substeps([0.0, 0.1], 15.0, 1e-3, caught.value.lower)


@pytest.mark.slow
def test_openings_and_reservoir_are_in_the_result_and_its_file(flow, tmp_path):
    result = run_scenario(flow)
    assert result.outcome.name == "COMPLETED"
    result.to_netcdf(tmp_path / "result.nc")
    with xr.open_dataset(tmp_path / "result.nc") as saved:
        assert float(abs(saved["opening1"]).max()) > 0.05
        assert 6 * bar < float(saved["reservoir"].min()) < 6.999 * bar
        assert saved["opening2"].attrs["units"] == "1" and saved["reservoir"].attrs["units"] == "Pa"


@pytest.mark.slow
def test_a_small_valve_tracks_worse_and_its_rate_limit_is_found(flow):
    batch = run_many(flow, {"valve.conductance": np.array([2e-10, 4e-9])})
    small, large = batch.table["angle_rmse"].values
    assert small > 1.1 * large
    trackable = {
        conductance: check_trackability(
            scenario(FLOW.replace("0.4 L", f"{conductance} L")).plant(),
            flow.reference(),
            duration=0.4,
            control_period=0.01,
        ).verdict()
        for conductance in (0.4, 0.005)
    }
    assert "trackable throughout" in trackable[0.4] and "at the rate limit" in trackable[0.005]


@pytest.mark.slow
def test_unequal_valves_with_tubes_are_a_file_parameters_and_columns():
    read = scenario(TUBES)
    valve = read.plant().valve
    assert isinstance(valve, UnequalValves) and valve.muscle1 == valve.muscle2
    assert valve.muscle1.valve.conductance == pytest.approx(0.0091e-8) and valve.muscle2.volume == pytest.approx(3e-6)
    assert Scenario.parse(read.dumps()).plant().valve == valve
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


STARTING_POINTS = sorted((Path(__file__).parents[2] / "examples" / "valves").glob("*.yaml"))


@pytest.mark.slow
@pytest.mark.parametrize("path", STARTING_POINTS, ids=lambda path: path.stem)
def test_the_gains_to_start_from_control_their_valves(path):
    result = run_scenario(Scenario.read(path))
    assert not result.outcome.failed and result.outcome is not Outcome.LIMIT_CYCLE
    assert result.metrics["angle_rmse"] < 2 * deg
