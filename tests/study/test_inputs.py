"""Data, laws and joints by name."""

import pytest

from mckibben import catalog
from mckibben.errors import FileError, NotInCatalogError
from mckibben.identification import fit_law
from mckibben.muscle import ChouLaw, ExponentialLaw, ThresholdLaw
from mckibben.scenario.inputs import data_named, geometry_named, law_named, law_type_named


def test_data_of_the_catalog_by_name_and_of_a_file_by_path(tmp_path):
    named = data_named("festo-tool-10mm")
    assert named.table.identical(catalog.dataset("festo-tool-10mm").table)
    named.to_netcdf(tmp_path / "copy.nc")
    assert data_named(str(tmp_path / "copy.nc")).table.identical(named.table)


def test_a_file_of_the_name_of_an_entry_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "festo-tool-10mm").write_text("pressure_bar,contraction_percent,force_N\n1,0,80\n1,5,40\n")
    assert len(data_named("festo-tool-10mm")) == 2


@pytest.mark.parametrize(("name", "named"), [("dmsp", "-martens2017"), ("nobody", "festo-tool-10mm")])
def test_a_name_of_no_dataset_names_those_there_are(tmp_path, monkeypatch, name, named):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NotInCatalogError) as caught:
        data_named(name)
    assert caught.value.value == name and named in caught.value.remedy


@pytest.mark.slow
def test_a_law_by_name_of_a_specimen_and_of_a_fit_file(tmp_path):
    eq3 = law_named("lei-mas-10-180n")
    assert float(eq3.force(0.0, 6e5)) == pytest.approx(584.72)
    chou = law_named("chou", specimen="MAS-10-180N-AA-MC-O")
    assert isinstance(chou, ChouLaw)
    assert float(chou.force(0.0, 6e5)) == pytest.approx(386, abs=0.5)
    fit = fit_law(ExponentialLaw, catalog.dataset("festo-tool-10mm"))
    fit.to_yaml(tmp_path / "fit.yaml")
    read = float(law_named(str(tmp_path / "fit.yaml")).force(0.05, 3e5))
    assert read == pytest.approx(float(fit.law.force(0.05, 3e5)), abs=0.01 * fit.rmse)


def test_the_law_of_a_muscle_file_has_its_threshold(tmp_path):
    text = "specimen: MAS-10-180N-AA-MC-O\nlaw: {class: threshold, law: lei-mas-10-180n, threshold: 30 kPa}\n"
    (tmp_path / "muscle.yaml").write_text(text)
    found = law_named(str(tmp_path / "muscle.yaml"))
    assert isinstance(found, ThresholdLaw)
    assert float(found.threshold) == 3e4


def test_chou_needs_a_specimen():
    with pytest.raises(NotInCatalogError, match="specimen=NAME, a file or one of MAS-10-180N-AA-MC-O, DMSP-10-250"):
        law_named("chou")
    with pytest.raises(NotInCatalogError, match="nobody"):
        law_named("chou", specimen="nobody")


def test_an_unknown_law_names_the_known():
    with pytest.raises(NotInCatalogError, match=r"no law 'x'; give a fit file .* lei-mas-10-180n") as caught:
        law_named("x")
    assert caught.value.value == "x"
    with pytest.raises(FileError, match=r"gone\.yaml"):
        law_named("gone.yaml")


@pytest.mark.parametrize("name", ["exponential", "Exponential", "ExponentialLaw", "EXPONENTIALLAW"])
def test_kinds_of_law_in_any_case(name):
    assert law_type_named(name) is ExponentialLaw


@pytest.mark.parametrize("name", ["", "law", "expo"])
def test_no_other_kind_is_guessed(name):
    with pytest.raises(NotInCatalogError, match=r"chou|exponential") as caught:
        law_type_named(name)
    assert caught.value.value == name


PULLEY = "{class: Pulley, radius: 30 mm, rest_length: 160 mm}"
PATHS = f"path1: {PULLEY}, path2: {PULLEY}"


@pytest.mark.parametrize(
    "text",
    [
        f"{{class: PairedPaths, {PATHS}}}",
        f"{{{PATHS}}}",
        f"geometry: {{{PATHS}}}",
        f"geometry: {{class: PairedPaths, {PATHS}}}",
        f"joint: {{geometry: {{{PATHS}}}}}",  # before there is a muscle
        f"joint: {{geometry: {{class: PairedPaths, {PATHS}}}, muscle: {{specimen: MAS-10-180N-AA-MC-O}}}}",
    ],
)
def test_a_geometry_is_read_with_and_without_its_keys_and_class(tmp_path, text):
    path = tmp_path / "geometry.yaml"
    path.write_text(f"{text}\n")
    assert geometry_named(str(path)).path1.radius == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        (f"path1: {PULLEY}\npth2: {PULLEY}\n", "pth2"),
        (f"joint:\n  geometry:\n    path1: {PULLEY}\n    path2: {{class: Pulley, radius: 30}}\n", "path2.radius"),
        ("joint_length: 370 mm\njoint_radius: 30 mm\n", "connector_length"),
        ("", ""),
        ("name: x\njoint: {}\nload: knee-table-2\n", "controller"),
    ],
)
def test_a_mistake_in_a_geometry_is_one_of_the_geometry(tmp_path, text, field):
    path = tmp_path / "geometry.yaml"
    path.write_text(text)
    with pytest.raises(FileError) as caught:
        geometry_named(str(path))
    assert field in {problem.field for problem in caught.value.problems}
