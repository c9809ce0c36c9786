"""
A controller as C
=================

The controller of a scenario as C99 for a microcontroller: no memory allocation, bounded loops, no library except
``math.h``.
"""

import io
import re
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.export import export
from mckibben.units import bar

scenario = mk.Scenario.read("../pre-contracted-step-pid.yaml").replace(duration=7.0)
with tempfile.TemporaryDirectory() as folder:
    files = export(scenario, "c", Path(folder) / "knee").contents
print("\n".join(files))

# %%
# The functions that a program calls at the start, and in every control period:

print("\n\n".join(re.findall(r"^void controller_(?:defaults|init|step)\([^;]*;", files["controller.h"], re.MULTILINE)))

# %%
# The code comes with a recorded run. ``make check`` replays it and compares the commands of the C program with these:

run = np.genfromtxt(io.StringIO(files["replay.csv"]), delimiter=",", names=True)
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for number in (1, 2):
    axes.plot(
        np.arange(len(run)) * scenario.control_period, run[f"commandspressure{number}"] / bar, label=f"muscle {number}"
    )
axes.set(xlabel="time [s]", ylabel="commanded pressure [bar]")
axes.legend()
