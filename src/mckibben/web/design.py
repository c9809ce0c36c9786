"""Design of a joint with two equal muscles: kinds and their dimensions, ranges over the angle, drawing, and file."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import ArrayLike

from mckibben import catalog
from mckibben.component.schema import ComponentField, write
from mckibben.config.document import to_text
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint, Cam, Geometry, KneeGeometry, PairedPaths, Pulley, TwoBonePath
from mckibben.joint.antagonistic import SMALL_MOTION
from mckibben.joint.attainable import cocontraction_segment, is_affine
from mckibben.joint.linkage import SLENDER, Linkage, Points, muscle_sizes
from mckibben.muscle import Muscle
from mckibben.numerics.compiled import jit
from mckibben.plant.joint_plant import rated_for
from mckibben.reachability.envelope import active_limits
from mckibben.reachability.static import scan_points
from mckibben.report.palette import MUSCLES
from mckibben.units import bar, deg, mm, percent

_MUSCLES = {"MAS-10-180N-AA-MC-O": "lei-mas-10-180n", "DMSP-10-250": "sarosi-dmsp-10"}
"""Specimens of the catalog and their laws."""
YOURS = "your fit"
ANGLES = np.linspace(-40, 40, 81) * deg
POSE = 40.0


class JointDimension(NamedTuple):
    """A dimension of a kind of joint: its label, unit, limits, step and initial value."""

    label: str
    unit: str
    limits: tuple[float, float]
    step: float
    value: float


class JointKind(NamedTuple):
    """A kind of joint: its dimensions, and its geometry from these [mm] and the muscle length [m] at 0 deg."""

    dimensions: dict[str, JointDimension]
    geometry: Callable[..., Geometry]


def _connectors(distance: float, length: float) -> float:
    """Length of the connectors [m] of muscles of a length [m] between anchors at a distance [m]."""
    if distance < length:
        message = f"the anchors are {distance / mm:.4g} mm apart, less than the muscles of {length / mm:.4g} mm"
        remedy = "move them apart, or let the muscles contract more"
        raise RangeError(message, value=distance, lower=length, unit="m", remedy=remedy)
    return round((distance - length) / mm, 6) * mm


def _knee(length: float, *, height: float, radius: float) -> Geometry:
    return KneeGeometry(height * mm, radius * mm, _connectors(height * mm, length))


def _pulleys(length: float, *, radius: float) -> Geometry:
    return PairedPaths(Pulley(radius * mm, length), Pulley(radius * mm, length))


def _cams(length: float, *, arm: float, slope: float, curvature: float) -> Geometry:
    """Cams that are mirror images of each other, of a moment arm and its growth [mm, mm/rad, mm/rad^2]."""
    first, second = (Cam(arm * mm, length, sign * slope * mm, curvature * mm) for sign in (-1, 1))
    return PairedPaths(first, second)


def _bones(length: float, *, height: float, upper: float, lower: float, depth: float) -> Geometry:
    """Muscles on both sides between two bones."""
    between = _connectors(math.hypot(lower - upper, height + depth) * mm, length)
    ends = [(x * mm, y * mm) for x, y in ((upper, height), (lower, -depth))]
    first, second = (
        TwoBonePath(sign * ends[0][0], ends[0][1], sign * ends[1][0], ends[1][1], between) for sign in (-1, 1)
    )
    return PairedPaths(first, second)


_HEIGHT = JointDimension("from hip to joint axis", "mm", (150, 700), 1, 370)
_RADIUS = JointDimension("radius of the anchors", "mm", (8, 80), 0.5, 30)
KINDS = {
    "round knee": JointKind({"height": _HEIGHT, "radius": _RADIUS}, _knee),
    "pulleys": JointKind({"radius": _RADIUS._replace(label="radius of the pulleys")}, _pulleys),
    "cams": JointKind(
        {
            "arm": _RADIUS._replace(label="moment arms at 0°"),
            "slope": JointDimension("growth of an arm", "mm/rad", (-30, 30), 0.5, 10),
            "curvature": JointDimension("curvature of the arms", "mm/rad²", (-30, 30), 0.5, 0),
        },
        _cams,
    ),
    "between two bones": JointKind(
        {
            "height": _HEIGHT,
            "upper": JointDimension("upper anchors, to the side", "mm", (0, 120), 1, 30),
            "lower": JointDimension("lower anchors, to the side", "mm", (8, 120), 1, 35),
            "depth": JointDimension("lower anchors, below the axis", "mm", (-60, 120), 1, 20),
        },
        _bones,
    ),
}
"""Joints of two equal muscles on opposite sides."""


@dataclass
class JointDesign:
    """Numbers of the page, in shown units.

    Attributes
    ----------
    muscle, kind
        Names of the muscle, and of the kind of joint in `KINDS`.
    dimensions
        Dimensions of that kind by name, in the units of their `JointDimension`; default: its initial values.
    contraction
        Contraction of both muscles at 0 deg [%].
    torque, pressure
        Torque of the load [N*m], and highest pressure [bar].
    angle
        Angle [deg] of the drawing.
    """

    muscle: str = next(iter(_MUSCLES))
    kind: str = next(iter(KINDS))
    dimensions: dict[str, float] = field(default_factory=dict)
    contraction: float = 10.0
    torque: float = 0.0
    pressure: float = 6.0
    angle: float = 10.0

    def __post_init__(self) -> None:
        self.dimensions = {
            name: dimension.value for name, dimension in KINDS[self.kind].dimensions.items()
        } | self.dimensions


class Designed(NamedTuple):
    """A joint with its ranges over `ANGLES`, and at the drawn angle.

    Attributes
    ----------
    stiffness, torque
        Lowest and highest attainable stiffness [N*m/rad] at the torque of the load, and torque [N*m]; arrays of the
        shape of `ANGLES`, NaN where the load is not held.
    """

    joint: AntagonisticJoint
    stiffness: tuple[np.ndarray, np.ndarray]
    torque: tuple[np.ndarray, np.ndarray]
    here: _Pose


class _Pose(NamedTuple):
    """The joint at one angle; pairs refer to muscles 1 and 2."""

    stiffness: tuple[Array, Array]
    small_motion: tuple[Array, Array] | None
    torque: tuple[Array, Array]
    arms: tuple[Array, Array]
    contractions: tuple[Array, Array]
    ends: tuple[tuple[Array, Array], ...]
    """Pressures [Pa] at the lowest and at the highest stiffness."""


Edges = tuple[Array, Array]
"""Lowest and highest values over the angles."""


@jit
def _ranges(
    joint: AntagonisticJoint, angles: ArrayLike, torque: ArrayLike, angle: ArrayLike, limits: tuple[float, float]
) -> tuple[Edges, Edges, _Pose]:
    """Stiffness and torque over angles and at one of them; compiled once per kind of law."""
    every = jnp.append(jnp.asarray(angles), jnp.asarray(angle))
    stiffness = joint.attainable_stiffness(every, torque, pressure_limits=limits)
    small = None
    if joint.has_friction:
        small = joint.attainable_stiffness(angle, torque, pressure_limits=limits, amplitude=SMALL_MOTION)
    torques = joint.attainable_torque(every, pressure_limits=limits)
    lengths, arms = joint.geometry.paths_and_arms(angle)
    contractions = joint.muscle1.specimen.contraction_at(lengths[0]), joint.muscle2.specimen.contraction_at(lengths[1])
    (low, high), (least, most) = stiffness, torques
    (pressure1, pressure2), along = cocontraction_segment(joint, angle, torque, limits, 0.0).at(
        scan_points(is_affine(joint))
    )
    ends = tuple((pressure1[at], pressure2[at]) for at in (jnp.argmin(along), jnp.argmax(along)))
    here = _Pose((low[-1], high[-1]), small, (least[-1], most[-1]), arms, contractions, ends)
    return (low[:-1], high[:-1]), (least[:-1], most[:-1]), here


def joint_of(design: JointDesign, muscle: Muscle) -> AntagonisticJoint:
    """The joint with two such muscles; raises a `RangeError` for lengths that do not fit."""
    length = float(muscle.specimen.initial_length) * (1 - design.contraction * percent)
    return AntagonisticJoint(KINDS[design.kind].geometry(length, **design.dimensions), muscle, muscle)


def limits_at(design: JointDesign, designed: Designed) -> str:
    """Binding limits of the attainable stiffness at the drawn angle, as `mckibben envelope` names them."""
    here = designed.here
    if not math.isfinite(float(here.stiffness[0])):
        return ""
    joint, ends = designed.joint, [np.array(end)[:, None] for end in here.ends]
    supplied = rated_for(joint, (design.pressure * bar,) * 2)
    texts = active_limits(supplied, (joint.muscle1, joint.muscle2), np.array([design.angle * deg]), ends)
    return "; ".join(text for text in texts if "stiffness: " in text)


def connector_length(geometry: Geometry) -> float | None:
    """Length of the connectors of a geometry [m]; None for one without connectors."""
    return getattr(getattr(geometry, "path1", geometry), "connector_length", None)


def highest_pressures(muscle: Muscle) -> tuple[float, float]:
    """Range [bar] from which the highest pressure of a joint is chosen."""
    least, most = pressure_limits(muscle)
    return max(least, min(0.5, most / 2)), most


def pressure_limits(muscle: Muscle) -> tuple[float, float]:
    """Lowest and highest pressure [bar] of a muscle's domain."""
    low, high = (float(limit) / bar * 100 for limit in (muscle.domain.pressure_min, muscle.domain.pressure_max))
    return max(math.ceil(round(low, 6)) / 100, 0.0), math.floor(round(high, 6)) / 100


