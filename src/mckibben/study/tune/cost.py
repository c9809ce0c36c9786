"""Cost of a tuning: a weighted sum of metrics, and its text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.component.base import Checked
from mckibben.component.columns import attributes
from mckibben.errors import ParameterError, UnitError, suggest
from mckibben.simulation import LEAST_DISK_MARGIN, Metrics
from mckibben.units import HINGE, JointType, Quantity, quantity

_PLUS = re.compile(r"(?<![0-9.][eE])\+")  # not the sign of 1e+3
_TERM = re.compile(r"(?:(?P<weight>[0-9.eE+-]+)\s*\*\s*)?(?P<metric>[a-z_]+)\s*(?:/\s*(?P<scale>.+))?")


_Positive = Annotated[float, Quantity("1", "1", 0, 1e300, open_lower=True)]


@dataclass(frozen=True)
class Term(Checked):
    """A metric, its scale [SI] and its weight in a cost.

    Raises `ParameterError` if there is no such metric, `RangeError` if scale or weight are not above 0.

    >>> Term("angle_rms", 0.1)
    Traceback (most recent call last):
        ...
    mckibben.errors.ParameterError: 'angle_rms' is not a metric; did you mean 'angle_rmse'?
    """

    metric: str
    scale: _Positive
    weight: _Positive = 1.0

    def __post_init__(self) -> None:
        if self.metric not in Metrics._fields:
            raise ParameterError(
                f"{self.metric!r} is not a metric", value=self.metric, remedy=suggest(self.metric, Metrics._fields)
            )
        super().__post_init__()


@dataclass(frozen=True)
class Cost(Checked):
    """Weighted sum of metrics over their scales; of a robot, of the means over its joints.

    Errors alone would drive gains to the stability limit. With a gain margin the cost is the larger of two: that of the
    parameters, and that with all tuned controller gains multiplied by the margin.

    Attributes
    ----------
    terms
        Metrics with their scales and weights, each metric once.
    gain_margin
        Factor by which the gains may increase, 1 or more.
    percentile
        Of the cost over scenarios and conditions, above 0 up to 100 (the worst). None: their mean.
    disk_margin
        Least disk margin of the linearised loop that tuned gains keep, 0 (none) to 2.
    joint_type
        How the joint moves, on which the units of its text depend.

    Raises
    ------
    ParameterError
        If there is no term, or a metric appears twice.
    RangeError
        If a margin or the percentile is out of range.

    Examples
    --------
    >>> from mckibben.units import deg
    >>> cost = Cost.of({"angle_rmse": 0.1 * deg, "stiffness_rmse": 0.5})
    >>> round(float(cost({"angle_rmse": 0.2 * deg, "stiffness_rmse": 1.0})), 9)
    4.0
    """

    terms: tuple[Term, ...]
    gain_margin: Annotated[float, Quantity("1", "1", 1, 1e6)] = 1.0
    percentile: Annotated[float, Quantity("1", "1", 0, 100, open_lower=True)] | None = None
    disk_margin: Annotated[float, Quantity("1", "1", 0, 2, open_upper=True)] = LEAST_DISK_MARGIN
    joint_type: JointType = field(default=HINGE, repr=False)

    def __post_init__(self) -> None:
        names = [term.metric for term in self.terms]
        twice = [name for name in names if names.count(name) > 1]
        if not names or twice:
            raise ParameterError(
                f"{twice[0]} appears twice" if twice else "the cost has no term", remedy="name each metric once"
            )
        super().__post_init__()

    @classmethod
    def of(cls, scales: Mapping[str, float], **options: Any) -> Self:
        """Cost from metrics and their scales [SI], with options as for `Cost`."""
        return cls(tuple(Term(name, scale) for name, scale in scales.items()), **options)

    @property
    def metrics(self) -> tuple[str, ...]:
        """Metrics that the cost needs."""
        return tuple(term.metric for term in self.terms)

    def __call__(self, values: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the cost of metrics [SI] of shape (runs,), or (joints, runs), of which it has the means."""
        return np.asarray(sum(term.weight * mean_of_joints(values[term.metric]) / term.scale for term in self.terms))

    @property
    def text(self) -> str:
        """Text from which `parse_cost` restores the cost exactly."""
        return " + ".join(_written(term, self.joint_type) for term in self.terms)


def mean_of_joints(values: ArrayLike) -> NDArray[np.float64]:
    """Return a metric of shape (runs,), or the means over the joints of one of shape (joints, runs)."""
    joints = np.asarray(values)
    return joints.mean(axis=0) if joints.ndim > 1 else joints


def parse_cost(text: str, joint_type: JointType = HINGE, **options: Any) -> Cost:
    """Parse a cost such as ``angle_rmse/0.1 deg + 2*stiffness_rmse/0.5 N*m/rad``, with options as for `Cost`.

    A single metric needs no scale; each of several metrics needs one, since their units differ.

    Raises `ParameterError` if a term is invalid, or its unit does not fit its metric, and as `Cost` and `Term`.

    Examples
    --------
    >>> parse_cost("angle_rmse/0.1 deg + 2*stiffness_rmse/0.5 N*m/rad").terms[1]
    Term(metric='stiffness_rmse', scale=0.5, weight=2.0)
    """
    terms_of_text = [term_text.strip() for term_text in _PLUS.split(text)]
    terms = []
    for term_text in terms_of_text:
        match = _TERM.fullmatch(term_text)
        if match is None:
            raise ParameterError(
                f"{term_text!r} is not a term of a cost", value=term_text, remedy="write it like angle_rmse/0.1 deg"
            )
        metric, scale = match["metric"], match["scale"]
        Term(metric, 1.0)  # raises for an unknown metric
        if scale is None and len(terms_of_text) > 1:
            unit = _unit(metric, HINGE).replace("ratio", "%")
            unit = joint_type.shown("deg" if unit == "rad" else unit)
            raise ParameterError(
                f"{metric} has no scale, and cannot be added to other metrics",
                remedy=f"write it like {metric}/0.1 {unit}",
            )
        try:
            weight = float(match["weight"] or 1.0)
            size = 1.0 if scale is None else quantity(scale, _unit(metric, joint_type))
        except UnitError as error:
            raise ParameterError(f"{term_text!r}: {error}", value=term_text) from None
        except ValueError:
            raise ParameterError(
                f"{match['weight']!r} is not a number", value=term_text, remedy="write 2*metric"
            ) from None
        terms.append(Term(metric, size, weight))
    return Cost(tuple(terms), joint_type=joint_type, **options)


def _written(term: Term, joint_type: JointType) -> str:
    weight = "" if term.weight == 1 else f"{term.weight!r}*"
    return f"{weight}{term.metric}/{term.scale!r} {_unit(term.metric, joint_type)}".replace("+", "")


def _unit(metric: str, joint_type: JointType) -> str:
    """SI unit of a metric; "ratio" for a plain number."""
    unit = attributes(metric, joint_type)["units"]
    return "ratio" if unit == "1" else unit
