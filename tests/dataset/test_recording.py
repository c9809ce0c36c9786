import numpy as np
import pytest
import xarray as xr

from mckibben.dataset import Recording, read_dataset, read_recording
from mckibben.dataset.points import saturated_samples
from mckibben.errors import DatasetError, McKibbenWarning, RangeError
from mckibben.units import bar, kPa, percent

from .conftest import problems_of as said_of

RATE = 200.0  # Hz
FRICTION = 6.0  # N


def law(pressure, contraction):
    """A muscle, slack where it would push [N]."""
    return np.maximum(0, (1.1e-3 * pressure - 60) * (1 - 3.6 * contraction) - 200 * contraction)


class Run:
    """An isobaric test: at each pressure a stroke there and back in steps, each held for 3 s after 0.5 s of motion."""

    def __init__(self, levels=(1 * bar, 2 * bar, 3 * bar), *, seed=0, noise=1.0, rate=RATE, top=0.2):
        steps = np.arange(0, top + 1e-9, 0.04)
        stroke = [*steps, *steps[-2::-1]]
        self.plan = [(level, contraction) for level in levels for contraction in stroke]
        move, hold = int(0.5 * rate), int(3 * rate)
        before = np.array([(0.0, 0.0), *self.plan[:-1]])
        ramp = np.linspace(0, 1, move, endpoint=False)[None, :, None]
        moving = before[:, None] + (np.array(self.plan) - before)[:, None] * ramp
        held = np.repeat(np.array(self.plan)[:, None], hold, axis=1)
        self.pressure, self.contraction = np.concatenate([moving, held], axis=1).reshape(-1, 2).T
        count = len(self.pressure)
        motion = np.sign(np.diff(self.contraction, prepend=0))
        side = motion[np.maximum.accumulate(np.where(motion != 0, np.arange(count), 0))]
        clean = law(self.pressure, self.contraction)
        self.force = clean - FRICTION * side * (clean > 0)
        self.moved = np.sign(np.diff([0.0, *(c for _, c in self.plan)]))
        rng = np.random.default_rng(seed)
        self.pressure = self.pressure + noise * rng.normal(0, 500, count)
        self.contraction = self.contraction + noise * rng.normal(0, 1e-5, count)
        self.force = self.force + noise * rng.normal(0, 0.5, count)
        self.time = np.arange(count) / rate

    def record(self, **other) -> Recording:
        columns = {"time": self.time, "pressure": self.pressure, "force": self.force, "contraction": self.contraction}
        return Recording.of(**columns | other)


RUN = Run()


def accounted(points, record):
    assert sum(points.counts.values()) == len(record)
    assert points.counts["used"] == points.samples.sum()
    return points


@pytest.mark.parametrize("noise", [1.0, 0.0])
def test_every_plateau_is_found_with_its_level_its_direction_and_its_means(noise):
    test = Run(noise=noise)
    points = accounted(test.record().plateaus(), test.record())
    pressure, contraction = np.array(test.plan).T
    data = points.dataset
    assert len(data) == len(test.plan)
    np.testing.assert_allclose(data.pressure, pressure, atol=120)
    np.testing.assert_allclose(data.contraction, contraction, atol=3e-6)
    clean = law(pressure, contraction)
    moved = test.moved != 0
    expected = (clean - FRICTION * test.moved * (clean > 0))[moved]
    np.testing.assert_allclose(data.force[moved], expected, atol=0.12)  # 4.6 standard errors of 400 samples
    np.testing.assert_allclose(data.table["force_spread"], 0.5 * noise, atol=0.08)
    assert data.levels.tolist() == pressure.tolist()
    words = {1: "unloading", -1: "loading", 0: ""}
    assert data.table["direction"].values.tolist() == [words[int(m)] for m in test.moved]
    assert data.table["phase"].values.tolist() == ["filling" if m == 0 else "" for m in test.moved]
    assert sorted(data.directions) == ["loading", "unloading"]
    assert points.counts["not steady"] + points.counts["used"] > 0.85 * len(test.time)


