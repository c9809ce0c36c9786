import re
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from mckibben.dataset import formats, read_dataset, read_recording
from mckibben.dataset.encodings import decode
from mckibben.dataset.headers import parse_header
from mckibben.dataset.large_text import read_large_text
from mckibben.dataset.quantities import LEAVE_OUT
from mckibben.dataset.text import read_text
from mckibben.errors import DatasetError, McKibbenWarning, RangeError
from mckibben.units import bar

# Rows of Martens and Boblan 2017, a DMSP-10-250 (zeros mean slack), and of the maker's chart for 10 mm.
MARTENS = """\
pressure_Pa,length_m,contraction_ratio,force_N
50000,0.25,0.0,0.0
50000,0.234,0.064,0.0
360000,0.25,0.0,283.8333
402187,0.234,0.064,101.5
441375,0.219,0.124,46.1667
650000,0.219,0.124,158.6667
"""
FESTO = """\
pressure_kPa,contraction_ratio,force_N
0,-0.03,232.4
0,-0.025,175.3
0,0,0
100,-0.03,321.3
100,0,81.7
"""


@pytest.fixture
def file(tmp_path):
    def write(content: str | bytes) -> Path:
        path = tmp_path / "rig.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def problems(path, **more) -> list[str]:
    with pytest.raises(DatasetError) as caught:
        read_dataset(path, **more)
    assert caught.value.source == str(path)
    return [str(problem).removesuffix(f"; correct it{LEAVE_OUT}") for problem in caught.value.problems]


def test_a_measured_map_with_lengths_and_contractions(file):
    data = read_dataset(file(MARTENS), specimen="DMSP-10-250")
    assert data.pressure.tolist() == [50000, 50000, 360000, 402187, 441375, 650000]
    assert data.contraction.tolist() == [0, 0.064, 0, 0.064, 0.124, 0.124]
    assert data.force.tolist() == [0, 0, 283.8333, 101.5, 46.1667, 158.6667]
    assert data.slack.tolist() == [True, True, False, False, False, False]
    read = data.table.attrs.pop("columns_read").splitlines()
    assert [line.split()[:4] for line in read[1:5]] == [
        ["pressure_Pa", "pressure", "Pa", "header"],
        ["length_m", "length", "m", "header"],
        ["contraction_ratio", "contraction", "ratio", "header"],
        ["force_N", "force", "N", "header"],
    ]
    assert read[5].startswith("6 rows")
    assert data.table.attrs == {
        "specimen": "DMSP-10-250",
        "source": "rig.csv",
        "slack_force": 0.0,
        "initial_length": 0.25,
    }


def test_the_table_of_columns_read_states_units_their_origin_ranges_and_signs(file):
    text = "Druck;Muscle length;Force [kN];note\nbar;mm;;\n1,0;200;-0,1;a\n2,5;190;-0,15;b\n2,5;180;-0,05;c\n"
    data = read_dataset(file(text), columns={"Druck": "pressure_bar"}, initial_length=0.2, force_sign=-1)
    read = [re.split(r" {2,}", line) for line in data.table.attrs["columns_read"].splitlines()]
    assert read[1:4] == [
        ["Druck", "pressure", "bar", "columns", "1..2.5"],
        ["Muscle length", "length", "mm", "file", "180..200", "initial length 200 mm"],
        ["Force [kN]", "force", "kN", "header", "0.05..0.15", "sign reversed"],
    ]
    diameter = 1e3 * np.sqrt(4 * 150 / (np.pi * 8.2 * 2.5e5))  # 150 N at 2.5 bar
    assert f"{diameter:.2g} mm" in read[4][0]
    assert "Muscle length" in data._repr_html_()


def test_the_makers_chart(file):
    data = read_dataset(file(FESTO))
    assert data.pressures.tolist() == [0, 1 * bar]
    assert data.contraction.min() == -0.03
    assert len(data.taut) == 4
    assert "initial_length" not in data.table.attrs


