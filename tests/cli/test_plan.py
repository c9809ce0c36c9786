"""mckibben plan: its table, what it keeps, and what it says of wrong input."""

from __future__ import annotations

import json

import pytest

MARTENS = "dmsp-10-250-martens2017"


@pytest.mark.slow
def test_the_points_and_what_they_gain(cli):
    found = cli("plan", MARTENS, "--law", "exponential", "--for", "stiffness", "--points", "5")
    assert (found.code, found.err) == (0, "")
    assert "stiffness at 0 deg, 3 bar, 3 bar: 74.24 N*m/rad, standard error now 1.98 N*m/rad" in found.out
    assert "points to measure next" in found.out and "directions are not recorded" in found.out


@pytest.mark.slow
def test_what_is_kept(cli, tmp_path):
    options = ("--for", "decay", "--limits", "0..20 %, 1..6 bar", "--step", "2 mm, 0.5 bar")
    found = cli("plan", MARTENS, *options, "--json", "--out", "next")
    assert found.code == 0 and all(name in found.err for name in ("plan.csv", "results.json", "planned.svg", "next"))
    numbers = json.loads(found.out)
    assert numbers == json.loads((tmp_path / "next" / "results.json").read_text(encoding="utf-8"))
    points, (parameters,) = numbers["columns"], (table["columns"] for table in numbers["tables"])
    errors = points["standard_error"]
    assert errors["unit"] == "1" and errors["values"] == sorted(errors["values"], reverse=True)
    assert errors["values"][-1] == pytest.approx(parameters["decay"]["values"][1])
    rows = (tmp_path / "next" / "plan.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == "pressure_bar,contraction_percent,direction,repeat" and len(rows) == 9
    for pressure, contraction in zip(points["pressure"]["values"], points["contraction"]["values"], strict=True):
        assert 1e5 <= pressure <= 6e5 and pressure % 0.5e5 == 0
        assert contraction / 0.008 == pytest.approx(round(contraction / 0.008))
    assert (tmp_path / "next" / "planned.png").stat().st_size > 20_000
