"""Kinds of hostile files: functions from a random generator to a file. Here are what they share, and the controls.

A kind that is named ``control_...`` is a sound file, which must be read.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

Rng = np.random.Generator


@dataclass(frozen=True)
class File:
    """A file: name, content or function that makes it at a path, command that runs meanwhile, how it is to be read."""

    name: str
    content: bytes = b""
    place: Callable[[Path], object] | None = None
    meanwhile: Callable[[Path], list[str]] | None = None
    options: dict[str, float] = field(default_factory=dict)
    reader: str = ""  # dataset or recording; empty: either

    def write(self, folder: Path) -> Path:
        """Write it to a folder; its path."""
        path = folder / self.name
        if self.place is None:
            path.write_bytes(self.content)
        else:
            self.place(path)
        return path


KINDS: dict[str, Callable[[Rng], File]] = {}


def kind(make: Callable[[Rng], File]) -> Callable[[Rng], File]:
    KINDS[make.__name__] = make
    return make


HEADER = ("time_ms", "pressure_bar", "contraction_percent", "force_N")


def columns(count: int) -> np.ndarray:
    """Sound points, shape (count, 4): a muscle at five pressures in turn, shortened and stretched at each."""
    at = np.arange(count)
    per = -(-count // 5)
    pressure = 2.0 + at // per
    contraction = (15 * (1 - abs(2 * (at % per) / per - 1))).round(2)
    force = 8.2e5 * np.pi / 4 * 0.02**2 * pressure * (1 - contraction / 28) ** 2
    return np.stack([at * 10.0, pressure, contraction, force.round(1)], axis=1)


def lines(count: int, delimiter: str = ",", end: str = "\n", point: str = ".") -> bytes:
    """Sound rows as text, in cells of fixed width."""
    parts = []
    for values, whole, decimals in zip(columns(count).T, (8, 1, 2, 4), (0, 1, 1, 0), strict=True):
        number = np.rint(values * 10**decimals).astype(np.int64)
        digits = number[:, None] // 10 ** np.arange(whole + decimals - 1, -1, -1) % 10 + ord("0")
        sign = [np.full((count, 1), ord(point))] if decimals else []
        parts += [digits[:, :whole], *sign, digits[:, whole:], np.full((count, 1), ord(delimiter))]
    ends = np.tile(np.frombuffer(end.encode(), np.uint8), (count, 1))
    return np.concatenate([*parts[:-1], ends], axis=1).astype(np.uint8).tobytes()


def head(*more: str, delimiter: str = ",", end: str = "\n") -> bytes:
    return (delimiter.join([*HEADER, *more]) + end).encode()


def text(*parts: bytes, name: str = "rig.csv", **more: object) -> File:
    return File(name, b"".join(parts), **more)  # pyright: ignore[reportArgumentType]


def pick(rng: Rng, *values: Any) -> Any:
    return values[rng.integers(len(values))]


def near(rng: Rng, number: float) -> int:
    """A whole number between 80 and 120 % of another."""
    return int(number * rng.uniform(0.8, 1.2))


def flipped(content: bytes, rng: Rng, first: int = 0, last: int | None = None) -> bytes:
    """Content with 1 to 64 bytes changed between two places."""
    data, end = bytearray(content), len(content) if last is None else min(last, len(content))
    for at in rng.integers(first, end, 2 ** rng.integers(0, 7)):
        data[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, data[at] ^ 1 << rng.integers(8)])
    return bytes(data)


def cut(content: bytes, rng: Rng) -> bytes:
    return content[: rng.integers(1, len(content))]


def damage(name: str, sound: Callable[[Rng], bytes], file_name: str) -> None:
    """Kinds of damaged files: flipped in the first kilobytes, anywhere, and cut off."""
    KINDS[f"{name}_head_flipped"] = lambda rng: File(file_name, flipped(sound(rng), rng, 0, 4096))
    KINDS[f"{name}_flipped"] = lambda rng: File(file_name, flipped(sound(rng), rng))
    KINDS[f"{name}_cut_off"] = lambda rng: File(file_name, cut(sound(rng), rng))


def sound_hdf5(count: int, *, matlab: bool = False, rng: Rng | None = None) -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512 if matlab else 0) as file:
        for name, values in zip(HEADER, columns(count).T, strict=True):
            packed = {"compression": "gzip", "shuffle": bool(rng and rng.random() < 0.5), "chunks": True}
            node = file.create_dataset(name, data=values[None, :] if matlab else values, **(packed if rng else {}))
            node.attrs["MATLAB_class"] = np.bytes_("double")
    mark = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    return mark + stream.getvalue()[128:] if matlab else stream.getvalue()


def sound_netcdf(count: int, reader: str) -> Callable[[Path], object]:
    from mckibben.dataset import IsobaricDataset, Recording

    time, pressure, contraction, force = columns(count).T
    si = {"time": time / 1e3, "pressure": pressure * 1e5, "contraction": contraction / 100, "force": force}
    if reader == "recording":
        return Recording.of(**si).to_netcdf
    return IsobaricDataset.of(**si, direction=["loading"] * count).to_netcdf


def sound_tdms(count: int) -> bytes:
    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        channels = zip(HEADER, columns(count).T, strict=True)
        writer.write_segment([ChannelObject("rig", name, values) for name, values in channels])
    return stream.getvalue()


def sound_xlsx(count: int) -> bytes:
    book, stream = openpyxl.Workbook(write_only=True), io.BytesIO()
    sheet = book.create_sheet("rig")
    sheet.append(HEADER)
    for row in columns(count).tolist():
        sheet.append(row)
    book.save(stream)
    return stream.getvalue()


def sound_mat(count: int, **options: object) -> bytes:
    stream = io.BytesIO()
    table = {name: values[:, None] for name, values in zip(HEADER, columns(count).T, strict=True)}
    savemat(stream, table, **options)  # pyright: ignore[reportArgumentType]
    return stream.getvalue()


def sound_lvm(count: int, comment: str = "") -> bytes:
    start = f"LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n{comment}\nChannels\t4\n***End_of_Header***\n"
    return start.encode() + head(delimiter="\t") + lines(count, "\t")


# Controls: a small and a large file of each format, and texts of several shapes


def controls(name: str, small: int, large: int, make: Callable[[int, Rng], bytes], file_name: str) -> None:
    for size, count in (("small", small), ("large", large)):
        KINDS[f"control_{size}_{name}"] = lambda rng, count=count: File(file_name, make(near(rng, count), rng))


controls("csv", 60, 100_000, lambda n, rng: head() + lines(n), "rig.csv")
controls("xlsx", 60, 30_000, lambda n, rng: sound_xlsx(n), "rig.xlsx")
controls("mat5", 60, 300_000, lambda n, rng: sound_mat(n, do_compression=bool(rng.integers(2))), "rig.mat")
controls("mat4", 60, 300_000, lambda n, rng: sound_mat(n, format="4"), "rig.mat")
controls("mat73", 60, 300_000, lambda n, rng: sound_hdf5(n, matlab=True, rng=rng), "rig.mat")
controls("hdf5", 60, 300_000, lambda n, rng: sound_hdf5(n, rng=rng), "rig.h5")
controls("tdms", 60, 300_000, lambda n, rng: sound_tdms(n), "rig.tdms")
controls("lvm", 60, 100_000, lambda n, rng: sound_lvm(n), "rig.lvm")
controls("tabs", 60, 100_000, lambda n, rng: head(delimiter="\t", end="\r\n") + lines(n, "\t", "\r\n"), "rig.txt")
controls("decimal_commas", 60, 100_000, lambda n, rng: head(delimiter=";") + lines(n, ";", point=","), "rig.csv")
controls("utf16", 60, 100_000, lambda n, rng: (head() + lines(n)).decode().encode("utf-16"), "rig.csv")


def netcdf(rng: Rng, count: int) -> File:
    reader = pick(rng, "dataset", "recording")
    return File("rig.nc", place=sound_netcdf(near(rng, count), reader), reader=reader)


@kind
def control_small_netcdf(rng):
    return netcdf(rng, 60)


@kind
def control_large_netcdf(rng):
    return netcdf(rng, 100_000)


@kind
def control_three_million_rows(rng):
    return text(head(), lines(3_000_000 - int(rng.integers(1000))))


@kind
def control_many_rows_with_a_word(rng):
    word = pick(rng, b"ok", b"measured again", b"\xc3\xbc")
    count = near(rng, 350_000)
    return text(head("note"), lines(count, end=f",{word.decode()}\n"))


@kind
def control_many_comments_and_a_quoted_cell(rng):
    comments = b"".join(b"# note %d: as before\n" % i for i in range(rng.integers(10, 1000)))
    return text(comments, head("note"), lines(near(rng, 100), end=',"a ""b"", c"\n'))


@kind
def control_a_file_name_with_a_line_end(rng):
    return text(head(), lines(near(rng, 60)), name="rig\n\x1b[31m of Monday.csv")
