"""Small pieces that several figures share: letters of panels, clipped axes that say so, thinned bands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from mckibben.report.style import BAND

_HALO = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
_MOST_VERTICES = 600


def letter(axes: Axes, mark: str, title: str) -> None:
    """Name a panel "(a) title", the letter in bold."""
    axes.set_title(rf"$\bf{{({mark})}}$ {title}")


def robust_limits(
    curves: Sequence[ArrayLike], *, part: float = 0.995, margin: float = 0.12, floor: float = 0.0
) -> tuple[float, float]:
    """Limits of an axis that hold all but the outermost of the values, so that a short spike does not flatten the rest.

    Parameters
    ----------
    curves
        What is drawn; NaN is left out.
    part
        The part of each curve that stays within, counted from both ends.
    margin
        Added on both sides, as a part of the range.
    floor
        The least range.
    """
    finite = [values[np.isfinite(values)] for values in (np.asarray(c, float) for c in curves)]
    finite = [values for values in finite if values.size]
    if not finite:
        return 0.0, 1.0
    low = min(float(np.quantile(values, 1 - part)) for values in finite)
    high = max(float(np.quantile(values, part)) for values in finite)
    short = max(floor - (high - low), 0.0) / 2
    low, high = low - short, high + short
    room = margin * (high - low) or 1.0
    return low - room, high + room


def note_off_scale(
    axes: Axes, times: NDArray[np.float64], curves: dict[str, NDArray[np.float64]], unit: str, *, bottom: bool = False
) -> None:
    """Say in the panel which curves leave its limits, how far they go, and when; nothing where none does."""
    low, high = axes.get_ylim()
    start, end = axes.get_xlim()
    inside = (times >= start) & (times <= end)
    sentences = []
    for name, values in curves.items():
        out = np.where(inside, np.maximum(low - values, values - high), -np.inf)
        if not np.any(out > 0):
            continue
        worst = int(np.nanargmax(out))
        sentences.append(f"{name} {minus(values[worst], '.3g')} {unit} at {times[worst]:.2f} s")
    if sentences:
        axes.text(
            0.985,
            0.03 if bottom else 0.97,
            "off the scale: " + "\n".join(sentences),
            transform=axes.transAxes,
            ha="right",
            va="bottom" if bottom else "top",
            fontsize=6.5,
            color="#555555",
            bbox=_HALO,
            zorder=5,
        )


def minus(value: float, form: str = ".1f") -> str:
    """A number as text with a typographic minus, as on the axes."""
    return format(value, form).replace("-", "−")


def draw_band(axes: Axes, x: ArrayLike, low: ArrayLike, high: ArrayLike, **look: Any) -> None:
    """Shade between two curves, behind everything, with no more vertices than one can see."""
    x, low, high = (np.asarray(values, float) for values in (x, low, high))
    every = max(len(x) // _MOST_VERTICES, 1)
    kept = np.unique(np.append(np.arange(0, len(x), every), len(x) - 1))
    style = {"color": BAND, "linewidth": 0.0, "zorder": 0} | look
    axes.fill_between(x[kept], low[kept], high[kept], **style)


def plain_numbers(axis: Axis) -> None:
    """Label a logarithmic axis with 0.05 in place of 5·10^-2: powers of ten, and where few are in sight 2 and 5 too."""

    def written(value: float, _: object) -> str:
        low, high = axis.get_view_interval()
        first = round(value / 10.0 ** math.floor(math.log10(value) + 1e-9))
        return f"{value:g}" if first == 1 or (first in (2, 5) and high < 30 * low) else ""

    axis.set_major_formatter(written)
    axis.set_minor_formatter(written)
    to_label = mpl.rcParams["xtick.major.size"] + mpl.rcParams["xtick.major.pad"]
    axis.set_tick_params(which="minor", pad=to_label - mpl.rcParams["xtick.minor.size"])  # shorter marks, the same line


def legend_above(figure: Figure, *axes: Axes, columns: int = 5) -> None:
    """One legend for the whole figure, above it: each name once, in order of appearance."""
    found: dict[str, Any] = {}
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(list(found.values()), list(found), loc="outside upper center", ncols=min(columns, len(found)))


def beside(axes: Axes, text: str, **place: Any) -> None:
    """A short remark in the upper right corner of a panel, readable over lines."""
    settings = {"x": 0.985, "y": 0.96, "ha": "right", "va": "top", "fontsize": 7} | place
    axes.text(s=text, transform=axes.transAxes, bbox=_HALO, zorder=5, **settings)
