# %% [markdown]
# # PID control and its limits
#
# The knee follows a sine while its stiffness is controlled too. Two PID loops do it: one acts on the difference of the
# pressures and moves the joint, the other acts on their mean and stiffens it. In this lab you write a PI step, measure
# an error, choose gains that hold for conditions that you have not seen, and find references that no gains can follow.
#
# **You need** the lab on attainable stiffness, and sampled control. **You learn** to implement a PI controller with its
# state, to tune for unseen conditions, and to tell poor gains from infeasible references.

# %% [markdown]
# ## Two loops
#
# Let $p_c$ be the co-contraction and $p_d$ the differential pressure. The valves receive
#
# $$p_1 = p_c - p_d, \qquad p_2 = p_c + p_d$$
#
# and each of the two quantities is the output $u$ of a PID controller, with the error $e$ of the angle or of the
# stiffness,
#
# $$u = k_p e + k_i \int e\,dt + k_d \dot e$$
#
# Stiffness is not measured: a model computes it from angle and pressures. The gains have units. With $k_p$ = 2 bar/rad,
# an error of 0.1 rad gives 0.2 bar. In code, gains are in Pa per rad: `kp=2 * bar`.
#
# The supply limits the pressures to 0 to 6 bar, and the valve follows a command with a time constant of 20 ms. Both
# limit what feedback can do. The two loops are those of Fig. 7 of the paper. The page that
# `mckibben web` serves simulates them, too.

# %%
import dataclasses
import warnings

import grading
import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.units import bar, deg, mm, ms

warnings.simplefilter("ignore", mk.errors.ReachabilityWarning)  # some references below are infeasible on purpose
printed = mk.catalog.joint("knee-table-2")
knee = dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=208 * mm))
load = mk.catalog.load("knee-table-2")


def run(position, frequency=0.5, stiffness=14.0, mass_factor=1.0, time_constant=20 * ms):
    """Simulate 4 s of a sine of 10 deg with the PID of the position loop."""
    heavier = dataclasses.replace(load, mass2=mass_factor * load.mass2)
    plant = mk.JointPlant(knee, heavier, mk.FirstOrderValve(time_constant=time_constant))
    reference = mk.Reference(angle=mk.Sine(amplitude=10 * deg, frequency=frequency), stiffness=mk.Constant(stiffness))
    loop = mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0)  # of the stiffness
    controller = mk.PositionStiffnessControl(position, loop, model=knee)
    return mk.simulate(plant, controller, reference, duration=4.0, control_period=1 * ms)


first = run(mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar))
figure, axes = plt.subplots()
axes.plot(first.times, first["desired_angle"] / deg, "--", first.times, first["angle"] / deg)
axes.set(xlabel="time [s]", ylabel="angle [deg]")

# %% [markdown]
# ## Task 1: a PI step
#
# A microcontroller calls a function once per control period. It adds the error to the integral term, then returns the
# new integral term and the output. The integral term has the unit of the output, so that it is continuous when $k_i$
# changes.


# %% task step
def pi_step(integral, error, kp, ki, period):
    """Return the new integral term [Pa] and the output [Pa] for an error [rad]; the period is in s."""
    ### BEGIN SOLUTION
    integral = integral + ki * period * error
    return integral, kp * error + integral
    ### END SOLUTION


# %% check step 2
def outputs(errors, kp, ki, period):
    """Compare the outputs with those of the toolkit's PID for a series of errors."""
    pid = mk.PID(kp=kp, ki=ki, kd=0.0)
    state, integral, found, expected = pid.init(0.0, 0.0, 0.0), 0.0, [], []
    for error in errors:
        state, output = pid.step(state, error, 0.0, period)
        integral, mine = pi_step(integral, error, kp, ki, period)
        found.append(float(mine))
        expected.append(float(output))
    return found, expected


grading.close(*outputs([0.1, 0.1, -0.05, 0.02], 2 * bar, 60 * bar, 1 * ms), tolerance=1e-9, unit="Pa")
### BEGIN HIDDEN TESTS
grading.close(*outputs(0.2 * np.cos(np.arange(20)), 3 * bar, 10 * bar, 5 * ms), tolerance=1e-9, unit="Pa")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 2: measure
#
# Write the root mean square error of the angle [rad], from the columns `angle` and `desired_angle` of a result. Then
# predict: the frequency of the reference doubles. Does the error double as well?


