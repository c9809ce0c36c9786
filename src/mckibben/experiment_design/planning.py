"""Planning of the next test: from prior data to the design of measurement points."""

from __future__ import annotations

import numpy as np

from mckibben.component.calls import checked_call
from mckibben.component.checks import check_positive
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.experiment_design.candidates import REPEATS, CandidateSet, StateGrid, design_region
from mckibben.experiment_design.information import (
    ErrorEstimator,
    ExchangeProblem,
    Floats,
    IdentifiableSubspace,
    condensed,
    exchange,
    information_matrix,
)
from mckibben.experiment_design.prior import PriorData
from mckibben.experiment_design.quantities import QuantityOfInterest
from mckibben.experiment_design.result import ErrorMap, ExperimentPlan, PlannedPoint
from mckibben.identification import Fit
from mckibben.muscle import Domain, ForceLaw, Specimen
from mckibben.units import Contraction, Force, Pressure, bar

_UNIDENTIFIABLE = 1e-6  # relative part in the null space


@checked_call
def plan(
    data: IsobaricDataset | Fit,
    quantity: QuantityOfInterest,
    law_type: type[ForceLaw] | None = None,
    *,
    points: int = 8,
    limits: Domain | None = None,
    specimen: Specimen | None = None,
    contraction_step: Contraction | None = None,
    pressure_step: Pressure = 0.25 * bar,
    noise: Force | None = None,
) -> ExperimentPlan:
    r"""Plan the measurement points that most reduce the standard error of a quantity.

    A locally optimal exact design: the law is linearised in its parameters about the fit, and points are chosen from a
    grid by an exchange algorithm, at most twice each. The covariance of the parameters after a design is

    .. math:: \Sigma = \Bigl(\sum_s J_s^T (\sigma^2 I + \tau^2 1 1^T)^{-1} J_s\Bigr)^{-1}

    with the derivatives J of the forces, the standard deviation sigma of a point, and tau of the error that the points
    of a stroke s share. Where directions are recorded, half the gap between them is an unknown of the fit: points of
    one direction alone do not distinguish it from the force.

    Parameters
    ----------
    data
        Measured points, or a fit to them.
    quantity
        `Coefficient`, `Force` or `JointStiffness`.
    law_type
        Kind of law. Default: that of the fit.
    points
        Number of points, 1 to 200.
    limits
        Limits of contraction and pressure. Default: those of the specimen, or of the data.
    specimen
        Range, rating and length of the muscle. Default: the catalog entry named in the data.
    contraction_step, pressure_step
        Resolution of the rig [-], [Pa]. Default: 1 mm (0.5 % of an unknown length), and 0.25 bar.
    noise
        Standard deviation of a point [N]. Default: estimated from residuals.

    Raises
    ------
    IdentificationError
        If no measurement within the limits reduces the error, or the data determine no law.
    RangeError
        If nothing can be measured within the limits, or a number is out of range.
    ParameterError
        If the law has no such coefficient, or the kind of law is missing.

    References
    ----------
    V. V. Fedorov, Theory of Optimal Experiments, Academic Press 1972 (exchange); A. C. Atkinson, A. N. Donev and R. D.
    Tobias, Optimum Experimental Designs, with SAS, Oxford 2007, ch. 10 (criteria) and 17 (nonlinear models).

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.experiment_design import Coefficient
    >>> from mckibben.muscle import ExponentialLaw
    >>> data = catalog.dataset("dmsp-10-250-martens2017")
    >>> found = plan(data, Coefficient("decay"), ExponentialLaw, points=4)
    >>> found.error_after < found.error_now
    True
    """
    if not 1 <= points <= 200:
        message = f"{points} points are not within 1..200"
        raise RangeError(message, field="points", value=points, lower=1, upper=200)
    if noise is not None:
        check_positive("plan", "N", noise=noise)
    prior = PriorData.of(data, law_type, noise)
    region, notes = design_region(prior, limits, specimen, contraction_step, pressure_step)
    states = StateGrid.of(prior.law, region)
    candidates = CandidateSet.of(prior, states)
    if len(candidates.rows) < points:
        message = f"there are {len(candidates.rows)} candidates for {points} points"
        remedy = "choose finer steps, wider limits or fewer points"
        raise RangeError(message, value=points, upper=len(candidates.rows), remedy=remedy)
    linear = quantity.linearize(prior.law, states)
    gradients = np.pad(linear.gradients, ((0, 0), (0, prior.friction)))  # friction itself is of no interest
    subspace = IdentifiableSubspace.of(np.concatenate([candidates.rows[::REPEATS], prior.rows]))
    _check_identifiable(quantity, gradients, subspace, prior)
    targets = condensed(gradients @ subspace.basis)
    # prior standard deviation: 100 of the largest forces; a weaker prior would be lost in rounding
    weakest = 1 / (100 * float(states.force[states.allowed].max())) ** 2, 1e-10 / prior.noise.point**2
    weak = np.eye(subspace.basis.shape[1]) * max(weakest)
    prior_information = information_matrix(prior.rows @ subspace.basis, prior.strokes, prior.noise)
    rows = candidates.rows @ subspace.basis
    problem = ExchangeProblem(rows, candidates.strokes, prior_information + weak, prior.noise, targets)
    estimator = ErrorEstimator(prior_information, weak)

    chosen = exchange(problem, points)
    added = [problem.added(chosen[: i + 1]) for i in range(points)]
    errors = [estimator.error(targets), *(estimator.error(targets, more) for more in added)]
    unit_vectors = np.eye(len(prior.names))
    unidentifiable = subspace.unidentifiable_part(unit_vectors) > _UNIDENTIFIABLE
    now, after = (
        np.where(unidentifiable, np.inf, estimator.errors(unit_vectors @ subspace.basis, more))
        for more in (0.0, added[-1])
    )
    force_rows = candidates.rows[:: REPEATS * len(candidates.directions)].copy()
    force_rows[:, len(prior.parameters) :] = 0.0  # the law's force, midway between the directions
    maps = np.full((2, *states.allowed.shape), np.nan)
    maps[:, states.allowed] = [estimator.errors(force_rows @ subspace.basis, more) for more in (0.0, added[-1])]
    free = np.concatenate([subspace.null_space, estimator.undetermined(subspace)], axis=1)
    planned = [
        PlannedPoint(*point, standard_error=error, gain=float(1 - np.nan_to_num(error / before, nan=1.0)))
        for point, before, error in zip(candidates.points(chosen), errors, errors[1:], strict=False)
    ]
    risky = estimator.errors(problem.rows[chosen])
    overload = _overload_note([point.force for point in planned], risky, region.force_max)
    return ExperimentPlan(
        quantity=quantity,
        law=prior.law,
        points=tuple(planned),
        error_now=errors[0],
        error_after=errors[-1],
        value=float(linear.values[0]) if len(linear.values) == 1 else None,
        parameter_errors={name: (float(now[i]), float(after[i])) for i, name in enumerate(prior.parameters)},
        noise=prior.noise,
        half_width=prior.half_width if prior.friction and np.isfinite(now[-1]) else None,
        diagnostics=_diagnostics(prior, free),
        notes=(*prior.notes, *notes, *linear.warnings, *overload),
        measured=prior.measured,
        map=ErrorMap(states, *maps),
        target_states=linear.states,
    )


