# %% [markdown]
# # Uncertainty of a fit
#
# A fit always gives numbers. How far can they be trusted? In this lab you compute intervals for a force, count in
# simulated experiments how often they contain the truth, see what breaks them, and judge the fit of a real muscle on
# pressures that it has not seen.
#
# **You need** the lab on the force law, and Student's t distribution. **You learn** to tell a confidence interval from
# a prediction interval, to check the coverage of either, to handle errors that points share, and to find an outlier.

# %% [markdown]
# ## A law that is known
#
# To check an interval one must know the truth. The first half of this lab therefore uses a muscle whose law is known,
# Eq. 3 of the paper, and simulated measurements with a scatter of 2 N. For a known decay, Eq. 2 is linear in its six
# parameters, $F = \Phi\,\theta$; the matrix $\Phi$ is that of the lab on the force law, with pressures in bar.

# %%
import grading
import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import mckibben as mk
from mckibben.identification import Grouping
from mckibben.units import bar

law = mk.catalog.law("lei-mas-10-180n")
SCATTER = 2.0  # N


def design_matrix(contraction, pressure, decay=law.decay):
    """Design matrix of Eq. 2 with pressures in bar, of shape (points, 6); inputs in SI units."""
    contraction, pressure = (np.ravel(each) for each in np.broadcast_arrays(contraction, pressure))
    shapes = np.ones_like(contraction), contraction, np.exp(-decay * contraction)
    return np.column_stack([column for shape in shapes for column in (shape, shape * pressure / bar)])


contraction, pressure = (np.ravel(each) for each in np.meshgrid(np.linspace(0, 0.12, 8), np.arange(2.0, 7.0) * bar))
matrix, truth = design_matrix(contraction, pressure), np.asarray(law.force(contraction, pressure))
new_contraction, new_pressure = np.array([0.01, 0.05, 0.11]), 4.5 * bar  # a pressure between those measured
new, new_truth = design_matrix(new_contraction, new_pressure), np.asarray(law.force(new_contraction, new_pressure))


def measured(seed):
    """Simulated forces [N] with independent errors."""
    return truth + np.random.default_rng(seed).normal(0.0, SCATTER, truth.size)


# %% [markdown]
# ## Task 1: confidence interval
#
# With independent errors of equal variance, the estimate of the force at a new point with the row $x$ of the design
# matrix has the standard error
#
# $$s_F = s \sqrt{x^\top (\Phi^\top \Phi)^{-1} x}, \qquad s^2 = \frac{r^\top r}{n - 6}$$
#
# with the residuals $r$ of the $n$ points. The confidence interval is the estimate $\pm\ t\,s_F$, where $t$ is the
# quantile of Student's distribution with $n - 6$ degrees of freedom: `stats.t.ppf((1 + level) / 2, n - 6)`. It holds
# the **mean** force of the muscle there.


# %% task confidence
def confidence(matrix, force, new, level=0.95):
    """Estimates [N] and half widths [N] of their confidence intervals at the rows of a design matrix `new`."""
    ### BEGIN SOLUTION
    parameters, *_ = np.linalg.lstsq(matrix, force, rcond=None)
    residuals, degrees = force - matrix @ parameters, len(force) - matrix.shape[1]
    inverse = np.linalg.inv(matrix.T @ matrix)
    variance = residuals @ residuals / degrees * np.sum(new @ inverse * new, axis=1)
    return new @ parameters, stats.t.ppf((1 + level) / 2, degrees) * np.sqrt(variance)
    ### END SOLUTION


# %% check confidence 3
def expected_half_width(force, level, single=0.0):
    """Half widths by another way, the triangular factor of the matrix."""
    triangle = np.linalg.qr(matrix, mode="r")
    leverage = np.sum(np.linalg.solve(triangle.T, new.T) ** 2, axis=0)
    residual = force - matrix @ np.linalg.lstsq(matrix, force, rcond=None)[0]
    degrees = len(force) - 6
    return stats.t.ppf((1 + level) / 2, degrees) * np.sqrt(residual @ residual / degrees * (leverage + single))


estimate, half = confidence(matrix, measured(1), new)
grading.close(estimate, new_truth, tolerance=0.02, unit="N")
grading.close(half, expected_half_width(measured(1), 0.95), tolerance=1e-3, unit="N")
### BEGIN HIDDEN TESTS
grading.close(confidence(matrix, measured(2), new, 0.8)[1], expected_half_width(measured(2), 0.8), tolerance=1e-3)
### END HIDDEN TESTS

