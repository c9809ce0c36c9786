"""Coverage of the intervals of `mckibben calibrate --valves`, on the plants of the comparison with real valves.

    python benchmarks/valves.py [--runs 12] [--duration 120] [--seed 30] [--setup NAME]

For each setup of examples/comparison/valves.yaml the first model is the data sheet, and each plant is drawn from the
conditions of the suite: conductance +-30 %, polytropic index, supply, dead volume, lags, delay, strength and friction.
The plants differ in more, all drawn uniformly: the encoder's zero by up to 2 deg, those of the pressure sensors by up
to 1.7 kPa, the moment arms by 5 %, the law by 15 %, the volume of the muscles by 8 %, the conductance to the exhaust by
30 % from that of the supply; a critical ratio of 0.2 to 0.5, and a leak of up to 0.3 % of the conductance; for
regulators a dead zone of up to 5 kPa. The priors of the encoder's zero, of the moment arms and of the supply are
1.2 deg, 3 % and 20 %. "Covered" is the share of 95 % intervals, of both valves, that contain the true value,
with its standard error over the plants.
"""

import argparse
import dataclasses
import time

import numpy as np

from mckibben.calibration import JointPrior, JointRecording, ValveExperiment, calibrate_scenario_valves
from mckibben.joint import ScaledArms
from mckibben.plant import NoDisturbance, PerfectSensors
from mckibben.simulation import simulate_many
from mckibben.study.compare import Suite, draw
from mckibben.units import deg, kPa

SUITE = "examples/comparison/valves.yaml"
ENCODER, NOISE = 0.022 * deg, 4 * kPa
ZERO, OFFSET, ARMS, LAW, VOLUME, EXHAUST, LEAK, DEAD_ZONE = 2 * deg, 1.7 * kPa, 0.05, 0.15, 0.08, 0.3, 3e-3, 5 * kPa
CRITICAL = 0.2, 0.5
PRIOR = JointPrior(zero=1.2 * deg, arm_scale=0.03, supply=0.2)
KEPT = ("angle", "pressure1", "pressure2", "command1", "command2")


def truth(plant, count, rng):
    """The plants with what calibrations do not know, and the encoder's zero [rad] of each."""

    def around(wide):
        return 1 + rng.uniform(-wide, wide, count)

    joint, muscles = plant.joint, []
    for muscle in (joint.muscle1, joint.muscle2):
        diameter = muscle.specimen.initial_diameter * np.sqrt(around(VOLUME))
        specimen = dataclasses.replace(muscle.specimen, initial_diameter=diameter)
        muscles.append(dataclasses.replace(muscle, specimen=specimen, strength=muscle.strength * around(LAW)))
    arms = ScaledArms(joint.geometry, around(ARMS))
    joint = dataclasses.replace(joint, geometry=arms, muscle1=muscles[0], muscle2=muscles[1])
    valve, conductance = plant.valve, np.asarray(plant.valve.conductance)
    fields = {"exhaust_conductance": conductance * around(EXHAUST), "leak": conductance * rng.uniform(0, LEAK, count)}
    fields["critical_ratio"] = rng.uniform(*CRITICAL, count)
    if hasattr(valve, "time_constant"):
        fields["dead_zone"] = rng.uniform(0, DEAD_ZONE, count)
    valve = dataclasses.replace(valve, **fields)
    quiet = dataclasses.replace(plant, joint=joint, valve=valve, sensors=PerfectSensors(), disturbance=NoDisturbance())
    return quiet, rng.uniform(-ZERO, ZERO, count)


def recordings(plant, parts, zeros, rng, substeps=None):
    """Recordings of all plants: a list for each."""
    found, offsets = [[] for _ in zeros], rng.uniform(-OFFSET, OFFSET, (zeros.size, 2))
    for part in parts.values():
        batch = simulate_many(
            plant,
            part.control(),
            part.reference(),
            duration=part.duration,
            control_period=part.control_period,
            substeps=substeps or part.substeps,
            metrics=["angle_rmse"],
            keep=KEPT,
            every=part.control_period,
        )
        times = batch.table["time"].to_numpy()
        for i, zero in enumerate(zeros):
            angle, *columns = (batch[name][i] for name in KEPT)
            pressures, commands = (np.stack(columns[at : at + 2], axis=1) for at in (0, 2))
            found[i].append(
                JointRecording(
                    times,
                    np.round((angle + zero) / ENCODER) * ENCODER,
                    pressures + offsets[i] + NOISE * rng.standard_normal(pressures.shape),
                    commands=commands,
                )
            )
    return found


def value(plant, name, i):
    """True value of a quantity of a plant."""
    of = plant.command_delay if name == "delay" else getattr(plant.valve, name)
    return float(np.broadcast_to(np.asarray(of, float), (i + 1,) if np.ndim(of) == 0 else np.shape(of))[i])


def main():
    """Print a table for each setup."""
    options = argparse.ArgumentParser()
    options.add_argument("--runs", type=int, default=12)
    options.add_argument("--duration", type=float, default=120.0)
    options.add_argument("--seed", type=int, default=30)
    options.add_argument("--setup", default="")
    given = options.parse_args()
    whole = Suite.read(SUITE)
    print("| setup | quantity | covered | median half width | before |")
    print("|---|---|---|---|---|")
    for setup in [given.setup] if given.setup else whole.setups:
        suite, rng = whole.of_setup(setup), np.random.default_rng(given.seed)
        (runs,) = draw(suite, given.runs, given.seed).groups
        plant, zeros = truth(runs.plant, given.runs, rng)
        nominal = suite.scenario("PID", next(iter(suite.references)))
        parts = ValveExperiment(-10 * deg, 10 * deg, given.duration).scenarios(nominal)
        sets = recordings(plant, parts, zeros, rng)
        begun = time.monotonic()
        found = [calibrate_scenario_valves(nominal, one, PRIOR) for one in sets]
        misfits = sum(remark.field == "residual" for one in found for remark in one.remarks())
        seconds = (time.monotonic() - begun) / given.runs
        ratios = [one.residual / one.noise for one in found]
        for name in dict.fromkeys(name.partition(".")[2] for name in found[0].quantities):
            if name in ("pressure_zero", "zero", "arm_scale", "volume"):
                continue
            covered, width, before = [], [], []
            for i, one in enumerate(found):
                for each in (one.quantities[f"valve1.{name}"], one.quantities[f"valve2.{name}"]):
                    low, high = each.interval
                    true = value(plant, name, i)
                    covered.append(low <= true <= high)
                    width.append(1.96 * each.deviation / true if true else np.nan)
                    before.append(1.96 * each.prior / true if true else np.nan)
            each = np.reshape(covered, (-1, 2)).mean(axis=1)
            share = f"{100 * np.mean(covered):.0f} +- {100 * np.std(each) / given.runs**0.5:.0f} %"
            print(f"| {setup} | {name} | {share} | {100 * np.median(width):.1f} % | {100 * np.median(before):.0f} % |")
        print(
            f"{setup}: residual {min(ratios):.2f} to {max(ratios):.2f} times the noise, {misfits} misfits, "
            f"{seconds:.1f} s each",
            flush=True,
        )


if __name__ == "__main__":
    main()
