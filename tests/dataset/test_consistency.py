"""Files with points that contradict each other, written from a muscle of known forces: none is read in silence."""

import warnings

import numpy as np
import pytest

from mckibben.cli.options import parse_columns
from mckibben.dataset import Recording, read_dataset, read_recording
from mckibben.dataset.plausibility import missing_marks
from mckibben.dataset.points import stuck_or_jumping
from mckibben.dataset.recipe import Recipe
from mckibben.errors import DatasetError, McKibbenWarning, RangeError, UnitError


def points(bars=(1, 2, 3, 4, 5, 6), contractions=9, largest=24.0):
    """Pressure [bar], contraction [%], force [N]: loading and unloading at each pressure, with noise."""
    rng = np.random.default_rng(5)
    down, up = np.linspace(largest, 0, contractions), np.linspace(0, largest, contractions)
    strokes = np.concatenate([up, down])
    pressure, contraction = np.repeat(bars, len(strokes)).astype(float), np.tile(strokes, len(bars))
    friction = np.tile(np.repeat([0.97, 1.03], contractions), len(bars))
    force = 100 * pressure * np.maximum(1 - contraction / (8 + 3 * pressure), 0) ** 1.3 * friction
    return pressure, contraction, force + rng.normal(0, 0.15, len(force))


@pytest.fixture
def heard(tmp_path):
    """Write a file of columns, read it, and return the dataset and the warnings."""

    def read(pressure, contraction, force, more=None, **options):
        columns = {"pressure_bar": pressure, "contraction_percent": contraction, "force_N": force} | (more or {})
        rows = [
            ",".join(f"{x:.3f}" if isinstance(x, float) else x for x in row)
            for row in zip(*columns.values(), strict=True)
        ]
        path = tmp_path / "rig.csv"
        path.write_text("\n".join([",".join(columns), *rows]) + "\n")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", McKibbenWarning)
            data = read_dataset(path, **options)
        return data, [str(one.message) for one in caught]

    return read


def changed(values, rows, to):
    values = values.copy()
    values[list(rows)] = to
    return values


def test_sound_points_are_read_without_a_warning(heard):
    data, told = heard(*points())
    assert told == []
    assert data.slack.any()  # its offset was subtracted


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda force: np.minimum(force, 200.0),
        lambda force: changed(force, [2, 39, 57, 94], 0.0),
        lambda force: changed(force, [0, 17, 18, 35], 4095.0),
    ],
    ids=["clipped", "lost", "full scale of 12 bits"],
)
def test_the_offset_of_the_slack_muscle_does_not_hide_saturation_and_lost_forces(heard, spoilt):
    pressure, contraction, force = points()
    data, told = heard(pressure, contraction, spoilt(force))
    assert "slack muscle" in data.table.attrs["preprocessing"]
    assert any("force" in one for one in told)


def test_the_scatter_of_a_taut_muscle_is_not_noise_of_a_slack_one(heard):
    pressure, contraction, force = points()
    data, told = heard(pressure, contraction, force, {"set_pressure_bar": np.full(len(force), 6.0)})
    assert data.table.attrs["slack_force"] == 0
    np.testing.assert_allclose(data.force, force, atol=1e-3)
    assert any("set_pressure" in one for one in told)


def test_a_force_that_rises_with_the_contraction_is_reported(heard):
    pressure, contraction, force = points(contractions=9, largest=4.6)
    assert heard(pressure, contraction, force)[1] == []
    assert any("--displacement" in one for one in heard(pressure, -contraction, force)[1])


def test_points_along_a_spring_are_no_wrong_sign(heard):
    pressure = np.concatenate([np.linspace(1, 6, 20), np.linspace(6, 1, 20)])
    contraction = 3 * pressure + np.repeat([0.0, 1.5], 20)
    assert heard(pressure, contraction, 10.0 * contraction)[1] == []


@pytest.mark.parametrize(
    ("column", "rows", "to"),
    [
        (0, [2, 20, 38, 57, 74], 0.0),
        (0, [2, 20, 38, 57, 74], -1.0),
        (1, [41, 59, 78, 96], 0.0),
        (2, [37, 55, 73, 92], -1.0),
        (2, [38, 74], 3000.0),
        (2, [90, 91, 106, 107], 130.0),
    ],
    ids=["pressure 0", "pressure -1", "contraction 0", "force -1", "decimal point", "wrap"],
)
def test_single_points_that_contradict_the_others_are_named(heard, column, rows, to):
    columns = list(points())
    columns[column] = changed(columns[column], rows, to)
    told = [one for one in heard(*columns)[1] if f"line {rows[-1] + 2} (" in one]
    assert len(told) == 1


