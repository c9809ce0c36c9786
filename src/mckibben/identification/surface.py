"""Smooth force over contraction and pressure beside the friction, whatever the law: friction is what is not smooth.

The force is a polynomial in the pressure, each of whose coefficients is a smoothing spline over the contraction. The
roughness of the splines, relative to the noise, is estimated by restricted maximum likelihood
(`mckibben.identification.mixed_model`): what the points leave open of the surface is in the errors of the friction.

References
----------
D. Ruppert, M. Wand and R. Carroll, "Semiparametric Regression", Cambridge University Press 2003, section 4.9.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from mckibben.dataset import IsobaricDataset
from mckibben.identification.estimator import Bools, Floats
from mckibben.identification.grouping import held_values
from mckibben.identification.mixed_model import MixedModel

_KNOTS = 16


@dataclass(frozen=True, eq=False)
class SmoothSurface:
    """Columns of a smooth force at the points that count; `smooth` ones have a weak, `rough` ones a strong curvature.

    Attributes
    ----------
    smooth
        Columns that are linear in the contraction, shape (points, 2 * orders).
    rough
        Columns of the splines, whose coefficients are normal with one scale for each order, shape (points, m).
    orders
        Number of powers of the pressure.
    """

    smooth: Floats = field(repr=False)
    rough: Floats = field(repr=False)
    orders: int

    @classmethod
    def of(cls, means: IsobaricDataset, used: Bools, *, most: int = 4) -> SmoothSurface:
        """Surface over the taut points that count, with `most` powers of the pressure, or one by held value."""
        taut = used & ~means.slack
        contraction, pressure = (_scaled(column, taut) for column in (means.contraction, means.pressure))
        orders = min(most, len(np.unique(held_values(means)[taut])))
        powers = np.vander(pressure, orders, increasing=True) * taut[:, None]
        shapes = np.vander(contraction, 2, increasing=True), _splines(contraction)
        smooth, rough = ((powers[:, :, None] * shape[:, None, :]).reshape(len(taut), -1)[used] for shape in shapes)
        return cls(smooth, rough, orders)

    def basis(self, columns: Floats, residuals: Floats, weights: Floats) -> Floats:
        """Orthonormal basis of what the surface explains of weighted residuals, beside other columns.

        Returns
        -------
        Shape (points and rows of the prior, m).
        """
        weighted = weights[:, None] * self.smooth
        left, sizes, _ = np.linalg.svd(weighted, full_matrices=False)
        smooth, rough = left[:, sizes > 1e-10 * sizes[0]], weights[:, None] * self.rough
        model = MixedModel(np.hstack([smooth, columns]), rough, residuals, self._scales)
        starts = [np.full(self.orders, start) for start in (0.0, 4.0)]
        scale = np.exp(self._scales(model.estimate(starts, [(-6.0, 14.0)] * self.orders)[0])[0])
        prior = np.hstack([np.zeros((len(scale), smooth.shape[1])), np.eye(len(scale))])
        return np.linalg.qr(np.concatenate([np.hstack([smooth, rough * scale]), prior]))[0]

    def _scales(self, hyperparameters: Floats) -> tuple[Floats, Floats]:
        derivative = np.repeat(np.eye(self.orders), self.rough.shape[1] // self.orders, axis=0)
        return derivative @ hyperparameters, derivative


def _scaled(values: Floats, points: Bools) -> Floats:
    """Values from -1 to 1 over some points, and those of other points at these ends."""
    least, most = values[points].min(), values[points].max()
    return np.clip(2 * (values - least) / max(most - least, np.finfo(float).tiny) - 1, -1.0, 1.0)


def _splines(places: Floats) -> Floats:
    """Cubic splines at places from -1 to 1: independent normal coefficients give a normal curvature, shape (n, m)."""
    from scipy.interpolate import BSpline  # takes 0.3 s to import

    knots, root = _spline_root()
    return BSpline.design_matrix(places, knots, 3).toarray() @ root


@cache
def _spline_root() -> tuple[Floats, Floats]:
    """Knots, and roots of the integral of the squared curvature, without straight lines."""
    from scipy.interpolate import BSpline

    knots = np.concatenate([np.full(3, -1.0), np.linspace(-1, 1, _KNOTS), np.full(3, 1.0)])
    places, weights = np.polynomial.legendre.leggauss(20 * _KNOTS)
    curvature = BSpline(knots, np.eye(_KNOTS + 2), 3).derivative(2)(places)
    sizes, directions = np.linalg.eigh((curvature.T * weights) @ curvature)
    return knots, directions[:, 2:] / np.sqrt(sizes[2:])
