"""
How sure is a force law?
========================

Intervals of the parameters, of the force, and of the next measurement.
"""

import mckibben as mk
from mckibben.units import bar, percent

data = mk.catalog.dataset("festo-tool-10mm")
fit = mk.identify(mk.ExponentialLaw, data)
for name, (low, high) in fit.intervals(0.95).items():
    print(f"{name:6} {fit.estimates[name]:12.4g}  95 %: {low:12.4g} .. {high:12.4g}")

# %%
# The inner band is the confidence interval of the law's force, the outer one the prediction interval of one more
# plateau. Points of a pressure have errors in common, which makes the intervals wider than independent points would.

figure = mk.report.force_bands(data, fit)

# %%
# In numbers, at 4 bar:

found = fit.force_intervals([5 * percent, 10 * percent], 4 * bar)
(found.prediction.upper - found.prediction.lower).round(1)  # N
