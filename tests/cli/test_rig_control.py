"""mckibben rig control: a run in full, what it keeps, and what it refuses."""

import json
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from mckibben.rig.record import read_record
from mckibben.simulation import Result
from mckibben.study.reporting import shown
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.running import run_scenario

ROOT = Path(__file__).parents[2]
NAME = "pre-contracted-step-pid"


@pytest.fixture
def short(shortened, tmp_path):
    (tmp_path / "short.yaml").write_text(shortened(NAME), encoding="utf-8")


def test_a_run_in_full_has_the_numbers_of_the_simulation(cli, short, tmp_path):
    found = cli("rig", "control", "short.yaml", "--out", "run", "--unpaced", "--ideal", "--json")
    assert (found.code, found.err.splitlines()[-1]) == (
        0,
        "kept the record, scenario.yaml, results.json, result.nc, tracking.png and .svg in run",
    )
    numbers = json.loads(found.out)
    simulated = run_scenario(Scenario.read(tmp_path / "short.yaml")).result
    expected = shown(simulated.metrics)
    assert (numbers["ended"], numbers["outcome"], numbers["timing"]) == ("completed", "completed", None)
    assert numbers["vented_after_s"] < 0.1
    for name, value in numbers["metrics"].items():
        if name not in ("coupling_deg", "air_L") and value is not None:  # a second run; noise
            assert value == pytest.approx(expected[name], rel=1e-9, abs=1e-9), name
    assert numbers["metrics"]["coupling_deg"] is None
    assert numbers["metrics"]["air_L"] is None
    kept = Result.from_netcdf(tmp_path / "run" / "result.nc")
    assert np.allclose(kept.columns["angle"], simulated.columns["angle"], rtol=0, atol=1e-12)
    assert Scenario.read(tmp_path / "run" / "scenario.yaml") == Scenario.read(tmp_path / "short.yaml")
    record = read_record(tmp_path / "run")
    assert Scenario.parse(record.header["scenario"]) == Scenario.read(tmp_path / "short.yaml")
    assert set(record.header) >= {"backend", "calibrations", "limits", "course", "versions", "priority", "rig"}
    assert [event.kind for event in record.events] == ["opened", "completed", "vented"]

    again = cli("rig", "control", "short.yaml", "--out", "run", "--unpaced")
    assert again.code == 2 and "record-0001.chunks: it is there already" in again.err


def test_beyond_a_limit_it_stops_with_the_reason_and_code_1(cli, short, tmp_path):
    rig = (ROOT / "examples" / "rig" / "joint-rig.yaml").read_text(encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(rig.replace("lowest_angle: -30 deg", "lowest_angle: 10 deg"), encoding="utf-8")
    found = cli("rig", "control", "short.yaml", "--rig", "rig.yaml", "--out", "run", "--unpaced")
    assert found.code == 1
    assert "stopped and vented: the angle of 9." in found.err and "10 to 45 deg" in found.err
    record = read_record(tmp_path / "run")
    assert "stopped" in [event.kind for event in record.events]
    assert json.loads((tmp_path / "run" / "results.json").read_text())["ended"] == "stopped"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("short.yaml",), "say where to keep it: --out DIR"),
        (("nowhere.yaml", "--out", "run"), "nowhere.yaml: 1 problem"),
        (("short.yaml", "--out", "run", "--duration", "1.5 ms"), "no whole number of control periods"),
        (("short.yaml", "--out", "run", "--duration", "3 bar"), "--duration"),
        (
            ("short.yaml", "--out", "run", "--rig", "wrong.yaml"),
            "line 2, virtual.angle_step: 'bar' is not a unit",
        ),
        (("short.yaml", "--out", "run", "--rig", "both.yaml"), "has no rig; give one of virtual, nidaqmx"),
        (("short.yaml", "--out", "short.yaml"), "it is a file"),
    ],
)
def test_what_is_wrong_is_said_before_anything_moves(cli, short, tmp_path, arguments, text):
    (tmp_path / "wrong.yaml").write_text("virtual:\n  angle_step: 5 bar\n", encoding="utf-8")
    (tmp_path / "both.yaml").write_text("name: none\n", encoding="utf-8")
    found = cli("rig", "control", *arguments)
    assert found.code == 2 and text in found.err, found.err
    assert not list(tmp_path.glob("run/record*"))


def test_ctrl_c_vents_keeps_the_record_and_has_the_code_of_shells(cli, short, tmp_path):
    """In real time, ordinary or not."""
    record = tmp_path / "run" / "record-0001.chunks"

    def press_keys():
        begun = time.monotonic()
        while time.monotonic() - begun < 60 and (not record.exists() or record.stat().st_size < 100_000):
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    pressing = threading.Thread(target=press_keys)
    pressing.start()
    found = cli("rig", "control", "short.yaml", "--out", "run", "--duration", "60 s")
    pressing.join()
    assert found.code == 128 + signal.SIGINT
    assert "stopped and vented: stopped by SIGINT (Ctrl-C)" in found.err
    kept = read_record(tmp_path / "run")
    assert [event.kind for event in kept.events] == ["opened", "signal", "vented"]
    sample = kept.columns["sample"]
    assert sample.size > 100 and sample[0] == 0 and sample[-1] >= sample.size - 1
    assert (tmp_path / "run" / "results.json").exists()
