"""Sizing of a joint for a range of stiffness over a range of angle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.errors import ParameterError
from mckibben.joint import Geometry, RigidTendon
from mckibben.joint.attainable import pressure_limits_of
from mckibben.muscle import Muscle, PressureAffineLaw
from mckibben.numerics.calculus import derivative
from mckibben.numerics.compiled import compiled, numeric
from mckibben.numerics.elementary import floating
from mckibben.plant import JointPlant
from mckibben.reachability.bands import Holdable, Range, holdable
from mckibben.reachability.targets import VARIED, Choice, Wanted, nominal, put
from mckibben.units import deg, mm, percent

ANGLES = 25
"""Angles of the wanted range that are looked at in a search."""

BROKEN = (
    "muscle 1 is stretched beyond its domain",
    "muscle 2 is stretched beyond its domain",
    "muscle 1 is contracted beyond its domain",
    "muscle 2 is contracted beyond its domain",
    "no tensions within limits give the torque",
    "the lowest attainable stiffness",
    "the highest attainable stiffness",
)
"""What each kind of margin below zero means."""

NEAR = (
    "stretching muscle 1",
    "stretching muscle 2",
    "contracting muscle 1",
    "contracting muscle 2",
    "the torque to be held",
    "the lowest stiffness",
    "the highest stiffness",
)
"""What each kind of margin stands for where it is met."""

_CONTRACTION, _TENSION, _STIFFNESS = 1 * percent, 10.0, 0.05


def margins(
    plant: JointPlant,
    lengths: dict[str, Array],
    angle: ArrayLike,
    stiffness: ArrayLike,
    torque: ArrayLike,
    minimum_tension: ArrayLike,
) -> Array:
    """Every margin, shape (7 kinds, 2 torques, angles), in the order of `BROKEN`.

    Parameters
    ----------
    plant
        Joint and load; laws affine in pressure, rigid tendons.
    lengths
        In place of the plant's own [m], by name.
    angle, stiffness
        Shape (angles,) [rad]; lowest and highest that are wanted [N*m/rad].
    torque, minimum_tension
        To spare either way [N*m]; what each muscle keeps [N].
    """
    angle, stiffness, torque = floating(angle), floating(stiffness), floating(torque)
    plant = put(plant, lengths)
    joint = plant.joint
    paths, (arm1, arm2) = joint.geometry.paths_and_arms(angle)
    muscles, (lowest, highest) = (joint.muscle1, joint.muscle2), pressure_limits_of(joint)
    contractions = [muscle.specimen.contraction_at(path) for muscle, path in zip(muscles, paths, strict=True)]
    low = [jnp.maximum(m.tension(e, p), minimum_tension) for m, e, p in zip(muscles, contractions, lowest, strict=True)]
    high = [
        jnp.minimum(m.tension(e, p), m.specimen.rated_force)
        for m, e, p in zip(muscles, contractions, highest, strict=True)
    ]
    held = jnp.stack([-torque, torque])[:, None] - plant.load.gravity_torque(angle)
    first = jnp.maximum(low[0], (low[1] * arm2 - held) / arm1)
    last = jnp.minimum(high[0], (high[1] * arm2 - held) / arm1)
    room = jnp.minimum(last - first, jnp.minimum(high[0] - low[0], high[1] - low[1]))

    def stiffness_at(tension1: Array) -> Array:
        tension2 = (held + tension1 * arm1) / arm2
        pressures = (
            muscles[0].pressure_for(tension1, contractions[0]),
            muscles[1].pressure_for(tension2, contractions[1]),
        )
        return _taut(joint.geometry, muscles, angle, pressures)

    ends = stiffness_at(first), stiffness_at(last)
    size = _STIFFNESS * jnp.maximum(jnp.abs(stiffness[1]), 1.0)
    each = [
        *((e - m.domain.contraction_min) / _CONTRACTION for m, e in zip(muscles, contractions, strict=True)),
        *((m.domain.contraction_max - e) / _CONTRACTION for m, e in zip(muscles, contractions, strict=True)),
        room / _TENSION,
        (stiffness[0] - jnp.minimum(*ends)) / size,
        (jnp.maximum(*ends) - stiffness[1]) / size,
    ]
    return jnp.stack([jnp.broadcast_to(margin, held.shape) for margin in each])


def _taut(geometry: Geometry, muscles: tuple[Muscle, Muscle], angle: Array, pressures: tuple[Array, Array]) -> Array:
    """The stiffness by the laws as they are, not cut off where they turn negative: smooth beyond what is attainable."""

    def torque(angle: Array) -> Array:
        paths, (arm1, arm2) = geometry.paths_and_arms(angle)
        pulls = [
            muscle.law.force(muscle.specimen.contraction_at(path), pressure)
            for muscle, path, pressure in zip(muscles, paths, pressures, strict=True)
        ]
        return pulls[1] * arm2 - pulls[0] * arm1

    return -derivative(torque, jnp.broadcast_to(angle, pressures[0].shape))


@compiled
def margins_and_slopes(
    plant: JointPlant,
    lengths: dict[str, float],
    angle: ArrayLike,
    stiffness: ArrayLike,
    torque: ArrayLike,
    minimum_tension: ArrayLike,
) -> tuple[Array, dict[str, Array]]:
    """The margins, and their derivatives by each length [1/m]."""

    def twice(lengths: dict[str, Array]) -> tuple[Array, Array]:
        values = margins(plant, lengths, angle, stiffness, torque, minimum_tension)
        return values, values

    slopes, values = jax.jacfwd(twice, has_aux=True)({name: floating(value) for name, value in lengths.items()})
    return values, slopes


Values = NDArray[np.float64]

_CHECKED = 241
_WITHIN = 0.05  # of the least margin: what is as near to its limit counts as limiting, too
_ITERATIONS = 100
_SCREENED = 128  # points spread over the ranges, of which the best are started from
_RESTARTS = 4


@dataclass(frozen=True)
class Design:
    """Lengths for a wish, and what they attain.

    Attributes
    ----------
    wanted
        The wish.
    lengths
        What was found [m], by name.
    before
        What it was in the plant to begin with [m].
    plant
        With these lengths.
    margin
        The least margin, see `margins`, in its sizes; the wish is attained if it is not below zero.
    limits
        What limits it, each in words.
    at_bound
        The lengths at an end of their range.
    angles, stiffness
        The band that is attained over the wanted angles, the smallest over the torques that are wanted: shape (241,)
        [rad], [N*m/rad]; NaN where a torque cannot be held.
    holds
        All that the joint can hold standing.
    """

    wanted: Wanted
    lengths: dict[str, float]
    before: dict[str, float]
    plant: JointPlant
    margin: float
    limits: tuple[str, ...]
    at_bound: tuple[str, ...]
    angles: Values
    stiffness: Range
    holds: Holdable

    @property
    def attained(self) -> bool:
        """Whether the wish is attained at all angles that were looked at."""
        low, high = self.wanted.stiffness
        band = self.stiffness
        return bool(np.all((band.lowest <= low + 1e-6) & (band.highest >= high - 1e-6)))

    @property
    def shortfall(self) -> float:
        """By how much the stiffness misses the wish at most [N*m/rad]; NaN where a torque cannot be held at all."""
        low, high = self.wanted.stiffness
        return float(np.maximum(np.maximum(self.stiffness.lowest - low, high - self.stiffness.highest), 0.0).max())

    def rows(self) -> list[tuple[str, str]]:
        """The band at nine of the wanted angles, as text."""
        chosen = np.unique(np.linspace(0, self.angles.size - 1, 9).round().astype(int))
        low, high = self.stiffness
        return [
            (
                f"{self.angles[i] / deg:.4g} deg",
                f"{low[i]:.4g}..{high[i]:.4g} N*m/rad" if low[i] <= high[i] else "cannot be held",
            )
            for i in chosen
        ]

    def records(self) -> dict[str, Any]:
        """All of it as plain data; lengths in mm, angles in deg, stiffness in N*m/rad."""
        return {
            "wanted": self.wanted.describe(),
            "attained": self.attained,
            "described": self.describe(),
            "lengths_mm": {name: value / mm for name, value in self.lengths.items()},
            "before_mm": {name: value / mm for name, value in self.before.items()},
            "margin": self.margin,
            "shortfall": self.shortfall,
            "limits": list(self.limits),
            "at_bound": list(self.at_bound),
            "holdable_deg": [self.holds.first / deg, self.holds.last / deg],
            "angles_deg": (self.angles[::10] / deg).tolist(),
            "stiffness": [edge[::10].tolist() for edge in self.stiffness],
        }

    def describe(self) -> str:
        """What was found, in plain words."""
        lengths = ", ".join(f"{name} {value / mm:.4g} mm" for name, value in self.lengths.items())
        low, high = float(self.stiffness.lowest.max()), float(self.stiffness.highest.min())
        limits = "; limited by " + ", ".join(self.limits) if self.limits else ""
        bounds = f"; at an end of its range: {', '.join(self.at_bound)}" if self.at_bound else ""
        if self.attained:
            return (
                f"{self.wanted.describe()}: attained with {lengths}; "
                f"common to all these angles are {low:.4g}..{high:.4g} N*m/rad{limits}{bounds}"
            )
        if np.isnan(self.shortfall):
            lost = np.isnan(self.stiffness.lowest)
            near = f"at {lost.mean():.0%} of the angles no pressures within limits give the torque"
        else:
            near = f"the stiffness misses it by up to {self.shortfall:.3g} N*m/rad"
        nearest = f"impossible within these ranges; nearest is {lengths}, where {near}"
        return f"{self.wanted.describe()}: {nearest}{limits}{bounds}"


def design(
    plant: JointPlant, wanted: Wanted, choices: Sequence[Choice], *, starts: int = 6, minimum_tension: float = 0.0
) -> Design:
    """The lengths with which a wish is attained with the largest margin; or that come nearest.

    The least of the `margins` is made as large as it can be: max t with every margin >= t, by sequential quadratic
    programming (SLSQP) with exact derivatives, from the best of 128 points.

    Parameters
    ----------
    plant
        Joint and load; lengths that are not varied stay. Laws affine in pressure, rigid tendons.
    wanted
        The wish; standing, against gravity. For motion give it a torque to spare, I theta''.
    choices
        What may be varied, and within what.
    starts
        From how many points to search: the best of the plant as it is and of 128 spread over the ranges.
    minimum_tension
        What each muscle must keep [N].

    Raises
    ------
    ParameterError
        If nothing is varied or something twice, the ranges leave no room for a muscle, or the joint is of a kind whose
        stiffness is not affine along its tensions.

    Examples
    --------
    >>> from mckibben import IdealValve, catalog
    >>> printed = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), IdealValve())
    >>> found = design(printed, Wanted((14.0, 18.0), (-15 * deg, 15 * deg)), [Choice("connector_length", 0.19, 0.22)])
    >>> found.attained, round(found.lengths["connector_length"] / mm)
    (True, 207)
    """
    from scipy.stats import qmc

    _check(plant, choices, starts)
    plant = numeric(plant)
    lower = np.array([choice.lower for choice in choices])
    width = np.array([choice.upper for choice in choices]) - lower
    names = tuple(choice.name for choice in choices)
    angles = np.linspace(*wanted.angles, ANGLES)
    asked = (np.asarray(wanted.stiffness), wanted.torque, minimum_tension)

    def margins(x: Values) -> tuple[Values, Values]:
        """The margins, flat, and their derivatives with respect to x: lengths as parts of their ranges."""
        values, by_length = margins_and_slopes(plant, dict(zip(names, lower + width * x, strict=True)), angles, *asked)
        slopes = np.stack([np.asarray(by_length[name]).ravel() for name in names], axis=-1)
        return np.asarray(values).ravel(), slopes * width

    first = np.clip((np.array([nominal(plant, name) for name in names]) - lower) / width, 0.0, 1.0)
    tried = [first, *qmc.Halton(len(names), scramble=False).random(_SCREENED)]
    reached = np.array([margins(x)[0].min() for x in tried])
    order = [k for k in np.argsort(-reached) if np.isfinite(reached[k])][:starts]
    best, least = first, -np.inf
    for k in order:
        x, begin = tried[k], float(reached[k])
        for _ in range(_RESTARTS):  # margins have kinks, on which a search may come to rest too soon
            found = _climb(margins, x, begin)
            gained = float(margins(found)[0].min())
            if not gained > begin + 1e-6 * max(abs(begin), 1.0):
                break
            x, begin = found, gained
        if begin > least:
            best, least = x, begin
    if not np.isfinite(least):
        raise ParameterError(
            "the ranges leave no room for a muscle", remedy="choose shorter connectors or a smaller radius"
        )
    return _described(plant, wanted, choices, best, lower + width * best, angles, margins(best)[0], minimum_tension)


def _climb(margins: Callable[[Values], tuple[Values, Values]], start: Values, begin: float) -> Values:
    """Where the least margin is highest, as far as one search from a start gets."""
    from scipy.optimize import minimize

    size = start.size
    found = minimize(
        lambda z: -z[-1],
        np.append(start, begin),
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


def _check(plant: JointPlant, choices: Sequence[Choice], starts: int) -> None:
    names = [choice.name for choice in choices]
    both = {"muscle_length"} & set(names) and {"muscle1_length", "muscle2_length"} & set(names)
    if not names or len(set(names)) < len(names) or both:
        raise ParameterError(
            f"a design varies {', '.join(names)}" if names else "a design varies nothing",
            value=names,
            remedy=f"give each length once, of {', '.join(VARIED)}; muscle_length is that of both muscles",
        )
    if starts < 1:
        raise ParameterError(f"a search from {starts} starts", value=starts, remedy="give 1 or more")
    muscles = (plant.joint.muscle1, plant.joint.muscle2)
    if not isinstance(plant.joint.tendon, RigidTendon) or not all(
        isinstance(m.law, PressureAffineLaw) for m in muscles
    ):
        raise ParameterError(
            "a design needs rigid tendons and laws affine in pressure",
            remedy="leave out the spring, or fit a law such as the exponential one; envelopes themselves need neither",
        )


@compiled
def _attained(plant: JointPlant, angle: ArrayLike, torque: ArrayLike, minimum_tension: float) -> tuple[Array, Array]:
    held = floating(torque) * jnp.array([-1.0, 1.0])[:, None] - plant.load.gravity_torque(angle)
    lowest, highest = plant.joint.attainable_stiffness(angle, held, minimum_tension=minimum_tension)
    return jnp.max(lowest, axis=0), jnp.min(highest, axis=0)


def _described(
    plant: JointPlant,
    wanted: Wanted,
    choices: Sequence[Choice],
    parts: Values,
    lengths: Values,
    angles: Values,
    margins: Values,
    minimum_tension: float,
) -> Design:
    chosen = {choice.name: float(value) for choice, value in zip(choices, lengths, strict=True)}
    found = numeric(put(plant, chosen))
    looked = np.linspace(*wanted.angles, _CHECKED)
    band = Range(*(np.asarray(x) for x in _attained(found, looked, wanted.torque, minimum_tension)))
    least = float(margins.min())
    each = margins.reshape(len(BROKEN), 2, angles.size).min(axis=1)
    limits = []
    for kind, over in enumerate(each):
        if over.min() <= least + max(_WITHIN, _WITHIN * abs(least)):
            words = BROKEN[kind] if least < 0 else NEAR[kind]
            limits.append(f"{words} at {angles[int(np.argmin(over))] / deg:.3g} deg")
    at_bound = [c.name for c, part in zip(choices, parts, strict=True) if part < 1e-4 or part > 1 - 1e-4]
    return Design(
        wanted,
        chosen,
        {choice.name: nominal(plant, choice.name) for choice in choices},
        found,
        least,
        tuple(limits),
        tuple(at_bound),
        looked,
        band,
        holdable(found, about=float(np.mean(wanted.angles))),
    )
