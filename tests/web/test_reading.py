"""How the page of muscles reads files: choices at columns, questions, and fields."""

import numpy as np
import pytest

pytest.importorskip("nicegui")

from mckibben.dataset import Recipe
from mckibben.errors import DatasetError, McKibbenError
from mckibben.web import reading
from mckibben.web.reading import ColumnChoice

LENGTHENING = "displacement: lengthening\nzero_length: 183 mm\n"


def test_columns_are_chosen_until_nothing_is_open(tmp_path):
    """The header of an absolute pressure, a displacement without a direction, and a force with the wrong sign."""
    path, rows = tmp_path / "data-steps.csv", []
    for p in (150, 250, 350, 450):
        rows += [f"{p};{280 * e:.1f};{-0.4 * (p - 100) * (1 - 3 * e):.2f};{e:.1f}" for e in np.arange(0, 0.25, 0.05)]
    path.write_text("\n".join(["Abs. pressure (kPa);Crosshead (mm);Force (N);Druck ist", *rows]), encoding="utf-8")
    fields = reading.ReadingFields()
    (table,), data, questions = reading.read([path], fields)
    assert data is None and table.head["Force (N)"][0] == -20
    choices = {header: ColumnChoice.of(header, table, fields.columns) for header in table.head}
    assert choices["Abs. pressure (kPa)"] == ColumnChoice("pressure", "kPa", absolute=True)
    assert choices["Crosshead (mm)"] == ColumnChoice("displacement", "mm")
    assert {"Abs. pressure (kPa)", "Crosshead (mm)", "Druck ist"} <= {question.problem.field for question in questions}
    fields.ambient, fields.initial_length = "100 kPa", "280 mm"
    fields.columns |= {"Crosshead (mm)": choices["Crosshead (mm)"].changed(quantity="shortening").name}
    fields.columns |= {"Druck ist": ColumnChoice("").name}
    (table,), data, questions = reading.read([path], fields)
    assert data is None and [question.problem.field for question in questions] == ["force"]
    force = ColumnChoice.of("Force (N)", table, fields.columns)
    fields.columns["Force (N)"] = force.changed(turned=True).name
    (table,), data, questions = reading.read([path], fields)
    assert data.pressures.tolist() == [5e4, 15e4, 25e4, 35e4] and not questions
    assert ColumnChoice.of("Force (N)", table, fields.columns).turned
    assert ColumnChoice.of("Druck ist", table, fields.columns).quantity == ""


def test_a_file_without_names_is_chosen_column_by_column_and_no_unit_is_guessed(tmp_path):
    rows = "".join(f"{p},{100 * e:.0f},{100 * p * (1 - 3 * e):.2f}\n" for p in (1, 2) for e in (0, 0.1, 0.2))
    for header, names in (("ch1,ch2,ch3\n", ["ch1", "ch2", "ch3"]), ("", ["1", "2", "3"])):
        path, fields = tmp_path / "data-x.csv", reading.ReadingFields()
        path.write_text(header + rows, encoding="utf-8")
        (table,), data, questions = reading.read([path], fields)
        assert data is None and questions and len(table.head) == 3 and not table.columns
        fields.columns = dict(zip(names, ("pressure_bar", "contraction_percent", "force_N"), strict=True))
        assert reading.read([path], fields).data.force.max() == 200
    assert ColumnChoice("pressure", "bar").changed(quantity="force").name == "force"  # the page asks for the unit


def test_the_files_of_a_test_give_their_pressures_by_name(tmp_path):
    paths = [tmp_path / f"data-m25_{p}bar.csv" for p in (1, 2, 3)]
    for p, path in enumerate(paths, start=1):
        rows = [f"{100 * p * (0.3 - e):.3f},{37 - 220 * e:.2f}" for e in np.arange(0, 0.2, 0.02)]
        path.write_text("\n".join(["force_N,displacement_mm", *rows]), encoding="utf-8")
    fields = reading.ReadingFields("220 mm", further=LENGTHENING + "from_name: '{pressure_bar}bar'")
    found = reading.read(paths, fields)
    assert found.data.pressures.tolist() == [1e5, 2e5, 3e5] and len(found.tables) == 3
    paths[0].write_text("nothing", encoding="utf-8")
    with pytest.raises(DatasetError) as caught:
        reading.read(paths, fields)
    assert caught.value.source == "m25_1bar.csv"


def test_a_recipe_fills_the_fields_that_give_it():
    text = LENGTHENING + "initial_length: 220 mm\nambient: 101.3 kPa\ncolumns: {Weg: displacement_mm}\n"
    recipe, fields = Recipe.parse(text + "sample_rate: 100 Hz\naccept: [corrupt]\n"), reading.ReadingFields()
    fields.take(recipe)
    assert (fields.initial_length, fields.ambient, fields.columns) == (
        "220 mm",
        "101.3 kPa",
        {"Weg": "displacement_mm"},
    )
    assert "sample_rate: 100 Hz" in fields.further and "initial_length" not in fields.further
    assert fields.recipe() == recipe
    fields.take(Recipe())
    assert fields == reading.ReadingFields()


@pytest.mark.parametrize(
    ("fields", "named"), [({"further": "displacment: lengthening"}, "displacment"), ({"ambient": "1 N"}, "ambient")]
)
def test_a_wrong_field_is_named(fields, named):
    with pytest.raises(McKibbenError) as caught:
        reading.ReadingFields(**fields).recipe()
    assert named in str(caught.value)
