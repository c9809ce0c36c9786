# %% [markdown]
# # Valves and delay
#
# A controller asks for a pressure, and gets it later: air must flow through a valve, and the command itself travels
# through electronics, a bus and tubes. In this lab you compute how fast a valve can be, find out how much delay a loop
# tolerates before it oscillates, detect the oscillation, and remove most of the delay's effect by prediction.
#
# **You need** the lab on PID control, and frequency responses. **You learn** to model a valve as a lag and as a flow,
# to read a delay margin from a frequency response, to detect a limit cycle, and to use a predictor.

# %% [markdown]
# ## Two models of a valve
#
# The simplest model is a first-order lag, $T \dot p + p = u$, with the command $u$. A closer one has air: the mass flow
# through an opening of the sonic conductance $C$ (ISO 6358) at the absolute pressures $p_1$ upstream and $p_2$
# downstream is
#
# $$\dot m = C \rho_0 p_1 \sqrt{1 - \left(\frac{p_2 / p_1 - b}{1 - b}\right)^2}$$
#
# with the critical pressure ratio $b$. If $p_2 / p_1 \le b$ the flow is *choked*: it is $C \rho_0 p_1$, whatever the
# pressure downstream.

# %%
import dataclasses
import warnings

import grading
import matplotlib.pyplot as plt
import numpy as np

import mckibben as mk
from mckibben.muscle import air
from mckibben.units import bar, deg, mm, ms

warnings.simplefilter("ignore", mk.errors.McKibbenWarning)  # some loops below oscillate on purpose
CONDUCTANCE, CRITICAL = 0.4 * air.L_PER_S_BAR, 0.3  # of a small proportional valve

# %% [markdown]
# ## Task 1: a lag in discrete time
#
# The controller holds its command for a control period $h$. Give the pressure after it, exactly: not by an Euler step,
# which would go a quarter too far at $h = T / 2$.


# %% task lag
def after_lag(pressure, command, time_constant, period):
    """Pressure [Pa] after a period [s] with a constant command [Pa], of a first-order lag."""
    ### BEGIN SOLUTION
    return command + (pressure - command) * np.exp(-period / time_constant)
    ### END SOLUTION


# %% check lag 1
for given in ((1 * bar, 4 * bar, 20 * ms, 1 * ms), (5 * bar, 2 * bar, 20 * ms, 30 * ms)):
    valve = mk.FirstOrderValve(given[2])
    expected = valve.all_after((given[0],) * 2, (), (given[1],) * 2, given[3])[0][0]
    grading.close(after_lag(*given), expected, tolerance=1e-6, unit="Pa")

# %% [markdown]
# ## Task 2: mass flow
#
# Predict first: the supply has 7 bar gauge pressure. Up to which pressure in the muscle is the flow choked? Write the
# mass flow for **absolute** pressures, from `upstream` to `downstream`, for numbers; `air.DENSITY` is $\rho_0$.


# %% task flow
def mass_flow(upstream, downstream):
    """Mass flow [kg/s] at absolute pressures [Pa], the first one higher."""
    ### BEGIN SOLUTION
    ratio = downstream / upstream
    share = 1.0 if ratio <= CRITICAL else np.sqrt(1 - ((ratio - CRITICAL) / (1 - CRITICAL)) ** 2)
    return CONDUCTANCE * air.DENSITY * upstream * share
    ### END SOLUTION


# %% check flow 2
for upstream, downstream in ((8 * bar, 1 * bar), (8 * bar, 5 * bar), (6 * bar, 5 * bar)):
    expected = air.mass_flow(CONDUCTANCE, CRITICAL, upstream, downstream)
    grading.close(mass_flow(upstream, downstream), expected, tolerance=1e-3, unit="kg/s")
### BEGIN HIDDEN TESTS
for upstream, downstream in ((4 * bar, 1.19 * bar), (4 * bar, 1.25 * bar), (3 * bar, 2.5 * bar)):
    expected = air.mass_flow(CONDUCTANCE, CRITICAL, upstream, downstream)
    grading.close(mass_flow(upstream, downstream), expected, tolerance=1e-3, unit="kg/s")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 3: time to fill and to vent
#
# In a muscle of constant volume $V$ the pressure changes with $\dot p = n R T \dot m / V$; `air.ENERGY` is $R T$
# [J/kg], and $n = 1.2$. Integrate with small steps (1e-5 s), and give the time until the gauge pressure has gone from
# one value to another, filled from a supply of 7 bar gauge or vented to the atmosphere, `air.ATMOSPHERE`. Mind the
# difference of gauge and absolute pressure.
#
# Predict: does it take longer to fill from 1 to 5 bar, or to vent from 5 to 1 bar?


# %% task fill
def time_between(start, end, volume, supply=7 * bar):
    """Time [s] in which the gauge pressure [Pa] in a volume [m^3] changes from a start to an end."""
    ### BEGIN SOLUTION
    pressure, target, time, step = start + air.ATMOSPHERE, end + air.ATMOSPHERE, 0.0, 1e-5
    filling = end > start
    while (pressure < target) == filling:
        flow = mass_flow(supply + air.ATMOSPHERE, pressure) if filling else -mass_flow(pressure, air.ATMOSPHERE)
        pressure += step * 1.2 * air.ENERGY * flow / volume
        time += step
    return time
    ### END SOLUTION


