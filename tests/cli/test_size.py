"""`mckibben size`: the tables, what is kept, and mistakes of a requirement."""

import csv
import json
from pathlib import Path

import pytest

from mckibben import Scenario

pytestmark = pytest.mark.usefixtures("optimized")
EXAMPLE = Path("examples/sizing/pulleys.yaml").resolve()


@pytest.mark.slow
def test_a_joint_is_sized_kept_and_runs(cli, tmp_path):
    found = cli("size", str(EXAMPLE), "--out", "kept")
    assert found.code == 0, found.err
    numbers = json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    candidates, parts, checks = (table["columns"] for table in numbers["tables"])
    torque = [candidates[name]["values"][0] for name in ("least torque", "torque beyond gravity", "highest torque")]
    assert torque == sorted(torque) and candidates["muscle"]["values"][0] in found.out
    assert all(checks["met"]["values"])
    with (tmp_path / "kept" / "parts.csv").open(encoding="utf-8") as file:
        assert [row["part"] for row in csv.DictReader(file)] == parts["part"]["values"]
    assert (tmp_path / "kept" / "selection.png").stat().st_size > 5000
    assert Scenario.read(tmp_path / "kept" / "scenario.yaml").name.startswith("sized")
    assert cli("simulate", "kept/scenario.yaml").code == 0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (("angles: [-30 deg, 30 deg]\n", ""), "angles"),
        (("stiffness: [15 N*m/rad, 18 N*m/rad]", "stiffness: [15 bar, 18 bar]"), "stiffness"),
        (("supply: 6 bar", "supply: 6 bar\nmuscles: [missing.yaml]"), "missing.yaml"),
    ],
)
def test_a_mistake_names_its_field(cli, tmp_path, change, named):
    (tmp_path / "need.yaml").write_text(EXAMPLE.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    refused = cli("size", "need.yaml")
    assert refused.code == 2
    assert named in refused.err
