"""Eq. 2 with a deviation over contraction and pressure, the mean of a Gaussian process of reduced rank."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle import base
from mckibben.muscle.base import Parameter, PositiveContraction, check_point
from mckibben.muscle.exponential import Decay, EquationTwo
from mckibben.muscle.specimen import Domain

ORDER = 6
"""Number of basis functions over contraction and over pressure."""


class GaussianProcessLaw(EquationTwo):
    r"""Eq. 2 with a smooth deviation over contraction and pressure.

    .. math:: F = F_{Eq. 2} + \sum_{i,j=0}^{5} d_{ij}\,T_i(g(v))\,T_j(g(w)), \quad
        v = \mathrm{clip}\left(\frac{\varepsilon - \varepsilon_m}{h}, -1, 1\right), \quad
        w = \mathrm{clip}\left(\frac{p - p_m}{k}, -1, 1\right)

    :math:`T_i` are Chebyshev polynomials and :math:`g(v) = (3v - v^3)/2`, so that :math:`T_i(g(v))` is nearly
    :math:`\cos(i\pi(v - 1)/2)`: the basis of a Gaussian process of reduced rank. Each has a slope of zero at the ends
    of the window, and beyond them the deviation is constant. `identify` sets the window, estimates size and lengths of
    the deviation, and returns a simpler law if that predicts points left out as well (docs/laws.md).

    Parameters
    ----------
    a1, a2, b1, b2, c1, c2, decay
        As for `ExponentialLaw`.
    d00, ..., d55
        Coefficients of the deviation [N]; the first digit is the order over contraction.
    centre, half_width
        Window over contraction [-].
    pressure_centre, pressure_half_width
        Window over pressure [Pa].

    References
    ----------
    A. Solin and S. Sarkka, "Hilbert space methods for reduced-rank Gaussian process regression", Statistics and
    Computing 30 (2020) 419-446; its sum with Eq. 2: this project, docs/laws.md.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.identification import fit_law
    >>> from mckibben.muscle import GaussianProcessLaw
    >>> fit = fit_law(GaussianProcessLaw, catalog.dataset("dmsp-10-250-martens2017"))
    >>> type(fit.law).__name__, round(fit.rmse, 2)
    ('GaussianProcessLaw', 0.61)
    """

    short_name = "gaussian_process"

    __annotations__.update({f"d{i}{j}": "float" for i in range(ORDER) for j in range(ORDER)})
    decay: Decay
    centre: float
    half_width: PositiveContraction
    pressure_centre: float
    pressure_half_width: float
    domain: Domain = Domain()

    equation = (
        "F = F_Eq2 + sum_ij d_ij T_i(g(v)) T_j(g(w)), g(v) = (3 v - v^3)/2; v, w: eps, p in their windows, within -1..1"
    )
    source = "this project"
    linear_parameters = (
        *EquationTwo.linear_parameters,
        *(
            Parameter(
                f"d{i}{j}", "N", "N", f"deviation, order {i} over contraction and {j} over pressure", penalised=True
            )
            for i in range(ORDER)
            for j in range(ORDER)
        ),
    )
    constants = (
        Parameter("centre", "1", "percent", "centre of the window over contraction"),
        Parameter("half_width", "1", "percent", "its half width"),
        Parameter("pressure_centre", "Pa", "bar", "centre of the window over pressure"),
        Parameter("pressure_half_width", "Pa", "bar", "its half width"),
    )

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        contraction, pressure = check_point(contraction, pressure)
        eps, p = jnp.asarray(contraction), jnp.asarray(pressure)
        offset, gain = self.terms(eps)
        over_contraction = _basis((eps - self.centre) * (1 / self.half_width))
        over_pressure = _basis((p - self.pressure_centre) * (1 / self.pressure_half_width))
        deviation = jnp.asarray(0.0)
        for i, along in enumerate(over_contraction):
            row = jnp.asarray(0.0)
            for j, across in enumerate(over_pressure):
                row = row + getattr(self, f"d{i}{j}") * across
            deviation = deviation + row * along
        return offset + gain * p + deviation

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        return base.pressure_for(self, force, contraction)


def _basis(position: Array) -> list[Array]:
    """T_0, ..., T_5 at g(v), for a position in the window."""
    v = jnp.clip(position, -1.0, 1.0)
    g = v * (1.5 - 0.5 * v * v)
    polynomials = [jnp.ones_like(g), g]
    while len(polynomials) < ORDER:
        polynomials.append(2.0 * g * polynomials[-1] - polynomials[-2])
    return polynomials