def test_a_fixed_length_that_is_filled_and_vented_in_steps_has_phases_and_no_direction():
    levels = [1, 2, 3, 2, 1]
    pressure = np.repeat(np.array(levels) * bar, 400)
    force = np.repeat([10.0, 20, 30, 26, 16], 400)
    record = Recording.of(time=np.arange(2000) / RATE, pressure=pressure, force=force, contraction=0.1)
    data = record.plateaus().dataset
    assert data.force.tolist() == [10, 20, 30, 26, 16]
    assert "direction" not in data.table
    assert data.table["phase"].values.tolist() == ["", "filling", "filling", "venting", "venting"]


def test_the_ends_of_a_sensor_are_recognised_and_left_out():
    low, high = 5.0, 180.0
    record = RUN.record(force=np.clip(RUN.force, low, high), slack_force=1.0)
    points = accounted(record.plateaus(), record)
    clean = RUN.record(slack_force=1.0).plateaus().dataset
    within = (clean.force > low + 2) & (clean.force < high - 2)
    assert 10 < within.sum() < len(clean) - 4
    found = points.dataset.force
    np.testing.assert_allclose(found[(found > low + 2) & (found < high - 2)], clean.force[within], atol=1e-9)
    assert found.max() < high and found.min() > low
    clipped = ((RUN.force <= low) | (RUN.force >= high)).sum()
    assert points.counts["at the floor of force"] + points.counts["at the ceiling of force"] >= clipped * 0.98
    assert any("force is saturated at 180 N, the ceiling of its channel" in note for note in points.notes)


@pytest.mark.parametrize("step", [0.05, 2.0])
def test_a_coarse_converter_is_no_end_of_the_channel(step):
    record = RUN.record(force=np.round(RUN.force / step) * step, pressure=np.round(RUN.pressure / 200) * 200)
    points = accounted(record.plateaus(), record)
    slack = RUN.record().plateaus().dataset.force < 1
    assert len(points.dataset) >= len(slack) - slack.sum()
    assert not any("pressure" in note or "ceiling" in note for note in points.notes)


def test_gaps_part_what_is_steady_and_a_clock_that_is_set_back_costs_its_plateau():
    time = RUN.time.copy()
    middle = int(3.5 * RATE * 4 - 1.5 * RATE)  # in the middle of the fourth plateau
    time[middle:] += 7
    time[2 * middle + 200 :] -= 11  # in that of the eighth
    record = RUN.record(time=time)
    with pytest.warns(McKibbenWarning, match="the clock went back"):
        points = accounted(record.plateaus(), record)
    assert len(points.dataset) == len(RUN.plan) + 1 - 1
    assert points.notes[0].startswith(f"gap: {time[middle - 1]:g} to {time[middle]:g} s")
    assert points.notes[1].startswith("clock went back: ")
    assert points.counts["the clock went back"] == pytest.approx(3 * RATE, abs=0.2 * RATE)


def held(*parts, rate=RATE):
    """Contraction and pressure in parts of a duration [s], each held or with both ends given."""
    rows = [np.stack([np.linspace(*ends, int(t * rate), endpoint=False) for ends in both]) for t, *both in parts]
    return np.concatenate(rows, axis=1)


def after(*shifts):
    """Three plateaus: contraction 5 %, 15 % and, after a break, 10 % and other pressures; the clock as told."""
    still = (2 * bar, 2 * bar)
    before = held((2, (0.05, 0.05), still), (1, (0.05, 0.15), still), (2, (0.15, 0.15), still))
    since = held(*shifts)
    contraction, pressure = np.concatenate([before, since], axis=1)
    return contraction, pressure, before.shape[1]


