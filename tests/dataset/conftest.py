"""The same six points in every kind of file that is read."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from mckibben.dataset import IsobaricDataset, read_dataset
from mckibben.dataset.quantities import LEAVE_OUT
from mckibben.errors import DatasetError

PRESSURE = np.array([1.0, 2, 3, 4, 5, 6])  # bar
CONTRACTION = np.array([0, 2.5, 5, 7.5, 10, 12.5])  # percent
FORCE = np.array([50.5, 90, 120, 150.25, 180, 200])  # N
DIRECTION = ["loading", "loading", "unloading", "unloading", "loading", "unloading"]
COLUMNS = {"pressure_bar": PRESSURE, "contraction_percent": CONTRACTION, "force_N": FORCE}


def mat(*, compressed: bool) -> bytes:
    rig = {name: values[:, None] for name, values in COLUMNS.items()}
    direction = np.array(DIRECTION, dtype=object)[:, None]
    stream = io.BytesIO()
    savemat(stream, {"rig": rig, "fs": 1000.0, "direction": direction}, do_compression=compressed)
    return stream.getvalue()


def mat4() -> bytes:
    stream = io.BytesIO()
    savemat(stream, {name: values[:, None] for name, values in COLUMNS.items()}, format="4")
    return stream.getvalue()


def mat73() -> bytes:
    """As MATLAB writes it: columns are rows, texts are references to codes."""
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as file:
        rig = file.create_group("rig")
        rig.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in COLUMNS.items():
            rig.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        words = file.create_group("#refs#")
        cells = [
            words.create_dataset(str(i), data=np.array([[ord(letter)] for letter in word], np.uint16)).ref
            for i, word in enumerate(DIRECTION)
        ]
        direction = file.create_dataset("direction", data=np.array([cells], dtype=h5py.ref_dtype))
        direction.attrs["MATLAB_class"] = np.bytes_("cell")
    return b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + stream.getvalue()[128:]


def hdf5() -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values, unit in (
            ("Pressure", PRESSURE, "bar"),
            ("Contraction", CONTRACTION, "%"),
            ("Force", FORCE, "N"),
        ):
            file.create_dataset(f"rig/{name}", data=values).attrs["units"] = unit
    return stream.getvalue()


def tdms() -> bytes:
    stream = io.BytesIO()
    columns = (("Pressure", PRESSURE, "bar"), ("Contraction", CONTRACTION, "%"), ("Force", FORCE, "N"))
    with TdmsWriter(stream) as writer:
        writer.write_segment(
            [
                ChannelObject("rig", name, values, properties={"unit_string": unit, "wf_increment": 0.5})
                for name, values, unit in columns
            ]
        )
    return stream.getvalue()


def xlsx() -> bytes:
    book = openpyxl.Workbook()
    sheet = book.active
    for row in (["Rig 3"], [], ["No", "Pressure", "Contraction", "Force", "Direction"], [None, "bar", "%", "N", None]):
        sheet.append(row)
    for i, row in enumerate(zip(PRESSURE, CONTRACTION, FORCE, DIRECTION, strict=True)):
        sheet.append([i + 1, *row])
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def text() -> bytes:
    """Semicolons, decimal commas, and headers that are not ours."""
    rows = [
        f"{p:g};{f:g};x;{c:g};{d}\n".replace(".", ",")
        for p, f, c, d in zip(PRESSURE, FORCE, CONTRACTION, DIRECTION, strict=True)
    ]
    return ("Pressure (bar);Force [N];p / x;Contraction [%];Direction\n" + "".join(rows)).encode()


def lvm() -> bytes:
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\n***End_of_Header***\t\n\t\nChannels\t3\n"
        "Samples\t6\t6\t6\nY_Unit_Label\tbar\t%\tN\nX_Dimension\tTime\tTime\tTime\n***End_of_Header***\t\n"
        "X_Value\tPressure\tContraction\tForce\tComment\n"
    )
    rows = zip(PRESSURE, CONTRACTION, FORCE, strict=True)
    return (head + "".join(f"{i / 2:f}\t{p:f}\t{c:f}\t{f:f}\n" for i, (p, c, f) in enumerate(rows))).encode()


FILES = {
    "compressed.mat": mat(compressed=True),
    "plain.mat": mat(compressed=False),
    "version4.mat": mat4(),
    "version73.mat": mat73(),
    "rig.h5": hdf5(),
    "rig.tdms": tdms(),
    "rig.xlsx": xlsx(),
    "rig.csv": text(),
    "utf16.csv": text().decode().encode("utf-16"),
    "rig.lvm": lvm(),
}


@pytest.fixture
def put(tmp_path) -> Callable[[str | bytes, str], Path]:
    """Write a file."""

    def write(content: str | bytes, name: str = "rig.csv") -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def is_the_six_points(data: IsobaricDataset) -> None:
    np.testing.assert_allclose(data.pressure, PRESSURE * 1e5)
    np.testing.assert_allclose(data.contraction, CONTRACTION / 100)
    np.testing.assert_allclose(data.force, FORCE)


def said_of(path: Path, read=read_dataset, **more) -> list[str]:
    """The problems of a file, without the remedy of all corrupt rows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(DatasetError) as caught:
            read(path, **more)
    assert caught.value.source == str(path)
    return [str(problem).removesuffix(f"; correct it{LEAVE_OUT}") for problem in caught.value.problems]
