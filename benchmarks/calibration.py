"""What `mckibben calibrate` gains: stiffness errors after it, on the plants of the comparison's suite.

    python benchmarks/calibration.py [--runs 64] [--mass 0.5] [--duration 60] [--seed 20]

Plants and runs are those of examples/comparison/knee.yaml: a quarter of the muscles of another make, each +-10 %, mass
+-50 %, friction of 0 to 15 N. The plants differ from the controller's model in more: the weight is 1 % off (as its
intervals assume), the encoder's zero 0.3 deg and the moment arms 2 %, all with random signs; friction is 20 % larger in
one direction than in the other, and the muscles creep: a Maxwell arm each of 150 to 600 N/m and 1 to 10 s, all drawn.
The weight is clipped on for half of the duration.
Then the runs of the suite's evaluation are computed with PID, and with the decoupling controller with the model before
and after; errors are those of the plant's true stiffness. "Covered": part of the time along the sweeps that the 95 %
intervals hold the true stiffness, mean over plants with its standard error, and the part of plants where they hold it
for at least half of the time, with the median half width of the intervals. With load cells (gains 1 % wrong) there is
no weight.
"""

import argparse
import dataclasses
import time

import jax
import numpy as np

from mckibben.calibration import JointPrior, JointRecording, Sweeps, calibrate_joint
from mckibben.joint import ScaledArms
from mckibben.muscle import ForceCorrection, MaxwellCreep, corrected_law
from mckibben.plant import NoDisturbance
from mckibben.scenario import with_values
from mckibben.simulation import simulate_many
from mckibben.study.compare import Suite, draw
from mckibben.units import deg

SUITE, EVERY = "examples/comparison/knee.yaml", 2e-3
ENCODER, NOISE, CELL_NOISE = 0.022 * deg, 4e3, 0.5  # rad, Pa, N
ARMS, ZERO, WEIGHT, CELLS, ASYMMETRY = 0.02, 0.3 * deg, 0.01, 0.01, 0.2
CREEP, CREEP_TIME = (150.0, 600.0), (1.0, 10.0)  # N/m, s
KEPT = ("angle", "pressure1", "pressure2", "force1", "force2", "stiffness")


def truth(runs, rng):
    """The plants with what calibrations do not know, and the encoder's zero [rad] of each."""
    joint, count = runs.plant.joint, runs.count
    muscles = []
    for muscle in (joint.muscle1, joint.muscle2):
        shift = np.zeros((1, count)) + ASYMMETRY / 2 * np.asarray(muscle.friction.half_width)
        law = corrected_law(muscle.law, ForceCorrection(tuple(shift), (np.zeros(count),), 0.1, 0.1))
        creep = MaxwellCreep(rng.uniform(*CREEP, count), np.exp(rng.uniform(*np.log(CREEP_TIME), count)))
        muscles.append(dataclasses.replace(muscle, law=law, creep=creep))
    arms = ScaledArms(joint.geometry, 1 + ARMS * rng.choice([-1, 1], count))
    joint = dataclasses.replace(joint, geometry=arms, muscle1=muscles[0], muscle2=muscles[1])
    return dataclasses.replace(runs.plant, joint=joint), ZERO * rng.choice([-1, 1], count)


def recordings(plant, scenario, sweeps, zeros, rng, cells):
    """Recordings of all plants: a list for each."""
    count = zeros.size
    found = [[] for _ in range(count)]
    for mass, part in sweeps.scenarios(scenario).items():
        actual = mass * (1 + WEIGHT * rng.choice([-1, 1], count))
        here = dataclasses.replace(
            plant, load=plant.load.with_weight(actual, sweeps.distance), disturbance=NoDisturbance()
        )
        batch = simulate_many(
            here,
            part.control(),
            part.reference(),
            duration=part.duration,
            control_period=part.control_period,
            substeps=part.substeps,
            metrics=["angle_rmse"],
            keep=KEPT,
            every=EVERY,
        )
        times = batch.table["time"].to_numpy()
        for i in range(count):
            angle = np.round((batch["angle"][i] + zeros[i]) / ENCODER) * ENCODER
            pressures = np.stack([batch["pressure1"][i], batch["pressure2"][i]], axis=1)
            tensions = np.stack([batch["force1"][i], batch["force2"][i]], axis=1)
            gains = 1 + CELLS * rng.standard_normal(2)
            found[i].append(
                (
                    JointRecording(
                        times,
                        angle,
                        pressures + NOISE * rng.standard_normal(pressures.shape),
                        tensions * gains + CELL_NOISE * rng.standard_normal(tensions.shape) if cells else None,
                        mass,
                        sweeps.distance,
                    ),
                    {name: batch[name][i] for name in ("angle", "pressure1", "pressure2", "stiffness")},
                )
            )
    return found


