"""Coverage of 95 % intervals over six kinds of test of a muscle whose equations are not those of the package.

    python benchmarks/kinds_of_test.py [--sets 25] [--kind weights] [--law exponential]

The muscle has a braid with end effects, a membrane, Dahl friction and a damper; the load cell has noise and may drift,
pressure and length have the errors of a lab. Each data set draws all of them anew, is written as a file, and goes through
reading and `identify_with_friction`. By kind: the share of the sets whose interval holds the true half width, damping,
drift and forces at places amid the points, with the number of intervals; how often a drift is found where there is none;
and the median error of the forces, relative to the largest.
"""

import argparse
import tempfile
import warnings
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtrit

from mckibben import muscle as laws
from mckibben.dataset import read_dataset, read_recording
from mckibben.errors import McKibbenError
from mckibben.identification import identify_with_friction
from mckibben.joint import PairedPaths, Pulley
from mckibben.units import bar, deg, mm

RATE = 20.0  # Hz
PRESSURES = np.array([1.5, 2.5, 3.5, 4.5, 5.5]) * bar
RADIUS = 25 * mm


@dataclass
class Lab:
    """A muscle and its rig, drawn at random, in SI units."""

    rng: np.random.Generator
    length: float = field(init=False)
    area: float = field(init=False)
    shape: tuple[float, float] = field(init=False)

    def __post_init__(self):
        draw = self.rng.uniform
        self.length, self.area = draw(0.15, 0.4), np.pi / 4 * (draw(8, 22) * mm) ** 2
        largest = 6 * self.area * 5 * bar
        self.shape = draw(13, 17), draw(5, 7)
        self.half_width, self.presliding = largest * draw(0.01, 0.03), draw(0.1, 0.5) * mm
        self.damping = largest * draw(0.2, 0.8)  # N*s/m
        self.drift = largest * (draw(-0.008, 0.008) if draw() < 0.5 else 0.0) / 600  # N/s
        self.noise = largest * draw(3e-4, 1e-3)
        self.common = largest * draw(0, 1e-3)  # error of a stroke
        self.offset = largest * draw(-0.01, 0.01)

    def tension(self, eps, p):
        """Static force [N]: the ends stay cylindrical, and the membrane stiffens."""
        a, b = self.shape
        moved = eps * (1 + 0.12 * np.exp(-p / bar))
        return p * self.area * (a * (1 - 1.05 * moved) ** 2 - b) - 3 * bar * self.area * eps * (1 + 4 * eps)

    @property
    def farthest(self):
        """Contraction at which the lowest pressure has a tenth of its force."""
        p = PRESSURES[0]
        return brentq(lambda eps: self.tension(eps, p) - 0.1 * self.tension(0.0, p), 0, 0.4)

    def friction(self, length, start=1.0):
        """Dahl friction [N] along lengths, from a long motion in the direction of the start."""
        state, forces = start * self.half_width, []
        for move in np.diff(length, prepend=length[:1]):
            end = np.sign(move) * self.half_width
            state = end + (state - end) * np.exp(-abs(move) / self.presliding) if move else state
            forces.append(state)
        return np.array(forces)

    def measured(self, time, eps, p, *, damped=True):
        """Pressure [bar], length [mm] and force [N] as the rig records them."""
        length = self.length * (1 - eps)
        force = self.tension(eps, p) + self.friction(length) + self.drift * time
        if damped:
            force = force + self.damping * np.gradient(length, time)
        force = np.maximum(force, 0) + self.rng.normal(0, self.noise, len(time))
        strokes = np.cumsum((np.diff(np.sign(np.diff(eps, prepend=eps[0])), prepend=0) != 0) | (np.abs(np.diff(p, prepend=p[0])) > 0.2 * bar))
        force = force + self.common * self.rng.normal(size=strokes.max() + 1)[strokes]
        return (
            (p + self.rng.normal(0, 300, len(time))) / bar,
            (length + self.rng.normal(0, 0.02 * mm, len(time))) / mm,
            force,
        )


def parts(*legs):
    """Samples along straight legs (duration [s], from, to)."""
    return np.concatenate([np.linspace(a, b, round(RATE * t), endpoint=False) for t, a, b in legs])


