# ruff: noqa: E501 - tables of cases
"""Questions of a reader, and the options that answer them."""

import gzip
import io
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mckibben.dataset import TOPICS, IsobaricDataset, Recipe, read_columns, read_dataset, read_recording
from mckibben.dataset.vocabulary import parse_header
from mckibben.dataset.words import doubtful_words
from mckibben.errors import DatasetError, RangeError, ScenarioError

from .conftest import C, F, P, are_the_points, problems_of, table

HEADER = "Pressure [bar];Contraction [%];Force [N]"


def archived() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("content.xml", "<a/>")
    return stream.getvalue()


@pytest.mark.parametrize(
    ("header", "quantity", "unit"),
    [
        ("pressure_bar", "pressure", "bar"), ("Druck ist [kPa]", "pressure", "kPa"), ("Überdruck in mbar", "pressure", "mbar"),
        ("P (psi)", "pressure", "psi"), ("Druck soll [bar]", "set_pressure", "bar"), ("p_soll_bar", "set_pressure", "bar"),
        ("F / N", "force", "N"), ("Zugkraft, kN", "force", "kN"), ("Force (gf)", "force", "gf"), ("load cell [mN]", "force", "mN"),
        ("Kraft [kg]", "force", "kgf"), ("CH3 Force - N", "force", "N"), ("weight_g", "set_force", "gf"), ("l / mm", "length", "mm"), ("101 <Force> (N)", "force", "N"),
        ("Contraction (%)", "contraction", "percent"), ("eps [-]", "contraction", "ratio"), ("Verkürzung [mm]", "shortening", "mm"),
        ("Weg [mm]", "displacement", "mm"), ("Muscle length [in]", "length", "in"), ("Zeit  1 - Standardmessrate [s]", "time", "s"),
        ("Model Root/Pressure [bar]/In1", "pressure", "bar"), ("millis", "time", "ms"), ("Pressure (bar) Ave", "pressure", "bar"),
        ("Istdruck [bar]", "pressure", "bar"), ("Kontraktion ε [%]", "contraction", "percent"), ("Pressure kPa(g)", "pressure", "kPa"), ("Force (N) - Channel 3", "force", "N"),
        ("torque_N_m", "torque", "N*m"), ("couple [N.m]", "torque", "N*m"), ("トルク（mNm）", "torque", "mN*m"), ("Torque (kgf·cm)", "torque", "kgf*cm"),
        ("压力 (kPa)", "pressure", "kPa"), ("荷重 [N]", "force", "N"), ("poids (kg)", "set_force", "kgf"), ("psig", "", "psi"), ("收缩率 (%)", "contraction", "percent"),
        ("PAM Pressure (kPa)", "pressure", "kPa"), ("McKibben force [N]", "force", "N"), ("Druck im Muskel [bar]", "pressure", "bar"), ("Presión [bar]", "pressure", "bar"), ("Forza [N]", "force", "N"),
        ("Längenänderung [mm]", "displacement", "mm"), ("Längenänderung [%]", "", "percent"), ("Contracción [%]", "contraction", "percent"), ("P1 [bar]", "pressure1", "bar"),
    ],
)  # fmt: skip
def test_headers_in_five_languages(header, quantity, unit):
    assert parse_header(header)[:2] == (quantity, unit)


@pytest.mark.parametrize(
    "header",
    (
        "T [K];f [Hz];Strain (%);contraction rate [%];Blocked force [N];Contraction rate (%/s);Dehnung [%];Relative length;Force max [N];Supply pressure [bar];Kanal 1;"
        "Force offset [N];pressure [mpa]"
    ).split(";"),
)
def test_headers_that_are_not_plain_are_not_read(header):
    parsed = parse_header(header)
    assert not (parsed.quantity in ("pressure", "force", "contraction") and parsed.unit)


