"""The figure of a ranking: how far each law is off at what it has not seen, and what it leaves over."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from mckibben.identification import Ranked, Ranking
from mckibben.report.panels import beside, letter
from mckibben.report.style import BLUE, DOUBLE, GREEN, ORANGE, VERMILLION, blank, pressure_colours, styled
from mckibben.units import bar, percent

_SHOWN = 6  # laws whose residuals are drawn
_LOOKS: dict[str, dict[str, Any]] = {
    "seen": {"color": "#888888", "marker": "|", "label": "points fitted to"},
    "pressure": {"color": BLUE, "marker": "o", "label": "unseen pressures"},
    "direction": {"color": VERMILLION, "marker": "D", "label": "unseen direction"},
    "repeat": {"color": GREEN, "marker": "s", "label": "unseen repeats"},
}


@styled
def ranking(found: Ranking) -> Figure:
    """Errors of all laws above, residuals of the best ones below, coloured by pressure."""
    fitted = [entry for entry in found.entries if entry.fit]
    shown = fitted[:_SHOWN]
    rows = -(-len(shown) // 3)
    above = 0.26 * max(len(fitted), 3) + 0.9
    figure = blank(DOUBLE, above + 1.75 * rows)
    upper, lower = (
        figure.add_subfigure(part) for part in figure.add_gridspec(2, 1, height_ratios=[above, 1.75 * rows])
    )
    _errors(upper.subplots(), fitted, found)
    colours = pressure_colours()
    levels = found.points.pressures / bar
    scale = Normalize(float(levels.min()), float(levels.max()) if len(levels) > 1 else float(levels.min()) + 1)
    panels = lower.subplots(rows, 3, squeeze=False, sharex=True).ravel()
    for i, (axes, entry) in enumerate(zip(panels, shown, strict=False)):
        _residuals(axes, entry, found, scale)
        letter(axes, "bcdefg"[i], _short(entry.law))
        if i % 3 == 0:
            axes.set_ylabel("measured − law [N]")
        axes.set_xlabel("contraction [%]")
        axes.xaxis.set_tick_params(labelbottom=True)
    for axes in panels[len(shown) :]:
        axes.remove()
    bar_axes = lower.colorbar(ScalarMappable(scale, colours), ax=list(panels[: len(shown)]), fraction=0.03, pad=0.01)
    bar_axes.set_label("pressure [bar]")
    return figure


def _errors(axes: Axes, fitted: list[Ranked], found: Ranking) -> None:
    places = np.arange(len(fitted))
    kinds = {"seen": [entry.fit.rmse if entry.fit else np.nan for entry in fitted]}
    for name in found.blocks:
        kinds[name] = [entry.unseen[name].rmse if name in entry.unseen else np.nan for entry in fitted]
    for name, errors in kinds.items():
        size = 60 if name == "seen" else 26
        axes.scatter(errors, places, s=size, zorder=3 + (name != "seen"), **_LOOKS[name])
    for place, entry in zip(places, fitted, strict=True):
        if entry.flags:
            axes.axhspan(place - 0.5, place + 0.5, color=ORANGE, alpha=0.14, linewidth=0, zorder=0)
    axes.set_yticks(places, [f"{_short(entry.law)} ({entry.parameters})" for entry in fitted])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("RMSE [N]")
    axes.grid(axis="x", which="both", alpha=0.3)
    order = "the best at unseen points first" if found.blocks else "least AICc first (no block could be held out)"
    letter(axes, "a", f"laws (number of parameters), {order}")
    axes.legend(loc="lower left", framealpha=0.95)
    if any(entry.flags for entry in fitted):
        beside(axes, "shaded: flagged, see the table")


def _residuals(axes: Axes, entry: Ranked, found: Ranking, scale: Normalize) -> None:
    assert entry.fit is not None
    residuals = entry.fit.residuals
    assert residuals is not None
    points = found.points
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
    pattern = entry.structure.pattern if entry.structure else ""
    beside(axes, f"pattern: {pattern}" if pattern else "no pattern", fontsize=6.5)


def _short(law: str) -> str:
    return law.removesuffix("Law")