def test_semicolons_decimal_commas_bom_crlf_comments_and_blank_lines(file):
    text = (
        "# specimen: MAS-10\r\n# initial_length: 180 mm\r\n# slack_force: 2 N\r\n# free words\r\n\r\n"
        "Pressure_KPA;Contraction_PERCENT;force_kN;Direction;REPEAT;time_ms;set_pressure_bar;note\r\n"
        "150,5;2,5;0,1;Stretching;1;500;1,5;first\r\n\r\n;;;;;;;\r\n"
        "200;-3;1e-3;Entlastung;2;1000;;a,b.c\r\n"
    )
    data = read_dataset(file(b"\xef\xbb\xbf" + text.encode()))
    np.testing.assert_allclose(data.pressure, [150500, 200000])
    np.testing.assert_allclose(data.contraction, [0.025, -0.03])
    np.testing.assert_allclose(data.force, [100, 1])
    np.testing.assert_allclose(data.levels, [150000, 200000])
    assert data.table["direction"].values.tolist() == ["loading", "unloading"]
    assert data.table["repeat"].values.tolist() == [1, 2]
    np.testing.assert_allclose(data.table["time"], [0.5, 1.0])
    assert data.table.attrs["initial_length"] == pytest.approx(0.18)
    assert data.table.attrs["specimen"] == "MAS-10"
    assert data.slack.tolist() == [False, True]
    assert data.table.attrs["ignored_columns"] == "note"


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_delimiters(file, delimiter):
    data = read_dataset(file(FESTO.replace(",", delimiter)))
    assert data.force.tolist() == [232.4, 175.3, 0, 321.3, 81.7]


@pytest.mark.parametrize(
    ("header", "pascals"),
    [("bar", 1e5), ("kPa", 1e3), ("MPa", 1e6), ("Pa", 1.0), ("mbar", 100.0), ("psi", 6894.757293168361)],
)
def test_pressure_units(file, header, pascals):
    data = read_dataset(file(f"pressure_{header},contraction_ratio,force_N\n{2e5 / pascals!r},0.1,30\n"))
    assert data.pressure[0] == pytest.approx(2e5)


def test_columns_name_the_headers_of_the_file(file):
    path = file("Druck [bar];Kürzung;Kraft, N\n1,5;10;200\n")
    columns = {"Druck [bar]": "pressure_bar", "Kürzung": "contraction_percent", "Kraft, N": "force_N"}
    data = read_dataset(path, columns=columns)
    assert (data.pressure[0], data.contraction[0], data.force[0]) == pytest.approx((1.5e5, 0.1, 200))
    found = problems(path, columns=columns | {"Weg": "length_mm"})
    assert found == ["line 1: columns has 'Weg', the file 'Druck [bar]', 'Kürzung', 'Kraft, N'"]
    assert (
        "unknown name 'pressure' is assigned to 'Kürzung'; accepted are"
        in problems(path, columns={"Kürzung": "pressure"})[0]
    )


def test_a_misspelled_name_is_one_problem_with_a_proposal(file):
    path = file("Supply kPa,contraction_percent,force_N\n150,10,200\n")
    (found,) = problems(path, columns={"Supply kPa": "presure_kPa"})
    assert found.endswith("did you mean 'pressure_kPa'?")
    (found,) = problems(path, columns={"Supply kPa": "pressure"})
    assert "pressure_kPa" in found
    assert "force" not in found


def test_a_unit_that_is_the_last_word_of_a_header_is_proposed(file):
    (found,) = problems(file("Supply kPa,contraction_percent,force_N\n150,10,200\n"))
    assert "--column 'Supply kPa=pressure_kPa'" in found


def test_the_remedy_of_a_wrong_unit_names_the_header_and_the_option(file):
    rows = "".join(f"{p},{c},{100 * p - 200 * c / 10}\n" for p in (1, 2, 3, 4) for c in (0, 1, 2))
    (found,) = problems(file(f"pressure_kPa,contraction_percent,force_N\n{rows}"))
    assert "0.04 bar" in found
    assert "header" in found
    assert "--column" in found


