import numpy as np
import pytest
import xarray as xr

from mckibben import catalog
from mckibben.dataset import IsobaricDataset, Recording, read_dataset
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.identification import identify
from mckibben.muscle import ExponentialLaw
from mckibben.units import bar, kPa, percent

RATE = 500.0
TURNS = [(0, 0), (1, 0), (8, 6 * bar), (10, 6 * bar), (17, 0), (18, 0), (19.5, 3 * bar), (21, 0)]  # s, Pa
TIME = np.arange(0, 21, 1 / RATE)
CLEAN = np.interp(TIME, *zip(*TURNS, strict=True))
MOTION = np.sign(np.diff(CLEAN, prepend=0))
SIDE = MOTION[np.maximum.accumulate(np.where(MOTION != 0, np.arange(len(TIME)), 0))]


def truth(pressure, side):
    """Curved, so that a mean over a band would be off, with a loop of 16 N [N]."""
    return 20 + 8e-4 * pressure + 4e-10 * pressure**2 - 8 * side


def record(noise=1.0, **other) -> Recording:
    rng = np.random.default_rng(1)
    pressure = CLEAN + noise * rng.normal(0, 500, len(TIME))
    force = truth(CLEAN, SIDE) + noise * rng.normal(0, 0.5, len(TIME))
    return Recording.of(**{"time": TIME, "pressure": pressure, "force": force, "contraction": 0.05} | other)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_points_at_given_pressures_for_filling_and_venting_apart(noise):
    levels = np.array([1, 2, 4]) * bar
    points = record(noise).isometric(levels)
    data = points.dataset
    assert data.pressure.tolist() == [1e5, 2e5, 4e5, 1e5, 2e5, 4e5, 1e5, 2e5, 1e5, 2e5]
    assert data.table["phase"].values.tolist() == ["filling"] * 3 + ["venting"] * 3 + ["filling"] * 2 + ["venting"] * 2
    assert data.table["repeat"].values.tolist() == [0] * 6 + [1] * 4
    assert "direction" not in data.table and data.phases.tolist() == ["filling", "venting"]
    side = np.where(data.table["phase"] == "filling", 1, -1)
    np.testing.assert_allclose(data.force, truth(data.pressure, side), atol=0.05 + 0.25 * noise)
    np.testing.assert_allclose(data.contraction, 0.05)
    assert np.all(np.abs(data.table["force_spread"] - 0.65 * noise) < 0.12)  # of force and, times the slope, pressure
    assert sum(points.counts.values()) == len(TIME)
    assert points.counts["used"] == points.samples.sum()
    assert points.notes == ("not passed: 4 bar by filling 1, venting 1",)


def test_the_line_is_that_of_numpy():
    run = record()
    points = run.isometric([2 * bar, 4 * bar], band=10 * kPa)
    mine = (TIME > 1) & (TIME < 8) & (np.abs(run.pressure - 2 * bar) <= 10 * kPa)
    line = np.polynomial.Polynomial.fit(run.pressure[mine] - 2 * bar, run.force[mine], 1).convert()
    assert points.samples[0] == mine.sum()
    assert points.dataset.force[0] == pytest.approx(line(0.0), rel=1e-12)


def test_evenly_spaced_levels_lie_inside_the_range():
    data = record().isometric(count=6).dataset
    np.testing.assert_allclose(np.diff(data.pressures), 1 * bar, rtol=0.01)
    assert data.pressures[0] == pytest.approx(0.5 * bar, abs=3 * kPa)


def test_a_rest_at_the_top_belongs_to_the_filling():
    points = record().isometric([5.998 * bar], band=1 * kPa)
    assert points.dataset.table["phase"].values.tolist() == ["filling"]
    assert points.counts["at rest or turning"] > 400


def test_a_level_is_not_reached_from_one_side():
    with pytest.raises(
        RangeError, match=r"no level is passed\n  10500 samples: 0 used[^\n]*\n  not passed: 7 bar by filling 0"
    ):
        record().isometric([7 * bar])


