# %% [markdown]
# # Model-based control
#
# Two PID loops know nothing about the knee. A model gives the torque that a motion needs, and the pressures for that
# torque and a stiffness together. In this lab you invert the model, drive the knee without any feedback, add feedback,
# compare with PID at equal air, and find out which errors of the model feedback hides.
#
# **You need** the labs on attainable stiffness and PID control. **You learn** to invert torque and stiffness, to invert
# the dynamics and a valve, to compare controllers fairly, and to judge how much a wrong model costs.

# %% [markdown]
# ## The inverse
#
# With muscles that obey Eq. 2, torque and stiffness at a given angle are *affine* in the two pressures,
#
# $$\tau = \tau_0 + t_1 p_1 + t_2 p_2, \qquad K = K_0 + k_1 p_1 + k_2 p_2$$
#
# so three evaluations determine the map, and a system of two equations inverts it.

# %%
import dataclasses

import grading
import numpy as np

import mckibben as mk
from mckibben.units import bar, deg, litre, mm, ms

printed = mk.catalog.joint("knee-table-2")
knee = dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=208 * mm))
load = mk.catalog.load("knee-table-2")

# %% [markdown]
# ## Task 1: pressures for torque and stiffness
#
# Use `joint.torque(angle, (p1, p2))` and `joint.stiffness(angle, (p1, p2))` at (5, 5), (6, 5) and (5, 6) bar, where
# both muscles are taut: at 3 bar and 8 deg one is slack, and the map is another one. Return both pressures [Pa],
# without limits.


# %% task inverse
def pressures_for(joint, angle, torque, stiffness):
    """Gauge pressures [Pa] of muscles 1 and 2 that give a torque [N*m] and a stiffness [N*m/rad]."""

    ### BEGIN SOLUTION
    def both(pressures):
        return np.array([float(joint.torque(angle, pressures)), float(joint.stiffness(angle, pressures))])

    middle = both((5 * bar, 5 * bar))
    slopes = np.column_stack([both((6 * bar, 5 * bar)) - middle, both((5 * bar, 6 * bar)) - middle])
    found = np.linalg.solve(slopes, np.array([torque, stiffness]) - middle)
    return 5 * bar + found[0] * bar, 5 * bar + found[1] * bar
    ### END SOLUTION


# %% check inverse 3
for angle, torque, stiffness in ((0.0, 1.0, 14.0), (8 * deg, -0.5, 13.0)):
    expected = knee.affine_map(angle).pressures_for(torque, stiffness)
    grading.close(
        np.array(pressures_for(knee, angle, torque, stiffness)), np.array(expected), tolerance=1e-4, unit="Pa"
    )
### BEGIN HIDDEN TESTS
expected = knee.affine_map(-5 * deg).pressures_for(0.3, 15.0)
grading.close(np.array(pressures_for(knee, -5 * deg, 0.3, 15.0)), np.array(expected), tolerance=1e-4, unit="Pa")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 2: the torque that a motion needs
#
# Eq. 6 of the paper is $I \ddot\theta + c\,\dot\theta = \tau + \tau_g(\theta)$, with `load.total_inertia`,
# `load.damping` and `load.gravity_torque(angle)`. Solve it for the torque of the muscles. Predict first: at the turning
# points of a sine of 8 deg and 1 Hz, is more torque needed for inertia or for gravity?


# %% task torque
def needed_torque(load, angle, velocity, acceleration):
    """Torque [N*m] of the muscles for an angle [rad], velocity [rad/s] and acceleration [rad/s^2]."""
    ### BEGIN SOLUTION
    return load.total_inertia * acceleration + load.damping * velocity - np.asarray(load.gravity_torque(angle))
    ### END SOLUTION


# %% check torque 2
for state in ((0.1, 0.5, -3.0), (-0.2, 0.0, 10.0)):
    grading.close(needed_torque(load, *state), load.required_torque(*state), tolerance=1e-6, unit="N*m")
### BEGIN HIDDEN TESTS
heavy = dataclasses.replace(load, mass2=0.9, damping=0.05)
grading.close(needed_torque(heavy, 0.15, -2.0, 1.0), heavy.required_torque(0.15, -2.0, 1.0), tolerance=1e-6, unit="N*m")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 3: without feedback
#
# Both together give the pressures along a motion. The knee shall follow $\theta_0 \cos(2 \pi t)$, with $\theta_0$ =
# 8 deg, at a stiffness of 14 N·m/rad, in open loop: nobody looks at the angle. But the valves lag,
# $T \dot p + p = u$ with $T$ = 20 ms, so the commands have to lead. Given the pressures at equal times, return the
# commands (derivative by `np.gradient`).

