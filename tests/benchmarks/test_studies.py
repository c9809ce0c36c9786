"""The studies behind tables of the documentation run at their smallest size."""

from __future__ import annotations

import contextlib
import importlib
from pathlib import Path

import numpy as np
import pytest

from mckibben.dataset import read_dataset
from mckibben.muscle import ExponentialLaw

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def foreign_files(tool, folder):
    tool.files("servo", folder)
    assert len(read_dataset(folder / "muscle.csv")) > 100


def kinds_of_test(tool, folder):
    covered = []
    for kind in tool.KINDS:
        tally = tool.tallied(kind, 1, ExponentialLaw, 0, folder)
        assert not tally["refused"] and np.median(tally["error"]) < 0.01
        assert all(tally["friction"]) and not any(tally["false drift"])
        covered += tally["force"]
    assert np.mean(covered) > 0.9


def real_time(tool, folder):
    tool.print_runs(0.2, 2e-3)


def known_reference(tool, folder):
    """Overshoot, the solver against fatrop's, and a step that is known ahead."""
    tool.looking_ahead([(20, 100)])
    pytest.importorskip("casadi", reason="CasADi is not installed (make does it)")
    with contextlib.chdir(folder):
        tool.against_fatrop(3, names=("sine of 10 deg, 1 Hz",))
    tool.known_references(lags=(0.02,), duration=0.1, names=("step of 10 deg",))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "run", "rows"),
    [
        ("foreign_lab", foreign_files, 0),
        ("real_time", real_time, 5),
        ("preview", known_reference, 10),
        ("kinds_of_test", kinds_of_test, 0),
    ],
)
def test_a_study_prints_its_table(monkeypatch, tmp_path, capsys, name, run, rows):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    run(importlib.import_module(name), tmp_path)
    assert capsys.readouterr().out.count("\n|") + bool(rows) == rows
