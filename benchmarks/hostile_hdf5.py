"""Kinds of hostile HDF5, NetCDF and MATLAB 7.3 files."""

from __future__ import annotations

import functools
import io
import struct
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from hostile_kinds import HEADER, KINDS, File, Rng, columns, damage, kind, near, pick, sound_hdf5, sound_netcdf

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


def hdf5(total: float, dtype: str = "f8", squeezed: bool = True, **options: Any) -> Callable[[Rng], File]:
    """Kind of files with one bomb."""

    def make(rng: Rng) -> File:
        return made(rng, lambda file: bomb(file, target(rng, file), near(rng, total), dtype, squeezed, **options))

    return make


KINDS["hdf5_bomb_of_10_gb"] = hdf5(1e10)
KINDS["hdf5_bomb_of_bytes"] = hdf5(8e8, "u1")
KINDS["hdf5_bomb_of_bits_that_become_doubles"] = hdf5(2.5e8, "i1")
KINDS["hdf5_bomb_just_below_the_ratio"] = hdf5(1.5e9, shuffle=True)
KINDS["hdf5_chunks_never_written"] = hdf5(1e11, squeezed=False, fillvalue=1.0)
KINDS["hdf5_chunks_never_written_just_below"] = hdf5(5.5e7, "u1", squeezed=False, fillvalue=1)


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
def hdf5_other_filters(rng):
    """Fletcher 32, LZF, scale and offset, with damaged chunks."""
    options = pick(rng, {"fletcher32": True}, {"compression": "lzf"}, {"scaleoffset": 1}, {"shuffle": True})

    def add(file: h5py.File) -> None:
        node = file.create_dataset(target(rng, file), (2**22,), "i4", chunks=(2**18,), **options)
        for at in range(0, 2**22, 2**18):
            node.id.write_direct_chunk((at,), rng.bytes(near(rng, 30_000)))

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


@kind
def hdf5_small_chunks(rng):
    """Of one value each, millions declared, none or thousands written."""
    count, written = near(rng, 6e6), int(rng.choice([0, 20_000]))

    def add(file: h5py.File) -> None:
        node = file.create_dataset(target(rng, file), (count,), "f8", chunks=(1,))
        for at in range(written):
            node.id.write_direct_chunk((at,), bytes(8))

    return made(rng, add)


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
def netcdf_ten_thousand_variables(rng):
    return crowd("rig.nc", 10_000)


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
def hdf5_one_bomb_with_many_names(rng):
    """Ten thousand hard links to one dataset."""
    size, count = pick(rng, 1e4, 1e6, 6e7), near(rng, 10_000)

    def add(file: h5py.File) -> None:
        node = bomb(file, "first", size)
        for i in range(count):
            file[f"c{i}"] = node

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


def texts(rng: Rng, long: bool) -> tuple[bytes, int]:
    """A file of texts of variable length, and where their references are: 16 bytes each."""
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values in zip(HEADER, columns(60).T, strict=True):
            file[name] = values
        words = ["x" * (near(rng, 1e6) if long else 20), *["y"] * near(rng, 50_000)]
        node = file.create_dataset(pick(rng, "direction", "pressure_bar2"), data=words, dtype=h5py.string_dtype())
        file[HEADER[1]].attrs["unit"] = "bar"
        at = node.id.get_offset()
    return stream.getvalue(), int(at)


@kind
def hdf5_texts_that_are_all_one(rng):
    """Each of 50,000 texts refers to the same megabyte."""
    content, at = texts(rng, True)
    count = (len(content) - at) // 16
    count = min(count, 40_000)
    return File(
        pick(rng, "rig.h5", "rig.mat"), content[:at] + content[at : at + 16] * count + content[at + 16 * count :]
    )


@kind
def hdf5_damaged_heaps(rng):
    """Sizes and indexes in heaps of texts are changed, as in a heap where the library loops."""
    content, _ = texts(rng, False)
    data, places = bytearray(content), [i for i in range(len(content)) if content.startswith(b"GCOL", i)]
    for place in places[: rng.integers(1, 4)]:
        at = place + 8 * int(rng.integers(1, 8))
        struct.pack_into("<Q", data, at, pick(rng, 0, 1, 57, 2**31, 2**63, 2**64 - 1, len(content)))
    return File(pick(rng, "rig.h5", "rig.nc", "rig.mat"), bytes(data))


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
def mat73_a_million_cells(rng):
    """Each refers to a word of its own, or to the same."""
    count = pick(rng, 50_000, 1_000_000)

    def add(file: h5py.File) -> None:
        word = file.create_dataset("#refs#/a", data=np.array([[111], [107]], np.uint16))
        cells = file.create_dataset(
            "direction", data=np.full((1, count), word.ref, h5py.ref_dtype), dtype=h5py.ref_dtype
        )
        cells.attrs["MATLAB_class"] = np.bytes_("cell")

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
def hdf5_many_dimensions(rng):
    shape = pick(rng, (1,) * 32, (2,) * 24, (0, 2**40), (2**12, 2**12), (1, 2**24), (64, 2**17), ())
    return made(
        rng, lambda file: file.create_dataset(target(rng, file), shape, "u1", compression="gzip" if shape else None)
    )