def stacked(trees):
    """One tree of arrays over runs."""
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(one, float) for one in leaves]), *trees)


def main():
    """Print the table."""
    options = argparse.ArgumentParser()
    options.add_argument("--runs", type=int, default=64)
    options.add_argument("--mass", type=float, default=0.5)
    options.add_argument("--distance", type=float, default=0.2)
    options.add_argument("--duration", type=float, default=60.0)
    options.add_argument("--seed", type=int, default=20)
    given = options.parse_args()
    suite = Suite.read(SUITE)
    (runs,) = draw(suite, given.runs, given.seed).groups  # the joints differ in numbers
    rng = np.random.default_rng(given.seed)
    plant, zeros = truth(runs, rng)
    nominal = suite.scenario("decoupling, friction fed forward", next(iter(suite.references)))
    nominal = with_values(
        nominal,
        {
            "controller.feedback.bandwidth": 60.0,
            "controller.feedback.damping": 3.0,
            "controller.observer.bandwidth": 100.0,
            "controller.observer.damping": 3.0,
            "controller.pressure_observer.bandwidth": 100.0,
        },
    )
    control, pid = nominal.control(), suite.scenario("PID", next(iter(suite.references))).control()

    def errors(controller):
        batch = simulate_many(
            plant,
            controller,
            runs.reference,
            duration=suite.duration,
            control_period=suite.control_period,
            substeps=suite.substeps,
            metrics=["angle_rmse", "stiffness_rmse"],
        )
        return batch["angle_rmse"] / deg, batch["stiffness_rmse"]

    rows = {"PID": errors(pid), "decoupling, model before": errors(control)}
    for name, cells in (("calibrated with a weight", False), ("calibrated with load cells", True)):
        mass = 0.0 if cells else given.mass
        sweeps = Sweeps(-10 * deg, 10 * deg, given.duration / (1 if cells else 2), mass, given.distance)
        sets = recordings(plant, nominal, sweeps, zeros, rng, cells)
        begun, found, covered, widths = time.monotonic(), [], [], []
        for one in sets:
            found.append(calibrate_joint(control.model, control.load, [each for each, _ in one], JointPrior()))
            angle, first, second, true = (
                np.concatenate([each[key][::50] for _, each in one])
                for key in ("angle", "pressure1", "pressure2", "stiffness")
            )
            value, deviation = found[-1].stiffness(angle, (first, second))
            covered.append(np.mean(np.abs(value - true) < 1.96 * deviation))
            widths.append(np.median(1.96 * deviation))
        seconds = (time.monotonic() - begun) / given.runs
        models = stacked([each.joint for each in found])
        loads = stacked([each.load for each in found])
        rows[name] = errors(dataclasses.replace(control, model=models, load=loads))
        half = np.mean(np.asarray(covered) >= 0.5)
        share = f"covered {np.mean(covered):.3f} +- {np.std(covered) / given.runs**0.5:.3f} of the time"
        share += f", at least half of it in {half:.3f} of plants, +-{np.median(widths):.2f} N*m/rad"
        low, middle, most = np.percentile([each.residual / each.noise for each in found], [0, 50, 100])
        share += f"; residual {middle:.1f} ({low:.1f} to {most:.1f}) times its noise"
        print(f"{name}: {share}; {seconds:.1f} s each", flush=True)
    stiffness0 = rows["PID"][1]
    print("| | angle RMSE, median [deg] | stiffness RMSE, median (95 %) [N*m/rad] | against PID |")
    print("|---|---|---|---|")
    for name, (angle, stiffness) in rows.items():
        fine = np.isfinite(stiffness) & np.isfinite(stiffness0)
        median, high = np.percentile(stiffness[fine], [50, 95])
        ratio = median / np.median(stiffness0[fine])
        print(f"| {name} | {np.median(angle[fine]):.3f} | {median:.2f} ({high:.2f}) | {ratio:.2f} |")
    print(f"{np.sum(~np.isfinite(stiffness0))} of {given.runs} runs could not start")


if __name__ == "__main__":
    main()
