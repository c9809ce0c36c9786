"""mckibben rig control: a run in full, what it keeps, and what it refuses."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mckibben.rig.record import read_record
from mckibben.scenario import Scenario, run_scenario
from mckibben.simulation import SimulationResult
from tests.robot.test_control import ONE, TORQUE

ROOT = Path(__file__).parents[2]
NAME = "pre-contracted-step-pid"


@pytest.fixture
def short(shortened, tmp_path):
    (tmp_path / "short.yaml").write_text(re.sub("accuracy:.*", "substeps: 4", shortened(NAME)), encoding="utf-8")


@pytest.mark.slow
def test_a_run_in_full_has_the_numbers_of_the_simulation(cli, short, tmp_path):
    checked = cli("rig", "control", "short.yaml", "--check")
    assert checked.code == 0 and "pressure2" in checked.out and not (tmp_path / "run").exists()
    found = cli("rig", "control", "short.yaml", "--out", "run", "--unpaced", "--ideal", "--json")
    assert found.code == 1
    for name in ("scenario.yaml", "results.json", "result.nc", "tracking.png", "tracking.svg", "run"):
        assert name in found.err.splitlines()[-1]
    numbers = {name: entry["value"] for name, entry in json.loads(found.out)["scalars"].items()}
    simulated = run_scenario(Scenario.read(tmp_path / "short.yaml"))
    assert numbers.pop("ended") == "completed" and not any(
        "deadlines" in t["title"] for t in json.loads(found.out)["tables"]
    )
    assert numbers.pop("vented_after") < 0.1 and numbers.pop("remaining_pressure") < 0.2e5
    assert numbers["coupling"] is None and numbers["air"] is None  # a second run; noise
    for name, value in numbers.items():
        if value is not None:
            assert value == pytest.approx(simulated.metrics[name], rel=1e-9, abs=1e-9), name
    kept = SimulationResult.from_netcdf(tmp_path / "run" / "result.nc")
    assert np.allclose(kept.columns["angle"], simulated.columns["angle"], rtol=0, atol=1e-12)
    assert Scenario.read(tmp_path / "run" / "scenario.yaml") == Scenario.read(tmp_path / "short.yaml")
    record = read_record(tmp_path / "run")
    assert Scenario.parse(record.header["scenario"]) == Scenario.read(tmp_path / "short.yaml")
    assert set(record.header) >= {"backend", "limits", "plan", "versions", "priority", "rig"}
    assert [event.kind for event in record.events] == ["opened", "completed", "vented"]

    again = cli("rig", "control", "short.yaml", "--out", "run", "--unpaced")
    assert again.code == 2 and "1 problem" in again.err and "record-0001.mcap" in again.err


@pytest.mark.slow
def test_beyond_a_limit_it_stops_with_the_reason_and_code_1(cli, short, tmp_path):
    rig = (ROOT / "examples" / "rig" / "joint-rig.yaml").read_text(encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(rig.replace("lowest_angle: -30 deg", "lowest_angle: 10 deg"), encoding="utf-8")
    found = cli("rig", "control", "short.yaml", "--rig", "rig.yaml", "--out", "run", "--unpaced")
    assert found.code == 1
    assert "stopped: the angle of 9." in found.err and "10 to 45 deg" in found.err
    record = read_record(tmp_path / "run")
    assert "stopped" in [event.kind for event in record.events]
    assert json.loads((tmp_path / "run" / "results.json").read_text())["scalars"]["ended"]["value"] == "stopped"


@pytest.mark.slow
def test_a_robot_runs_too_and_its_columns_are_along_joint_and_muscle(cli, tmp_path):
    (tmp_path / "one.yaml").write_text((ONE + TORQUE).replace("duration: 0.4 s", "duration: 0.1 s"), encoding="utf-8")
    quick = "rig: simulated\napproach: {raising: 100 ms, settling: 50 ms}\n"
    (tmp_path / "rig.yaml").write_text(quick, encoding="utf-8")
    checked = cli("rig", "control", "one.yaml", "--rig", "rig.yaml", "--check")
    assert checked.code == 0 and {"angle.knee", "pressure.knee2", "valve.knee1"} <= {
        *re.findall(r"\w+\.\w+", checked.out)
    }
    found = cli("rig", "control", "one.yaml", "--rig", "rig.yaml", "--out", "run", "--unpaced", "--json")
    assert found.code == 1  # so soon it does not follow
    with xr.open_dataset(tmp_path / "run" / "result.nc") as kept:
        assert kept["angle"].dims == ("joint", "time") and kept["command"].dims == ("muscle", "time")
        assert kept["muscle"].values.tolist() == ["knee1", "knee2"] and kept.sizes["time"] == 50
