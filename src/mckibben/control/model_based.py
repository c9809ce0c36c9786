"""What controllers by a model of the joint share: what they believe, and how a measurement changes it."""

from __future__ import annotations

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.adaptation import Adapted, LawAdaptation, strengthened
from mckibben.control.allocation import map_at, pressures_between
from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.control.observer import Motion, Observer, PressureObserver
from mckibben.control.reference import Course, followed, standing
from mckibben.errors import RangeError
from mckibben.joint import AffineMap, AntagonisticJoint, Load, TorqueStiffnessMap
from mckibben.joint.antagonistic import NO_STATES, MuscleStates
from mckibben.joint.attainable import is_affine, pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.batching import apart
from mckibben.numerics.checks import check_kind, check_positive
from mckibben.numerics.elementary import exp
from mckibben.units import Force, ShortTime

Scalar = Float[Array, ""]


class Beliefs(NamedTuple):
    """What a controller believes at a sample, and what it did then.

    Attributes
    ----------
    motion, pressures
        What the observers have.
    course
        How the wish moves.
    memories
        What the model's muscles remember along the wish.
    adapted
        What is believed of their strength; empty without adaptation.
    torque
        Of the model's muscles [N*m], without friction.
    estimate
        Of the stiffness [N*m/rad].
    friction
        The torque of friction that is made up for [N*m].
    commands
        Held since the sample [Pa].
    saturated
        Whether a wish was cut off at a limit.
    """

    motion: Motion
    pressures: Pair
    course: Course
    muscles: MuscleStates
    adapted: Adapted | tuple[()]
    torque: Scalar
    estimate: Scalar
    friction: Scalar
    commands: Pair
    saturated: Array


