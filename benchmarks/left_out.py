"""Errors at left-out pressures and contractions, and coverage and width of prediction intervals there.

    python benchmarks/left_out.py

The data sets of the catalog. Each pressure and each inner contraction is predicted from all others, by
Eq. 2, Chou's law, Eq. 2 with smooth deviations, and a plain Gaussian process: a constant mean, a squared exponential
kernel of two lengths, and noise, by maximum likelihood. Blocks without which Eq. 2 is not determined are left out for
all. Outliers that `mckibben.identification.find_outliers` names are left out of the data. Prints the table of
docs/results/intervals.md, the lowest and the highest pressure apart: RMSE, that relative to Eq. 2, the share of
left-out points inside of nominal 95 % intervals, their median half width, and the mean interval score (Gneiting and
Raftery 2007), which rewards narrow intervals and coverage at once.
"""

import warnings
from statistics import NormalDist

import numpy as np
from scipy.optimize import minimize

import mckibben as mk
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.identification.estimator import IntervalEstimate
from mckibben.identification.outliers import find_outliers, without_outliers
from mckibben.identification.regression import contraction_blocks, pressure_blocks
from mckibben.muscle import LAWS

DATA = ("festo-tool-10mm", "dmsp-10-250-martens2017", "dmsp-20-300-martens2017")
COMPARED = ("Exponential", "Chou", "Smooth")
PLAIN = "a plain Gaussian process"
STARTS = ((0.0, 0.0, -3.0), (-1.0, -1.0, -3.0), (0.0, 0.0, -6.0))
BOUNDS = ((-3.0, 6.0), (-3.0, 4.0), (-3.0, 4.0), (-9.0, 1.0))  # logarithms of amplitude, two lengths and noise


def gaussian_process(points: mk.IsobaricDataset, new: mk.IsobaricDataset) -> tuple[np.ndarray, np.ndarray]:
    """Force and standard deviation [N] at other points."""
    given, wanted = (np.column_stack([one.contraction, one.pressure]) for one in (points, new))
    middle, scale = given.mean(axis=0), given.std(axis=0)
    given, wanted = (given - middle) / scale, (wanted - middle) / scale
    mean, spread = points.force.mean(), points.force.std()
    target = (points.force - mean) / spread

    def kernel(first, second, values):
        apart = (first[:, None] - second) / np.exp(values[1:3])
        return np.exp(2 * values[0] - np.sum(apart**2, axis=-1) / 2)

    def noisy(values):
        return kernel(given, given, values) + (np.exp(2 * values[3]) + 1e-9 * np.exp(2 * values[0])) * np.eye(
            len(given)
        )

    def cost(values):
        factor = np.linalg.cholesky(noisy(values))
        white = np.linalg.solve(factor, target)
        return white @ white / 2 + np.log(np.diag(factor)).sum()

    found = min((minimize(cost, (1.0, *start), bounds=BOUNDS) for start in STARTS), key=lambda one: one.fun).x
    across = kernel(wanted, given, found)
    solved = np.linalg.solve(noisy(found), across.T)
    variance = np.exp(2 * found[0]) - np.sum(across * solved.T, axis=1) + np.exp(2 * found[3])
    return mean + spread * (target @ solved), spread * np.sqrt(np.maximum(variance, 0))


def predicted(law: str, points: mk.IsobaricDataset, new: mk.IsobaricDataset) -> np.ndarray:
    """Error, half width and score of a 95 % interval [N], and whether it contains the force: shape (4, new points)."""
    if law == PLAIN:
        value, deviation = gaussian_process(points, new)
        half = NormalDist().inv_cdf(0.975) * deviation
        band = IntervalEstimate(0.95, value, deviation, np.full(len(new), np.inf), value - half, value + half)
    else:
        fit = mk.identify(points, LAWS[f"{law}Law"], robust=False)
        band = fit.force_intervals(new.contraction, new.pressure).prediction
    half = (band.upper - band.lower) / 2
    return np.array([band.value - new.force, half, band.score(new.force), band.contains(new.force)])


def left_out(data: mk.IsobaricDataset, laws: list[str]) -> dict[str, dict[str, np.ndarray]]:
    """`predicted` at all left-out points, by group of blocks and by law."""
    points = without_outliers(data, find_outliers(data)).taut
    levels = pressure_blocks(points)[0]
    kinds = {"contractions": contraction_blocks(points)}
    if levels is not None:
        low, high, names = levels == levels.min(), levels == levels.max(), levels.astype(str)
        groups = {"lowest pressure": low, "highest pressure": high, "other pressures": ~(low | high)}
        kinds |= {group: np.where(own, names, "") for group, own in groups.items()}
    found: dict[str, dict[str, np.ndarray]] = {}
    for kind, labels in kinds.items():
        rows: dict[str, list[np.ndarray]] = {law: [] for law in laws}
        for label in filter(None, np.unique(labels).tolist()):
            rest, new = points.select(labels != label), points.select(labels == label)
            try:
                answers = {law: predicted(law, rest, new) for law in laws}
            except IdentificationError:
                continue
            for law, answer in answers.items():
                rows[law].append(answer)
        if any(rows.values()):
            found[kind] = {law: np.concatenate(parts, axis=1) for law, parts in rows.items()}
    return found


def main():
    warnings.simplefilter("ignore", McKibbenWarning)
    print_table({name: mk.catalog.dataset(name) for name in DATA}, [*COMPARED, PLAIN])


def print_table(sets: dict[str, mk.IsobaricDataset], laws: list[str]) -> None:
    """Print errors, coverage and width by data set, block and law; the first law is the reference."""
    header = ("data", "left out", "points", "law", "RMSE", "relative", "inside of 95 %", "half width", "score")
    print(f"| {' | '.join(header)} |\n{'|---' * len(header)}|")
    for name, data in sets.items():
        for kind, by_law in left_out(data, laws).items():
            reference = np.sqrt(np.mean(by_law[laws[0]][0] ** 2))
            for law, (errors, half, score, inside) in by_law.items():
                rmse = np.sqrt(np.mean(errors**2))
                row = f"{rmse:.2f} N | {rmse / reference:.2f} | {100 * np.mean(inside):.0f} %"
                row += f" | {np.median(half):.3g} N | {np.mean(score):.3g} N"
                print(f"| {name} | {kind} | {len(errors)} | {law} | {row} |", flush=True)


if __name__ == "__main__":
    main()