def write(path, names, columns):
    np.savetxt(path, np.transpose(columns), "%.6g", ",", header=",".join(names), comments="")
    return path


RECORDED = "time_s", "pressure_bar", "length_mm", "force_N"


def strokes_of(lab, legs, path, **options):
    """File of strokes along the legs, at each pressure."""
    once = parts(*legs)
    eps, p = np.tile(once, len(PRESSURES)), np.repeat(PRESSURES, len(once))
    time = np.arange(len(eps)) / RATE
    return write(path, RECORDED, (time, *lab.measured(time, eps, p, **options)))


def stop_and_go(lab, path):
    stops = np.linspace(0, lab.farthest, 8)
    stops = [*stops, *stops[-2::-1]]
    legs = [leg for a, b in zip(stops, stops[1:], strict=False) for leg in ((0.5, a, b), (1.5, b, b))]
    file = strokes_of(lab, [(1.5, 0, 0), *legs], path)
    return read_recording(file, initial_length=lab.length).plateaus().dataset


def slow_loops(lab, path):
    legs = (15, 0, lab.farthest), (15, lab.farthest, 0)
    file = strokes_of(lab, legs, path, damped=False)
    return read_dataset(file, initial_length=lab.length)


def strokes_at_speeds(lab, path):
    legs = [leg for t in (12, 5, 2) for leg in ((t, 0, lab.farthest), (t, lab.farthest, 0))]
    return read_dataset(strokes_of(lab, legs, path), initial_length=lab.length)


def steps_of_pressure(lab, path):
    levels = [*PRESSURES, *PRESSURES[-2::-1]]
    steps = parts((2, levels[0], levels[0]), *(leg for a, b in zip(levels, levels[1:], strict=False) for leg in ((0.3, a, b), (1.7, b, b))))
    stops = lab.farthest * np.array([0, 0.33, 0.67, 1, 0.83, 0.5, 0.17])
    eps = np.concatenate([np.append(parts((0.5, a, b)), np.full(len(steps), b)) for a, b in zip([0, *stops], stops, strict=False)])
    p = np.tile(np.append(np.full(round(0.5 * RATE), levels[0]), steps), len(stops))
    time = np.arange(len(eps)) / RATE
    file = write(path, RECORDED, (time, *lab.measured(time, eps, p)))
    return read_recording(file, initial_length=lab.length).plateaus().dataset


def weights(lab, path):
    """Typed loads, up and down in the pressure from where the muscle is as long as without pressure."""
    rows = []
    for load in np.round(lab.tension(0.0, 5.5 * bar) * np.array([0.12, 0.25, 0.4, 0.6]), 1):
        least = brentq(lambda p, at=load: lab.tension(0.0, p) - at, 0, 6 * bar)
        up, eps, state = np.linspace(least + 0.2 * bar, 6 * bar, 12), 0.0, -lab.half_width

        def after(x, eps, state):
            move = (eps - x) * lab.length
            end = np.sign(move) * lab.half_width
            return end + (state - end) * np.exp(-abs(move) / lab.presliding)

        for p in [*up, *up[::-1]]:
            new = brentq(lambda x, p=p, eps=eps, state=state, load=load: lab.tension(x, p) + after(x, eps, state) - load, -0.2, 0.45)
            eps, state = new, after(new, eps, state)
            rows.append((p, eps, load))
    p, eps, load = np.array(rows).T
    p, length = p + lab.rng.normal(0, 500, len(p)), lab.length * (1 - eps) + lab.rng.normal(0, 0.05 * mm, len(p))
    file = write(path, ("pressure_bar", "length_mm", "load_N"), (p / bar, length / mm, load))
    return read_dataset(file, initial_length=lab.length)


def torque(lab, path):
    """Torque at angles of a pulley, stopped there."""
    span = lab.farthest * lab.length / RADIUS
    angle = np.linspace(-span / 2, span / 2, 12)
    once = np.concatenate([angle, angle[::-1]])
    angle, p = np.tile(once, len(PRESSURES)), np.repeat(PRESSURES, len(once))
    time = 3.0 * np.arange(len(angle))
    eps = (angle + span / 2) * RADIUS / lab.length
    pressure, _, force = lab.measured(time, eps, p, damped=False)
    geometry = PairedPaths(*(Pulley(radius=RADIUS, rest_length=lab.length * (1 - lab.farthest / 2)) for _ in range(2)))
    file = write(path, ("time_s", "pressure_bar", "angle_deg", "torque_Nm"), (time, pressure, angle / deg, force * RADIUS))
    return read_dataset(file, initial_length=lab.length, joint="pulley", geometry=geometry)


