"""`mckibben new`: files to start from run as they are, with a muscle of the catalog or the user's."""

import json

import pytest

from mckibben import catalog
from mckibben.component.schema import ComponentField, write
from mckibben.config.document import to_text
from mckibben.muscle import Muscle
from mckibben.scenario import Scenario, batched
from mckibben.simulation import LEAST_DISK_MARGIN
from mckibben.study.parameters.uncertainty import extremes, uncertainty
from mckibben.units import deg

OWN = Muscle(catalog.specimen("DMSP-20-300"), catalog.law("lei-mas-10-180n"))


@pytest.mark.slow
@pytest.mark.parametrize("own", [False, True])
def test_a_joint_runs_with_margins(cli, tmp_path, own):
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "muscle.yaml").write_text(to_text(write(OWN, ComponentField(Muscle))))
    assert cli("new", "joint", "joint.yaml", *(("--muscle", "own/muscle.yaml") if own else ())).code == 0
    run = json.loads(cli("simulate", "joint.yaml", "--json").out)["scalars"]
    assert run["angle_rmse"]["value"] < 0.3 * deg and run["command_reversals"]["value"] < (50 if own else 10)
    scenario = Scenario.read("joint.yaml")
    assert len(scenario.uncertainty) == 7 and all(muscle.has_friction for muscle in scenario.joint.muscles)
    assert batched(scenario, extremes(uncertainty(scenario))).disk_margins(20).min() >= LEAST_DISK_MARGIN
    length = "266 mm" if own else "162 mm"
    assert (tmp_path / "joint.yaml").read_text().count(f"rest_length: {length}") == 2


@pytest.mark.slow
@pytest.mark.parametrize(("against", "own"), [("weight", True), ("muscle", False)])
def test_an_axis_runs_with_margins(cli, tmp_path, own, against):
    (tmp_path / "own.yaml").write_text(to_text(write(OWN, ComponentField(Muscle))))
    done = cli("new", "axis", "axis.yaml", "--against", against, *(("--muscle", "own.yaml") if own else ()))
    assert done.code == 0, done.err
    assert cli("envelope", "axis.yaml").code == 0
    columns = json.loads(cli("simulate", "axis.yaml", "--json").out)["scalars"]
    scenario = Scenario.read("axis.yaml")
    assert columns["angle_rmse"]["unit"] == "m" and columns["angle_rmse"]["value"] < 0.25 * scenario.start.angle
    assert ("stiffness_rmse" in columns) == scenario.follows_stiffness == (against == "muscle")
    assert scenario.margins().stable
    assert batched(scenario, extremes(uncertainty(scenario))).disk_margins(20).min() >= LEAST_DISK_MARGIN


@pytest.mark.slow
def test_a_test_and_a_robot_are_valid(cli):
    for kind, command in (("bench", ("rig", "run", "--dry-run")), ("robot", ("robot", "pressures"))):
        assert cli("new", kind, f"{kind}.yaml").code == 0
        done = cli(*command, f"{kind}.yaml")
        assert done.code == 0, done.err


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("jiont", "x.yaml"), "did you mean 'joint'"),
        (("robot", "x.yaml", "--muscle", "own.yaml"), "leave --muscle out"),
        (("joint", "x.yaml", "--muscle", "missing.yaml"), "missing.yaml"),
        (("joint", "there.yaml"), "already exists"),
        (("joint", "x.yaml", "--against", "weight"), "leave it out"),
        (("axis", "x.yaml", "--against", "wieght"), "did you mean 'weight'"),
    ],
)
def test_mistakes_write_nothing(cli, tmp_path, arguments, meant):
    (tmp_path / "there.yaml").write_text("mine")
    done = cli("new", *arguments)
    assert done.code == 2 and meant in done.err
    assert (tmp_path / "there.yaml").read_text() == "mine" and not (tmp_path / "x.yaml").exists()
