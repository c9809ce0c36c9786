"""A public elbow with two McKibben muscles, identified from recordings of commanded pressures, simulated on others.

    git clone https://github.com/gkharish/pneumaticarm_dentification
    python benchmarks/elbow.py CLONE [--seed 0] [--joint-friction 0.2] [--cross-validate] [--thirds]

The recordings (folder ident_data: five pairs of time and value a row, commands in bar, angle in rad, 100 Hz) have no
licence and are not part of this repository. Every third file in alphabetical order, from the first, is fitted; the
others are held out.

The model before has the dimensions of the elbow (joint 4) in the authors' own program, gkharish/pneumaticarm7R,
src/pneumaticarm_2linkmodel.cpp: muscles by the law of Tondu and Lopez, the one that extends mounted at its largest
contraction, pulleys of 15 mm, a forearm of 2.6 kg; lag 0.1 s, as in src/pneumaticarm_model.cpp.

With --joint-friction [N*m] the joint has dry friction of its own before, with presliding of 1 deg. --cross-validate
simulates each third of the fitted files by the model fitted to the others of them; no held-out file is read. --thirds
fits the three disjoint thirds of all files, and prints whether their estimates agree within their intervals.

Rivals: three poles, no zeros, a delay and an offset after a polynomial of both pressures, linear or quadratic, fitted
to the same samples from several starts; and the transfer function that the authors print in their report, from the
pressure of one muscle alone, which is given the measured angle at the start of the step. Errors are root mean squares
[rad], of the angle over all motion (3 s after each change of the commands), and over 3 s of the authors' step.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter, lsim, lti
from scipy.special import chdtrc

from mckibben.actuator import FirstOrderValve
from mckibben.calibration import JointPrior, JointRecording, calibrate_from_commands
from mckibben.joint import AntagonisticJoint, GeneralLoad, PairedPaths, Pulley
from mckibben.muscle import Domain, Muscle, Specimen, TonduLopezLaw
from mckibben.plant import JointFriction
from mckibben.units import bar, deg, mm, ms, percent

EVERY, STEP, PERIOD, STARTS = 3, 3.0, 0.01, 8  # files; s; s; of the rivals' fits
AUTHORS = lti([207.1], [1, 10.73, 84.23, 366])  # rad/bar, their report
PRIOR = JointPrior(strength=0.3, offset=0.15)  # three times the default: the muscles were never measured


def elbow():
    """Joint, load and valve before."""
    length, angle, factor = 185 * mm, 23 * deg, 1.25
    domain = Domain(-10 * percent, 45 * percent, 0.0, 4 * bar)
    muscle = Muscle(Specimen("elbow", length), TonduLopezLaw(angle, 17 * mm, factor, domain))
    largest = (1 - 1 / (np.sqrt(3) * np.cos(angle))) / factor  # contraction at which the law's force is 0
    paths = PairedPaths(Pulley(15 * mm, length * (1 - largest)), Pulley(15 * mm, length))
    load = GeneralLoad(0.0144 + 2.6 * 0.178**2, 2.6 * 0.178 * 9.81, 0.25)
    return AntagonisticJoint(paths, muscle, muscle), load, FirstOrderValve(100 * ms)


def recording(file):
    """A file with its columns at the times of the angle; muscle 1 is the one that lengthens with the angle."""
    table = np.genfromtxt(file, delimiter=",", skip_header=1)

    def pair(first):
        rows = table[:, first : first + 2]
        return rows[np.isfinite(rows).all(axis=1)].T

    (at, flexor), (times, angle), (_, extensor) = pair(4), pair(6), pair(8)
    nearest = np.clip(np.searchsorted(at, times - 5 * ms), 0, min(flexor.size, extensor.size) - 1)
    return JointRecording(times, angle, np.stack([extensor[nearest], flexor[nearest]], axis=1) * bar, commanded=True)


def rival(parameters, commands, period):
    """Angle [rad] of three poles and a delay after a polynomial of both pressures, of degree 1 or 2.

    Parameters are logarithms of pole, natural frequency [1/s], damping and delay [s], then offset and coefficients.
    """
    (pole, frequency, damping, delay), offset, gains = np.exp(parameters[:4]), parameters[4], parameters[5:]
    denominator = np.polymul([1 / pole, 1], [1 / frequency**2, 2 * damping / frequency, 1])
    numerator, denominator, _ = cont2discrete(([1.0], denominator), period, "zoh")
    first, second = commands / bar
    terms = np.array([first, second, first**2, first * second, second**2])[: gains.size]
    steps = np.arange(first.size)
    late = np.interp(steps - delay / period, steps, gains @ terms)
    return offset + late[0] + lfilter(numerator.ravel(), denominator, late - late[0])


def fitted_rival(motions, coefficients, seed):
    """Parameters of least squares, the best of several starts."""
    rng, found = np.random.default_rng(seed), []

    def errors(parameters):
        return np.concatenate([rival(parameters, commands, PERIOD) - angle for angle, commands in motions])

    for _ in range(STARTS):
        start = np.array([*np.log([10, 7, 0.4, 0.05]), 0.0, -0.2, 0.5, 0.0, 0.0, 0.0])[: 5 + coefficients]
        found.append(least_squares(errors, start + rng.normal(0, 0.3, start.size)))
    return min(found, key=lambda one: one.cost).x


def rms(errors):
    """Root mean square."""
    return float(np.sqrt(np.mean(errors**2)))


def cross_validated(recordings, friction):
    """Error [rad] over all motion of each recording, by the model fitted to others; every third one is left out."""
    for left in range(EVERY):
        kept = [one for place, one in enumerate(recordings) if place % EVERY != left]
        found = calibrate_from_commands(*elbow(), kept, PRIOR, friction=friction)
        yield from (found.simulate(one).errors[1] for one in recordings[left::EVERY])


def print_thirds(recordings, friction):
    """Print estimates by disjoint thirds of the files, and the probability of a larger chi-squared of their scatter."""
    found = [calibrate_from_commands(*elbow(), recordings[i::EVERY], PRIOR, friction=friction) for i in range(EVERY)]
    print("| quantity | estimates of the thirds | p-value |\n|---|---|---|")
    for name, one in found[0].quantities.items():
        values, deviations = np.array(
            [(each.quantities[name].value, each.quantities[name].deviation) for each in found]
        ).T
        weights = 1 / deviations**2
        scatter = weights @ (values - weights @ values / weights.sum()) ** 2
        shown = ", ".join(f"{value:.3g} +- {wide:.2g}" for value, wide in zip(values, deviations, strict=True))
        print(f"| {name} [{one.unit}] | {shown} | {chdtrc(EVERY - 1, scatter):.2g} |")


def main():
    """Print the tables."""
    options = argparse.ArgumentParser()
    options.add_argument("clone", type=Path)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--joint-friction", type=float, default=0.0)
    options.add_argument("--cross-validate", action="store_true")
    options.add_argument("--thirds", action="store_true")
    given = options.parse_args()
    friction = JointFriction(given.joint_friction, 1 * deg) if given.joint_friction else None
    files = sorted(one for one in (given.clone / "ident_data").glob("*.csv") if one.stem != "datainfo")
    if given.cross_validate:
        errors = np.array(list(cross_validated([recording(one) for one in files[::EVERY]], friction)))
        print("cross-validated:", *(f"{error:.4f}" for error in errors), f"root mean square {rms(errors):.4f} rad")
        return
    if given.thirds:
        print_thirds([recording(one) for one in files], friction)
        return
    recordings = {one.stem: recording(one) for one in files}
    fitted = list(recordings)[::EVERY]
    begun = time.monotonic()
    found = calibrate_from_commands(*elbow(), [recordings[name] for name in fitted], PRIOR, friction=friction)
    print(f"{time.monotonic() - begun:.0f} s; fitted: {', '.join(fitted)}")
    for name, one in found.quantities.items():
        print(f"  {name}: {one.value:.4g} +- {one.deviation:.2g} {one.unit} ({one.prior:.2g} before)")
    simulated = {name: found.simulate(one) for name, one in recordings.items()}

    def commands(name):
        one = recordings[name]
        return one.pressures[np.searchsorted(one.time, simulated[name].time - 5 * ms)].T

    motions = [(simulated[name].measured, commands(name)) for name in fitted]
    rivals = [fitted_rival(motions, coefficients, given.seed) for coefficients in (2, 5)]
    for one in rivals:
        print("rival:", np.round([*np.exp(one[:4]), *one[4:]], 4).tolist())
    print("all motion: before, calibrated, linear, polynomial; step: the same, and the authors'")
    kept = []
    for name, one in simulated.items():
        pressures = commands(name)
        changes = np.flatnonzero(np.abs(np.diff(pressures, axis=1)).max(axis=0) > 1e-3 * bar) + 1
        start = changes[np.diff(changes, prepend=-STEP / PERIOD) > 1 / PERIOD][1] - 1
        step = slice(start, start + round(STEP / PERIOD))
        angles = [one.before, one.after, *(rival(each, pressures, PERIOD) for each in rivals)]
        errors = [rms(each - one.measured) for each in angles] + [rms((each - one.measured)[step]) for each in angles]
        if name.startswith("sim"):
            change = (pressures[1][step] - pressures[1][start]) / bar
            response = lsim(AUTHORS, change, PERIOD * np.arange(change.size))[1]
            errors.append(rms(one.measured[start] + response - one.measured[step]))
        role = "fitted" if name in fitted else "held out"
        print(f"{name:30s} {role:8s}", *(f"{error:.4f}" for error in errors))
        if role == "held out":
            kept.append(errors)
    table = np.array([row + [np.nan] * (9 - len(row)) for row in kept])
    print("held out, root mean square    ", *(f"{rms(column[np.isfinite(column)]):.4f}" for column in table.T))


if __name__ == "__main__":
    main()
