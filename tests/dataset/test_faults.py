"""Recordings with faults of known truth: their plateaus are lost, or a question stops; right ones raise nothing."""

import warnings

import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset, Recording, read_dataset
from mckibben.dataset.faults import RecordedSignals
from mckibben.errors import DatasetError, McKibbenWarning, RangeError
from mckibben.units import bar, percent

RATE = 100.0
LARGEST = 400.0  # N


def law(pressure, contraction):
    return np.maximum(0, (1.1e-3 * pressure - 40) * (1 - 3.2 * contraction) - 250 * contraction)


class Samples:
    """Holds of 3 s after moves of 0.5 s: strokes at four pressures, or pressures at four lengths; or strokes alone."""

    def __init__(self, kind="strokes", *, noise=1.0, steps=(0.0, 0.0, 0.0), friction=6.0, hold=3.0, seed=0):
        if kind == "strokes":
            ends = np.concatenate([np.arange(0, 0.21, 0.04), np.arange(0.16, -0.01, -0.04)])
            plan = [(level * bar, end) for level in (1, 2, 3, 4) for end in ends]
        elif kind == "stairs":
            levels = np.concatenate([np.arange(0.5, 4.1, 0.5), np.arange(3.5, 0.4, -0.5)])
            plan = [(level * bar, end) for end in (0.0, 0.05, 0.1, 0.15) for level in levels]
        else:
            plan = [(level * bar, end) for level in (1, 2, 3, 4) for end in (0.0, 0.2) * 6]
        move = np.linspace(0, 1, int((5 if kind == "loops" else 0.5) * RATE), endpoint=False)[:, None]
        before = [(0.0, 0.0), *plan[:-1]]
        parts = [np.array(a) + (np.array(b) - a) * move for a, b in zip(before, plan, strict=True)]
        rests = [np.tile(end, (int((0 if kind == "loops" else hold) * RATE), 1)) for end in plan]
        self.pressure, self.contraction = np.concatenate([r for pair in zip(parts, rests, strict=True) for r in pair]).T
        self.time = np.arange(len(self.pressure)) / RATE
        travel = np.diff(self.contraction, prepend=0.0)
        way = np.sign(travel[np.maximum.accumulate(np.where(travel != 0, np.arange(len(travel)), 0))])
        clean = law(self.pressure, self.contraction)
        self.force = clean - friction * way * (clean > 0)
        rng = np.random.default_rng(seed)
        for name, scatter, step in zip(("pressure", "contraction", "force"), (300.0, 2e-5, 0.4), steps, strict=True):
            values = getattr(self, name) + noise * scatter * rng.normal(size=len(self.time))
            setattr(self, name, np.round(values / step) * step if step else values)

    def record(self) -> Recording:
        return Recording.of(
            time=self.time, pressure=self.pressure, force=self.force, contraction=self.contraction, slack_force=2.0
        )


def stuck(samples, name, begin, seconds):
    values = getattr(samples, name)
    at = int(begin * len(values))
    values[at : at + int(seconds * RATE)] = values[at]


def late(samples, name, seconds):
    values, shift = getattr(samples, name), int(seconds * RATE)
    setattr(samples, name, np.concatenate([np.full(shift, values[0]), values[:-shift]]))


def absolute(samples, begin):
    samples.pressure[int(begin * len(samples.time)) :] += 1.013 * bar


def right(points: IsobaricDataset, friction=6.0):
    """Whether all forces are within friction and 3 % of the law."""
    return np.all(np.abs(points.force - law(points.pressure, points.contraction)) < friction + 0.03 * LARGEST)


