"""Start page: three ways to begin."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from mckibben.web.identify import IdentificationState
from mckibben.web.layout import button, frame, heading, quiet
from mckibben.web.session import session
from mckibben.web.workbench import START, Workbench

_EXAMPLE = "dmsp-10-250-martens2017"


def page() -> None:
    """The page."""
    with frame("/"), ui.element("div").classes("ways"):
        _way(
            "Your data",
            "A CSV, Excel, MATLAB, TDMS or LabVIEW file with pressure, force, and length or contraction of your "
            "muscle. Units are read from the headers; what is not plain is asked at the column.",
            "Choose a file",
            lambda: ui.navigate.to("/identify"),
        )
        _way(
            "Example data",
            "The points that Martens and Boblan measured on a Festo DMSP-10-250: drawn, fitted, and used on a joint.",
            "Try it",
            _example,
        )
        _way(
            "The paper's knee",
            "Lei et al.: position and stiffness of a knee with two muscles, by two PID loops. Change gains, valves and "
            "load, and see the angle follow.",
            "Run it",
            _knee,
        )


def _way(title: str, text: str, label: str, action: Callable[[], object]) -> None:
    with ui.column().classes("panel").style("gap: 10px"):
        heading(title)
        quiet(text)
        button(label, action, f"way-{label.lower().replace(' ', '-')}", main=True)


def _example() -> None:
    session().state(IdentificationState).wanted = _EXAMPLE
    ui.navigate.to("/identify")


def _knee() -> None:
    session().state(Workbench).waiting = START
    ui.navigate.to("/run")
