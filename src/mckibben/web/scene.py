"""3D view of the joint in a run: bones, and muscles to scale, coloured by pressure."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np
from nicegui import events, ui
from numpy.typing import NDArray

from mckibben.joint import AntagonisticJoint
from mckibben.joint.mechanism import SLENDER, Mechanism, Points
from mckibben.units import bar
from mckibben.web.layout import PageSlider
from mckibben.web.workbench import Kept

_HEIGHT = 10.0  # of the fixed limb, in the units of the scene
_RATE = 12  # frames per second
_SLACK, _FULL = np.array([0xCC, 0xD9, 0xE6]), np.array([0xD5, 0x5E, 0x00])
BONE, CABLE = "#b9c2cb", "#555f69"


def lay_rod(rod: Any, first: NDArray[np.float64], last: NDArray[np.float64], radius: float) -> Any:
    """Lay a cylinder of radius and length 1 between two points of a scene."""
    along = last - first
    length = float(np.linalg.norm(along)) or 1e-9
    axis = along / length
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    rod.move(*((first + last) / 2).tolist()).scale(radius, length, radius)
    return rod.rotate_R(np.column_stack([across, axis, np.cross(across, axis)]).tolist())


def filling_colour(part: float) -> str:
    """Colour of a muscle at a part of the largest pressure of a run."""
    red, green, blue = (_SLACK + float(np.clip(part, 0.0, 1.0)) * (_FULL - _SLACK)).round().astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


class JointScene:
    """A scene with a time slider; the joint moves in the x-z plane."""

    def __init__(self) -> None:
        self._run: Kept | None = None
        self._joint: AntagonisticJoint | None = None
        with ui.row().classes("w-full items-center no-wrap").style("gap: 12px"):
            self._play = ui.switch("play", on_change=self._start).props("dense").classes("quiet").mark("play")
            self.slider = PageSlider(min=0.0, max=1.0, step=0.01, value=0.0, on_change=self._place)
            self.slider.props('aria-label="time of the run"').mark("time")
            self._time = ui.label().classes("quiet number").style("min-width: 52px; text-align: right")
        self.scene = ui.scene(grid=False, background_color="#ffffff", fps=30).classes("w-full").style("height: 260px")
        self._timer = ui.timer(1 / _RATE, self._step, active=False)

    def show(self, run: Kept) -> None:
        """Show another run."""
        self._run = run
        if self._joint is None or not eqx.tree_equal(run.joint, self._joint):
            self._joint = run.joint
            self._build(run)
        end = float(run.columns["time"][-1])
        self.slider.props(f"max={end:g} step={end / 200:g}")
        self.slider.value = min(self._now, end)
        self._place()

    def _build(self, run: Kept) -> None:
        angles = run.columns["angle"][np.isfinite(run.columns["angle"])]
        self._mechanism = mechanism = Mechanism(run.joint.geometry, (float(angles.min()), float(angles.max())))
        self._scale = scale = _HEIGHT / mechanism.height
        top, strands = mechanism.height * mechanism.up, mechanism.strands(0.0)
        self.scene.clear()
        with self.scene as scene:
            self._rod(BONE, np.zeros(2), top, 0.3)
            self._rod(BONE, strands[0].start, strands[1].start, 0.15)
            scene.cylinder(0.28, 0.28, 1.4).material(CABLE)  # the axis, along y
            with scene.group() as self._moving:
                self._rod(BONE, np.zeros(2), mechanism.limb(0.0, 0.6 * mechanism.height), 0.3)
                for strand, straight in zip(strands, mechanism.straight, strict=True):
                    if straight:
                        self._rod(BONE, np.zeros(2), strand.end, 0.15)
                for outline in mechanism.cams(0.0):
                    cam = scene.extrusion((scale * outline).tolist(), 0.5).material("#dce1e8")
                    cam.rotate(np.pi / 2, 0, 0).move(y=0.25)
            self._cables = [self._rod(CABLE, one.start, one.end, 0.05) for one in strands]
            self._muscles = [self._rod(CABLE, one.start, one.end, 0.3) for one in strands]
        self.scene.move_camera(4.0, -11.0, 4.0, 0.0, 0.0, 0.2 * _HEIGHT, duration=0)

    def _rod(self, color: str, first: Points, last: Points, radius: float) -> Any:
        """A cylinder of radius and length 1, laid between two points [m]."""
        return self._lay(self.scene.cylinder(1, 1, 1, 24).material(color), first, last, radius)

    def _lay(self, rod: Any, first: Points, last: Points, radius: float) -> Any:
        start, end = (self._scale * np.array([point[0], 0.0, point[1]]) for point in (first, last))
        return lay_rod(rod, start, end, radius)

    @property
    def _now(self) -> float:
        return self.slider.value or 0.0

    def _place(self, _: events.ValueChangeEventArguments | None = None) -> None:
        """Move everything to the slider's time."""
        run = self._run
        if run is None:
            return
        columns = run.columns
        at = int(np.searchsorted(columns["time"], self._now).clip(max=len(columns["time"]) - 1))
        angle = float(columns["angle"][at])
        self._time.text = f"{columns['time'][at]:.2f} s"
        if not np.isfinite(angle):
            return
        self._moving.rotate(0.0, -angle, 0.0)
        highest = max(float(np.nanmax(columns[name])) for name in ("pressure1", "pressure2")) or bar
        for number, strand in enumerate(self._mechanism.strands(angle)):
            length, diameter = float(run.lengths[number][at]), run.diameters[number]
            thick = SLENDER * length if diameter is None else float(diameter[at])
            self._lay(self._cables[number], strand.start, strand.end, 0.05)
            self._lay(self._muscles[number], *strand.body(length), self._scale * thick / 2)
            self._muscles[number].material(filling_colour(columns[f"pressure{number + 1}"][at] / highest))

    def _start(self) -> None:
        self._timer.active = self._play.value

    def _step(self) -> None:
        """Advance by one frame in run time; restart after the end."""
        if self._run is not None:
            now, end = self._now, float(self._run.columns["time"][-1])
            self.slider.value = 0.0 if now >= end else min(now + 1 / _RATE, end)
