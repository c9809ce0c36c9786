"""
Attainable stiffness of a joint
===============================

Two muscles can stiffen a joint without moving it, by co-contraction. The geometry determines by how much, more than the
controller does.
"""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.units import deg, mm

printed = mk.catalog.joint("knee-table-2")  # the knee of the paper, as in its Table 2
longer = dataclasses.replace(printed.geometry, connector_length=208 * mm)
knees = {
    "as printed": printed,
    "connectors 18 mm longer": dataclasses.replace(printed, geometry=longer),
}
load = mk.catalog.load("knee-table-2")

# %%
# The lowest and the highest stiffness at which the muscles hold the load, as functions of the angle. The band ends
# where no pressures within limits hold the load.

angles = np.linspace(-40, 40, 161) * deg
torque = -load.gravity_torque(angles)
figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
for panel, (name, knee) in zip(axes, knees.items(), strict=True):
    lowest, highest = knee.attainable_stiffness(angles, torque)
    panel.fill_between(angles / deg, lowest, highest, alpha=0.4)
    panel.set(title=name, xlabel="angle [deg]", ylabel="stiffness [N·m/rad]")

# %%
# As printed, both muscles have their full length at 0 deg, and are stretched as soon as the joint moves. With longer
# connectors they are contracted by 10 %, the stiffness is lower, and it can be varied at every angle.

for name, knee in knees.items():
    lowest, highest = knee.attainable_stiffness(0.0, -load.gravity_torque(0.0))
    print(f"{name}: {lowest:.1f} to {highest:.1f} N*m/rad at 0 deg")
