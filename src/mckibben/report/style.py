"""Style of the figures, and shared panel elements."""

from __future__ import annotations

import functools
import io
import itertools
import math
import os
import re
import string
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, YAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import Collection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FixedLocator
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import printable
from mckibben.report.palette import BAND, BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION
from mckibben.storage.files import atomic_write
from mckibben.units import percent

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset

DOUBLE = 7.2
"""Width of two columns of a journal [inches]."""

Look = dict[str, Any]
"""Options of an artist of matplotlib."""

DESIRED: Look = {"color": BLACK, "linestyle": (0, (4, 2)), "linewidth": 1.0, "zorder": 3}
CONTROLLERS: dict[str, Look] = {
    "PID": {"color": VERMILLION, "linestyle": "-", "marker": "o"},
    "BP": {"color": BLUE, "linestyle": "-", "marker": "s"},
    "PID, position gains doubled": {"color": GREEN, "linestyle": "-.", "marker": "P"},
    "PID tuned": {"color": ORANGE, "linestyle": "--", "marker": "D"},
    "BP on tuned gains": {"color": SKY, "linestyle": "-.", "marker": "^"},
    "BP on tuned gains, free": {"color": PURPLE, "linestyle": ":", "marker": "v"},
}
"""Fixed styles of the controllers of the paper; `looks_of` assigns styles to others."""
_SPARE = tuple(
    {"color": color, "linestyle": style}
    for style in ("-", "--", ":", "-.")
    for color in (VERMILLION, BLUE, GREEN, PURPLE, ORANGE, SKY, BLACK)
)

LOADING: Look = {"color": BLUE, "marker": "^"}
UNLOADING: Look = {"color": VERMILLION, "marker": "v"}
DIRECTIONS = {"loading": LOADING, "unloading": UNLOADING}
EXPERIMENTAL: Look = {"color": "#8E3B8E", "linestyle": "-"}
THEORETICAL: Look = {"color": GREEN, "linestyle": (0, (5, 1.5))}
"""Styles of Fig. 4: loading, unloading, experimental law, theoretical law."""

P = ParamSpec("P")
R = TypeVar("R")


@contextmanager
def house_style() -> Iterator[None]:
    """Context in which matplotlib has the settings of `mckibben.mplstyle`; the user's are restored afterwards.

    >>> with house_style():
    ...     mpl.rcParams["axes.grid"]
    True
    """
    with resources.as_file(resources.files("mckibben.report") / "mckibben.mplstyle") as path:
        settings = mpl.rc_params_from_file(path, use_default_template=True)
    with mpl.rc_context({name: value for name, value in settings.items() if not name.startswith("backend")}):
        yield


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Decorator of a function that draws: it runs in the house style.

    Texts of a returned figure, which contain names given by users, have their control characters escaped, and lines of
    at most 120 characters.
    """

    @functools.wraps(draw)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with house_style():
            drawn = draw(*args, **kwargs)
            if isinstance(drawn, Figure):
                _limit_texts(drawn)
            return drawn

    return wrapped


def _limit_texts(figure: Figure) -> None:
    """Escape unprintable characters in the texts of a figure, which contain user-given names, and limit their lines.

    The style disables mathematics in all texts except the panel letters.
    """

    def limited(text: str) -> str:
        return "\n".join(printable(line, _LONGEST_LINE) for line in text.split("\n"))

    artists = figure.findobj()  # once: it makes all ticks
    for axis in (artist for artist in artists if isinstance(artist, Axis)):
        if isinstance(formatter := axis.get_major_formatter(), FixedFormatter):
            formatter.seq = [limited(text) for text in formatter.seq]
        if isinstance(axis, YAxis):  # a power of ten is above the numbers: titles keep their place
            axis.get_offset_text().set_horizontalalignment("right")
    for text in (artist for artist in artists if isinstance(artist, Text)):
        if text.get_text() != (short := limited(text.get_text())):
            text.set_text(short)


class NotebookFigure(Figure):
    """Figure shown as an image in notebooks, with or without pyplot."""

    def _repr_png_(self) -> bytes:
        return png_of(self)


def png_of(figure: Figure, resolution: float | None = None) -> bytes:
    """Image of a figure.

    Parameters
    ----------
    figure
        Figure; its layout is computed.
    resolution
        Resolution [dpi]. Default: that of the figure.

    Returns
    -------
    bytes
        PNG.
    """
    image = io.BytesIO()
    if resolution is not None:
        figure.set_dpi(resolution)
    with house_style():
        FigureCanvasAgg(figure).print_png(image)
    return image.getvalue()


def blank(width: float, height: float) -> Figure:
    """Empty figure of a size [inches] with constrained layout, not registered with pyplot."""
    return NotebookFigure(figsize=(width, height), layout="constrained")


def looks_of(names: Iterable[str]) -> dict[str, Look]:
    """Colour and line style by name: those of `CONTROLLERS`, and unused ones for other names, up to 28.

    Examples
    --------
    >>> looks = looks_of(["PID", "mine"])
    >>> looks["PID"]["color"] == VERMILLION, looks["mine"]["color"] == VERMILLION
    (True, False)
    """
    names = list(names)
    fixed_looks = {name: CONTROLLERS[name] for name in names if name in CONTROLLERS}
    fixed = {name: {key: look[key] for key in ("color", "linestyle")} for name, look in fixed_looks.items()}
    colors = {look["color"] for look in fixed_looks.values()}
    spare = itertools.cycle(sorted(_SPARE, key=lambda look: look["color"] in colors))
    return {name: fixed.get(name) or next(spare) for name in names}


def part_of(name: str, first: int, last: int) -> ListedColormap:
    """The colours from `first` to `last`, of 256, of a colour map of matplotlib."""
    return ListedColormap(mpl.colormaps[name].resampled(256)(range(first, last)))


def pressure_colours() -> ListedColormap:
    """Colour map of pressures: viridis without its palest end."""
    return part_of("viridis", 0, 222)


def by_direction(data: IsobaricDataset) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Each direction of a dataset and its points; the name is empty if directions are not recorded."""
    directions = data.table["direction"].to_numpy() if "direction" in data.table else np.full(len(data), "")
    return ((str(direction), directions == direction) for direction in np.unique(directions))


