"""Raw recordings of the usual tests: what `points` reads, `identify` survives, and the law is right."""

import itertools

import numpy as np
import pytest

from mckibben import ExponentialLaw
from mckibben.dataset import read_dataset, read_recording
from mckibben.errors import McKibbenError, RangeError
from mckibben.identification import identify_with_friction

LENGTH, RATE, FRICTION, NOISE = 0.25, 20.0, 5.0, 0.3  # m, Hz, N
PRESSURES = (2e5, 3e5, 4e5)
STROKE = (0.0, 0.04, 0.08, 0.12, 0.08, 0.04, 0.0)


def force(pressure: np.ndarray, contraction: np.ndarray) -> np.ndarray:
    """Force of a muscle of 24 mm without friction [N]."""
    return 1.3e-3 * pressure * (1 - contraction / 0.28) ** 2


def path(*parts: tuple[float, float, float]) -> np.ndarray:
    """Samples along straight parts of a duration [s] from one value to another."""
    return np.concatenate([np.linspace(a, b, int(RATE * t), endpoint=False) for t, a, b in parts])


def stop_and_go() -> tuple[np.ndarray, np.ndarray]:
    moves = path(*(part for a, b in itertools.pairwise(STROKE) for part in ((1, a, b), (2, b, b))))
    return np.repeat(PRESSURES, len(moves)), np.tile(moves, 3)


def slow_loops() -> tuple[np.ndarray, np.ndarray]:
    loop = path((15, 0, 0.12), (15, 0.12, 0))
    return np.repeat(PRESSURES, len(loop)), np.tile(loop, 3)


def strokes_at_speeds() -> tuple[np.ndarray, np.ndarray]:
    loop = path(*(part for t in (20, 8, 3) for part in ((t, 0, 0.12), (t, 0.12, 0))))
    return np.repeat(PRESSURES, len(loop)), np.tile(loop, 3)


def steps_of_pressure() -> tuple[np.ndarray, np.ndarray]:
    levels = path(
        *(
            part
            for a, b in zip((1, 2, 3, 4, 3, 2), (2, 3, 4, 3, 2, 1), strict=True)
            for part in ((0.3, a, b), (3, b, b))
        )
    )
    lengths = np.repeat((0.0, 0.04, 0.08, 0.12), len(levels))
    return 1e5 * np.tile(levels, 4), lengths


def sweeps_of_pressure() -> tuple[np.ndarray, np.ndarray]:
    sweep = path((15, 1, 4), (15, 4, 1))
    return 1e5 * np.tile(sweep, 4), np.repeat((0.0, 0.04, 0.08, 0.12), len(sweep))


TESTS = (stop_and_go, slow_loops, strokes_at_speeds, steps_of_pressure, sweeps_of_pressure)


@pytest.mark.slow
@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("test", TESTS)
def test_what_points_reads_identify_survives(test, gap, tmp_path):
    pressure, contraction = test()
    rng, moved = np.random.default_rng(1), np.diff(contraction, prepend=contraction[:1])
    side = np.sign(moved)
    for at in range(1, len(side)):
        side[at] = side[at] or side[at - 1]
    time = np.arange(len(pressure)) / RATE + (np.arange(len(pressure)) > 600) * (7.0 if gap else 0.0)
    measured = force(pressure, contraction) - FRICTION * side + rng.normal(0, NOISE, len(time))
    columns = [time, (pressure + rng.normal(0, 200, len(time))) / 1e5, 100 * contraction, measured]
    file = tmp_path / "rig.csv"
    np.savetxt(
        file, np.transpose(columns), "%.5f", ",", header="time_s,pressure_bar,contraction_percent,force_N", comments=""
    )
    try:
        plateaus = read_recording(file, initial_length=LENGTH).plateaus().dataset
    except RangeError as error:
        assert "mckibben identify FILE" in error.remedy and test in (slow_loops, strokes_at_speeds, sweeps_of_pressure)
        plateaus = None
    data = read_dataset(file, initial_length=LENGTH)
    assert ("mckibben points" in data.table.attrs["preprocessing"]) == (test in (stop_and_go, steps_of_pressure))
    for points in (data, plateaus):
        if points is None:
            continue
        try:
            fit = identify_with_friction(ExponentialLaw, points)
        except McKibbenError as error:
            pytest.fail(f"{test.__name__}: {error}")
        where = np.array([2.5e5, 3.5e5]), np.array([0.03, 0.1])
        np.testing.assert_allclose(fit.predict(where[1], where[0]), force(*where), atol=FRICTION + 1)
