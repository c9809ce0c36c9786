"""
Sizing of a joint
=================

Which lengths give a required range of stiffness over a range of angles?
"""

import mckibben as mk

# %%
# As printed, the knee cannot be held beyond about 10 deg. The requirement is a stiffness of 14 to 16 N*m/rad from -15
# to 15 deg; the connector length and the radius may be chosen.

need = mk.Requirement.read("../sizing/knee.yaml")
found = mk.size(need)
print(found.to_text())

# %%
# The frame is the required stiffness, the blue area is attainable with these lengths. The knee as printed has 70
# N*m/rad and more, outside the figure.

figure = found.plot()
