"""The file of a study: what was added is there after a kill, a full disk, and bit rot; one process at a time has it."""

import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import warnings

import numpy as np
import pytest

from mckibben.errors import FileError, McKibbenWarning
from mckibben.storage.store import STUDY, Store, differences, open_store, read_store

ABOUT = {"format": "test", "seed": 3, "software": {"jax": "1", "engine": "native"}, "scenario": "a: 1\nb: 2\n"}


def content_of(number):
    return np.random.default_rng(number).bytes(500 + 13 * number)


@pytest.fixture
def path(tmp_path):
    with open_store(tmp_path / STUDY) as store:
        job = store.job(ABOUT)
        for number in range(20):
            job.add({number: content_of(number)})
    return tmp_path / STUDY


def records(path):
    with open_store(path, resume=True) as store:
        job = store.job(ABOUT)
        return {number: job.read(number) for number in job.numbers}


def test_what_was_added_is_read_back_from_one_file(path):
    assert [file.name for file in path.parent.iterdir()] == [STUDY]
    assert records(path) == {number: content_of(number) for number in range(20)}
    with read_store(path) as store:
        assert store.about() == ABOUT
        assert store.about("another") is None


def test_arrays_and_jobs_by_name(tmp_path):
    columns = {"x": np.linspace(0, 1, 5), "code": np.arange(5, dtype=np.int8)}
    with open_store(None) as store:
        job, other = store.job(ABOUT), store.job(ABOUT, "other")
        job.add_arrays(7, columns)
        assert job.numbers == {7} and other.numbers == set()
        for name, column in job.read_arrays(7).items():
            np.testing.assert_array_equal(column, columns[name])


def test_damage_is_found_and_never_read_as_a_result(path, tmp_path):
    original, intact = path.read_bytes(), {number: content_of(number) for number in range(20)}
    fewer = refused = 0
    for place in np.random.default_rng(1).integers(0, len(original), 120).tolist():
        changed = bytearray(original)
        changed[place] ^= 0x20
        path.write_bytes(bytes(changed))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", McKibbenWarning)
                kept = records(path)
        except FileError as error:
            refused += bool(error.problems[0].remedy)
            continue
        assert kept.items() <= intact.items()
        fewer += len(kept) < 20
    assert fewer > 20 and refused > 0


def test_a_damaged_record_is_reported_and_can_be_added_again(path):
    content = bytearray(path.read_bytes())
    content[content.index(content_of(4)[:40]) + 3] ^= 1
    path.write_bytes(content)
    with pytest.warns(McKibbenWarning, match="1 damaged records"), open_store(path, resume=True) as store:
        job = store.job(ABOUT)
        assert job.numbers == set(range(20)) - {4}
        job.add({4: content_of(4)})
    assert records(path)[4] == content_of(4)


KILLED = """
import os, sys, pathlib
from mckibben.storage.store import open_store
with open_store(pathlib.Path(sys.argv[1])) as store:
    job = store.job({"format": "test"})
    for number in range(10**6):
        job.add({number: bytes(2000)})
        print(number, flush=True)
"""


def test_a_killed_process_loses_nothing_that_was_added(tmp_path):
    child = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / STUDY)], stdout=subprocess.PIPE, text=True)
    added = [int(child.stdout.readline()) for _ in range(30)][-1]
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    with open_store(tmp_path / STUDY, resume=True) as store:
        job = store.job({"format": "test"})
        assert set(range(added + 1)) <= job.numbers
        assert all(job.read(number) == bytes(2000) for number in job.numbers)


def test_a_full_disk_loses_nothing_and_is_reported(path, monkeypatch):
    prepare = Store._prepare

    def small(store, **options):
        prepare(store, **options)
        pages = store._connection.execute("PRAGMA page_count").fetchone()[0]
        store._connection.execute(f"PRAGMA max_page_count = {pages + 2}")

    with monkeypatch.context() as patch:
        patch.setattr(Store, "_prepare", small)
        with pytest.raises(FileError) as caught, open_store(path, resume=True) as store:
            store.job(ABOUT).add({number: bytes(3000) for number in range(20, 30)})
    (problem,) = caught.value.problems
    assert problem.message == "the disk is full; 20 records are kept"
    assert "--resume" in problem.remedy
    assert records(path) == {number: content_of(number) for number in range(20)}


