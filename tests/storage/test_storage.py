"""Folders that are kept to oneself: one process at a time, and what others put there stays."""

import errno
import fcntl
import os

import pytest

from mckibben.errors import FileError, McKibbenWarning
from mckibben.storage.files import alone, check_free


def test_only_one_at_a_time(tmp_path):
    path = tmp_path / ".lock"
    with alone(path, "at it"):
        with (
            pytest.raises(FileError, match=rf"another process \(pid {os.getpid()} on .*\) is at it; wait for its end"),
            alone(path, "at it"),
        ):
            pytest.fail("two at once")
        assert path.exists()
    assert not path.exists()
    with alone(path, "at it"):
        pass


def test_it_is_let_go_of_after_an_error_too(tmp_path):
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt), alone(tmp_path / ".lock", "at it"):
            raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_no_lock(tmp_path):
    (tmp_path / ".lock").write_text("pid 1 on elsewhere, and much more than will be written\n")
    with alone(tmp_path / ".lock", "at it"):
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
    with alone(path, "at it"), pytest.raises(FileError, match="is at it"), alone(path, "at it"):
        pytest.fail("two at once")
    assert len(calls) == 3


def test_where_there_are_no_locks_it_says_so(tmp_path, monkeypatch):
    def unknown(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(fcntl, "flock", unknown)
    said = "has no locks: take care that one process alone is at it"
    with pytest.warns(McKibbenWarning, match=said), alone(tmp_path / ".lock", "at it"):
        pass


def test_a_folder_that_cannot_be_written_to(tmp_path):
    said = "it cannot be written: No such file or directory"
    with pytest.raises(FileError, match=said), alone(tmp_path / "nowhere" / ".lock", "at it"):
        pass


def test_files_that_are_there_are_all_named(tmp_path):
    check_free(tmp_path / "nowhere", ["a"])
    check_free(tmp_path, ["a", "[b]*.yaml"])
    (tmp_path / "[b]*.yaml").touch()
    (tmp_path / "b1.yaml").touch()
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileError) as refused:
        check_free(tmp_path, ["a", "[b]*.yaml", "gone"])
    assert [problem.field for problem in refused.value.problems] == ["[b]*.yaml", "gone"]
    assert "move what is there out of the way" in str(refused.value)
