r"""Uncertainty of a joint's torque and stiffness from the fits of its muscles.

Delta method, with gradients by forward differentiation through the joint. Two muscles with the same fit share its
errors, which partly cancel in the torque of a symmetric joint and add up in its stiffness. Two fits are independent.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import ParameterError
from mckibben.identification.estimator import IntervalEstimate, check_level, t_interval, variance_of
from mckibben.identification.fit import Fit
from mckibben.joint import AntagonisticJoint
from mckibben.joint.antagonistic import pressure_pair
from mckibben.muscle import ForceLaw
from mckibben.numerics.compiled import jit


@dataclass(frozen=True)
class JointBands:
    """Torque [N*m] and stiffness [N*m/rad] of a joint with intervals."""

    torque: IntervalEstimate
    stiffness: IntervalEstimate
    may_be_slack: NDArray[np.bool_]  # the interval of a muscle's force includes zero: the bands are too narrow


def joint_bands(
    joint: AntagonisticJoint,
    fits: Fit | tuple[Fit, Fit],
    angle: ArrayLike,
    pressures: tuple[ArrayLike, ArrayLike],
    *,
    level: float = 0.95,
) -> JointBands:
    """Torque and stiffness of a joint with their uncertainty; a slack muscle contributes nothing.

    Raises `IdentificationError` if a fit was read from a file; `ParameterError` if there are not one or two fits.

    Parameters
    ----------
    joint
        Joint; its muscles get the laws of the fits.
    fits
        One fit for both muscles, with common errors, or one independent fit per muscle.
    angle, pressures
        Angle [rad] and gauge pressures [Pa]; they broadcast.
    level
        As for `Fit.intervals`.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.identification import fit_law
    >>> from mckibben.muscle import ExponentialLaw
    >>> from mckibben.units import bar
    >>> fit = fit_law(ExponentialLaw, catalog.dataset("festo-tool-10mm"))
    >>> bands = joint_bands(catalog.joint("knee-table-2"), fit, 0.0, (3 * bar, 3 * bar))
    >>> print(f"{float(bands.stiffness.value):.1f} +- {float(bands.stiffness.standard_error):.1f} N*m/rad")
    52.3 +- 0.3 N*m/rad
    >>> float(bands.torque.standard_error) < 1e-12  # both muscles err alike
    True
    """
    check_level(level)
    common = isinstance(fits, Fit)
    pair: Sequence[Fit] = (fits,) if common else fits
    if not all(isinstance(fit, Fit) for fit in pair) or len(pair) not in (1, 2):
        raise ParameterError("a joint has two muscles", remedy="give one fit for both, or a tuple of two")
    both = pair[0], pair[-1]
    values = tuple(np.array(list(fit.estimates.values())) for fit in pair)
    with_laws = eqx.tree_at(lambda j: (j.muscle1.law, j.muscle2.law), joint, tuple(fit.law for fit in both))
    pressures = pressure_pair(pressures)  # type: ignore[arg-type]  # JAX accepts the same arrays as NumPy
    where = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (angle, *pressures)))
    shape = where[0].shape
    answers = torque_and_stiffness_gradients(with_laws, values, *where)
    answers_of_both, gradients, contractions = jax.tree.map(np.asarray, answers)
    bands: list[IntervalEstimate] = []
    for i in range(2):
        parts: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        for fit, gradient in zip(pair, gradients, strict=True):
            regression = fit.require_regression()
            parts.append(variance_of(regression.error_model, gradient[i][..., regression.free]))
        bands.append(t_interval(level, answers_of_both[i], parts))
    doubtful = np.zeros(shape, bool)
    for contraction, pressure, fit in zip(contractions, where[1:], both, strict=True):
        force = fit.force_intervals(contraction, pressure, level=level).confidence
        doubtful |= (force.lower < 0) & (force.upper > 0)
    return JointBands(bands[0], bands[1], doubtful)


@jit
def torque_and_stiffness_gradients(
    joint: AntagonisticJoint, values: tuple[NDArray, ...], angle: NDArray, pressure1: NDArray, pressure2: NDArray
) -> tuple[Array, tuple[Array, ...], tuple[Array, Array]]:
    """Torque and stiffness, shape (2, ...); gradients per fit, shape (2, ..., parameters); contractions."""

    def answer(parameters: tuple[NDArray, ...]) -> Array:
        laws = _with(joint.muscle1.law, parameters[0]), _with(joint.muscle2.law, parameters[-1])
        changed = eqx.tree_at(lambda j: (j.muscle1.law, j.muscle2.law), joint, laws)
        return jnp.stack(changed.torque_and_stiffness(angle, (pressure1, pressure2)))

    return answer(values), jax.jacfwd(answer)(values), joint.contractions(angle, (pressure1, pressure2))


def _with(law: ForceLaw, values: Any) -> ForceLaw:
    names = [p.name for p in type(law).parameters()]
    return dataclasses.replace(law, **dict(zip(names, values, strict=True)))