def test_a_column_of_directions_may_be_left_out(file):
    header, row = "pressure_bar,contraction_percent,force_N", "1,10,200"
    (found,) = problems(file(f"{header},direction\n{row},auf\n"))
    assert "leave the column out" in found
    assert len(read_dataset(file(f"{header}\n{row}\n"))) == 1


def test_lengths_alone_need_the_initial_length(file):
    path = file("pressure_bar,length_mm,force_N\n1,180,50\n2,171,40\n")
    assert problems(path) == [
        "initial_length: is needed for lengths; give initial_length (command line: --initial-length '180 mm')"
    ]
    data = read_dataset(path, initial_length=0.18)
    np.testing.assert_allclose(data.contraction, [0, 0.05], atol=1e-15)
    assert data.table.attrs["initial_length"] == 0.18
    assert "line 2, length_mm: 0.18 m is 1000 times the initial length, 0.00018 m; check" in problems(
        path, initial_length=0.18e-3
    )[0].replace("1e+03", "1000")
    for bad in (0.0, -1.0, np.nan, np.inf):
        assert "is not a positive length" in problems(path, initial_length=bad)[0]


def test_lengths_and_contractions_must_agree(file):
    bent = MARTENS.replace("441375,0.219", "441375,0.223")
    assert problems(file(bent)) == [
        "line 6, length_m: 0.223 m contradicts contraction 0.124 of 0.25 m, which implies 0.219 m"
    ]
    rounded = MARTENS.replace("441375,0.219", "441375,0.2194")
    assert read_dataset(file(rounded)).table.attrs["initial_length"] == pytest.approx(0.25)
    assert problems(file(MARTENS), initial_length=0.18) == [
        "initial_length: 0.18 m is given, but lengths and contractions agree on 0.25 m"
    ]


def test_every_problem_is_listed_with_its_line_and_column(file):
    text = """\
# rig 2
pressure_bar,contraction_ratio,force_N,direction,repeat

1,0.1,abc,loading,1
nan,0.1,5,loading,1
inf,0.1,,up,1
-1.02,6.4,5,1,1.5
1,0.1,5,loading

1,0.1,"1,234.5",unloading,-1
"2,5",0.1,"line
break",unloading,1
1_000,0.1,1e999,unloading,99999999999999999999
"""
    words = "write loading (being stretched), unloading (shortening) or unknown, or leave the column out; or give its "
    words += "meaning, loading or unloading: columns={{'{0}': ...}} (command line: --column '{0}=...')"
    assert problems(file(text)) == [
        "line 4, force_N: 'abc' is not a number",
        "line 5, pressure_bar: 'nan' is not a finite number",
        "line 6, pressure_bar: 'inf' is not a finite number",
        "line 6, force_N: the cell is empty",
        f"line 6, direction: 'up' is not a direction; {words.format('up')}",
        "line 7, pressure_bar: -1.02 bar is below a vacuum (-1.0132 bar, gauge)",
        "line 7, contraction_ratio: 6.4 is not between -1 and 1; "
        "this looks like percent: name the column contraction_percent",
        f"line 7, direction: '1' is not a direction; {words.format('1')}",
        "line 7, repeat: 1.5 is not an integer from 0 up",
        "line 8: has 4 cells, the header 5",
        "line 10, repeat: -1 is not an integer from 0 up",
        "line 11, pressure_bar: '2,5' has a decimal comma, but line 4 a decimal point; use one decimal sign in the "
        "whole file",
        "line 11, force_N: 'line\\nbreak' is not a number",
        "line 13, pressure_bar: '1_000' is not a number",
        "line 13, force_N: '1e999' is not a finite number",
        "line 13, repeat: 1e+20 is not an integer from 0 up",
    ]


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("1,0.1,1e999", "line 2, force_kN: '1e999' is not a finite number"),
        ("1,0.1,1e308", "line 2, force_kN: 1e+308 kN is too large"),
        ("1,0.1,٣", "line 2, force_kN: '٣' is not a number"),
        ("1,0.1,3 V", "line 2, force_kN: '3 V' is not a number"),
        ("1,-100,3", "line 2, contraction_percent: -100 % is not between -100 and 100 %"),
    ],
)
def test_numbers_that_cannot_be_meant(file, row, expected):
    assert problems(file(f"pressure_bar,contraction_percent,force_kN\n{row}\n")) == [expected]


