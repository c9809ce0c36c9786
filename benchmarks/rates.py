"""Friction that depends on the rate, from simulated strokes at several rates: coverage of intervals, and wrong forms.

    python benchmarks/rates.py [--sets 20]

A muscle with Eq. 3 moves along sines of 9 mm at 0.03, 0.1, and 0.3 Hz, and is released once in 0.2 s, at four
pressures; force, pressure, and length have noise (0.3 N, 200 Pa, 10 um). Points of the strokes are extracted as by
`mckibben points --strokes`, and law and friction are identified from them. Prints the tables of docs/hysteresis.md:
chosen form and share of estimates within two standard errors, and for muscles of other forms the chosen form, the
warnings, and the error of the friction.
"""

import argparse
import collections
import warnings

import numpy as np

import mckibben as mk
from mckibben import catalog
from mckibben.dataset import Recording
from mckibben.errors import McKibbenWarning
from mckibben.muscle import MaxwellSlip, forces
from mckibben.units import bar, mm, percent

LAW, LENGTH = catalog.law("lei-mas-10-180n"), 180 * mm
PRESSURES = np.array([2.0, 3.0, 4.0, 5.0]) * bar
RATES = (0.03, 0.1, 0.3)  # Hz
INTERVAL = 0.02  # s
SLIP = MaxwellSlip(10.0, 0.5 * mm, growth=2 / bar, reference_pressure=3.5 * bar)
VARIABLE = {"viscous": 300.0, "viscous_growth": 80 / bar, "viscous_length_growth": 8 / mm, "reference_length": 0.165}
TRUTHS = {
    "pressure": SLIP,
    "variable-viscous": MaxwellSlip(10.0, 0.5 * mm, growth=2 / bar, reference_pressure=3.5 * bar, **VARIABLE),
    "rate": MaxwellSlip(
        10.0, 0.5 * mm, growth=2 / bar, reference_pressure=3.5 * bar, rate_growth=0.5, rate_speed=5 * mm
    ),
}
FOREIGN = {  # friction [N] in addition to SLIP, of rate [m/s], pressure, and half width
    "falls with the rate (Stribeck)": lambda v, p, width: -0.4 * width * np.sign(v) * (1 - np.exp(-np.abs(v) / 3e-3)),
    "square of the rate": lambda v, p, width: 2e4 * v * np.abs(v),
    "logarithm of the rate": lambda v, p, width: 0.3 * width * np.sign(v) * np.log1p(np.abs(v) / 5e-4),
    "damping of shortening twice that of stretching": lambda v, p, width: np.where(v > 0, 300.0, 600.0) * v,
}


def motion() -> tuple[np.ndarray, np.ndarray]:
    """Time and contraction of the sines and the quick release."""
    parts = []
    for rate in RATES:
        time = np.arange(0, 2 / rate, INTERVAL)
        parts += [0.08 - 0.05 * np.cos(2 * np.pi * rate * time), np.full(50, 0.03)]
    ramp = np.linspace(0.03, 0.13, 11)
    contraction = np.concatenate([np.full(50, 0.03), *parts, ramp, np.full(100, 0.13), ramp[::-1], np.full(50, 0.03)])
    return INTERVAL * np.arange(len(contraction)), contraction


def recorded(friction: MaxwellSlip, seed: int, more=None) -> mk.IsobaricDataset:
    """Points along the strokes of a simulated recording."""
    rng = np.random.default_rng(seed)
    time, contraction = motion()
    length = LENGTH * (1 - contraction)
    rate = np.gradient(length, time)
    columns = []
    for number, pressure in enumerate(PRESSURES):
        tension = np.maximum(forces(LAW, contraction, pressure), 0.0)
        force = tension + friction.path_response(length, tension, pressure, side=1.0)
        force += np.asarray(friction.viscous_force(length, tension, pressure, rate))
        if more is not None:
            force += more(rate, pressure, np.asarray(friction.half_width_at(tension, pressure)))
        start = number * (time[-1] + 5)
        columns.append((time + start, np.full(len(time), pressure), contraction, force))
    time, pressure, contraction, force = map(np.concatenate, zip(*columns, strict=True))
    noise = rng.standard_normal((3, len(time)))
    return (
        Recording.of(
            time=time,
            pressure=pressure + 200 * noise[0],
            contraction=contraction + 1e-5 / LENGTH * noise[1],
            force=force + 0.3 * noise[2],
            initial_length=LENGTH,
            slack_force=1.0,
        )
        .strokes(step=0.1 * percent)
        .dataset
    )


def deviations(found, truth: MaxwellSlip) -> dict[str, float]:
    """Deviation of the estimates from the truth, in standard errors."""
    fit, errors = found.friction, found.standard_errors
    pressure = fit.reference_pressure - truth.reference_pressure
    true = {
        "half_width": truth.half_width + truth.growth * pressure,
        "growth": truth.growth,
        "presliding_length": None,
        "viscous_growth": truth.viscous_growth,
        "viscous_length_growth": truth.viscous_length_growth,
        "rate_growth": truth.rate_growth,
        "rate_speed": truth.rate_speed,
    }
    if truth.viscous:
        length = (fit.reference_length or 0.0) - truth.reference_length
        true["viscous"] = truth.viscous + truth.viscous_growth * pressure + truth.viscous_length_growth * length
    return {
        name: ((getattr(fit, name) or 0.0) - value) / errors[name]
        for name, value in true.items()
        if value is not None and np.isfinite(errors[name])
    }


def main():
    parser = argparse.ArgumentParser(description="Friction that depends on the rate, from simulated strokes.")
    parser.add_argument("--sets", type=int, default=20)
    options = parser.parse_args()
    warnings.simplefilter("ignore", McKibbenWarning)
    print("| true form | chosen | rejected | within two standard errors |\n|---|---|---|---|")
    for name, truth in TRUTHS.items():
        forms, inside, rejected = collections.Counter(), collections.defaultdict(list), 0
        for seed in range(options.sets):
            found = mk.identify_hysteresis(mk.ExponentialLaw, recorded(truth, seed))
            forms[found.form.value] += 1
            rejected += found.lack_of_fit is not None
            if found.form.value == name:
                for parameter, score in deviations(found, truth).items():
                    inside[parameter].append(abs(score) < 2)
        shares = ", ".join(f"{one} {100 * np.mean(hits):.0f} %" for one, hits in inside.items())
        print(f"| {name} | {dict(forms)} | {rejected} | {shares} |", flush=True)
    print("\n| true friction | chosen | warning | error of the friction, RMS |\n|---|---|---|---|")
    for name, more in FOREIGN.items():
        for seed in range(max(1, options.sets // 10)):
            found = mk.identify_hysteresis(mk.ExponentialLaw, recorded(SLIP, seed, more))
            lack = found.lack_of_fit.quantity if found.lack_of_fit else f"{len(found.warnings)} others"
            print(f"| {name} | {found.form.value} | {lack} | {found.rmse:.2g} N |", flush=True)


if __name__ == "__main__":
    main()
