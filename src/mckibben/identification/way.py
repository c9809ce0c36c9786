"""The force along the course of a test as a function of the numbers of law, friction and drift, and its derivatives."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.identification.design import design_matrix
from mckibben.identification.strokes import DriftBasis, Strokes
from mckibben.muscle import ForceLaw, MaxwellSlip, forces
from mckibben.muscle.friction import NARROWEST, drawn, faded, polygon

FRICTION = ("half_width", "growth", "log_presliding")
"""What is sought of a `MaxwellSlip`: B0 [N], B1 [N/Pa] and the logarithm of s0 [m]."""

_SMALL = 1e-4  # N: a change of the tension for difference quotients
_RELATIVE = 1e-6
_WIDEST = 1e5  # N


@dataclass(frozen=True, eq=False)
class WayModel:
    """Force along the way: law, friction as `MaxwellSlip.along` has it, and an offset in amplitudes.

    Parameters
    ----------
    template
        The law, with values for all of its parameters.
    strokes, means
        The course of a test, and its points.
    drift
        What the sensor's offset may look like.
    used
        Shape (rows,): the points whose residuals count; the way leads through all.
    reference_pressure
        Of the friction [Pa].
    elements
        Of the friction.
    """

    template: ForceLaw
    strokes: Strokes
    means: IsobaricDataset = field(repr=False)
    drift: DriftBasis = field(repr=False)
    used: NDArray[np.bool_] = field(repr=False)
    reference_pressure: float
    elements: int

    @property
    def law_names(self) -> tuple[str, ...]:
        """The parameters of the law, linear ones first."""
        return tuple(p.name for p in type(self.template).parameters())

    def law(self, values: Mapping[str, float]) -> ForceLaw:
        """The law with those of its parameters that are among the values."""
        given = {name: values[name] for name in self.law_names if name in values}
        return dataclasses.replace(self.template, **given)

    def friction(self, values: Mapping[str, float]) -> MaxwellSlip:
        """The friction of these values."""
        return MaxwellSlip(
            values["half_width"],
            float(np.exp(values["log_presliding"])),
            growth=values["growth"],
            reference_pressure=self.reference_pressure,
            elements=self.elements,
        )

    @property
    def shortest(self) -> float:
        """The logarithm of the s0 [m] with which friction has changed sides after one step: below, all is the same."""
        share, stiffness = polygon(self.elements)
        return float(np.log(self.strokes.step / (2 * (share / stiffness).max())))

    def bounds(self, names: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The range of each parameter."""
        given = {p.name: (p.lower, p.upper) for p in type(self.template).shape_parameters}
        given |= {
            "half_width": (NARROWEST, _WIDEST),
            "log_presliding": (self.shortest, float(np.log(10 * np.ptp(self.strokes.length)))),
        }
        lower, upper = zip(*(given.get(name, (-np.inf, np.inf)) for name in names), strict=True)
        return np.array(lower, float), np.array(upper, float)

    def parts(self, values: Mapping[str, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The law's tension and the force of friction [N] at each row, shape (rows,)."""
        tension = self._tension(values)
        return tension, self._friction(tension[:, None], [values])[:, 0]

    def residuals(self, values: Mapping[str, float], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
        """Measured minus modelled force [N] at the points used, with the sign that `least_squares` wants: modelled."""
        tension, friction = self.parts(values)
        return (tension + friction + self.drift.points @ offsets - self.means.force)[self.used]

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> NDArray[np.float64]:
        """The derivative of the modelled force at the points used by the named parameters and the offsets."""
        tension = self._tension(values)
        of_law = [name for name in names if name in self.law_names]
        columns = design_matrix(self.law(values), of_law, self.means.contraction, self.means.pressure)
        columns = columns * (tension > 0)[:, None]
        others = [name for name in names if name not in self.law_names]
        # One pass along the way for all difference quotients of the friction.
        by_law = _SMALL / np.maximum(np.abs(columns).max(axis=0, initial=0.0), 1e-300)
        small = np.array([*by_law, *map(self._small, others)])
        moved = [dict(values) for _ in names]
        for k, name in enumerate(others):
            moved[len(of_law) + k][name] += small[len(of_law) + k]
        tensions = np.repeat(tension[:, None], len(names) + 1, axis=1)
        tensions[:, 1 : len(of_law) + 1] += columns * small[: len(of_law)]
        friction = self._friction(np.maximum(tensions, 0.0), [values, *moved])
        slopes = (friction[:, 1:] - friction[:, :1]) / small
        slopes[:, : len(of_law)] += columns
        return np.concatenate([slopes, self.drift.points], axis=1)[self.used]

    def _small(self, name: str) -> float:
        return {"half_width": _RELATIVE, "growth": _RELATIVE / self._pressures, "log_presliding": _RELATIVE}[name]

    @cached_property
    def _pressures(self) -> float:
        return max(float(np.abs(self.means.pressure - self.reference_pressure).max()), 1.0)

    def _tension(self, values: Mapping[str, float]) -> NDArray[np.float64]:
        return np.maximum(forces(self.law(values), self.means.contraction, self.means.pressure), 0.0)

    def _friction(self, tension: NDArray[np.float64], sets: Sequence[Mapping[str, float]]) -> NDArray[np.float64]:
        """For each column of tensions and its values, shape (rows, sets)."""
        half_width, growth, log_presliding = (np.array([values[name] for values in sets]) for name in FRICTION)
        above = self.means.pressure - self.reference_pressure
        limit = faded(half_width + growth * above[:, None], tension, np)
        share, stiffness = polygon(self.elements)
        stiffness = stiffness * (half_width / np.exp(log_presliding))[:, None]
        place = self.strokes.place
        deflections = drawn(
            self.strokes.travel[..., None], limit[place], stiffness, share, side=self.strokes.side[:, None]
        )
        return self.strokes.scattered(np.einsum("pwse,se->pws", deflections, stiffness))
