"""Coverage of 95 % intervals over many synthetic data sets, with the width and the score of those of the force.

    python benchmarks/coverage.py [--sets 2000]

The truth is Eq. 3, measured as the rig does: loading and unloading at each pressure, noise within a plateau correlated
from sample to sample (so that only its mean is a measurement), and in every other row an error common to each stroke.
Each data set goes through the estimator of `identify`; takes a few minutes. tests/identification/test_coverage.py runs
fewer sets.
"""

import argparse
import dataclasses

import numpy as np
from scipy.signal import lfilter

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import DatasetSummary, Fit, Grouping
from mckibben.identification.estimator import standard_errors
from mckibben.identification.least_squares import FitProblem, grid_search, solve
from mckibben.identification.regression import Regression
from mckibben.muscle import ExponentialLaw, forces
from mckibben.units import bar, percent

EQ_3 = catalog.law("lei-mas-10-180n")
TRUTH = np.array([float(getattr(EQ_3, p.name)) for p in ExponentialLaw.parameters()])
AT = (8 * percent, 3.3 * bar)
SAMPLES, AGREEMENT = 40, 0.9  # of a plateau, and between neighbouring samples
LEVELS = np.arange(2, 6.1, 0.5) * bar


def design(levels, directions=2) -> IsobaricDataset:
    """Where the muscle pulls by more than 10 N, so that noise makes nothing slack."""
    rows = [
        (p, eps, direction)
        for p in levels
        for direction in ("loading", "unloading")[:directions]
        for eps in np.linspace(-3, 20, 13) * percent
        if float(EQ_3.force(eps, p)) > 10
    ]
    pressure, contraction, direction = (np.array(column) for column in zip(*rows, strict=True))
    return IsobaricDataset.of(
        pressure=pressure, contraction=contraction, force=forces(EQ_3, contraction, pressure), direction=direction
    )


def plateaus(points: int, sets: int, seed: int) -> np.ndarray:
    """Noise of 2 N within plateaus, shape (sets, points, samples): each sample agrees with the one before."""
    white = np.random.default_rng(seed).normal(size=(sets, points, SAMPLES))
    white[..., 1:] *= np.sqrt(1 - AGREEMENT**2)
    return 2.0 * np.asarray(lfilter([1.0], [1.0, -AGREEMENT], white, axis=-1))


def strokes(points: IsobaricDataset, labels, sets: int, seed: int, size=2.0) -> np.ndarray:
    """An error common to the points of each stroke [N], shape (sets, points)."""
    return size * np.random.default_rng(seed).normal(size=(sets, labels.max() + 1))[:, labels]


def starts(problem: FitProblem, measured: np.ndarray) -> np.ndarray:
    """What `search` finds for each row of forces, shape (sets, shape): all rows at a place of the grid at once."""
    places = list(problem.cube.grid())
    costs = []
    for place in places:
        values = np.concatenate([np.zeros(problem.linear), problem.cube.values(place)])
        columns = dataclasses.replace(problem, force=np.zeros_like(problem.force)).response(values)[1]
        linear = columns[:, : problem.linear]
        q, _ = np.linalg.qr(linear / np.linalg.norm(linear, axis=0))
        costs.append(np.sum(measured**2, axis=1) - np.sum((measured @ q) ** 2, axis=1))
    return np.array(places)[np.argmin(costs, axis=0)]


def fits(points: IsobaricDataset, measured: np.ndarray):
    """The estimator on each row, without the refits to parts of the points."""
    problem = FitProblem.of(ExponentialLaw, points)
    pad = len(problem.force) - len(points)
    for i, (row, start) in enumerate(zip(measured, starts(problem, measured), strict=True)):
        this = dataclasses.replace(problem, force=np.pad(row, (0, pad), mode="edge"))
        if i < 5:
            np.testing.assert_array_equal(start, grid_search(this))
        solution = solve(this, start)
        at_bound = np.zeros(7, bool)
        regression = Regression(points, this, solution, at_bound)
        errors, correlations = standard_errors(solution.jacobian, solution.residuals, at_bound)
        yield Fit(
            law=this.law(solution.values),
            standard_errors=dict(zip(this.names, errors, strict=True)),
            correlations=correlations,
            rmse=0.0,
            max_error=0.0,
            points_used=len(points),
            points_slack=0,
            leave_one_pressure_out=None,
            notes=(),
            dataset=DatasetSummary("", "", ()),
            robust=regression.robust_errors,
            regression=regression,
        )


def grouped(fit: Fit, by: Grouping) -> Fit:
    """The fit with errors in common by a grouping, whatever its points suggest."""
    regression = dataclasses.replace(fit.require_regression())
    vars(regression)["default_grouping"] = by, ""
    return dataclasses.replace(fit, regression=regression, robust=regression.robust_errors)


def covered(points, measured, further, groupings):
    """The share of data sets whose interval holds the truth, by grouping: 7 parameters, a force, a further measurement;
    then half width and score for the further measurement [N]."""
    force = float(EQ_3.force(*AT))
    inside, widths = ({by: [] for by in groupings} for _ in range(2))
    for plain, error in zip(fits(points, measured), further, strict=True):
        for by in groupings:
            fit = grouped(plain, by)
            bounds = list(fit.intervals().values())
            band = fit.force_intervals(*AT)
            bounds += [(band.confidence.lower, band.confidence.upper), (band.prediction.lower, band.prediction.upper)]
            truths = [*TRUTH, force, force + error]
            inside[by].append([low <= truth <= high for (low, high), truth in zip(bounds, truths, strict=True)])
            prediction = band.prediction
            widths[by].append((float(prediction.upper - prediction.value), float(prediction.score(force + error))))
    return {by: (np.mean(inside[by], axis=0), *np.transpose(widths[by])) for by in groupings}


def stroke_labels(points: IsobaricDataset) -> np.ndarray:
    """The number of each point's stroke."""
    loading = points.table["direction"].to_numpy() == "loading"
    return np.unique(np.stack([points.levels, loading]), axis=1, return_inverse=True)[1].reshape(-1)


def shares(points, sets: int, *, common: bool):
    """`covered` for so many data sets, with or without an error common to each stroke."""
    noise = plateaus(len(points) + 1, sets, seed=1).mean(axis=-1)
    measured, further = points.force + noise[:, :-1], noise[:, -1]
    if common:
        measured = measured + strokes(points, stroke_labels(points), sets, seed=2)
        further = further + 2.0 * np.random.default_rng(3).normal(size=sets)
    return covered(points, measured, further, (Grouping.POINT, Grouping.STROKE))


def main():
    parser = argparse.ArgumentParser(description="How often 95 % intervals hold the truth; half width and score.")
    parser.add_argument("--sets", type=int, default=2000, help="data sets a row")
    options = parser.parse_args()
    print("| strokes | points | errors | by stroke | classical |\n|---|---|---|---|---|")
    for step in (0.5, 1.0, 2.0):
        points = design(np.arange(2, 6.1, step) * bar)
        for common, name in ((False, "independent"), (True, "2 N common to each stroke")):
            found = shares(points, options.sets, common=common)
            cells = (
                f"{100 * share.min():.1f} .. {100 * share.max():.1f} %, {np.median(half):.3g} N, {score.mean():.3g} N"
                for share, half, score in (found[Grouping.STROKE], found[Grouping.POINT])
            )
            print(f"| {stroke_labels(points).max() + 1} | {len(points)} | {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
