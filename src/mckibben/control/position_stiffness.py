"""Joint position and joint stiffness at once: two loops over differential pressure and co-contraction (Fig. 5)."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.base import Controller, Loop, Measurement, Setpoint
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import pressure_limits_of
from mckibben.numerics.derivative import derivative
from mckibben.numerics.many import apart

Scalar = Float[Array, ""]


class PositionStiffnessState(NamedTuple):
    """The state of both loops, the last estimate of the stiffness [N*m/rad], whether a command was at a limit."""

    position: Any
    stiffness: Any
    estimate: Scalar
    saturated: Array


class PositionStiffnessControl(Controller):
    """A position loop sets the differential pressure, a stiffness loop the co-contraction.

    p1 = pc - pd and p2 = pc + pd, each within the limits of its muscle's domain; both loops are told what was
    realised. Stiffness cannot be measured: it is estimated from the measured angle and pressures by the controller's
    own model of the joint, and is only as true as that model.

    Parameters
    ----------
    position
        The loop from angle [rad] to differential pressure pd [Pa].
    stiffness
        The loop from stiffness [N*m/rad] to co-contraction pc [Pa].
    model
        The controller's model of the joint; another object than the plant's.

    References
    ----------
    Fig. 5 of the paper.
    """

    position: Loop
    stiffness: Loop
    model: AntagonisticJoint = eqx.field(kw_only=True)

    def init(self, measurement: Measurement) -> PositionStiffnessState:
        pressure1, pressure2 = measurement.pressures
        estimate = self.model.stiffness(measurement.angle, measurement.pressures)
        return PositionStiffnessState(
            position=self.position.init(measurement.angle, measurement.angle, (pressure2 - pressure1) / 2),
            stiffness=self.stiffness.init(estimate, estimate, (pressure1 + pressure2) / 2),
            estimate=estimate,
            saturated=jnp.asarray(False),
        )

    def step(
        self, state: PositionStiffnessState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[PositionStiffnessState, tuple[Scalar, Scalar]]:
        angle, pressures = measurement
        estimate = apart(self.model.stiffness, angle, pressures, witness=period)
        by_differential, by_cocontraction = self._sensitivities(measurement, estimate)
        position, differential = self.position.step(state.position, setpoint.angle, angle, by_differential, period)
        stiffness, cocontraction = self.stiffness.step(
            state.stiffness, setpoint.stiffness, estimate, by_cocontraction, period
        )

        lowest, highest = pressure_limits_of(self.model)
        wanted1, wanted2 = cocontraction - differential, cocontraction + differential
        command1 = jnp.clip(wanted1, lowest[0], highest[0])
        command2 = jnp.clip(wanted2, lowest[1], highest[1])
        saturated = (command1 != wanted1) | (command2 != wanted2)

        position = self.position.realised(position, differential, (command2 - command1) / 2, period)
        stiffness = self.stiffness.realised(stiffness, cocontraction, (command1 + command2) / 2, period)
        return PositionStiffnessState(position, stiffness, estimate, saturated), (command1, command2)

    def telemetry(self, state: PositionStiffnessState) -> dict[str, Scalar]:
        loops = {
            f"{name}_{key}": value
            for name, loop, part in (
                ("position", self.position, state.position),
                ("stiffness", self.stiffness, state.stiffness),
            )
            for key, value in loop.telemetry(part).items()
        }
        return {"stiffness_estimate": state.estimate, "saturated": state.saturated, **loops}

    def _sensitivities(self, measurement: Measurement, stiffness: Scalar) -> tuple[Scalar, Scalar]:
        """Static change of the angle per differential pressure, and of the stiffness per co-contraction.

        Of the muscles alone: the controller knows no load, so gravity's part of the stiffness is left out.
        """
        angle, (pressure1, pressure2) = measurement
        zero = jnp.zeros_like(pressure1)
        torque_slope = derivative(lambda pd: self.model.torque(angle, (pressure1 - pd, pressure2 + pd)), zero)
        stiffness_slope = derivative(lambda pc: self.model.stiffness(angle, (pressure1 + pc, pressure2 + pc)), zero)
        slack = stiffness == 0  # then no pressure holds an angle, and nothing can be learned from one
        angle_slope = jnp.where(slack, 0.0, torque_slope / jnp.where(slack, 1.0, stiffness))
        return angle_slope, stiffness_slope
