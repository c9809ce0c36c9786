"""The stiffness in service on foreign rigs whose muscles become 10 % weaker while they track a sine.

    python benchmarks/service.py [--rigs 8] [--weight 0.4] [--out docs/results/service.md]

The rigs are those of tests/calibration/foreign.py: another law with kinks, four slip elements, creep, and valves of
second order with a delay. Each is calibrated with 15 s each of slow and fast motion, bare and with a weight, and then
tracks a sine, with and without dither of 1 to 4 Hz; after 30 s both muscles are 10 % weaker. Errors are those of the
mean stiffness of each 2 s, root mean squares over the rigs: before that, and 26 to 32 s after it.
"""

import argparse
import dataclasses
import sys
from datetime import date
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from mckibben.calibration import JointPrior, JointRecording, calibrate_joint
from mckibben.calibration.service import follow
from tests.calibration import foreign
from tests.calibration.test_estimation import LOAD, knee

BAR, DEG, AGED, SECONDS = 1e5, np.pi / 180, 30.0, 64.0
MEAN, SWING = 4.9e5, 0.6e5  # Pa, of the co-contraction


def tracked(rigs, amplitude, frequency, differential, common):
    """Angles [rad] and pressures [Pa] of all rigs and motions, sampled at 1 kHz; the arguments are over motions."""
    steps, step = int(SECONDS / foreign.PERIOD), foreign.PERIOD / foreign.INNER
    shape, sign = (rigs.count, len(amplitude)), np.array([-1.0, 1.0])
    time = np.arange(steps) * foreign.PERIOD
    phases = np.pi * np.arange(foreign.FREQUENCIES.size) ** 2 / foreign.FREQUENCIES.size
    wave = np.sin(2 * np.pi * foreign.FREQUENCIES * time[:, None] + phases).sum(axis=1)
    wave /= np.abs(wave).max()
    angle, rate, integral = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    length, stretch, creep = rigs.lengths(angle), np.zeros((*shape, 2, 4)), np.zeros((*shape, 2, 3))
    pressure, slope = np.full((*shape, 2), MEAN), np.zeros((*shape, 2))
    queue, decay = [pressure.copy() for _ in range(6)], np.exp(-step / rigs.times)
    angles, pressures = np.empty((steps, *shape)), np.empty((steps, *shape, 2))
    for k, now in enumerate(time):
        target = amplitude * np.sin(2 * np.pi * frequency * now)
        moving = amplitude * 2 * np.pi * frequency * np.cos(2 * np.pi * frequency * now)
        integral += 3e5 * (target - angle) * foreign.PERIOD
        wanted = integral + 2.2e5 * target + 2e5 * (target - angle) - 4e3 * (rate - moving / 2) + differential * wave[k]
        command = np.clip((MEAN + common * wave[k])[:, None] + sign * wanted[..., None], 0.2 * BAR, 6.3 * BAR)
        queue.append(command)
        late = queue.pop(0)
        for _ in range(foreign.INNER):
            slope += step * (70.0**2 * (late - pressure) - 2 * 0.8 * 70.0 * slope)
            pressure = pressure + step * slope
            after = rigs.lengths(angle)
            moved, length = (after - length)[..., None], after
            stretch, creep = np.clip(stretch + moved, -rigs.slips, rigs.slips), decay * (creep + moved)
            band = (rigs.bands * stretch / rigs.slips).sum(-1) * (1 + rigs.growth * (pressure / 3.5e5 - 1))
            law = rigs.tension(1 - after / rigs.length, pressure) * (0.9 if now >= AGED else 1.0)
            pull = np.maximum(law + band + (rigs.creep * creep).sum(-1), 0.0)
            torque = (pull * rigs.arm * np.cos(angle[..., None]) * sign).sum(-1)
            gravity = rigs.moment * np.sin(rigs.hanging - angle)
            rate = rate + step / rigs.inertia * (torque + gravity - rigs.viscous * rate)
            angle = angle + step * rate
        angles[k], pressures[k] = angle, pressure
    return time, angles, pressures


