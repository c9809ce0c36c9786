"""The examples are runs of the report: who starts from one finds it there."""

from pathlib import Path

import pytest

from mckibben.paper.settings import AS_PRINTED, PRE_CONTRACTED, StiffnessReference, bp_scenario, pid_scenario
from mckibben.study.scenario import Scenario

EXAMPLES = Path(__file__).parents[2] / "examples"
RUNS = {
    "as-printed-constant-pid": pid_scenario(AS_PRINTED, StiffnessReference.CONSTANT),
    "pre-contracted-step-pid": pid_scenario(PRE_CONTRACTED, StiffnessReference.STEP),
    "pre-contracted-step-backprop": bp_scenario(PRE_CONTRACTED, StiffnessReference.STEP),
}


def test_there_is_a_run_for_every_example():
    assert {path.stem for path in EXAMPLES.glob("*.yaml")} == set(RUNS)


@pytest.mark.parametrize("name", RUNS)
def test_an_example_is_built_as_the_run_of_the_report(name):
    example, run = Scenario.read(EXAMPLES / f"{name}.yaml"), RUNS[name]
    assert repr(example.plant()) == repr(run.plant())
    assert repr(example.control()) == repr(run.control())
    assert repr(example.reference()) == repr(run.reference())
    assert example.start == run.start
    assert (example.duration, example.control_period, example.substeps) == (10.0, 1e-3, 4)
