"""Figures of identification: ranking, uncertainty and hysteresis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.identification.grouping import held_values
from mckibben.identification.loading_path import with_last_motion
from mckibben.report.palette import BLACK, BLUE, ORANGE
from mckibben.report.style import (
    DOUBLE,
    Look,
    beside,
    blank,
    draw_band,
    draw_points,
    legend_above,
    letter,
    panels,
    plain_numbers,
    pressure_colours,
    styled,
)
from mckibben.units import bar, percent

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset
    from mckibben.identification import Fit, HysteresisFit, RankedLaw, Ranking

_MOST = 6  # laws whose residuals are drawn, and pressures with their own panel
_LOOKS: dict[str, Look] = {
    "seen": {"color": "#888888", "marker": "|", "label": "fitted points"},
    "pressure": {"color": BLUE, "marker": "o", "label": "held-out inner pressures"},
    "contraction": {"color": ORANGE, "marker": "v", "label": "held-out contractions"},
}


@styled
def ranking(ranked: Ranking) -> Figure:
    """Cross-validation errors of all laws, and residuals of the best six, coloured by pressure.

    Upper panel: RMSE [N] of the fitted points and of each kind of held-out block, on a logarithmic axis; laws are in
    the order of the ranking, with their number of parameters, flagged ones shaded. Lower panels: measured minus fitted
    force [N] over contraction [%].

    Parameters
    ----------
    ranked
        Result of `mckibben.identification.rank`.
    """
    fitted = [entry for entry in ranked.entries if entry.fit]
    drawn = fitted[:_MOST]
    rows = -(-len(drawn) // 3)
    above = 0.26 * max(len(fitted), 3) + 0.9
    figure = blank(DOUBLE, above + 1.75 * rows)
    upper, lower = (
        figure.add_subfigure(area) for area in figure.add_gridspec(2, 1, height_ratios=[above, 1.75 * rows])
    )
    _errors(upper.subplots(), fitted, ranked)
    levels = ranked.points.pressures / bar
    scale = Normalize(float(levels.min()), float(levels.max()) if len(levels) > 1 else float(levels.min()) + 1)
    grid = panels(lower, len(drawn), 3, sharex=True)
    for i, (axes, entry) in enumerate(zip(grid, drawn, strict=True)):
        _residuals(axes, entry, scale)
        letter(axes, i + 1, _short(entry.law))
        if i % 3 == 0:
            axes.set_ylabel("measured − law [N]")
        axes.set_xlabel("contraction [%]")
        axes.xaxis.set_tick_params(labelbottom=True)
    shades = ScalarMappable(scale, pressure_colours())
    lower.colorbar(shades, ax=list(grid), fraction=0.03, pad=0.01, label="pressure [bar]")
    return figure


def _errors(axes: Axes, fitted: list[RankedLaw], ranked: Ranking) -> None:
    """Draw the RMSE [N] of each law, for fitted points and for each kind of held-out block."""
    places = np.arange(len(fitted))
    kinds = {"seen": [entry.fit.rmse if entry.fit else np.nan for entry in fitted]}
    for name in ranked.blocks:
        kinds[name] = [entry.held_out.get(name, np.nan) for entry in fitted]
    for name, errors in kinds.items():
        size = 60 if name == "seen" else 26
        axes.scatter(errors, places, s=size, zorder=3 + (name != "seen"), **_LOOKS[name])
    for place, entry in zip(places, fitted, strict=True):
        if entry.flags:
            axes.axhspan(place - 0.5, place + 0.5, color=ORANGE, alpha=0.14, linewidth=0, zorder=0)
    axes.set_yticks(places, [f"{_short(entry.law)} ({entry.parameters})" for entry in fitted])
    axes.invert_yaxis()
    axes.set_xscale("log")
    plain_numbers(axes.xaxis)
    axes.set_xlabel("RMSE [N]")
    axes.grid(axis="x", which="both", alpha=0.3)
    order = "by cross-validation error" if ranked.blocks else "by AICc (no block could be held out)"
    letter(axes, 0, f"laws (number of parameters), {order}")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), framealpha=0.95)
    if any(entry.flags for entry in fitted):
        beside(axes, "shaded: flagged, see the table")


def _residuals(axes: Axes, entry: RankedLaw, scale: Normalize) -> None:
    """Draw the residuals [N] of a law over contraction [%], coloured by pressure."""
    assert entry.fit is not None
    residuals = entry.fit.residuals
    assert residuals is not None
    points = entry.fit.require_regression().points
    axes.axhline(0, color="#888888", linewidth=0.6, zorder=1)
    axes.scatter(
        points.contraction / percent,
        residuals,
        c=points.levels / bar,
        cmap=pressure_colours(),
        norm=scale,
        s=8,
        linewidth=0,
        zorder=2,
    )
    largest = float(np.abs(residuals).max())
    axes.set_ylim(-1.15 * largest, 1.6 * largest)


def _short(law: str) -> str:
    """Name of a law without its ending.

    >>> _short("ExponentialLaw")
    'Exponential'
    """
    return law.removesuffix("Law")


_MEAN: Look = {"color": BLUE, "alpha": 0.45, "zorder": 2}


@styled
def force_bands(dataset: IsobaricDataset, fit: Fit, *, level: float = 0.95) -> Figure:
    """Fitted law with its pointwise confidence band (inner) and the prediction band of a plateau mean (outer).

    Upper panels: force [N] over contraction [%] at up to six pressures; lower panels: the same minus the fitted force,
    with the share of the points inside the prediction band, and its median half width.

    Parameters
    ----------
    dataset
        Points of the fit, or new ones.
    fit
        Fitted law.
    level
        Coverage of the bands [-].
    """
    taut = dataset.taut
    levels = _spread(taut.pressures)
    figure = blank(DOUBLE if len(levels) > 2 else 5.4, 4.2)
    grid = figure.subplots(
        2, len(levels), squeeze=False, sharex=True, sharey="row", gridspec_kw={"height_ratios": [1.5, 1]}
    )
    first, last = float(taut.contraction.min()), float(taut.contraction.max())
    for i, pressure in enumerate(levels):
        points = taut.at(float(pressure))
        along = np.linspace(first, min(last, float(points.contraction.max()) + 0.02), 200)
        band = fit.force_intervals(along, float(pressure), level=level)
        for axes, offset in ((grid[0, i], 0.0), (grid[1, i], band.confidence.value)):
            outer, inner = band.prediction, band.confidence
            x, width = along / percent, f"{100 * level:g} %"
            draw_band(axes, x, outer.lower - offset, outer.upper - offset, label=f"{width} prediction band")
            draw_band(axes, x, inner.lower - offset, inner.upper - offset, label=f"{width} confidence band", **_MEAN)
            axes.plot(x, band.confidence.value - offset, label="fitted law", **_MODEL)
        there = fit.force_intervals(points.contraction, points.pressure, level=level)
        look: Look = {"markersize": _size(points), "zorder": 4}
        draw_points(grid[0, i], points, points.force, **look)
        draw_points(grid[1, i], points, points.force - there.confidence.value, **look)
        inside = np.mean(there.prediction.contains(points.force))
        half = np.median(there.prediction.upper - there.prediction.value)
        grid[1, i].set_title(f"{100 * inside:.0f} % in ±{half:.2g} N", fontsize=7, loc="left")
        letter(grid[0, i], i, f"{pressure / bar:.3g} bar")
        grid[1, i].set(xlabel="contraction [%]")
    grid[0, 0].set(ylabel="force [N]", ylim=(min(0.0, float(taut.force.min())), 1.06 * float(taut.force.max())))
    grid[1, 0].set(ylabel="measured − fitted [N]")
    legend_above(figure, *grid.ravel())
    return figure


def _size(points: IsobaricDataset) -> float:
    """Size of markers, smaller for many points, which would hide curves and bands."""
    return max(0.8, 2.6 * min(1.0, (600 / max(1, len(points))) ** 0.5))


_CONTRACTION = "contraction [%]"
_MODEL = {"color": BLACK, "linewidth": 0.8, "zorder": 4}


@styled
def loops(dataset: IsobaricDataset, fit: HysteresisFit) -> Figure:
    """Hysteresis loops, measured and modelled: force [N], and friction force [N] by pressure, or by load if it is held.

    Parameters
    ----------
    dataset
        Points from which the friction was identified.
    fit
        Law with friction, fitted to them.

    Raises
    ------
    RangeError
        If the dataset is not the identified one.
    """
    means = with_last_motion(dataset)
    if len(means) != len(fit.residuals):
        raise RangeError(
            f"the hysteresis was identified from {len(fit.residuals)} points, the dataset has {len(means)}",
            remedy="use the dataset of the identification",
        )
    held = held_values(means)
    scale, unit = (bar, "bar") if np.array_equal(held, means.levels) else (1.0, "N")
    levels = _spread(np.unique(held[fit.tension > 0]))
    columns = min(3, len(levels))
    below = 1.75 * -(-len(levels) // columns)
    figure = blank(DOUBLE, 3.0 + below)
    areas: Any = figure.subfigures(2, 1, height_ratios=[3.0, below])
    upper, lower = areas
    curves = upper.subplots()
    _forces(curves, means, fit, held)
    letter(curves, 0, "force")
    grid = panels(lower, len(levels), columns, sharex=True, sharey=True)
    for i, (axes, level) in enumerate(zip(grid, levels, strict=True)):
        error = _loop(axes, means, fit, held, level)
        letter(axes, i + 1, f"{level / scale:.4g} {unit}, RMSE {error:.2g} N")
        axes.set(xlabel=_CONTRACTION, ylabel="friction [N]")
        axes.label_outer()
    return figure


def _spread(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """At most `_MOST` levels from the lowest to the highest."""
    return levels[np.linspace(0, len(levels) - 1, min(len(levels), _MOST)).round().astype(int)]


def _forces(axes: Axes, means: IsobaricDataset, fit: HysteresisFit, held: NDArray[np.float64]) -> None:
    """Draw all points, and the modelled force of each pass."""
    force, model = means.force - fit.offset, fit.tension + fit.friction_force
    draw_points(axes, means, force, markersize=_size(means))
    for rows in _passes(means, held):
        axes.plot(means.contraction[rows] / percent, model[rows], label="law and friction", **_MODEL)
    friction = fit.friction
    title = f"half width {friction.half_width:.3g} N at {friction.reference_pressure / bar:.3g} bar"
    if friction.growth:
        title += f", {friction.growth * bar:+.2g} N/bar"
    labels = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(labels.values(), labels, loc="upper right", title=title, title_fontsize=7.5, alignment="left")
    axes.set(xlabel=_CONTRACTION, ylabel="force [N]")


def _loop(axes: Axes, means: IsobaricDataset, fit: HysteresisFit, held: NDArray[np.float64], level: float) -> float:
    """Draw the friction force at a held pressure or load, measured and modelled; return the RMSE [N]."""
    here = (held == level) & (fit.tension > 0)
    draw_points(axes, means.select(here), (fit.residuals + fit.friction_force)[here], markersize=_size(means))
    for rows in _passes(means, held):
        if here[rows].any():
            rows = rows[here[rows]]
            axes.plot(means.contraction[rows] / percent, fit.friction_force[rows], **_MODEL)
    axes.axhline(0.0, color="#999999", linewidth=0.5, zorder=0)
    return float(np.sqrt(np.mean(fit.residuals[here] ** 2)))


def _passes(means: IsobaricDataset, held: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Rows of each pass at a held pressure or load, in temporal order."""
    time = means.table["time"].to_numpy() if "time" in means.table else np.arange(len(means))
    order = np.argsort(time, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(held[order])) + 1)
