"""Eq. 2 with smooth deviations over contraction, quadratic in pressure."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import Parameter, PositiveContraction, check_point
from mckibben.muscle.exponential import Decay, EquationTwo
from mckibben.muscle.specimen import Domain
from mckibben.numerics.elementary import polynomial

DEGREE = 5
"""Degree of the polynomial of each deviation."""


def _deviation(order: int) -> tuple[Parameter, ...]:
    """Coefficients of s_j, penalised in an identification."""
    unit = ("N", "N/Pa", "N/Pa^2")[order]
    unit_in_files = ("N", "N/bar", "N/bar^2")[order]
    powers = ("constant", "linear", "quadratic", "cubic", "quartic", "quintic")
    return tuple(
        Parameter(f"s{order}{i}", unit, unit_in_files, f"deviation s{order}, {power}", penalised=True)
        for i, power in enumerate(powers)
    )


class SmoothLaw(EquationTwo):
    r"""Eq. 2 with smooth deviations over contraction, quadratic in pressure.

    .. math:: F = F_{Eq. 2} + s_0(\varepsilon) + p\,s_1(\varepsilon) + p^2 s_2(\varepsilon), \quad
        s_j = (1 - v^2)^3 \sum_{i=0}^{5} s_{ji} v^i, \quad
        v = \mathrm{clip}\left(\frac{\varepsilon - \varepsilon_m}{h}, -1, 1\right)

    Outside the window :math:`\varepsilon_m \pm h` the law is Eq. 2. `identify` sets the window, estimates the size of
    the deviations, and returns an `ExponentialLaw` where the data support none (docs/laws.md).

    Parameters
    ----------
    a1, a2, b1, b2, c1, c2, decay
        As for `ExponentialLaw`.
    s00, ..., s25
        Coefficients of the deviations [N], [N/Pa] and [N/Pa^2].
    centre, half_width
        Window of the deviations: contractions [-].

    References
    ----------
    This project, docs/laws.md.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.identification import fit_law
    >>> fit = fit_law(SmoothLaw, catalog.dataset("festo-tool-10mm"))
    >>> round(fit.rmse, 2), round(fit.leave_one_pressure_out.rmse, 2)
    (0.06, 0.15)
    """

    short_name = "smooth"

    __annotations__.update({f"s{order}{i}": "float" for order in range(3) for i in range(DEGREE + 1)})
    decay: Decay
    centre: float
    half_width: PositiveContraction
    domain: Domain = Domain()

    source = "this project"
    equation: ClassVar[str] = (
        "F = F_Eq2 + s0 + p s1 + p^2 s2, s_j = (1 - v^2)^3 sum_i s_ji v^i, v = clip((eps - centre)/half_width, -1, 1)"
    )
    linear_parameters = (*EquationTwo.linear_parameters, *_deviation(0), *_deviation(1), *_deviation(2))
    constants = (
        Parameter("centre", "1", "percent", "centre of the window of the deviations"),
        Parameter("half_width", "1", "percent", "its half width"),
    )

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        contraction, pressure = check_point(contraction, pressure)
        offset, gain, curvature = self._quadratic(contraction)
        return offset + (gain + curvature * pressure) * pressure

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        """Return the gauge pressure [Pa] on the branch where force rises with pressure; NaN if there is none."""
        offset, gain, curvature = self._quadratic(contraction)
        above = jnp.asarray(force) - offset
        return 2 * above / (gain + jnp.sqrt(gain * gain + 4 * curvature * above))

    def _quadratic(self, contraction: ArrayLike) -> tuple[Array, ...]:
        """Coefficients of the force over pressure, from the offset [N] on."""
        eps = jnp.asarray(contraction)
        v = jnp.clip((eps - self.centre) * (1 / self.half_width), -1.0, 1.0)
        inside = 1 - v * v
        window = inside * inside * inside
        offset, gain = self.terms(eps)
        added = (polynomial(v, tuple(getattr(self, f"s{order}{i}") for i in range(DEGREE + 1))) for order in range(3))
        first, second, third = (window * series for series in added)
        return offset + first, gain + second, third
