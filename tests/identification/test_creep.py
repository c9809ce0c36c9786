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


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "tau"), [(1000.0, 3.0), (1000.0, 8.0), (400.0, 40.0), (1500.0, 300.0)])
def test_an_arm_is_found_within_its_errors(stiffness, tau):
    far = []
    for seed in range(3):
        found = identify_creep(measured(MaxwellCreep(stiffness, tau), seed), **TIMES)
        assert found.is_significant and found.warnings == ()
        errors = found.standard_errors
        assert errors["time_constant"] < 0.25 * tau and errors["stiffness"] < 0.5 * stiffness
        far.append((found.creep.time_constant - tau) / errors["time_constant"])
        assert found.time_constant_interval[0] * 0.8 < tau < found.time_constant_interval[1] * 1.25
        assert found.time_constant_interval[0] < found.creep.time_constant < found.time_constant_interval[1]
    assert np.abs(far).max() < 3.5 and np.abs(np.mean(far)) < 1.7


@pytest.mark.slow
def test_the_errors_are_as_large_as_the_scatter():
    few = dataclasses.replace(PROTOCOL, pressures=[4 * bar], repeats=1)
    found = [
        identify_creep(measured(MaxwellCreep(1000.0, 8.0), seed, few, force_noise=0.05), **TIMES) for seed in range(16)
    ]
    constants = np.array([one.creep.time_constant for one in found])
    stated = np.median([one.standard_errors["time_constant"] for one in found])
    assert constants.std() == pytest.approx(stated, rel=0.4)
    assert np.mean([one.time_constant_interval[0] <= 8.0 <= one.time_constant_interval[1] for one in found]) >= 0.85


@pytest.mark.slow
def test_noise_in_common_within_a_plateau_is_allowed_for():
    """A slow wander of the sensor within each plateau: errors of independent samples would be too small."""
    few = dataclasses.replace(PROTOCOL, pressures=[4 * bar], repeats=2)
    generator = np.random.default_rng(5)
    scatter, stated = [], []
    for seed in range(12):
        data = measured(MaxwellCreep(1000.0, 8.0), seed, few, force_noise=0.02)
        samples = data.table["force_samples"].to_numpy()
        wander = 0.004 * np.cumsum(generator.standard_normal(samples.shape), axis=1)
        table = data.table.assign(force_samples=(("point", "sample"), samples + wander))
        found = identify_creep(IsobaricDataset(table), **TIMES)
        scatter.append((found.rate, found.creep.time_constant))
        stated.append((found.rate_error, found.standard_errors["time_constant"]))
    np.testing.assert_allclose(np.std(scatter, axis=0), np.median(stated, axis=0), rtol=0.5)


def test_what_it_says_of_each_point_is_what_the_rig_had(crept):
    data, found = crept
    truth = (
        measured(MaxwellCreep(1000.0, 8.0), 1, force_noise=0.0).force - measured(NoCreep(), 1, force_noise=0.0).force
    )
    assert np.abs(truth).max() > 0.3
    clear = np.asarray(LAW.force(data.contraction, data.pressure)) > 20
    np.testing.assert_allclose(found.mean_force[clear], truth[clear], atol=0.03)
    np.testing.assert_array_equal(found.mean_force[data.slack], 0)
    np.testing.assert_allclose(
        found.relaxation([0.0, 1.0])[:, 1], found.initial_force * math.exp(-1 / found.creep.time_constant)
    )
    assert 0.05 < found.relative_stiffness < 0.2  # 1 N/mm beside some 10
    assert "time constant" in found.report() and "% of the muscle's" in found.report()


@pytest.mark.slow
def test_hysteresis_is_found_as_without_creep_once_creep_is_taken_off(crept):
    data, found = crept
    spoilt, cured = (identify_hysteresis(LAW, each).friction for each in (data.plateau_means(), found.corrected(data)))
    assert abs(spoilt.half_width - 12) > 0.2
    assert abs(cured.half_width - 12) < 0.05
    with pytest.raises(IdentificationError, match="is not the dataset"):
        found.corrected(data.select(np.arange(len(data)) < 5))


