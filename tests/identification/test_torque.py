"""The law of two equal muscles from torques of their joint, with friction of muscles and joint."""

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset.reading import read_torques
from mckibben.errors import IdentificationError
from mckibben.identification import identify_torque
from mckibben.joint import PairedPaths, Pulley
from mckibben.muscle import ExponentialLaw

KNEE = catalog.joint("knee-table-2").geometry
PULLEYS = PairedPaths(*(Pulley(radius=0.025, rest_length=0.162) for _ in range(2)))
LAW, LENGTH, HALF_WIDTH, JOINT = catalog.law("lei-mas-10-180n"), 0.18, 8.0, 0.15


def torques(folder, geometry, pairs, *, reversing=True, noise=0.02):
    """File of angles back and forth at pairs of pressures [bar], as by an encoder and a torque sensor."""
    once = np.linspace(-25, 25, 16)
    once = np.append(once, once[::-1]) if reversing else once
    side = np.append(np.ones(16), -np.ones(16)) if reversing else np.ones(16)
    angle, side = np.tile(once, len(pairs)), np.tile(side, len(pairs))
    first, second = (np.repeat(values, len(once)) for values in np.transpose(pairs))
    lengths, arms = (np.array(pair) for pair in geometry.paths_and_arms(np.deg2rad(angle)))
    friction = side * HALF_WIDTH * np.array([[1.0], [-1.0]])  # muscle 1 is stretched where the angle rises
    force = np.array(LAW.force(1 - lengths / LENGTH, 1e5 * np.array([first, second])))
    force = np.where(force > 0, force + friction, 0.0)
    torque = force[1] * arms[1] - force[0] * arms[0] - JOINT * side
    torque = torque + noise * np.random.default_rng(0).normal(size=len(angle))
    path = folder / "joint.csv"
    header = "angle_deg,torque_Nm,p1_bar,p2_bar"
    np.savetxt(path, np.transpose([angle, torque, first, second]), "%.6f", ",", header=header, comments="")
    return path


VENTED = [(0.0, 3.0), (0.0, 4.5), (0.0, 6.0), (3.0, 0.0), (4.5, 0.0), (6.0, 0.0)]
BOTH = [(a, b) for a in (3.0, 4.0, 5.0, 6.0) for b in (3.0, 4.5, 6.0)]


@pytest.mark.slow
def test_law_and_both_kinds_of_friction_where_the_moment_arms_vary(tmp_path):
    table = read_torques(torques(tmp_path, KNEE, [*VENTED, *BOTH]), geometry=KNEE)
    fit = identify_torque(ExponentialLaw, table, KNEE, initial_length=LENGTH)
    assert fit.rmse < 0.025 and not [note for note in fit.notes if note.severity.value == "severe"]
    assert fit.force_error < 2.0
    for name, true in (("half_width", HALF_WIDTH), ("joint_friction", JOINT)):
        low, high = fit.intervals[name]
        assert low < true < high
    places = np.array([0.05, 0.1, 0.12]), np.array([4e5, 5e5, 6e5])
    np.testing.assert_allclose(fit.law.force(*places), LAW.force(*places), rtol=0.03)


def test_a_muscle_that_is_slack_separates_the_friction_of_pulleys(tmp_path):
    table = read_torques(torques(tmp_path, PULLEYS, VENTED), geometry=PULLEYS)
    fit = identify_torque(ExponentialLaw, table, PULLEYS, initial_length=LENGTH)
    assert fit.estimates["half_width"] == pytest.approx(HALF_WIDTH, rel=0.1)
    assert fit.estimates["joint_friction"] == pytest.approx(JOINT, rel=0.2)


@pytest.mark.slow
def test_what_the_torque_does_not_show_is_refused_or_said(tmp_path):
    """A force that two muscles on equal pulleys have alike; friction of a motion in one direction."""
    taut = [(5.0, 5.0), (5.0, 6.0), (6.0, 5.0), (5.5, 6.0), (6.0, 5.5), (6.0, 6.0)]
    table = read_torques(torques(tmp_path, PULLEYS, taut), geometry=PULLEYS)
    with pytest.raises(IdentificationError, match="do not determine a1") as refused:
        identify_torque(ExponentialLaw, table, PULLEYS, initial_length=LENGTH)
    assert "vented" in refused.value.remedy
    one_way = read_torques(torques(tmp_path, KNEE, [*VENTED, *BOTH], reversing=False), geometry=KNEE)
    fit = identify_torque(ExponentialLaw, one_way, KNEE, initial_length=LENGTH)
    assert "joint_friction" not in fit.estimates and fit.notes[0].field == "joint_friction"
