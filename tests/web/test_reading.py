"""Fields of the page of muscles by which a file is read."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("nicegui")

from mckibben.dataset import Recipe
from mckibben.errors import DatasetError
from mckibben.web import reading

LENGTHENING = {"initial_length": "220 mm", "displacement": "lengthening", "zero_length": "183 mm"}
SHORTENING = {"initial_length": "220 mm", "displacement": "shortening", "zero_length": "200 mm"}


def test_the_columns_that_were_read_are_cells_of_a_table(tmp_path):
    path = tmp_path / "rig.csv"
    lines = ("2;0;9;unloading;0", "2;10;5;loading;1", "3;0;13;unloading;2", "3;10;8;loading;3")
    path.write_text("\n".join(["Druck  [bar];Weg [mm];Kraft [N];Richtung;time [s]", *lines]), encoding="utf-8")
    fields = reading.ReadingFields(**SHORTENING, columns="Richtung = direction")
    rows, last = reading.rows_read(reading.read([path], fields).table.attrs["columns_read"])
    found = {row[0]: row[1:] for row in reversed(rows)}
    assert found["Druck  [bar]"] == ("pressure", "bar", "header", "2..3", "")
    assert found["Richtung"] == ("direction", "", "", "", "")
    assert found["Weg [mm]"][:4] == ("displacement", "mm", "header", "0..10")
    assert "220 mm" in found["Weg [mm]"][4]
    assert ("Weg [mm]", "contraction", "", "", "0.09091..0.1364", "") in rows
    assert last.startswith("4 rows")


def test_displacements_are_read_as_the_fields_say(tmp_path):
    lines = [
        f"{p};{0.1 * (3 - p) - 20 * p * (0.2 - e) / 0.2:.3f};{37 - 220 * e:.2f}"
        for p in (1, 2, 3)
        for e in np.arange(0, 0.2, 0.02)
    ]
    path = tmp_path / "weg.csv"
    path.write_text("\n".join(["Druck [bar];Kraft [N];Weg [mm]", *lines]), encoding="utf-8")
    fields = reading.ReadingFields(**LENGTHENING, negative=True)
    with pytest.raises(DatasetError) as caught:
        reading.read([path], reading.ReadingFields())
    assert {problem.field for problem in caught.value.problems} == {"Weg [mm]"}
    read = reading.read([path], fields)
    np.testing.assert_allclose(np.unique(read.contraction.round(4)), np.arange(0, 0.2, 0.02), atol=1e-4)
    assert read.force.max() > 0
    assert Recipe.parse(fields.recipe().dumps()) == fields.recipe()
    filled = reading.ReadingFields()
    whole = fields.recipe().dumps() + "columns: {Weg: displacement_mm}\nspecimen: mine\nsample_rate: 100 Hz\n"
    filled.take(Recipe.parse(whole))
    kept = {"columns": "Weg = displacement_mm", "specimen": "mine", "others": {"sample_rate": 100.0}}
    assert filled == dataclasses.replace(fields, **kept)
    assert filled.recipe() == Recipe.parse(whole)
    positive = Recipe(force_sign=1)
    filled.take(positive)
    assert filled.recipe() == positive
    filled.negative = True
    assert filled.recipe().force_sign == -1
    fields.clear()
    assert fields == reading.ReadingFields()


def test_the_files_of_a_test_give_their_pressures_by_name(tmp_path):
    paths = [tmp_path / f"data-m25_{p}bar.csv" for p in (1, 2, 3)]
    for p, path in enumerate(paths, start=1):
        rows = [f"{100 * p * (0.3 - e):.3f},{37 - 220 * e:.2f}" for e in np.arange(0, 0.2, 0.02)]
        path.write_text("\n".join(["force_N,displacement_mm", *rows]), encoding="utf-8")
    fields = reading.ReadingFields(**LENGTHENING, from_name="{pressure_bar}bar")
    assert reading.read(paths, fields).pressures.tolist() == [1e5, 2e5, 3e5]
    with pytest.raises(DatasetError) as caught:
        reading.read(paths, reading.ReadingFields(**LENGTHENING))
    (problem,) = caught.value.problems
    assert "no column for pressure" in problem.message and caught.value.source == "m25_1bar.csv"


def test_damaged_rows_are_left_out_if_asked(tmp_path):
    rows = [f"{p},{c},{100 * p * (1 - c / 25)}" for p in (1, 2, 3) for c in range(0, 20, 5)]
    rows[5] = "2,n/a,150"
    path = tmp_path / "rig.csv"
    path.write_text("\n".join(["pressure_bar,contraction_percent,force_N", *rows]), encoding="utf-8")
    with pytest.raises(DatasetError):
        reading.read([path], reading.ReadingFields())
    assert len(reading.read([path], reading.ReadingFields(skip=True))) == 11
