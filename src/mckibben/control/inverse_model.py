"""Feedforward by an inverse model of the joint, in addition to two loops."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator import FirstOrderValve
from mckibben.component.columns import Label
from mckibben.control.allocation import keep_taut, linearise, pressure_range, prioritise_torque
from mckibben.control.base import Controller, LoadModel, Measurement, Setpoint, ValveModel, check_valve_model
from mckibben.control.position_stiffness import Feedforward, PositionStiffnessControl, PositionStiffnessState
from mckibben.control.reference import ReferenceDerivatives
from mckibben.joint.geometry import Pair
from mckibben.numerics.compiled import cached_trace
from mckibben.numerics.elementary import floating

Scalar = Float[Array, ""]

_TAUT = 1.0  # N: least tension, if the loops have none


class InverseInput(NamedTuple):
    """Input of the inverse: angle [rad], velocity [rad/s], acceleration [rad/s^2], stiffness [N*m/rad]."""

    angle: Scalar
    velocity: Scalar
    acceleration: Scalar
    stiffness: Scalar


class InverseModelState(NamedTuple):
    """State of loops and reference; pressures at the start minus those of the model, and feedforward, as (pd, pc)."""

    loops: PositionStiffnessState
    reference: ReferenceDerivatives
    path: Scalar
    offset: Pair
    feedforward: Pair


class InverseModelControl(Controller[InverseModelState]):
    r"""Feedforward pressures of a model of the joint, in addition to a position and a stiffness loop.

    .. math:: (p_d, p_c) = M(\theta, \dot\theta, \ddot\theta, K) + p_0

    M maps the torque of the motion (`Load.required_torque`) and the stiffness to pressures, with priority to the
    torque, for the reference after the lag of the valves; p_0 makes it exact at the start. With a prediction over the
    delay (`DelayCompensation`) it is the strongest form of the PID.

    Parameters
    ----------
    loops
        The two loops, with their model and minimum tension.
    load
        Model of inertia, damping and gravity.
    valve
        Model of the valves, with the lag that the feedforward previews; default: first-order, 20 ms.

    References
    ----------
    J.-J. Slotine and W. Li, Applied Nonlinear Control, Prentice-Hall 1991, sec. 9.1 (computed-torque feedforward).
    """

    short_name = "inverse_model"
    telemetry_labels: ClassVar = {
        "feedforward_differential": Label("Pa", "feedforward differential pressure"),
        "feedforward_cocontraction": Label("Pa", "feedforward co-contraction"),
    }

    loops: PositionStiffnessControl
    load: LoadModel
    valve: ValveModel = eqx.field(kw_only=True, default=FirstOrderValve(0.02))

    def __check_init__(self) -> None:
        super().__check_init__()
        check_valve_model("InverseModelControl", self.valve, self.loops.model.muscles)

    def init(self, measurement: Measurement) -> InverseModelState:
        angle, (pressure1, pressure2) = measurement
        zero = jnp.zeros_like(floating(angle))
        stiffness = self.loops.model.evaluate(angle, measurement.pressures)[1]
        differential, cocontraction = self._inverse(InverseInput(angle, zero, zero, stiffness), measurement.pressures)
        feedforward = Feedforward((pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2, zero)
        return InverseModelState(
            loops=self.loops.init_with(feedforward, measurement),
            reference=ReferenceDerivatives.init(angle),
            path=zero,
            offset=(feedforward.differential - differential, feedforward.cocontraction - cocontraction),
            feedforward=feedforward[:2],
        )

    def step(
        self, state: InverseModelState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[InverseModelState, Pair]:
        reference, offset = state.reference.update(setpoint.angle, period), state.offset
        path = state.path + jnp.where(reference.samples_since_jump >= 1.0, period * reference.velocity, 0.0)
        target = self._preview(reference, setpoint.stiffness - self._added_stiffness(measurement), period)
        differential, cocontraction = self._inverse(target, measurement.pressures)
        feedforward = Feedforward(differential + offset[0], cocontraction + offset[1], path)
        loops, commands = self.loops.step_with(feedforward, state.loops, setpoint, measurement, period)
        return InverseModelState(loops, reference, path, offset, feedforward[:2]), commands

    def telemetry(self, state: InverseModelState) -> dict[str, Scalar]:
        return {
            **self.loops.telemetry(state.loops),
            "feedforward_differential": state.feedforward[0],
            "feedforward_cocontraction": state.feedforward[1],
        }

    def _added_stiffness(self, measurement: Measurement) -> Scalar | float:
        """Stiffness of the loops minus the isobaric one, which the inverse uses [N*m/rad]."""
        model, amplitude = self.loops.model, self.loops.stiffness_amplitude
        if amplitude is None:
            return 0.0
        return model.secant_stiffness(*measurement, amplitude) - model.evaluate(*measurement)[1]

    def _preview(self, reference: ReferenceDerivatives, stiffness: Scalar, period: ArrayLike) -> InverseInput:
        """Reference after the valves' lag."""
        lag = jnp.asarray(self.valve.model_lag(self.loops.model))
        velocity = reference.velocity + lag * reference.acceleration
        angle = reference.angle + lag * (reference.velocity + lag / 2 * reference.acceleration)
        return InverseInput(angle, velocity, reference.acceleration_after(lag, period), stiffness)

    @cached_trace
    def _inverse(self, x: InverseInput, pressures: Pair) -> Pair:
        """Differential pressure and co-contraction [Pa] by the model, within limits."""
        model = self.loops.model
        tension = _TAUT if self.minimum_tension is None else self.minimum_tension
        lowest, highest = pressure_range(model, x.angle, tension)
        affine = linearise(model, x.angle, keep_taut(pressures, lowest))
        torque = self.load.required_torque(x.angle, x.velocity, x.acceleration)
        allocation = prioritise_torque(affine, torque, x.stiffness, lowest, highest, model.springs)
        pressure1, pressure2 = allocation.pressures
        return (pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2