# %% [markdown]
# ## Task 2: prediction interval
#
# Predict first: you measure once more at the new points. Will 95 % of the new values lie in the confidence interval? A
# single measurement has its own scatter, so the variance is $s^2$ larger. Write the half width of the **prediction
# interval**.


# %% task prediction
def prediction_half_width(matrix, force, new, level=0.95):
    """Half widths [N] of the prediction intervals at the rows of a design matrix `new`."""
    ### BEGIN SOLUTION
    parameters, *_ = np.linalg.lstsq(matrix, force, rcond=None)
    residuals, degrees = force - matrix @ parameters, len(force) - matrix.shape[1]
    quantile = stats.t.ppf((1 + level) / 2, degrees)
    return np.hypot(confidence(matrix, force, new, level)[1], quantile * np.sqrt(residuals @ residuals / degrees))
    ### END SOLUTION


# %% check prediction 2
half = prediction_half_width(matrix, measured(1), new)
grading.close(half, expected_half_width(measured(1), 0.95, 1.0), tolerance=1e-3, unit="N")
### BEGIN HIDDEN TESTS
half = prediction_half_width(matrix, measured(4), new, 0.9)
grading.close(half, expected_half_width(measured(4), 0.9, 1.0), tolerance=1e-3, unit="N")
### END HIDDEN TESTS

# %%
shown = np.linspace(0.0, 0.12, 60)
rows, exact = design_matrix(shown, new_pressure), np.asarray(law.force(shown, new_pressure))
estimate, half = confidence(matrix, measured(1), rows)
wide = prediction_half_width(matrix, measured(1), rows)
figure, axes = plt.subplots()
axes.fill_between(100 * shown, estimate - wide - exact, estimate + wide - exact, alpha=0.2, label="prediction")
axes.fill_between(100 * shown, estimate - half - exact, estimate + half - exact, alpha=0.4, label="confidence")
axes.plot(100 * contraction, measured(1) - truth, "k.", label="measured")
axes.set(xlabel="contraction [%]", ylabel="deviation from the true force [N]")
axes.legend()

# %% [markdown]
# ## Task 3: coverage
#
# An interval of 95 % is a promise about many experiments. Repeat the experiment 500 times, with the forces
# `simulate(seed)` for the seeds 0 to 499, and return the share of confidence intervals that contain the true force
# `new_truth`, over all three new points.


# %% task coverage
def coverage(simulate, interval=confidence):
    """Share of the intervals that contain the true force, over 500 experiments and the new points."""
    ### BEGIN SOLUTION
    inside = []
    for seed in range(500):
        estimate, half = interval(matrix, simulate(seed), new)
        inside.append(np.abs(estimate - new_truth) <= half)
    return np.mean(inside)
    ### END SOLUTION


# %% check coverage 2
independent = coverage(measured)
grading.ensure(
    0.92 < independent < 0.98, f"The coverage is {independent:.3f}; with independent errors it is near 0.95."
)
grading.ensure(coverage(measured, lambda *_: (new_truth, np.zeros(3))) == 1, "A perfect estimate is always inside.")
### BEGIN HIDDEN TESTS
half_as_wide = coverage(measured, lambda *given: (confidence(*given)[0], confidence(*given)[1] / 2))
grading.ensure(0.60 < half_as_wide < 0.76, "Half of the interval contains the truth in about 68 % of the experiments.")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 4: errors that points share
#
# On a real rig the points of one pressure share errors: the pressure is off by a little, the zero of the force sensor
# moves between sweeps. Here each pressure has an error of 2 N that is common to all its points.


# %%
def measured_in_sweeps(seed):
    """Simulated forces [N] with independent errors, and one that is common to the points of each pressure."""
    common = np.random.default_rng(seed + 10_000).normal(0.0, 2.0, 5)
    return measured(seed) + common[np.unique(pressure, return_inverse=True)[1]]


print(f"coverage with common errors: {coverage(measured_in_sweeps):.2f}")

# %% [markdown]
# More points per sweep would not help: there are five independent sweeps, not forty independent points. So let whole
# sweeps vary. The **jackknife** leaves out one group $g$ of $G$ at a time, and its standard error is
#
# $$s_J = \sqrt{\frac{G - 1}{G} \sum_g \left(\hat F_{(g)} - \bar F\right)^2}$$
#
# with the estimates $\hat F_{(g)}$ without group $g$, and their mean $\bar F$. Write it.


