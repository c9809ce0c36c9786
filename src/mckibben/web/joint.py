"""Joint page: dimensions of a joint with two equal muscles, drawing, attainable stiffness and torque over the angle.

Sliders change the joint at once: the newest values are computed in a thread, and intermediate ones skipped.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial

import numpy as np
from nicegui import events, ui

from mckibben.errors import McKibbenError
from mckibben.muscle import Muscle
from mckibben.report.palette import BLACK, GREY, MUSCLES
from mckibben.units import deg, mm, percent
from mckibben.web.charts import Series, band, chart, draw, line
from mckibben.web.design import (
    ANGLES,
    KINDS,
    POSE,
    Designed,
    JointDesign,
    compute,
    connector_length,
    drawing,
    highest_pressures,
    limits_at,
    muscles,
    pressure_limits,
    scenario_lines,
)
from mckibben.web.identify import IdentificationState
from mckibben.web.layout import (
    LATER,
    NumberField,
    NumberSlider,
    actions,
    button,
    frame,
    panel,
    quiet,
    select,
    show_error,
    side,
)
from mckibben.web.session import Latest, in_thread, session
from mckibben.web.workbench import Workbench, with_joint

_NEW_JOINT = (
    "The joint is that of the page Joint, with a stiffness that it can have. Load, valve and controller are those of "
    "`mckibben new joint`: set them here, and tune the gains on the page Tune."
)
_COMPILING = "computing; a new kind of joint or law compiles for a few seconds"


def _held(angles: np.ndarray, holds: np.ndarray) -> str:
    """Range of angles [deg] at which the load is held; it may go on beyond the ends of the charts.

    >>> _held(np.array([-10.0, 0.0, 10.0, 20.0]), np.array([False, True, True, False]))
    'the load is held from 0° to 10°'
    """
    if not holds.any():
        return "no pressures hold the load at any angle"
    least = "at least " if holds[0] or holds[-1] else ""
    return f"the load is held {least}from {angles[holds][0]:.0f}° to {angles[holds][-1]:.0f}°"


def page() -> None:
    """The page."""
    visitor = session()
    design, choices = visitor.state(JointDesign), muscles(visitor.state(IdentificationState).muscle)
    if design.muscle not in choices:
        design.muscle = next(iter(choices))
    with frame("/joint", design, *vars(design)):
        _Page(design, choices)


class _Page:
    """Sliders, drawing and charts of one visit.

    Parameters
    ----------
    design
        Numbers of the page, kept in the session.
    choices
        Muscles to choose from, by name.
    """

    def __init__(self, design: JointDesign, choices: dict[str, Muscle]) -> None:
        self.design, self.choices = design, choices
        self.latest = Latest(compute, self.show, self.fail)
        self.fields: list[NumberField] = []
        self.old = False  # whether the results are not those of the sliders
        with side():
            with panel("Joint"):
                select(list(choices), "muscles", "muscle", value=design.muscle, on_change=self.choose)
                select(list(KINDS), "kind of joint", "kind", value=design.kind, on_change=self.reshape)
                self.dimensions = ui.column().classes("w-full").style("gap: 10px")
                self.form()
                self.number("contraction at 0°", "%", "contraction", (-3, 25), 0.1)
                self.series = ui.label().classes("quiet number")
            with panel("Load and air"):
                self.number("torque of the load", "N·m", "torque", (-20, 20), 0.1)
                self.pressure = ui.column().classes("w-full")
                self.pressure_form()
                self.lowest = quiet("")
            with actions():
                button("Run this joint", self.run, main=True)
        with side():
            with ui.element("div").classes("pair narrow-first"):
                with panel():
                    self.drawing = ui.html("", sanitize=False).classes("w-full")  # only lines with numbers
                    with ui.row().classes("w-full justify-between no-wrap"):
                        self.contractions = [
                            ui.label()
                            .classes("quiet number")
                            .style(f"border-left: 4px solid {color}; padding-left: 6px")
                            for color in MUSCLES
                        ]
                    self.number("angle", "°", "angle", (-POSE, POSE), 0.5)
                with panel("Attainable stiffness", stays=True):
                    degrees = {"min": -POSE, "max": POSE}
                    self.stiffness = chart("joint angle [°]", "stiffness [N·m/rad]", height=350, xAxis=degrees)
                    self.note = ui.label(_COMPILING).classes("quiet number")
                    self.limits = quiet("")
                    self.errors = ui.column()
            with panel("Attainable torque"):
                self.torque = chart("joint angle [°]", "torque [N·m]", height=230, xAxis=degrees)
            with panel("At this angle"), ui.element("div").classes("facts") as facts:
                self.facts = [self.fact(name) for name in ("stiffness", "torque of the muscles", "moment arms")]
        self.shown = self.drawing, self.stiffness, self.torque, facts
        self.newest: Designed | None = None
        ui.timer(0.0, self.again, once=True)
        ui.timer(LATER, self.show_rest)

    @staticmethod
    def fact(name: str) -> ui.label:
        """A number with its name above it."""
        with ui.column().style("gap: 0"):
            ui.label(name).classes("quiet")
            return ui.label().classes("fact")

    def number(self, label: str, unit: str, name: str, limits: tuple[float, float], step: float) -> None:
        """A slider for a number of the design.

        Parameters
        ----------
        label, unit
            Text, and shown unit.
        name
            Attribute of `JointDesign`.
        limits, step
            Range and step of the slider.
        """

        async def changed(value: float) -> None:
            setattr(self.design, name, value)
            await self.again()

        self.slider(NumberSlider(label, unit, limits, step, getattr(self.design, name), changed))

    def slider(self, slider: NumberSlider) -> None:
        """Keep the field of a new slider: the results are grey while it shows a value that is refused."""
        self.fields = [*(field for field in self.fields if not field.is_deleted), slider.field]
        slider.field.on_value_change(self.grey)

    def form(self) -> None:
        """Sliders for the dimensions of this kind of joint."""
        self.dimensions.clear()
        with self.dimensions:
            for name, dimension in KINDS[self.design.kind].dimensions.items():

                async def changed(value: float, name: str = name) -> None:
                    self.design.dimensions[name] = value
                    await self.again()

                value = self.design.dimensions[name]
                self.slider(
                    NumberSlider(dimension.label, dimension.unit, dimension.limits, dimension.step, value, changed)
                )

    def pressure_form(self) -> None:
        """Slider for the highest pressure, in the range of the muscle."""
        limits = highest_pressures(self.choices[self.design.muscle])
        self.design.pressure = min(max(self.design.pressure, limits[0]), limits[1])
        self.pressure.clear()
        with self.pressure:
            self.number("highest pressure", "bar", "pressure", limits, 0.1)

    def wait(self) -> None:
        """Grey what belongs to another kind of joint or muscle until the new one is computed."""
        self.note.text, self.limits.text = _COMPILING, ""
        self.grey(old=True)

    def grey(self, _: object = None, *, old: bool | None = None) -> None:
        """Grey the results if they are old, or if the value of a field is refused; otherwise show their colours."""
        self.old = self.old if old is None else old
        refused = any(not field.validate() for field in self.fields if not field.is_deleted)
        for part in self.shown:
            part.classes(**{"add" if self.old or refused else "remove": "stale"})
        for text in (self.note, self.limits):
            text.classes(**{"add" if refused else "remove": "stale"})

    async def reshape(self, event: events.ValueChangeEventArguments) -> None:
        """Change the kind of joint."""
        self.wait()
        self.design.kind, self.design.dimensions = event.value, {}
        self.design.__post_init__()
        self.form()
        await self.again()

    async def again(self) -> None:
        """Compute for the slider values."""
        now = dataclasses.replace(self.design, dimensions=dict(self.design.dimensions))
        await self.latest(now, self.choices[self.design.muscle])

    async def choose(self, event: events.ValueChangeEventArguments) -> None:
        """Change the muscle; the joint's length changes with the muscle's."""
        before, self.design.muscle = self.choices[self.design.muscle], event.value
        now = self.choices[event.value]
        self.wait()
        self.pressure_form()
        if "height" in self.design.dimensions:
            longer = (now.specimen.initial_length - before.specimen.initial_length) / mm
            self.design.dimensions["height"] = round(self.design.dimensions["height"] + longer)
            self.form()
        await self.again()

    def show(self, designed: Designed) -> None:
        """Draw the stiffness; `show_rest` draws the rest."""
        self.grey(old=False)
        angles = ANGLES / deg
        low, high = designed.stiffness
        lowest, highest = line("lowest", angles, low, GREY, dash=True), line("highest", angles, high, GREY)
        draw(self.stiffness, [*band("attainable", angles, low, high, "#9aa7b3"), lowest | self.mark(), highest])
        self.newest = designed

    def mark(self) -> Series:
        """Line at the drawn angle."""
        look = {"color": BLACK, "type": [4, 3], "width": 1}
        data = [{"xAxis": self.design.angle}]
        return {
            "markLine": {"symbol": "none", "silent": True, "label": {"show": False}, "lineStyle": look, "data": data}
        }

    async def show_rest(self) -> None:
        """Show drawing, torque and texts of the newest joint, unless already shown."""
        designed, self.newest = self.newest, None
        if designed is None:
            return
        if self.errors.default_slot.children:
            self.errors.clear()
        design, here, angles = self.design, designed.here, ANGLES / deg
        muscle = self.choices[design.muscle]
        self.drawing.content, _ = await in_thread(drawing, designed.joint, design.angle * deg, here.contractions)
        least, most = designed.torque
        load = line("load", [-POSE, POSE], [design.torque] * 2, BLACK, dash=True, width=1.5)
        lower, upper = (line(name, angles, edge, GREY) for name, edge in (("lowest", least), ("highest", most)))
        curves = [*band("attainable", angles, least, most, "#9aa7b3"), lower | self.mark(), upper, load]
        draw(self.torque, curves, legend=("attainable", "load"))
        self.note.text = _held(angles, np.isfinite(designed.stiffness[0]))
        self.limits.text, _ = await in_thread(limits_at, design, designed)
        least, most = pressure_limits(muscle)
        measured = f"The law was measured from {least:g} to {most:g} bar; with extrapolate: true, scenarios go beyond."
        self.lowest.text = measured if least else ""
        length, between = muscle.specimen.initial_length / mm, connector_length(designed.joint.geometry)
        connectors = "" if between is None else f"connectors {between / mm:.1f} mm, "
        self.series.text = f"{connectors}muscles of {length:g} mm"
        (k1, k2), (t1, t2), arms = (tuple(float(x) for x in pair) for pair in (here.stiffness, here.torque, here.arms))
        small = "" if here.small_motion is None else "; small motion {:.3g} to {:.3g}".format(*here.small_motion)
        self.facts[0].text = f"{k1:.3g} to {k2:.3g} N·m/rad{small}" if math.isfinite(k1) else "the load is not held"
        self.facts[1].text = f"{t1:.3g} to {t2:.3g} N·m" if math.isfinite(t1) else "a muscle is outside its range"
        self.facts[2].text = f"{arms[0] / mm:.1f} and {arms[1] / mm:.1f} mm"
        domain, names = muscle.domain, ("antagonist", "agonist")
        for label, name, contraction in zip(self.contractions, names, map(float, here.contractions), strict=True):
            inside = domain.contraction_min <= contraction <= domain.contraction_max
            label.text = f"{name} {contraction / percent:.1f} %" + ("" if inside else ", out of range")

    def fail(self, error: Exception) -> None:
        """Show why this joint is impossible; the results of the last possible one turn grey."""
        assert isinstance(error, McKibbenError)
        self.newest, self.note.text, self.limits.text = None, "", ""
        self.grey(old=True)
        self.errors.clear()
        with self.errors:
            show_error(error)

    def run(self) -> None:
        """Use the joint on the page of runs."""
        lines, bench = scenario_lines(self.design, self.choices[self.design.muscle]), session().state(Workbench)
        bench.waiting, bench.note = partial(with_joint, lines), _NEW_JOINT
        ui.navigate.to("/run")