@pytest.mark.parametrize("typed", [-6.0, -60.0])  # a warning, and an error
def test_one_wrong_contraction_is_named(heard, typed):
    pressure, contraction, force = points()
    try:
        told = heard(pressure, changed(contraction, [60], typed), force)[1]
    except DatasetError as error:
        told = [str(one) for one in error.problems]
    assert any("line 62" in one and "--initial-length" in one for one in told)


@pytest.mark.parametrize("scatter", [0.0, 0.01])
@pytest.mark.parametrize("typed", [30.51, 9.9, 2.55, 0.35])
def test_one_wrong_pressure_is_named_and_leaves_the_levels_as_they_are(heard, scatter, typed):
    pressure, contraction, force = points()
    pressure = changed(pressure + np.random.default_rng(3).normal(0, scatter, len(pressure)), [60], typed)
    if typed > 16:  # impossible for a muscle
        with pytest.raises(DatasetError) as error:
            heard(pressure, contraction, force)
        told = [str(one) for one in error.value.problems]
        assert len(told) == 1
    else:
        data, told = heard(pressure, contraction, force)
        assert {*data.pressures} == {1e5, 2e5, 3e5, 4e5, 5e5, 6e5, data.pressure[60]}
    assert [one for one in told if "line 62 (" in one]


def test_rows_of_a_saturated_sensor_are_left_out_from_a_given_force_on(heard, tmp_path):
    pressure, contraction, force = points()
    columns = pressure, contraction, np.minimum(force, 255.0)
    assert any("largest_force" in one and "--largest-force" in one for one in heard(*columns)[1])
    data, told = heard(*columns, largest_force=255.0)
    assert len(data) == np.count_nonzero(force < 255) < len(force)
    assert [f"{np.count_nonzero(force >= 255)} of 108 rows are left out" in one for one in told] == [True]
    assert data.place(0) == f"line {np.argmax(force < 255) + 2}"
    heard(*columns)[0].to_netcdf(tmp_path / "kept.nc")
    assert len(read_dataset(tmp_path / "kept.nc", largest_force=250.0)) == np.count_nonzero(force < 250)


@pytest.mark.parametrize("order", ["shuffled", "by contraction", "backward"])
def test_the_order_of_the_rows_is_no_contradiction(heard, order):
    columns = points()
    keys = {"shuffled": np.random.default_rng(1).random(108), "by contraction": columns[1], "backward": -np.arange(108)}
    assert heard(*(one[np.argsort(keys[order], kind="stable")] for one in columns))[1] == []


def test_a_muscle_that_is_slack_at_the_lowest_pressure_and_pulls_at_the_next_is_reported(heard):
    pressure, contraction, force = points((0, 1, 2, 3, 4, 5))
    assert heard(pressure, contraction, force)[1] == []
    assert any("absolute" in one for one in heard(pressure + 1.01325, contraction, force)[1])


def test_absolute_pressures_of_a_muscle_that_is_never_slack_are_reported(heard):
    pressure, contraction, force = points((1, 2, 3, 4), contractions=6, largest=6.0)
    assert heard(pressure, contraction, force)[1] == []
    assert any("absolute" in one for one in heard(pressure + 1.01325, contraction, force)[1])


def test_a_force_that_contradicts_those_at_less_pressure_is_named(heard):
    pressure, contraction, force = points((2, 4, 6), contractions=3, largest=12.0)
    told = [
        one for one in heard(pressure, contraction, changed(force, [14], force[14] - 400.0))[1] if "line 16 (" in one
    ]
    assert len(told) == 1


def test_forces_of_a_slower_channel_that_holds_its_value_are_reported(heard):
    pressure, contraction, force = points(contractions=9)
    rows = np.arange(len(force))
    assert any("repeat" in one for one in heard(pressure, contraction, force[rows - rows % 2])[1])
    weights = np.repeat([50.0, 100.0, 150.0], 36)  # isotonic: the force is constant by design
    assert not any("repeat" in one for one in heard(pressure, np.sort(contraction), weights)[1])


def test_two_equal_largest_forces_are_reported(heard):
    pressure, contraction = np.repeat([2.0, 3.0, 4.0], 5), np.tile(np.arange(0, 15, 3.0), 3)
    force = 83.7 * pressure * (1 - contraction / 28) ** 2
    assert heard(pressure, contraction, force)[1] == []
    assert any("saturated" in one for one in heard(pressure, contraction, np.minimum(force, 255.0))[1])


