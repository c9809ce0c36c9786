"""A law with a pressure threshold: the dead band of the bladder."""

from __future__ import annotations

from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import ForceLaw, check_point
from mckibben.muscle.specimen import Domain
from mckibben.numerics.compiled import jit_inline
from mckibben.numerics.elementary import Number
from mckibben.units import Percent, Quantity

Threshold = Annotated[float, Quantity("Pa", "bar", 0.01, 5)]
SMOOTHNESS = 0.2
"""Width of the rounded corner, relative to the threshold."""
Smoothness = Annotated[float, Percent("1", "%", 1, 100)]


class ThresholdLaw(ForceLaw):
    r"""A law that sees only the part of the pressure above a threshold.

    .. math:: F = F_\mathrm{law}(\varepsilon, p_e), \qquad
        p_e = \frac{1}{2}\left(p - p_t + \sqrt{(p - p_t)^2 + (s\,p_t)^2}\right)

    A bladder of rubber takes the threshold :math:`p_t` to expand to its braid: the air adds hardly any force below it.
    The corner is rounded over the width :math:`s\,p_t`; the rounded form is ours.

    Parameters
    ----------
    law
        Any law.
    threshold
        p_t [Pa, gauge].
    smoothness
        s [-].

    References
    ----------
    C.-P. Chou and B. Hannaford, "Measurement and modeling of McKibben pneumatic artificial muscles", IEEE Trans.
    Robotics and Automation 12 (1996) 90-102 (threshold of the pressure in the linear model).

    Examples
    --------
    >>> from mckibben import catalog
    >>> law = catalog.law("lei-mas-10-180n")
    >>> shifted = ThresholdLaw(law, threshold=3e4)
    >>> round(float(shifted.effective_pressure(3e5))), round(float(shifted.effective_pressure(0.0)))
    (270033, 297)
    >>> [round(float(one), 6) for one in (shifted.force(0.0, 3e5), law.force(0.0, shifted.effective_pressure(3e5)))]
    [268.545936, 268.545936]
    """

    short_name = "threshold"

    law: ForceLaw
    threshold: Threshold
    smoothness: Smoothness = eqx.field(default=SMOOTHNESS, kw_only=True)

    equation = "F = F_law(eps, (p - pt + sqrt((p - pt)^2 + (s pt)^2)) / 2)"
    source = "threshold: Chou and Hannaford 1996; its rounded form: ours"

    @property
    def domain(self) -> Domain:  # type: ignore[override]
        """Domain of the law, at the pressures of which it sees the effective ones."""
        domain = self.law.domain.intersection(self.law.formula_domain)
        low, high = (self._measured(pressure) for pressure in (domain.pressure_min, domain.pressure_max))
        return Domain(domain.contraction_min, domain.contraction_max, low, high)

    def _measured(self, effective: Number) -> Number:
        """Pressure [Pa] of an effective one; that itself below all effective pressures."""
        width = self.smoothness * self.threshold
        if isinstance(effective, float | int):
            return self.threshold + effective - width * width / (4 * effective) if effective > 0 else effective
        possible = effective > 0
        back = self.threshold + effective - width * width / (4 * jnp.where(possible, effective, 1.0))
        return jnp.where(possible, back, effective)

    def effective_pressure(self, pressure: ArrayLike) -> Float[Array, "..."]:
        """Return the pressure [Pa] that the law sees."""
        return effective_pressure(jnp.asarray(pressure), self.threshold, self.smoothness)

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        contraction, pressure = check_point(contraction, pressure)
        return self._force(contraction, pressure)

    @jit_inline  # traced: the law would warn of effective pressures near 0, as of numbers in bar
    def _force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        return self.law.force(contraction, self.effective_pressure(pressure))

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        effective = jnp.asarray(self.law.pressure_for(force, contraction))
        return jnp.where(effective > 0, self._measured(effective), jnp.nan)


def effective_pressure(pressure: Any, threshold: Any, smoothness: float = SMOOTHNESS) -> Any:
    """Return the pressure [Pa] above a threshold [Pa], in NumPy or JAX as the pressure."""
    above = pressure - threshold
    return (above + (above * above + (smoothness * threshold) ** 2) ** 0.5) / 2
