"""Creep from the samples of plateaus of the simulated rig, whose truth is known."""

import dataclasses
import math

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification.creep import identify_creep
from mckibben.identification.friction import identify_hysteresis
from mckibben.muscle import MaxwellCreep, Muscle, NoCreep
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
from mckibben.units import bar

SPECIMEN, LAW = catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n")
PROTOCOL = IsobaricProtocol(pressures=[2 * bar, 4 * bar, 6 * bar], repeats=2, samples=100, acquisition=5.0)
TIMES = {"interval": 0.05, "dwell": PROTOCOL.dwell, "speed": PROTOCOL.speed}


def measured(creep, seed, protocol=PROTOCOL, **sensor):
    muscle = Muscle(SPECIMEN, LAW, creep=creep)
    return SimulatedIsobaricTest(muscle, **{"force_noise": 0.1, **sensor}).run(protocol, seed=seed)


@pytest.fixture(scope="module")
def crept():
    data = measured(MaxwellCreep(1000.0, 8.0), 1, force_drift=0.5)
    return data, identify_creep(data, **TIMES)


def test_what_it_says_of_each_point_is_what_the_rig_had(crept):
    data, found = crept
    truth = (
        measured(MaxwellCreep(1000.0, 8.0), 1, force_noise=0.0).force - measured(NoCreep(), 1, force_noise=0.0).force
    )
    assert np.abs(truth).max() > 0.3
    clear = np.asarray(LAW.force(data.contraction, data.pressure)) > 20
    np.testing.assert_allclose(found.mean_force[clear], truth[clear], atol=0.03)
    np.testing.assert_array_equal(found.mean_force[data.slack], 0)
    assert "stiffness of 1" in found.verdict()


@pytest.mark.slow
def test_hysteresis_is_found_as_without_creep_once_creep_is_taken_off(crept):
    data, found = crept
    spoilt, cured = (identify_hysteresis(LAW, each).friction for each in (data.plateau_means(), found.corrected(data)))
    assert abs(spoilt.half_width - 12) > 0.2
    assert abs(cured.half_width - 12) < 0.05
    with pytest.raises(IdentificationError, match="is not the dataset"):
        found.corrected(data.select(np.arange(len(data)) < 5))


def test_rows_may_be_in_any_order_where_there_are_times(crept):
    data, found = crept
    shuffled = np.random.default_rng(0).permutation(len(data))
    again = identify_creep(IsobaricDataset(data.table.isel(point=shuffled)), **TIMES)
    assert again.creep.time_constant == pytest.approx(found.creep.time_constant, rel=1e-5)
    np.testing.assert_allclose(again.mean_force, found.mean_force[shuffled], atol=1e-6)
    timeless = identify_creep(IsobaricDataset(data.table.drop_vars("time")), **TIMES)
    assert timeless.creep.time_constant == pytest.approx(found.creep.time_constant, rel=1e-5)


def test_data_that_cannot_tell_are_refused(crept):
    data, _ = crept
    direction = data.table["direction"].to_numpy()

    def refused(match, changed, **times):
        with pytest.raises(IdentificationError, match=match):
            identify_creep(changed, **{**TIMES, **times})

    refused("no raw samples of the force", data.plateau_means())
    refused("lacks one direction", data.select(direction == "loading"))
    turn = int(np.flatnonzero((data.levels == 6 * bar) & (direction == "loading"))[0])
    refused("taut plateaus follow a move by", data.select(np.abs(np.arange(len(data)) - turn) < 6))
    refused("take .* s longer than the time between", data, interval=0.5)
    refused("take .* s longer than the time between", data, speed=5e-5)
    with pytest.raises(RangeError, match="speed is 0 m/s"):
        identify_creep(data, **{**TIMES, "speed": 0.0})


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "tau"), [(1000.0, 3.0), (1000.0, 8.0), (400.0, 40.0), (1500.0, 300.0)])
def test_an_arm_is_found_within_its_intervals(stiffness, tau):
    for seed in range(2):
        found = identify_creep(measured(MaxwellCreep(stiffness, tau), seed), **TIMES)
        low, high = found.time_constant_interval
        assert found.is_significant and low < found.creep.time_constant < high
        assert low * 0.8 < tau < high * 1.25 and high < 2.5 * low
        low, high = found.amplitude_interval
        assert low * 0.8 < stiffness < high * 1.25 and high - low < stiffness


@pytest.mark.slow
def test_the_interval_is_as_wide_as_the_scatter_with_noise_in_common_within_a_plateau():
    few = dataclasses.replace(PROTOCOL, pressures=[4 * bar], repeats=2)
    generator, constants, halves = np.random.default_rng(5), [], []
    for seed in range(12):
        data = measured(MaxwellCreep(1000.0, 8.0), seed, few, force_noise=0.02)
        samples = data.table["force_samples"].to_numpy()
        wander = 0.004 * np.cumsum(generator.standard_normal(samples.shape), axis=1)
        found = identify_creep(
            IsobaricDataset(data.table.assign(force_samples=(("point", "sample"), samples + wander))), **TIMES
        )
        constants.append(found.time_constant)
        halves.append(np.diff(found.time_constant_interval)[0] / 2)
    assert np.std(constants) == pytest.approx(np.median(halves) / 2, rel=0.6)


@pytest.mark.slow
def test_none_is_seen_where_there_is_none():
    fits = [identify_creep(measured(NoCreep(), seed, force_drift=1.0), **TIMES) for seed in range(12)]
    assert sum(fit.is_significant for fit in fits) <= 1
    assert all(not fit.mean_force.any() for fit in fits if not fit.is_significant)


def test_a_time_constant_that_the_plateaus_do_not_show_is_not_determined():
    late = dataclasses.replace(PROTOCOL, samples=50, acquisition=1.0)
    short = dataclasses.replace(late, pressures=[4 * bar], repeats=1)
    slow = identify_creep(
        measured(MaxwellCreep(1500.0, 800.0), 1, short, force_noise=0.05), **{**TIMES, "interval": 0.02}
    )
    assert slow.is_significant and slow.time_constant_interval[1] == math.inf
    assert slow.amplitude_interval[1] == math.inf and any("not determined" in note.text for note in slow.notes)


def test_a_regulator_that_follows_slowly_is_told_from_creep():
    """Pressure and force go back together after each move, at some 100 N/bar."""
    data = measured(NoCreep(), 1)
    table, decay = data.table, np.exp(-np.arange(100) * 0.05 / 4.0)
    lag = 500.0 * np.where(table["direction"].to_numpy() == "loading", 1.0, -1.0)[:, None] * decay
    slow = table.assign(
        pressure_samples=(("point", "sample"), table["pressure_samples"].to_numpy() + lag),
        force_samples=(("point", "sample"), table["force_samples"].to_numpy() + lag * 1e-3 * (~data.slack)[:, None]),
    )
    found = identify_creep(IsobaricDataset(slow), **TIMES)
    assert found.is_significant and "the pressure drifts too" in found.notes[-1].text
    blind = identify_creep(IsobaricDataset(slow.drop_vars("pressure_samples")), **TIMES)
    assert "without pressure samples" in blind.notes[0].text
    onwards = table.assign(force_samples=(("point", "sample"), table["force_samples"].to_numpy() - lag * 1e-3))
    assert not identify_creep(IsobaricDataset(onwards), **TIMES).is_significant
