"""The documented procedure on a lab that shares no code with the plants of the toolkit.

    python benchmarks/foreign_lab.py regulator|spool|switching --out DIR [--runs 24] [--seed 11] [--only STEP]

The steps are 1 to 6 of docs/compare.md, "For your joint and valves", and all but the last are commands of `mckibben` on
the rig of benchmarks/foreign_rig.py: a test of one muscle, its force law, the joint with a weight of 500 g, the valves,
and a comparison with short searches on the calibrated model, in which the PIDs have ten times the budget of the others.
The last step runs the tuned controllers on the foreign plant, with other loads, supplies, friction, disturbances and
references in each run, and prints the median angle RMSE, in which failed runs count as infinite, diverged runs + limit
cycles, and the air that the plant used. `--only` repeats one step: files, identify, joint, valves, compare or evaluate.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import foreign_rig as foreign
import jax
import jax.numpy as jnp
import numpy as np
import yaml
from jax import lax

from mckibben.control import Measurement, Setpoint
from mckibben.numerics.compiled import numeric
from mckibben.scenario import Scenario
from mckibben.simulation.oscillation import find_limit_cycle
from mckibben.study.benchmark import Suite, draw

EXAMPLES = Path("examples").resolve()
EXTENSION = Path(__file__).with_name("foreign_rig.py").resolve()


class Known(NamedTuple):
    """What a lab knows of its valves: data sheet and tube, delay, class of first gains, lag, substeps."""

    valve: str
    delay: str
    gains: str
    lag: str
    substeps: int


VALVES = {
    "regulator": Known(
        "{class: regulator, conductance: 0.045 L/(s*bar), supply: 7 bar, time_constant: 20 ms, band: 0.5 bar, "
        "dead_volume: 6 cm^3}",
        delay="4 ms",
        gains="regulator",
        lag="time_constant",
        substeps=6,
    ),
    "spool": Known(
        "{from: festo-mpye-5-m5, supply: 7 bar, dead_zone: 3 %, dead_volume: 6 cm^3}",
        delay="2 ms",
        gains="mpye-5-m5",
        lag="spool_lag",
        substeps=12,
    ),
    "switching": Known(
        "{from: festo-mh1, conductance: 0.06 L/(s*bar), supply: 7 bar, period: 8 ms, opening_delay: 1 ms, "
        "dead_volume: 3 cm^3}",
        delay="1 ms",
        gains="mh1",
        lag="opening_delay",
        substeps=6,
    ),
}
SCENARIO = """\
name: a foreign joint, {kind}
joint:
  geometry:
    class: PairedPaths
    path1: {{class: Pulley, radius: 28 mm, rest_length: 225 mm}}
    path2: {{class: Pulley, radius: 28 mm, rest_length: 225 mm}}
  muscle: fit/muscle.yaml
load: {{class: pendulum, mass: 1.15 kg, length: 250 mm, damping: 0.05 N*m*s/rad}}
valve: {valve}
command_delay: {delay}
sensors: {{encoder: 0.044 deg, pressure_noise: 3 kPa}}
{controller}reference:
  angle: {{class: sine, amplitude: 5 deg, frequency: 0.5 Hz, phase: 90 deg}}
  stiffness: 12 N*m/rad
