"""The command line, run in this process as the installed command runs it."""

from __future__ import annotations

import sys
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
    """An example of ours, cut to 0.2 s, its step early."""

    def text(name: str) -> str:
        whole = (EXAMPLES / f"{name}.yaml").read_text(encoding="utf-8")
        return whole.replace("duration: 10 s", "duration: 200 ms").replace("at: 5 s", "at: 100 ms")

    return text


@pytest.fixture
def each_progress(monkeypatch):
    """A log gets a line for each step of progress, as soon as it is made."""
    monkeypatch.setattr("mckibben.cli.options._LOG_INTERVAL", 0.0)
    monkeypatch.setattr("mckibben.cli.options._LOG_SHARE", 0.0)
