"""
What to measure next
====================

The points that most reduce the uncertainty of a quantity, here the stiffness of a joint.
"""

import mckibben as mk
from mckibben.experiment_design import JointStiffness

data = mk.catalog.dataset("dmsp-10-250-martens2017")
knee = mk.catalog.joint("knee-table-2")
found = mk.plan(data, JointStiffness(knee), mk.ExponentialLaw, points=6)
print(found.verdict())

# %%
# The standard error of the force before and after. The new points, numbered by their gain, are near the pressure and
# the contraction on which the stiffness depends, including the stretched muscle.

figure = mk.report.planned(found)
