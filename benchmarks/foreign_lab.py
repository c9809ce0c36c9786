# ruff: noqa: E501 - tables of cases
"""The documented procedure on labs that share no code with the plants of the toolkit.

    python benchmarks/foreign_lab.py regulator|spool|switching|pair|servo --out DIR
        [--air '0.3 L'] [--runs 24] [--seed 11] [--only STEP]

The steps are 1 to 6 of docs/compare.md, "For your joint and valves", and all but the last are commands of `mckibben`
on the rig of benchmarks/foreign_rig.py, or for `pair` and `servo` on that of benchmarks/foreign_elbow.py: a test of
one muscle, its force law, the joint with a weight of 1.5 kg (2 kg on the elbow), the valves, and a comparison on the
calibrated model, in which the PIDs have three times the searches of the others. The last step runs the tuned controllers on
the foreign plant, with other loads, supplies, friction, disturbances and references in each run, and prints the median
angle RMSE, in which failed runs count as infinite, the same without the offset of the encoder, which no controller can
correct, diverged runs + limit cycles, and the air that the plant used. `--air` is the scale of the air in the cost of
the search. `--only` repeats one step: files, identify, joint, valves, compare or evaluate.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import foreign_elbow
import jax
import jax.numpy as jnp
import numpy as np
import yaml
from jax import lax

from mckibben.control import Measurement, Setpoint
from mckibben.numerics.compiled import numeric
from mckibben.scenario import Scenario
from mckibben.simulation.oscillation import find_limit_cycle
from mckibben.study.compare import Suite, draw

PERIOD, HIGHEST = foreign_elbow.rig.PERIOD, foreign_elbow.rig.HIGHEST  # of both rigs
EXAMPLES = Path("examples").resolve()


class Lab(NamedTuple):
    """What differs between labs: plant and rig, drawing, references, sensors, muscles, weight, and the runs."""

    plant: ModuleType
    rig: str
    name: str
    radius: str
    rest_length: str
    load: str
    sensors: dict[str, str]
    stiffness: str
    references: dict[str, str]  # of the suite, and those in their place
    stroke: int  # %, of the test of a muscle
    weight: int  # g
    distance: str
    friction: str
    disturbance: float  # N m
    compressor: tuple[float, float]  # Pa
    mass: tuple[float, float]  # of that of the plant
    coulomb: tuple[float, float]  # N


JOINT = Lab(
    plant=foreign_elbow.rig,
    rig="ForeignRig",
    name="a foreign joint",
    radius="28 mm",
    rest_length="225 mm",
    load="mass: 1.15 kg, length: 250 mm, damping: 0.05 N*m*s/rad",
    sensors={"encoder": "0.044 deg", "pressure_noise": "3 kPa"},
    stiffness="12 N*m/rad",
    references={"13.5..16": "10..13", "14 N*m": "11 N*m", "16 N*m": "13 N*m", "15 N*m": "12 N*m"},
    stroke=24,
    weight=1500,
    distance="200 mm",
    friction="3..15 N",
    disturbance=0.3,
    compressor=(6.4e5, 7.4e5),
    mass=(0.9, 1.1),
    coulomb=(3, 8),
)
ELBOW = Lab(
    plant=foreign_elbow,
    rig="ElbowRig",
    name="a foreign elbow",
    radius="25 mm",
    rest_length="270 mm",
    load="mass: 2 kg, length: 300 mm, damping: 0.1 N*m*s/rad",
    sensors={"encoder": "0.088 deg", "pressure_noise": "2 kPa"},
    stiffness="11 N*m/rad",
    references={"13.5..16": "8..13", "14 N*m": "9 N*m", "16 N*m": "12 N*m", "15 N*m": "11 N*m"},
    stroke=22,
    weight=2000,
    distance="300 mm",
    friction="4..18 N",
    disturbance=0.6,
    compressor=(6.3e5, 7.4e5),
    mass=(0.8, 1.2),
    coulomb=(3, 9),
)


class Known(NamedTuple):
    """What a lab knows of its valves: data sheet and tube, delay, class of first gains, lag, substeps."""

    lab: Lab
    valve: str
    delay: str
    gains: str
    lag: str
    substeps: int


LEFT_OUT = "decoupling", "oracle"  # of the controllers of valves.yaml
VALVES = {
    "regulator": Known(
        JOINT,
        "{class: regulator, conductance: 0.045 L/(s*bar), supply: 7 bar, time_constant: 20 ms, band: 0.5 bar, dead_volume: 6 cm^3}",
        delay="4 ms",
        gains="regulator",
        lag="time_constant",
        substeps=6,
    ),
    "spool": Known(JOINT, "{from: festo-mpye-5-m5, supply: 7 bar, dead_zone: 3 %, dead_volume: 6 cm^3}", delay="2 ms", gains="mpye-5-m5", lag="spool_lag", substeps=12),
    "switching": Known(
        JOINT,
        "{from: festo-mh1, conductance: 0.06 L/(s*bar), supply: 7 bar, period: 8 ms, opening_delay: 1 ms, dead_volume: 3 cm^3}",
        delay="1 ms",
        gains="mh1",
        lag="opening_delay",
        substeps=6,
    ),
    "pair": Known(
        ELBOW,
        "{class: regulator, conductance: 0.5 L/(s*bar), supply: 7 bar, time_constant: 5 ms, band: 0.5 bar, dead_volume: 14 cm^3}",
        delay="2 ms",
        gains="regulator",
        lag="time_constant",
        substeps=6,
    ),
    "servo": Known(
        ELBOW,
        "{class: regulator, conductance: 0.2 L/(s*bar), supply: 7 bar, time_constant: 25 ms, band: 0.5 bar, dead_zone: 0.08 bar, dead_volume: 19 cm^3}",
        delay="4 ms",
        gains="regulator",
        lag="time_constant",
        substeps=6,
    ),
}  # fmt: skip
SCENARIO = """\
name: {lab.name}, {kind}
joint:
  geometry:
    class: PairedPaths
    path1: {{class: Pulley, radius: {lab.radius}, rest_length: {lab.rest_length}}}
    path2: {{class: Pulley, radius: {lab.radius}, rest_length: {lab.rest_length}}}
  muscle: fit/muscle.yaml
