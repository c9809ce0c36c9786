# %% [markdown]
# # Hysteresis and friction
#
# Stretch a pneumatic muscle and let it go again: at the same pressure and length it pulls harder on the way out than on
# the way back. The threads of the braid rub. In this lab you measure the width of the loop, write a model of it, find
# out what it does to the stiffness of a joint, and identify it together with the force law.
#
# **You need** the lab on the force law. **You learn** to read a loop, to model friction that sticks without a sign
# function, to tell small-motion stiffness from isobaric stiffness, and to identify a law without the bias of friction.

# %% [markdown]
# ## A test in both directions
#
# A test rig stretches the muscle step by step at constant pressure (*loading*: the length grows) and lets it shorten
# again (*unloading*). The rig of this lab is simulated, with noise of force and pressure; the muscle in it has friction
# that you are to find.

# %%
import dataclasses

import grading
import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.units import bar, deg, mm

law = mk.catalog.law("lei-mas-10-180n")
specimen = mk.catalog.specimen("MAS-10-180N-AA-MC-O")
rig = mk.SimulatedIsobaricTest(mk.Muscle(specimen, law), hysteresis=9.0, presliding_length=0.6 * mm)
protocol = mk.IsobaricProtocol(pressures=[3 * bar, 4 * bar, 5 * bar, 6 * bar], repeats=1)
data = rig.run(protocol, seed=3)


def branches(data, pressure):
    """Return contraction [-], force on loading and force on unloading [N] at a nominal pressure [Pa]."""
    one = data.at([pressure]).plateau_means().taut
    direction, contraction = np.asarray(one.table["direction"]), np.asarray(one.contraction).round(5)
    force = np.asarray(one.force)
    up, down = (
        dict(zip(contraction[each], force[each], strict=True))
        for each in (direction == "loading", direction == "unloading")
    )
    both = sorted(set(up) & set(down))
    return np.array(both), np.array([up[each] for each in both]), np.array([down[each] for each in both])


figure, axes = plt.subplots()
for pressure in (3 * bar, 6 * bar):
    contraction, up, down = branches(data, pressure)
    axes.plot(100 * contraction, up - down, ".-", label=f"{pressure / bar:.0f} bar")
axes.set(xlabel="contraction [%]", ylabel="loading minus unloading [N]")
axes.legend()

# %% [markdown]
# ## Task 1: width of the loop
#
# Predict first: does the distance between the branches grow with the pressure? Look at the plot. At both ends it is
# smaller: right after a reversal the force has not yet reached the other branch, and a muscle that hardly pulls has
# hardly any friction.
#
# Half the distance between the branches is the *half width* $B$ of the loop. Estimate it: take the **median** of half
# the distance over all contractions of a pressure, and the mean over the pressures.


# %% task width
def half_width(data, pressures):
    """Half width [N] of the loops at several nominal pressures [Pa]."""
    ### BEGIN SOLUTION
    widths = []
    for pressure in pressures:
        _, up, down = branches(data, pressure)
        widths.append(np.median(up - down) / 2)
    return np.mean(widths)
    ### END SOLUTION


# %% check width 2
grading.close(half_width(data, [3 * bar, 4 * bar, 5 * bar, 6 * bar]), 9.0, tolerance=0.05, unit="N")
### BEGIN HIDDEN TESTS
wider = mk.SimulatedIsobaricTest(mk.Muscle(specimen, law), hysteresis=14.0)
short = mk.IsobaricProtocol(pressures=[4 * bar, 6 * bar], repeats=1)
grading.close(half_width(wider.run(short, seed=5), [4 * bar, 6 * bar]), 14.0, tolerance=0.06, unit="N")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 2: a spring with a slider
#
# A force $-B\,\mathrm{sign}(v)$ would be a poor model: at rest it is undefined, and in a simulation it chatters. A
# spring in series with a slider has no such problem. The spring of stiffness $k$ is unstressed at the length $a$, its
# *anchor*. It pulls with $k (l - a)$, but with at most $\pm B$; beyond that the slider slips, and the anchor follows so
# that the force stays at the limit:
#
# $$f = \mathrm{clip}\left(k (l - a), -B, B\right), \qquad a \leftarrow l - f / k$$
#
# Write one step. The force is positive, and adds to that of the law, while the muscle is stretched.


