"""`mckibben envelope`: verdict, trackable changes, table, and errors."""

import json

import pytest

INFEASIBLE = ("amplitude: 2 deg, frequency: 0.5 Hz", "amplitude: 20 deg, frequency: 5 Hz")


@pytest.fixture
def printed(shortened, tmp_path):
    """The knee as printed, with a reference of 20 deg."""
    text = shortened("as-printed-constant-pid").replace(*INFEASIBLE)
    (tmp_path / "s.yaml").write_text(text, encoding="utf-8")
    return tmp_path


def rows(numbers):
    """Table of the static envelope by angle, in SI."""
    columns = numbers["tables"][-1]["columns"]
    names = [name for name in columns if name != "angle"]
    cells = zip(*(columns[name]["values"] for name in names), strict=True)
    return {
        angle: dict(zip(names, row, strict=True)) for angle, row in zip(columns["angle"]["values"], cells, strict=True)
    }


@pytest.mark.slow
def test_an_infeasible_reference_and_what_would_be_trackable(cli, printed):
    found = cli("envelope", "s.yaml", "--out", "kept")
    assert found.code == 0
    numbers = json.loads((printed / "kept" / "results.json").read_text(encoding="utf-8"))
    assert "not even statically trackable" in numbers["verdict"]
    amplitude = numbers["scalars"]["amplitude"]["value"]
    assert 0 < amplitude < 0.2 and numbers["scalars"]["speed"]["value"] is None
    assert {path.name for path in (printed / "kept").iterdir()} == {"results.json", "envelope.png", "envelope.svg"}
    text = (printed / "s.yaml").read_text(encoding="utf-8")
    for factor, trackable in ((amplitude, True), (amplitude + 0.002, False)):
        (printed / "less.yaml").write_text(text.replace("20 deg", f"{20 * factor} deg"), encoding="utf-8")
        verdict = json.loads(cli("envelope", "less.yaml", "--json").out)["verdict"]
        assert ("trackable throughout" in verdict) == trackable
