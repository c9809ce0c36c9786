"""Style of the figures, and panel elements that several figures share."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

SINGLE, DOUBLE = 3.5, 7.2
"""Widths of one and of two columns of a journal [inches]."""

BLACK, ORANGE, SKY, GREEN, BLUE, VERMILLION, PURPLE = (
    "#111111",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
"""The colours of Okabe and Ito, which people with any kind of colour vision can tell apart."""
BAND = "#DBE2E9"

DESIRED: dict[str, Any] = {"color": BLACK, "linestyle": (0, (4, 2)), "linewidth": 1.0, "zorder": 3}
CONTROLLERS: dict[str, dict[str, Any]] = {
    "PID": {"color": VERMILLION, "linestyle": "-", "marker": "o"},
    "BP": {"color": BLUE, "linestyle": "-", "marker": "s"},
    "PID tuned": {"color": ORANGE, "linestyle": (0, (6, 1.2)), "marker": "D"},
    "BP on tuned gains": {"color": SKY, "linestyle": (0, (3, 1, 1, 1)), "marker": "^"},
    "BP on tuned gains, free": {"color": PURPLE, "linestyle": (0, (1, 1)), "marker": "v"},
}
"""One look a controller in all figures; `look_of` gives others one of their own."""
_SPARE: tuple[dict[str, Any], ...] = (
    {"color": VERMILLION, "linestyle": "-"},
    {"color": BLUE, "linestyle": "-"},
    {"color": GREEN, "linestyle": (0, (6, 1.2))},
    {"color": PURPLE, "linestyle": (0, (3, 1, 1, 1))},
    {"color": ORANGE, "linestyle": (0, (1, 1))},
    {"color": SKY, "linestyle": (0, (5, 1, 1, 1, 1, 1))},
    {"color": BLACK, "linestyle": (0, (2, 1))},
    {"color": "#7F7F7F", "linestyle": "-"},
)

LOADING: dict[str, Any] = {"color": BLUE, "marker": "^"}
UNLOADING: dict[str, Any] = {"color": VERMILLION, "marker": "v"}
EXPERIMENTAL: dict[str, Any] = {"color": "#8E3B8E", "linestyle": "-"}
THEORETICAL: dict[str, Any] = {"color": GREEN, "linestyle": (0, (5, 1.5))}
"""As in the paper's Fig. 4: loading blue, unloading red, the experimental law purple, the theoretical one green."""

P = ParamSpec("P")
R = TypeVar("R")


@contextmanager
def house_style() -> Iterator[None]:
    """The style of `mckibben.mplstyle` on matplotlib's defaults, whatever the user has set; undone afterwards."""
    with resources.as_file(resources.files("mckibben.report") / "mckibben.mplstyle") as path:
        settings = mpl.rc_params_from_file(path, use_default_template=True)
    with mpl.rc_context({name: value for name, value in settings.items() if not name.startswith("backend")}):
        yield


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function that draws: it works in the house style and leaves matplotlib as it was."""

    @functools.wraps(draw)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with house_style():
            return draw(*args, **kwargs)

    return wrapped


def blank(width: float, height: float) -> Figure:
    """An empty figure [inches] that lays itself out; it belongs to no window and no global list."""
    return Figure(figsize=(width, height), layout="constrained")


def looks_of(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Colour and line style by name: the fixed ones of `CONTROLLERS`, and for other names one each that is free."""
    names = list(names)
    taken = {CONTROLLERS[name]["color"] for name in names if name in CONTROLLERS}
    spare = [look for look in _SPARE if look["color"] not in taken] or list(_SPARE)
    looks: dict[str, dict[str, Any]] = {}
    count = 0
    for name in names:
        if name in CONTROLLERS:
            looks[name] = {key: CONTROLLERS[name][key] for key in ("color", "linestyle")}
        else:
            looks[name] = spare[count % len(spare)]
            count += 1
    return looks


def pressure_colours() -> ListedColormap:
    """From low (dark) to high pressure: viridis without its palest end, which is lost on white."""
    colours = mpl.colormaps["viridis"].resampled(256)(range(256))
    return ListedColormap(colours[:222], name="pressure")


@styled
def save(figure: Figure, folder: str | os.PathLike[str], name: str, *, preview: bool = False) -> tuple[Path, Path]:
    """Keep a figure as `name`.png (200 dpi) and `name`.svg in a folder made if need be; a preview as PNG of 100 dpi.

    The same figure gives the same bytes: no date, no random identifiers; letters are kept as outlines, so that the
    SVG needs no font.

    Returns
    -------
    png, svg
        The two files; of a preview the second does not exist.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"
    resolution = mpl.rcParams["savefig.dpi"]
    figure.set_dpi(
        resolution / 2 if preview else resolution
    )  # before the layout: letters are wider or narrower at other resolutions
    engine = figure.get_layout_engine()
    if engine is not None:
        figure.draw_without_rendering()  # lays out once, with all labels there; doing so at every draw takes as long
        figure.set_layout_engine("none")
    # Straight to the canvases: `Figure.savefig` draws everything twice.
    FigureCanvasAgg(figure).print_png(png, metadata={"Software": None})
    if not preview:
        FigureCanvasSVG(figure).print_svg(svg, metadata={"Date": None, "Creator": None})
    return png, svg


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