# %%
times = np.arange(0, 3, 2 * ms)
angles = 8 * deg * np.cos(2 * np.pi * times)
velocities, accelerations = -2 * np.pi * 8 * deg * np.sin(2 * np.pi * times), -((2 * np.pi) ** 2) * angles
torques = np.asarray(load.required_torque(angles, velocities, accelerations))
planned = np.array(knee.affine_map(angles).pressures_for(torques, 14.0))  # shape (2, times)


def open_loop(commands, load=load):
    """Root mean square error of the angle [rad] when commands [Pa] of shape (2, times) drive the knee."""
    plant = mk.JointPlant(knee, load, mk.FirstOrderValve(20 * ms))
    controller = mk.OpenLoopControl(*(mk.Samples(times, each) for each in commands), model=knee)
    reference = mk.Reference(
        angle=mk.Sine(amplitude=8 * deg, frequency=1.0, phase=90 * deg), stiffness=mk.Constant(14.0)
    )
    start = plant.init_state(8 * deg, tuple(planned[:, 0]))
    return mk.simulate(plant, controller, reference, duration=2.9, control_period=1 * ms, initial=start).metrics[
        "angle_rmse"
    ]


# %% task lead
def leading(pressures, times, time_constant):
    """Commands [Pa] by which first-order valves follow pressures [Pa] of shape (2, times)."""
    ### BEGIN SOLUTION
    return pressures + time_constant * np.gradient(pressures, times, axis=1)
    ### END SOLUTION


# %% check lead 2
ramp = np.array([1 * bar + 2 * bar * times, 3 * bar - 0.5 * bar * times])
grading.close(leading(ramp, times, 0.05), ramp + 0.05 * np.array([[2 * bar], [-0.5 * bar]]), tolerance=1e-6, unit="Pa")
grading.below(open_loop(leading(planned, times, 20 * ms)) / deg, 0.3, unit="deg")

# %%
commands = leading(planned, times, 20 * ms)
heavier = dataclasses.replace(load, mass2=1.1 * load.mass2)
for name, error in {
    "with lead": open_loop(commands),
    "without lead": open_loop(planned),
    "with a weight that is 10 % heavier": open_loop(commands, heavier),
}.items():
    print(f"{name}: {error / deg:.2f} deg")

# %% [markdown]
# ## Task 4: feedback, at equal air
#
# Open loop depends on the model entirely. `mk.DecouplingControl` computes the same inverse in every control period, for
# the acceleration that a linear feedback asks for; an observer estimates what the model does not explain. Its poles
# have one parameter, their bandwidth.
#
# A comparison is fair at equal cost. Here the cost is air. Run the PID and the decoupling controller with `run`, and
# choose a bandwidth [rad/s] of at most 80 with which the decoupling controller has at most a **fifth** of the PID's
# error of the angle, and needs no more air. The check also tries other motions.

# %%
pid = mk.PositionStiffnessControl(
    mk.PID(kp=4 * bar, ki=150 * bar, kd=0.4 * bar), mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0), model=knee
)


def decoupling(bandwidth, model=knee):
    """The decoupling controller with poles of a bandwidth [rad/s]."""
    feedback = mk.PolePlacement(bandwidth, damping=2.5)
    observer = mk.ExtendedStateObserver(3 * bandwidth, damping=2.0)
    return mk.DecouplingControl(model, load, feedback, observer, valve=mk.FirstOrderValve(20 * ms))


def run(controller, *, frequency=1.0, load=load, joint=knee, time_constant=20 * ms, angle=None, stiffness=14.0):
    """Simulate 3 s of a sine of 8 deg, or of another angle; the plant may differ from the controller's model."""
    angle = mk.Sine(amplitude=8 * deg, frequency=frequency) if angle is None else angle
    plant = mk.JointPlant(joint, load, mk.FirstOrderValve(time_constant))
    reference = mk.Reference(angle=angle, stiffness=stiffness)
    return mk.simulate(plant, controller, reference, duration=3.0, control_period=1 * ms)


# %% task fair
### BEGIN SOLUTION
bandwidth = 50.0
### END SOLUTION

# %% check fair 3
grading.ensure(0 < bandwidth <= 80, "The bandwidth is at most 80 rad/s.")
frequencies = [1.0]
### BEGIN HIDDEN TESTS
frequencies = [0.7, 1.0, 1.3]
### END HIDDEN TESTS
for frequency in frequencies:
    ours, theirs = run(decoupling(bandwidth), frequency=frequency).metrics, run(pid, frequency=frequency).metrics
    grading.below(ours["angle_rmse"] / theirs["angle_rmse"], 0.2, unit="of the PID's error")
    grading.ensure(ours["air"] <= theirs["air"], f"At {frequency} Hz it needs more air than the PID.")

