"""What works for which robot: the page is that of the benchmark, and batches of robots are compiled C."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

from mckibben.codegen.native import compiler
from mckibben.scenario import run_many

ROOT = Path(__file__).parents[2]


@pytest.fixture
def capabilities(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("capabilities")


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear axis", "neck"])
def test_runs_and_batches_are_compiled_c_also_where_no_engine_is_asked_for(capabilities, name):
    """An emitter that lacks an operation falls back to XLA without a warning: ten times as slow."""
    scenario = capabilities.SCENARIOS[name]().replace(duration=20e-3, substeps=12)
    assert scenario.run_once().engine == "native"
    assert run_many(scenario, {"command_delay": [0.0, scenario.control_period]}).engine == "native"


def columns_of(page):
    """The answers of the page by robot and capability."""
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in page.splitlines() if row.startswith("|")]
    (_, *robots), _, *answers = rows
    return {robot: {name: cells[place] for name, *cells in answers} for place, robot in enumerate(robots)}


@pytest.mark.slow
def test_the_page_says_what_works(capabilities):
    """All that it refuses is refused; the benchmark itself tries all, and takes an hour."""
    page = (ROOT / "docs" / "results" / "capabilities.md").read_text(encoding="utf-8")
    robot = "leg"
    column = columns_of(page)[robot]
    assert [*column] == [*capabilities.COMMANDS, *capabilities.PYTHON]
    refused = [name for name, answer in column.items() if answer == "no"]
    assert "yes" not in capabilities.answers(robot, refused).values()
    assert all(f"\n- {name}, {robot}: " in page for name in refused)
