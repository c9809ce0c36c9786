"""
Friction and hysteresis
=======================

A muscle that is stretched pulls harder than one that shortens. The difference is identified along with the law.
"""

import mckibben as mk

data = mk.read_dataset("../rig.csv")
found = mk.identify_hysteresis(mk.ExponentialLaw, data)
found

# %%
# Measured loops, and those of the friction model:

figure = mk.report.loops(data, found)

# %%
# Without friction the data determine the law alone. These data are simulated; the remaining residual is their rounding.

before = mk.identify(data, friction=False)
after = mk.identify(found.corrected_points)
print(f"RMSE {before.rmse:.2f} N with the friction in the data, {after.rmse:.2f} N without")