# %% task jackknife
def jackknife_error(matrix, force, groups, new):
    """Standard errors [N] of the estimates at `new`, from leaving out one group at a time."""
    ### BEGIN SOLUTION
    estimates = []
    for group in np.unique(groups):
        kept = groups != group
        estimates.append(new @ np.linalg.lstsq(matrix[kept], force[kept], rcond=None)[0])
    count = len(estimates)
    return np.sqrt((count - 1) * np.var(estimates, axis=0))
    ### END SOLUTION


# %% check jackknife 3
ones = np.ones((4, 1))
grading.close(
    jackknife_error(ones, np.array([1.0, 2.0, 4.0, 5.0]), np.arange(4), ones[:1]), [np.sqrt(10 / 12)], tolerance=1e-6
)
sweeps = jackknife_error(matrix, measured_in_sweeps(7), pressure, new)
grading.ensure(np.shape(sweeps) == (3,), "One standard error for each new point.")


def with_jackknife(matrix, force, new):
    """Estimate and half width with the jackknife by pressure; five groups leave four degrees of freedom."""
    return confidence(matrix, force, new)[0], stats.t.ppf(0.975, 4) * jackknife_error(matrix, force, pressure, new)


by_pressure = coverage(measured_in_sweeps, with_jackknife)
grading.ensure(by_pressure > 0.9, f"The coverage by pressure is {by_pressure:.2f} only.")
grading.ensure(by_pressure > coverage(measured_in_sweeps) + 0.05, "The intervals by point must be too narrow here.")
### BEGIN HIDDEN TESTS
by_point = jackknife_error(matrix, measured(3), np.arange(truth.size), new)
grading.close(by_point, confidence(matrix, measured(3), new)[1] / stats.t.ppf(0.975, 34), tolerance=0.35, unit="N")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 5: pressures that were left out
#
# Now a real muscle, and a law that is not quite right: tabulated forces of a Festo muscle of 10 mm. Leave out one
# pressure at a time, identify Eq. 2 from the others, and count which share of the forces that were left out lies in
#
# - the classical confidence interval, `fit.force_intervals(contraction, pressure, by=Grouping.POINT).confidence`,
# - the toolkit's prediction interval, `fit.force_intervals(contraction, pressure).prediction`, which reckons with
#   the errors at left-out pressures.
#
# An interval has the attributes `lower` and `upper` [N]. Predict both shares first.

# %%
data = mk.catalog.dataset("festo-tool-10mm").taut

# %% task left_out
### BEGIN SOLUTION
in_confidence, in_prediction = [], []
for level in np.unique(np.asarray(data.pressure)):
    out = np.asarray(data.pressure) == level
    held, fit = data.select(out), mk.identify(data.select(~out), mk.ExponentialLaw)
    force = np.asarray(held.force)
    classical = fit.force_intervals(held.contraction, held.pressure, by=Grouping.POINT).confidence
    calibrated = fit.force_intervals(held.contraction, held.pressure).prediction
    in_confidence.append((classical.lower <= force) & (force <= classical.upper))
    in_prediction.append((calibrated.lower <= force) & (force <= calibrated.upper))
share_confidence, share_prediction = np.mean(np.concatenate(in_confidence)), np.mean(np.concatenate(in_prediction))
### END SOLUTION

# %% check left_out 3
levels, counts = np.unique(np.asarray(data.pressure), return_counts=True)
found = []
for level in levels:
    out = np.asarray(data.pressure) == level
    one, held = mk.identify(data.select(~out), mk.ExponentialLaw), data.select(out)
    classical = one.force_intervals(held.contraction, held.pressure, by=Grouping.POINT).confidence
    calibrated = one.force_intervals(held.contraction, held.pressure).prediction
    found.append(
        [
            np.sum(np.abs(np.asarray(held.force) - (each.lower + each.upper) / 2) <= (each.upper - each.lower) / 2)
            for each in (classical, calibrated)
        ]
    )
expected = np.sum(found, axis=0) / counts.sum()
grading.close(np.array([share_confidence, share_prediction]), expected, tolerance=0.004)  # less than one point

# %%
print(f"inside: {100 * share_confidence:.0f} % (classical confidence), {100 * share_prediction:.0f} % (prediction)")

# %% [markdown]
# ## Task 6: an outlier
#
# One force of the table was copied wrongly. Find it. Residuals alone mislead, because a wrong point pulls the fit
# towards itself. The *externally studentised* residual compares a point with the fit to all **others**:
#
# $$t_i = \frac{r_i}{s_{(i)} \sqrt{1 - h_i}}, \qquad s_{(i)}^2 = \frac{r^\top r - r_i^2 / (1 - h_i)}{n - 7}$$
#
# with the leverages $h_i$, the diagonal of $\Phi (\Phi^\top \Phi)^{-1} \Phi^\top$. Return all $t_i$.


