"""Start page: the three steps in pictures, drawn from the catalog's muscle and a joint that moves; ways to begin."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable

import numpy as np
from nicegui import ui

from mckibben.muscle.muscle import forces
from mckibben.report.palette import DESIRED, MEASURED
from mckibben.units import bar, deg
from mckibben.web.charts import pressure_colour
from mckibben.web.design import JointDesign, drawing, joint_of, muscles
from mckibben.web.identify import IdentificationState
from mckibben.web.layout import button, frame, heading, quiet
from mckibben.web.session import in_thread, session
from mckibben.web.workbench import START, Workbench

_STEPS = {
    "1 Muscle": "Points of a test become a force law with friction.",
    "2 Joint": "Two muscles turn a joint, with a torque and a stiffness.",
    "3 Run": "A controller moves it; gains are tuned for your tolerances.",
}
_SHAPE = re.compile(r"<(polyline|polygon|circle) [^>]*/>")


def page() -> None:
    """The page."""
    with frame("/"):
        with ui.element("div").classes("ways"):
            pictures = [_step(title, text) for title, text in _STEPS.items()]
        with ui.element("div").classes("ways"):
            _way(
                "Your data",
                "Pressure, force, and length or contraction in CSV, Excel, MATLAB, TDMS or LabVIEW files.",
                "Choose a file",
                "/identify",
            )
            _way(
                "Example data",
                "Points that Martens and Boblan measured on a Festo DMSP-10-250: see them, fit them, build a joint.",
                "Try it",
                "/identify",
                lambda: setattr(session().state(IdentificationState), "wanted", "dmsp-10-250-martens2017"),
            )
            _way(
                "The paper's knee",
                "Lei et al.: position and stiffness of a knee with two muscles, controlled by two PID loops.",
                "Run it",
                "/run",
                lambda: setattr(session().state(Workbench), "ran", START),
            )

    async def draw() -> None:
        drawn, _ = await in_thread(step_pictures)
        for picture, content in zip(pictures, drawn, strict=True):
            picture.content = content

    ui.timer(0.0, draw, once=True)


def _step(title: str, text: str) -> ui.html:
    with ui.column().classes("panel").style("gap: 6px"):
        heading(title)
        quiet(text)
        return ui.html("", sanitize=False).classes("w-full drawing")  # only numbers


def _way(title: str, text: str, label: str, path: str, before: Callable[[], object] = lambda: None) -> None:
    with ui.column().classes("panel").style("gap: 10px"):
        heading(title)
        quiet(text)
        button(label, lambda: (before(), ui.navigate.to(path)), main=True)


@functools.cache
def step_pictures(frames: int = 16, swing: float = 25 * deg) -> tuple[str, str, str]:
    """The three steps as SVG: a force law, the joint of the page Joint in motion, and its angle over time."""
    muscle = next(iter(muscles(None).values()))
    joint, phases = joint_of(JointDesign(), muscle), np.linspace(0.0, 2 * np.pi, frames + 1)
    poses = []
    for angle in swing * np.sin(phases):
        first, second = map(muscle.specimen.contraction_at, joint.geometry.path_lengths(angle))
        poses.append(drawing(joint, angle, (first, second)))
    contraction, levels = np.linspace(-0.03, 0.25, 40), np.arange(1.0, 7.0)
    law = [
        _curve(
            1000 * contraction + 30, forces(muscle.law, contraction, level * bar) / 4, pressure_colour((level - 1) / 5)
        )
        for level in levels
    ]
    times = np.linspace(0.0, 280.0, frames + 1)
    path = _curve(times, 110 + 80 * np.sin(phases), DESIRED)
    dots = [
        f'<circle cx="{x:.1f}" cy="{110 - 80 * np.sin(p):.1f}" r="7" fill="{MEASURED}"/>'
        for x, p in zip(times, phases, strict=True)
    ]
    return (
        _svg("force over contraction", law),
        moving(poses),
        moving([_svg("angle over time", [path, dot]) for dot in dots]),
    )


def _curve(x: np.ndarray, y: np.ndarray, colour: str) -> str:
    points = " ".join(f"{a:.1f},{220 - b:.1f}" for a, b in zip(x, y, strict=True) if b > 0)
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2.5"/>'


def _svg(title: str, shapes: list[str]) -> str:
    look = 'viewBox="-10 -10 300 240"'
    return f'<svg {look} role="img" aria-label="{title}">{"".join(shapes)}</svg>'


def moving(poses: list[str], seconds: float = 4.0) -> str:
    """One SVG that moves through others of the same shapes, again and again, in a time [s].

    >>> moving(['<circle cx="1" r="2"/>', '<circle cx="3" r="2"/>'])
    '<circle cx="1" r="2"><animate attributeName="cx" dur="4s" repeatCount="indefinite" values="1;3"/></circle>'
    """
    shapes = iter(list(zip(*map(_tags, poses), strict=True)))

    def animated(match: re.Match[str]) -> str:
        over = next(shapes)
        changes = {
            name: ";".join(tag[name] for tag in over) for name in over[0] if len({tag[name] for tag in over}) > 1
        }
        inner = "".join(
            f'<animate attributeName="{name}" dur="{seconds:g}s" repeatCount="indefinite" values="{values}"/>'
            for name, values in changes.items()
        )
        return f"{match[0][:-2]}>{inner}</{match[1]}>"

    return _SHAPE.sub(animated, poses[0])


def _tags(svg: str) -> list[dict[str, str]]:
    """Attributes of each shape."""
    return [dict(re.findall(r'([\w-]+)="([^"]*)"', match[0])) for match in _SHAPE.finditer(svg)]
