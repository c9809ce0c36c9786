"""Page of runs: references, controller and gains, live plots, and the scenario as YAML.

Selects change a part of the scenario, fields its numbers, and the text all of it; every change runs it again.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from nicegui import events, ui

from mckibben.config.document import LONGEST_TEXT
from mckibben.report.palette import DESIRED, MEASURED, MUSCLES, ORANGE, PURPLE, SKY
from mckibben.scenario import Scenario, ScenarioParameter, list_parameters, with_values
from mckibben.simulation import SimulationResult
from mckibben.simulation.metrics import in_shown_units
from mckibben.units import bar, deg
from mckibben.web.charts import Series, band, chart, draw, line
from mckibben.web.forms import meaning, number
from mckibben.web.layout import (
    JobPage,
    button,
    fold,
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
from mckibben.web.results import Presented, Repetition, show_result
from mckibben.web.session import session
from mckibben.web.workbench import (
    SMALL_MOTION,
    ScenarioRun,
    Workbench,
    compute,
    parse,
    scenario_files,
    with_joint,
)

_NEW_JOINT = (
    "The joint is that of the page Joint, with a stiffness that it can have. Load, valve and controller are {}: set "
    "them here, and tune the gains on the page Tune."
)
_KEPT = (PURPLE, ORANGE, SKY)
"""Colours of kept runs, of which there are at most as many."""
_PARTS = ("controller", "reference", "joint", "load", "friction", "valve", "sensors", "disturbance")
"""Parts of a scenario with fields; the first two are open at first."""


def page() -> None:
    """The page."""
    visitor = session()
    state = visitor.state(Workbench)
    with frame("/run", state, "ran"):
        _Page(state, visitor.folder)


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
                for label in [*CHOICES][:3]:
                    self.select(label)
            with panel(), fold("Plant").mark("plant"):
                for label in [*CHOICES][3:]:
                    self.select(label)
            self.form = ui.column().classes("w-full").style("gap: 16px")
            with panel(), fold("Advanced: the scenario as YAML"):
                self.yaml = text_area("scenario", LONGEST_TEXT, 260)
                with ui.row().style("gap: 8px"):
                    button("Run", self.apply, "run", main=True)
                upload("or a scenario.yaml", 4 * LONGEST_TEXT, self.uploaded).props("accept=.yaml,.yml")
        with side():
            with ui.row().classes("w-full items-center").style("gap: 12px"):
                button("Keep this run", self.keep, "keep", main=True)
                button("Remove kept runs", self.clear)
                button("Margins", partial(self.study, "margins"), "margins")
                button("Limits", partial(self.study, "envelope"), "limits")
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

    def select(self, label: str) -> None:
        """A select that changes the scenario, and shows the kind that runs."""

        def changed(event: events.ValueChangeEventArguments) -> None:
            scenario = self.state.scenario
            if event.value and scenario is not None and event.value != self.state.options.get(label):
                self.change(lambda: CHOICES[label].choose(scenario, event.value))

        self.selects[label] = select(list(CHOICES[label].options), label, label, on_change=changed)

    def begin(self) -> None:
        """Run the joint of another page, or the first scenario."""
        state, folder = self.state, self.folder
        if state.waiting:
            text, state.waiting = state.waiting, ""
            self.apply_text(text)
        elif state.joint:
            text = None if state.current is None else state.current.text
            joint, state.joint = state.joint, ""
            note = _NEW_JOINT.format("still those of the scenario before" if text else "those of `mckibben new joint`")
            self.change(lambda: with_joint(text, joint, folder), note=note)
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
        if state.current is not None:
            old = " stale" if state.error else ""
            with ui.column().classes(f"w-full{old}"), show_result(state.current.presented, "run"):
                if state.error is not None:
                    quiet("Fields, curves and numbers are those of the last scenario that ran.")
        for name, presented in state.studies.items():
            show_result(presented, name)

    def change(
        self,
        make: Callable[[], Scenario],
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

        def run(progress: Callable[[str, float], None]) -> tuple[Scenario, dict[str, str | None], ScenarioRun]:
            scenario = make()
            progress("run", 0.1)  # unless another has been requested since
            options = {label: choice.chosen(scenario) for label, choice in CHOICES.items()}
            return scenario, options, compute(scenario, folder)

        def done(ran: tuple[Scenario, dict[str, str | None], ScenarioRun], heard: list[str]) -> None:
            state.scenario, state.options, state.current = ran
            state.studies = {}
            state.text, state.error = state.current.text, None
            state.notes = [*filter(None, [note]), *state.current.presented.others(heard)]
            state.form += form

        self.start_job(run, done, scroll=scroll)  # not from a field or a select, which may be changed again

    def apply_text(self, text: str) -> None:
        """Run the scenario in a text."""
        self.state.text = text
        self.change(lambda: parse(text, self.folder), scroll=True)

    def apply(self) -> None:
        """Run the text on the page."""
        self.apply_text(self.yaml.value or "")

    async def uploaded(self, event: events.MultiUploadEventArguments) -> None:
        """Run an uploaded scenario."""
        content = await event.files[0].read()
        self.apply_text(content[: 4 * LONGEST_TEXT].decode("utf-8", errors="replace"))

    def fields(self, scenario: Scenario) -> None:
        """Fields for the numbers set in a scenario, by its parts, with one column for each loop."""
        parts: dict[str, dict[str, list[ScenarioParameter]]] = {part: {} for part in _PARTS}
        for parameter in list_parameters(scenario):
            if parameter.nominal is not None and parameter.part in parts and not _HIDDEN.search(parameter.name):
                _, *groups, _ = parameter.name.split(".")
                parts[parameter.part].setdefault(next(iter(groups), ""), []).append(parameter)
        for part, columns in parts.items():
            if not columns:
                continue
            with panel(), fold(part.capitalize(), opened=part in _PARTS[:2]), ui.element("div").classes("fields"):
                for group, members in columns.items():
                    alone = not group or len(columns) == 1
                    with ui.element("div").classes("fields wide") if alone else ui.column().style("gap: 4px"):
                        if group:
                            ui.label(group.replace("_", " ")).classes("loop")
                        for parameter in members:
                            name = parameter.name.removeprefix(f"{part}.").removeprefix(f"{group}.")
                            self.number(scenario, parameter, name)

    def number(self, scenario: Scenario, parameter: ScenarioParameter, name: str) -> None:
        """A number field, in the unit of files."""

        def changed(value: float) -> None:
            if (now := self.state.scenario) is not None:
                self.change(lambda: with_values(now, {parameter.name: value}), form=False)

        label, words = name.replace(".", " ").replace("_", " "), meaning(scenario, parameter)
        number(label, parameter.mark, float(parameter.nominal or 0.0), changed, words).mark(parameter.name)

    def study(self, name: str) -> None:
        """Compute stability margins, or the attainable set, of the scenario that ran last."""
        state, folder = self.state, self.folder
        if (scenario := state.scenario) is None or state.current is None:
            return
        text = state.current.text

        def compute(progress: Callable[[str, float], None]) -> Presented:
            progress(name, 0.1)
            words = (name, "scenario.yaml", "--out", name)
            python = f'result = mk.Scenario.read("scenario.yaml").{name}()'
            return Presented.of(getattr(scenario, name)(), Repetition.of(words, python, scenario_files(text, folder)))

        def done(presented: Presented, heard: list[str]) -> None:
            state.studies = {name: presented} | {other: old for other, old in state.studies.items() if other != name}
            state.notes, state.error = presented.others(heard), None

        self.start_job(compute, done)

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

    def plot(self, now: ScenarioRun) -> None:
        """Draw angle, stiffness with its attainable range, pressures and metrics of this run over kept ones."""
        result, overlays = now.result, {f"run {k}": run.result for k, run in enumerate(self.state.overlays, 1)}
        time = result["time"]

        def reference(name: str, unit: float) -> Series:
            return line("desired", time, result[name] / unit, DESIRED, dash=True, width=1.5)

        def curves(name: str, unit: float) -> list[Series]:
            older = [
                line(kept, run["time"], run[name] / unit, color, width=1.5)
                for color, (kept, run) in zip(_KEPT, overlays.items(), strict=False)
                if name in run.columns
            ]
            return [*older, line("now", time, result[name] / unit, MEASURED)]

        draw(self.angle, [*curves("angle", deg), reference("desired_angle", deg)])
        bounds = band("attainable at rest", time, result["lowest_stiffness"], result["highest_stiffness"], "#9aa7b3")
        draw(self.stiffness, [*bounds, *curves("stiffness", 1.0), reference("desired_stiffness", 1.0)])
        self.small_panel.visible = SMALL_MOTION in result.columns
        if self.small_panel.visible:  # in its own chart, as it can be many times the isobaric stiffness
            draw(self.small, curves(SMALL_MOTION, 1.0))
        colors = (("muscle 1", "pressure1", MUSCLES[0]), ("muscle 2", "pressure2", MUSCLES[1]))
        draw(self.pressure, [line(name, time, result[key] / bar, color) for name, key, color in colors])
        self.comparison.visible = bool(overlays)
        self.numbers.clear()
        with self.numbers:
            rows = [_row(name, run) for name, run in {"now": result, **overlays}.items()]
            table(("run", "angle RMSE [°]", "stiffness RMSE [N·m/rad]", "coupling [°]", "air [L]", "outcome"), rows)


def _row(name: str, result: SimulationResult) -> tuple[str, ...]:
    """Cells of a run: name, RMSE of angle [deg] and stiffness [N*m/rad], coupling [deg], air [L], outcome."""
    metrics = in_shown_units(result.metrics)
    shown = (metrics[metric] for metric in ("angle_rmse_deg", "stiffness_rmse", "coupling_deg", "air_L"))
    outcome = result.outcome.name.lower().replace("_", " ")
    return name, *(f"{number:.3g}" if np.isfinite(number) else "-" for number in shown), outcome
