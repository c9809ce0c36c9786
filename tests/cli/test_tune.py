"""mckibben tune, as people type it."""

import json
import re
from pathlib import Path

import pytest

from mckibben.scenario import Scenario
from mckibben.storage.store import STUDY
from mckibben.study.tune import read_trials
from mckibben.study.tune.objective import TuningProblem

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
def scenario(tmp_path, text) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def mistaken(cli, tmp_path, scenario):
    """Call with a mistake: it is bad input, said in one error without a progress bar; what is said."""

    def call(*arguments: str) -> str:
        found = cli("tune", *arguments)
        assert (found.code, found.out) == (2, ""), found
        assert found.err.startswith("error: ")
        assert "Traceback" not in found.err
        assert [path.name for path in tmp_path.iterdir()] == ["s.yaml"], "something is in the way of the next try"
        return found.err

    return call


def table_of(folder: Path, title: str) -> dict[str, list]:
    """Columns of a table in results.json."""
    tables = json.loads((folder / "results.json").read_text(encoding="utf-8"))["tables"]
    (table,) = [table for table in tables if table["title"].startswith(title)]
    return {name: column["values"] for name, column in table["columns"].items()}


@pytest.mark.parametrize("method", ["cma", "local"])
@pytest.mark.slow
def test_a_search_from_beginning_to_end(cli, scenario, tmp_path, text, method, each_progress):
    done = cli("tune", "s.yaml", *SMALL, "--method", method)
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

    new = (kept / "s-tuned.yaml").read_text(encoding="utf-8")
    changed = [(a, b) for a, b in zip(text.splitlines(), new.splitlines(), strict=True) if a != b]
    assert len(changed) == 1, "its comments and order are kept"
    assert changed[0][1].startswith("start: {angle: ")
    margins = json.loads(cli("margins", "kept/s-tuned.yaml", "--json").out)
    assert tuned["least disk margin"] == pytest.approx(
        min(margins["columns"]["disk"]["values"] if "columns" in margins else margins["margins"]["disk"])
    )


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--percentile", "50"), "--conditions"),
        (("--conditions", "load.mass2=0.5 kg"), "does not vary"),
        (("--conditions", "load.mass2=+-20 %", "--percentile", "101"), "percentile is 101"),
    ],
)
def test_conditions_that_mean_nothing_are_refused(cli, scenario, arguments, named):
    found = cli("tune", "s.yaml", "--over", "controller.position.kp=1..4 bar/rad", *arguments, "--out", "kept")
    assert (found.code, named in found.err) == (2, True), found.err


@pytest.mark.slow
def test_files_that_scenarios_name_are_found_from_the_new_folder(cli, tmp_path, text, monkeypatch):
    monkeypatch.setattr(TuningProblem, "costs", lambda self, values: values[:, 1])  # what is found does not matter here
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "reference.csv").write_text("time_s,angle_deg\n0,2\n1,2\n", encoding="utf-8")
    far = text.replace("angle: 2 deg", "angle: {class: samples_file, file: reference.csv}")
    assert far != text
    (tmp_path / "a" / "s.yaml").write_text(far, encoding="utf-8")
    (tmp_path / "b" / "s.yaml").write_text(text, encoding="utf-8")
    found = cli("tune", "a/s.yaml", "b/s.yaml", *SMALL)
    assert found.code == 0, found.err
    kept = tmp_path / "kept"
    best = min(read_trials(kept / STUDY), key=lambda trial: (trial.cost, trial.point))
    tuned = [Scenario.read(kept / name) for name in ("s-tuned.yaml", "s-tuned-2.yaml")]
    before = [Scenario.read(tmp_path / name / "s.yaml") for name in "ab"]
    for new, old in zip(tuned, before, strict=True):
        assert new.model_copy(update={"start": old.start}) == old
        assert new.start.stiffness == pytest.approx(11 * (20 / 11) ** best.point[1], rel=1e-5)
    assert tuned[0].signals.angle.file == tmp_path / "a" / "reference.csv"
    assert "# The knee" in (kept / "s-tuned-2.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("known", "believed"), [((), 208e-3), (("--model-follows", "joint.geometry.connector_length"), None)]
)
@pytest.mark.slow
def test_a_tuned_plant_is_known_to_the_controller_if_asked_alone(cli, scenario, tmp_path, monkeypatch, known, believed):
    monkeypatch.setattr(TuningProblem, "costs", lambda self, values: values[:, 0])  # what is found does not matter here
    plant = ("--over", "joint.geometry.connector_length=206..208 mm", *COST, "--iterations", "1", "--out", "kept")
    found = cli("tune", "s.yaml", *plant, *known)
    assert found.code == 0, found.err
    tuned = Scenario.read(tmp_path / "kept" / "s-tuned.yaml")
    assert 206e-3 <= tuned.joint.geometry.connector_length < 208e-3
    true = tuned.joint.geometry.connector_length
    assert tuned.controller.model.geometry.connector_length == pytest.approx(believed or true, rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (SMALL[:-2], "--out DIR"),
        (
            ("--over", "controller.positon.kp"),
            "did you mean 'controller.position.kp'",
        ),  # before the missing --out
        ((*SMALL, "--method", "newton"), "method is 'newton'"),
        ((*SMALL, "--over", "start.angle"), "zero, or not given: there is no range around it"),
        (
            (*SMALL, "--over", "start.angle=0..1 deg"),
            "start.angle is varied twice",
        ),
        ((*SMALL, "--cost", "coupling", "--method", "cma"), "coupling is not defined"),
        ((*SMALL, "--seed", "-1"), "seed is -1"),
        ((*SMALL, "--resume"), "no study to continue; leave out --resume"),
        (("missing.yaml", *SMALL), "missing.yaml"),
    ],
)
def test_a_mistake_is_one_error(mistaken, arguments, named):
    assert named in mistaken("s.yaml", *arguments)


@pytest.mark.parametrize("name", ["s-tuned-2.yaml", "tuning.png"])
def test_files_that_others_put_there_stay(cli, scenario, tmp_path, name):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / name).write_text("mine", encoding="utf-8")
    found = cli("tune", "s.yaml", "s.yaml", *SMALL)
    assert (found.code, found.out) == (2, "")
    assert f"{name}: it already exists; choose another folder, or move the existing file" in found.err
    assert [(path.name, path.read_text(encoding="utf-8")) for path in (tmp_path / "kept").iterdir()] == [(name, "mine")]


@pytest.mark.slow
def test_a_search_in_the_way_is_not_overwritten(cli, scenario, tmp_path):
    asked = ("tune", "s.yaml", *SMALL)
    assert cli(*asked).code == 0
    before = {path: path.read_bytes() for path in (tmp_path / "kept").iterdir()}
    refused = cli(*asked)
    assert (refused.code, refused.out) == (2, "")
    assert "a study exists already; continue it with --resume" in refused.err
    again = cli("tune", "s.yaml", "--resume", "--iterations", "3", "--out", "kept")  # options are those of the study
    assert again.code == 0, again.err
    refused = cli(*asked, "--margin", "2", "--resume")
    assert (refused.code, refused.out) == (2, "")
    assert re.search("gain_margin: .* started with 1.0, not 2.0", refused.err)
    assert {path: path.read_bytes() for path in (tmp_path / "kept").iterdir()} == before
