"""A project as one file: it comes back as it was, and nothing else comes in."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("nicegui")

from mckibben import Scenario, read_dataset
from mckibben.errors import McKibbenError, ParameterError, RangeError, ScenarioError, UnitError
from mckibben.identification import identify
from mckibben.muscle import ExponentialLaw
from mckibben.web import identify as muscle_page
from mckibben.web import project, workbench

RIG = Path(__file__).parents[2] / "examples" / "rig.csv"


def zipped(files):
    kept = io.BytesIO()
    with zipfile.ZipFile(kept, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return kept.getvalue()


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "session"
    made.mkdir()
    return made


def test_an_inner_diameter_gives_the_muscle_a_volume(folder):
    points = read_dataset(RIG)
    fit = identify(ExponentialLaw, points)
    assert muscle_page.keep_muscle(fit, None, points, folder).specimen.volume_terms is None
    length = float(points.table.attrs["initial_length"])
    found = muscle_page.keep_muscle(fit, None, points, folder, "10 mm").specimen.volume_terms
    assert found[0] == pytest.approx(np.pi / 4 * 0.01**2 * length)
    for wrong in ("1 m", "10 bar"):
        with pytest.raises((RangeError, UnitError)):
            muscle_page.keep_muscle(fit, None, points, folder, wrong)


@pytest.mark.slow
def test_a_project_comes_back_in_another_session_and_on_the_command_line(folder, tmp_path):
    points = read_dataset(RIG)
    muscle_page.keep_muscle(identify(ExponentialLaw, points), None, points, folder)
    (folder / "data-upload.csv").write_text("anything", encoding="utf-8")
    text = workbench.START.replace("{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}", "muscle.yaml")
    content = project.pack(folder, text, points)
    other, unzipped = tmp_path / "other", tmp_path / "unzipped"
    other.mkdir()
    found = project.unpack(content, other)
    assert {one.name for one in other.iterdir()} == {"scenario.yaml", "muscle.yaml", "fit.yaml", "points.csv"}
    assert found.points and found.muscle and found.scenario
    means = points.plateau_means().table
    assert all((found.points.table[name] == means[name]).all() for name in ("pressure", "contraction", "force"))
    zipfile.ZipFile(io.BytesIO(content)).extractall(unzipped)
    kept = Scenario.read(unzipped / "scenario.yaml")
    assert kept.joint.muscle1.law == found.muscle.law == found.scenario.joint.muscle1.law
    bench, identification = workbench.Workbench(), muscle_page.IdentificationState()
    project.adopt(found, other, bench, identification)
    assert bench.waiting == text
    assert identification.data is found.points and identification.muscle is found.muscle
    assert project.pack(other, text, identification.data)  # and it goes on


@pytest.mark.parametrize(
    "name",
    [
        "../scenario.yaml",
        "/etc/x.yaml",
        "a/b.yaml",
        "..\\x.yaml",
        "C:x.yaml",
        ".hidden.yaml",
        "x.py",
        "x.yaml/",
        "a\n.csv",
    ],
)
def test_a_file_outside_or_of_another_kind_is_refused(folder, name):
    with pytest.raises(ParameterError):
        project.unpack(zipped({"scenario.yaml": workbench.START, name: "x"}), folder)
    assert not list(folder.iterdir()) and not (folder.parent / "scenario.yaml").exists()


def test_too_much_is_refused(folder, monkeypatch):
    many = {f"file{number}.csv": "x" for number in range(project.MOST_FILES)}
    with pytest.raises(ParameterError):
        project.unpack(zipped({"scenario.yaml": workbench.START, **many}), folder)
    monkeypatch.setattr(project, "LARGEST", 10_000)
    with pytest.raises(ParameterError):
        project.unpack(zipped({"scenario.yaml": workbench.START, "zeros.csv": bytes(20_000)}), folder)
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", zipped({}), zipped({"angle.csv": "x"}), zipped({"scenario.yaml": ""})[:-9]]
)
def test_what_is_no_project_is_refused(folder, content):
    with pytest.raises(ParameterError):
        project.unpack(content, folder)
    assert not list(folder.iterdir())


def test_files_are_checked_by_their_readers_before_they_replace_others(folder):
    (folder / "muscle.yaml").write_text("of before", encoding="utf-8")
    (folder.parent / "secret.yaml").write_text("law: x", encoding="utf-8")
    with pytest.raises(ScenarioError) as found:
        project.unpack(zipped({"muscle.yaml": "specimen: MAS-10-180N-AA-MC-O\nlaw: ../secret.yaml\n"}), folder)
    assert found.value.problems[0].field == "law"
    with pytest.raises(ScenarioError) as found:
        project.unpack(zipped({"scenario.yaml": workbench.START.replace("duration: 6 s", "duration: 6 V")}), folder)
    assert found.value.problems[0].field == "duration" and found.value.problems[0].line
    nested = "joint: {geometry: {from: knee-table-2, connector_length: 208 mm}, muscle: muscle.yaml}\n"
    text = nested + workbench.START[workbench.START.index("load:") :]
    files = {"scenario.yaml": "name: x\n" + text, "muscle.yaml": "specimen: x\nlaw: ../secret.yaml\n"}
    with pytest.raises(McKibbenError):
        project.unpack(zipped(files), folder)
    assert [one.name for one in folder.iterdir()] == ["muscle.yaml"]
    assert (folder / "muscle.yaml").read_text(encoding="utf-8") == "of before"
