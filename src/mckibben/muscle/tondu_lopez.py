"""Laws of Tondu and Lopez: Chou's cylinder with conical ends."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import (
    BRAID_PARAMETERS,
    ForceLaw,
    Parameter,
    PressureAffineLaw,
    braid_gain,
    check_point,
    pressure_for,
)
from mckibben.muscle.specimen import Domain
from mckibben.numerics.elementary import exp
from mckibben.units import BraidAngle, Diameter, Factor, bar


class TonduLopezLaw(PressureAffineLaw):
    r"""Ideal braid with a constant end-effect factor k: the cylinder contracts k times as much as the muscle.

    .. math:: F = \pi r_0^2 \, p \left(a (1 - k\varepsilon)^2 - b\right), \quad
        a = \frac{3}{\tan^2\alpha_0}, \quad b = \frac{1}{\sin^2\alpha_0}

    With k = 1 it is Chou's law.

    Parameters
    ----------
    braid_angle, initial_diameter
        Angle alpha0 [rad] between thread and axis, and diameter 2 r0 [m], of the deflated muscle.
    end_factor
        k [-], 1 or more.

    References
    ----------
    B. Tondu and P. Lopez, "Modeling and control of McKibben artificial muscle robot actuators", IEEE Control Systems
    Magazine 20 (2000) 15-38.

    Examples
    --------
    >>> from mckibben.units import bar, deg, mm, percent
    >>> law = TonduLopezLaw(braid_angle=25 * deg, initial_diameter=10 * mm, end_factor=1.25)
    >>> round(float(law.force(0.0, 6 * bar)), 1), round(float(law.force(20 * percent, 6 * bar)), 1)
    (386.3, 101.9)
    """

    braid_angle: BraidAngle
    initial_diameter: Diameter
    end_factor: Factor
    domain: Domain = Domain()

    equation = "F = p (pi d0^2/4) (3/tan^2(alpha0) (1 - k eps)^2 - 1/sin^2(alpha0))"
    source = "Tondu and Lopez 2000"
    shape_parameters = (*BRAID_PARAMETERS, Parameter("end_factor", "1", "1", "k, effect of conical ends", 0.5, 3.0))

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        gain = braid_gain(self.braid_angle, self.initial_diameter, 1 - self.end_factor * jnp.asarray(contraction))
        return jnp.zeros_like(gain), gain


class TonduLopezVariableLaw(ForceLaw):
    r"""Ideal braid with an end-effect factor that decreases with pressure.

    .. math:: F = \pi r_0^2 \, p \left(a (1 - k(p)\,\varepsilon)^2 - b\right), \quad k(p) = a_k e^{-p/p_1} + b_k,
        \quad p_1 = 1\,\mathrm{bar}

    Parameters as for `TonduLopezLaw`, with a_k and b_k [-] as `end_rise` and `end_factor`; the source has the pressure
    in bar in the exponent.

    Examples
    --------
    >>> from mckibben.units import bar, deg, mm, percent
    >>> law = TonduLopezVariableLaw(25 * deg, 10 * mm, end_rise=0.5, end_factor=1.25)
    >>> [round(float(law.force(20 * percent, p * bar)), 1) for p in (1, 6)]
    [11.1, 101.6]
    """

    braid_angle: BraidAngle
    initial_diameter: Diameter
    end_rise: float
    end_factor: Factor
    domain: Domain = Domain()

    equation = "F = p (pi d0^2/4) (3/tan^2(alpha0) (1 - k(p) eps)^2 - 1/sin^2(alpha0)), k(p) = a_k exp(-p/1 bar) + b_k"
    source = "Tondu and Lopez 2000, k(p)"
    shape_parameters = (
        *BRAID_PARAMETERS,
        Parameter("end_rise", "1", "1", "a_k, increase of the end effect at zero pressure", -2.0, 5.0),
        Parameter("end_factor", "1", "1", "b_k, end effect at high pressure", 0.5, 3.0),
    )
    reference_pressure: ClassVar[float] = 1 * bar
    """p_1 [Pa]; the source has the pressure in bar."""

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        contraction, pressure = check_point(contraction, pressure)
        pressure = jnp.asarray(pressure)
        factor = self.end_rise * exp(-pressure / self.reference_pressure) + self.end_factor
        return pressure * braid_gain(self.braid_angle, self.initial_diameter, 1 - factor * jnp.asarray(contraction))

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        return pressure_for(self, force, contraction)