# %% task slip
def slip(anchor, length, stiffness, limit):
    """Return the friction force [N] at a length [m], and the new anchor [m]."""
    ### BEGIN SOLUTION
    force = np.clip(stiffness * (length - anchor), -limit, limit)
    return force, length - force / stiffness
    ### END SOLUTION


# %% check slip 3
def path_of(lengths, stiffness, limit):
    """Compare the forces along a path with those of the toolkit's model with one element."""
    model = mk.MaxwellSlip(limit, limit / stiffness, elements=1)
    scale = float(model.stiffnesses[0])  # of its one spring
    anchor, found = lengths[0], []
    for length in lengths:
        force, anchor = slip(anchor, length, scale, limit)
        found.append(float(force))
    return found, model.path_response(lengths, tension=1e4, pressure=4 * bar)


grading.close(*path_of([0.170, 0.1701, 0.175, 0.1749, 0.170, 0.1703], 2e4, 9.0), tolerance=1e-3, unit="N")
### BEGIN HIDDEN TESTS
grading.close(*path_of(0.17 + 2e-3 * np.sin(np.linspace(0, 15, 300)), 3e4, 12.0), tolerance=1e-3, unit="N")
### END HIDDEN TESTS

# %% [markdown]
# Several such elements in parallel, which slip one after the other, make the reversal smooth: that is the Maxwell-slip
# model, `mk.MaxwellSlip(half_width, presliding_length)`. After a reversal, 63 % of the change to the other branch is
# complete after the presliding length. The browser page of this lab draws its loops.

# %%
friction = mk.MaxwellSlip(half_width=9.0, presliding_length=0.6 * mm)
lengths = 0.17 + np.concatenate(
    [3e-3 * np.sin(np.linspace(0, 2.5 * np.pi, 400)), np.linspace(3e-3, 1e-3, 60), np.linspace(1e-3, 3e-3, 60)]
)
forces = friction.path_response(lengths, tension=300.0, pressure=4 * bar)
figure, axes = plt.subplots()
axes.plot(lengths / mm, forces)
axes.set(xlabel="length [mm]", ylabel="friction [N]")

# %% [markdown]
# ## Task 3: energy of a loop
#
# Predict first: does the muscle return more work on the way back than stretching it has cost, or less? Compute the
# energy that is lost in one closed cycle, $E = \oint f\,dl$, from samples of length and force (the trapezoidal rule;
# the last sample equals the first). For a motion much longer than the presliding length it is close to $4 B$ times the
# amplitude.


# %% task energy
def lost_energy(length, force):
    """Energy [J] that is lost in a closed cycle, from samples of the length [m] and of the friction force [N]."""
    ### BEGIN SOLUTION
    return np.sum((force[1:] + force[:-1]) / 2 * np.diff(length))
    ### END SOLUTION


# %% check energy 2
def cycle(amplitude):
    """Return length and force of the last of three cycles."""
    phase = np.linspace(0, 6 * np.pi, 6001)
    lengths = 0.17 + amplitude * np.sin(phase)
    return lengths[-2001:], friction.path_response(lengths, tension=1e4, pressure=4 * bar)[-2001:]


grading.close(lost_energy(*cycle(30 * mm)), 4 * 9.0 * 30 * mm, tolerance=0.03, unit="J")
grading.close(
    lost_energy(np.array([0.0, 1.0, 1.0, 0.0, 0.0]), np.array([2.0, 2.0, -2.0, -2.0, 2.0])), 4.0, tolerance=1e-9
)
### BEGIN HIDDEN TESTS
grading.ensure(lost_energy(*cycle(0.05 * mm)) < 0.1 * 4 * 9.0 * 0.05 * mm, "A small motion hardly slips.")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 4: stiffness of a joint with friction
#
# Now both muscles of a knee have this friction. Push the joint from rest by the angle $a$: muscle $i$ with the moment
# arm $d_i$ changes its length by $d_i a$, and its friction resists with $f_i$, the response of an unstressed muscle to
# that displacement. To the push, the joint has the *secant stiffness*
#
# $$K_a = K + \frac{f_1 d_1 + f_2 d_2}{a}$$
#
# where $K$ is the isobaric stiffness, `knee.stiffness(angle, pressures)`. Implement it with
# `friction.path_response([l, l + d*a], tension=..., pressure=...)[1]`, at the tension of each muscle
# (`knee.tensions(angle, pressures)`).

