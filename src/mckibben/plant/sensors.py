"""Sensors: what a controller is told of the plant's state."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.checks import check_positive, check_within
from mckibben.numerics.elementary import floating
from mckibben.units import AngleStep, Delay, PressureNoise, Seed

Scalar = Float[Array, ""]


class Reading(NamedTuple):
    """An angle [rad] and two gauge pressures [Pa] as sensors tell them."""

    angle: Scalar
    pressure1: Scalar
    pressure2: Scalar


class Sensors(eqx.Module):
    """From the true angle and pressures at the start of a control period to what the controller is given."""

    @abc.abstractmethod
    def read(self, last: Any, periods: ArrayLike, true: Reading) -> tuple[Any, Reading]:
        """What is remembered for the next control period, and what the controller is given in this one.

        Parameters
        ----------
        last
            What was remembered; `first` before the first period.
        periods
            Control periods since the start.
        true
            The truth now.
        """

    @abc.abstractmethod
    def first(self, true: Reading) -> Any:
        """What is remembered before the first control period."""


class PerfectSensors(Sensors):
    """The controller is told the truth, at once: what the paper's simulation assumes."""

    def first(self, true: Reading) -> tuple[()]:
        return ()

    def read(self, last: Any, periods: ArrayLike, true: Reading) -> tuple[Any, Reading]:
        return last, true


class SampledSensors(Sensors):
    """An encoder that counts in steps, pressures with white noise, and all of it late if need be.

    Parameters
    ----------
    encoder
        One step of the encoder [rad]; the angle is rounded to the nearest. 0 for none.
    pressure_noise
        Standard deviation [Pa] of each sample of each pressure, normal and independent.
    delay
        Control periods by which a reading is late, 0 to 1; between these it is as far between two readings.
    seed
        Of the noise: the same seed gives the same, period by period.

    Examples
    --------
    >>> sensors = SampledSensors(encoder=0.01)
    >>> true = Reading(jnp.asarray(0.1234), jnp.asarray(2e5), jnp.asarray(3e5))
    >>> _, told = sensors.read(sensors.first(true), 0, true)
    >>> round(float(told.angle), 4), float(told.pressure1)
    (0.12, 200000.0)
    """

    encoder: AngleStep = 0.0
    pressure_noise: PressureNoise = 0.0
    delay: Delay = 0.0
    seed: Seed = 0

    def __check_init__(self) -> None:
        check_positive("SampledSensors", "rad", zero=True, encoder=self.encoder)
        check_positive("SampledSensors", "Pa", zero=True, pressure_noise=self.pressure_noise)
        check_within("SampledSensors", 0.0, 1.0, "periods", delay=self.delay)

    def first(self, true: Reading) -> Reading:
        return self._told(0, true)

    def read(self, last: Reading, periods: ArrayLike, true: Reading) -> tuple[Reading, Reading]:
        now = self._told(periods, true)
        late = jnp.asarray(self.delay)
        return now, Reading(*(new + late * (old - new) for new, old in zip(now, last, strict=True)))

    def _told(self, periods: ArrayLike, true: Reading) -> Reading:
        """What would be told now without a delay."""
        angle = floating(true.angle)
        step = jnp.asarray(self.encoder)
        counted = jnp.where(step > 0, jnp.round(angle / jnp.where(step > 0, step, 1.0)) * step, angle)
        key = jax.random.fold_in(jax.random.key(self.seed), jnp.asarray(periods).astype(jnp.uint32))
        normal = jax.random.normal(key, (2,), jnp.float32)  # in either precision the same
        noise = normal.astype(angle.dtype) * self.pressure_noise
        return Reading(counted, true.pressure1 + noise[0], true.pressure2 + noise[1])
