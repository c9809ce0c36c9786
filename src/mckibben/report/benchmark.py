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

from mckibben.report.figures import ReportFigure, described
from mckibben.report.page import Section, write_document
from mckibben.report.style import DOUBLE, blank, legend_above, letter, looks_of, plain_numbers, styled
from mckibben.report.tables import Table, number
from mckibben.report.tracking import tracking
from mckibben.study.compare.statistics import FAILED, failed_runs
from mckibben.units import deg

if TYPE_CHECKING:
    from mckibben.study.compare import BenchmarkResult

_ERRORS = (("angle_rmse", "angle rmse [deg]", deg), ("stiffness_rmse", "stiffness rmse [N·m/rad]", 1.0))
_PAGE = "comparison.html"
_TRACED = 2  # controllers with time traces in addition to the first
_NARROW = 3.0  # a smaller ratio gets a linear axis


@styled
def benchmark_errors(result: BenchmarkResult) -> Figure:
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
def benchmark_air(result: BenchmarkResult, numbers: Mapping[str, Any]) -> Figure:
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
def benchmark_front(result: BenchmarkResult, numbers: Mapping[str, Any]) -> Figure:
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


def write_benchmark(result: BenchmarkResult, numbers: Mapping[str, Any], folder: str | os.PathLike[str]) -> Path:
    """Write `comparison.html`, self-contained, and its figures in `figures/`; return its path.

    Parameters
    ----------
    result
        Comparison, from `mckibben.compare`.
    numbers
        Its `statistics`.
    folder
        Folder of the page.
    """
    folder, suite = Path(folder), result.suite
    first, runs = next(iter(result.batches)), numbers["runs"] - numbers["no_start"]
    tables = [_ranking(numbers), *([at_air] if (at_air := _at_air(numbers)) else [])]
    return write_document(
        folder / _PAGE,
        title=suite.name,
        lead=_lead(result, numbers, runs),
        sections=[
            Section("Ranking", tables, _figures(result, numbers, runs)),
            Section("Tuning", [_tuned(result)], words=True),
        ],
        source_title="The suite",
        source=suite.dumps(folder=folder),
        again=f"mckibben compare SUITE.yaml --out DIR --repeat '{first} {min(17, numbers['runs'] - 1)}' > run.yaml\n"
        "mckibben simulate run.yaml",
    )


def _lead(result: BenchmarkResult, numbers: Mapping[str, Any], runs: int) -> str:
    """How the controllers were tuned and evaluated."""
    tuning, first = result.suite.tuning, next(iter(result.batches))
    infeasible = (
        f" ({numbers['no_start']} more had no static equilibrium at their start)" if numbers["no_start"] else ""
    )
    untuned = f" except {', '.join(tuning.untuned)}" if tuning.untuned else ""
    searches = f"{tuning.starts} {'search' if tuning.starts == 1 else 'searches'}"
    at_air = f", and one more for the lowest angle error at the air of {first}" if numbers["at_air_of_first"] else ""
    return (
        f"{len(result.batches)} controllers on {runs} unseen runs{infeasible}. Each{untuned} was tuned with the same "
        f"budget: {searches} of {tuning.generations} generations of {tuning.population} points on {tuning.runs} other "
        f"runs, minimising the mean of {numbers['cost']}{at_air}. No controller has access to the plant beyond its "
        "measurements."
    )


def _figures(result: BenchmarkResult, numbers: Mapping[str, Any], runs: int) -> list[ReportFigure]:
    first, *others = result.batches
    run, results = result.median_run([first, *[name for name in numbers["order"] if name in others][:_TRACED]])
    drawn = {
        "errors": benchmark_errors(result),
        "air": benchmark_air(result, numbers),
        "front": benchmark_front(result, numbers),
        "traces": tracking(results),
    }
    return [
        described(f"comparison/{name}", figure, runs=runs, run=run, first=first)
        for name, figure in drawn.items()
        if any(axes.lines for axes in figure.axes)  # no front without tuning, no air without volumes
    ]


_COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("angle rmse [deg]", "angle_rmse_deg", "median"),
    ("95 %", "angle_rmse_deg", "percentile_95"),
    ("stiffness rmse [N*m/rad]", "stiffness_rmse", "median"),
    ("95 %", "stiffness_rmse", "percentile_95"),
    ("coupling [deg]", "coupling_deg", "median"),
    ("estimate rmse [N*m/rad]", "estimate_rmse", "median"),
    ("air [L]", "air_L", "median"),
    ("saturated [s]", "time_saturated_s", "median"),
)
"""Title, metric and statistic of the columns of both rankings."""


def _ranked(caption: str, first: str, controllers: Mapping[str, Any]) -> Table:
    """Errors of controllers, and the ratio of their angle errors to that of the first."""
    rows = []
    for name, errors in controllers.items():
        ratio = errors["ratio_to_first"]["angle_rmse_deg"]
        interval = f"{number(ratio['ratio'])} ({number(ratio['low'])} to {number(ratio['high'])})"
        cells = (number((errors["metrics"][metric] or {}).get(statistic)) for _, metric, statistic in _COLUMNS)
        rows.append((name, failed_runs(errors), *cells, interval))
    titles = (title for title, _, _ in _COLUMNS)
    return Table(caption, ("controller", FAILED, *titles, f"angle rmse / {first}"), rows)


def _ranking(numbers: Mapping[str, Any]) -> Table:
    controllers = numbers["controllers"]
    return _ranked(
        "Ordered by median cost. Medians and 95th percentiles over the runs that did not diverge. Errors refer to the "
        "plant's stiffness, coupling to stiffness steps; estimate rmse is the error of the controller's stiffness "
        "estimate. Ratios of medians, with 95 % bootstrap intervals over the runs.",
        next(iter(controllers)),
        {name: controllers[name] for name in numbers["order"]},
    )


def _at_air(numbers: Mapping[str, Any]) -> Table | None:
    """Errors at no more air than the first controller uses, if it was tuned."""
    if (at_air := numbers["at_air_of_first"]) is None:
        return None
    first = next(iter(numbers["controllers"]))
    return _ranked(
        f"At the air of {first}: the trial of each tuning with the lowest angle error at no more than "
        f"{number(at_air['air_L'])} L (medians of the training runs), on the unseen runs; ratio to {first} as tuned.",
        first,
        at_air["controllers"],
    )


def _tuned(result: BenchmarkResult) -> Table:
    rows = []
    for name, values in result.tuned.items():
        costs = result.training_cost.get(name)
        change = "not tuned" if costs is None else f"cost {number(costs[1])} before, {number(costs[0])} tuned"
        written = [
            f"{gain.name.removeprefix('controller.')} {gain.parameter.show(values[gain.name]).replace('*', '·')}"
            for gain in result.suite.tuned_over(name)
        ]
        rows.append((name, change, "; ".join(written)))
    return Table("Tuned parameters.", ("controller", "cost of the training runs", "parameters"), rows)


def _distribution(axes: Axes, values: NDArray[np.float64], **look: Any) -> None:
    """Empirical distribution function; runs without a value count as infinite."""
    ordered = np.sort(values[np.isfinite(values)])
    below = np.arange(ordered.size + 1) / max(values.size, 1)
    axes.plot([*ordered[:1], *ordered], below[: ordered.size + bool(ordered.size)], drawstyle="steps-post", **look)
