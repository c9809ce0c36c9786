"""Law of this project: exponentials of rates one, two and four, and the logarithm of pressure in the last."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import ForceLaw, Parameter, pressure_for
from mckibben.muscle.specimen import Domain
from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import exp
from mckibben.units import atm


class TripleExponentialLaw(ForceLaw):
    r"""Empirical law with one parameter more than Eq. 2 and about half of its error at unseen pressures.

    .. math:: F = a_1 + (a_2 + b\,\varepsilon)\,p + c\,p^2 e^{-\mu\varepsilon} + d_1 e^{-2\mu\varepsilon}
        + \left(d_2 + d_3 \ln(1 + p/p_a)\right) e^{-4\mu\varepsilon}

    with the atmosphere :math:`p_a` = 101325 Pa. The second term is the force of the braid; the exponentials stand
    for rubber and ends. The form is empirical: `benchmarks/forms.py` selected it among 33649 by the cross-validation
    error on two measured and two published muscles; of the best sixty it loses least with fewer pressures. Fitted to
    any of the four, the force of a taut muscle decreases with contraction and increases with pressure, at -3..25 % and
    0..8 bar.

    Parameters
    ----------
    a1, d1, d2, d3
        Forces [N].
    a2, b
        Forces per pressure [N/Pa]; b per unit of contraction.
    c
        Force per square of pressure [N/Pa^2].
    decay
        mu [-], per unit of contraction.
    domain
        Domain of the data behind it.

    References
    ----------
    This project, docs/laws.md; `mckibben identify dmsp-10-250-martens2017 --law all` compares it with the others.

    Examples
    --------
    >>> from mckibben import catalog, identify
    >>> fit = identify(TripleExponentialLaw, catalog.dataset("dmsp-10-250-martens2017"))
    >>> round(fit.rmse, 2), round(fit.leave_one_pressure_out.rmse, 2)
    (0.66, 0.84)
    """

    a1: float
    a2: float
    b: float
    c: float
    d1: float
    d2: float
    d3: float
    decay: float
    domain: Domain = Domain()

    def __check_init__(self) -> None:
        check_positive("TripleExponentialLaw", "per unit of contraction", decay=self.decay)

    equation = (
        "F = a1 + (a2 + b eps) p + c p^2 exp(-mu eps) + d1 exp(-2 mu eps) + (d2 + d3 ln(1 + p/p_a)) exp(-4 mu eps)"
    )
    source = "this project"
    linear_parameters = (
        Parameter("a1", "N", "N", "constant"),
        Parameter("a2", "N/Pa", "N/bar", "constant, per pressure"),
        Parameter("b", "N/Pa", "N/(bar*percent)", "linear, per pressure"),
        Parameter("c", "N/Pa^2", "N/bar^2", "slow exponential, per square of pressure"),
        Parameter("d1", "N", "N", "exponential of twice its decay"),
        Parameter("d2", "N", "N", "exponential of four times its decay"),
        Parameter("d3", "N", "N", "the same, per logarithm of pressure"),
    )
    shape_parameters = (Parameter("decay", "1", "1/percent", "decay of the slow exponential", 2.0, 40.0),)
    atmosphere: ClassVar[float] = atm
    """p_a [Pa]."""

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        eps, pressure = jnp.asarray(contraction), jnp.asarray(pressure)
        slow = exp(-self.decay * eps)
        twice = slow * slow
        work = jnp.log1p(pressure * (1 / self.atmosphere))
        braid = self.a1 + (self.a2 + self.b * eps + self.c * pressure * slow) * pressure
        return braid + (self.d1 + (self.d2 + self.d3 * work) * twice) * twice

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        return pressure_for(self, force, contraction)
