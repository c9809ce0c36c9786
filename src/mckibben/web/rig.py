"""Rig page: a test on the simulated rig, with live plots and a vent button."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from nicegui import ui

from mckibben.component.classes import classes_of
from mckibben.config.document import LONGEST_TEXT, plain, read_document, to_text
from mckibben.config.model import parse_model
from mckibben.dataset import IsobaricDataset
from mckibben.errors import McKibbenError, ParameterError, RigError
from mckibben.report.palette import FORCE, PRESSURE
from mckibben.result import Result, column
from mckibben.rig.bench import RigLimits
from mckibben.rig.document import RigTest
from mckibben.rig.protocol import Protocol
from mckibben.rig.runner import Progress
from mckibben.rig.running import CheckedTest, check, data_name, run_test
from mckibben.scenario.parameters import Mark
from mckibben.units import Quantity, bar, percent
from mckibben.web import resource
from mckibben.web.charts import chart, draw, line
from mckibben.web.forms import Value, section_form
from mckibben.web.identify import IdentificationState
from mckibben.web.layout import JobPage, actions, button, fold, frame, panel, select, side, text_area
from mckibben.web.reading import Read
from mckibben.web.results import Presented, Repetition, show_result
from mckibben.web.session import JobState, session

_MOST_SAMPLES = 5_000_000
_START = resource("starts/isobaric-test.yaml")
_PACES = {20: "20 times as fast", 100: "100 times as fast", 0: "as fast as possible"}


class Measured(Result):
    """Points of a test on a rig."""

    data: IsobaricDataset
    pressure: np.ndarray = column("Pa", "pressure", shown="bar")
    contraction: np.ndarray = column("1", "contraction", shown="%")
    force: np.ndarray = column("N", "force")

    @classmethod
    def of(cls, data: IsobaricDataset) -> Measured:
        """From the dataset of the test."""
        return cls(data, data.pressure, data.contraction, data.force)

    def verdict(self) -> str:
        """Number of points and pressures."""
        return f"{len(self.data)} points measured, at {len(self.data.pressures)} pressures"


@dataclass
class RigState(JobState):
    """State of the page.

    Attributes
    ----------
    text, pace
        Protocol in YAML, and how many times as fast as the rig the test runs; 0: as fast as possible.
    rows
        Time [s], pressure [bar], force [N] and contraction [%] of each cycle.
    points, total
        Points that were measured, and all of the test.
    result, presented, source
        Points of the last finished test, and the file with them.
    vent
        Event that stops the test.
    """

    text: str = _START
    pace: int = 100
    rows: list[tuple[float, float, float, float]] = field(default_factory=list)
    points: int = 0
    total: int = 1
    result: Measured | None = None
    presented: Presented | None = None
    source: Path | None = None
    vent: threading.Event = field(default_factory=threading.Event)


def checked(text: str, folder: Path) -> CheckedTest:
    """A test on the simulated rig, checked by a dry run.

    Parameters
    ----------
    text, folder
        Protocol in YAML, and the folder of its files.

    Raises
    ------
    ScenarioError
        With all violations at their lines.
    ParameterError
        For a physical rig, or a test of more than 5 million samples.
    """
    test, document = parse_model(RigTest, text, source="protocol", folder=folder, confined=True)
    if test.rig.physical:
        raise ParameterError("this page runs the simulated rig only", remedy="use `mckibben rig run` for a card")
    checked_test = check(test, document)
    samples = checked_test.dry_run.samples
    if samples > _MOST_SAMPLES:
        message = f"the test has {samples} samples, more than {_MOST_SAMPLES}"
        raise ParameterError(message, value=samples, remedy="use fewer points, or use `mckibben rig run`")
    return checked_test


def measure(
    state: RigState, text: str, folder: Path, shown: Callable[[str, float], None] = lambda _step, _part: None
) -> IsobaricDataset:
    """Run a test, appending rows to the state.

    Parameters
    ----------
    state
        State of the page; its event `vent` stops the test.
    text, folder
        Protocol in YAML, and the folder of the record, which is replaced.
    shown
        Called with step and part; whatever it raises stops the test.
    """
    test = checked(text, folder.parent)
    shutil.rmtree(folder, ignore_errors=True)
    state.rows, state.points, state.total = [], 0, max(1, test.dry_run.plateaus)
    began = time.monotonic()

    def report(progress: Progress) -> None:
        if state.vent.is_set():
            raise RigError("vented by hand")
        shown("test", progress.points / state.total)
        latest = progress.latest
        row = latest.time, latest.pressure / bar, latest.force, progress.contraction / percent
        state.rows.append(row)
        state.points = progress.points
        if state.pace:
            time.sleep(max(0.0, min(1.0, began + progress.time / state.pace - time.monotonic())))

    data = run_test(test, folder, report=report)
    state.source = folder / data_name(test.test)
    return data


def page() -> None:
    """The page."""
    visitor = session()
    state = visitor.state(RigState)
    with frame("/rig", state, "text", "pace"):
        _Page(state, visitor.folder)


class _Page(JobPage[RigState]):
    """Protocol and plots of one visit."""

    def __init__(self, state: RigState, folder: Path) -> None:
        super().__init__(state, folder)
        self.drawn = 0
        with side(), panel("Test on the simulated rig"):
            self.form = ui.column().classes("w-full").style("gap: 8px")
            with fold("Advanced: the protocol as YAML"):
                text_area("protocol", LONGEST_TEXT, 330).bind_value(state, "text")
                button("Show in the fields", self.fields)
            self.fields()
            select(_PACES, "time of the rig", "pace").bind_value(state, "pace")
            with actions():
                button("Start", self.start, "start", main=True)
                button("Vent", self.vent, "vent", main=True, color="negative")
            self.bar = ui.linear_progress(0, show_value=False).props('instant-feedback aria-label="points measured"')
            self.status = ui.label().classes("quiet number")
        with side():
            self.results = ui.column().classes("w-full")
            with panel("Force over contraction"):
                self.loop = chart("contraction [%]", "force [N]", height=300)
            with panel("Pressure"):
                self.pressure = chart("time [s]", "pressure [bar]", height=190)
            with panel("Force"):
                self.force = chart("time [s]", "force [N]", height=190)
        ui.timer(0.2, self.refresh)

    def fields(self) -> None:
        """Fields for the numbers of protocol and limits, which the text has; none of a text with mistakes."""
        self.form.clear()
        try:
            data = plain(read_document(self.state.text).data)
            (name, protocol), limits = next(iter(data["protocol"].items())), data["limits"]
            kind = classes_of(Protocol)[name]
        except (McKibbenError, LookupError, TypeError, AttributeError, ValueError):
            return  # starting it tells the mistakes

        def put(section: dict[str, object], key: str, mark: Mark, value: Value) -> None:
            texts = [mark.write(item) if isinstance(mark, Quantity) else item for item in np.atleast_1d(value).tolist()]
            section[key] = texts if isinstance(value, list) else texts[0]
            self.state.text = to_text(data)

        with self.form:
            for title, part, section in (("Protocol", kind, protocol), ("Limits", RigLimits, limits)):
                with fold(title, opened=part is kind), ui.element("div").classes("fields"):
                    section_form(part, section, partial(put, section))

    def refresh(self) -> None:
        """Show new measurements."""
        state = self.state
        rows = state.rows
        self.bar.value = state.points / state.total if rows else 0.0
        self.status.text = f"{state.points} of {state.total} points" if rows else ""
        if len(rows) != self.drawn:
            self.drawn = len(rows)
            times, pressure, force, contraction = np.array(rows or [(np.nan,) * 4]).T
            draw(self.pressure, [line("pressure", times, pressure, PRESSURE, width=1.5)])
            draw(self.force, [line("force", times, force, FORCE, width=1.5)])
            draw(self.loop, [line("measured", contraction, force, FORCE, width=1)])
        if self.news():
            self.show_results(self.results, self.show)

    def show(self) -> None:
        """Show the error or the remarks of the test, and what can be done with its points."""
        self.show_notes()
        if self.state.presented is not None:
            with show_result(self.state.presented, "test"):
                button("Identify the muscle", self.identify, main=True)

    def start(self) -> None:
        """Run the test; at most one at a time."""
        state, folder = self.state, self.folder / "test"
        if state.jobs.busy:
            ui.notify("a test is running: vent first")
            return
        state.vent.clear()
        state.error, state.result, state.presented = None, None, None
        text = state.text

        def compute(shown: Callable[[str, float], None]) -> tuple[Measured, Presented]:
            result = Measured.of(measure(state, text, folder, shown))
            python = (
                "from mckibben.rig.document import read_test\n"
                "from mckibben.rig.running import check, run_test\nfrom pathlib import Path\n\n"
                'result = run_test(check(*read_test("protocol.yaml")), Path("test"))'
            )
            words = ("rig", "run", "protocol.yaml", "--out", "test")
            steps = Repetition.of(words, python, {"protocol.yaml": text.encode()})
            return result, Presented.of(result, steps, charts=True)

        def done(measured: tuple[Measured, Presented], heard: list[str]) -> None:
            (state.result, state.presented), state.notes = measured, heard

        self.start_job(compute, done)

    def vent(self) -> None:
        """Stop the test after the current cycle, and vent."""
        self.state.vent.set()

    def identify(self) -> None:
        """Use the points on the muscle page."""
        muscle, result = session().state(IdentificationState), self.state.result
        assert result is not None
        muscle.use(
            "test on the simulated rig", Read((), result.data, ()), [self.state.source] if self.state.source else []
        )
        muscle.jobs.version += 1
        ui.navigate.to("/identify")
