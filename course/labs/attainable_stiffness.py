# %% [markdown]
# # Antagonistic joint and attainable stiffness
#
# Two muscles that pull on a joint in opposite directions can stiffen it without moving it, as you can stiffen your
# elbow. How stiff and how compliant it can be depends on the geometry more than on the controller. In this lab you
# derive torque and stiffness, and find the stiffness that a knee can attain while it holds its load.
#
# **You need** the lab on the force law, and derivatives. **You learn** to derive torque and stiffness from the lengths
# of the muscles, to determine which stiffness is attainable, and to change the geometry so that a required one is.

# %% [markdown]
# ## Torque and stiffness
#
# If the joint turns by $d\theta$, muscle $i$ with the length $l_i$ does the work $-F_i\,dl_i$. By virtual work, the
# torque and the isobaric stiffness (Eqs. 7 and 8 of the paper) are
#
# $$\tau = -F_1 \frac{dl_1}{d\theta} - F_2 \frac{dl_2}{d\theta}, \qquad K = -\frac{\partial\tau}{\partial\theta}$$
#
# at constant pressures $p_1, p_2$. Muscle 1 lengthens as the angle grows, muscle 2 shortens. With Eq. 2, both $\tau$
# and $K$ are affine functions of the two pressures.
#
# **Isobaric stiffness is not the stiffness of a small push.** In muscles with friction, a small motion does not
# overcome the friction between the threads, and the joint feels several times as stiff. The muscles of this lab have
# none.

# %%
import dataclasses

import grading
import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.units import bar, deg, mm

printed = mk.catalog.joint("knee-table-2")  # the knee of the paper, connectors of 190 mm
load = mk.catalog.load("knee-table-2")


def with_connectors(length):
    """Return the knee with other connectors: the longer they are, the more contracted both muscles are."""
    return dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=length))


knee = with_connectors(208 * mm)  # both muscles are contracted by 10 % at 0 deg

# %% [markdown]
# ## Task 1: torque
#
# Compute the torque from the forces and the lengths. `joint.geometry.path_lengths(angle)` returns both lengths [m], and
# `joint.tensions(angle, (p1, p2))` both forces [N]. Differentiate numerically (central difference, step 1e-5 rad), or
# use `jax.grad`.
#
# Predict first: what is the sign of the torque at 0 deg if only muscle 2 is inflated?


# %% task torque
def torque(joint, angle, pressure1, pressure2):
    """Torque [N*m] of the muscles at an angle [rad] and gauge pressures [Pa], numbers or arrays."""
    ### BEGIN SOLUTION
    step = 1e-5
    after, before = (joint.geometry.path_lengths(angle + each) for each in (step, -step))
    forces = joint.tensions(angle, (pressure1, pressure2))
    return -sum(np.asarray(f) * np.asarray(a - b) / (2 * step) for f, a, b in zip(forces, after, before, strict=True))
    ### END SOLUTION


# %% check torque 2
for angle, pressures in ((0.0, (1 * bar, 4 * bar)), (20 * deg, (2 * bar, 3 * bar)), (-15 * deg, (4 * bar, 1 * bar))):
    grading.close(torque(knee, angle, *pressures), knee.torque(angle, pressures), tolerance=1e-4, unit="N*m")
### BEGIN HIDDEN TESTS
grading.close(
    torque(printed, 5 * deg, 3 * bar, 3 * bar), printed.torque(5 * deg, (3 * bar, 3 * bar)), tolerance=1e-4, unit="N*m"
)
### END HIDDEN TESTS

# %% [markdown]
# ## Task 2: stiffness
#
# Compute the isobaric stiffness from your torque. Mind the sign: a stable joint has a positive stiffness, because the
# torque falls as the angle grows.


# %% task stiffness
def stiffness(joint, angle, pressure1, pressure2):
    """Isobaric stiffness [N*m/rad]."""
    ### BEGIN SOLUTION
    step = 1e-3
    after, before = (torque(joint, angle + each, pressure1, pressure2) for each in (step, -step))
    return -(after - before) / (2 * step)
    ### END SOLUTION


# %% check stiffness 2
for angle, pressures in ((0.0, (4 * bar, 4 * bar)), (10 * deg, (3 * bar, 4.5 * bar))):
    grading.close(stiffness(knee, angle, *pressures), knee.stiffness(angle, pressures), tolerance=1e-2, unit="N*m/rad")
### BEGIN HIDDEN TESTS
grading.close(
    stiffness(printed, 0.0, 3 * bar, 3 * bar),
    printed.stiffness(0.0, (3 * bar, 3 * bar)),
    tolerance=1e-2,
    unit="N*m/rad",
)
### END HIDDEN TESTS

