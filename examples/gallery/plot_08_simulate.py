"""
Position and stiffness of a knee
================================

Two PID loops: the angle error sets the difference of the pressures, the stiffness error their mean.
"""

import dataclasses

import mckibben as mk
from mckibben.units import bar, deg, mm, ms

printed = mk.catalog.joint("knee-table-2")
knee = dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=208 * mm))
plant = mk.JointPlant(knee, mk.catalog.load("knee-table-2"), mk.FirstOrderValve(time_constant=20 * ms))
reference = mk.Reference(
    angle=mk.Sine(amplitude=10 * deg, frequency=0.5), stiffness=mk.Step(before=13.0, after=17.0, at=5.0)
)

# %%
# Is the reference statically feasible?

mk.check_reference(plant, reference)

# %%
# The stiffness is not measured but computed by a model of the joint. Here the model is correct.

controller = mk.PositionStiffnessControl(
    mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar), mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0), model=knee
)
result = mk.simulate(plant, controller, reference, duration=10.0)
result

# %%
figure = mk.report.tracking({"PID": result})

# %%
# ``mk.report.animate(result, "run.webp", plant)`` shows the joint in motion:
#
# .. image:: /images/knee.webp
#    :alt: The knee follows a sine; its muscles change colour with their pressure
