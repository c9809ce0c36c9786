"""Rigs of another law, friction, creep and valves than any of the package, simulated in NumPy side by side.

A rig has two muscles on a round joint that hangs. Forces are quadratic in contraction, with kinks, and affine in
pressure; friction has four slip elements, creep three arms, the valves a second-order lag and a delay.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

GRAVITY = 9.81
PERIOD, INNER = 1e-3, 1  # s, and integration steps
FREQUENCIES = np.array([1.0, 1.45, 1.95, 2.45, 2.95, 3.45, 4.0])  # Hz
DEG = np.pi / 180


@dataclasses.dataclass
class Rigs:
    """Numbers of all rigs, each of shape (rigs, 1) or (rigs, 1, ...)."""

    law: np.ndarray  # coefficients of contraction and pressure, shape (rigs, 1, muscles, 2, 3)
    kinks: np.ndarray  # relative heights at the places, shape (rigs, 1, muscles, places)
    arm: np.ndarray  # radius [m], shape (rigs, 1, muscles)
    rest: np.ndarray  # length at angle 0 [m], likewise
    slips: np.ndarray  # [m], shape (rigs, 1, muscles, 4)
    bands: np.ndarray  # [N], likewise
    growth: np.ndarray
    creep: np.ndarray  # [N/m], shape (rigs, 1, muscles, 3)
    inertia: np.ndarray
    moment: np.ndarray
    hanging: float
    viscous: np.ndarray
    zero: np.ndarray
    lever: np.ndarray  # factor
    length: float  # of a muscle [m]
    centre: float

    places = np.linspace(-1, 1, 9)
    times = np.array([0.5, 4.0, 15.0])
    half = 0.06

    @property
    def count(self) -> int:
        return len(self.arm)

    def tension(self, contraction: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """Tensions [N] of contractions and pressures of shape (rigs, ..., muscles)."""
        v = np.clip((contraction - self.centre) / self.half, -1, 1)
        shape = (self.count, *(1,) * (v.ndim - 2), 2)
        c = self.law.reshape(*shape, 2, 3)
        force = (c[..., 0, 0] + contraction * (c[..., 0, 1] + contraction * c[..., 0, 2])) + pressure * (
            c[..., 1, 0] + contraction * (c[..., 1, 1] + contraction * c[..., 1, 2])
        )
        place = (v + 1) / 2 * (self.places.size - 1)
        left = np.clip(place.astype(int), 0, self.places.size - 2)
        kinks = np.broadcast_to(self.kinks.reshape(*shape, -1), (*v.shape, self.places.size))
        low, high = (np.take_along_axis(kinks, (left + k)[..., None], -1)[..., 0] for k in (0, 1))
        return np.maximum(force * (1 + low + (place - left) * (high - low)), 0.0)

    def lengths(self, angle: np.ndarray) -> np.ndarray:
        """Path lengths [m], shape (..., muscles)."""
        shape = (self.count, *(1,) * (angle.ndim - 1), 2)
        return self.rest.reshape(shape) + self.arm.reshape(shape) * np.sin(angle[..., None]) * np.array([1.0, -1.0])

    def torque(self, angle: np.ndarray, pressure: np.ndarray, more: np.ndarray | float = 0.0) -> np.ndarray:
        """Torque of both muscles [N*m] with additional tensions, at angles of shape (rigs, ...)."""
        shape = (self.count, *(1,) * (angle.ndim - 1), 2)
        tension = np.maximum(self.tension(1 - self.lengths(angle) / self.length, pressure) + more, 0.0)
        arms = self.arm.reshape(shape) * np.cos(angle[..., None])
        return (tension * arms * np.array([-1.0, 1.0])).sum(axis=-1)

    def stiffness(self, angle: np.ndarray, pressure: np.ndarray, step: float = 0.5 * DEG) -> np.ndarray:
        """Isobaric stiffness [N*m/rad], over a kink or two."""
        return (self.torque(angle - step, pressure) - self.torque(angle + step, pressure)) / (2 * step)


def draw(
    rng, count, force, length, rest, radius, inertia, moment, hanging, *, scatter=0.1, mass=0.02, inertia_error=0.05
):
    """Rigs about a model: force(contraction, pressure) [N] of a law that is fitted by other terms."""
    e, p = np.meshgrid(np.linspace(0.04, 0.2, 17), np.linspace(1e5, 6e5, 11), indexing="ij")
    terms = np.stack([p**k * e**i for k in (0, 1) for i in range(3)], axis=-1).reshape(-1, 6)
    scale = np.abs(terms).max(axis=0)
    fit = (np.linalg.lstsq(terms / scale, force(e, p).ravel(), rcond=None)[0] / scale).reshape(2, 3)
    centre = 1 - rest / length
    law = np.tile(fit, (count, 1, 2, 1, 1))
    strength = 1 + scatter * rng.standard_normal((count, 1, 2, 1))
    slope = 1 + scatter / 2 * rng.standard_normal((count, 1, 2, 1))
    law[..., 1, :] *= strength * slope
    law[..., 0, :] *= strength
    law[..., 0, 0] += 0.01 * scatter / 0.1 * 600 * rng.standard_normal((count, 1, 2))
    tilt = 0.3 * scatter * rng.standard_normal((count, 1, 2, 1)) * Rigs.places
    kinks = tilt + 0.0035 * scatter / 0.1 * rng.standard_normal((count, 1, 2, Rigs.places.size))

    def around(width, *shape):
        return 1 + width * rng.standard_normal((count, 1, *shape))

    bands = 7.5 * np.exp(0.4 * rng.standard_normal((count, 1, 2, 1))) * rng.dirichlet([4, 4, 3, 2], (count, 1, 2))
    return Rigs(
        law=law,
        kinks=kinks,
        arm=radius * around(0.02, 2),
        rest=rest + 0.6e-3 * rng.standard_normal((count, 1, 2)),
        slips=np.array([0.2, 0.5, 1.1, 2.0]) * 1e-3 * np.exp(0.2 * rng.standard_normal((count, 1, 2, 4))),
        bands=bands,
        growth=0.5 * around(0.4, 2),
        creep=12 / (2 * radius**2) * 0.02 * np.abs(around(0.5, 2, 3)),
        inertia=inertia * around(inertia_error),
        moment=moment * around(mass),
        hanging=hanging,
        viscous=0.05 * around(0.3),
        zero=0.8 * DEG * rng.standard_normal((count, 1)),
        lever=around(0.005),
        length=length,
        centre=centre,
    )


class Parts(NamedTuple):
    """Motion of all rigs in parts: weights [kg], and whether a part is fast, shape (parts,)."""

    mass: np.ndarray
    fast: np.ndarray
    distance: float = 0.2
    seconds: float = 15.0


def simulate(rigs: Rigs, parts: Parts, middle: float, mean: tuple[float, float], amplitude: np.ndarray):
    """Angles [rad], shape (samples, rigs, parts), and pressures in the muscles [Pa], (samples, rigs, parts, 2).

    Slow parts sweep the angle in a loop, fast ones have a multisine of the differential pressure with an amplitude.
    """
    steps = int(parts.seconds / PERIOD)
    time = np.arange(steps) * PERIOD
    shape = rigs.count, parts.mass.size
    phases = np.pi * np.arange(FREQUENCIES.size) ** 2 / FREQUENCIES.size
    wave = np.sin(2 * np.pi * FREQUENCIES * time[:, None] + phases).sum(axis=1)
    wave /= np.abs(wave).max()
    cocontraction = mean[0] + mean[1] * np.sin(2 * np.pi * 2 / parts.seconds * time)
    reference = middle + 10 * DEG * np.sin(2 * np.pi * 3 / parts.seconds * time)
    lever = parts.distance * rigs.lever
    inertia = rigs.inertia + parts.mass * (lever**2 + 0.02**2)
    moment = rigs.moment + parts.mass * GRAVITY * lever
    angle, rate = np.full(shape, middle), np.zeros(shape)
    length = rigs.lengths(angle)
    stretch, creep = np.zeros((*shape, 2, 4)), np.zeros((*shape, 2, 3))
    integral = np.zeros(shape)
    pressure, slope = np.full((*shape, 2), mean[0]), np.zeros((*shape, 2))
    queue = [pressure.copy() for _ in range(6)]
    angles, pressures = np.empty((steps, *shape)), np.empty((steps, *shape, 2))
    dt, decay, sign = PERIOD / INNER, np.exp(-PERIOD / INNER / rigs.times), np.array([-1.0, 1.0])
    settle = int(2.0 / PERIOD)
    for k in range(-settle, steps):
        at = max(k, 0)
        target = np.where(parts.fast, middle, reference[at])
        error = target - angle
        hold = parts.fast & (k > -settle // 4)  # the loop ends before fast motion begins
        integral += np.where(hold, 0.1e6, 0.3e6) * error * PERIOD
        differential = (
            integral
            + np.where(hold, 0.0, 3.5e5 * (target - middle) - 0.04e5 * rate)
            + amplitude * parts.fast * wave[at] * (k >= 0)
        )
        command = np.clip(cocontraction[at] + sign * differential[..., None], 0.2e5, 6.3e5)
        queue.append(command)
        late = queue.pop(0)
        for _ in range(INNER):
            slope += dt * (70.0**2 * (late - pressure) - 2 * 0.8 * 70.0 * slope)
            pressure = pressure + dt * slope
            after = rigs.lengths(angle)
            moved = (after - length)[..., None]
            length = after
            level = 1 + rigs.growth * (pressure / 3.5e5 - 1)
            stretch = np.clip(stretch + moved, -rigs.slips, rigs.slips)
            creep = decay * (creep + moved)
            more = (rigs.bands * stretch / rigs.slips).sum(axis=-1) * level + (rigs.creep * creep).sum(axis=-1)
            torque = rigs.torque(angle, pressure, more) - 500 * (angle - np.clip(angle, -0.35, 0.35))
            gravity = moment * np.sin(rigs.hanging - angle)
            rate = rate + dt / inertia * (torque + gravity - rigs.viscous * rate)
            angle = angle + dt * rate
        if k >= 0:
            angles[k], pressures[k] = angle, pressure
    return time, angles, pressures


def adapted(rigs: Rigs, parts: Parts, middle: float, mean: tuple[float, float]) -> np.ndarray:
    """Amplitudes [Pa] at which fast parts move by about 10 deg."""
    amplitude = np.full((rigs.count, parts.mass.size), 0.4e5)
    for _ in range(2):
        angles = simulate(rigs, parts, middle, mean, amplitude)[1]
        amplitude = amplitude * np.clip(10 * DEG / (np.abs(angles[1000:] - middle).max(axis=0)), 0.5, 1.6)
    return amplitude


def measured(rng, angles, pressures, zero, *, noise=4e3, step=0.022 * DEG):
    """Readings of an encoder and of pressure sensors."""
    read = np.round((angles + zero) / step) * step
    return read, pressures + noise * rng.standard_normal(pressures.shape)
