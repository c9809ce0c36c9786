import dataclasses

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.identification import Fit, find_outliers, fit_law, read_law
from mckibben.muscle import ChouLaw, Domain, ExponentialLaw, HuntLaw, Parameter, PressureAffineLaw, SarosiLaw
from mckibben.muscle.slopes import unphysical
from mckibben.result import Severity
from mckibben.units import bar, deg, mm, percent

EQ_3 = catalog.law("lei-mas-10-180n")
RIG = read_dataset("examples/rig.csv")


def texts(fit):
    """All remarks on a fit, details too."""
    return [f"{note.text}; {note.remedy}" for note in fit.notes]


def grid(law, pressures=None, contractions=None, noise=0.0, seed=1, **more) -> IsobaricDataset:
    """Points of a law, where it pulls."""
    pressures = np.arange(13) * 0.5 * bar if pressures is None else pressures
    contractions = np.linspace(-3, 25, 29) * percent if contractions is None else contractions
    pressure, contraction = (a.ravel() for a in np.meshgrid(pressures, contractions, indexing="ij"))
    force = np.asarray(law.force(contraction, pressure))
    force = force + noise * np.random.default_rng(seed).normal(size=force.shape)
    return IsobaricDataset.of(pressure=pressure, contraction=contraction, force=np.maximum(force, 0), **more)


# --- outliers ---


@pytest.mark.parametrize(
    ("row", "shift"), [(40, 40.0), (100, -40.0), (10 + int(np.argmin(RIG.taut.contraction[10:])), 60.0)]
)
def test_a_single_wrong_force_is_named_and_left_out(row, shift):
    table = RIG.taut.table.copy(deep=True)
    force = table["force"].to_numpy().copy()
    force[row] += shift
    table["force"] = ("point", force)
    fit = fit_law(ExponentialLaw, IsobaricDataset(table))
    (outlier,) = fit.outliers
    assert (outlier.row, outlier.force) == (row + 1, force[row])
    assert outlier.expected == pytest.approx(force[row] - shift, abs=0.5 * abs(shift))
    assert fit.points_used == len(force) - 1
    assert any(f"row {row + 1}" in warning for warning in texts(fit))


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0.88, 10.0])
def test_a_wrong_number_changes_no_coefficient_by_more_than_its_standard_error(wrong):
    """12 % too little, and a decimal slip."""
    good = grid(EQ_3, noise=1.0)
    row = int(np.argmin(np.abs(good.force - 250)))
    force = good.force.copy()
    force[row] *= wrong
    bad = IsobaricDataset(good.table.assign(force=("point", force)))
    clean, robust, plain = (
        fit_law(ExponentialLaw, data, robust=r) for data, r in ((good, True), (bad, True), (bad, False))
    )
    assert [one.row for one in robust.outliers] == [row + 1]
    for name, error in clean.standard_errors.items():
        assert abs(robust.estimates[name] - clean.estimates[name]) < error
    assert plain.rmse > 2 * clean.rmse


@pytest.mark.slow
@pytest.mark.parametrize("row", [40, 80])
def test_a_wrong_number_is_named_where_the_law_differs_from_a_smooth_surface(row):
    """Hunt's law does by more than this noise, at more than 5 % of the points."""
    law = fit_law(HuntLaw, catalog.dataset("dmsp-10-250-martens2017")).law
    data = grid(law, np.linspace(0, 6, 8) * bar, np.linspace(0, 24, 13) * percent, noise=0.05, slack_force=2.5)
    force = data.force.copy()
    force[row] *= 1.12
    found = find_outliers(IsobaricDataset(data.table.assign(force=("point", force))))
    assert [one.row for one in found] == [row + 1]


@pytest.mark.slow
@pytest.mark.parametrize(("count", "noise", "seed"), [(13, 0.05, 2), (16, 0.3, 1)])
def test_a_good_point_where_the_law_differs_from_a_smooth_surface_is_no_outlier(count, noise, seed):
    """Its error is that of a contraction that is 0.1 % off, or of a load cell."""
    law = fit_law(HuntLaw, catalog.dataset("dmsp-10-250-martens2017")).law
    contractions = np.linspace(0, 24, count) * percent
    assert find_outliers(grid(law, np.linspace(0, 6, 8) * bar, contractions, noise, seed, slack_force=2.5)) == ()


