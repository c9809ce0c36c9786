"""Prediction over a known delay of the commands."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator.base import Actuator, air_volumes, delay_periods
from mckibben.component.base import Inherited
from mckibben.component.columns import Label
from mckibben.control.actuator_adaptation import ActuatorAdaptation, ActuatorAdaptationState, with_speed
from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.control.model_based import Estimates, ModelBasedControl
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver
from mckibben.errors import ParameterError, RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.joint.geometry import Pair
from mckibben.units import CommandDelay

Scalar = Float[Array, ""]

_MOST_STEPS = 8  # of the prediction


def _plant_delay(scope: Mapping[str, Any]) -> Any:
    """Delay of the plant's commands [s]."""
    found = scope.get("command_delay")
    return 0.0 if found is None else found


class DelayState(NamedTuple):
    """State of the inner controller, estimates at the last sample, and commands [Pa] on their way, the last first.

    `angle` is the last measured one [rad].
    """

    inner: Any
    estimates: Estimates
    sent: tuple[Pair, ...]
    adaptation: ActuatorAdaptationState | tuple[()]
    angle: Scalar


class DelayCompensation(ModelBasedControl):
    r"""Wrapper that gives a controller the measurement to be expected when its commands arrive.

    An observer estimates motion, pressures and disturbance from the measurement and the commands that have arrived; the
    model then predicts angle and pressures over the delay d with the commands on their way. The controller gets these,
    and the setpoint of the angle extrapolated over d by the derivatives of its samples:

    .. math:: \theta_r(t + d) \approx \theta_r + d\,\dot\theta_r + \tfrac12 d^2\,\ddot\theta_r

    Parameters
    ----------
    controller
        Any controller.
    command_delay
        d [s]: time from a command to the valves; in a file, by default, that of the plant.
    model, load, valve
        Models of the joint, its load and its valves.
    observer, pressure_observer
        As for `DecouplingControl`. The disturbance is constant over the prediction.
    actuator_adaptation
        On-line estimate of the delay and of the speed of the valves, used by the model of the controller too; by
        default none.

    References
    ----------
    O. J. M. Smith, A controller to overcome dead time, ISA Journal 6, 1959; with a state observer, so that disturbances
    and unstable loads are predicted too: A. Z. Manitius and A. W. Olbrot, Finite spectrum assignment problem for
    systems with delays, IEEE Trans. Automatic Control 24, 1979.
    """

    short_name = "delay_compensation"
    telemetry_labels: ClassVar = {
        "command_delay_estimate": Label("s", "controller's estimate of the delay of the commands"),
        "valve_speed_estimate": Label("1", "controller's estimate of the speed of the valves, relative to its model"),
    }

    controller: Controller = eqx.field(kw_only=True)
    command_delay: Annotated[CommandDelay, Inherited(_plant_delay)] = eqx.field(kw_only=True)
    observer: Observer = ExtendedStateObserver()
    pressure_observer: PressureObserver = PressureObserver()
    actuator_adaptation: ActuatorAdaptation | None = eqx.field(kw_only=True, default=None)
    periods: int | None = eqx.field(kw_only=True, default=None, static=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.actuator_adaptation is not None:
            for one in _with_valves(self):
                self.actuator_adaptation.check_valve(one.valve)
                if getattr(one, "valve_adaptation", None) is not None:
                    raise RangeError(
                        f"DelayCompensation: actuator_adaptation and the valve_adaptation of a {type(one).__name__} "
                        "estimate the same valves",
                        field="actuator_adaptation",
                        remedy="leave one of them out",
                    )

    @property
    def observers(self) -> tuple[Observer, PressureObserver]:
        return self.observer, self.pressure_observer

    def with_period(self, period: float) -> Self:
        prepared = super().with_period(period)
        adaptation, longest = self.actuator_adaptation, self.command_delay
        if adaptation is not None:
            longest = adaptation.longest_delay(longest)
        return dataclasses.replace(prepared, periods=delay_periods(longest, period))

    def init(self, measurement: Measurement) -> DelayState:
        if self.periods is None:
            raise ParameterError(
                "DelayCompensation: the control period is unknown, and with it the commands on their way",
                remedy="use controller.with_period(period)",
            )
        sent = (measurement.pressures,) * (self.periods + 1)
        adaptation = self.actuator_adaptation
        adapted = () if adaptation is None else adaptation.init(self.valve, self.command_delay, measurement.pressures)
        return DelayState(
            self.controller.init(measurement), self.init_estimates(measurement), sent, adapted, measurement.angle
        )

    def step(
        self, state: DelayState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[DelayState, Pair]:
        adapted = self._adapt_actuator(state, measurement, period)
        following, commands = self._with_estimates(adapted)._step(state, setpoint, measurement, period)
        return following._replace(adaptation=adapted), commands

    def _step(
        self, state: DelayState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[DelayState, Pair]:
        delay = self.command_delay / jnp.asarray(period)
        arrived = _means(state.sent, delay, delay + 1)
        estimates, model = self.update(state.estimates._replace(commands=arrived), setpoint, measurement, period)[:2]
        expected = self._predicted(model, estimates, state.sent, period)
        reference, ahead = estimates.reference, jnp.asarray(self.command_delay)
        angle = reference.angle + ahead * (reference.velocity + ahead / 2 * reference.acceleration)
        inner, commands = self.controller.step(state.inner, setpoint._replace(angle=angle), expected, period)
        unused = ("torque", "stiffness", "added_stiffness", "commands", "saturated")  # not computed in exported C
        estimates = estimates._replace(**{name: getattr(state.estimates, name) for name in unused})
        sent = (commands, *state.sent[:-1])
        return DelayState(inner, estimates, sent, state.adaptation, measurement.angle), commands

    def telemetry(self, state: DelayState) -> dict[str, Scalar]:
        signals = self.controller.telemetry(state.inner)
        if isinstance(state.adaptation, ActuatorAdaptationState):
            estimates = {
                "command_delay_estimate": state.adaptation.delay,
                "valve_speed_estimate": state.adaptation.speed,
            }
            signals = signals | estimates
        return signals

    def _adapt_actuator(
        self, state: DelayState, measurement: Measurement, period: ArrayLike
    ) -> ActuatorAdaptationState | tuple[()]:
        """Estimates of delay and speed after a further measurement."""
        if self.actuator_adaptation is None or not isinstance(state.adaptation, ActuatorAdaptationState):
            return state.adaptation
        angle, pressures = measurement
        air: Any = (None, None)
        if self.valve.holds_air:
            # An observer lags; steps of the encoder cancel in the sum over several periods.
            velocity, middle = (angle - state.angle) / period, (angle + state.angle) / 2
            attached = tuple(self.valve.for_muscle(side).attached_volume for side in (0, 1))
            air = air_volumes(self.model, middle, velocity, pressures, dead_volumes=attached)
        held = state.adaptation, self.valve, self.command_delay
        return self.actuator_adaptation.step(*held, state.sent, pressures, air, period)

    def _with_estimates(self, adapted: ActuatorAdaptationState | tuple[()]) -> DelayCompensation:
        """The controller with estimates in place of delay and speed of its models."""
        if not isinstance(adapted, ActuatorAdaptationState):
            return self
        valves = [with_speed(one.valve, adapted.speed) for one in _with_valves(self)]

        def replaced(control: Any) -> list[Any]:
            return [control.command_delay, *(one.valve for one in _with_valves(control))]

        return eqx.tree_at(replaced, self, [adapted.delay, *valves])

    def _predicted(
        self, model: AntagonisticJoint, estimates: Estimates, sent: tuple[Pair, ...], period: ArrayLike
    ) -> Measurement:
        """Angle [rad] and pressures [Pa] when the next command arrives."""
        steps = min(len(sent) - 1, _MOST_STEPS)
        if not steps:
            return Measurement(estimates.motion.angle, estimates.pressures)
        delay, step = self.command_delay / jnp.asarray(period), jnp.asarray(self.command_delay) / steps
        pairs = [_means(sent, delay * (1 - (k + 1) / steps), delay * (1 - k / steps)) for k in range(steps)]
        commands = jnp.stack([one for one, _ in pairs]), jnp.stack([other for _, other in pairs])

        def advance(state: tuple[Scalar, Scalar, Pair, Any], commands: Pair) -> tuple[Any, None]:
            angle, velocity, pressures, actuators = state
            midway = angle + step / 2 * velocity  # one evaluation of the geometry
            valves = self._valves(estimates.valves, midway, velocity, pressures, actuators)
            following, actuators = valves.predict(commands, step)
            middle = tuple((one + other) / 2 for one, other in zip(pressures, following, strict=True))
            torque = model.torque(midway, (middle[0], middle[1])) + estimates.friction
            acceleration = self.load.acceleration(midway, velocity, torque) + estimates.motion.disturbance
            moved = angle + step * (velocity + step / 2 * acceleration)
            return (moved, velocity + step * acceleration, following, actuators), None

        motion = estimates.motion
        start = motion.angle, motion.velocity, estimates.pressures, estimates.actuators
        (angle, _, pressures, _), _ = lax.scan(advance, start, commands)
        return Measurement(angle, pressures)


def _with_valves(controller: Any) -> Iterator[Any]:
    """The controllers with a model of the valves: this one, and those that it wraps."""
    if isinstance(getattr(controller, "valve", None), Actuator):
        yield controller
    for field in dataclasses.fields(controller):
        inner = getattr(controller, field.name)
        if isinstance(inner, Controller):
            yield from _with_valves(inner)


def _means(sent: tuple[Pair, ...], newest: ArrayLike, oldest: ArrayLike) -> Pair:
    """Mean commands [Pa] between two ages, in control periods; the last sent has an age of up to 1."""
    span = jnp.maximum(jnp.asarray(oldest) - newest, 1e-9)
    shares = [
        jnp.clip((jnp.minimum(oldest, age + 1.0) - jnp.maximum(newest, float(age))) / span, 0.0, 1.0)
        for age in range(len(sent))
    ]
    weighed = [(share * one, share * other) for share, (one, other) in zip(shares, sent, strict=True)]
    first, second = (functools.reduce(operator.add, side) for side in zip(*weighed, strict=True))
    return first, second
