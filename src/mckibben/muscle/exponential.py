"""Improved Tondu-Lopez law, Eq. 2 of the paper: a linear term and an exponential, each affine in pressure."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import Parameter, PressureAffineLaw
from mckibben.muscle.specimen import Domain
from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import exp


class ExponentialLaw(PressureAffineLaw):
    r"""Empirical law with six coefficients and a decay.

    .. math:: F = (a_1 + a_2 p) + (b_1 + b_2 p)\,\varepsilon + (c_1 + c_2 p)\,e^{-\mu\varepsilon}

    In SI; the paper's numbers are in bar and percent (`mckibben.catalog`). Outside the domain of the fitted data the
    exponential grows without bound (2493 N at -8 % and 6 bar for Eq. 3, of a muscle rated 630 N), and the force is
    negative at low pressure.

    Parameters
    ----------
    a1, b1, c1
        Forces [N].
    a2, b2, c2
        Forces per pressure [N/Pa].
    decay
        mu [-], per unit of contraction: 30 is the paper's 0.3 per percent.
    domain
        Domain of the data behind it.

    References
    ----------
    Eq. 2 of the paper, there called the improved Tondu-Lopez model.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.units import bar, percent
    >>> law = catalog.law("lei-mas-10-180n")  # Eq. 3
    >>> round(float(law.force(contraction=0.0, pressure=6 * bar)), 2)
    584.72
    >>> round(float(law.force(contraction=10 * percent, pressure=6 * bar)), 1)
    242.6
    """

    a1: float
    a2: float
    b1: float
    b2: float
    c1: float
    c2: float
    decay: float
    domain: Domain = Domain()

    def __check_init__(self) -> None:
        check_positive("ExponentialLaw", "per unit of contraction", decay=self.decay)

    equation = "F = (a1 + a2 p) + (b1 + b2 p) eps + (c1 + c2 p) exp(-mu eps)"
    source = "Eq. 2 of the paper (improved Tondu-Lopez)"
    linear_parameters = (
        Parameter("a1", "N", "N", "constant"),
        Parameter("a2", "N/Pa", "N/bar", "constant, per pressure"),
        Parameter("b1", "N", "N/percent", "linear"),
        Parameter("b2", "N/Pa", "N/(bar*percent)", "linear, per pressure"),
        Parameter("c1", "N", "N", "exponential"),
        Parameter("c2", "N/Pa", "N/bar", "exponential, per pressure"),
    )
    shape_parameters = (Parameter("decay", "1", "1/percent", "decay of the exponential", 1.0, 300.0),)

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        eps = jnp.asarray(contraction)
        decayed = exp(-self.decay * eps)
        return (
            self.a1 + self.b1 * eps + self.c1 * decayed,
            self.a2 + self.b2 * eps + self.c2 * decayed,
        )
