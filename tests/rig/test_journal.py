"""Journals: appended records survive a kill, a torn end and damage in the middle."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from mckibben.errors import DatasetError, FileError
from mckibben.rig import journal as module
from mckibben.rig.journal import Journal, JournalReader, JournalRecord
from mckibben.rig.record import read_header as read_record_header

ITEM = b"I"
ABOUT = {"format": "test journal", "version": 1, "seed": 3}
FRONT = 48  # bytes of a record before its payload
HEADER_SIZE = FRONT + len(json.dumps(ABOUT))


def content_of(number):
    return np.random.default_rng(number).bytes(50 + 13 * number)


@pytest.fixture
def filled(tmp_path):
    path = tmp_path / "a.journal"
    with Journal.create(path, ABOUT) as journal:
        for number in range(20):
            journal.append(JournalRecord(ITEM, number, content_of(number)))
    return path


def numbers(path):
    records = [record for record in JournalReader(path) if record.kind == ITEM]
    assert all(record.payload == content_of(record.number) for record in records)
    return [record.number for record in records]


def test_what_is_appended_is_read_back(filled):
    assert numbers(filled) == list(range(20))
    assert JournalReader(filled).header() == ABOUT


def test_a_damaged_header_is_read_from_its_copy(filled):
    content = filled.read_bytes()
    size = HEADER_SIZE
    for place in range(2 * size):
        filled.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
        assert JournalReader(filled).checked_header() == ABOUT
    assert numbers(filled) == list(range(20))
    filled.write_bytes(content[2 * size :])
    with pytest.raises(FileError):
        JournalReader(filled).checked_header()


def test_a_journal_without_its_header_is_told_from_another_file(filled, tmp_path):
    content, size = filled.read_bytes(), HEADER_SIZE
    for kept in (b"", content[:5], content[:40], content[: size - 1], content[2 * size :]):
        filled.write_bytes(kept)
        with pytest.raises(FileError) as caught:
            JournalReader(filled).checked_header()
        assert caught.value.problems[0].field == "header" and caught.value.problems[0].remedy
        with pytest.raises(DatasetError) as record:
            read_record_header(filled)
        assert record.value.problems[0].field == "header"
    filled.write_text("angle,force\n1,2\n", encoding="utf-8")
    assert JournalReader(filled).checked_header() is None


@pytest.mark.parametrize("lose", [Path.unlink, lambda path: path.rename(path.with_name("elsewhere"))])
def test_a_journal_that_was_removed_or_moved_is_not_written_on_in_silence(tmp_path, lose):
    with Journal.create(tmp_path / "a", ABOUT) as journal:
        lose(tmp_path / "a")
        with pytest.raises(FileNotFoundError):
            journal.append(JournalRecord(ITEM, 1, content_of(1)))


def test_a_window_without_a_record_is_searched_in_parts(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_WINDOW", 64)
    for length in range(60, 80):
        path = tmp_path / f"{length}"
        with Journal.create(path, ABOUT) as journal:
            journal.append(JournalRecord(ITEM, 4, bytes(length)))
            journal.append(JournalRecord(ITEM, 5, content_of(5)))
        content = bytearray(path.read_bytes())
        content[2 * HEADER_SIZE : 2 * HEADER_SIZE + 8] = b"damaged!"
        path.write_bytes(content)
        assert numbers(path) == [5]


def test_a_closed_journal_is_closed_once(filled):
    with Journal.create(filled.with_name("b"), ABOUT) as journal:
        assert not journal.closed
    assert journal.closed
    journal.close()
    with pytest.raises(OSError):
        journal.append(JournalRecord(ITEM, 0, b""))


def test_an_existing_file_is_not_taken(filled):
    with pytest.raises(FileError):
        Journal.create(filled, ABOUT)
    assert numbers(filled) == list(range(20))


def records_of(content):
    """The records of a journal, each as its bytes."""
    starts = [place.start() for place in re.finditer(b"MCKCHUNK", content)]
    return [content[begin:end] for begin, end in zip(starts, [*starts[1:], len(content)], strict=True)]


@pytest.fixture
def records(filled):
    """Records of a journal and of one of another seed: two headers, then 20 items each."""
    other = filled.with_name("other")
    with Journal.create(other, {**ABOUT, "seed": 4}) as journal:
        for number in range(20):
            journal.append(JournalRecord(ITEM, number, content_of(number)))
    return records_of(filled.read_bytes()), records_of(other.read_bytes())


@pytest.mark.parametrize(
    ("splice", "place"),
    [
        (lambda ours, theirs: [*ours, theirs[9]], 22),  # appended
        (lambda ours, theirs: [*ours[:9], theirs[9], *ours[10:]], 9),  # in place of ours, of the same size
        (lambda ours, theirs: [*ours, ours[9]], 22),  # repeated
        (lambda ours, theirs: [*ours[:9], ours[10], ours[9], *ours[11:]], 9),  # exchanged
        (lambda ours, theirs: [*ours[:9], *ours[10:]], 9),  # removed
        (lambda ours, theirs: [*theirs[:2], *ours[2:]], 2),  # the header of another journal
        (lambda ours, theirs: [theirs[0], *ours[1:]], 1),  # one of its copies
    ],
)
def test_records_of_other_journals_and_places_are_refused_by_place(filled, records, splice, place):
    spliced = splice(*records)
    filled.write_bytes(b"".join(spliced))
    reader = JournalReader(filled)
    with pytest.raises(FileError) as caught:
        list(reader)
    (problem,) = caught.value.problems
    start = sum(len(one) for one in spliced[:place])
    assert (problem.field, problem.value) == ("record", start) and problem.remedy
    assert reader.end == start and f"byte {start}" in problem.message
    with pytest.raises(DatasetError):
        list(JournalReader(filled, DatasetError))


def test_a_record_cut_out_of_the_end_is_an_unfinished_journal(filled, records):
    filled.write_bytes(b"".join(records[0][:-1]))
    assert numbers(filled) == list(range(19))
