"""Signal flow of the control of position and stiffness, as in Fig. 5 of the paper."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch

from mckibben.report.style import BLACK, blank, styled

_CONTROLLER, _PLANT = "#DCEAF7", "#F7E7D3"
_SUM = 0.09  # inches


@styled
def draw_control_loop() -> Figure:
    """Block diagram of `PositionStiffnessControl` on a joint: two loops, valves, muscles, joint and load.

    The stiffness is not measured: the controller's model of the joint gives it from the angle and both pressures.
    """
    figure = blank(4.8, 3.5)
    axes = figure.subplots()
    axes.set(xlim=(0.0, 4.8), ylim=(0.0, 3.5), aspect="equal")
    axes.axis("off")
    draw_block(axes, 2.05, 3.1, 1.2, "position\ncontroller", _CONTROLLER)
    draw_block(axes, 2.05, 2.35, 1.2, "stiffness\ncontroller", _CONTROLLER)
    draw_block(axes, 3.95, 2.72, 1.2, "$p_1 = p_c − p_d$\n$p_2 = p_c + p_d$", _CONTROLLER)
    draw_block(axes, 2.25, 1.45, 1.5, "model of the joint\n$K(θ, p_1, p_2)$", _CONTROLLER)
    draw_block(axes, 4.15, 0.62, 0.9, "valves", _PLANT)
    draw_block(axes, 2.93, 0.62, 1.0, "muscles\n$F(ε, p)$", _PLANT)
    draw_block(axes, 1.5, 0.62, 1.3, "joint and load\n$τ = F_2 d_2 − F_1 d_1$", _PLANT)
    for x, y in ((0.75, 3.1), (1.1, 2.35)):
        axes.add_patch(Circle((x, y), _SUM, facecolor="white", edgecolor=BLACK, linewidth=0.9, zorder=4))
        _text(axes, x - 0.17, y + 0.1, "+")
        _text(axes, x + 0.13, y - 0.17, "−")
    draw_arrow(axes, (0.3, 3.1), (0.75 - _SUM, 3.1))
    draw_arrow(axes, (0.3, 2.35), (1.1 - _SUM, 2.35))
    _text(axes, 0.16, 3.1, "$θ_d$")
    _text(axes, 0.16, 2.35, "$K_d$")
    draw_arrow(axes, (0.75 + _SUM, 3.1), (1.45, 3.1))
    draw_arrow(axes, (1.1 + _SUM, 2.35), (1.45, 2.35))
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
    draw_arrow(axes, (0.85, 0.62), (0.75, 0.62), (0.75, 3.1 - _SUM))
    _text(axes, 0.62, 1.75, "$θ$")
    draw_arrow(axes, (0.75, 1.06), (2.25, 1.06), (2.25, 1.23))
    draw_arrow(axes, (1.5, 1.45), (1.1, 1.45), (1.1, 2.35 - _SUM))
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
