"""Law of Martens and Boblan: geometry of the braid and elasticity of the rubber."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import BRAID_PARAMETERS, Parameter, PressureAffineLaw, braid_gain
from mckibben.muscle.specimen import Domain
from mckibben.units import BraidAngle, Diameter


class MartensBoblanLaw(PressureAffineLaw):
    r"""Virtual work of the gas and of a rubber tube, stretched axially and radially.

    .. math::

        F = -p \frac{dV}{dL} + \frac{dU}{dL}, \quad \frac{dV}{dL} = \frac{L_f^2 - 3 L^2}{4\pi n^2}, \quad
        U = \frac{l_0}{2} \left(S_l \varepsilon^2 + S_d (D/d_0 - 1)^2\right)

    with the thread's length :math:`L_f = l_0/\cos\alpha_0`, its turns :math:`n = l_0 \tan\alpha_0/(\pi d_0)` and the
    diameter :math:`D = \sqrt{L_f^2 - L^2}/(n\pi)`. The source derives the geometry and has different rubber terms; the
    energy U, with an axial and a radial stiffness, is ours. The length l0 cancels. NaN beyond the stretch at which the
    threads are straight. Without rubber it is Chou's law.

    Parameters
    ----------
    axial_stiffness, radial_stiffness
        S_l and S_d [N]: modulus times cross-section of the rubber, axial and radial.
    braid_angle, initial_diameter
        alpha0 [rad] and d0 [m] of the deflated muscle.

    References
    ----------
    M. Martens and I. Boblan, "Modeling the static force of a Festo pneumatic muscle actuator: a new approach and a
    comparison to existing models", Actuators 6 (2017) 33, doi 10.3390/act6040033.

    Examples
    --------
    >>> from mckibben.units import bar, deg, mm, percent
    >>> law = MartensBoblanLaw(300.0, 20.0, braid_angle=25 * deg, initial_diameter=10 * mm)
    >>> round(float(law.force(10 * percent, 6 * bar)), 1), round(float(law.force(-3 * percent, 0.0)), 1)
    (210.5, 25.9)
    """

    short_name = "martens_boblan"

    axial_stiffness: float
    radial_stiffness: float
    braid_angle: BraidAngle
    initial_diameter: Diameter
    domain: Domain = Domain()

    equation = (
        "F = p (pi d0^2/4) (3/tan^2(alpha0) (1 - eps)^2 - 1/sin^2(alpha0)) - S_l eps - S_d (D/d0 - 1) d(D/d0)/d(eps)"
    )
    source = "Martens and Boblan 2017; the rubber's energy ours"
    linear_parameters = (
        Parameter("axial_stiffness", "N", "N", "rubber, axial"),
        Parameter("radial_stiffness", "N", "N", "rubber, radial"),
    )
    shape_parameters = BRAID_PARAMETERS

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        eps = jnp.asarray(contraction)
        ratio, cosine, sine = 1 - eps, jnp.cos(self.braid_angle), jnp.sin(self.braid_angle)
        widening = jnp.sqrt(1 - (cosine * ratio) ** 2) / sine  # D / d0
        widening_rate = (cosine / sine) ** 2 * ratio / widening
        rubber = -self.axial_stiffness * eps - self.radial_stiffness * (widening - 1) * widening_rate
        return rubber, braid_gain(self.braid_angle, self.initial_diameter, ratio)
