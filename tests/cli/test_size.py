"""`mckibben size`: the table, what is kept, and mistakes."""

import csv
import dataclasses
import json

import pytest

from mckibben import Scenario, reachability

pytestmark = pytest.mark.usefixtures("optimized")
LOAD = ("--mass", "2 kg", "--arm", "250 mm")
MOTION = ("--angles", "-30..30 deg", "--cycle", "2 s")


@pytest.mark.slow
def test_a_joint_is_sized_kept_and_runs(cli, tmp_path, monkeypatch):
    size, asked, sized = reachability.size, [], []

    def once(requirement, *given, **options):
        asked.append(requirement)
        sized.append(sized[0] if sized else size(requirement, *given, **options))
        return sized[0]

    monkeypatch.setattr(reachability, "size", once)
    given = ("size", *LOAD, *MOTION, "--stiffness", "15 N*m/rad", "--torque", "1 N*m")
    found = cli(*given, "--out", "kept")
    assert found.code == 0, found.err
    numbers = json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    best = numbers["candidates"][0]
    assert best["make"] in found.out and best["torque_Nm"][0] < best["torque_Nm"][1] < best["torque_Nm"][2]
    assert all(check["met"] for check in numbers["simulated"])
    with (tmp_path / "kept" / "parts.csv").open(encoding="utf-8") as file:
        parts = [row["part"] for row in csv.DictReader(file)]
    assert parts == ["muscle", "pulley", "proportional valve", "tube", "reservoir", "compressor"]
    for name in ("joint.svg", "selection.png"):
        assert (tmp_path / "kept" / name).stat().st_size > 5000
    assert Scenario.read(tmp_path / "kept" / "scenario.yaml").name.startswith("sized")
    assert cli("simulate", "kept/scenario.yaml").code == 0
    motion = ("--angles", "-30..30 deg", "--speed", "94.25 deg/s")  # pi * 60 deg in 2 s
    assert json.loads(cli("size", *LOAD, *motion, *given[-4:], "--json").out) == numbers
    assert (asked[0].cycle, asked[1].cycle) == (2.0, pytest.approx(2.0, rel=1e-4))
    assert dataclasses.replace(asked[1], cycle=2.0) == asked[0]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ((*LOAD, "--cycle", "2 s"), "--angles"),
        ((*LOAD, "--angles", "-30..30 deg"), "--cycle"),
        ((*LOAD, *MOTION, "--speed", "90 deg/s"), "--cycle"),
        ((*MOTION,), "--mass"),
        ((*LOAD, *MOTION, "--inertia", "1 kg*m^2"), "--inertia"),
        ((*LOAD, *MOTION, "--stiffness", "15 bar"), "--stiffness"),
        ((*LOAD, "--angles", "-30..30 deg", "--speed", "-5 deg/s"), "--speed"),
        ((*LOAD, *MOTION, "--tube", "-1 m"), "--tube"),
        ((*MOTION, "--inertia", "1 kg*m^2", "--hanging", "40 deg"), "--hanging"),
        (("missing.yaml", *LOAD, *MOTION), "missing.yaml"),
    ],
)
def test_a_mistake_names_its_option(cli, options, named):
    refused = cli("size", *options)
    assert refused.code == 2
    assert named in refused.err


def test_a_scenario_in_place_of_a_muscle_is_named(cli, tmp_path):
    (tmp_path / "joint.yaml").write_text("joint: x\ncontroller: y\nreference: z\n", encoding="utf-8")
    found = cli("size", "joint.yaml", *LOAD, *MOTION)
    assert found.code == 2
    assert "1 problem" in found.err and "`mckibben simulate` reads" in found.err
