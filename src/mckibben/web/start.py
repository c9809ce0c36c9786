"""Start page: three ways to begin."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from mckibben.web.identify import IdentificationState
from mckibben.web.layout import button, frame, heading, quiet
from mckibben.web.session import session
from mckibben.web.workbench import START, Workbench


def page() -> None:
    """The page."""
    with frame("/"), ui.element("div").classes("ways"):
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
            lambda: setattr(session().state(Workbench), "waiting", START),
        )


def _way(title: str, text: str, label: str, path: str, before: Callable[[], object] = lambda: None) -> None:
    with ui.column().classes("panel").style("gap: 10px"):
        heading(title)
        quiet(text)
        button(label, lambda: (before(), ui.navigate.to(path)), main=True)
