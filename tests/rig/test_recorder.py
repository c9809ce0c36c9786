"""The recorder: what was appended is on the disk, in order, whatever becomes of the process or of the disk."""

import errno
import json
import os
import shutil
import struct
import time

import mcap.reader
import numpy as np
import pytest

from mckibben.errors import DatasetError, FileError, McKibbenWarning, RigError
from mckibben.rig import record as recorder_module
from mckibben.rig.record import Recorder, read_record, segments
from mckibben.storage.mcap import Column, McapWriter

COLUMNS = [Column("time", "s"), Column("force", "N", "float32"), Column("position", "1", "int32")]


def rows(first, count):
    return [(number / 1e3, float(np.float32(np.sin(number))), number) for number in range(first, first + count)]


def rows_in(folder):
    return len(read_record(folder))


@pytest.fixture
def filled(tmp_path):
    """A record of 50 chunks of 20 rows, an event after each."""
    folder = tmp_path / "record"
    with Recorder(folder, {"specimen": "ours"}, COLUMNS) as recorder:
        for number in range(50):
            recorder.append(rows(20 * number, 20))
            recorder.event("point", number=number)
            recorder.flush()
    return folder


def test_what_goes_in_comes_out(filled):
    record = read_record(filled)
    assert record.header == {"specimen": "ours"} and record.units == {"time": "s", "force": "N", "position": "1"}
    np.testing.assert_array_equal(record.columns["position"], np.arange(1000))
    np.testing.assert_array_equal(record.columns["force"], np.sin(np.arange(1000)).astype(np.float32))
    assert record.columns["force"].dtype == np.float32
    assert [event.row for event in record.events] == [20 * (number + 1) for number in range(50)]
    assert [event.data["number"] for event in record.events] == list(range(50))


def test_a_file_cut_anywhere_keeps_all_whole_chunks(filled):
    (path,) = segments(filled)
    content = path.read_bytes()
    begin = content.index(b"zstd") - 41
    for cut in [len(content), *np.random.default_rng(0).integers(begin, len(content), 60).tolist()]:
        path.write_bytes(content[:cut])
        record = read_record(filled)
        np.testing.assert_array_equal(record.columns["position"], np.arange(len(record)))
        assert len(record) == 20 * len(record.events)
        assert len(record) >= 1000 * (cut - begin) // (len(content) - begin) - 40


def _summary(path):
    """Length of the part after the last chunk: indexes and footer."""
    content = path.read_bytes()
    return len(content) - content.rindex(struct.pack("<BQI", 0x0F, 4, 0))


def test_other_tools_read_it(filled):
    """The library's own reader, which seeks by the summary; units are in the schema."""
    with segments(filled)[0].open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        samples = [(channel, message) for _, channel, message in reader.iter_messages(topics=["samples"])]
        summary = reader.get_summary()
        (attachment, *_) = reader.iter_attachments()
    assert [json.loads(message.data)["position"] for _, message in samples] == list(range(1000))
    assert [message.log_time for _, message in samples] == [number * 1_000_000 for number in range(1000)]
    schemas = {schema.name: json.loads(schema.data) for schema in summary.schemas.values()}
    assert schemas["samples"]["properties"]["force"] == {"type": "number", "unit": "N"}
    assert summary.statistics.message_count == 1050 and attachment.name == "header.json"


@pytest.mark.parametrize("lose", [shutil.rmtree, lambda folder: folder.rename(folder.with_name("elsewhere"))])
def test_a_folder_that_vanishes_is_noticed_within_a_period(tmp_path, lose):
    folder = tmp_path / "record"
    recorder = Recorder(folder, {}, COLUMNS)
    recorder.append(rows(0, 10))
    recorder.flush()
    lose(folder)
    with pytest.raises(RigError) as failed:
        for first in range(10, 10_000, 10):
            recorder.append(rows(first, 10))
            time.sleep(recorder_module.PERIOD / 4)
    assert first < 100 and f"nothing is kept at {folder}" in failed.value.remedy
    with pytest.raises(RigError):
        recorder.close()


def test_a_record_goes_on_in_a_file_of_its_own_after_a_torn_end(filled):
    (path,) = segments(filled)
    path.write_bytes(path.read_bytes()[: -_summary(path) - 120])
    there, before = rows_in(filled), path.read_bytes()
    assert there == 980
    with Recorder(filled, {"specimen": "ours"}, COLUMNS, resume=True) as recorder:
        assert recorder.rows == there
        recorder.append(rows(there, 5))
        recorder.event("resumed")
    assert path.read_bytes() == before
    record = read_record(filled)
    np.testing.assert_array_equal(record.columns["position"], np.arange(985))
    assert record.events[-1].row == 985


