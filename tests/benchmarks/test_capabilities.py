"""What works for which robot: the page is that of the benchmark, and batches of robots are compiled C."""

from __future__ import annotations

import importlib
import json
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


def test_the_page_is_made_of_the_kept_answers(capabilities):
    table = json.loads(capabilities.ANSWERS.read_text(encoding="utf-8"))
    assert capabilities.PAGE.read_text(encoding="utf-8") == capabilities.page(table)


@pytest.mark.slow
def test_what_is_refused_by_the_page_is_refused(capabilities):
    """The benchmark itself tries all, and takes an hour."""
    kept = json.loads(capabilities.ANSWERS.read_text(encoding="utf-8"))["leg"]
    answers = capabilities.answers("leg", [name for name in capabilities.COMMANDS if kept[name] != "yes"])
    assert "yes" not in answers.values()
