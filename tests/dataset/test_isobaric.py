import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset
from mckibben.errors import DatasetError, RangeError
from mckibben.units import bar


def grid(**more) -> IsobaricDataset:
    """Three pressures by two contractions by two repeats; forces 0..11 N."""
    pressure, contraction, repeat = np.meshgrid([1 * bar, 2 * bar, 4.5 * bar], [0.0, 0.2], [1, 2], indexing="ij")
    values = {
        "pressure": pressure.ravel(),
        "contraction": contraction.ravel(),
        "force": np.arange(12.0),
        "repeat": repeat.ravel(),
        "direction": np.where(contraction.ravel() > 0, "unloading", "loading"),
    }
    return IsobaricDataset.of(**values | more)


def test_a_dataset_keeps_what_it_was_given_with_units_and_attributes():
    data = grid(specimen="DMSP-10-250", initial_length=0.25, source="rig 2", slack_force=0.5)
    assert len(data) == 12
    assert data.pressure.dtype == data.contraction.dtype == data.force.dtype == np.float64
    assert data.force.tolist() == list(range(12))
    assert data.table.sizes == {"point": 12}
    assert {name: data.table[name].attrs["units"] for name in ("pressure", "contraction", "force")} == {
        "pressure": "Pa",
        "contraction": "1",
        "force": "N",
    }
    assert all(data.table[name].attrs["long_name"] for name in data.table)
    assert data.table.attrs == {
        "specimen": "DMSP-10-250",
        "source": "rig 2",
        "slack_force": 0.5,
        "initial_length": 0.25,
    }
    assert "initial_length" not in grid().table.attrs


def test_the_arrays_of_the_caller_and_of_the_dataset_do_not_touch():
    force = np.arange(3.0)
    data = IsobaricDataset.of(pressure=[0, 0, 0], contraction=[0, 0, 0], force=force)
    force[0] = 99
    assert data.force[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        data.force[0] = 1


def test_slack_is_a_force_up_to_the_slack_force():
    assert grid().slack.tolist() == [True] + 11 * [False]
    noisy = grid(slack_force=2.0)
    assert noisy.slack.sum() == 3
    assert noisy.taut.force.min() == 3
    assert noisy.taut.table.attrs["slack_force"] == 2.0


def test_levels_are_the_set_pressures_where_known():
    data = IsobaricDataset.of(
        pressure=[1.01e5, 2.02e5, 3e5], contraction=[0, 0, 0], force=[1, 2, 3], set_pressure=[1e5, 2e5, np.nan]
    )
    assert data.levels.tolist() == [1e5, 2e5, 3e5]
    assert data.at([2e5, 3e5]).force.tolist() == [2, 3]
    assert grid().pressures.tolist() == [1e5, 2e5, 4.5e5]


def test_at_takes_what_is_near_and_names_what_there_is():
    assert grid().at(2.005 * bar).force.tolist() == [4, 5, 6, 7]
    assert len(grid().at([1 * bar, 2 * bar])) == 8
    assert len(grid().at(1.9 * bar, tolerance=0.2 * bar)) == 4
    with pytest.raises(RangeError, match=r"no point at 3 bar; there are 1, 2, 4\.5"):
        grid().at([2 * bar, 3 * bar])


@pytest.mark.parametrize("mask", [np.ones(11, bool), np.ones(12, int), True, np.ones((12, 1), bool)])
def test_a_mask_is_one_boolean_per_point(mask):
    with pytest.raises(RangeError, match="one boolean per point"):
        grid().select(mask)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"force": [1, 2]}, "force: has 2 values for 12 points"),
        ({"force": 12 * ["a"]}, "force: contains values other than numbers"),
        ({"force": [*range(11), np.inf]}, "force: inf at point 11 is not finite"),
        ({"contraction": [*range(12)]}, r"contraction: 1 at point 1 .* \(and 10 more\); .* percent"),
        ({"pressure": [-2e5] + 11 * [0]}, "pressure: -200000 at point 0 is below"),
        ({"direction": [*(11 * ["loading"]), "sideways"]}, "direction: 'sideways' at point 11"),
        ({"repeat": [*range(11), 0.5]}, "repeat: 0.5 at point 11"),
        ({"force_spread": np.zeros((12, 2))}, "2 dimensions instead of 1"),
        ({"initial_length": -1.0}, "initial_length: -1 m is not above 0"),
        ({"slack_force": True}, "slack_force: True is not a finite number"),
    ],
)
def test_what_cannot_have_been_measured_is_refused(bad, message):
    with pytest.raises(DatasetError, match=message):
        grid(**bad)


def test_all_problems_are_raised_at_once():
    with pytest.raises(DatasetError) as caught:
        grid(force=12 * [np.nan], contraction=12 * [2.0], initial_length="long")
    assert [problem.field for problem in caught.value.problems] == ["contraction", "force", "initial_length"]


def test_a_table_in_other_units_is_refused():
    table = grid().table.copy()
    table["pressure"].attrs["units"] = "bar"
    with pytest.raises(DatasetError, match="pressure: is in 'bar'; give it in 'Pa'"):
        IsobaricDataset(table)
    with pytest.raises(DatasetError, match="force: is missing"):
        IsobaricDataset(grid().table.drop_vars("force"))


def test_a_test_at_0_bar_alone_is_no_mistake_of_the_unit():
    given = {"pressure": [120.0, -80.0, 250.0], "contraction": [0.0, 0.1, 0.2], "force": [3.0, 1.0, 0.2]}
    assert len(IsobaricDataset.of(**given, set_pressure=[0.0] * 3)) == 3
    with pytest.raises(DatasetError):
        IsobaricDataset.of(**given | {"pressure": [1.0, 2.0, 3.0]}, set_pressure=[1.0, 2.0, 3.0])