@pytest.mark.slow
@pytest.mark.parametrize("clipped", [False, True])
def test_good_points_are_named_in_one_data_set_of_a_hundred(clipped):
    """Slack readings scatter about 0 N, or are clipped there: three of 40 have a probability of 1 %."""
    points = grid(EQ_3, np.arange(1, 7) * bar, np.linspace(0, 20, 11) * percent)
    named, missed = 0, 0
    for seed in range(40):
        force = points.force + np.random.default_rng(seed).normal(size=len(points))
        force = np.maximum(force, 0) if clipped else force
        data = IsobaricDataset.of(pressure=points.pressure, contraction=points.contraction, force=force)
        missed += bool(np.any(~data.slack & (points.force == 0)))
        named += bool(find_outliers(data))
    assert named <= 2
    assert missed <= 6


# --- recovery -----------------------------------------------------------------------------------------------


def test_domain_is_the_range_of_the_points_used():
    data = catalog.dataset("dmsp-10-250-martens2017")
    assert fit_law(ExponentialLaw, data).law.domain == Domain(0.0, 0.184, 68750.0, 650000.0)


# --- against other solvers ----------------------------------------------------------------------------------


def exponential(x, a1, a2, b1, b2, c1, c2, decay):
    """Eq. 2 in bar and percent."""
    eps, p = x
    return a1 + a2 * p + (b1 + b2 * p) * eps + (c1 + c2 * p) * np.exp(-decay * eps)


def test_estimates_errors_and_correlations_are_those_of_curve_fit():
    from scipy.optimize import curve_fit

    data = catalog.dataset("dmsp-10-250-martens2017")
    fit, taut = fit_law(ExponentialLaw, data), data.taut
    x = taut.contraction / percent, taut.pressure / bar
    start = [-245.8, 109, 3.216, -3.442, 255.6, -13.18, 0.3]
    values, covariance = curve_fit(exponential, x, taut.force, p0=start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    errors = np.sqrt(np.diag(covariance))
    scales = np.array([1, 1 / bar, 1 / percent, 1 / bar / percent, 1, 1 / bar, 1 / percent])
    np.testing.assert_allclose(list(fit.estimates.values()), values * scales, rtol=1e-5)
    np.testing.assert_allclose(list(fit.standard_errors.values()), errors * scales, rtol=1e-4)
    np.testing.assert_allclose(fit.correlations, covariance / np.outer(errors, errors), atol=1e-4)


class PlaneLaw(PressureAffineLaw):
    """F = a + b p + c eps: linear in all its parameters."""

    a: float
    b: float
    c: float
    domain: Domain = Domain()

    equation = "F = a + b p + c eps"
    source = "these tests"
    linear_parameters = (
        Parameter("a", "N", "N", "constant"),
        Parameter("b", "N/Pa", "N/bar", "per pressure", lower=0.0),
        Parameter("c", "N", "N/percent", "per contraction"),
    )

    def pressure_terms(self, contraction):
        return self.a + self.c * contraction, self.b + 0 * contraction


def test_a_linear_law_is_ordinary_least_squares():
    data = grid(PlaneLaw(700.0, 1e-4, -900.0), noise=3.0)
    fit = fit_law(PlaneLaw, data)
    design = np.stack([np.ones(len(data)), data.pressure / bar, data.contraction], axis=1)
    expected, rss, *_ = np.linalg.lstsq(design, data.force, rcond=None)
    covariance = np.linalg.inv(design.T @ design) * rss / (len(data) - 3)
    scales = np.array([1.0, 1 / bar, 1.0])
    np.testing.assert_allclose(list(fit.estimates.values()), expected * scales, rtol=1e-11)
    errors = np.sqrt(np.diag(covariance)) * scales
    np.testing.assert_allclose(list(fit.standard_errors.values()), errors, rtol=1e-10)


# --- errors at unseen pressures -----------------------------------------------------------------------------


@pytest.mark.slow
def test_leaving_one_pressure_out_equals_a_loop_over_identify():
    data = grid(EQ_3, pressures=np.arange(1, 7) * bar, noise=2.0)
    cross_validation = fit_law(ExponentialLaw, data).leave_one_pressure_out
    residuals = []
    for pressure in data.taut.pressures:
        taut = data.taut
        law, held_out = fit_law(ExponentialLaw, taut.select(taut.levels != pressure)).law, taut.at(pressure)
        error = held_out.force - np.asarray(law.force(held_out.contraction, held_out.pressure))
        assert cross_validation.by_level[pressure] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6)
        residuals.append(error)
    pooled = np.concatenate(residuals)
    assert cross_validation.rmse == pytest.approx(np.sqrt(np.mean(pooled**2)), rel=1e-6)
    assert cross_validation.max_error == pytest.approx(np.abs(pooled).max(), rel=1e-6)


# --- too little data ----------------------------------------------------------------------------------------


