"""Page of runs: references, controller and gains, live plots, and the scenario as YAML."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from nicegui import events, ui

from mckibben.config.document import LONGEST_TEXT
from mckibben.errors import printable
from mckibben.report.palette import BLACK, BLUE, MUSCLES
from mckibben.scenario import Scenario, ScenarioParameter, list_parameters, with_values
from mckibben.units import bar, deg, factor
from mckibben.web.identify import NEEDS_MUSCLE
from mckibben.web.layout import (
    PALETTE,
    JobPage,
    NumberField,
    band,
    button,
    chart,
    draw,
    frame,
    line,
    panel,
    quiet,
    results_side,
    select,
    side,
    table,
    text_area,
    upload,
)
from mckibben.web.parts import CHOICES
from mckibben.web.session import session
from mckibben.web.workbench import (
    ANGLES,
    CONTROLLERS,
    SIGNALS,
    SMALL_MOTION,
    START,
    Kept,
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
_MOST_KEPT = len(PALETTE) - 1
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
    kept = session()
    with frame("/run"):
        _Page(kept.state(Workbench), kept.folder)


_HIDDEN = re.compile(r"\.(model|specimen|law|domain)\.")
"""Parameters without a field on the page."""


class _Page(JobPage[Workbench]):
    """Forms and plots of one visit."""

    def __init__(self, state: Workbench, folder: Path) -> None:
        super().__init__(state, folder)
        self.formed = -1
        self.text = ""
        self.selects: dict[str, ui.select] = {}
        with side():
            with panel("Controller and references"):
                for label, options, choose in (
                    ("controller", list(CONTROLLERS), self.choose_controller),
                    ("angle", list(SIGNALS), self.choose_angle),
                    ("stiffness", list(SIGNALS), self.choose_stiffness),
                ):
                    self.select(label, options, self.chosen(label, choose))
            with panel(), _section("Plant").mark("plant"):
                for label, choice in CHOICES.items():
                    self.select(label, list(choice.options), self.part(label))
            self.form = ui.column().classes("w-full").style("gap: 16px")
            with panel("Scenario"):
                self.yaml = text_area("scenario", LONGEST_TEXT, 260).mark("yaml")
                with ui.row().style("gap: 8px"):
                    button("Run", self.apply, "run", main=True)
                    button("Download", self.download)
                upload("or a scenario.yaml", 4 * LONGEST_TEXT, self.uploaded).props("accept=.yaml,.yml")
        with results_side():
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
                with panel("Numbers"):
                    self.numbers = ui.column().classes("w-full")
        ui.timer(0.0, self.begin, once=True)  # once a browser shows the page: a request alone computes nothing
        ui.timer(0.1, self.refresh)

    def select(
        self, label: str, options: list[str], changed: Callable[[events.ValueChangeEventArguments], None]
    ) -> None:
        """A select with a label."""
        self.selects[label] = select(options, label, label, on_change=changed)

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
            for shown in (self.angle, self.results, self.form):
                shown.classes(**{"remove" if state.error is None else "add": "stale"})
            if state.current is not None:
                self.plot(state.current)

    def show(self) -> None:
        """Show the error or the remarks of the last run."""
        self.show_notes()
        if self.state.error is not None and self.state.current is not None:
            quiet("The fields and curves are those of the last scenario that ran.")

    def change(self, make: Callable[[], Scenario], *, form: bool = True, note: str = "", scroll: bool = False) -> None:
        """Change the scenario and run it, with a note on the change; rebuild the fields if its structure changed."""
        state, folder = self.state, self.folder

        def run(progress: Callable[[str, float], None]) -> tuple[Scenario, dict[str, str | None], Kept, list[str]]:
            scenario = make()
            progress("run", 0.1)  # unless another has been requested since
            return scenario, _options(scenario), *compute(scenario, folder)

        def done(found: tuple[Scenario, dict[str, str | None], Kept, list[str]], heard: list[str]) -> None:
            state.scenario, state.options, state.current, remarks = found
            state.text, state.error = state.current.text, None
            state.notes = [*filter(None, [note]), *remarks, *heard]
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

    def chosen(
        self, label: str, choose: Callable[[events.ValueChangeEventArguments], None]
    ) -> Callable[[events.ValueChangeEventArguments], None]:
        """The handler of a select, which shows the kind that runs."""

        def changed(event: events.ValueChangeEventArguments) -> None:
            if event.value and event.value != self.state.options.get(label):
                choose(event)

        return changed

    def part(self, label: str) -> Callable[[events.ValueChangeEventArguments], None]:
        """The handler of a select of the plant."""

        def choose(event: events.ValueChangeEventArguments) -> None:
            if (scenario := self.state.scenario) is not None:
                self.change(lambda: CHOICES[label].choose(scenario, event.value))

        return self.chosen(label, choose)

    def section(self, section: str, *place: str) -> None:
        """Run the scenario with a new section."""
        text = START if self.state.current is None else self.state.current.text  # the last valid one
        self.change(lambda: parse(with_section(text, section, place), self.folder))

    def choose_controller(self, event: events.ValueChangeEventArguments) -> None:
        """Change the kind of controller, with initial gains."""
        self.section(CONTROLLERS[event.value], "controller")

    def choose_angle(self, event: events.ValueChangeEventArguments) -> None:
        """Change the kind of angle reference."""
        self.section(SIGNALS[event.value].format(**ANGLES), "reference", "angle")

    def choose_stiffness(self, event: events.ValueChangeEventArguments) -> None:
        """Change the kind of stiffness reference, keeping its mean."""
        now = self.state.current
        mean = 15.0 if now is None else float(np.mean(now.columns["desired_stiffness"]))
        low, high = f"{0.9 * mean:.3g} N*m/rad", f"{1.1 * mean:.3g} N*m/rad"
        parts = {"at": f"{mean:.3g} N*m/rad", "low": low, "high": high, "half": f"{0.1 * mean:.3g} N*m/rad"}
        self.section(SIGNALS[event.value].format(**parts), "reference", "stiffness")

    def fields(self, scenario: Scenario) -> None:
        """Fields for the numbers set in a scenario."""
        every = [(one, one.nominal) for one in list_parameters(scenario) if one.nominal is not None]
        for prefix, title in {**_GROUPS, **_PLANT}.items():
            found = [one for one in every if one[0].name.startswith(prefix) and not _HIDDEN.search(one[0].name)]
            if not found:
                continue
            with panel(), _section(title, opened=prefix in _GROUPS), ui.element("div").classes("fields"):
                for one, nominal in found:
                    self.number(one, nominal, one.name.removeprefix(prefix))

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
            number = len(state.kept) + 1
            state.kept.append(dataclasses.replace(state.current, name=f"run {number}"))
            del state.kept[:-_MOST_KEPT]
            state.jobs.version += 1

    def clear(self) -> None:
        """Remove all kept runs."""
        self.state.kept.clear()
        self.state.jobs.version += 1

    def plot(self, now: Kept) -> None:
        """Curves of the current run over the kept ones."""
        time, columns, overlays = now.columns["time"], now.columns, self.state.kept
        pairs = [(one, PALETTE[1 + i % _MOST_KEPT]) for i, one in enumerate(overlays)]
        desired = line("reference", time, columns["desired_angle"] / deg, BLACK, dash=True, width=1.5)
        older = [line(one.name, one.columns["time"], one.columns["angle"] / deg, c, width=1.5) for one, c in pairs]
        draw(self.angle, [*older, line("now", time, columns["angle"] / deg, BLUE), desired])
        desired = line("reference", time, columns["desired_stiffness"], BLACK, dash=True, width=1.5)
        older = [line(one.name, one.columns["time"], one.columns["stiffness"], c, width=1.5) for one, c in pairs]
        bounds = band("attainable at rest", time, *now.band, "#9aa7b3")
        draw(self.stiffness, [*bounds, *older, line("now", time, columns["stiffness"], BLUE), desired])
        small = columns.get(SMALL_MOTION)
        self.small_panel.visible = small is not None
        if small is not None:  # in its own chart, as it can be many times the isobaric stiffness
            older = [
                line(one.name, one.columns["time"], one.columns[SMALL_MOTION], c, width=1.5)
                for one, c in pairs
                if SMALL_MOTION in one.columns
            ]
            draw(self.small, [*older, line("now", time, small, BLUE)])
        colors = (("muscle 1", "pressure1", MUSCLES[0]), ("muscle 2", "pressure2", MUSCLES[1]))
        draw(self.pressure, [line(name, time, columns[key] / bar, color) for name, key, color in colors])
        self.numbers.clear()
        with self.numbers:
            rows = [_row(one) for one in (dataclasses.replace(now, name="now"), *overlays)]
            table(("run", "angle RMSE [°]", "stiffness RMSE [N·m/rad]", "coupling [°]", "air [L]", "outcome"), rows)


def _options(scenario: Scenario) -> dict[str, str | None]:
    """Options of a scenario by the label of their select; None if the page does not offer its part."""
    return chosen_kinds(scenario) | {label: choice.chosen(scenario) for label, choice in CHOICES.items()}


def _section(title: str, *, opened: bool = False) -> ui.expansion:
    """A part of the page that opens and closes."""
    return ui.expansion(title, value=opened).classes("w-full").props("dense header-class=heading")


def _row(one: Kept) -> tuple[str, ...]:
    names = ("angle_rmse_deg", "stiffness_rmse", "coupling_deg", "air_L")
    numbers = (f"{one.metrics[name]:.3g}" if np.isfinite(one.metrics[name]) else "-" for name in names)
    return printable(one.name, 60), *numbers, one.outcome


def _step(value: float) -> float:
    """Step of a field: a twentieth of the number, rounded to one digit."""
    return float(f"{abs(value) / 20:.0e}") or 0.1
