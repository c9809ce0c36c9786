"""Our own examples cause no warnings: mckibben's warnings are errors in tests, and fits list theirs."""

from pathlib import Path

import pytest

from mckibben import identify, read_dataset
from mckibben.muscle import ExponentialLaw
from mckibben.scenario import Scenario, run_scenario

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_scenario_runs_without_a_warning(path):
    assert run_scenario(Scenario.read(path)).result.outcome.usable


@pytest.mark.slow
def test_a_dataset_has_only_the_warning_of_its_friction():
    fit = identify(ExponentialLaw, read_dataset(EXAMPLES / "rig.csv"))
    assert [warning for warning in fit.warnings if "friction" not in warning] == []
