"""Page of runs: references, controller and gains, live plots, and the scenario as YAML.

Selects change a part of the scenario, fields its numbers, and the text all of it; every change runs it again.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from nicegui import events, ui

from mckibben.config.document import LONGEST_TEXT
from mckibben.errors import printable
from mckibben.report.palette import DESIRED, MEASURED, MUSCLES, ORANGE, PURPLE, SKY
from mckibben.scenario import Scenario, ScenarioParameter, list_parameters, with_values
from mckibben.units import bar, deg, factor
from mckibben.web.charts import Series, band, chart, draw, line
from mckibben.web.identify import NEEDS_MUSCLE
from mckibben.web.layout import (
    JobPage,
    NumberField,
    button,
    frame,
    panel,
    quiet,
    select,
    side,
    table,
    text_area,
    upload,
)
from mckibben.web.parts import CHOICES
from mckibben.web.results import Presented, show_result
from mckibben.web.session import session
from mckibben.web.workbench import (
    ANGLES,
    CONTROLLERS,
    SIGNALS,
    SMALL_MOTION,
    START,
    Curves,
    Workbench,
    chosen_kinds,
    compute,
    parse,
    with_joint,
    with_section,
)

_NEW_JOINT = (
    "The joint is that of the page Joint, with another reference of the stiffness. Load, valve and gains are still "
    "those of the scenario before: set them here, and tune the gains on the page Tune."
)
_KEPT = (PURPLE, ORANGE, SKY)
"""Colours of kept runs, of which there are at most as many."""
_GROUPS = {"controller.": "Gains", "reference.": "References"}
_PLANT = {
    "joint.": "Joint and muscles",
    "load.": "Load",
    "friction.": "Friction of the joint",
    "valve.": "Valves",
    "sensors.": "Sensors",
    "disturbance.": "Disturbance",
}


def page() -> None:
    """The page."""
    visitor = session()
    with frame("/run"):
        _Page(visitor.state(Workbench), visitor.folder)


_HIDDEN = re.compile(r"\.(model|specimen|law|domain)\.")
"""Parameters without a field on the page."""


class _Page(JobPage[Workbench]):
    """Forms and plots of one visit.

    Fields and curves are those of the last scenario that ran; after an error they are grey.
    """

    def __init__(self, state: Workbench, folder: Path) -> None:
        super().__init__(state, folder)
        self.formed = -1
        self.text = ""
        self.selects: dict[str, ui.select] = {}
        with side():
            with panel("Controller and references"):
                for label, options in {"controller": CONTROLLERS, "angle": SIGNALS, "stiffness": SIGNALS}.items():
                    self.select(label, options)
            with panel(), _section("Plant").mark("plant"):
                for label, choice in CHOICES.items():
                    self.select(label, choice.options)
            self.form = ui.column().classes("w-full").style("gap: 16px")
            with panel("Scenario"):
                self.yaml = text_area("scenario", LONGEST_TEXT, 260).mark("yaml")
                with ui.row().style("gap: 8px"):
                    button("Run", self.apply, "run", main=True)
                    button("Download", self.download)
                upload("or a scenario.yaml", 4 * LONGEST_TEXT, self.uploaded).props("accept=.yaml,.yml")
        with side():
            with ui.row().classes("w-full items-center").style("gap: 12px"):
                button("Keep this run", self.keep, "keep", main=True)
                button("Remove kept runs", self.clear)
                with ui.row().classes("items-center no-wrap") as self.busy:
                    ui.spinner(size="20px")
                    quiet("computing; a new kind of controller compiles for a few seconds")
                    button("Cancel", state.jobs.cancel, "cancel").props("dense")
            self.remarks = ui.column().classes("w-full")
            with panel("Angle", stays=True):
                self.angle = chart("time [s]", "angle [°]", height=270)
            with ui.column().classes("w-full").style("gap: 16px") as self.results:
                with panel("Stiffness"):
                    self.stiffness = chart("time [s]", "stiffness [N·m/rad]", height=270)
                with panel("Stiffness of small motion, with friction") as self.small_panel:
                    self.small = chart("time [s]", "stiffness [N·m/rad]", height=200)
                with panel("Pressures"):
                    self.pressure = chart("time [s]", "pressure [bar]", height=230)
                with panel("Kept runs") as self.comparison:
                    self.numbers = ui.column().classes("w-full")
        ui.timer(0.0, self.begin, once=True)  # once a browser shows the page: a request alone computes nothing
        ui.timer(0.1, self.refresh)

    def select(self, label: str, options: Iterable[str]) -> None:
        """A select that changes the scenario, and shows the kind that runs."""

        def changed(event: events.ValueChangeEventArguments) -> None:
            if event.value and event.value != self.state.options.get(label):
                self.choose(label, event.value)

        self.selects[label] = select(list(options), label, label, on_change=changed)

    def begin(self) -> None:
        """Run the joint of another page, or the first scenario."""
        state, folder = self.state, self.folder
        if state.waiting:
            text, state.waiting = state.waiting, ""
            self.apply_text(text)
        elif state.joint:
            text = START if state.current is None else state.current.text
            joint, state.joint = state.joint, ""
            self.change(lambda: with_joint(text, joint, folder), note=_NEW_JOINT)
        elif state.current is None and not state.jobs.busy:
            self.apply_text(state.text)

    def refresh(self) -> None:
        """Show new results."""
        state = self.state
        self.busy.visible = state.jobs.busy
        if self.formed != state.form:
            self.formed = state.form
            self.form.clear()
            if state.scenario is not None:
                with self.form:
                    self.fields(state.scenario)
        if self.news():
            if self.text != state.text:  # otherwise it may be being edited
                self.text = self.yaml.value = state.text
            self.show_results(self.remarks, self.show)
            if state.scenario is not None and not state.jobs.busy:
                for label, kind in state.options.items():
                    self.selects[label].value = kind
            for part in (self.angle, self.results, self.form):
                part.classes(**{"remove" if state.error is None else "add": "stale"})
            if state.current is not None:
                self.plot(state.current)

    def show(self) -> None:
        """Show the error or the warnings of the last run, and the result of the last scenario that ran."""
        state = self.state
        self.show_notes()
        if state.presented is not None:
            with ui.column().classes("w-full" + (" stale" if state.error else "")), show_result(state.presented, "run"):
                if state.error is not None:
                    quiet("Fields, curves and numbers are those of the last scenario that ran.")

    def change(self, make: Callable[[], Scenario], *, form: bool = True, note: str = "", scroll: bool = False) -> None:
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

        def run(progress: Callable[[str, float], None]) -> tuple[Scenario, dict[str, str | None], Curves, Presented]:
            scenario = make()
            progress("run", 0.1)  # unless another has been requested since
            return scenario, _options(scenario), *compute(scenario, folder)

        def done(ran: tuple[Scenario, dict[str, str | None], Curves, Presented], heard: list[str]) -> None:
            state.scenario, state.options, state.current, state.presented = ran
            state.text, state.error = state.current.text, None
            state.notes = [*filter(None, [note]), *state.presented.others(heard)]
            state.form += form

        self.start_job(run, done, scroll=scroll)  # not from a field or a select, which may be changed again

    def apply_text(self, text: str) -> None:
        """Run the scenario in a text."""
        self.state.text = text
        self.change(lambda: parse(text, self.folder), scroll=True)

    def apply(self) -> None:
        """Run the text on the page."""
        self.apply_text(self.yaml.value or "")

    async def uploaded(self, event: events.UploadEventArguments) -> None:
        """Run an uploaded scenario."""
        content = await event.file.read()
        self.apply_text(content[: 4 * LONGEST_TEXT].decode("utf-8", errors="replace"))

    def download(self) -> None:
        """Offer the shown scenario for download."""
        ui.download.content(self.state.text, "scenario.yaml")
        if "muscle.yaml" in self.state.text:
            ui.notify(NEEDS_MUSCLE, multi_line=True)

    def choose(self, label: str, kind: str) -> None:
        """Run the scenario with another kind of controller, reference or part of the plant."""
        now, scenario, folder = self.state.current, self.state.scenario, self.folder
        if (choice := CHOICES.get(label)) is not None:
            if scenario is not None:
                self.change(lambda: choice.choose(scenario, kind))
            return
        if label == "controller":
            section, place = CONTROLLERS[kind], ("controller",)
        else:
            section, place = SIGNALS[kind].format(**_levels(label, now)), ("reference", label)
        text = START if now is None else now.text  # the last valid one
        self.change(lambda: parse(with_section(text, section, place), folder))

    def fields(self, scenario: Scenario) -> None:
        """Fields for the numbers set in a scenario."""
        parameters = list_parameters(scenario)
        for prefix, title in {**_GROUPS, **_PLANT}.items():
            shown = [
                (parameter, parameter.nominal)
                for parameter in parameters
                if parameter.nominal is not None
                and parameter.name.startswith(prefix)
                and not _HIDDEN.search(parameter.name)
            ]
            if not shown:
                continue
            with panel(), _section(title, opened=prefix in _GROUPS), ui.element("div").classes("fields"):
                for parameter, nominal in shown:
                    self.number(parameter, nominal, parameter.name.removeprefix(prefix))

    def number(self, parameter: ScenarioParameter, nominal: float, name: str) -> None:
        """A number field, in the unit of files."""
        scale = 1.0 if parameter.is_integer else factor(parameter.shown)
        unit = "" if parameter.shown == "1" else parameter.shown

        def si(value: float) -> float | int:
            return int(value) if parameter.is_integer and value.is_integer() else value * scale

        def changed(value: float) -> None:
            if (scenario := self.state.scenario) is not None:
                self.change(lambda: with_values(scenario, {parameter.name: si(float(value))}), form=False)

        NumberField(
            name.replace(".", " ").replace("_", " "),
            float(f"{nominal / scale:.10g}"),
            lambda value: parameter.holds(si(float(value))),
            f"{'a whole number, ' if parameter.is_integer else ''}{parameter.range}",
            changed,
            step=_step(nominal / scale),
        ).props(f'dense debounce=400 hint="{unit}"').classes("w-full").mark(parameter.name)

    def keep(self) -> None:
        """Keep the current run for comparison."""
        state = self.state
        if state.current is not None:
            state.overlays.append(dataclasses.replace(state.current, name=f"run {len(state.overlays) + 1}"))
            del state.overlays[: -len(_KEPT)]
            state.jobs.version += 1

    def clear(self) -> None:
        """Remove all kept runs."""
        self.state.overlays.clear()
        self.state.jobs.version += 1

    def plot(self, now: Curves) -> None:
        """Draw angle, stiffness with its attainable range, pressures and metrics of this run over kept ones."""
        time, columns, overlays = now.columns["time"], now.columns, self.state.overlays

        def reference(name: str, unit: float) -> Series:
            return line("desired", time, columns[name] / unit, DESIRED, dash=True, width=1.5)

        def curves(name: str, unit: float) -> list[Series]:
            older = [
                line(run.name, run.columns["time"], run.columns[name] / unit, color, width=1.5)
                for color, run in zip(_KEPT, overlays, strict=False)
                if name in run.columns
            ]
            return [*older, line("now", time, columns[name] / unit, MEASURED)]

        draw(self.angle, [*curves("angle", deg), reference("desired_angle", deg)])
        bounds = band("attainable at rest", time, *now.band, "#9aa7b3")
        draw(self.stiffness, [*bounds, *curves("stiffness", 1.0), reference("desired_stiffness", 1.0)])
        self.small_panel.visible = SMALL_MOTION in columns
        if self.small_panel.visible:  # in its own chart, as it can be many times the isobaric stiffness
            draw(self.small, curves(SMALL_MOTION, 1.0))
        colors = (("muscle 1", "pressure1", MUSCLES[0]), ("muscle 2", "pressure2", MUSCLES[1]))
        draw(self.pressure, [line(name, time, columns[key] / bar, color) for name, key, color in colors])
        self.comparison.visible = bool(overlays)
        self.numbers.clear()
        with self.numbers:
            rows = [_row(run) for run in (dataclasses.replace(now, name="now"), *overlays)]
            table(("run", "angle RMSE [°]", "stiffness RMSE [N·m/rad]", "coupling [°]", "air [L]", "outcome"), rows)


def _options(scenario: Scenario) -> dict[str, str | None]:
    """Options of a scenario by the label of their select; None if the page does not offer its part."""
    return chosen_kinds(scenario) | {label: choice.chosen(scenario) for label, choice in CHOICES.items()}


def _levels(label: str, now: Curves | None) -> dict[str, str]:
    """Levels of a new reference as text, by the name in `SIGNALS`.

    Those of the angle are fixed, those of the stiffness 0.9 and 1.1 times the mean of the present one.
    """
    if label == "angle":
        return ANGLES
    mean = 15.0 if now is None else float(np.mean(now.columns["desired_stiffness"]))
    factors = {"at": 1.0, "low": 0.9, "high": 1.1, "half": 0.1}
    return {name: f"{factor * mean:.3g} N*m/rad" for name, factor in factors.items()}


def _section(title: str, *, opened: bool = False) -> ui.expansion:
    """A part of the page that opens and closes."""
    return ui.expansion(title, value=opened).classes("w-full").props("dense header-class=heading")


def _row(run: Curves) -> tuple[str, ...]:
    """Cells of a run: name, RMSE of angle [deg] and stiffness [N*m/rad], coupling [deg], air [L], outcome."""
    names = ("angle_rmse_deg", "stiffness_rmse", "coupling_deg", "air_L")
    numbers = (f"{run.metrics[name]:.3g}" if np.isfinite(run.metrics[name]) else "-" for name in names)
    return printable(run.name, 60), *numbers, run.outcome


def _step(value: float) -> float:
    """Step of a field: a twentieth of the number, rounded to one digit.

    >>> _step(3.7), _step(0.0)
    (0.2, 0.1)
    """
    return float(f"{abs(value) / 20:.0e}") or 0.1
