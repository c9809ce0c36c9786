"""
A force law from measured data
==============================

A table of pressures, contractions and forces of a muscle becomes a force law with standard errors.
"""

import mckibben as mk

# %%
# ``rig.csv`` is an isobaric test with loading and unloading. Points without force are slack and excluded from the fit.

data = mk.read_dataset("../rig.csv")
data

# %%
# Eq. 2 of the paper has seven parameters. The leave-one-pressure-out errors are more informative than those of the fit.

fit = mk.identify(data, "exponential", friction=False)
print(fit.to_text())

# %%
# The points lie on both sides of the curves: loading above, unloading below. The difference is friction, which has
# :ref:`its own model <sphx_glr_gallery_plot_04_friction.py>`.

figure = fit.plot()
