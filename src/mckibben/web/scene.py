"""3D views with a time slider: bones, and muscles to scale, coloured by pressure; the joint of a run."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import numpy as np
from nicegui import events, ui

from mckibben.joint import AntagonisticJoint
from mckibben.joint.mechanism import SLENDER, Mechanism, Points
from mckibben.units import bar
from mckibben.web.layout import PageSlider
from mckibben.web.workbench import Kept

HEIGHT = 10.0  # of the fixed limb or the leg, in the units of the scene
_RATE = 12  # frames per second
_SLACK, _FULL = np.array([0xCC, 0xD9, 0xE6]), np.array([0xD5, 0x5E, 0x00])
BONE, CABLE = "#b9c2cb", "#555f69"
# The library draws every frame: draw only if the camera, the size or an object differs from the last drawn frame.
# It takes its size from the window's events: a scene that is hidden at first would keep a size of 0.
_ON_DEMAND = """() => {
  const view = getElement(ID), { renderer } = view;
  const draw = renderer.render.bind(renderer), size = renderer.setSize.bind(renderer);
  let drawn = "";
  renderer.setSize = (...sides) => { drawn = ""; size(...sides); };
  renderer.render = (scene, camera) => {
    camera.updateMatrixWorld();
    scene.updateMatrixWorld();
    const shown = [camera.matrixWorld.elements];
    scene.traverse((one) =>
      shown.push(one.uuid, one.visible, one.matrixWorld.elements, one.material?.color?.getHex() ?? 0));
    const now = JSON.stringify(shown, (_, value) => value.toFixed ? Math.round(1e4 * value) : value);  // it drifts
    if (now !== drawn) { drawn = now; draw(scene, camera); }
  };
  new ResizeObserver(() => view.resize()).observe(view.$el);
}"""


def pressure_color(part: float) -> str:
    """Colour of a muscle at a part of the largest pressure."""
    red, green, blue = (_SLACK + np.clip(part, 0.0, 1.0) * (_FULL - _SLACK)).round().astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


class Film(abc.ABC):
    """A scene that turns with the mouse, a time slider, and a switch that plays it `slowed` by a factor."""

    def __init__(self, *, height: int = 260, slowed: float = 1.0, digits: int = 2) -> None:
        self._end, self._slowed, self._digits, self._scale = 0.0, slowed, digits, 1.0
        with ui.row().classes("w-full items-center no-wrap").style("gap: 12px"):
            self._play = ui.switch("play", on_change=self._start).props("dense").classes("quiet").mark("play")
            self.slider = PageSlider(min=0.0, max=1.0, step=0.01, value=0.0, on_change=self._place)
            self.slider.props('aria-label="time of the run"').mark("time")
            self._time = ui.label().classes("quiet number").style("min-width: 60px; text-align: right")
        self.scene = ui.scene(grid=False, background_color="#ffffff", fps=30).classes("w-full")
        self.scene.style(f"height: {height}px")
        self.scene.on("init", js_handler=_ON_DEMAND.replace("ID", str(self.scene.id)))
        self._timer = ui.timer(1 / _RATE, self._step, active=False)

    @abc.abstractmethod
    def move(self, time: float) -> float:
        """Move everything to a time [s]; returns that of the sample shown."""

    def set_end(self, end: float) -> None:
        """Set the duration [s], and show the time of the slider."""
        self._end = end
        self.slider.props(f"max={end:g} step={end / 200:g}")
        self.slider.value = min(self._now, end)
        self._place()

    def rod(self, color: str, first: Points, last: Points, radius: float) -> Any:
        """A cylinder of radius and length 1, laid between two points [m]."""
        return self.lay(self.scene.cylinder(1, 1, 1, 24).material(color), first, last, radius)

    def lay(self, rod: Any, first: Points, last: Points, radius: float) -> Any:
        """Lay a rod of a radius in units of the scene between two points (x, y, z) [m]."""
        middle, along = self._scale * (first + last) / 2, self._scale * (last - first)
        length = max(float(np.linalg.norm(along)), 1e-6)
        along = along / length
        across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
        across = across / np.linalg.norm(across)
        rod.move(*middle.tolist()).scale(radius, length, radius)
        return rod.rotate_R(np.stack([across, along, np.cross(across, along)], 1).tolist())

    @property
    def _now(self) -> float:
        return self.slider.value or 0.0

    def _place(self, _: events.ValueChangeEventArguments | None = None) -> None:
        if self._end:
            self._time.text = f"{self.move(self._now):.{self._digits}f} s"

    def _start(self) -> None:
        self._timer.active = self._play.value

    def _step(self) -> None:
        """Advance by one frame; restart after the end."""
        if self._end:
            now = self._now
            self.slider.value = 0.0 if now >= self._end else min(now + 1 / _RATE / self._slowed, self._end)


def _in_space(point: Points) -> Points:
    """A point of the x-z plane."""
    return np.array([point[0], 0.0, point[1]])


class JointScene(Film):
    """The joint of a run; it moves in the x-z plane."""

    def __init__(self) -> None:
        super().__init__()
        self._run: Kept | None = None
        self._joint: AntagonisticJoint | None = None

    def show(self, run: Kept) -> None:
        """Show another run."""
        self._run = run
        if self._joint is None or not eqx.tree_equal(run.joint, self._joint):
            self._joint = run.joint
            self._build(run)
        self.set_end(float(run.columns["time"][-1]))

    def _build(self, run: Kept) -> None:
        angles = run.columns["angle"][np.isfinite(run.columns["angle"])]
        self._mechanism = mechanism = Mechanism(run.joint.geometry, (float(angles.min()), float(angles.max())))
        self._scale = scale = HEIGHT / mechanism.height
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
        self.scene.move_camera(4.0, -11.0, 4.0, 0.0, 0.0, 0.2 * HEIGHT, duration=0)

    def _rod(self, color: str, first: Points, last: Points, radius: float) -> Any:
        return self.rod(color, _in_space(first), _in_space(last), radius)

    def move(self, time: float) -> float:
        """Move the limb, cables and muscles to a time [s]."""
        run = self._run
        assert run is not None
        columns = run.columns
        at = int(np.searchsorted(columns["time"], time).clip(max=len(columns["time"]) - 1))
        angle = float(columns["angle"][at])
        if np.isfinite(angle):
            self._moving.rotate(0.0, -angle, 0.0)
            highest = max(float(np.nanmax(columns[name])) for name in ("pressure1", "pressure2")) or bar
            for number, strand in enumerate(self._mechanism.strands(angle)):
                length, diameter = float(run.lengths[number][at]), run.diameters[number]
                thick = SLENDER * length if diameter is None else float(diameter[at])
                self.lay(self._cables[number], _in_space(strand.start), _in_space(strand.end), 0.05)
                first, last = map(_in_space, strand.body(length))
                self.lay(self._muscles[number], first, last, self._scale * thick / 2)
                self._muscles[number].material(pressure_color(columns[f"pressure{number + 1}"][at] / highest))
        return float(columns["time"][at])
