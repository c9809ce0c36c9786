"""Slack force, levels and passes found in the data, and mistakes of sign, unit and initial length."""

import numpy as np
import pytest
import xarray as xr

from mckibben import ExponentialLaw, IsobaricDataset, catalog, read_dataset
from mckibben.dataset.preprocessing import passes, pressure_levels, slack_force
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.identification import fit_law
from mckibben.muscle import ChouLaw, forces
from mckibben.units import bar, deg, mm

TRUTH = {"a1": -200.0, "a2": 95.0, "b1": 1.0, "b2": -3.0, "c1": 170.0, "c2": -4.0, "decay": 0.36}  # bar, percent
SI = {"a1": 1.0, "a2": 1e-5, "b1": 100.0, "b2": 1e-3, "c1": 1.0, "c2": 1e-5, "decay": 100.0}
LENGTH = 250 * mm


def measured(seed=0, *, bars=(1, 2, 3, 4, 5, 6), noise=1.2, offset=0.0, scatter=0.01, largest=0.26, repeats=1):
    """Pressure [bar], contraction, force [N] of an Eq. 2 muscle with 7 N of friction, pressure by pressure."""
    rng = np.random.default_rng(seed)
    stroke = np.linspace(0, largest, 20)
    contraction = np.tile(np.concatenate([stroke, stroke[::-1]]), len(bars) * repeats)
    side = np.tile(np.repeat([-1.0, 1.0], 20), len(bars) * repeats)
    pressure = np.repeat(np.array(bars, float), 40 * repeats) + rng.normal(0, scatter, contraction.size)
    t, percent = TRUTH, 100 * contraction
    law = t["a1"] + t["a2"] * pressure + (t["b1"] + t["b2"] * pressure) * percent
    law += (t["c1"] + t["c2"] * pressure) * np.exp(-t["decay"] * percent)
    force = np.maximum(law + 7 * side, 0) + offset + rng.normal(0, noise, contraction.size)
    return pressure, contraction, force, side


@pytest.fixture
def written(tmp_path):
    """Writes a semicolon file with decimal commas; its columns are those of `read`."""

    def write(pressure, contraction, force):
        rows = [
            f"{p:.3f};{f:.2f};{1e3 * LENGTH * (1 - c):.2f}"
            for p, c, f in zip(pressure, contraction, force, strict=True)
        ]
        path = tmp_path / "lab.csv"
        path.write_text("\n".join(["Druck [bar];Kraft [N];Laenge [mm]", *rows]).replace(".", ",") + "\n")
        return path

    return write


def read(path, *, length=LENGTH, pressure="pressure_bar", **options):
    columns = {"Druck [bar]": pressure, "Kraft [N]": "force_N", "Laenge [mm]": "length_mm"}
    return read_dataset(path, columns=columns, initial_length=length, **options)


@pytest.mark.slow
def test_intervals_of_plain_files_hold_the_truth(written):
    for seed in range(5):
        pressure, contraction, force, side = measured(seed, offset=3.0)
        data = read(written(pressure, contraction, force))
        assert data.pressures.tolist() == [1e5, 2e5, 3e5, 4e5, 5e5, 6e5]
        assert (data.table["direction"].to_numpy() == np.where(side > 0, "loading", "unloading")).all()
        assert "repeat" not in data.table
        assert len(data.table.attrs["preprocessing"].splitlines()) == 3
        fit = fit_law(ExponentialLaw, data)
        intervals = fit.intervals(0.95)
        assert all(low <= TRUTH[name] * SI[name] <= high for name, (low, high) in intervals.items())
        assert fit.rmse == pytest.approx(7.1, abs=0.5)
        assert fit.leave_one_pressure_out.rmse < 8


def test_a_file_that_was_preprocessed_is_read_back_as_it_is(written, tmp_path):
    data = read(written(*measured(repeats=2)[:3]))
    assert data.repeats.tolist() == [0, 1]
    data.to_csv(tmp_path / "kept.csv")
    del data.table.attrs["columns_read"]  # of the first file
    xr.testing.assert_allclose(read_dataset(tmp_path / "kept.csv").table, data.table, rtol=1e-8)  # nine digits


