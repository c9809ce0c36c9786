"""Points near a turn of the stroke, on datasets made by hand."""

import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset
from mckibben.errors import RangeError
from mckibben.rig import away_from_turns
from mckibben.units import mm

LENGTH = 0.1  # so that 1 % is 1 mm


def strokes(low: int, high: int, *, pressure: float = 1e5, repeat: int = 0) -> dict[str, list]:
    """Stretched from `high` to `low` percent in steps of 1 mm, and back."""
    loading, unloading = list(range(high, low - 1, -1)), list(range(low, high + 1))
    percent = loading + unloading
    return {
        "pressure": [pressure] * len(percent),
        "contraction": [p / 100 for p in percent],
        "force": [100.0 - p for p in percent],
        "direction": ["loading"] * len(loading) + ["unloading"] * len(unloading),
        "repeat": [repeat] * len(percent),
    }


def data(*parts: dict[str, list], initial_length: float | None = LENGTH, **without) -> IsobaricDataset:
    columns = {name: [x for part in parts for x in part[name]] for name in parts[0]}
    return IsobaricDataset.of(**{k: v for k, v in columns.items() if k not in without}, initial_length=initial_length)


def kept(dataset: IsobaricDataset, direction: str) -> list[int]:
    here = dataset.table["direction"].to_numpy() == direction
    return sorted(round(100 * c) for c in dataset.contraction[here])


@pytest.mark.parametrize(("travel", "left"), [(0.0, 11), (0.5 * mm, 9), (1 * mm, 9), (1.01 * mm, 7), (5 * mm, 1)])
def test_the_travel_is_a_length(travel, left):
    assert len(away_from_turns(data(strokes(0, 10)), travel=travel)) == 2 * left


def test_every_pressure_and_repeat_turns_for_itself():
    found = away_from_turns(data(strokes(0, 10), strokes(-3, 5, pressure=2e5), strokes(2, 8, repeat=1)))
    at = lambda pressure, repeat: found.select(  # noqa: E731
        (found.levels == pressure) & (found.table["repeat"].to_numpy() == repeat)
    )
    for direction in ("loading", "unloading"):
        assert kept(at(1e5, 0), direction) == list(range(2, 9))
        assert kept(at(2e5, 0), direction) == list(range(-1, 4))
        assert kept(at(1e5, 1), direction) == list(range(4, 7))


def test_measured_pressures_with_noise_count_by_their_set_pressure():
    whole = strokes(0, 10)
    nominal = np.array(whole.pop("pressure"))
    noisy = nominal + np.random.default_rng(0).normal(0, 500, nominal.size)
    found = away_from_turns(IsobaricDataset.of(**whole, pressure=noisy, set_pressure=nominal, initial_length=LENGTH))
    assert kept(found, "loading") == list(range(2, 9))


def test_without_a_direction_or_a_length_turns_are_not_known():
    for dataset in (data(strokes(0, 10), initial_length=None), data(strokes(0, 10), direction=None)):
        with pytest.raises(RangeError, match="keep all points"):
            away_from_turns(dataset)
