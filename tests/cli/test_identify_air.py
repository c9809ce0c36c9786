"""`mckibben identify-air`: recordings of tests with a shut valve, the table, what is kept, and mistakes."""

import json

import numpy as np
import pytest

SPECIMEN = ("--specimen", "MAS-10-180N-AA-MC-O")


@pytest.fixture
def recording(tmp_path):
    """A muscle at 10 % that is filled to 5 bar at 0.5 s, and cools to 4 bar with a time constant of 0.4 s."""
    time = np.arange(0.0, 4.0, 1e-3)
    filled = np.interp(time, [0.0, 0.4, 0.5], [0.0, 0.0, 5.0])
    pressure = np.where(time < 0.5, filled, 4 + np.exp(-(time - 0.5) / 0.4))
    noise = np.random.default_rng(0).normal(0.0, 2e-3, time.size)
    rows = [f"{t:.3f},{p:.5f},10" for t, p in zip(time, pressure + noise, strict=True)]
    path = tmp_path / "shut.csv"
    path.write_text("\n".join(["time_s,pressure_bar,force_N", *(f"{row}" for row in rows)]), encoding="utf-8")
    return path


def wall(numbers):
    """Estimate of the conductance of the wall [W/K], and its interval."""
    (table,) = numbers["tables"]
    assert table["columns"]["quantity"]["values"][0] == "wall_conductance"
    return [table["columns"][name]["values"][0] for name in ("estimate", "lower", "upper")]


def test_the_conductance_of_the_wall_is_found_and_kept(cli, recording, tmp_path):
    given = ("identify-air", str(recording), *SPECIMEN, "--contraction", "10 %", "--dead-volume", "2 cm^3")
    found = cli(*given, "--out", "kept")
    assert found.code == 0, found.err
    assert "wall_conductance" in found.out and "W/K" in found.out
    numbers = json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    assert numbers["columns"]["time_constants"]["values"] == [pytest.approx(0.4, rel=0.01)]
    value, low, high = wall(numbers)
    assert low < value < high < 1.1 * low
    assert json.loads(cli(*given, "--json").out) == numbers


@pytest.mark.parametrize(
    ("options", "named"),
    [(SPECIMEN, "--contraction"), ((*SPECIMEN, "--contraction", "10 bar"), "--contraction"), ((), "--specimen")],
)
def test_mistakes_are_explained(cli, recording, options, named):
    found = cli("identify-air", str(recording), *options)
    assert found.code == 2
    assert named in found.err
