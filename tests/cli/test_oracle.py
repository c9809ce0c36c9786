"""`mckibben oracle`."""

import json
from pathlib import Path

import pytest

from mckibben.scenario import Scenario

EXAMPLE = Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml"


@pytest.mark.slow
def test_the_optimal_commands_are_better_than_the_controller_from_both_starts(cli, tmp_path):
    scenario = Scenario.read(EXAMPLE)
    path = tmp_path / "short.yaml"
    scenario.model_copy(update={"duration": 0.1}).to_yaml(path)
    code, out, _ = cli("oracle", str(path), "--json", "--out", "kept")
    assert code == 0
    found = json.loads(out)
    controller, optimal = found["runs"].values()
    assert optimal["angle_rmse_deg"] < controller["angle_rmse_deg"]
    assert found["ratio"] == pytest.approx(controller["angle_rmse_deg"] / optimal["angle_rmse_deg"])
    costs = [start["cost"] for start in found["starts"]]
    assert max(costs) < 1.05 * min(costs)
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {"results.json", "oracle.png", "oracle.svg"}
