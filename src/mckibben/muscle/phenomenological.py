"""Phenomenological force laws: Repperger, Reynolds and Hunt."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import ForceLaw, Parameter, PositiveContraction, PressureAffineLaw, check_point
from mckibben.muscle.specimen import Domain
from mckibben.numerics.calculus import bracketed_root
from mckibben.units import Contraction, ForcePerPressure, Pressure, PressureScale, Quantity, SignedForce, kPa, percent

PressurePerForce = Annotated[float, Quantity("Pa/N", "kPa/N", 0, 1e3, open_lower=True)]


class ReppergerLaw(PressureAffineLaw):
    r"""Spring whose stiffness increases with pressure, unloaded at full contraction.

    .. math:: F = (k_0 + k_1 p)\,(\varepsilon_0 - \varepsilon)

    The source has a spring with two stiffnesses, inflated and deflated, and a transient force. This static form is
    ours: the stiffness is affine in pressure, and the force is zero at the same contraction for all pressures.

    Parameters
    ----------
    k0, k1
        Stiffness [N] of the deflated muscle and its increase with pressure [N/Pa], per unit of contraction.
    rest
        Contraction eps0 [-] without force.

    References
    ----------
    D. Repperger, K. Johnson and C. Phillips, "A VSC position tracking system involving a large scale pneumatic muscle
    actuator", IEEE Conf. Decision and Control (1998) 4302-4307.
    """

    short_name = "repperger"

    k0: SignedForce
    k1: ForcePerPressure
    rest: Contraction
    domain: Domain = Domain()

    equation = "F = (k0 + k1 p) (eps0 - eps)"
    source = "after Repperger et al. 1998, at rest (form ours)"
    linear_parameters = (
        Parameter("k0", "N", "N/percent", "spring, deflated"),
        Parameter("k1", "N/Pa", "N/(bar*percent)", "spring, per pressure"),
    )
    shape_parameters = (Parameter("rest", "1", "percent", "contraction without force", 1 * percent, 60 * percent),)

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        remaining = self.rest - jnp.asarray(contraction)
        return self.k0 * remaining, self.k1 * remaining


class ReynoldsLaw(PressureAffineLaw):
    r"""Contractile force and linear spring: the static part of the three-element model.

    .. math:: F = (f_0 + f_1 p) - (k_0 + k_1 p)\,\varepsilon

    The source writes :math:`M\ddot x + B(p)\dot x + K(p) x = F_{ce}(p) - M g` with the shortening x in mm: K is here
    per unit of contraction, K l0. The damper B(p) is left out; see `mckibben.muscle.Friction`.

    Parameters
    ----------
    f0, f1
        Contractile force [N] and its increase with pressure [N/Pa].
    k0, k1
        Stiffness [N] and its increase with pressure [N/Pa], per unit of contraction.

    References
    ----------
    D. Reynolds, D. Repperger, C. Phillips and G. Bandry, "Modeling the dynamic characteristics of pneumatic muscle",
    Annals of Biomedical Engineering 31 (2003) 310-317.

    Examples
    --------
    The published muscle, made from a bicycle tube (179.2 + 1.39 P, 5.71 + 0.0307 P; N, mm, kPa); its length of 250 mm
    is our assumption:

    >>> law = ReynoldsLaw(f0=179.2, f1=1.39 / kPa, k0=5.71 * 250, k1=0.0307 * 250 / kPa)
    >>> round(float(law.force(10 * percent, 400 * kPa)), 1)
    285.4
    """

    short_name = "reynolds"

    f0: SignedForce
    f1: ForcePerPressure
    k0: SignedForce
    k1: ForcePerPressure
    domain: Domain = Domain()

    equation = "F = (f0 + f1 p) - (k0 + k1 p) eps"
    source = "Reynolds et al. 2003, at rest"
    linear_parameters = (
        Parameter("f0", "N", "N", "contractile force"),
        Parameter("f1", "N/Pa", "N/bar", "contractile force, per pressure"),
        Parameter("k0", "N", "N/percent", "spring"),
        Parameter("k1", "N/Pa", "N/(bar*percent)", "spring, per pressure"),
    )

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        eps = jnp.asarray(contraction)
        return self.f0 - self.k0 * eps, self.f1 - self.k1 * eps


class HuntLaw(ForceLaw):
    r"""Pressure as a function of force and contraction; the force is its root.

    .. math::

        p = p_0 + c_1 F + c_2 \tan\left(c_3 \left(\frac{\varepsilon}{\varepsilon_{max} - c_4 F} - c_5\right)\right)

    with :math:`c_3` = 2.0265, :math:`c_4` = 3.31e-4 per N and :math:`c_5` = 0.461 as published.
    Valid for contractions from 0 up. `pressure_for` is the formula, `force` is found numerically; both are NaN where no
    solution exists. c4 is for a 10 mm muscle and limits the force to eps_max/c4: do not use the law for larger muscles.

    Parameters
    ----------
    p0, c2
        Pressures [Pa].
    c1
        Pressure per force [Pa/N].
    largest
        eps_max [-], largest contraction, at 620 kPa.

    References
    ----------
    A. Hunt, A. Graber-Tilton and R. Quinn, "Modeling length effects of braided pneumatic actuators", ASME IDETC 2017;
    there with a hysteresis of 15.6 kPa, positive when shortening; here, see `mckibben.muscle.MaxwellSlip`.

    Examples
    --------
    >>> law = HuntLaw(p0=254.3 * kPa, c1=1.23 * kPa, c2=192 * kPa, largest=16 * percent)
    >>> round(float(law.pressure_for(300.0, 0.0)) / kPa, 1), round(float(law.force(8 * percent, 600 * kPa)), 1)
    (363.6, 168.9)
    """

    short_name = "hunt"

    p0: Pressure
    c1: PressurePerForce
    c2: PressureScale
    largest: PositiveContraction
    domain: Domain = Domain()

    equation = "F = root of p = p0 + c1 F + c2 tan(2.0265 (eps/(eps_max - 3.31e-4 F) - 0.461))"
    source = "Hunt et al. 2017, without its hysteresis"
    shape_parameters = (
        Parameter("p0", "Pa", "kPa", "offset", 50 * kPa, 1000 * kPa),
        Parameter("c1", "Pa/N", "kPa/N", "pressure per force", 0.02 * kPa, 10 * kPa),
        Parameter("c2", "Pa", "kPa", "of the tangent", 20 * kPa, 1000 * kPa),
        Parameter("largest", "1", "percent", "largest contraction", 5 * percent, 50 * percent),
    )
    steepness: ClassVar[float] = 2.0265
    shift: ClassVar[float] = 0.461
    softening: ClassVar[float] = 3.31e-4
    """c3 [-], c5 [-] and c4 [1/N]."""
    formula_domain: ClassVar[Domain] = Domain(contraction_min=0.0)

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        contraction, pressure = check_point(contraction, pressure)
        contraction, pressure = jnp.asarray(contraction), jnp.asarray(pressure)
        # Upper bound: below the force at the pole of the tangent and the force at the lowest tangent.
        to_pole = jnp.where(contraction == 0, jnp.inf, (self.largest - contraction / self._pole) / self.softening)
        least = self.p0 - self.c2 * jnp.tan(self.steepness * self.shift)
        highest = jnp.minimum((pressure - least) / self.c1 + 1.0, to_pole - 1e-6 * self.largest / self.softening)
        # Lower bound: a force at which the tangent is at most 10 and the linear part at most the remainder.
        mild = self.shift + math.atan(10.0) / self.steepness
        lowest = jnp.minimum((pressure - self.p0 - 10.0 * self.c2) / self.c1, highest)
        lowest = jnp.minimum(lowest, (self.largest - contraction / mild) / self.softening) - 1.0
        return bracketed_root(lambda force: self._pressure(force, contraction) - pressure, lowest, highest)

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        force, contraction = jnp.asarray(force), jnp.asarray(contraction)
        largest = self.largest - self.softening * force
        exists = (contraction == 0) | ((largest > 0) & (contraction < self._pole * largest))
        return jnp.where(exists, self._pressure(force, contraction), jnp.nan)

    @property
    def _pole(self) -> float:
        """Contraction divided by the largest contraction, at the pole of the tangent."""
        return self.shift + math.pi / (2 * self.steepness)

    def _pressure(self, force: Array, contraction: Array) -> Array:
        ratio = contraction / (self.largest - self.softening * force)
        return self.p0 + self.c1 * force + self.c2 * jnp.tan(self.steepness * (ratio - self.shift))
