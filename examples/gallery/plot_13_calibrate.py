"""
Calibration on the joint
========================

A controller knows the stiffness only from its model. Slow sweeps of the joint, without and with a known weight, correct
the model.
"""

import dataclasses

import numpy as np

import mckibben as mk
from mckibben.calibration import JointRecording, calibrate_joint
from mckibben.units import bar, deg, mm, ms

printed = mk.catalog.joint("knee-table-2")
model = dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=208 * mm))
load = mk.catalog.load("knee-table-2")

# %%
# The muscles of the joint are weaker than those of the model by 10 % and 15 %.


def scaled(muscle, factor):
    law = muscle.law
    names = ("a1", "a2", "b1", "b2", "c1", "c2")
    return dataclasses.replace(
        muscle, law=dataclasses.replace(law, **{name: factor * getattr(law, name) for name in names})
    )


joint = dataclasses.replace(model, muscle1=scaled(model.muscle1, 0.9), muscle2=scaled(model.muscle2, 0.85))

# %%
# The existing controller sweeps angle and stiffness; a weight of 0.5 kg is attached for the second recording.

controller = mk.PositionStiffnessControl(
    mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar), mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0), model=model
)
reference = mk.Reference(
    angle=mk.Multisine(amplitudes=(8 * deg, 1 * deg), frequencies=(0.2, 1.0)),
    stiffness=mk.Sine(amplitude=2.0, frequency=0.1, offset=14.0),
)
recordings = []
for mass in (0.0, 0.5):
    plant = mk.JointPlant(joint, load.with_weight(mass, 200 * mm), mk.FirstOrderValve(time_constant=20 * ms))
    run = mk.simulate(plant, controller, reference, duration=10.0)
    pressures = np.column_stack([run["pressure1"], run["pressure2"]])
    recordings.append(JointRecording(run.times, run["angle"], pressures, added_mass=mass, distance=200 * mm))

# %%
# Angles and pressures alone determine the forces up to a common factor; the weight determines the factor.

found = calibrate_joint(model, load, recordings)
figure = mk.report.calibration(found)

# %%
# The stiffness according to both models, with standard deviations, and the true stiffness of the joint:

pressures = (5 * bar, 5 * bar)
for name, (value, deviation) in {
    "model before": found.prior_stiffness(0.0, pressures),
    "calibrated": found.stiffness(0.0, pressures),
    "joint": (joint.stiffness(0.0, pressures), 0.0),
}.items():
    print(f"{name:12} {float(value):6.2f} +- {float(deviation):.2f} N*m/rad")
