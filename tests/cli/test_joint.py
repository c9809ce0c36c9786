"""`mckibben simulate`, `envelope`, `stiffness` and `size`: our examples, warnings, and what is kept."""

import csv
import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from mckibben.dataset.formats import read_table
from mckibben.scenario import Scenario, run_scenario
from mckibben.simulation import SimulationResult
from mckibben.units import deg

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_animate_writes_the_run_and_mistakes_come_before_it(cli, tmp_path, shortened):
    (tmp_path / "short.yaml").write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    found = cli("simulate", "short.yaml", "--animate", "run.gif", "--json")
    assert (found.code, json.loads(found.out)["ok"]) == (1, False)
    assert (tmp_path / "run.gif").read_bytes()[:6] == b"GIF89a"
    for name, part in (("run.gif", "already"), ("run.mp4", ".webp"), ("missing/run.gif", "")):
        refused = cli("simulate", "short.yaml", "--animate", name)
        assert (refused.code, refused.out) == ((2, "") if part else (1, refused.out)), name
        assert part in refused.err
    assert cli("simulate", "short.yaml", "--animate", "run.gif", "--force").code == 1


@pytest.mark.slow
def test_out_keeps_a_run_that_can_be_had_again(cli, tmp_path, shortened):
    (tmp_path / "short.yaml").write_text(shortened("pre-contracted-step-pid"), encoding="utf-8")
    found = cli("simulate", "short.yaml", "--out", "kept", "--json")
    assert found.code == 1
    kept = tmp_path / "kept"
    assert {"result.nc", "result.mcap", "results.json", "scenario.yaml", "tracking.png"} <= {
        p.name for p in kept.iterdir()
    }
    numbers = json.loads((kept / "results.json").read_text(encoding="utf-8"))
    assert json.loads(found.out) == numbers
    assert Scenario.read(kept / "scenario.yaml") == Scenario.read(tmp_path / "short.yaml")
    result = SimulationResult.from_netcdf(kept / "result.nc")
    again = run_scenario(Scenario.read(kept / "scenario.yaml"))
    assert again.to_dataset().drop_attrs().identical(result.to_dataset().drop_attrs())
    assert result.metrics["stiffness_rmse"] == numbers["scalars"]["stiffness_rmse"]["value"]
    table = read_table(kept / "result.mcap", {})
    columns = {column.label: column for column in table.columns}
    np.testing.assert_array_equal(columns["pressure1"].cells, result["pressure1"])
    assert (columns["pressure1"].unit, columns["angle"].unit) == ("Pa", "rad")


