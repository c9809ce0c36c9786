"""The house style of figures: sizes, colours with one meaning each, and how a figure is kept."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

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