@pytest.mark.parametrize(("highest", "reported"), [(255.0, True), (1000.0, False)])
def test_three_equal_largest_forces_are_reported_where_two_others_are_equal_by_chance(heard, highest, reported):
    pressure, contraction = np.repeat([2.0, 3.0, 4.0], 5), np.tile(np.arange(0, 15, 3.0), 3)
    force = 90.7 * pressure * (1 - contraction / 32) ** 2
    force[2] = force[6]
    told = heard(pressure, contraction, np.minimum(np.round(force, 1), highest))[1]
    assert any("saturated" in one for one in told) == reported


def test_a_dead_band_is_no_offset_of_the_pressure(heard):
    pressure, contraction, force = points((0, 0.3, 1, 2, 3, 4, 5))
    dead = np.where(pressure < 0.8, np.minimum(force, 0.4), force * (pressure - 0.8) / np.maximum(pressure, 0.8))
    assert heard(pressure, contraction, dead)[1] == []
    assert heard(pressure[18:], contraction[18:], dead[18:])[1] == []


def test_reversed_directions_are_reported(heard):
    pressure, contraction, force = points()
    words = np.tile(np.repeat(["unloading", "loading"], 9), 6)
    assert heard(pressure, contraction, force, {"direction": words})[1] == []
    told = heard(pressure, contraction, force, {"direction": np.where(words == "loading", "unloading", "loading")})[1]
    assert len(told) == 1


def test_words_of_another_language_are_read_by_their_meaning(heard):
    words = np.tile(np.repeat(["descente", "Montee"], 9), 6)
    with pytest.raises(DatasetError) as caught:
        heard(*points(), {"direction": words})
    remedies = [one.remedy for one in caught.value.problems]
    assert all("columns={" in one and "--column" in one for one in remedies)
    data, told = heard(*points(), {"direction": words}, columns={"descente": "unloading", "montee": "loading"})
    assert told == []
    assert data.table["direction"].values.tolist() == np.where(words == "Montee", "loading", "unloading").tolist()


@pytest.mark.parametrize("way", ["plateaus", "isometric"])
def test_a_pull_recorded_as_negative_is_an_error_of_the_points(way):
    time = np.arange(0, 40, 0.01)
    steps = np.where(time < 20, 2e5, 3e5)
    ramp = 3e5 - np.abs(time - 20) * 1e4
    pressure = steps if way == "plateaus" else ramp
    for sign in (1, -1):
        record = Recording.of(time=time, pressure=pressure, force=sign * pressure / 1e3, contraction=0.1)
        if sign > 0:
            assert (getattr(record, way)().dataset.force > 0).all()
        else:
            with pytest.raises(DatasetError) as caught:
                getattr(record, way)()
            assert [one.field for one in caught.value.problems] == ["force"]


@pytest.mark.parametrize("read", [read_dataset, read_recording])
@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"on_corrupt": "Raise"}, "on_corrupt"),
        ({"on_corrupt": "error"}, "on_corrupt"),
        ({"on_corrupt": None}, "on_corrupt"),
        ({"on_corrupt": True}, "on_corrupt"),
        ({"initial_length": [0.18]}, "initial_length"),
        ({"slack_force": np.ones(2)}, "slack_force"),
    ],
)
def test_options_that_mean_nothing_are_errors(read, options, field, put):
    with pytest.raises(RangeError) as caught:
        read(put("time_s,pressure_bar,contraction_percent,force_N\n0,1,0,80\n1,1,1,n/a\n"), **options)
    assert caught.value.field == field


@pytest.mark.parametrize("path", [b"x", [b"x"], [None], None, 5, []])
def test_paths_that_are_no_paths_are_errors(path):
    with pytest.raises(RangeError) as caught:
        read_dataset(path)
    assert caught.value.field == "path"


@pytest.mark.parametrize(("field", "value"), [("initial_length", 180), ("slack_force", -1)])
def test_impossible_lengths_and_slack_forces_are_problems_of_the_file(field, value, heard, tmp_path):
    heard(*points())[0].to_netcdf(tmp_path / "rig.nc")
    for read in (lambda **more: heard(*points(), **more), lambda **more: read_dataset(tmp_path / "rig.nc", **more)):
        with pytest.raises(DatasetError) as caught:
            read(**{field: value})
        assert [one.field for one in caught.value.problems] == [field]


def test_a_slack_force_above_all_forces_is_reported(heard):
    data, told = heard(*points(), slack_force=1e4)
    assert not len(data.taut)
    assert any("slack_force" in one for one in told)


@pytest.mark.parametrize(("length", "count"), [(0.18, 0), (0.19, 1)])
def test_an_initial_length_that_the_file_contradicts_is_reported(put, length, count):
    path = put("# initial_length: 180 mm\npressure_bar,length_mm,force_N\n1,180,80\n2,175,140\n3,170,190\n")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", McKibbenWarning)
        read_dataset(path, initial_length=length)
    assert len([one for one in caught if "initial_length" in str(one.message)]) == count


