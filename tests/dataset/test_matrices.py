# ruff: noqa: E501 - tables of cases
"""Matrices: a row per pressure, a column per contraction, forces as cells, or the other way."""

import io

import numpy as np
import openpyxl
import pytest

from mckibben.dataset import Recipe, read_dataset
from mckibben.errors import ScenarioError

from .conftest import C, F, P, are_the_points, problems_of

PRESSURES, CONTRACTIONS = np.unique(P), np.unique(C)
FORCES = F.reshape(3, 6)
ROWS, ACROSS = "pressure_bar,contraction_percent,force_N", "contraction_percent,pressure_bar,force_N"


def grid(corner="p [bar]\\eps [%]", above="{:g}", turned=False, sep=";", decimal=".") -> str:
    rows, columns, forces = (CONTRACTIONS, PRESSURES, FORCES.T) if turned else (PRESSURES, CONTRACTIONS, FORCES)
    lines = [[corner, *map(above.format, columns)]]
    lines += [[f"{x:g}" for x in (row, *cells)] for row, cells in zip(rows, forces, strict=True)]
    return "\n".join(sep.join(line).replace(".", decimal) for line in lines) + "\n"


def workbook(text: str) -> bytes:
    book = openpyxl.Workbook()
    for line in text.splitlines():
        book.active.append(
            [
                float(cell.replace(",", ".")) if cell[:1].isdigit() and " " not in cell else cell
                for cell in line.split(";")
            ]
        )
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


MATRICES = {
    "pressures down": (grid(), ROWS),
    "pressures across": (grid("eps [%]", turned=True), ACROSS),
    "empty corner": (grid(""), ROWS),
    "no corner": (grid().partition(";")[2], ROWS),
    "a title": ("Force [N] of muscle A\n\n" + grid(), ROWS),
    "a row of units": (grid().replace("\n", "\nbar;N;N;N;N;N;N\n", 1), ROWS),
    "units in the header": (grid("eps [%]", "{:g} bar", turned=True), ACROSS),
    "names in the header": (grid("eps [%]", "F at {:g} bar [N]", turned=True), ACROSS),
    "German": (grid("Kontraktion [%]", "{:.2f} bar", turned=True, decimal=","), ACROSS),
    "commas": (grid(sep=","), ROWS),
    "blanks": (grid("p\\eps", sep="  "), ROWS),
    "names of both axes": (";;eps [%];;;;;\n" + "\n".join(f"{'p [bar]' * (at == 1)};{line}" for at, line in enumerate(grid("").splitlines())) + "\n", ROWS),
    "units at the rows": ("\n".join(line.replace(";", " bar;", at > 0) for at, line in enumerate(grid("F [N]", "{:g} %").splitlines())), ROWS),
    "a footnote": (grid() + "measured on 12 March\n", ROWS),
}  # fmt: skip


@pytest.mark.parametrize("case", MATRICES)
@pytest.mark.parametrize("ending", ["csv", "xlsx"])
def test_a_matrix_is_read_with_one_key_that_the_question_names(case, ending, put):
    text, key = MATRICES[case]
    content = workbook(text) if ending == "xlsx" and case not in ("blanks", "commas", "no corner") else text
    path = put(content, f"rig.{ending}")
    assert any("--read 'matrix=" in problem for problem in problems_of(path))
    are_the_points(read_dataset(path, matrix=key))


@pytest.mark.parametrize(
    ("text", "key", "answer"),
    [
        (grid(), ROWS.replace("bar", "MPa"), "accept=words"),
        (grid("", "{:g} bar", turned=True), ACROSS.replace("bar", "kPa"), "contradicts its header"),
        ("tare 15 N\n" + grid(), ROWS, "'tare 15 N'"),
        ("F in kgf\n" + grid(), ROWS, "--column 'cells=force_kgf'"),
        (grid() + "\n" + grid(""), ROWS, "save each matrix by itself"),
        (grid() + "\n" + grid("Muscle 2"), ROWS, "differ by more than a number"),
        (grid("", "{:g} bar", turned=True).replace("4.02 bar", "58 psi"), ACROSS, "differ by more than a number"),
        (grid() + "mean;1;2;3;4;5;6\n", ROWS, "save each matrix by itself"),
        (grid().replace(";1286", ";?"), ROWS, "'?' is not a number"),
        ("Pressure [bar];Contraction [%];Force [N]\n2;0;1286\n3;0;1929\n", ROWS, "has no matrix"),
        ("\n".join(f"{line};;{line}" for line in grid().splitlines()), ROWS, "has no matrix"),
        (grid(), "pressure_bar,displacement_mm,force_N", "--column 'columns=WAY_mm'"),
    ],
)  # fmt: skip
def test_a_matrix_that_is_not_plain_is_a_question(text, key, answer, put):
    assert any(answer in problem for problem in problems_of(put(text), matrix=key, initial_length=0.2))


def test_an_empty_cell_is_no_point_and_other_quantities_are_named(put):
    path = put(grid("", "{:g}").replace(";1286", ";"))
    assert len(read_dataset(path, matrix=ROWS)) == len(P) - 1
    are_the_points(
        read_dataset(
            put(grid("p").replace("2.5;5;7.5;10;12.5", "5;10;15;20;25")),
            matrix=["pressure_bar", "shortening_mm", "force_N"],
            initial_length=0.2,
        )
    )


def test_a_matrix_has_three_quantities():
    assert Recipe(matrix="pressure_bar, contraction_percent, force_N").matrix[1] == "contraction_percent"
    with pytest.raises(ScenarioError, match="rows, columns and cells"):
        Recipe(matrix="pressure_bar, force_N")


@pytest.mark.parametrize("across", ["loads", "pressures"])
def test_loads_that_hang_while_the_pressure_rises_and_falls_are_passes_of_each_load(across, tmp_path):
    """Whichever way the table is turned: a load stays, and its pressures follow each other."""
    pressures, loads = np.array([2.0, 3, 4, 5, 6, 5, 4, 3, 2]), np.array([3.0, 5, 8, 11])
    side = np.where(np.arange(9) < 5, -1.0, 1.0)
    cells = 75 - 3 * loads - 60 / pressures[:, None] - 0.8 * side[:, None]
    rows, columns, cells = (pressures, loads, cells) if across == "loads" else (loads, pressures, cells.T)
    np.savetxt(
        tmp_path / "m.csv",
        np.column_stack([rows, cells]),
        "%.3f",
        ",",
        header=",".join(map(str, ("", *columns))),
        comments="",
    )
    names = ("pressure_bar", "mass_kg")[:: 1 if across == "loads" else -1]
    data = read_dataset(tmp_path / "m.csv", matrix=[*names, "shortening_mm"], initial_length=0.2)
    found = data.table["direction"].to_numpy().reshape(4, 9)
    assert (found[:, 1:5] == "unloading").all() and (found[:, 5:] == "loading").all()
