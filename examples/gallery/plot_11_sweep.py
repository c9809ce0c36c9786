"""
A sweep with tolerances
=======================

How well does a controller perform if load and muscles differ from those it was designed for?
"""

import mckibben as mk

scenario = mk.Scenario.read("../pre-contracted-step-pid.yaml").replace(duration=6.0)

# %%
# 200 runs with other loads and valves, and connectors that are up to 2 mm too long or short. The controller's model
# keeps the values in the file.

ranges = [
    "load.mass2=0.2 kg..1.0 kg",
    "valve.time_constant=15 ms..40 ms",
    "joint.geometry.connector_length=206 mm..210 mm",
]
swept = mk.sweep(scenario, ranges, samples=200, seed=1, metrics=["angle_rmse", "stiffness_rmse"])
swept

# %%
figure = mk.report.sweep(swept)

# %%
# The worst run, which ``swept.scenario(worst)`` returns as a scenario:

table = swept.table
worst = int(table["stiffness_rmse"].to_numpy().argmax())
for name in ("load.mass2", "valve.time_constant", "joint.geometry.connector_length", "stiffness_rmse"):
    print(f"{name:24} {float(table[name][worst]):.3g} {table[name].attrs['units']}")