@pytest.mark.parametrize(
    "text",
    (
        "Tare force 15 N;All pressures are absolute;Force gain | 2 | N/V;force unit: kgf;Kraft in daN;"
        "F_true = 9.81 x F;lengths include 60 mm of fittings;two muscles in parallel;hook and plate of 1.2 kg not included;"
        "Gewichte ohne Teller;Lasthaken 0,8 kg;pan 200 g;zzgl. Gehänge;Gewichtsteller nicht gewogen"
    ).split(";"),
)
def test_words_that_change_numbers_are_doubtful(text):
    assert list(doubtful_words([(3, text)], ["bar", "N", "percent"])) == [(3, text)]


@pytest.mark.parametrize(
    "text",
    (
        "Rig 3;Operator: A. B.;Sensor: U9C, 1 kN;units: bar, %, N;Date 12.03.2024;Versuch 7;Range 10 bar;Hersteller: Festo;Japan"
    ).split(";"),
)
def test_plain_words_are_not_doubtful(text):
    assert not list(doubtful_words([(1, text)], ["bar", "N", "percent"]))


QUESTIONS: dict[str, tuple[str, str, dict[str, object]]] = {  # text, words of the question, options that answer it
    "unknown header": (table("Kanal 1 [bar];Contraction [%];Force [N]"), "Kanal 1 [bar]", {"columns": {"Kanal 1 [bar]": "pressure_bar"}}),
    "no unit": (table("Druck;Contraction [%];Force [N]"), "--column 'Druck=pressure_UNIT'", {"columns": {"Druck": "pressure_bar"}}),
    "no header": (table(HEADER).partition("\n")[2], "has no header", {"columns": {"1": "pressure_bar", "2": "contraction_percent", "3": "force_N"}}),
    "two forces": (table(f"{HEADER};Force 2 [N]", P, C, F, 2 * F), "are both a force", {"columns": {"Force 2 [N]": "ignore"}}),
    "unit column": (table(f"{HEADER};Force unit", P, C, F / 9.80665, ["kgf"] * 18).replace("Force [N]", "Force"), "Force unit: is not understood", {"columns": {"Force": "force_kgf"}, "accept": ["columns"]}),
    "two contractions": (table(f"{HEADER};Length [mm]", P, C, F, 200 - 2 * C - (C == 5)), "contradicts the contraction", {"columns": {"Length [mm]": "ignore"}}),
    "peak force": (table(f"{HEADER};Force max [N]", P, C, F, 2 * F), "Force max [N]: is not understood", {"columns": {"Force max [N]": "ignore"}}),
    "strain": (table("Pressure [bar];Elongation (%);Force [N]"), "--column 'Elongation (%)=-lengthening_percent'", {"columns": {"Elongation (%)": "-lengthening_percent"}}),
    "absolute pressure": (table("Abs. pressure (bar);Contraction [%];Force [N]", P + 1.013, C, F), "--read 'ambient=101.3 kPa'", {"ambient": 101300.0}),
    "bar abs": (table("p [bar abs];Contraction [%];Force [N]", P + 1.013, C, F), "is an absolute pressure", {"ambient": 101300.0}),
    "lengths": (table("Pressure [bar];Length [mm];Force [N]", P, 200 - 2 * C, F), "--initial-length", {"initial_length": 0.2}),
    "displacements": (table("Pressure [bar];Weg [mm];Force [N]", P, 2 * C, F), "--column 'Weg [mm]=WAY_mm'", {"columns": {"Weg [mm]": "shortening_mm"}, "initial_length": 0.2}),
    "displacements from another zero": (
        table("Pressure [bar];Weg [mm];Force [N]", P, 50 - 2 * C, F), "shortening or lengthening",
        {"displacement": "lengthening", "initial_length": 0.2, "zero_length": 0.15},
    ),
    "negative pull": (table(HEADER, P, C, -F), "--column 'Force [N]=-force_N'", {"columns": {"Force [N]": "-force_N"}}),
    "corrupt cell": (table(HEADER).replace("\n3.01;5;", "\nx;1;2\n3.01;5;"), "'x' is not a number", {"accept": ["corrupt"]}),
    "short row": (table(HEADER).replace("\n3.01;5;", "\n3.01\n3.01;5;"), "has 1 cell, the header 3", {"accept": ["corrupt"]}),
    "words": ("# tare: 15 N\n" + table(HEADER), "'tare: 15 N'", {"accept": ["words"]}),
    "a unit in words": ("# forces in kgf\n" + table(HEADER, P, C, F / 9.80665), "--column 'Force [N]=force_kgf'", {"columns": {"Force [N]": "force_kgf"}, "accept": ["words"]}),
    "unread column": (table(f"{HEADER};valid", P, C, F, np.arange(18) % 2), "valid: is not understood", {"accept": ["columns"]}),
    "direction": (table(f"{HEADER};Direction", P, C, F, ["up"] * 18), "'up' is not a direction", {"columns": {"up": "unloading"}}),
}  # fmt: skip