@pytest.mark.parametrize(("noise", "offset", "largest"), [(1.2, 0.0, 0.26), (0.2, -8.0, 0.26), (1.2, 30.0, 0.12)])
def test_the_slack_force_is_found_from_its_noise(noise, offset, largest):
    pressure, contraction, force, _ = measured(noise=noise, offset=offset, largest=largest)
    found = slack_force(force, contraction, np.round(pressure), np.round(pressure).astype(int))
    error = 4 * noise / np.sqrt(found.points)
    assert found.offset == pytest.approx(offset, abs=error)
    assert found.noise == pytest.approx(noise, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("offset", [-0.5, 0.0, 0.5])
def test_a_reading_that_is_never_negative_hides_no_slack_muscle(written, offset):
    for seed in range(3):
        pressure, contraction, force, _ = measured(seed, noise=1.2, offset=offset)
        data = read(written(pressure, contraction, np.maximum(force, 0)))
        assert data.table.attrs["slack_force"] == pytest.approx(4.8, rel=0.4)
        assert fit_law(ExponentialLaw, data).rmse == pytest.approx(7.1, abs=0.5)


def test_the_offset_is_found_over_points_of_several_fixed_lengths(tmp_path):
    """Steps of the pressure at each of four lengths: only together they show the slack muscle."""
    rng, levels, paths = np.random.default_rng(0), np.r_[0:6, 4:-1:-1] * bar, []
    for contraction in (0.0, 0.05, 0.1, 0.15):
        force = 3e-4 * levels * (1 - 4 * contraction) + 2.0 + rng.normal(0, 0.05, levels.size)
        points = IsobaricDataset.of(
            pressure=levels, contraction=np.full(levels.size, contraction), force=force, set_pressure=levels
        )
        paths.append(tmp_path / f"{contraction}.csv")
        points.to_csv(paths[-1])
    assert not read_dataset(paths[0]).slack.any()
    data = read_dataset(paths)
    assert data.slack.sum() == 8
    assert data.force[data.slack] == pytest.approx(0.0, abs=0.2)
    assert "offset" in data.table.attrs["preprocessing"]
    kept = read_dataset(paths, slack_force=0.0)
    assert kept.force.min() > 1.5


def test_taut_points_are_no_slack_force():
    pressure, contraction, force, _ = measured(bars=(4, 5, 6), largest=0.08)
    assert slack_force(force, contraction, np.round(pressure), np.round(pressure).astype(int)) is None
    chart = catalog.dataset("festo-tool-10mm")
    assert slack_force(chart.force, chart.contraction, chart.levels, chart.levels.astype(int)) is None


@pytest.mark.parametrize("pressures", [5, 6])
def test_the_last_taut_points_of_several_curves_are_no_slack_force(pressures):
    """They scatter about a mode by the steps of the contraction, and fall with it."""
    pressure, contraction = map(np.ravel, np.meshgrid(np.linspace(0, 6, pressures) * bar, np.linspace(0, 0.24, 9)))
    force = forces(ChouLaw(28 * deg, 10 * mm), contraction, pressure) - 60.0
    force = force + np.random.default_rng(1).normal(0, 0.05, force.size)
    taut = force > 2.5
    passes = np.round(pressure).astype(int)
    assert slack_force(force[taut], contraction[taut], pressure[taut], passes[taut]) is None


@pytest.mark.parametrize("noise", [0.1, 1.0])
def test_strokes_that_end_at_one_force_are_not_slack(noise):
    """A test that stops at 20 N."""
    law, pressure = catalog.law("lei-mas-10-180n"), np.repeat(np.linspace(1.5, 6, 6) * bar, 10)
    stroke = np.linspace(0, 0.35, 500)
    ends = [np.interp(-20, -np.asarray(forces(law, stroke, one)), stroke) for one in pressure]
    contraction = np.tile(np.linspace(0, 1, 10), 6) * ends
    force = np.asarray(forces(law, contraction, pressure)) + np.random.default_rng(1).normal(0, noise, 60)
    assert slack_force(force, contraction, pressure, np.round(pressure).astype(int)) is None


def narrow(threshold, offset):
    """Pressure, contraction and force of a muscle that pulls from a pressure on [bar], in a window of 3 %."""
    pressure, contraction = map(np.ravel, np.meshgrid(np.linspace(1, 6, 6), np.linspace(0.05, 0.08, 13), indexing="ij"))
    force = 500 * np.maximum(pressure - threshold, 0) * (1 - 3 * contraction) ** 2 + offset
    return pressure, contraction, force + np.random.default_rng(1).normal(0, 4, force.size)


def test_forces_at_one_pressure_of_a_narrow_window_are_not_slack(written):
    """Whether the muscle is slack at 1 bar is not known: nothing is subtracted, and a note says so."""
    for threshold, offset in ((1.3, 20.0), (0.95, 0.0)):
        pressure, contraction, force = narrow(threshold, offset)
        data = read(written(pressure, contraction, force))
        np.testing.assert_allclose(data.force, force, atol=0.01)
        assert "load cell is not estimated" in data.table.attrs["preprocessing"]


def test_arrays_keep_a_zero_error_of_the_load_cell_with_a_warning():
    pressure, contraction, force, _ = measured(offset=8.0)
    with pytest.warns(McKibbenWarning, match="lowest forces"):
        data = IsobaricDataset.of(pressure=pressure * bar, contraction=contraction, force=force)
    assert np.array_equal(data.force, force)
    small = IsobaricDataset.of(pressure=pressure * bar, contraction=contraction, force=force - 6.5)
    assert small.slack.sum() > 120 and np.array_equal(small.force, force - 6.5)  # an error within the noise


def test_levels_and_their_nominal_pressures():
    rng = np.random.default_rng(1)
    bars = np.repeat([0.5, 1.0, 1.5, 3.0], [5, 9, 7, 12])
    order = rng.permutation(bars.size)
    levels = pressure_levels((bars + rng.normal(0, 0.01, bars.size))[order] * bar)
    np.testing.assert_allclose(levels / bar, bars[order], atol=0.02)
    assert np.unique(levels).size == 4
    assert np.isnan(pressure_levels(rng.uniform(0, 6, 1000) * bar)).all()
    assert np.array_equal(pressure_levels(bars * bar), bars * bar)


def test_scatter_about_one_pressure_is_one_level_and_determines_nothing_of_the_pressure(written):
    pressure, contraction, force, _ = measured(bars=(3,), scatter=2e-3)
    data = read(written(pressure, contraction, force))
    assert len(data.pressures) == 1
    with pytest.raises(IdentificationError) as caught:
        fit_law(ExponentialLaw, data)
    assert caught.value.field == "pressure"


def test_samples_in_which_the_pressure_changes_are_no_levels(tmp_path):
    """Strokes at three pressures at 10 Hz, with two samples in each change of the pressure."""
    once = np.concatenate([np.zeros(30), np.linspace(0, 0.1, 100), np.linspace(0.1, 0, 100), np.zeros(30)])
    pressure = np.repeat([2.0, 3.0, 4.0], len(once))
    for change in (1, 2):
        pressure[change * len(once) - 1 : change * len(once) + 1] += 0.3, -0.3
    force = 150 * pressure * (1 - np.tile(once, 3) / 0.3) ** 2
    rows = np.transpose([0.1 * np.arange(len(force)), pressure, 250 * (1 - np.tile(once, 3)), force])
    np.savetxt(tmp_path / "a.csv", rows, "%.4f", ",", header="time_s,pressure_bar,length_mm,force_N", comments="")
    data = read_dataset(tmp_path / "a.csv", initial_length=LENGTH)
    assert data.pressures.tolist() == [2e5, 3e5, 4e5] and len(data.directions) == 2


def test_passes_need_reversals():
    up = np.linspace(0, 0.2, 10)
    one = np.zeros(30, int)
    direction, repeat = passes(one, np.concatenate([up, up[::-1], up]))
    assert direction[[0, 9, 10, 19, 20, 29]].tolist() == ["unloading"] * 2 + ["loading"] * 2 + ["unloading"] * 2
    assert repeat[[0, 19, 20]].tolist() == [0, 0, 1]
    assert passes(np.repeat([0, 1, 2], 10), np.tile(up, 3)) is None
    assert passes(one, np.random.default_rng(0).uniform(0, 0.2, 30)) is None


def test_passes_need_reversals_at_most_points_and_not_at_most_pressures():
    """After a loss two short strokes at pressures of their own leave the directions of the others known."""
    loop, stroke = np.r_[np.linspace(0, 0.2, 20), np.linspace(0.2, 0, 20)], np.linspace(0, 0.1, 10)
    groups = np.repeat([0, 1, 2, 3], [40, 10, 10, 40])
    direction, _ = passes(groups, np.concatenate([loop, stroke, stroke[::-1], loop]))
    assert direction[[5, 35, 45, 55, 95]].tolist() == ["unloading", "loading", "unloading", "loading", "loading"]


@pytest.mark.slow
def test_points_without_levels_have_blocks_all_the_same(written):
    pressure, contraction, force, _ = measured(scatter=0.3)
    data = read(written(pressure, contraction, force))
    assert "set_pressure" not in data.table
    assert len(fit_law(ExponentialLaw, data).leave_one_pressure_out.by_level) == 8


@pytest.mark.parametrize("zero", [0.0, -200.0])
def test_repeats_of_one_taut_point_are_not_slack(zero):
    """Four lengths at three pressures, each five times: the least force is measured five times at one point."""
    contraction, pressure = (
        np.repeat(axis.ravel(), 5) for axis in np.meshgrid([0.0, 0.05, 0.1, 0.15], [4e5, 5e5, 6e5])
    )
    force = 1e-3 * pressure * (1 - 4 * contraction) + np.random.default_rng(1).normal(0, 0.3, contraction.size)
    assert slack_force(force + zero, contraction, pressure, np.zeros(contraction.size, int)) is None


def test_a_muscle_that_only_begins_to_pull_is_not_slack():
    """At one length, the lowest forces rise with the pressure by less than the gap above them."""
    pressure = np.r_[np.linspace(0.5, 2.6, 15), np.linspace(2.9, 6, 20)] * bar
    force = np.interp(pressure, np.array([0.5, 2.6, 2.9, 6.0]) * bar, [6.0, 12.0, 35.0, 240.0])
    force += np.random.default_rng(1).normal(0, 0.2, force.size)
    assert slack_force(force, np.full(35, 0.04), pressure, np.zeros(35, int)) is None
