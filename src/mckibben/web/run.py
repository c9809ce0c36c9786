"""Page of runs: references, controller and gains, live plots, and the scenario as YAML, of a joint or a robot.

Selects change a part of the scenario, fields its numbers, and the text all of it; every change runs it again.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from nicegui import events, ui
from starlette.responses import HTMLResponse, PlainTextResponse, Response

from mckibben.component.columns import labels_of
from mckibben.config.document import LONGEST_TEXT
from mckibben.errors import ParameterError
from mckibben.export.page import page_files
from mckibben.report.palette import BLUE, DESIRED, GREEN, MEASURED, MUSCLES, ORANGE, PURPLE, SKY
from mckibben.scenario import ScenarioParameter, StudiedScenario, list_parameters, with_values
from mckibben.simulation.result import BAND
from mckibben.units import bar
from mckibben.web.charts import Series, band, chart, draw, line
from mckibben.web.forms import meaning, number
from mckibben.web.layout import (
    JobPage,
    NumberField,
    button,
    fold,
    frame,
    panel,
    progress_row,
    quiet,
    select,
    side,
    table,
    text_area,
    upload,
)
from mckibben.web.parts import Choice, control_choices, plant_choices
from mckibben.web.results import Presented, Repetition, show_result
from mckibben.web.session import session
from mckibben.web.workbench import (
    LEG,
    READ,
    SMALL_MOTION,
    START,
    ScenarioRun,
    Workbench,
    compute,
    parse,
    save_scenario,
    scenario_files,
)

_KEPT = (PURPLE, ORANGE, SKY)
"""Colours of kept runs, of which there are at most as many."""
_COLOURS = (*MUSCLES, GREEN, PURPLE, ORANGE, SKY, BLUE)
"""Colours of muscles, in turn."""
_PARTS = ("controller", "controllers", "reference", "joint", "load", "friction", "valve", "sensors", "disturbance")
"""Parts of a scenario with fields; the first three are open at first."""
_EXAMPLES = {"": "none", "knee": "the knee of the paper", "leg": "the leg of the paper"}
_TEXTS = {"knee": START, "leg": LEG}
_METRICS = ("angle_rmse", "stiffness_rmse", "coupling", "air")
"""Metrics of the comparison of kept runs."""
MOVING = "/moving"
"""Address of the page to move."""


def page() -> None:
    """The page."""
    visitor = session()
    state = visitor.state(Workbench)
    with frame("/run", state, "ran", state=state):
        _Page(state, visitor.folder)


def moving() -> Response:
    """The last page to move, of `Move it`."""
    presented = session().state(Workbench).studies.get("page")
    if presented is None:
        return PlainTextResponse("The scenario has changed since; ask for the page again.", 404)
    return HTMLResponse(presented.steps.files["page.html"])


_HIDDEN = re.compile(r"\.(model|specimen|law|domain)\.")
"""Parameters without a field on the page."""


class _Page(JobPage[Workbench]):
    """Forms and plots of one visit.

    Fields and curves are those of the last scenario that ran: dimmed while another one runs, and grey after an error,
    beside a value that is refused, and beside an edited text.
    """

    def __init__(self, state: Workbench, folder: Path) -> None:
        super().__init__(state, folder)
        self.formed, self.look = -1, ""
        self.text = ""
        self.selects: dict[str, ui.select] = {}
        self.numbers: list[NumberField] = []
        with side():
            with panel("Controller and references"):
                select(_EXAMPLES, "an example", "start", value="", on_change=self.example)
                self.control = ui.element("div").classes("fields")
            with panel(), fold("Plant").mark("plant"):
                self.plant = ui.element("div").classes("fields")
            self.form = ui.column().classes("w-full").style("gap: 16px")
            with panel(), fold("Advanced: the scenario as YAML"):
                self.yaml = text_area("scenario", LONGEST_TEXT, 260)
                with ui.row().style("gap: 8px"):
                    button("Run", self.apply, "run", main=True)
                upload("or a file, with those that it names", 4 * LONGEST_TEXT, self.uploaded, most=16)
        with side():
            with ui.row().classes("w-full items-center").style("gap: 12px"):
                button("Keep this run", self.keep, "keep", main=True)
                button("Remove kept runs", self.clear)
                button("Margins", partial(self.study, "margins"), "margins")
                button("Limits", partial(self.study, "envelope"), "limits")
                button("Move it", partial(self.study, "page"), "move")
            self.progress = progress_row(state.jobs)
            self.remarks = ui.column().classes("w-full")
            with panel("Angle", stays=True) as self.first:
                self.joints = ui.toggle([], on_change=self.choose_joint).props("no-caps flat").mark("joint")
                self.angle = chart("time [s]", "angle [°]", height=270)
            with ui.column().classes("w-full").style("gap: 16px") as self.results:
                with panel("Stiffness"):
                    self.stiffness = chart("time [s]", "stiffness [N·m/rad]", height=270)
                with panel("Stiffness of small motion, with friction") as self.small_panel:
                    self.small = chart("time [s]", "stiffness [N·m/rad]", height=200)
                with panel("Pressures"):
                    self.pressure = chart("time [s]", "pressure [bar]", height=230)
                with panel("Kept runs") as self.comparison:
                    self.table = ui.column().classes("w-full")
        self.first.visible = self.results.visible = state.current is not None
        ui.timer(0.0, self.begin, once=True)  # once a browser shows the page: a request alone computes nothing
        ui.timer(0.1, self.refresh)

    def select(self, label: str, choice: Choice) -> None:
        """A select that changes the scenario, and shows the kind that runs."""

        def changed(event: events.ValueChangeEventArguments) -> None:
            scenario = self.state.scenario
            if event.value and scenario is not None and event.value != self.state.options.get(label):
                self.change(lambda: choice.choose(scenario, event.value))

        element = select(list(choice.options), label, label, value=self.state.options[label], on_change=changed)
        self.selects[label] = element.classes("wide" if " of " in label else "")

    def example(self, event: events.ValueChangeEventArguments) -> None:
        """Run an example."""
        if event.value:
            self.apply_text(_TEXTS[event.value])

    def begin(self) -> None:
        """Run the scenario of another page, or the first one."""
        state, folder = self.state, self.folder
        if state.waiting is not None:
            make, note = state.waiting, state.note
            state.waiting = None
            self.change(lambda: make(folder), note=note)
        elif state.current is None and not state.jobs.busy:
            self.apply_text(state.text)

    def refresh(self) -> None:
        """Show new results, and whether they are those of the fields and of the text."""
        state = self.state
        self.progress()
        if self.formed != state.form and state.scenario is not None:
            self.formed = state.form
            self.parts(state.scenario)
        if self.news():
            if self.text != state.text:  # otherwise it may be being edited
                self.text = self.yaml.value = state.text
            self.show_results(self.remarks, self.show)
            for label, element in self.selects.items():
                if not state.jobs.busy:
                    element.value = state.options.get(label)
            self.first.visible = self.results.visible = state.current is not None
            if state.current is not None:
                self.plot(state.current)
        refused = any(field.error for field in self.numbers)
        old = state.error is not None or refused or self.yaml.value != self.text
        look = "waiting" if state.jobs.busy else "stale" if old else ""
        if look != self.look:
            for part in (self.remarks, self.first, self.results):
                part.classes(look, remove=self.look or None)
            self.form.classes("stale" if look else "", remove="stale")
            self.look = look

    def show(self) -> None:
        """Show the error or the warnings of the last run, and the result of the last scenario that ran."""
        state = self.state
        self.show_notes()
        if state.current is not None:
            with show_result(state.current.presented, "run"):
                if state.note:
                    quiet(state.note)
                if state.error is not None:
                    quiet("Fields, curves and numbers are those of the last scenario that ran.")
        for name, presented in state.studies.items():
            with show_result(presented, name):
                if name == "page":
                    ui.link("Open the joint that moves under your finger", MOVING, new_tab=True).mark("moving")

    def change(
        self,
        make: Callable[[], StudiedScenario],
        *,
        form: bool = True,
        note: str = "",
        scroll: bool = False,
    ) -> None:
        """Change the scenario and run it.

        Parameters
        ----------
        make
            Makes the new scenario, in the thread of the job; its error is shown.
        form
            Whether the structure changes, so that the fields are rebuilt.
        note
            Remark on the change.
        scroll
            Whether the page scrolls to the results.
        """
        state, folder = self.state, self.folder

        def run(progress: Callable[[str, float], None]) -> tuple[StudiedScenario, dict[str, str | None], ScenarioRun]:
            scenario = make()
            options = {
                label: choice.chosen(scenario)
                for label, choice in (control_choices(scenario) | plant_choices(scenario)).items()
            }
            progress("run, a new kind compiles" if form else "run", 0.0)  # unless another has been requested since
            if state.current is None:  # fields while the first run compiles
                state.scenario, state.options, state.form = scenario, options, state.form + 1
            return scenario, options, compute(scenario, folder)

        def done(ran: tuple[StudiedScenario, dict[str, str | None], ScenarioRun], heard: list[str]) -> None:
            state.form += form and ran[0] is not state.scenario
            state.scenario, state.options, state.current = ran
            state.studies = {}
            state.text, state.error = state.current.text, None
            state.note, state.notes = note, state.current.presented.others(heard)

        kind = "structure" if form else "numbers"
        self.start_job(run, done, scroll=scroll, kind=kind)  # not from a field or a select: it may be changed again

    def apply_text(self, text: str, folder: Path | None = None) -> None:
        """Run the scenario in a text, which may name files of a folder."""
        self.state.text = text
        self.change(lambda: parse(text, folder or self.folder), scroll=True)

    def apply(self) -> None:
        """Run the text on the page."""
        self.apply_text(self.yaml.value or "")

    async def uploaded(self, event: events.MultiUploadEventArguments) -> None:
        """Run an uploaded scenario, which may name other uploaded files."""
        folder = Path(tempfile.mkdtemp(dir=self.folder, prefix="scenario-"))
        try:
            path = await save_scenario(event.files, folder)
        except ParameterError as error:
            ui.notify(str(error), type="negative")
            return
        self.apply_text(path.read_bytes()[: 4 * LONGEST_TEXT].decode("utf-8", errors="replace"), folder)

    def parts(self, scenario: StudiedScenario) -> None:
        """Selects of the parts of a scenario, and fields of its numbers."""
        self.selects, self.numbers = {}, []
        for column, choices in ((self.control, control_choices), (self.plant, plant_choices)):
            column.clear()
            with column:
                for label, choice in choices(scenario).items():
                    self.select(label, choice)
        self.form.clear()
        with self.form:
            self.fields(scenario)

    def fields(self, scenario: StudiedScenario) -> None:
        """Fields for the numbers set in a scenario, by its parts, with one column for each loop or joint."""
        parts: dict[str, dict[str, list[ScenarioParameter]]] = {part: {} for part in _PARTS}
        for parameter in list_parameters(scenario):
            if parameter.nominal is not None and parameter.part in parts and not _HIDDEN.search(parameter.name):
                _, *groups, _ = parameter.name.split(".")
                parts[parameter.part].setdefault(next(iter(groups), ""), []).append(parameter)
        for part, columns in parts.items():
            if not columns:
                continue
            with panel(), fold(part.capitalize(), opened=part in _PARTS[:3]), ui.element("div").classes("fields"):
                for group, members in columns.items():
                    alone = not group or len(columns) == 1
                    with ui.element("div").classes("fields wide") if alone else ui.column().style("gap: 4px"):
                        if group:
                            ui.label(group.replace("_", " ")).classes("loop")
                        for parameter in members:
                            name = parameter.name.removeprefix(f"{part}.").removeprefix(f"{group}.")
                            self.number(scenario, parameter, name)

    def number(self, scenario: StudiedScenario, parameter: ScenarioParameter, name: str) -> None:
        """A number field, in the unit of files."""

        def changed(value: float) -> None:
            if (now := self.state.scenario) is not None:
                self.change(lambda: with_values(now, {parameter.name: value}), form=False)

        label, words = name.replace(".", " ").replace("_", " "), meaning(scenario, parameter)
        element = number(label, parameter.mark, float(parameter.nominal or 0.0), changed, words).mark(parameter.name)
        self.numbers.append(element)

    def study(self, name: str) -> None:
        """Compute stability margins, the attainable set, or the page to move, of the scenario that ran last."""
        state, folder = self.state, self.folder
        if (scenario := state.scenario) is None or state.current is None:
            return
        files = scenario_files(state.current.text, folder)

        def compute(progress: Callable[[str, float], None]) -> Presented:
            progress(name, 0.0)
            if name != "page":
                words = (name, "scenario.yaml", "--out", name)
                return Presented.of(getattr(scenario, name)(), Repetition.of(words, f"result = {READ}.{name}()", files))
            exported = page_files(scenario, name, folder)
            words = ("export", "scenario.yaml", "--to", "page", "--out", name)
            python = f'from mckibben.export import export\n\nresult = export({READ}, "page", "page")'
            contents = {path: str(text).encode() for path, text in exported.contents.items()}
            return Presented.of(exported, Repetition.of(words, python, files | contents))

        def done(presented: Presented, heard: list[str]) -> None:
            state.studies = {name: presented} | {other: old for other, old in state.studies.items() if other != name}
            state.notes, state.error = presented.others(heard), None

        self.start_job(compute, done, kind=name)

    def keep(self) -> None:
        """Keep the current run for comparison."""
        state = self.state
        if state.current is not None:
            state.overlays.append(state.current)
            del state.overlays[: -len(_KEPT)]
            state.jobs.version += 1

    def clear(self) -> None:
        """Remove all kept runs."""
        self.state.overlays.clear()
        self.state.jobs.version += 1

    def choose_joint(self, event: events.ValueChangeEventArguments) -> None:
        """Draw another joint."""
        if event.value and event.value != self.state.joint and self.state.current is not None:
            self.state.joint = event.value
            self.plot(self.state.current)

    def plot(self, now: ScenarioRun) -> None:
        """Draw angle, stiffness with its attainable range, pressures and metrics of this run over kept ones."""
        state, names = self.state, now.joints or ("",)
        joint = state.joint = state.joint if state.joint in names else names[0]
        self.joints.visible = bool(now.joints)
        if self.joints.options != [*now.joints]:
            self.joints.set_options([*now.joints], value=joint or None)
        time, runs = now.result["time"], {f"run {k}": run for k, run in enumerate(state.overlays, 1)} | {"now": now}
        colours = dict(zip(runs, (*_KEPT[: len(runs) - 1], MEASURED), strict=True))

        def curves(name: str, unit: float) -> list[Series]:
            """Those of all runs, and of the reference."""
            shown = [
                (kept, run, name, {"color": colours[kept], "width": 1.5 + 0.5 * (run is now)})
                for kept, run in runs.items()
            ]
            shown.append(("desired", now, f"desired_{name}", {"color": DESIRED, "dash": True, "width": 1.5}))
            values = [
                (label, run, run.of_joint(run.result.columns, column, joint), look)
                for label, run, column, look in shown
            ]
            return [line(label, run.result["time"], y / unit, **look) for label, run, y, look in values if y.size]

        kind = now.result.joint_type
        stiffness = kind.size("N*m/rad")
        self.angle.options["yAxis"]["name"] = kind.label("angle", "deg").replace("deg", "°")
        for panel_chart in (self.stiffness, self.small):
            panel_chart.options["yAxis"]["name"] = kind.label("stiffness", "N*m/rad")
        draw(self.angle, curves("angle", kind.size("deg")))
        low, high = (now.of_joint(now.result.columns, name, joint) for name in BAND)
        edges = low / stiffness, high / stiffness
        bounds = band("attainable at rest", time, *edges, "#9aa7b3") if low.size else []
        draw(self.stiffness, [*bounds, *curves("stiffness", stiffness)])
        self.small_panel.visible = bool(small := curves(SMALL_MOTION, stiffness))
        if small:  # in its own chart, as it can be many times the isobaric stiffness
            draw(self.small, small)
        pressures = enumerate(now.pressures.items())
        draw(self.pressure, [line(name, time, p / bar, _COLOURS[k % len(_COLOURS)]) for k, (name, p) in pressures])
        self.comparison.visible = len(runs) > 1
        self.table.clear()
        with self.table:
            self.compare(runs, joint)

    def compare(self, runs: Mapping[str, ScenarioRun], joint: str) -> None:
        """Table of runs with their metrics, those of joints for one of them."""
        labels = {name: label for run in runs.values() for name, label in labels_of(run.result.kind).items()}
        labels = {name: labels[name] for name in _METRICS if name in labels}
        rows = []
        for name, run in runs.items():
            metrics, row = run.result.metrics, [name]
            for metric, label in labels.items():
                value = np.asarray(metrics.get(metric, np.nan))
                value = run.of_joint(metrics, metric, joint) if value.ndim else value
                row.append(f"{value.item() / label.size:.3g}" if value.size and np.isfinite(value) else "-")
            rows.append([*row, run.result.outcome.value.partition(":")[0]])
        table(("run", *(f"{label.title} [{label.shown_unit}]" for label in labels.values()), "outcome"), rows)