class ModelBasedControl(Controller):
    """A controller that works out its commands from a model of joint, load and valves.

    What it is for is left to those made of it; here is what they believe. They are told how the joint moves and what
    pressures there are by observers, one of which knows the torque that the model gives at the *measured* pressures, so
    that neither lag nor limits wind it up.
    """

    model: AntagonisticJoint
    load: Load
    valve_time_constant: ShortTime = eqx.field(kw_only=True, default=0.02)
    minimum_tension: Force = eqx.field(kw_only=True, default=5.0)
    friction_compensation: bool = eqx.field(kw_only=True, static=True, default=False)
    adaptation: LawAdaptation | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        name = type(self).__name__
        observer, pressure_observer = self.observers
        check_kind(
            name,
            model=(self.model, AntagonisticJoint),
            load=(self.load, Load),
            observer=(observer, Observer),
            pressure_observer=(pressure_observer, PressureObserver),
        )
        if self.adaptation is not None:
            check_kind(name, adaptation=(self.adaptation, LawAdaptation))
        check_positive(name, "s", zero=True, valve_time_constant=self.valve_time_constant)
        check_positive(name, "N", zero=True, minimum_tension=self.minimum_tension)
        if self.friction_compensation and not self.model.has_friction:
            raise RangeError(
                f"{name}: no muscle of its model has friction to make up for",
                remedy="give the model's muscles a MaxwellSlip, or leave friction_compensation out",
            )

    @property
    @abc.abstractmethod
    def observers(self) -> tuple[Observer, PressureObserver]:
        """Of the motion, and of the pressures."""

    def believed_first(self, measurement: Measurement) -> Beliefs:
        """What is believed before the first step: all is at rest."""
        angle, pressures = measurement
        torque, estimate = self.model.torque_and_stiffness(angle, pressures)
        nothing = jnp.zeros_like(angle)
        return Beliefs(
            motion=self.observers[0].init(angle, self.acceleration(angle, nothing, torque)),
            pressures=pressures,
            course=standing(angle),
            muscles=self.model.init_state(angle, pressures) if self.friction_compensation else NO_STATES,
            adapted=() if self.adaptation is None else self.adaptation.init(self.model, self.load, angle, pressures),
            torque=torque,
            estimate=estimate,
            friction=nothing,
            commands=pressures,
            saturated=jnp.asarray(False),
        )

    def believed(
        self, before: Beliefs, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[Beliefs, AntagonisticJoint]:
        """What is believed with one more sample, but for the commands to come; and the model as it is believed now."""
        angle = measurement.angle
        observer, pressure_observer = self.observers
        share = self.share(period)
        pressures = pressure_observer.step(before.pressures, before.commands, measurement.pressures, share, period)
        adapted, model = self._adapted(before.adapted, measurement, period)
        torque, estimate = apart(model.torque_and_stiffness, angle, pressures, witness=period)
        muscles, rubbing = self._friction(before.muscles, setpoint.angle, pressures)
        known = self.acceleration(angle, before.motion.velocity, torque + rubbing)
        motion = observer.step(before.motion, angle, known, period)
        course = followed(before.course, setpoint.angle, period)
        after = before._replace(
            motion=motion,
            pressures=pressures,
            course=course,
            muscles=muscles,
            adapted=adapted,
            torque=torque,
            estimate=estimate,
            friction=rubbing,
        )
        return after, model

    def told(self, beliefs: Beliefs) -> dict[str, Scalar]:
        """What is worth recording of it, by name."""
        told = {
            "stiffness_estimate": beliefs.estimate,
            "saturated": beliefs.saturated,
            "velocity_estimate": beliefs.motion.velocity,
            "disturbance_estimate": self.load.total_inertia * beliefs.motion.disturbance,
            "friction_compensation": beliefs.friction,
        }
        if not isinstance(beliefs.adapted, Adapted):
            return told
        strength1, strength2 = beliefs.adapted.strengths
        return {**told, "strength1_estimate": strength1, "strength2_estimate": strength2}

    def acceleration(self, angle: ArrayLike, velocity: ArrayLike, torque: ArrayLike) -> Scalar:
        """What the model expects [rad/s^2] at an angle [rad], a velocity [rad/s] and a torque [N*m]."""
        moving = torque + self.load.gravity_torque(angle) - self.load.damping * velocity
        return jnp.asarray(moving / self.load.total_inertia)

    def share(self, duration: ArrayLike) -> Scalar:
        """The part of a step that a valve is believed to do in a time [s]."""
        lag = jnp.asarray(self.valve_time_constant)
        return jnp.where(lag > 0, 1 - exp(-jnp.asarray(duration) / jnp.where(lag > 0, lag, 1.0)), 1.0)

    def held(self, commands: Pair) -> Pair:
        """The commands [Pa], which rounding may have taken past a limit."""
        (low1, low2), (high1, high2) = pressure_limits_of(self.model)
        return jnp.clip(commands[0], low1, high1), jnp.clip(commands[1], low2, high2)

    def _adapted(
        self, adapted: Adapted | tuple[()], measurement: Measurement, period: ArrayLike
    ) -> tuple[Adapted | tuple[()], AntagonisticJoint]:
        """What is believed of the muscles now, and the model with it.

        From the pressures as measured: what an observer makes of them is off where its valve is not the true one.
        """
        if self.adaptation is None or not isinstance(adapted, Adapted):
            return adapted, self.model
        adapted = self.adaptation.step(adapted, self.model, self.load, *measurement, period)
        return adapted, strengthened(self.model, adapted.strengths)

    def _friction(self, muscles: MuscleStates, wish: ArrayLike, pressures: Pair) -> tuple[MuscleStates, Scalar]:
        """What the model's muscles remember along the wish [rad], and the torque [N*m] of their friction there."""
        if not self.friction_compensation:
            return muscles, jnp.zeros_like(pressures[0])
        muscles = self.model.update_state(muscles, wish, pressures)
        return muscles, self.model.friction_torque(wish, 0.0, pressures, muscles)


_ASIDE = 0.02  # rad: where the model is asked a second time, to tell how it changes with the angle


class Surroundings(NamedTuple):
    """What a model says of the joint at an angle, and how it changes with the angle.

    Attributes
    ----------
    torque, softening
        Torque over the pressures, of taut muscles, and how it falls with the angle.
    stiffness, stiffness_slope
        The same of the stiffness, and how it grows.
    lowest, highest, lowest_slope, highest_slope
        Limits of the pressures.
    """

    torque: AffineMap
    softening: AffineMap
    stiffness: AffineMap
    stiffness_slope: AffineMap
    lowest: Pair
    highest: Pair
    lowest_slope: Pair
    highest_slope: Pair


def surroundings(
    model: AntagonisticJoint, angle: Scalar, pressures: Pair, *, minimum_tension: ArrayLike
) -> Surroundings:
    """What a model says of the joint about an angle [rad] and pressures [Pa], no muscle below a tension [N]."""

    def at(angle: Scalar) -> tuple[TorqueStiffnessMap, Pair, Pair]:
        lowest, highest = pressures_between(model, angle, minimum_tension)
        return map_at(model, angle, _taut(pressures, lowest)), lowest, highest

    both = lax.map(at, jnp.stack([angle, angle + _ASIDE]))  # a loop: half of the code to compile
    (torque, stiffness), lowest, highest = jax.tree.map(lambda values: values[0], both)
    (_, stiffness_slope), *limit_slopes = jax.tree.map(lambda values: (values[1] - values[0]) / _ASIDE, both)
    softening = stiffness
    if not is_affine(model):  # a secant across the stop of a spring says nothing of other pressures
        nothing = jnp.zeros_like(angle)
        softening = AffineMap(stiffness(_taut(pressures, lowest)), nothing, nothing)
        stiffness_slope = AffineMap(nothing, nothing, nothing)
    return Surroundings(torque, softening, stiffness, stiffness_slope, lowest, highest, *limit_slopes)


def _taut(pressures: Pair, lowest: Pair) -> Pair:
    """The nearest pressures that keep both muscles taut."""
    return jnp.maximum(pressures[0], lowest[0]), jnp.maximum(pressures[1], lowest[1])
