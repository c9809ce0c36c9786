"""Sliding mode: the error is driven to a line on which it dies out, by more than any disturbance can hold against."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.control.feedback import Feedback
from mckibben.numerics.checks import check_positive

Scalar = Float[Array, ""]


class SlidingMode(Feedback):
    r"""Sliding mode with a boundary layer.

    .. math:: s = \dot e + \lambda e, \quad a = \lambda \dot e + \rho\, \mathrm{sat}(s / \phi)

    Outside the layer :math:`|s| < \phi` the surface s = 0 is reached whatever disturbance below rho there is; inside it
    is a PD loop, and a disturbance d leaves an error of :math:`\phi d / (\lambda \rho)`. A layer of no width would
    chatter: the pressures follow with the lag T only, and stability inside asks for
    :math:`\lambda + \rho/\phi > T \lambda \rho/\phi`.

    Parameters
    ----------
    slope
        lambda [1/s].
    reach
        rho [rad/s^2].
    layer
        phi [rad/s].
    lag
        T [s].

    References
    ----------
    J.-J. E. Slotine and W. Li, Applied Nonlinear Control, Prentice Hall 1991, ch. 7.
    """

    slope: float = 40.0
    reach: float = 80.0
    layer: float = 1.0
    lag: float = 0.005

    def __check_init__(self) -> None:
        check_positive("SlidingMode", "1/s", slope=self.slope)
        check_positive("SlidingMode", "rad/s^2", reach=self.reach)
        check_positive("SlidingMode", "rad/s", layer=self.layer)
        check_positive("SlidingMode", "s", lag=self.lag)

    def init(self, error: ArrayLike) -> tuple[()]:
        return ()

    def step(self, state: tuple[()], error: ArrayLike, rate: ArrayLike, period: ArrayLike) -> tuple[tuple[()], Scalar]:
        surface = rate + self.slope * jnp.asarray(error)
        return state, self.slope * jnp.asarray(rate) + self.reach * jnp.clip(surface / self.layer, -1.0, 1.0)

    def realised(self, state: tuple[()], missing: ArrayLike, period: ArrayLike) -> tuple[()]:
        return state
