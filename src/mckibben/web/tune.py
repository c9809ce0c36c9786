"""Tune page: gains of the scenario of the page Run, for tolerances of its errors and a margin, and how to repeat it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

from nicegui import events, ui

from mckibben.component.columns import labels_of
from mckibben.errors import printable
from mckibben.scenario import StudiedScenario, list_parameters
from mckibben.simulation import Metrics
from mckibben.study.tune import parse_cost, parse_ranges, tune
from mckibben.study.tune.search import SEARCHES
from mckibben.study.tune.tune import COST
from mckibben.units import BoundedInt, Quantity
from mckibben.web.forms import section_form
from mckibben.web.layout import JobPage, NumberField, actions, button, frame, panel, progress_row, quiet, select, side
from mckibben.web.results import Presented, Repetition, show_result
from mckibben.web.session import JobState, session
from mckibben.web.workbench import READ, START, Workbench, parse, scenario_files

METRICS = labels_of(Metrics)
"""Metrics with their titles and units; those of robots are some of them."""
Progress = Callable[[str, float], None]


@dataclass
class TuningRequest:
    """Input of a tuning, as `mckibben tune` has it.

    Attributes
    ----------
    tolerances
        Error that counts as 1 in the cost, by its metric, in the unit that is shown.
    over
        Parameters, or NAME=RANGE; all gains if empty.
    method
        Search.
    gain_margin
        Factor by which gains may be larger: the cost covers them, too.
    disk_margin
        Least disk margin that the gains keep along the run; 0 for none.
    iterations
        Generations of the search, or its steps.
    seed
        Seed of the search.
    """

    tolerances: dict[str, float] = field(default_factory=lambda: _tolerances(COST["cost"]))
    over: tuple[str, ...] = ()
    method: str = "cma"
    gain_margin: Annotated[float, Quantity("1", "1", 1, 10)] = COST["gain_margin"]
    disk_margin: Annotated[float, Quantity("1", "1", 0, 1.9)] = COST["disk_margin"]
    iterations: Annotated[int, BoundedInt(1, 60)] = 10
    seed: Annotated[int, BoundedInt(0, 2**31 - 1)] = 0

    @property
    def cost(self) -> str:
        """Sum of the metrics, each over its tolerance, as text."""
        return " + ".join(f"{name}/{value:g} {METRICS[name].shown_unit}" for name, value in self.tolerances.items())


def _tolerances(cost: str) -> dict[str, float]:
    """Tolerances of a cost as text."""
    return {term.metric: float(f"{term.scale / METRICS[term.metric].size:.6g}") for term in parse_cost(cost).terms}


class Study(NamedTuple):
    """Result of a tuning: what is shown, the scenario that was tuned, and the tuned one."""

    presented: Presented
    text: str
    tuned: StudiedScenario


def tuned(text: str, request: TuningRequest, folder: Path, progress: Progress) -> Study:
    """Tune a scenario as `mckibben tune` does.

    Parameters
    ----------
    text, folder
        Scenario, and the folder of its files.
    request
        Input of the page.
    progress
        Called with step and part; whatever it raises ends the study.

    Raises
    ------
    McKibbenError
        For mistakes of text or request.
    """
    progress("compiling", 0.0)
    scenario = parse(text, folder)
    cost = parse_cost(request.cost, gain_margin=request.gain_margin, disk_margin=request.disk_margin)
    search = {"method": request.method, "iterations": request.iterations, "seed": request.seed}
    result = tune(scenario, parse_ranges(request.over, scenario), cost, **search, progress=progress)
    progress("runs before and after", 1.0)
    numbers = {"margin": request.gain_margin, "disk-margin": request.disk_margin, **search}
    words = ["tune", "scenario.yaml", "--out", "tuned", "--cost", request.cost]
    words += [word for name, value in numbers.items() for word in (f"--{name}", str(value))]
    words += [word for parameter in request.over for word in ("--over", parameter)]
    python = (
        "from mckibben.study.tune import parse_cost\n\n"
        f"margins = {{'gain_margin': {request.gain_margin}, 'disk_margin': {request.disk_margin}}}\n"
        f"cost = parse_cost({request.cost!r}, **margins)\n"
        f"result = {READ}.tune({list(request.over)}, cost, **{search})"
    )
    steps = Repetition.of(words, python, scenario_files(text, folder))
    return Study(Presented.of(result, steps), text, result.scenarios[0])


@dataclass
class StudyState(JobState):
    """State of the page: input and result."""

    request: TuningRequest = field(default_factory=TuningRequest)
    study: Study | None = None


def page() -> None:
    """The page."""
    visitor = session()
    state = visitor.state(StudyState)
    with frame("/tune", state.request, *vars(state.request)):
        _Page(state, visitor.state(Workbench), visitor.folder)


class _Page(JobPage[StudyState]):
    """Request and result of one visit."""

    def __init__(self, state: StudyState, bench: Workbench, folder: Path) -> None:
        super().__init__(state, folder)
        self.bench, self.drawn = bench, ""
        request = state.request
        with side():
            with panel("Tune"):
                self.name = quiet("").mark("scenario-name")
                quiet("An error of this size counts as 1 in the cost:")
                self.tolerances = ui.element("div").classes("fields")
                measured = Metrics._fields
                metrics = {name: label.title for name, label in METRICS.items() if name in measured}
                chosen = list(request.tolerances)
                select(metrics, "errors in the cost", "metrics", value=chosen, multiple=True, on_change=self.weigh)
                self.weigh()
                with ui.element("div").classes("fields"):
                    self.numbers = section_form(TuningRequest, vars(request), self.put)
                select(list(SEARCHES), "method", "method").bind_value(request, "method")
                self.parameters(request)
                with actions():
                    button("Tune", self.tune, "tune", main=True)
                quiet("Compiling takes part of the time. Larger searches, and comparisons: `mckibben tune`, `compare`.")
            self.progress = progress_row(state.jobs)
        with side():
            self.results = ui.column().classes("w-full").style("gap: 16px")
        ui.timer(0.15, self.refresh)

    def refresh(self) -> None:
        """Show progress, and new results."""
        self.progress()
        scenario = self.bench.scenario
        shown = "the first one" if scenario is None else printable(scenario.name, 80)
        self.name.text = f"Scenario: {shown}, as it last ran on the page Run."
        if self.news() or self.drawn != self.text():
            self.drawn = self.text()
            self.show_results(self.results, self.show)

    def weigh(self, event: events.ValueChangeEventArguments | None = None) -> None:
        """Fields for the tolerance of each error in the cost."""
        request = self.state.request
        if event is not None and event.value:
            request.tolerances = {name: request.tolerances.get(name, 1.0) for name in event.value}
        above = (lambda number: number > 0), "a number above 0"
        self.tolerances.clear()
        with self.tolerances:
            for name, value in request.tolerances.items():
                put, label = partial(request.tolerances.__setitem__, name), METRICS[name]
                element = NumberField(name.replace("_", " "), value, *above, put, words=f"{label.title}.")
                element.props(f'dense suffix="{label.shown_unit}"').classes("w-full").mark(name)

    def put(self, name: str, _: object, value: object) -> None:
        """Take a number of the request."""
        setattr(self.state.request, name, value)

    def parameters(self, request: TuningRequest) -> None:
        """A choice of parameters, or of texts NAME=RANGE."""
        names = [parameter.name for parameter in list_parameters(self.bench.scenario or parse(START, self.folder))]
        element = select(
            list(dict.fromkeys((*request.over, *names))),
            "tuned; or all gains",
            "over",
            value=list(request.over),
            multiple=True,
            with_input=True,
            new_value_mode="add-unique",
            on_change=lambda event: setattr(request, "over", tuple(event.value or ())),
        )
        element.props("use-chips")

    def text(self) -> str:
        """The scenario of the page Run, as it last ran."""
        return self.bench.text if self.bench.current is None else self.bench.current.text

    def tune(self) -> None:
        """Tune the scenario, once at a time."""
        state, text, folder = self.state, self.text(), self.folder
        if wrong := [field.label for field in self.numbers if field.error]:
            ui.notify(f"correct first: {', '.join(map(str, wrong))}", type="negative")
            return
        if state.jobs.busy:
            ui.notify("a search is running: cancel it first")
            return

        def compute(progress: Callable[[str, float], None]) -> Study:
            return tuned(text, state.request, folder, progress)

        def done(study: Study, heard: list[str]) -> None:
            state.study, state.notes = study, study.presented.others(heard)

        state.error, state.notes = None, []
        self.start_job(compute, done)

    def run(self) -> None:
        """Open the tuned scenario on the page Run."""
        assert self.state.study is not None
        self.bench.ran = self.state.study.tuned.dumps(folder=self.folder)
        ui.navigate.to("/run")

    def show(self) -> None:
        """Show the result, grey if the scenario has been changed, or a search has failed since."""
        self.show_notes()
        study, now = self.state.study, self.text()
        if study is None:
            return
        changed = study.text != now and parse(study.text, self.folder) != parse(now, self.folder)  # spaces may differ
        with ui.column().classes("w-full" + (" stale" if changed or self.state.error else "")).style("gap: 16px"):
            if changed:
                quiet("Result of the scenario before it was changed.")
            with show_result(study.presented, "tuned"):
                button("Run it", self.run, "use-tuned", main=True)
