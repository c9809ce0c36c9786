import io
import struct
import sys
import warnings

import h5py
import numpy as np
import openpyxl
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from mckibben.dataset import read_dataset, read_recording
from mckibben.errors import McKibbenWarning

from .conftest import COLUMNS, CONTRACTION, DIRECTION, FILES, FORCE, PRESSURE, is_the_six_points, said_of, text


@pytest.mark.parametrize("name", FILES)
def test_the_same_points_from_every_kind_of_file(name, put):
    data = read_dataset(put(FILES[name], name))
    is_the_six_points(data)
    if name not in ("version4.mat", "rig.h5", "rig.tdms", "rig.lvm"):
        assert data.table["direction"].values.tolist() == DIRECTION


@pytest.mark.parametrize("name", FILES)
def test_the_kind_is_told_by_the_content_and_not_by_the_name(name, put):
    if name != "version4.mat":  # it has no mark
        is_the_six_points(read_dataset(put(FILES[name], "rig.dat")))


@pytest.mark.parametrize(
    ("name", "pressure", "column"),
    [
        ("plain.mat", "rig.pressure_bar", "rig.force_N"),
        ("version73.mat", "rig.pressure_bar", "rig.force_N"),
        ("version4.mat", "pressure_bar", "force_N"),
        ("rig.h5", "rig/Pressure", "rig/Force"),
        ("rig.tdms", "rig/Pressure", "rig/Force"),
        ("rig.xlsx", "Pressure", "Force"),
        ("rig.csv", "Pressure (bar)", "Force [N]"),
        ("rig.lvm", "Pressure", "Force"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*as assigned")
@pytest.mark.filterwarnings("ignore:.* is read in .*, but")
def test_columns_are_named_in_every_kind_of_file_and_what_is_said_goes_first(name, pressure, column, put):
    path = put(FILES[name], name)
    data = read_dataset(path, columns={column: "pressure_kPa", pressure: "force_N"})
    np.testing.assert_allclose(data.pressure, FORCE * 1e3)
    np.testing.assert_allclose(data.force, PRESSURE)
    found = said_of(path, columns={"nothing": "force_N"})
    assert f"columns has 'nothing', the file {', '.join(map(repr, [*_names(name)]))}" in found[0]


def _names(name):
    return {
        "plain.mat": ["rig.pressure_bar", "rig.contraction_percent", "rig.force_N", "direction"],
        "version73.mat": ["direction", "rig.contraction_percent", "rig.force_N", "rig.pressure_bar"],
        "version4.mat": list(COLUMNS),
        "rig.h5": ["rig/Contraction", "rig/Force", "rig/Pressure"],
        "rig.tdms": ["rig/Pressure", "rig/Contraction", "rig/Force"],
        "rig.xlsx": ["No", "Pressure", "Contraction", "Force", "Direction"],
        "rig.csv": ["Pressure (bar)", "Force [N]", "p / x", "Contraction [%]", "Direction"],
        "rig.lvm": ["X_Value", "Pressure", "Contraction", "Force", "Comment"],
    }[name]


@pytest.mark.parametrize(
    "header",
    [
        "Pressure (bar),Force [N],Contraction [%]",
        "p / bar,F / N,ε / %",
        "Gauge pressure [bar(g)],Tension in N,relative contraction (percent)",
        "pressure bar,FORCE N,Contraction %",
        'P [barg],"Force, N",epsilon [%]',
    ],
)
def test_headers_as_people_write_them(header, put):
    rows = "".join(f"{p},{f},{c}\n" for p, f, c in zip(PRESSURE, FORCE, CONTRACTION, strict=True))
    is_the_six_points(read_dataset(put(f"{header}\n{rows}")))
    quoted = header.replace('"Force, N"', "Force [N]")
    is_the_six_points(read_dataset(put(f"{quoted}\n{rows}".replace(",", "\t"))))


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("Pressure (psia)", "line 1, Pressure (psia): 'psia' is absolute; a gauge pressure is needed"),
        ("p [bar abs]", "line 1, p [bar abs]: 'bar abs' is absolute; a gauge pressure is needed"),
        ("Pressure [mPa]", "line 1, Pressure [mPa]: 'mPa' is not a unit of pressure here"),
        ("Pressure", "line 1, Pressure: has no unit"),
        ("P / W", "line 1: no column for pressure; the file has 'P / W', 'force_N'"),
    ],
)
def test_headers_that_must_not_pass_for_a_gauge_pressure(header, expected, put):
    assert said_of(put(f"{header},force_N,contraction_ratio\n1,2,0\n"))[0].startswith(expected)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252", "utf-32"])
def test_encodings(encoding, put):
    words = "# source: Prüfstand\nPressure (bar);Contraction [%];Force [N];Kürzung µ\n1,5;2;3;x\n2;2;3;y\n"
    data = read_dataset(put(words.encode(encoding)))
    assert data.pressure.tolist() == [1.5e5, 2e5]
    assert data.table.attrs["source"] == "Prüfstand"
    assert data.table.attrs["ignored_columns"] == "Kürzung µ"


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "  "])
def test_a_row_of_units_under_the_header(delimiter, put):
    rows = [["Time", "Pressure", "Contraction", "Force"], ["[s]", "[bar]", "[%]", "[kN]"], ["0", "1", "2", "3"]]
    data = read_dataset(put("".join(delimiter.join(row) + "\n" for row in [*rows, ["1", "2", "3.5", "4e-3"]])))
    assert data.force.tolist() == [3000, 4]
    found = said_of(put("".join(delimiter.join(row) + "\n" for row in [*rows, ["1", "x", "3", "4"]])))
    assert found == ["line 4, Pressure: 'x' is not a number"]


