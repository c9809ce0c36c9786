"""
Sizing of a joint
=================

Which muscles and pulleys give a required range of stiffness over a range of angles?
"""

import mckibben as mk

# %%
# The requirement is a stiffness of 15 to 18 N*m/rad from -30 to 30 deg with a load of 2 kg.

need = mk.Requirement.read("../sizing/pulleys.yaml")
found = mk.size(need)
print(found.to_text())

# %%
# The frame is the required stiffness, the blue area is attainable with the parts of the first candidate.

figure = found.plot()
