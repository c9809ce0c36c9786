"""
Controllers compared
====================

Two PID loops compared with a controller that solves for both pressures together, on the same reference.
"""

import dataclasses

import mckibben as mk
from mckibben.units import bar, deg, mm, ms

printed = mk.catalog.joint("knee-table-2")
knee = dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=208 * mm))
load = mk.catalog.load("knee-table-2")
plant = mk.JointPlant(knee, load, mk.FirstOrderValve(time_constant=20 * ms))
reference = mk.Reference(
    angle=mk.Sine(amplitude=10 * deg, frequency=0.5), stiffness=mk.Step(before=13.0, after=17.0, at=2.0)
)
controllers = {
    "PID": mk.PositionStiffnessControl(
        mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar), mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0), model=knee
    ),
    "decoupling": mk.DecouplingControl(
        model=knee, load=load, feedback=mk.PolePlacement(60.0), observer=mk.ExtendedStateObserver(180.0)
    ),
}
runs = {name: mk.simulate(plant, each, reference, duration=4.0) for name, each in controllers.items()}
for name, run in runs.items():
    angle, stiffness = run.metrics["angle_rmse"] / deg, run.metrics["stiffness_rmse"]
    print(f"{name:10} {angle:.3f} deg  {stiffness:.3f} N*m/rad")

# %%
figure = mk.report.tracking(runs)

# %%
# Here the model of the decoupling controller equals the plant, and there are no disturbances. ``mckibben compare``
# tunes all controllers with the same budget and evaluates them with other loads, valves, muscles, noise and
# disturbances.
