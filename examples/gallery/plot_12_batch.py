"""
Thousands of runs on all cores
==============================

Replace numbers by arrays to simulate a batch. Runs share one program, several per processor vector, on all cores.
"""

import dataclasses
import time

import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.units import bar, deg, mm, ms

printed = mk.catalog.joint("knee-table-2")
knee = dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=208 * mm))
plant = mk.JointPlant(knee, mk.catalog.load("knee-table-2"), mk.FirstOrderValve(time_constant=20 * ms))
reference = mk.Reference(angle=mk.Sine(amplitude=10 * deg, frequency=0.5), stiffness=15.0)
controller = mk.PositionStiffnessControl(
    mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar), mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0), model=knee
)

# %%
# A grid of two gains: 40 by 40 runs of 4 s. Runs that diverge are marked, and the batch continues.

kp, ki = (each.ravel() for each in np.meshgrid(np.geomspace(0.5, 50, 40), np.geomspace(5, 1000, 40)))
over = {"controller.position.kp": kp * bar, "controller.position.ki": ki * bar}
start = time.perf_counter()
batch = mk.simulate_many(plant, controller, reference, over=over, duration=4.0, metrics=["angle_rmse"])
print(f"{len(kp)} runs in {time.perf_counter() - start:.1f} s, compilation included")

# %%
errors = np.where(batch.failed, np.nan, batch.metrics["angle_rmse"]) / deg
figure, axes = plt.subplots(figsize=(5.5, 4), layout="constrained")
drawn = axes.pcolormesh(kp.reshape(40, 40), ki.reshape(40, 40), errors.reshape(40, 40), cmap="viridis_r")
figure.colorbar(drawn, label="angle RMSE [deg]")
axes.set(xscale="log", yscale="log", xlabel="kp [bar/rad]", ylabel="ki [bar/(rad s)]", title="white: diverged")

# %%
# The derivative of an error with respect to any parameter is exact, from a single pass.

slopes = mk.differentiate(plant, controller, reference, ["controller.position.ki", "load.mass2"], duration=1.0)
slopes.gradients["angle_rmse"]
