import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from mckibben.cli.points import _levels, points
from mckibben.dataset import read_dataset, read_recording
from mckibben.errors import DatasetError, RangeError, UnitError
from mckibben.units import bar

APP = typer.Typer()
APP.command()(points)

TIME = np.arange(0, 30, 0.02)
LEVEL = np.array([1.0, 2, 3, 2, 1])[np.minimum(TIME // 6, 4).astype(int)]  # bar, 6 s each
RAMP = np.interp(TIME, [0, 14, 16, 30], [0, 6, 6, 0])


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


COLUMN = ("--column", "Druck [bar]=pressure_bar", "--contraction", "10 %")


def test_plateaus_become_a_file_that_is_read_as_points(run):
    write("rig.csv", LEVEL)
    Path("how.yaml").write_text("specimen: DMSP-10\n")
    text = run("rig.csv", *COLUMN, "--out", "points.csv", "--read", "how.yaml")
    assert "rig.csv: 5 points from 1500 samples" in text
    assert "1500 samples: 1470 used" in text or "1500 samples: 1480 used" in text
    assert "filling" in text and "venting" in text
    assert "wrote 5 points to points.csv; fit a law with: mckibben identify points.csv" in text
    data = read_dataset("points.csv")
    np.testing.assert_allclose(data.force, [30, 70, 110, 70, 30])
    assert data.table["phase"].values.tolist() == ["", "filling", "filling", "venting", "venting"]
    assert data.table.attrs["specimen"] == "DMSP-10"


def test_the_sign_of_a_load_cell_is_turned(run):
    write("rig.csv", LEVEL)
    write("turned.csv", LEVEL, gain=-1)
    Path("turned.csv").write_text(Path("turned.csv").read_text().replace("Force (N)", "Zug (N)"))
    turned_column = ("--column", "Zug (N)=-force_N")
    run("rig.csv", *COLUMN, "--out", "as-is.csv")
    run("turned.csv", *COLUMN, *turned_column, "--out", "turned-points.csv")
    as_is, turned = (read_dataset(name, slack_force=0.0) for name in ("as-is.csv", "turned-points.csv"))
    np.testing.assert_array_equal(turned.force, as_is.force)
    run("turned.csv", *COLUMN, "--column", "Zug (N)=force_N", error=DatasetError)


def test_a_file_that_cannot_be_kept_is_refused_before_the_work(run):
    write("rig.csv", LEVEL)
    for reading in (("rig.csv", *COLUMN), ("not there.csv",)):
        wrong = run(*reading, "--out", "nodir/points.csv", error=DatasetError)
        assert "points.csv: 1 problem" in wrong and "there is no folder nodir" in wrong
        Path("points.csv").write_text("kept")
        wrong = run(*reading, "--out", "points.csv", error=DatasetError)
        assert "points.csv: 1 problem\n  exists already" in wrong
        assert Path("points.csv").read_text() == "kept"
    assert not Path("nodir").exists()


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        ("1, 2.5, 4 bar", [1, 2.5, 4]),
        ("1 bar, 2.5 bar", [1, 2.5]),
        ("200 kPa,0.4MPa", [2, 4]),
        ("1e5, 2.5e5 Pa", [1, 2.5]),
        ("2bar", [2]),
    ],
)
def test_levels_have_a_unit_for_all_or_one_each(levels, expected):
    assert [level / bar for level in _levels(levels)] == pytest.approx(expected)


def test_an_isometric_record(run):
    write("rig.csv", RAMP)
    found = json.loads(run("rig.csv", *COLUMN, "--isometric", "--levels", "2, 4.5 bar", "--json", "--out", "points.nc"))
    assert [(p["pressure_bar"], p["came_by"]) for p in found["points"]] == [
        (2.0, "filling"),
        (4.5, "filling"),
        (2.0, "venting"),
        (4.5, "venting"),
    ]
    assert sum(found["samples"].values()) == len(TIME)
    assert read_dataset("points.nc").pressures.tolist() == [2 * bar, 4.5 * bar]
    assert "12 points" in run("rig.csv", *COLUMN, "--isometric", "--count", "6")


