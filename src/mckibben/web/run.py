"""Page of runs: references, controller and gains, with plots that follow, and the scenario as YAML."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from nicegui import events, ui

from mckibben.config.document import LONGEST_TEXT, read_document, to_text
from mckibben.config.model import parse_model
from mckibben.errors import McKibbenError, ParameterError, printable
from mckibben.simulation import Result
from mckibben.simulation.metrics import in_shown_units
from mckibben.study.parameters import ScenarioParameter, list_parameters
from mckibben.study.parameters.values import with_values
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.building import run_scenario
from mckibben.units import bar, deg, factor
from mckibben.web.layout import (
    BLACK,
    BLUE,
    GREEN,
    PALETTE,
    VERMILLION,
    band,
    chart,
    draw,
    frame,
    line,
    panel,
    show_error,
    show_warnings,
    side,
    table,
)
from mckibben.web.session import Jobs, session

MOST_STEPS = 2_000_000
"""Integration steps of a run; more are for the command line, where a run can be stopped."""
_MOST_KEPT = len(PALETTE) - 1

_START = """\
name: knee
joint:
  geometry: knee-table-2
  connector_length: 208 mm
  muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
load: knee-table-2
valve: {time_constant: 20 ms}
controller:
  position: {pid: {kp: 2 bar/rad, ki: 60 bar/(rad*s), kd: 0.4 bar*s/rad}}
  stiffness: {pid: {kp: 0.08 bar/(N*m/rad), ki: 5 bar/(N*m*s/rad), kd: 0 bar*s/(N*m/rad)}}
reference:
  angle: {sine: {amplitude: 10 deg, frequency: 0.5 Hz}}
  stiffness: {step: {before: 13 N*m/rad, after: 17 N*m/rad, at: 3 s}}
start: {angle: 0 deg, stiffness: 12 N*m/rad}
duration: 6 s
control_period: 1 ms
"""
CONTROLLERS = {
    "two PID loops": _START[_START.index("  position") : _START.index("reference")],
    "PID loops with backpropagation": """\
  position: {backprop: {kp: 2 bar/rad, ki: 60 bar/(rad*s), kd: 0.4 bar*s/rad, gain_ratio: 2, learning_rate: 3 1/s,
    momentum: 0.5, signal_scale: 10 deg, error_scale: 1 deg, output_scale: 10 bar/s, seed: 0}}
  stiffness: {backprop: {kp: 0.08 bar/(N*m/rad), ki: 5 bar/(N*m*s/rad), kd: 0 bar*s/(N*m/rad), gain_ratio: 2,
    learning_rate: 3 1/s, momentum: 0.5, signal_scale: 15 N*m/rad, error_scale: 1 N*m/rad, output_scale: 1 bar/s,
    jacobian: sign, seed: 0}}
""",
    "model inversion (decoupling)": """\
  decoupling:
    poles: {bandwidth: 80 rad/s}
    disturbance_observer: {bandwidth: 250 rad/s}
    pressure_observer: {bandwidth: 200 rad/s}
""",
    "predictive control": """\
  predictive:
    bandwidth: 80 rad/s
    disturbance_observer: {bandwidth: 250 rad/s}
    pressure_observer: {bandwidth: 200 rad/s}