def test_settings_of_a_recipe_without_effect_are_reported(put):
    path = put("pressure_bar,contraction_percent,force_N\n1,0,80\n2,0,160\n")
    with pytest.warns(McKibbenWarning, match="sample_rate"):
        assert len(Recipe(sample_rate=100.0).dataset(path)) == 2


def test_a_header_that_is_assigned_twice_is_an_error():
    assert parse_columns(["a=force_N", "a=force_N"]) == {"a": "force_N"}
    with pytest.raises(UnitError):
        parse_columns(["a=force_N", "a=pressure_bar"])


def test_usual_values_do_not_mark_missing_ones(heard):
    rng = np.random.default_rng(2)
    contraction = np.tile(np.linspace(0, 10, 50), 2)
    pressure = np.repeat([1000.0, 2000.0], 50) + rng.normal(0, 0.3, 100)
    pressure[[7, 8, 30]] = 999.9
    force = 0.1 * pressure * (1 - contraction / 20)
    time = 999_999.0 + 100.0 * np.arange(-50, 50)
    assert heard(pressure / 1000, contraction, force, {"time_ms": time})[1] == []
    for values in (pressure, time):
        assert not missing_marks(np.round(values, 1).astype(float))[0].any()
    ramp = np.repeat([500.0, 1000.0, 2000.0], 10) + np.tile(np.arange(-1.0, 1.0), 15)  # 999 next to another level
    assert not missing_marks(ramp)[0].any()
    decimals = np.linspace(100.5, 3000.5, 40)
    assert missing_marks(changed(decimals, [5], 1023.0))[0].nonzero()[0].tolist() == [5]
    assert not missing_marks(np.round(changed(decimals, [5], 1023.0)))[0].any()
    assert missing_marks(changed(ramp, [3], 999.0))[0].nonzero()[0].tolist() == [3]
    assert missing_marks(changed(np.linspace(0, 700, 100), [60], 999.0))[0].sum() == 1


@pytest.mark.parametrize(("highest", "reported"), [(5.98, True), (7.0, False)])
def test_pressures_cut_off_at_their_highest_level_are_reported(highest, reported, heard):
    noise = 0.01 * np.array([0, 1, -2, 1, 2, 0, 0, 0, -1, 2, 1, -1, 0, 2, -1])
    pressure = np.minimum(np.repeat([1.5, 4.0, 6.0], 5) + noise, highest)
    contraction = np.tile([0.0, 3.0, 6.0, 9.0, 12.0], 3)
    told = heard(pressure, contraction, 250 * pressure * (1 - contraction / 30) ** 2)[1]
    assert ["saturated" in one for one in told] == [True] * reported


def test_equal_pressures_of_a_coarse_sensor_are_not_reported_as_cut_off(heard):
    noise = np.array([0.0, -0.01, 0.0, 0.01, 0.0])  # one of five above the others: a level without one is likely
    pressure = np.concatenate([1.5 + noise, 4.0 + noise, 6.0 + np.minimum(noise, 0.0)])
    contraction = np.tile([0.0, 3.0, 6.0, 9.0, 12.0], 3)
    assert heard(pressure, contraction, 250 * pressure * (1 - contraction / 30) ** 2)[1] == []


@pytest.mark.parametrize(
    ("tails", "offset", "reported"),
    [
        ((2, 0, 0), 30.0, True),
        ((0, 4, 0), 30.0, True),
        ((1, 1, 1), 30.0, True),
        ((3, 0, 0), 0.0, False),
        ((0, 0, 0), 30.0, True),
    ],
    ids=["two", "four", "one at each pressure", "no offset", "extrapolated to no pressure"],
)
def test_an_offset_that_few_slack_points_show_is_reported(tails, offset, reported, heard):
    rows = []
    for pressure, tail in zip((2.0, 3.0, 4.0), tails, strict=True):
        rows += [(pressure, e, 60 * pressure * (1 - e / 28) ** 2 + offset) for e in np.linspace(0.0, 18.0, 7)]
        rows += [(pressure, e, offset) for e in np.linspace(30.0, 36.0, 4)[:tail]]
    data, told = heard(*np.array(rows).T)
    assert ["offset" in one for one in told] == [True] * reported
    assert data.force[0] == pytest.approx(120 + offset)  # not subtracted


def test_a_force_that_stands_still_for_some_rows_is_reported(heard):
    pressure, contraction, force = points()
    force[91:97] = force[91]
    assert any("repeat the row before" in text for text in heard(pressure, contraction, force)[1])


