"""Page of legs: a landing of a leg from its file, its forces, and the leg in space with its muscles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui
from numpy.typing import NDArray

from mckibben.config.document import LONGEST_TEXT
from mckibben.config.model import parse_model
from mckibben.errors import McKibbenError, Problem, ScenarioError
from mckibben.leg import LegPlant, LegResult, LegScenario, LegStart, PressureSchedule, simulate_leg
from mckibben.units import deg, mm, ms
from mckibben.web.layout import (
    BLACK,
    PALETTE,
    NumberSlider,
    PageSlider,
    chart,
    draw,
    frame,
    line,
    notify_if_replaced,
    panel,
    show_error,
    show_warnings,
    side,
    table,
    text_area,
    upload,
)
from mckibben.web.scene import BONE, CABLE, filling_colour, lay_rod
from mckibben.web.session import Jobs, session

Floats = NDArray[np.float64]

START = """\
name: leg of the paper in space
leg: lei-leg
valve: {class: regulator, conductance: 0.5 L/(s*bar), supply: 7 bar, time_constant: 5 ms, dead_volume: 3 cm^3}
ground: {stiffness: 20 kN/m, damping: 0.5 s/m, friction: 0.1, side_slope: 3 deg}
landing:
  joint: knee
  touchdown: {side: 0 deg, hip: 0 deg, knee: 0 deg}
  drop: [50 mm]