# %% [markdown]
# ## Task 3: common pressure is not stiffness
#
# Predict: if the pressure of both muscles is raised from 3 to 6 bar at 0 deg, by which factor does the stiffness grow?
# Many answer "two" for any joint. Compute the factor for the knee as printed in the paper and for the knee with longer
# connectors. What happens below 2.5 bar?

# %% task common
### BEGIN SOLUTION
factor_printed, factor_longer = (
    stiffness(joint, 0.0, 6 * bar, 6 * bar) / stiffness(joint, 0.0, 3 * bar, 3 * bar) for joint in (printed, knee)
)
### END SOLUTION

# %% check common 2
for factor, joint in ((factor_printed, printed), (factor_longer, knee)):
    expected = joint.stiffness(0.0, (6 * bar, 6 * bar)) / joint.stiffness(0.0, (3 * bar, 3 * bar))
    grading.close(factor, expected, tolerance=1e-2)

# %% [markdown]
# ## Task 4: attainable stiffness
#
# The muscles must also hold the load. At rest the torque of the muscles balances gravity, $\tau(p_1, p_2) = -\tau_g$,
# which leaves a single degree of freedom: co-contraction. Both pressures lie between 0 and 6 bar, and both muscles must
# be taut, so the stiffness has a lowest and a highest value. Find them. For each $p_1$ on a grid there is one $p_2$
# that holds the load. Since the torque is affine in $p_2$ where the muscles are taut, two evaluations of the torque, at
# 3 and 6 bar, give it. Leave out pairs outside the limits, and pairs at which a muscle is slack or almost so (tension
# below 1 N): a difference quotient across that limit would be wrong.


# %% task attainable
def attainable(joint, angle, steps=121):
    """Lowest and highest stiffness [N*m/rad] at which the joint holds its load at an angle [rad]."""
    holding = -float(load.gravity_torque(angle))
    ### BEGIN SOLUTION
    pressure1 = np.linspace(0, 6 * bar, steps)
    low, high = (torque(joint, angle, pressure1, each) for each in (3 * bar, 6 * bar))
    pressure2 = 3 * bar + (holding - low) / (high - low) * 3 * bar
    taut = np.all(np.array(joint.tensions(angle, (pressure1, np.clip(pressure2, 0, 6 * bar)))) > 1, axis=0)
    held = taut & (pressure2 >= 0) & (pressure2 <= 6 * bar)
    found = stiffness(joint, angle, pressure1[held], pressure2[held])
    return np.min(found), np.max(found)
    ### END SOLUTION


# %% check attainable 4
for angle in (0.0, 10 * deg):
    expected = np.array(knee.attainable_stiffness(angle, -load.gravity_torque(angle)))
    grading.close(np.array(attainable(knee, angle)), expected, tolerance=0.03, unit="N*m/rad")
### BEGIN HIDDEN TESTS
expected = np.array(knee.attainable_stiffness(-10 * deg, -load.gravity_torque(-10 * deg)))
grading.close(np.array(attainable(knee, -10 * deg)), expected, tolerance=0.03, unit="N*m/rad")
### END HIDDEN TESTS

# %%
angles = np.linspace(-40, 40, 161) * deg
figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
for panel, (name, joint) in zip(axes, {"as printed": printed, "longer connectors": knee}.items(), strict=True):
    panel.fill_between(angles / deg, *joint.attainable_stiffness(angles, -load.gravity_torque(angles)), alpha=0.4)
    panel.set(title=name, xlabel="angle [deg]", ylabel="stiffness [N·m/rad]")

# %% [markdown]
# ## Task 5: design
#
# A walking leg needs a knee with 14 N·m/rad at every angle from -10 to 10 deg. Choose the length of the connectors. The
# check also tries angles that are not shown here. Try `with_connectors` first, or the page that `mckibben web` serves.

# %% task design
### BEGIN SOLUTION
connector_length = 208 * mm
### END SOLUTION

# %% check design 2
chosen = with_connectors(connector_length)
tried = np.linspace(-10, 10, 5) * deg
### BEGIN HIDDEN TESTS
tried = np.linspace(-10, 10, 41) * deg
### END HIDDEN TESTS
lowest, highest = (np.asarray(each) for each in chosen.attainable_stiffness(tried, -load.gravity_torque(tried)))
grading.ensure(np.all(lowest <= 14) and np.all(highest >= 14), "14 N*m/rad is not attainable at all of the angles.")

# %% [markdown]
# ## What to remember
#
# - **Common pressure is not stiffness.** With muscles at their full length, co-contraction hardly changes the
#   stiffness, and more pressure even lowers it. With contracted muscles it changes the stiffness a lot, once both
#   muscles are taut.
# - **A stiffness outside the attainable band is not a matter of tuning.** No gain reaches it. Check a reference before
#   you simulate it (`mk.check_reference`).
# - **A muscle pulls only.** A pressure that the linear equations give may belong to a slack muscle.
