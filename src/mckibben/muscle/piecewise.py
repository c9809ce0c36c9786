"""A law whose contractile force and spring are tables over the pressure."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.calls import checked_call
from mckibben.errors import RangeError
from mckibben.muscle.base import ForceLaw, check_point, pressure_for
from mckibben.muscle.specimen import Domain
from mckibben.units import Pressure, SignedForce


class PiecewiseLaw(ForceLaw):
    r"""Contractile force and linear spring, each piecewise linear in pressure.

    .. math:: F = f(p) - k(p)\,\varepsilon

    `ReynoldsLaw` has one piece; a spring that softens at low and stiffens at high pressure needs several. Beyond the
    table, the first and the last piece are continued.

    Parameters
    ----------
    pressures
        Pressures [Pa, gauge] of the table, ascending.
    forces, springs
        Contractile force f [N], and spring k [N] per unit of contraction, at each.

    References
    ----------
    D. Reynolds, D. Repperger, C. Phillips and G. Bandry, "Modeling the dynamic characteristics of pneumatic muscle",
    Annals of Biomedical Engineering 31 (2003) 310-317 (the terms).

    Examples
    --------
    Halfway between 1 and 3 bar, at a contraction of 10 %:

    >>> law = PiecewiseLaw(pressures=(1e5, 3e5, 6e5), forces=(200.0, 500.0, 1000.0), springs=(2e3, 1e3, 2e3))
    >>> round(float(law.force(0.1, 2e5)), 6)  # (200 + 500) / 2 - 0.1 * (2000 + 1000) / 2
    200.0
    """

    short_name = "piecewise"

    pressures: Sequence[Pressure]
    forces: Sequence[SignedForce]
    springs: Sequence[SignedForce]
    domain: Domain = Domain()

    equation = "F = f(p) - k(p) eps"
    source = "terms: Reynolds et al. 2003; pieces: ours"

    def __check_init__(self) -> None:
        super().__check_init__()
        counts = {len(self.pressures), len(self.forces), len(self.springs)}
        if counts == {1} or len(counts) > 1:
            remedy = "give two pressures or more, and a force and a spring at each"
            raise RangeError("PiecewiseLaw: the columns are not those of a table", field="pressures", remedy=remedy)
        if isinstance(self.pressures[0], float | int) and np.any(np.diff(self.pressures) <= 0):
            raise RangeError("PiecewiseLaw: the pressures do not ascend", field="pressures", remedy="sort the rows")

    @checked_call
    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        contraction, pressure = check_point(contraction, pressure)
        return self._at(self.forces, pressure) - self._at(self.springs, pressure) * contraction

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        return pressure_for(self, force, contraction)

    def _at(self, values: Sequence[float], pressure: ArrayLike) -> Array:
        """Value of a column at a pressure [Pa]."""
        at, pressure = self.pressures, jnp.asarray(pressure)
        slopes = [(b - a) / (q - p) for a, b, p, q in zip(values, values[1:], at, at[1:], strict=False)]
        value = values[0] + slopes[0] * (pressure - at[0])
        for start, before, after in zip(at[1:], slopes, slopes[1:], strict=False):
            value = value + (after - before) * jnp.maximum(pressure - start, 0.0)
        return value
