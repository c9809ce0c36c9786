"""What limits the stiffness: how much of the error of a wrong law motion can take away, by what else is known.

    python benchmarks/stiffness.py [--runs 256] [--figure docs/images/stiffness.png]

A knee at 0.25 to 0.5 Hz and 3 to 6 deg, 8 s each, whose stiffness steps; encoder of 0.022 deg, pressure noise of 4 kPa,
each muscle +-10 % against the law that the controller believes, friction of 0 to 15 N in each, mass +-50 %, valves of
10 to 50 ms (20 believed). Errors are those of the plant's true stiffness over the last 4 s, medians over the runs,
against a controller that believes its law. "Excited" adds a sine of 1 deg at 4 Hz to the reference angle. How wrong
the adaptation takes its equation to be is chosen for each row on other runs.
"""

import argparse
import dataclasses
from pathlib import Path

import equinox as eqx
import numpy as np

from mckibben import catalog
from mckibben.actuator import FirstOrderValve
from mckibben.control import (
    DecouplingControl,
    ExtendedStateObserver,
    LawAdaptation,
    Multisine,
    PolePlacement,
    Reference,
    Step,
)
from mckibben.muscle import MaxwellSlip, adjusted_law
from mckibben.plant import JointPlant, SampledSensors
from mckibben.simulation import simulate_many
from mckibben.units import deg, kPa, mm, ms

KNEE = eqx.tree_at(lambda j: j.geometry.connector_length, catalog.joint("knee-table-2"), 208 * mm)
LOAD = catalog.load("knee-table-2")
MASS_SPREAD, STRENGTH_SPREAD = 0.25 / 3**0.5, 0.1 / 3**0.5  # standard deviations of +-50 % and +-10 %, even
DURATION, SEEN = 8.0, 4.0
TORQUE_ERRORS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
NAMES = (
    "the law is believed",
    "adapted, load +-50 %",
    "adapted, load known",
    "adapted, presliding known",
    "adapted, both known",
)


def with_friction(half_width, presliding_length):
    """The knee with friction in both muscles; numbers, or pairs of them, and arrays over runs."""
    muscles = [
        dataclasses.replace(muscle, friction=MaxwellSlip(width, length))
        for muscle, width, length in zip((KNEE.muscle1, KNEE.muscle2), half_width, presliding_length, strict=True)
    ]
    return dataclasses.replace(KNEE, muscle1=muscles[0], muscle2=muscles[1])


def plants(runs, seed):
    """What differs from run to run: the plant, and its second mass [kg] and presliding lengths [m]."""
    draw = np.random.default_rng(seed)
    length = draw.uniform(0.3 * mm, 0.8 * mm, (2, runs))
    joint = with_friction(np.maximum(draw.uniform(0, 15, (2, runs)), 1e-3), length)
    strengths = 1 + 0.1 * draw.uniform(-1, 1, (2, runs))
    muscles = [
        dataclasses.replace(muscle, law=adjusted_law(muscle.law, strength=strength))
        for muscle, strength in zip((joint.muscle1, joint.muscle2), strengths, strict=True)
    ]
    mass = 0.5 * (1 + 0.5 * draw.uniform(-1, 1, runs))
    plant = JointPlant(
        dataclasses.replace(joint, muscle1=muscles[0], muscle2=muscles[1]),
        dataclasses.replace(LOAD, mass2=mass),
        FirstOrderValve(draw.uniform(10 * ms, 50 * ms, runs)),
        sensors=SampledSensors(0.022 * deg, 4 * kPa, 0.0, np.arange(runs)),
    )
    return plant, mass, length


def reference(runs, seed, excited):
    draw = np.random.default_rng([seed, 1])
    amplitude, frequency = draw.uniform(3 * deg, 6 * deg, runs), draw.uniform(0.25, 0.5, runs)
    before, after = draw.uniform(13.5, 17.0, (2, runs))
    shaken = 1 * deg if excited else 0.0
    angle = Multisine((amplitude, shaken), (frequency, 4.0), (np.pi / 2, np.pi / 2))
    return Reference(angle=angle, stiffness=Step(before, after, 2.0))


