"""Which points are of one stroke, and what follows from it."""

import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset, Recording
from mckibben.identification import Grouping, fit_law
from mckibben.identification.grouping import approach_labels, finest_grouping, group_labels
from mckibben.muscle import ReynoldsLaw
from mckibben.units import bar


def points(levels, **columns):
    count = len(levels)
    return IsobaricDataset.of(
        pressure=np.array(levels) * bar, contraction=np.arange(count) / 100, force=50.0 - np.arange(count), **columns
    )


def test_a_point_of_no_direction_goes_with_the_next_of_its_level_and_repeat_or_with_the_last():
    data = points(
        [1, 1, 1, 1, 1, 2, 2, 2],
        direction=["", "unloading", "", "loading", "", "", "unloading", ""],
        repeat=[0, 0, 0, 0, 0, 0, 0, 1],
    )
    expected = ["unloading", "unloading", "loading", "loading", "loading", "unloading", "unloading", ""]
    assert approach_labels(data).tolist() == expected
    assert group_labels(data, Grouping.STROKE).tolist() == [1, 1, 0, 0, 0, 2, 2, 3]
    shuffled = data.select(np.ones(8, bool))
    order = [5, 0, 1, 6, 2, 7, 3, 4]  # levels interleaved, the order within each kept
    table = shuffled.table.isel(point=order)
    assert approach_labels(IsobaricDataset(table)).tolist() == [expected[i] for i in order]


def test_fillings_and_ventings_are_strokes_where_no_direction_is_known():
    phase = ["filling", "filling", "venting", "", "filling", "venting"]
    data = points([1, 1, 1, 1, 2, 2], phase=phase)
    assert finest_grouping(data) is Grouping.STROKE
    assert group_labels(data, Grouping.STROKE).tolist() == [0, 0, 1, 1, 2, 3]
    both = points([1, 1, 1, 1, 2, 2], phase=phase, direction=["", "", "", "loading", "", ""])
    assert approach_labels(both).tolist() == ["loading"] * 4 + ["filling", "venting"]


def test_empty_columns_tell_nothing_apart():
    data = points([1, 1, 2], direction=[""] * 3, phase=[""] * 3)
    assert finest_grouping(data) is Grouping.PRESSURE
    assert group_labels(data, Grouping.STROKE).tolist() == [0, 0, 1]
    assert len(approach_labels(data.select(np.zeros(3, bool)))) == 0


def test_the_points_of_a_raw_test_are_in_two_strokes_a_level():
    """Filled to a level at full length, and then moved there and back: the first plateau has no direction."""
    steps = [*np.arange(0, 0.13, 0.04), *np.arange(0.08, -0.01, -0.04)]
    plan = np.array([(level * bar, eps) for level in (1, 2, 3) for eps in steps])
    pressure, contraction = np.repeat(plan, 300, axis=0).T
    noise = np.random.default_rng(0).normal(size=len(plan))
    force = 1e-3 * pressure * (1 - 3 * contraction) + np.repeat(noise, 300)
    time = np.arange(len(force)) / 200
    data = Recording.of(time=time, pressure=pressure, force=force, contraction=contraction).plateaus().dataset
    assert data.table["direction"].values.tolist() == (["", *["unloading"] * 3, *["loading"] * 3]) * 3
    assert np.bincount(group_labels(data, Grouping.STROKE)).tolist() == [3, 4] * 3
    fit = fit_law(ReynoldsLaw, data)
    assert (fit.robust.by, fit.robust.groups) == (Grouping.STROKE, 6)


@pytest.mark.parametrize("column", ["direction", "phase"])
def test_friction_is_an_error_in_common_however_its_side_is_recorded(column):
    words = {"direction": ["loading", "unloading"], "phase": ["venting", "filling"]}[column]
    pressure, contraction = (a.ravel() for a in np.meshgrid(np.arange(1, 6) * bar, np.arange(10) / 50, indexing="ij"))
    clean = np.tile(1e-3 * pressure * (1 - 3 * contraction), 2)
    force = clean + np.repeat([8.0, -8.0], 50) + np.random.default_rng(0).normal(size=100)
    data = IsobaricDataset.of(
        pressure=np.tile(pressure, 2),
        contraction=np.tile(contraction, 2),
        force=force,
        slack_force=-100.0,
        **{column: np.repeat(words, 50)},
    )
    fit = fit_law(ReynoldsLaw, data)
    assert (fit.robust.by, fit.robust.groups) == (Grouping.STROKE, 10)
    assert fit.robust.standard_errors["f0"] > 1.5 * fit.standard_errors["f0"]