def _overload_note(force: list[float], errors: Floats, force_max: float) -> list[str]:
    """Points whose force may exceed the limit by two standard errors."""
    over = [str(i + 1) for i in np.flatnonzero(np.isfinite(errors) & (np.array(force) + 2 * errors > force_max))]
    if not over:
        return []
    places = f"point{'s' * (len(over) > 1)} {', '.join(over)}"
    return [f"the force may exceed {force_max:.0f} N at {places}, given the present uncertainty: approach slowly"]


def _diagnostics(prior: PriorData, free: Floats) -> tuple[str, ...]:
    """Sentences on the limits of the prior data; `free`: combinations of unknowns that do not change any force."""
    texts = []
    if count := free.shape[1]:
        names = _tied(prior.names, free)
        texts.append(f"not identifiable: {count} combination{'s' * (count > 1)} of {names} affect no measured force")
    directions = list(prior.measured.directions)
    if not directions:
        texts.append("directions are not recorded: friction cannot be identified, and the plan assumes none")
    elif len(directions) == 1:
        (other,) = {"loading", "unloading"} - set(directions)
        texts.append(f"all points are {directions[0]}: friction is not distinguished from force; measure {other} too")
    return tuple(texts)


def _tied(names: list[str], space: Floats) -> str:
    """Names of the unknowns that take part in combinations, shape (unknowns, combinations)."""
    share = np.abs(space).max(axis=1)
    return ", ".join(name for name, amount in zip(names, share, strict=True) if amount > 0.05 * share.max())


def _check_identifiable(
    quantity: QuantityOfInterest, gradients: Floats, subspace: IdentifiableSubspace, prior: PriorData
) -> None:
    """Raise an error for a quantity whose error no measurement reduces."""
    if not np.abs(gradients / subspace.scale).max() > 1e-9:  # per newton, to rounding
        raise IdentificationError(
            f"{quantity}: nothing to gain, it does not depend on the law's parameters there (both muscles slack, or "
            "their errors cancel)",
            remedy="choose another angle or other pressures",
        )
    if (subspace.unidentifiable_part(gradients) > _UNIDENTIFIABLE).any():
        raise IdentificationError(
            f"{quantity} is not identifiable within the limits: {_tied(prior.names, subspace.null_space)} can change "
            "together without changing any measurable force",
            remedy="use a law with fewer parameters, or wider limits",
        )
