"""State estimation shared by the controllers that invert or predict a model of the joint."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator import Actuator, AirVolume, FirstOrderValve
from mckibben.actuator.base import Attainable, air_volumes
from mckibben.component.columns import Label
from mckibben.control.adaptation import AdaptationState, LawAdaptation, with_strengths
from mckibben.control.allocation import command_limits
from mckibben.control.base import (
    Controller,
    JointModel,
    LoadModel,
    Measurement,
    Setpoint,
    ValveModel,
    check_valve_model,
)
from mckibben.control.observer import MotionEstimate, Observer, PressureObserver
from mckibben.control.reference import ReferenceDerivatives
from mckibben.control.valve_adaptation import ValveAdaptation, ValveAdaptationState
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.joint.antagonistic import NO_STATES, MuscleStates
from mckibben.joint.geometry import Pair
from mckibben.units import AngleScale, Force

Scalar = Float[Array, ""]


class Valves(NamedTuple):
    """Model of the valves at their estimated pressures [Pa] and states, and the range of their commands [Pa]."""

    model: Actuator
    pressures: Pair
    states: tuple[Any, Any]
    air: tuple[AirVolume | None, AirVolume | None]
    commands: tuple[Pair, Pair]

    def predict(self, commands: Pair, duration: ArrayLike) -> tuple[Pair, tuple[Any, Any]]:
        """Return the pressures [Pa] and states a time [s] later, under constant commands [Pa]."""
        each = zip(self.pressures, self.states, commands, self.air, strict=True)
        (pressure1, state1), (pressure2, state2) = (
            self.model.for_muscle(i).predict(*one, duration) for i, one in enumerate(each)
        )
        return (pressure1, pressure2), (state1, state2)

    def attainable(self, duration: ArrayLike) -> tuple[Attainable, Attainable]:
        """Return the pressures that can be reached within a time [s]."""
        each = zip(self.pressures, self.states, zip(*self.commands, strict=True), self.air, strict=True)
        reach1, reach2 = (self.model.for_muscle(i).attainable(*one, duration) for i, one in enumerate(each))
        return reach1, reach2

    def commands_toward(self, targets: Pair, lag: ArrayLike, period: ArrayLike) -> Pair:
        """Return the commands [Pa] of a control period [s] that lead the pressures to targets [Pa] with a lag [s]."""
        each = zip(self.pressures, self.states, targets, self.air, strict=True)
        wanted = (self.model.for_muscle(i).command_toward(*one, lag, period) for i, one in enumerate(each))
        command1, command2 = map(jnp.clip, wanted, *self.commands)
        return command1, command2


class Estimates(NamedTuple):
    """Estimates at a sample, and the commands given then."""

    motion: MotionEstimate
    pressures: Pair
    reference: ReferenceDerivatives
    muscles: MuscleStates  # of the model, along the reference
    adaptation: AdaptationState | tuple[()]
    valves: ValveAdaptationState | tuple[()]
    torque: Scalar  # of the model's muscles at the estimated pressures, without friction [N*m]
    stiffness: Scalar  # of the model, for the amplitude of the controller [N*m/rad]
    added_stiffness: Scalar  # minus the isobaric one [N*m/rad]
    friction: Scalar  # compensated torque [N*m]
    commands: Pair  # since the sample [Pa]
    actuators: tuple[Any, Any]  # states of the model of the valves
    saturated: Array


class ModelBasedControl(Controller):
    """Base of controllers with a model of joint, load and valves: parameters and state estimation."""

    telemetry_labels: ClassVar = {
        "velocity_estimate": Label("rad/s", "controller's estimate of the angular velocity"),
        "disturbance_estimate": Label("N*m", "controller's estimate of the disturbance torque"),
        "strength1_estimate": Label("1", "controller's estimate of the strength of muscle 1 relative to its law"),
        "strength2_estimate": Label("1", "controller's estimate of the strength of muscle 2 relative to its law"),
        "valve_time_constant_estimate": Label("s", "controller's estimate of the time constant of the valves"),
    }

    model: JointModel
    load: LoadModel
    valve: ValveModel = eqx.field(kw_only=True, default=FirstOrderValve(0.02))
    minimum_tension: Force = eqx.field(kw_only=True, default=5.0)
    friction_compensation: bool = eqx.field(kw_only=True, static=True, default=False)
    adaptation: LawAdaptation | None = eqx.field(kw_only=True, default=None)
    valve_adaptation: ValveAdaptation | None = eqx.field(kw_only=True, default=None)
    stiffness_amplitude: AngleScale | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        super().__check_init__()
        name = type(self).__name__
        if self.adaptation is not None:
            self.adaptation.check_load(self.load)
        check_valve_model(name, self.valve, self.model)
        if self.valve_adaptation is not None and not self.valve.is_first_order:
            raise RangeError(
                f"{name}: valve_adaptation estimates the lag of a first-order valve, and the model is a "
                f"{type(self.valve).__name__}",
                field="valve_adaptation",
                remedy="give the controller a `valve` with a time_constant, or leave valve_adaptation out",
            )
        if self.friction_compensation and not self.model.has_friction:
            raise RangeError(
                f"{name}: no muscle of its model has friction to compensate",
                remedy="give the model's muscles a MaxwellSlip, or leave friction_compensation out",
            )

    @property
    @abc.abstractmethod
    def observers(self) -> tuple[Observer, PressureObserver]:
        """Observers of the motion and of the pressures."""

    def init_estimates(self, measurement: Measurement) -> Estimates:
        """Estimates before the first step, at rest."""
        angle, pressures = measurement
        torque, isobaric = self.model.evaluate(angle, pressures)
        stiffness, added = self._stiffness(self.model, angle, pressures, isobaric)
        zero = jnp.zeros_like(angle)
        return Estimates(
            motion=self.observers[0].init(angle, self.load.acceleration(angle, zero, torque)),
            pressures=pressures,
            reference=ReferenceDerivatives.init(angle),
            muscles=self.model.init_state(angle, pressures) if self.friction_compensation else NO_STATES,
            adaptation=() if self.adaptation is None else self.adaptation.init(self.model, self.load, angle, pressures),
            valves=() if self.valve_adaptation is None else self.valve_adaptation.init(self.valve.lag, pressures),
            torque=torque,
            stiffness=stiffness,
            added_stiffness=added,
            friction=zero,
            commands=pressures,
            actuators=tuple(self.valve.for_muscle(i).init_model(pressures[i]) for i in (0, 1)),  # type: ignore
            saturated=jnp.asarray(False),
        )

    def update(
        self, last: Estimates, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[Estimates, AntagonisticJoint, Valves]:
        """Estimates after a further sample, with the last commands, and the adapted models of joint and valves."""
        angle = measurement.angle
        observer, pressure_observer = self.observers
        adapted = self._adapt_valves(last, measurement.pressures, period)
        valves = self._valves(adapted, angle, last.motion.velocity, last.pressures, last.actuators)
        predicted, actuators = valves.predict(last.commands, period)
        pressures = pressure_observer.step(predicted, measurement.pressures, period)
        adaptation, model = self._adapt(last.adaptation, measurement, period)
        torque, isobaric = model.evaluate(angle, pressures)
        stiffness, added = self._stiffness(model, angle, pressures, isobaric)
        muscles, friction_torque = self._friction(last.muscles, setpoint.angle, pressures)
        known = self.load.acceleration(angle, last.motion.velocity, torque + friction_torque)
        estimates = last._replace(
            motion=observer.step(last.motion, angle, known, period),
            pressures=pressures,
            reference=last.reference.update(setpoint.angle, period),
            muscles=muscles,
            adaptation=adaptation,
            valves=adapted,
            actuators=actuators,
            torque=torque,
            stiffness=stiffness,
            added_stiffness=added,
            friction=friction_torque,
        )
        now = self._valves(adapted, angle, estimates.motion.velocity, pressures, actuators)
        return estimates, model, now

    def estimates_telemetry(self, estimates: Estimates) -> dict[str, Scalar]:
        """Signals to record, by name."""
        signals = {
            "stiffness_estimate": estimates.stiffness,
            "saturated": estimates.saturated,
            "velocity_estimate": estimates.motion.velocity,
            "disturbance_estimate": self.load.dynamic_torque(0.0, estimates.motion.disturbance),
            "friction_compensation": estimates.friction,
        }
        if isinstance(estimates.adaptation, AdaptationState):
            strength1, strength2 = estimates.adaptation.strengths
            signals |= {"strength1_estimate": strength1, "strength2_estimate": strength2}
        if isinstance(estimates.valves, ValveAdaptationState):
            signals |= {"valve_time_constant_estimate": estimates.valves.time_constant}
        return signals

    def _valves(
        self,
        adapted: ValveAdaptationState | tuple[()],
        angle: ArrayLike,
        velocity: ArrayLike,
        pressures: Pair,
        states: tuple[Any, Any],
    ) -> Valves:
        """Model of the valves, with the estimated time constant, at a motion of the joint."""
        valve: Any = self.valve
        if isinstance(adapted, ValveAdaptationState):
            valve = dataclasses.replace(valve, time_constant=adapted.time_constant)
        air: Any = (None, None)
        if valve.holds_air:
            dead1, dead2 = (valve.for_muscle(i).attached_volume for i in (0, 1))
            air = air_volumes(self.model, angle, velocity, pressures, dead_volumes=(dead1, dead2))
        return Valves(valve, pressures, states, air, command_limits(self.model, valve))

    def _stiffness(self, model: AntagonisticJoint, angle: ArrayLike, pressures: Pair, isobaric: Scalar) -> Pair:
        """Controlled stiffness by a model, and its difference from the isobaric one [N*m/rad]."""
        if self.stiffness_amplitude is None:
            return isobaric, jnp.zeros_like(isobaric)
        stiffness = model.stiffness_for(angle, pressures, self.stiffness_amplitude)
        return stiffness, stiffness - isobaric

    def _adapt(
        self, state: AdaptationState | tuple[()], measurement: Measurement, period: ArrayLike
    ) -> tuple[AdaptationState | tuple[()], AntagonisticJoint]:
        """Adapted model, from the measured pressures: estimated ones are biased by a wrong valve model."""
        if self.adaptation is None or not isinstance(state, AdaptationState):
            return state, self.model
        state = self.adaptation.step(state, self.model, self.load, *measurement, period)
        return state, with_strengths(self.model, state.strengths)

    def _adapt_valves(self, last: Estimates, measured: Pair, period: ArrayLike) -> ValveAdaptationState | tuple[()]:
        """Estimate of the valves' time constant after measured pressures [Pa]."""
        if self.valve_adaptation is None or not isinstance(last.valves, ValveAdaptationState):
            return last.valves
        return self.valve_adaptation.step(last.valves, self.valve.lag, last.commands, measured, period)

    def _friction(self, muscles: MuscleStates, angle: ArrayLike, pressures: Pair) -> tuple[MuscleStates, Scalar]:
        """Internal states of the model's muscles at a reference angle [rad], and their torque of friction [N*m]."""
        if not self.friction_compensation:
            return muscles, jnp.zeros_like(pressures[0])
        muscles = self.model.update_state(muscles, angle, pressures)
        return muscles, self.model.friction_torque(angle, 0.0, pressures, muscles)