# %% task error
def angle_error(result):
    """Root mean square error [rad] of the angle."""
    ### BEGIN SOLUTION
    return np.sqrt(np.mean((result["angle"] - result["desired_angle"]) ** 2))
    ### END SOLUTION


# %% check error 2
faster = run(mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar), frequency=1.0)
for result in (first, faster):
    grading.close(angle_error(result), result.metrics["angle_rmse"], tolerance=0.01, unit="rad")

# %%
print(f"error at 0.5 Hz: {angle_error(first) / deg:.2f} deg, at 1 Hz: {angle_error(faster) / deg:.2f} deg")

# %% [markdown]
# ## Task 3: tune
#
# Choose gains of the position loop such that the error stays below 0.8 deg at 0.5 Hz. The knee must also follow 0.6 Hz
# within 0.9 deg, and carry a heavier load; the check also tries combinations that are not shown here. Start from the
# gains above and raise one at a time. Which one reduces the error the most?

# %% task tune
### BEGIN SOLUTION
position = mk.PID(kp=4 * bar, ki=150 * bar, kd=0.4 * bar)
### END SOLUTION

# %% check tune 4
conditions = [{}, {"mass_factor": 1.2}]
### BEGIN HIDDEN TESTS
conditions += [{"mass_factor": 1.5, "stiffness": 13.0}, {"time_constant": 30 * ms}]
### END HIDDEN TESTS
grading.below([run(position, **each).metrics["angle_rmse"] / deg for each in conditions], 0.8, unit="deg")
grading.below(run(position, frequency=0.6).metrics["angle_rmse"] / deg, 0.9, unit="deg")

# %% [markdown]
# ## Task 4: what no gains can do
#
# The knee is to have a given stiffness while it moves slowly from $-A$ to $A$. Write a function that returns whether
# the stiffness is attainable at **all** these angles. `knee.attainable_stiffness(angles, torque)` returns the lowest
# and the highest, where `torque = -load.gravity_torque(angles)` holds the load.


# %% task feasible
def is_feasible(stiffness, amplitude):
    """Whether a stiffness [N*m/rad] is attainable at all angles within an amplitude [rad]."""
    ### BEGIN SOLUTION
    angles = np.linspace(-amplitude, amplitude, 101)
    lowest, highest = knee.attainable_stiffness(angles, -load.gravity_torque(angles))
    return bool(np.all((lowest <= stiffness) & (stiffness <= highest)))
    ### END SOLUTION


# %% check feasible 3
plant = mk.JointPlant(knee, load, mk.IdealValve())
cases = [(14.0, 5 * deg), (22.0, 5 * deg), (14.0, 30 * deg)]
### BEGIN HIDDEN TESTS
cases += [(16.0, 10 * deg), (12.0, 20 * deg), (10.0, 15 * deg), (17.0, 5 * deg)]
### END HIDDEN TESTS
for stiffness, amplitude in cases:
    slow = mk.Reference(angle=mk.Sine(amplitude=amplitude, frequency=0.05), stiffness=mk.Constant(stiffness))
    expected = bool(np.all(mk.check_reference(plant, slow, duration=20.0).feasible))
    found = is_feasible(stiffness, amplitude)
    grading.ensure(bool(found) == expected, f"{stiffness} N*m/rad within {amplitude / deg:.0f} deg: not {found}.")

# %%
asked = run(position, stiffness=22.0)
print(f"asked: 22 N*m/rad, highest stiffness in the run: {np.max(asked['stiffness']):.1f} N*m/rad")
print(asked.verdict())

# %% [markdown]
# ## What to remember
#
# - **An unreachable stiffness is not a tuning problem.** The integral of the stiffness loop drives both valves to their
#   limits, where the position loop loses its authority too.
# - **Integral action removes constant errors only.** The error on a moving reference grows with its frequency.
# - **The valve limits the gain.** Feedback reacts to pressures that arrive tens of milliseconds late; with more gain,
#   the joint oscillates.
# - **Gains that fit one run prove little.** Test them with other loads and other references.