FINE = (1000.0, 2.5e-4, 0.5)  # steps of converters


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"kind": "stairs", "friction": 0.0},
        {"noise": 0.0},
        {"steps": FINE},
        {"steps": FINE, "noise": 0.0},
        {"kind": "stairs", "friction": 0.0, "steps": (5e3, 1e-3, 1.0), "noise": 0.0},
    ],
)
def test_right_recordings_lose_nothing_and_raise_no_question(options):
    samples = Samples(**options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        points = samples.record().plateaus()
    assert len(points.dataset) >= 44 and right(points.dataset)
    assert {*points.counts} <= {"used", "settling", "not steady"}


def test_a_slow_creep_and_weights_that_are_typed_in_are_no_faults():
    time = np.arange(0, 300, 0.02)
    pressure = np.interp(time, [0, 5, 5.5, 300], [0, 0, 4e5, 4e5]) + np.random.default_rng(0).normal(0, 200, len(time))
    force = law(4e5, 0.05) * np.where(time < 5.2, 0.0, 1 - 0.15 * np.exp(-(time - 5.2) / 30))
    record = Recording.of(time=time, pressure=pressure, force=force, contraction=0.05)
    assert len(record.plateaus().dataset) == 2
    levels = np.repeat([2.0, 2.5, 3.0, 3.5, 3.0, 2.5, 2.0], 400)
    loads = (40.0, 90.0, 150.0)
    pressure = np.tile(levels, 3) * bar + np.random.default_rng(1).normal(0, 300, 8400)
    grid = np.linspace(-0.1, 0.4, 2001)
    ends = [[np.interp(-load, -law(level * bar, grid), grid) for level in levels] for load in loads]
    contraction = np.concatenate(ends) + np.random.default_rng(2).normal(0, 2e-5, 8400)
    record = Recording.of(
        time=np.arange(8400) / RATE, pressure=pressure, force=np.repeat(loads, 2800), contraction=contraction
    )
    assert len(record.plateaus().dataset) == 21


@pytest.mark.slow
@pytest.mark.parametrize(("name", "begin"), [("pressure", 0.2), ("contraction", 0.55), ("force", 0.2)])
def test_the_plateaus_of_a_stuck_sensor_are_lost(name, begin, tmp_path):
    samples = Samples()
    stuck(samples, name, begin, 40)
    with pytest.warns(McKibbenWarning, match=f"{name} is stuck"):
        points = samples.record().plateaus()
    assert right(points.dataset) and 30 <= len(points.dataset) <= 36
    assert points.counts[f"the {name} is stuck"] == pytest.approx(40 * RATE, abs=2)
    samples.record().to_netcdf(tmp_path / "a.nc")
    with pytest.warns(McKibbenWarning, match=f"{name} is stuck"):
        data = read_dataset(tmp_path / "a.nc", accept=["order"])
    first, last = begin * samples.time[-1], begin * samples.time[-1] + 40
    assert not np.any((data.table["time"] > first + 1) & (data.table["time"] < last - 1))
    assert "is stuck" in data.table.attrs["preprocessing"]


@pytest.mark.slow
def test_loops_of_which_too_much_is_lost_say_that_there_is_no_friction(tmp_path):
    samples = Samples("loops")
    stuck(samples, "force", 0.02, 234)
    samples.record().to_netcdf(tmp_path / "a.nc")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = read_dataset(tmp_path / "a.nc", accept=["order", "rows"])
    assert "direction" not in data.table
    assert any("no friction is identified" in str(warning.message) for warning in caught)


def test_a_pressure_that_is_set_at_once_while_the_force_is_stuck_is_no_jump():
    samples = Samples()
    samples.pressure = np.round(samples.pressure / bar) * bar + np.random.default_rng(0).normal(
        0, 300, len(samples.time)
    )
    stuck(samples, "force", 0.2, 40)
    with pytest.warns(McKibbenWarning, match="force is stuck"):
        points = samples.record().plateaus()
    assert right(points.dataset) and 30 <= len(points.dataset) <= 36


def test_a_force_that_stays_between_the_steps_of_a_converter_is_stuck():
    samples = Samples(noise=0.0, steps=FINE)
    stuck(samples, "force", 0.55, 40)
    with pytest.warns(McKibbenWarning, match="force is stuck"):
        assert right(samples.record().plateaus().dataset)


@pytest.mark.parametrize("name", ["pressure", "contraction", "force"])
@pytest.mark.parametrize("levels", [(1.5, 3.0), (1.5, 2.5, 3.5)])
def test_a_late_signal_of_loops_at_few_pressures_is_a_question_with_the_delay(name, levels):
    """Few large changes; of a periodic motion the shortest delay is named."""
    time, rng = np.arange(0, 60 * len(levels), 0.05), np.random.default_rng(0)
    phase = 2 * np.pi * time / 11
    signals = {"pressure": np.array(levels)[(time // 60).astype(int)] * bar, "contraction": 0.09 * (1 - np.cos(phase))}
    signals["force"] = law(signals["pressure"], signals["contraction"]) - 6 * np.sign(np.sin(phase))
    signals[name] = np.interp(time - 2, time, signals[name])
    noisy = {
        key: signals[key] + rng.normal(0, size, len(time)) for key, size in zip(signals, (300, 2e-5, 0.4), strict=True)
    }
    asked = RecordedSignals(Recording.of(time=time, **noisy, slack_force=2.0).table).questions()
    (message,) = (query.problem.message for query in asked if "apart" in query.problem.message)
    assert message.startswith(name) and float(message.split(" are ")[1].split()[0]) == pytest.approx(2, abs=0.3)


@pytest.mark.parametrize(("name", "seconds"), [("pressure", 1.0), ("contraction", 2.0), ("force", 1.0), ("force", 5.0)])
def test_a_late_signal_is_a_question(name, seconds, tmp_path):
    samples = Samples()
    late(samples, name, seconds)
    with warnings.catch_warnings(), pytest.raises(DatasetError, match=f"{seconds:g} s apart") as caught:
        warnings.simplefilter("ignore")
        samples.record().plateaus()
    assert "accept=order" in caught.value.problems[0].remedy
    samples.record().to_netcdf(tmp_path / "a.nc")
    with warnings.catch_warnings(), pytest.raises(DatasetError, match=f"{seconds:g} s apart"):
        warnings.simplefilter("ignore")
        read_dataset(tmp_path / "a.nc")


def moved(time, contraction, levels, *, damping=0.0):
    """Points of one motion at each pressure, with friction and damping of the contraction."""
    rng, count = np.random.default_rng(0), len(time)
    once = np.gradient(contraction, time)
    pressure, rate = np.repeat(levels, count) * bar, np.tile(once, len(levels))
    contraction, start = np.tile(contraction, len(levels)), np.arange(len(levels)) * (time[-1] + 1.0)
    force = law(pressure, contraction) - 6.0 * np.tanh(rate / 1e-4) - damping * rate
    return {
        "time": (start[:, None] + time).ravel(),
        "pressure": pressure + rng.normal(0, 300, len(pressure)),
        "contraction": contraction + rng.normal(0, 2e-5, len(pressure)),
        "force": force + rng.normal(0, 0.4, len(pressure)),
    }


def written(path, columns):
    units = {"time": 1.0, "pressure": bar, "contraction": percent, "force": 1.0}
    table = np.transpose([columns[name] / unit for name, unit in units.items()])
    np.savetxt(path, table, "%.6g", ",", header="time_s,pressure_bar,contraction_percent,force_N", comments="")
    return path


@pytest.mark.parametrize("damping", [0.0, 50.0])
@pytest.mark.parametrize("motion", ["cycles", "sine", "as many samples at each speed"])
def test_periodic_motions_and_uneven_samples_are_not_late(motion, damping, tmp_path):
    time = np.arange(0, 24, 0.02)
    if motion == "cycles":
        contraction = np.interp(time % 4, [0, 2, 4], [0.01, 0.15, 0.01])
    elif motion == "sine":
        contraction = 0.08 - 0.07 * np.cos(2 * np.pi * time / 4)
    else:
        ends = np.cumsum([0, 8, 8, 3, 3, 1, 1, 0.4, 0.4])
        time = np.interp(np.arange(240), np.arange(9) * 30, ends)
        contraction = np.interp(time, ends, [0.01, 0.15] * 4 + [0.01])
    columns = moved(time, contraction, (1.5, 2.5, 3.5, 4.5), damping=damping)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(read_dataset(written(tmp_path / "a.csv", columns))) > 0


@pytest.mark.parametrize(
    ("name", "shift", "begin"), [("pressure", 1.013 * bar, 0.3), ("force", 60.0, 0.55), ("force", -15.0, 0.35)]
)
def test_another_zero_within_loops_is_a_question_with_its_time(name, shift, begin, tmp_path):
    time = np.arange(0, 30, 0.05)
    columns = moved(time, np.interp(time, [0, 15, 30], [0.01, 0.15, 0.01]), (1.5, 2.5, 3.5, 4.5))
    first = int(begin * len(columns["time"]))
    columns[name][first:] += shift
    with pytest.raises(DatasetError) as caught:
        read_dataset(written(tmp_path / "a.csv", columns))
    seconds = float(caught.value.problems[0].message.split()[1])
    assert seconds == pytest.approx(columns["time"][first], abs=2.0)
    assert "accept=order" in caught.value.problems[0].remedy


@pytest.mark.parametrize(("begin", "before"), [(0.25, False), (0.5, True), (0.75, False)])
def test_a_gauge_that_turns_absolute_within_loops_or_at_a_change_of_the_level_is_a_question(begin, before, tmp_path):
    time = np.arange(0, 30, 0.05)
    columns = moved(time, np.interp(time, [0, 15, 30], [0.01, 0.15, 0.01]), (1.5, 2.5, 3.5, 4.5))
    turn = int(begin * len(columns["time"]))
    columns["pressure"][:turn] += 1.013 * bar * before
    columns["pressure"][turn:] += 1.013 * bar * (not before)
    with pytest.raises(DatasetError) as caught:
        read_dataset(written(tmp_path / "a.csv", columns))
    (problem,) = caught.value.problems
    assert problem.field == "pressure" and "accept=order" in problem.remedy
    assert float(problem.message.split()[1]) == pytest.approx(columns["time"][turn], abs=1.0)


@pytest.mark.parametrize(("power", "threshold"), [(1.3, 0.0), (0.8, 0.0), (1.0, 1.0)])
def test_a_force_that_is_not_linear_in_the_pressure_is_no_gauge_that_turned_absolute(power, threshold, tmp_path):
    time = np.arange(0, 30, 0.05)
    columns = moved(time, np.interp(time, [0, 15, 30], [0.01, 0.15, 0.01]), (1.0, 1.5, 3.0, 4.5))
    linear = columns["pressure"] / bar
    columns["force"] *= np.maximum(linear - threshold, 0.1) ** power / linear
    assert len(read_dataset(written(tmp_path / "a.csv", columns))) > 0


@pytest.mark.parametrize(("kind", "begin"), [("strokes", 0.3), ("stairs", 0.5), ("strokes", 0.8)])
def test_a_gauge_pressure_that_turns_absolute_is_a_question(kind, begin):
    samples = Samples(kind, friction=6.0 if kind == "strokes" else 0.0)
    absolute(samples, begin)
    with pytest.raises(DatasetError) as caught:
        samples.record().plateaus()
    assert any(f"{begin * samples.time[-1]:.0f}"[:1] in problem.message for problem in caught.value.problems)


def test_a_load_cell_that_changes_its_zero_in_a_plateau_costs_it_and_is_a_question():
    samples = Samples()
    at = int(82.5 * RATE)  # in a plateau
    samples.force[at:] += 0.3 * LARGEST
    with pytest.warns(McKibbenWarning, match="jumps"), pytest.raises(DatasetError):
        samples.record().plateaus()


def test_a_clock_that_is_set_back_goes_on_in_points_and_samples(tmp_path):
    samples = Samples()
    samples.time[8000:] -= 60
    with pytest.warns(McKibbenWarning, match="the clock went back"):
        points = samples.record().plateaus()
    assert np.all(np.diff(points.time) > 0) and right(points.dataset) and len(points.dataset) >= 42
    samples.record().to_netcdf(tmp_path / "a.nc")
    with pytest.warns(McKibbenWarning, match="the clock went back"):
        data = read_dataset(tmp_path / "a.nc")
    assert np.all(np.diff(data.table["time"]) > 0)


def test_loops_have_no_plateaus_and_the_error_says_what_fits_them():
    with pytest.raises(RangeError, match="no plateaus") as caught:
        Samples("loops").record().plateaus()
    assert "mckibben identify" in caught.value.remedy


def test_many_strokes_are_thinned_with_a_note(monkeypatch):
    from mckibben.dataset import preprocessing

    monkeypatch.setattr(preprocessing, "_STROKES", 20)
    samples = Samples("loops")
    data = IsobaricDataset.of(
        time=samples.time, pressure=samples.pressure, contraction=samples.contraction, force=samples.force
    )
    table, _ = preprocessing.preprocess(data.table, slack_known=True, files=np.zeros(len(data), int))
    (note,) = [note for note in table.attrs["preprocessing"].splitlines() if "one repeat in" in note]
    assert "46 strokes" in note
    assert len(np.unique(table["set_pressure"])) == 4 and {*np.unique(table["direction"])} == {"loading", "unloading"}
    assert len(table["force"]) < 6000


def test_the_means_of_a_plateau_say_nothing_of_the_ends_of_a_sensor():
    samples = Samples(noise=0.0, steps=(2.5e3, 1 * percent / 40, 1.0))
    samples.record().plateaus()