@pytest.mark.parametrize("case", QUESTIONS)
def test_what_is_not_plain_is_a_question_with_its_answer(case, put):
    text, said, answer = QUESTIONS[case]
    path = put(text)
    problems = problems_of(path)
    assert any(said in problem for problem in problems)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        are_the_points(read_dataset(path, **answer))


@pytest.mark.parametrize(("decimal", "factor"), [(".", 1.0), (",", 1e3)])
def test_decimals_that_may_be_thousands(put, decimal, factor):
    forces = [f"{1 + f / 1e3:.3f}" for f in F]
    path = put(table(HEADER, np.round(P), np.round(C), forces).replace("[N]", "[kN]" if factor == 1 else "[N]"))
    (problem,) = problems_of(path)  # not each number that is none with the other sign
    assert "may be a decimal or a thousand" in problem
    data = read_dataset(path, decimal=decimal, accept=list(TOPICS))
    np.testing.assert_allclose(data.force, 1e3 + F, atol=0.51)


def test_megapascals_read_as_bars_are_a_question(put):
    path = put(table("Druck;Contraction [%];Force [N]", P / 10, C, F))
    problem = problems_of(path, columns={"Druck": "pressure_bar"})[0]
    assert problem.startswith("pressure") and "--column 'Druck=pressure_UNIT'" in problem
    are_the_points(read_dataset(path, columns={"Druck": "pressure_MPa"}))


@pytest.mark.parametrize(
    ("header", "name"),
    [("Force [N]", "force_kN"), ("Force [N]", "pressure_bar"), ("Abs. pressure [bar]", "pressure_bar")],
)
def test_a_column_named_against_its_header_is_a_question(put, header, name):
    path = put(table(HEADER.replace(f"{name.partition('_')[0].title()} [bar]", header), P, C, F))
    problem, *_ = problems_of(path, columns={header: name})
    assert problem.startswith(header) and "accept=words" in problem


def test_every_mistake_is_listed_with_its_line(put):
    text = table(HEADER).replace("3.01;5;", "a;5;").replace("4.02;0;", "4.02;0;b;").replace("2;2.5;", "c;2.5;")
    assert [problem.partition(":")[0] for problem in problems_of(put(text))] == [
        "line 3, Pressure [bar]",
        "line 10, Pressure [bar]",
        "line 14",
        "line 15, Pressure [bar]",
    ]


def test_a_table_shows_where_each_column_is_from(put):
    text = table("Druck;p abs [kPa];Contraction;Kraft [N];Raumtemperatur [°C]", P, 100 * P, C, F, 21 + 0 * P)
    columns = {
        "Druck": "pressure_bar",
        "p abs [kPa]": "ignore",
        "Contraction": "contraction_percent",
        "Kraft [N]": "-force_N",
    }
    understood = read_columns(put(text), columns=columns)
    lines = str(understood).splitlines()
    assert [line.split() for line in lines[:3]] == [
        ["column", "quantity", "unit", "unit", "from", "range"],
        ["Druck", "pressure", "bar", "columns", "2..4.02"],
        ["Contraction", "contraction", "percent", "columns", "0..12.5"],
    ]
    assert "sign reversed" in lines[3] and lines[4] == "18 rows"
    assert understood.ignored == ["p abs [kPa]", "Raumtemperatur [°C]"] and not understood.questions
    assert "Druck" in understood._repr_html_()


