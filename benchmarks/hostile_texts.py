"""Kinds of hostile texts and LVM files, and of paths that lead to no usual file."""

from __future__ import annotations

import io
import os
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hostile_kinds import (
    File,
    Rng,
    flipped,
    head,
    kind,
    lines,
    near,
    pick,
    sound_hdf5,
    sound_lvm,
    sound_mat,
    sound_tdms,
    text,
)

# Texts


@kind
def text_blank_lines(rng):
    blank = pick(rng, b"\n", b" \n", b"\r\n", b"\t \n")
    return text(*[head()] * int(rng.integers(2)), blank * (near(rng, 35e6) // len(blank)), lines(3))


@kind
def text_two_million_points_without_order(rng):
    """Each pressure occurs once, twice or thrice: as many levels, and strokes of two points."""
    count, each = near(rng, 2e6), int(rng.integers(1, 4))
    pressure = np.repeat(np.linspace(1, 7, count // each + 1), each)[:count]
    table = np.stack([np.arange(count), pressure, rng.uniform(0, 25, count), rng.uniform(0, 600, count)], axis=1)
    stream = io.BytesIO()
    np.savetxt(stream, table, fmt="%.7g", delimiter=",")
    return text(head(), stream.getvalue())


@kind
def text_one_line_without_delimiters(rng):
    letter = pick(rng, b"1", b"x", b" ", b"\t")
    return text(*[head()] * int(rng.integers(2)), letter * near(rng, 150e6))


@kind
def text_one_line_of_delimiters(rng):
    cell = pick(rng, b"1,", b"x;", b"1\t", b"a b ")
    return text(*[head()] * int(rng.integers(2)), cell * (near(rng, 110e6) // len(cell)))


@kind
def text_4097_columns(rng):
    count = 4097 - int(rng.integers(2))
    names = ",".join(f"c{i}" for i in range(count - 4))
    return text(head(names), lines(2000, end=",1" * (count - 4) + "\n"))


@kind
def text_a_million_cells_in_each_row(rng):
    return text(head(), lines(10), (b"1" + b",1" * near(rng, 1e6) + b"\n") * 10)


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
def text_header_of_brackets(rng):
    """Header, or 60 lines searched for one, where each word opens a bracket that nothing closes."""
    word = pick(rng, "a ( ", "a [ ", "a\t(\t", "a (x ", "in [ / ")
    line = (word * (near(rng, 200_000) // len(word)) + "\n").encode()
    return text(line * int(rng.choice([1, 60])), lines(5))


@kind
def text_header_of_units(rng):
    """Names just shorter than the longest that are parsed, thousands of them."""
    name = pick(rng, "p in ", "p / ", "x [", "force_", "Pressure (", " _ ")
    cells = [(name * 50)[: rng.integers(150, 200)] for _ in range(1200)]
    return text(";".join(cells).encode() + b"\n", b";".join([b"bar"] * 1200) + b"\n", lines(5))


@kind
def text_million_comments(rng):
    many = near(rng, 1e6)
    shape = pick(rng, "# key {}: value\n", "# specimen: {}\n", "%{}\n", "#{}:{}\n")
    return text("".join(shape.format(i, i) for i in range(many)).encode(), head(), lines(20))


@kind
def text_long_comment(rng):
    name = pick(rng, "specimen", "source", "slack_force", "initial_length", "preprocessing", "x")
    cell = pick(rng, "x", "1", "0.", "1 ", "\u202e")
    return text(f"# {name}: {cell * near(rng, 20e6)}\n".encode(), head(), lines(20))


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
def text_row_numbers_that_are_none(rng):
    """One cell more than the header in each row: row numbers of 5000 digits, or of other digits."""
    number = pick(rng, "7" * 5000, "²", "١", "①")
    return text(head(delimiter=";"), f"{number};0;2;1;100\n".encode() * 20)


@kind
def text_exponents(rng):
    cell = pick(rng, "1e400", "1e-400", "-1e999999999", "1e308", "9e307")
    return text(head(), lines(20), f"0,2,1,{cell}\n".encode() * int(rng.choice([1, 20, 1_000_000])))


@kind
def text_only_delimiters(rng):
    sign = pick(rng, b",", b";", b"\t", b'"', b"|")
    return text(*[head()] * int(rng.integers(2)), (sign * near(rng, 50) + b"\n") * 500_000)


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
def text_ambiguous_numbers(rng):
    return text(head(delimiter=";"), b"1;2;1,234;3,456\n" * near(rng, 1e6))


@kind
def text_many_directions(rng):
    """A million different words where a few are expected."""
    name, many = pick(rng, "direction", "phase", "repeat", "set_pressure_bar"), near(rng, 400_000)
    rows = lines(many).split(b"\n")
    return text(head(name), *(b"%s,w%d\n" % (row, i) for i, row in enumerate(rows[:-1])))


@kind
def text_reversals_in_each_row(rng):
    """Contractions and pressures that jump to and fro, so that each row is a ramp or a level of its own."""
    many = near(rng, 1_000_000)
    values = np.stack(
        [np.arange(many) * 10, rng.uniform(1, 6, many), rng.uniform(0, 15, many), rng.uniform(0, 900, many)]
    )
    stream = io.StringIO()
    np.savetxt(stream, values.T, "%.4g", ",")
    return text(head(), stream.getvalue().encode())


# LVM


@kind
def lvm_segments(rng):
    return text(sound_lvm(3), b"***End_of_Header***\n1\t2\n" * near(rng, 1e5), name="rig.lvm")


@kind
def lvm_header_without_end(rng):
    row = pick(rng, b"Channels\t4\n", b"\t" * 1000 + b"\n", b"***End_of_Heade\n", b"x")
    return text(b"LabVIEW Measurement\n", row * (near(rng, 3e7) // len(row)), name="rig.lvm")


@kind
def lvm_long_header(rng):
    """Lines without number before the channels, and names for ever."""
    label = pick(rng, "\n", "Y_Unit_Label\t" + "N\t" * 1_000_000, "Comment\t" + "x" * 20_000_000)
    return text(sound_lvm(20, label * (near(rng, 1e7) if label == "\n" else 1)), name="rig.lvm")


@kind
def lvm_comment_column(rng):
    rows = lines(near(rng, 500_000), "\t", pick(rng, "\n", "\t\n", "\tx\n", "\t\t\t\n"))
    start = sound_lvm(0).removesuffix(head(delimiter="\t"))
    return text(start, head("Comment", delimiter="\t"), rows, name="rig.lvm")


# Paths

ENDINGS = ("csv", "nc", "h5", "mat", "xlsx", "tdms", "lvm")


def special(rng: Rng, place: Callable[[Path], object], meanwhile: Callable[[Path], list[str]] | None = None) -> File:
    return File(f"rig.{ENDINGS[rng.integers(len(ENDINGS))]}", place=place, meanwhile=meanwhile)


def link(target: str) -> Callable[[Path], object]:
    return lambda path: path.symlink_to(target)


@kind
def path_pipe_without_a_writer(rng):
    return special(rng, os.mkfifo)


@kind
def path_pipe_with_an_endless_writer(rng):
    start = ("1", head().decode(), "TDSm", "MATLAB 5.0", "PK\x03\x04")[rng.integers(5)]
    return special(rng, os.mkfifo, lambda path: ["sh", "-c", 'exec yes "$0" > "$1"', start, str(path)])


@kind
def path_device_zero(rng):
    return special(rng, link("/dev/zero"))


@kind
def path_device_random(rng):
    return special(rng, link("/dev/urandom"))


@kind
def path_terminal_or_input(rng):
    return special(rng, link(pick(rng, "/dev/stdin", "/dev/tty", "/dev/ptmx", "/dev/null", "/dev/full")))


@kind
def path_link_to_itself(rng):
    return special(rng, lambda path: path.symlink_to(path.name))


@kind
def path_directory(rng):
    return special(rng, Path.mkdir)


@kind
def path_memory_of_the_process(rng):
    return special(rng, link(pick(rng, "/proc/self/mem", "/proc/self/pagemap", "/proc/self/exe")))


@kind
def path_socket(rng):
    import socket

    return special(rng, lambda path: socket.socket(socket.AF_UNIX).bind(str(path)))


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


GROWS = (
    "import sys\nwith open(sys.argv[1], 'ab', 0) as file:\n while file.tell() < 10**9: file.write(b'0,2,1,9\\n' * 9**5)"
)


@kind
def path_file_that_grows(rng):
    """While it is read, up to 1 GB."""
    sound = head() + lines(near(rng, 200_000))
    return special(rng, lambda path: path.write_bytes(sound), lambda path: [sys.executable, "-c", GROWS, str(path)])
