"""Sensors and external disturbances of a plant: ideal, or sampled, noisy and disturbed."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.component.base import Component
from mckibben.joint import Measurement
from mckibben.numerics.elementary import Number, floating
from mckibben.units import Angle, AngleStep, Delay, PressureNoise, Seed


class Sensors(Component):
    """Sensor model: maps the true state to a measurement once per control period.

    For a robot, the angle of a measurement is a tuple over the joints, and there is a pressure for each muscle.
    """

    default_class = "sampled"

    @property
    def angle_resolution(self) -> Number:
        """Smallest step [rad] of a measured angle; 0 for none."""
        return 0.0

    @abc.abstractmethod
    def init(self, true: Measurement) -> Any:
        """Return the sensor state at the start of a run, at rest at a true measurement."""

    @abc.abstractmethod
    def measure(self, state: Any, index: ArrayLike, true: Measurement) -> tuple[Any, Measurement]:
        """Return the next state and the measurement of the true state at the start of a control period."""


class PerfectSensors(Sensors):
    """Exact measurement without delay, as in the paper's simulation; it has no state."""

    short_name = "perfect"

    def init(self, true: Measurement) -> tuple[()]:
        return ()

    def measure(self, state: Any, index: ArrayLike, true: Measurement) -> tuple[Any, Measurement]:
        return state, true


class SampledSensors(Sensors):
    """Quantised encoder, white pressure noise and a delay.

    Parameters
    ----------
    encoder, encoder_offset
        Step [rad], 0 for none, to the nearest multiple of which the angle plus its offset [rad] is rounded.
    pressure_noise, seed
        Standard deviation [Pa] of the noise of each pressure, normal and white over the control periods, and the seed
        of its draws. A period has the same draws in 32 and 64 bits.
    delay
        Delay, 0 to 1 control periods; samples are interpolated linearly.

    Examples
    --------
    >>> sensors = SampledSensors(encoder=0.01)
    >>> true = Measurement(jnp.asarray(0.123), (jnp.asarray(2e5), jnp.asarray(3e5)))
    >>> round(float(sensors.measure(sensors.init(true), 1, true)[1].angle), 6)
    0.12
    """

    short_name = "sampled"

    encoder: AngleStep = 0.0
    pressure_noise: PressureNoise = 0.0
    delay: Delay = 0.0
    seed: Seed = 0
    encoder_offset: Angle = eqx.field(kw_only=True, default=0.0)

    @property
    def angle_resolution(self) -> Number:
        return self.encoder

    def init(self, true: Measurement) -> Measurement:
        return self._sample(0, true)

    def measure(self, state: Measurement, index: ArrayLike, true: Measurement) -> tuple[Measurement, Measurement]:
        sample, delay = self._sample(index, true), jnp.asarray(self.delay)
        return sample, jax.tree.map(lambda new, old: new + delay * (old - new), sample, state)

    def _sample(self, index: ArrayLike, true: Measurement) -> Measurement:
        """Quantised, noisy sample without delay."""
        key = jax.random.fold_in(jax.random.key(self.seed), jnp.asarray(index).astype(jnp.uint32))
        noise = jax.random.normal(key, (len(true.pressures),), jnp.float32)  # the same in either precision
        pressures = zip(map(floating, true.pressures), noise, strict=True)
        measured: Any = tuple(
            pressure + error.astype(pressure.dtype) * self.pressure_noise for pressure, error in pressures
        )
        return Measurement(jax.tree.map(self._quantised, true.angle), measured)

    def _quantised(self, angle: ArrayLike) -> Array:
        angle, step = floating(angle) + self.encoder_offset, jnp.asarray(self.encoder)
        return jnp.where(step > 0, jnp.round(angle / jnp.where(step > 0, step, 1.0)) * step, angle)
