"""Tasks in folders: a file task.yaml, and the CSV files of the task in the same folder."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import model_validator

from mckibben.bench.task import KINDS, DataBlock, Task, Training
from mckibben.config.fields import OneOf
from mckibben.config.model import ConfigModel, DocumentModel, explicit_fields, fail_validation
from mckibben.errors import DatasetError, Problem, UnitError
from mckibben.units import (
    BraidAngle,
    Contraction,
    Diameter,
    Force,
    Inertia,
    Length,
    MomentArm,
    PositiveTime,
    Torque,
    factor,
)

FILE = "task.yaml"
_RECORDINGS = ("hysteresis", "isometric", "joint")


class SetupFacts(ConfigModel):
    """Numbers about the setup of a task; those of a joint are needed by the baselines of laws."""

    initial_length: Length | None = None
    initial_diameter: Diameter | None = None
    braid_angle: BraidAngle | None = None
    slack_force: Force | None = None
    pulley_radius: MomentArm | None = None
    contraction_at_zero: Contraction | None = None
    inertia: Inertia | None = None
    gravity_torque: Torque | None = None


class TaskFile(DocumentModel):
    r"""A task in a folder: its kind, CSV files of training and of test data, source and licence, and facts.

    Examples
    --------
    >>> text = "name: rig\ntask: map\ntrain: [a.csv]\ntest: [b.csv]\nsource: our rig\nlicence: CC0\n"
    >>> TaskFile.parse(text).test
    ('b.csv',)
    """

    kind = "task"
    examples = "docs/bench.md"

    name: str
    task: Annotated[str, OneOf(tuple(KINDS))]
    train: tuple[str, ...]
    test: tuple[str, ...]
    source: str
    licence: str
    period: PositiveTime | None = None
    facts: SetupFacts = SetupFacts()

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.period is None) == (self.task in _RECORDINGS):
            fail_validation(
                f"a task {self.task!r} {'needs' if self.period is None else 'has no'} `period`",
                "give the time between two samples" if self.period is None else "leave it out",
            )
        if both := sorted({*self.train} & {*self.test}):
            fail_validation(f"{both[0]} is in `train` and in `test`", "test with other data")
        return self


def read_task(folder: str | os.PathLike[str]) -> Task:
    """Read the task of a folder; raises a `ScenarioError` or a `DatasetError` with every problem of a file."""
    place = Path(folder)
    given = TaskFile.read(place / FILE)
    train, test = (tuple(_read_block(place, name, given.task) for name in names) for names in (given.train, given.test))
    training = Training(given.name, given.task, train, given.period, explicit_fields(given.facts))
    return Task(training, test, f"{given.source} ({given.licence})")


def _read_block(folder: Path, name: str, kind: str) -> DataBlock:
    """Read a CSV file with headers such as pressure_bar; its name is that of the block."""
    file = folder / name
    try:
        with file.open(encoding="utf-8-sig", newline="") as opened:
            header = [one.strip() for one in next(csv.reader(opened), [])]
            table = np.genfromtxt(opened, delimiter=",", ndmin=2)
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise DatasetError(
            str(file), [Problem(f"cannot be read: {error}", remedy="name a CSV file with commas between its cells")]
        ) from None
    if not table.size:
        raise DatasetError(str(file), [Problem("has no rows", remedy="name a file with a header and rows")])
    inputs, output = KINDS[kind]
    columns, problems = [], []
    for quantity, unit in (*inputs, output):
        found = [i for i, one in enumerate(header) if one.partition("_")[0] == quantity]
        if not found or table.shape[1:] != (len(header),):
            shown = f"{quantity}_{unit}" if unit != "1" else quantity
            problems.append(Problem(f"has no column of the {quantity}", remedy=f"name it {shown}, or in another unit"))
            continue
        spelled = header[found[0]].partition("_")[2] or "1"
        try:
            columns.append(table[:, found[0]] * factor(spelled, unit))
        except UnitError as error:
            problems.append(Problem(error.message, line=1, field=header[found[0]], remedy=error.remedy))
    if problems:
        raise DatasetError(str(file), problems)
    if not np.isfinite(columns).all():
        raise DatasetError(str(file), [Problem("has cells that are not numbers", remedy="remove these rows")])
    return DataBlock.of(Path(name).stem, np.column_stack(columns[:-1]), columns[-1])
