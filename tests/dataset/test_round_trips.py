import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.errors import DatasetError


def assert_same(a: IsobaricDataset, b: IsobaricDataset) -> None:
    xr.testing.assert_identical(a.table, b.table)
    assert {name: a.table[name].dtype for name in a.table} == {name: b.table[name].dtype for name in b.table}


def test_what_is_not_ours_and_the_spread_of_samples_survive_netcdf(tmp_path):
    data = IsobaricDataset.of(pressure=[2e5], contraction=[0.1], force=[0], force_spread=[0.5])
    warm = IsobaricDataset(data.table.assign(temperature=("point", [295.0])))
    warm.to_netcdf(tmp_path / "data.nc")
    again = IsobaricDataset.from_netcdf(tmp_path / "data.nc")
    assert_same(again, warm)
    assert again.table["force_spread"].item() == 0.5
    again.to_netcdf(tmp_path / "again.nc")
    assert_same(IsobaricDataset.from_netcdf(tmp_path / "again.nc"), warm)


def test_arguments_go_before_what_a_netcdf_file_says(tmp_path):
    given = IsobaricDataset.of(pressure=[1e5, 1e5], contraction=[0, 0.1], force=[6, 3], specimen="A")
    given.to_netcdf(tmp_path / "a.nc")
    data = read_dataset(tmp_path / "a.nc", specimen="B", initial_length=0.18, slack_force=5.0)
    assert data.table.attrs == {"specimen": "B", "source": "", "initial_length": 0.18, "slack_force": 5.0}
    assert data.slack.tolist() == [False, True]


@pytest.mark.parametrize("content", [b"", b"pressure_bar,force_N\n1,2\n", b"\x89HDF\r\n\x1a\n" + bytes(200)])
def test_a_file_that_is_no_netcdf_is_refused(content, tmp_path):
    path = tmp_path / "data.nc"
    path.write_bytes(content)
    with pytest.raises(DatasetError, match=r"data\.nc: 1 problem\n  cannot be read as NetCDF"):
        read_dataset(path)


def test_a_missing_netcdf_file_and_renamed_columns_are_refused(tmp_path):
    with pytest.raises(DatasetError, match="no such file"):
        read_dataset(tmp_path / "none.nc")
    IsobaricDataset.of(pressure=[1e5], contraction=[0.0], force=[10.0]).to_netcdf(tmp_path / "own.nc")
    with pytest.raises(DatasetError, match="read as it is"):
        read_dataset(tmp_path / "own.nc", columns={"a": "force_N"})


@pytest.mark.slow
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.floats(0, 1, exclude_max=True))
def test_a_netcdf_file_that_lost_values_is_refused(cut, tmp_path):
    path = tmp_path / "data.nc"
    if not path.exists():
        IsobaricDataset.of(pressure=[1e5], contraction=[0], force=[3], specimen="A").to_netcdf(path)
    values = path.read_bytes()
    part = tmp_path / "part.nc"
    part.write_bytes(values[: int(cut * len(values))])
    with pytest.raises(DatasetError):
        read_dataset(part)
