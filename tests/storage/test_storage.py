"""Folders that are kept to oneself: one process at a time, and what others put there stays."""

import errno
import fcntl
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from mckibben.errors import FileError, McKibbenWarning
from mckibben.storage import files
from mckibben.storage.files import atomic_write, check_free, file_lock, make_folder

OPEN_FILES = Path("/proc/self/fd")


def test_only_one_at_a_time(tmp_path):
    path = tmp_path / ".lock"
    with file_lock(path, "at it"):
        with (
            pytest.raises(FileError, match=rf"another process \(pid {os.getpid()} on .*\) is at it; wait"),
            file_lock(path, "at it"),
        ):
            pytest.fail("two at once")
        assert path.exists()
    assert not path.exists()
    with file_lock(path, "at it"):
        pass


@pytest.mark.skipif(not OPEN_FILES.is_dir(), reason="open files are not listed here")
def test_a_lock_leaves_no_open_file(tmp_path):
    before = sum(1 for _ in OPEN_FILES.iterdir())
    for _ in range(3):
        with file_lock(tmp_path / ".lock", "at it"):
            pass
    assert sum(1 for _ in OPEN_FILES.iterdir()) <= before


def test_it_is_let_go_of_after_an_error_too(tmp_path):
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt), file_lock(tmp_path / ".lock", "at it"):
            raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_lock_whose_file_someone_removed_ends_as_others(tmp_path):
    with file_lock(tmp_path / ".lock", "at it"):
        (tmp_path / ".lock").unlink()
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_no_lock(tmp_path):
    (tmp_path / ".lock").write_text("pid 1 on elsewhere, and much more than will be written\n")
    with file_lock(tmp_path / ".lock", "at it"):
        assert (tmp_path / ".lock").read_text().startswith(f"pid {os.getpid()} on ")
        assert "elsewhere" not in (tmp_path / ".lock").read_text()


def test_a_file_that_its_last_holder_removes_in_between_is_no_lock(tmp_path, monkeypatch):
    path, real, calls = tmp_path / ".lock", fcntl.flock, []

    def removed(file, how):
        calls.append(file)
        if len(calls) == 1:
            path.unlink()
        real(file, how)

    monkeypatch.setattr(fcntl, "flock", removed)
    with file_lock(path, "at it"), pytest.raises(FileError, match="is at it"), file_lock(path, "at it"):
        pytest.fail("two at once")
    assert len(calls) == 3


def test_where_there_are_no_locks_it_says_so(tmp_path, monkeypatch):
    def unknown(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(fcntl, "flock", unknown)
    said = "has no locks: make sure that only one process is at it"
    with pytest.warns(McKibbenWarning, match=said), file_lock(tmp_path / ".lock", "at it"):
        pass


def test_a_folder_that_cannot_be_written_to(tmp_path):
    said = "it cannot be written: No such file or directory"
    with pytest.raises(FileError, match=said), file_lock(tmp_path / "nowhere" / ".lock", "at it"):
        pass


def test_files_that_are_there_are_all_named(tmp_path):
    check_free(tmp_path / "nowhere", ["a"])
    check_free(tmp_path, ["a", "[b]*.yaml"])
    (tmp_path / "[b]*.yaml").touch()
    (tmp_path / "b1.yaml").touch()
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileError) as refused:
        check_free(tmp_path, ["a", "[b]*.yaml", "gone"])
    assert [problem.field for problem in refused.value.problems] == ["[b]*.yaml, gone"]  # in one problem
    assert "move the existing file" in str(refused.value)


def test_a_file_is_written_completely_or_not_at_all(tmp_path):
    path = tmp_path / "a"
    with pytest.raises(RuntimeError), atomic_write(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert not list(tmp_path.iterdir())
    with atomic_write(path) as part:
        part.write_text("first")
    with pytest.raises(FileError) as refused, atomic_write(path) as part:
        part.write_text("second")
    assert refused.value.problems[0].field == "a" and path.read_text() == "first"
    with atomic_write(path, overwrite=True) as part:
        part.write_text("second")
    assert path.read_text() == "second" and list(tmp_path.iterdir()) == [path]


def test_without_hard_links_an_existing_file_is_kept_too(tmp_path, monkeypatch):
    def link(*_):
        raise OSError(errno.EPERM, "not supported here")

    monkeypatch.setattr(os, "link", link)
    with atomic_write(tmp_path / "a") as part:
        part.write_text("first")
    with pytest.raises(FileError), atomic_write(tmp_path / "a") as part:
        part.write_text("second")
    assert (tmp_path / "a").read_text() == "first" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("overwrite", [True, False])
def test_a_link_is_not_followed(tmp_path, overwrite):
    (tmp_path / "target").write_text("mine")
    path = tmp_path / "link"
    path.symlink_to(tmp_path / "target")
    if overwrite:
        with atomic_write(path, overwrite=True) as part:
            part.write_text("new")
        assert not path.is_symlink() and path.read_text() == "new"
    else:
        with pytest.raises(FileError), atomic_write(path) as part:
            part.write_text("new")
    assert (tmp_path / "target").read_text() == "mine"


def test_a_written_file_and_its_folder_are_synced(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.fstat(file).st_ino))
    with atomic_write(tmp_path / "a") as part:
        part.write_text("text")
    assert synced == [(tmp_path / "a").stat().st_ino, tmp_path.stat().st_ino]


def test_new_folders_are_synced_into_their_parents(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.fstat(file).st_ino))
    make_folder(tmp_path / "a" / "b")
    assert set(synced) == {tmp_path.stat().st_ino, (tmp_path / "a").stat().st_ino}
    make_folder(tmp_path / "a" / "b")
    assert len(synced) == 2


def test_on_windows_a_byte_is_locked_and_a_second_holder_is_refused(tmp_path, monkeypatch):
    """With `flock` in place of the lock of Windows, and its error for a taken one."""
    real = fcntl.flock

    def locking(file, how, size):
        assert os.lseek(file, 0, os.SEEK_CUR) > 1000 and (how, size) == (2, 1)
        try:
            real(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, "Permission denied") from None

    monkeypatch.setattr(files, "fcntl", None)
    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))
    path = tmp_path / ".lock"
    with file_lock(path, "at it"):
        with pytest.raises(FileError, match=rf"pid {os.getpid()} on .* is at it"), file_lock(path, "at it"):
            pytest.fail("two at once")
        assert path.read_text(encoding="utf-8").startswith(f"pid {os.getpid()} on ")
    assert not path.exists()