def test_a_lost_decimal_point_at_the_largest_force_is_reported(heard):
    pressure, contraction, force = points(bars=(1, 2, 3))
    at = int(np.argmax(force))
    force[at] *= 4
    assert any(f"line {at + 2} " in text for text in heard(pressure, contraction, force)[1])


@pytest.mark.parametrize(("factor", "reported"), [(1.0, False), (2.5, True)])
def test_a_force_that_would_end_beyond_the_reach_of_a_muscle_is_reported(heard, factor, reported):
    contraction = np.tile(np.linspace(0, 12, 7), 3)
    pressure = np.repeat([2.0, 3.0, 4.0], 7)
    force = 80 * pressure * (1 - contraction / 28)
    said = heard(pressure, factor * contraction, force)[1]
    assert any("would end at" in text for text in said) == reported


def sampled(**changes):
    """Samples of a taut muscle that is shortened and stretched, with noise; `changes` replace channels."""
    time = np.arange(0, 12, 0.01)
    noise = np.random.default_rng(3).normal(0, 1, (3, len(time)))
    contraction = 0.05 + 0.04 * np.sin(time) + 1e-5 * noise[0]
    pressure = 3e5 + 200 * noise[1]
    channels = {
        "time": time,
        "pressure": pressure,
        "force": 600 * (1 - contraction / 0.3) + 0.3 * noise[2],
        "contraction": contraction,
    }
    return Recording.of(**channels | {name: change(channels[name]) for name, change in changes.items()})


@pytest.mark.parametrize(
    ("channel", "change", "said"),
    [
        ("force", lambda force: force + 150 * (np.arange(len(force)) > 700), "force alone jumps, at 7.01 s"),
        ("contraction", lambda eps: np.where(eps > 0.08, eps - 0.05, eps), "contraction alone jumps"),
        ("pressure", lambda p: np.where(abs(np.arange(len(p)) - 500) < 150, p[350], p), "pressure does not change"),
        ("time", lambda time: np.floor(time * 20) / 20, "have the time of the one before"),
    ],
)
def test_samples_of_sensors_that_jump_or_stand_still_are_noted(channel, change, said):
    found = sampled(**{channel: change}).strokes(pressure_tolerance=3e3)
    assert [said in note for note in found.notes].count(True) == 1
    assert not sampled().strokes(pressure_tolerance=3e3).notes


@pytest.mark.parametrize(("friction", "noted"), [(45.0, False), (-45.0, True)])
def test_a_force_that_steps_by_friction_where_the_muscle_reverses_fast_is_no_jump(friction, noted):
    phase = 20 * np.arange(0, 12, 0.01)
    contraction = 0.05 + 0.04 * np.sin(phase)
    force = 600 * (1 - contraction / 0.3) - friction * np.sign(np.cos(phase))
    noise = np.random.default_rng(3).normal(0, 0.3, len(phase))
    found = sampled(contraction=lambda _: contraction, force=lambda _: force + noise)
    notes = list(stuck_or_jumping(found.table, np.zeros(len(phase), bool)))
    assert [note.startswith("force alone jumps") for note in notes] == [True] * noted


def test_a_recording_with_the_newest_sample_first_is_refused():
    backwards = sampled(time=lambda time: time[::-1])
    for extract in (backwards.plateaus, backwards.strokes):
        with pytest.raises(RangeError, match="does not advance"):
            extract()


@pytest.mark.parametrize(("other", "reported"), [(1.0, False), (0.3, True)])
def test_forces_of_fast_and_slow_strokes_differ_by_viscous_friction(other, reported):
    rows, end = [], 0.0
    for pressure in (1e5, 2e5, 3e5, 4e5):
        for duration in (8.0, 3.0, 1.0):
            t = np.arange(0, 4 * duration, 0.05)
            contraction = 0.05 + 0.12 * (1 - np.abs(2 * ((t / 2 / duration) % 1) - 1))
            friction = np.where((t // duration) % 2, 1, -1) * (3 + 36 / duration)  # 36 N at the highest speed
            part = other if pressure == 3e5 and duration == 3 else 1.0
            rows.append(
                [end + t, pressure + 0 * t, part * (pressure * 7e-4 * (1 - 2 * contraction) + friction), contraction]
            )
            end += t[-1] + 0.05
    time, pressure, force, contraction = np.concatenate(rows, axis=1)
    recording = Recording.of(time=time, pressure=pressure, force=force, contraction=contraction)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", McKibbenWarning)
        recording.strokes(step=0.01)
    assert any("contradict" in str(one.message) for one in caught) == reported
