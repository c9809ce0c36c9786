"""Drawings of a joint and its muscles at an angle, with the coordinates of its geometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, SupportsFloat

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Circle, Polygon
from matplotlib.typing import ColorType
from numpy.typing import NDArray

from mckibben.component.checks import check_kind
from mckibben.joint import AntagonisticJoint, Geometry, KneeGeometry
from mckibben.joint.linkage import SLENDER, Linkage, Points, SlideLinkage, linkage_of, muscle_sizes
from mckibben.plant import JointPlant
from mckibben.report.palette import BLACK, GREY, MUSCLES
from mckibben.report.style import blank, minus, pressure_colours, styled
from mckibben.units import bar, deg, mm

if TYPE_CHECKING:
    from mckibben.joint.geometry import Pressures

_BONE, _PLATE, _CABLE, _UNKNOWN = "#C9CED6", "#DCE1E8", "#555555", "#8FBBDD"
_LIMB = 0.62  # length of the moving limb per height
_NOTE = {"fontsize": 9, "color": BLACK}


class JointPicture:
    """Artists of a joint on axes with equal scales, in metres with the joint axis at (0, 0).

    Parameters
    ----------
    axes
        Panel, whose axes are hidden.
    linkage
        Geometry of the joint, scaled for drawing.
    springs
        Whether muscles 1 and 2 are return springs, which are drawn as coils.
    """

    def __init__(self, axes: Axes, linkage: Linkage | SlideLinkage, springs: tuple[bool, bool]) -> None:
        self.linkage, self._springs = linkage, springs
        axes.set_aspect("equal")
        axes.axis("off")
        bodies, strands = linkage.bodies(0.0), linkage.strands(0.0)

        def lines(count: int, width: float) -> list[Line2D]:
            return [
                axes.plot([], [], color=_BONE, linewidth=width, solid_capstyle="round", zorder=1)[0]
                for _ in range(count)
            ]

        self._thick, self._thin = lines(len(bodies.thick), 9), lines(len(bodies.thin), 5)
        self._cams = [Polygon(outline, facecolor=_PLATE, linewidth=0, zorder=2) for outline in linkage.cams(0.0)]
        self._weights = axes.plot([], [], "o", color="#6B7480", markersize=9, zorder=3)[0]
        self._cables = [axes.plot([], [], color=_CABLE, linewidth=1.6, zorder=4)[0] for _ in strands]
        self._bodies = [
            Polygon(np.zeros((3, 2)), closed=True, linewidth=0.8, edgecolor="#333333", zorder=5) for _ in strands
        ]
        for patch in (*self._cams, *self._bodies):
            axes.add_patch(patch)
        for x, y in linkage.pivots:
            radius = 0.012 * linkage.height
            axes.add_patch(Circle((x, y), radius, facecolor="white", edgecolor=BLACK, linewidth=1.0, zorder=6))
        self.artists = [*self._thick, *self._thin, *self._cams, self._weights, *self._cables, *self._bodies]

    def update(
        self, angle: float, lengths: Sequence[float], diameters: Sequence[float | None], colours: Sequence[ColorType]
    ) -> None:
        """Move all artists.

        Parameters
        ----------
        angle
            Joint angle [rad], or position [m].
        lengths, diameters
            Length and diameter [m] of each muscle; None for an unknown diameter.
        colours
            Colour of each muscle.
        """
        linkage = self.linkage
        strands = linkage.strands(angle)
        for patch, outline in zip(self._cams, linkage.cams(angle), strict=True):
            patch.set_xy(outline)
        bodies = linkage.bodies(angle)
        for artist, line in zip((*self._thick, *self._thin), (*bodies.thick, *bodies.thin), strict=True):
            artist.set_data(*line.T)
        self._weights.set_data(*linkage.masses(angle).T)
        for index, strand in enumerate(strands):
            if strand is None:
                continue
            first, last = strand.body(lengths[index])
            cable = [strand.start, first, (np.nan, np.nan), last, strand.end, *strand.wrap]
            diameter = diameters[index]
            width = SLENDER * lengths[index] if diameter is None else diameter
            if self._springs[index]:
                cable[1:4] = _coil(first, last, width)
            self._cables[index].set_data(*np.array(cable).T)
            self._bodies[index].set_xy(_body(first, last, width))
            self._bodies[index].set(facecolor=colours[index], visible=not self._springs[index])


def _frame(first: Points, last: Points) -> tuple[Points, Points]:
    """Vector from the first to the last point, and the unit vector across."""
    along = last - first
    return along, np.array([-along[1], along[0]]) / np.linalg.norm(along)


def _body(first: Points, last: Points, width: float) -> Points:
    """Outline of a muscle: a cylinder with ends that narrow to the fittings over half a diameter."""
    along, across = _frame(first, last)
    share = min(width / 2 / float(np.linalg.norm(along)), 0.25)
    turn = np.linspace(0, np.pi / 2, 9)
    places = np.concatenate([share * (1 - np.cos(turn)), 1 - share * (1 - np.cos(turn[::-1]))])
    half = width / 2 * (0.45 + 0.55 * np.concatenate([np.sin(turn), np.sin(turn[::-1])]))
    middle = first + places[:, None] * along
    return np.concatenate([middle + half[:, None] * across, (middle - half[:, None] * across)[::-1]])


def _coil(first: Points, last: Points, width: float) -> list[Points]:
    """Zigzag of a spring."""
    along, across = _frame(first, last)
    return [first + i / 20 * along + (width / 2 if i % 2 else -width / 2) * (1 <= i <= 19) * across for i in range(21)]


def outer_points(linkage: Linkage | SlideLinkage, angles: Sequence[float]) -> Points:
    """Points that a picture has to contain at these angles [rad]."""
    points = [np.zeros((1, 2))]
    for angle in angles:
        strands = [strand for strand in linkage.strands(angle) if strand is not None]
        points += [np.array([strand.start, strand.end, *strand.wrap]) for strand in strands]
        points += linkage.bodies(angle).thick
    return np.concatenate(points)


@styled
def draw_joint(
    joint: Geometry | AntagonisticJoint | JointPlant,
    angle: float = 0.0,
    pressures: Pressures | None = None,
    *,
    labels: bool = True,
) -> Figure:
    """Drawing of a joint at an angle [rad], with its dimensions and moment arms; of a slide, at a position [m].

    Muscles have the lengths of the geometry, or of the joint at gauge pressures [Pa] (default: 0), and a diameter given
    by the volume of their specimens. A path that is not a straight line is drawn on a pulley
    whose radius is its moment arm.

    Parameters
    ----------
    joint
        A geometry, a joint, or a plant, whose load's point masses are drawn as well.
    angle
        Joint angle [rad].
    pressures
        Gauge pressures (p1, p2) [Pa], which colour the muscles.
    labels
        Whether to label the dimensions.

    Examples
    --------
    >>> from mckibben import catalog
    >>> draw_joint(catalog.joint("knee-table-2"), 0.3, (2e5, 3e5))
    <NotebookFigure size ...>
    """
    plant = joint if isinstance(joint, JointPlant) else None
    body = joint if plant is None else plant.joint
    muscles = body if isinstance(body, AntagonisticJoint) else None
    geometry: Any = body if muscles is None else muscles.geometry
    check_kind("draw_joint", "joint", geometry, Geometry)
    linkage = linkage_of(geometry, (angle,), None if plant is None else plant.load)
    lengths: Sequence[SupportsFloat] = geometry.path_lengths(angle)
    diameters: Sequence[SupportsFloat | None] = (None, None)
    if muscles is not None:
        lengths, diameters = muscle_sizes(muscles, muscles.contractions(angle, pressures or (0.0, 0.0)))
    sizes = [float(length) for length in lengths], [None if width is None else float(width) for width in diameters]
    scale = None if pressures is None else _pressure_scale(muscles, pressures)
    colours = [_UNKNOWN] * 2 if scale is None else list(scale.to_rgba(np.asarray(pressures, float) / bar))

    springs = muscles.springs if muscles else (False, False)
    box = outer_points(linkage, (angle,))
    figure = blank(4.2, 5.0) if labels else blank(2.4, 4.0)
    axes = figure.subplots()
    JointPicture(axes, linkage, springs).update(angle, *sizes, colours)
    (left, bottom), (right, top) = box.min(axis=0), box.max(axis=0)
    margin = 0.04 * max(right - left, top - bottom)
    axes.set(xlim=(left - margin, right + margin), ylim=(bottom - margin, top + margin))
    if scale is not None:
        figure.colorbar(scale, ax=axes, label="pressure [bar]", location="bottom", fraction=0.04, pad=0.02)
    if labels and isinstance(linkage, SlideLinkage):
        _label_slide(axes, linkage, angle)
    elif labels and isinstance(linkage, Linkage):
        _label(axes, linkage, sizes[0], angle)
    return figure


def _pressure_scale(joint: AntagonisticJoint | None, pressures: Pressures) -> ScalarMappable:
    highest = float(np.max(np.asarray(pressures, float)))
    if joint is not None:
        highest = max([highest, *(float(muscle.domain.pressure_max) for muscle in (joint.muscle1, joint.muscle2))])
    return ScalarMappable(Normalize(0.0, highest / bar), pressure_colours())


def _note(
    axes: Axes, at: NDArray[np.float64], text: str, away: NDArray[np.float64], gap: float = 0.0, **look: Any
) -> None:
    """Write text next to a point [m], in a direction and at a distance from it."""
    x, y = np.asarray(at) + gap * np.asarray(away)
    ha = "left" if away[0] > 0.3 else "right" if away[0] < -0.3 else "center"
    va = "bottom" if away[1] > 0.3 else "top" if away[1] < -0.3 else "center"
    halo = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    axes.text(x, y, text, ha=ha, va=va, parse_math=True, zorder=8, bbox=halo, **_NOTE, **look)


def _label_slide(axes: Axes, linkage: SlideLinkage, position: float) -> None:
    """Names of the muscles, and the direction of growing positions."""
    across = np.array([-linkage.along[1], linkage.along[0]])
    gap, turned = 0.12 * linkage.height, math.degrees(math.atan2(linkage.along[1], linkage.along[0]))
    for number, strand in enumerate(linkage.strands(position), 1):
        if strand is not None:
            _note(axes, (strand.start + strand.end) / 2, f"muscle {number}", across, gap, rotation=turned)
    tip = linkage.tip(position) - gap * across
    arrow = {"arrowstyle": "-|>", "linewidth": 0.8, "color": BLACK, "mutation_scale": 8}
    end = tip + 0.1 * linkage.height * linkage.along
    axes.annotate("", tuple(end), tuple(tip), arrowprops=arrow, zorder=7)
    axes.set_title(f"{minus(position / mm, '.3g')} mm", loc="center", color=GREY)


def _label(axes: Axes, linkage: Linkage, lengths: Sequence[float], angle: float) -> None:
    """Names of the muscles, moment arms and angle, and the lengths of a `KneeGeometry`."""
    geometry, up, height = linkage.geometry, linkage.up, linkage.height
    strands = linkage.strands(angle)
    right = np.array([up[1], -up[0]])
    gap, rotation = 0.045 * height, 90.0 if abs(up[1]) > 0.5 else 0.0
    second = 1.0 if (strands[1].start - strands[0].start) @ right >= 0 else -1.0
    for number, (strand, length, side) in enumerate(zip(strands, lengths, (-second, second), strict=True), 1):
        first, last = strand.body(length)
        _note(axes, (first + last) / 2, f"muscle {number}", side * right, gap, rotation=rotation)
        along = (strand.end - strand.start) / strand.length
        foot = strand.start - (strand.start @ along) * along
        color = MUSCLES[number - 1]
        axes.plot(*np.array([np.zeros(2), foot]).T, color=color, linewidth=1.4, linestyle=(0, (3, 1.5)), zorder=7)
        _note(axes, foot, f"$d_{number}$", foot / np.linalg.norm(foot), gap)
        if isinstance(geometry, KneeGeometry) and number == 2:
            _note(axes, (strand.start + first) / 2, "$L_u$", side * right, gap)
            _note(axes, (strand.end + last) / 2, "$L_d$", side * right, gap)
    low, high = axes.get_xlim()
    axes.set_xlim(low - 0.16 * height, high + 0.12 * height)  # room for the names at the sides
    if isinstance(geometry, KneeGeometry):
        _label_height(axes, geometry, height)
    if abs(angle) > 1 * deg:
        down, radius = linkage.limb(0.0, 0.4 * height), 0.3 * height
        axes.plot(*np.array([np.zeros(2), down]).T, color=BLACK, linewidth=0.7, linestyle=(0, (4, 2)), zorder=3)
        zero = math.degrees(math.atan2(down[1], down[0]))
        first, last = sorted((zero, zero + angle / deg))
        arc = {"theta1": first, "theta2": last, "color": BLACK, "linewidth": 0.9, "zorder": 7}
        axes.add_patch(Arc((0, 0), 2 * radius, 2 * radius, **arc))
        _note(axes, linkage.limb(angle / 2, radius), "$θ$", linkage.limb(angle / 2, 1.0), gap / 2)
    arms = " and ".join(f"{float(arm) / mm:.3g}" for arm in geometry.moment_arms(angle))
    axes.set_title(f"{minus(angle / deg, '.3g')} deg: moment arms {arms} mm", loc="center", color=GREY)


def _label_height(axes: Axes, geometry: KneeGeometry, height: float) -> None:
    """Dimension line of the distance from the hip to the hinge."""
    x, top = -float(geometry.joint_radius) - 0.15 * height, float(geometry.joint_length)
    for y, end in ((top, -float(geometry.joint_radius)), (0.0, 0.0)):
        axes.plot([x - 0.02 * height, end], [y, y], color=GREY, linewidth=0.6, zorder=0)
    arrow = {"arrowstyle": "<|-|>", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0, "color": BLACK, "mutation_scale": 7}
    axes.annotate("", (x, 0.0), (x, top), arrowprops=arrow, zorder=7)
    _note(axes, np.array([x, 0.45 * top]), "$H$", np.array([-1.0, 0.0]), 0.02 * height)