# %% check fill 3
def by_integral(start, end, volume, supply=7 * bar):
    """The same as an integral of 1 / rate over the pressure."""
    absolute = np.linspace(start, end, 4001) + air.ATMOSPHERE
    if end > start:
        flow = air.mass_flow(CONDUCTANCE, CRITICAL, supply + air.ATMOSPHERE, absolute)
    else:
        flow = -air.mass_flow(CONDUCTANCE, CRITICAL, absolute, air.ATMOSPHERE)
    return np.trapezoid(volume / (1.2 * air.ENERGY * np.asarray(flow)), absolute)


for given in ((1 * bar, 5 * bar, 20e-6), (5 * bar, 1 * bar, 20e-6)):
    grading.close(time_between(*given), by_integral(*given), tolerance=0.01, unit="s")
### BEGIN HIDDEN TESTS
for given in ((0.2 * bar, 6 * bar, 50e-6), (6 * bar, 0.5 * bar, 30e-6)):
    grading.close(time_between(*given), by_integral(*given), tolerance=0.01, unit="s")
### END HIDDEN TESTS

# %%
for name, ends in {"filling": (1 * bar, 5 * bar), "venting": (5 * bar, 1 * bar)}.items():
    print(f"{name}: {time_between(*ends, 20e-6) / ms:.1f} ms")

# %% [markdown]
# ## A loop with a delay
#
# Now the knee of the lab on PID control, with a first-order valve of 20 ms and commands that arrive late.

# %%
printed = mk.catalog.joint("knee-table-2")
knee = dataclasses.replace(printed, geometry=dataclasses.replace(printed.geometry, connector_length=208 * mm))
load, lag = mk.catalog.load("knee-table-2"), mk.FirstOrderValve(20 * ms)
pid = mk.PositionStiffnessControl(
    mk.PID(kp=2 * bar, ki=60 * bar, kd=0.4 * bar), mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0), model=knee
)


def scenario(delay, controller=pid):
    """The knee on a sine of 5 deg with a delay of the commands [s]."""
    reference = mk.Reference(angle=mk.Sine(amplitude=5 * deg, frequency=0.5), stiffness=mk.Constant(14.0))
    parts = {"joint": knee, "load": load, "valve": lag, "controller": controller, "reference": reference}
    settings = {"start": {"stiffness": 14.0}, "duration": 4.0, "control_period": 1 * ms}
    return mk.Scenario(name="knee with a delay", command_delay=delay or None, **parts, **settings)


def runs(delays, controller=pid, over="command_delay", metrics=("angle_rmse", "oscillation_amplitude")):
    """Metrics of runs with other delays [s] of the plant, or of another parameter."""
    one = scenario(18 * ms, controller)
    plant, wanted = one.plant(), one.reference()
    start = one.initial(plant)
    return mk.simulate_many(
        plant,
        one.control(),
        wanted,
        over={over: np.asarray(delays)},
        duration=4.0,
        initial=start,
        metrics=list(metrics),
    )


margins = scenario(0.0).margins()
figure, axes = plt.subplots()
axes.loglog(margins.frequency, np.abs(margins.loci[0]))
axes.axhline(1, linestyle="--")
axes.set(xlabel="frequency [Hz]", ylabel="gain of the open loop")

# %% [markdown]
# ## Task 4: delay margin
#
# A delay $\tau$ multiplies the frequency response $L(i\omega)$ of the open loop by $e^{-i\omega\tau}$: it turns the
# phase, and leaves the gain. The loop becomes unstable when the delay turns $L$ to -1, at a frequency where
# $|L| = 1$. With the phase margin $\varphi = \pi + \arg L$ at such a crossover, the delay margin is $\varphi / \omega$.
#
# Find all crossovers between samples (where $|L| - 1$ changes its sign; use the sample before), take $\varphi$ within
# 0 to $2\pi$, and return the smallest margin.


# %% task margin
def delay_margin(frequency, response):
    """Delay margin [s] from samples of the open loop over the frequency [Hz]; infinite without a crossover."""
    ### BEGIN SOLUTION
    crossing = np.flatnonzero(np.diff(np.sign(np.abs(response) - 1)))
    phase = np.mod(np.pi + np.angle(response[crossing]), 2 * np.pi)
    return np.min(phase / (2 * np.pi * frequency[crossing]), initial=np.inf)
    ### END SOLUTION


