"""A result declares; texts, JSON, notebook, NetCDF, files and the exit code follow."""

import dataclasses
import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from mckibben.cli.command import command
from mckibben.errors import FileError
from mckibben.result import Column, Listing, Remark, Result, Severity, column, number, table
from mckibben.storage.store import STUDY


class Swing(Result):
    """Angles of a pendulum."""

    files = ("angles.csv",)

    time: np.ndarray = column("s", "time", "ms")
    angle: np.ndarray = column("rad", "angle of the pendulum", "deg")
    mass: float = column("kg", "mass")
    modes: np.ndarray = column("rad", "modes", dims=("row", "mode"))
    label: str = column(title="label", default="<b>")
    private: object = None
    severe: bool = False

    def verdict(self):
        return f"swings by {np.ptp(self.angle):.2g} rad"

    def remarks(self):
        yield Remark.note("mass", "the mass is an estimate")
        yield Remark.warning("angle", "few samples", remedy="take more")
        if self.severe:
            yield Remark.severe("angle", "the pendulum falls")

    @property
    @number("J", "energy")
    def energy(self):
        return None if self.severe else 1.5

    @table("Samples by hand", detail=True)
    def samples(self):
        return {"law": (Column(), ["Chou", "Lei"])}

    @table("Nothing")
    def nothing(self):
        return {}

    def write(self, folder):
        (folder / "angles.csv").write_text("angle\n")


@pytest.fixture
def swing():
    return Swing(np.array([0.0, 0.5]), np.radians([0.0, 90.0]), 2.0, np.ones((2, 3)))


def test_the_text_begins_with_the_verdict_and_has_shown_units(swing):
    lines = swing.to_text().splitlines()
    assert lines[0] == swing.verdict()
    assert lines[1].startswith("warning: few samples; take more")
    assert "the mass is an estimate" not in swing.to_text()
    assert lines[-3].split() == ["500", "90"]  # ms and deg
    assert "Chou" not in swing.to_text()


def test_a_number_of_a_property_is_a_scalar_unless_it_is_none(swing):
    assert swing.to_dict()["scalars"]["energy"] == {"title": "energy", "unit": "J", "value": 1.5}
    assert "energy" not in dataclasses.replace(swing, severe=True).to_dict()["scalars"]
    assert [listing.title for listing in swing.listings()] == ["", "", "Samples by hand"]


def test_details_add_notes_and_further_tables(swing):
    text = swing.to_text(details=True)
    assert "the mass is an estimate" in text
    assert "Chou" in text


@pytest.mark.parametrize("width", [30, 50, 80, 200])
def test_no_line_is_longer_than_the_terminal_and_nothing_is_lost(width):
    sentence = "the pressure of the second muscle is at the supply for most of the run"
    listing = Listing(
        "",
        {
            "law": (Column(title="force law"), ["ExponentialLaw", "ChouLaw"]),
            **{f"x{i}": (Column("N", f"residual of block {i}"), [1.5, -200000.0]) for i in range(8)},
            "remark": (Column(title="remark"), [sentence, "-"]),
        },
    )
    text = listing.to_text(width)
    assert max(map(len, text.splitlines())) <= width
    assert set(sentence.split()) <= set(text.split())
    assert text.split().count("1.5") == 8
    heading = f"share of {sentence}"
    scalars = {"share": (Column("1", heading), [0.1234]), "sum": (Column("N*m/rad", "sum"), [123.4])}
    text = Listing("", scalars, vertical=True).to_text(width)
    assert max(map(len, text.splitlines())) <= width
    assert {"0.1234", "N*m/rad", *heading.split()} <= set(text.split())


def test_a_long_table_says_how_much_it_leaves_out():
    listing = Listing("", {"x": (Column(), list(range(1000)))})
    assert "970 rows" in listing.to_text()
    assert len(listing.to_dict()["columns"]["x"]["values"]) == 1000


def test_the_plain_data_are_json_in_si(swing):
    data = json.loads(json.dumps(swing.to_dict()))
    assert data["columns"]["angle"]["values"][1] == pytest.approx(np.pi / 2)
    assert data["columns"]["angle"]["unit"] == "rad"
    assert data["scalars"]["mass"]["value"] == 2.0
    assert "private" not in data["scalars"]
    assert [remark["severity"] for remark in data["remarks"]] == ["warning", "note"]
    assert data["tables"][0]["columns"]["law"]["values"] == ["Chou", "Lei"]


