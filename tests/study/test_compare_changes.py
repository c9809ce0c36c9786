"""Plants that differ from the nominal one in one respect, and what breaks on them."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mckibben.robot import RobotScenario
from mckibben.scenario import Scenario, with_values
from mckibben.simulation import Batch, Outcome
from mckibben.simulation.outcome import OUTCOMES
from mckibben.study.compare.changes import Changed, changed_values, on_changed_plants
from mckibben.units import deg

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_a_laboratory_has_all_changes():
    changes = changed_values(Scenario.read(EXAMPLES / "own-joint.yaml"))
    payloads = ["nominal", "payload +50 %", "payload -50 %"]
    others = ["strength +25 %", "strength -25 %", "delay x 1.5", "friction x 2", "supply x 0.5"]
    assert list(changes) == payloads + others
    assert changes["delay x 1.5"] == {"command_delay": pytest.approx(6e-3)}
    assert changes["supply x 0.5"] == {"valve.supply": pytest.approx(3.5e5)}
    assert changes["friction x 2"] == {"joint.muscle.friction.half_width": pytest.approx(15.0)}


def test_of_an_ideal_plant_and_of_a_robot_only_what_it_has_changes():
    ideal = changed_values(Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml"))
    assert not {"delay x 1.5", "friction x 2", "supply x 0.5"} & ideal.keys() and "payload +50 %" in ideal
    strengths = changed_values(RobotScenario.read(EXAMPLES / "robot" / "lei-leg-control.yaml"))["strength -25 %"]
    assert strengths == {f"robot.muscles.{number}.muscle.strength": 0.75 for number in range(3)}


def test_a_cell_has_the_error_the_margin_that_is_too_small_or_the_failure():
    codes = [OUTCOMES.index(outcome) for outcome in (Outcome.COMPLETED, Outcome.COMPLETED, Outcome.LIMIT_CYCLE)]
    flags = {"flag_values": np.arange(len(OUTCOMES)), "flag_meanings": " ".join(each.name for each in OUTCOMES)}
    table = xr.Dataset({"angle_rmse": ("run", np.array([0.5, 1.0, 2.0]) * deg), "outcome": ("run", codes, flags)})
    changed = Changed(("nominal", "payload +50 %", "delay x 1.5"), Batch(table), np.array([0.5, 0.11, -0.2]))
    assert changed.cells(deg) == ["0.5", "1 (disk 0.11)", "limit cycle"]


@pytest.mark.slow
def test_each_change_is_that_of_the_plant_alone():
    """The error with each change is that of a run whose model stays, and more delay is less margin."""
    scenario = Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml")
    scenario = scenario.replace(duration=0.5, command_delay=0.008, start={"angle": 0.0}).with_fixed_model()
    found = on_changed_plants(scenario)
    values = changed_values(scenario)
    assert found.changes == tuple(values)
    for change, error in zip(found.changes, found.batch.metrics["angle_rmse"], strict=True):
        alone = with_values(scenario, values[change]).run_once().metrics["angle_rmse"]
        assert error == pytest.approx(alone, rel=1e-6), change
    disk = dict(zip(found.changes, found.disk, strict=True))
    assert disk["delay x 1.5"] < disk["nominal"]
