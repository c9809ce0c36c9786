"""
User-defined joint
==================

Muscles between two bones, on pulleys or cams, or with measured moment arms; or any geometry given by a formula.
"""

import jax.numpy as jnp

import mckibben as mk
from mckibben.joint import Geometry
from mckibben.units import bar, deg, mm

muscle = mk.Muscle(mk.catalog.specimen("MAS-10-180N-AA-MC-O"), mk.catalog.law("lei-mas-10-180n"))

# %%
# Muscle 1 lengthens as the angle increases, muscle 2 shortens. The hinge is the origin; angles turn from x to y.

elbow = mk.PairedPaths(
    mk.TwoBonePath(proximal_x=-30 * mm, proximal_y=182 * mm, distal_x=-35 * mm, distal_y=0.0, connector_length=20 * mm),
    mk.Pulley(radius=30 * mm, rest_length=162 * mm),
)
figure = mk.report.draw_joint(mk.AntagonisticJoint(elbow, muscle, muscle), 15 * deg, (2 * bar, 4 * bar))

# %%
# Measured moment arms become a smooth curve. A path that is not straight is drawn as the cam with the same moment arms.

table = mk.TabulatedPath(
    [angle * deg for angle in (-40, -20, 0, 20, 40)],
    arms=[arm * mm for arm in (26, 29, 30, 29, 26.5)],
    rest_length=162 * mm,
)
ankle = mk.AntagonisticJoint(mk.PairedPaths(table, table), muscle, muscle)
figure_ankle = mk.report.draw_joint(ankle, 15 * deg, (2 * bar, 4 * bar))

# %%
# A class that returns the two path lengths is a geometry like the built-in ones: moment arms, torque and stiffness
# follow by differentiation.


class Crank(Geometry):
    """Muscles on a crank, with distant anchors."""

    radius: float

    def path_lengths(self, angle):
        return 0.162 + self.radius * jnp.sin(angle), 0.162 - self.radius * jnp.sin(angle)


crank = mk.AntagonisticJoint(Crank(30 * mm), muscle, muscle)
for joint in (mk.AntagonisticJoint(elbow, muscle, muscle), ankle, crank):
    torque, stiffness = joint.torque_and_stiffness(15 * deg, (2 * bar, 4 * bar))
    print(f"{type(joint.geometry).__name__:12} {torque:6.2f} N*m {stiffness:6.1f} N*m/rad")
