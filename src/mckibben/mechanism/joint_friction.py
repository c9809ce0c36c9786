"""Dry friction of the joint itself, of bearings and cable guides: Coulomb friction with presliding."""

from __future__ import annotations

from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.muscle.friction import Elements, FrictionState, anchors, polygon, slip_forces
from mckibben.numerics.elementary import floating
from mckibben.units import JointQuantity

PreslidingAngle = Annotated[float, JointQuantity("rad", "deg", 0, 360, open_lower=True)]

FrictionTorque = Annotated[float, JointQuantity("N*m", "N*m", 1e-9, 1e6)]  # it is divided by


class JointFriction(Component):
    r"""Coulomb friction of the joint, with presliding: springs in parallel, each with a slider (Maxwell slip).

    .. math::

        \tau_f = \sum_i \mathrm{clip}\big(k_i (\theta - a_i),\ \pm w_i \tau_C\big), \qquad
        a_i \leftarrow \theta - \tau_{f,i}/k_i

    While the joint slides in one direction the torque is tau_C against the motion, at any speed. Below tau_C the joint
    sticks: it yields as a spring, and a constant torque moves it no further, unlike with friction that is a smooth
    function of the velocity. No sign of a velocity appears, so nothing chatters. The elements are those of
    `MaxwellSlip`.

    Parameters
    ----------
    torque
        tau_C [N*m].
    presliding
        theta_0 [rad]: after a reversal about 63 % of the change from tau_C to -tau_C is reached after theta_0, 86 %
        after 2 theta_0.
    elements
        Springs, 1 to 16. With one spring, the torque of a joint that sticks is linear in the angle.

    References
    ----------
    D. D. Rizos and S. D. Fassois, Chaos 14 (2004) 431-445, as for `MaxwellSlip`.

    Examples
    --------
    Turned by 10 deg from rest, and back by 1 deg:

    >>> from mckibben.units import deg
    >>> friction = JointFriction(0.3, 1 * deg)
    >>> state = friction.project(friction.initial(0.0), 10 * deg)
    >>> [round(float(friction.resisting_torque(state, angle * deg)), 3) for angle in (10, 9, 0)]
    [0.3, -0.072, -0.3]
    """

    aliases: ClassVar = {"force": ("torque",)}

    torque: FrictionTorque
    presliding: PreslidingAngle = 0.5 * jnp.pi / 180
    elements: Elements = eqx.field(default=4, kw_only=True, static=True)

    @property
    def steepest(self) -> Float[Array, ""]:
        """Stiffness [N*m/rad] of all elements before any slips."""
        return polygon(self.elements).stiffness.sum() * self.torque / self.presliding  # type: ignore

    def initial(self, angle: ArrayLike) -> FrictionState:
        """Return the unstressed state at an angle [rad]."""
        return (floating(angle),) * self.elements

    def resisting_torque(self, state: FrictionState, angle: ArrayLike) -> Float[Array, "..."]:
        """Return the torque [N*m] against the motion at an angle [rad] shortly after a state."""
        first, *others = self._torques(state, angle)
        return sum(others, first)

    def project(self, state: FrictionState, angle: ArrayLike) -> FrictionState:
        """Return the state after a move to an angle [rad]; the torque is the same before and after."""
        return anchors(self._torques(state, angle), angle, self.presliding / self.torque)

    def _torques(self, state: FrictionState, angle: ArrayLike) -> list[Array]:
        return slip_forces(state, angle, self.torque, self.torque / self.presliding)
