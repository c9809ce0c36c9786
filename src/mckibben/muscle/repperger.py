"""Law of Repperger and co-workers: a spring whose stiffness increases with pressure."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import Parameter, PressureAffineLaw
from mckibben.muscle.specimen import Domain
from mckibben.units import percent


class ReppergerLaw(PressureAffineLaw):
    r"""Spring whose stiffness increases with pressure, unloaded at full contraction.

    .. math:: F = (k_0 + k_1 p)\,(\varepsilon_0 - \varepsilon)

    The source has a spring with two stiffnesses, inflated and deflated, and a transient force. This static form is
    ours: the stiffness is affine in pressure, and the force is zero at one contraction.

    Parameters
    ----------
    k0, k1
        Stiffness [N] of the deflated muscle and its increase with pressure [N/Pa], per unit of contraction.
    rest
        Contraction eps0 [-] without force.
    domain
        Domain of the data behind it.

    References
    ----------
    D. Repperger, K. Johnson and C. Phillips, "A VSC position tracking system involving a large scale pneumatic muscle
    actuator", IEEE Conf. Decision and Control (1998) 4302-4307.

    Examples
    --------
    >>> from mckibben.units import bar
    >>> law = ReppergerLaw(k0=200.0, k1=300.0 / bar, rest=25 * percent)
    >>> round(float(law.force(5 * percent, 6 * bar)), 1)
    400.0
    """

    k0: float
    k1: float
    rest: float
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