""",
}
_SIGNALS = {
    "constant": "{at}",
    "step": "{{step: {{before: {low}, after: {high}, at: 3 s}}}}",
    "ramp": "{{ramp: {{before: {low}, after: {high}, start: 2 s, duration: 2 s}}}}",
    "sine": "{{sine: {{amplitude: {half}, frequency: 0.5 Hz, offset: {at}}}}}",
}
_ANGLES = {"at": "0 deg", "low": "-8 deg", "high": "8 deg", "half": "10 deg"}
_GROUPS = {"controller.": "Gains", "reference.": "References", "load.": "Load"}
_COLUMNS = ("time", "angle", "desired_angle", "stiffness", "desired_stiffness", "pressure1", "pressure2")


@dataclass(frozen=True)
class Kept:
    """Curves, metrics and file of a run."""

    name: str
    columns: dict[str, np.ndarray]
    band: tuple[np.ndarray, np.ndarray]
    metrics: dict[str, float]
    outcome: str
    text: str


@dataclass
class Workbench:
    """State of the page; `joint` is a section of a scenario, to be taken over."""

    scenario: Scenario | None = None
    text: str = _START
    current: Kept | None = None
    kept: list[Kept] = field(default_factory=list)
    error: McKibbenError | None = None
    notes: list[str] = field(default_factory=list)
    jobs: Jobs = field(default_factory=Jobs)
    joint: str = ""
    form: int = 0


def parse(text: str, folder: Path) -> Scenario:
    """A scenario that names no files but those of the session, and is no longer than a page can wait for."""
    found = parse_model(Scenario, text, source="scenario", folder=folder, confined=True)[0]
    steps = found.duration / found.control_period * found.substeps
    if steps > MOST_STEPS:
        raise ParameterError(
            f"the run has {steps:.3g} integration steps, more than {MOST_STEPS:.3g}",
            value=steps,
            remedy="shorten the duration, or use `mckibben simulate`",
        )
    return found


def compute(scenario: Scenario, folder: Path) -> tuple[Kept, list[str]]:
    """Run a scenario; its curves, and remarks."""
    result, feasibility = run_scenario(scenario)
    remarks = [] if feasibility.feasible else [feasibility.describe()]
    if result.outcome.name != "COMPLETED":
        remarks.append(result.outcome.value)
    return _kept(scenario, result, folder), remarks


def _kept(scenario: Scenario, result: Result, folder: Path) -> Kept:
    step = max(1, len(result["angle"]) // 1200)
    columns = {name: np.asarray(result[name])[::step] for name in _COLUMNS}
    bounds = np.asarray(result["lowest_stiffness"])[::step], np.asarray(result["highest_stiffness"])[::step]
    text = scenario.dumps(folder=folder)
    return Kept(
        scenario.name,
        columns,
        bounds,
        in_shown_units(result.metrics),
        result.outcome.name.lower().replace("_", " "),
        text,
    )


def with_section(text: str, section: str, place: tuple[str, ...]) -> str:
    """The text of a scenario with another section at a place."""
    data = _plain(read_document(text).data)
    inner: Any = data
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = _plain(read_document(f"x: {section}" if "\n" not in section else f"x:\n{section}").data)["x"]
    return to_text(data)


def _plain(data: Any) -> Any:
    """A document with dictionaries that may be changed, and lists."""
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    return [_plain(one) for one in data] if isinstance(data, tuple | list) else data


def with_joint(text: str, joint: str, folder: Path) -> Scenario:
    """The scenario with another joint, and a stiffness reference inside what that attains."""
    data = _plain(read_document(text).data)
    data["joint"] = _plain(read_document(joint).data)["joint"]
    scenario = parse(to_text(data), folder)
    plant = scenario.plant()
    angles = jnp.linspace(-10.0, 10.0, 9) * deg
    low, high = plant.joint.attainable_stiffness(angles, -plant.load.gravity_torque(angles))
    lowest, highest = float(jnp.max(low)), float(jnp.min(high))
    if not lowest < highest:  # as it is: the run says why
        return scenario
    before, after = (lowest + part * (highest - lowest) for part in (0.3, 0.6))
    data["reference"]["stiffness"] = {
        "step": {
            "before": f"{before:.3g} N*m/rad",
            "after": f"{after:.3g} N*m/rad",
            "at": f"{scenario.duration / 2:g} s",
        }
    }
    data["start"] = {"angle": "0 deg", "stiffness": f"{before:.3g} N*m/rad"}
    return parse(to_text(data), folder)


def page() -> None:
    """The page."""
    kept = session()
    with frame("/run"):
        _Page(kept.state(Workbench), kept.folder)


class _Page:
    """Forms and plots of one visit."""

    def __init__(self, state: Workbench, folder: Path) -> None:
        self.state, self.folder = state, folder
        self.shown = self.formed = -1
        self.text = ""
        with side():
            with panel("Controller and references"):
                for label, options, choose in (
                    ("controller", list(CONTROLLERS), self.choose_controller),
                    ("angle", list(_SIGNALS), self.choose_angle),
                    ("stiffness", list(_SIGNALS), self.choose_stiffness),
                ):
                    ui.select(options, label=f"{label}: choose a kind", on_change=choose).props("dense").classes(
                        "w-full"
                    ).mark(label)
            self.form = ui.column().classes("w-full").style("gap: 16px")
            with panel("Scenario"):
                self.yaml = (
                    ui.textarea()
                    .props(f"outlined maxlength={LONGEST_TEXT} spellcheck=false input-style='height: 260px'")
                    .classes("w-full mono")
                    .mark("yaml")
                )
                with ui.row().style("gap: 8px"):
                    ui.button("Run", on_click=self.apply).props("unelevated no-caps").mark("run")
                    ui.button("Download", on_click=self.download).props("flat no-caps")
                ui.upload(
                    label="or a scenario.yaml",
                    auto_upload=True,
                    max_file_size=4 * LONGEST_TEXT,
                    on_upload=self.uploaded,
                ).props("flat bordered accept=.yaml,.yml").classes("w-full")
        with side():
            with ui.row().classes("w-full items-center no-wrap").style("gap: 12px"):
                ui.button("Keep this run", on_click=self.keep).props("unelevated no-caps").mark("keep")
                ui.button("Remove kept runs", on_click=self.clear).props("flat no-caps")
                with ui.row().classes("items-center no-wrap") as self.busy:
                    ui.spinner(size="20px")
                    ui.label("computing; a new kind of controller compiles for some seconds").classes("quiet")
                    ui.button("Cancel", on_click=state.jobs.cancel).props("flat dense no-caps").mark("cancel")
            self.remarks = ui.column().classes("w-full")
            with panel("Angle", stays=True):
                self.angle = chart("time [s]", "angle [°]", height=270)
            with panel("Stiffness"):
                self.stiffness = chart("time [s]", "stiffness [N·m/rad]", height=270)
            with panel("Pressures"):
                self.pressure = chart("time [s]", "pressure [bar]", height=200)
            with panel("Numbers"):
                self.numbers = ui.column().classes("w-full").style("overflow-x: auto")
        ui.timer(0.1, self.refresh)
        if state.joint:
            text = _START if state.current is None else state.current.text
            joint, state.joint = state.joint, ""
            self.change(lambda: with_joint(text, joint, folder))
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
        if self.shown != state.jobs.version:
            self.shown = state.jobs.version
            if self.text != state.text:  # else it may be being edited
                self.text = self.yaml.value = state.text
            self.remarks.clear()
            with self.remarks:
                if state.error is not None:
                    with panel():
                        show_error(state.error)
                elif state.notes:
                    with panel():
                        show_warnings(state.notes)
            if state.current is not None:
                self.plot(state.current)

    def change(self, make: Callable[[], Scenario], *, form: bool = True) -> None:
        """Make another scenario and run it; with other fields if its form is another."""
        state, folder = self.state, self.folder

        def run(progress: Callable[[str, float], None]) -> tuple[Scenario, Kept, list[str]]:
            scenario = make()
            progress("run", 0.1)  # not if another has been asked for since
            return scenario, *compute(scenario, folder)

        def done(found: tuple[Scenario, Kept, list[str]], heard: list[str]) -> None:
            scenario, state.current, remarks = found
            state.scenario, state.text, state.error = scenario, state.current.text, None
            state.notes = [*remarks, *heard]
            state.form += form

        def fail(error: McKibbenError) -> None:
            state.error = error

        state.jobs.start(run, done, fail)

    def apply_text(self, text: str) -> None:
        """Run the scenario of a text."""
        self.state.text = text
        self.change(lambda: parse(text, self.folder))

    def apply(self) -> None:
        """Run the text as it stands in the page."""
        self.apply_text(self.yaml.value or "")

    async def uploaded(self, event: events.UploadEventArguments) -> None:
        """Run an uploaded scenario."""
        content = await event.file.read()
        self.apply_text(content[: 4 * LONGEST_TEXT].decode("utf-8", errors="replace"))

    def download(self) -> None:
        """Hand out the scenario that is shown."""
        ui.download.content(self.state.text, "scenario.yaml")

    def section(self, section: str, *place: str) -> None:
        """Run the scenario with another section."""
        text = _START if self.state.current is None else self.state.current.text  # one that could be run
        self.change(lambda: parse(with_section(text, section, place), self.folder))

    def choose_controller(self, event: events.ValueChangeEventArguments) -> None:
        """Take another kind of controller, with gains to begin with."""
        self.section(CONTROLLERS[event.value], "controller")

    def choose_angle(self, event: events.ValueChangeEventArguments) -> None:
        """Take another kind of angle reference."""
        self.section(_SIGNALS[event.value].format(**_ANGLES), "reference", "angle")

    def choose_stiffness(self, event: events.ValueChangeEventArguments) -> None:
        """Take another kind of stiffness reference, about the mean of the present one."""
        now = self.state.current
        mean = 15.0 if now is None else float(np.mean(now.columns["desired_stiffness"]))
        low, high = f"{0.9 * mean:.3g} N*m/rad", f"{1.1 * mean:.3g} N*m/rad"
        parts = {"at": f"{mean:.3g} N*m/rad", "low": low, "high": high, "half": f"{0.1 * mean:.3g} N*m/rad"}
        self.section(_SIGNALS[event.value].format(**parts), "reference", "stiffness")

    def fields(self, scenario: Scenario) -> None:
        """Fields of the numbers of a scenario that are set."""
        every = [(one, one.nominal) for one in list_parameters(scenario) if one.nominal is not None]
        for prefix, title in _GROUPS.items():
            found = [one for one in every if one[0].name.startswith(prefix) and ".model." not in one[0].name]
            if found:
                with panel(title), ui.element("div").classes("fields"):
                    for one, nominal in found:
                        self.number(one, nominal, one.name.removeprefix(prefix))

    def number(self, parameter: ScenarioParameter, nominal: float, name: str) -> None:
        """A field of a number, in the unit of files."""
        scale = 1.0 if parameter.is_integer else factor(parameter.shown)
        unit = "" if parameter.shown == "1" else parameter.shown

        def changed(event: events.ValueChangeEventArguments) -> None:
            scenario = self.state.scenario
            if event.value is None or scenario is None:
                return
            value = int(event.value) if parameter.is_integer else event.value * scale
            self.change(lambda: with_values(scenario, {parameter.name: value}), form=False)

        short = name.removeprefix("decoupling.").removeprefix("predictive.")
        label = short.replace(".", " ").replace("_", " ") + (f" [{unit}]" if unit else "")
        wide = "grid-column: 1 / -1" if len(label) > 21 else ""
        ui.number(label, value=float(f"{nominal / scale:.10g}"), on_change=changed).props(
            f"dense debounce=400 step={_step(nominal / scale)}"
        ).classes("w-full").style(wide).mark(parameter.name)

    def keep(self) -> None:
        """Keep the current run for comparison."""
        state = self.state
        if state.current is not None:
            number = len(state.kept) + 1
            state.kept.append(dataclasses.replace(state.current, name=f"run {number}"))
            del state.kept[:-_MOST_KEPT]
            state.jobs.version += 1

    def clear(self) -> None:
        """Keep no runs."""
        self.state.kept.clear()
        self.state.jobs.version += 1

    def plot(self, now: Kept) -> None:
        """Curves of the current run over those kept."""
        time, columns, overlays = now.columns["time"], now.columns, self.state.kept
        pairs = [(one, PALETTE[1 + i % _MOST_KEPT]) for i, one in enumerate(overlays)]
        desired = line("reference", time, columns["desired_angle"] / deg, BLACK, dash=True, width=1.5)
        older = [line(one.name, one.columns["time"], one.columns["angle"] / deg, c, width=1.5) for one, c in pairs]
        draw(self.angle, [*older, line("now", time, columns["angle"] / deg, BLUE), desired])
        desired = line("reference", time, columns["desired_stiffness"], BLACK, dash=True, width=1.5)
        older = [line(one.name, one.columns["time"], one.columns["stiffness"], c, width=1.5) for one, c in pairs]
        bounds = band("attainable at rest", time, *now.band, "#9aa7b3")
        draw(self.stiffness, [*bounds, *older, line("now", time, columns["stiffness"], BLUE), desired])
        colors = (("antagonist", "pressure1", GREEN), ("agonist", "pressure2", VERMILLION))
        draw(self.pressure, [line(name, time, columns[key] / bar, color) for name, key, color in colors])
        self.numbers.clear()
        with self.numbers:
            rows = [_row(one) for one in (dataclasses.replace(now, name="now"), *overlays)]
            table(("run", "angle RMSE °", "stiffness RMSE N·m/rad", "coupling °", "air L", "outcome"), rows)


def _row(one: Kept) -> tuple[str, ...]:
    names = ("angle_rmse_deg", "stiffness_rmse", "coupling_deg", "air_L")
    numbers = (f"{one.metrics[name]:.3g}" if np.isfinite(one.metrics[name]) else "-" for name in names)
    return printable(one.name, 60), *numbers, one.outcome


def _step(value: float) -> float:
    """Step of a field: a twentieth of the number, rounded to one digit."""
    return float(f"{abs(value) / 20:.0e}") or 0.1
