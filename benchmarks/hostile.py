"""Hostile measurement files: each is read or refused with an error of ours, soon and in little memory; Linux only.

``python benchmarks/hostile.py`` writes files of some 60 kinds (the functions marked `kind`), one after the other, and
reads each in a forked process with `read_dataset` (even seeds) or `read_recording` (odd seeds). A file fails if reading
ends in any other exception, a crash, more than 15 s of processor time or more than 1 GB.
"""

from __future__ import annotations

import argparse
import functools
import io
import os
import resource
import struct
import sys
import tempfile
import traceback
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from mckibben.dataset import read_dataset, read_recording
from mckibben.errors import McKibbenError

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


def sound_mat(count: int, **options: object) -> bytes:
    stream = io.BytesIO()
    table = {name: values[:, None] for name, values in zip(HEADER, columns(count).T, strict=True)}
    savemat(stream, table, **options)  # pyright: ignore[reportArgumentType]
    return stream.getvalue()


def sound_lvm(count: int, comment: str = "") -> bytes:
    start = f"LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n{comment}\nChannels\t4\n***End_of_Header***\n"
    return start.encode() + head(delimiter="\t") + lines(count, "\t")


def netcdf(rng: Rng, count: int) -> File:
    reader = pick(rng, "dataset", "recording")
    return File("rig.nc", place=sound_netcdf(near(rng, count), reader), reader=reader)


@kind
def control_small_netcdf(rng):
    return netcdf(rng, 60)


@kind
def control_three_million_rows(rng):
    return text(head(), lines(3_000_000 - int(rng.integers(1000))))


