# ruff: noqa: E501 - tables of cases
"""Ordinary files of loggers and spreadsheets are read at once, without a question."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
import xarray as xr
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from mckibben.dataset import read_dataset, read_recording
from mckibben.dataset import text as texts
from mckibben.errors import DatasetError

from .conftest import C, F, P, are_the_points

TIME = np.arange(0, 6, 0.05)
PRESSURE = np.where(TIME < 3, 2.0, 3.0) + 0.01 * np.sin(40 * TIME)  # bar
LENGTH = 180 - 0.1 * np.arange(len(TIME)) % 18  # mm
FORCE = 40 * PRESSURE * (1 - (1 - LENGTH / 180) / 0.28) ** 2  # N
SAMPLES = np.column_stack([PRESSURE, LENGTH, FORCE])
POINTS = np.column_stack([P, C, F])


def stamp(second: float, form: str) -> str:
    """Time of day and date 12 March 2024, 14:02:00 and so many seconds."""
    whole, milli = divmod(round(second * 1000), 1000)
    return form.format(s=whole % 60, m=2 + whole // 60, ms=milli)


def table(
    header: str,
    columns: np.ndarray,
    first: list[str] | None = None,
    sep: str = ",",
    decimal: str = ".",
    digits: int = 4,
) -> str:
    """Lines of a header and rows; `first` are cells of a first column."""
    rows = [[f"{value:.{digits}f}".replace(".", decimal) for value in row] for row in columns]
    if first is not None:
        rows = [[cell, *row] for cell, row in zip(first, rows, strict=True)]
    return "\n".join([header, *map(sep.join, rows)]) + "\n"


def stamped(header: str, form: str, sep: str = ",", decimal: str = ".") -> str:
    return table(header, SAMPLES, [stamp(t, form) for t in TIME], sep, decimal)


NAMES = "Pressure [bar],Length [mm],Force [N]"
RECORDINGS: dict[str, str] = {
    "pandas timestamp": stamped(f"timestamp,{NAMES}", "2024-03-12 14:{m:02d}:{s:02d}.{ms:03d}000"),
    "ISO with zone": stamped(f"time,{NAMES}", "2024-03-12T14:{m:02d}:{s:02d}.{ms:03d}Z"),
    "German date and time": stamped("Zeitstempel;Druck [bar];Länge [mm];Kraft [N]", "12.03.2024 14:{m:02d}:{s:02d},{ms:03d}", ";", ","),
    "time of day": stamped(f"Time,{NAMES}", "14:{m:02d}:{s:02d}.{ms:03d}"),
    "epoch in seconds": table(f"__time,{NAMES}", SAMPLES, [f"{1710252120 + t:.3f}" for t in TIME]),
    "epoch in nanoseconds": table(f"timestamp,{NAMES}", SAMPLES, [f"{int((1710252120 + t) * 1e9)}" for t in TIME]),
    "ROS": table("%time,field.pressure_bar,field.length_mm,field.force_N", SAMPLES, [f"{1710252120000000000 + round(t * 1e9)}" for t in TIME]),
    "Arduino millis": table("millis,pressure_bar,length_mm,force_N", SAMPLES, [f"{round(1000 * t)}" for t in TIME]),
    "Simulink tout": table("tout,pressure_bar,length_mm,force_N", SAMPLES, [f"{t:.3f}" for t in TIME]),
    "Arduino IDE": "".join(f"14:{2 + int(t) // 60:02d}:{int(t) % 60:02d}.{round(1000 * (t % 1)):03d} -> {line}\n" for t, line in zip([0.0, *TIME], table("pressure_bar,length_mm,force_N", SAMPLES).splitlines(), strict=True)),
    "catman": "Druckversuch\nAufnahmebeginn 12.03.2024\nDevice: MGCplus\n" + table("Zeit  1 - Standardmessrate [s]\tDruck [bar]\tLänge [mm]\tKraft [N]", SAMPLES, [f"{t:.4f}".replace(".", ",") for t in TIME], "\t", ","),
    "PicoLog": stamped(",Pressure (bar) Ave,Length (mm) Ave,Force (N) Ave", '"2024-03-12T14:{m:02d}:{s:02d}.{ms:03d}+01:00"'),
    "Campbell TOA5": '"TOA5","rig","CR1000X","1234","CR1000X.Std.03","CPU:rig.CR1X","1","Table1"\n' + stamped('"TIMESTAMP","RECORD","Pressure","Length","Force"\n"TS","RN","bar","mm","N"\n"","","Smp","Smp","Smp"', '"2024-03-12 14:{m:02d}:{s:02d}.{ms:03d}",1'),
    "Keysight BenchVue": "Name:,Rig\nOwner:,lab\n" + stamped("Scan,Time,101 <Pressure> (bar),102 <Length> (mm),103 <Force> (N)", "1,03/12/2024 14:{m:02d}:{s:02d}:{ms:03d}"),
    "dSPACE CSV": table("Time [s],Model Root/Pressure [bar]/In1,Model Root/Length [mm]/In1,Model Root/Force [N]/In1", SAMPLES, [f"{t:.3f}" for t in TIME]),
    "Graphtec": "Vendor,GRAPHTEC Corporation\nModel,GL240\nAMP settings\nCH,Signal name,Input,Range,Filter,Span\n"
    'CH1,"Pressure",DC,10V,Off,10.00,0.00,bar\nCH2,"Length",DC,10V,Off,300.0,0.0,mm\nCH3,"Force",DC,10V,Off,500.0,0.0,N\nData\n' + stamped("Number,Date&Time,CH1,CH2,CH3\nNO.,Time,bar,mm,N", "1,2024/03/12 14:{m:02d}:{s:02d}.{ms:03d}"),
    "LabVIEW": "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n***End_of_Header***\t\n\t\n"
    "Channels\t3\nY_Unit_Label\tbar\tmm\tN\nX_Dimension\tTime\tTime\tTime\nDelta_X\t0.05\t0.05\t0.05\n***End_of_Header***\t\n" + table("X_Value\tPressure\tLength\tForce\tComment", SAMPLES, [f"{t:.3f}" for t in TIME], "\t"),
    "Excel export": table("Zeit (s);Druck (bar);Weg ignoriert;Länge (mm);Kraft (N)".replace("Weg ignoriert;", ""), SAMPLES, [f"{t:.2f}".replace(".", ",") for t in TIME], ";", ","),
    "oscilloscope": table("Time (ms),Pressure (kPa),Length (mm),Force (N),Temperature (°C)", np.column_stack([1000 * TIME, 100 * PRESSURE, LENGTH, FORCE, 0 * TIME + 21.5])),
    "blanks": table("# time_s pressure_bar length_mm force_N", np.column_stack([TIME, SAMPLES]), sep=" "),
}  # fmt: skip


def simulink() -> bytes:
    """Structure with time of To Workspace."""
    stream = io.BytesIO()
    signals = np.zeros(3, dtype=[("values", object), ("label", object)])
    for at, (name, values) in enumerate(zip(("pressure_bar", "length_mm", "force_N"), SAMPLES.T, strict=True)):
        signals[at] = (values[:, None], name)
    savemat(stream, {"x": {"time": TIME[:, None], "signals": signals}})
    return stream.getvalue()


def dspace() -> bytes:
    """Recording of ControlDesk: X and Y with Name, Data and Unit."""
    stream = io.BytesIO()
    channels = np.zeros(3, dtype=[("Name", object), ("Data", object), ("Unit", object)])
    for at, (name, unit) in enumerate((("Pressure", "bar"), ("Length", "mm"), ("Force", "N"))):
        channels[at] = (name, SAMPLES[:, at], unit)
    clock = np.zeros(1, dtype=[("Name", object), ("Data", object), ("Unit", object)])
    clock[0] = ("Time", TIME, "s")
    savemat(stream, {"rec1": {"X": clock, "Y": channels, "Description": "rig"}})
    return stream.getvalue()


def tdms() -> bytes:
    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        writer.write_segment(
            [
                ChannelObject(
                    "rig", name, values, properties={"unit_string": unit, "wf_increment": 0.05, "wf_start_offset": 0.0}
                )
                for name, values, unit in zip(
                    ("Pressure", "Length", "Force"), SAMPLES.T, ("bar", "mm", "N"), strict=True
                )
            ]
        )
    return stream.getvalue()


def hdf5() -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values, unit in zip(
            ("Time", "Pressure", "Length", "Force"), (TIME, *SAMPLES.T), ("s", "bar", "mm", "N"), strict=True
        ):
            file.create_dataset(f"rig/{name}", data=values).attrs["units"] = unit
    return stream.getvalue()


BINARY: dict[str, tuple[str, Callable[[], bytes]]] = {
    "Simulink structure": (".mat", simulink),
    "dSPACE recording": (".mat", dspace),
    "TDMS": (".tdms", tdms),
    "HDF5": (".h5", hdf5),
}
FILES = {name: (".csv", text.encode()) for name, text in RECORDINGS.items()} | {
    name: (end, make()) for name, (end, make) in BINARY.items()
}


@pytest.mark.parametrize("logger", FILES)
def test_a_recording_of_a_logger_is_read_at_once(logger, tmp_path):
    ending, content = FILES[logger]
    path = tmp_path / f"rig{ending}"
    path.write_bytes(content)
    recording = read_recording(path, initial_length=0.18)
    np.testing.assert_allclose(recording.time - recording.time[0], TIME, atol=1.1e-3)
    np.testing.assert_allclose(recording.pressure, PRESSURE * 1e5, atol=11)
    np.testing.assert_allclose(recording.contraction, 1 - LENGTH / 180, atol=1e-6)
    np.testing.assert_allclose(recording.force, FORCE, atol=1e-4)


def workbook() -> bytes:
    book = openpyxl.Workbook()
    book.active.append(["Test of a muscle, 12 March"])
    book.active.append(["Pressure (bar)", "Contraction (%)", "Force (N)"])
    for row in POINTS.tolist():
        book.active.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def test_a_workbook_with_deep_xml_is_refused_before_it_is_parsed(tmp_path):
    stream = io.BytesIO(workbook())
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("xl/deep.xml", "<c>" * 1000 + "</c>" * 1000)
    (tmp_path / "deep.xlsx").write_bytes(stream.getvalue())
    with pytest.raises(DatasetError, match="nested") as refused:
        read_dataset(tmp_path / "deep.xlsx")
    assert "CSV" in refused.value.problems[0].remedy


def netcdf() -> bytes:
    """Written by xarray with units of its author."""
    variables = {
        name: ("point", values, {"units": unit})
        for name, values, unit in (("pressure", P, "bar"), ("contraction", C, "%"), ("force", F, "N"))
    }
    return bytes(xr.Dataset(variables).to_netcdf(engine="h5netcdf"))


def matrix() -> bytes:
    stream = io.BytesIO()
    savemat(stream, {"pressure_bar": P, "contraction_percent": C, "force_N": F})
    return stream.getvalue()


GAUGE = POINTS * [100, 0.01, 1e-3]
SHEETS: dict[str, tuple[str, bytes]] = {
    name: (".csv", text.encode(encoding))
    for name, text, encoding in (
        ("English", table("Pressure [bar],Contraction [%],Force [N]", POINTS), "utf-8"),
        ("German", table("Druck [bar];Kontraktion [%];Kraft [N]", POINTS, sep=";", decimal=","), "utf-8"),
        ("German of Windows", table("Überdruck in bar;Verkürzung in %;Zugkraft in N", POINTS, sep=";", decimal=","), "cp1252"),
        ("UTF-16 of Excel", table("Druck (bar)\tKontraktion (%)\tKraft (N)", POINTS, sep="\t", decimal=","), "utf-16"),
        ("SI", table("pressure_Pa,contraction_ratio,force_N", POINTS * [1e5, 0.01, 1]), "utf-8"),
        ("other units", table("p / kPa,eps / -,F / kN", GAUGE, digits=7), "utf-8"),
        ("row of units", table("Pressure;Contraction;Force\nbar;%;N", POINTS, sep=";"), "utf-8"),
        ("row numbers", table("No.,Pressure [bar],Contraction [%],Force [N]", POINTS, [str(i) for i in range(1, 19)]), "utf-8"),
        ("temperature", table("Pressure [bar],Contraction [%],Force [N],Temperature [°C]", np.column_stack([POINTS, 21 + 0 * P])), "utf-8"),
        ("preamble", "Rig 3\nOperator: A. B.\nDate: 12.03.2024\n\n" + table("Pressure [bar],Contraction [%],Force [N]", POINTS), "utf-8"),
        ("set and actual", table("Druck soll [bar];Druck ist [bar];Kontraktion [%];Kraft [N]", np.column_stack([P.round(), POINTS]), sep=";"), "utf-8"),
        ("numpy", table("# pressure_bar contraction_percent force_N", POINTS, sep=" "), "utf-8"),
        ("gram-force", table("Pressure (mmHg),Contraction (%),Force (gf)", POINTS * [750.0616827, 1, 101.9716213], digits=6), "utf-8"),
    )
} | {"workbook": (".xlsx", workbook()), "NetCDF of xarray": (".nc", netcdf()), "MATLAB": (".mat", matrix())}  # fmt: skip


@pytest.mark.parametrize("sheet", SHEETS)
def test_a_table_of_points_is_read_at_once(sheet, tmp_path):
    ending, content = SHEETS[sheet]
    path = tmp_path / f"rig{ending}"
    path.write_bytes(content)
    are_the_points(read_dataset(path))


@pytest.mark.parametrize("form", ["time_s,pressure_bar,force_N\n", "# rig\ntime_s;pressure_bar;force_N\r\n"])
def test_a_table_of_numbers_is_read_in_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    monkeypatch.setattr(texts, "_CHUNK", 128)
    numbers = np.random.default_rng(0).uniform(-9, 9, (400, 3)).round(3)
    end = form.removeprefix(form.rstrip())
    rows = [(";" if ";" in form else ",").join(map(str, row)) for row in numbers.tolist()]
    path = tmp_path / "rig.csv"
    path.write_bytes((form + end.join([*rows, ""])).encode())
    plain = texts.read_numbers(path, {}, "")
    assert plain is not None
    by_line = texts.read_text(path.read_text(), path, {}, "", texts.read_lines)
    np.testing.assert_array_equal([column.cells for column in plain.columns], numbers.T)
    np.testing.assert_array_equal(plain.lines, by_line.lines)
    assert [(column.name, column.unit) for column in plain.columns] == [(x.name, x.unit) for x in by_line.columns]
    assert (plain.words, plain.decimal) == (by_line.words, by_line.decimal)
    for damaged in (f"{rows[0]}x", "1.5", '"1",2,3', ""):
        path.write_bytes((form + end.join([*rows, damaged, *rows])).encode())
        assert texts.read_numbers(path, {}, "") is None
