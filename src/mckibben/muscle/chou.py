"""The geometric law of Chou and Hannaford, Eq. 1 of the paper."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Inherited
from mckibben.muscle.base import BRAID_PARAMETERS, PressureAffineLaw, braid_gain
from mckibben.muscle.specimen import Domain
from mckibben.units import BraidAngle, Diameter

if TYPE_CHECKING:
    from mckibben.muscle.specimen import Specimen

_WHAT = "Chou's law (Eq. 1)"


class ChouLaw(PressureAffineLaw):
    r"""Ideal McKibben muscle: a cylinder of inextensible braid without rubber, friction or ends.

    .. math::

        F = p \frac{\pi d_0^2}{4} \left(\beta_1 (1-\varepsilon)^2 - \beta_2\right), \quad
        \beta_1 = \frac{3}{\tan^2\alpha_0}, \quad \beta_2 = \frac{1}{\sin^2\alpha_0}

    with the angle alpha0 [rad] between thread and axis, and the diameter d0 [m], of the deflated muscle.

    References
    ----------
    Eq. 1 of the paper; C.-P. Chou and B. Hannaford, "Measurement and modeling of McKibben pneumatic artificial
    muscles", IEEE Trans. Robotics and Automation 12 (1996) 90-102.

    Examples
    --------
    >>> from mckibben.units import bar, deg, mm, percent
    >>> law = ChouLaw(braid_angle=25 * deg, initial_diameter=10 * mm)
    >>> round(float(law.force(0.0, 6 * bar)), 1), round(law.zero_force_contraction / percent, 1)
    (386.3, 36.3)
    """

    short_name = "chou"

    braid_angle: Annotated[BraidAngle, Inherited(lambda scope: scope["specimen"].braid(_WHAT)[1])]
    initial_diameter: Annotated[Diameter, Inherited(lambda scope: scope["specimen"].braid(_WHAT)[0])]
    domain: Annotated[Domain, Inherited(lambda scope: scope["specimen"].domain)] = Domain()

    equation = "F = p (pi d0^2/4) (3/tan^2(alpha0) (1 - eps)^2 - 1/sin^2(alpha0))"
    source = "Chou and Hannaford 1996; Eq. 1"
    shape_parameters = BRAID_PARAMETERS

    @classmethod
    def of(cls, specimen: Specimen) -> ChouLaw:
        """Return the law from a specimen's geometry; `RangeError` if diameter or braid angle is unknown."""
        initial_diameter, braid_angle = specimen.braid(_WHAT)
        return cls(braid_angle=braid_angle, initial_diameter=initial_diameter, domain=specimen.domain)

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        gain = braid_gain(self.braid_angle, self.initial_diameter, 1 - jnp.asarray(contraction))
        return jnp.zeros_like(gain), gain

    @property
    def zero_force_contraction(self) -> float:
        """Contraction [-] at which the force is zero at any pressure."""
        return 1 - 1 / (math.sqrt(3) * math.cos(self.braid_angle))
