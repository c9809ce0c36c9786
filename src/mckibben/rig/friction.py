"""Dry friction with presliding: the memory of the direction in which a muscle was last moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def presliding(travel: ArrayLike, reach: float, start: float = 1.0) -> NDArray[np.float64]:
    r"""The share of the friction band that is taken up after each move, from -1 to 1.

    .. math:: \frac{dz}{ds} = \frac{1 - z \, \mathrm{sgn}(\dot s)}{s_0}

    Rate-independent: it knows the way, not the time. It is integrated exactly, so a move may be cut into
    parts.

    Parameters
    ----------
    travel
        Shape (moves,): the signed moves [m], one after the other; positive = towards z = 1.
    reach
        The way s0 [m] of the change of sides after a reversal: 63 % of it are done after s0, 98 % after 4 s0.
    start
        The share before the first move.

    References
    ----------
    P. R. Dahl, "A solid friction model", Aerospace Corporation TOR-0158(3107-18)-1 (1968), with exponent 1.

    Examples
    --------
    >>> presliding([1e-3, -1e-3, -1e-3, -1e-3], reach=0.5e-3).round(3)
    array([ 1.   , -0.729, -0.963, -0.995])
    """
    moves = np.asarray(travel, dtype=np.float64)
    shares = np.empty_like(moves)
    share = start
    for k, (side, kept) in enumerate(zip(np.sign(moves), np.exp(-np.abs(moves) / reach), strict=True)):
        share = side + (share - side) * kept
        shares[k] = share
    return shares
