"""
Valves and air
==============

A proportional valve fills a muscle whose volume changes as it moves. How much does the valve size matter?
"""

import dataclasses

import mckibben as mk
from mckibben.units import bar, deg, mm, ms, quantity

printed = mk.catalog.joint("knee-table-2")
knee = dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=208 * mm))
load = mk.catalog.load("knee-table-2")
reference = mk.Reference(
    angle=mk.Sine(amplitude=10 * deg, frequency=1.0), stiffness=mk.Step(before=13.0, after=17.0, at=1.0)
)
controller = mk.PositionStiffnessControl(
    mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar), mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0), model=knee
)

# %%
# The conductance is the air flow per pressure, in L/(s*bar); the supply has 7 bar. A first-order lag of 20 ms is the
# usual simplification.

valves = {
    "lag of 20 ms": mk.FirstOrderValve(time_constant=20 * ms),
    "valve, 0.4 L/(s bar)": mk.FlowValve(quantity("0.4 L/(s*bar)", "m^3/(s*Pa)"), 7 * bar),
    "valve, 0.04 L/(s bar)": mk.FlowValve(quantity("0.04 L/(s*bar)", "m^3/(s*Pa)"), 7 * bar),
}
runs = {
    name: mk.simulate(mk.JointPlant(knee, load, valve), controller, reference, duration=2.0)
    for name, valve in valves.items()
}
for name, run in runs.items():
    print(f"{name:22} {run.metrics['angle_rmse'] / deg:.2f} deg, {run.metrics['air'] * 1e3:.2f} L of air")

# %%
figure = mk.report.tracking(runs)
