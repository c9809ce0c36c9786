"""Files that lead elsewhere, claim what they do not hold, make a library loop, or exceed the limits of a reader."""

import os
import runpy
import struct
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.dataset.child import call_in_child
from mckibben.errors import DatasetError

SECONDS = 20.0
COLUMNS = {"pressure": np.arange(6.0) * 1e5, "contraction": np.arange(6) / 50, "force": np.arange(6.0) * 40}


@pytest.fixture
def dataset():
    return IsobaricDataset.of(**COLUMNS, direction=["loading", "unloading"] * 3)


@pytest.fixture
def netcdf(tmp_path, dataset):
    path = tmp_path / "rig.nc"
    dataset.table.to_netcdf(path, engine="h5netcdf")  # without a checksum
    return path


def refused_by(path):
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    return caught.value


def refused(path):
    start = time.perf_counter()
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    assert time.perf_counter() - start < SECONDS
    assert caught.value.source == str(path)
    return caught.value.problems[0]


def replace_force(path, make):
    with h5py.File(path, "r+") as file:
        del file["force"]
        make(file)


def external_storage(file):
    secret = file.filename + ".txt"
    Path(secret).write_bytes(bytes(48))
    file.create_dataset("force", (6,), "f8", external=[(secret, 0, 48)])


def external_link(file):
    with h5py.File(file.filename + ".h5", "w") as other:
        other["force"] = COLUMNS["force"]
    file["force"] = h5py.ExternalLink(file.filename + ".h5", "force")


def virtual(file):
    layout = h5py.VirtualLayout((6,), "f8")
    layout[:] = h5py.VirtualSource(file.filename + ".h5", "force", (6,))
    file.create_virtual_dataset("force", layout)


@pytest.mark.slow
@pytest.mark.parametrize("make", [external_storage, external_link, virtual])
def test_netcdf_never_leads_to_another_file(netcdf, make):
    replace_force(netcdf, make)
    assert refused(netcdf).field == "force"


def test_units_that_are_an_array_are_an_error(netcdf):
    with h5py.File(netcdf, "r+") as file:
        file["force"].attrs["units"] = np.zeros(9)
    assert refused(netcdf).field == "force"


def test_values_that_the_file_does_not_hold_are_not_allocated(netcdf):
    replace_force(netcdf, lambda file: file.create_dataset("force", (150_000_000,), "f8", chunks=(1024,)))
    assert netcdf.stat().st_size < 1e5
    assert "150000000 values" in refused(netcdf).message


def test_a_group_in_itself_ends(netcdf):
    with h5py.File(netcdf, "r+") as file:
        file["again"] = file["/"]
    assert refused(netcdf).field == "again"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rig.h5", "rig.nc"])
def test_a_heap_in_which_the_library_loops_is_an_error_and_the_next_file_is_read(
    tmp_path, netcdf, dataset, monkeypatch, name
):
    path = tmp_path / ("damaged" + name[3:])
    with h5py.File(path, "w") as file:
        for field, unit in (("Pressure", "bar"), ("Force", "N"), ("Contraction", "%")):
            file[field] = np.arange(6.0)
            file[field].attrs["unit"] = unit
    damaged = bytearray(path.read_bytes())
    at = damaged.find(b"GCOL") + 16
    damaged[at + 8 : at + 16] = struct.pack("<Q", 57)  # it was 1: then follows free space of no size
    path.write_bytes(damaged)
    with monkeypatch.context() as patch:
        patch.setattr("mckibben.dataset.child.SECONDS", 1.0)
        patch.setattr("mckibben.dataset.child._WALL", 60.0)  # however busy the machine is
        assert "more than 1 s of processor time" in refused(path).message
    assert read_dataset(netcdf).table.identical(dataset.table)


def test_a_reader_that_waits_reaches_the_wall_clock_limit_and_the_message_has_that_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("mckibben.dataset.child.SECONDS", 0.5)
    path = tmp_path / "waits.py"
    path.write_text("import time; time.sleep(60)")
    with pytest.raises(DatasetError) as caught:
        call_in_child(path, runpy.run_path)
    limit = "3 s" if os.name == "posix" else "0.65 s"
    assert caught.value.problems[0].message.endswith(f"more than {limit}")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes and devices")
def test_pipes_and_devices_are_refused_without_reading_them(tmp_path):
    os.mkfifo(tmp_path / "rig.csv")
    assert "pipe" in refused(tmp_path / "rig.csv").message
    assert "device" in refused(Path("/dev/zero")).message


def test_a_file_beyond_the_memory_limit_is_read_with_larger_limits(tmp_path, monkeypatch):
    monkeypatch.setattr("mckibben.dataset.child.MEMORY", 2**25)
    path = tmp_path / "rig.h5"
    with h5py.File(path, "w") as file:
        for name, unit, factor in (("Pressure", "bar", 1e-5), ("Force", "N", 1), ("Contraction", "%", 100)):
            values = COLUMNS[name.lower()] * factor
            file[name], file[name].attrs["unit"] = values, unit
        file["other"] = np.zeros(2**22)
    assert "cannot be read" in refused(path).message  # in the libraries, or even before they are imported
    monkeypatch.setenv("MCKIBBEN_READ_LIMITS", "16")
    assert len(read_dataset(path)) == 6
    monkeypatch.setenv("MCKIBBEN_READ_LIMITS", "much")
    assert "not a positive number" in refused_by(path).problems[0].message


def test_a_crash_of_the_child_process_is_an_error_and_the_next_file_is_read(netcdf, dataset):
    with pytest.raises(DatasetError) as caught:
        call_in_child(Path("rig.mat"), exec, {})  # not a program: any exception ends the process
    assert "crashes" in caught.value.problems[0].message
    assert read_dataset(netcdf).table.identical(dataset.table)