# %% check margin 3
frequency = np.geomspace(0.1, 100, 20_001)
complex_frequency = 2j * np.pi * frequency
grading.close(delay_margin(frequency, 10 / complex_frequency), np.pi / 2 / 10, tolerance=0.01, unit="s")
grading.ensure(
    delay_margin(frequency, 0.5 / (1 + complex_frequency)) == np.inf, "No crossover: any delay is tolerated."
)
smallest = min(
    delay_margin(margins.frequency, margins.loci[point, :, number]) for point in range(20) for number in (0, 1)
)
grading.close(smallest, margins.delay.min(), tolerance=0.06, unit="s")
### BEGIN HIDDEN TESTS
lagging = 30 / complex_frequency / (1 + 0.02 * complex_frequency)
crossover = np.sqrt((np.sqrt(1 + 4 * (30 * 0.02) ** 2) - 1) / 2) / 0.02
expected = (np.pi / 2 - np.arctan(0.02 * crossover)) / crossover
grading.close(delay_margin(frequency, lagging), expected, tolerance=0.01, unit="s")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 5: detect the limit cycle
#
# Beyond the margin the linear loop is unstable. The real one oscillates with a constant amplitude, since the pressures
# are limited: a *limit cycle*. From the error of the angle over time, estimate its period: twice the mean time between
# two consecutive changes of sign. Take the second half of the run only.

# %%
beyond = scenario(20 * ms).simulate()
error = beyond["angle"] - beyond["desired_angle"]
figure, axes = plt.subplots()
axes.plot(beyond.times, error / deg)
axes.set(xlabel="time [s]", ylabel="error [deg]")


# %% task cycle
def cycle_period(error, control_period):
    """Period [s] of an oscillation, from the error in each control period [s]."""
    ### BEGIN SOLUTION
    later = np.asarray(error)[len(error) // 2 :]
    changes = np.flatnonzero(np.diff(np.sign(later)))
    return 2 * np.mean(np.diff(changes)) * control_period
    ### END SOLUTION


# %% check cycle 2
grading.close(cycle_period(error, 1 * ms), beyond.metrics["oscillation_period"], tolerance=0.06, unit="s")
### BEGIN HIDDEN TESTS
grading.close(cycle_period(np.sin(2 * np.pi * 7 * np.arange(3000) * 2e-3 + 0.3), 2e-3), 1 / 7, tolerance=0.01, unit="s")
### END HIDDEN TESTS

# %% [markdown]
# ## Task 6: where does it begin?
#
# Simulate delays of 10 to 24 ms in steps of 1 ms with `runs(delays)`, which returns their metrics; the column
# `oscillation_amplitude` [rad] is 0 without a limit cycle. Give the smallest delay [s] with one. Predict it from the
# margin of task 4. What does the error of the angle say one step below?

# %% task onset
### BEGIN SOLUTION
delays = np.arange(10, 25) * ms
found = runs(delays)
onset = delays[np.argmax(np.asarray(found["oscillation_amplitude"]) > 0)]
### END SOLUTION

# %% check onset 2
around = np.array([onset - 1 * ms, onset])
amplitudes = np.asarray(runs(around)["oscillation_amplitude"])
grading.ensure(amplitudes[1] > 0, "There is no limit cycle at this delay. Is it in s?")
grading.ensure(amplitudes[0] == 0, "There is a limit cycle at a smaller delay already.")

# %% [markdown]
# ## Task 7: predict
#
# `mk.DelayCompensation` estimates the state, predicts it over the delay with the commands that are on their way, and
# lets the controller act on the prediction. The plant now has a delay of 18 ms. But do you know the delay? Find the
# root mean square errors of the angle [rad] for the assumed delays below, and the largest of them at which the loop has
# no limit cycle. `runs(delays, controller, over="controller.command_delay")` varies what the controller assumes.

# %%
assumed = np.array([3.0, 6.0, 12.0, 18.0, 24.0, 30.0]) * ms
predictor = mk.DelayCompensation(controller=pid, command_delay=18 * ms, model=knee, load=load, valve=lag)

# %% task predict
### BEGIN SOLUTION
predicted = runs(assumed, predictor, over="controller.command_delay")
errors = np.asarray(predicted["angle_rmse"])
largest_assumed = assumed[np.asarray(predicted["oscillation_amplitude"]) == 0][-1]
### END SOLUTION

# %% check predict 3
expected = runs(assumed, predictor, over="controller.command_delay")
grading.close(errors, np.asarray(expected["angle_rmse"]), tolerance=0.01, unit="rad")
grading.close(
    largest_assumed, assumed[np.asarray(expected["oscillation_amplitude"]) == 0].max(), tolerance=0.01, unit="s"
)

# %%
alone = scenario(18 * ms).simulate().metrics["angle_rmse"]
print(f"without prediction: {alone / deg:.2f} deg")
for delay, one in zip(assumed, errors, strict=True):
    print(f"assumed {delay / ms:.0f} ms: {one / deg:.2f} deg")

# %% [markdown]
# ## What to remember
#
# - **A valve is a flow, not a number.** Choked flow fills at a constant rate; venting slows down as the pressure falls.
#   A time constant describes small changes about one pressure.
# - **Delay costs phase in proportion to frequency.** A faster loop has a smaller delay margin. Compute it before you
#   raise a gain.
# - **At the margin nothing warns.** One millisecond below the onset of the limit cycle the error looks as good as ever.
# - **A predictor needs the delay only roughly**, as the prediction is corrected by measurement. It moves the margin; it
#   does not make the knee react earlier.
