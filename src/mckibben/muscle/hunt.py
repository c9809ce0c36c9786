"""The law of Hunt and co-workers, which was made the other way round: the pressure as a function of the force."""

from __future__ import annotations

import math
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import ForceLaw, Parameter
from mckibben.muscle.specimen import Domain
from mckibben.numerics.calculus import increasing_root
from mckibben.numerics.checks import check_positive
from mckibben.units import kPa, percent


class HuntLaw(ForceLaw):
    r"""The pressure that a force at a contraction takes; the force is its root.

    .. math::

        p = p_0 + c_1 F + c_2 \tan\left(c_3 \left(\frac{\varepsilon}{\varepsilon_{max} - c_4 F} - c_5\right)\right)

    with :math:`c_3` = 2.0265, :math:`c_4` = 3.31e-4 per N and :math:`c_5` = 0.461 as published. It is made for
    contractions from 0 up: `pressure_for` is the formula, `force` is found by bisection; both are NaN where there is
    none. c4 is that of a 10 mm muscle, and no force is above eps_max/c4: the law is of no use for larger ones.

    Parameters
    ----------
    p0, c2
        Pressures [Pa].
    c1
        Pressure per force [Pa/N].
    largest
        eps_max [-]: the largest contraction of the muscle, at 620 kPa.
    domain
        Where to trust it.

    References
    ----------
    A. Hunt, A. Graber-Tilton and R. Quinn, "Modeling length effects of braided pneumatic actuators", ASME IDETC 2017;
    there with a hysteresis of 15.6 kPa, + when shortening, which is `mckibben.muscle.MaxwellSlip` here.

    Examples
    --------
    >>> law = HuntLaw(p0=254.3 * kPa, c1=1.23 * kPa, c2=192 * kPa, largest=16 * percent)
    >>> round(float(law.pressure_for(300.0, 0.0)) / kPa, 1)
    363.6
    >>> round(float(law.force(8 * percent, 600 * kPa)), 1)
    168.9
    """

    p0: float
    c1: float
    c2: float
    largest: float
    domain: Domain = Domain()

    def __check_init__(self) -> None:
        check_positive("HuntLaw", "Pa/N", c1=self.c1)
        check_positive("HuntLaw", "Pa", c2=self.c2)
        check_positive("HuntLaw", "1", largest=self.largest)

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
        contraction, pressure = jnp.asarray(contraction), jnp.asarray(pressure)
        # Below the force that takes the tangent to its pole, and below that of the tangent at its least.
        to_pole = jnp.where(contraction == 0, jnp.inf, (self.largest - contraction / self._pole) / self.softening)
        least = self.p0 - self.c2 * jnp.tan(self.steepness * self.shift)
        highest = jnp.minimum((pressure - least) / self.c1 + 1.0, to_pole - 1e-6 * self.largest / self.softening)
        # Above a force at which the tangent is no more than 10, and the rest no more than is left.
        mild = self.shift + math.atan(10.0) / self.steepness
        lowest = jnp.minimum((pressure - self.p0 - 10.0 * self.c2) / self.c1, highest)
        lowest = jnp.minimum(lowest, (self.largest - contraction / mild) / self.softening) - 1.0
        return increasing_root(lambda force: self._pressure(force, contraction) - pressure, lowest, highest)

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        force, contraction = jnp.asarray(force), jnp.asarray(contraction)
        left = self.largest - self.softening * force  # the largest contraction under this force
        reached = (contraction == 0) | ((left > 0) & (contraction < self._pole * left))
        return jnp.where(reached, self._pressure(force, contraction), jnp.nan)

    @property
    def _pole(self) -> float:
        """The part of the largest contraction at which the tangent has its pole: no pressure shortens further."""
        return self.shift + math.pi / (2 * self.steepness)

    def _pressure(self, force: Array, contraction: Array) -> Array:
        share = contraction / (self.largest - self.softening * force)
        return self.p0 + self.c1 * force + self.c2 * jnp.tan(self.steepness * (share - self.shift))
