"""Files that contradict themselves, or an option: an error or a warning, never a wrong number in silence."""

import warnings

import numpy as np
import pytest

from mckibben.dataset import read_dataset
from mckibben.errors import DatasetError, McKibbenWarning

ROWS = "".join(f"{p},{f},{c}\n" for p, f, c in ((2, 100, 0), (2, 80, 4), (3, 160, 0), (3, 130, 4), (4, 220, 0)))


@pytest.fixture
def put(tmp_path):
    def write(text):
        path = tmp_path / "rig.csv"
        path.write_text(text)
        return path

    return write


def refused(path, **options):
    """Fields of the problems of a file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(DatasetError) as caught:
            read_dataset(path, **options)
    return [problem.field or problem.line for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("units", "field"),
    [("bar abs,N,%", "pressure_bar"), ("psia,N,%", "pressure_bar"), ("bar,kg,%", "force_N"), ("bar,dN,%", "force_N")],
)
def test_a_row_of_units_that_contradicts_the_header_is_refused(put, units, field):
    assert refused(put(f"pressure_bar,force_N,contraction_percent\n{units}\n{ROWS}")) == [field]


@pytest.mark.parametrize("header", ["p [psia]", "p [bar(a)]", "p (kPa abs)"])
def test_an_absolute_pressure_is_refused_even_if_it_is_assigned(put, header):
    path = put(f"{header},force_N,contraction_percent\n{ROWS}")
    assert refused(path, columns={header: "pressure_bar"}) == [header]


@pytest.mark.parametrize("header", ["Absolute pressure [bar]", "p_abs_bar"])
def test_a_name_that_may_mean_an_absolute_pressure_is_a_warning(put, header):
    path = put(f"{header},force_N,contraction_percent\n{ROWS}")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert read_dataset(path, columns={header: "pressure_bar"}).pressure[0] == 2e5
    assert any("absolute" in str(one.message) for one in said)


@pytest.mark.parametrize("header", ["F [10 N]", "force [kg]", "Effort (daN)", "force (x10 N)"])
def test_a_unit_in_the_name_that_contradicts_the_assigned_one_is_a_warning(put, header):
    path = put(f"pressure_bar,{header},contraction_percent\n{ROWS}")
    with pytest.warns(McKibbenWarning, match="its name says"):
        read_dataset(path, columns={header: "force_N"})


def test_words_in_brackets_are_no_unit(put):
    path = put(f"pressure_bar,Load cell (left),contraction_percent\n{ROWS}")
    assert read_dataset(path, columns={"Load cell (left)": "force_N"}).force[0] == 100


def test_one_of_two_columns_of_a_name_is_chosen_by_its_position(put):
    rows = "".join(f"{p},{f / 2},{f},{c}\n" for p, f, c in np.loadtxt(ROWS.splitlines(), delimiter=","))
    path = put(f"pressure_bar,Force [N],Force [N],contraction_percent\n{rows}")
    assert refused(path) == ["Force [N]"]
    assert [read_dataset(path, columns={place: "force_N"}).force[0] for place in "23"] == [50, 100]


def test_a_constant_length_gives_way_to_a_displacement(put):
    rows = "".join(f"{p};{f};180;{c}\n" for p, f, c in np.loadtxt(ROWS.splitlines(), delimiter=","))
    path = put(f"pressure_bar;force_N;Länge [mm];Hub [mm]\n{rows}")
    with pytest.warns(McKibbenWarning, match="constant"):
        data = read_dataset(path, initial_length=0.18, displacement="shortening")
    assert data.contraction.max() == pytest.approx(4 / 180)


@pytest.mark.parametrize("other", ["pressure_bar,force_kgf,contraction_percent", "kPa,N,%", "bar,kN,%"])
def test_another_header_within_a_file_is_refused(put, other):
    path = put(f"pressure_bar,force_N,contraction_percent\n{ROWS}{other}\n{ROWS}")
    assert refused(path, on_corrupt="report") == [7]


def test_rows_of_dashes_are_left_out_and_repeated_headers_with_units_passed_over(put):
    head = "pressure,force,contraction\nbar,N,%\n"
    with pytest.warns(McKibbenWarning, match="1 of 7 rows"):
        data = read_dataset(put(f"{head}{ROWS}-,-,-\n{head}5,300,0\n"), on_corrupt="report")
    assert len(data) == 6


def test_a_last_row_of_words_is_left_out_with_and_without_empty_cells(put):
    for end in ("Ende der Messung", "Ende der Messung,,"):
        with pytest.warns(McKibbenWarning, match="left out"):
            data = read_dataset(put(f"pressure_bar,force_N,contraction_percent\n{ROWS}{end}\n"))
        assert len(data) == 5


def test_sheets_with_times_of_their_own_are_not_read_row_by_row(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    loads, pressures = book.active, book.create_sheet("Pressure log")
    loads.append(["time [s]", "force [N]", "contraction [%]"])
    pressures.append(["time [s]", "pressure [bar]"])
    for i, (p, f, c) in enumerate(np.loadtxt(ROWS.splitlines(), delimiter=",").tolist()):
        loads.append([i, f, c])
        pressures.append([2 * i, p])
    book.save(tmp_path / "two.xlsx")
    with pytest.raises(DatasetError) as caught:
        read_dataset(tmp_path / "two.xlsx")
    assert any("time" in problem.message for problem in caught.value.problems)


def test_a_temperature_that_moves_is_a_warning(put):
    lines = ROWS.splitlines()
    for rise, unit, warned in ((0.5, "degC", 0), (2.0, "degC", 1), (2.0, "F", 0), (2.0, "mV", 0)):
        rows = "".join(f"{line},{20 + rise * i}\n" for i, line in enumerate(lines))
        path = put(f"pressure_bar,force_N,contraction_%,temperature_{unit}\n{rows}")
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            read_dataset(path)
        assert sum("temperature" in str(one.message) and "drifts" in str(one.message) for one in heard) == warned


def muscle(pressure, contraction):
    """Force [N] of a muscle at a pressure [bar] and a contraction [%]."""
    return 60 * pressure * (1 - contraction / 28) ** 2


GRID = [(p, c) for p in (1.0, 2.0, 3.0, 4.0) for c in (0.0, 3.0, 6.0, 9.0, 12.0, 15.0)]


def told(put, change):
    """Warnings of a file whose rows (pressure, contraction, force) a function has changed."""
    rows = np.array([(p, c, muscle(p, c)) for p, c in GRID])
    change(rows)
    table = "".join(f"{p:g},{c:g},{f:.2f}\n" for p, c, f in rows)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        read_dataset(put(f"pressure_bar,contraction_percent,force_N\n{table}"))
    return [str(one.message) for one in said]


def test_sound_points_are_not_reported(put):
    assert told(put, lambda rows: None) == []


def offset(rows):
    rows[:, 2] += 50


def later_in_kilonewtons(rows):
    rows[12:, 2] /= 1000


def stuck_pressure(rows):
    rows[:, 0] = 2


def lost_length(rows):
    rows[10, 1] = 0


def end_of_the_length_sensor(rows):
    rows[:, 1] = np.minimum(rows[:, 1], 7)


def saturated(rows):
    rows[:, 2] = np.minimum(rows[:, 2], 120 + 0.1 * np.arange(len(rows)))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (offset, "force"),
        (later_in_kilonewtons, "force"),
        (stuck_pressure, "force"),
        (lost_length, "contraction"),
        (end_of_the_length_sensor, "contraction"),
        (saturated, "force"),
    ],
)
def test_a_sensor_that_fails_is_reported(put, change, field):
    assert any(f": {field}: " in one for one in told(put, change))


@pytest.mark.parametrize("line", ["# amplifier gain: 10", "# multiply the forces by 2", "% uncalibrated", "# U/10*500"])
def test_a_comment_on_a_scale_is_reported(put, line):
    with pytest.warns(McKibbenWarning, match="line 1"):
        read_dataset(put(f"{line}\npressure_bar,force_N,contraction_percent\n{ROWS}"))


@pytest.mark.parametrize("line", ["# hose 12x2", "# hose 12 mm x 2 mm", "# muscle 10 × 180 mm"])
def test_a_size_in_a_comment_is_no_scale(put, line):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        read_dataset(put(f"{line}\npressure_bar,force_N,contraction_percent\n{ROWS}"))
    assert not any("line 1" in str(one.message) for one in said)


@pytest.mark.parametrize(
    ("name", "pattern", "value"),
    [
        ("muscle-5percent.csv", "{contraction_percent}percent", 0.05),
        ("muscle_c-5percent.csv", "c{contraction_percent}percent", -0.05),
        ("at 2,5 percent.csv", "at {contraction_percent} percent", 0.025),
    ],
)
def test_numbers_in_the_name_of_a_file(tmp_path, name, pattern, value):
    (tmp_path / name).write_text("pressure_bar,force_N\n1,50\n2,100\n3,150\n", encoding="utf-8")
    assert read_dataset(tmp_path / name, from_name=pattern).contraction == pytest.approx(value)


def test_a_pattern_that_fits_in_several_places_is_refused(tmp_path):
    (tmp_path / "step3_p2.csv").write_text("contraction_percent,force_N\n0,100\n2,90\n4,80\n", encoding="utf-8")
    with pytest.raises(DatasetError):
        read_dataset(tmp_path / "step3_p2.csv", from_name="p{pressure_bar}")
    assert read_dataset(tmp_path / "step3_p2.csv", from_name="_p{pressure_bar}").pressure == pytest.approx(2e5)
