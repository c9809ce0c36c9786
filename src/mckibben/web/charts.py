"""Charts of the pages: Apache ECharts with the options of `starts/chart.json`; series are its options as dictionaries.

Each can be zoomed by its toolbox, and saved as PNG, SVG or CSV by its menu, in the browser (`starts/page.js`).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from nicegui import ui
from numpy.typing import ArrayLike

from mckibben.web import resource

Series = dict[str, Any]
"""Options of a curve of a chart."""

_MOST_POINTS = 1500
_PRESSURES = ["#440154", "#414487", "#2A788E", "#22A884", "#7AD151"]  # as `mckibben.report.style.pressure_colours`


def points(x: ArrayLike, y: ArrayLike, most: int = _MOST_POINTS) -> list[list[float | None]]:
    """Pairs for a chart, with gaps where a value is not finite.

    Parameters
    ----------
    x, y
        Arrays of shape (samples,).
    most
        Most pairs; of more samples every second, third ... one is taken.

    Examples
    --------
    >>> points([0.0, 1.0, 2.0], [1.0, float("nan"), 3.0])
    [[0.0, 1.0], [1.0, None], [2.0, 3.0]]
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    step = max(1, -(-len(x) // most))
    pairs = zip(x[::step].tolist(), y[::step].tolist(), strict=True)
    return [[round(a, 5), float(f"{b:.5g}") if math.isfinite(b) else None] for a, b in pairs]


def pressure_colour(part: float) -> str:
    """Colour of a pressure that is a part, 0 to 1, of the highest.

    >>> pressure_colour(0.0), pressure_colour(0.5), pressure_colour(1.0)
    ('#440154', '#2a788e', '#7ad151')
    """
    channels = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in _PRESSURES], float)
    places = np.linspace(0.0, 1.0, len(_PRESSURES))
    return "#" + "".join(f"{round(np.interp(part, places, channel)):02x}" for channel in channels.T)


def line(name: str, x: ArrayLike, y: ArrayLike, color: str, *, dash: bool = False, width: float = 2) -> Series:
    """A curve of a chart.

    Parameters
    ----------
    name
        Text in the legend and at the pointer.
    x, y
        Arrays of shape (samples,), in the units of the axes.
    color, dash, width
        Colour, whether it is dashed, and width in pixels.
    """
    look = {"color": color, "width": width, "type": [6, 4] if dash else "solid"}
    return {
        "type": "line",
        "name": name,
        "data": points(x, y),
        "showSymbol": False,
        "z": 3,
        "lineStyle": look,
        "itemStyle": {"color": color},
    }


def band(name: str, x: ArrayLike, low: ArrayLike, high: ArrayLike, color: str) -> list[Series]:
    """The area between two curves, as two stacked series.

    Parameters
    ----------
    name
        Text in the legend.
    x, low, high
        Arrays of shape (samples,), in the units of the axes.
    color
        Colour of the area.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    shared: Series = {
        "type": "line",
        "stack": name,
        "stackStrategy": "all",
        "showSymbol": False,
        "silent": True,
        "lineStyle": {"opacity": 0},
        "tooltip": {"show": False},
        "emphasis": {"disabled": True},
    }
    return [
        {**shared, "name": f"{name} from", "data": points(x, low)},
        {
            **shared,
            "name": name,
            "data": points(x, high - low),
            "itemStyle": {"color": color},
            "areaStyle": {"color": color, "opacity": 0.22},
        },
    ]


def cloud(name: str, x: ArrayLike, y: ArrayLike, pressure: ArrayLike, symbol: str = "circle") -> Series:
    """Points of a chart with a scale of colours, see `chart`.

    Parameters
    ----------
    name, symbol
        Text at the pointer, and shape of ECharts.
    x, y, pressure
        Arrays of shape (samples,), in the units of the axes and of the scale.
    """
    x, y, pressure = (np.asarray(values, float) for values in (x, y, pressure))
    step = max(1, -(-len(x) // _MOST_POINTS))
    rows = np.round(np.column_stack([x, y, pressure])[::step], 5)
    data = rows[np.isfinite(rows).all(axis=1)].tolist()
    size = 4 if len(data) > 400 else 6
    return {"type": "scatter", "name": name, "data": data, "symbol": symbol, "symbolSize": size, "z": 4}


def chart(
    x: str,
    y: str,
    *,
    height: int = 300,
    scale: str = "",
    span: tuple[float, float] = (0, 1),
    **axes: Mapping[str, object],
) -> ui.echart:
    """An empty chart.

    Parameters
    ----------
    x, y
        Labels of the axes, with units.
    height
        Height in pixels.
    scale, span
        Label of a scale of colours for a third number of the points of the first two series, and its ends.
    axes
        Further options of `xAxis` and `yAxis`, such as `min`.
    """
    options = json.loads(resource("starts/chart.json"))
    for axis, name in (("xAxis", x), ("yAxis", y)):
        options[axis] |= {"name": name, **axes.get(axis, {})}
    if scale:
        low, high = span
        options["visualMap"] |= {
            "show": True,
            "dimension": 2,
            "seriesIndex": [0, 1],
            "min": low,
            "max": high,
            "text": [scale, ""],
        }
        options["visualMap"]["inRange"] = {"color": _PRESSURES}
        options["tooltip"]["trigger"], options["legend"]["show"] = "item", False
        options["grid"]["top"] = 50
    else:
        del options["visualMap"]
    name = re.sub("[^a-z]+", "-", y.partition("[")[0].lower()).strip("-")
    with ui.element("div").classes("chart w-full"):
        graph = ui.echart(options).classes("w-full").style(f"height: {height}px").props(f'role="img" aria-label="{y}"')
        save = ui.button(icon="download").props(f'flat round dense size=sm aria-label="save the chart of {name}"')
        with save, ui.menu():
            for kind in ("PNG", "SVG", "CSV"):
                ui.menu_item(kind).on("click", js_handler=f"() => saveChart({graph.id}, '{kind.lower()}', '{name}')")
    return graph


def draw(on: ui.echart, series: Iterable[Series], *, legend: Iterable[str] | None = None) -> None:
    """Replace the curves of a chart.

    If their number is unchanged, only the curves are sent, directly to the chart: the page is not rendered again.

    Parameters
    ----------
    on
        Chart.
    series
        Curves, areas and points.
    legend
        Names in the legend. Default: all but the lower ends of bands.
    """
    series = list(series)
    names = (
        [curve["name"] for curve in series if not curve["name"].endswith(" from")] if legend is None else list(legend)
    )
    names, alike = list(dict.fromkeys(names)), series and len(on.options["series"]) == len(series)
    with on.props.suspend_updates():  # what is sent later, such as another class, must not bring back older curves
        on.options["title"]["show"], on.options["legend"]["data"], on.options["series"] = not series, names, series
    if not alike:
        on.update()
        return
    changed = [{key: curve[key] for key in ("type", "name", "data", "markLine") if key in curve} for curve in series]
    on.run_chart_method("setOption", {"series": changed, "legend": {"data": names}})
