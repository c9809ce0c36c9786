import dataclasses
import importlib
import sys
import textwrap

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from mckibben import catalog
from mckibben.component import classes
from mckibben.dataset import IsobaricDataset
from mckibben.errors import FileError, ScenarioError
from mckibben.identification import DatasetSummary, Fit, Grouping, identify, read_law
from mckibben.identification.storage import find_fit
from mckibben.muscle import ChouLaw, Domain, ExponentialLaw, GaussianProcessLaw
from mckibben.units import bar, deg, mm


@pytest.fixture(scope="module")
def fit() -> Fit:
    return identify(ExponentialLaw, catalog.dataset("dmsp-10-250-martens2017"))


def same(a: Fit, b: Fit) -> None:
    for field in dataclasses.fields(Fit):
        if field.name == "correlations":
            np.testing.assert_array_equal(a.correlations, b.correlations)
        elif field.name == "standard_errors":
            np.testing.assert_array_equal(list(a.standard_errors.values()), list(b.standard_errors.values()))
            assert list(a.standard_errors) == list(b.standard_errors)
        elif field.name not in ("residuals", "regression"):  # compared by the intervals
            assert getattr(a, field.name) == getattr(b, field.name), field.name


def test_a_fit_with_classical_errors_alone_comes_back(fit, tmp_path):
    classical = dataclasses.replace(fit, robust=None)
    classical.to_yaml(tmp_path / "fit.yaml")
    again = Fit.from_yaml(tmp_path / "fit.yaml")
    same(classical, again)
    assert again.robust is None


def test_every_number_comes_back_exactly(fit, tmp_path):
    fit.to_yaml(tmp_path / "fit.yaml")
    again = Fit.from_yaml(tmp_path / "fit.yaml")
    same(fit, again)
    np.testing.assert_array_equal(again.residuals, fit.residuals)
    assert again.robust == fit.robust
    assert fit.robust.groups == 16
    assert again.intervals() == fit.intervals()
    assert again.report() == fit.report()
    assert read_law(tmp_path / "fit.yaml") == fit.law
    found = find_fit(tmp_path / "fit.yaml")
    assert np.sqrt(np.diag(found.robust_covariance)) == pytest.approx(list(fit.robust.standard_errors.values()))
    text = (tmp_path / "fit.yaml").read_text()
    assert "# 92.52 N/bar: constant, per pressure" in text


def test_repeats_and_directions_of_the_points_come_back(tmp_path):
    chart = catalog.dataset("festo-tool-10mm")
    columns = {name: np.tile(chart.table[name].to_numpy(), 2) for name in ("pressure", "contraction", "force")}
    repeat = np.repeat([0, 1], len(chart))
    direction = np.where(repeat, "unloading", "loading")
    fit = identify(ExponentialLaw, IsobaricDataset.of(**columns, repeat=repeat, direction=direction))
    fit.to_yaml(tmp_path / "fit.yaml")
    points = Fit.from_yaml(tmp_path / "fit.yaml").require_regression().points
    for name in ("repeat", "direction"):
        np.testing.assert_array_equal(points.table[name], fit.require_regression().points.table[name])


@pytest.mark.slow
@pytest.mark.parametrize("law", [ExponentialLaw, GaussianProcessLaw])
def test_a_file_gives_the_same_intervals(law, tmp_path):
    fit = identify(law, catalog.dataset("dmsp-10-250-martens2017"))
    assert type(fit.law) is law
    fit.to_yaml(tmp_path / "fit.yaml")
    again = Fit.from_yaml(tmp_path / "fit.yaml")
    for by in (None, Grouping.POINT, Grouping.PRESSURE):
        ours, theirs = (one.force_intervals([0.0, 0.03, 0.1], 4 * bar, by=by) for one in (again, fit))
        np.testing.assert_allclose(ours.confidence.upper, theirs.confidence.upper, rtol=1e-7)
        np.testing.assert_allclose(ours.prediction.upper, theirs.prediction.upper, rtol=1e-7)


def test_outliers_come_back(tmp_path):
    good = catalog.dataset("festo-tool-10mm")
    force = good.force.copy()
    force[30] *= 1.12
    fit = identify(ExponentialLaw, IsobaricDataset(good.table.assign(force=("point", force))))
    assert len(fit.outliers) == 1
    fit.to_yaml(tmp_path / "fit.yaml")
    assert Fit.from_yaml(tmp_path / "fit.yaml").outliers == fit.outliers


finite = st.floats(allow_nan=False, allow_infinity=False)
anything = st.text(st.characters(blacklist_categories=("Cs", "Cc", "Cn")), max_size=30)


