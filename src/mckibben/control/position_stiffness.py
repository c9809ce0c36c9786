"""Joint position and joint stiffness at once: two loops over differential pressure and co-contraction (Fig. 5)."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.allocation import differential_first, pressures_between
from mckibben.control.base import Controller, Loop, Measurement, Setpoint
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.batching import apart
from mckibben.numerics.calculus import derivative
from mckibben.numerics.checks import check_positive

Scalar = Float[Array, ""]


class PositionStiffnessState(NamedTuple):
    """The state of both loops, the last estimate of the stiffness [N*m/rad], whether a command was at a limit."""

    position: Any
    stiffness: Any
    estimate: Scalar
    saturated: Array


class Forward(NamedTuple):
    """What something else gives beside the two loops.

    Attributes
    ----------
    differential, cocontraction
        Its part of the pressures [Pa].
    path
        How far the wish has moved without a jump [rad]: the position loop sees wish and measurement from there, so that
        its derivative is that of the error and does not hold against the motion.
    """

    differential: Scalar
    cocontraction: Scalar
    path: Scalar


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
    minimum_tension
        Below which no muscle shall go, nor above the specimen's rated force [N]. By the model, at the measured angle;
        where the wishes of both loops cannot be had within these limits, the co-contraction gives way, and then the
        differential pressure. None, as in the paper: the limits are those of the pressures alone, each command is cut
        off by itself, and a muscle may go slack.

    References
    ----------
    Fig. 5 of the paper.
    """

    position: Loop
    stiffness: Loop
    model: AntagonisticJoint = eqx.field(kw_only=True)
    minimum_tension: float | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        if self.minimum_tension is not None:
            check_positive("PositionStiffnessControl", "N", minimum_tension=self.minimum_tension)

    def init(self, measurement: Measurement) -> PositionStiffnessState:
        return self.init_beside(None, measurement)

    def step(
        self, state: PositionStiffnessState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[PositionStiffnessState, Pair]:
        return self.step_beside(None, state, setpoint, measurement, period)

    def init_beside(self, forward: Forward | None, measurement: Measurement) -> PositionStiffnessState:
        """`init`, where something else gives a part of the pressures."""
        angle, (pressure1, pressure2) = measurement
        estimate = self.model.stiffness(angle, measurement.pressures)
        differential, cocontraction = (pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2
        if forward is not None:
            differential, cocontraction = differential - forward.differential, cocontraction - forward.cocontraction
            angle = angle - forward.path
        return PositionStiffnessState(
            position=self.position.init(angle, angle, differential),
            stiffness=self.stiffness.init(estimate, estimate, cocontraction),
            estimate=estimate,
            saturated=jnp.asarray(False),
        )

    def step_beside(
        self,
        forward: Forward | None,
        state: PositionStiffnessState,
        setpoint: Setpoint,
        measurement: Measurement,
        period: ArrayLike,
    ) -> tuple[PositionStiffnessState, Pair]:
        """`step`, where something else gives a part of the pressures; the loops are told what is left of theirs."""
        angle, pressures = measurement
        estimate = apart(self.model.stiffness, angle, pressures, witness=period)
        by_differential, by_cocontraction = self._sensitivities(measurement, estimate)
        wished, seen = (
            (setpoint.angle, angle) if forward is None else (setpoint.angle - forward.path, angle - forward.path)
        )
        position, differential = self.position.step(state.position, wished, seen, by_differential, period)
        stiffness, cocontraction = self.stiffness.step(
            state.stiffness, setpoint.stiffness, estimate, by_cocontraction, period
        )

        given = (0.0, 0.0) if forward is None else (forward.differential, forward.cocontraction)
        asked = (
            (differential, cocontraction) if forward is None else (differential + given[0], cocontraction + given[1])
        )
        (command1, command2), saturated = within_limits(self.model, self.minimum_tension, angle, asked, period)
        position = self.position.realised(position, differential, (command2 - command1) / 2 - given[0], period)
        stiffness = self.stiffness.realised(stiffness, cocontraction, (command1 + command2) / 2 - given[1], period)
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


def within_limits(
    model: AntagonisticJoint, minimum_tension: ArrayLike | None, angle: ArrayLike, asked: Pair, period: ArrayLike
) -> tuple[Pair, Array]:
    """The commands [Pa] to a differential pressure and a co-contraction [Pa], and whether they had to be cut off.

    Parameters
    ----------
    model
        Whose limits they are.
    minimum_tension
        [N]; None where the limits are those of the pressures alone, each command cut off by itself.
    angle
        Where the joint is [rad].
    asked
        The differential pressure and the co-contraction [Pa].
    period
        The control period [s].
    """
    differential, cocontraction = asked
    if minimum_tension is not None:
        limits = apart(lambda at: pressures_between(model, at, minimum_tension), jnp.asarray(angle), witness=period)
        return differential_first(differential, cocontraction, *limits)
    lowest, highest = pressure_limits_of(model)
    wanted1, wanted2 = cocontraction - differential, cocontraction + differential
    command1 = jnp.clip(wanted1, lowest[0], highest[0])
    command2 = jnp.clip(wanted2, lowest[1], highest[1])
    return (command1, command2), (command1 != wanted1) | (command2 != wanted2)
