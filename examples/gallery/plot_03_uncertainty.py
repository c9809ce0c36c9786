"""
Uncertainty of a force law
==========================

Intervals for the parameters, the force, and the next measurement.
"""

import mckibben as mk
from mckibben.units import bar, percent

data = mk.catalog.dataset("festo-tool-10mm")
fit = mk.identify(data)
for name, (low, high) in fit.intervals(0.95).items():
    print(f"{name:6} {fit.estimates[name]:12.4g}  95 %: {low:12.4g} .. {high:12.4g}")

# %%
# The inner band is the confidence interval of the law's force, the outer band the prediction interval of another
# plateau. Points at the same pressure have common errors, which makes the intervals wider than for independent points.

figure = mk.report.force_bands(data, fit)

# %%
# In numbers, at 4 bar:

found = fit.force_intervals([5 * percent, 10 * percent], 4 * bar)
(found.prediction.upper - found.prediction.lower).round(1)  # N
