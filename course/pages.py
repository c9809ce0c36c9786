"""Explorers of the labs' pages: parts with sliders that run in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp

from mckibben import catalog
from mckibben.muscle import MaxwellSlip, Muscle
from mckibben.report.explorers import Across, Chart, Curve, Explorer, Slider, Table, explorers, table_explorer
from mckibben.scenario import Scenario
from mckibben.units import bar, mm

EXAMPLES = Path(__file__).parents[1] / "examples"


def _knee(key: str) -> Explorer:
    return explorers(Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml"), [key])[key]


def _hysteresis() -> Explorer:
    """A muscle that is moved along a sine at constant pressure."""
    muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    sliders = [
        Slider("half_width", "half width of the loop", "N", 1.0, 9.0, 0.5, 20.0, 0.5),
        Slider("presliding", "presliding length", "mm", mm, 0.6, 0.1, 2.0, 0.05),
        Slider("amplitude", "amplitude of the motion", "mm", mm, 3.0, 0.05, 6.0, 0.05),
        Slider("contraction", "mean contraction", "%", 0.01, 8.0, 4.0, 16.0, 0.5),
        Slider("pressure", "pressure", "bar", bar, 4.0, 1.0, 6.0, 0.1),
    ]
    initial_length = muscle.specimen.initial_length

    def at(parameters: Any, length: Any, friction: MaxwellSlip, state: Any) -> Any:
        tension = muscle.tension(1 - length / initial_length, parameters["pressure"])
        return tension, friction.force(state, length, tension, parameters["pressure"])

    def friction_of(parameters: Any) -> MaxwellSlip:
        return MaxwellSlip(parameters["half_width"], parameters["presliding"])

    def init(parameters: Any) -> Any:
        length = initial_length * (1 - parameters["contraction"])
        return friction_of(parameters).initial(length), length, 0.0 * length, 0.0 * length

    def row(parameters: Any, state: Any, x: Any) -> Any:
        anchors, before, force_before, energy = state
        friction, middle = friction_of(parameters), initial_length * (1 - parameters["contraction"])
        length = middle + parameters["amplitude"] * jnp.sin(2 * jnp.pi * x)
        tension, force = at(parameters, length, friction, anchors)
        energy = jnp.where(x > 1.75, energy + (force + force_before) / 2 * (length - before), 0.0)
        push = 2 * mm * (x + 0.01)
        (low, _), (high, resisting) = (
            at(parameters, middle + move, friction, friction.initial(middle)) for move in (-push, push)
        )
        isobaric = (high - low) / (2 * push)
        columns = {
            "contraction": 1 - length / initial_length,
            "force": jnp.where(x > 1.25, tension + force, jnp.nan),  # the closed loop
            "law": jnp.where(x > 2.25, tension, jnp.nan),
            "push": push,
            "isobaric": isobaric,
            "secant": isobaric + resisting / push,
        }
        following = friction.project(anchors, length, tension, parameters["pressure"])
        return (following, length, force, energy), columns

    def summary(parameters: Any, state: Any) -> dict[str, Any]:
        friction, middle, tiny = friction_of(parameters), initial_length * (1 - parameters["contraction"]), 1e-3 * mm
        (low, _), (high, resisting) = (
            at(parameters, middle + move, friction, friction.initial(middle)) for move in (-tiny, tiny)
        )
        isobaric = (high - low) / (2 * tiny)
        return {
            "energy": 1e3 * state[3],
            "isobaric": isobaric * mm,
            "small": (isobaric + resisting / tiny) * mm,
            "width": 2 * friction.half_width_at((low + high) / 2, parameters["pressure"]),
        }

    charts = (
        Chart(
            "Force over contraction",
            "force, N",
            (Curve("force", "loop"), Curve("law", "law", fixed=True)),
            across=Across("contraction, %", column="contraction", factor=100.0),
        ),
        Chart(
            "Stiffness to a push from rest",
            "stiffness, N/mm",
            (Curve("secant", "secant"), Curve("isobaric", "isobaric", fixed=True)),
            mm,
            low=0.0,
            across=Across("push, mm", 0.0, 5.0, "push", 1 / mm),
        ),
    )
    words = (
        "The loop is up to {width} N wide and loses {energy} mJ per cycle. The muscle has {small} N/mm to a tiny push, "
        "and {isobaric} N/mm by its law alone."
    )
    table = Table(row, (0.0, 2.75, 441), Across("cycle"), charts, [("", words)], init, summary)
    text = (
        "A muscle moved along a sine at constant pressure, and its stiffness to a push. Dashed: the law without "
        "friction, and, thin, the values at the start."
    )
    return table_explorer("hysteresis", "Explore the loop over friction and motion", text, sliders, table)


EXPLORERS = {
    "force_law": lambda: _knee("force"),
    "hysteresis": _hysteresis,
    "attainable_stiffness": lambda: _knee("attainable"),
    "position_control": lambda: _knee("run"),
}
"""Explorers by lab, in the order of the course."""
