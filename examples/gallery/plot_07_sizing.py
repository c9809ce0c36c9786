"""
Sizing of a joint
=================

Which lengths give a required range of stiffness over a range of angles?
"""

import mckibben as mk
from mckibben.reachability import design, parse_target, parse_variable, static_envelope

scenario = mk.Scenario.read("../as-printed-constant-pid.yaml")
plant = scenario.plant()

# %%
# As printed, the knee cannot be held beyond about 10 deg. The target is a stiffness of 12 to 16 N*m/rad from -15 to
# 15 deg; the design variables are the connector length and the radius.

target = parse_target("stiffness 12..16 N*m/rad over -15..15 deg")
variables = [parse_variable("connector_length=150..260 mm"), parse_variable("joint_radius=20..60 mm")]
found = design(plant, target, variables)
print(found.describe())

# %%
# The frame is the target, the blue area is attainable with the design. The knee as printed has 70 N*m/rad and more,
# outside the figure.

figure = mk.report.design(found, static_envelope(plant, about=0.0))