KINDS = (stop_and_go, slow_loops, strokes_at_speeds, steps_of_pressure, weights, torque)


def judged(lab, data, law, tally):
    """Add to a tally: by quantity, whether the interval holds the truth."""
    found = identify_with_friction(law, data)
    fit, friction = found.fit, found.hysteresis
    if friction is None:
        tally["no friction"].append(found.note)
    else:
        errors, freedom = friction.standard_errors, np.inf
        z = float(stdtrit(max(len(np.unique(data.levels)) * 2 - 1, 2), 0.975))
        tally["half width"].append((friction.friction.half_width - lab.half_width) / errors["half_width"])
        tally["_t"].append(z)
        tally["width ratio"].append(friction.friction.half_width / lab.half_width)
        tally["form"].append(friction.form.value)
        if friction.friction.viscous:
            tally["damping"].append((friction.friction.viscous - lab.damping) / errors["viscous"])
        if friction.drift:
            tally["drift"].append((friction.drift.rate - lab.drift) / friction.drift.rate_error)
            tally["drift false"].append(not lab.drift)
        else:
            tally["drift none"].append(lab.drift)
    taut = data.taut
    rows = lab.rng.choice(len(taut), 9)
    eps, p = taut.contraction[rows], taut.pressure[rows]
    inside = np.asarray(fit.law.domain.contains(eps, p))
    eps, p = eps[inside], p[inside]
    band, true = fit.force_intervals(eps, p), lab.tension(eps, p)
    further = true + lab.rng.normal(0, lab.noise, len(eps)) + lab.common * lab.rng.normal(size=len(eps))
    tally["force (confidence)"] += band.confidence.contains(true).tolist()
    tally["force (prediction)"] += band.prediction.contains(further).tolist()
    tally["half/noise"] += (np.median((band.prediction.upper - band.prediction.lower) / 2) / np.hypot(lab.noise, lab.common)).ravel().tolist()
    tally["error"] += (np.abs(band.prediction.value - true) / taut.force.max()).tolist()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=25, help="data sets of each kind")
    parser.add_argument("--kind", default="", help="one kind alone")
    parser.add_argument("--law", default="ExponentialLaw")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    law = getattr(laws, options.law)
    import time as clock
    with tempfile.TemporaryDirectory() as folder:
        for kind in KINDS:
            if options.kind not in kind.__name__:
                continue
            tally = defaultdict(list)
            began = clock.time()
            for number in range(options.sets):
                lab = Lab(np.random.default_rng((options.seed, number)))
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    try:
                        data = kind(lab, Path(folder) / "rig.csv")
                        judged(lab, data, law, tally)
                    except McKibbenError as error:
                        tally["refused"].append(str(error)[:300])
            print(kind.__name__, f"{(clock.time() - began) / options.sets:.2f} s")
            for name, values in tally.items():
                if name in ("form",):
                    print("  ", name, dict(zip(*np.unique(values, return_counts=True))))
                elif name in ("refused", "no friction"):
                    print("  ", name, len(values), set(values) if len(values) < 4 else list(values)[:4])
                elif name in ("half width", "damping", "drift"):
                    t = np.array(tally["_t"][: len(values)]) if name == "half width" else np.full(len(values), tally["_t"][0])
                    print("  ", name, f"{np.mean(np.abs(values) < t):.0%} of {len(values)}; z mean {np.mean(values):.2f} sd {np.std(values):.2f}")
                elif name == "error":
                    print("  ", name, f"{np.median(values):.3%}, 90 % {np.quantile(values, 0.9):.3%}")
                elif name == "drift none":
                    print("  ", name, f"{len(values)}, of which true zero {np.mean(np.array(values) == 0):.0%}")
                elif name != "_t":
                    print("  ", name, f"{np.mean(values):.3f} of {len(values)}")


if __name__ == "__main__":
    main()
