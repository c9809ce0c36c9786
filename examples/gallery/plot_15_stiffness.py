"""
What stiffness means
====================

The stiffness of a joint with friction depends on how far and how fast it is moved.
"""

import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.units import deg

plant = mk.Scenario.read("../stiffness/knee.yaml").plant()
held = plant.equilibrium(0.0, stiffness=15.0)

# %%
# In slow motion at constant pressures, small amplitudes meet presliding friction and are much stiffer. The stiffness
# that a controller sets, 15 N*m/rad, is that of large amplitudes.

amplitudes = np.geomspace(0.01, 10, 60) * deg
secant = plant.joint.secant_stiffness(0.0, held.pressures, amplitudes)
figure, axes = plt.subplots(figsize=(5.5, 3.4), layout="constrained")
axes.semilogx(amplitudes / deg, secant, label="slow motion, constant pressures")
axes.axhline(15.0, color="black", linestyle="--", linewidth=0.9, label="without friction")
axes.set(xlabel="amplitude [deg]", ylabel="stiffness [N·m/rad]", ylim=(0, None))
axes.legend()

# %%
# With closed valves the air acts as an additional spring:

open_valves = float(plant.joint.stiffness(0.0, held.pressures))
closed = float(plant.joint.closed_valve_stiffness(0.0, held.pressures, polytropic_index=1.4))
print(f"{open_valves:.1f} N*m/rad at constant pressures, {closed:.1f} N*m/rad with closed valves, moved quickly")
