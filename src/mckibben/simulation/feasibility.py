"""Static feasibility of a reference: the stiffness that a joint can attain at each desired angle."""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction, compiled
from mckibben.component.calls import checked_call
from mckibben.control.base import Reference, Setpoint
from mckibben.joint.attainable import leaves_domain, solve_static, stiffness_range
from mckibben.mechanism.dynamics import joint_equations
from mckibben.mechanism.robot import Robot
from mckibben.numerics.calculus import evenly_spaced
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant
from mckibben.plant.joint_plant import rated_for
from mckibben.result import Remark, Result, column
from mckibben.simulation.problem import sampled
from mckibben.statics.posture import EXACT, is_affine
from mckibben.statics.reference import POSTURES, check_postures
from mckibben.units import HINGE, Duration, JointType, ShortTime

_ROUNDING = 1e-6  # N*m/rad
_BLOCK = 256  # control periods
_TAUT = 1.0  # N, least tension


class Feasibility(Result):
    """A reference compared with the attainable stiffness at each control period.

    The attainable stiffness is that at the desired angle while the muscles balance gravity; NaN where no pressures
    within limits hold the angle. `cause` says which muscle leaves its domain at the first such angle, if one does.
    Arrays have shape (periods,).
    """

    figures: ClassVar = ("feasibility",)

    times: NDArray[np.float64] = column("s", "time", dims=("time",))
    desired_angle: NDArray[np.float64] = column("rad", "desired angle", "deg", dims=("time",))
    desired_stiffness: NDArray[np.float64] = column("N*m/rad", "desired stiffness", dims=("time",))
    lowest: NDArray[np.float64] = column("N*m/rad", "lowest attainable stiffness", dims=("time",))
    highest: NDArray[np.float64] = column("N*m/rad", "highest attainable stiffness", dims=("time",))
    cause: str = ""
    joint_type: JointType = HINGE

    @property
    def shortfall(self) -> NDArray[np.float64]:
        """Distance of the desired stiffness from the attainable range [N*m/rad]; NaN where the angle cannot be held."""
        return distance_from(self.lowest, self.highest, self.desired_stiffness)

    @property
    def feasible(self) -> bool:
        """Whether all of the reference can be held statically."""
        return bool(np.all(self.shortfall == 0))

    def verdict(self) -> str:
        """When and by how much the reference is not feasible."""
        if self.feasible:
            return "the reference is statically feasible throughout"
        sentences, missing, shown = [], self.shortfall, self.joint_type.show
        unheld, short = np.isnan(missing), np.nan_to_num(missing) > 0
        if unheld.any():
            who = "the joint cannot" if self.cause else "no pressures within limits"
            failure = f"{who} hold the desired {self.joint_type.words('angle')}"
            at = int(unheld.argmax())
            when = f"{_span(self.times, unheld)}, first at {self.times[at]:.3g} s"
            sentences.append(f"{failure} {when} ({shown(self.desired_angle[at], 'deg', 3)})")
        if short.any():
            at = int(np.nanargmax(missing))
            desired, least, most = (
                f"{stiffness[at] / self.joint_type.size('N*m/rad'):.4g}"
                for stiffness in (self.desired_stiffness, self.lowest, self.highest)
            )
            sentences.append(
                f"the desired stiffness is not attainable {_span(self.times, short)}, by up to "
                f"{shown(missing[at], 'N*m/rad', 3)} at {self.times[at]:.3g} s (desired {desired}, attainable "
                f"{least}..{most} {self.joint_type.shown('N*m/rad')} at {shown(self.desired_angle[at], 'deg', 3)})"
            )
        return "; ".join(filter(None, (*sentences, self.cause)))

    def remarks(self) -> Iterable[Remark]:
        """A severe remark on a reference that is not feasible."""
        if not self.feasible:
            remedy = "`mckibben envelope` shows what is"
            yield Remark.severe("reference", "the joint cannot follow it statically", remedy)


def distance_from(low: NDArray, high: NDArray, stiffness: NDArray) -> NDArray[np.float64]:
    """Distance of a stiffness from a range, 0 inside to rounding, or for no stiffness; NaN where none is attainable."""
    stiffness = np.where(np.isnan(stiffness), low, stiffness)
    out = np.maximum(low - stiffness, stiffness - high)
    return np.where(out > _ROUNDING, out, np.where(np.isnan(out), np.nan, 0.0))


def _span(times: NDArray[np.float64], mask: NDArray[np.bool_]) -> str:
    """The share of a run in which a mask is true, and the times [s] of its ends, as text."""
    where, share = np.flatnonzero(mask), mask.mean()
    text = f"{share:.0%}" if share > 0.005 else "under 1%"
    return f"for {text} of the run, between {times[where[0]]:.3g} s and {times[where[-1]]:.3g} s"


