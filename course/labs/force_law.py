# %% [markdown]
# # Force law from data
#
# A pneumatic muscle pulls harder the more it is inflated, and the less it is contracted. A force law states how much.
# In this lab you predict the force of a muscle from its geometry, fit an empirical law to measured forces, and find out
# how far each of them can be trusted.
#
# **You need** Python, NumPy and least squares. **You learn** to predict a force from the geometry of the braid, to fit
# a law that is linear in most of its parameters, and to judge it on data that it has not seen.

# %% [markdown]
# ## The ideal muscle
#
# The braid of a McKibben muscle consists of inextensible threads. When the muscle contracts from its initial length
# $l_0$ to the length $l$, its diameter grows, and the volume $V$ with it. If no energy is lost or stored, the work of
# the gas equals the work of the muscle, $p\,dV = -F\,dl$. For a cylinder this gives Eq. 1 of the paper (Chou and
# Hannaford 1996),
#
# $$F = \frac{\pi d_0^2 p}{4} \left(\frac{3 (1-\varepsilon)^2}{\tan^2\alpha_0} - \frac{1}{\sin^2\alpha_0}\right)$$
#
# with the gauge pressure $p$, the contraction $\varepsilon = (l_0 - l)/l_0$, the initial diameter $d_0$, and the
# initial angle $\alpha_0$ between thread and axis.
#
# **Pressures are gauge pressures in Pa.** Catalogs print bar, and 1 bar = 100,000 Pa. Contraction is a ratio: 10 % is
# 0.1. `mckibben.units` has the factors, as in `6 * bar`.

# %%
import grading
import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.units import bar, deg, mm

# %% [markdown]
# ## Task 1: predict
#
# Before you compute: does the muscle pull more at 5 % or at 15 % contraction? What happens to the force if the pressure
# doubles? Write down both answers. Then write Eq. 1 as a function, for numbers and arrays in SI units.

# %% task ideal
DIAMETER, ANGLE = 10 * mm, 25 * deg


def ideal_force(contraction, pressure):
    """Force [N] of the ideal muscle at a contraction [-] and a gauge pressure [Pa]."""
    ### BEGIN SOLUTION
    stretch = 3 * (1 - contraction) ** 2 / np.tan(ANGLE) ** 2 - 1 / np.sin(ANGLE) ** 2
    return np.pi * DIAMETER**2 / 4 * pressure * stretch
    ### END SOLUTION


# %% check ideal 2
law = mk.ChouLaw(braid_angle=ANGLE, initial_diameter=DIAMETER)
contractions, pressures = np.meshgrid([0.0, 0.05, 0.15, 0.3], [1 * bar, 3.5 * bar, 6 * bar])
grading.agree(ideal_force, law.force, contractions, pressures, tolerance=1e-6, unit="N")
### BEGIN HIDDEN TESTS
grading.agree(ideal_force, law.force, np.linspace(0.01, 0.33, 12), 2.3 * bar, tolerance=1e-6, unit="N")
### END HIDDEN TESTS

# %% [markdown]
# ## Measured forces
#
# The package contains forces that Martens and Boblan measured on a Festo DMSP-10-250: 17 pressures, five contractions
# each. Where the force is zero the muscle is slack; these points tell us nothing about the law and are left out.

# %%
data = mk.catalog.dataset("dmsp-10-250-martens2017").taut
contraction, pressure, force = (np.asarray(each) for each in (data.contraction, data.pressure, data.force))
figure, axes = plt.subplots()
points = axes.scatter(100 * contraction, force, c=pressure / bar)
axes.set(xlabel="contraction [%]", ylabel="force [N]")
figure.colorbar(points, label="pressure [bar]")

# %% [markdown]
# ## Task 2: fit
#
# The threads of a real muscle rub, the tube is stiff, and the ends stay narrow. Eq. 2 of the paper is therefore
# empirical,
#
# $$F = (a_1 + a_2 p) + (b_1 + b_2 p)\,\varepsilon + (c_1 + c_2 p)\,e^{-\mu\varepsilon}$$
#
# Its seven parameters have no physical meaning of their own. For a given decay $\mu$ the law is linear in the other
# six: they follow from linear least squares. Write the design matrix $\Phi$, one row per point and one column per
# parameter in the order $a_1, a_2, b_1, b_2, c_1, c_2$, such that $F = \Phi\,\theta$.
#
# *Numerical hint.* With the pressure in Pa, some columns would be 100,000 times as large as others, and the matrix
# badly conditioned. Use the pressure in bar inside this function; the residuals do not depend on it.