def test_a_gap_parts_a_filling_and_the_ends_of_the_sensor_are_left_out():
    time = TIME + 5 * (TIME >= 4)
    points = record(time=time).isometric([1 * bar, 5 * bar])
    assert points.dataset.table["repeat"].values.tolist() == [0, 1, 0, 0, 2, 1]
    assert points.notes[0].startswith("gap: 3.998 to 9 s")
    run = record()
    clipped = record(force=np.minimum(run.force, 400))
    points = clipped.isometric([1 * bar, 5.5 * bar])
    assert 5.5 * bar not in points.dataset.pressures
    assert points.counts["at the ceiling of force"] > 500
    assert sum(points.counts.values()) == len(TIME)


def test_the_length_must_be_known_and_fixed():
    bare = Recording(record().table.drop_vars("contraction"))
    with pytest.raises(RangeError, match="the contraction is unknown; give contraction"):
        bare.isometric()
    assert bare.isometric(contraction=10 * percent).dataset.contraction[0] == 0.1
    with pytest.raises(RangeError, match=r"made at contraction 0\.05, not 0\.1"):
        record().isometric(contraction=0.1)
    with pytest.raises(RangeError, match="the length was not fixed"):
        record(contraction=0.2 * TIME / 21).isometric()
    slipped = record(contraction=np.where(TIME > 17, 0.07, 0.05)).isometric()
    assert slipped.counts["at another length"] == (TIME > 17).sum()


@pytest.mark.parametrize(
    "argument", [{"count": 0}, {"levels": []}, {"levels": [np.nan]}, {"band": -1.0}, {"reversal": 0.0}]
)
def test_arguments_without_a_meaning_are_refused(argument):
    with pytest.raises(RangeError):
        record().isometric(**argument)
    with pytest.raises(RangeError, match="overlap"):
        record().isometric([1e5, 1.1e5], band=6e3)


def test_fillings_and_ventings_at_several_lengths_identify_a_law(tmp_path):
    """The loop of filling and venting lies evenly about the law: a fit to both finds it."""
    law = catalog.law("lei-mas-10-180n")
    parts = []
    for contraction in np.linspace(0, 0.18, 7):
        clean = np.asarray(law.force(contraction=contraction, pressure=CLEAN))
        run = record(force=clean - 5 * SIDE, contraction=contraction)
        parts.append(run.isometric(np.array([2.5, 3.5, 4.5, 5.5]) * bar).dataset)
    table = xr.concat([part.table for part in parts], "point", combine_attrs="drop")
    IsobaricDataset(table).to_csv(tmp_path / "points.csv")
    points = read_dataset(tmp_path / "points.csv")
    assert len(points.phases) == 2
    both = points.select((points.table["repeat"] == 0).to_numpy())
    fit = identify(ExponentialLaw, both)
    expected = law.force(contraction=both.contraction, pressure=both.pressure)
    np.testing.assert_allclose(fit.law.force(contraction=both.contraction, pressure=both.pressure), expected, atol=0.4)