@checked_call
def check_reference(
    plant: JointPlant,
    reference: Reference,
    *,
    duration: Duration = 10.0,
    control_period: ShortTime = 1e-3,
    stiffness_amplitude: float | None = None,
) -> Feasibility:
    """Compare a reference with the attainable stiffness of a plant's joint, statically, at every control period [s].

    The stiffness is the isobaric one, or that of a motion with an amplitude [rad] (`secant_stiffness`). Raises
    `SimulationError` if duration [s] and control period do not fit together.
    """
    times, setpoints = sampled(reference, duration, control_period)
    return feasibility(plant, times, setpoints, static_band(plant, setpoints.angle, stiffness_amplitude))


def feasibility(plant: PyTree, times: NDArray, setpoints: Setpoint, band: tuple[Array, Array]) -> Feasibility:
    """Feasibility of setpoints of shape (periods,), from the attainable stiffness at them (`static_band`).

    None is asked of a muscle against a spring: the angle determines its stiffness.
    """
    angle, stiffness, low, high = (np.asarray(values)[: times.size] for values in (*setpoints, *band))
    unheld, joint = np.isnan(high), plant.supplied_joint
    cause = leaves_domain(joint, angle, unheld) if unheld.any() else ""
    desired = low if any(joint.springs) else stiffness
    return Feasibility(times, angle, desired, low, high, cause=cause, joint_type=plant.mechanism.joint_type)


@BatchFunction
def static_bands(shared: tuple[JointPlant, ArrayLike | None, Any], angle: Array) -> tuple[Array, Array]:
    """Lowest and highest stiffness [N*m/rad] at which the supplied joint holds an angle [rad] against gravity."""
    plant, amplitude, tension = shared
    torque = -plant.load.gravity_torque(angle)
    return plant.supplied_joint.attainable_stiffness(angle, torque, amplitude=amplitude, minimum_tension=tension)


def static_band(
    plant: JointPlant, angles: ArrayLike, amplitude: ArrayLike | None, tension: ArrayLike = 0.0, *, engine: str = "auto"
) -> tuple[Array, Array]:
    """`static_bands` at angles of shape (periods,), and at the last one repeated: each length needs a program."""
    padded = np.pad(angles, (0, -np.size(angles) % _BLOCK), mode="edge")
    return static_bands(engine, numeric((plant, amplitude, tension)), padded)[0]


class HeldByPairs(NamedTuple):
    """Pressures [Pa] of the pairs of muscles of joints that hold a robot at rest, by joint, and whether they do."""

    pressures: list[tuple[Array, Array]]
    attained: Array


@compiled
def held_by_pairs(
    shared: tuple[Robot, PyTree, PyTree, PyTree, PyTree], lane: tuple[Robot, PyTree, PyTree, PyTree, PyTree]
) -> HeldByPairs:
    """Closed form of a robot with a pair of muscles for each joint, and no others.

    Both arguments are parts of the robot, the supply [Pa], g [m/s^2], and angles [rad] and stiffness [N*m/rad] by
    joint: those that all runs have in common, and those with runs along the last axis.
    """
    robot, supply, gravity, angles, stiffness = eqx.combine(lane, shared)
    held = robot.held(angles)
    bias = iter(joint_equations(robot, held, (0.0,) * len(held), gravity).bias)
    found, attained = [], []
    for index, (joint, angle, wanted) in enumerate(zip(robot.joints, held, stiffness, strict=True)):
        pair, torque = robot.pair(index), next(bias) if joint.locked is None else 0.0
        pair = rated_for(pair, tuple(jnp.minimum(muscle.domain.pressure_max, supply) for muscle in pair.muscles))
        solution = solve_static(pair, angle, torque, wanted)
        low, high = stiffness_range(pair, angle, torque, None, _TAUT)
        found.append(solution.pressures)
        attained.append(solution.exists & (low <= wanted * (1 + EXACT)) & (wanted * (1 - EXACT) <= high))
    return HeldByPairs(found, functools.reduce(operator.and_, attained))


def unattainable(plant: PyTree, times: NDArray, setpoints: Sequence[Setpoint]) -> list[Remark]:
    """Return remarks on postures that the muscles of a robot cannot hold, and on stiffness not attained there, at rest.

    Checked at some of the times [s] of setpoints.
    """
    robot, supply = plant.robot, plant.supply
    chosen = evenly_spaced(times.size, POSTURES)
    angles, stiffness = (
        np.stack([np.asarray(values)[chosen] for values in rows]) for rows in zip(*setpoints, strict=True)
    )
    missed = np.ones(chosen.size, bool)
    if robot.has_disjoint_pairs and is_affine(robot):
        numbers, none = numeric(robot), (None,) * len(angles)
        unchanged, postures = (numbers, supply, plant.gravity, none, none), (tuple(angles), tuple(stiffness))
        missed = ~held_by_pairs(unchanged, (eqx.filter(numbers, False), None, None, *postures)).attained
    rows = times[chosen][missed], angles[:, missed].T, stiffness[:, missed].T
    return list(check_postures(robot, *rows, supply=supply)) if missed.any() else []
