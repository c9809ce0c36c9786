"""Mutated files of each format that is read: an error of ours or a dataset, within limits of time and memory.

``python benchmarks/mutate.py --files 10000`` mutates a sound file of each format so many times, in worker processes
that are ended where a file takes longer than 30 s. A failure is printed with its seed, and `--repeat FORMAT SEED` reads
that file again and keeps it. A failure is any exception that is no `McKibbenError`, a file that takes too long or more
than 1 GB, and a text of which rows read and rows listed are not all rows.
"""

from __future__ import annotations

import argparse
import faulthandler
import io
import json
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

SECONDS = 30.0
MEMORY = 10**9  # bytes
CHUNK = 500  # files that a worker process reads
EXAMPLES = Path(__file__).parents[1] / "examples"
WORDS = (
    b"",
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\0\0\0\0",
    b"\0\0\0\x10",
    b"\x01",
    b"nan",
    b'"',
    b"\n",
    b";",
    b"1e999",
    b"1_0",
    b"\x1b[31m",
    b"[[[[[[[[",
    b"&a *a",
    b"!!int ",
    b"- ",
    b": ",
    b"\xc3",
)
TEXTS = ("csv", "semicolon", "tsv")


class Format(NamedTuple):
    """Name of a sound file, its content and its reader."""

    name: str
    content: bytes
    read: Callable[[Path], Any]


def formats() -> dict[str, Callable[[], Format]]:
    """Formats by name; each is made only where it is used."""
    return {
        "csv": lambda: Format("rig.csv", _text(",", "."), _dataset),
        "semicolon": lambda: Format("rig.csv", _text(";", ","), _dataset),
        "tsv": lambda: Format("rig.tsv", _text("\t", "."), _dataset),
        "xlsx": lambda: Format("rig.xlsx", _xlsx(), _dataset),
        "mat5": lambda: Format("rig.mat", _mat(do_compression=False), _dataset),
        "mat5-compressed": lambda: Format("rig.mat", _mat(do_compression=True), _dataset),
        "mat4": lambda: Format("rig.mat", _mat(format="4"), _dataset),
        "mat73": lambda: Format("rig.mat", _hdf5(matlab=True), _dataset),
        "hdf5": lambda: Format("rig.h5", _hdf5(matlab=False), _dataset),
        "netcdf": lambda: Format("rig.nc", _netcdf(), _dataset),
        "tdms": lambda: Format("rig.tdms", _tdms(), _dataset),
        "lvm": lambda: Format("rig.lvm", _lvm(), _dataset),
        "scenario": lambda: Format("s.yaml", (EXAMPLES / "pre-contracted-step-pid.yaml").read_bytes(), _scenario),
        "suite": lambda: Format("comparison/s.yaml", (EXAMPLES / "comparison/knee.yaml").read_bytes(), _suite),
        "protocol": lambda: Format("s.yaml", (EXAMPLES / "rig/paper-protocol.yaml").read_bytes(), _protocol),
        "joint-rig": lambda: Format("s.yaml", (EXAMPLES / "rig/joint-rig.yaml").read_bytes(), _joint_rig),
        "fit": lambda: Format("fit.yaml", _fit(), _read_fit),
        "calibration": lambda: Format("c.json", _calibration(), _calibrations),
    }


COLUMNS = {
    "pressure_bar": np.repeat([1.0, 2.5, 4.0], 10),
    "contraction_percent": np.tile(np.arange(10) * 2.5, 3),
    "force_N": np.arange(30) * 3.25 + 1,
}
CHANNELS = {"force": "N", "pressure": "Pa", "valve": "Pa", "position": "m"}
WAY = ["loading", "unloading"] * 15


def _text(delimiter: str, decimal: str) -> bytes:
    rows = [[f"{value:g}".replace(".", decimal) for value in row] for row in zip(*COLUMNS.values(), strict=True)]
    lines = [[*COLUMNS, "direction"], *([*row, way] for row, way in zip(rows, WAY, strict=True))]
    return "".join(delimiter.join(line) + "\n" for line in lines).encode()


def _xlsx() -> bytes:
    import openpyxl

    book, stream = openpyxl.Workbook(), io.BytesIO()
    book.active.append([*COLUMNS, "direction"])
    for row in zip(*COLUMNS.values(), WAY, strict=True):
        book.active.append([float(cell) if isinstance(cell, float) else cell for cell in row])
    book.save(stream)
    return stream.getvalue()


def _mat(**options: Any) -> bytes:
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, {name: values[:, None] for name, values in COLUMNS.items()}, **options)
    return stream.getvalue()


def _hdf5(*, matlab: bool) -> bytes:
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512 if matlab else 0) as file:
        for name, values in COLUMNS.items():
            data = values[None, :] if matlab else values
            node = file.create_dataset(f"rig/{name}", data=data, chunks=data.shape, compression="gzip")
            node.attrs["MATLAB_class"] = np.bytes_("double")
            node.attrs["note"] = "measured"
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    return head + stream.getvalue()[128:] if matlab else stream.getvalue()