# %%
for name, one in {"PID": pid, "decoupling": decoupling(bandwidth)}.items():
    metrics = run(one).metrics
    print(f"{name}: {metrics['angle_rmse'] / deg:.2f} deg, {metrics['air'] / litre:.2f} L of air")

# %% [markdown]
# ## Task 5: decoupled
#
# The knee holds 5 deg while its stiffness steps from 12 to 16 N·m/rad at 1 s. Give the largest deviation of the angle
# [rad] after 0.99 s, for the PID and for the decoupling controller. Predict both. Why does the PID move the knee?

# %%
hold = {"angle": mk.Constant(5 * deg), "stiffness": mk.Step(before=12.0, after=16.0, at=1.0)}

# %% task coupling
### BEGIN SOLUTION
deviations = []
for controller in (pid, decoupling(bandwidth)):
    result = run(controller, **hold)
    deviations.append(np.max(np.abs(result["angle"] - 5 * deg)[result.times > 0.99]))
deviation_pid, deviation_decoupling = deviations
### END SOLUTION

# %% check coupling 2
held = run(pid, **hold)
expected = np.abs(np.asarray(held["angle"]) - np.asarray(held["desired_angle"]))[990:].max()
grading.close(deviation_pid, expected, tolerance=0.02, unit="rad")
grading.ensure(0 <= deviation_decoupling < expected / 20, "The decoupling controller hardly moves the knee.")

# %% [markdown]
# ## Task 6: an error that feedback hides
#
# Muscles differ: let both be 10 % weaker than in the model (`weak`). Give, for the decoupling controller, the factor by
# which the root mean square error of the **angle** grows, and that of the **stiffness**. Predict which one.

# %%
weak = dataclasses.replace(
    knee, **{name: dataclasses.replace(getattr(knee, name), strength=0.9) for name in ("muscle1", "muscle2")}
)

# %% task hidden
### BEGIN SOLUTION
right, wrong = (run(decoupling(bandwidth), joint=joint).metrics for joint in (knee, weak))
angle_factor = wrong["angle_rmse"] / right["angle_rmse"]
stiffness_factor = wrong["stiffness_rmse"] / right["stiffness_rmse"]
### END SOLUTION

# %% check hidden 2
before, after = (run(decoupling(bandwidth), joint=joint).metrics for joint in (knee, weak))
grading.close(angle_factor, after["angle_rmse"] / before["angle_rmse"], tolerance=0.02)
grading.close(stiffness_factor, after["stiffness_rmse"] / before["stiffness_rmse"], tolerance=0.02)

# %%
print(f"angle: {angle_factor:.2f} times, stiffness: {stiffness_factor:.0f} times")
print(f"the stiffness is off by {after['stiffness_rmse']:.2f} N*m/rad, the estimate by {after['estimate_rmse']:.2f}")

# %% [markdown]
# ## Task 7: plants that differ from the model
#
# Now the load is 50 % heavier or lighter, the muscles are 10 % weaker, and the valves have 10 to 40 ms, while the
# model remains the same. Choose a bandwidth with which the error stays below 0.16 deg in all these cases and the loop
# needs no more than 0.24 L of air. Slower poles need less air, faster ones hide more; the check tries more plants.

# %% task robust
### BEGIN SOLUTION
robust_bandwidth = 55.0
### END SOLUTION

# %% check robust 3
plants = [{"time_constant": 40 * ms}, {"load": dataclasses.replace(load, mass2=1.5 * load.mass2)}]
### BEGIN HIDDEN TESTS
plants += [{"time_constant": 10 * ms}, {"joint": weak}, {"load": dataclasses.replace(load, mass2=0.5 * load.mass2)}]
### END HIDDEN TESTS
found = [run(decoupling(robust_bandwidth), **each).metrics for each in plants]
grading.below([each["angle_rmse"] / deg for each in found], 0.16, unit="deg")
grading.below([each["air"] / litre for each in found], 0.24, unit="L")

# %% [markdown]
# ## What to remember
#
# - **The inverse decouples, feedback corrects.** With a model, feedback only has to remove what the model misses, and a
#   stiffness step does not move the joint.
# - **Compare at equal cost.** A smaller error that costs twice the air is no better controller.
# - **Feedback hides the model error that it can measure, and only that.** The angle is as good with muscles that are
#   10 % weaker; the stiffness, which nobody measures, is wrong by 10 %, and the controller does not know.
# - **Bandwidth hides errors until the valves or noise end it.** The lag of the valves is the part of the model that
#   matters most.