@kind
def hdf5_user_block(rng):
    """Of 512 bytes and more: text, another format, a second file."""
    start = pick(
        rng, b"TDSm", b"PK\x03\x04", b"MATLAB 5.0", b"MATLAB 7.3", b"time_s,pressure_bar\n", b"\x89HDF\r\n\x1a\n"
    )
    stream, size = io.BytesIO(), pick(rng, 512, 1024, 2**20)
    with h5py.File(stream, "w", userblock_size=size) as file:
        for name, values in zip(HEADER, columns(60).T, strict=True):
            file[name] = values
    return File(pick(rng, *PLACES, "rig.csv", "rig.xlsx"), start + stream.getvalue()[len(start) :])


def sound_nc(rng: Rng) -> bytes:
    return made(rng, lambda file: None, "rig.nc").content


damage("hdf5", lambda rng: sound_hdf5(near(rng, 200), rng=pick(rng, rng, None)), "rig.h5")
damage("mat73", lambda rng: sound_hdf5(near(rng, 200), matlab=True), "rig.mat")
damage("netcdf", sound_nc, "rig.nc")


@kind
def hdf5_one_word_of_the_head_changed(rng):
    """An aligned word of the file claims a large number: sizes, addresses, counts."""
    data = bytearray(sound_hdf5(60, matlab=False))
    at = 8 * int(rng.integers(1, 400))
    struct.pack_into("<Q", data, at, pick(rng, 2**64 - 1, 2**63, 2**40, 2**31, at, 0))
    return File(pick(rng, "rig.h5", "rig.nc"), bytes(data))


# NetCDF


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


@kind
def netcdf_scales_in_circles(rng):
    """Dimension scales of dimension scales, of themselves, of the wrong length, or none."""
    what = int(rng.integers(5))

    def add(file: h5py.File) -> None:
        scales = [file.create_dataset(f"d{i}", data=np.arange(near(rng, 60))) for i in range(6)]
        for scale in scales:
            mark = pick(rng, "x", "", "point") if what else "This is a netCDF dimension but not a netCDF variable."
            scale.make_scale(mark)
        for i, node in enumerate(scales):
            kind_of = h5py.h5t.py_create(h5py.vlen_dtype(h5py.ref_dtype), logical=True)
            attribute = h5py.h5a.create(node.id, b"DIMENSION_LIST", kind_of, h5py.h5s.create_simple((1,)))
            references = np.empty(1, h5py.vlen_dtype(h5py.ref_dtype))
            references[0] = np.array([scales[(i + 1) % 6].ref] * near(rng, 3), h5py.ref_dtype)
            attribute.write(references)
            if what > 2:
                node.attrs["_Netcdf4Dimid"] = np.int32(pick(rng, -1, 0, 2**31 - 1))
        if what > 3:
            file["force"].attrs["_Netcdf4Coordinates"] = np.arange(near(rng, 7000), dtype="i4")

    return made(rng, add, "rig.nc")


@kind
def netcdf_attributes_that_decode(rng):
    """Packing, times and fill values that a decoder applies: huge arrays, texts, infinities."""
    name = pick(rng, "scale_factor", "add_offset", "_FillValue", "missing_value", "units", "calendar", "dtype")
    value = pick(rng, np.zeros(5000), np.inf, "days since 1e400", np.bytes_("x" * 60_000), 2**63 - 1, "bool")

    def add(file: h5py.File) -> None:
        node = file[pick(rng, "force", "time", "pressure")]
        if name in node.attrs:
            del node.attrs[name]
        node.attrs[name] = value
        if rng.integers(2):
            node.attrs["coordinates"] = "force " * 9000

    return made(rng, add, "rig.nc")


@kind
def netcdf_coded_attributes(rng):
    """Attributes of our own with numbers that cannot be, and texts of megabytes."""

    def add(file: h5py.File) -> None:
        for name in ("slack_force", "initial_length", "specimen", "source", "preprocessing", "sha256", "checksum"):
            file.attrs[name] = pick(rng, np.nan, -1, "x" * 60_000, np.zeros(9), 1e308, True)

    return made(rng, add, "rig.nc")
