"""Datasets to CSV files, each of which appears complete or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import xarray as xr

from mckibben.files import whole

CSV_COLUMNS = {
    "pressure": "pressure_Pa",
    "contraction": "contraction_ratio",
    "force": "force_N",
    "direction": "direction",
    "phase": "phase",
    "repeat": "repeat",
    "time": "time_s",
    "set_pressure": "set_pressure_Pa",
}


def write_csv(table: xr.Dataset, path: Path) -> None:
    """Write a table of plateau means: comments, header, and a row per point, floats in full."""
    attrs = table.attrs
    comments = [f"# specimen: {plain(attrs['specimen'])}", f"# source: {plain(attrs['source'])}"]
    if "initial_length" in attrs:
        comments.append(f"# initial_length: {attrs['initial_length']!r} m")
    comments.append(f"# slack_force: {attrs['slack_force']!r} N")
    present = [name for name in CSV_COLUMNS if name in table]
    rows = zip(*(_cells(table[name].to_numpy()) for name in present), strict=True)
    if "repairs" in attrs:
        comments.append(f"# repairs: {plain(attrs['repairs'])}")
    header = ",".join(CSV_COLUMNS[name] for name in present)
    text = "\n".join([*comments, header, *map(",".join, rows)])
    with whole(path) as sibling:
        sibling.write_text(f"{text}\n", encoding="utf-8", newline="\n")


def plain(text: str) -> str:
    """A text for the rest of a line: as it is, or in JSON's quotes where it would not come back the same."""
    return text if text.isprintable() and text == text.strip() and not text.startswith('"') else json.dumps(text)


def unplain(text: str) -> str:
    """The inverse of `plain`; a text that only looks quoted is left as it is."""
    try:
        value = json.loads(text) if text.startswith('"') else text
    except ValueError:
        return text
    return value if isinstance(value, str) else text


def _cells(values: np.ndarray) -> list[str]:
    if values.dtype.kind == "f":
        return ["" if value != value else repr(value) for value in values.tolist()]
    return [str(value) or "unknown" for value in values.tolist()]  # directions and phases