def test_one_decimal_sign_through_the_whole_file(file):
    text = "pressure_bar;contraction_percent;force_N\n1;2;3\n1,5;2;3\n2.5;2;3\n1;2;1.000\n"
    assert problems(file(text)) == [
        "line 4, pressure_bar: '2.5' has a decimal point, but line 3 a decimal comma; "
        "use one decimal sign in the whole file",
    ]
    assert read_dataset(file(text.replace("2.5", "2,5"))).force[-1] == 1000


def test_decimal_commas_between_commas_are_recognised(file):
    found = problems(file("pressure_bar,contraction_ratio,force_N\n1,5,0,1,20,5\n"))
    assert found == ["line 2: has 6 cells, the header 3; decimal commas need semicolons between the columns"]


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (
            "pressure_mPa,contraction_ratio,force_N",
            "line 1, pressure_mPa: 'mPa' is not a unit of pressure here",
        ),
        (
            "pressure_Mbar,contraction_ratio,force_N",
            "line 1, pressure_Mbar: 'Mbar' is not a unit of pressure",
        ),
        ("pressure_bar,contraction_ratio,force_mm", "line 1, force_mm: 'mm' is not a unit of force here"),
        ("pressure,contraction_ratio,force_N", "line 1, pressure: has no unit"),
        (
            "pressure_bar,angle_deg,force_N",
            "line 1: no column for contraction; the file has 'pressure_bar', ",
        ),
        (
            "pressure_bar,pressure_kPa,contraction_ratio,force_N",
            "line 1, pressure_kPa: duplicates pressure, after 'pressure_bar'; keep one of them",
        ),
        ("pressure_bar,contraction_ratio,force_N,force_N", "line 1, force_N: appears twice in the header"),
    ],
)
def test_headers_that_cannot_be_used(file, header, expected):
    row = ",".join(f"{index / 10}" for index in range(header.count(",") + 1))
    found = problems(file(f"{header}\n{row}\n"))
    assert found[0].startswith(expected)


def test_missing_columns_say_what_is_accepted(file):
    found = problems(file("a,b\n1,2\n"))
    assert len(found) == 3
    assert (
        "pressure_bar, pressure_kPa, pressure_MPa, pressure_Pa, pressure_mbar, pressure_psi or pressure_kgf/cm^2"
        in found[0]
    )
    assert "contraction_percent, contraction_ratio or contraction_permille (or length_mm, length_m," in found[1]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "is empty"),
        ("\n# words\n", "has no header and no rows"),
        ("# x\n\npressure_bar,contraction_ratio,force_N\n\n", "line 3: has a header and no rows"),
        (b"pressure_bar\n\n\x00\x01", "line 3: is a binary file; give text, .nc, .mat, .tdms"),
        ("pressure_bar,force_N\n".encode("utf-16")[:-1], "line 1: byte 0x0a at 42 is no UTF-16 text; save the file as"),
        (b"pressure_bar\n\x81", "line 2: byte 0x81 at 13 is neither UTF-8 nor Windows-1252 text; save the file as"),
        (
            b"PK\x03\x04abc",
            "is a ZIP archive or an OpenDocument file, not a workbook; extract it, or save the sheet as",
        ),
        (b"\x89HDF\r\n\x1a\n", "cannot be read as an HDF5 file: "),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "is a workbook in the format before 2007; save it as .xlsx or CSV"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(range(1, 256)), "is an image, not a table"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF" + bytes(range(1, 256)), "is an image, not a table"),
        (b"TDSm" + bytes(40), "cannot be read as TDMS"),
        (b"MATLAB 5.0 MAT-file", "cannot be read as a MATLAB file: "),
        (
            FESTO + "1," + 200_000 * "9" + ",1\n",
            "line 7, contraction_ratio: '9999999999999999999999999999999999999...' is not a finite number",
        ),
    ],
)
def test_files_that_are_no_tables(file, content, expected):
    found = problems(file(content))
    assert len(found) == 1
    assert found[0].startswith(expected)