def staircase(levels, *, overshoot=0.1, move=0.1, hold=2.0, decay=0.1, rate=RATE):
    """Steps of the pressure [Pa] through levels [bar] that overshoot, decaying over `decay` [s]."""
    time = np.arange(0, hold * len(levels), 1 / rate)
    step = np.minimum((time // hold).astype(int), len(levels) - 1)
    since, before = time - step * hold, np.array([levels[0], *levels[:-1]])[step]
    jump = np.array(levels)[step] - before
    rise = np.minimum(since / move, 1.0)
    after = np.maximum(since - move, 0.0)
    ring = overshoot * (since > move) * np.exp(-after / decay) * np.sin(after / decay)
    pressure = (before + jump * (rise + ring)) * bar
    return time, pressure + np.random.default_rng(0).normal(0, 200, len(time))


LEVELS = [*np.arange(0, 6.1, 0.5), *np.arange(5.5, -0.1, -0.5)]


def test_a_staircase_is_no_ramp():
    time, pressure = staircase(LEVELS, overshoot=0.5)
    record = Recording.of(time=time, pressure=pressure, force=truth(pressure, 0), contraction=0.05)
    with pytest.raises(RangeError, match="was held at") as error:
        record.isometric()
    assert "plateaus" in error.value.remedy
    points = record.plateaus()
    assert points.dataset.table["phase"].values.tolist()[1:] == ["filling"] * 12 + ["venting"] * 12


def test_transients_of_the_valve_are_no_points():
    time, pressure = staircase([0.0, 6.0, 0.0], move=0.3, overshoot=0.0, hold=10.0)
    record = Recording.of(time=time, pressure=pressure, force=truth(pressure, 0), contraction=0.05)
    with pytest.raises(RangeError, match="of a transient"):
        record.isometric()


def test_an_overshoot_of_a_ramp_is_no_phase():
    ripple = 0.1 * bar * np.sin(2 * np.pi * 3 * TIME)
    data = record(pressure=CLEAN + ripple).isometric([2 * bar, 4 * bar]).dataset
    assert data.table["phase"].values.tolist()[:4] == ["filling", "filling", "venting", "venting"]
    assert data.table["repeat"].values.tolist()[:4] == [0] * 4


def regulated(levels, overshoot, hold=12.0, period=0.01, start=0.08):
    """Pressure [Pa] of an underdamped regulator along a staircase [bar], and a force that follows it."""
    damping = -np.log(overshoot) / np.hypot(np.pi, np.log(overshoot))
    frequency, samples = 12.0, round(hold / period)
    time = period * np.arange(samples)
    fast = frequency * np.sqrt(1 - damping**2)
    ringing = np.exp(-damping * frequency * time)
    response = 1 - ringing * (np.cos(fast * time) + damping * frequency / fast * np.sin(fast * time))
    before = np.array([start, *levels[:-1]])
    pressure = np.concatenate([a + (b - a) * response for a, b in zip(before, levels, strict=True)]) * bar
    return Recording.of(
        time=period * np.arange(pressure.size), pressure=pressure, force=pressure / 2e3, contraction=0.1
    )


@pytest.mark.parametrize("overshoot", [0.05, 0.4, 0.8])
def test_filling_in_steps_is_filling_whatever_the_overshoot(overshoot):
    levels = [1.6, 2.2, 3.0, 3.3, 4.1, 5.0, 5.9]
    data = regulated(levels, overshoot).plateaus(dwell=0.5).dataset
    assert data.table["phase"].values.tolist() == ["filling"] * len(levels)
    down = regulated(levels[::-1], overshoot, start=6.5).plateaus(dwell=0.5).dataset
    assert down.table["phase"].values.tolist() == ["venting"] * len(levels)


def test_steps_that_overshoot_are_no_ramps_between_their_peaks():
    with pytest.warns(McKibbenWarning, match="was held"):
        regulated([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 5.0, 3.0, 1.0], 0.4).isometric()


def test_a_large_excursion_before_a_plateau_is_venting():
    """From 1 to 3 bar by way of 6 bar: the friction has the sign of venting."""
    pressure = np.concatenate([np.full(300, 1.0), np.linspace(1, 6, 200), np.linspace(6, 3, 200), np.full(300, 3.0)])
    record = Recording.of(time=0.01 * np.arange(1000), pressure=pressure * bar, force=50.0 * pressure, contraction=0.1)
    assert record.plateaus().dataset.table["phase"].values.tolist() == ["", "venting"]


def test_small_steps_are_several_pressures():
    """Plateaus of 601 to 623 kPa that follow each other by steps are not one level; equal ones are."""
    levels = [3.0, 6.01, 6.06, 6.12, 6.18, 6.23, 3.002]
    data = regulated(levels, 0.1).plateaus(dwell=0.5).dataset
    assert np.unique(data.levels).size == 6
    np.testing.assert_allclose(data.levels / bar, [3.0, *levels[1:-1], 3.0], atol=0.006)


def test_the_scatter_of_a_regulator_over_lengths_is_one_pressure():
    """The length changes between the plateaus, so that 601 to 607 kPa are one level."""
    pressure = np.repeat([6.01, 6.04, 6.07, 6.02], 300) * bar
    contraction = np.repeat([0.0, 0.05, 0.10, 0.15], 300)
    record = Recording.of(
        time=0.01 * np.arange(1200), pressure=pressure, force=400 - 2e3 * contraction, contraction=contraction
    )
    assert np.unique(record.plateaus().dataset.levels).size == 1