def test_lines_before_the_header_are_passed_over_but_no_row(put):
    rows = "pressure_bar;contraction_percent;force_N\n1;2;3\n2;2;x\n"
    assert said_of(put(f"Rig 3\nDate: today; noon\n\n{rows}")) == ["line 6, force_N: 'x' is not a number"]
    assert "has no header" in said_of(put(f"2;0;300\n{rows}"))[0]


def test_columns_of_row_numbers_and_white_space(put):
    is_the_six_points(
        read_dataset(
            put(
                "pressure_bar,contraction_percent,force_N\n"
                + "".join(f"{i},{p},{c},{f}\n" for i, (p, c, f) in enumerate(zip(*COLUMNS.values(), strict=True)))
            )
        )
    )
    named = "\n".join(f'"{i}" {p}\t{c}  {f} ' for i, (p, c, f) in enumerate(zip(*COLUMNS.values(), strict=True)))
    is_the_six_points(read_dataset(put(f"No  Pressure (bar) contraction_percent  Force [N]\n{named}\n")))


@pytest.mark.filterwarnings("ignore::mckibben.errors.McKibbenWarning")  # of random points
def test_a_text_of_numbers_alone_reads_as_one_with_words(put):
    """It takes another way, by NumPy: the lines in its errors must be the same."""
    rng = np.random.default_rng(0)
    rows = [f"{p:.3f};{c:.4f};{f:.2e}\n".replace(".", ",") for p, c, f in rng.uniform(0, (6, 0.3, 300), (50, 3))]
    header = "pressure_bar;contraction_ratio;force_N"
    quote = read_dataset(put(header + "\n" + "".join(rows)))
    worded = read_dataset(put(header + ";note\n" + "".join(row[:-1] + ";a\n" for row in rows)))
    assert quote.force.tolist() == worded.force.tolist()
    assert quote.pressure.tolist() == worded.pressure.tolist()
    rows[30] = "-9;0;0\n"
    expected = ["line 32, pressure_bar: -9 bar is below a vacuum (-1.0132 bar, gauge)"]
    assert said_of(put(header + "\n" + "".join(rows))) == expected
    assert said_of(put(header + ";note\n" + "".join(row[:-1] + ";a\n" for row in rows))) == expected