def test_no_file_and_a_directory(tmp_path):
    assert problems(tmp_path / "none.csv") == ["there is no such file"]
    (tmp_path / "noon.csv").touch()
    assert "noon.csv" in problems(tmp_path / "none.csv")[0]
    assert problems(tmp_path) == [f"is a directory; {formats.FILES_REMEDY}"]
    assert "cannot be read" in problems(tmp_path / "a\0b.csv")[0]


def test_bad_comments_and_arguments_are_problems_of_the_file(file):
    assert problems(file("# slack_force: small\n# initial_length: 180\n" + FESTO)) == [
        "line 1, slack_force: 'small' is not a number and a unit; write it like '12.5 N'",
        "line 2, initial_length: '180' has no unit; write it like '180 mm'",
    ]
    assert problems(file(FESTO), initial_length=-0.1) == ["initial_length: -0.1 m is not above 0"]
    assert problems(file(FESTO), slack_force=np.nan) == ["slack_force: nan is not a finite number"]


def test_arguments_go_before_comments(file):
    path = file("# specimen: A\n# slack_force: 100 N\n" + FESTO)
    assert read_dataset(path).slack.sum() == 2
    data = read_dataset(path, specimen="B", slack_force=0.0)
    assert data.table.attrs["specimen"] == "B"
    assert data.slack.sum() == 1


def test_units_that_are_probably_meant_otherwise_are_warned_of(file):
    with (
        pytest.warns(McKibbenWarning, match=r"pressure_Pa never exceeds 100 Pa; .*name it pressure_bar"),
        pytest.raises(DatasetError),
    ):
        read_dataset(file("pressure_Pa,contraction_ratio,force_N\n6,0.1,3\n"))
    ratios = "pressure_bar,contraction_percent,force_N\n6,0,90\n6,0.1,80\n6,0.2,70\n6,0.25,60\n"
    with pytest.warns(McKibbenWarning, match=r"contraction_percent never exceeds 0\.5 %"):
        read_dataset(file(ratios))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_dataset(file("pressure_Pa,contraction_ratio,force_N\n0,0.1,3\n"))
        read_dataset(file(ratios.replace("6,0.25,60\n", "")))


@pytest.mark.slow
def test_a_hundred_thousand_rows_take_no_time_to_speak_of(file):
    row = "1.50000,2.50000,123.456,loading,1\n"
    path = file("pressure_bar,contraction_percent,force_N,direction,repeat\n" + 100_000 * row + row.replace("3", "4"))
    start = time.process_time()
    assert len(read_dataset(path)) == 100_001
    assert time.process_time() - start < 3  # 0.6 s of a slow core


FUZZ = settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
VALID = (
    b"# specimen: A\n# initial_length: 0.18 m\n"
    b"pressure_bar;contraction_percent;length_mm;force_N;direction;repeat;time_s;set_pressure_bar;x\n"
    b"1,5;2,5;175,5;100;loading;1;0,5;1,5;a\n2;5;171;90,5;unloading;2;1;;b\n3;10;162;1e2;loading;3;2;3;\n"
)
SPLICES = [
    b"",
    b",",
    b";",
    b".",
    b"-",
    b'"',
    b"\n",
    b"\r",
    b"#",
    b"nan",
    b"1e999",
    b"1e308",
    b"\xff",
    b"\0",
    b"\t",
]
SPLICES += [b"99999999", b"_Pa", "\u0663\u2028\x85".encode(), b" ", b"1_0", b"+"]


