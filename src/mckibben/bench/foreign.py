"""Simulated muscles and a joint whose equations no law of this package contains, for the benchmark.

Every quantity is in SI units; pressures are gauge pressures. Nothing here uses the laws, friction, creep or valves of
the package. The numbers are plausible for muscles of 10 mm, but not those of a product.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from mckibben.numerics.calculus import rk4

Floats = NDArray[np.float64]

_ATMOSPHERE = 101325.0
_GAS, _TEMPERATURE, _ISENTROPIC, _POLYTROPIC = 287.0, 293.15, 1.4, 1.25
_STEPS = 100  # of the integration of a joint, in each period
_CRITICAL = (2 / (_ISENTROPIC + 1)) ** (_ISENTROPIC / (_ISENTROPIC - 1))


@dataclass(frozen=True)
class ForeignMuscle:
    r"""A braided bladder with a thick wall of Mooney-Rivlin rubber, braid friction, and fractional viscoelasticity.

    Static force: virtual work of a braid whose threads stretch with the pressure, on the part of the pressure that
    presses the bladder against the braid, and the energy of the wall (volume V_w, incompressible):

    .. math:: F_s = p_c\,\frac{3L^2 - b^2}{4\pi N^2} + V_w \frac{dW}{dL}, \quad W = C_{10}(I_1 - 3) + C_{01}(I_2 - 3)

    Hysteresis over length: asymmetric Bouc-Wen, with a width that depends on the pressure. Rate: a power law of the
    velocity. Slow part: a fractional Zener model, whose creep is a power of time instead of a sum of exponentials.

    References
    ----------
    G. K. Klute and B. Hannaford, J. Dyn. Sys. Meas. Control 122 (2000) 386-388 (wall of Mooney-Rivlin rubber);
    S. Davis, N. Tsagarakis, J. Canderle and D. G. Caldwell, Int. J. Robotics Res. 22 (2003) 213-227 (stretching
    threads); C. H. Wang and Y. K. Wen, J. Struct. Eng. 126 (2000) 1151-1160 (asymmetric Bouc-Wen);
    R. L. Bagley and P. J. Torvik, J. Rheology 27 (1983) 201-210 (fractional derivatives).
    """

    length: float = 0.18
    diameter: float = 0.010
    braid_angle: float = 0.436
    wall: float = 7.2e-6  # volume [m^3]
    first: float = 1.3e5  # C10 [Pa]
    second: float = 2e4  # C01 [Pa]
    thread: float = 4e-8  # relative stretch per pressure [1/Pa]
    ends: float = 1.12  # contraction of the cylindrical part relative to the whole (conical ends)
    contact: float = 4.5e4  # pressure at which the bladder reaches the braid at contraction 0 [Pa]
    contact_slope: float = 1.6e5  # its growth with contraction [Pa]
    contact_width: float = 1.2e4  # pressure over which contact spreads [Pa]
    friction: float = 3.0  # half width of the hysteresis at pressure 0 [N]
    friction_slope: float = 2.6e-5  # its growth with pressure [N/Pa]
    presliding: float = 0.006  # contraction
    asymmetry: float = 0.22
    viscosity: float = 4.0  # force at a rate of 1/s and `rated` pressure [N]
    exponent: float = 0.35  # of the velocity
    creep: float = 0.07  # part of a change of force that is delayed
    creep_time: float = 1.5  # s
    creep_order: float = 0.4
    rated: float = 6e5  # Pa

    def static_force(self, contraction: ArrayLike, pressure: ArrayLike, xp: Any = np) -> Floats:
        """Static force [N], at least 0, without hysteresis, computed by NumPy or `jax.numpy`."""
        shortening, gauge = xp.asarray(contraction, float) * self.ends, xp.asarray(pressure, float)
        thread = self.length / np.cos(self.braid_angle)
        turns = thread * np.sin(self.braid_angle) / (np.pi * self.diameter)
        length = self.length * (1 - shortening)
        gap = thread**2 - length**2
        stretched = thread * (1 + self.thread * gauge)
        braid = (3 * length**2 - stretched**2) / (4 * np.pi * turns**2)
        beyond = (gauge - self.contact - self.contact_slope * shortening) / self.contact_width
        pressing = self.contact_width * xp.logaddexp(0, beyond)
        axial, hoop = length / self.length, xp.sqrt(gap / (thread**2 - self.length**2))
        radial = 1 / (axial * hoop)
        axial_slope = 1 / self.length
        hoop_slope = -hoop * length / gap
        radial_slope = -radial * (axial_slope / axial + hoop_slope / hoop)
        parts = ((axial, axial_slope), (hoop, hoop_slope), (radial, radial_slope))
        energy_slope = sum(2 * (self.first * one - self.second / one**3) * slope for one, slope in parts)
        return xp.maximum(pressing * braid + self.wall * energy_slope, 0.0)

    def volume(self, contraction: ArrayLike, xp: Any = np) -> Floats:
        """Volume of the air [m^3]."""
        thread = self.length / np.cos(self.braid_angle)
        turns = thread * np.sin(self.braid_angle) / (np.pi * self.diameter)
        length = self.length * (1 - xp.asarray(contraction, float) * self.ends)
        return length * (thread**2 - length**2) / (4 * np.pi * turns**2) - self.wall

    def sliding_rate(self, state: ArrayLike, rate: ArrayLike, xp: Any = np) -> Floats:
        """Rate of the hysteresis state, 0 where friction is relaxed, from the rate of the contraction [1/s]."""
        slip, speed = xp.asarray(state, float), xp.asarray(rate, float)
        shape = 0.5 + 0.5 * xp.sign(speed * slip) + self.asymmetry * (xp.sign(speed) + xp.sign(slip))
        return speed / self.presliding * (1 - xp.abs(slip) ** 1.5 * shape)

    def friction_force(self, state: ArrayLike, pressure: ArrayLike, rate: ArrayLike, xp: Any = np) -> Floats:
        """Force lost to hysteresis and viscosity [N] at a state and a rate of the contraction [1/s]."""
        gauge, speed = xp.asarray(pressure, float), xp.asarray(rate, float)
        sliding = (self.friction + self.friction_slope * gauge) * xp.asarray(state, float)
        return sliding + self.viscosity * gauge / self.rated * xp.sign(speed) * xp.abs(speed) ** self.exponent

    def force(self, period: float, contraction: ArrayLike, pressure: ArrayLike) -> Floats:
        """Force [N] along samples of contraction and pressure, between which both are linear; at rest before."""
        contraction, pressure = np.asarray(contraction, float), np.asarray(pressure, float)
        state = _sliding(self, period, contraction.tobytes())
        static = self.static_force(contraction, pressure)
        relaxed = static[0] + _fractional(static - static[0], period, self.creep, self.creep_time, self.creep_order)
        lost = self.friction_force(state, pressure, np.gradient(contraction, period))
        return np.maximum(relaxed - lost, 0.0)


@functools.lru_cache(maxsize=16)
def _sliding(muscle: ForeignMuscle, period: float, samples: bytes) -> Floats:
    """Hysteresis state along samples of the contraction; recordings at other pressures have the same."""
    contraction = np.frombuffer(samples)
    times, rates = period * np.arange(contraction.size), np.diff(contraction) / period
    if np.ptp(contraction) == 0:
        return np.zeros(contraction.size)

    def slope(time: float, z: Floats) -> Floats:
        return muscle.sliding_rate(z, rates[min(int(time / period), rates.size - 1)])

    return solve_ivp(
        slope, (0.0, times[-1]), [0.0], t_eval=times, max_step=period, rtol=1e-6, atol=1e-8, method="RK23"
    ).y[0]


def _fractional(values: Floats, period: float, part: float, time: float, order: float) -> Floats:
    """Response of a fractional Zener model (1 + (T D)^a) y = (1 + (1 - c) (T D)^a) x, by Gruenwald's series."""
    weights = np.cumprod(np.concatenate([[1.0], 1 - (order + 1) / np.arange(1, values.size)]))
    memory = (time / period) ** order * weights
    memory[0] += 1
    now = (1 - part) * (memory - np.eye(1, values.size)[0]) + np.eye(1, values.size)[0]
    return np.asarray(lfilter(now, memory, values))


