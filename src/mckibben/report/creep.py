"""The figure of a muscle's creep: how the force moves within plateaus, measured and as the identified arm has it."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import RangeError
from mckibben.identification.courses import Courses
from mckibben.identification.creep_fit import CreepFit
from mckibben.identification.strokes import Strokes
from mckibben.muscle import MaxwellCreep
from mckibben.report.panels import letter
from mckibben.report.style import BLACK, DOUBLE, LOADING, UNLOADING, blank, styled

_MODEL: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "zorder": 4}
_MOST = 20  # moves since the turn


@styled
def relaxation(dataset: IsobaricDataset, found: CreepFit) -> Figure:
    """How the force goes back within plateaus: on average over time, and how fast by the number of moves since a turn.

    Bars are one standard error, over plateaus. What drifts in common is taken off.

    Parameters
    ----------
    dataset
        The one that the creep was identified from, with its samples.
    found
        Of `identify_creep`.

    Raises
    ------
    RangeError
        If the dataset has another number of points, or no samples.
    """
    if len(dataset) != len(found.relaxing) or "force_samples" not in dataset.table:
        raise RangeError(
            f"the creep is of the samples of {len(found.relaxing)} points, the dataset has {len(dataset)} points"
            + (" and no samples" if "force_samples" not in dataset.table else ""),
            remedy="give the dataset that it was identified from",
        )
    means = dataset.plateau_means()
    measured = Courses.of(dataset.table["force_samples"].to_numpy(), found.interval)
    modelled = Courses.of(found.course(measured.times), found.interval)
    taut = ~means.slack
    side, moves = _since_turn(Strokes.of(means))
    figure = blank(DOUBLE, 2.7)
    courses, slopes = figure.subplots(1, 2)
    _courses(courses, measured, modelled, found, taut, side)
    _slopes(slopes, measured, modelled, found, taut, side, moves)
    return figure


def _since_turn(strokes: Strokes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Shape (rows,): the side of the last move, and how many went that way in a row; 0 where there was none."""
    sides = np.sign(np.where(np.abs(strokes.travel) > 1e-9, strokes.travel, 0.0))
    counts = np.zeros(sides.shape)
    way, run = np.zeros(sides.shape[1]), np.zeros(sides.shape[1])
    for k, now in enumerate(sides):
        run = np.where(now == 0, run, np.where(now == way, run + 1, 1))
        way = np.where(now == 0, way, now)
        counts[k] = np.where(now == 0, 0, run)
    return strokes.scattered(sides), strokes.scattered(counts).astype(np.int64)


def _courses(
    axes: Axes,
    measured: Courses,
    modelled: Courses,
    found: CreepFit,
    taut: NDArray[np.bool_],
    side: NDArray[np.float64],
) -> None:
    edges = np.append(measured.edges, len(measured.times)) * found.interval
    times = (edges[:-1] + edges[1:] - found.interval) / 2
    common = found.common_rate * measured.blocks(measured.times)
    for sign, look in ((1, LOADING), (-1, UNLOADING)):
        here = taut & (side == sign)
        values = measured.values[here] - common
        error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
        axes.errorbar(times, values.mean(axis=0) * 1e3, error * 1e3, linestyle="none", markersize=3, **look)
        axes.plot(times, modelled.values[here].mean(axis=0) * 1e3, **_MODEL)
    axes.set(xlabel="time since the first sample [s]", ylabel="force less its mean [mN]")
    letter(axes, "a", "mean over plateaus")


def _slopes(
    axes: Axes,
    measured: Courses,
    modelled: Courses,
    found: CreepFit,
    taut: NDArray[np.bool_],
    side: NDArray[np.float64],
    moves: NDArray[np.int64],
) -> None:
    slope, model = measured.slopes - found.common_rate, modelled.slopes
    for sign, look, label in ((-1, UNLOADING, "after shortening"), (1, LOADING, "after stretching")):
        here = taut & (side == sign)
        counts = [n for n in range(1, _MOST + 1) if np.count_nonzero(here & (moves == n)) > 1]
        groups = [slope[here & (moves == n)] * 1e3 for n in counts]
        errors = [group.std(ddof=1) / np.sqrt(len(group)) for group in groups]
        heights = [group.mean() for group in groups]
        axes.errorbar(counts, heights, errors, linestyle="none", markersize=3, label=label, **look)
        modelled_heights = [model[here & (moves == n)].mean() * 1e3 for n in counts]
        axes.plot(counts, modelled_heights, label="one arm" if sign > 0 else None, **_MODEL)
    axes.axhline(0.0, color="#999999", linewidth=0.5, zorder=0)
    axes.set(xlabel="moves since the turn", ylabel="slope within a plateau [mN/s]")
    creep = found.creep
    title = (
        f"{creep.stiffness / 1e3:.3g} N/mm, {creep.time_constant:.3g} s"
        if isinstance(creep, MaxwellCreep)
        else "no creep seen"
    )
    axes.legend(title=title, title_fontsize=7.5, alignment="left", loc="center right")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    letter(axes, "b", "how fast it goes back")
