"""The benchmark tells what it timed, what it refused and what is missing; its own knee is ours."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from mckibben.numerics.compiled import numeric
from mckibben.simulation.loop import compiled_episode
from mckibben.units import deg

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def bench(monkeypatch):
    """Its modules, which find each other as scripts do."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    names = ("rows", "timing", "tables", "reference", "engines.plain_c")
    return SimpleNamespace(**{name.split(".")[-1]: importlib.import_module(name) for name in names})


@pytest.fixture
def table(bench):
    candidate, timed = bench.rows.Candidate, bench.timing.Bench(rounds=3, budget=1.0)

    def absent():
        raise ImportError("no such thing")

    def failing():
        raise RuntimeError("first line\nsecond line")

    def breaking():
        raise ValueError("while it runs")

    work = np.arange(20_000.0)
    timed.add("base", lambda: candidate("base", lambda: work.sum(), base="base"))
    timed.add(
        "half", lambda: candidate("half", lambda: work.sum(), work=0.5, base="base", deviation=1e-12, tolerance=1e-9)
    )
    timed.add("off", lambda: candidate("off", lambda: work.sum(), base="base", deviation=0.5, tolerance=1e-9))
    timed.add("nan", lambda: candidate("nan", lambda: work.sum(), base="base", deviation=float("nan"), tolerance=1e-9))
    timed.add("absent", absent, install="thing")
    timed.add("failing", failing)
    timed.add("breaking", lambda: candidate("breaking", breaking))
    return bench.rows.Table("Things", "sum", "time", "sum", timed.timed(), ("A note.",))


def test_what_agrees_is_timed(table):
    base, half = table.rows[:2]
    assert len(base.seconds) == len(half.seconds) == 3
    assert base.ratio == 1.0
    assert half.ratio > 0
    assert half.time == pytest.approx(2 * np.median(half.seconds))


def test_what_cannot_be_timed_says_why(table):
    notes = {row.engine: row.note for row in table.rows if not row.seconds}
    assert notes == {
        "off": "deviates by 5.0e-01, more than 1e-09: not timed",
        "nan": "deviates by nan, more than 1e-09: not timed",
        "absent": "not installed (pip install thing)",
        "failing": "failed: RuntimeError: first line",
        "breaking": "failed: ValueError: while it runs",
    }


@pytest.mark.slow
def test_plain_c_runs_our_episode(bench, tmp_path):
    reference = bench.reference
    problem = reference.reference_problem().shortened(200)
    traced = numeric((problem.plant, problem.pid, problem.setpoints, problem.start, reference.PERIOD))
    _, record = jax.block_until_ready(compiled_episode(*traced, reference.SUBSTEPS))
    angles = bench.plain_c.PlainC(tmp_path).episode(problem)()[:, 0]
    assert np.abs(angles - np.asarray(record.state.angle)).max() < 1e-12


def test_a_mutant_changes_one_part_and_afterwards_the_file_is_as_before(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    tool = importlib.import_module("mutants")
    file, seen = tmp_path / "src" / "mckibben" / "joint" / "part.py", []
    file.parent.mkdir(parents=True)
    text = "def é(x: int = 3) -> float:\n    if x <= 2:\n        raise ValueError(4)\n    return -x + 1\n"
    file.write_text(text, encoding="utf-8")
    found = tool.mutants(file, tmp_path)
    assert {one.before: one.after for one in found} == {
        "3": "6", "x <= 2": "x < 2", "2": "4", "raise ValueError(4)": "pass", "-x + 1": "(-x - 1)", "-x": "(x)",
        "1": "2",
    }  # fmt: skip
    assert {one.line for one in found} == {1, 2, 3, 4}
    monkeypatch.setattr(tool, "passes", lambda *_: seen.append(file.read_text(encoding="utf-8")))
    assert not any(tool.survives(tmp_path, one, [], ["tests"]) for one in found)
    assert len(set(seen)) == len(seen) == len(found) and text not in seen
    assert file.read_text(encoding="utf-8") == text


@pytest.mark.slow
def test_no_degenerate_test_of_a_muscle_gives_a_law_in_silence(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    found = importlib.import_module("designs").outcomes(24)
    assert len(found) == 12 and all(sum(numbers.values()) == 2 for numbers in found.values())
    assert not any(numbers["silent"] for numbers in found.values())


@pytest.mark.slow
def test_the_arm_of_the_documentation_follows_in_a_foreign_plant(monkeypatch, tmp_path):
    """Its exported C, with friction, mass, payload, delay, strength and noise that are not those of the file."""
    pytest.importorskip("mujoco")
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    arm = importlib.import_module("foreign_arm")
    errors = arm.errors_of({name: arm.CASES[name] for name in ("as in the file", "all at once")}, tmp_path)
    assert max(found.max() for found in errors.values()) < 0.3 * deg
    unlike = np.array([errors["as in the file"], errors["all at once"]])
    assert (unlike[1, 1:] > 1.1 * unlike[0, 1:]).all()  # the cases reach the plant
