# %% [markdown]
# # The jumping leg
#
# A leg with four muscles, at hip and knee, jumps off the ground and lands on it. Nothing is as fast as one would like:
# air flows through valves, joints have stops, and what was jumped must be landed. In this lab you account for the
# energy of a jump, time the muscles, and land softly.
#
# **You need** the labs on attainable stiffness, and on valves and delay. **You learn** to read take-off and landing
# from forces, to close an energy balance, to gain height by timing, and to choose a stiffness for landing.

# %% [markdown]
# ## The leg
#
# The trunk slides on a vertical rail, and the foot is a roller. Muscle 2 of the knee stretches the leg, muscle 1 bends
# it. The regulators limit the flow of air into volumes that change with the motion. The first cell compiles the leg,
# which takes some seconds.

# %%
import dataclasses

import grading
import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.robot import EnergyBalance, Ground, PressureSchedule, RobotPlant, RobotStart, read_robot, simulate_robot
from mckibben.units import bar, deg, mm, ms

GRAVITY, STEP = 9.81, 0.25 * ms
robot = read_robot("lei-leg-planar")
regulator = mk.PressureRegulator(0.5 * L_PER_S_BAR, 7 * bar, time_constant=5 * ms, dead_volume=3e-6)
plant = RobotPlant(robot, regulator, Ground(20e3, 0.5, friction=0.0))
mass, squat = float(robot.total_mass), (0.0, -20 * deg)  # kg; angles of hip and knee


def jump(levels, wait=20 * ms, duration=0.7):
    """Jump from a squat: 1 bar in all muscles, and after a wait [s] the levels [Pa] of hip1, hip2, knee1, knee2."""
    schedule = PressureSchedule(tuple((1 * bar, each) for each in levels), ((wait,),) * 4)
    start = RobotStart(squat, (1 * bar,) * 4)
    return simulate_robot(plant, schedule, start, duration=duration, control_period=STEP)


first = jump((1 * bar, 1 * bar, 0 * bar, 6 * bar))
figure, axes = plt.subplots(2, 1, sharex=True)
axes[0].plot(first.times, first["mass_height"] / mm)
axes[0].set(ylabel="centre of mass [mm]")
axes[1].plot(first.times, first["ground_up"] / (mass * GRAVITY))
axes[1].set(xlabel="time [s]", ylabel="force of the ground [weights]")

# %% [markdown]
# ## Task 1: take-off
#
# In flight only gravity acts, so the speed at take-off determines the rise of the centre of mass. Find the take-off in
# a run: the foot leaves the ground at the last sample with a force before the longest time without one. Return the
# speed `run["mass_speed"]` there [m/s], and the rise [m] that follows from it.


# %% task take_off
def take_off(run):
    """Speed of the centre of mass at take-off [m/s], and its rise after it [m]."""
    ### BEGIN SOLUTION
    touching = np.flatnonzero(run["ground_up"] > 0)
    last = touching[np.argmax(np.diff(touching))]
    speed = run["mass_speed"][last]
    return speed, speed**2 / (2 * GRAVITY)
    ### END SOLUTION


# %% check take_off 2
speed, rise = take_off(first)
grading.close(speed, first.metrics["take_off_speed"], tolerance=0.01, unit="m/s")
highest = np.max(first["mass_height"]) - first["mass_height"][np.argmin(np.abs(first["mass_speed"] - speed))]
grading.close(rise, first.metrics["take_off_speed"] ** 2 / (2 * GRAVITY), tolerance=0.02, unit="m")
grading.close(rise, highest, tolerance=0.03, unit="m")
### BEGIN HIDDEN TESTS
other = jump((2 * bar, 4 * bar, 1 * bar, 5.5 * bar), 60 * ms)
grading.close(take_off(other)[0], other.metrics["take_off_speed"], tolerance=0.01, unit="m/s")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 2: energy accounts
#
# The columns `muscle_power`, `stop_power`, `resisting_power` (damping and friction) and `ground_power` [W] are the
# powers of everything that acts on the bodies, besides gravity. Over any run their works sum to the change of kinetic
# energy (`kinetic`) and of potential energy, $m g\,\Delta h$ of the centre of mass. Return the four works and the two
# changes [J] in this order, by the trapezoidal rule (`np.trapezoid`), from the first to the last sample.
#
# Predict: which of the four takes most of the energy away, from squat to the end of the landing?


# %% task energy
def accounts(run):
    """Works of muscles, stops, resistance and ground, and changes of kinetic and potential energy [J]."""
    ### BEGIN SOLUTION
    names = ("muscle_power", "stop_power", "resisting_power", "ground_power")
    works = [np.trapezoid(run[name], run.times) for name in names]
    kinetic = run["kinetic"][-1] - run["kinetic"][0]
    return [*works, kinetic, mass * GRAVITY * (run["mass_height"][-1] - run["mass_height"][0])]
    ### END SOLUTION


# %% check energy 3
found, expected = accounts(first), EnergyBalance.of(plant, first)
grading.close(np.array(found), np.array(expected[:6]), tolerance=0.01, unit="J")
grading.ensure(abs(sum(found[:4]) - sum(found[4:])) < 0.05, "The accounts do not close.")
### BEGIN HIDDEN TESTS
other = jump((2 * bar, 4 * bar, 1 * bar, 5.5 * bar), duration=0.3)
grading.close(np.array(accounts(other)), np.array(EnergyBalance.of(plant, other)[:6]), tolerance=0.01, unit="J")
### END HIDDEN TESTS