"""
_FRAMES = 300
_RATE = 12  # frames per second
_SIZE = 10.0  # of the leg in the units of the scene
_LONGEST = 5.0  # s, of a landing on the page


@dataclass
class Landing:
    """A landing: curves over time, and points and muscles of the frames that are shown."""

    plant: LegPlant
    commands: tuple[float, ...]
    stiffness: float
    attainable: tuple[float, float]
    times: Floats
    angles: Floats
    force: Floats
    metrics: dict[str, Any]
    points: Floats
    muscles: dict[str, list[Floats]]
    shapes: dict[str, tuple[Floats, Floats, Floats]]
    places: dict[str, int]


@dataclass
class LegBench:
    """State of the page."""

    text: str = START
    drop: float = 0.05
    share: float = 0.5
    landing: Landing | None = None
    error: McKibbenError | None = None
    notes: list[str] = field(default_factory=list)
    jobs: Jobs = field(default_factory=Jobs)


def land(text: str, drop: float, share: float, folder: Path) -> Landing:
    """Simulate a landing from a height [m], at a share of the attainable stiffness of the joint of the file."""
    scenario = parse_model(LegScenario, text, source="leg", folder=folder, confined=True)[0]
    landing = scenario.landing
    if landing is None or landing.duration > _LONGEST:
        remedy = "see docs/leg.md" if landing is None else f"give a `landing` of up to {_LONGEST:g} s"
        raise ScenarioError("leg", [Problem("has no section `landing` that is short enough", remedy=remedy)])
    plant = scenario.plant()
    leg, angles = plant.leg, plant.leg.posture_angles(landing.touchdown)
    index = leg.index(landing.joint)
    low, high = (float(one) for one in leg.joints[index].muscles.attainable_stiffness(angles[index], 0.0))
    stiffness = low + 1e-6 + share * (high - low - 2e-6)
    wanted = [stiffness if at == index else None for at in range(len(leg.joints))]
    commands = tuple(float(one) for one in leg.pressures_for(angles, [0.0] * len(angles), wanted))
    start = LegStart(angles, commands, 0.0, -float(np.sqrt(2 * plant.gravity * drop)))
    schedule = PressureSchedule(tuple((one,) for one in commands))
    duration = scenario.whole_steps(landing.duration)
    run = simulate_leg(plant, schedule, start, duration=duration, **scenario.steps)
    return _shown(plant, run, commands, stiffness, (low, high))


def _shown(
    plant: LegPlant, run: LegResult, commands: tuple[float, ...], stiffness: float, attainable: tuple[float, float]
) -> Landing:
    from mckibben.report.leg_shapes import muscle_shapes, place_of, skeleton, straight_paths

    every = run.to_xarray()
    at = every.isel(time=np.unique(np.linspace(0, every.sizes["time"] - 1, _FRAMES).round().astype(int)))
    paths = straight_paths(plant, at)
    shapes = muscle_shapes(plant, at, float(every["pressure"].max()) or 1.0)
    return Landing(
        plant,
        commands,
        stiffness,
        attainable,
        at["time"].to_numpy(),
        at["angle"].to_numpy() / deg,
        at["ground_up"].to_numpy(),
        run.metrics,
        skeleton(plant, at),
        paths,
        {name: tuple(shapes[name]) for name in paths},  # type: ignore[misc]
        {name: place_of(plant, name) for name in paths},
    )


def page() -> None:
    """The page."""
    kept = session()
    with frame("/leg"):
        _Page(kept.state(LegBench), kept.folder)


class _Page:
    """Forms and plots of one visit."""

    def __init__(self, state: LegBench, folder: Path) -> None:
        self.state, self.folder = state, folder
        self.shown = -1
        self.job = 0
        with side():
            with panel("Landing"):
                NumberSlider("drop", "mm", (5.0, 200.0), 5.0, state.drop / mm, self.set_drop)
                NumberSlider("stiffness", "%", (0.0, 100.0), 5.0, 100 * state.share, self.set_share)
                ui.label("stiffness: a share of what the joint can attain at touchdown").classes("quiet")
            with panel("Leg"):
                self.yaml = text_area("leg", LONGEST_TEXT, 260, value=state.text).mark("yaml")
                ui.button("Land", on_click=self.apply).props("unelevated no-caps").mark("land")
                upload("or a leg.yaml", 4 * LONGEST_TEXT, self.uploaded).props("accept=.yaml,.yml")
        with side():
            with ui.row().classes("items-center no-wrap") as self.busy:
                ui.spinner(size="20px")
                ui.label("computing; a new kind of leg compiles for some seconds").classes("quiet")
                ui.button("Cancel", on_click=state.jobs.cancel).props("flat dense no-caps").mark("cancel")
            self.remarks = ui.column().classes("w-full")
            with panel("Leg in space", stays=True):
                self.scene = LegScene()
            with ui.element("div").classes("pair"):
                with panel("Ground force"):
                    self.force = chart("time [ms]", "force [N]", height=250)
                with panel("Joints"):
                    self.angles = chart("time [ms]", "angle [°]", height=250)
            with panel("Numbers"):
                self.numbers = ui.column().classes("w-full").style("overflow-x: auto")
        ui.timer(0.0, self.begin, once=True)
        ui.timer(0.1, self.refresh)

    def begin(self) -> None:
        """Run the first landing."""
        if self.state.landing is None and not self.state.jobs.busy:
            self.run()

    def set_drop(self, value: float) -> None:
        """Land from another height."""
        self.state.drop = value * mm
        self.run()

    def set_share(self, value: float) -> None:
        """Land with another stiffness."""
        self.state.share = value / 100
        self.run()

    def apply(self) -> None:
        """Land with the leg of the text."""
        self.state.text = self.yaml.value or ""
        self.run()

    async def uploaded(self, event: events.UploadEventArguments) -> None:
        """Land with an uploaded leg."""
        content = await event.file.read()
        self.state.text = self.yaml.value = content[: 4 * LONGEST_TEXT].decode("utf-8", errors="replace")
        self.run()

    def run(self) -> None:
        """Start the landing."""
        state, folder = self.state, self.folder
        text, drop, share = state.text, state.drop, state.share

        def compute(progress: Callable[[str, float], None]) -> Landing:
            progress("landing", 0.1)
            return land(text, drop, share, folder)

        def done(found: Landing, heard: list[str]) -> None:
            state.landing, state.error, state.notes = found, None, heard

        def fail(error: McKibbenError) -> None:
            state.error = error

        self.job = state.jobs.start(compute, done, fail)

    def refresh(self) -> None:
        """Show new results."""
        state = self.state
        self.busy.visible = state.jobs.busy
        self.job = notify_if_replaced(state.jobs, self.job)
        if self.shown == state.jobs.version:
            return
        self.shown = state.jobs.version
        self.remarks.clear()
        with self.remarks:
            if state.error is not None:
                with panel():
                    show_error(state.error)
                    if state.landing is not None:
                        ui.label("The plots are of the last landing.").classes("quiet")
            elif state.notes:
                with panel():
                    show_warnings(state.notes)
        if state.landing is not None:
            self.plot(state.landing)

    def plot(self, now: Landing) -> None:
        """Curves, scene and numbers of a landing."""
        names = [joint.name for joint in now.plant.leg.joints]
        draw(self.force, [line("on the foot", now.times / ms, now.force, BLACK)])
        curves = zip(names, now.angles, PALETTE, strict=False)
        draw(self.angles, [line(name, now.times / ms, angle, color) for name, angle, color in curves])
        self.scene.show(now)
        weight = float(now.plant.leg.total_mass * now.plant.gravity)
        low, high = now.attainable
        rows = [
            ("stiffness of the joint", f"{now.stiffness:.3g} N·m/rad, attainable {low:.3g} to {high:.3g}"),
            ("highest force of the ground", f"{now.metrics['peak_force'] / weight:.3g} weights"),
            ("largest deflection", f"{now.metrics['deflection'] / mm:.3g} mm"),
        ]
        self.numbers.clear()
        with self.numbers:
            table(("quantity", "value"), rows, left=2)


class LegScene:
    """The leg in a scene that can be turned, with a time slider."""

    def __init__(self) -> None:
        self._run: Landing | None = None
        with ui.row().classes("w-full items-center no-wrap").style("gap: 12px"):
            self._play = ui.switch("play", on_change=self._start).props("dense").classes("quiet").mark("play")
            self._speed = ui.select({1.0: "1", 0.1: "1/10", 0.02: "1/50"}, value=0.1, label="speed").props("dense")
            self.slider = PageSlider(min=0.0, max=1.0, step=0.001, value=0.0, on_change=self._place)
            self.slider.props('aria-label="time of the landing"').mark("time")
            self._time = ui.label().classes("quiet number").style("min-width: 60px; text-align: right")
        self.scene = ui.scene(grid=False, background_color="#ffffff", fps=30).classes("w-full").style("height: 320px")
        ui.label("Drag to turn. Muscles are coloured by their pressure.").classes("quiet")
        self._timer = ui.timer(1 / _RATE, self._step, active=False)

    def show(self, run: Landing) -> None:
        """Show another landing."""
        self._run = run
        self._build(run)
        end = float(run.times[-1])
        self.slider.props(f"max={end:g} step={end / 500:g}")
        self.slider.value = min(self.slider.value or 0.0, end)
        self._place()

    def _build(self, run: Landing) -> None:
        height = float(np.ptp(run.points[0, :, 2])) or 1.0
        self._scale = scale = _SIZE / height
        ground = run.plant.ground
        self.scene.clear()
        with self.scene as scene:
            floor = scene.box(16, 16, 0.1).material("#e6e9ed")
            across, normal = np.array([0.0, 1.0, 0.0]), np.array([float(one) for one in ground.normal])
            forwards = np.cross(across, normal)
            forwards /= np.linalg.norm(forwards)
            floor.rotate_R(np.column_stack([forwards, np.cross(normal, forwards), normal]).tolist())
            floor.move(*(-0.05 * normal).tolist())
            lengths = np.linalg.norm(np.diff(run.points[0], axis=0), axis=-1)
            bones = np.flatnonzero(lengths > 1e-6)  # two joints may have one centre
            self._bones = {int(bone): scene.cylinder(1, 1, 1, 24).material(BONE) for bone in bones}
            self._joints = [scene.sphere(0.28).material(CABLE) for _ in run.points[0, 1:-1]]
            foot = max(scale * float(run.plant.leg.foot_radius), 0.1)
            self._foot = scene.sphere(foot).material("#22262b")
            self._trunk = scene.box(1.8, 1.4, 0.7).material("#225c8f")
            self._cables = {
                name: [scene.cylinder(1, 1, 1, 12).material(CABLE) for _ in parts]
                for name, parts in run.muscles.items()
            }
            self._muscles = {name: scene.cylinder(1, 1, 1, 24).material(CABLE) for name in run.muscles}
        self.scene.move_camera(4.0, -9.0, 6.5, 0.0, 0.0, 0.48 * _SIZE, duration=0)

    def _place(self, _: events.ValueChangeEventArguments | None = None) -> None:
        """Move everything to the slider's time."""
        run = self._run
        if run is None:
            return
        at = int(np.searchsorted(run.times, self.slider.value or 0.0).clip(max=len(run.times) - 1))
        self._time.text = f"{run.times[at] / ms:.0f} ms"
        points = self._scale * run.points[at]
        for bone, rod in self._bones.items():
            lay_rod(rod, points[bone], points[bone + 1], 0.18)
        for joint, place in zip(self._joints, points[1:-1], strict=True):
            joint.move(*place.tolist())
        self._foot.move(*points[-1].tolist())
        self._trunk.move(*(points[0] + [0.0, 0.0, 0.35]).tolist())
        for name, parts in run.muscles.items():
            ends = [self._scale * part[at] for part in parts]
            for cable, (first, last) in zip(self._cables[name], ends, strict=True):
                lay_rod(cable, first, last, 0.05)
            first, last = ends[run.places[name]]
            length, diameter, filling = (float(one[at]) for one in run.shapes[name])
            middle, along = (first + last) / 2, last - first
            half = min(0.5, 0.5 * self._scale * length / (float(np.linalg.norm(along)) or 1.0)) * along
            lay_rod(self._muscles[name], middle - half, middle + half, self._scale * diameter / 2)
            self._muscles[name].material(filling_colour(filling))

    def _start(self) -> None:
        self._timer.active = self._play.value

    def _step(self) -> None:
        """Advance by one frame at the chosen speed; restart after the end."""
        if self._run is not None:
            now, end = self.slider.value or 0.0, float(self._run.times[-1])
            self.slider.value = 0.0 if now >= end else min(now + float(self._speed.value) / _RATE, end)
