"""Coverage of 95 % intervals over six kinds of test of a muscle whose equations are not those of the package.

    python benchmarks/kinds_of_test.py [--sets 25] [--kind weights] [--law SmoothLaw]

The muscle has a braid with end effects, a membrane, Dahl friction and a damper; the load cell has noise and may drift,
pressure and length have the errors of a lab. Each data set draws all of them anew, is written as a file, and goes
through reading and `identify_with_friction`. By kind of test: the share of sets with friction; of the intervals that
hold the true half width (of load cells without and with drift), damping, force (likewise) and a further measured force;
the root mean square of the stated standard errors of the half width, relative to that of its errors, both as shares of
the half width; drifts that are named where there is none; the median error of the force, the median half width of its
interval and the mean interval score, relative to the largest force; and the sets that are refused. A drift of the load
cell that the test does not show is an error of the rig, which is in no interval. tests/benchmarks runs one set each.
"""

import argparse
import itertools
import tempfile
import warnings
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

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
        strokes = np.cumsum(
            (np.diff(np.sign(np.diff(eps, prepend=eps[0])), prepend=0) != 0)
            | (np.abs(np.diff(p, prepend=p[0])) > 0.2 * bar)
        )
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
    legs = [leg for a, b in itertools.pairwise(stops) for leg in ((0.5, a, b), (1.5, b, b))]
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
    steps = parts(
        (2, levels[0], levels[0]), *(leg for a, b in itertools.pairwise(levels) for leg in ((0.3, a, b), (1.7, b, b)))
    )
    stops = lab.farthest * np.array([0, 0.33, 0.67, 1, 0.83, 0.5, 0.17])
    eps = np.concatenate(
        [np.append(parts((0.5, a, b)), np.full(len(steps), b)) for a, b in itertools.pairwise([0, *stops])]
    )
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
            new = brentq(
                lambda x, p=p, eps=eps, state=state, load=load: lab.tension(x, p) + after(x, eps, state) - load,
                -0.2,
                0.45,
            )
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
    file = write(
        path, ("time_s", "pressure_bar", "angle_deg", "torque_Nm"), (time, pressure, angle / deg, force * RADIUS)
    )
    return read_dataset(file, initial_length=lab.length, joint="pulley", geometry=geometry)


KINDS = (stop_and_go, slow_loops, strokes_at_speeds, steps_of_pressure, weights, torque)


QUANTITIES = "half width", "half width with drift", "damping", "force", "force with drift", "a further force"


def judged(lab: Lab, data, law) -> dict[str, list[bool]]:
    """By quantity, whether the 95 % interval holds the truth; whether a drift is named where there is none."""
    fit = identify_with_friction(law, data)
    friction, held, drifts = fit.hysteresis, defaultdict(list), " with drift" if lab.drift else ""
    if friction is not None:
        names = {"half_width": ("half width" + drifts, lab.half_width), "viscous": ("damping", lab.damping)}
        for name in names if friction.friction.viscous else ["half_width"]:
            title, truth = names[name]
            value, error = getattr(friction.friction, name), friction.standard_errors[name]
            held[title] = [bool(abs(value - truth) < 1.96 * error)]
            held[f"errors of {name}"] = [((value - truth) / truth, error / truth)]
        if not lab.drift:
            held["false drift"] = [friction.drift is not None]
    taut = data.taut
    rows = lab.rng.choice(len(taut), 9)
    eps, p = taut.contraction[rows], taut.pressure[rows]
    inside = np.asarray(fit.law.domain.contains(eps, p))
    eps, p = eps[inside], p[inside]
    band, true = fit.force_intervals(eps, p), lab.tension(eps, p)
    further = true + np.hypot(lab.noise, lab.common) * lab.rng.normal(size=len(eps))
    held["force" + drifts] = band.confidence.contains(true).tolist()
    held["a further force"] = band.prediction.contains(further).tolist()
    largest, confidence = taut.force.max(), band.confidence
    held["error"] = (np.abs(confidence.value - true) / largest).tolist()
    held["half width of force"] = ((confidence.upper - confidence.lower) / 2 / largest).tolist()
    held["score"] = (confidence.score(true) / largest).tolist()
    held["friction"] = [friction is not None]
    return held


def tallied(kind, sets: int, law, seed: int, folder: Path) -> dict[str, list]:
    """Judgement of all sets of a kind; a refusal is kept as text."""
    tally: dict[str, list] = defaultdict(list)
    for number in range(sets):
        lab = Lab(np.random.default_rng((seed, number)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                for name, values in judged(lab, kind(lab, folder / "rig.csv"), law).items():
                    tally[name] += values
            except McKibbenError as error:
                tally["refused"].append(str(error))
    return tally


def main():
    parser = argparse.ArgumentParser(description="Coverage of 95 % intervals over six kinds of test.")
    parser.add_argument("--sets", type=int, default=25, help="data sets of each kind")
    parser.add_argument("--kind", default="", help="one kind alone")
    parser.add_argument("--law", default="ExponentialLaw", help="class of the law")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(
        f"| test | friction found | {' | '.join(QUANTITIES)} | error stated / real | false drift | median error "
        "| half width | score | refused |"
    )
    print("|---" * (len(QUANTITIES) + 8) + "|")
    with tempfile.TemporaryDirectory() as folder:
        for kind in KINDS:
            if options.kind in kind.__name__:
                tally = tallied(kind, options.sets, getattr(laws, options.law), options.seed, Path(folder))
                shares = [
                    f"{np.mean(tally[name]):.0%} of {len(tally[name])}" if tally[name] else "" for name in QUANTITIES
                ]
                real, stated = np.sqrt(np.mean(np.square(tally["errors of half_width"]), axis=0))
                print(
                    f"| {kind.__name__.replace('_', ' ')} | {np.mean(tally['friction']):.0%} | {' | '.join(shares)} | "
                    f"{stated / real:.1f} | {sum(tally['false drift'])} of {len(tally['false drift'])} | "
                    f"{np.median(tally['error']):.2%} | "
                    f"{np.median(tally['half width of force']):.2%} | {np.mean(tally['score']):.2%} | "
                    f"{len(tally['refused'])} |",
                    flush=True,
                )
                for text in sorted({*tally["refused"]}):
                    print(f"  refused: {text[:200]}")


if __name__ == "__main__":
    main()
