import dataclasses

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import ScenarioError
from mckibben.identification import Fit, fit_law, read_law
from mckibben.muscle import Domain, ExponentialLaw, Parameter, PressureAffineLaw, SmoothLaw
from mckibben.units import bar, deg, mm


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fit_law(ExponentialLaw, catalog.dataset("dmsp-10-250-martens2017"))


def same(a: Fit, b: Fit) -> None:
    for field in dataclasses.fields(Fit):
        if field.name == "correlations":
            np.testing.assert_array_equal(a.correlations, b.correlations)
        elif field.name == "standard_errors":
            np.testing.assert_array_equal(list(a.standard_errors.values()), list(b.standard_errors.values()))
            assert list(a.standard_errors) == list(b.standard_errors)
        elif field.name not in ("residuals", "regression"):  # compared by the intervals
            assert getattr(a, field.name) == getattr(b, field.name), field.name


def test_every_number_comes_back_exactly(fit, tmp_path):
    fit.to_yaml(tmp_path / "fit.yaml")
    again = Fit.from_yaml(tmp_path / "fit.yaml")
    same(fit, again)
    np.testing.assert_array_equal(again.residuals, fit.residuals)
    assert again.robust == fit.robust
    assert fit.robust.groups == 16
    assert again.intervals() == fit.intervals()
    assert again.to_text(details=True) == fit.to_text(details=True)
    assert read_law(tmp_path / "fit.yaml") == fit.law
    assert np.sqrt(np.diag(again.robust_covariance)) == pytest.approx(list(fit.robust.standard_errors.values()))
    text = (tmp_path / "fit.yaml").read_text()
    assert "a2: 92.52" in text


def test_repeats_and_directions_of_the_points_come_back(tmp_path):
    chart = catalog.dataset("festo-tool-10mm")
    columns = {name: np.tile(chart.table[name].to_numpy(), 2) for name in ("pressure", "contraction", "force")}
    repeat = np.repeat([0, 1], len(chart))
    labels = {"repeat": repeat, "direction": np.where(repeat, "unloading", "loading")}
    labels["set_pressure"] = np.where(columns["pressure"] > 3 * bar, np.nan, columns["pressure"])
    fit = fit_law(ExponentialLaw, IsobaricDataset.of(**columns, **labels))
    fit.to_yaml(tmp_path / "fit.yaml")
    points = Fit.from_yaml(tmp_path / "fit.yaml").require_regression().points
    for name in labels:
        np.testing.assert_array_equal(points.table[name], fit.require_regression().points.table[name])


@pytest.mark.slow
@pytest.mark.parametrize("law", [ExponentialLaw, SmoothLaw])
def test_a_file_gives_the_same_intervals(law, tmp_path):
    fit = fit_law(law, catalog.dataset("dmsp-10-250-martens2017"))
    assert type(fit.law) is law
    fit.to_yaml(tmp_path / "fit.yaml")
    again = Fit.from_yaml(tmp_path / "fit.yaml")
    ours, theirs = (one.force_intervals([0.0, 0.03, 0.1], 4 * bar) for one in (again, fit))
    np.testing.assert_allclose(ours.confidence.upper, theirs.confidence.upper, rtol=1e-7)
    np.testing.assert_allclose(ours.prediction.upper, theirs.prediction.upper, rtol=1e-7)


def test_outliers_come_back(tmp_path):
    good = catalog.dataset("festo-tool-10mm")
    force = good.force.copy()
    force[30] *= 1.12
    fit = fit_law(ExponentialLaw, IsobaricDataset(good.table.assign(force=("point", force))))
    assert len(fit.outliers) == 1
    fit.to_yaml(tmp_path / "fit.yaml")
    assert Fit.from_yaml(tmp_path / "fit.yaml").outliers == fit.outliers


def test_a_law_written_by_hand(tmp_path):
    path = tmp_path / "law.yaml"
    path.write_text(
        "law:\n  class: chou\n  braid_angle: 25 deg\n  initial_diameter: 10 mm\n"
        "  domain: {contraction_min: -3 %, contraction_max: 25 %, pressure_min: 0 bar, pressure_max: 8 bar}\n"
    )
    law = read_law(path)
    assert (law.braid_angle, law.initial_diameter) == (pytest.approx(25 * deg), pytest.approx(10 * mm))
    assert law.domain == Domain(-0.03, 0.25, 0.0, 8e5)
    with pytest.raises(ScenarioError, match="not the numbers of its fit"):
        Fit.from_yaml(path)


def test_a_broken_file_lists_all_its_problems_with_lines(fit, tmp_path):
    path = tmp_path / "fit.yaml"
    fit.to_yaml(path)
    lines = path.read_text().splitlines()
    number = {line.split(":")[0].strip(): i for i, line in reversed(list(enumerate(lines)))}
    lines[number["a1"]] = "  a1: much"
    lines[number["a2"]] = "  a2: 1 mm"
    lines[number["b1"]] = "  q7: 1 N"
    lines[number["points_used"]] = "  points_used: -3"
    path.write_text("\n".join(lines))
    with pytest.raises(ScenarioError) as error:
        Fit.from_yaml(path)
    found = {p.field: p.line - 1 for p in error.value.problems}
    for field, name in (("law.a1", "a1"), ("law.a2", "a2"), ("law.q7", "b1"), ("fit.points_used", "points_used")):
        assert found[field] == number[name]


@pytest.mark.parametrize(
    ("text", "line", "field"),
    [
        ("", None, ""),
        ("law: {class: hooke}\n", 1, "law"),
        ("law: {class: chou, braid_angle: 25}\n", 1, "law.braid_angle"),
    ],
)
def test_what_is_no_law_is_refused(text, line, field, tmp_path):
    path = tmp_path / "law.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioError) as error:
        read_law(path)
    assert (line, field) in {(p.line, p.field) for p in error.value.problems}
    assert all(p.remedy for p in error.value.problems)


class LinearLaw(PressureAffineLaw):
    a: float
    k: float
    domain: Domain = Domain()

    equation = "F = a p - k eps"
    source = "a test"
    linear_parameters = (Parameter("a", "N/Pa", "N/bar", "force per pressure"), Parameter("k", "N", "N", "stiffness"))

    def pressure_terms(self, contraction):
        return -self.k * contraction, self.a


def test_another_equation_than_the_one_of_the_class_is_refused(tmp_path):
    text = f"law: {{{{class: '{__name__}:LinearLaw', a: 1 N/bar, k: 2 N}}}}\nequation: F = a p {{}} k eps\n"
    (tmp_path / "law.yaml").write_text(text.format("-"))
    assert type(read_law(tmp_path / "law.yaml")) is LinearLaw
    (tmp_path / "law.yaml").write_text(text.format("+"))
    with pytest.raises(ScenarioError) as error:
        read_law(tmp_path / "law.yaml")
    (problem,) = error.value.problems
    assert (problem.line, problem.field) == (2, "equation") and problem.remedy
