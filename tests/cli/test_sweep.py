"""mckibben sweep, as people type it; and what is left when it is interrupted or killed."""

import json
import re
import signal
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mckibben.scenario import Scenario, list_parameters
from mckibben.simulation.metrics import METRICS
from mckibben.study.sweep import sweep

MASS = ("--over", "load.mass2=0.2 kg..1.0 kg")


@pytest.fixture
def scenario(tmp_path, shortened) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_sweep_from_beginning_to_end(cli, scenario, tmp_path, each_progress):
    asked = (*MASS, "--over", "start.stiffness=12 N*m/rad, 30 N*m/rad", "--samples", "40", "--seed", "1")
    done = cli("sweep", "s.yaml", *asked, "--out", "kept", "--details")
    assert done.code == 0
    kept = tmp_path / "kept"
    names = {"study.sqlite", "sweep.nc", "results.json", "sweep.png", "sweep.svg"}
    assert {path.name for path in kept.iterdir()} == names and all(name in done.out for name in names)
    swept = sweep(Scenario.read(scenario), out=kept, resume=True)
    assert (swept.count, swept.computed, swept.failed.sum()) == (40, 0, 20)
    with xr.open_dataset(kept / "sweep.nc", engine="h5netcdf") as table:
        np.testing.assert_array_equal(table["angle_rmse"], swept["angle_rmse"])
    assert json.loads((kept / "results.json").read_text(encoding="utf-8"))["verdict"] == swept.verdict()
    assert " ".join(done.out.split()).startswith(swept.verdict())
    assert re.search(r"completed +20 +50", done.out) and re.search(r"not run: no pressures.* +20 +50", done.out)
    for metric, unit, size in METRICS.values():
        if metric != "coupling" and (values := swept.values(metric) / size).size:
            median = re.escape(f"{np.median(values):.4g}")
            assert re.search(rf"{metric.replace('_', ' ')} +{re.escape(unit)} +{median} ", done.out), metric
    assert re.search(r"start\.stiffness +failed +1", done.out)
    assert "40 of 40 runs" in done.err

    again = cli("sweep", "s.yaml", "--resume", "--out", "kept", "--details")
    assert (again.code, again.out, again.err) == (0, done.out, "")
    as_json = cli("sweep", "s.yaml", "--resume", "--out", "kept", "--json")
    assert json.loads(as_json.out) == json.loads((kept / "results.json").read_text(encoding="utf-8"))
    assert as_json.err.startswith("wrote results.json, sweep.nc, sweep.png, sweep.svg, study.sqlite to kept")
    before = (kept / "study.sqlite").read_bytes()
    for arguments, message in (
        (asked, "a study exists already; continue it with --resume"),
        (("--resume", "--seed", "2"), "seed: the study was started with 1, not 2"),
    ):
        refused = cli("sweep", "s.yaml", *arguments, "--out", "kept")
        assert (refused.code, refused.out) == (2, "") and message in refused.err
    assert (kept / "study.sqlite").read_bytes() == before


def test_the_list_of_what_can_be_varied(cli, scenario):
    listed = json.loads(cli("sweep", "s.yaml", "--list", "--json").out)["columns"]
    known = list_parameters(Scenario.read(scenario))
    assert listed["parameter"]["values"] == [parameter.name for parameter in known]
    row = listed["parameter"]["values"].index("joint.geometry.joint_length")
    shown = [listed[name]["values"][row] for name in ("value", "range", "unit")]
    assert shown == ["370 mm", "above 0 to 10000 mm", "mm"]
    text = cli("sweep", "s.yaml", "--list").out
    assert text.startswith(f"{Scenario.read(scenario).name}: {len(known)} parameters can be varied")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["s.yaml", *MASS], "--out DIR"),
        (["s.yaml", "--out", "x", "--over", "load.mas2=1..2 kg"], "did you mean 'load.mass2'?"),
        (["s.yaml", "--out", "x", "--resume"], "there is no study to continue"),
        (["s.yaml", "--out", "x", "--force", *MASS], "continue it with --resume"),
        (["s.yaml", "--out", "/proc/x", *MASS], "/proc/x: 1 problem\n  it cannot be made"),
        (["nowhere.yaml", "--out", "x", *MASS], "nowhere.yaml: 1 problem"),
    ],
)
def test_mistakes(cli, scenario, tmp_path, arguments, said):
    found = cli("sweep", *arguments)
    assert (found.code, found.out) == (2, "")
    assert found.err.startswith("error: ")
    assert said in found.err
    assert "Traceback" not in found.err
    assert [path.name for path in tmp_path.iterdir()] == ["s.yaml"], "a folder is in the way of the next try"


@pytest.mark.slow
def test_an_interrupted_and_then_killed_sweep_ends_with_the_same_bytes(cli, stopped, scenario, tmp_path):
    asked = (*MASS, "--samples", "512")

    def blocks() -> int:
        connection = sqlite3.connect(tmp_path / "kept" / "study.sqlite")
        count = connection.execute("SELECT count(*) FROM record").fetchone()[0]
        connection.close()
        return count

    code, messages = stopped(signal.SIGINT, "sweep", "s.yaml", *asked, "--out", "kept")
    first = blocks()
    assert (code, 3 <= first < 12) == (130, True), messages
    assert f"interrupted: {32 * first} of 512 runs are kept; continue with --resume" in messages
    code, _ = stopped(signal.SIGKILL, "sweep", "s.yaml", "--resume", "--out", "kept")
    assert code == -signal.SIGKILL and first + 3 <= blocks() < 16
    assert cli("sweep", "s.yaml", "--resume", "--out", "kept").code == 0
    assert cli("sweep", "s.yaml", *asked, "--out", "undisturbed").code == 0
    for name in ("sweep.nc", "results.json"):
        files = [(tmp_path / folder / name).read_bytes() for folder in ("kept", "undisturbed")]
        assert files[0] == files[1]
