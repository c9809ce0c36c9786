"""Law of Tsagarakis and Caldwell: rigid ends, wall thickness and a threshold pressure."""

from __future__ import annotations

from typing import Annotated

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.muscle.base import BRAID_PARAMETERS, Parameter, PressureAffineLaw, braid_gain
from mckibben.muscle.specimen import Domain
from mckibben.units import BraidAngle, Diameter, Percent, Pressure, Quantity, mm

WallThickness = Annotated[float, Quantity("m", "mm", 0, 50)]
EndShare = Annotated[float, Percent("1", "%", 0, 90)]


class TsagarakisCaldwellLaw(PressureAffineLaw):
    r"""Braid with ends of constant length, a wall of finite thickness, and a threshold pressure.

    .. math::

        F = (p - p_t) \left[\frac{\pi d_0^2}{4}\left(a x^2 - b\right)
            + \pi d_n t \left(2\sin\alpha - \frac{1}{\sin\alpha}\right) - \pi t^2\right]

    with :math:`a = 3/\tan^2\alpha_0`, :math:`b = 1/\sin^2\alpha_0`, the cylinder's length over its initial one :math:`x
    = 1 - \varepsilon/(1 - s)`, the braid angle :math:`\cos\alpha = x \cos\alpha_0` and the braid's diameter at 90
    degrees :math:`d_n = d_0/\sin\alpha_0`. Below the threshold pressure p_t, due to rubber and static friction, there
    is no force. NaN beyond the stretch at which the threads are straight. Without corrections it is Chou's law.

    The source gives its corrections as a procedure. This form, with one parameter per correction, is ours; the wall
    term is by Chou and Hannaford.

    Parameters
    ----------
    threshold_pressure
        p_t [Pa].
    braid_angle, initial_diameter
        alpha0 [rad] and d0 [m] of the deflated muscle.
    wall_thickness
        t [m] of bladder and braid.
    end_share
        s [-], length of both ends over that of the muscle.

    References
    ----------
    N. Tsagarakis and D. Caldwell, "Improved modelling and assessment of pneumatic muscle actuators", IEEE Int. Conf.
    Robotics and Automation (2000) 3641-3646; the wall's term: C.-P. Chou and B. Hannaford, IEEE Trans. Robotics and
    Automation 12 (1996) 90-102.

    Examples
    --------
    >>> from mckibben.units import bar, deg, mm
    >>> law = TsagarakisCaldwellLaw(0.2 * bar, 25 * deg, 10 * mm, wall_thickness=1 * mm, end_share=0.1)
    >>> round(float(law.force(0.0, 6 * bar)), 1)
    306.0
    """

    threshold_pressure: Pressure
    braid_angle: BraidAngle
    initial_diameter: Diameter
    wall_thickness: WallThickness
    end_share: EndShare
    domain: Domain = Domain()

    equation = (
        "F = (p - p_t) ((pi d0^2/4) (3/tan^2(alpha0) x^2 - 1/sin^2(alpha0)) + pi d_n t (2 sin(alpha) - 1/sin(alpha)) "
        "- pi t^2), x = 1 - eps/(1 - s)"
    )
    source = "after Tsagarakis and Caldwell 2000 (form ours)"
    linear_parameters = (Parameter("threshold_pressure", "Pa", "bar", "pressure lost to rubber and friction"),)
    shape_parameters = (
        *BRAID_PARAMETERS,
        Parameter("wall_thickness", "m", "mm", "thickness of bladder and braid", 0.0, 5 * mm),
        Parameter("end_share", "1", "percent", "fraction of the length taken by the ends", 0.0, 0.6),
    )

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        x = 1 - jnp.asarray(contraction) / (1 - self.end_share)
        sine = jnp.sqrt(1 - (x * jnp.cos(self.braid_angle)) ** 2)
        diameter = self.initial_diameter / jnp.sin(self.braid_angle)
        wall = jnp.pi * diameter * self.wall_thickness * (2 * sine - 1 / sine) - jnp.pi * self.wall_thickness**2
        gain = braid_gain(self.braid_angle, self.initial_diameter, x) + wall
        return -self.threshold_pressure * gain, gain
