"""Feed-forward of friction: what a model of the muscles' hysteresis expects along the wish is made up for."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.control.position_stiffness import within_limits
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.joint.antagonistic import MuscleStates
from mckibben.joint.attainable import pressure_limits_of
from mckibben.numerics.calculus import derivative
from mckibben.numerics.checks import check_kind

Scalar = Float[Array, ""]


class FrictionCompensationState(NamedTuple):
    """The state of the controller inside; internal states of the model's muscles; the friction torque expected [N*m].

    And whether a command was at a limit.
    """

    inner: Any
    muscles: MuscleStates
    torque: Scalar
    saturated: Array


class FrictionCompensation(Controller):
    r"""A controller, and on top of its differential pressure what friction will take.

    .. math:: p_d \leftarrow p_d - \tau_f \Big/ \frac{\partial\tau}{\partial p_d}

    The model's muscles are drawn along the *desired* angle, at the measured pressures, and :math:`\tau_f` is the
    torque of their rate-independent friction there. The measured angle would be the other choice. It is not taken,
    because near a reversal the joint sticks while the wish already turns: friction would be made up for in the wrong
    direction until the joint has moved, and the estimate would be fed back on itself, which rings or creeps once it is
    a little too large. Along the wish it leads and cannot make the loop unstable, and presliding makes it continuous,
    so that it does not chatter. What it gets wrong is left to the feedback.

    Viscous friction is not made up for: a step of the wish would be a kick. Where the shift meets a limit of the
    pressure, the controller inside is not told; its integral sees the error that this leaves. A minimum tension of the
    controller inside is kept with the shift as well.

    Parameters
    ----------
    controller
        What it wraps.
    model
        A joint whose muscles have friction: what the controller believes of it.
    """

    controller: Controller
    model: AntagonisticJoint = eqx.field(kw_only=True)

    def __check_init__(self) -> None:
        check_kind(
            "FrictionCompensation",
            controller=(self.controller, Controller),
            model=(self.model, AntagonisticJoint),
        )
        if not self.model.has_friction:
            raise RangeError(
                "FrictionCompensation: no muscle of its model has friction",
                remedy="give the model's muscles a MaxwellSlip, or leave the compensation out",
            )

    def init(self, measurement: Measurement) -> FrictionCompensationState:
        muscles = self.model.init_state(measurement.angle, measurement.pressures)
        nothing = jnp.zeros_like(measurement.angle)
        return FrictionCompensationState(self.controller.init(measurement), muscles, nothing, jnp.asarray(False))

    def step(
        self,
        state: FrictionCompensationState,
        setpoint: Setpoint,
        measurement: Measurement,
        period: ArrayLike,
    ) -> tuple[FrictionCompensationState, tuple[Scalar, Scalar]]:
        inner, (command1, command2) = self.controller.step(state.inner, setpoint, measurement, period)
        pressures = measurement.pressures
        muscles = self.model.update_state(state.muscles, setpoint.angle, pressures)
        torque = self.model.friction_torque(setpoint.angle, 0.0, pressures, muscles)
        shift = -torque * self._pressure_per_torque(measurement)

        tension = getattr(self.controller, "minimum_tension", None)
        if tension is None:
            lowest, highest = pressure_limits_of(self.model)
            wanted1, wanted2 = command1 - shift, command2 + shift
            shifted1 = jnp.clip(wanted1, lowest[0], highest[0])
            shifted2 = jnp.clip(wanted2, lowest[1], highest[1])
            saturated = (shifted1 != wanted1) | (shifted2 != wanted2)
        else:
            asked = (command2 - command1) / 2 + shift, (command1 + command2) / 2
            (shifted1, shifted2), saturated = within_limits(self.model, tension, measurement.angle, asked, period)
        return FrictionCompensationState(inner, muscles, torque, saturated), (shifted1, shifted2)

    def telemetry(self, state: FrictionCompensationState) -> dict[str, Scalar]:
        inner = self.controller.telemetry(state.inner)
        saturated = inner.get("saturated", jnp.asarray(False)) | state.saturated
        return {**inner, "saturated": saturated, "friction_compensation": state.torque}

    def _pressure_per_torque(self, measurement: Measurement) -> Scalar:
        """Change of the differential pressure [Pa] per torque [N*m]; 0 where both muscles are slack."""
        angle, (pressure1, pressure2) = measurement
        zero = jnp.zeros_like(pressure1)
        slope = derivative(lambda pd: self.model.torque(angle, (pressure1 - pd, pressure2 + pd)), zero)
        slack = slope <= 0
        return jnp.where(slack, 0.0, 1 / jnp.where(slack, 1.0, slope))