def test_corrupt_rows_are_refused_or_left_out_and_named(run):
    write("rig.csv", LEVEL, "30.00,1.0,x\n30.0")
    assert "line 1502, Force (N): 'x' is not a number" in run("rig.csv", *COLUMN, error=DatasetError)
    repairs = json.loads(run("rig.csv", *COLUMN, "--accept", "corrupt", "--json"))["repairs"]
    assert repairs[0] == "line 1502, Force (N): 'x' is not a number"
    assert "the file was truncated here" in repairs[1]


@pytest.mark.parametrize(
    ("arguments", "error", "expected"),
    [
        (("--dwell", "1"), UnitError, "--dwell: '1' has no unit"),
        (("--levels", "2", "--isometric"), UnitError, "--levels '2' has no unit; write --levels '1, 2, 3 bar'"),
        (("--levels", "1, 2 bar, 3", "--isometric"), UnitError, "is not a list of pressures"),
        (("--levels", "1, 2 bar, 300 kPa", "--isometric"), UnitError, "'1, 2 bar, 300 kPa'"),
        (("--levels", "1,, 2 bar", "--isometric"), UnitError, "--levels '1,, 2 bar'"),
        (("--levels", "1 bra, 2 bra", "--isometric"), UnitError, "--levels: unknown unit 'bra'"),
        (("--column", "Druck"), UnitError, "--column 'Druck'"),
        (("--out", "points.txt"), DatasetError, "does not have the ending .csv or .nc"),
    ],
)
def test_options_that_cannot_be_read(arguments, error, expected, run):
    write("rig.csv", LEVEL)
    assert expected in run("rig.csv", *COLUMN, *arguments, error=error)


def test_a_shorter_dwell_is_suggested(run):
    write("rig.csv", LEVEL)
    error = run("rig.csv", *COLUMN, "--dwell", "10 s", error=RangeError)
    assert "--dwell '5 s'" in error


def test_files_at_several_lengths_are_read_with_the_lengths_in_their_names(run):
    for length, gain in ((200, 1.0), (190, 0.6)):
        write(f"L{length}mm.csv", RAMP, gain=gain)
    given = ("L200mm.csv", "L190mm.csv", "--isometric", "--levels", "1, 2, 3 bar", "--initial-length", "200 mm")
    Path("name.yaml").write_text("from_name: L{length_mm}\n")
    run(*given, "--read", "name.yaml", "--save-recipe", "how.yaml")
    assert "from_name" in Path("how.yaml").read_text(encoding="utf-8")
    run(*given, "--read", "how.yaml", "--out", "points.csv")
    table = read_dataset("points.csv").table
    np.testing.assert_allclose(np.unique(table["contraction"]), [0.0, 0.05], atol=1e-12)
    assert set(table["repeat"].values) == {0}
    run(*given, error=RangeError)
    Path("name.yaml").write_text("from_name: M{length_mm}\n")
    run(*given, "--read", "name.yaml", error=DatasetError)


def test_one_contraction_holds_for_all_files(run):
    write("a.csv", RAMP)
    Path("b.csv").write_text(
        "Time (s),Druck [bar],Force (N)\n"
        + "".join(f"{t:.2f},{p:.3f},{15 * p:.2f}\n" for t, p in zip(TIME, RAMP, strict=True)),
        encoding="utf-8",
    )
    read = read_recording(["a.csv", "b.csv"], columns={"Druck [bar]": "pressure_bar"})
    assert len(read.isometric(contraction=0.1).dataset)
    with pytest.raises(RangeError):
        read.isometric(contraction="10 %")


def test_strokes_have_the_tolerance_of_python(run):
    time = np.arange(0, 40, 0.02)
    travel = 10 * np.abs((time / 10) % 2 - 1)
    pressure = 2 + 0.05 * np.sin(time)
    rows = [f"{t:.2f},{p:.4f},{x:.3f},{100 - 5 * x:.2f}\n" for t, p, x in zip(time, pressure, travel, strict=True)]
    Path("strokes.csv").write_text("time_s,pressure_bar,contraction_percent,force_N\n" + "".join(rows))
    found = json.loads(run("strokes.csv", "--strokes", "--json"))
    assert found["samples"] == dict(read_recording("strokes.csv").strokes().counts)
    assert not found["notes"]
    text = run("strokes.csv", "--strokes", "--pressure-tolerance", "1 kPa", error=RangeError)
    assert "varies by more than 1 kPa" in text