def _netcdf() -> bytes:
    from mckibben import IsobaricDataset

    si = {"pressure": COLUMNS["pressure_bar"] * 1e5, "contraction": COLUMNS["contraction_percent"] / 100}
    data = IsobaricDataset.of(**si, force=COLUMNS["force_N"], direction=WAY, specimen="rig 3", source="rig.csv")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.nc"
        data.table.to_netcdf(path, engine="h5netcdf")  # without a checksum, which would end every test here
        return path.read_bytes()


def _tdms() -> bytes:
    from nptdms import ChannelObject, TdmsWriter

    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        writer.write_segment([ChannelObject("rig", name, values) for name, values in COLUMNS.items()])
    return stream.getvalue()


def _lvm() -> bytes:
    head = "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tOne\n***End_of_Header***\n\n"
    channels = f"Channels\t{len(COLUMNS)}\n***End_of_Header***\n"
    rows = [
        f"{i}\t" + "\t".join(f"{value:g}" for value in row) for i, row in enumerate(zip(*COLUMNS.values(), strict=True))
    ]
    return (head + channels + "\t".join(["X_Value", *COLUMNS]) + "\n" + "\n".join(rows) + "\n").encode()


def _fit() -> bytes:
    from mckibben import ExponentialLaw, catalog, identify

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fit.yaml"
        identify(ExponentialLaw, catalog.dataset("dmsp-10-250-martens2017")).to_yaml(path)
        return path.read_bytes().rpartition(b"# sha256")[0]


def _calibration() -> bytes:
    channel = {"unit": "N", "gain": 12.5, "offset": -0.5, "tare": 0.0, "low": -2000.0, "high": 2000.0, "margin": 0.02}
    return json.dumps(
        {name: {"name": name, **channel, "unit": unit} for name, unit in CHANNELS.items()}, indent=1
    ).encode()


def _dataset(path: Path) -> Any:
    from mckibben import read_dataset

    return read_dataset(path, accept=["corrupt"])


def _scenario(path: Path) -> Any:
    from mckibben.scenario import Scenario

    return Scenario.read(path)


def _suite(path: Path) -> Any:
    from mckibben.study.compare.suite import Suite

    return Suite.read(path)


def _protocol(path: Path) -> Any:
    from mckibben.study.rig.document import RigTest

    return RigTest.read(path)


def _joint_rig(path: Path) -> Any:
    from mckibben.realtime.config import JointRig

    return JointRig.read(path)


def _read_fit(path: Path) -> Any:
    from mckibben.identification import Fit

    return Fit.from_yaml(path)


def _calibrations(path: Path) -> Any:
    from mckibben.rig.calibration import read_calibrations

    return read_calibrations(path, CHANNELS)