@pytest.mark.slow
def test_none_is_seen_where_there_is_none():
    scores = []
    for seed in range(30):
        found = identify_creep(measured(NoCreep(), seed, force_drift=1.0), **TIMES)
        scores.append(found.significance)
        assert found.creep == NoCreep() and not found.is_significant and found.relative_stiffness == 0
        assert not found.initial_force.any() and math.isnan(found.standard_errors["stiffness"])
        assert "is detectable from" in found.warnings[-1] and "no significant creep" in found.report()
    assert 0.7 < np.std(scores) < 1.3


def test_what_would_show_is_about_what_does():
    """The bound that it gives where it sees none: twice of that is seen."""
    text = identify_creep(measured(NoCreep(), 3), **TIMES).warnings[-1]
    bound = float(text.split("from ")[1].split(" N/mm")[0]) * 1e3
    assert identify_creep(measured(MaxwellCreep(2 * bound, 10.0), 3), **TIMES).is_significant
    assert not identify_creep(measured(MaxwellCreep(bound / 10, 10.0), 3), **TIMES).is_significant


def test_a_time_constant_that_the_plateaus_do_not_show_is_said_not_to_be_known():
    late = dataclasses.replace(PROTOCOL, samples=50, acquisition=1.0)
    times = {**TIMES, "interval": 0.02}
    found = identify_creep(measured(MaxwellCreep(1500.0, 2.0), 1, late), **times)
    assert (
        found.is_significant
        and math.isnan(found.standard_errors["time_constant"])
        and found.time_constant_interval[0] == 0
    )
    assert "the wait of 5 s before the first sample is too long" in found.warnings[0]
    short = dataclasses.replace(late, pressures=[4 * bar], repeats=1)
    found = identify_creep(measured(MaxwellCreep(1500.0, 800.0), 1, short, force_noise=0.05), **times)
    assert found.is_significant and found.time_constant_interval[1] == math.inf and "is too short" in found.warnings[0]
    ratio = float(found.warnings[0].split("per time constant is ")[1].split(" N/mm/s")[0])
    assert ratio == pytest.approx(1.5 / 800, rel=0.4)


def test_a_regulator_that_follows_slowly_is_told_from_creep():
    """Pressure and force go back together after each move, at some 100 N/bar."""
    data = measured(NoCreep(), 1)
    table, decay = data.table, np.exp(-np.arange(100) * 0.05 / 4.0)
    side = np.where(table["direction"].to_numpy() == "loading", 1.0, -1.0)[:, None]
    lag = 500.0 * side * decay
    slow = table.assign(
        pressure_samples=(("point", "sample"), table["pressure_samples"].to_numpy() + lag),
        force_samples=(("point", "sample"), table["force_samples"].to_numpy() + lag * 1e-3 * (~data.slack)[:, None]),
    )
    found = identify_creep(IsobaricDataset(slow), **TIMES)
    assert (
        found.is_significant
        and "the pressure drifts too" in found.warnings[0]
        and "due to the regulator, not creep" in found.warnings[0]
    )
    crept = lag * 5e-3 * (~data.slack)[:, None]  # five times as large: a fifth is due to the regulator
    both = slow.assign(force_samples=(("point", "sample"), table["force_samples"].to_numpy() + 2 * crept))
    assert not any("regulator" in text for text in identify_creep(IsobaricDataset(both), **TIMES).warnings)
    blind = identify_creep(IsobaricDataset(slow.drop_vars("pressure_samples")), **TIMES)
    assert "without pressure samples" in blind.warnings[0]
    onwards = table.assign(force_samples=(("point", "sample"), table["force_samples"].to_numpy() - 0.5 * side * decay))
    against = identify_creep(IsobaricDataset(onwards), **TIMES)
    assert (
        not against.is_significant and against.significance < -3 and "continues in the direction" in against.warnings[0]
    )


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
