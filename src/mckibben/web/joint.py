"""Page of the joint: geometry with a drawing, attainable stiffness and torque over the angle."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import ArrayLike
from nicegui import ui

from mckibben import catalog
from mckibben.errors import McKibbenError
from mckibben.joint import AntagonisticJoint, KneeGeometry
from mckibben.muscle import Muscle
from mckibben.numerics.compiled import compiled
from mckibben.units import bar, deg, mm, percent
from mckibben.web.identify import IdentificationState
from mckibben.web.layout import (
    BLACK,
    BLUE,
    GREEN,
    LATER,
    VERMILLION,
    NumberSlider,
    band,
    chart,
    draw,
    frame,
    line,
    panel,
    show_error,
    side,
)
from mckibben.web.session import Latest, session

_MUSCLES = {"MAS-10-180N-AA-MC-O": "lei-mas-10-180n", "DMSP-10-250": "sarosi-dmsp-10"}
"""Specimens of the catalog and their laws."""
YOURS = "your fit"
_ANGLES = np.linspace(-40, 40, 81) * deg
_POSE = 40.0


@dataclass
class JointDesign:
    """Numbers of the page, in the units that are shown."""

    muscle: str = next(iter(_MUSCLES))
    joint_length: float = 370.0
    joint_radius: float = 30.0
    contraction: float = 10.0
    torque: float = 0.0
    pressure: float = 6.0
    angle: float = 10.0


class Designed(NamedTuple):
    """A joint with its ranges over the angle, and at the angle that is drawn."""

    joint: AntagonisticJoint
    stiffness: tuple[np.ndarray, np.ndarray]
    torque: tuple[np.ndarray, np.ndarray]
    here: _Pose


class _Pose(NamedTuple):
    """The joint at one angle; pairs are of muscles 1 and 2."""

    stiffness: tuple[Array, Array]
    torque: tuple[Array, Array]
    lengths: tuple[Array, Array]
    arms: tuple[Array, Array]
    contractions: tuple[Array, Array]


@compiled
def _ranges(
    joint: AntagonisticJoint, angles: ArrayLike, torque: ArrayLike, angle: ArrayLike, limits: tuple[float, float]
) -> tuple[Any, Any, _Pose]:
    """Stiffness and torque over angles and at one of them; compiled once for each kind of law."""
    every = jnp.append(jnp.asarray(angles), jnp.asarray(angle))
    stiffness = joint.attainable_stiffness(every, torque, pressure_limits=limits)
    torques = joint.attainable_torque(every, pressure_limits=limits)
    lengths, arms = joint.geometry.paths_and_arms(angle)
    contractions = joint.muscle1.specimen.contraction_at(lengths[0]), joint.muscle2.specimen.contraction_at(lengths[1])
    (low, high), (least, most) = stiffness, torques
    here = _Pose((low[-1], high[-1]), (least[-1], most[-1]), lengths, arms, contractions)
    return (low[:-1], high[:-1]), (least[:-1], most[:-1]), here


def joint_of(design: JointDesign, muscle: Muscle) -> AntagonisticJoint:
    """The joint of two such muscles; raises a `RangeError` for lengths that do not fit."""
    return AntagonisticJoint(
        KneeGeometry(design.joint_length * mm, design.joint_radius * mm, connector_length(design, muscle)),
        muscle,
        muscle,
    )


def connector_length(design: JointDesign, muscle: Muscle) -> float:
    """Length of the connectors [m] with which the muscles have the asked contraction at 0 deg."""
    return design.joint_length * mm - muscle.specimen.initial_length * (1 - design.contraction * percent)


def highest_pressure(muscle: Muscle) -> float:
    """Highest pressure [bar] of a muscle's domain."""
    return round(float(muscle.domain.pressure_max) / bar, 2)


def compute(design: JointDesign, muscle: Muscle) -> Designed:
    """The joint and its ranges."""
    joint = joint_of(design, muscle)
    limits = (0.0, design.pressure * bar)
    found = _ranges(joint, _ANGLES, design.torque, design.angle * deg, limits)
    stiffness, torque, here = found
    return Designed(joint, tuple(map(np.asarray, stiffness)), tuple(map(np.asarray, torque)), here)  # type: ignore[arg-type]