def test_nothing_is_known_of_the_way_across_a_break():
    higher = (3 * bar, 3 * bar)

    def ways(*parts):
        contraction, pressure, count = after(*parts)
        time = np.arange(len(contraction)) / RATE
        time[count:] += 190.0
        record = Recording.of(time=time, pressure=pressure, force=100 - 400 * contraction, contraction=contraction)
        table = record.plateaus().dataset.table
        phase = table["phase"].values.tolist() if "phase" in table else [""] * table.sizes["point"]
        return table["direction"].values.tolist(), phase

    still = (2 * bar, 2 * bar)
    nothing = [""] * 3
    assert ways((2, (0.10, 0.10), still)) == (["", "unloading", ""], nothing)
    assert ways((2, (0.15, 0.15), higher)) == (["", "unloading", ""], nothing)
    assert ways((2, (0.15, 0.15), still)) == (["", "unloading", ""], nothing)  # not that of the one before, either
    # what is seen after it counts
    assert ways((1, (0.05, 0.10), still), (2, (0.10, 0.10), still)) == (["", "unloading", "unloading"], nothing)
    filled = (1, (0.15, 0.15), (2 * bar, 3 * bar)), (2, (0.15, 0.15), higher)
    assert ways(*filled) == (["", "unloading", ""], ["", "", "filling"])
    two = (2, (0.10, 0.10), still), (1, (0.10, 0.05), still), (2, (0.05, 0.05), still)
    assert ways(*two)[0] == ["", "unloading", "", "loading"]


def test_tolerance_dwell_and_settle_do_what_they_say():
    creeping = RUN.record(force=RUN.force + 20 * np.exp(-(RUN.time % 3.5 - 0.5).clip(0) / 0.3), slack_force=1.0)
    quote, as_column = creeping.plateaus(), creeping.plateaus(settle=0.99)
    assert len(quote.dataset) == len(as_column.dataset) == len(RUN.plan)
    bias = quote.dataset.force - as_column.dataset.force
    assert np.all(bias > 1) and as_column.counts["settling"] > 3 * quote.counts["settling"]
    with pytest.raises(RangeError, match=r"steady for 4 s\n  23.00 samples: 0 used") as error:
        RUN.record().plateaus(dwell=4.0)
    assert "--dwell" in error.value.remedy
    assert len(RUN.record().plateaus(dwell=2.9).dataset) == len(RUN.plan)


def test_a_slow_ramp_is_no_plateau():
    time = np.arange(0, 60, 1 / RATE)
    ramp = Recording.of(time=time, pressure=2e5 + 0 * time, force=100 - time, contraction=0.2 * time / 60)
    with pytest.raises(RangeError, match="no plateaus"):
        ramp.plateaus()


def test_set_pressures_of_the_record_go_before_clusters():
    record = RUN.record(set_pressure=np.where(RUN.time < 35, 0.9 * bar, 2.9 * bar))
    with pytest.raises(DatasetError, match="set pressures are far"):
        record.plateaus()
    points = record.plateaus(accept=["order"]).dataset
    assert set(np.round(points.levels)) <= {0.9 * bar, 2.9 * bar}


def test_pressures_without_steps_have_no_level():
    pressure = np.repeat(np.arange(1e5, 1e5 + 12 * 6 * kPa, 6 * kPa), 400)
    contraction = np.repeat(0.01 * np.arange(12), 400)
    time = np.arange(len(pressure)) / RATE
    record = Recording.of(time=time, pressure=pressure, force=pressure / 1e4, contraction=contraction)
    points = record.plateaus(accept=["zero"])
    assert np.isnan(points.dataset.table["set_pressure"]).all()
    assert "the pressures of 12 plateaus follow each other without a step: they get no set pressure" in points.notes


def test_a_recording_round_trips_and_is_what_it_was_given(tmp_path):
    record = RUN.record(specimen="DMSP-10", initial_length=0.25, slack_force=1.0, set_pressure=np.nan)
    record.to_netcdf(tmp_path / "a.nc")
    assert read_recording(tmp_path / "a.nc").table.identical(record.table)
    assert read_recording(tmp_path / "a.nc", specimen="B").table.attrs["specimen"] == "B"
    with pytest.raises(ValueError, match="read-only"):
        record.force[0] = 0
    points = record.plateaus().dataset
    assert points.table.attrs["initial_length"] == 0.25
    points.to_csv(tmp_path / "points.csv")
    again = read_dataset(tmp_path / "points.csv")
    xr.testing.assert_allclose(again.table, points.table.drop_vars("force_spread"), rtol=1e-8)  # nine digits
    assert "7.7" not in repr(record) and repr(record).startswith("<Recording 'DMSP-10': ")