# %%
printed = mk.catalog.joint("knee-table-2")
muscle = dataclasses.replace(printed.muscle1, friction=friction)
geometry = dataclasses.replace(printed.geometry, connector_length=208 * mm)
knee = dataclasses.replace(printed, geometry=geometry, muscle1=muscle, muscle2=muscle)
held = (3.5 * bar, 3.5 * bar)


def moment_arms(angle):
    """Moment arms [m] of both muscles at an angle [rad], positive."""
    step = 1e-5
    after, before = (np.array(knee.geometry.path_lengths(angle + each)) for each in (step, -step))
    return np.abs(after - before) / (2 * step)


# %% task secant
def secant_stiffness(angle, pressures, amplitude):
    """Stiffness [N*m/rad] of the knee to a push by an amplitude [rad] from rest."""
    ### BEGIN SOLUTION
    resisting = 0.0
    for arm, tension, pressure in zip(moment_arms(angle), knee.tensions(angle, pressures), pressures, strict=True):
        moved = friction.path_response([0.17, 0.17 + arm * amplitude], tension=float(tension), pressure=pressure)
        resisting += moved[1] * arm
    return float(knee.stiffness(angle, pressures)) + resisting / amplitude
    ### END SOLUTION


# %% check secant 3
for amplitude in (0.02 * deg, 0.5 * deg, 1.5 * deg):
    expected = knee.secant_stiffness(0.0, held, amplitude)
    grading.close(secant_stiffness(0.0, held, amplitude), expected, tolerance=0.02, unit="N*m/rad")
### BEGIN HIDDEN TESTS
for amplitude in (0.1 * deg, 0.4 * deg):
    expected = knee.secant_stiffness(3 * deg, (3 * bar, 4 * bar), amplitude)
    grading.close(secant_stiffness(3 * deg, (3 * bar, 4 * bar), amplitude), expected, tolerance=0.03, unit="N*m/rad")
### END HIDDEN TESTS

# %%
amplitudes = np.geomspace(0.01, 10, 40) * deg
figure, axes = plt.subplots()
axes.semilogx(amplitudes / deg, [secant_stiffness(0.0, held, each) for each in amplitudes])
axes.axhline(float(knee.stiffness(0.0, held)), linestyle="--")
axes.set(xlabel="amplitude [deg]", ylabel="stiffness [N·m/rad]")

# %% [markdown]
# ## Task 5: two answers to one question
#
# "How stiff is this knee?" Give the ratio of its stiffness to a tiny push (0.01 deg) to its isobaric stiffness, and the
# amplitude [rad] at which a push meets exactly twice the isobaric stiffness. Predict the ratio first.

# %% task ratio
### BEGIN SOLUTION
isobaric = float(knee.stiffness(0.0, held))
ratio = secant_stiffness(0.0, held, 0.01 * deg) / isobaric
low, high = 0.01 * deg, 10 * deg
for _ in range(40):
    middle = np.sqrt(low * high)
    if secant_stiffness(0.0, held, middle) > 2 * isobaric:
        low = middle
    else:
        high = middle
amplitude_of_twice = low
### END SOLUTION

# %% check ratio 2
grading.close(ratio, knee.secant_stiffness(0.0, held, 0.01 * deg) / knee.stiffness(0.0, held), tolerance=0.02)
grading.ensure(0.01 * deg < amplitude_of_twice < 20 * deg, "Is the amplitude in deg where rad is expected?")
twice = knee.secant_stiffness(0.0, held, amplitude_of_twice) / knee.stiffness(0.0, held)
grading.close(twice, 2.0, tolerance=0.02)