def draw_points(axes: Axes, data: IsobaricDataset, values: NDArray[np.float64], label: str = "", **look: Any) -> None:
    """Draw a value of each point of a dataset over contraction [%], with colour and marker of its direction.

    Parameters
    ----------
    axes, data
        Panel, and points.
    values
        Values, shape (points,), in the unit of the axis.
    label
        Text after the direction, in the legend.
    look
        Options of `Axes.plot`.
    """
    for direction, mask in by_direction(data):
        appearance: Look = DIRECTIONS.get(direction, {"color": "#444444", "marker": "o"}) | {"linestyle": ""} | look
        axes.plot(
            data.contraction[mask] / percent, values[mask], label=f"{direction} {label}".strip() or None, **appearance
        )


@styled
def save(figure: Figure, folder: str | os.PathLike[str], name: str, *, preview: bool = False) -> tuple[Path, Path]:
    """Write a figure as PNG (200 dpi) and SVG.

    The files are reproducible byte for byte; the SVG has text as outlines.

    Parameters
    ----------
    figure
        Figure; its layout is fixed.
    folder
        Folder, which is made if it is missing; existing files are replaced.
    name
        Name of the files without their endings.
    preview
        Only a PNG with 100 dpi.

    Returns
    -------
    tuple of Path
        Paths of PNG and SVG.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"
    resolution = mpl.rcParams["savefig.dpi"]
    figure.set_dpi(resolution / 2 if preview else resolution)  # before the layout, which depends on the resolution
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)  # one layout instead of one per draw
        figure.set_layout_engine("none")
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        axis.set_major_locator(FixedLocator(axis.get_majorticklocs().tolist()))  # found once instead of some ten times
    # `Figure.savefig` would draw everything twice
    with atomic_write(png, overwrite=True) as temporary:
        FigureCanvasAgg(figure).print_png(temporary, metadata={"Software": None}, pil_kwargs={"compress_level": 3})
    if not preview:
        with atomic_write(svg, overwrite=True) as temporary:
            FigureCanvasSVG(figure).print_svg(temporary, metadata={"Date": None, "Creator": None})
    return png, svg


_NO_LABEL = re.compile(r"_(child\d+|nolegend_)$")  # other names with a leading underscore come from users
_LONGEST_LINE = 120  # characters
_HALO = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
_MOST_VERTICES = 600


def letter(axes: Axes, index: int, title: str) -> None:
    """Set the title of the panel at an index, from 0: "(a) title" with a bold letter."""
    mark = rf"$\bf{{({string.ascii_lowercase[index % 26]})}}$"
    text = re.sub(r"\bK_(min|max)\b", r"$K_{\\mathrm{\1}}$", title.replace("$", chr(92) + "$"))
    axes.set_title(f"{mark} {text}", parse_math=True)


def panels(figure: Figure | SubFigure, count: int, columns: int, **options: Any) -> NDArray[Any]:
    """Panels of a figure in row order, shape (count,).

    Parameters
    ----------
    figure
        Empty figure.
    count, columns
        Number of panels, and of panels per row; the rest of the last row stays empty.
    options
        Options of `Figure.subplots`.
    """
    grid = figure.subplots(-(-count // columns), columns, squeeze=False, **options).ravel()
    for axes in grid[count:]:
        axes.remove()
    return grid[:count]


def robust_limits(
    curves: Sequence[ArrayLike], *, part: float = 0.995, margin: float = 0.12, floor: float = 0.0
) -> tuple[float, float]:
    """Axis limits that contain all but the outermost values of each curve.

    Values that are not finite do not count; without a finite value the limits are 0 and 1.

    Parameters
    ----------
    curves
        Values of each curve.
    part
        Quantile [-] of a curve that is inside; its counterpart from below, too.
    margin
        Share [-] of the range that is added on each side.
    floor
        Least range.

    Examples
    --------
    >>> robust_limits([np.linspace(0, 10, 1001), [np.nan]], part=1.0, margin=0.1)
    (-1.0, 11.0)
    >>> robust_limits([[3.0, 3.0]], floor=2.0, margin=0.0)
    (2.0, 4.0)
    """
    finite = [values[np.isfinite(values)] for values in (np.asarray(c, float) for c in curves)]
    finite = [values for values in finite if values.size]
    if not finite:
        return 0.0, 1.0
    low = min(float(np.quantile(values, 1 - part)) for values in finite)
    high = max(float(np.quantile(values, part)) for values in finite)
    short = max(floor - (high - low), 0.0) / 2
    low, high = low - short, high + short
    extra = margin * (high - low) if high > low else 1.0
    return low - extra, high + extra


def note_off_scale(
    axes: Axes, times: NDArray[np.float64], curves: dict[str, NDArray[np.float64]], unit: str, *, bottom: bool = False
) -> None:
    """Annotate the curves that leave the panel with their extreme value and its time.

    Parameters
    ----------
    axes
        Panel with its limits.
    times
        Times of all curves [s], shape (samples,).
    curves
        Values by name, in a `unit`.
    bottom
        Whether the note is at the lower edge of the panel.
    """
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
        place = {"y": 0.03, "va": "bottom"} if bottom else {"y": 0.97, "va": "top"}
        beside(axes, "off scale: " + "\n".join(sentences), fontsize=6.5, color="#555555", **place)


def minus(value: float, form: str = ".1f") -> str:
    """Format a number with a typographic minus.

    Examples
    --------
    >>> minus(-12.34)
    '−12.3'
    """
    return format(value, form).replace("-", "−")


def draw_band(axes: Axes, x: ArrayLike, low: ArrayLike, high: ArrayLike, **look: Any) -> None:
    """Shade the area between two curves in the background, with at most some 600 vertices.

    Parameters
    ----------
    axes
        Panel.
    x, low, high
        Abscissa and both curves, shape (samples,).
    look
        Options of `Axes.fill_between`.
    """
    x, low, high = (np.asarray(values, float) for values in (x, low, high))
    if not len(x):
        return
    every = max(len(x) // _MOST_VERTICES, 1)
    rows = np.unique(np.append(np.arange(0, len(x), every), len(x) - 1))
    style: Look = {"color": BAND, "linewidth": 0.0, "zorder": 0} | look
    axes.fill_between(x[rows], low[rows], high[rows], **style)


def plain_numbers(axis: Axis) -> None:
    """Label a logarithmic axis with decimal numbers: powers of ten, on short axes also 2 and 5 times."""

    def written(value: float, _: object) -> str:
        low, high = axis.get_view_interval()
        first = round(value / 10.0 ** math.floor(math.log10(value) + 1e-9))
        return f"{value:g}" if first == 1 or (first in (2, 5) and high < 30 * low) else ""

    axis.set_major_formatter(written)
    axis.set_minor_formatter(written)
    to_label = mpl.rcParams["xtick.major.size"] + mpl.rcParams["xtick.major.pad"]
    axis.set_tick_params(which="minor", pad=to_label - mpl.rcParams["xtick.minor.size"])


_CHARACTER, _HANDLE, _LEGEND_ROW = 0.058, 0.45, 0.15  # inches of a legend


def legend_above(figure: Figure, *axes: Axes, columns: int = 5) -> None:
    """Draw one legend above the figure, each label once in order of appearance; the figure grows by its rows.

    Parameters
    ----------
    figure
        Figure.
    axes
        Panels whose labelled curves, areas and points are in the legend.
    columns
        Most columns of the legend.
    """
    handles: Look = {}
    for panel in axes:
        for handle in panel.get_children():
            label = str(handle.get_label())
            if isinstance(handle, Line2D | Patch | Collection) and label and not _NO_LABEL.match(label):
                handles.setdefault(label, handle)
    widths, room = [len(label) * _CHARACTER + _HANDLE for label in handles], figure.get_figwidth()
    in_one_row = len(handles) <= columns and sum(widths) <= room
    most = len(handles) if in_one_row else min(columns, int(room / max(widths, default=1.0)))
    rows = -(-len(handles) // max(most, 1))
    columns = max(-(-len(handles) // max(rows, 1)), 1)  # rows of nearly equal length
    figure.set_figheight(figure.get_figheight() + max(0, rows - 2) * _LEGEND_ROW)
    figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=columns)


def beside(axes: Axes, text: str, **place: Any) -> None:
    """Annotate the upper right corner of a panel; `place` has other options of `Axes.text`."""
    settings: Look = {"x": 0.985, "y": 0.96, "ha": "right", "va": "top", "fontsize": 7} | place
    axes.text(s=text, transform=axes.transAxes, bbox=_HALO, zorder=5, **settings)
