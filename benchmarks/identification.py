"""Identification of a force law from 5.85 million raw samples: ours against scipy and lmfit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rows import Candidate, Table
from timing import Bench

from mckibben import ExponentialLaw, IsobaricDataset, catalog
from mckibben.identification import fit_law
from mckibben.muscle import ForceLaw, forces
from mckibben.units import bar, kPa, percent

PRESSURES = np.linspace(2, 6, 13) * bar
CONTRACTIONS = np.linspace(-3, 14, 45) * percent  # all of them taut
DIRECTIONS, REPEATS, SAMPLES = 2, 5, 1000
FORCE_NOISE, PRESSURE_NOISE = 0.5, 0.5 * kPa  # those of the simulated rig
AGREED = 0.05  # N
OURS = "ours, mk.identify"
PARAMETERS = ("a1", "a2", "b1", "b2", "c1", "c2", "decay")
UNITS = np.array([1, 1 / bar, 1 / percent, 1 / percent / bar, 1, 1 / bar, 1 / percent])  # as the paper prints them


class Sampled(NamedTuple):
    """A test with its raw samples, shape (plateaus, samples): force [N] and pressure [Pa]."""

    dataset: IsobaricDataset
    force: NDArray[np.float32]
    pressure: NDArray[np.float32]

    def averaged(self) -> IsobaricDataset:
        """The dataset with the means of the samples."""
        means = {name: ("point", getattr(self, name).mean(axis=1, dtype=float)) for name in ("force", "pressure")}
        return IsobaricDataset(self.dataset.table.assign(means))


class Points(NamedTuple):
    """What a fit is made of, in bar, percent and N."""

    pressure: NDArray[np.floating]
    contraction: NDArray[np.floating]
    force: NDArray[np.floating]


def identification(folder: Path, *, quick: bool) -> Table:
    """The table of fits."""
    bench = Bench(rounds=5 if quick else 9, budget=2.0 if quick else 6.0)
    truth = catalog.law("lei-mas-10-180n")
    sampled = synthetic(truth)
    dataset = sampled.averaged()
    law = fit_law(ExponentialLaw, dataset).law
    used = 100 if quick else SAMPLES
    guess = 1.2 * np.array([getattr(truth, name) for name in PARAMETERS]) / UNITS

    def off(found: ForceLaw) -> float:
        return float(np.abs(_on_grid(found) - _on_grid(law)).max())

    def fitted(name: str, fit: Callable[[Points, NDArray], NDArray], points: Points, **more) -> Candidate:
        values: list[NDArray] = []

        def run() -> None:
            values[:] = [fit(points, guess)]

        run()
        return Candidate(name, run, more.pop("work", 1.0), off(_law(values[0])), AGREED, base=OURS, **more)

    def comparators(name: str, fit: Callable[[Points, NDArray], NDArray]) -> list[Candidate]:
        return [
            fitted(f"{name}, on plateau means", fit, means(dataset), note=f"{len(dataset)} means, computed beforehand"),
            fitted(
                f"{name}, on all samples",
                fit,
                raw(sampled, used),
                work=used / SAMPLES,
                note="one timing" + (f", of {used} samples a plateau, scaled" if quick else ""),
                warm=False,
                most=1,
            ),
        ]

    def by_scipy() -> list[Candidate]:
        from scipy.optimize import curve_fit

        def fit(points: Points, start: NDArray) -> NDArray:
            return curve_fit(_formula, (points.pressure, points.contraction), points.force, p0=start)[0]

        return comparators("SciPy curve_fit", fit)

    def by_lmfit() -> list[Candidate]:
        import lmfit

        def formula(pressure, contraction, a1, a2, b1, b2, c1, c2, decay):
            return _formula((pressure, contraction), a1, a2, b1, b2, c1, c2, decay)

        def fit(points: Points, start: NDArray) -> NDArray:
            model = lmfit.Model(formula, independent_vars=["pressure", "contraction"])
            first = model.make_params(**dict(zip(PARAMETERS, start.tolist(), strict=True)))
            done = model.fit(points.force, first, pressure=points.pressure, contraction=points.contraction)
            return np.array([done.best_values[name] for name in PARAMETERS])

        return comparators("lmfit", fit)

    note = "plateau means, fit, errors at unseen pressures; starts without a guess"
    bench.entries += [
        Candidate(OURS, lambda: fit_law(ExponentialLaw, sampled.averaged()), 1.0, off(truth), 1.0, note, OURS),
        Candidate(
            f"{OURS}, on plateau means",
            lambda: fit_law(ExponentialLaw, dataset),
            note="computed beforehand",
            base=OURS,
        ),
        Candidate("NumPy, plateau means alone", sampled.averaged, note="float64 sums", base=OURS),
    ]
    bench.add("SciPy curve_fit", by_scipy)
    bench.add("lmfit", by_lmfit, install="lmfit")
    return Table(
        "Identification from 5.85 million samples",
        "identification",
        "time",
        "force [N]",
        bench.timed(),
        (
            f"{len(PRESSURES)} pressures x {len(CONTRACTIONS)} positions x {DIRECTIONS} directions x {REPEATS} repeats "
            f"x {SAMPLES} samples (float32, of force and of pressure), from Eq. 3 with {FORCE_NOISE} N and "
            f"{PRESSURE_NOISE:.0f} Pa of noise; all points taut.",
            "scipy and lmfit start from the truth times 1.2, in bar and percent, and differentiate numerically, as "
            "they do by default. They give only estimates and covariances.",
            "Deviation: the largest of the fitted force over the points, from that of mk.identify [N]; that of "
            "mk.identify is from the truth.",
        ),
    )


def synthetic(law: ForceLaw) -> Sampled:
    """Plateaus with raw samples, as the simulated rig gives them, without its hysteresis."""
    pressure, contraction, turn = (
        axis.ravel() for axis in np.meshgrid(PRESSURES, CONTRACTIONS, np.arange(DIRECTIONS * REPEATS), indexing="ij")
    )
    generator = np.random.default_rng(0)

    def sampled(true: NDArray[np.float64], noise: float) -> NDArray[np.float32]:
        samples = generator.standard_normal((len(true), SAMPLES), dtype=np.float32)
        return samples * np.float32(noise) + true[:, None].astype(np.float32)

    force, gauge = sampled(forces(law, contraction, pressure), FORCE_NOISE), sampled(pressure, PRESSURE_NOISE)
    dataset = IsobaricDataset.of(
        pressure=gauge.mean(axis=1, dtype=float),
        contraction=contraction,
        force=force.mean(axis=1, dtype=float),
        direction=np.where(turn % 2, "unloading", "loading"),
        repeat=turn // 2,
        set_pressure=pressure,
    )
    return Sampled(dataset, force, gauge)


def means(dataset: IsobaricDataset) -> Points:
    """The plateau means."""
    return Points(dataset.pressure / bar, dataset.contraction / percent, dataset.force)


def raw(sampled: Sampled, used: int) -> Points:
    """So many raw samples of each plateau, flat, in float64."""
    pressure, force = sampled.pressure[:, :used], sampled.force[:, :used]
    contraction = np.repeat(sampled.dataset.contraction / percent, used)
    return Points(pressure.ravel().astype(float) / bar, contraction, force.ravel().astype(float))


def _formula(at: tuple, a1: float, a2: float, b1: float, b2: float, c1: float, c2: float, decay: float) -> NDArray:
    """Eq. 2 in bar, percent and N."""
    p, eps = at
    return (a1 + a2 * p) + (b1 + b2 * p) * eps + (c1 + c2 * p) * np.exp(-decay * eps)


def _law(values: NDArray) -> ExponentialLaw:
    return ExponentialLaw(**dict(zip(PARAMETERS, (values * UNITS).tolist(), strict=True)))


def _on_grid(law: ForceLaw) -> NDArray[np.float64]:
    pressure, contraction = np.meshgrid(PRESSURES, CONTRACTIONS)
    return forces(law, contraction.ravel(), pressure.ravel())