def test_too_few_points():
    data = grid(EQ_3, pressures=[5 * bar, 6 * bar], contractions=[0.0, 0.05, 0.1])
    with pytest.raises(IdentificationError, match=r"6 taut points .* 7 parameters .* measure at least 8") as error:
        fit_law(ExponentialLaw, data)
    assert (error.value.value, error.value.lower) == (6, 8)


@pytest.mark.parametrize(
    ("pressures", "contractions", "unidentifiable"),
    [
        ([3 * bar, 4 * bar, 5 * bar, 6 * bar], [0.02, 0.08], "a1"),  # two contractions
        ([3 * bar, 4 * bar, 5 * bar, 6 * bar], [0.0, 0.05, 0.1], "a1"),  # three
    ],
)
def test_a_singular_design_names_what_it_does_not_determine(pressures, contractions, unidentifiable):
    data = grid(EQ_3, pressures=pressures, contractions=contractions, noise=0.5)
    with pytest.raises(IdentificationError, match=r"not determine .*condition number.*; measure at more") as error:
        fit_law(ExponentialLaw, data)
    assert unidentifiable in str(error.value)


# --- what is said, not hidden -------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_parameter_at_its_bound_is_said():
    law = ChouLaw(54.6 * deg, 10 * mm)  # beyond the 54 deg of the range
    contractions = np.linspace(-0.5, -0.2, 20)
    fit = fit_law(ChouLaw, grid(law, contractions=contractions))
    assert fit.law.braid_angle == pytest.approx(54 * deg)
    assert any("braid_angle is at the bound of its range 5 deg .. 54 deg" in w for w in texts(fit))
    assert np.isnan(fit.standard_errors["braid_angle"])
    assert np.isfinite(fit.standard_errors["initial_diameter"])


def test_the_domain_is_that_of_measured_pressures_that_the_set_ones_are_far_from():
    set_pressure = np.repeat(np.arange(1, 9) * bar, 29)  # a compressor of 5.2 bar
    data = grid(EQ_3, pressures=np.minimum(np.arange(1, 9), 5.2) * bar, set_pressure=set_pressure)
    fit = fit_law(ExponentialLaw, data)
    assert float(fit.law.domain.pressure_max) == pytest.approx(5.2 * bar)
    assert any("2.8 bar" in warning for warning in texts(fit))
    near = grid(EQ_3, pressures=np.arange(1, 9) * 0.99 * bar, set_pressure=set_pressure)
    assert float(fit_law(ExponentialLaw, near).law.domain.pressure_max) == 8 * bar


def test_slack_points_do_not_matter():
    data = grid(EQ_3, noise=0.5)
    assert data.slack.any()
    whole, taut = fit_law(ExponentialLaw, data), fit_law(ExponentialLaw, data.taut)
    assert whole.estimates == taut.estimates
    assert whole.points_slack == np.count_nonzero(data.slack)
    assert taut.points_slack == 0


@pytest.mark.parametrize(("offset", "severity"), [(0.0, Severity.NOTE), (-20.0, Severity.WARNING)])
def test_what_the_forces_say_of_the_zero_of_the_load_cell(offset, severity):
    """Strokes that end where the muscle is just slack, and no more points of a slack muscle."""
    data = grid(EQ_3, np.arange(3, 7) * bar, np.linspace(0, 5, 9) * percent)
    ends = grid(EQ_3, np.arange(3, 7) * bar, [0.3]) if offset else data.select(np.zeros(len(data), bool))
    columns = [np.append(getattr(data, name), getattr(ends, name)) for name in ("pressure", "contraction", "force")]
    force = columns[2] + offset + 0.3 * np.random.default_rng(0).normal(size=len(columns[2]))
    points = IsobaricDataset.of(pressure=columns[0], contraction=columns[1], force=force)
    (note,) = [note for note in fit_law(ExponentialLaw, points).notes if "zero" in note.text]
    assert (note.field, note.severity) == ("force", severity) and "slack" in note.remedy


def test_lone_points_of_a_slack_muscle_show_the_zero_and_are_no_errors():
    law = catalog.law("lei-mas-10-180n")
    points = grid(law, np.arange(2, 6) * bar, np.linspace(0, 16, 17) * percent)
    points = points.select(points.force > 10)
    columns = [
        np.append(getattr(points, name), value)
        for name, value in (("pressure", 2 * bar), ("contraction", 0.16), ("force", 0.0))
    ]
    force = columns[2] + 6 + 0.2 * np.random.default_rng(0).normal(size=len(columns[2]))
    fit = fit_law(ExponentialLaw, IsobaricDataset.of(pressure=columns[0], contraction=columns[1], force=force))
    (outlier,) = fit.outliers
    assert outlier.row == len(force) and outlier.expected < 0
    (note,) = [note for note in fit.notes if note.severity is Severity.WARNING]
    assert f"row {len(force)}" in note.text and "slack" in note.text and "zero" in note.remedy


