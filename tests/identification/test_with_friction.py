"""A law is fitted with friction where, and only where, loading and unloading differ."""

import dataclasses
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import mckibben as mk
from mckibben import catalog
from mckibben.component.schema import read_component
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification import fit_law, identify_with_friction, shows_hysteresis
from mckibben.identification.loading_path import loop_half_width, with_last_motion
from mckibben.muscle import ExponentialLaw, Muscle, ReynoldsLaw, forces
from mckibben.result import Remark, Severity
from mckibben.units import bar, mm

RIG = Path(__file__).parents[2] / "examples" / "rig.csv"


@pytest.fixture(scope="module")
def rig():
    return mk.read_dataset(RIG)


@pytest.mark.slow
def test_friction_is_fitted_where_loading_and_unloading_differ(rig):
    """The rig's friction is 12 N over 0.5 mm (`mckibben.rig.SimulatedIsobaricTest`)."""
    found = identify_with_friction(ExponentialLaw, rig)
    assert float(found.friction.half_width) == pytest.approx(12.0, rel=0.01)
    assert float(found.friction.presliding_length) == pytest.approx(0.5 * mm, rel=0.02)
    assert found.rmse < 0.1 < 10 < fit_law(ExponentialLaw, rig).rmse
    assert found.law == fit_law(ExponentialLaw, found.hysteresis.corrected_points).law
    assert found.note


@pytest.mark.slow
@pytest.mark.parametrize("friction", [None, False])
@pytest.mark.parametrize("wrong", [0.0, 60.0])
def test_all_points_are_used_slack_or_left_out(rig, friction, wrong):
    force = rig.force.copy()
    force[40] += wrong
    data = mk.IsobaricDataset(rig.table.assign(force=("point", force)))
    found = identify_with_friction(ExponentialLaw, data, friction=friction)
    assert (found.points_read, found.points_slack) == (len(data), int(data.slack.sum()))
    assert found.points_used + found.points_slack + found.points_left_out == found.points_read
    assert found.points_left_out >= len(found.outliers) == (wrong > 0)
    assert {"points_read", "points_used", "points_slack", "points_left_out"} <= found.to_dict()["scalars"].keys()


def test_without_friction_the_fit_is_that_of_identify(rig):
    found = identify_with_friction(ExponentialLaw, rig, friction=False)
    assert found.law == fit_law(ExponentialLaw, rig).law
    assert found.hysteresis is found.friction is None and not found.note


def test_data_of_one_direction_are_fitted_as_before():
    data = catalog.dataset("dmsp-10-250-martens2017")
    found = identify_with_friction(ExponentialLaw, data)
    assert found.law == fit_law(ExponentialLaw, data).law and not found.note
    with pytest.raises(IdentificationError):
        identify_with_friction(ExponentialLaw, data, friction=True)


@pytest.mark.slow
def test_directions_that_do_not_differ_show_no_friction():
    muscle = mk.Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    protocol = mk.IsobaricProtocol(pressures=[2 * bar, 4 * bar, 6 * bar], repeats=1, samples=20)
    data = mk.SimulatedIsobaricTest(muscle, hysteresis=0.0).run(protocol, seed=2)
    assert len(data.directions) == 2 and not shows_hysteresis(data)
    found = identify_with_friction(ExponentialLaw, data)
    assert found.hysteresis is None and not found.note


@pytest.mark.slow
def test_friction_does_not_depend_on_the_form_of_the_law(rig):
    """The misfit of this law, 54 N, is several times the friction."""
    found, other = (identify_with_friction(law, rig) for law in (ReynoldsLaw, ExponentialLaw))
    assert float(found.friction.half_width) == pytest.approx(float(other.friction.half_width), rel=1e-3)
    assert found.hysteresis.rmse > 40 and other.hysteresis.rmse < 0.1
    assert found.law == fit_law(ReynoldsLaw, found.hysteresis.corrected_points).law