def test_a_file_that_is_missing_or_copied_is_told(filled):
    with Recorder(filled, {}, COLUMNS, resume=True) as recorder:
        recorder.append(rows(1000, 5))
    first, second = segments(filled)
    shutil.copy(second, second.with_name("record-0003.mcap"))
    with pytest.raises(DatasetError, match="rows repeat"):
        read_record(filled)
    second.with_name("record-0003.mcap").unlink()
    first.unlink()
    with pytest.warns(McKibbenWarning, match="1000 rows are missing"):
        assert read_record(filled).rows.tolist() == [*range(1000, 1005)]


def test_samples_are_on_the_disk_within_a_second_and_without_being_asked(tmp_path):
    with Recorder(tmp_path, {}, COLUMNS) as recorder:
        recorder.append(rows(0, 10))
        end = time.monotonic() + 5
        while not rows_in(tmp_path) and time.monotonic() < end:
            time.sleep(0.02)
        assert rows_in(tmp_path) == 10
    assert recorder_module.PERIOD <= 0.5


def test_what_was_flushed_was_brought_to_the_disk(tmp_path, monkeypatch):
    synced = []
    with Recorder(tmp_path, {}, COLUMNS) as recorder:
        monkeypatch.setattr(recorder_module.os, "fsync", lambda file: synced.append(rows_in(tmp_path)))
        recorder.append(rows(0, 10))
        recorder.flush()
        assert synced[-1] == 10


def test_a_record_is_no_start_twice_and_not_gone_on_with_by_another(filled):
    with pytest.raises(FileError, match="contains a record; resume it, or choose another"):
        Recorder(filled, {}, COLUMNS)
    with pytest.raises(FileError, match="other columns"):
        Recorder(filled, {}, COLUMNS[:2], resume=True)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_after_a_write_that_failed_nothing_more_is_written_and_its_part_is_cut_off(tmp_path, monkeypatch, number):
    """What came later would stand after a gap; also what was taken while the failure was not known yet."""
    write, places = McapWriter._write, []

    def failing(writer, content):
        places.append(len(content))
        if len(places) == 2:
            recorder.event("point", "taken meanwhile")
            monkeypatch.setattr(recorder_module.os, "fsync", fail)
        write(writer, content)

    def fail(file):
        monkeypatch.undo()
        raise OSError(number, os.strerror(number))

    recorder = Recorder(tmp_path, {}, COLUMNS)
    monkeypatch.setattr(McapWriter, "_write", failing)
    recorder.append(rows(0, 10))
    recorder.flush()
    whole = recorder.path.stat().st_size
    recorder.append(rows(10, 10))
    for what in (recorder.flush, lambda: recorder.append(rows(20, 10)), lambda: recorder.event("stopped")):
        with pytest.raises(RigError, match=f"{os.strerror(number)}; what was recorded before is kept"):
            what()
    assert recorder.path.stat().st_size == whole
    with pytest.raises(RigError):
        recorder.close()
    assert len(read_record(tmp_path)) == 10 and not read_record(tmp_path).events


def test_whatever_goes_wrong_in_its_thread_is_told_and_nothing_is_lost_in_silence(tmp_path, monkeypatch):
    recorder = Recorder(tmp_path, {}, COLUMNS)
    monkeypatch.setattr(recorder_module, "pack_rows", lambda *_: (_ for _ in ()).throw(MemoryError()))
    recorder.append(rows(0, 10))
    for what in (recorder.flush, lambda: recorder.append(rows(10, 10)), recorder.close):
        with pytest.raises(RigError, match="cannot be written: MemoryError"):
            what()


@pytest.mark.slow
def test_a_slow_disk_holds_the_appender_back_and_loses_nothing(tmp_path, monkeypatch):
    put = McapWriter._write
    monkeypatch.setattr(McapWriter, "_write", lambda *rest: (time.sleep(20e-3), put(*rest)))
    with Recorder(tmp_path, {}, COLUMNS) as recorder:
        for first in range(0, 40_000, 10):
            recorder.append(rows(first, 10))
    np.testing.assert_array_equal(read_record(tmp_path).columns["position"], np.arange(40_000))


def test_something_else_is_no_record(tmp_path):
    with pytest.raises(DatasetError, match="no record of a rig"):
        read_record(tmp_path)
    (tmp_path / "record-0001.mcap").write_bytes(b"something else")
    with pytest.raises(DatasetError, match="not a rig record"):
        read_record(tmp_path)


@pytest.mark.parametrize("kept", [True, False])
def test_a_record_that_an_error_ended_is_left_if_anything_was_recorded(tmp_path, kept):
    with pytest.raises(RigError, match="no device"), Recorder(tmp_path, {}, [Column("time", "s")]) as recorder:
        if kept:
            recorder.event("opened")
        raise RigError("no device")
    assert len(segments(tmp_path)) == kept