@dataclass(frozen=True)
class ForeignJoint:
    r"""Two foreign muscles on a pulley, with a pendulum, dry friction, and proportional valves.

    Muscle 1 lengthens with the angle. A valve opens with the error of the pressure, and passes the isentropic flow of
    an ideal nozzle (de Saint-Venant and Wantzel), not that of ISO 6358:

    .. math:: \dot m = A\,p_u \sqrt{\frac{2}{R T}\,\frac{\kappa}{\kappa - 1}\left(r^{2/\kappa} -
        r^{(\kappa+1)/\kappa}\right)}, \quad r = \max(p_d/p_u, r^*)
    """

    muscle1: ForeignMuscle = ForeignMuscle()
    muscle2: ForeignMuscle = ForeignMuscle(friction=4.0, wall=7.8e-6, diameter=0.0102)
    radius: float = 0.02
    contraction: float = 0.10  # of both muscles at angle 0
    inertia: float = 0.02
    gravity_torque: float = 0.8
    damping: float = 0.05
    dry_friction: float = 0.12
    dry_rate: float = 0.05  # rad/s
    supply: float = 7e5
    opening: float = 2.5e-7  # largest cross section [m^2]
    band: float = 4e4  # error of the pressure for a fully open valve [Pa]
    dead_volume: float = 6e-6

    def angles(self, period: float, command1: ArrayLike, command2: ArrayLike) -> Floats:
        """Angles [rad], shape (samples,), from commands [Pa] held over each period; at rest at angle 0 before."""
        commands = jnp.stack([jnp.asarray(command1, float), jnp.asarray(command2, float)], axis=1)
        first = jnp.zeros(6).at[2:4].set(commands[0])
        later = _states(self, first, commands[:-1], period / _STEPS)
        return np.asarray(jnp.concatenate([first[None], later])[:, 0])

    def rates(self, state: Array, wanted: Array) -> Array:
        """Rates of angle, velocity, both pressures and both hysteresis states under two commands."""
        angle, rate, pressures, sliding = state[0], state[1], state[2:4], state[4:6]
        torque, changes, slides = -self.gravity_torque * jnp.sin(angle), [], []
        for i, muscle in enumerate((self.muscle1, self.muscle2)):
            arm = (-self.radius, self.radius)[i]  # muscle 2 shortens with the angle
            contraction = self.contraction + arm * angle / muscle.length
            speed = arm * rate / muscle.length
            lost = muscle.friction_force(sliding[i], pressures[i], speed, jnp)
            torque += arm * jnp.maximum(muscle.static_force(contraction, pressures[i], jnp) - lost, 0.0)
            here = muscle.volume(contraction, jnp) + self.dead_volume
            ahead = muscle.volume(contraction + 1e-6, jnp) + self.dead_volume
            absolute = pressures[i] + _ATMOSPHERE
            flow = self._flow(absolute, jnp.tanh((wanted[i] - pressures[i]) / self.band))
            volume_rate = (ahead - here) / 1e-6 * speed
            changes.append(_POLYTROPIC / here * (flow * _GAS * _TEMPERATURE - absolute * volume_rate))
            slides.append(muscle.sliding_rate(sliding[i], speed, jnp))
        torque -= self.damping * rate + self.dry_friction * jnp.tanh(rate / self.dry_rate)
        return jnp.stack([rate, torque / self.inertia, *changes, *slides])

    def _flow(self, pressure: Array, opening: Array) -> Array:
        """Mass flow into a muscle [kg/s] at its absolute pressure [Pa]; negative while venting."""
        up = jnp.where(opening > 0, self.supply + _ATMOSPHERE, pressure)
        down = jnp.where(opening > 0, pressure, _ATMOSPHERE)
        ratio = jnp.clip(down / up, _CRITICAL, 1.0)
        power = ratio ** (2 / _ISENTROPIC) - ratio ** ((_ISENTROPIC + 1) / _ISENTROPIC)
        nozzle = jnp.sqrt(2 / (_GAS * _TEMPERATURE) * _ISENTROPIC / (_ISENTROPIC - 1) * jnp.maximum(power, 0.0))
        return self.opening * opening * up * nozzle


@functools.partial(jax.jit, static_argnums=0)
def _states(joint: ForeignJoint, first: Array, commands: Array, step: float) -> Array:
    """States after each period, shape (periods, 6)."""

    def period(state: Array, wanted: Array) -> tuple[Array, Array]:
        after = lax.fori_loop(0, _STEPS, lambda _, x: rk4(lambda y: joint.rates(y, wanted), x, step), state)
        return after, after

    return lax.scan(period, first, commands)[1]