def muscles(fitted: IdentificationState) -> dict[str, Muscle]:
    """Muscles to choose from: of the catalog, and the one identified in this session."""
    known = {name: Muscle(catalog.specimen(name), catalog.law(law)) for name, law in _MUSCLES.items()}
    return {YOURS: fitted.muscle} | known if fitted.muscle is not None else known


def scenario_lines(design: JointDesign, muscle: Muscle) -> str:
    """The section `joint` of a scenario."""
    made_of = (
        "muscle.yaml" if design.muscle == YOURS else f"{{specimen: {design.muscle}, law: {_MUSCLES[design.muscle]}}}"
    )
    lengths = f"joint_length: {design.joint_length:g} mm, joint_radius: {design.joint_radius:g} mm"
    connector = f"connector_length: {connector_length(design, muscle) / mm:.10g} mm"
    return f"joint:\n  geometry: {{{lengths}, {connector}}}\n  muscle: {made_of}\n"


def page() -> None:
    """The page."""
    kept = session()
    design, known = kept.state(JointDesign), muscles(kept.state(IdentificationState))
    if design.muscle not in known:
        design.muscle = next(iter(known))
    with frame("/"):
        _Page(design, known)


class _Page:
    """Sliders, drawing and charts of one visit."""

    def __init__(self, design: JointDesign, known: dict[str, Muscle]) -> None:
        self.design, self.known = design, known
        self.latest = Latest(compute, self.show, self.fail)
        muscle = known[design.muscle]
        with side():
            with panel("Joint"):
                ui.select(list(known), value=design.muscle, label="muscles", on_change=self.choose).props(
                    "dense"
                ).classes("w-full").mark("muscle")
                self.number("from hip to joint axis", "mm", "joint_length", (150, 700), 1)
                self.number("radius of the anchors", "mm", "joint_radius", (8, 80), 0.5)
                self.number("contraction at 0°", "%", "contraction", (-3, 25), 0.1)
                self.connectors = ui.label().classes("quiet number")
            with panel("Load and air"):
                self.number("torque of the load", "N·m", "torque", (-20, 20), 0.1)
                most = highest_pressure(muscle)
                design.pressure = min(design.pressure, most)
                self.pressure = self.number("highest pressure", "bar", "pressure", (0.5, most), 0.1)
            with ui.row().classes("w-full").style("gap: 8px"):
                ui.button("Run this joint", on_click=self.run).props("unelevated no-caps")
                ui.button("Download YAML", on_click=self.download).props("flat no-caps")
        with side():
            with ui.element("div").classes("pair narrow-first"):
                with panel():
                    self.drawing = ui.html("", sanitize=False).classes("w-full")  # lines at numbers, and nothing else
                    with ui.row().classes("w-full justify-between no-wrap"):
                        self.contractions = [
                            ui.label()
                            .classes("quiet number")
                            .style(f"border-left: 4px solid {color}; padding-left: 6px")
                            for color in (BLUE, VERMILLION)
                        ]
                    self.number("angle", "°", "angle", (-_POSE, _POSE), 0.5)
                    self.play = ui.switch("move", on_change=self.move).props("dense").classes("quiet")
                    self.timer = ui.timer(0.05, self.swing, active=False)
                with panel("Attainable stiffness", stays=True):
                    degrees = {"min": -_POSE, "max": _POSE}
                    self.stiffness = chart("joint angle [°]", "stiffness [N·m/rad]", height=350, xAxis=degrees)
                    self.note = ui.label().classes("quiet number")
            with panel("Attainable torque"):
                self.torque = chart("joint angle [°]", "torque [N·m]", height=230, xAxis=degrees)
            with panel("At this angle"), ui.element("div").classes("facts"):
                self.facts = [self.fact(name) for name in ("stiffness", "torque of the muscles", "moment arms")]
        self.errors = ui.column()
        self.phase = 0.0
        self.found: Designed | None = None
        ui.timer(0.0, self.first, once=True)
        ui.timer(LATER, self.show_rest)

    @staticmethod
    def fact(name: str) -> ui.label:
        """A number with its name above."""
        with ui.column().style("gap: 0"):
            ui.label(name).classes("quiet")
            return ui.label().classes("fact")

    def number(self, label: str, unit: str, name: str, limits: tuple[float, float], step: float) -> NumberSlider:
        """A slider of a number of the design."""

        async def changed(value: float) -> None:
            setattr(self.design, name, value)
            await self.again()

        return NumberSlider(label, unit, limits, step, getattr(self.design, name), changed)

    async def first(self) -> None:
        """The first curves; after it nothing of this kind of muscle is compiled."""
        await self.again()

    async def again(self) -> None:
        """Compute for the numbers of the sliders."""
        await self.latest(dataclasses.replace(self.design), self.known[self.design.muscle])

    async def choose(self, event: Any) -> None:
        """Take another muscle; the joint gets as much longer as the muscle is."""
        before, self.design.muscle = self.known[self.design.muscle], event.value
        now = self.known[event.value]
        most = highest_pressure(now)
        self.design.pressure = min(self.design.pressure, most)
        self.pressure.slider.props(f"max={most}")
        self.pressure.slider.value = self.pressure.field.value = self.design.pressure
        longer = (now.specimen.initial_length - before.specimen.initial_length) / mm
        self.design.joint_length = round(self.design.joint_length + longer)
        await self.again()

    def show(self, found: Designed) -> None:
        """Draw the stiffness, and leave the rest to `show_rest`."""
        angles = _ANGLES / deg
        low, high = found.stiffness
        lowest, highest = line("lowest", angles, low, BLUE), line("highest", angles, high, VERMILLION)
        draw(self.stiffness, [*band("attainable", angles, low, high, BLUE), lowest | self.mark(), highest])
        self.found = found

    def mark(self) -> dict[str, Any]:
        """Line at the angle that is drawn."""
        look = {"color": BLACK, "type": [4, 3], "width": 1}
        data = [{"xAxis": self.design.angle}]
        return {
            "markLine": {"symbol": "none", "silent": True, "label": {"show": False}, "lineStyle": look, "data": data}
        }

    def show_rest(self) -> None:
        """Drawing, torque and texts of the newest joint, if they are not shown yet."""
        found, self.found = self.found, None
        if found is None:
            return
        if self.errors.default_slot.children:
            self.errors.clear()
        design, here, angles = self.design, found.here, _ANGLES / deg
        muscle = self.known[design.muscle]
        self.drawing.content = drawing(design, found)
        least, most = found.torque
        load = line("load", [-_POSE, _POSE], [design.torque] * 2, BLACK, dash=True, width=1.5)
        lower, upper = (line(name, angles, edge, GREEN) for name, edge in (("lowest", least), ("highest", most)))
        curves = [*band("attainable", angles, least, most, GREEN), lower | self.mark(), upper, load]
        draw(self.torque, curves, legend=("attainable", "load"))
        reached = np.flatnonzero(np.isfinite(found.stiffness[0]))
        self.note.text = (
            f"the load is held from {angles[reached[0]]:.0f}° to {angles[reached[-1]]:.0f}°"
            if len(reached)
            else "no pressures hold the load at any angle"
        )
        own = muscle.specimen.initial_length / mm
        self.connectors.text = f"connectors {connector_length(design, muscle) / mm:.1f} mm, muscles of {own:g} mm"
        (k1, k2), (t1, t2), arms = (tuple(float(x) for x in pair) for pair in (here.stiffness, here.torque, here.arms))
        self.facts[0].text = f"{k1:.3g} to {k2:.3g} N·m/rad" if math.isfinite(k1) else "the load is not held"
        self.facts[1].text = f"{t1:.3g} to {t2:.3g} N·m" if math.isfinite(t1) else "a muscle is out of its range"
        self.facts[2].text = f"{arms[0] / mm:.1f} and {arms[1] / mm:.1f} mm"
        domain, names = muscle.domain, ("antagonist", "agonist")
        for text, name, one in zip(self.contractions, names, map(float, here.contractions), strict=True):
            inside = domain.contraction_min <= one <= domain.contraction_max
            text.text = f"{name} {one / percent:.1f} %" + ("" if inside else ", out of range")

    def fail(self, error: Exception) -> None:
        """Show why there is no such joint."""
        self.errors.clear()
        self.found = None
        assert isinstance(error, McKibbenError)
        for one in (self.stiffness, self.torque):
            draw(one, [])
        with self.errors, panel():
            show_error(error)

    async def move(self) -> None:
        """Start or stop the motion."""
        self.timer.active = self.play.value

    async def swing(self) -> None:
        """The next angle of the motion."""
        self.phase += 0.07
        self.design.angle = round(0.6 * _POSE * math.sin(self.phase), 1)
        await self.again()

    def download(self) -> None:
        """Hand out the joint as a section of a scenario."""
        text = scenario_lines(self.design, self.known[self.design.muscle])
        ui.download.content(text, "joint.yaml")

    def run(self) -> None:
        """Take the joint to the page of runs."""
        from mckibben.web.run import Workbench

        muscle = self.known[self.design.muscle]
        session().state(Workbench).joint = scenario_lines(self.design, muscle)
        ui.navigate.to("/run")


