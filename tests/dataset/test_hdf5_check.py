"""Files whose heap of texts is damaged: the HDF5 library would go round in circles for ever."""

import struct

import h5py
import numpy as np
import pytest

from mckibben.dataset import read_dataset
from mckibben.dataset.matlab import global_heaps_are_valid
from mckibben.errors import DatasetError


@pytest.fixture
def content(tmp_path):
    path = tmp_path / "rig.h5"
    with h5py.File(path, "w") as file:
        for name, unit in (("Pressure", "bar"), ("Force", "N"), ("Contraction", "%")):
            file[name] = np.arange(6.0)
            file[name].attrs["unit"] = unit
    return path.read_bytes()


def parts(content):
    """Where the parts of the heap begin, and its end."""
    at = content.find(b"GCOL") + 16
    end = at - 16 + struct.unpack("<Q", content[at - 8 : at])[0]
    found = []
    while at + 16 <= end:
        found.append(at)
        index, size = struct.unpack("<H6xQ", content[at : at + 16])
        at += size if index == 0 else 16 + -(-size // 8) * 8
    return found, end


def test_what_h5py_writes_is_sound(content):
    assert global_heaps_are_valid(content)
    assert len(parts(content)[0]) == 4  # three texts and what is free


@pytest.mark.parametrize("size", [57, 1 << 40, (1 << 64) - 1])
@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_part_of_another_size_is_not_sound_and_is_an_error_in_no_time(content, tmp_path, part, size):
    # 57 in place of 1: the library found free space of no size behind it, and never came back
    damaged = bytearray(content)
    at = parts(content)[0][part]
    damaged[at + 8 : at + 16] = struct.pack("<Q", size)
    path = tmp_path / "damaged.h5"
    path.write_bytes(damaged)
    assert not global_heaps_are_valid(bytes(damaged))
    with pytest.raises(DatasetError, match="a heap of strings is corrupt"):
        read_dataset(path)


@pytest.mark.parametrize("size", [0, 15, 5000])
def test_free_space_has_to_lie_inside(content, size):
    damaged = bytearray(content)
    at = parts(content)[0][-1]
    damaged[at + 8 : at + 16] = struct.pack("<Q", size)
    assert not global_heaps_are_valid(bytes(damaged))


def test_a_heap_that_is_longer_than_its_file_is_not_sound(content):
    at = content.find(b"GCOL")
    assert not global_heaps_are_valid(content[: at + 100])
