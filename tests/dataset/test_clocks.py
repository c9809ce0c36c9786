"""Two recordings of one test whose clocks differ: a testing machine, and a board that measures the pressure."""

import numpy as np
import pytest

from mckibben.dataset import read_dataset, read_recording
from mckibben.errors import DatasetError

OFFSET, DRIFT = 7.3, 4e-4


def written(folder, *, repeats=False, shared=True, still=False, resolution=0.0):
    """Files of the machine (s, length, force) and of the board (ms, pressure, and perhaps a force of another scale)."""
    rng, time = np.random.default_rng(0), np.arange(0, 120, 0.02)
    other = np.arange(0, 80, 0.05)
    at = OFFSET + (1 + DRIFT) * other

    def contraction(t):
        return 0.06 * (1 - np.cos(0.5 * t if repeats else 0.02 * t**1.6))

    def pressure(t):
        return np.array([2.0, 3.0, 4.0, 3.0])[(np.asarray(t) // 30).astype(int) % 4]

    def force(t):
        return 150 * pressure(t) * (1 - contraction(t) / 0.3) ** 2 if not (repeats or still) else 100 * contraction(t)

    noise = rng.normal(0, 0.2, len(time))
    machine = np.transpose([time, 200 * (1 - contraction(time)), force(time) + noise])
    board = [
        1e3 * (np.floor(other / resolution) * resolution if resolution else other),
        pressure(at) + rng.normal(0, 0.002, len(other)),
    ]
    header = "millis [ms],pressure_bar"
    if shared:
        board.append(0.02 * (0 * at if still else force(at)) + 1)
        header += ",force_V"
    np.savetxt(folder / "machine.csv", machine, "%.5f", ",", header="time_s,length_mm,force_N", comments="")
    np.savetxt(folder / "board.csv", np.transpose(board), "%.5f", ",", header=header, comments="")
    return [folder / "machine.csv", folder / "board.csv"], (at, pressure)


NAMES = {"force_V": "50*(x-1) force_N"}


@pytest.mark.slow
def test_the_second_clock_is_estimated_from_a_force_that_both_measured(tmp_path):
    paths, (at, pressure) = written(tmp_path)
    recording = read_recording(paths, clocks="estimated", columns=NAMES, initial_length=0.2)
    assert recording.time[0] == pytest.approx(OFFSET, abs=0.03) and recording.time[-1] == pytest.approx(
        at[-1], abs=0.03
    )
    off = np.abs(recording.pressure / 1e5 - pressure(recording.time)) > 0.02
    assert np.count_nonzero(off) <= 2 * 4  # samples at the steps
    stated = read_recording(
        paths, clocks=f"{OFFSET} s, {100 * DRIFT} %", columns=NAMES | {"force_V": "ignore"}, initial_length=0.2
    )
    both = np.interp(stated.time, recording.time, recording.pressure)
    assert np.mean(np.abs(stated.pressure - both) > 2e3) < 0.01
    for points in (
        read_dataset(paths, clocks="estimated", columns=NAMES, initial_length=0.2),
        recording.plateaus(pressure_tolerance=1e5, contraction_tolerance=0.3).dataset,
    ):
        assert "second clock" in points.table.attrs["preprocessing"]


@pytest.mark.parametrize(
    ("how", "why"), [({"shared": False}, "no quantity"), ({"repeats": True}, "repeat"), ({"still": True}, "not move")]
)
def test_clocks_that_the_data_do_not_determine_are_asked_about(tmp_path, how, why):
    paths, _ = written(tmp_path, **how)
    columns = NAMES if how.get("shared", True) else {}
    with pytest.raises(DatasetError) as caught:
        read_recording(paths, clocks="estimated", columns=columns, initial_length=0.2)
    (problem,) = caught.value.problems
    assert problem.field == "clocks" and why in problem.message and "clocks=12.5 s" in problem.remedy


@pytest.mark.parametrize("resolution", [0.07, 1.0])
def test_stamps_of_a_logger_that_repeat_are_spread_evenly(tmp_path, resolution):
    paths, (at, pressure) = written(tmp_path, shared=False, resolution=resolution)
    recording = read_recording(paths, clocks=f"{OFFSET} s, {100 * DRIFT} %", initial_length=0.2)
    assert recording.time[-1] == pytest.approx(at[-1], abs=resolution + 0.05)
    away = np.min(np.abs(recording.time[:, None] - [30, 60]), axis=1) > resolution + 0.1
    np.testing.assert_allclose(recording.pressure[away] / 1e5, pressure(recording.time[away]), atol=0.02)


def test_rows_of_the_first_recording_in_a_gap_of_the_second_are_left_out(tmp_path):
    paths, _ = written(tmp_path, shared=False)
    board = np.loadtxt(paths[1], delimiter=",", skiprows=1)
    lost = (board[:, 0] > 20e3) & (board[:, 0] < 40e3)
    np.savetxt(paths[1], board[~lost], "%.5f", ",", header="millis [ms],pressure_bar", comments="")
    time = read_recording(paths, clocks=f"{OFFSET} s", initial_length=0.2).time
    assert not np.any((time > OFFSET + 20.1) & (time < OFFSET + 39.9)) and time[-1] > OFFSET + 70


@pytest.mark.parametrize(("shift", "name"), [(-3e3, "second"), (None, "second")])
def test_a_second_clock_that_is_not_usable_is_named(tmp_path, shift, name):
    paths, _ = written(tmp_path, shared=False)
    board = np.loadtxt(paths[1], delimiter=",", skiprows=1)
    if shift:
        board[800:, 0] += shift
    np.savetxt(
        paths[1], board, "%.5f", ",", header="millis [ms],pressure_bar" if shift else "repeat,pressure_bar", comments=""
    )
    with pytest.raises(DatasetError) as caught:
        read_recording(paths, clocks="3 s", initial_length=0.2)
    (problem,) = caught.value.problems
    assert name in problem.message and "state" not in problem.remedy


@pytest.mark.parametrize(("span", "unit", "scale"), [(2**32, "us", 1e6), (2**16, "ms", 1e3), (2**32, "ms", 1e3)])
def test_a_counter_that_rolls_over_goes_on(tmp_path, span, unit, scale):
    time = np.arange(0, 40, 0.01)
    counts = (span - 12 * scale + np.round(time * scale)) % span
    rows = np.column_stack([counts, 2 + 0 * time, 100 + 0 * time])
    path = tmp_path / "a.csv"
    np.savetxt(path, rows, "%.3f", ",", header=f"time [{unit}],pressure_bar,force_N", comments="")
    recording = read_recording(path)
    np.testing.assert_allclose(np.diff(recording.time), 0.01, atol=1e-5)
    assert "overflow" in recording.table.attrs["columns_read"]


def plotted(folder, *, padded: bool, second: float = 0.05, start: float = 0.0):
    """A file of a plot tool: time and pressure, time and length, time and force, of other rates each."""
    clocks = [start * at + np.arange(0, 40, step) for at, step in enumerate((second, 0.02, 0.1))]
    signals = [2 + np.sin(0.3 * clocks[0]), 200 - clocks[1] / 4, 100 + 40 * np.sin(0.3 * clocks[2])]
    count = max(map(len, clocks)) if padded else min(map(len, clocks))
    columns = [
        [f"{value:.4f}" for value in part[:count]] + [""] * (count - len(part))
        for pair in zip(clocks, signals, strict=True)
        for part in pair
    ]
    lines = [",".join(row) for row in zip(*columns, strict=True)]
    path = folder / "plot.csv"
    path.write_text("\n".join(["time_s,pressure_bar,time_s,length_mm,time_s,force_N", *lines]) + "\n")
    return path


@pytest.mark.parametrize("padded", [True, False])
def test_signals_with_times_of_their_own_are_asked_about_and_read_with_one_key(tmp_path, padded):
    path = plotted(tmp_path, padded=padded)
    with pytest.raises(DatasetError, match="clocks=paired"):
        read_recording(path, initial_length=0.2)
    recording = read_recording(path, initial_length=0.2, clocks="paired")
    assert recording.time[-1] == pytest.approx(39.9 if padded else 8, abs=0.2)
    np.testing.assert_allclose(recording.pressure / 1e5, 2 + np.sin(0.3 * recording.time), atol=1e-3)
    np.testing.assert_allclose(recording.force, 100 + 40 * np.sin(0.3 * recording.time), atol=0.1)
    np.testing.assert_allclose(recording.contraction, recording.time / 800, atol=1e-5)


def test_times_that_are_equal_or_only_rounded_are_one_clock(tmp_path):
    time = np.arange(0, 30, 0.05)
    rows = np.column_stack([time, 1e3 * time, 2 + 0 * time, np.floor(time), 100 + 0 * time])
    path = tmp_path / "a.csv"
    np.savetxt(path, rows, "%.2f", ",", header="time_s,time_ms,pressure_bar,elapsed_s,force_N", comments="")
    np.testing.assert_allclose(read_recording(path).time, time, atol=1e-9)
    rows[:, 3] = time + 4
    np.savetxt(path, rows, "%.2f", ",", header="time_s,time_ms,pressure_bar,elapsed_s,force_N", comments="")
    with pytest.raises(DatasetError, match="another clock"):
        read_recording(path)
