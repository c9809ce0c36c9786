"""
Force laws compared
===================

All force laws fitted to one muscle, and ranked by their cross-validation errors.
"""

import numpy as np

import mckibben as mk
from mckibben.units import bar

data = mk.catalog.dataset("dmsp-10-250-martens2017")
found = mk.rank(data)
found

# %%
# The best laws contain an exponential of the contraction: Eq. 2 of the paper (``Exponential``), and Sarosi's, which has
# fewer parameters. Chou's law (Eq. 1) models the braid but not the rubber, and has a large error.

figure = mk.report.ranking(found)

# %%
# Eq. 2 and Chou's law, with the points at four pressures:

some = data.select(np.isin(data.levels, np.array([1.9625, 3.35, 4.86562, 6.5]) * bar))
laws = {
    "Eq. 2": mk.identify(data).law,
    "Chou (Eq. 1)": mk.ChouLaw.of(mk.catalog.specimen("DMSP-10-250")),
}
figure_laws = mk.report.law_comparison(some, laws)
