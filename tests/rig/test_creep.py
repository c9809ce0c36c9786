"""Creep on the simulated rig: what the sensor reads at each sample, move by move."""

import dataclasses
import math

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.muscle import MaxwellCreep, Muscle, NoCreep
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
from mckibben.units import bar, mm, percent

PLAIN = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
QUIET = {"force_noise": 0.0, "pressure_noise": 0.0, "regulator_offset": 0.0}
PROTOCOL = IsobaricProtocol(
    pressures=[3 * bar, 5 * bar], step=3 * mm, speed=1 * mm, dwell=2.0, acquisition=4.0, samples=8, repeats=2
)


def test_samples_are_those_of_small_steps_in_time():
    """Euler steps of 1 ms through moves, waits and samples; T/2 is the most that the arm holds."""
    creeping = dataclasses.replace(PLAIN, creep=MaxwellCreep(1500.0, 3.0))
    data = SimulatedIsobaricTest(creeping, **QUIET).run(PROTOCOL, seed=1)
    without = SimulatedIsobaricTest(PLAIN, **QUIET).run(PROTOCOL, seed=1)
    added = data.force - without.force
    length, tension = 0.18 * (1 - data.contraction), np.asarray(PLAIN.force(data.contraction, data.levels))
    step, held, expected = 1e-3, 0.0, []
    for k in range(len(data)):
        new = k == 0 or data.levels[k] != data.levels[k - 1]
        held, travel = (0.0, 0.0) if new else (held, length[k] - length[k - 1])
        for _ in range(round(abs(travel) / (1e-3 * step))):
            held += step * (1500.0 * math.copysign(1e-3, travel) - held / 3)
        held = min(max(held, -tension[k] / 2), tension[k] / 2)
        held *= math.exp(-2 / 3)
        expected.append(held * np.exp(-np.arange(8) * 0.5 / 3))
        held *= math.exp(-4 / 3)
    np.testing.assert_allclose(added, np.mean(expected, axis=1), atol=2e-3)
    np.testing.assert_allclose(data.table["force_spread"], np.std(expected, axis=1), atol=2e-3)
    assert added.max() > 0.9 and added.min() < -0.9
    assert repr(creeping.creep) in data.table.attrs["source"]


def test_without_creep_the_samples_are_what_they_were():
    said = dataclasses.replace(PLAIN, creep=NoCreep())
    one, other = (SimulatedIsobaricTest(muscle).run(PROTOCOL, seed=4) for muscle in (PLAIN, said))
    assert one.table.identical(other.table) and "creep" not in one.table.attrs["source"]


def test_creep_counts_against_the_rating():
    steep = dataclasses.replace(PLAIN, creep=MaxwellCreep(8000.0, 1000.0))
    tight = dataclasses.replace(PROTOCOL, pressures=[6 * bar], force_reserve=4 * percent)
    SimulatedIsobaricTest(PLAIN).run(tight, seed=1)
    with pytest.raises(RangeError, match="creep and regulator offset can take the force to"):
        SimulatedIsobaricTest(steep).run(tight, seed=1)