load: {{class: pendulum, {lab.load}}}
valve: {known.valve}
command_delay: {known.delay}
sensors: {{encoder: {lab.sensors[encoder]}, pressure_noise: {lab.sensors[pressure_noise]}}}
{controller}reference:
  angle: {{class: sine, amplitude: 5 deg, frequency: 0.5 Hz, phase: 90 deg}}
  stiffness: {lab.stiffness}
start: {{angle: 5 deg}}
duration: 4 s
control_period: 1 ms
substeps: 12
"""
HELD, END = 2000, 500  # periods before a run, and of the error at its end


def files(kind, folder):
    """Write what the lab knows: the test of a muscle, drawing and data sheets, the rig."""
    known = VALVES[kind]
    lab, rng = known.lab, np.random.default_rng(4)
    plant = lab.plant.numbers(kind)
    rows, stroke = ["pressure_bar,force_N,contraction_percent"], np.linspace(0, lab.stroke, lab.stroke + 1)
    for level in (0.5, 1, 2, 3, 4, 5, 6):
        for side, way in ((-1, stroke), (1, stroke[::-1])):
            for percent in way:
                pressure = level + rng.normal(0, 0.01)
                force = float(lab.plant.law(plant, percent / 100, pressure * 1e5))
                drag = lab.plant.drag(plant, force, side, abs(percent - way[0]) / 100)
                pulled = max(force + drag, 0) + rng.normal(0, 1)
                rows.append(f"{pressure:.3f},{pulled:.2f},{percent:.2f}")
    (folder / "muscle.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    text = (EXAMPLES / "valves" / f"{known.gains}-decoupling.yaml").read_text(encoding="utf-8")
    controller = text[text.index("controller:") : text.index("reference:")]
    scenario = SCENARIO.format(kind=kind, lab=lab, known=known, controller=controller)
    (folder / "scenario.yaml").write_text(scenario, encoding="utf-8")
    for name, weight in (("joint", lab.weight), ("valves", 0)):
        rig = f"rig: {{class: {lab.rig}, valves: {kind}, weight: {weight}}}\n"
        (folder / f"{name}-rig.yaml").write_text(rig, encoding="utf-8")


def mckibben(kind, folder, *words):
    """Run a command of the toolkit in a folder, with the rig, and with yes to all questions."""
    extension = Path(VALVES[kind].lab.plant.__file__).resolve()
    command = [sys.executable, "-m", "mckibben", "--extension", str(extension), *words]
    subprocess.run(command, cwd=folder, check=True, input="y\n" * 9, text=True)


def suite_of(kind, folder, air):
    """Write the suite: that of the real valves, with joint, load, valve and delay of the calibration."""
    text = (EXAMPLES / "comparison" / "valves.yaml").read_text(encoding="utf-8")
    known = VALVES[kind]
    lab = known.lab
    for old, new in lab.references.items():
        text = text.replace(old, new)
    suite = yaml.safe_load(text.replace("air/0.3 L", f"air/{air}"))
    plant = yaml.safe_load((folder / "valves" / "scenario.yaml").read_text(encoding="utf-8"))
    valve, delay = plant["valve"], float(plant["command_delay"].split()[0])
    margin = max(2, 0.25 * delay)
    first, second = ("valve.muscle1", "valve.muscle2") if valve["class"] == "unequal" else ("valve", "valve")
    conditions = [f"{one}.conductance=+-25 %" for one in dict.fromkeys((first, second))]
    for one in dict.fromkeys((first, second)):
        part = valve[one.removeprefix("valve.")] if "." in one else valve
        lag, longest = (float(part.get(name, "inf ms").split()[0]) for name in (known.lag, "period"))
        conditions.append(f"{one}.{known.lag}={0.75 * lag}..{min(1.25 * lag, longest)} ms")
    suite |= {
        "name": f"{lab.name}, {kind}",
        "joint": "joint/model.yaml",
        "load": plant["load"],
        "sensors": dict(lab.sensors),
        "setups": {
            kind: {
                "valve": valve,
                "command_delay": plant["command_delay"],
                "conditions": [*conditions, f"command_delay={max(delay - margin, 0)}..{delay + margin} ms"],
                "substeps": known.substeps,
            }
        },
        "conditions": [
            f"joint.muscle1.friction.half_width={lab.friction}",
            f"joint.muscle2.friction.half_width={lab.friction}",
            "load.mass=+-30 %",
            *(f"{one}.supply=+-8 %" for one in dict.fromkeys((first, second))),
            f"disturbance.height=0 N*m, {lab.disturbance} N*m",
        ],
        "controllers": {name: one for name, one in suite["controllers"].items() if name not in LEFT_OUT},
        "true_model": [],
    }
    tuning = suite["tuning"]
    tuning["over"] = {name: one for name, one in tuning["over"].items() if name not in LEFT_OUT}
    (folder / "suite.yaml").write_text(yaml.safe_dump(suite, sort_keys=False), encoding="utf-8")


def drawn(kind, count, rng):
    """Numbers of the plants of the runs, of shape (count,) where they differ."""
    lab = VALVES[kind].lab
    plant = lab.plant.numbers(kind)
    varied = {
        "compressor": rng.uniform(*lab.compressor, count),
        "mass": plant["mass"] * rng.uniform(*lab.mass, count),
        "coulomb": rng.uniform(*lab.coulomb, count),
        "disturbed": rng.choice([0.0, lab.disturbance], count),
    }
    return plant, varied


def course(kind, plant, control, angles, stiffnesses, noise):
    """True angle [rad] and air [m^3] of a run, each of shape (periods,)."""
    foreign = VALVES[kind].lab.plant
    state = foreign.start(plant, angles[0], (2.5e5, 2.5e5))

    def measured(state, noise):
        angle, (one, two) = foreign.sensed(plant, state, noise)
        return Measurement(angle, (one, two))

    def period(carry, given):
        state, inner = carry
        angle, stiffness, noise = given
        inner, commands = control.step(inner, Setpoint(angle, stiffness), measured(state, noise), PERIOD)
        commands = tuple(jnp.clip(one, 0.0, HIGHEST) for one in commands)
        return (foreign.advance(kind, plant, state, commands), inner), (state["angle"], state["air"])

    return lax.scan(period, (state, control.init(measured(state, noise[0]))), (angles, stiffnesses, noise))[1]


def evaluate(kind, folder, count, seed):
    """Print a row for each tuned controller."""
    rng, suite = np.random.default_rng(seed), Suite.read(folder / "suite.yaml").of_setup(kind)
    (group,) = draw(suite, count, seed).groups
    setpoints = [np.asarray(getattr(group.parts.reference, name).values) for name in ("angle", "stiffness")]
    angles, stiffnesses = (np.concatenate([np.repeat(one[:, :1], HELD, 1), one], axis=1) for one in setpoints)
    noise = rng.standard_normal((*angles.shape, 2))
    plant, varied = drawn(kind, count, rng)

    @jax.jit
    def runs(control):
        def of(varied, *row):
            return course(kind, plant | varied, control, *row)

        return jax.vmap(of)(varied, angles, stiffnesses, noise)

    print("| controller | median angle RMSE | without offset | failed | air |\n|---|---|---|---|---|")
    for path in sorted((folder / "comparison" / kind / "controllers").glob("*.yaml")):
        control = Scenario.read(path).control().with_period(PERIOD)
        true, air = map(np.asarray, runs(numeric(control)))
        error, desired = (true - angles)[:, HELD:], angles[:, HELD:]
        end = np.sqrt(np.mean(error[:, -END:] ** 2, axis=1))
        lost = ~np.isfinite(end) | (end > np.maximum(np.deg2rad(5), np.ptp(desired, axis=1)))
        cycles = jax.vmap(lambda a, d: find_limit_cycle(a, d, PERIOD, plant["encoder"]).amplitude)
        cycling = ~lost & (np.asarray(cycles(true[:, HELD:], desired)) > 0)
        errors = (error, error + plant["zero"])  # true, and as the encoder reads
        rmse, read = (
            np.median(np.where(lost | cycling, np.inf, np.degrees(np.sqrt(np.mean(one**2, axis=1))))) for one in errors
        )
        used = np.median(air[:, -1] - air[:, HELD]) * 1e3
        failed = f"{lost.sum()} + {cycling.sum()}"
        print(f"| {path.stem} | {rmse:.2f} deg | {read:.2f} deg | {failed} | {used:.2f} L |", flush=True)


def main():
    """Run all steps, or one."""
    options = argparse.ArgumentParser()
    options.add_argument("valves", choices=VALVES)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--air", default="0.3 L")
    options.add_argument("--runs", type=int, default=24)
    options.add_argument("--seed", type=int, default=11)
    options.add_argument("--only", default="")
    given = options.parse_args()
    kind, folder = given.valves, given.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    lab = VALVES[kind].lab
    weight = ("--weight", f"{lab.weight} g, {lab.distance}", "--limb", "estimated", "--angles", "-14..14 deg")
    length, diameter = (f"{1e3 * lab.plant.SPECIMEN[name]:g} mm" for name in ("length", "diameter"))
    size = ("--initial-length", length, "--inner", diameter)

    def compare():
        suite_of(kind, folder, given.air)
        mckibben(kind, folder, "compare", "suite.yaml", "--resume", "--out", "comparison")

    def calibrate(scenario, out, *more):
        mckibben(kind, folder, "calibrate", scenario, "--rig", f"{out}-rig.yaml", "--out", out, *more)

    def valves():
        (folder / "prior.yaml").write_text("supply: 10 %\n", encoding="utf-8")
        calibrate("joint/scenario.yaml", "valves", "--valves", "--prior", "prior.yaml")

    steps = {
        "files": lambda: files(kind, folder),
        "identify": lambda: mckibben(kind, folder, "identify", "muscle.csv", *size, "--out", "fit"),
        "joint": lambda: calibrate("scenario.yaml", "joint", *weight),
        "valves": valves,
        "compare": compare,
        "evaluate": lambda: evaluate(kind, folder, given.runs, given.seed),
    }
    for name in [given.only] if given.only else steps:
        steps[name]()


if __name__ == "__main__":
    main()