def narrow(contraction, pressure_max, diameter=20e-3):
    """Noisy points of an ideal braid within a narrow window of contractions."""
    contraction, pressure = np.meshgrid(np.linspace(*contraction, 12), np.linspace(pressure_max / 6, pressure_max, 6))
    force = np.asarray(ChouLaw(25 * deg, diameter).force(contraction, pressure))
    force = force + np.random.default_rng(1).normal(0, 0.01 * force.max(), force.shape)
    columns = {"pressure": pressure, "contraction": contraction, "force": force}
    return IsobaricDataset.of(**{name: values.ravel() for name, values in columns.items()}, slack_force=0.0)


@pytest.mark.parametrize("window", [(0.0, 0.03), (0.10, 0.13)])
@pytest.mark.parametrize("kind", [ExponentialLaw, SarosiLaw])
def test_terms_that_cancel_in_a_narrow_window_are_no_error(kind, window, tmp_path):
    data = narrow(window, 8e5, diameter=80e-3)
    found = fit_law(kind, data)
    assert found.rmse < 0.02 * data.force.max()
    found.to_yaml(tmp_path / "fit.yaml")
    read = Fit.from_yaml(tmp_path / "fit.yaml").predict(data.contraction, data.pressure)
    np.testing.assert_allclose(read, found.predict(data.contraction, data.pressure), atol=0.01 * found.rmse)


@pytest.mark.parametrize("size", [0.0, 40.0])
def test_residuals_far_above_the_others_are_a_warning_by_size(size):
    data = grid(EQ_3, noise=0.5, slack_force=2.0)
    force = data.force.copy()
    rows = np.flatnonzero(~data.slack)[[20, 70, 110]]
    force[rows] += size
    fit = fit_law(ExponentialLaw, IsobaricDataset(data.table.assign(force=("point", force))), robust=False)
    remarks = [note for note in fit.notes if note.field == "max_error"]
    assert [note.severity for note in remarks] == [Severity.WARNING] * (size > 0)
    assert all(note.text.startswith("3 of ") for note in remarks)


def test_a_law_in_a_file_that_no_muscle_has_is_named(tmp_path):
    file = tmp_path / "law.yaml"
    file.write_text("law: {class: reynolds, f0: 300 N, f1: -10 N/bar, k0: 500 N, k1: 100 N/bar}")
    with pytest.warns(McKibbenWarning, match="law.yaml.*falls with pressure"):
        read_law(file)


def test_a_wrong_number_is_found_among_few_contractions():
    data = narrow((0.0, 0.2), 6e5)
    assert find_outliers(data) == ()
    force = data.force.copy()
    force[30] *= 5
    (outlier,) = find_outliers(IsobaricDataset(data.table.assign(force=("point", force))))
    assert (outlier.row, outlier.force, outlier.contraction) == (31, force[30], data.contraction[30])


def test_a_law_is_physical_if_its_force_falls_with_contraction_and_rises_with_pressure():
    law = catalog.law("lei-mas-10-180n")
    assert unphysical(law) == ""
    falling = dataclasses.replace(law, **{name: -float(getattr(law, name)) for name in ("a2", "b2", "c2")})
    assert "falls with pressure" in unphysical(falling)
    rising = dataclasses.replace(law, b1=float(law.b1) + 1e4)
    assert "rises with contraction" in unphysical(rising)
    hooked = dataclasses.replace(law, c1=-5e-4, c2=0.0, decay=300.0)  # it rises over less than 0.3 % of contraction
    assert "rises with contraction at -3 %" in unphysical(hooked)
    assert "no force" in unphysical(HuntLaw(254.3e3, 1230.0, 192e3, 0.16, Domain(-0.03, 0.2, 0.0, 6e5)))


def test_a_law_at_a_bound_that_describes_the_points_is_a_note_and_else_a_warning():
    """The decay of 0.6 per metre is below its range; noise of 30 N is 6 % of the force."""
    law = ExponentialLaw(100.0, 1e-3, 200.0, -2e-3, 4e4, 1e-2, decay=0.6)
    for noise, severity in ((0.5, Severity.NOTE), (2000.0, Severity.WARNING)):
        fit = fit_law(ExponentialLaw, grid(law, noise=noise), robust=False)
        severities = {note.severity for note in fit.notes if note.field == "decay"}
        assert not severities or severities == {severity}
