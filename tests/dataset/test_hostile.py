"""Thousands of damaged files: a dataset whose rows are all accounted for, or an error of ours."""

from __future__ import annotations

import contextlib
import functools
import random
import re
import tempfile
import time
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mckibben.dataset import IsobaricDataset, read_dataset, read_recording
from mckibben.errors import McKibbenError

from .conftest import FILES

SEEDS = 16
FILES_A_SEED = 25  # together 400 files of a kind
CHECKED = {"plain.mat": 10, "rig.h5": 1, "version73.mat": 1, "rig.nc": 1}  # per seed: damaged ones end a child process
SECONDS = 2.0  # for one file of a few kilobytes, on a busy machine
BYTES = 200e6

WORDS = [
    b"",
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\0\0\0\0",
    b"\0\0\0\x10",
    b"\x01",
    b"nan",
    b'"',
    b"\n",
    b";",
    b"1e999",
]
SEEDED = settings(max_examples=SEEDS, deadline=None, suppress_health_check=list(HealthCheck))


def damaged(content: bytes, chance: random.Random) -> bytes:
    """A file with bits flipped, words put in, parts cut out or repeated, or its end cut off."""
    for _ in range(chance.choice((1, 1, 2, 4))):
        what, at, size = chance.randrange(6), chance.randrange(len(content) + 1), chance.randrange(1, 40)
        if what == 0:
            content = (
                content[:at]
                + bytes(byte ^ 1 << chance.randrange(8) for byte in content[at : at + 1])
                + content[at + 1 :]
            )
        elif what == 1:
            word = chance.choice(WORDS)
            content = content[:at] + word + content[at + len(word) :]
        elif what == 2:
            content = content[:at] + chance.choice(WORDS) + content[at:]
        elif what == 3:
            content = content[:at] + content[at + size :]
        elif what == 4:
            content = content[:at] + content[at // 2 : at // 2 + size] + content[at:]
        elif chance.random() < 0.4:
            content = content[:at]
    return content


@functools.cache
def content_of(name):
    if name in FILES:
        return FILES[name]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        IsobaricDataset.of(
            pressure=[1e5, 2e5, 3e5], contraction=[0, 0.1, 0.2], force=[50, 90, 120], direction=["loading"] * 3
        ).table.to_netcdf(path, engine="h5netcdf")
        return path.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FILES, "rig.nc"])
@SEEDED
@given(seed=st.integers(0, 2**32))
def test_a_damaged_file_gives_a_dataset_or_an_error_of_ours(name, seed, tmp_path):
    chance, path = random.Random(seed), tmp_path / name
    for number in range(CHECKED.get(name, FILES_A_SEED)):
        path.write_bytes(damaged(content_of(name), chance))
        report = bool(number % 2)
        start = time.process_time()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                data = read_dataset(path, on_corrupt="report" if report else "raise")
            except McKibbenError as error:
                assert str(error).startswith(str(path))
            else:
                assert np.isfinite([data.pressure, data.contraction, data.force]).all()
                assert caught or "repairs" not in data.table.attrs  # such as a last row that looks like full scales
        assert time.process_time() - start < SECONDS


LINES = [f"{i},{i / 100},{10 * i}.5" for i in range(1, 21)]
GARBAGE = [
    "",
    " ",
    "x",
    "1,2",
    "1,2,3,4",
    ",,",
    '"',
    'a,"b',
    "nan,0,1",
    "5,,5",
    "1\x002,0,5",
    "#",
    "1;2;3",
    "é,0,1",
    ",,,,",
]


@settings(SEEDED, max_examples=150)
@given(
    inserted=st.lists(st.tuples(st.integers(0, 20), st.sampled_from(GARBAGE)), max_size=8),
    order=st.randoms(use_true_random=False),
    cut=st.integers(0, 12),
    newline=st.sampled_from(["\n", "\r\n"]),
)
@pytest.mark.slow
def test_every_line_of_a_text_is_a_point_or_in_the_report(inserted, order, cut, newline, tmp_path):
    """Rows in any order, garbage between them, the end cut off: point by point and line by line."""
    lines = LINES.copy()
    order.shuffle(lines)
    for at, text in inserted:
        lines.insert(at, text)
    text = newline.join(["pressure_bar,contraction_ratio,force_N", *lines]) + newline
    text = text[: len(text) - cut]
    path = tmp_path / "rig.csv"
    path.write_bytes(text.encode())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            data = read_dataset(path, on_corrupt="report")
        except McKibbenError:
            return
    physical = text.split(newline)[1:]
    named = {int(line) for line in re.findall(r"^line (\d+)", data.table.attrs.get("repairs", ""), re.MULTILINE)}
    for first, last in re.findall(r"line (\d+).*(?:goes on to line|to) (\d+)", data.table.attrs.get("repairs", "")):
        named |= set(range(int(first), int(last) + 1))
    for message in data.table.attrs.get("repairs", "").splitlines():
        if (span := re.search(r"lines (\d+) to (\d+)", message)) is not None:
            named |= set(range(int(span[1]), int(span[2]) + 1))
    whole = [line for number, line in enumerate(physical, 2) if number not in named and line.strip(', "')]
    expected = np.array([line.split(",") for line in whole], float).reshape(-1, 3)
    np.testing.assert_allclose(np.stack([data.pressure / 1e5, data.contraction, data.force], axis=1), expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rig.csv", "rig.lvm", "rig.tdms", "plain.mat"])
@settings(SEEDED, max_examples=4)
@given(seed=st.integers(0, 2**32))
def test_a_damaged_recording_gives_a_recording_or_an_error_of_ours(name, seed, tmp_path):
    chance, path = random.Random(seed), tmp_path / name
    for _ in range(FILES_A_SEED):
        path.write_bytes(damaged(FILES[name], chance))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                record = read_recording(path, on_corrupt="report", sample_rate=None if name == "rig.lvm" else 10.0)
                points = record.plateaus(dwell=0.5)
            except McKibbenError:
                continue
        assert sum(points.counts.values()) == len(record)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plain.mat", "version4.mat", "rig.tdms"])
def test_no_number_in_a_head_makes_a_huge_array(name, tmp_path):
    """Each aligned word of the head in turn claims a large number, in `plain.mat` up to the end of a column."""
    content = FILES[name]
    tracemalloc.start()
    first, last = (128, 296) if name == "plain.mat" else (0, 400)
    for at in range(first, min(len(content), last), 4):
        for word in (b"\xff\xff\xff\x7f", b"\0\0\0\x40"):
            path = tmp_path / name
            path.write_bytes(content[:at] + word + content[at + 4 :])
            with warnings.catch_warnings(), contextlib.suppress(McKibbenError):
                warnings.simplefilter("ignore")
                read_dataset(path, on_corrupt="report")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < BYTES
