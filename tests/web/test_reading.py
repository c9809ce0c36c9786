"""Fields of the page of muscles by which a file is read."""

import numpy as np
import pytest

pytest.importorskip("nicegui")

from mckibben.dataset import Recipe
from mckibben.errors import DatasetError, McKibbenError
from mckibben.web import reading

LENGTHENING = "displacement: lengthening\nzero_length: 183 mm\n"
SHORTENING = "displacement: shortening\nzero_length: 200 mm\n"
LENGTH = "220 mm"


def test_the_columns_that_were_read_are_cells_of_a_table(tmp_path):
    path = tmp_path / "rig.csv"
    lines = ("2;0;9;unloading;0", "2;10;5;loading;1", "3;0;13;unloading;2", "3;10;8;loading;3")
    path.write_text("\n".join(["Druck  [bar];Weg [mm];Kraft [N];Richtung;time [s]", *lines]), encoding="utf-8")
    fields = reading.ReadingFields(LENGTH, columns="Richtung = direction", further=SHORTENING)
    rows = reading.understood(reading.read([path], fields))
    found = {row[0]: row[1:] for row in reversed(rows)}
    assert found["Druck  [bar]"] == ("pressure", "bar", "header", "2..3", "")
    assert found["Richtung"] == ("direction", "", "", "", "")
    assert found["Weg [mm]"][:4] == ("displacement", "mm", "header", "0..10")
    assert "220 mm" in found["Weg [mm]"][4]
    assert "contraction" not in [row[1] for row in rows]


def test_the_files_of_a_test_give_their_pressures_by_name(tmp_path):
    paths = [tmp_path / f"data-m25_{p}bar.csv" for p in (1, 2, 3)]
    for p, path in enumerate(paths, start=1):
        rows = [f"{100 * p * (0.3 - e):.3f},{37 - 220 * e:.2f}" for e in np.arange(0, 0.2, 0.02)]
        path.write_text("\n".join(["force_N,displacement_mm", *rows]), encoding="utf-8")
    fields = reading.ReadingFields(LENGTH, further=LENGTHENING + "from_name: '{pressure_bar}bar'")
    data = reading.read(paths, fields)
    assert data.pressures.tolist() == [1e5, 2e5, 3e5]
    rows = reading.understood(data)
    assert [row[1] for row in rows].count("force") == 1 and not any(row[4] for row in rows)
    with pytest.raises(DatasetError) as caught:
        reading.read(paths, reading.ReadingFields(LENGTH, further=LENGTHENING))
    (problem,) = caught.value.problems
    assert "no column for pressure" in problem.message and caught.value.source == "m25_1bar.csv"


def test_a_recipe_fills_the_fields_that_give_it():
    text = LENGTHENING + "initial_length: 220 mm\nambient: 101.3 kPa\ncolumns: {Weg: displacement_mm}\n"
    recipe, fields = Recipe.parse(text + "sample_rate: 100 Hz\naccept: [corrupt]\n"), reading.ReadingFields()
    fields.take(recipe)
    assert (fields.initial_length, fields.ambient, fields.columns) == ("220 mm", "101.3 kPa", "Weg = displacement_mm")
    assert "sample_rate: 100 Hz" in fields.further and "initial_length" not in fields.further
    assert fields.recipe() == recipe
    fields.take(Recipe())
    assert fields == reading.ReadingFields()


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"further": "displacment: lengthening"}, "displacment"),
        ({"ambient": "1 N"}, "ambient"),
        ({"columns": "Weg"}, "columns, line 1"),
    ],
)
def test_a_wrong_field_is_named(fields, named):
    with pytest.raises(McKibbenError) as caught:
        reading.ReadingFields(**fields).recipe()
    assert named in str(caught.value)