def drawn(count, weight):
    """Rigs, and the recordings of their calibration."""
    law, rng = knee().muscle1.law, np.random.default_rng(2)
    length = float(knee().muscle1.specimen.initial_length)
    numbers = map(float, (LOAD.total_inertia, LOAD.gravity_moment, LOAD.hanging_angle))
    rigs = foreign.draw(rng, count, lambda e, p: np.asarray(law.force(e, p)), length, 0.9 * length, 0.03, *numbers)
    parts = foreign.Parts(np.repeat([0.0, weight], 2), np.tile([False, True], 2))
    amplitude = foreign.adapted(rigs, parts, 0.0, (MEAN, SWING))
    time, angles, pressures = foreign.simulate(rigs, parts, 0.0, (MEAN, SWING), amplitude)
    recordings = []
    for rig in range(count):
        of_rig = []
        for part, mass in enumerate(parts.mass):
            read = foreign.measured(rng, angles[:, rig, part], pressures[:, rig, part], rigs.zero[rig, 0])
            of_rig.append(JointRecording(time, *read, None, mass, parts.distance, mass * 0.02**2))
        recordings.append(of_rig)
    return rigs, recordings


def only(rigs, number):
    """One of the rigs."""
    arrays = {name: value for name, value in vars(rigs).items() if isinstance(value, np.ndarray)}
    return dataclasses.replace(rigs, **{name: value[number : number + 1] for name, value in arrays.items()})


MOTIONS = {  # amplitude asked for [deg], frequency [Hz], differential and common dither [bar]
    "10 deg, 0.5 Hz": (15.5, 0.5, 0.0, 0.0),
    "with 0.05 bar, differential": (15.5, 0.5, 0.05, 0.0),
    "with 0.1 bar, differential": (15.5, 0.5, 0.1, 0.0),
    "with 0.1 bar, common": (15.5, 0.5, 0.0, 0.1),
    "10 deg, 1 Hz": (15.5, 1.0, 0.0, 0.0),
}


def main():
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=8)
    parser.add_argument("--weight", type=float, default=0.4)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rigs, recordings = drawn(options.rigs, options.weight)
    amplitude, frequency, differential, common = np.array(list(MOTIONS.values())).T
    time, angles, pressures = tracked(rigs, amplitude * DEG, frequency, differential * BAR, common * BAR)
    errors = [[] for _ in MOTIONS]  # estimate and calibration, before and after
    for rig in range(options.rigs):
        fit = calibrate_joint(knee(), LOAD, recordings[rig], JointPrior(mass=0.02, inertia=0.05))
        for motion in range(len(MOTIONS)):
            rng, true = np.random.default_rng((rig, motion)), only(rigs, rig)
            read = foreign.measured(rng, angles[:, rig, motion], pressures[:, rig, motion], rigs.zero[rig, 0])
            told, row = follow(fit, JointRecording(time, *read)), []
            for first, last in ((20.0, AGED), (AGED + 26, AGED + 32)):
                for end, value, before in zip(told.times, told.stiffness[:, 0], told.calibrated[:, 0], strict=True):
                    if first < end <= last:
                        within = slice(int((end - 2) * 1000), int(end * 1000), 20)
                        at = angles[within, rig, motion][None], pressures[within, rig, motion][None]
                        stiffness = true.stiffness(*at, step=DEG).mean() * (0.9 if end > AGED else 1.0)
                        row.append((first > AGED, value / stiffness - 1, before / stiffness - 1))
            errors[motion].append(row)
        print(f"rig {rig + 1} of {options.rigs}", file=sys.stderr, flush=True)
    lines = ["| motion | before | calibration | 30 s after | worst rig | calibration | moved by the dither |"]
    lines.append("|---|---|---|---|---|---|---|")
    for motion, name in enumerate(MOTIONS):
        rows = np.array(errors[motion])  # rigs, blocks, columns
        early, late = (rows[:, rows[0, :, 0] == when, 1:] for when in (0, 1))
        cells = [100 * np.sqrt(np.mean(part[..., column] ** 2)) for part in (early, late) for column in (0, 1)]
        cells.insert(3, 100 * np.abs(late[..., 0]).max())
        moved = np.sqrt(np.mean((angles[:, :, motion] - angles[:, :, 0])[20_000:30_000] ** 2)) / DEG
        dithered = f"{moved:.2f} deg" if differential[motion] or common[motion] else ""
        lines.append(f"| {name} | {' | '.join(f'{cell:.1f} %' for cell in cells)} | {dithered} |")
    command = f"python {' '.join(sys.argv)}"
    print("\n".join(lines))
    if options.out:
        about = __doc__.split("\n\n", 2)[2].strip()
        text = f"# Stiffness in service\n\nMade on {date.today()} by\n\n```sh\n{command}\n```\n\n{about}\n\n"
        options.out.write_text(text + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