# %% task outlier
def studentised(matrix, force):
    """Externally studentised residuals [-] of a linear fit."""
    ### BEGIN SOLUTION
    projection = matrix @ np.linalg.pinv(matrix)
    residuals, free = force - projection @ force, 1 - np.diag(projection)
    variance = (residuals @ residuals - residuals**2 / free) / (len(force) - matrix.shape[1] - 1)
    return residuals / np.sqrt(variance * free)
    ### END SOLUTION


# %% check outlier 3
def by_leaving_out(matrix, force, point):
    """The same from a fit to all other points."""
    kept = np.arange(len(force)) != point
    parameters = np.linalg.lstsq(matrix[kept], force[kept], rcond=None)[0]
    residual = force[kept] - matrix[kept] @ parameters
    inverse = np.linalg.inv(matrix[kept].T @ matrix[kept])
    single = 1 + matrix[point] @ inverse @ matrix[point]
    scale = np.sqrt(residual @ residual / (len(residual) - matrix.shape[1]) * single)
    return (force[point] - matrix[point] @ parameters) / scale


wrong = measured(5)
wrong[11] += 15.0
grading.ensure(
    np.argmax(np.abs(studentised(matrix, wrong))) == 11, "The point with the largest value is not the wrong one."
)
grading.close(
    studentised(matrix, wrong)[[0, 11]], [by_leaving_out(matrix, wrong, each) for each in (0, 11)], tolerance=1e-3
)
### BEGIN HIDDEN TESTS
other = measured(6)
grading.close(
    studentised(matrix, other)[[2, 39]], [by_leaving_out(matrix, other, each) for each in (2, 39)], tolerance=1e-3
)
### END HIDDEN TESTS

# %% [markdown]
# `mk.identify` does this for you, with a surface that does not depend on the law: it names such points in
# `fit.outliers` and leaves them out, unless `robust=False`.

# %%
table = data.table.assign(force=("point", np.where(np.arange(len(data)) == 30, 1.12, 1.0) * np.asarray(data.force)))
spoiled = type(data)(table)
kept, left_out = mk.identify(spoiled, mk.ExponentialLaw, robust=False), mk.identify(spoiled, mk.ExponentialLaw)
print(
    f"RMSE {kept.rmse:.2f} N with all points, {left_out.rmse:.2f} N without {[str(one) for one in left_out.outliers]}"
)

# %% [markdown]
# ## Task 7: beyond the data
#
# Identify Eq. 2 from the points of the Festo muscle up to 4 bar, and predict those at 8 bar. Give the root mean square
# error [N] of this prediction, and its ratio to the `leave_one_pressure_out.rmse` of the fit, which promises what to
# expect at a pressure that was left out. Predict the ratio.

# %% task beyond
### BEGIN SOLUTION
low = mk.identify(data.select(np.asarray(data.pressure) <= 4 * bar + 1), mk.ExponentialLaw)
highest = data.select(np.asarray(data.pressure) >= 8 * bar - 1)
errors = np.asarray(highest.force) - np.asarray(low.law.force(highest.contraction, highest.pressure))
error_beyond = np.sqrt(np.mean(errors**2))
error_ratio = error_beyond / low.leave_one_pressure_out.rmse
### END SOLUTION

# %% check beyond 2
below = np.asarray(data.pressure) < 4.5 * bar
one, eight = mk.identify(data.select(below), mk.ExponentialLaw), data.at([8 * bar])
expected = np.sqrt(
    np.mean((np.asarray(eight.force) - np.asarray(one.law.force(eight.contraction, eight.pressure))) ** 2)
)
grading.close(error_beyond, expected, tolerance=0.02, unit="N")
grading.close(error_ratio, expected / one.leave_one_pressure_out.rmse, tolerance=0.03)

# %%
print(f"at 8 bar: {error_beyond:.1f} N, {error_ratio:.1f} times the error at pressures that were left out")

# %% [markdown]
# ## What to remember
#
# - **Confidence is about the mean, prediction about the next value.** With many points the first shrinks to nothing,
#   the second to the scatter.
# - **Count what is independent.** Points of one sweep share errors; forty points in five sweeps are five. Intervals
#   that ignore this are too narrow, however good the fit looks.
# - **A parameter has no interval against a wrong law.** Only data that were left out show the misfit.
# - **No interval holds outside the data.** Nothing in the points warns of what the law does there.
