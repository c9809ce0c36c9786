"""Kinds of hostile MATLAB files up to version 7, and of TDMS files."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import numpy as np
from hostile_kinds import HEADER, File, Rng, columns, damage, kind, near, pick, sound_mat, sound_tdms

# MATLAB 5

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
def mat5_bytes_as_doubles(rng):
    """A compressed vector of bytes, which are doubles when read."""
    size = near(rng, 5e7)
    name = pick(rng, "x", "force_raw")
    return mat(rng, squeezed(array(DOUBLE, (size, 1), name, element(pick(rng, 1, 2), bytes(size)))))


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
def mat5_no_values_of_many_dimensions(rng):
    dims = pick(rng, (0,) * 1000, (1,) * 100_000, (0, 2**30, 2**30), (1,) * 64)
    return mat(rng, array(DOUBLE, dims, "x", element(9, bytes(8 * (0 not in dims)))))


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
def mat5_millions_of_structs(rng):
    count, fields = near(rng, 6e6), pick(rng, (b"a",), (b"a", b"b", b"c"), ())
    names = element(5, struct.pack("<i", 1)) + element(1, b"".join(fields))
    return mat(rng, squeezed(array(STRUCT, (count // max(1, len(fields)), 1), "s", names, EMPTY * count)))


@kind
def mat5_struct_of_a_million_fields(rng):
    count = near(rng, 1e6)
    names = element(5, struct.pack("<i", 8)) + element(1, b"".join(b"f%07d" % i for i in range(count)))
    value = pick(rng, EMPTY, array(DOUBLE, (2, 1), "", element(2, b"\1\2")))
    inner = array(STRUCT, (1, 1), "s", names, value * count)
    return mat(rng, squeezed(inner) if len(inner) < 6e7 else inner)


@kind
def mat5_long_texts(rng):
    """Of rare letters, each of which takes room of its own."""
    count = near(rng, 2.5e7)
    text = element(4, struct.pack("<H", pick(rng, 0x4E00, 0x61, 0xD800)) * count)
    return mat(rng, squeezed(array(TEXT, (1, count), "x", text)))


@kind
def mat5_thousands_of_columns(rng):
    shape = (pick(rng, 2, 1000, 10_000), pick(rng, 64, 65, 4096))
    content = element(2, bytes(shape[0] * shape[1]))
    return mat(rng, *(squeezed(array(DOUBLE, shape, f"m{i}", content)) for i in range(near(rng, 70))), noise=True)


@kind
def mat5_sparse(rng):
    """With wrong row numbers and column starts."""
    row, start = struct.pack("<3i", 2**30, -1, 7), struct.pack("<4i", 0, 2**31 - 1, -5, 3)
    content = element(5, row) + element(5, start) + element(9, bytes(24))
    return mat(rng, array(SPARSE, (3, 3), pick(rng, "x", "force_N2"), content, flags=pick(rng, 0, 0x0800)))


@kind
def mat5_many_variables(rng):
    one = array(DOUBLE, (1, 1), "x", element(2, b"\1"))
    return mat(rng, pick(rng, one, EMPTY, squeezed(one)) * near(rng, 200_000))


@kind
def mat4_negative_dimensions(rng):
    start = struct.pack(
        "<5i", 0, pick(rng, -1, 2**31 - 1, 3), pick(rng, -3, 2**31 - 1, 0), 0, pick(rng, 2, -1, 2**31 - 1)
    )
    return File("rig.mat", start + b"x\0" + bytes(100))


@kind
def mat4_bytes_as_doubles(rng):
    size = near(rng, 5e7)
    return File("rig.mat", struct.pack("<5i", 50, size, 1, 0, 2) + b"x\0" + bytes(size))


@kind
def mat4_millions_of_variables(rng):
    return File(
        "rig.mat", (struct.pack("<5i", 0, *pick(rng, (0, 0), (1, 0), (0, 2**31 - 1)), 0, 2) + b"x\0") * near(rng, 1e6)
    )


damage("mat5", lambda rng: sound_mat(near(rng, 60), do_compression=pick(rng, True, False)), "rig.mat")
damage("mat4", lambda rng: sound_mat(near(rng, 60), format="4"), "rig.mat")


# TDMS

META, NEW, RAW, INTERLEAVED, BIG, DAQMX = 2, 4, 8, 32, 64, 128


def worded(name: str) -> bytes:
    return struct.pack("<I", len(name)) + name.encode()


def channel(name: str, index: bytes | None, properties: Sequence[tuple[str, int, bytes]] = ()) -> bytes:
    """Object of a segment: path, raw index (None: no data), properties of a name, type and value."""
    path = f"/'rig'/'{name}'"
    raw = struct.pack("<I", 2**32 - 1) if index is None else index
    each = (worded(key) + struct.pack("<I", of) + value for key, of, value in properties)
    return worded(path) + raw + struct.pack("<I", len(properties)) + b"".join(each)


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
def tdms_index_of_many_channels(rng):
    many = near(rng, pick(rng, 100_000, 400_000))
    index, raw = pick(rng, (None, 0), (plain_index(0), 0), (plain_index(1, 5), many))
    return tdms(segment([channel(f"c{i}", index) for i in range(many)], bytes(raw)))


@kind
def tdms_many_segments(rng):
    flags = pick(rng, 0, RAW, META, META | NEW, META | RAW)
    return tdms(
        segment([channel("force_N", struct.pack("<I", 0))] if rng.integers(2) else [], flags=flags) * near(rng, 300_000)
    )


@kind
def tdms_segments_times_channels(rng):
    """A segment of thousands of channels, and thousands of segments that repeat them, or change one."""
    many = near(rng, 5000)
    first = segment([channel(f"c{i}", plain_index(1, 5)) for i in range(many)], bytes(many))
    again = pick(rng, segment([], b"", RAW), segment([channel("c1", plain_index(1, 5))], b"", META | RAW))
    return tdms(first, again * many)


@kind
def tdms_many_chunks(rng):
    """A channel of one byte, which a segment repeats millions of times."""
    flags = META | NEW | RAW | pick(rng, 0, INTERLEAVED)
    names = ["x", "y"][: rng.integers(1, 3)]
    return tdms(segment([channel(name, plain_index(1, 1)) for name in names], bytes(near(rng, 4e6)), flags))


@kind
def tdms_daqmx(rng):
    """Scalers of no width, of no buffer, and of places outside of it."""
    scalers = [struct.pack("<5I", pick(rng, 3, 5), pick(rng, 0, 7, 2**31), pick(rng, 0, 2**31), 0, i) for i in range(3)]
    widths = [pick(rng, 0, 1, 4, 2**31)] * pick(rng, 0, 1, 3)
    index = struct.pack("<3IQ", pick(rng, 0x1269, 0x126A), 2**32 - 1, 1, pick(rng, 10, 10**6, 2**60))
    index += struct.pack("<I", len(scalers)) + b"".join(scalers)
    index += struct.pack(f"<I{len(widths)}I", len(widths), *widths)
    return tdms(segment([channel("force_N", index)], bytes(near(rng, 1000)), META | NEW | RAW | DAQMX))


@kind
def tdms_properties(rng):
    """Huge texts, countless properties, and some that mean something to a reader."""
    word = pick(rng, "x", "unit_string", "wf_increment", "NI_Number_Of_Scales", "NI_Scale[0]_Scale_Type")
    many, size = pick(rng, (1, 3e7), (300_000, 10), (10, 2e6))
    each = [(f"{word}{i or ''}", 0x20, worded("y" * near(rng, size))) for i in range(many)]
    numbers = [("wf_increment", 10, struct.pack("<d", pick(rng, 0, -1, np.nan, 1e-300)))]
    numbers += [("NI_Number_Of_Scales", 7, struct.pack("<I", pick(rng, 0, 3, 2**31)))]
    return tdms(segment([channel("force_N", plain_index(1), [*each, *numbers])], bytes(8)))


@kind
def tdms_counts_that_lie(rng):
    """Numbers of objects and properties, and lengths of texts, of billions."""
    data = bytearray(segment([channel("force_N", plain_index(2), [("unit_string", 0x20, worded("N"))])], bytes(16)))
    struct.pack_into("<I", data, pick(rng, 28, 32, 48, 52, 56, 72, 76), pick(rng, 2**32 - 1, 2**31, 10**6, 10**8))
    return tdms(bytes(data))


@kind
def tdms_texts(rng):
    """A channel of texts, with offsets that lie."""
    count = pick(rng, 3, 10**5)
    offsets = [pick(rng, 0, 5, 2**32 - 1, 2**31, i) for i in range(count)]
    raw = struct.pack(f"<{count}I", *offsets) + b"x" * near(rng, 1000)
    index = struct.pack("<3I2Q", 28, 0x20, 1, count, pick(rng, len(raw), 2**63, 0))
    return tdms(segment([channel("direction", index)], raw))


@kind
def tdms_flags_at_random(rng):
    data = bytearray(sound_tdms(60))
    struct.pack_into("<I", data, 4, int(rng.integers(0, 2**9)))
    return File("rig.tdms", bytes(data))


damage("tdms", lambda rng: sound_tdms(near(rng, 60)), "rig.tdms")
