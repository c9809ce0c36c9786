"""`mckibben sweep` and `tune`, as people type them; and what is left when they are interrupted or killed."""

import json
import re
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mckibben.errors import FileError, McKibbenWarning
from mckibben.scenario import Scenario, list_parameters
from mckibben.storage.store import STUDY, Job, Store, open_store
from mckibben.study.scenarios import begun_settings
from mckibben.study.sweep import sweep
from mckibben.study.tune import read_trials

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
    assert re.search(r"does not follow +20 +50", done.out) and re.search(r"not run: no pressures.* +20 +50", done.out)
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
    assert shown == ["370 mm", "above 0, up to 10000 mm", "mm"]
    text = cli("sweep", "s.yaml", "--list").out
    assert text.startswith(f"{Scenario.read(scenario).name}: {len(known)} parameters can be varied")


@pytest.mark.slow
def test_an_interrupted_sweep_ends_with_the_same_bytes(cli, stopped, scenario, tmp_path):
    asked = (*MASS, "--samples", "512")
    code, messages = stopped("sweep", "s.yaml", *asked, "--out", "kept")
    connection = sqlite3.connect(tmp_path / "kept" / "study.sqlite")
    (first,) = connection.execute("SELECT count(*) FROM record").fetchone()
    connection.close()
    assert (code, 3 <= first < 12) == (130, True), messages
    assert f"interrupted: {32 * first} of 512 runs are kept; continue with --resume" in messages
    assert cli("sweep", "s.yaml", "--resume", "--out", "kept").code == 0
    assert cli("sweep", "s.yaml", *asked, "--out", "undisturbed").code == 0
    for name in ("sweep.nc", "results.json"):
        files = [(tmp_path / folder / name).read_bytes() for folder in ("kept", "undisturbed")]
        assert files[0] == files[1]


class FirstRecordError(BaseException):
    """A study has begun to record."""


@pytest.mark.slow
@pytest.mark.parametrize("how", ["--force", "--resume"])
def test_a_study_killed_before_its_first_record_goes_on_in_both_ways(cli, scenario, tmp_path, monkeypatch, how):
    def begun(*_):
        raise FirstRecordError

    monkeypatch.setattr(Job, "add", begun)
    (tmp_path / "kept").mkdir()
    Store(tmp_path / "kept" / STUDY).close()  # what a kill leaves while programs compile
    for _ in range(2):  # the second time the settings are recorded
        with pytest.raises(FirstRecordError):
            cli("sweep", "s.yaml", *MASS, "--out", "kept", how)


def test_what_was_not_recorded_is_said_and_other_studies_are_not_continued(tmp_path):
    Store(tmp_path / STUDY).close()
    with pytest.warns(McKibbenWarning, match="nothing was recorded"):
        assert begun_settings(tmp_path, "mckibben tuning", resume=True) == {}
    with open_store(tmp_path / STUDY, resume=True) as store:
        store.job({"format": "another"}).add({0: b"x"})
    with pytest.raises(FileError, match="another kind"):
        begun_settings(tmp_path, "mckibben tuning", resume=True)


CHANGES = (
    ("duration: 10 s", "duration: 100 ms"),
    ("control_period: 1 ms", "control_period: 2 ms"),
    ("{class: sine, amplitude: 10 deg, frequency: 0.5 Hz}", "2 deg"),
    ("{class: step, before: 13 N*m/rad, after: 17 N*m/rad, at: 5 s}", "15 N*m/rad"),
)
START = ("--over", "start.angle=-5..8 deg", "--over", "start.stiffness=11..20 N*m/rad log")
COST = ("--cost", "angle_rmse/1 deg + stiffness_rmse/1 N*m/rad", "--margin", "1")
SMALL = (*START, *COST, "--iterations", "3", "--out", "kept")


@pytest.fixture
def text() -> str:
    """The example, with nothing to do but to stay at 2 deg and 15 N*m/rad."""
    said = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
    for old, new in CHANGES:
        assert old in said
        said = said.replace(old, new)
    return said


@pytest.fixture
def still(tmp_path, text) -> None:
    (tmp_path / "s.yaml").write_text(text, encoding="utf-8")


def table_of(folder: Path, title: str) -> dict[str, list]:
    """Columns of a table in results.json."""
    tables = json.loads((folder / "results.json").read_text(encoding="utf-8"))["tables"]
    (table,) = [table for table in tables if table["title"].startswith(title)]
    return {name: column["values"] for name, column in table["columns"].items()}


@pytest.mark.slow
def test_a_search_from_beginning_to_end(cli, still, tmp_path, text, each_progress):
    done = cli("tune", "s.yaml", *SMALL, "--method", "cma")
    assert done.code == 0
    kept = tmp_path / "kept"
    names = {"s-tuned.yaml", STUDY, "results.json", "tuning.png", "tuning.svg"}
    assert {path.name for path in kept.iterdir()} == names and all(name in done.out + done.err for name in names)
    numbers = json.loads((kept / "results.json").read_text(encoding="utf-8"))
    scalars = {name: entry["value"] for name, entry in numbers["scalars"].items()}
    trials = read_trials(kept / STUDY)
    assert scalars["cost"] <= scalars["cost_before"] and scalars["evaluated"] == len(trials)
    assert f"searching, lowest cost {min(trial.cost for trial in trials):.4g}" in done.err
    assert done.out.startswith(f"cost {scalars['cost_before']:.4g} -> {scalars['cost']:.4g}")
    effect = table_of(kept, "pre-contracted knee")
    tuned = dict(zip(effect["metric"], effect["tuned"], strict=True))
    assert scalars["cost"] == pytest.approx(tuned["angle rmse"] + tuned["stiffness rmse"], rel=1e-6)
    parameters = table_of(kept, "Parameters")
    assert parameters["parameter"] == ["start.angle", "start.stiffness"]
    assert re.search(rf"start\.angle +0 deg +{re.escape(parameters['tuned'][0])}\s", done.out)

    before = {path: path.read_bytes() for path in kept.iterdir()}
    again = cli("tune", "s.yaml", "--resume", "--iterations", "3", "--out", "kept")  # options are those of the study
    assert again.code == 0, again.err
    refused = cli("tune", "s.yaml", *SMALL, "--margin", "2", "--resume")
    assert (refused.code, refused.out) == (2, "") and "gain_margin: " in refused.err
    assert {path: path.read_bytes() for path in kept.iterdir()} == before

    new = (kept / "s-tuned.yaml").read_text(encoding="utf-8")
    changed = [(a, b) for a, b in zip(text.splitlines(), new.splitlines(), strict=True) if a != b]
    assert len(changed) == 1, "its comments and order are kept"
    assert changed[0][1].startswith("start: {angle: ")
    margins = json.loads(cli("margins", "kept/s-tuned.yaml", "--json").out)
    assert tuned["least disk margin"] == pytest.approx(min(margins["columns"]["disk"]["values"]))