def test_a_notebook_shows_escaped_text(swing):
    assert "&lt;b&gt;" in swing._repr_html_()
    assert "<b>" not in swing._repr_html_()


def test_the_dataset_keeps_axes_and_units(swing):
    dataset = swing.to_dataset()
    assert dataset["modes"].dims == ("row", "mode")
    assert dataset["angle"].attrs["units"] == "rad"


def test_a_result_is_ok_unless_a_remark_is_severe(swing):
    assert swing.ok
    falling = Swing(swing.time, swing.angle, 2.0, swing.modes, severe=True)
    assert not falling.ok
    assert [r["severity"] for r in falling.to_dict()["remarks"]] == [s.value for s in Severity]


def test_existing_files_are_kept_unless_forced(swing, tmp_path):
    assert swing.save(tmp_path) == ["results.json", "angles.csv"]
    with pytest.raises(FileError) as caught:
        swing.save(tmp_path)
    assert caught.value.problems[0].field == "results.json, angles.csv"
    swing.save(tmp_path, force=True)


class Parts(Result):
    """Files that the object knows."""


def parts(*names):
    return Parts().with_files({name: lambda path: path.write_text("new") for name in names})


def test_force_leaves_what_this_run_wrote_and_what_others_did(tmp_path):
    first = parts("fit.yaml", "fits/a.yaml", "fits/b.yaml", "more/c.yaml")
    listed = first.save(tmp_path)
    assert json.loads((tmp_path / "results.json").read_text())["files"] == listed
    (tmp_path / "fits" / "mine.yaml").write_text("mine")
    (tmp_path / "ranking.png").write_text("mine")
    assert parts("fit.yaml", "ranking.yaml").save(tmp_path, force=True) == ["results.json", "fit.yaml", "ranking.yaml"]
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert left == {"results.json", "fit.yaml", "ranking.yaml", "fits/mine.yaml", "ranking.png"}
    assert not (tmp_path / "more").exists()


def test_a_file_that_stays_is_not_listed_as_written(tmp_path):
    silent = Parts().with_files({"muscle.yaml": lambda path: None})
    (tmp_path / "muscle.yaml").write_text("mine")
    assert silent.save(tmp_path, force=True) == ["results.json"]
    parts("fit.yaml").save(tmp_path, force=True)
    assert (tmp_path / "muscle.yaml").read_text() == "mine"


@pytest.mark.parametrize(
    "content",
    [
        '{"files": ["../precious", "/PRECIOUS", "link/precious", "", ".", 5, null, "a\\u0000b"]}',
        "[1]",
        "{",
        '{"files": 5}',
    ],
)
def test_a_foreign_list_removes_nothing_outside_of_the_folder(tmp_path, content):
    precious, folder = tmp_path / "precious", tmp_path / "kept"
    precious.write_text("mine")
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    (folder / "results.json").write_text(content.replace("/PRECIOUS", str(precious)))
    parts("fit.yaml").save(folder, force=True)
    assert precious.read_text() == "mine" and (folder / "fit.yaml").is_file()


@pytest.fixture
def run(swing):
    app = typer.Typer(pretty_exceptions_enable=False)

    @app.command()
    @command
    def swinging(falls: bool = False, progress=None) -> "Swing":
        if progress:
            progress("halfway", 0.5)
        return Swing(swing.time, swing.angle, 2.0, swing.modes, severe=falls)

    return lambda *arguments: CliRunner().invoke(app, list(arguments))


def test_a_command_prints_writes_and_sets_the_exit_code(run, tmp_path):
    assert run().output.startswith("swings by")
    assert run("--falls").exit_code == 1
    assert json.loads(run("--json").stdout)["ok"]
    assert run("--out", str(tmp_path)).exit_code == 0
    assert json.loads((tmp_path / "results.json").read_text())["result"] == "Swing"


def test_a_command_does_not_overwrite(run, tmp_path):
    run("--out", str(tmp_path))
    assert isinstance(run("--out", str(tmp_path)).exception, FileError)
    assert run("--out", str(tmp_path), "--force").exit_code == 0
    (tmp_path / STUDY).write_bytes(b"")
    assert isinstance(run("--out", str(tmp_path), "--force").exception, FileError)