def test_a_mistake_in_a_cell_is_named_by_its_row_in_every_kind_of_file(put):
    bad = FORCE.copy()
    bad[3] = np.nan
    stream = io.BytesIO()
    savemat(stream, {"r": {"pressure_bar": PRESSURE, "contraction_percent": CONTRACTION, "force_N": bad}})
    assert said_of(put(stream.getvalue(), "a.mat")) == ["row 4, r.force_N: nan is not a finite number"]
    book = openpyxl.load_workbook(io.BytesIO(FILES["rig.xlsx"]))
    book.active["D8"], book.active["B7"], book.active["C9"] = "#DIV/0!", None, -150
    stream = io.BytesIO()
    book.save(stream)
    assert said_of(put(stream.getvalue(), "a.xlsx")) == [
        "row 7, Pressure: the cell is empty",
        "row 8, Force: '#DIV/0!' is not a number",
        "row 9, Contraction: -150 % is not between -100 and 100 %",
    ]
    assert said_of(put(FILES["rig.lvm"].replace(b"120.000000", b"12O.000000"), "a.lvm")) == [
        "line 14, Force: '12O.000000' is not a number"
    ]


def test_decimal_commas_in_texts_of_a_sheet_must_agree(put):
    book = openpyxl.Workbook()
    for row in (["pressure_bar", "contraction_percent", "force_N"], ["1,5", "2", 3], ["2.5", "2", 3]):
        book.active.append(row)
    stream = io.BytesIO()
    book.save(stream)
    found = said_of(put(stream.getvalue(), "a.xlsx"))
    assert found[0].startswith("row 3, pressure_bar: '2.5' has a decimal point, but row 2 a decimal comma")


def test_two_sheets_or_groups_are_never_mixed(put):
    book = openpyxl.Workbook()
    for title, force in (("run 1", 3), ("run 2", 7)):
        sheet = book.create_sheet(title)
        sheet.append(["pressure_bar", "contraction_percent", "force_N"])
        sheet.append([1, 2, force])
    stream = io.BytesIO()
    book.save(stream)
    path = put(stream.getvalue(), "a.xlsx")
    assert "'run 2/force_N': duplicates" not in said_of(path)[0]
    assert any("run 2/force_N: duplicates force, after 'run 1/force_N'" in text for text in said_of(path))
    names = ("pressure_bar", "contraction_percent", "force_N")
    assert read_dataset(path, columns={f"run 2/{name}": name for name in names}).force.tolist() == [7]


def test_matrices_and_lengths_that_differ(put):
    stream = io.BytesIO()
    savemat(stream, {"m": np.stack(list(COLUMNS.values()), axis=1), "t": np.arange(5.0)})
    path = put(stream.getvalue(), "a.mat")
    columns = {f"m(:,{i + 1})": name for i, name in enumerate(COLUMNS)}
    is_the_six_points(read_dataset(path, columns=columns))
    assert said_of(path, columns=columns | {"t": "time_s"}) == [
        "t: has 5 values, 'm(:,1)' 6; read columns of equal length"
    ]


def test_objects_of_matlab_are_named_and_how_to_save_them(put):
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as file:
        table = file.create_dataset("T", data=np.zeros((1, 6), np.uint32))
        table.attrs["MATLAB_class"] = np.bytes_("table")
    content = b"MATLAB 7.3 MAT-file".ljust(512) + stream.getvalue()[512:]
    found = said_of(put(content, "a.mat"))
    assert found[-1].startswith("T: is a MATLAB object") or "T: is a MATLAB object" in "".join(found)
    assert "table2struct" in "".join(found)


def test_a_matrix_that_claims_what_the_file_does_not_hold_is_not_read(put):
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.create_dataset("pressure_bar", shape=(2**34,), dtype="f8", chunks=(1024,))
    found = said_of(put(stream.getvalue(), "a.h5"))
    assert "pressure_bar: claims 17179869184 values, more than can be read" in found[-1] + found[0]


def test_a_tdms_file_that_was_cut_off_says_so(put):
    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        for part in range(3):
            writer.write_segment([ChannelObject("g", n, v + part) for n, v in COLUMNS.items()])
    path = put(stream.getvalue()[:-100], "a.tdms")
    found = said_of(path)
    assert any("the file was cut off: its last segment is not complete" in text for text in found)
    with pytest.warns(McKibbenWarning, match="cut off"):
        data = read_dataset(path, on_corrupt="report")
    assert data.pressure.tolist() == [*(PRESSURE * 1e5), *(PRESSURE * 1e5 + 1e5)]
    repairs = data.table.attrs["repairs"]
    assert "cut off" in repairs
    assert [f"row {row}, g/force_N: nan is not" in repairs for row in range(12, 19)] == [False, *5 * [True], False]