def test_accept_answers_only_its_topics(put):
    path = put("# gain 2\n" + table(f"{HEADER};valid", P, C, F, np.arange(18) % 2))
    assert len(problems_of(path)) == 2
    (problem,) = problems_of(path, accept=["words"])
    assert "--read accept=columns" in problem
    assert set(TOPICS) >= {"words", "columns", "corrupt", "saturation", "gauge"}
    with pytest.raises(ScenarioError, match=r"'nonsense' is none of words, layout"):
        read_dataset(path, accept=["nonsense"])


def test_corrupt_rows_that_are_left_out_are_kept_in_mind(put):
    data = read_dataset(put(table(HEADER).replace("\n3.01;5;", "\nx;1;2\n3.01;5;")), accept=["corrupt"])
    assert data.table.attrs["repairs"] == "line 10, Pressure [bar]: 'x' is not a number"
    assert data.place(8) == "line 11"
    text = HEADER + "\n" + "x;1;2\n" * 5 + "2;0;100\n" * 4
    assert any("5 of 9 rows would be left out" in problem for problem in problems_of(put(text), accept=["corrupt"]))


def test_options_of_a_file_are_a_recipe(put, tmp_path):
    recipe = Recipe(columns={"Druck [bar]": "pressure_bar"}, ambient=101300.0, accept=["words"], part="rig")
    recipe.to_yaml(tmp_path / "recipe.yaml")
    assert Recipe.read(tmp_path / "recipe.yaml") == recipe
    with pytest.raises(ScenarioError) as caught:
        Recipe.parse("inital_length: 20 mm\nlever: 2\nfrom_name: L\ndecimal: ;\n")
    assert len(caught.value.problems) == 4
    assert Recipe.parse("# nothing\n") == Recipe()


def test_a_number_in_the_name_of_a_file(put, tmp_path):
    paths = [
        put(table("Contraction [%];Force [N]", C[:6], F[P == level]), f"p{level:g}bar.csv")
        for level in (2.0, 3.01, 4.02)
    ]
    are_the_points(read_dataset(paths, from_name="p{pressure_bar}bar"))
    assert "does not match" in problems_of(paths[0], from_name="x{pressure_bar}")[0]


def test_files_of_one_test_are_joined(put):
    header = f"{HEADER};Repeat;Time [s]"
    part = [np.asarray(values) for values in (P, C, F, 0 * P, np.arange(18.0))]
    paths = [put(table(header, *part), f"{name}.csv") for name in "ab"]
    joined = read_dataset(paths, accept=["rows"])
    assert len(joined) == 36 and joined.repeats.tolist() == [0, 1]
    assert joined.place(20) == f"line 4 of {paths[1]}"
    assert np.all(np.diff(joined.table["time"]) > 0)
    other = put(table(HEADER), "c.csv")
    (problem,) = problems_of_several([paths[0], other])
    assert "not all files have repeat, time" in problem
    with pytest.raises(RangeError, match="not a file"):
        read_dataset([])


def problems_of_several(paths: list[Path]) -> list[str]:
    with pytest.raises(DatasetError) as caught:
        read_dataset(paths)
    return [str(problem) for problem in caught.value.problems]


def test_what_this_program_wrote_is_read_as_it_is(tmp_path):
    data = IsobaricDataset.of(pressure=P * 1e5, contraction=C / 100, force=F, specimen='of, "us"', initial_length=0.2)
    data.to_csv(tmp_path / "own.csv")
    data.to_netcdf(tmp_path / "own.nc")
    for name in ("own.csv", "own.nc"):
        read = read_dataset(tmp_path / name)
        np.testing.assert_array_equal(read.force, data.force)
        assert read.table.attrs["specimen"] == 'of, "us"' and read.table.attrs["initial_length"] == 0.2
    assert read_dataset(tmp_path / "own.nc", slack_force=3.0).table.attrs["slack_force"] == 3.0


def test_the_time_of_a_recording(put):
    header, time = "Time [s];Pressure [bar];Force [N]", np.arange(18) * 0.01
    path = put(table(header.partition(";")[2], P, F))
    assert any("sample_rate" in problem for problem in problems_of(path, read_recording))
    assert read_recording(path, sample_rate=100.0, contraction=0.1).time == pytest.approx(time)
    timed = put(table(header, time, P, F))
    assert read_recording(timed).contraction is None
    assert any("leave sample_rate out" in problem for problem in problems_of(timed, read_recording, sample_rate=100.0))
    unclear = put(table("Time;Pressure [bar];Force [N]", time, P, F))
    assert any("'Time' is not understood as a clock" in problem for problem in problems_of(unclear, read_recording))