def only_dataset_errors(path, **more) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            data = read_dataset(path, **more)
        except DatasetError as error:
            assert error.problems and str(error)
        else:
            assert np.isfinite([data.pressure, data.contraction, data.force]).all()


@pytest.mark.slow
@FUZZ
@given(content=st.binary(max_size=300) | st.text(max_size=300).map(lambda text: text.encode("utf-8", "replace")))
def test_random_bytes_raise_nothing_but_dataset_errors(content, file):
    only_dataset_errors(file(content))
    only_dataset_errors(file(b"pressure_bar,contraction_ratio,force_N\n" + content))


@FUZZ
@given(
    edits=st.lists(
        st.tuples(st.integers(0, len(VALID)), st.integers(0, 8), st.sampled_from(SPLICES)),
        min_size=1,
        max_size=4,
    ),
    initial_length=st.none() | st.floats(),
    slack_force=st.none() | st.floats(),
)
@example(edits=[(0, 0, b"")], initial_length=1e308, slack_force=None)
@pytest.mark.slow
def test_mutated_files_raise_nothing_but_dataset_errors(edits, initial_length, slack_force, file):
    content = VALID
    for at, removed, put in edits:
        content = content[:at] + put + content[at + removed :]
    only_dataset_errors(file(content), initial_length=initial_length, slack_force=slack_force)


def test_the_file_that_the_fuzz_begins_with_is_valid(file):
    assert len(read_dataset(file(VALID))) == 3


@pytest.mark.parametrize("read", [read_dataset, read_recording])
@pytest.mark.parametrize("argument", ["initial_length", "slack_force"])
def test_arguments_are_numbers_in_si(read, argument, file):
    with pytest.raises(RangeError) as error:
        read(file(VALID), **{argument: "200 mm"})
    assert error.value.field == argument


HEAD = "time (s);pressure (bar);force (N)\n"
ROWS = [f"{0.001 * i:.3f};{2 + i % 7 / 7:.5f};{40 + i % 11 / 11:.4f}\n" for i in range(60_000)]
LARGE = HEAD + "".join(ROWS)


def known(header, unit):
    return parse_header(header, unit) is not None


def large(path, content, decimal=""):
    path.write_bytes(content.encode())
    return read_large_text(path, known, decimal)


@pytest.mark.parametrize(
    "content",
    [
        LARGE,
        LARGE.replace(";", ","),
        LARGE.replace(";", "\t"),
        LARGE.replace(".", ","),
        LARGE.replace("\n", "\r\n"),
        LARGE.rstrip("\n"),
        LARGE.removesuffix("000\n"),
        "# specimen: S\n" + LARGE.replace("time (s)", "Temperature [°C]"),
        "time;pressure;force\ns;bar;N\n" + "".join(ROWS),
        "\ufeff" + LARGE,
        LARGE.replace("pressure (bar)", "note"),
        HEAD + ROWS[7] * 1_200_000,  # several pieces
    ],
    ids=["semicolon", "comma", "tab", "decimal comma", "CRLF", "no last line end", "cut", "comment", "units below",
         "byte order mark", "unknown column", "pieces"],
)  # fmt: skip
def test_a_large_text_of_numbers_is_read_in_pieces_as_it_would_be_whole(tmp_path, content):
    found = large(tmp_path / "large.csv", content)
    whole = read_text(decode(content.encode(), "")[0], "", known)
    assert found is not None
    for one, other in zip(found.channels, whole.channels, strict=True):
        np.testing.assert_array_equal(one.cells, np.asarray(other.cells, float))
        assert (one.name, one.unit, one.lines) == (other.name, other.unit, other.lines)
    for name in ("header_line", "comments", "delimiter", "has_header", "corrupt", "problems", "suspect"):
        assert getattr(found, name) == getattr(whole, name)


