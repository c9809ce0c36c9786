"""Files of points, and the problems that a reader finds in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset, Recording, read_dataset
from mckibben.errors import DatasetError

P, C = (grid.ravel() for grid in np.meshgrid([2.0, 3.01, 4.02], [0.0, 2.5, 5.0, 7.5, 10.0, 12.5], indexing="ij"))
F = (643.0 * P * (1 - C / 28) ** 2).round(1)
"""Points of a muscle: pressure [bar], contraction [%], force [N]."""


def table(
    header: str = "Pressure [bar];Contraction [%];Force [N]", *columns: np.ndarray, sep: str = ";", decimal: str = "."
) -> str:
    """A header and rows, by default of the points."""
    rows = zip(*(np.asarray(column).tolist() for column in columns or (P, C, F)), strict=True)
    cells = [
        [f"{cell:.10g}".replace(".", decimal) if isinstance(cell, float | int) else cell for cell in row]
        for row in rows
    ]
    return "\n".join([header, *map(sep.join, cells)]) + "\n"


@pytest.fixture
def put(tmp_path: Path) -> Callable[..., Path]:
    """Write a file."""

    def write(content: str | bytes, name: str = "rig.csv") -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def are_the_points(dataset: IsobaricDataset) -> None:
    np.testing.assert_allclose(dataset.pressure, P * 1e5, rtol=1e-6)
    np.testing.assert_allclose(dataset.contraction, C / 100, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(dataset.force, F, rtol=1e-6)


def problems_of(
    path: Path, read: Callable[..., IsobaricDataset | Recording] = read_dataset, **options: object
) -> list[str]:
    """The problems of a file, each with its remedy."""
    with pytest.raises(DatasetError) as caught:
        read(path, **options)
    assert str(path) in caught.value.source
    return [str(problem) for problem in caught.value.problems]