@pytest.mark.parametrize(
    ("first", "last", "seconds"),
    [
        ("23:59:59.5", "00:00:00.5", 1.0),
        ("31.01.2024 23:59:59", "01.02.2024 00:00:01", 2.0),
        ("1/31/2024 11:59:59 PM", "2/1/2024 12:00:01 AM", 2.0),
        ("2024-02-28T23:59:59", "2024-02-29T00:00:00", 1.0),
    ],
)
def test_a_clock_that_passes_midnight(put, first, last, seconds):
    path = put(table("time;Pressure [bar];Force [N]", [first] * 3 + [last] * 3, P[:6], F[:6]))
    assert read_recording(path).time[3] == pytest.approx(seconds)


def test_days_and_months_that_may_be_exchanged_are_no_clock(put):
    path = put(
        table("time;Pressure [bar];Force [N]", ["01/02/2024 23:59:59"] * 3 + ["02/02/2024 00:00:01"] * 3, P[:6], F[:6])
    )
    assert any("not understood as a clock" in problem for problem in problems_of(path, read_recording))


READINGS: dict[str, tuple[str, dict[str, object], tuple[str, str]]] = {  # text, options, column and its remarks
    "a mass that hangs": (table("Pressure [bar];Contraction [%];Weight [kg]", P, C, F / 9.80665), {}, ("Weight [kg]", "masses times g")),
    "a mass in grams": (table("Pressure [bar];Contraction [%];Mass [g]", P, C, F / 9.80665e-3), {}, ("Mass [g]", "masses times g")),
    "a mass below a load cell": (table("Pressure [bar];Contraction [%];Force [N];Weight [kg]", P, C, F, F.round(-2) / 9.80665), {}, ("Weight [kg]", "masses times g")),
    "elongation": (table("Pressure [bar];Elongation (%);Force [N]", P, -C, F), {}, ("Elongation (%)", "")),
    "relative length": (table("Pressure [bar];Relative length (-);Force [N]", P, 1 - C / 100, F), {}, ("Relative length (-)", "")),
    "set and measured": (table("Soll [bar];Ist [bar];Contraction [%];Kraft ist [N]", P.round(), P, C, F), {}, ("Ist [bar]", "")),
    "absolute by a word": ("# all pressures are absolute\n" + table("p [kPa];Contraction [%];Force [N]", 100 * P + 101.3, C, F), {"ambient": 101300.0}, ("p [kPa]", "absolute, less 101.3 kPa")),
    "absolute by its name": (table("p_abs_kPa;Contraction [%];Force [N]", 100 * P + 101.3, C, F), {"ambient": 101300.0}, ("p_abs_kPa", "absolute, less 101.3 kPa")),
    "lines of sensors": (
        table("Druck [V];Contraction [%];Force [counts]", (P + 1) / 2.5, C, 50 - F / 0.1),
        {"columns": {"Druck [V]": "2.5*(x - 0.4) pressure_bar", "Force [counts]": "-0.1*x+5 force_N"}}, ("Druck [V]", "2.5 x -1"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", READINGS)
def test_what_a_header_or_a_line_says_is_applied(case, put):
    text, options, (header, remark) = READINGS[case]
    data = read_dataset(put(text), **options)
    are_the_points(data)
    (row,) = [row for row in data.lines[0].rows() if row[0] == header]
    assert row[-1] == remark


def test_a_sensor_without_a_line_is_asked_about_with_its_form(put):
    path = put(table("Druck [V];Contraction [%];Force [N]", (P + 1) / 2.5, C, F))
    assert any("--column 'Druck [V]=GAIN*x+OFFSET pressure_bar'" in problem for problem in problems_of(path))


def test_an_ambient_pressure_needs_an_absolute_one(put):
    assert any("ambient: no pressure is absolute" in problem for problem in problems_of(put(table()), ambient=101300.0))


def test_loads_without_a_sensor_are_one_for_each_file(put):
    pressure, loads = np.linspace(2, 6, 9), (98.0665, 200.0, 400.0)
    shorter = [28 * (1 - np.sqrt(load / (64.3 * pressure))) for load in loads]
    paths = [put(table("Pressure [bar];Contraction [%]", pressure, c), f"{len(c)}{c[0]:.0f}.csv") for c in shorter]
    data = read_dataset(paths, loads=["10 kg", "200 N", "0.4 kN"], accept=["range"])
    assert np.unique(data.force).tolist() == pytest.approx(loads)
    assert Recipe(loads="[10 kg, 200 N]").loads == pytest.approx(loads[:2])
    assert any("--read 'loads=" in problem for problem in problems_of(paths[0]))
    (problem,) = problems_of(paths[0], loads=["2 kg", "30 N"])
    assert problem.startswith("loads: 2 loads are given for 1 files")


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b'[{"pressure_bar": 1}]', "JSON"), (b'{"pressure_bar": 1}\n{"pressure_bar": 2}\n', "JSON"), (b"PAR1\0\0PAR1", "Parquet"),
        (gzip.compress(b"Pressure [bar]", mtime=0), "compressed"), (bytes.fromhex("d0cf11e0a1b11ae1") + bytes(99), ".xls"),
        (b"CDF\x01\0\0", "NetCDF 3"), (b"%PDF-1.4\n", "PDF"), (b"<html><table>", "HTML"), (archived(), ".ods"),
    ],
)  # fmt: skip
def test_a_format_that_is_not_read_is_named_with_what_is(content, kind, put):
    (problem,) = problems_of(put(content, "rig.nc" if "CDF" in kind else "rig.dat"))
    assert kind in problem and "CSV" in problem