def compute(design: JointDesign, muscle: Muscle) -> Designed:
    """The joint and its attainable ranges.

    Parameters
    ----------
    design
        Numbers of the page.
    muscle
        Muscle on both sides.

    Raises
    ------
    RangeError
        If lengths do not fit.
    """
    joint = joint_of(design, muscle)
    limits = pressure_limits(muscle)[0] * bar, design.pressure * bar
    stiffness, torque, here = _ranges(joint, ANGLES, design.torque, design.angle * deg, limits)
    return Designed(joint, _arrays(stiffness), _arrays(torque), here)


def _arrays(edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(edges[0]), np.asarray(edges[1])


def muscles(fitted: Muscle | None) -> dict[str, Muscle]:
    """Muscles to choose from: the catalog, and the one identified in this session."""
    choices = {name: Muscle(catalog.specimen(name), catalog.law(law)) for name, law in _MUSCLES.items()}
    return choices if fitted is None else {YOURS: fitted} | choices


def scenario_lines(design: JointDesign, muscle: Muscle) -> str:
    """The section `joint` of a scenario."""
    made_of = "muscle.yaml" if design.muscle == YOURS else {"specimen": design.muscle, "law": _MUSCLES[design.muscle]}
    return to_text(
        {"joint": {"geometry": write(joint_of(design, muscle).geometry, ComponentField(Geometry)), "muscle": made_of}}
    )


def drawing(joint: AntagonisticJoint, angle: float, contractions: tuple[ArrayLike, ArrayLike]) -> str:
    """SVG of a joint, to scale; it contains only numbers, no text of the user.

    Parameters
    ----------
    joint
        Joint.
    angle
        Joint angle [rad].
    contractions
        Contractions of both muscles [-], which give their thickness.
    """
    linkage = Linkage(joint.geometry, (-POSE * deg, POSE * deg))
    strands, height = linkage.strands(angle), linkage.height / mm
    bone, shank = 0.016 * height, 0.55 * linkage.height

    def points(*places: Sequence[float] | Points) -> str:
        """Points [m] in millimetres, with y pointing down."""
        return " ".join(f"{x / mm:.2f},{-y / mm:.2f}" for x, y in places)

    def path(color: str, width: float, *places: Sequence[float] | Points) -> str:
        look = f'stroke="{color}" stroke-width="{width:.2f}" stroke-linecap="round"'
        return f'<polyline points="{points(*places)}" fill="none" {look}/>'

    top = linkage.height * linkage.up
    levers = [strand.end for strand, straight in zip(strands, linkage.straight, strict=True) if straight]
    parts = [
        *(f'<polygon points="{points(*outline)}" fill="#dce1e8"/>' for outline in linkage.cams(angle)),
        path("#c3cad1", 2.2 * bone, top, (0, 0)),
        path("#aab4bd", 2.2 * bone, (0, 0), linkage.limb(angle, shank)),
        path("#8a949d", bone, strands[0].start, top, strands[1].start),
        *(path("#8a949d", bone, (0, 0), end) for end in levers),
    ]
    lengths, diameters = muscle_sizes(joint, contractions)
    for strand, length, diameter, color in zip(strands, lengths, diameters, MUSCLES, strict=True):
        thick = (SLENDER * length if diameter is None else diameter) / mm
        body = path(color, float(thick), *strand.body(float(length))).replace("round", "butt")
        parts += [path("#6b7680", 0.5 * bone, strand.start, strand.end, *strand.wrap), body]
    side = max(0.62 * height, 1.3 * max(abs(strand.start[0]) for strand in strands) / mm)
    box = f"{-side:.1f} {-1.06 * height:.1f} {2 * side:.1f} {1.68 * height:.1f}"
    return (
        f'<svg viewBox="{box}" role="img" aria-label="drawing of the joint" '
        f'style="width: 100%; height: 300px; display: block">{"".join(parts)}'
        f'<circle r="{1.5 * bone:.2f}" fill="#ffffff" stroke="#5f6b76" stroke-width="{0.6 * bone:.2f}"/></svg>'
    )