def test_waveforms_of_tdms_and_lvm_know_their_time(put):
    assert read_recording(put(FILES["rig.tdms"], "a.tdms")).time.tolist() == [0, 0.5, 1, 1.5, 2, 2.5]
    assert read_recording(put(FILES["rig.lvm"], "a.lvm")).time.tolist() == [0, 0.5, 1, 1.5, 2, 2.5]
    commas = FILES["rig.lvm"].replace(b"\t", b",").replace(b"Separator,Tab", b"Separator,Comma")
    assert read_recording(put(commas, "b.lvm")).time.tolist() == [0, 0.5, 1, 1.5, 2, 2.5]


def test_a_channel_of_tdms_that_begins_later_is_reported(put):
    stream = io.BytesIO()
    begin = np.datetime64("2024-03-12T14:00:00", "us")
    with TdmsWriter(stream) as writer:
        for number, (name, values) in enumerate(COLUMNS.items()):
            start = {"wf_start_time": begin + np.timedelta64(2 * (number == 1), "s"), "wf_increment": 0.5}
            writer.write_segment([ChannelObject("g", name, values, properties=start)])
    late = [*COLUMNS][1]
    with pytest.warns(McKibbenWarning, match=f"g/{late}: begins 2 s after the first channel"):
        read_dataset(put(stream.getvalue(), "a.tdms"))


def test_a_short_vector_named_as_a_calibration_is_reported(put):
    stream = io.BytesIO()
    savemat(stream, {**COLUMNS, "cal": [1.0, 1.0, 0.1]})
    with pytest.warns(McKibbenWarning, match="'cal' is not a column"):
        read_dataset(put(stream.getvalue(), "a.mat"))


def test_several_segments_of_an_lvm_file_are_refused(put):
    segment = FILES["rig.lvm"].partition(b"***End_of_Header***")[2]
    assert said_of(put(FILES["rig.lvm"] + segment, "a.lvm")) == [
        "has 2 segments; write one segment to a file, or give TDMS"
    ]


def test_a_unit_that_is_not_that_of_the_header_is_refused(put):
    found = said_of(put("pressure_psi,force_N,contraction_ratio\nbar,kN,-\n30,100,0.01\n40,150,0.02\n"))
    assert [one.split(":")[0] for one in found] == ["line 1, pressure_psi", "line 1, force_N"]


@pytest.mark.parametrize(("name", "module"), [("rig.tdms", "nptdms"), ("rig.xlsx", "openpyxl")])
def test_a_missing_extra_is_named(name, module, put, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr("mckibben.dataset.formats.call_in_child", lambda path, read, *args: read(path, *args))
    extra = {"nptdms": "mckibben[tdms]", "openpyxl": "mckibben[excel]"}[module]
    assert extra in said_of(put(FILES[name], name))[0]


def test_nothing_of_this_warns(put):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_dataset(put(text()))


def test_matrices_of_matlab_73_lie_on_their_side(put):
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as file:
        file.create_dataset("m", data=np.stack(list(COLUMNS.values()))).attrs["MATLAB_class"] = np.bytes_("double")
    path = put(b"MATLAB 7.3 MAT-file".ljust(512) + stream.getvalue()[512:], "a.mat")
    is_the_six_points(read_dataset(path, columns={f"m(:,{i + 1})": name for i, name in enumerate(COLUMNS)}))


@pytest.mark.slow
def test_a_struct_of_a_billion_elements_without_fields_is_refused(put):
    def element(kind: int, content: bytes) -> bytes:
        return struct.pack("<2I", kind, len(content)) + content + bytes(-len(content) % 8)

    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    flags, dims = element(6, struct.pack("<2I", 2, 0)), element(5, struct.pack("<2i", 1, 10**9))
    array = flags + dims + element(1, b"s") + element(5, struct.pack("<i", 8)) + element(1, b"")
    assert "cannot be read" in said_of(put(head + element(14, array), "a.mat"))[0]
