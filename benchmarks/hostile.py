"""Hostile measurement files: each is read or refused with an error of ours, soon and in little memory; Linux only.

``python benchmarks/hostile.py`` writes files of some 30 kinds (the functions marked `kind`), one after the other, and
reads each in a forked process with `read_dataset` (even seeds) or `read_recording` (odd seeds). A file fails if reading
ends in any other exception, a crash, more than 15 s of processor time or more than 1 GB.
"""

from __future__ import annotations

import argparse
import functools
import io
import json
import os
import resource
import struct
import sys
import tempfile
import traceback
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
from mcap.writer import Writer
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
def text_two_million_corrupt_rows(rng):
    row = pick(rng, b"x\n", b"1,2\n", b"1,2,3,4,5\n", b"a,b,c,d\n", b",,,1\n")
    return text(head(), lines(10), row * 2_000_000)


@kind
def text_an_unclosed_quotation_mark(rng):
    """And then quotation marks in each line."""
    row = pick(rng, b'1,"2,3,4\n', b'"\n', b'""",1\n', b'1,2,3,"a ""b\n', b'"1",2,3"\n')
    return text(head(), b'1,2,"3,4\n', row * near(rng, 1e6))


@kind
def text_groups_of_digits(rng):
    """Cells that a pattern of thousands almost matches."""
    sign = pick(rng, ",", ".", " ", "'")
    cell = "1" + f"{sign}234" * near(rng, 100_000) + pick(rng, "x", "", sign, "5")
    return text(head(delimiter=";"), lines(50, ";"), f"0;2;1;{cell}\n".encode() * 100)


@kind
def text_many_directions(rng):
    """A million different words where a few are expected."""
    name, many = pick(rng, "direction", "phase", "repeat", "set_pressure_bar"), near(rng, 400_000)
    rows = lines(many).split(b"\n")
    return text(head(name), *(b"%s,w%d\n" % (row, i) for i, row in enumerate(rows[:-1])))


@kind
def lvm_segments(rng):
    return text(sound_lvm(3), b"***End_of_Header***\n1\t2\n" * near(rng, 1e5), name="rig.lvm")


ENDINGS = ("csv", "nc", "h5", "mat", "xlsx", "tdms", "lvm", "mcap")


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


def sound_xlsx(count: int) -> bytes:
    book, stream = openpyxl.Workbook(), io.BytesIO()
    for row in [HEADER, *columns(count).tolist()]:
        book.active.append(row)
    book.save(stream)
    return stream.getvalue()


def book(content: bytes, start: bytes = b"", **parts: bytes) -> File:
    """A sound workbook with more XML at the end and the start of its sheet, and more parts."""
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(sound_xlsx(20))) as sound,
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in sound.namelist():
            part = sound.read(name)
            if name.endswith("sheet1.xml"):
                part = start + part.replace(b"</sheetData>", content + b"</sheetData>")
            new.writestr(name, part)
        for name, part in parts.items():
            new.writestr(f"xl/{name}.xml", part)
    return File("rig.xlsx", stream.getvalue())


@kind
def xlsx_bomb(rng):
    """One part of gigabytes, of which the directory tells the truth."""
    return book(b"", image=bytes(near(rng, 4e8)))


@kind
def xlsx_billion_laughs(rng):
    depth, times = int(rng.integers(5, 30)), int(rng.integers(2, 12))
    defined = [b'<!ENTITY a0 "' + b"ha" * 50 + b'">']
    defined += [b'<!ENTITY a%d "' % i + b"&a%d;" % (i - 1) * times + b'">' for i in range(1, depth)]
    start = b"<!DOCTYPE x [" + b"".join(defined) + b"]>"
    start = pick(rng, start, b'<!DOCTYPE x [<!ENTITY a%d SYSTEM "file:///dev/zero">]>' % (depth - 1))
    return book(b'<row><c t="inlineStr"><is><t>&a%d;</t></is></c></row>' % (depth - 1), start)


@kind
def xlsx_one_endless_cell(rng):
    return book(b"<row><c><v>" + pick(rng, b"1", b"x") * near(rng, 2e8) + b"</v></c></row>")


@kind
def xlsx_deep_xml(rng):
    tag, depth = pick(rng, b"row", b"c", b"x"), pick(rng, 1000, 1_000_000)
    return book(b"<%s>" % tag * depth + b"</%s>" % tag * depth)


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


@functools.lru_cache(8)
def packed(size: int, noisy: bool, dtype: str) -> bytes:
    """A squeezed chunk: zeros, or with a little noise in it, for a smaller ratio."""
    data = bytearray(size)
    if noisy:
        data[:: 2**13] = bytes(range(1, 256)) * (len(data[:: 2**13]) // 255) + bytes(len(data[:: 2**13]) % 255)
    return zlib.compress(bytes(data), 9)


@kind
def hdf5_contiguous_without_storage(rng):
    shape = pick(rng, (2**40,), (2**20, 2**20), (2**59,), (2**31, 1), (6_000_000,))
    return made(rng, lambda file: file.create_dataset(target(rng, file), shape, pick(rng, "u1", "f8", "S8")))


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
def hdf5_compound_types(rng):
    """Thousands of fields, arrays in arrays, enumerations: of no file with columns."""
    many = np.dtype([(f"f{i}", "f8") for i in range(near(rng, 600))])
    array = np.dtype([("a", "f8", (64, 64)), ("b", "S1000")])
    enum = h5py.enum_dtype({f"e{i}": i for i in range(near(rng, 3000))}, "i4")
    vlen = h5py.vlen_dtype(np.dtype("f8"))
    dtype = pick(rng, many, array, enum, vlen)
    return made(rng, lambda file: file.create_dataset(target(rng, file), (near(rng, 800),), dtype))


@kind
def mat5_bomb(rng):
    stream = io.BytesIO()
    savemat(stream, {"force_N": np.zeros((near(rng, pick(rng, 3e6, 7e6)), 1))}, do_compression=True)
    return File("rig.mat", stream.getvalue())


def sound_mcap(count: int) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=1000)
    writer.start()
    channel = writer.register_channel("/rig", "json", 0)
    for at, row in enumerate(columns(count).tolist()):
        writer.add_message(channel, at * 10**7, json.dumps(dict(zip(HEADER, row, strict=True))).encode(), at * 10**7)
    writer.finish()
    return stream.getvalue()


SOUND: dict[str, Callable[[int], bytes]] = {
    "csv": lambda count: head() + lines(count),
    "h5": sound_hdf5,
    "lvm": sound_lvm,
    "mat": sound_mat,
    "mcap": sound_mcap,
    "tdms": sound_tdms,
    "xlsx": sound_xlsx,
}


def damaged(ending: str, rng: Rng) -> File:
    """A sound file with bytes changed, numbers made huge, its end cut off, or a part repeated."""
    data = bytearray(SOUND[ending](60))
    for at in rng.integers(0, len(data) - 8, 2 ** rng.integers(0, 6)):
        data[at] ^= 1 << rng.integers(8)
    for at in rng.integers(0, len(data) // 4, rng.integers(0, 3)):
        struct.pack_into("<I", data, int(4 * at), pick(rng, 2**31 - 1, 2**32 - 1, 10**6, 0))
    first, last = sorted(rng.integers(0, len(data), 2))
    return File(f"rig.{ending}", bytes(pick(rng, data, data[:last], data[:last] + data[first:last] * 50)))


for _ending in SOUND:
    KINDS[f"damaged_{_ending}"] = functools.partial(damaged, _ending)


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
