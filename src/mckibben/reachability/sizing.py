"""Sizing of a joint: lengths for a stiffness range over a range of angles."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mckibben.errors import ParameterError, UnitError
from mckibben.joint import Geometry, RigidTendon
from mckibben.joint.attainable import pressure_limits_of
from mckibben.muscle import Muscle, PressureAffineLaw
from mckibben.notebook import html_table
from mckibben.numerics.calculus import derivative, evenly_spaced
from mckibben.numerics.compiled import jit, numeric
from mckibben.numerics.elementary import floating
from mckibben.plant import JointPlant
from mckibben.reachability.lengths import check_length, design_lengths, length_of, with_lengths
from mckibben.reachability.static import AttainableRange, StaticEnvelope, Values, static_envelope
from mckibben.units import deg, mm, parse_range, percent

_LIMITS = [f"{end} contraction of muscle {i}" for end in ("minimum", "maximum") for i in (1, 2)]
CONSTRAINTS = (*_LIMITS, "attainable torque", "lowest attainable stiffness", "highest attainable stiffness")
"""Constraints of a design, in the order of `constraint_margins`."""

_CONTRACTION_SCALE, _TENSION_SCALE, _STIFFNESS_SCALE = 1 * percent, 10.0, 0.05
_ANGLES = 25  # of the target, in the optimisation
_RESULT_ANGLES = 241
_ACTIVE = 0.05  # constraints within this of the smallest margin, absolute or relative, count as active
_ITERATIONS = 100
_SCREENED = 128  # Halton points, the best of which are starting points
_RESTARTS = 4
_LONGEST = 10.0  # m: longer ones were probably given in millimetres
_TARGET = re.compile(r"(?:stiffness\s+)?(.+?)\s+over\s+(.+)", re.DOTALL)


@dataclass(frozen=True)
class DesignTarget:
    """Stiffness range [N*m/rad] to be attainable throughout a range of angles [rad].

    `torque_reserve` [N*m] is the torque in either direction in excess of gravity, at each of these stiffnesses.
    """

    stiffness: tuple[float, float]
    angles: tuple[float, float]
    torque_reserve: float = 0.0

    def __post_init__(self) -> None:
        for name, (low, high) in (("stiffness", self.stiffness), ("angles", self.angles)):
            if not -np.inf < low <= high < np.inf:
                remedy = "give two finite numbers, the lower first"
                raise ParameterError(f"{name} from {low:g} to {high:g}", value=(low, high), remedy=remedy)
        if (largest := max(map(abs, self.angles))) > 80 * deg:
            remedy = "stay within -80..80 deg, where both moment arms are positive"
            message = f"angles reach {largest / deg:.4g} deg"
            raise ParameterError(message, lower=-80.0, upper=80.0, unit="deg", remedy=remedy)
        if not (np.isfinite(self.torque_reserve) and self.torque_reserve >= 0):
            raise ParameterError(
                f"the torque reserve is {self.torque_reserve:g} N*m", value=self.torque_reserve, remedy="give 0 or more"
            )

    def describe(self) -> str:
        """The target as text."""
        (low, high), (first, last) = self.stiffness, self.angles
        reserve = f", torque reserve {self.torque_reserve:g} N*m" if self.torque_reserve else ""
        return f"stiffness {low:g}..{high:g} N*m/rad over {first / deg:g}..{last / deg:g} deg{reserve}"


def parse_target(text: str, *, torque_reserve: float = 0.0) -> DesignTarget:
    """Parse a target such as "stiffness 12..18 N*m/rad over -20..20 deg"; raises ParameterError or UnitError."""
    found = _TARGET.fullmatch(text.strip())
    if not found:
        remedy = "write it like 'stiffness 12..18 N*m/rad over -20..20 deg'"
        raise ParameterError(f"{text!r} is not a design target", value=text, remedy=remedy)
    try:
        return DesignTarget(parse_range(found[1], "N*m/rad"), parse_range(found[2], "rad"), torque_reserve)
    except UnitError as error:
        raise UnitError(f"{text!r}: {error}", value=text) from None


@dataclass(frozen=True)
class DesignVariable:
    """A length to choose, one of the `design_lengths` of the joint, and its bounds [m]."""

    name: str
    lower: float
    upper: float

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            message = f"{self.name} from {self.lower / mm:g} to {self.upper / mm:g} mm is not a range"
            raise ParameterError(message, value=(self.lower, self.upper), remedy="give two lengths, the shorter first")
        if not max(-self.lower, self.upper) < _LONGEST:
            message = f"{self.name} up to {max(-self.lower, self.upper):g} m is too long for a joint"
            remedy = f"give lengths below {_LONGEST:g} m, such as 20..40 mm"
            both = self.lower, self.upper
            raise ParameterError(message, value=both, lower=-_LONGEST, upper=_LONGEST, unit="m", remedy=remedy)


def parse_variable(text: str) -> DesignVariable:
    """Parse a design variable with its bounds; raises ParameterError or UnitError.

    >>> parse_variable("joint_radius=20..40 mm")
    DesignVariable(name='joint_radius', lower=0.02, upper=0.04)
    """
    name, equals, bounds = (part.strip() for part in text.partition("="))
    if not equals or ".." not in bounds:
        remedy = "write it like 'connector_length=150..260 mm'"
        raise ParameterError(f"{text!r} is not a length with its range", value=text, remedy=remedy)
    try:
        return DesignVariable(name.removeprefix("joint.").removeprefix("geometry."), *parse_range(bounds, "m"))
    except UnitError as error:
        raise UnitError(f"{text!r}: {error}", value=text) from None


def constraint_margins(
    plant: JointPlant,
    lengths: dict[str, Array],
    angle: ArrayLike,
    stiffness: ArrayLike,
    torque_reserve: ArrayLike,
    minimum_tension: ArrayLike,
) -> Array:
    """Scaled margins of `CONSTRAINTS`, shape (7, 2 torques, angles); negative where violated."""
    angle, stiffness, torque_reserve = floating(angle), floating(stiffness), floating(torque_reserve)
    plant = with_lengths(plant, lengths)
    joint = plant.supplied_joint
    paths, (arm1, arm2) = joint.geometry.paths_and_arms(angle)
    muscles, (lowest, highest) = (joint.muscle1, joint.muscle2), pressure_limits_of(joint)
    contractions = [muscle.specimen.contraction_at(path) for muscle, path in zip(muscles, paths, strict=True)]
    low = [jnp.maximum(m.tension(e, p), minimum_tension) for m, e, p in zip(muscles, contractions, lowest, strict=True)]
    high = [
        jnp.minimum(m.tension(e, p), m.specimen.force_limit)
        for m, e, p in zip(muscles, contractions, highest, strict=True)
    ]
    torque = jnp.stack([-torque_reserve, torque_reserve])[:, None] - plant.load.gravity_torque(angle)
    first = jnp.maximum(low[0], (low[1] * arm2 - torque) / arm1)
    last = jnp.minimum(high[0], (high[1] * arm2 - torque) / arm1)
    tension_range = jnp.minimum(last - first, jnp.minimum(high[0] - low[0], high[1] - low[1]))

    def stiffness_at(tension1: Array) -> Array:
        tension2 = (torque + tension1 * arm1) / arm2
        pressures = (
            muscles[0].force_law.pressure_for(tension1, contractions[0]),
            muscles[1].force_law.pressure_for(tension2, contractions[1]),
        )
        return _unclipped_stiffness(joint.geometry, muscles, angle, pressures)

    ends = stiffness_at(first), stiffness_at(last)
    scale = _STIFFNESS_SCALE * jnp.maximum(jnp.abs(stiffness[1]), 1.0)
    margins = [
        *((e - m.domain.contraction_min) / _CONTRACTION_SCALE for m, e in zip(muscles, contractions, strict=True)),
        *((m.domain.contraction_max - e) / _CONTRACTION_SCALE for m, e in zip(muscles, contractions, strict=True)),
        tension_range / _TENSION_SCALE,
        (stiffness[0] - jnp.minimum(*ends)) / scale,
        (jnp.maximum(*ends) - stiffness[1]) / scale,
    ]
    return jnp.stack([jnp.broadcast_to(margin, torque.shape) for margin in margins])


def _unclipped_stiffness(
    geometry: Geometry, muscles: tuple[Muscle, Muscle], angle: Array, pressures: tuple[Array, Array]
) -> Array:
    """Stiffness from laws that may become negative, smooth beyond the attainable set."""

    def torque(angle: Array) -> Array:
        paths, (arm1, arm2) = geometry.paths_and_arms(angle)
        pulls = [
            muscle.force_law.force(muscle.specimen.contraction_at(path), pressure)
            for muscle, path, pressure in zip(muscles, paths, pressures, strict=True)
        ]
        return pulls[1] * arm2 - pulls[0] * arm1

    return -derivative(torque, jnp.broadcast_to(angle, pressures[0].shape))


@jit
def margins_and_jacobian(
    plant: JointPlant,
    lengths: dict[str, float],
    angle: ArrayLike,
    stiffness: ArrayLike,
    torque_reserve: ArrayLike,
    minimum_tension: ArrayLike,
) -> tuple[Array, dict[str, Array]]:
    """Constraint margins and their derivatives with respect to each length [1/m]."""

    def twice(lengths: dict[str, Array]) -> tuple[Array, Array]:
        values = constraint_margins(plant, lengths, angle, stiffness, torque_reserve, minimum_tension)
        return values, values

    jacobian, values = jax.jacfwd(twice, has_aux=True)({name: floating(value) for name, value in lengths.items()})
    return values, jacobian


@dataclass(frozen=True)
class Design:
    """Result of `design`."""

    target: DesignTarget
    lengths: dict[str, float]  # optimised [m], by name
    initial: dict[str, float]
    plant: JointPlant  # with the optimised lengths
    margin: float  # smallest of the `constraint_margins`; the target is attained if it is not negative
    active: tuple[str, ...]  # or violated constraints, each with its angle
    at_bound: tuple[str, ...]  # lengths
    angles: Values  # of the target, shape (241,) [rad]
    stiffness: AttainableRange  # there, at all target torques [N*m/rad]; NaN where one is not attainable
    envelope: StaticEnvelope  # of the plant

    def __repr__(self) -> str:
        return f"<Design: {self.describe()}>"

    def _repr_html_(self) -> str:
        return html_table(self.describe(), ("angle", "stiffness"), self.rows())

    @property
    def attained(self) -> bool:
        """Whether the target is attained at all angles."""
        low, high = self.target.stiffness
        band = self.stiffness
        return bool(np.all((band.lowest <= low + 1e-6) & (band.highest >= high - 1e-6)))

    @property
    def shortfall(self) -> float:
        """Largest distance of the stiffness from the target [N*m/rad]; NaN where a torque is not attainable."""
        low, high = self.target.stiffness
        return float(np.maximum(np.maximum(self.stiffness.lowest - low, high - self.stiffness.highest), 0.0).max())

    def rows(self) -> list[tuple[str, str]]:
        """Stiffness attained at nine of the target angles, as text."""
        chosen = evenly_spaced(self.angles.size, 9)
        low, high = self.stiffness
        return [
            (
                f"{self.angles[i] / deg:.4g} deg",
                f"{low[i]:.4g}..{high[i]:.4g} N*m/rad" if low[i] <= high[i] else "infeasible",
            )
            for i in chosen
        ]

    def records(self) -> dict[str, Any]:
        """The result as plain data; lengths in mm, angles in deg, stiffness in N*m/rad."""
        return {
            "target": self.target.describe(),
            "attained": self.attained,
            "described": self.describe(),
            "lengths_mm": {name: value / mm for name, value in self.lengths.items()},
            "initial_mm": {name: value / mm for name, value in self.initial.items()},
            "margin": self.margin,
            "shortfall": self.shortfall,
            "active": list(self.active),
            "at_bound": list(self.at_bound),
            "static_range_deg": [self.envelope.angle_min / deg, self.envelope.angle_max / deg],
            "angles_deg": (self.angles[::10] / deg).tolist(),
            "stiffness": [edge[::10].tolist() for edge in self.stiffness],
        }

    def describe(self) -> str:
        """The result in words."""
        lengths = ", ".join(f"{name} {value / mm:.4g} mm" for name, value in self.lengths.items())
        kind = "active" if self.margin >= 0 else "violated"
        active = f"; {kind} constraints: {', '.join(self.active)}" if self.active else ""
        bounds = f"; at a bound: {', '.join(self.at_bound)}" if self.at_bound else ""
        if self.attained:
            low, high = float(self.stiffness.lowest.max()), float(self.stiffness.highest.min())
            found = f"attained with {lengths}; attainable at all these angles: {low:.4g}..{high:.4g} N*m/rad"
        else:
            if np.isnan(self.shortfall):
                fraction = np.isnan(self.stiffness.lowest).mean()
                miss = f"at {fraction:.0%} of the angles no pressures within limits give the torque"
            else:
                miss = f"the stiffness misses the target by up to {self.shortfall:.3g} N*m/rad"
            found = f"infeasible within these bounds; nearest is {lengths}, where {miss}"
        return f"{self.target.describe()}: {found}{active}{bounds}"


def design(
    plant: JointPlant,
    target: DesignTarget,
    variables: Sequence[DesignVariable],
    *,
    starts: int = 6,
    minimum_tension: float = 0.0,
) -> Design:
    """Size the lengths of a joint for a stiffness target.

    Maximises the smallest of the `constraint_margins` (max t subject to every margin >= t) by sequential quadratic
    programming (SLSQP) with exact derivatives, started from the best of 128 points. An infeasible target gives the
    lengths of the smallest violation.

    Raises `ParameterError` if there are no variables or one is given twice, no lengths within the bounds leave space
    for the muscles, or the stiffness of the joint is not affine in its tensions.

    Parameters
    ----------
    plant
        Joint and load; other lengths are kept. Requires laws affine in pressure and rigid tendons.
    target
        Static, under gravity; a torque reserve I theta'' allows for motion.
    variables
        Lengths to choose, with bounds.
    starts
        Number of local searches, from the best of the initial lengths and 128 points over the bounds.
    minimum_tension
        Lower bound of the tension of each muscle [N].

    Examples
    --------
    >>> from mckibben import IdealValve, catalog
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), IdealValve())
    >>> target, variables = DesignTarget((14.0, 18.0), (-0.25, 0.25)), [DesignVariable("connector_length", 0.19, 0.22)]
    >>> found = design(printed, target, variables, starts=1)
    >>> found.attained, round(found.lengths["connector_length"] / mm)
    (True, 207)
    """
    from scipy.stats import qmc

    _check_problem(plant, variables, starts)
    plant = numeric(plant)
    lower = np.array([variable.lower for variable in variables])
    width = np.array([variable.upper for variable in variables]) - lower
    names = tuple(variable.name for variable in variables)
    angles = np.linspace(*target.angles, _ANGLES)
    given = (np.asarray(target.stiffness), target.torque_reserve, minimum_tension)

    def margins(x: Values) -> tuple[Values, Values]:
        """Flattened margins and their derivatives with respect to x, the lengths scaled to 0..1."""
        lengths = dict(zip(names, lower + width * x, strict=True))
        values, by_length = margins_and_jacobian(plant, lengths, angles, *given)
        jacobian = np.stack([np.asarray(by_length[name]).ravel() for name in names], axis=-1)
        return np.asarray(values).ravel(), jacobian * width

    first = np.clip((np.array([length_of(plant, name) for name in names]) - lower) / width, 0.0, 1.0)
    points = [first, *qmc.Halton(len(names), scramble=False).random(_SCREENED)]
    screened = np.array([margins(x)[0].min() for x in points])
    order = [k for k in np.argsort(-screened) if np.isfinite(screened[k])][:starts]
    best, best_margin = first, -np.inf
    for k in order:
        x, margin = points[k], float(screened[k])
        for _ in range(_RESTARTS):  # margins have kinks, at which a search may stop too soon
            found = _maximize_margin(margins, x, margin)
            reached = float(margins(found)[0].min())
            if not reached > margin + 1e-6 * max(abs(margin), 1.0):
                break
            x, margin = found, reached
        if margin > best_margin:
            best, best_margin = x, margin
    if not np.isfinite(best_margin):
        message = "no lengths within the bounds leave space for the muscles"
        raise ParameterError(message, remedy="choose shorter connectors or a smaller radius")
    lengths = {name: float(value) for name, value in zip(names, lower + width * best, strict=True)}
    sized = numeric(with_lengths(plant, lengths))
    checked = np.linspace(*target.angles, _RESULT_ANGLES)
    band = attained_stiffness(sized, checked, target.torque_reserve, minimum_tension)
    return Design(
        target,
        lengths,
        {name: length_of(plant, name) for name in names},
        sized,
        best_margin,
        tuple(_active_constraints(margins(best)[0], angles)),
        tuple(name for name, part in zip(names, best, strict=True) if part < 1e-4 or part > 1 - 1e-4),
        checked,
        AttainableRange(*(np.asarray(x) for x in band)),
        static_envelope(sized, about=float(np.mean(target.angles))),
    )


def _maximize_margin(margins: Callable[[Values], tuple[Values, Values]], start: Values, margin: float) -> Values:
    """One SLSQP search for the largest smallest margin."""
    from scipy.optimize import minimize

    size = start.size
    found = minimize(
        lambda z: -z[-1],
        np.append(start, margin),
        jac=lambda z: np.append(np.zeros(size), -1.0),
        bounds=[(0.0, 1.0)] * size + [(None, None)],
        constraints={
            "type": "ineq",
            "fun": lambda z: margins(z[:-1])[0] - z[-1],
            "jac": lambda z: np.column_stack([(found := margins(z[:-1]))[1], -np.ones(found[0].size)]),
        },
        method="SLSQP",
        options={"maxiter": _ITERATIONS, "ftol": 1e-9},
    )
    return np.clip(found.x[:-1], 0.0, 1.0)


def _check_problem(plant: JointPlant, variables: Sequence[DesignVariable], starts: int) -> None:
    names = [variable.name for variable in variables]
    known = design_lengths(plant)
    places = [place for name in names for place in known.get(name, ())]
    if not names or len(set(names)) < len(names) or len(set(places)) < len(places):
        raise ParameterError(
            f"a design varies {', '.join(names)}" if names else "a design varies nothing",
            value=names,
            remedy="give each length once; a name such as muscle_length or radius applies to both muscles",
        )
    for variable in variables:
        check_length(plant, variable.name, variable.lower)
    if starts < 1:
        raise ParameterError(f"the search has {starts} starts", value=starts, remedy="give 1 or more")
    laws = plant.joint.muscle1.law, plant.joint.muscle2.law
    if any(plant.joint.springs):
        message = "with a return spring the angle determines the stiffness: there is no range to attain"
        remedy = "choose spring and lengths by the envelope, or use two muscles"
        raise ParameterError(message, field="return_spring", remedy=remedy)
    if not isinstance(plant.joint.tendon, RigidTendon) or not all(isinstance(law, PressureAffineLaw) for law in laws):
        raise ParameterError(
            "a design needs rigid tendons and laws affine in pressure",
            remedy="leave out the spring, or fit a law such as the exponential one; envelopes need neither",
        )


@jit
def attained_stiffness(
    plant: JointPlant, angle: ArrayLike, reserve: ArrayLike, minimum_tension: float
) -> tuple[Array, Array]:
    """Lowest and highest stiffness [N*m/rad] attainable at both torques of a reserve [N*m], over angles [rad]."""
    torque = floating(reserve) * jnp.array([-1.0, 1.0])[:, None] - plant.load.gravity_torque(angle)
    lowest, highest = plant.supplied_joint.attainable_stiffness(angle, torque, minimum_tension=minimum_tension)
    return jnp.max(lowest, axis=0), jnp.min(highest, axis=0)


def _active_constraints(margins: Values, angles: Values) -> list[str]:
    least = float(margins.min())
    by_constraint = margins.reshape(len(CONSTRAINTS), 2, angles.size).min(axis=1)
    return [
        f"{name} at {angles[int(np.argmin(over))] / deg:.3g} deg"
        for name, over in zip(CONSTRAINTS, by_constraint, strict=True)
        if over.min() <= least + max(_ACTIVE, _ACTIVE * abs(least))
    ]
