"""Joint position and joint stiffness by two loops over differential pressure and co-contraction (Fig. 5)."""

from __future__ import annotations

import warnings
from numbers import Real
from typing import Annotated, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.component.base import Units
from mckibben.component.calls import user_level
from mckibben.component.columns import Label
from mckibben.control.allocation import achieved, limit_commands
from mckibben.control.base import Controller, JointModel, Loop, Measurement, Setpoint
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.joint.geometry import Pair
from mckibben.units import AngleGain, AngleScale, JointQuantity, StiffnessScale, Tension

AngleIntegralGain = Annotated[float, JointQuantity("Pa/(rad*s)", "bar/(rad*s)", -1e6, 1e6)]
AngleDerivativeGain = Annotated[float, JointQuantity("Pa*s/rad", "bar*s/rad", -1e6, 1e6)]
StiffnessGain = Annotated[float, JointQuantity("Pa/(N*m/rad)", "bar/(N*m/rad)", -1e6, 1e6)]
StiffnessIntegralGain = Annotated[float, JointQuantity("Pa/(N*m*s/rad)", "bar/(N*m*s/rad)", -1e6, 1e6)]
StiffnessDerivativeGain = Annotated[float, JointQuantity("Pa*s/(N*m/rad)", "bar*s/(N*m/rad)", -1e6, 1e6)]

Scalar = Float[Array, ""]

_ANGLE_LOOP = Units(
    gain=AngleGain, integral_gain=AngleIntegralGain, derivative_gain=AngleDerivativeGain, scale=AngleScale
)
_STIFFNESS_LOOP = Units(
    gain=StiffnessGain,
    integral_gain=StiffnessIntegralGain,
    derivative_gain=StiffnessDerivativeGain,
    scale=StiffnessScale,
)

_LEAST_GAIN = 1e3  # Pa: if the largest of the position loop is lower, they are in bar


class PositionStiffnessState(NamedTuple):
    """State of both loops, estimated stiffness [N*m/rad], and whether a command met a limit."""

    position: PyTree
    stiffness: PyTree
    estimate: Scalar
    saturated: Array


class Feedforward(NamedTuple):
    """Pressures [Pa] added to those of the loops, and the displacement that they account for."""

    differential: Scalar
    cocontraction: Scalar
    path: Scalar  # displacement [rad] that the position loop does not see, so that its derivative does not oppose it


NO_FEEDFORWARD = Feedforward(0.0, 0.0, 0.0)  # type: ignore[arg-type]  # plain numbers