@pytest.mark.parametrize(
    "row",
    ["", "1.0;2.0", "1.0;2.0;3.0;4.0", "1.0;2.0;", ";1.0;2.0", "1.0;2.0;1-2", "1.0;2.0;1e", "1.0;2.0;n/a", "1;2;3,5"],
)
def test_a_large_text_with_another_row_is_not_read_in_pieces(tmp_path, row):
    rows = "".join(ROWS)
    for several in (f"{row}\n", f"{row}\n1;2;3;4\n"):
        assert large(tmp_path / "large.csv", HEAD + rows + several + rows) is None


def test_a_large_text_in_doubt_is_not_read_in_pieces(tmp_path):
    whole_numbers = "".join(f"{i};2;{40 + i % 11}\n" for i in range(60_000))
    assert large(tmp_path / "large.csv", HEAD + whole_numbers) is not None
    assert large(tmp_path / "large.csv", HEAD + whole_numbers + "1.234;2;40\n") is None  # may be 1234
    assert large(tmp_path / "large.csv", LARGE, decimal=",") is None


def test_a_header_without_a_quantity_is_suggested_by_its_unit_or_spelling(file):
    path = file("Supply (psi),Load cell (lbf),contraction_percent\n30,20,0\n30,10,10\n")
    with pytest.raises(DatasetError) as caught:
        read_dataset(path, columns={"Suply (psi)": "pressure_psi"})
    remedies = [problem.remedy for problem in caught.value.problems]
    assert any("'Supply (psi)'" in one for one in remedies)
    assert any("'Load cell (lbf)': 'force_lbf'" in one for one in remedies)
    with pytest.raises(DatasetError) as caught:
        read_dataset(file("force_N,contraction_percent\n20,0\n10,10\n"))
    assert [problem.remedy.count("from_name") for problem in caught.value.problems] == [1]


def test_a_wrong_initial_length_is_not_a_problem_of_each_row(file):
    rows = "\n".join(f"1,{180 + k},{50 - k}" for k in range(30))
    with pytest.raises(DatasetError) as caught:
        read_dataset(file(f"pressure_bar,length_mm,force_N\n{rows}"), initial_length=0.018)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (2, "length_mm") and "29" in problem.message
    assert "initial_length" in problem.remedy


def test_points_know_their_lines(tmp_path):
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    first.write_text(f"# a test\n{MARTENS}")
    second.write_text(MARTENS.replace("360000,0.25,0.0", "360000,0.25,x"))
    data = read_dataset(first)
    assert (data.place(0), data.place(5)) == ("line 3", "line 8")
    assert data.taut.place(0) == "row 1"  # a row of its own, no longer of the file
    with pytest.warns(McKibbenWarning, match="left out"):
        both = read_dataset([first, second], on_corrupt="report")
    expected = [f"line 3 of {first}", f"line 3 of {second}", f"line 5 of {second}"]
    assert [both.place(row) for row in (0, 7, 8)] == expected


@pytest.mark.parametrize(
    ("units", "scale", "field", "advice", "usual"),
    [
        (("kPa", "N"), 1, "pressure", "6 kPa", "bar"),
        (("bar", "N"), 1000, "pressure", "6000 bar", "mbar"),  # in which the force would be that of a thread
        (("bar", "kN"), 1, "force", "540 kN", "N"),
    ],
)
def test_the_unit_in_which_a_number_would_be_usual_is_proposed(tmp_path, units, scale, field, advice, usual):
    rows = [f"{p * scale},{c},{p * (30 - c) * 3}" for p in (2, 4, 6) for c in (0, 5, 10, 15)]
    path = tmp_path / "wrong.csv"
    path.write_text("\n".join([f"pressure_{units[0]},contraction_percent,force_{units[1]}", *rows]))
    with pytest.raises(DatasetError) as caught:
        read_dataset(path)
    (problem,) = caught.value.problems
    assert problem.field == field and f"{advice} would be usual in {usual}" in problem.remedy