def drawing(design: JointDesign, found: Designed) -> str:
    """SVG of the joint at its angle, to scale; of numbers only."""
    angle, H, r = design.angle * deg, design.joint_length, design.joint_radius
    shank, bottom = 0.55 * H, 0.62 * H
    width, top = max(0.62 * H, 2.6 * r), 0.06 * H
    cosine, sine = math.cos(angle), math.sin(angle)

    def place(x: float, y: float) -> tuple[float, float]:
        """Coordinates of the drawing, in which y points down."""
        return x, -y

    def stroke(a: tuple[float, float], b: tuple[float, float], color: str, width: float, opacity: float = 1.0) -> str:
        (x1, y1), (x2, y2) = place(*a), place(*b)
        where = f'x1="{x1:.2f}" y1="{y1:.2f}" x2="{x2:.2f}" y2="{y2:.2f}"'
        return f'<line {where} stroke="{color}" stroke-width="{width:.2f}" stroke-linecap="round" opacity="{opacity}"/>'

    def along(a: tuple[float, float], b: tuple[float, float], part: float) -> tuple[float, float]:
        return a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])

    bone = 0.016 * H
    lines = [
        stroke((0, H), (0, 0), "#c3cad1", 2.2 * bone),
        stroke((0, 0), (shank * sine, -shank * cosine), "#aab4bd", 2.2 * bone),
        stroke((-r, H), (r, H), "#8a949d", bone),
        stroke((-r * cosine, -r * sine), (r * cosine, r * sine), "#8a949d", bone),
    ]
    specimen = found.joint.muscle1.specimen
    ends = (((-r, H), (-r * cosine, -r * sine)), ((r, H), (r * cosine, r * sine)))
    for (upper, lower), length, contraction, color in zip(
        ends, found.here.lengths, found.here.contractions, (BLUE, VERMILLION), strict=True
    ):
        span = math.dist(upper, lower)
        part = min(1.0, float(length) / mm / span)
        first = (1 - part) / 2
        thick = (specimen.initial_diameter or 0.05 * specimen.initial_length) / mm
        thick *= 1 + 3 * max(float(contraction), 0.0)  # a sketch: the braid is about so much thicker
        lines += [
            stroke(upper, lower, "#6b7680", 0.5 * bone),
            stroke(along(upper, lower, first), along(upper, lower, first + part), color, thick, 0.9),
        ]
    lines.append(
        f'<circle cx="0" cy="0" r="{1.5 * bone:.2f}" fill="#ffffff" stroke="#5f6b76" stroke-width="{0.6 * bone:.2f}"/>'
    )
    box = f"{-width:.1f} {-H - top:.1f} {2 * width:.1f} {H + top + bottom:.1f}"
    return (
        f'<svg viewBox="{box}" role="img" aria-label="drawing of the joint" '
        f'style="width: 100%; height: 300px; display: block">{"".join(lines)}</svg>'
    )