def numbers(form: str) -> str:
    return "\n".join([HEADER, *(";".join(form.format(x) for x in row) for row in zip(P, C, F, strict=True))]) + "\n"


@pytest.mark.parametrize(
    "content",
    [
        table(HEADER).encode("utf-16-le"),
        table(HEADER).encode("utf-16-be"),
        numbers("{:.8E}").replace("E", "D").encode(),
        numbers("+ {:.10g}").encode(),
        numbers('"+ {:.10g}"').encode(),
        "".join(f"14:02:{at:02d}.000 -> {line}\n" for at, line in enumerate(["Ready", *table(HEADER).splitlines()])).encode(),
        "".join(f"14:02:{at:02d}.000 -> {line}\n" if at else f"{line}\n" for at, line in enumerate(table(HEADER).splitlines())).encode(),
    ],
)  # fmt: skip
def test_forms_of_texts_are_read_at_once(content, put):
    are_the_points(read_dataset(put(content)))


@pytest.mark.parametrize("coordinate", [None, np.arange(18)])
def test_a_dimension_of_xarray_needs_no_variable(coordinate, tmp_path):
    columns = (("pressure", P, "bar"), ("contraction", C, "%"), ("force", F, "N"))
    file = xr.Dataset({name: ("i", values, {"units": unit}) for name, values, unit in columns})
    (file if coordinate is None else file.assign_coords(i=coordinate)).to_netcdf(tmp_path / "rig.nc", engine="h5netcdf")
    are_the_points(read_dataset(tmp_path / "rig.nc"))


@pytest.mark.parametrize(("lost", "asks"), [(0, False), (300, True)])
def test_a_mark_of_missing_values_is_more_frequent_than_the_values_beside_it(lost, asks, put):
    """A force that sweeps over 999.99 N in ten thousand rows reads that once or twice."""
    force = np.round(np.random.default_rng(0).uniform(900, 1100, 10_000), 2)
    force[::5000], force[1 : 1 + lost] = 999.99, 999.99
    rows = "".join(f"{4 + 1e-3 * number:.3f};0;{newton}\n" for number, newton in enumerate(force))
    asked = [question.problem.field for question in read_columns(put(f"{HEADER}\n{rows}".encode())).questions]
    assert ("Force [N]" in asked) == asks