@given(
    angle=st.floats(0.011, 0.954),
    diameter=st.floats(1e-300, 0.5),
    contraction=st.tuples(st.floats(-0.5, 0.8), st.floats(-0.5, 0.8)).map(sorted),
    pressure=st.tuples(st.floats(-1e8, 1e8), st.floats(-1e8, 1e8)).map(sorted),
    numbers=st.lists(finite, min_size=4, max_size=4),
    texts=st.lists(anything, min_size=3, max_size=3),
    lopo=st.booleans(),
)
@pytest.mark.slow
def test_whatever_is_in_a_fit_comes_back(
    angle, diameter, contraction, pressure, numbers, texts, lopo, fit, tmp_path_factory
):
    path = tmp_path_factory.mktemp("fits") / "fit.yaml"
    e1, rho, rmse, largest = numbers
    odd = Fit(
        law=ChouLaw(angle, diameter, Domain(*contraction, *pressure)),
        standard_errors={"braid_angle": np.nan, "initial_diameter": e1},
        correlations=np.array([[np.nan, np.nan], [np.nan, rho]]),
        rmse=rmse,
        max_error=largest,
        points_used=3,
        points_slack=0,
        leave_one_pressure_out=fit.leave_one_pressure_out if lopo else None,
        warnings=tuple(texts[:1]),
        dataset=DatasetSummary(texts[1], texts[2], tuple(pressure)),
    )
    odd.to_yaml(path)
    same(odd, Fit.from_yaml(path))


def test_a_law_written_by_hand(tmp_path):
    path = tmp_path / "law.yaml"
    path.write_text(
        "law: ChouLaw\n"
        "parameters:\n"
        "  braid_angle: 25 deg\n"
        "  initial_diameter: {estimate: 10, unit: mm}\n"
        "domain:\n"
        "  contraction: {min: -3, max: 25, unit: percent}\n"
        "  pressure: {min: 0, max: 8, unit: bar}\n"
    )
    law = read_law(path)
    assert law.braid_angle == pytest.approx(25 * deg)
    assert law.initial_diameter == pytest.approx(10 * mm)
    assert law.domain == Domain(-0.03, 0.25, 0.0, 8e5)
    assert find_fit(path) is None
    with pytest.raises(ScenarioError) as error:
        Fit.from_yaml(path)
    assert {"residuals", "points", "correlations", "warnings", "dataset"} <= {p.field for p in error.value.problems}


def test_a_broken_file_lists_all_its_problems_with_lines(fit, tmp_path):
    path = tmp_path / "fit.yaml"
    fit.to_yaml(path)
    lines = path.read_text().splitlines()
    number = {line.split(":")[0].strip(): i for i, line in reversed(list(enumerate(lines)))}
    lines[number["a1"]] = (
        "  a1: {estimate: much, standard_error: 1.0, robust_error: 1.0, degrees_of_freedom: 9.0, unit: N}"
    )
    lines[number["a2"]] = (
        "  a2: {estimate: 1.0, standard_error: 1.0, robust_error: 1.0, degrees_of_freedom: 9.0, unit: mm}"
    )
    lines[number["b1"]] = (
        "  q7: {estimate: 1.0, standard_error: 1.0, robust_error: 1.0, degrees_of_freedom: 9.0, unit: N}"
    )
    lines[number["points"]] = "points: {used: -3, slack: 0}"
    path.write_text("\n".join(lines))
    with pytest.raises(ScenarioError) as error:
        Fit.from_yaml(path)
    found = {p.field: p for p in error.value.problems}
    assert {field: p.line - 1 for field, p in found.items()} == {
        "parameters.a1.estimate": number["a1"],
        "parameters.a2.unit": number["a2"],
        "parameters.q7": number["b1"],
        "parameters.b1": number["parameters"],
        "points.used": number["points"],
    }
    assert len(error.value.problems) == 5
    assert found["parameters.a1.estimate"].value == "much"
    assert found["parameters.a2.unit"].unit == "N/Pa"
    assert (found["points.used"].value, found["points.used"].lower) == (-3, 0)


def test_a_changed_digit_is_found_and_meant_changes_are_possible(fit, tmp_path):
    path = tmp_path / "fit.yaml"
    fit.to_yaml(path)
    text = path.read_text()
    changed = text.replace("estimate: -", "estimate: -1", 1)
    path.write_text(changed)
    with pytest.raises(FileError, match="it has changed since it was written"):
        read_law(path)
    path.write_text(changed.rpartition("# sha256")[0])
    assert read_law(path) != fit.law


@pytest.mark.parametrize(
    ("text", "line", "field"),
    [
        ("law: [1", 1, ""),
        ("- 1\n", 1, ""),
        ("", None, ""),
        ("law: HookeLaw\n", 1, "law"),
        ("law: [ChouLaw]\n", 1, "law"),
        ("law: ChouLaw\nparameters: 3\n", 2, "parameters"),
        ("law: ChouLaw\n", 1, "parameters"),
        ("law: ChouLaw\nparameters: {braid_angle: 25}\n", 2, "parameters.braid_angle"),
        ("law: ChouLaw\nparameters:\n  braid_angle: 4,5 deg\n", 3, "parameters.braid_angle"),
    ],
)
def test_what_is_no_law_is_refused(text, line, field, tmp_path):
    path = tmp_path / "law.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioError) as error:
        read_law(path)
    assert (line, field) in {(p.line, p.field) for p in error.value.problems}
    assert all(p.remedy for p in error.value.problems)