def test_the_mistakes_of_the_documentation_give_its_words(cli, tmp_path):
    text = (ROOT / "examples" / "pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
    text = text.replace("kd: 0.4 bar*s/rad", "kd: 0").replace("duration: 10 s", "duration: 10.0005 s")
    (tmp_path / "bad.yaml").write_text(text, encoding="utf-8")
    found = cli("simulate", "bad.yaml")
    flat = lambda words: " ".join(re.sub(r"line \d+", "line", words).split())  # noqa: E731
    assert flat(found.err) in flat((ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8"))


INFEASIBLE = ("amplitude: 2 deg, frequency: 0.5 Hz", "amplitude: 20 deg, frequency: 5 Hz")


@pytest.mark.slow
def test_an_infeasible_reference_and_what_would_be_feasible(cli, tmp_path, shortened):
    text = shortened("as-printed-constant-pid").replace(*INFEASIBLE)
    (tmp_path / "s.yaml").write_text(text, encoding="utf-8")
    found = cli("envelope", "s.yaml", "--out", "kept")
    assert found.code == 0
    numbers = json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    assert "the joint cannot hold the desired angle" in numbers["verdict"]
    amplitude = numbers["scalars"]["amplitude"]["value"]
    scenario = Scenario.read(tmp_path / "s.yaml")
    for factor, feasible in ((amplitude, True), (amplitude + 0.002, False)):
        smaller = dataclasses.replace(scenario.signals.angle, amplitude=factor * 20 * deg)
        changed = scenario.model_copy(update={"signals": dataclasses.replace(scenario.signals, angle=smaller)})
        assert changed.envelope().reference.feasible == feasible
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {"results.json", "envelope.png", "envelope.svg"}


FRICTION = "law: lei-mas-10-180n, friction: {half_width: 7.5 N, presliding_length: 0.5 mm}}"


@pytest.mark.slow
def test_closed_forms_simulation_and_the_controller(cli, shortened, tmp_path):
    text = shortened("pre-contracted-step-pid").replace("law: lei-mas-10-180n}", FRICTION)
    text = text.replace("before: 13 N*m/rad", "before: 38 N*m/rad").replace(
        "  stiffness: {kp:", "  stiffness_amplitude: 1 deg\n  stiffness: {kp:"
    )
    (tmp_path / "s.yaml").write_text(text, encoding="utf-8")
    found = cli("stiffness", "s.yaml", "--motion", "0.01..1 deg, 10 Hz", "--out", "kept")
    assert found.code == 0, found.err
    numbers = json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    tables = {table["title"]: table["columns"] for table in numbers["tables"]}
    small = tables["Stiffness of small motion, without friction"]
    held = {name: entry["values"][0] for name, entry in small.items()}
    _, secant, closed = (entry["values"] for entry in tables["Closed forms, with friction"].values())
    # asked for in motion of 1 deg, the last amplitude; without friction it is less, with less motion more
    assert secant[-1] == pytest.approx(held["setpoint"], rel=5e-3) == 38.0
    assert held["isobaric"] < 20 < held["closed_valve"]
    assert secant[0] == pytest.approx(held["isobaric"] + 46.1, abs=0.5)
    tests = {title: columns["10 Hz"]["values"] for title, columns in tables.items() if "Simulated" in title}
    assert tests["Simulated: constant pressures"] == pytest.approx(secant, rel=1e-4)
    assert tests["Simulated: closed valves"] == pytest.approx(closed, rel=1e-4)
    # these valves hold the pressure, whatever the motion: no test with constant commands
    assert set(tests) == {f"Simulated: {name}" for name in ("constant pressures", "closed valves", "controller active")}
    assert re.search(rf"\n +1 +{secant[-1]:.4g} +{closed[-1]:.4g}\n", found.out)
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {
        *("results.json", "stiffness.png", "stiffness.svg", "felt_stiffness.png", "felt_stiffness.svg")
    }


@pytest.mark.usefixtures("optimized")
@pytest.mark.slow
def test_a_joint_is_sized_kept_and_runs(cli, tmp_path):
    found = cli("size", str(ROOT / "examples" / "sizing" / "pulleys.yaml"), "--out", "kept")
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


FALLS_WITH_PRESSURE = """\
name: a joint
joint:
  geometry:
    class: PairedPaths
    path1: {class: Pulley, radius: 25 mm, rest_length: 230 mm}
    path2: {class: Pulley, radius: 25 mm, rest_length: 230 mm}
  muscle:
    specimen: {name: exchanged, initial_length: 250 mm}
    law: {class: reynolds, f0: 250 N, f1: -8 N/bar, k0: 400 N, k1: 80 N/bar, domain: {pressure_max: 5 bar}}
load: {class: general, inertia: 0.02 kg*m^2, greatest_gravity_torque: 0 N*m, damping: 0.5 N*m*s/rad}
valve: {time_constant: 50 ms}
controller:
  position: {kp: 2 bar/rad, ki: 20 bar/(rad*s), kd: 0.1 bar*s/rad}
  stiffness: {kp: 0 bar/(N*m/rad), ki: 0 bar/(N*m*s/rad), kd: 0 bar*s/(N*m/rad)}
reference: {angle: {class: step, before: 0 deg, after: 8 deg, at: 0.5 s}, stiffness: 5 N*m/rad}
start: {angle: 0 deg}
duration: 1 s
control_period: 1 ms
"""


@pytest.mark.parametrize(("command", "code"), [pytest.param("envelope", 1, marks=pytest.mark.slow), ("margins", 2)])
def test_a_law_whose_force_falls_with_pressure_is_why_nothing_holds_the_joint(cli, tmp_path, command, code):
    (tmp_path / "joint.yaml").write_text(FALLS_WITH_PRESSURE, encoding="utf-8")
    found = cli(command, "joint.yaml")
    assert found.code == code
    assert "the law of 'exchanged'" in found.err
    assert "falls with pressure" in (found.out if code == 1 else found.err)