def steps_of_pressure(half_width: float, *, left: float = 1.0, seed: int = 0) -> mk.IsobaricDataset:
    """Four pressures at each of ten lengths, which are reached from both sides; a part of the friction is left then."""
    rng, law, rows = np.random.default_rng(seed), catalog.law("lei-mas-10-180n"), []
    for number, eps in enumerate(np.array([0, 2, 4, 6, 8, 10, 8, 6, 4, 2]) / 100):
        side, common = 0 if not number else -1 if number < 6 else 1, rng.normal(0, 0.2)
        for step, pressure in enumerate(np.array([3, 4, 5, 6]) * bar):
            friction = side * half_width * (left if step else 1.0)
            force = float(law.force(eps, pressure)) + friction + common + rng.normal(0, 0.2)
            word = "" if step else {0: "", -1: "unloading", 1: "loading"}[side]
            rows.append((pressure, eps, force, word, "filling" if step else "", 5.0 * len(rows)))
    names = "pressure", "contraction", "force", "direction", "phase", "time"
    columns = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))
    return mk.IsobaricDataset.of(**columns, initial_length=180 * mm)


@pytest.mark.slow
def test_at_fixed_lengths_the_friction_stays_as_the_last_motion_left_it():
    found = identify_with_friction(ExponentialLaw, steps_of_pressure(8.0))
    error = found.hysteresis.standard_errors["half_width"]
    assert abs(float(found.friction.half_width) - 8.0) < 2 * error < 1.0
    assert "friction" not in {note.field for note in found.notes}
    truth = np.asarray(catalog.law("lei-mas-10-180n").force(0.05, np.array([3.5, 5.5]) * bar))
    band = found.force_intervals(0.05, np.array([3.5, 5.5]) * bar).confidence
    assert band.contains(truth).all() and np.all(band.upper - band.lower < 4.0)
    assert identify_with_friction(ExponentialLaw, steps_of_pressure(0.0)).hysteresis is None


def test_a_frame_that_yields_to_the_pressure_releases_the_friction_of_the_motion():
    """The first points of each length have it whole, whatever the others have; the law is not free of it."""
    found = identify_with_friction(ExponentialLaw, steps_of_pressure(8.0, left=0.3))
    assert abs(float(found.friction.half_width) - 8.0) < 2 * found.hysteresis.standard_errors["half_width"] < 1.0
    assert "friction" in {note.field for note in found.remarks() if note.severity is Severity.WARNING}


@pytest.mark.slow
def test_the_interval_of_the_friction_at_fixed_lengths_holds_and_is_not_far_wider_than_its_scatter():
    tests = [with_last_motion(steps_of_pressure(8.0, seed=seed)) for seed in range(100)]
    found = [loop_half_width(means, ~means.slack) for means in tests]
    errors, stated = np.array(found).T - np.array([[8.0], [0.0]])
    assert np.mean(np.abs(errors) < 1.96 * stated) > 0.9
    assert np.median(stated) < 3 * errors.std()


def test_reversed_directions_are_named(rig):
    other = {"loading": "unloading", "unloading": "loading"}
    directions = [other[str(one)] for one in rig.table["direction"].to_numpy()]
    found = identify_with_friction(
        ExponentialLaw, mk.IsobaricDataset(rig.table.assign(direction=("point", directions)))
    )
    assert found.hysteresis is None and "below" in found.note


@pytest.mark.slow
def test_the_muscle_has_law_and_friction_of_the_fit(rig):
    found = identify_with_friction(ExponentialLaw, rig)
    muscle = found.muscle(mk.Specimen("mine", 0.2))
    assert (muscle.law, muscle.friction) == (found.law, found.friction)
    assert float(found.predict(0.1, 3 * bar)) == pytest.approx(float(muscle.force(0.1, 3 * bar)))
    doubtful = dataclasses.replace(found.hysteresis, notes=(Remark.warning("half_width", "at a bound"),))
    warned = dataclasses.replace(found, hysteresis=doubtful)
    assert warned.warnings == (*found.warnings, "at a bound")
    assert all(text in warned.to_text(width=500, details=True) for text in ("at a bound", found.note))
    assert found.plot().axes
    for given, volume in ({"fill": 30e-6}, 30e-6), ({"diameter": 12 * mm}, np.pi / 4 * 0.012**2 * 0.2):
        assert float(found.muscle(mk.Specimen("mine", 0.2), **given).specimen.volume(0.0)) == pytest.approx(volume)
    with pytest.raises(RangeError):
        found.muscle(mk.Specimen("mine", 0.2), diameter=12.0)
    unknown = identify_with_friction(ExponentialLaw, catalog.dataset("dmsp-10-250-martens2017"))
    del unknown.points.table.attrs["initial_length"]
    with pytest.raises(IdentificationError):
        unknown.muscle()


