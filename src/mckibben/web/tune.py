"""Tune page: gains of the scenario of the page Run, and its comparison with other controllers.

Both are studies of `mckibben.web.studies` with limited size; their scenarios open on the page Run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from nicegui import ui

from mckibben.errors import printable
from mckibben.scenario import Scenario
from mckibben.study.tune.search import SEARCHES
from mckibben.web.layout import (
    JobPage,
    NumberField,
    button,
    frame,
    panel,
    progress_row,
    quiet,
    select,
    side,
)
from mckibben.web.results import show_result
from mckibben.web.session import JobState, session
from mckibben.web.studies import (
    ComparisonRequest,
    Study,
    TuningRequest,
    compared,
    tuned,
)
from mckibben.web.workbench import CONTROLLERS, Workbench, parse


@dataclass
class StudyState(JobState):
    """State of the page.

    Attributes
    ----------
    tuning, comparison
        Inputs of both studies.
    results
        Tuning and comparison by name, the newest first.
    """

    tuning: TuningRequest = field(default_factory=TuningRequest)
    comparison: ComparisonRequest = field(default_factory=ComparisonRequest)
    results: dict[str, Study] = field(default_factory=dict)  # the newest first


def page() -> None:
    """The page."""
    visitor = session()
    with frame("/tune"):
        _Page(visitor.state(StudyState), visitor.state(Workbench), visitor.folder)


class _Page(JobPage[StudyState]):
    """Requests and results of one visit."""

    def __init__(self, state: StudyState, bench: Workbench, folder: Path) -> None:
        super().__init__(state, folder)
        self.bench, self.drawn = bench, ""
        tuning, comparison = state.tuning, state.comparison
        with side():
            with panel("Scenario"):
                self.name = ui.label().classes("number").mark("scenario-name")
                quiet("That of the page Run, as it last ran.")
            self.progress = progress_row(state.jobs)
            with panel("Tune"):
                _lines("cost", tuning, "cost")
                select(list(SEARCHES), "method", "method").bind_value(tuning, "method")
                with ui.element("div").classes("fields"):
                    self.tuning_fields = [
                        _number("gain margin", tuning, "gain_margin", 1.0, 10.0),
                        _number("disk margin", tuning, "disk_margin", 0.0, 1.9),
                        _number("iterations", tuning, "iterations", 1, 60),
                        _number("seed", tuning, "seed", 0, 2**31 - 1),
                    ]
                _lines("NAME=RANGE per line, or all gains", tuning, "over")
                button("Tune", self.tune, "tune", main=True)
            with panel("Compare"):
                select(
                    list(CONTROLLERS),
                    "with these controllers",
                    "controllers",
                    value=list(comparison.controllers),
                    multiple=True,
                    on_change=lambda event: setattr(comparison, "controllers", tuple(event.value or ())),
                )
                with ui.element("div").classes("fields"):
                    self.comparison_fields = [
                        _number("unseen runs", comparison, "runs", 2, 512),
                        _number("generations", comparison, "generations", 1, 30),
                    ]
                _lines("conditions, NAME=RANGE per line, or strengths and masses", comparison, "conditions")
                button("Compare", self.compare, "compare", main=True)
            quiet(
                "Both take minutes, part of them for compiling, and more on a busy computer. The time of tuning grows "
                "with iterations, that of comparing with controllers, generations and unseen runs. `mckibben tune` and "
                "`mckibben compare` do larger ones, and can be interrupted and resumed."
            )
        with side():
            self.results = ui.column().classes("w-full").style("gap: 16px")
        ui.timer(0.15, self.refresh)

    def refresh(self) -> None:
        """Show progress, and new results."""
        self.progress()
        scenario = self.bench.scenario
        self.name.text = "the first one" if scenario is None else printable(scenario.name, 80)
        if self.news() or self.drawn != self.text():
            self.drawn = self.text()
            self.show_results(self.results, self.show)

    def text(self) -> str:
        """The scenario of the page Run, as it last ran."""
        return self.bench.text if self.bench.current is None else self.bench.current.text

    def tune(self) -> None:
        """Tune the scenario."""
        self.start("tuned", tuned, self.state.tuning, self.tuning_fields)

    def compare(self) -> None:
        """Compare controllers."""
        self.start("compared", compared, self.state.comparison, self.comparison_fields)

    def start(
        self,
        name: str,
        compute: Callable[..., Study],
        request: TuningRequest | ComparisonRequest,
        fields: list[NumberField],
    ) -> None:
        """Compute a study, at most one at a time.

        Parameters
        ----------
        name
            Key of its result in the state.
        compute, request
            Study, and its input.
        fields
            Number fields, which have to be valid.
        """
        state, text, folder = self.state, self.text(), self.folder
        if wrong := [field.label for field in fields if field.error]:
            ui.notify(f"correct first: {', '.join(map(str, wrong))}", type="negative")
            return
        if state.jobs.busy:
            ui.notify("a study is running: cancel it first")
            return

        def done(study: Study, heard: list[str]) -> None:
            state.results = {name: study} | {other: old for other, old in state.results.items() if other != name}
            state.notes = study.presented.others(heard)

        state.error, state.notes = None, []
        self.start_job(lambda progress: compute(text, request, folder, progress), done)

    def run(self, scenario: Scenario) -> None:
        """Open a scenario on the page Run."""
        self.bench.waiting = scenario.dumps(folder=self.folder)
        ui.navigate.to("/run")

    def show(self) -> None:
        """Show everything known."""
        state = self.state
        self.show_notes()
        for name, (presented, text, scenarios) in state.results.items():
            with self.result_of(text), show_result(presented, name), ui.row().classes("items-center"):
                chosen = select(list(scenarios), "scenario", value=next(iter(scenarios))).classes(remove="w-full")
                self.run_button(name, scenarios, chosen)
        if not state.results and state.error is None:
            with panel("No study yet"):
                quiet(
                    "Tune searches the gains of the scenario for the lowest cost. Compare tunes its controller and "
                    "others with one budget, and compares them on the same unseen runs."
                )

    @contextmanager
    def result_of(self, text: str) -> Iterator[None]:
        """A column for the result of a scenario, grey if the scenario has been changed or a study has failed since."""
        now = self.text()  # the page Run writes a scenario that is the same with other spaces
        changed = text != now and parse(text, self.folder) != parse(now, self.folder)
        with ui.column().classes("w-full" + (" stale" if changed or self.state.error else "")).style("gap: 16px"):
            if changed:
                quiet("Result of the scenario before it was changed.")
            yield

    def run_button(self, name: str, scenarios: dict[str, Scenario], chosen: ui.select) -> None:
        """Button that opens the chosen scenario of a study on the page Run."""
        button("Run it", lambda: self.run(scenarios[str(chosen.value)]), f"use-{name}", main=True)


def _lines(label: str, on: TuningRequest | ComparisonRequest, name: str) -> None:
    """A field of several lines, bound to an attribute of a request."""
    ui.textarea(label).props("dense autogrow maxlength=4000").classes("w-full mono").mark(name).bind_value(on, name)


def _number(label: str, on: TuningRequest | ComparisonRequest, name: str, low: float, high: float) -> NumberField:
    """A number field of a request; whole if its limits are."""
    whole = isinstance(low, int)

    def changed(value: float) -> None:
        setattr(on, name, int(value) if whole else value)

    made = NumberField(
        label,
        getattr(on, name),
        lambda value: low <= value <= high and (not whole or float(value).is_integer()),
        f"{'a whole number, ' if whole else ''}{low:g} to {high:g}",
        changed,
    )
    return made.props("dense").classes("w-full").mark(name)
