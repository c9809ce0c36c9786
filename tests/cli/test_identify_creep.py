"""`mckibben identify-creep`: a recording of steps of the pressure, the report, what is kept, and mistakes."""

import json

import numpy as np
import pytest


@pytest.fixture
def recording(tmp_path):
    """Steps at 100 N/bar, of which 8 % follow with 2 s."""
    step = 0.05
    time = np.arange(0, 60, step)
    pressure = 1.0 + np.array([0, 1, 2, 1, 0, 2])[(time // 10).astype(int)]
    behind = np.ones(time.size)
    for k in range(1, time.size):
        behind[k] = pressure[k - 1] + (behind[k - 1] - pressure[k - 1]) * np.exp(-step / 2)
    force = 100 * (pressure + 0.08 * (behind - pressure)) + np.random.default_rng(2).normal(0, 0.1, time.size)
    rows = [f"{t:.2f},{p},{f:.4f}" for t, p, f in zip(time, pressure, force, strict=True)]
    path = tmp_path / "steps.csv"
    path.write_text("\n".join(["time_s,pressure_bar,force_N", *rows]), encoding="utf-8")
    return path


def test_share_and_time_constant_are_found_and_kept(cli, recording, tmp_path):
    given = ("identify-creep", str(recording), "--contraction", "5 %")
    found = cli(*given, "--out", "kept")
    assert found.code == 0, found.err
    assert "intervals" in found.out
    numbers = json.loads((tmp_path / "kept" / "results.json").read_text(encoding="utf-8"))
    assert numbers["scalars"]["share"]["value"] == pytest.approx(0.08, rel=0.03)
    assert numbers["scalars"]["time_constant"]["value"] == pytest.approx(2.0, rel=0.05)
    assert not numbers["remarks"]
    assert json.loads(cli(*given, "--json").out) == numbers


def test_a_recording_without_steps_is_refused_with_a_remedy(cli, recording):
    lines = recording.read_text(encoding="utf-8").splitlines()
    recording.write_text("\n".join(lines[:150]), encoding="utf-8")
    found = cli("identify-creep", str(recording), "--contraction", "5 %")
    assert found.code == 2 and "step the pressure" in found.err