def test_no_file(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read: No such file"):
        read_law(tmp_path / "nowhere.yaml")


_LAW = """
    from mckibben.muscle import Domain, Parameter, PressureAffineLaw

    class LinearLaw(PressureAffineLaw):
        a: float
        k: float
        domain: Domain = Domain()

        equation = "{equation}"
        source = "a test"
        linear_parameters = (
            Parameter("a", "N/Pa", "N/bar", "force per pressure"),
            Parameter("k", "N", "N", "stiffness"),
        )

        def pressure_terms(self, contraction):
            return {sign}self.k * contraction, self.a
"""


def imported(folder, monkeypatch, name, equation="F = a p - k eps", sign="-"):
    """A module with a law, which is forgotten after the test."""
    (folder / f"{name}.py").write_text(textwrap.dedent(_LAW.format(equation=equation, sign=sign)))
    monkeypatch.syspath_prepend(folder)
    module = importlib.import_module(name)
    monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, name, module)
    return module.LinearLaw


@pytest.fixture
def two_laws(tmp_path, monkeypatch):
    found = [
        imported(tmp_path, monkeypatch, "storage_one"),
        imported(tmp_path, monkeypatch, "storage_two", "F = a p + k eps", "+"),
    ]
    monkeypatch.setattr(classes, "concrete_subclasses", lambda base: iter(found))
    return found


def test_a_fit_comes_back_with_its_own_class_among_two_of_one_name(two_laws, tmp_path):
    for law in two_laws:
        fit = identify(law, catalog.dataset("dmsp-10-250-martens2017"))
        fit.to_yaml(tmp_path / "fit.yaml")
        assert yaml.safe_load((tmp_path / "fit.yaml").read_text())["law"] == f"{law.__module__}:LinearLaw"
        assert type(read_law(tmp_path / "fit.yaml")) is law
        assert read_law(tmp_path / "fit.yaml") == fit.law


def test_one_name_of_two_laws_is_refused_and_both_are_named(two_laws, tmp_path):
    (tmp_path / "law.yaml").write_text("parameters: {a: 1 N/bar, k: 2 N}\nlaw: LinearLaw\n")
    with pytest.raises(ScenarioError) as error:
        read_law(tmp_path / "law.yaml")
    (problem,) = error.value.problems
    assert (problem.line, problem.field) == (2, "law")
    assert all(law.__module__ in problem.message for law in two_laws)
    (tmp_path / "law.yaml").write_text("parameters: {a: 1 N/bar, k: 2 N}\nlaw: storage_two:LinearLaw\n")
    assert type(read_law(tmp_path / "law.yaml")) is two_laws[1]


@pytest.mark.parametrize("name", ["storage_one:LinearLaw", "LinearLaw"])
def test_another_equation_than_the_one_of_the_class_is_refused(name, two_laws, tmp_path, monkeypatch):
    monkeypatch.setattr(classes, "concrete_subclasses", lambda base: iter(two_laws[:1]))
    text = "law: {}\nparameters: {{a: 1 N/bar, k: 2 N}}\nequation: F = a p {} k eps\n"
    (tmp_path / "law.yaml").write_text(text.format(name, "-"))
    assert type(read_law(tmp_path / "law.yaml")) is two_laws[0]
    (tmp_path / "law.yaml").write_text(text.format(name, "+"))
    with pytest.raises(ScenarioError) as error:
        read_law(tmp_path / "law.yaml")
    (problem,) = error.value.problems
    assert (problem.line, problem.field, problem.value) == (3, "equation", "F = a p + k eps")
    assert "F = a p - k eps" in problem.message
    assert problem.remedy


def test_a_law_that_is_not_imported_needs_an_extension(tmp_path):
    (tmp_path / "law.yaml").write_text("law: storage_nowhere:CubicLaw\nparameters: {a: 1}\n")
    with pytest.raises(ScenarioError) as error:
        read_law(tmp_path / "law.yaml")
    (problem,) = error.value.problems
    assert (problem.line, problem.field) == (1, "law")
    assert "--extension" in problem.remedy


def test_a_domain_may_be_left_out_where_the_class_has_one(two_laws, tmp_path):
    path = tmp_path / "law.yaml"
    path.write_text("law: storage_one:LinearLaw\nparameters: {a: 1 N/bar, k: 2 N}\n")
    assert read_law(path) == two_laws[0](1e-5, 2.0)
