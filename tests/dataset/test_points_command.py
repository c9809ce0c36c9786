import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from mckibben.cli.points import points
from mckibben.dataset import Recording, read_dataset
from mckibben.errors import DatasetError, ParameterError, RangeError, UnitError

APP = typer.Typer()
APP.command()(points)

TIME = np.arange(0, 30, 0.02)
LEVEL = np.array([1.0, 2, 3, 2, 1])[np.minimum(TIME // 6, 4).astype(int)]  # bar, 6 s each


@pytest.fixture
def run(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")

    def call(*arguments: str, error: type[Exception] | None = None) -> str:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            done = CliRunner().invoke(APP, list(arguments))
        if error is None:
            assert done.exit_code == 0, (done.output, done.exception)
            return done.stdout
        assert isinstance(done.exception, error)
        return str(done.exception)

    return call


def write(name: str, pressure: np.ndarray, lines: str = "", gain: float = 1) -> None:
    rows = [f"{t:.2f},{p:.3f},{gain * (40 * p - 10):.2f}\n" for t, p in zip(TIME, pressure, strict=True)]
    Path(name).write_text("Time (s),Druck [bar],Force (N)\n" + "".join(rows) + lines)


COLUMN = ("--column", "Druck [bar]=pressure_bar", "--read", "contraction=10 %")


@pytest.mark.slow
def test_plateaus_become_files_that_are_read_as_points(run):
    write("rig.csv", LEVEL)
    Path("how.yaml").write_text("specimen: DMSP-10\n")
    text = run("rig.csv", *COLUMN, "--out", "found", "--read", "how.yaml", "--details")
    assert "5 points from 1500 samples: 1470 used" in text or "5 points from 1500 samples: 1480 used" in text
    assert "filling" in text and "venting" in text
    for name in ("points.csv", "points.nc"):
        data = read_dataset(f"found/{name}")
        np.testing.assert_allclose(data.force, [30, 70, 110, 70, 30])
        assert data.table["phase"].values.tolist() == ["", "filling", "filling", "venting", "venting"]
        assert data.table.attrs["specimen"] == "DMSP-10"
    run("rig.csv", "--read", "found/recipe.yaml", "--out", "again")
    np.testing.assert_array_equal(read_dataset("again/points.nc").force, data.force)


def test_numbers_for_machines_have_units(run):
    write("rig.csv", LEVEL)
    found = json.loads(run("rig.csv", *COLUMN, "--json"))
    columns = found["columns"]
    assert columns["pressure"]["unit"] == "Pa" and columns["contraction"]["values"] == [0.1] * 5
    assert columns["approach"]["values"] == ["-", "filling", "filling", "venting", "venting"]


@pytest.mark.parametrize(
    ("arguments", "error", "expected"),
    [
        (("--dwell", "1"), UnitError, "--dwell: '1' has no unit"),
        (("--tolerance", "1 %, 2 bra"), UnitError, "--tolerance: unknown unit 'bra'"),
        (("--column", "Druck"), ParameterError, "--column 'Druck'"),
    ],
)
def test_options_that_cannot_be_read(arguments, error, expected, run):
    write("rig.csv", LEVEL)
    assert expected in run("rig.csv", *COLUMN, *arguments, error=error)


def test_files_at_several_lengths_are_read_with_the_lengths_in_their_names(run):
    for length, gain in ((200, 1.0), (190, 0.6)):
        write(f"L{length}mm.csv", LEVEL, gain=gain)
    given = ("L200mm.csv", "L190mm.csv", "--initial-length", "200 mm")
    Path("name.yaml").write_text("from_name: L{length_mm}\n")
    run(*given, "--read", "name.yaml", "--out", "found")
    assert "from_name" in Path("found/recipe.yaml").read_text(encoding="utf-8")
    table = read_dataset("found/points.csv").table
    np.testing.assert_allclose(np.unique(table["contraction"]), [0.0, 0.05], atol=1e-12)
    run(*given, error=RangeError)
    Path("name.yaml").write_text("from_name: M{length_mm}\n")
    run(*given, "--read", "name.yaml", error=DatasetError)


def test_the_samples_of_a_recording_are_points_for_a_fit(tmp_path):
    time, pressure = np.arange(400.0), np.repeat([2e5, 3e5, 4e5, 5e5], 100)
    contraction = np.tile(np.concatenate([np.linspace(0, 0.15, 50), np.linspace(0.15, 0, 50)]), 4)
    force = 2e-3 * pressure * (1 - contraction / 0.28) ** 2
    samples = {"time": time, "pressure": pressure, "contraction": contraction, "force": force}
    Recording.of(**samples).to_netcdf(tmp_path / "rig.nc")
    data = read_dataset(tmp_path / "rig.nc", slack_force=0.0)
    np.testing.assert_array_equal(data.force, force)
    assert data.pressures.tolist() == [2e5, 3e5, 4e5, 5e5] and len(data.directions) == 2
