"""Diagrams of workflows for the pages of the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from mckibben.report.diagram import draw_arrow, draw_block
from mckibben.report.style import blank, styled

OURS, FILE, OTHER = "#DCEAF7", "#F1F3F5", "#F7E7D3"
"""Colours of a command, a file, and a device or another program."""

Box = tuple[float, float, str, str]
"""Column, row from the top, text and colour."""

WORKFLOWS: Mapping[str, tuple[Mapping[str, Box], Sequence[tuple[str, str]]]] = {
    "export": (
        {
            "scenario": (0, 1.5, "scenario.yaml", FILE),
            "export": (1, 1.5, "mckibben\nexport", OURS),
            "c": (2, 0, "controller\nas C99", FILE),
            "js": (2, 1, "controller\nas JavaScript", FILE),
            "fmu": (2, 2, "FMUs", FILE),
            "mjcf": (2, 3, "MJCF, Warp,\nOSIM", FILE),
            "board": (3, 0, "microcontroller", OTHER),
            "page": (3, 1, "browser", OTHER),
            "simulink": (3, 2, "Simulink,\nOpenModelica", OTHER),
            "mujoco": (3, 3, "MuJoCo,\nOpenSim", OTHER),
        },
        [
            ("scenario", "export"),
            *(("export", name) for name in ("c", "js", "fmu", "mjcf")),
            ("c", "board"),
            ("js", "page"),
            ("fmu", "simulink"),
            ("mjcf", "mujoco"),
        ],
    ),
    "deploy": (
        {
            "scenario": (0, 0, "knee.yaml", FILE),
            "tune": (1, 0, "mckibben\ntune", OURS),
            "tuned": (2, 0, "knee-tuned.yaml", FILE),
            "simulate": (3, 0, "mckibben\nsimulate", OURS),
            "export": (2, 1, "mckibben\nexport --to c", OURS),
            "control": (3, 1, "mckibben\nrig control", OURS),
            "code": (2, 2, "C99 with a\nrecorded run", FILE),
            "board": (3, 2, "board or\nROS 2 node", OTHER),
        },
        [
            ("scenario", "tune"),
            ("tune", "tuned"),
            ("tuned", "simulate"),
            ("tuned", "export"),
            ("tuned", "control"),
            ("export", "code"),
            ("code", "board"),
        ],
    ),
    "rig": (
        {
            "protocol": (0, 0.5, "protocol.yaml", FILE),
            "run": (1, 0.5, "mckibben\nrig run", OURS),
            "simulated": (1, 1.5, "rig, simulated\nor physical", OTHER),
            "record": (2, 0, "record: all\nsamples", FILE),
            "data": (2, 1, "isobaric.nc:\npoints", FILE),
            "identify": (3, 1, "mckibben\nidentify", OURS),
            "muscle": (4, 1, "muscle.yaml,\nfit.yaml", FILE),
        },
        [
            ("protocol", "run"),
            ("run", "simulated"),
            ("simulated", "run"),
            ("run", "record"),
            ("run", "data"),
            ("data", "identify"),
            ("identify", "muscle"),
        ],
    ),
    "rig-hardware": (
        {
            "test": (0, 0.5, "test,\nsafety monitor", OURS),
            "backend": (1, 0.5, "card, or\nsimulated rig", OTHER),
            "valve": (2, 0, "pressure\nregulator", OTHER),
            "motor": (2, 1, "motor,\nreducer, screw", OTHER),
            "muscle": (3, 0.5, "muscle", OTHER),
            "sensors": (2, 2, "force and\npressure sensors", OTHER),
        },
        [
            ("test", "backend"),
            ("backend", "valve"),
            ("backend", "motor"),
            ("valve", "muscle"),
            ("motor", "muscle"),
            ("muscle", "sensors"),
            ("sensors", "backend"),
        ],
    ),
    "joint-rig": (
        {
            "scenario": (0, 0, "scenario.yaml", FILE),
            "controller": (1, 0, "controller,\nsafety monitor", OURS),
            "valves": (2, 0, "two valves", OTHER),
            "joint": (3, 0.5, "joint, physical\nor simulated", OTHER),
            "sensors": (2, 1, "angle and\ntwo pressures", OTHER),
            "record": (0, 1, "record and\nmetrics", FILE),
        },
        [
            ("scenario", "controller"),
            ("controller", "valves"),
            ("valves", "joint"),
            ("joint", "sensors"),
            ("sensors", "controller"),
            ("controller", "record"),
        ],
    ),
}
"""Boxes and arrows of each diagram."""

_COLUMN, _ROW, _WIDTH, _HEIGHT = 1.75, 0.72, 1.25, 0.44  # inches


@styled
def draw_workflow(boxes: Mapping[str, Box], arrows: Sequence[tuple[str, str]]) -> Figure:
    """Boxes on a grid, and arrows from the first to the second box of each pair."""
    columns, rows = max(box[0] for box in boxes.values()), max(box[1] for box in boxes.values())
    width, height = columns * _COLUMN + _WIDTH + 0.2, rows * _ROW + _HEIGHT + 0.2
    figure = blank(width, height)
    axes = figure.subplots()
    axes.set(xlim=(0.0, width), ylim=(0.0, height), aspect="equal")
    axes.axis("off")
    places = {
        name: (0.1 + _WIDTH / 2 + column * _COLUMN, height - 0.1 - _HEIGHT / 2 - row * _ROW)
        for name, (column, row, _, _) in boxes.items()
    }
    for name, (_, _, text, colour) in boxes.items():
        draw_block(axes, *places[name], _WIDTH, text, colour)
    for first, last in arrows:
        both = (last, first) in arrows
        draw_arrow(axes, *_between(places[first], places[last], 0.12 if both else 0.0))
    return figure


def _between(first: tuple[float, float], last: tuple[float, float], aside: float) -> list[tuple[float, float]]:
    """Ends of an arrow at the edges of two boxes; `aside` moves both to the right of its direction."""
    (x0, y0), (x1, y1) = first, last
    if x0 == x1:
        side = np.sign(y1 - y0)
        return [(x0 + side * aside, y0 + side * _HEIGHT / 2), (x1 + side * aside, y1 - side * _HEIGHT / 2)]
    side = np.sign(x1 - x0)
    return [(x0 + side * _WIDTH / 2, y0), (x1 - side * _WIDTH / 2, y1)]
