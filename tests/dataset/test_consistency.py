"""Files with points that contradict each other, written from a muscle of known forces: none is read in silence."""

import warnings

import numpy as np
import pytest

from mckibben.dataset import read_dataset
from mckibben.errors import McKibbenWarning


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