# %%
for name, energy in zip(("muscles", "stops", "damping", "ground", "kinetic", "potential"), found, strict=True):
    print(f"{name}: {energy:+.2f} J")

# %% [markdown]
# ## Task 3: constant pressures
#
# Choose four levels of at most 6 bar, applied 20 ms after the start, with which the centre of mass rises by at least
# 55 mm after take-off. Think about which muscle does the work, and which one is in its way.

# %% task constant
### BEGIN SOLUTION
levels = (0 * bar, 6 * bar, 0 * bar, 6 * bar)
### END SOLUTION

# %% check constant 2
grading.ensure(len(levels) == 4, "Four levels, of hip1, hip2, knee1 and knee2.")
grading.ensure(0 <= min(levels) and max(levels) <= 6 * bar, "The levels are from 0 to 6 bar, in Pa.")
grading.ensure(max(levels) > 1000, "Are the levels in bar where Pa is expected?")
constant = jump(levels)
risen = constant.metrics["take_off_speed"] ** 2 / (2 * GRAVITY)
grading.ensure(risen >= 55 * mm, f"The centre of mass rises by {risen / mm:.0f} mm only.")

# %% [markdown]
# ## Task 4: timing
#
# Predict: if the muscles wait a little longer, in which time the leg sinks into a deeper squat at 1 bar, does it jump
# higher or lower? Simulate waits of 20 to 200 ms in steps of 20 ms with your levels. Return the best wait [s] and the
# rise [m] with it. Which entry of the energy accounts has changed most?

# %% task timing
### BEGIN SOLUTION
waits = np.arange(20, 201, 20) * ms
rises = [jump(levels, wait).metrics["take_off_speed"] ** 2 / (2 * GRAVITY) for wait in waits]
best_wait, best_rise = waits[np.argmax(rises)], max(rises)
### END SOLUTION

# %% check timing 3
tried = [jump(levels, each).metrics["take_off_speed"] ** 2 / (2 * GRAVITY) for each in np.arange(20, 201, 20) * ms]
grading.close(best_rise, max(tried), tolerance=0.01, unit="m")
grading.close(best_wait, (20 + 20 * np.argmax(tried)) * ms, tolerance=0.01, unit="s")

# %%
timed = jump(levels, best_wait)
weights = timed.metrics["peak_landing_force"] / (mass * GRAVITY)
print(f"{tried[0] / mm:.0f} mm at once, {best_rise / mm:.0f} mm after {best_wait / ms:.0f} ms")
print(f"it lands with {weights:.1f} weights")

# %% [markdown]
# ## Task 5: land softly
#
# The stretched robot falls by 50 mm. Before, `robot.pressures_for` has set the stiffness of the knee. Too soft, and the
# knee hits its stop; too stiff, and the trunk is shaken. For the stiffnesses below, find the one with the smallest
# largest force on the trunk, `peak_trunk_force` [N]: once for the regulators, and once for valves that are almost shut
# during the landing, so that the air stays in the muscles. Predict which is softer.

# %%
stiffnesses = np.arange(10.0, 20.5, 1.0)  # N*m/rad
shut = dataclasses.replace(
    plant, valve=mk.PressureRegulator(0.002 * L_PER_S_BAR, 7 * bar, time_constant=5 * ms, dead_volume=3e-6)
)


def land(stiffness, plant):
    """Metrics of a landing after a fall of 50 mm with a stiffness [N*m/rad] of the knee."""
    pressures = robot.pressures_for((0.0, 0.0), torques=(0.0, 0.0), stiffness=(None, stiffness))
    start = RobotStart((0.0, 0.0), pressures, upward_speed=-np.sqrt(2 * GRAVITY * 50 * mm))
    schedule = PressureSchedule(tuple((each,) for each in pressures))
    return simulate_robot(plant, schedule, start, duration=0.25, control_period=STEP).metrics


# %% task landing
### BEGIN SOLUTION
best_regulated, best_shut = (
    stiffnesses[np.argmin([land(each, one)["peak_trunk_force"] for each in stiffnesses])] for one in (plant, shut)
)
### END SOLUTION

# %% check landing 3
for answer, one in ((best_regulated, plant), (best_shut, shut)):
    forces = [land(each, one)["peak_trunk_force"] for each in stiffnesses]
    grading.close(answer, stiffnesses[np.argmin(forces)], tolerance=0.01, unit="N*m/rad")

# %%
print(f"best stiffness: {best_regulated:.0f} N*m/rad with regulators, {best_shut:.0f} N*m/rad with the air shut in")

# %% [markdown]
# ## What to remember
#
# - **Speed at take-off is all that counts.** Everything before is an account of work: what the muscles do, minus what
#   damping, stops and the impact take.
# - **Timing is worth more than pressure.** A leg that sinks first has a longer stroke to push over.
# - **The best stiffness for landing depends on the valves.** Air that is shut in adds stiffness of its own. Too soft is
#   worse than too stiff, as the stop is harder than any muscle.
