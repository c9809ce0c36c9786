"""Start page: the three steps of the work, and ways to begin."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from mckibben.web.identify import IdentificationState
from mckibben.web.layout import button, frame, heading, quiet
from mckibben.web.session import session
from mckibben.web.workbench import START, Workbench

_STEPS = {
    "1 Muscle": "Points of a test become a force law with friction.",
    "2 Joint": "Two muscles turn a joint, with a torque and a stiffness.",
    "3 Run": "A controller moves it; gains are tuned for your tolerances.",
}


def page() -> None:
    """The page."""
    with frame("/"):
        with ui.element("div").classes("ways"):
            for title, text in _STEPS.items():
                with ui.column().classes("panel").style("gap: 6px"):
                    heading(title)
                    quiet(text)
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
                lambda: setattr(session().state(IdentificationState), "example", "dmsp-10-250-martens2017"),
            )
            _way(
                "The paper's knee",
                "Lei et al.: position and stiffness of a knee with two muscles, controlled by two PID loops.",
                "Run it",
                "/run",
                lambda: setattr(session().state(Workbench), "ran", START),
            )


def _way(title: str, text: str, label: str, path: str, before: Callable[[], object] = lambda: None) -> None:
    with ui.column().classes("panel").style("gap: 10px"):
        heading(title)
        quiet(text)
        button(label, lambda: (before(), ui.navigate.to(path)), main=True)
