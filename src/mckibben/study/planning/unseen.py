"""What the points at hand cannot tell, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.study.planning.candidates import States
from mckibben.study.planning.quantities import in_words
from mckibben.units import bar, percent

_SAME = 0.1 * percent  # contractions that are nearer are one place
_VAGUE = 2.0  # a force is vague where its standard error is so many times that of a single point
_NAMED = 6


def about_coverage(points: IsobaricDataset, measured: IsobaricDataset, states: States) -> list[str]:
    """What was never measured: ends of the range, slack pressures, directions, repeats, times.

    Parameters
    ----------
    points
        The taut points.
    measured
        All of them.
    states
        Those that can be measured.
    """
    said = []
    dead = [p for p in measured.pressures if measured.slack[measured.levels == p].all()]
    if dead:
        listed = ", ".join(f"{p / bar:.4g}" for p in dead[:_NAMED]) + (" ..." if len(dead) > _NAMED else "")
        said.append(f"at {listed} bar all points are slack: they do not say how strong the muscle is there")
    if not len(points):
        return [*said, "no point is taut: nothing is known of the force but that it is small"]
    said += _ends(points, states)
    table = measured.table
    directions = list(measured.directions)
    if not directions:
        said.append(
            "directions are not recorded: whether friction is in the forces cannot be seen, and the plan takes them "
            "for free of it"
        )
    elif len(directions) == 1:
        other = "unloading" if directions[0] == "loading" else "loading"
        said.append(
            f"all points are {directions[0]}: the data at hand cannot tell friction from force; measure {other} too"
        )
    keys = [np.round(points.contraction / _SAME), points.levels]
    keys += [np.unique(points.table["direction"].to_numpy(), return_inverse=True)[1]] if directions else []
    if len(np.unique(np.stack(keys), axis=1).T) == len(points):
        said.append("nothing was measured twice: what the law misses and what the rig scatters cannot be told apart")
    if "time" not in table:
        said.append("times are not recorded: drift and creep cannot be seen")
    return said


def about_parameters(
    names: Sequence[str],
    combinations: NDArray[np.float64],
    values: NDArray[np.float64],
    errors: NDArray[np.float64],
) -> list[str]:
    """Which parameters the points do not determine, together or alone.

    Parameters
    ----------
    names
        Of the parameters, friction included.
    combinations
        Shape (parameters, combinations), each in units of 1 N: what leaves all measured forces as they are.
    values, errors
        Shape (parameters,): estimates and standard errors; infinite where there is none.
    """
    said = []
    tied = np.zeros(len(names), bool)
    if combinations.shape[1]:
        share = np.abs(combinations).max(axis=1)
        tied = share > 0.05 * share.max()
        count = combinations.shape[1]
        which = ", ".join(name for name, part in zip(names, tied, strict=True) if part)
        ways = "one way" if count == 1 else f"{count} ways"
        said.append(f"{which} can change together, in {ways}, and leave all measured forces as they are")
    with np.errstate(invalid="ignore"):
        vague = np.isfinite(errors) & (errors > np.abs(values)) & ~tied
    if vague.any():
        which = ", ".join(name for name, part in zip(names, vague, strict=True) if part)
        said.append(f"{which}: the standard error is larger than the value")
    return said


def about_force(states: States, errors: NDArray[np.float64], point: float) -> list[str]:
    """Where the force that the law predicts is hardly known.

    Parameters
    ----------
    states
        Those that can be measured.
    errors
        Shape (pressures, contractions): standard error of the law's force [N]; infinite where it is not determined.
    point
        That of a single point [N].
    """
    allowed = states.allowed
    unknown, vague = allowed & np.isinf(errors), allowed & np.isfinite(errors) & (errors > _VAGUE * point)
    said = []
    if unknown.any():
        part = np.count_nonzero(unknown) / np.count_nonzero(allowed)
        said.append(f"at {100 * part:.0f} % of the states that can be measured the law has no determined force")
    if vague.any():
        part = np.count_nonzero(vague) / np.count_nonzero(allowed)
        row, column = np.unravel_index(np.argmax(np.where(vague, errors, 0)), errors.shape)
        where = in_words(float(states.contractions[column]), float(states.pressures[row]))
        said.append(
            f"at {_share(part)} of the states that can be measured the force is uncertain by more than {_VAGUE:g} "
            f"times a single point's {point:.2g} N; worst, {errors[row, column]:.3g} N, at {where}"
        )
    return said


def _ends(points: IsobaricDataset, states: States) -> list[str]:
    """Where the range that can be measured goes on and the points do not."""
    rows, columns = states.places.T
    said = []
    step = float(np.diff(states.contractions[:2]).sum()) if len(states.contractions) > 1 else 0.0
    low, high = points.contraction.min(), points.contraction.max()
    first, last = states.contractions[columns].min(), states.contractions[columns].max()
    if first < low - max(step, _SAME):
        stretched = " (the muscle stretched beyond its length)" if first < 0 <= low else ""
        said.append(
            f"no point below {low / percent:.3g} % contraction, where {first / percent:.3g} % is allowed{stretched}"
        )
    if last > high + max(step, _SAME):
        said.append(
            f"no taut point above {high / percent:.3g} % contraction, where {last / percent:.3g} % can be reached"
        )
    low, high = points.levels.min(), points.levels.max()
    first, last = states.pressures[rows].min(), states.pressures[rows].max()
    step = float(np.diff(states.pressures[:2]).sum()) if len(states.pressures) > 1 else 0.0
    if first < low - max(step, 1e3):
        said.append(f"no taut point below {low / bar:.3g} bar, where the law has a force down to {first / bar:.3g} bar")
    if last > high + max(step, 1e3):
        said.append(f"no point above {high / bar:.3g} bar, where {last / bar:.3g} bar is allowed")
    return said


def _share(part: float) -> str:
    return f"{100 * part:.0f} %" if part >= 0.01 else "under 1 %"
