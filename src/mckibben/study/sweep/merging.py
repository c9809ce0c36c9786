"""Merging of the parts of a sweep, without holding their tables in memory."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from numpy.typing import NDArray

from mckibben.errors import FileError, ParameterError, Problem
from mckibben.storage.files import append_seal, atomic_write, check_free, explain_write_errors, make_folder
from mckibben.study.sweep.plan import manifest_differences, parse_part
from mckibben.study.sweep.result import PIECE, SweepResult, write_columns
from mckibben.study.sweep.sweep import TABLE


def merge(folders: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]) -> SweepResult:
    """Join the parts of a sweep, computed with `part`, in any order.

    Raises `FileError` if a part is missing, given twice, unfinished, damaged, or of another sweep or division; if `out`
    contains another table; or if the disk is full.

    The table in `out` is that of the undivided sweep, byte for byte. If it is there already, as after a `mckibben
    merge` that was killed during its statistics, it is not written again. Columns of the result are read when used.
    """
    if not folders:
        raise ParameterError("there is nothing to merge", field="folders", remedy="give the folders of all parts")
    out = Path(out)
    with ExitStack() as opened:
        parts = _ordered([_opened(Path(folder), opened) for folder in folders])
        tables = [swept.table for _, swept in parts]
        runs = sum(swept.count for _, swept in parts)
        if (merged := _merged(out, parts[0][1], runs)) is not None:
            return merged

        def pieces(name: str) -> Iterator[NDArray]:
            for table in tables:
                for start in range(0, table.sizes["run"], PIECE):
                    yield table[name][start : start + PIECE].to_numpy()

        make_folder(out)
        with explain_write_errors(out, lambda: "", "make room, and merge again"):
            size = runs * sum(column.dtype.itemsize for column in tables[0].values())
            if shutil.disk_usage(out).free < 1.01 * size:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            with atomic_write(out / TABLE) as temporary:
                with temporary.open("w+b") as file:
                    write_columns(file, tables[0], runs, {str(name): pieces(str(name)) for name in tables[0]})
                append_seal(temporary)
    return SweepResult.from_netcdf(out / TABLE, lazy=True)


def _merged(out: Path, part: SweepResult, runs: int) -> SweepResult | None:
    """The table of an earlier merge of the same sweep; raises FileError for any other table in the folder."""
    try:
        found = SweepResult.from_netcdf(out / TABLE, lazy=True)
    except FileError:
        check_free(out, [TABLE])
        return None
    manifests = [json.loads(swept.table.attrs["manifest"]) for swept in (part, found)]
    if manifest_differences(*manifests) or _part_of(found) != (1, 1) or found.count != runs:
        found.table.close()
        check_free(out, [TABLE])
    return found


def _opened(folder: Path, opened: ExitStack) -> tuple[Path, SweepResult]:
    """The table of a part."""
    if not (folder / TABLE).is_file():
        problem = Problem("it has no finished part of a sweep", field=TABLE, remedy="finish it with --resume")
        raise FileError(str(folder), [problem])
    swept = SweepResult.from_netcdf(folder / TABLE, lazy=True)
    opened.callback(swept.table.close)
    return folder, swept


def _ordered(parts: list[tuple[Path, SweepResult]]) -> list[tuple[Path, SweepResult]]:
    """The parts in order; raises FileError unless each part of one sweep is there once."""
    folder, swept = parts[0]
    wanted, count = json.loads(swept.table.attrs["manifest"]), _part_of(swept)[1]
    found: dict[int, tuple[Path, SweepResult]] = {}
    for other, each in parts:
        number, parts_there = _part_of(each)
        if problems := manifest_differences(wanted, json.loads(each.table.attrs["manifest"])):
            remedy = f"merge parts of one sweep; {folder} was given first"
            raise FileError(str(other), [Problem(p.message, field=p.field, remedy=remedy) for p in problems])
        if parts_there != count:
            message = f"it is part {number}/{parts_there}, and {folder} a part of {count}"
            raise FileError(str(other), [Problem(message, field="part", value=number, remedy="merge one division")])
        if number in found:
            message = f"it is part {number}/{count}, as is {found[number][0]}"
            raise FileError(str(other), [Problem(message, field="part", value=number, remedy="give each part once")])
        found[number] = other, each
    if missing := [number for number in range(1, count + 1) if number not in found]:
        names = ", ".join(f"{number}/{count}" for number in missing[:20]) + (", ..." if len(missing) > 20 else "")
        remedy = "compute them with --part"
        raise FileError(
            str(folder), [Problem(f"parts {names} are missing", field="part", value=missing, remedy=remedy)]
        )
    return [found[number] for number in sorted(found)]


def _part_of(swept: SweepResult) -> tuple[int, int]:
    return parse_part(swept.table.attrs.get("part", "1/1"))
