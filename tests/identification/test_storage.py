import re

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import ScenarioError
from mckibben.identification import Fit, fit_law, read_law
from mckibben.muscle import Domain, ExponentialLaw, Parameter, PressureAffineLaw, SmoothLaw, forces
from mckibben.units import bar, deg, mm


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fit_law(ExponentialLaw, catalog.dataset("dmsp-10-250-martens2017"))


@pytest.mark.parametrize("law", [ExponentialLaw, pytest.param(SmoothLaw, marks=pytest.mark.slow)])
def test_a_file_gives_the_same_force_and_intervals_with_the_digits_that_the_residuals_justify(law, tmp_path):
    fit = fit_law(law, catalog.dataset("dmsp-10-250-martens2017"))
    assert type(fit.law) is law
    fit.to_yaml(tmp_path / "fit.yaml")
    again, points = Fit.from_yaml(tmp_path / "fit.yaml"), fit.require_regression().points
    assert read_law(tmp_path / "fit.yaml") == again.law
    np.testing.assert_allclose(again.residuals, fit.residuals, atol=0.01 * fit.rmse)
    np.testing.assert_allclose(again.correlations, fit.correlations, atol=1e-5)
    assert again.robust.groups == fit.robust.groups == 16 and again.notes == fit.notes
    for ours, theirs in ((again, fit), (again.robust, fit.robust)):
        assert ours.standard_errors == pytest.approx(theirs.standard_errors, rel=1e-5)
    ours, theirs = (one.force_intervals([0.0, 0.03, 0.1], 4 * bar) for one in (again, fit))
    for name in ("confidence", "prediction"):
        ends = (getattr(one, name).upper for one in (ours, theirs))
        np.testing.assert_allclose(*ends, atol=0.01 * fit.rmse)
    again.to_yaml(tmp_path / "again.yaml")
    assert read_law(tmp_path / "again.yaml") == again.law
    written = re.findall(r"-?\d\.?\d*e?-?\d*", (tmp_path / "fit.yaml").read_text().split("equation:")[0])
    assert np.mean([len(number.lstrip("-").replace(".", "")) for number in written]) < 7
    assert points.pressure.tolist() == again.require_regression().points.pressure.tolist()


def test_a_fit_without_noise_keeps_its_digits(tmp_path):
    pressure, contraction = (values.ravel() for values in np.meshgrid(np.arange(1, 7) * bar, np.linspace(0, 0.2, 9)))
    law = ExponentialLaw(1 / 3, 2e-3 / 3, 200 / 3, -2e-3, 40 / 3, 1e-4 / 3, decay=20 / 3)
    data = IsobaricDataset.of(pressure=pressure, contraction=contraction, force=forces(law, contraction, pressure))
    fit = fit_law(ExponentialLaw, data)
    fit.to_yaml(tmp_path / "fit.yaml")
    assert Fit.from_yaml(tmp_path / "fit.yaml").estimates == pytest.approx(fit.estimates, rel=1e-8)


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


def test_outliers_come_back(tmp_path):
    good = catalog.dataset("festo-tool-10mm")
    force = good.force.copy()
    force[30] *= 1.12
    fit = fit_law(ExponentialLaw, IsobaricDataset(good.table.assign(force=("point", force))))
    assert len(fit.outliers) == 1
    fit.to_yaml(tmp_path / "fit.yaml")
    (back,), (outlier,) = Fit.from_yaml(tmp_path / "fit.yaml").outliers, fit.outliers
    assert back.place == outlier.place and back.force == pytest.approx(outlier.force, rel=1e-5)


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