start: {{angle: 5 deg}}
duration: 4 s
control_period: 1 ms
substeps: 12
"""
STIFFNESS = {"13.5..16": "10..13", "14 N*m/rad": "11 N*m/rad", "16 N*m/rad": "13 N*m/rad", "15 N*m/rad": "12 N*m/rad"}
LEFT_OUT = ("decoupling", "oracle")
TRAINING = 8  # runs
HELD, END = 2000, 500  # periods before a run, and of the error at its end


def files(kind, folder):
    """Write what the lab knows: the test of a muscle, drawing and data sheets, the rig."""
    plant, rng = foreign.numbers(kind), np.random.default_rng(4)
    rows, stroke = ["pressure_bar,force_N,contraction_percent"], np.linspace(0, 24, 25)
    for level in (0.5, 1, 2, 3, 4, 5, 6):
        for side, way in ((-1, stroke), (1, stroke[::-1])):
            for percent in way:
                pressure = level + rng.normal(0, 0.01)
                force = float(foreign.law(plant, percent / 100, pressure * 1e5))
                pulled = max(force + side * (plant["coulomb"] + plant["by_force"] * force), 0) + rng.normal(0, 1)
                rows.append(f"{pressure:.3f},{pulled:.2f},{percent:.2f}")
    (folder / "muscle.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    known = VALVES[kind]
    text = (EXAMPLES / "valves" / f"{known.gains}-decoupling.yaml").read_text(encoding="utf-8")
    controller = text[text.index("controller:") : text.index("reference:")]
    scenario = SCENARIO.format(kind=kind, valve=known.valve, delay=known.delay, controller=controller)
    (folder / "scenario.yaml").write_text(scenario, encoding="utf-8")
    for name, weight in (("joint", 500), ("valves", 0)):
        rig = f"rig: {{class: ForeignRig, valves: {kind}, weight: {weight}}}\n"
        (folder / f"{name}-rig.yaml").write_text(rig, encoding="utf-8")


def mckibben(folder, *words):
    """Run a command of the toolkit in a folder, with the rig, and with yes to all questions."""
    command = [sys.executable, "-m", "mckibben", "--extension", str(EXTENSION), *words]
    subprocess.run(command, cwd=folder, check=True, input="y\n" * 9, text=True)


def suite_of(kind, folder):
    """Write the suite: that of the real valves, with joint, load, valve and delay of the calibration."""
    text = (EXAMPLES / "comparison" / "valves.yaml").read_text(encoding="utf-8")
    for old, new in STIFFNESS.items():
        text = text.replace(old, new)
    suite = yaml.safe_load(text)
    control = yaml.safe_load((folder / "valves" / "scenario.yaml").read_text(encoding="utf-8"))["controller"]
    valve, delay, known = control["valve"], float(control["command_delay"].split()[0]), VALVES[kind]
    first, second = ("valve.muscle1", "valve.muscle2") if valve["class"] == "unequal" else ("valve", "valve")
    conditions = [f"{one}.conductance=+-25 %" for one in dict.fromkeys((first, second))]
    for one in dict.fromkeys((first, second)):
        part = valve[one.removeprefix("valve.")] if "." in one else valve
        lag, longest = (float(part.get(name, "inf ms").split()[0]) for name in (known.lag, "period"))
        conditions.append(f"{one}.{known.lag}={0.75 * lag}..{min(1.25 * lag, longest)} ms")
    suite |= {
        "name": f"a foreign joint, {kind}",
        "joint": "joint/model.yaml",
        "load": control["load"],
        "sensors": {"encoder": "0.044 deg", "pressure_noise": "3 kPa"},
        "setups": {
            kind: {
                "valve": valve,
                "command_delay": control["command_delay"],
                "conditions": [*conditions, f"command_delay={max(delay - 2, 0)}..{delay + 2} ms"],
                "substeps": known.substeps,
            }
        },
        "conditions": [
            "joint.muscle1.friction.half_width=3..15 N",
            "joint.muscle2.friction.half_width=3..15 N",
            "load.mass=+-30 %",
            *(f"{one}.supply=+-8 %" for one in dict.fromkeys((first, second))),
            "disturbance.height=0 N*m, 0.3 N*m",
        ],
        "controllers": {name: one for name, one in suite["controllers"].items() if name not in LEFT_OUT},
        "true_model": [],
    }
    suite["tuning"]["runs"] = TRAINING
    (folder / "suite.yaml").write_text(yaml.safe_dump(suite, sort_keys=False), encoding="utf-8")


def drawn(kind, count, rng):
    """Numbers of the plants of the runs, of shape (count,) where they differ."""
    plant = foreign.numbers(kind)
    varied = {
        "compressor": rng.uniform(6.4e5, 7.4e5, count),
        "mass": plant["mass"] * rng.uniform(0.9, 1.1, count),
        "coulomb": rng.uniform(3, 8, count),
        "disturbed": rng.choice([0.0, 0.3], count),
    }
    return plant, varied


def course(kind, plant, control, angles, stiffnesses, noise):
    """True angle [rad] and air [m^3] of a run, each of shape (periods,)."""
    state = foreign.start(plant, angles[0], (2.5e5, 2.5e5))

    def measured(state, noise):
        angle, (one, two) = foreign.sensed(plant, state, noise)
        return Measurement(angle, (one, two))

    def period(carry, given):
        state, inner = carry
        angle, stiffness, noise = given
        inner, commands = control.step(inner, Setpoint(angle, stiffness), measured(state, noise), foreign.PERIOD)
        commands = tuple(jnp.clip(one, 0.0, foreign.HIGHEST) for one in commands)
        return (foreign.advance(kind, plant, state, commands), inner), (state["angle"], state["air"])

    return lax.scan(period, (state, control.init(measured(state, noise[0]))), (angles, stiffnesses, noise))[1]


def evaluate(kind, folder, count, seed):
    """Print a row for each tuned controller."""
    rng, suite = np.random.default_rng(seed), Suite.read(folder / "suite.yaml").of_setup(kind)
    (group,) = draw(suite, count, seed).groups
    setpoints = [np.asarray(getattr(group.reference, name).values) for name in ("angle", "stiffness")]
    angles, stiffnesses = (np.concatenate([np.repeat(one[:, :1], HELD, 1), one], axis=1) for one in setpoints)
    noise = rng.standard_normal((*angles.shape, 2))
    plant, varied = drawn(kind, count, rng)

    @jax.jit
    def runs(control):
        def of(varied, *row):
            return course(kind, plant | varied, control, *row)

        return jax.vmap(of)(varied, angles, stiffnesses, noise)

    print("| controller | median angle RMSE | failed | air |\n|---|---|---|---|")
    for path in sorted((folder / "comparison" / kind / "controllers").glob("*.yaml")):
        control = Scenario.read(path).control().with_period(foreign.PERIOD)
        true, air = map(np.asarray, runs(numeric(control)))
        error, desired = (true - angles)[:, HELD:], angles[:, HELD:]
        end = np.sqrt(np.mean(error[:, -END:] ** 2, axis=1))
        lost = ~np.isfinite(end) | (end > np.maximum(np.deg2rad(5), np.ptp(desired, axis=1)))
        cycles = jax.vmap(lambda a, d: find_limit_cycle(a, d, foreign.PERIOD, plant["encoder"]).amplitude)
        cycling = ~lost & (np.asarray(cycles(true[:, HELD:], desired)) > 0)
        rmse = np.degrees(np.sqrt(np.mean(error**2, axis=1)))
        median = np.median(np.where(lost | cycling, np.inf, rmse))
        used = np.median(air[:, -1] - air[:, HELD]) * 1e3
        print(f"| {path.stem} | {median:.2f} deg | {lost.sum()} + {cycling.sum()} | {used:.2f} L |", flush=True)


def main():
    """Run all steps, or one."""
    options = argparse.ArgumentParser()
    options.add_argument("valves", choices=VALVES)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--runs", type=int, default=24)
    options.add_argument("--seed", type=int, default=11)
    options.add_argument("--only", default="")
    given = options.parse_args()
    kind, folder = given.valves, given.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    weight = ("--weight", "0.5 kg", "--distance", "200 mm", "--angles", "-14..14 deg")
    size = ("--initial-length", "250 mm", "--diameter", "15 mm")

    def compare():
        suite_of(kind, folder)
        mckibben(folder, "compare", "suite.yaml", "--quick", "--resume", "--out", "comparison")

    def calibrate(scenario, out, *more):
        mckibben(folder, "calibrate", scenario, "--rig", f"{out}-rig.yaml", "--out", out, *more)

    steps = {
        "files": lambda: files(kind, folder),
        "identify": lambda: mckibben(folder, "identify", "muscle.csv", *size, "--out", "fit"),
        "joint": lambda: calibrate("scenario.yaml", "joint", *weight),
        "valves": lambda: calibrate("joint/scenario.yaml", "valves", "--valves", "--supply-error", "10 %"),
        "compare": compare,
        "evaluate": lambda: evaluate(kind, folder, given.runs, given.seed),
    }
    for name in [given.only] if given.only else steps:
        steps[name]()


if __name__ == "__main__":
    main()
