import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.muscle import MaxwellSlip, Muscle
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
from mckibben.units import bar, kPa, mm

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
SMALL = IsobaricProtocol(pressures=[0.0, 2 * bar, 6 * bar], repeats=2, samples=50)


@pytest.fixture(scope="module")
def measured():
    return SimulatedIsobaricTest(MUSCLE).run(IsobaricProtocol(samples=100), seed=3)


def test_the_same_seed_gives_the_same_data():
    rig = SimulatedIsobaricTest(MUSCLE)
    first, again, other = rig.run(SMALL, seed=5), rig.run(SMALL, seed=5), rig.run(SMALL, seed=6)
    assert first.table.identical(again.table)
    assert np.all(first.force != other.force)
    assert first.table.attrs["source"].endswith("seed 5")


def test_with_nothing_in_the_way_it_is_the_law():
    rig = SimulatedIsobaricTest(MUSCLE, hysteresis=0, force_noise=0, pressure_noise=0, regulator_offset=0)
    data = rig.run(IsobaricProtocol(), seed=0)
    law = np.asarray(MUSCLE.tension(data.contraction, data.levels))
    np.testing.assert_allclose(data.pressure, data.levels, rtol=1e-12)
    np.testing.assert_allclose(data.force, law, rtol=1e-9)
    np.testing.assert_array_equal(data.slack, law == 0)


def test_an_offset_is_seen_by_muscle_and_sensor_alike():
    rig = SimulatedIsobaricTest(MUSCLE, hysteresis=0, force_noise=0, pressure_noise=0)
    data = rig.run(IsobaricProtocol(), seed=1)
    np.testing.assert_allclose(data.force, MUSCLE.tension(data.contraction, data.pressure), rtol=1e-9, atol=1e-9)
    offset = data.pressure - data.levels
    assert np.abs(offset).max() <= 4.5 * kPa and offset.max() > 3 * kPa and offset.min() < -3 * kPa
    assert data.pressure.min() >= 0
    assert len(np.unique(offset[data.levels == 6 * bar])) == 5  # one a repeat


def test_the_sensors_noise_is_as_given():
    protocol = IsobaricProtocol(pressures=[2 * bar, 4 * bar], repeats=2)
    quiet = SimulatedIsobaricTest(MUSCLE, force_noise=0, pressure_noise=0).run(protocol, seed=3)
    measured = SimulatedIsobaricTest(MUSCLE).run(protocol, seed=3)
    assert np.sqrt(np.mean(measured.table["force_spread"] ** 2)) == pytest.approx(0.5, rel=4e-3)
    for name, sigma in (("force", 0.5), ("pressure", 500.0)):  # of a mean of 1000 independent samples
        error = getattr(measured, name) - getattr(quiet, name)
        assert np.std(error) == pytest.approx(sigma / np.sqrt(1000), rel=0.2) and abs(error.mean()) < 0.2 * np.std(
            error
        )


def test_a_loop_closes_at_the_turns():
    rig = SimulatedIsobaricTest(MUSCLE, force_noise=0, pressure_noise=0, regulator_offset=0)
    data = rig.run(IsobaricProtocol(pressures=[4 * bar], repeats=2), seed=0)
    directions, repeats = data.table["direction"].to_numpy(), data.table["repeat"].to_numpy()
    share = data.force - np.asarray(MUSCLE.tension(data.contraction, data.pressure))
    first, second = (share[(directions == "unloading") & (repeats == repeat)] for repeat in (0, 1))
    np.testing.assert_allclose(first, second, atol=1e-9)
    # after 1 and 2 mm, to what a polygon of six elements is off an exponential, over the whole width
    np.testing.assert_allclose(first[:3], 12 * np.array([1, 2 * np.exp(-2) - 1, 2 * np.exp(-4) - 1]), atol=24 * 0.012)
    loading = share[(directions == "loading") & (repeats == 0)]
    assert loading[0] == first[-1]  # the turn, without a move
    assert loading[-1] == pytest.approx(12, abs=1e-3)


def test_the_rated_force_is_never_exceeded(measured):
    assert (measured.force + 5 * measured.table["force_spread"]).max() < 630
    hardest = SimulatedIsobaricTest(MUSCLE, hysteresis=17, regulator_offset=9 * kPa, force_noise=0)
    assert hardest.run(IsobaricProtocol(), seed=1).force.max() < 630
    with pytest.raises(RangeError, match=r"force to 6\d\d N at .* bar, above the rated 630 N; raise .* 5 %"):
        SimulatedIsobaricTest(MUSCLE, hysteresis=60).run(IsobaricProtocol(), seed=1)
    reserved = IsobaricProtocol(force_reserve=0.15)
    assert SimulatedIsobaricTest(MUSCLE, hysteresis=60).run(reserved, seed=1).force.max() < 630


def test_slack_is_known(measured):
    slack = np.asarray(MUSCLE.tension(measured.contraction, measured.levels)) == 0
    clear = np.abs(np.asarray(MUSCLE.law.force(measured.contraction, measured.levels))) > 8  # beyond friction
    assert slack[clear].sum() > 100
    np.testing.assert_array_equal(measured.slack[clear], slack[clear])
    assert measured.table.attrs["slack_force"] == pytest.approx(5 * 0.5 / np.sqrt(100))


def test_a_muscle_brings_its_own_friction():
    own = MaxwellSlip(8.0, 1 * mm, growth=1 / bar, reference_pressure=3 * bar)
    quiet = {"force_noise": 0, "pressure_noise": 0, "regulator_offset": 0}
    data = SimulatedIsobaricTest(Muscle(MUSCLE.specimen, MUSCLE.law, own), **quiet).run(SMALL, seed=0)
    plain = SimulatedIsobaricTest(MUSCLE, hysteresis=0, **quiet).run(SMALL, seed=0)
    share = data.force - plain.force
    far = (data.levels == 6 * bar) & (data.contraction > 0.05) & (data.contraction < 0.18)
    loading = data.table["direction"].to_numpy() == "loading"
    np.testing.assert_allclose(np.abs(share[far]), 11 * np.tanh(plain.force[far] / 11), rtol=1e-9)
    assert np.all(share[far & loading] > 0) and np.all(share[far & ~loading] < 0)
    assert repr(own) in data.table.attrs["source"]


def test_the_force_sensor_drifts_evenly_or_wanders():
    quiet = SimulatedIsobaricTest(MUSCLE, force_noise=0, pressure_noise=0)
    plain = quiet.run(SMALL, seed=5)
    drifting = SimulatedIsobaricTest(MUSCLE, force_noise=0, pressure_noise=0, force_drift=0.4).run(SMALL, seed=5)
    time = plain.table["time"].to_numpy()
    np.testing.assert_allclose(drifting.force - plain.force, 0.4 * (time - time[0]) / 3600, atol=1e-9)
    np.testing.assert_array_equal(drifting.slack, plain.slack)  # the threshold has moved as far
    np.testing.assert_array_equal(drifting.pressure, plain.pressure)
    walks = [
        SimulatedIsobaricTest(MUSCLE, force_noise=0, pressure_noise=0, force_wander=0.3).run(SMALL, seed=seed).force
        - SimulatedIsobaricTest(MUSCLE, force_noise=0, pressure_noise=0).run(SMALL, seed=seed).force
        for seed in range(12)
    ]
    steps = np.concatenate([np.diff(walk) / np.sqrt(np.diff(time) / 3600) for walk in walks])
    assert np.std(steps) == pytest.approx(0.3, rel=0.05)
    assert abs(np.mean(steps)) < 0.03