def mutated(content: bytes, chance: random.Random) -> bytes:
    """Content with bits flipped, words put in, parts cut out or repeated, or its end cut off."""
    for _ in range(chance.choice((1, 1, 2, 4, 8))):
        at, size = chance.randrange(len(content) + 1), chance.randrange(1, 40)
        word = chance.choice(WORDS)
        kind = chance.randrange(7)
        if kind == 0 and at < len(content):
            content = content[:at] + bytes([content[at] ^ 1 << chance.randrange(8)]) + content[at + 1 :]
        elif kind == 1:
            content = content[:at] + word + content[at + len(word) :]
        elif kind == 2:
            content = content[:at] + word + content[at:]
        elif kind == 3:
            content = content[:at] + content[at + size :]
        elif kind == 4:
            content = content[:at] + content[at // 2 : at // 2 + size] + content[at:]
        elif kind == 5:
            content = content[:at] + content[at : at + size] * chance.choice((2, 50)) + content[at + size :]
        elif chance.random() < 0.3:
            content = content[:at]
    return content


def damaged(name: str, content: bytes, seed: int) -> bytes:
    """File of a seed; of a workbook every other time a part inside of it is damaged."""
    chance = random.Random(f"{name} {seed}")
    if name != "xlsx" or seed % 2:
        return mutated(content, chance)
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as book, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as copy:
        hit = chance.choice(book.namelist())
        for part in book.namelist():
            copy.writestr(part, mutated(book.read(part), chance) if part == hit else book.read(part))
    return stream.getvalue()


def unaccounted(path: Path, content: bytes, data: Any) -> str:
    """Rows of a text under a sound header that are neither read nor listed."""
    header = content.partition(b"\n")[0]
    if header != path.read_bytes().partition(b"\n")[0]:
        return ""
    text, said = path.read_bytes()[len(header) + 1 :], data.table.attrs.get("repairs", "")
    try:
        lines = re.split("\r\n|\r|\n", text.decode())
    except UnicodeDecodeError:
        return ""
    rows = {i for i, line in enumerate(lines, 2) if line.strip(" \t\r\x0b\x0c,;") not in ("", '""')}
    listed = {int(line) for line in re.findall(r"^line (\d+)", said, re.MULTILINE)}
    found = len(data) + len(listed)
    return f"{len(data)} rows read and {len(listed)} listed of {len(rows)}" if len(rows) > found else ""


def check(name: str, form: Format, seed: int, path: Path) -> str:
    """Failure of the file of a seed; empty where there is none, "refused" where it was refused."""
    from mckibben.errors import McKibbenError

    path.write_bytes(damaged(name, form.content, seed))
    try:
        data = form.read(path)
    except McKibbenError as error:
        text = str(error)
        if len(text) > 100_000:
            return f"a message of {len(text)} characters"
        bad = [letter for letter in text if not letter.isprintable() and letter not in "\n\t\u00a0"]
        return f"the message holds {bad[0]!r}" if bad else "refused"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    return unaccounted(path, form.content, data) if name in TEXTS else ""


def work(name: str, first: int, count: int) -> None:
    """Check so many seeds in this process, and print each before and after."""
    from mckibben.dataset import read_dataset  # noqa: F401  what is imported is no memory of the files

    form = formats()[name]()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(EXAMPLES, folder, dirs_exist_ok=True)  # a suite names other files
        path = Path(folder) / form.name
        path.write_bytes(form.content)
        form.read(path)  # the sound file, with all that it imports and compiles
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        room = used + MEMORY * (1 if path.suffix not in (".yaml", ".json") else 16)  # XLA reserves what it never takes
        resource.setrlimit(resource.RLIMIT_AS, (room, room))
        rest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        for seed in range(first, first + count):
            print(seed, flush=True)
            faulthandler.dump_traceback_later(SECONDS, exit=True)
            start = time.perf_counter()
            failure = check(name, form, seed, path)
            faulthandler.cancel_dump_traceback_later()
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
            failure = failure if peak - rest < MEMORY else f"took {(peak - rest) / 1e6:.0f} MB"
            print(json.dumps([failure, time.perf_counter() - start, peak]), flush=True)


def examine(name: str, first: int, count: int) -> list[tuple[int, str, float, float]]:
    """Seed, failure and time of each file; a worker that ended is started again behind the file that ended it."""
    found: list[tuple[int, str, float, float]] = []
    while len(found) < count:
        at = first + len(found)
        command = [sys.executable, __file__, "--work", name, str(at), str(first + count - at)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        lines = done.stdout.split("\n")[:-1]
        for seed, answer in zip(lines[::2], lines[1::2], strict=False):
            found.append((int(seed), *json.loads(answer)))
        if len(lines) % 2:
            found.append((int(lines[-1]), f"ended with {done.returncode}: {done.stderr[-300:]}", SECONDS, MEMORY))
        elif not lines:
            raise RuntimeError(done.stderr[-2000:])
    return found


def main() -> None:
    """Mutate files of the formats, and print what happened to them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=10_000, help="files of each format")
    parser.add_argument("--formats", default=",".join(formats()))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--repeat", nargs=2, metavar=("FORMAT", "SEED"))
    parser.add_argument("--work", nargs=3, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        work(given.work[0], int(given.work[1]), int(given.work[2]))
    elif given.repeat:
        name, seed = given.repeat[0], int(given.repeat[1])
        form = formats()[name]()
        path = Path(f"mutated-{seed}-{Path(form.name).name}")
        path.write_bytes(damaged(name, form.content, seed))
        print(path, form.read(path))
    else:
        failed = 0
        for name in given.formats.split(","):
            starts = range(given.seed, given.seed + given.files, CHUNK)
            counts = [min(CHUNK, given.seed + given.files - start) for start in starts]
            begin = time.perf_counter()
            with ThreadPoolExecutor(given.workers) as pool:
                parts = list(pool.map(examine, [name] * len(counts), starts, counts))
            found = [one for part in parts for one in part]
            failures = [one for one in found if one[1] not in ("", "refused")]
            refused = sum(one[1] == "refused" for one in found)
            slowest, peak = max(found, key=lambda one: one[2]), max(one[3] for one in found)
            print(
                f"{name:16} {len(found):6} files, {len(found) - refused - len(failures):6} read, {refused:6} refused, "
                f"{len(failures):3} failed; slowest {slowest[2]:.2f} s (seed {slowest[0]}), "
                f"peak {peak / 1e6:.0f} MB, {time.perf_counter() - begin:.0f} s in all",
                flush=True,
            )
            for seed, failure, seconds, _ in failures[:20]:
                print(f"  --repeat {name} {seed}: {failure} ({seconds:.1f} s)", flush=True)
            failed += len(failures)
        sys.exit(bool(failed))


if __name__ == "__main__":
    main()
