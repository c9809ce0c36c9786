"""A test gone through before anything moves: what it takes, and all that stands against it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mckibben.errors import Problem, RangeError, ScenarioError
from mckibben.rig.outline import Outline, outline
from mckibben.rig.runner import columns_of
from mckibben.rig.steps import Step, described
from mckibben.study.rig.building import Setup, build_setup, build_steps
from mckibben.study.rig.document import RigTest
from mckibben.study.scenario.document import Document, Place, dotted
from mckibben.units import bar, mm, percent


@dataclass(frozen=True)
class Checked:
    """A test that may be run.

    Attributes
    ----------
    test
        The test.
    setup
        Its rig, still closed.
    steps
        What is done.
    outline
        What that takes.
    room
        On the disk [bytes]: the record and the dataset.
    """

    test: RigTest
    setup: Setup
    steps: tuple[Step, ...]
    outline: Outline
    room: int

    def describe(self) -> str:
        """The dry run in words: the steps, and what they take."""
        found, upto = self.outline, "at most " if self.outline.at_most else ""
        limits = self.setup.bench.limits
        law = f"{found.force:.0f} N by the law, " if found.force else ""
        return "\n".join(
            [
                f"{self.test.name}: {self.setup.bench.specimen.name} on the {self.rig} rig",
                *described(self.steps, 1),
                f"{upto}{_time(found.duration)}, {found.plateaus} points, {found.samples} samples, "
                f"{found.pulses} pulses, {self.room / 1e6:.0f} MB on the disk",
                f"contraction {found.contraction[0] / percent:.4g}..{found.contraction[1] / percent:.4g} %, pressure "
                f"{found.pressure[0] / bar:g}..{found.pressure[1] / bar:g} bar; {law}limits: {limits.force:g} N, "
                f"{limits.pressure / bar:g} bar, {limits.stretch / mm:g} mm to stretch, {limits.shorten / mm:g} mm to "
                "shorten",
            ]
        )

    @property
    def rig(self) -> str:
        """Which kind of rig it is."""
        return "virtual" if self.test.rig.virtual is not None else "nidaqmx"


def check(test: RigTest, document: Document | None = None, *, source: str = "protocol", session: int = 0) -> Checked:
    """Go through a test without moving anything.

    Parameters
    ----------
    test
        As read.
    document
        Its text, for the lines of what is wrong.
    source
        What errors call it.
    session
        How often the test was begun before: a virtual rig has other noise each time.

    Raises
    ------
    ScenarioError
        With all that stands against it.
    """
    lines = document or Document()
    setup = build_setup(test, session)
    try:
        steps = build_steps(test.protocol, setup.bench.of)
    except RangeError as error:
        raise ScenarioError(source, _unsuited(str(error), ("protocol", test.protocol.form), lines)) from None
    found = outline(steps, setup.bench, setup.backend.inputs, patience=setup.backend.patience)
    if found.problems:
        raise ScenarioError(source, [_placed(problem, test, lines) for problem in found.problems])
    row = sum(column.stored.itemsize for column in columns_of([one.name for one in setup.backend.inputs]))
    return Checked(test, setup, steps, found, found.bytes(row) + 2 * 4 * found.samples)


def check_room(folder: Path, needed: int) -> None:
    """Raise if a disk has not that much room left.

    Raises
    ------
    ScenarioError
        It names both.
    """
    there = folder
    while not there.exists():
        there = there.absolute().parent
    free = shutil.disk_usage(there).free
    if free < needed:
        message = f"has {free / 1e6:.0f} MB left, and the test takes up to {needed / 1e6:.0f} MB"
        raise ScenarioError(str(folder), [Problem(message, remedy="make room, or choose another folder")])


def _placed(problem: Problem, test: RigTest, lines: Document) -> Problem:
    """A problem with its place in the file, as far as the file has it."""
    parts: Sequence[str] = re.findall(r"[a-z_]+|\d+", problem.field)
    place: Place = tuple(int(part) if part.isdigit() else part for part in parts)
    if problem.field.startswith("["):
        form = test.protocol.form
        place = ("protocol", "steps", *place) if form == "steps" else ("protocol", form)
    return Problem(problem.message, lines.line(place), dotted(place), problem.remedy)


def _unsuited(text: str, place: Place, lines: Document) -> list[Problem]:
    """What a whole test says of itself: a heading, and lines of ``field: what is wrong``."""
    heading, *said = text.splitlines()
    problems = []
    for line in said or [heading]:
        field, colon, message = line.strip().partition(": ")
        at = (*place, field) if colon and field.isidentifier() else place
        problems.append(Problem(message if len(at) > len(place) else line.strip(), lines.line(at), dotted(at)))
    return problems


def _time(duration: float) -> str:
    seconds = round(duration)
    return f"{seconds // 3600} h {seconds // 60 % 60:02d} min {seconds % 60:02d} s"