def _slow_loop(tmp_path, *, wrong_row=None):
    """A file of slow loops at three pressures, with friction of 10 % of the tension that reverses over 0.8 mm."""
    rng, length, friction, lines = np.random.default_rng(1), 220.0, 0.0, ["pressure_bar,length_mm,force_N"]
    law = catalog.law("lei-mas-10-180n")
    contraction = 0.23 * (1 - np.cos(np.linspace(0, 2 * np.pi, 80))) / 2
    for level in (2.0, 3.5, 5.0):
        tension = np.maximum(np.asarray(law.force(contraction, level * bar)), 0)
        for stretch, eps, force in zip(-np.diff(contraction, prepend=0), contraction, tension, strict=True):
            friction = np.clip(friction + stretch * length / 0.8, -1, 1)
            measured = force * (1 + 0.1 * friction) + rng.normal(0, 0.5)
            measured += 150.0 * (len(lines) == wrong_row)
            lines.append(f"{level + rng.normal(0, 0.005):.4f},{length * (1 - eps):.3f},{measured:.3f}")
    path = tmp_path / "loops.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.slow
def test_friction_that_reverses_makes_no_row_of_a_slow_loop_an_outlier(tmp_path):
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        data = mk.read_dataset(_slow_loop(tmp_path), initial_length=220 * mm)
    assert not [one for one in heard if "contradict" in str(one.message)]
    found = identify_with_friction(ExponentialLaw, data)
    assert found.hysteresis is not None
    assert found.outliers == fit_law(ExponentialLaw, data).outliers == ()


def test_a_wrong_force_in_a_slow_loop_is_an_outlier(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = mk.read_dataset(_slow_loop(tmp_path, wrong_row=100), initial_length=220 * mm, accept=["order"])
    assert [one.row for one in fit_law(ExponentialLaw, data).outliers] == [100]


@pytest.mark.slow
def test_a_saved_fit_has_the_muscle_for_scenarios(rig, tmp_path):
    """As the command writes it, with law and friction of the fit; without an initial length there is none."""
    fit = identify_with_friction(ExponentialLaw, rig)
    assert {"fit.yaml", "muscle.yaml", "results.json", "fit.png"} <= {*fit.save(tmp_path)}
    muscle = read_component(Muscle, tmp_path / "muscle.yaml")
    contraction, pressure = np.linspace(0.0, 0.15, 4), 3.0 * bar
    predicted = np.maximum(forces(muscle.law, contraction, pressure), 0.0)
    np.testing.assert_allclose(predicted, fit.predict(contraction, pressure), atol=0.01 * fit.hysteresis.rmse)
    for name in ("half_width", "presliding_length"):
        moved = float(getattr(muscle.friction, name)) - float(getattr(fit.friction, name))
        assert 0 < abs(moved) <= 0.05 * fit.hysteresis.standard_errors[name]
    digits = re.search(r"half_width: ([0-9.]+) N", (tmp_path / "muscle.yaml").read_text(encoding="utf-8"))
    assert len(digits[1]) <= 7  # 12.0014, of an error of 2.5 mN
    unknown = IsobaricDataset(rig.table.assign_attrs(specimen="", initial_length=None))
    bare = identify_with_friction(ExponentialLaw, unknown, friction=False)
    assert "muscle.yaml" not in bare.save(tmp_path, force=True) and not (tmp_path / "muscle.yaml").exists()
