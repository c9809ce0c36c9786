"""Figures and report of a comparison of controllers."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mckibben.report.figures import ReportFigure
from mckibben.report.page import embedded, style_sheet, template_of, write_page
from mckibben.report.style import DOUBLE, blank, legend_above, letter, looks_of, plain_numbers, styled
from mckibben.report.tables import Table, number
from mckibben.report.tracking import tracking
from mckibben.study.compare.result import FAILED, failed_runs
from mckibben.units import deg

if TYPE_CHECKING:
    from mckibben.study.compare import CompareResult

_ERRORS = (("angle_rmse", "angle rmse [deg]", deg), ("stiffness_rmse", "stiffness rmse [N·m/rad]", 1.0))
_PAGE = "comparison.html"
_TRACED = 2  # controllers with time traces in addition to the first
_NARROW = 3.0  # a smaller ratio gets a linear axis


@styled
def benchmark_errors(result: CompareResult) -> Figure:
    """Cumulative distribution of the angle and stiffness errors over the unseen runs, by controller."""
    figure = blank(DOUBLE, 3.0)
    axes = figure.subplots(1, 2, sharey=True)
    looks = looks_of(result.batches)
    for i, (panel, (metric, label, unit)) in enumerate(zip(axes, _ERRORS, strict=True)):
        for name, look in looks.items():
            _distribution(panel, result.metric(name, metric) / unit, label=name, **look)
        panel.set_xscale("log")
        plain_numbers(panel.xaxis)
        panel.set(xlabel=label, ylim=(0, 1.02))
        for share in (0.5, 0.95):
            panel.axhline(share, color="0.6", linewidth=0.6, zorder=0)
        letter(panel, i, label.split(" [")[0])
    axes[0].set_ylabel("share of runs below")
    axes[0].set_yticks([0, 0.25, 0.5, 0.75, 0.95], ["0", "0.25", "0.5", "0.75", "0.95"])
    legend_above(figure, axes[0], columns=min(len(looks), 4))
    return figure


def _marker(look: Mapping[str, Any]) -> str:
    """Marker of a controller, different if its colour is reused."""
    return "D" if "alpha" in look else "o"


@styled
def benchmark_references(result: CompareResult, numbers: Mapping[str, Any]) -> Figure:
    """Median errors by reference and controller, from `statistics` of the result."""
    references = list(result.suite.references)
    figure = blank(DOUBLE, 0.9 + 0.42 * len(references))
    axes = figure.subplots(1, 2, sharey=True)
    looks = looks_of(result.batches)
    keys = ("angle_rmse_deg", "stiffness_rmse")
    for i, (panel, key, (_, label, _)) in enumerate(zip(axes, keys, _ERRORS, strict=True)):
        for j, (name, look) in enumerate(looks.items()):
            found = numbers["controllers"][name]["by_reference"]
            shift = (j - (len(looks) - 1) / 2) * 0.7 / len(looks)
            errors = [(found.get(reference, {}).get(key), row + shift) for row, reference in enumerate(references)]
            places = [(error["median"], row) for error, row in errors if error]
            if places:
                x, y = zip(*places, strict=True)
                panel.plot(x, y, linestyle="", marker=_marker(look), markersize=3.5, color=look["color"], label=name)
        shown = [x for line in panel.lines for x in np.asarray(line.get_xdata())]
        if shown and max(shown) > _NARROW * min(shown):
            panel.set_xscale("log")
            plain_numbers(panel.xaxis)
        panel.set(xlabel=f"median {label}")
        letter(panel, i, label.split(" [")[0])
    axes[0].set_yticks(range(len(references)), references)
    axes[0].invert_yaxis()
    legend_above(figure, axes[0], columns=min(len(looks), 4))
    return figure


@styled
def benchmark_air(result: CompareResult, numbers: Mapping[str, Any]) -> Figure:
    """Angle error over air consumption: median and 90 % range of the runs."""
    figure = blank(DOUBLE, 3.0)
    axes = figure.subplots()
    for name, look in looks_of(result.batches).items():
        air, angle = result.metric(name, "air") * 1e3, result.metric(name, "angle_rmse") / deg
        if not (np.isfinite(angle) & np.isfinite(air)).any():
            continue  # all runs diverged, or the volume of a muscle unknown
        (x0, x, x1), (y0, y, y1) = (np.nanpercentile(each, [5, 50, 95]) for each in (air, angle))
        axes.plot([x0, x1], [y, y], color=look["color"], linewidth=0.8)
        axes.plot([x, x], [y0, y1], color=look["color"], linewidth=0.8)
        axes.plot(x, y, marker=_marker(look), markersize=4.5, linestyle="", color=look["color"], label=name)
    scale = "log" if axes.lines else "linear"
    axes.set(xscale=scale, yscale=scale, xlabel="air consumption [L]", ylabel="angle rmse [deg]")
    if axes.lines:
        plain_numbers(axes.xaxis)
        plain_numbers(axes.yaxis)
        legend_above(figure, axes, columns=4)
    return figure


@styled
def benchmark_front(result: CompareResult, numbers: Mapping[str, Any]) -> Figure:
    """Pareto front of median angle error and air consumption among the tuning trials, by controller."""
    figure = blank(DOUBLE, 3.0)
    axes = figure.subplots()
    for name, look in looks_of(result.batches).items():
        front = numbers["controllers"][name]["front"]
        if front:
            air, angle = ([at[key] for at in front] for key in ("air_L", "angle_rmse_deg"))
            axes.plot(air, angle, drawstyle="steps-post", marker=_marker(look), markersize=2.5, label=name, **look)
    axes.set(xscale="log", yscale="log", xlabel="air consumption [L]", ylabel="angle rmse [deg]")
    plain_numbers(axes.xaxis)
    plain_numbers(axes.yaxis)
    legend_above(figure, axes, columns=4)
    return figure


def write_benchmark(result: CompareResult, numbers: Mapping[str, Any], folder: str | os.PathLike[str]) -> Path:
    """Write `comparison.html`, self-contained, and its figures in `figures/`; return its path."""
    folder = Path(folder)
    text = template_of("benchmark.html.jinja").render(
        style=style_sheet(),
        suite=result.suite,
        numbers=numbers,
        first=next(iter(result.batches)),
        figures=[embedded(figure, folder) for figure in _figures(result, numbers)],
        tables=[
            _ranking(numbers),
            _ratios(numbers),
            _effort(numbers),
            _by_group(numbers, "by_reference", "reference"),
            _by_group(numbers, "by_joint", "the plant's joint"),
            _dependence(numbers),
        ],
        at_air=_at_air(numbers),
        tuned=_tuned(result),
        text=result.suite.dumps(folder=folder),
    )
    return write_page(folder / _PAGE, text)


def _figures(result: CompareResult, numbers: Mapping[str, Any]) -> list[ReportFigure]:
    runs = numbers["runs"] - numbers["no_start"]
    errors = (
        f"Cumulative distribution of the root mean square error over the {runs} unseen runs. Grey: median and 95th "
        "percentile. Diverged runs count as infinite errors."
    )
    references = "Median errors over the runs with each reference."
    air = "Air consumption and angle error: median and 90 % range of the runs."
    drawn = [
        ("errors", "Errors over all unseen runs", errors, benchmark_errors(result)),
        ("references", "Errors by reference", references, benchmark_references(result, numbers)),
    ]
    if any(np.isfinite(result.metric(name, "air")).any() for name in result.batches):
        drawn.append(("air", "Air consumption", air, benchmark_air(result, numbers)))
    if any(found["front"] for found in numbers["controllers"].values()):
        front = (
            "Pareto front of the tuning trials (air, angle error), medians of the training runs, with at most 1.1 "
            "times the stiffness error of the best trial."
        )
        drawn.append(("front", "Angle error against air", front, benchmark_front(result, numbers)))
    first, *others = result.batches
    shown = [first, *[name for name in numbers["order"] if name in others][:_TRACED]]
    run, results = result.median_run(shown)
    traces = f"Run {run}, with the median angle error of {first}: {first} and the {_TRACED} best of the others."
    drawn.append(("traces", "Time traces", traces, tracking(results)))
    return [ReportFigure(name, "", title, caption, title, figure) for name, title, caption, figure in drawn]


_Column = tuple[str, str, str]
_ERROR_COLUMNS: tuple[_Column, ...] = (
    ("angle rmse [deg]", "angle_rmse_deg", "median"),
    ("95 %", "angle_rmse_deg", "percentile_95"),
    ("stiffness rmse [N*m/rad]", "stiffness_rmse", "median"),
    ("95 %", "stiffness_rmse", "percentile_95"),
    ("coupling [deg]", "coupling_deg", "median"),
)
_EFFORT_COLUMNS: tuple[_Column, ...] = (
    ("ripple [N*m/rad]", "stiffness_ripple", "median"),
    ("estimate rmse [N*m/rad]", "estimate_rmse", "median"),
    ("air [L]", "air_L", "median"),
    ("saturated [s]", "time_saturated_s", "median"),
    ("slack, 95 % [s]", "time_slack_s", "percentile_95"),
)


def _ranking(numbers: Mapping[str, Any]) -> Table:
    rows = []
    for name in numbers["order"]:
        found = numbers["controllers"][name]
        settled = f"{found['settled']['runs']} of {found['settled']['of']}"
        rows.append((name, failed_runs(found), *_cells(found, _ERROR_COLUMNS), settled))
    return Table(
        "Ordered by median cost. Medians and 95th percentiles over the runs that did not diverge. Errors refer to "
        "the plant's stiffness; coupling and settling refer to stiffness steps.",
        ("controller", FAILED, *(title for title, _, _ in _ERROR_COLUMNS), "settled"),
        rows,
    )


def _effort(numbers: Mapping[str, Any]) -> Table:
    rows = [(name, *_cells(numbers["controllers"][name], _EFFORT_COLUMNS)) for name in numbers["order"]]
    return Table(
        "Medians; 95th percentile for the slack time. Ripple: varying part of the stiffness error; estimate rmse: "
        "error of the controller's stiffness estimate.",
        ("controller", *(title for title, _, _ in _EFFORT_COLUMNS)),
        rows,
    )


def _cells(found: Mapping[str, Any], columns: tuple[_Column, ...]) -> list[str]:
    return [number((found["metrics"][key] or {}).get(what)) for _, key, what in columns]


def _ratio(found: Mapping[str, Any]) -> str:
    return f"{number(found['ratio'])} ({number(found['low'])} to {number(found['high'])})"


def _ratios(numbers: Mapping[str, Any]) -> Table:
    first = next(iter(numbers["controllers"]))
    rows = [(name, *map(_ratio, numbers["controllers"][name]["ratio_to_first"].values())) for name in numbers["order"]]
    return Table(
        f"Ratio of the median error to that of {first}, with 95 % bootstrap interval over the runs.",
        ("controller", "angle rmse", "stiffness rmse"),
        rows,
    )


def _at_air(numbers: Mapping[str, Any]) -> Table | None:
    """Errors at no more air than the first controller uses, if it was tuned."""
    if (at_air := numbers["at_air_of_first"]) is None:
        return None
    first = next(iter(numbers["controllers"]))
    columns = (*_ERROR_COLUMNS[:3], _EFFORT_COLUMNS[2])
    rows = [
        (name, failed_runs(found), *_cells(found, columns), _ratio(found["ratio_to_first"]["angle_rmse_deg"]))
        for name, found in at_air["controllers"].items()
    ]
    return Table(
        f"At the air of {first}: the trial of each tuning with the lowest angle error at no more than "
        f"{number(at_air['air_L'])} L (medians of the training runs), on the unseen runs; ratio to {first} as tuned.",
        ("controller", FAILED, *(title for title, _, _ in columns), f"angle rmse / {first}"),
        rows,
    )


def _by_group(numbers: Mapping[str, Any], key: str, what: str) -> Table:
    groups = list(dict.fromkeys(group for found in numbers["controllers"].values() for group in found[key]))

    def cell(errors: Mapping[str, Any]) -> str:
        angle, stiffness = (errors[metric] or {} for metric in ("angle_rmse_deg", "stiffness_rmse"))
        tail = number(angle.get("percentile_95"))
        return f"{number(angle.get('median'))} deg ({tail}), {number(stiffness.get('median'))}"

    rows = [(name, *(cell(found[key][group]) for group in groups)) for name, found in numbers["controllers"].items()]
    title = f"Median errors by {what}: angle (95th percentile), and stiffness [N*m/rad]."
    return Table(title, ("controller", *groups), rows)


def _dependence(numbers: Mapping[str, Any]) -> Table:
    controllers = numbers["controllers"]
    conditions = list(next(iter(controllers.values()))["correlations"])

    def cell(correlation: Mapping[str, Any]) -> str:
        return f"{number(correlation['angle_rmse_deg'], 2)}, {number(correlation['stiffness_rmse'], 2)}"

    rows = [
        (condition, *(cell(found["correlations"][condition]) for found in controllers.values()))
        for condition in conditions
    ]
    return Table(
        "Spearman's rank correlation of each condition with the angle error, and with the stiffness error. "
        "Uncorrelated conditions give less than "
        f"{number(1.96 / max(numbers['runs'] - numbers['no_start'] - 1, 1) ** 0.5, 2)} 95 % of the time.",
        ("condition", *controllers),
        rows,
    )


def _tuned(result: CompareResult) -> Table:
    rows = []
    for name, values in result.tuned.items():
        costs = result.training_cost.get(name)
        said = "not tuned" if costs is None else f"cost {number(costs[1])} before, {number(costs[0])} tuned"
        written = [
            f"{each.name.removeprefix('controller.')} {each.parameter.show(values[each.name]).replace('*', '·')}"
            for each in result.suite.tuned_over(name)
        ]
        rows.append((name, said, "; ".join(written)))
    return Table("Tuned parameters.", ("controller", "cost of the training runs", "parameters"), rows)


def _distribution(axes: Axes, values: NDArray[np.float64], **look: Any) -> None:
    """Empirical distribution function; runs without a value count as infinite."""
    ordered = np.sort(values[np.isfinite(values)])
    below = np.arange(ordered.size + 1) / max(values.size, 1)
    axes.plot([*ordered[:1], *ordered], below[: ordered.size + bool(ordered.size)], drawstyle="steps-post", **look)