# %% [markdown]
# ## Task 6: where the joint comes to rest
#
# At constant pressures a joint with friction has not one position of rest but a range of them: friction can hold any
# torque up to $B_1 d_1 + B_2 d_2$, and the spring of the joint, $K$, pulls it back with $K$ times the deviation. How
# far, at most, can the angle at rest deviate from that without friction? (Gravity aside.) `friction.half_width_at(T,
# p)` is the half width at the tension $T$ and the pressure $p$.
#
# Compare with the amplitude of task 5. Why are they (almost) equal?

# %% task rest
### BEGIN SOLUTION
widths = [
    float(friction.half_width_at(tension, pressure))
    for tension, pressure in zip(knee.tensions(0.0, held), held, strict=True)
]
deviation = np.dot(widths, moment_arms(0.0)) / float(knee.stiffness(0.0, held))
### END SOLUTION

# %% check rest 2
pushed = 2 * deg  # beyond presliding: all sliders slip
without = float(knee.stiffness(0.0, held))
friction_torque = (float(knee.secant_stiffness(0.0, held, pushed)) - without) * pushed
grading.close(deviation, friction_torque / without, tolerance=0.08, unit="rad")

# %% [markdown]
# ## Task 7: identify
#
# Fit Eq. 2 to the points of the first test in three ways: to all of them (`mk.identify(..., mk.ExponentialLaw)`), to
# those of loading alone, and together with the friction (`mk.identify_hysteresis(mk.ExponentialLaw, data)`, with the
# results `.law` and `.friction`). Give the **bias** of each law: the mean of its force minus that of the true law
# (`law.force`) over the grid below. Two of the three are almost unbiased. Predict which one is not, and its sign.

# %%
means = data.plateau_means().taut
loading = means.select(np.asarray(means.table["direction"]) == "loading")
grid = np.meshgrid(np.linspace(0.02, 0.14, 13), [3 * bar, 4 * bar, 5 * bar, 6 * bar])

# %% task identify
### BEGIN SOLUTION
found = mk.identify_hysteresis(mk.ExponentialLaw, data)
laws = [mk.identify(means, mk.ExponentialLaw).law, mk.identify(loading, mk.ExponentialLaw).law, found.law]
bias_all, bias_loading, bias_with_friction = (
    np.mean(np.asarray(each.force(*grid)) - np.asarray(law.force(*grid))) for each in laws
)
identified_half_width = found.friction.half_width
### END SOLUTION

# %% check identify 4
reference = [mk.identify(each, mk.ExponentialLaw).law for each in (means, loading)]
reference.append(mk.identify_hysteresis(mk.ExponentialLaw, data).law)
for answer, one in zip((bias_all, bias_loading, bias_with_friction), reference, strict=True):
    expected = np.mean(np.asarray(one.force(*grid)) - np.asarray(law.force(*grid)))
    grading.ensure(abs(answer - expected) < 0.05, f"The bias is {expected:+.2f} N, not {answer:+.2f} N.")
grading.close(identified_half_width, 9.0, tolerance=0.01, unit="N")

# %%
names = ("all points", "loading alone", "law with friction")
for name, bias in zip(names, (bias_all, bias_loading, bias_with_friction), strict=True):
    print(f"bias, {name}: {bias:+.2f} N")

# %% [markdown]
# ## What to remember
#
# - **A fit to one direction is biased by half the loop.** Its residuals look perfect. Measure both directions, and fit
#   the friction too.
# - **Isobaric stiffness is not what a small push meets.** Friction between the threads acts as a spring until it
#   yields; the knee is several times as stiff for small motion. Say for which amplitude a stiffness holds.
# - **A joint at constant pressures rests anywhere within a band.** No setpoint of the pressures is accurate to better
#   than that without feedback of the angle.
# - **No sign function.** Elements of springs and sliders stick at rest and need no smoothing.
