"""Files are written whole or not at all, keep what others put there, and have one writer; signals stop jobs."""

import errno
import fcntl
import json
import math
import os
import signal
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mckibben.errors import FileError, McKibbenWarning
from mckibben.storage import files
from mckibben.storage.files import SIGNALS, atomic_write, check_free, file_lock, handle_signals, json_ready, write_json

OPEN_FILES = Path("/proc/self/fd")


def test_a_lock_has_one_holder_and_leaves_nothing(tmp_path):
    path = tmp_path / ".lock"
    before = sum(1 for _ in OPEN_FILES.iterdir()) if OPEN_FILES.is_dir() else 0
    path.write_text("pid 1 on elsewhere, left by a process that was killed\n")
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt), file_lock(path, "at it"):
            assert path.read_text().startswith(f"pid {os.getpid()} on ") and "elsewhere" not in path.read_text()
            holder = rf"another process \(pid {os.getpid()} on .*\) is at it; wait"
            with pytest.raises(FileError, match=holder), file_lock(path, "at it"):
                pytest.fail("two at once")
            raise KeyboardInterrupt
        assert list(tmp_path.iterdir()) == []
    with file_lock(path, "at it"):
        path.unlink()
    assert list(tmp_path.iterdir()) == []
    assert not OPEN_FILES.is_dir() or sum(1 for _ in OPEN_FILES.iterdir()) <= before


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


@pytest.mark.parametrize("system", ["of files", "Windows"])
def test_a_system_without_locks_is_reported(system, tmp_path, monkeypatch):
    def unknown(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(fcntl, "flock", unknown)
    if system == "Windows":
        monkeypatch.setattr(files, "fcntl", None)
    with pytest.warns(McKibbenWarning, match="has no locks"), file_lock(tmp_path / ".lock", "at it"):
        pass


def test_existing_files_are_all_named(tmp_path):
    check_free(tmp_path / "nowhere", ["a"])
    check_free(tmp_path, ["a", "[b]*.yaml"])
    (tmp_path / "[b]*.yaml").touch()
    (tmp_path / "b1.yaml").touch()
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileError) as refused:
        check_free(tmp_path, ["a", "[b]*.yaml", "gone"])
    assert [problem.field for problem in refused.value.problems] == ["[b]*.yaml, gone"]


def test_a_file_is_written_completely_or_not_at_all(tmp_path, monkeypatch):
    synced, path = [], tmp_path / "a"
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.fstat(file).st_ino))
    with pytest.raises(RuntimeError), atomic_write(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert not list(tmp_path.iterdir())
    with atomic_write(path) as part:
        part.write_text("first")
    assert synced == [path.stat().st_ino, tmp_path.stat().st_ino]
    with pytest.raises(FileError) as refused, atomic_write(path) as part:
        part.write_text("second")
    assert refused.value.problems[0].field == "a" and path.read_text() == "first"
    with atomic_write(path, overwrite=True) as part:
        part.write_text("second")
    assert path.read_text() == "second" and list(tmp_path.iterdir()) == [path]


def test_a_link_is_replaced_and_not_followed(tmp_path):
    path, target = tmp_path / "link", tmp_path / "target"
    target.write_text("mine")
    path.symlink_to(target)
    with pytest.raises(FileError), atomic_write(path) as part:
        part.write_text("new")
    with atomic_write(path, overwrite=True) as part:
        part.write_text("new")
    assert not path.is_symlink() and (path.read_text(), target.read_text()) == ("new", "mine")


def test_json_has_no_nan_and_replaces_a_file_whole(tmp_path):
    odd = {
        "a": math.nan,
        "b": [math.inf, (1.0, -math.inf)],
        "c": {"d": np.float64("nan")},
        "e": "Sárosi",
        "x": 0.1 + 0.2,
    }
    ready = {"a": None, "b": [None, [1.0, None]], "c": {"d": None}, "e": "Sárosi", "x": 0.1 + 0.2}
    write_json(tmp_path / "results.json", odd)
    with pytest.raises(TypeError):
        write_json(tmp_path / "results.json", {"x": object()})
    assert json.loads((tmp_path / "results.json").read_text(encoding="utf-8")) == ready == json_ready(odd)
    assert [path.name for path in tmp_path.iterdir()] == ["results.json"]


@pytest.fixture(params=SIGNALS)
def number(request):
    before = signal.signal(request.param, signal.SIG_DFL)  # a second one would end this process
    yield request.param
    signal.signal(request.param, before)


def test_a_signal_is_reported_and_a_later_one_interrupts(number, monkeypatch):
    received, clock = [], iter([0.0, 0.9, 1.1])
    monkeypatch.setattr(files, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    with handle_signals(received.append):
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)  # as a terminal that closes
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert received == 3 * [number] and signal.getsignal(number) == signal.SIG_DFL


def test_an_ignored_signal_and_another_thread_receive_nothing(number):
    def work():
        with handle_signals(print):
            handlers.append(signal.getsignal(number))

    handlers = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [signal.SIG_DFL]
    signal.signal(number, signal.SIG_IGN)
    with handle_signals(handlers.append):
        os.kill(os.getpid(), number)
    assert handlers == [signal.SIG_DFL] and signal.getsignal(number) == signal.SIG_IGN
