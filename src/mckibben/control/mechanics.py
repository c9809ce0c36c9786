"""A controller's model of the mechanics: a mechanism of the plant, with what control needs of it.

The methods of both have sequences over joints or over muscles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.control.allocation import keep_taut, linearise, pressure_range
from mckibben.joint import AffineMap, AntagonisticJoint
from mckibben.joint.route import Route
from mckibben.mechanism.dynamics import joint_equations
from mckibben.mechanism.hinge import Hinge
from mckibben.mechanism.robot_tree import Tree
from mckibben.mechanism.terms import JointTerms, Row, joint_terms
from mckibben.mechanism.tree import Equations
from mckibben.numerics.compiled import cached_trace
from mckibben.numerics.elementary import floating
from mckibben.numerics.spatial import total

Scalar = Float[Array, ""]
Scalars = tuple[Scalar, ...]


class AllocationTerms(NamedTuple):
    """Torques and stiffness over the pressures, and the pressures [Pa] of taut muscles within their ratings."""

    terms: JointTerms
    lowest: Scalars
    highest: Scalars


class HingeMechanics(Hinge):
    """A joint with its load in closed form: Eqs. 6 to 8."""

    is_paired = True
    """Whether the muscles are a pair of each joint alone."""

    def routes_at(self, angles: Sequence[ArrayLike]) -> Sequence[Route]:
        """Return all muscles with their paths at angles [rad]."""
        return self.joint.routes(angles[0])

    def torques(self, angles: Sequence[Array], pressures: Sequence[Array]) -> Scalars:
        """Return the torques [N*m] of the laws at angles [rad] and gauge pressures [Pa]."""
        return (self.joint.torque(angles[0], (pressures[0], pressures[1])),)

    def evaluate(self, angles: Sequence[Array], pressures: Sequence[Array]) -> tuple[Scalars, Scalars]:
        """Return `torques`, and the isobaric stiffness [N*m/rad] of each joint, the others held."""
        torque, stiffness = self.joint.evaluate(angles[0], (pressures[0], pressures[1]))
        return (torque,), (stiffness,)

    def stiffness_for(self, angles: Sequence[Array], pressures: Sequence[Array], amplitude: ArrayLike) -> Scalars:
        """Return the stiffness [N*m/rad] of motion with an amplitude [rad], friction included."""
        return (self.joint.secant_stiffness(angles[0], (pressures[0], pressures[1]), amplitude),)

    def equations(self, angles: Sequence[ArrayLike], rates: Sequence[ArrayLike]) -> Equations:
        """Return matrix, with full rows, and bias with the damping, of the motion."""
        return Equations([[self.load.total_inertia]], [self.load.required_torque(angles[0], rates[0], 0.0)])

    def accelerations(
        self, angles: Sequence[Array], rates: Sequence[Array], torques: Sequence[Array], period: ArrayLike
    ) -> Scalars:
        """Return the mean accelerations [rad/s^2] in a time [s] under torques [N*m]."""
        return (self.load.acceleration(angles[0], rates[0], torques[0]),)

    def allocation_terms(
        self, angles: Sequence[Array], pressures: Sequence[Array], minimum_tension: ArrayLike
    ) -> AllocationTerms:
        """Return the terms at angles [rad], near pressures [Pa], for tensions from a minimum [N] to the rating."""
        torque, stiffness, lowest, highest = _affine(self.joint, angles[0], tuple(pressures), minimum_tension)

        def row(affine: AffineMap) -> Row:
            return {0: (affine.offset, affine.slope1), 1: (0.0, affine.slope2)}

        return AllocationTerms(JointTerms([row(torque)], {(0, 0): row(stiffness)}, []), lowest, highest)


@cached_trace
def _affine(joint: AntagonisticJoint, angle: Scalar, pressures: Scalars, minimum_tension: ArrayLike) -> PyTree:
    lowest, highest = pressure_range(joint, angle, minimum_tension)
    return *linearise(joint, angle, keep_taut((pressures[0], pressures[1]), lowest)), lowest, highest


class TreeMechanics(Tree):
    """A robot with its base at rest and its foot in the air; laws are affine in pressure, and tendons rigid."""

    @property
    def is_paired(self) -> bool:
        return self.robot.has_disjoint_pairs

    def routes_at(self, angles: Sequence[ArrayLike]) -> Sequence[Route]:
        return self.robot.routed_muscles(angles)

    def torques(self, angles: Sequence[Array], pressures: Sequence[Array]) -> Scalars:
        return self.robot.torques(angles, pressures)

    def evaluate(self, angles: Sequence[Array], pressures: Sequence[Array]) -> tuple[Scalars, Scalars]:
        return self.torques(angles, pressures), joint_terms(self.robot, angles).stiffness_at(pressures)

    def stiffness_for(self, angles: Sequence[Array], pressures: Sequence[Array], amplitude: ArrayLike) -> Scalars:
        return tuple(
            self.robot.pair(joint).secant_stiffness(angles[joint], (pressures[first], pressures[first + 1]), amplitude)
            for joint, first in self.robot.pairs.items()
        )

    def equations(self, angles: Sequence[ArrayLike], rates: Sequence[ArrayLike]) -> Equations:
        matrix, bias = joint_equations(self.robot, angles, rates, self.gravity)
        joints = zip(bias, self.robot.joints, rates, strict=True)
        return Equations(matrix, [total(torque, joint.damping * rate) for torque, joint, rate in joints])

    def accelerations(
        self, angles: Sequence[Array], rates: Sequence[Array], torques: Sequence[Array], period: ArrayLike
    ) -> Scalars:
        matrix, bias = self.equations(angles, rates)  # damping is that at the end of the time: joints may be faster
        for i, joint in enumerate(self.robot.joints):
            matrix[i][i] = total(matrix[i][i], joint.damping * period)
        return tuple(Equations(matrix, bias).accelerations(torques))

    def allocation_terms(
        self, angles: Sequence[Array], pressures: Sequence[Array], minimum_tension: ArrayLike
    ) -> AllocationTerms:
        terms, lowest, highest = joint_terms(self.robot, angles), [], []
        for muscle, (offset, gain) in zip(self.muscles, terms.tension, strict=True):
            limits: Any = floating(muscle.domain.pressure_min), floating(muscle.domain.pressure_max)
            if not muscle.law.is_passive:
                low, rated = jnp.clip((minimum_tension - offset) / gain, *limits), muscle.specimen.rated_force
                limits = low, limits[1] if rated is None else jnp.clip((rated - offset) / gain, low, limits[1])
            lowest.append(limits[0])
            highest.append(limits[1])
        return AllocationTerms(terms, tuple(lowest), tuple(highest))


Mechanics = HingeMechanics | TreeMechanics