@kind
def text_blank_lines(rng):
    blank = pick(rng, b"\n", b" \n", b"\r\n", b"\t \n")
    return text(*[head()] * int(rng.integers(2)), blank * (near(rng, 35e6) // len(blank)), lines(3))


@kind
def text_one_line_without_delimiters(rng):
    letter = pick(rng, b"1", b"x", b" ", b"\t")
    return text(*[head()] * int(rng.integers(2)), letter * near(rng, 150e6))


@kind
def text_4097_columns(rng):
    count = 4097 - int(rng.integers(2))
    names = ",".join(f"c{i}" for i in range(count - 4))
    return text(head(names), lines(2000, end=",1" * (count - 4) + "\n"))


@kind
def text_two_million_corrupt_rows(rng):
    row = pick(rng, b"x\n", b"1,2\n", b"1,2,3,4,5\n", b"a,b,c,d\n", b",,,1\n")
    return text(head(), lines(10), row * 2_000_000)


@kind
def text_an_unclosed_quotation_mark(rng):
    """And then quotation marks in each line."""
    row = pick(rng, b'1,"2,3,4\n', b'"\n', b'""",1\n', b'1,2,3,"a ""b\n', b'"1",2,3"\n')
    return text(head(), b'1,2,"3,4\n', row * near(rng, 1e6))


@kind
def text_long_lines_with_quotation_marks(rng):
    return text(head(), (b'"' + b"x" * near(rng, 1e5) + b"\n") * 500)


@kind
def text_groups_of_digits(rng):
    """Cells that a pattern of thousands almost matches."""
    sign = pick(rng, ",", ".", " ", "'")
    cell = "1" + f"{sign}234" * near(rng, 100_000) + pick(rng, "x", "", sign, "5")
    return text(head(delimiter=";"), lines(50, ";"), f"0;2;1;{cell}\n".encode() * 100)


@kind
def text_million_comments(rng):
    many = near(rng, 1e6)
    shape = pick(rng, "# key {}: value\n", "# specimen: {}\n", "%{}\n", "#{}:{}\n")
    return text("".join(shape.format(i, i) for i in range(many)).encode(), head(), lines(20))


@kind
def text_utf32(rng):
    order = pick(rng, "utf-32-le", "utf-32-be")
    mark = "\ufeff".encode(order)
    return text(mark, (pick(rng, "\U0001f600", "1", "\n") * near(rng, 8e6)).encode(order))


@kind
def text_utf16_surrogates(rng):
    pair = pick(rng, b"\x3d\xd8\x00\xde", b"\x00\xd8", b"\x00\xdc", b"\n\x00")
    return text(b"\xff\xfe", (head() + lines(3)).decode().encode("utf-16-le"), pair * near(rng, 5e6))


@kind
def text_nul_bytes(rng):
    share = rng.choice([0.001, 0.009, 0.02])
    content = bytearray(head() + lines(near(rng, 400_000)))
    for at in rng.integers(len(head()), len(content), int(share * len(content))):
        content[at] = 0
    return text(bytes(content))


@kind
def text_numbers_of_a_million_digits(rng):
    digit = pick(rng, "1", "9", "0", "\u0661")
    cell = digit * near(rng, 1e6) + pick(rng, "", ".5", "e5", "e-1000000")
    return text(head(), lines(20), f"0,2,1,{cell}\n".encode() * 20)


@kind
def text_exponents(rng):
    cell = pick(rng, "1e400", "1e-400", "-1e999999999", "1e308", "9e307")
    return text(head(), lines(20), f"0,2,1,{cell}\n".encode() * int(rng.choice([1, 20, 1_000_000])))


@kind
def text_carriage_returns(rng):
    """Line ends of three kinds, or carriage returns alone."""
    rows = lines(near(rng, 200_000)).split(b"\n")
    ends = [b"\r", b"\r\n", b"\n", b"\n\r", b"\x0b", b"\x1c", b"\xc2\x85"][: rng.choice([1, 4, 7])]
    return text(*(row + ends[i % len(ends)] for i, row in enumerate([head()[:-1], *rows[:-1]])))


@kind
def text_bad_utf8(rng):
    bad = pick(rng, b"\xff", b"\x81", b"\xc3", b"\xed\xa0\x80", b"\xf4\x90\x80\x80")
    return text(head("note"), lines(near(rng, 200_000), end=",\n").replace(b",\n", b"," + bad + b"\n"))


@kind
def text_random_flips(rng):
    sound = head() + lines(near(rng, 100_000))
    return text(flipped(sound, rng) if rng.integers(2) else flipped(sound, rng, 0, 60))


@kind
def text_the_same_header_again_and_again(rng):
    return text((head() + lines(1)) * near(rng, 300_000))


@kind
def text_many_directions(rng):
    """A million different words where a few are expected."""
    name, many = pick(rng, "direction", "phase", "repeat", "set_pressure_bar"), near(rng, 400_000)
    rows = lines(many).split(b"\n")
    return text(head(name), *(b"%s,w%d\n" % (row, i) for i, row in enumerate(rows[:-1])))


@kind
def lvm_segments(rng):
    return text(sound_lvm(3), b"***End_of_Header***\n1\t2\n" * near(rng, 1e5), name="rig.lvm")


@kind
def lvm_header_without_end(rng):
    row = pick(rng, b"Channels\t4\n", b"\t" * 1000 + b"\n", b"***End_of_Heade\n", b"x")
    return text(b"LabVIEW Measurement\n", row * (near(rng, 3e7) // len(row)), name="rig.lvm")


ENDINGS = ("csv", "nc", "h5", "mat", "xlsx", "tdms", "lvm")


def special(rng: Rng, place: Callable[[Path], object], meanwhile: Callable[[Path], list[str]] | None = None) -> File:
    return File(f"rig.{ENDINGS[rng.integers(len(ENDINGS))]}", place=place, meanwhile=meanwhile)


def link(target: str) -> Callable[[Path], object]:
    return lambda path: path.symlink_to(target)


@kind
def path_pipe_without_a_writer(rng):
    return special(rng, os.mkfifo)


@kind
def path_device_zero(rng):
    return special(rng, link("/dev/zero"))


@kind
def path_link_to_itself(rng):
    return special(rng, lambda path: path.symlink_to(path.name))


@kind
def path_directory(rng):
    return special(rng, Path.mkdir)


def sparse(size: int, start: bytes) -> Callable[[Path], object]:
    def place(path: Path) -> None:
        path.write_bytes(start)
        os.truncate(path, size)

    return place


@kind
def path_sparse_file(rng):
    """Of 100 GB: zeros behind the first bytes of some format."""
    starts = (
        b"",
        head() + lines(9),
        sound_hdf5(20),
        sound_mat(20),
        sound_tdms(20),
        b"PK\x03\x04",
        struct.pack("<i", 0),
    )
    return special(rng, sparse(near(rng, 1e11), starts[rng.integers(len(starts))]))


XML = b'<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'


MAIN = b'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'


OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"


PACKAGE = "http://schemas.openxmlformats.org/package/2006"


TYPE = "application/vnd.openxmlformats-officedocument.spreadsheetml"


ROOM = 30_000_000  # bytes of a part


def header_row() -> bytes:
    cells = b"".join(b'<c t="inlineStr"><is><t>%s</t></is></c>' % name.encode() for name in HEADER)
    return b'<row r="1">' + cells + b"</row>"


def rows(count: int, start: int = 2) -> bytes:
    return b"".join(
        b'<row r="%d">' % (start + i) + b"".join(b"<c><v>%.10g</v></c>" % value for value in row) + b"</row>"
        for i, row in enumerate(columns(count).tolist())
    )


def sheet(*content: bytes, before: bytes = b"", after: bytes = b"") -> bytes:
    data = b"".join([header_row(), rows(20), *content])
    return (
        XML + b"<worksheet " + MAIN + b">" + before + b"<sheetData>" + data + b"</sheetData>" + after + b"</worksheet>"
    )


def relations(targets: Sequence[tuple[str, str]]) -> bytes:
    each = "".join(
        f'<Relationship Id="rId{i}" Type="{OFFICE}/{what}" Target="{target}"/>'
        for i, (what, target) in enumerate(targets)
    )
    return XML + f'<Relationships xmlns="{PACKAGE}/relationships">{each}</Relationships>'.encode()


def parts(
    first: bytes, targets: Sequence[str] = ("worksheets/sheet1.xml",), more: bytes = b"", **others: bytes
) -> dict[str, bytes]:
    """Parts of a workbook by name; `others` are styles, sharedStrings and so on."""
    names = {"styles": "styles", "sharedStrings": "sharedStrings", "theme": "theme"}
    linked = [("worksheet", target) for target in targets] + [(names[name], f"{name}.xml") for name in others]
    sheets = "".join(f'<sheet name="s{i}" sheetId="{i + 1}" r:id="rId{i}"/>' for i in range(len(targets)))
    types = [("xl/workbook.xml", "sheet.main"), *((f"xl/{target}", "worksheet") for target in targets)]
    types += [(f"xl/{name}.xml", name) for name in others]
    kinds = "".join(
        f'<Override PartName="/{name}" ContentType="{TYPE}.{what}+xml"/>' for name, what in dict(types).items()
    )
    return {
        "[Content_Types].xml": XML + f'<Types xmlns="{PACKAGE}/content-types">{kinds}</Types>'.encode(),
        "_rels/.rels": relations([("officeDocument", "xl/workbook.xml")]),
        "xl/_rels/workbook.xml.rels": relations(linked),
        "xl/workbook.xml": XML + b"<workbook " + MAIN + f' xmlns:r="{OFFICE}"><sheets>{sheets}</sheets>'.encode()
        + more + b"</workbook>",
        "xl/worksheets/sheet1.xml": first,
        **{f"xl/{name}.xml": content for name, content in others.items()},
    }  # fmt: skip


def zipped(content: Mapping[str, bytes], rng: Rng, padded: bool = True) -> File:
    """Workbook; noise in it keeps its ratio small, so that no limit of the ratio refuses it."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in content.items():
            archive.writestr(name, part)
        if padded:
            archive.writestr("xl/media/image1.png", rng.bytes(sum(map(len, content.values())) // 200), 0)
    return File(pick(rng, "rig.xlsx", "rig.xlsm"), stream.getvalue())


def book(rng: Rng, *content: bytes, padded: bool = True, **more: bytes) -> File:
    return zipped(parts(sheet(*content), **more), rng, padded)  # pyright: ignore[reportArgumentType]


def filled(piece: bytes, size: float = ROOM) -> bytes:
    return piece * max(1, int(size) // len(piece))


@kind
def xlsx_bomb(rng):
    """One part of gigabytes, of which the directory tells the truth."""
    content = parts(sheet())
    stream = io.BytesIO(zipped(content, rng, padded=False).content)
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive:
        name = pick(rng, "xl/worksheets/sheet2.xml", "xl/media/image1.png", "docProps/core.xml")
        archive.writestr(name, bytes(near(rng, 4e8)))
    return File("rig.xlsx", stream.getvalue())


@kind
def xlsx_in_xlsx(rng):
    content = zipped(parts(sheet()), rng).content
    for _ in range(20):
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for i in range(10):
                archive.writestr(f"xl/worksheets/sheet{i}.xml", content)
        content = stream.getvalue()[: 10**6]
    return zipped({**parts(sheet()), "xl/embeddings/book.xlsx": content, "xl/worksheets/sheet1.xml": content}, rng)


def directory(content: bytes) -> tuple[int, bytes]:
    """Place of the central directory of a zip file, and the directory."""
    size, at = struct.unpack_from("<2I", content, len(content) - 10)
    return at, content[at : at + size]


def with_directory(content: bytes, entries: Sequence[bytes]) -> bytes:
    at, _ = directory(content)
    joined, count = b"".join(entries), min(len(entries), 65535)
    return content[:at] + joined + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, count, count, len(joined), at, 0)


def entries(content: bytes) -> list[bytes]:
    found, rest = [], directory(content)[1]
    while rest:
        size = 46 + sum(struct.unpack_from("<3H", rest, 28))
        found, rest = [*found, rest[:size]], rest[size:]
    return found


@kind
def xlsx_parts_that_overlap(rng):
    """Hundreds of sheets whose directory entries all lead to one squeezed part."""
    count = near(rng, 250)
    content = parts(sheet(rows(near(rng, 4000))), [f"worksheets/sheet{i + 1}.xml" for i in range(count)])
    file = zipped({**content, "xl/media/image2.png": rng.bytes(10**6)}, rng)
    all_of = entries(file.content)
    one = next(entry for entry in all_of if b"sheet1.xml" in entry)
    named = [b"xl/worksheets/sheet%d.xml" % (i + 1) for i in range(1, count)]
    copies = [one[:28] + struct.pack("<H", len(name)) + one[30:46] + name for name in named]
    return File("rig.xlsx", with_directory(file.content, [*all_of, *copies]))


@kind
def xlsx_directory_that_lies(rng):
    """On the sizes, checksums, methods or places of parts."""
    content = book(rng, filled(b"<row/>", pick(rng, 1e3, 3e8)), padded=False).content
    changed = []
    for entry in entries(content):
        data = bytearray(entry)
        at = pick(rng, 10, 16, 20, 24, 42)
        value = pick(rng, 0, 1, 12, 99, 1000, 2**31, 2**32 - 1)
        if rng.integers(2) or b"sheet1.xml" in entry:
            struct.pack_into("<H" if at == 10 else "<I", data, at, value % (2**16 if at == 10 else 2**32))
        changed.append(bytes(data))
    return File("rig.xlsx", with_directory(content, changed))


@functools.lru_cache(1)
def crowded(count: int) -> bytes:
    return zipped(
        {**parts(sheet()), **{f"x{i}{'.xml' * (i % 2)}": b"" for i in range(count)}}, np.random.default_rng()
    ).content


@kind
def xlsx_65000_members(rng):
    return File(pick(rng, "rig.xlsx", "rig.xlsm", "rig.zip"), crowded(65_000))


@kind
def xlsx_shared_texts(rng):
    """As many as find room: empty, one of countless runs, or nested."""
    piece = pick(rng, b"<si/>", b"<si><t/></si>", b"<si><r><t>a</t></r></si>", b"<si><phoneticPr fontId='0'/></si>")
    inner = pick(rng, filled(piece), b"<si>" + filled(b"<r><t>a</t></r>") + b"</si>")
    return book(rng, sharedStrings=XML + b"<sst " + MAIN + b">" + inner + b"</sst>")


@kind
def xlsx_billion_laughs(rng):
    depth, times = int(rng.integers(5, 30)), int(rng.integers(2, 12))
    defined = [b'<!ENTITY a0 "' + b"ha" * 50 + b'">']
    defined += [b'<!ENTITY a%d "' % i + b"&a%d;" % (i - 1) * times + b'">' for i in range(1, depth)]
    start = b"<!DOCTYPE x [" + b"".join(defined) + b"]>"
    start = pick(rng, start, b'<!DOCTYPE x [<!ENTITY a%d SYSTEM "file:///dev/zero">]>' % (depth - 1))
    cell = b'<row><c t="inlineStr"><is><t>&a%d;</t></is></c></row>' % (depth - 1)
    return zipped(parts(sheet(cell).replace(XML, XML + start)), rng)


@kind
def xlsx_rows_far_below(rng):
    """Rows whose number is a billion, decreases, or is none."""
    numbers = pick(rng, (10**9,), (1_048_576,), (1_048_575, 1_048_577), (2, 1, 2), (-1,), (10**30,), ("x",))
    return book(rng, *(f'<row r="{at}"><c><v>1</v></c></row>'.encode() for at in numbers))


@kind
def xlsx_one_endless_cell(rng):
    start, end = pick(
        rng, (b"<c><v>", b"</v></c>"), (b'<c t="inlineStr"><is><t>', b"</t></is></c>"), (b"<c><f>", b"</f></c>"),
        (b"<c r='", b"'/>"), (b'<c t="d"><v>', b"</v></c>"),
    )  # fmt: skip
    return book(rng, b"<row>", start, pick(rng, b"1", b"x") * near(rng, 2e8), end, b"</row>")


@kind
def xlsx_deep_xml(rng):
    tag = pick(rng, b"row", b"c", b"x")
    depth = pick(rng, 1000, 1_000_000)
    return book(rng, b"<%s>" % tag * depth + b"</%s>" % tag * depth)


@kind
def xlsx_many_attributes(rng):
    attributes = b"".join(b' a%d="%d"' % (i, i) for i in range(pick(rng, 1000, 400_000)))
    return book(rng, b"<row" + attributes + b"><c" + attributes + b"/></row>")


PLACES = ("rig.h5", "rig.nc", "rig.mat")


def made(rng: Rng, add: Callable[[h5py.File], object], name: str = "", **more: object) -> File:
    """A sound file to which something is added: HDF5, NetCDF or MATLAB 7.3."""
    name = name or pick(rng, *PLACES)
    if name == "rig.nc":
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            more.setdefault("reader", pick(rng, "dataset", "recording"))
            sound_netcdf(60, str(more["reader"]))(path)
            stream = io.BytesIO(path.read_bytes())
    else:
        stream = io.BytesIO(sound_hdf5(60, matlab=name == "rig.mat"))
    mark = stream.getvalue()[:128] if name == "rig.mat" else b""
    with h5py.File(stream, "r+", libver="latest" if rng.integers(2) else None) as file:
        add(file)
        if name == "rig.nc" and rng.integers(4):
            give_dimensions(file)
    return File(name, mark + stream.getvalue()[len(mark) :], **more)  # pyright: ignore[reportArgumentType]


def give_dimensions(file: h5py.File) -> None:
    """Make each dataset that has none its own dimension, so that it is a variable of NetCDF."""
    for name in list(file)[:100]:
        node = file[name] if isinstance(file.get(name, getlink=True), h5py.HardLink) else None
        if isinstance(node, h5py.Dataset) and not node.is_scale and "DIMENSION_LIST" not in node.attrs:
            node.make_scale()


def target(rng: Rng, file: h5py.File) -> str:
    """Name for a hostile dataset: in place of a column that is read, or besides."""
    name = pick(rng, "force", "force_N", "pressure_bar", "extra", "deep/in/groups")
    if name in file:
        del file[name]
    return name


def bomb(file: Any, name: str, total: float, dtype: str = "f8", squeezed: bool = True, **options: Any) -> Any:
    """Dataset of so many bytes, each of whose chunks is the same squeezed one; or whose chunks are never written."""
    size = min(2**24, max(8, int(total)))
    shape, chunk = (int(total) // np.dtype(dtype).itemsize,), (size // np.dtype(dtype).itemsize,)
    node = file.create_dataset(name, shape, dtype, chunks=chunk, compression="gzip", **options)
    content = packed(size, bool(options.get("shuffle")), dtype)
    for at in range(0, shape[0] if squeezed else 0, chunk[0]):
        node.id.write_direct_chunk((at,), content)
    return node


@functools.lru_cache(8)
def packed(size: int, noisy: bool, dtype: str) -> bytes:
    """A squeezed chunk: zeros, or with a little noise in it, for a smaller ratio."""
    data = bytearray(size)
    if noisy:
        data[:: 2**13] = bytes(range(1, 256)) * (len(data[:: 2**13]) // 255) + bytes(len(data[:: 2**13]) % 255)
    return zlib.compress(bytes(data), 9)


@kind
def hdf5_nested_filters(rng):
    """A chunk squeezed twice or three times: ratios of a million."""
    times, size = int(rng.integers(2, 4)), 2**27

    def add(file: h5py.File) -> None:
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((size // 8,))
        content = bytes(size)
        for _ in range(times):
            plist.set_deflate(9)
            content = zlib.compress(content, 9)
        count = near(rng, 300)
        space = h5py.h5s.create_simple((count * size // 8,))
        name = target(rng, file).replace("/", "_").encode()
        node = h5py.h5d.create(file.id, name, h5py.h5t.NATIVE_DOUBLE, space, plist)
        for at in range(count):
            node.write_direct_chunk((at * size // 8,), content)

    return made(rng, add)


@kind
def hdf5_many_small_bombs(rng):
    """Each below any limit of one dataset."""
    count = near(rng, 60)

    def add(file: h5py.File) -> None:
        for i in range(count):
            bomb(file, f"x{i:05}", 2**25)

    return made(rng, add, pick(rng, "rig.h5", "rig.mat"))


@kind
def hdf5_contiguous_without_storage(rng):
    shape = pick(rng, (2**40,), (2**20, 2**20), (2**59,), (2**31, 1), (6_000_000,))
    return made(rng, lambda file: file.create_dataset(target(rng, file), shape, pick(rng, "u1", "f8", "S8")))


@functools.lru_cache(1)
def crowd(name: str, count: int) -> File:
    """A file of very many datasets, in one group."""

    def add(file: h5py.File) -> None:
        space = h5py.h5s.create_simple((2,))
        for i in range(count):
            h5py.h5d.create(file.id, b"c%d" % i, h5py.h5t.NATIVE_DOUBLE, space)

    return made(np.random.default_rng(0), add, name)


@kind
def hdf5_hundred_thousand_datasets(rng):
    file = crowd("rig.h5", 100_000)
    return File(pick(rng, "rig.h5", "rig.hdf5", "rig.dat"), file.content)


@kind
def hdf5_deep_groups(rng):
    depth = pick(rng, 15, 25, 3000)

    def add(file: h5py.File) -> None:
        group: Any = file
        for _ in range(depth):
            group = group.create_group("g")
        group["force_N"] = columns(60)[:, 3]

    return made(rng, add)


@kind
def hdf5_links_in_circles(rng):
    """Hard and soft links: a group in itself, or groups that all hold each other."""
    count = int(rng.integers(1, 20))

    def add(file: h5py.File) -> None:
        groups = [file.create_group(f"g{i}") for i in range(count)]
        for group in groups:
            for i, other in enumerate(groups):
                group[f"l{i}"] = other if rng.integers(2) else h5py.SoftLink(other.name)
        file["root"] = file["/"]
        file["soft"] = h5py.SoftLink("/soft")

    return made(rng, add)


@kind
def hdf5_links_to_elsewhere(rng):
    """External links, external storage and virtual datasets: of devices, other files, itself."""
    other = pick(rng, "/dev/zero", "/dev/urandom", "/proc/self/mem", "/etc/passwd", "rig.h5", "/dev/ptmx")

    def external(file: h5py.File, name: str) -> None:
        file[name] = h5py.ExternalLink(other, "/force")

    def storage(file: h5py.File, name: str) -> None:
        file.create_dataset(name, (10**6,), "f8", external=[(other, 0, h5py.h5f.UNLIMITED)])

    def virtual(file: h5py.File, name: str) -> None:
        layout = h5py.VirtualLayout((10**9,), "f8")
        layout[:] = h5py.VirtualSource(pick(rng, other, "."), "force", (10**9,))
        file.create_virtual_dataset(name, layout)

    add = pick(rng, external, storage, virtual)
    return made(rng, lambda file: add(file, target(rng, file)))


@kind
def hdf5_huge_attributes(rng):
    """Few large or many small ones, of the file or of a column."""
    large = bool(rng.integers(2))

    def add(file: h5py.File) -> None:
        file.create_dataset("Pressure [bar]", data=np.arange(6.0))
        node = pick(rng, file, file["Pressure [bar]"])
        for i in range(2 if large else near(rng, 20_000)):
            name = pick(rng, "units", "unit", "title") + (str(i) if i else "")
            node.attrs.create(name, np.zeros(near(rng, 3e7), "u1") if large else float(i))

    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="latest") as file:  # else attributes have at most 64 kB
        add(file)
    return File("rig.h5", stream.getvalue())


@kind
def mat73_cells_that_refer_to_a_bomb(rng):
    """Many cells with one reference, to a bomb, to a group, to the cells themselves, or to nothing."""
    size, count, what = pick(rng, 1e6, 6e7, 3e8), near(rng, 20_000), int(rng.integers(4))

    def add(file: h5py.File) -> None:
        node = bomb(file, "#refs#/a", size, "u2")
        cells = file.create_dataset("direction", (1, count), h5py.ref_dtype)
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        cells[...] = [node.ref, file["#refs#"].ref, cells.ref, h5py.Reference()][what]

    return made(rng, add, "rig.mat")


@kind
def hdf5_compound_types(rng):
    """Thousands of fields, arrays in arrays, enumerations: of no file with columns."""
    many = np.dtype([(f"f{i}", "f8") for i in range(near(rng, 600))])
    array = np.dtype([("a", "f8", (64, 64)), ("b", "S1000")])
    enum = h5py.enum_dtype({f"e{i}": i for i in range(near(rng, 3000))}, "i4")
    vlen = h5py.vlen_dtype(np.dtype("f8"))
    dtype = pick(rng, many, array, enum, vlen)
    return made(rng, lambda file: file.create_dataset(target(rng, file), (near(rng, 800),), dtype))


@kind
def netcdf_bomb(rng):
    """In the place of a variable that is read, or besides."""
    size, dtype = pick(rng, 6e7, 1e9, 1e10), pick(rng, "f8", "u1", "i2")

    def add(file: h5py.File) -> None:
        name = pick(rng, "force", "pressure", "extra")
        attrs = dict(file[name].attrs) if name in file else {}
        if name in file:
            del file[name]
        bomb(file, name, size, dtype, squeezed=bool(rng.integers(2))).attrs["units"] = attrs.get("units", "N")

    return made(rng, add, "rig.nc")


MATLAB = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"


CELL, STRUCT, TEXT, SPARSE, DOUBLE = 1, 2, 4, 5, 6


EMPTY = struct.pack("<2I", 14, 0)


def element(number_type: int, content: bytes) -> bytes:
    return struct.pack("<2I", number_type, len(content) % 2**32) + content + bytes(-len(content) % 8)


def array(kind_of: int, dims: Sequence[int], name: str, *content: bytes, flags: int = 0) -> bytes:
    shape = element(6, b"".join(struct.pack("<I", size % 2**32) for size in dims))
    start = element(6, struct.pack("<2I", kind_of | flags, 0)) + shape + element(1, name.encode())
    return element(14, start + b"".join(content))


def squeezed(content: bytes) -> bytes:
    data = zlib.compress(content, 9)
    return struct.pack("<2I", 15, len(data)) + data


def mat(rng: Rng, *content: bytes, noise: bool = False) -> File:
    """File with sound columns and others; with noise, if its size is to permit more."""
    doubles = zip(HEADER, columns(20).T, strict=True)
    sound = [array(DOUBLE, (20, 1), name, element(9, values.tobytes())) for name, values in doubles]
    more = [array(DOUBLE, (1, 10**5), "noise", element(9, rng.bytes(8 * 10**5)))] if noise else []
    return File("rig.mat", b"".join([MATLAB, *sound, *more, *content]))


@kind
def mat5_bomb(rng):
    size = near(rng, pick(rng, 1e9, 6e7, 6.6e7)) // 8 * 8
    return mat(rng, squeezed(array(DOUBLE, (size // 8, 1), "x", element(9, bytes(size)))))


@kind
def mat5_many_bombs(rng):
    size, count = pick(rng, 10**6, 10**5), near(rng, 3000)
    bombs = [squeezed(array(DOUBLE, (size, 1), f"x{i}", element(2, bytes(size)))) for i in range(10)]
    return mat(rng, *(bombs * (count // 10)), noise=True)


@kind
def mat5_squeezed_in_squeezed(rng):
    content = array(DOUBLE, (10**6, 1), "x", element(2, bytes(10**6)))
    for _ in range(near(rng, 500)):
        content = squeezed(content)
    return mat(rng, content)


@kind
def mat5_dimensions_overflow(rng):
    dims = pick(rng, (2**31, 2**31), (2**31 - 1, 2**31 - 1), (65536, 65536), (0, 2**31), (-1, -1), (2**16,) * 8)
    return mat(rng, array(pick(rng, CELL, STRUCT, TEXT, DOUBLE), dims, "x", element(9, bytes(8 * near(rng, 100)))))


@kind
def mat5_cells_deep(rng):
    content = array(DOUBLE, (1, 1), "", element(9, bytes(8)))
    for _ in range(pick(rng, 15, 25, 1000)):
        content = array(CELL, (1, 1), "", content)
    return mat(rng, pick(rng, content, squeezed(content)))


@kind
def mat5_millions_of_empty_cells(rng):
    """Of 8 bytes each, in a few kilobytes."""
    count = near(rng, 6.5e6)
    return mat(rng, squeezed(array(CELL, (count, 1), "direction", EMPTY * count)))


@kind
def mat5_struct_of_a_million_fields(rng):
    count = near(rng, 1e6)
    names = element(5, struct.pack("<i", 8)) + element(1, b"".join(b"f%07d" % i for i in range(count)))
    value = pick(rng, EMPTY, array(DOUBLE, (2, 1), "", element(2, b"\1\2")))
    inner = array(STRUCT, (1, 1), "s", names, value * count)
    return mat(rng, squeezed(inner) if len(inner) < 6e7 else inner)


@kind
def mat5_sparse(rng):
    """With wrong row numbers and column starts."""
    row, start = struct.pack("<3i", 2**30, -1, 7), struct.pack("<4i", 0, 2**31 - 1, -5, 3)
    content = element(5, row) + element(5, start) + element(9, bytes(24))
    return mat(rng, array(SPARSE, (3, 3), pick(rng, "x", "force_N2"), content, flags=pick(rng, 0, 0x0800)))


META, NEW, RAW = 2, 4, 8


def worded(name: str) -> bytes:
    return struct.pack("<I", len(name)) + name.encode()


def channel(name: str, index: bytes | None, properties: Sequence[tuple[str, int, bytes]] = ()) -> bytes:
    """Object of a segment: path, raw index (None: no data), properties of a name, type and value."""
    path = f"/'rig'/'{name}'"
    raw = struct.pack("<I", 2**32 - 1) if index is None else index
    values = (worded(key) + struct.pack("<I", of) + value for key, of, value in properties)
    return worded(path) + raw + struct.pack("<I", len(properties)) + b"".join(values)


def plain_index(count: int, number_type: int = 10, dimension: int = 1) -> bytes:
    return struct.pack("<3IQ", 20, number_type, dimension, count % 2**64)


def segment(
    objects: Sequence[bytes], raw: bytes = b"", flags: int = META | NEW | RAW, after: int | None = None
) -> bytes:
    meta = struct.pack("<I", len(objects)) + b"".join(objects) if flags & META else b""
    sizes = (len(meta) + len(raw) if after is None else after, len(meta))
    return b"TDSm" + struct.pack("<2I2Q", flags, 4712, *sizes) + meta + raw


def tdms(*segments: bytes) -> File:
    return File("rig.tdms", b"".join([sound_tdms(20), *segments]))


@kind
def tdms_endless_samples(rng):
    index = plain_index(pick(rng, 2**60, 2**63, 2**64 - 1, 2**40, 2**31), pick(rng, 1, 2, 10, 0, 0x44, 0x20, 0x08000C))
    return tdms(segment([channel("force_N", index)], bytes(80), after=pick(rng, None, 2**64 - 1, 2**62, 0, 10)))


@kind
def tdms_values_of_no_width(rng):
    """Which cost nothing in the file."""
    count = pick(rng, 1000, 10**6, 10**9)
    return tdms(segment([channel("x", plain_index(count, 0))], bytes(pick(rng, 0, near(rng, 10**6)))))


@kind
def tdms_many_segments(rng):
    flags = pick(rng, 0, RAW, META, META | NEW, META | RAW)
    return tdms(
        segment([channel("force_N", struct.pack("<I", 0))] if rng.integers(2) else [], flags=flags) * near(rng, 300_000)
    )


@kind
def tdms_counts_that_lie(rng):
    """Numbers of objects and properties, and lengths of texts, of billions."""
    data = bytearray(segment([channel("force_N", plain_index(2), [("unit_string", 0x20, worded("N"))])], bytes(16)))
    struct.pack_into("<I", data, pick(rng, 28, 32, 48, 52, 56, 72, 76), pick(rng, 2**32 - 1, 2**31, 10**6, 10**8))
    return tdms(bytes(data))


@kind
def tdms_flags_at_random(rng):
    data = bytearray(sound_tdms(60))
    struct.pack_into("<I", data, 4, int(rng.integers(0, 2**9)))
    return File("rig.tdms", bytes(data))


SECONDS, MEMORY = 15, 10**9  # processor time, and bytes


def outcome(path: Path, options: dict[str, float], read: Callable[..., object]) -> tuple[str, float, float]:
    """Read a file in a forked process: how it ended, processor time [s] and memory [bytes]."""
    pid = os.fork()
    if not pid:
        resource.setrlimit(resource.RLIMIT_CPU, (2 * SECONDS, 2 * SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (6 * 10**9, 6 * 10**9))
        os._exit(status(path, options, read))
    _, state, used = os.wait4(pid, 0)
    ended = {0: "read", 1: "refused"}.get(os.waitstatus_to_exitcode(state), "traceback or crash")
    seconds, memory = used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss
    if seconds > SECONDS:
        ended = "too long"
    elif memory > MEMORY:
        ended = "too large"
    return ended, seconds, memory


def status(path: Path, options: dict[str, float], read: Callable[..., object]) -> int:
    """0 for a file that is read, 1 for one that is refused, 2 for any other end."""
    try:
        read(path, **options)
    except McKibbenError:
        return 1
    except BaseException:
        traceback.print_exc()
        return 2
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--files", type=int, default=len(KINDS), metavar="N", help="number of files of all kinds together"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=sorted(KINDS), metavar="KIND")
    options = parser.parse_args()
    kinds, counts = options.only or [*KINDS], Counter()
    for index in range(options.files if not options.only else len(kinds)):
        name, seed = kinds[index % len(kinds)], options.seed + index // len(kinds)
        reader = read_recording if seed % 2 else read_dataset
        with tempfile.TemporaryDirectory() as folder:
            file = KINDS[name](np.random.default_rng([seed, *name.encode()]))
            ended, seconds, memory = outcome(file.write(Path(folder)), file.options, reader)
        counts[ended] += 1
        if ended not in ("read", "refused") or seconds > 5:
            print(f"{name} {seed}: {ended}, {seconds:.1f} s, {memory / 1e6:.0f} MB", flush=True)
    print(", ".join(f"{count} {ended}" for ended, count in counts.items()))
    return 0 if set(counts) <= {"read", "refused"} else 1


if __name__ == "__main__":
    sys.exit(main())