class PositionStiffnessControl(Controller[PositionStiffnessState]):
    """Position loop on the differential pressure pd, stiffness loop on the co-contraction pc (Fig. 5 of the paper).

    p1 = pc - pd and p2 = pc + pd, within the limits of each muscle's domain; both loops track the achieved output. The
    stiffness is estimated from the measured angle and pressures by the controller's own model of the joint. A muscle
    alone, against a spring or a weight, has no co-contraction, and the position loop alone.

    Parameters
    ----------
    position, stiffness
        Loops from angle [rad] to differential pressure, and from stiffness [N*m/rad] to co-contraction [Pa], which a
        muscle alone has not.
    model
        Controller's model of the joint; not the same object as the plant's.
    minimum_tension
        Lower limit of each muscle's tension [N] by the model; the upper one is the specimen's rated force. None, as in
        the paper: each command is clipped separately, and a muscle may go slack.
    stiffness_amplitude
        Amplitude [rad] of the motion whose stiffness is controlled, friction included
        (`AntagonisticJoint.secant_stiffness`). Default: the isobaric stiffness.
    """

    short_name = "position_stiffness"
    telemetry_labels: ClassVar = {
        "position_kp": Label("Pa/rad", "proportional gain of the position loop"),
        "position_ki": Label("Pa/(rad*s)", "integral gain of the position loop"),
        "position_kd": Label("Pa*s/rad", "derivative gain of the position loop"),
        "stiffness_kp": Label("Pa/(N*m/rad)", "proportional gain of the stiffness loop"),
        "stiffness_ki": Label("Pa/(N*m*s/rad)", "integral gain of the stiffness loop"),
        "stiffness_kd": Label("Pa*s/(N*m/rad)", "derivative gain of the stiffness loop"),
    }

    position: Annotated[Loop, _ANGLE_LOOP]
    stiffness: Annotated[Loop | None, _STIFFNESS_LOOP] = None
    model: JointModel = eqx.field(kw_only=True)
    minimum_tension: Tension | None = eqx.field(kw_only=True, default=None)
    stiffness_amplitude: AngleScale | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        super().__check_init__()
        if (self.stiffness is None) != any(self.model.springs):
            text, remedy = "two muscles need a stiffness loop", "give `stiffness` its gains"
            if self.stiffness is not None:
                text, remedy = "one muscle alone has no stiffness to control", "leave the stiffness loop out"
            raise RangeError(f"PositionStiffnessControl: {text}", field="stiffness", remedy=remedy)
        pid = vars(self.position).get("base", self.position)  # `getattr` would look for a similar name
        gains = [vars(pid).get(name) for name in ("kp", "ki", "kd")]
        if all(isinstance(gain, Real) for gain in gains) and 0 < max(abs(float(gain)) for gain in gains) < _LEAST_GAIN:
            text = f"the gains of the position loop are {', '.join(f'{gain:g}' for gain in gains)}"
            remedy = "numbers are in SI, such as 2 * bar for 2 bar/rad"
            warnings.warn(f"{text} Pa for an error of 1 rad: {remedy}", McKibbenWarning, stacklevel=user_level())

    def init(self, measurement: Measurement) -> PositionStiffnessState:
        return self.init_with(NO_FEEDFORWARD, measurement)

    def step(
        self, state: PositionStiffnessState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[PositionStiffnessState, Pair]:
        return self.step_with(NO_FEEDFORWARD, state, setpoint, measurement, period)

    def init_with(self, feedforward: Feedforward, measurement: Measurement) -> PositionStiffnessState:
        """Return the initial state with a feedforward."""
        angle, (pressure1, pressure2) = measurement
        estimate = self.model.stiffness_for(angle, measurement.pressures, self.stiffness_amplitude)
        differential = (pressure2 - pressure1) / 2 - feedforward.differential
        cocontraction = (pressure1 + pressure2) / 2 - feedforward.cocontraction
        held = cocontraction if self.stiffness is None else self.stiffness.init(estimate, estimate, cocontraction)
        return PositionStiffnessState(
            position=self.position.init(angle - feedforward.path, angle - feedforward.path, differential),
            stiffness=held,
            estimate=estimate,
            saturated=jnp.asarray(False),
        )

    def step_with(
        self,
        feedforward: Feedforward,
        state: PositionStiffnessState,
        setpoint: Setpoint,
        measurement: Measurement,
        period: ArrayLike,
    ) -> tuple[PositionStiffnessState, Pair]:
        """Return the next state and the commands with a feedforward."""
        angle, pressures = measurement
        estimate = self.model.stiffness_for(angle, pressures, self.stiffness_amplitude)
        target, measured = setpoint.angle - feedforward.path, angle - feedforward.path
        position, differential = self.position.step(state.position, target, measured, period)
        stiffness = cocontraction = state.stiffness
        if self.stiffness is not None:
            stiffness, cocontraction = self.stiffness.step(state.stiffness, setpoint.stiffness, estimate, period)

        targets = differential + feedforward.differential, cocontraction + feedforward.cocontraction
        commands, saturated = limit_commands(self.model, self.minimum_tension, angle, *targets)
        given_differential, given_mean = achieved(self.model, commands, targets[1])
        position = self.position.track(position, differential, given_differential - feedforward.differential, period)
        if self.stiffness is not None:
            stiffness = self.stiffness.track(stiffness, cocontraction, given_mean - feedforward.cocontraction, period)
        return PositionStiffnessState(position, stiffness, estimate, saturated), commands

    def telemetry(self, state: PositionStiffnessState) -> dict[str, Scalar]:
        loops = {
            f"{name}_{key}": value
            for name, loop, part in (
                ("position", self.position, state.position),
                ("stiffness", self.stiffness, state.stiffness),
            )
            if loop is not None
            for key, value in loop.telemetry(part).items()
        }
        return {"stiffness_estimate": state.estimate, "saturated": state.saturated, **loops}
