"""`mckibben identify --of creep` and `--of air`: recordings over time, what is kept, and mistakes."""

import json

import numpy as np
import pytest

SPECIMEN = ("--read", "specimen=MAS-10-180N-AA-MC-O")


@pytest.fixture
def shut(tmp_path):
    """A muscle at 10 % that is filled to 5 bar at 0.5 s, and cools to 4 bar with a time constant of 0.4 s."""
    time = np.arange(0.0, 4.0, 1e-3)
    filled = np.interp(time, [0.0, 0.4, 0.5], [0.0, 0.0, 5.0])
    pressure = np.where(time < 0.5, filled, 4 + np.exp(-(time - 0.5) / 0.4))
    pressure += np.random.default_rng(0).normal(0.0, 2e-3, time.size)
    return write(tmp_path / "shut.csv", time, pressure, np.full(time.size, 10.0))


@pytest.fixture
def steps(tmp_path):
    """Steps at 100 N/bar, of which 8 % follow with 2 s."""
    step = 0.05
    time = np.arange(0, 60, step)
    pressure = 1.0 + np.array([0, 1, 2, 1, 0, 2])[(time // 10).astype(int)]
    behind = np.ones(time.size)
    for k in range(1, time.size):
        behind[k] = pressure[k - 1] + (behind[k - 1] - pressure[k - 1]) * np.exp(-step / 2)
    force = 100 * (pressure + 0.08 * (behind - pressure)) + np.random.default_rng(2).normal(0, 0.1, time.size)
    return write(tmp_path / "steps.csv", time, pressure, force)


def write(path, *columns):
    np.savetxt(path, np.column_stack(columns), "%.5f", ",", header="time_s,pressure_bar,force_N", comments="")
    return path.name


def kept(cli, folder, *given):
    """Numbers that a command keeps, and prints."""
    done = cli(*given, "--out", "kept")
    assert done.code == 0, done.err
    numbers = json.loads((folder / "kept" / "results.json").read_text(encoding="utf-8"))
    assert json.loads(cli(*given, "--json").out) == numbers
    return numbers


def test_the_conductance_of_the_wall(cli, shut, tmp_path):
    given = ("identify", shut, "--of", "air", *SPECIMEN, "--read", "contraction=10 %", "--dead-volume", "2 cm^3")
    numbers = kept(cli, tmp_path, *given)
    assert numbers["columns"]["time_constants"]["values"] == [pytest.approx(0.4, rel=0.01)]
    (table,) = numbers["tables"]
    assert table["columns"]["quantity"]["values"][0] == "wall_conductance"
    value, low, high = (table["columns"][name]["values"][0] for name in ("estimate", "lower", "upper"))
    assert low < value < high < 1.1 * low


def test_share_and_time_constant_of_the_creep(cli, steps, tmp_path):
    numbers = kept(cli, tmp_path, "identify", steps, "--of", "creep", "--read", "contraction=5 %")
    assert numbers["scalars"]["share"]["value"] == pytest.approx(0.08, rel=0.03)
    assert numbers["scalars"]["time_constant"]["value"] == pytest.approx(2.0, rel=0.05)
    assert not numbers["remarks"]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("air", *SPECIMEN), "contraction=10 %"),
        (("air", *SPECIMEN, "--read", "contraction=10 bar"), "--read contraction="),
        (("air",), "--read specimen=NAME"),
        (("creep", "--pool"), "--pool"),
        (("heat",), "heat"),
    ],
)
def test_mistakes_are_explained(cli, shut, options, named):
    refused = cli("identify", shut, "--of", *options)
    assert (refused.code, refused.out) == (2, "") and named in refused.err


def test_a_recording_without_steps_is_refused_with_a_remedy(cli, steps, tmp_path):
    lines = (tmp_path / steps).read_text(encoding="utf-8").splitlines()
    (tmp_path / steps).write_text("\n".join(lines[:150]), encoding="utf-8")
    refused = cli("identify", steps, "--of", "creep", "--read", "contraction=5 %")
    assert refused.code == 2 and "step the pressure" in refused.err
