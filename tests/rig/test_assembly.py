"""The record of a test to its dataset: the right rows, wherever the chunks end."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import DatasetError, McKibbenWarning
from mckibben.rig.bench import Bench, RigLimits
from mckibben.rig.record import PLACE, POINT, Event, RecordedPoint, Recorder, assemble, points
from mckibben.rig.runner import columns_of
from mckibben.rig.simulated import FORCE_SENSOR, PRESSURE_SENSOR

BENCH = Bench(
    of=catalog.specimen("MAS-10-180N-AA-MC-O"), limits=RigLimits(pressure=6e5, force=630.0, stretch=0.01, shorten=0.05)
)
POINT_0 = RecordedPoint(
    number=0,
    first=5,
    rows=28,
    every=3,
    samples=10,
    time=0.5,
    position=-1.8e-3,
    contraction=0.01,
    force=0.0,
    pressure=0.0,
    set_pressure=1e5,
    set_force=None,
    direction="loading",
    phase="",
    repeat=0,
    keep=True,
)
POINTS = [
    POINT_0,
    replace(POINT_0, number=1, first=40, time=1.5, keep=False),
    replace(POINT_0, number=2, first=70, time=2.5, repeat=1),
]


def write(folder, size, kept=POINTS):
    """A hundred rows in chunks of a size, whose values are their number."""
    with Recorder(folder, {}, columns_of([FORCE_SENSOR.channel, PRESSURE_SENSOR.channel])) as recorder:
        for first in range(0, 100, size):
            number = np.arange(first, min(first + size, 100))
            recorder.append(np.stack([number / 1e3, number / 100, number * 1e3, number, 0 * number], axis=1).tolist())
            recorder.flush()
        for point in kept:
            recorder.event(POINT if point.keep else PLACE, **asdict(point))


@pytest.mark.parametrize("size", [1, 2, 7, 28, 100])
def test_each_point_gets_its_own_samples(tmp_path, size):
    write(tmp_path, size)
    data = assemble(tmp_path, BENCH, source="ours")
    rows = np.array([5 + 3 * np.arange(10), 70 + 3 * np.arange(10)])
    np.testing.assert_allclose(data.force, (rows / 100).mean(axis=1), rtol=1e-6)
    np.testing.assert_allclose(data.table["force_spread"], (rows / 100).std(axis=1), rtol=1e-6)
    np.testing.assert_allclose(data.pressure, 1e3 * rows.mean(axis=1), rtol=1e-6)
    assert data.table["time"].to_numpy().tolist() == [0.5, 2.5]
    assert data.repeats.tolist() == [0, 1] and data.table.attrs["source"] == "ours"


def test_points_of_different_lengths_have_means(tmp_path):
    write(tmp_path, 9, [POINT_0, replace(POINT_0, number=1, first=40, rows=5, every=1, samples=5)])
    data = assemble(tmp_path, BENCH)
    assert data.force == pytest.approx([0.185, 0.42])


def test_what_is_not_there_is_told(tmp_path):
    write(tmp_path / "1", 9, [])
    with pytest.raises(DatasetError, match="no point yet"):
        assemble(tmp_path / "1", BENCH)
    for name, first in (("2", 200), ("3", 90)):
        write(tmp_path / name, 9, [replace(POINT_0, first=first)])
        with pytest.raises(DatasetError, match="no complete point"):
            assemble(tmp_path / name, BENCH)


def test_a_point_without_all_its_samples_is_left_out(tmp_path):
    write(tmp_path, 9, [replace(POINT_0, first=90), replace(POINT_0, number=1)])
    with pytest.warns(McKibbenWarning, match="points 0 are missing"):
        data = assemble(tmp_path, BENCH)
    assert data.force == pytest.approx([0.185], rel=1e-6)


def test_a_point_counts_once_as_it_was_measured_last():
    events = [Event(POINT, "", 0, asdict(point)) for point in (POINTS[2], replace(POINT_0, first=50), POINT_0)]
    assert points([*events, Event("stopped", "", 0, {})]) == [POINT_0, POINTS[2]]
