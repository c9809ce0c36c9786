"""Costs of the stages of a predictive controller."""

from __future__ import annotations

import abc
import math
from numbers import Real
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from mckibben.component.base import Component
from mckibben.component.checks import check_within
from mckibben.control.base import Setpoint
from mckibben.joint.geometry import Pair
from mckibben.units import Angle, AngleScale, deg

Scalar = Float[Array, ""]


class StageEnd(NamedTuple):
    """Predicted joint at the end of a stage, in SI."""

    angle: Scalar
    velocity: Scalar
    acceleration: Scalar
    stiffness: Scalar  # isobaric
    pressures: Pair
    setpoint: Setpoint


class StageCost(Component):
    """Cost in addition to that of the errors: the sum of squares of residuals, integrated over the horizon.

    A residual of 1 weighs as much as an angle error of `PredictiveControl.angle_scale`. Squares keep each Newton step
    (Gauss-Newton) a convex problem.
    """

    default_class = "angle_limits"

    @abc.abstractmethod
    def residuals(self, stage: StageEnd) -> tuple[Scalar, ...]:
        """Return the residuals at the end of a stage."""


class AngleLimits(StageCost):
    """Soft limits of the angle [rad]: the residual is the angle beyond them over a scale [rad]."""

    short_name = "angle_limits"

    lowest: Angle
    highest: Angle
    scale: AngleScale = 0.005 * deg

    def __check_init__(self) -> None:
        super().__check_init__()
        if isinstance(self.lowest, Real) and isinstance(self.highest, Real):
            check_within("AngleLimits", self.lowest, math.inf, "rad", highest=self.highest)

    def residuals(self, stage: StageEnd) -> tuple[Scalar, ...]:
        return (jnp.maximum(stage.angle - self.highest, jnp.minimum(stage.angle - self.lowest, 0.0)) / self.scale,)
