"""Torques at angles, measured on a joint, as points of one muscle."""

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import read_columns, read_dataset, read_recording
from mckibben.dataset.reading import read_torques

from .conftest import problems_of, table

KNEE = catalog.joint("knee-table-2")
ANGLES, PRESSURES = (grid.ravel() for grid in np.meshgrid(np.arange(-20, 21, 4.0), [2.0, 3.0, 4.0]))  # deg, bar
LENGTH = float(KNEE.muscle2.specimen.initial_length)
OPTIONS = {"joint": "knee-table-2", "geometry": KNEE.geometry, "initial_length": LENGTH}


def muscle(number: int) -> tuple[np.ndarray, ...]:
    """Contraction [-], force [N] and moment arm [m] of muscle 1 or 2, from the geometry and the law."""
    lengths, arms = KNEE.geometry.paths_and_arms(np.deg2rad(ANGLES))
    contraction = 1 - np.asarray(lengths[number - 1]) / LENGTH
    force = np.maximum(np.asarray(KNEE.muscle2.law.force(contraction, PRESSURES * 1e5)), 0)
    return contraction, force, np.asarray(arms[number - 1])


@pytest.mark.parametrize(("number", "name"), [(2, "Druck"), (1, "Druck"), (2, "p2"), (1, "p1")])
def test_torques_are_points_of_the_muscle_that_their_sign_or_its_pressure_names(put, number, name):
    contraction, force, arm = muscle(number)
    torque = force * arm * (1 if number == 2 else -1)
    path = put(table(f"Winkel [°];Torque [Nm];{name} [bar]", ANGLES, torque, PRESSURES))
    data = read_dataset(path, **OPTIONS)
    np.testing.assert_allclose(data.contraction, contraction, atol=1e-9)
    np.testing.assert_allclose(data.force, force, rtol=1e-8, atol=1e-6)
    assert str(read_columns(path, **OPTIONS)).count(f"of muscle {number}, by the joint") == 2


def test_a_recording_without_a_header_of_forces_at_a_lever_is_read_by_one_recipe(put):
    """Of the shape of public knee recordings: ms, deg, N, kPa, and two marks."""
    contraction, force, arm = muscle(2)
    rows = [98.0 * np.arange(33), ANGLES, force * arm / 0.25, 100 * PRESSURES, 0 * ANGLES + 1, 0 * ANGLES + 1]
    path = put(table("", *rows, sep=",").lstrip())
    names = {"1": "time_ms", "2": "angle_deg", "3": "force_N", "4": "pressure_kPa", "5": "ignore", "6": "ignore"}
    recording = read_recording(path, columns=names, lever=0.25, **OPTIONS)
    assert recording.contraction == pytest.approx(contraction, abs=1e-9)
    assert recording.force == pytest.approx(force, rel=1e-7, abs=1e-6)
    assert recording.time[-1] == pytest.approx(3.136)


@pytest.mark.parametrize("factor", [1e3, 1e-3, -1])
@pytest.mark.parametrize("pair", [False, True])
def test_a_torque_of_wrong_unit_or_sign_is_named_with_its_option(put, factor, pair):
    (_, first, arm1), (_, second, arm2) = muscle(1), muscle(2)
    torque = np.concatenate([second * arm2, -first * arm1])[: 66 if pair else 33] * factor
    pressures = [PRESSURES, 0 * PRESSURES]
    columns = [np.append(*pressures), np.append(*pressures[::-1])] if pair else [PRESSURES]
    angles = np.tile(ANGLES, 2) if pair else ANGLES
    header = "Angle [deg];Moment [mNm];" + ("p2 [bar];p1 [bar]" if pair else "Druck [bar]")
    path = put(table(header, angles, 1e3 * torque, *columns))
    problem, *_ = problems_of(path, read_torques if pair else read_dataset, **OPTIONS)
    assert "Moment [mNm]" in problem.partition(";")[0]
    assert ("=-torque_mN*m'" if factor < 0 else "=torque_UNIT'") in problem


def test_forces_at_a_lever_need_its_arm_and_torques_none(put):
    _, force, arm = muscle(2)
    columns = {"Angle [deg]": ANGLES, "Pressure [bar]": PRESSURES, "Force [N]": force * arm / 0.25}
    at_lever = put(table(";".join(columns), *columns.values()))
    assert any("lever=250 mm" in problem for problem in problems_of(at_lever, **OPTIONS))
    columns["Torque [Nm]"] = force * arm
    both = put(table(";".join(columns), *columns.values()), "both.csv")
    for lever, remedy in ((None, "'Force [N]=ignore'"), (0.25, "leave lever out")):
        (problem,) = problems_of(both, lever=lever, **OPTIONS)
        assert problem.startswith("Torque [Nm]") and remedy in problem


@pytest.mark.slow
def test_angles_without_a_geometry_or_beyond_it_are_asked_about(put):
    _, force, arm = muscle(2)
    path = put(table("Angle [deg];Torque [N*m];Pressure [bar]", ANGLES, force * arm, PRESSURES))
    assert any(problem.startswith("joint: ") for problem in problems_of(path, joint="knee-table-2"))
    assert any("joint=FILE" in problem for problem in problems_of(path))
    tabulated = catalog_table()
    (problem,) = problems_of(path, **OPTIONS | {"geometry": tabulated})
    assert "--column 'Angle [deg]=1*x+0 angle_deg'" in problem
    no_angle = put(table("Torque [N*m];Pressure [bar]", force * arm, PRESSURES), "b.csv")
    assert any("no column for angle" in problem for problem in problems_of(no_angle, **OPTIONS))


def catalog_table():
    """Geometry of measured lengths from -10 to 10 deg."""
    from mckibben.joint import PairedPaths, TabulatedPath

    angles = np.deg2rad(np.linspace(-10, 10, 5))
    lengths = [np.asarray(length).tolist() for length in KNEE.geometry.path_lengths(angles)]
    return PairedPaths(*(TabulatedPath(angles.tolist(), lengths=values) for values in lengths))
