"""The command line, run in this process as the installed command runs it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from mckibben.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"


class Answer(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def cli(monkeypatch, capsys, tmp_path) -> Callable[..., Answer]:
    """Call the command with arguments, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MCKIBBEN_DEBUG", raising=False)
    monkeypatch.setenv("COLUMNS", "160")

    def call(*arguments: str) -> Answer:
        monkeypatch.setattr(sys, "argv", ["mckibben", *arguments])
        with warnings.catch_warnings():  # as outside of pytest, where our warnings are no errors
            warnings.simplefilter("default")
            try:
                main()
                code = 0
            except SystemExit as end:
                code = end.code or 0
        return Answer(code, *capsys.readouterr())

    return call


@pytest.fixture(scope="session")
def shortened() -> Callable[[str], str]:
    """An example of ours, cut to 0.2 s, its step early: a PID does not follow so soon, and runs have exit code 1."""

    def text(name: str) -> str:
        whole = (EXAMPLES / f"{name}.yaml").read_text(encoding="utf-8")
        return whole.replace("duration: 10 s", "duration: 200 ms").replace("at: 5 s", "at: 100 ms")

    return text


@pytest.fixture
def each_progress(monkeypatch):
    """A log gets a line for each step of progress, as soon as it is made."""
    monkeypatch.setattr("mckibben.cli.options._LOG_INTERVAL", 0.0)
    monkeypatch.setattr("mckibben.cli.options._LOG_SHARE", 0.0)


HOLDING = """
import signal, time
from pathlib import Path
from mckibben.storage.store import Job

add, added, interrupted = Job.add, [], []

def slowly(job, records):  # the third addition is kept; then nothing goes on but an interruption
    add(job, records)
    added.append(records)
    if len(added) >= 3:
        Path("holding").touch()
        while not interrupted:  # no lock, which the handler could wait for in the same thread
            time.sleep(0.01)
        time.sleep(0.3)

def interrupt(*_):
    interrupted.append(True)
    raise KeyboardInterrupt

Job.add = slowly
signal.signal(signal.SIGINT, interrupt)
from mckibben.cli import main
main()
"""


@pytest.fixture
def stopped(tmp_path):
    """Run a command until three more records are kept, then interrupt it; exit code and messages."""

    def stop(*arguments: str) -> tuple[int, str]:
        process = subprocess.Popen(
            [sys.executable, "-c", HOLDING, *arguments],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        while process.poll() is None and not (tmp_path / "holding").exists():
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, messages = process.communicate(timeout=100)
        (tmp_path / "holding").unlink()
        assert "Traceback" not in messages
        return process.returncode, messages

    return stop