def knowledge(mass, length):
    """What a controller knows, from least to most: its model of the joint, its load, and the spread of its mass.

    None where it does not adapt.
    """
    unknown, some = dataclasses.replace(LOAD, mass2=0.5), with_friction((7.5, 7.5), (0.5 * mm, 0.5 * mm))
    right = with_friction((7.5, 7.5), length)
    known = dataclasses.replace(LOAD, mass2=mass)

    things = (
        (KNEE, unknown, None),
        (some, unknown, MASS_SPREAD),
        (some, known, 0.0),
        (right, unknown, MASS_SPREAD),
        (right, known, 0.0),
    )
    return dict(zip(NAMES, things, strict=True))


def errors(seed, runs, name, excited, torque_error):
    """The stiffness RMSE [N*m/rad] of each run's last seconds."""
    plant, mass, length = plants(runs, seed)
    model, load, mass_spread = knowledge(mass, length)[name]
    adaptation = None if mass_spread is None else LawAdaptation(STRENGTH_SPREAD, mass_spread, 0.6, torque_error)
    control = DecouplingControl(
        model,
        load,
        PolePlacement(80.0),
        ExtendedStateObserver(250.0),
        valve=FirstOrderValve(20 * ms),
        adaptation=adaptation,
    )
    batch = simulate_many(
        plant,
        control,
        reference(runs, seed, excited),
        duration=DURATION,
        metrics=("angle_rmse",),
        keep=("stiffness", "desired_stiffness"),
        substeps=2,
    )
    assert not batch.failed.any()
    late = batch.table["time"].to_numpy() >= DURATION - SEEN
    error = (batch.table["stiffness"] - batch.table["desired_stiffness"]).to_numpy()[:, late]
    return np.sqrt(np.mean(error**2, axis=1))


def main():
    parser = argparse.ArgumentParser(description="What limits the stiffness.")
    parser.add_argument("--runs", type=int, default=256, help="of each row")
    parser.add_argument("--figure", type=Path, help="draw the table, too")
    asked = parser.parse_args()
    found = {}
    print("| what is known | at work: stiffness RMSE | | error taken | excited | | error taken |")
    print("|---|---|---|---|---|---|---|")
    for name in NAMES:
        cells = []
        for excited in (False, True):
            tried = TORQUE_ERRORS if name != NAMES[0] else TORQUE_ERRORS[:1]
            on_others = [np.median(errors(2, asked.runs, name, excited, each)) for each in tried]
            best = tried[int(np.argmin(on_others))]
            rmse = found[name, excited] = errors(1, asked.runs, name, excited, best)
            ratio = np.median(rmse) / np.median(found[NAMES[0], excited])
            taken = f"{best:g} N*m" if len(tried) > 1 else "-"
            cells += [f"{np.median(rmse):.3f} N*m/rad", f"{ratio:.2f} x", taken]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
    if asked.figure:
        draw(found, asked.figure)


def draw(found, path):
    """Distributions of the error, by what is known."""
    from mckibben.report.palette import BLUE, VERMILLION
    from mckibben.report.style import DOUBLE, blank, house_style, legend_above, save

    with house_style():
        figure = blank(DOUBLE, 2.6)
        axes = figure.subplots()
        for excited, color, shift, label in ((False, BLUE, -0.15, "at work"), (True, VERMILLION, 0.15, "excited")):
            for row, name in enumerate(NAMES):
                low, middle, high = np.percentile(found[name, excited], [5, 50, 95])
                axes.plot([low, high], [row + shift] * 2, color=color, linewidth=1.0)
                axes.plot(middle, row + shift, "o", color=color, label=label if row == 0 else None)
        believed = np.median(found[NAMES[0], False])
        axes.axvline(0.6 * believed, color="0.5", linestyle=(0, (4, 2)), label="0.6 of the first median")
        axes.set(xscale="log", xlabel="stiffness rmse [N·m/rad]: median, and the middle 90 % of the runs")
        axes.set_yticks(range(len(NAMES)), NAMES)
        axes.invert_yaxis()
        legend_above(figure, axes, columns=3)
    save(figure, path.parent, path.stem)


if __name__ == "__main__":
    main()
