"""Phenomenological law of Reynolds and co-workers: contractile element and spring, each affine in pressure."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import Parameter, PressureAffineLaw
from mckibben.muscle.specimen import Domain


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
    domain
        Domain of the data behind it.

    References
    ----------
    D. Reynolds, D. Repperger, C. Phillips and G. Bandry, "Modeling the dynamic characteristics of pneumatic muscle",
    Annals of Biomedical Engineering 31 (2003) 310-317.

    Examples
    --------
    The published muscle, made of a bicycle tube (179.2 + 1.39 P, 5.71 + 0.0307 P; N, mm, kPa); its length of 250 mm is
    our assumption:

    >>> from mckibben.units import kPa, percent
    >>> law = ReynoldsLaw(f0=179.2, f1=1.39 / kPa, k0=5.71 * 250, k1=0.0307 * 250 / kPa)
    >>> round(float(law.force(10 * percent, 400 * kPa)), 1)
    285.4
    """

    f0: float
    f1: float
    k0: float
    k1: float
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
