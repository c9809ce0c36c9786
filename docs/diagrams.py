"""Diagrams of the documentation: workflows, and the signal flow of Fig. 5 of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch

from mckibben.report.palette import BLACK
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
            "mjcf": (2, 3, "MJCF", FILE),
            "board": (3, 0, "microcontroller", OTHER),
            "page": (3, 1, "browser", OTHER),
            "simulink": (3, 2, "Simulink,\nOpenModelica", OTHER),
            "mujoco": (3, 3, "MuJoCo", OTHER),
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
            "board": (3, 2, "board", OTHER),
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

TEST_RIG: tuple[Mapping[str, Box], Sequence[tuple[str, str]]] = (
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
)
"""Fig. 2 of the paper, for its report."""

_COLUMN, _ROW, _WIDTH, _HEIGHT = 1.75, 0.72, 1.25, 0.44  # inches
SUM = 0.09  # radius of a summing point [inches]


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


@styled
def draw_control_loop() -> Figure:
    """Block diagram of `PositionStiffnessControl` on a joint: two loops, valves, muscles, joint and load.

    The stiffness is not measured: the controller's model of the joint gives it from the angle and both pressures.
    """
    figure = blank(4.8, 3.5)
    axes = figure.subplots()
    axes.set(xlim=(0.0, 4.8), ylim=(0.0, 3.5), aspect="equal")
    axes.axis("off")
    draw_block(axes, 2.05, 3.1, 1.2, "position\ncontroller", OURS)
    draw_block(axes, 2.05, 2.35, 1.2, "stiffness\ncontroller", OURS)
    draw_block(axes, 3.95, 2.72, 1.2, "$p_1 = p_c − p_d$\n$p_2 = p_c + p_d$", OURS)
    draw_block(axes, 2.25, 1.45, 1.5, "model of the joint\n$K(θ, p_1, p_2)$", OURS)
    draw_block(axes, 4.15, 0.62, 0.9, "valves", OTHER)
    draw_block(axes, 2.93, 0.62, 1.0, "muscles\n$F(ε, p)$", OTHER)
    draw_block(axes, 1.5, 0.62, 1.3, "joint and load\n$τ = F_2 d_2 − F_1 d_1$", OTHER)
    for x, y in ((0.75, 3.1), (1.1, 2.35)):
        axes.add_patch(Circle((x, y), SUM, facecolor="white", edgecolor=BLACK, linewidth=0.9, zorder=4))
        _text(axes, x - 0.17, y + 0.1, "+")
        _text(axes, x + 0.13, y - 0.17, "−")
    draw_arrow(axes, (0.3, 3.1), (0.75 - SUM, 3.1))
    draw_arrow(axes, (0.3, 2.35), (1.1 - SUM, 2.35))
    _text(axes, 0.16, 3.1, "$θ_d$")
    _text(axes, 0.16, 2.35, "$K_d$")
    draw_arrow(axes, (0.75 + SUM, 3.1), (1.45, 3.1))
    draw_arrow(axes, (1.1 + SUM, 2.35), (1.45, 2.35))
    draw_arrow(axes, (2.65, 3.1), (3.0, 3.1), (3.0, 2.86), (3.35, 2.86))
    draw_arrow(axes, (2.65, 2.35), (3.0, 2.35), (3.0, 2.58), (3.35, 2.58))
    _text(axes, 2.83, 3.21, "$p_d$")
    _text(axes, 2.83, 2.24, "$p_c$")
    draw_arrow(axes, (4.45, 2.5), (4.45, 0.84))
    _text(axes, 4.52, 1.95, "commands", rotation=90, va="center", ha="left")
    draw_arrow(axes, (3.7, 0.62), (3.43, 0.62))
    draw_arrow(axes, (2.43, 0.62), (2.15, 0.62))
    draw_arrow(axes, (3.56, 0.62), (3.56, 1.45), (3.0, 1.45))
    _text(axes, 3.3, 1.56, "$p_1, p_2$")
    draw_arrow(axes, (0.85, 0.62), (0.75, 0.62), (0.75, 3.1 - SUM))
    _text(axes, 0.62, 1.75, "$θ$")
    draw_arrow(axes, (0.75, 1.06), (2.25, 1.06), (2.25, 1.23))
    draw_arrow(axes, (1.5, 1.45), (1.1, 1.45), (1.1, 2.35 - SUM))
    _text(axes, 1.27, 1.56, "$K$")
    for x, y in ((3.56, 0.62), (0.75, 1.06)):
        axes.plot(x, y, "o", color=BLACK, markersize=2.6, zorder=4)
    _text(axes, 2.4, 0.14, "blue: controller    orange: plant, simulated or physical", color="#555555")
    return figure


def draw_block(axes: Axes, x: float, y: float, width: float, text: str, colour: str) -> None:
    """Box of a width about a point [inches]."""
    corner, shape = (x - width / 2, y - 0.22), "round,pad=0,rounding_size=0.05"
    axes.add_patch(
        FancyBboxPatch(corner, width, 0.44, shape, facecolor=colour, edgecolor=BLACK, linewidth=0.9, zorder=3)
    )
    _text(axes, x, y, text)


def _text(axes: Axes, x: float, y: float, text: str, **look: object) -> None:
    settings = {"ha": "center", "va": "center", "fontsize": 8.5, "parse_math": True, "zorder": 5} | look
    axes.text(x, y, text, **settings)  # type: ignore[arg-type]


def draw_arrow(axes: Axes, *points: tuple[float, float]) -> None:
    """Line through points [inches] with a head at the last."""
    *before, start, end = points
    axes.plot(*zip(*before, start, strict=True), color=BLACK, linewidth=0.9, zorder=2)
    axes.annotate(
        "", end, start, arrowprops={"arrowstyle": "-|>", "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}, zorder=2
    )
