"""Feedforward compensation of friction by a model of the muscles' hysteresis."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.columns import Label
from mckibben.control.allocation import clip_commands, limit_commands
from mckibben.control.base import Controller, JointModel, Measurement, Setpoint
from mckibben.control.inverse_model import InverseModelControl
from mckibben.errors import RangeError
from mckibben.joint.antagonistic import MuscleStates
from mckibben.numerics.calculus import derivative

Scalar = Float[Array, ""]


class FrictionCompensationState(NamedTuple):
    """States of inner controller and muscles, friction torque [N*m], and whether a command met a limit."""

    inner: Any
    muscles: MuscleStates
    torque: Scalar
    saturated: Array


class FrictionCompensation(Controller):
    r"""Wrapper that adds the pressures to overcome friction to the commands of an inner controller.

    .. math:: p_d \leftarrow p_d - \tau_f \Big/ \frac{\partial\tau}{\partial p_d}

    :math:`\tau_f` is the rate-independent friction torque of the model's muscles along the *reference* angle at the
    measured pressures: along the measured angle it would have the wrong sign near a reversal. Limits that the shift
    meets are not fed back to the inner controller, whose minimum tension holds here as well.
    """

    short_name = "friction_compensation"
    telemetry_labels: ClassVar = {
        "friction_compensation": Label("N*m", "friction torque compensated by the controller")
    }

    controller: Controller
    model: JointModel = eqx.field(kw_only=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        if isinstance(self.controller, InverseModelControl):
            message = "FrictionCompensation: the learned inverse of its controller includes friction"
            raise RangeError(message, field="controller", remedy="leave the compensation out")
        if not self.model.has_friction:
            raise RangeError(
                "FrictionCompensation: no muscle of its model has friction",
                remedy="give the model's muscles a MaxwellSlip, or leave the compensation out",
            )

    @property
    def stiffness_amplitude(self) -> float | None:  # pyrefly: ignore[bad-override]
        """That of the inner controller."""
        return self.controller.stiffness_amplitude

    def init(self, measurement: Measurement) -> FrictionCompensationState:
        muscles = self.model.init_state(measurement.angle, measurement.pressures)
        zero = jnp.zeros_like(measurement.angle)
        return FrictionCompensationState(self.controller.init(measurement), muscles, zero, jnp.asarray(False))

    def step(
        self, state: FrictionCompensationState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[FrictionCompensationState, tuple[Scalar, Scalar]]:
        inner, (command1, command2) = self.controller.step(state.inner, setpoint, measurement, period)
        pressures = measurement.pressures
        muscles = self.model.update_state(state.muscles, setpoint.angle, pressures)
        torque = self.model.friction_torque(setpoint.angle, None, pressures, muscles)
        shift = -torque * self._pressure_per_torque(measurement)

        tension = getattr(self.controller, "minimum_tension", None)
        if tension is None:
            shifted, saturated = clip_commands(self.model, (command1 - shift, command2 + shift))
        else:
            differential, cocontraction = (command2 - command1) / 2 + shift, (command1 + command2) / 2
            shifted, saturated = limit_commands(self.model, tension, measurement.angle, differential, cocontraction)
        return FrictionCompensationState(inner, muscles, torque, saturated), shifted

    def telemetry(self, state: FrictionCompensationState) -> dict[str, Scalar]:
        inner = self.controller.telemetry(state.inner)
        saturated = inner.get("saturated", jnp.asarray(False)) | state.saturated
        return {**inner, "saturated": saturated, "friction_compensation": state.torque}

    def _pressure_per_torque(self, measurement: Measurement) -> Scalar:
        """Differential pressure per torque [Pa/(N*m)]; 0 where both muscles are slack."""
        angle, (pressure1, pressure2) = measurement
        zero = jnp.zeros_like(pressure1)
        slope = derivative(lambda pd: self.model.torque(angle, (pressure1 - pd, pressure2 + pd)), zero)
        slack = slope <= 0
        return jnp.where(slack, 0.0, 1 / jnp.where(slack, 1.0, slope))