def test_files_of_samples(put):
    header = "t / s;Pressure [bar];Length [mm];Force [N]\n"
    rows = "".join(
        f"{t:.3f};{p / bar:.5f};{180 * (1 - c):.5f};{f:.5f}\n"
        for t, p, c, f in zip(RUN.time, RUN.pressure, RUN.contraction, RUN.force, strict=True)
    )
    path = put(header + rows.replace(".", ","))
    record = read_recording(path, initial_length=0.18)
    np.testing.assert_allclose(record.plateaus().dataset.force, RUN.record().plateaus().dataset.force, atol=1e-4)
    assert "is needed for lengths" in said_of(path, read_recording)[0]
    bare = put("pressure_bar,force_N\n1,2\n1,2\n")
    record = read_recording(bare, sample_rate=100.0, contraction=10 * percent)
    assert record.time.tolist() == [0, 0.01]
    assert record.contraction.tolist() == [0.1, 0.1]
    with pytest.raises(RangeError, match="has no contraction; give contraction"):
        read_recording(bare, sample_rate=100.0).plateaus()


@pytest.mark.parametrize(
    "argument", [{"dwell": 0.0}, {"settle": 2.0}, {"settle": -1.0}, {"pressure_tolerance": np.nan}]
)
def test_arguments_without_a_meaning_are_refused(argument):
    with pytest.raises(RangeError) as error:
        RUN.record().plateaus(**argument)
    assert error.value.field in (*argument, "dwell_after_settle")


def test_what_is_held_without_noise_or_read_in_coarse_steps_is_no_end_of_a_channel():
    motion = np.interp(np.arange(3000), [0, 1000, 1500, 2500, 3000], [0, 0, 1, 1, 0.5])
    assert saturated_samples(motion) == {}
    jitter = np.random.default_rng(0).normal(0, 0.3, 3000)
    stairs = np.repeat([0, 5, 2.5, 10], [1000, 1200, 300, 500])
    assert saturated_samples(np.round(stairs + jitter / 3)) == {}
    assert set(saturated_samples(np.clip(5 * motion + jitter, 0.5, 4.5))) == {"floor", "ceiling"}


def test_the_offset_of_the_load_cell_is_found_in_the_slack_muscle():
    offset = 3.0
    run = Run(levels=(0.7 * bar, 1.5 * bar), top=0.24)
    points = run.record(force=run.force + offset).plateaus().dataset
    slack = law(points.pressure, points.contraction) == 0
    assert slack.sum() >= 5 and abs(points.force[slack].mean()) < 0.1
    assert points.slack[slack].all() and not points.slack[law(points.pressure, points.contraction) > 20].any()
    assert "slack muscle" in points.table.attrs["preprocessing"]
    known = run.record(force=run.force + offset, slack_force=1.0).plateaus().dataset
    assert known.force[slack].mean() == pytest.approx(offset, abs=0.1)


def test_samples_farther_apart_than_a_plateau_are_points_already():
    time = 4.0 * np.arange(20)
    steps = Recording.of(time=time, pressure=np.full(20, 2e5), contraction=np.repeat(np.arange(10) / 50, 2), force=time)
    with pytest.raises(RangeError) as refused:
        steps.plateaus()
    assert (refused.value.field, refused.value.lower) == ("dwell", 4.0)


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


def test_a_large_excursion_before_a_plateau_is_venting():
    """From 1 to 3 bar by way of 6 bar: the friction has the sign of venting."""
    pressure = np.concatenate([np.full(300, 1.0), np.linspace(1, 6, 200), np.linspace(6, 3, 200), np.full(300, 3.0)])
    record = Recording.of(time=0.01 * np.arange(1000), pressure=pressure * bar, force=50.0 * pressure, contraction=0.1)
    assert record.plateaus().dataset.table["phase"].values.tolist() == ["", "venting"]


def test_the_scatter_of_a_regulator_over_lengths_is_one_pressure():
    """The length changes between the plateaus, so that 601 to 607 kPa are one level."""
    pressure = np.repeat([6.01, 6.04, 6.07, 6.02], 300) * bar
    contraction = np.repeat([0.0, 0.05, 0.10, 0.15], 300)
    record = Recording.of(
        time=0.01 * np.arange(1200), pressure=pressure, force=400 - 2e3 * contraction, contraction=contraction
    )
    assert np.unique(record.plateaus().dataset.levels).size == 1
