"""Reader of TDMS files (LabVIEW, FlexLogger, DIAdem)."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.dataset.sheet import RawColumn, RawTable, RowProblem, as_column
from mckibben.errors import DatasetError, Problem


def read_tdms(path: Path, data: bytes) -> RawTable:
    """Read the channels of a TDMS file, named ``group/channel``, with the units of their properties.

    Scaled channels are read scaled; the increment of waveforms is the sampling interval.

    Raises
    ------
    DatasetError
        If npTDMS is not installed, the file cannot be read, or it holds no channel.
    """
    try:
        from nptdms import TdmsFile
    except ImportError:
        remedy = 'pip install "mckibben[tdms]"'
        raise DatasetError(str(path), [Problem("is a TDMS file, and npTDMS is not installed", remedy=remedy)]) from None
    sheet = RawTable(kind=RowProblem)
    intervals: set[float] = set()
    try:
        with _captured_log() as warned:
            file = TdmsFile.read_metadata(io.BytesIO(data))
            claimed = sum(len(channel) for group in file.groups() for channel in group.channels())
            if claimed > len(data):  # a sample has at least a byte
                raise DatasetError(str(path), [Problem(f"claims {claimed} samples, which the file does not hold")])
            file = TdmsFile.read(io.BytesIO(data))
            for group in file.groups():
                for channel in group.channels():
                    _add(sheet, f"{group.name}/{channel.name}", channel, intervals)
            status = file.file_status
    except DatasetError:
        raise
    except Exception as error:  # npTDMS raises nearly every kind on a damaged file
        text = (str(error) or type(error).__name__).splitlines()[0]
        problem = Problem(f"cannot be read as TDMS: {text}", remedy="copy it again from where it was written")
        raise DatasetError(str(path), [problem]) from error
    sheet.corrupt += [RowProblem(f"npTDMS: {text[:120]}") for text in dict.fromkeys(warned)]
    if status.incomplete_final_segment:
        lost = sum(c.expected_length - c.read_length for c in (status.channel_statuses or {}).values())
        what = f" ({lost} values are missing)" if lost > 0 else ""
        sheet.corrupt.append(RowProblem(f"the file was cut off: its last segment is not complete{what}"))
        sheet.channels = _even(sheet.channels)
    if not sheet.channels:
        raise DatasetError(str(path), [Problem("has no channel with samples")])
    if len(intervals) == 1:
        sheet.interval = intervals.pop()
    return sheet


def _even(channels: list[RawColumn]) -> list[RawColumn]:
    """Pad the channels of each group to the longest, so that incomplete rows are reported."""
    longest: dict[str, int] = {}
    for channel in channels:
        group = channel.name.removesuffix(channel.short)
        longest[group] = max(longest.get(group, 0), len(channel.cells))
    even = []
    for channel in channels:
        count = longest[channel.name.removesuffix(channel.short)]
        missing, cells = count - len(channel.cells), channel.cells
        padded = (
            np.append(cells, np.full(missing, np.nan)) if isinstance(cells, np.ndarray) else [*cells, *[""] * missing]
        )
        even.append(replace(channel, cells=padded, lines=range(1, count + 1)))
    return even


@contextmanager
def _captured_log() -> Iterator[list[str]]:
    """Capture the log of npTDMS, its only report of a corrupt file."""
    said: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage())
    loggers = [logging.getLogger(name) for name in list(logging.root.manager.loggerDict) if name.startswith("nptdms.")]
    before = [(logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers, logger.propagate = [handler], False
    try:
        yield said
    finally:
        for logger, (handlers, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate


def _add(sheet: RawTable, name: str, channel: Any, intervals: set[float]) -> None:
    values = channel[:]
    if values is None or not len(values):
        sheet.ignored.append(name)
        return
    values = np.asarray(values)
    if values.dtype.kind in "biuf":
        cells = values.astype(np.float64)
    elif values.dtype.kind in "OU":
        cells = as_column(values.tolist())
    else:  # time stamps, complex numbers
        sheet.ignored.append(name)
        return
    properties = channel.properties
    unit = str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "")
    step = properties.get("wf_increment")
    if isinstance(step, (int, float)) and np.isfinite(step) and step > 0:
        intervals.add(float(step))
    rows = range(1, len(cells) + 1)
    sheet.channels.append(RawColumn(name, cells, rows, short=channel.name, unit=unit))