# %% task fit
def design_matrix(contraction, pressure, decay):
    """Design matrix of Eq. 2 with pressures in bar, of shape (points, 6); inputs in SI units."""
    ### BEGIN SOLUTION
    shapes = np.ones_like(contraction), contraction, np.exp(-decay * contraction)
    return np.column_stack([column for shape in shapes for column in (shape, shape * pressure / bar)])
    ### END SOLUTION


def fit_rmse(decay):
    """Root mean square error [N] of the best fit at a decay [-]."""
    ### BEGIN SOLUTION
    matrix = design_matrix(contraction, pressure, decay)
    solution, *_ = np.linalg.lstsq(matrix, force, rcond=None)
    return np.sqrt(np.mean((force - matrix @ solution) ** 2))
    ### END SOLUTION


# %% check fit 3
fit = mk.identify(data, mk.ExponentialLaw)  # searches the decay too
grading.close(fit_rmse(fit.law.decay), fit.rmse, tolerance=1e-3, unit="N")
grading.ensure(fit_rmse(2 * fit.law.decay) > fit.rmse, "Another decay cannot fit better than the best one.")
### BEGIN HIDDEN TESTS
other = design_matrix(np.array([0.03, 0.11]), np.array([2 * bar, 5 * bar]), 20.0)
grading.close(other[:, 2:4], [[0.03, 0.06], [0.11, 0.55]], tolerance=1e-9)
### END HIDDEN TESTS

# %% [markdown]
# ## Task 3: validate
#
# A fit with seven parameters describes the points from which it was made better than any others. Does it predict a
# pressure that was never measured? Points of one pressure were measured in one sweep and share their errors; leaving
# out single points would flatter the law. Leave out **one whole pressure** at a time, identify the law from the others
# (`mk.identify(data.select(mask), mk.ExponentialLaw)`), and predict the pressure that was left out. Return the root
# mean square of all these prediction errors.
#
# Predict first: is it smaller or larger than the error of the fit?


# %% task validate
def validation_rmse(data):
    """Leave-one-pressure-out error [N] of Eq. 2."""
    ### BEGIN SOLUTION
    pressure, errors = np.asarray(data.pressure), []
    for level in np.unique(pressure):
        out = pressure == level
        law = mk.identify(data.select(~out), mk.ExponentialLaw).law
        held = data.select(out)
        errors.append(np.asarray(held.force) - np.asarray(law.force(held.contraction, held.pressure)))
    return np.sqrt(np.mean(np.concatenate(errors) ** 2))
    ### END SOLUTION


# %% check validate 3
grading.close(validation_rmse(data), fit.leave_one_pressure_out.rmse, tolerance=0.03, unit="N")

# %% [markdown]
# ## Task 4: compare
#
# How much worse is the ideal muscle? Identify Chou's law from the same data (`mk.identify(data, mk.ChouLaw)` fits braid
# angle and diameter) and give the ratio of its error to that of Eq. 2.

# %% task compare
### BEGIN SOLUTION
error_ratio = mk.identify(data, mk.ChouLaw).rmse / fit.rmse
### END SOLUTION

# %% check compare 2
residual = force - np.asarray(mk.identify(data, mk.ChouLaw).law.force(contraction, pressure))
grading.close(error_ratio, np.sqrt(np.mean(residual**2)) / fit.rmse, tolerance=0.02)

# %% [markdown]
# ## What to remember
#
# - **bar and Pa.** A force that is 100,000 times too small has a pressure in bar where Pa was expected.
# - **A small residual is not a good prediction.** The error on a pressure that was left out is the honest one, and it
#   holds within the measured range only. Outside it, an empirical law may do anything.
# - **Parameters are not physics.** In Eq. 2, $a_1$ and $c_1$ are almost perfectly correlated: one can be raised and the
#   other lowered with hardly any effect on the force.