def test_a_file_that_disappears_is_not_written_on_in_silence(path):
    with open_store(path, resume=True) as store:
        job = store.job(ABOUT)
        path.unlink()
        with pytest.raises(FileError, match="has disappeared"):
            job.add({20: b"x"})


def test_a_second_process_is_refused_with_the_number_of_the_first(path):
    with open_store(path, resume=True):
        message = rf"another process \(pid {os.getpid()} on .*\) is computing this study; wait"
        with pytest.raises(FileError, match=message), open_store(path, resume=True):
            pytest.fail("two at once")


def test_a_new_study_and_a_continued_one_are_not_confused(path, tmp_path):
    with pytest.raises(FileError, match="a study exists already; continue it with --resume"), open_store(path):
        pytest.fail("replaced")
    with pytest.raises(FileError, match="no study to continue"), open_store(tmp_path / "a", resume=True):
        pytest.fail("begun")
    with pytest.raises(ZeroDivisionError), open_store(tmp_path / "b"):
        raise ZeroDivisionError  # before the first job: nothing remains
    assert not (tmp_path / "b").exists()


KILLED_EARLY = """
import os, sys, pathlib
from mckibben.storage import store
def end(*_, **__): os._exit(9)
if sys.argv[2] == "tables": store.Store._prepare = end
if sys.argv[2] == "job": store.Store.job = end
with store.open_store(pathlib.Path(sys.argv[1])) as opened:
    opened.job({"format": "test", "seed": 4})
    end()
"""


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("moment", ["tables", "job", "record"])
def test_a_study_killed_before_its_first_record_is_begun_in_both_ways(tmp_path, moment, resume):
    path = tmp_path / STUDY
    assert subprocess.run([sys.executable, "-c", KILLED_EARLY, str(path), moment], check=False).returncode == 9
    assert path.is_file()
    with open_store(path, resume=resume) as store:
        assert store.is_blank() and store.about() == (
            {"format": "test", "seed": 4} if resume and moment == "record" else None
        )
        job = store.job({"format": "test", "seed": 4})
        job.add({0: b"x"})
    with pytest.raises(FileError, match="exists already"), open_store(path):
        pytest.fail("replaced")
    with open_store(path, resume=True) as store:
        assert store.job({"format": "test", "seed": 4}).read(0) == b"x"


def test_a_study_without_records_may_begin_with_other_settings(tmp_path):
    for seed in (3, 4):
        with open_store(tmp_path / STUDY) as store:
            assert store.job(ABOUT | {"seed": seed}).about["seed"] == seed


@pytest.mark.parametrize("content", [b"", b"angle,force\n1,2\n", b"SQLite format 3\0" + bytes(4096)])
def test_another_file_is_refused(tmp_path, content):
    (tmp_path / STUDY).write_bytes(content)
    with pytest.raises(FileError), read_store(tmp_path / STUDY) as store:
        store.about()
    connection = sqlite3.connect(tmp_path / "other")
    connection.execute("CREATE TABLE job (name)")
    connection.close()
    with pytest.raises(FileError, match="not a study"), open_store(tmp_path / "other", resume=True):
        pytest.fail("opened")


@pytest.mark.parametrize(
    ("change", "field", "message"),
    [
        ({"seed": 4}, "seed", "started with 3, not 4"),
        ({"software": {"jax": "2", "engine": "native"}}, "software jax", "started with 1, not 2"),
        ({"scenario": "a: 1\nb: 3\n"}, "scenario", "started with b: 2, not b: 3"),
        ({"table": [1, 2.5]}, "table", "started with nothing, not 2 values from 1 to 2.5"),
    ],
)
def test_another_study_is_refused_with_each_difference(path, change, field, message):
    with pytest.raises(FileError) as caught, open_store(path, resume=True) as store:
        store.job(ABOUT | change)
    (problem,) = caught.value.problems
    assert problem.field == field and message in problem.message and problem.remedy
    assert re.search(r"\.\.\.$", differences({"a": "x" * 500}, {"a": "y"})[0].message.split(", not")[0])


def test_threads_add_at_once(tmp_path):
    with open_store(tmp_path / STUDY) as store:
        job = store.job(ABOUT)
        threads = [threading.Thread(target=job.add, args=({number: content_of(number)},)) for number in range(16)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    shutil.copy(tmp_path / STUDY, tmp_path / "copy")
    assert records(tmp_path / "copy") == {number: content_of(number) for number in range(16)}
