"""`mckibben stiffness`: the table, what is kept, and mistakes."""

import json
import re

import pytest

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
    held = {name: entry["value"] for name, entry in numbers["scalars"].items()}
    secant, closed = (numbers["columns"][name]["values"] for name in ("secant", "closed_secant"))
    # asked for in motion of 1 deg, the last amplitude; without friction it is less, with less motion more
    assert secant[-1] == pytest.approx(held["setpoint"], rel=5e-3) == 38.0
    assert held["isobaric"] < 20 < held["closed_valve"]
    assert secant[0] == pytest.approx(held["isobaric"] + 46.1, abs=0.5)
    tests = {table["title"]: table["columns"]["10 Hz"]["values"] for table in numbers["tables"]}
    assert tests["Simulated: constant pressures"] == pytest.approx(secant, rel=1e-4)
    assert tests["Simulated: closed valves"] == pytest.approx(closed, rel=1e-4)
    # these valves hold the pressure, whatever the motion: no test with constant commands
    assert set(tests) == {f"Simulated: {name}" for name in ("constant pressures", "closed valves", "controller active")}
    assert re.search(rf"\n +1 +{secant[-1]:.4g} +{closed[-1]:.4g}\n", found.out)
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {"results.json", "stiffness.png", "stiffness.svg"}


@pytest.mark.parametrize("motion", ["1 deg, 10 deg", "0..1 deg, 1 Hz", "1 deg"])
def test_mistakes_are_explained(cli, motion):
    found = cli("stiffness", "s.yaml", "--motion", motion)
    assert found.code == 2
    assert "--motion" in found.err
