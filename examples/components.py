"""User-defined classes of every kind, for docs/extending.md: copy the one that is closest to yours.

    mckibben check examples/components.py

checks the instances at the end of this file.
"""

from dataclasses import dataclass
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import mckibben as mk
from mckibben.actuator import AirValve, Valve
from mckibben.control import Controller, Loop, Observer, PolePlacement, Signal, StageCost
from mckibben.joint import Measurement, MusclePath, PendulumLoad, Tendon
from mckibben.muscle import NO_STATE, Domain, ForceLaw, Friction, MaxwellCreep, Parameter, pressure_for
from mckibben.numerics.calculus import bracketed_root
from mckibben.plant import Disturbance, Sensors
from mckibben.rig import JointHardware, SimulatedJoint
from mckibben.rig.simulated import SimulatedRig
from mckibben.robot import RobotController
from mckibben.units import (
    AngleGain,
    BoundedInt,
    Delay,
    Frequency,
    IntegralGain,
    Length,
    Pressure,
    Quantity,
    SignalValue,
    SpringRate,
    Tension,
    Torque,
    ValveTime,
    bar,
    deg,
    mm,
    ms,
)


class SofteningLaw(ForceLaw):
    """F = a p^1.2 (1 - eps/eps0)."""

    a: float
    eps0: float
    domain: Domain = Domain(0.0, 0.2, 0.1 * bar, 6 * bar)

    equation = "F = a p^1.2 (1 - eps/eps0)"
    source = "docs/extending.md"
    linear_parameters = (Parameter("a", "N/Pa^1.2", "N/Pa^1.2", "force per pressure"),)
    shape_parameters = (Parameter("eps0", "1", "%", "contraction without force", 0.2, 0.5),)

    def force(self, contraction, pressure):
        return self.a * jnp.asarray(pressure) ** 1.2 * (1 - jnp.asarray(contraction) / self.eps0)

    def pressure_for(self, force, contraction):
        return pressure_for(self, force, contraction)


class Slider(Friction):
    """One spring with a slider that yields at a constant force."""

    half_width: Tension
    stiffness: SpringRate

    def initial(self, length):
        return (jnp.asarray(length, float),)

    def half_width_at(self, tension, pressure):
        return jnp.minimum(self.half_width, jnp.asarray(tension) / 2)

    def force(self, state, length, tension, pressure):
        limit = self.half_width_at(tension, pressure)
        return jnp.clip(self.stiffness * (length - state[0]), -limit, limit)

    def project(self, state, length, tension, pressure):
        return (length - self.force(state, length, tension, pressure) / self.stiffness,)

    def viscous_force(self, length, tension, pressure, rate):
        return jnp.zeros_like(jnp.asarray(rate, float))

    def path_response(self, length, tension, pressure, *, side=0.0):
        columns = (np.asarray(column, float) for column in (length, tension, pressure))
        length, tension, pressure = np.broadcast_arrays(*columns)
        limit = np.asarray(self.half_width_at(tension, pressure))
        force = np.full(len(length), side * limit[0])
        for k in range(1, len(length)):
            force[k] = np.clip(force[k - 1] + self.stiffness * (length[k] - length[k - 1]), -limit[k], limit[k])
        return force


class SlowCreep(MaxwellCreep):
    """Maxwell arms, each three times slower than the one before."""

    @property
    def time_constants(self):
        return [self.time_constant * 3.0**arm for arm in range(self.arms)]


class StiffeningTendon(Tendon):
    """Extension that approaches its travel x: x (1 - exp(-T/T0))."""

    travel: Length
    scale: Tension

    def extension(self, tension):
        return self.travel * (1 - jnp.exp(-jnp.asarray(tension) / self.scale))

    def contraction(self, muscle, path, pressure, state=NO_STATE):
        def excess(extension):
            contraction = muscle.specimen.contraction_at(path - extension)
            return extension - self.extension(muscle.tension(contraction, pressure, state))

        return muscle.specimen.contraction_at(path - bracketed_root(excess, 0.0, self.travel))

    def permitted(self, muscle, path):
        ends = muscle.domain.contraction_min, muscle.domain.contraction_max
        least, most = (jnp.asarray(path) - muscle.specimen.length_at(end) for end in ends)

        def tension(extension):
            return -self.scale * jnp.log1p(-jnp.clip(extension / self.travel, 0.0, 1 - 1e-12))

        lowest = jnp.where(least > 0, tension(least), -jnp.inf)
        highest = jnp.where(most < self.travel, tension(most), jnp.inf)
        return jnp.where(least < self.travel, lowest, jnp.inf), jnp.where(most >= 0, highest, -jnp.inf)


class Spiral(MusclePath):
    """A spiral: the moment arm grows in proportion to the angle."""

    arm: Length
    growth: Length
    rest_length: Length

    def length(self, angle, side):
        return self.rest_length + side * (self.arm * angle + self.growth * angle**2 / 2)


class TwoLags(Valve):
    """Two equal first-order lags in series; the state is the pressure after the first."""

    time_constant: ValveTime = 20 * ms

    def init(self, pressure):
        return pressure

    def after(self, pressure, state, command, elapsed):
        ratio = jnp.asarray(elapsed) / self.time_constant
        error, pilot = pressure - command, state - command
        return command + (error + pilot * ratio) * jnp.exp(-ratio), command + pilot * jnp.exp(-ratio)

    def pressure_after(self, pressure, command, elapsed):
        return self.after(pressure, self.init(pressure), command, elapsed)[0]

    def command_for(self, pressure, rate):
        return jnp.asarray(pressure) + 2 * self.time_constant * rate


class Spool(AirValve):
    """Proportional valve whose spool follows the pressure error with a lag."""

    spool_lag: ValveTime = eqx.field(kw_only=True, default=5 * ms)

    def init(self, pressure):
        return jnp.zeros_like(pressure)

    def opening(self, state, command, pressure):
        return jnp.clip(state, -1.0, 1.0)

    def rate(self, state, command, pressure):
        return (jnp.clip((command - pressure) / self.band, -1.0, 1.0) - state) / self.spool_lag

    def fastest_rate(self, stroke):
        return max(1 / float(self.spool_lag), super().fastest_rate(stroke))


class SpringLoad(PendulumLoad):
    """A pendulum with a torsion spring, relaxed at 0."""

    spring: Annotated[float, Quantity("N*m/rad", lower=0, upper=1e3)] = 0.0

    def gravity_torque(self, angle):
        return super().gravity_torque(angle) - self.spring * jnp.asarray(angle)

    def gravity_stiffness(self, angle):
        return super().gravity_stiffness(angle) + self.spring


class SmoothedPressures(Sensors):
    """Pressure sensors with a first-order filter: the share of the last reading that each keeps."""

    share: Delay = 0.5

    def init(self, true):
        return true.pressures

    def measure(self, state, index, true):
        read = tuple(new + self.share * (old - new) for new, old in zip(true.pressures, state, strict=True))
        return read, Measurement(true.angle, read)


class Sway(Disturbance):
    """A torque that oscillates."""

    height: Torque
    frequency: Frequency = 1.0

    def torque(self, time):
        return self.height * jnp.sin(2 * jnp.pi * self.frequency * jnp.asarray(time))


class Chirp(Signal):
    """A sine whose frequency grows with time [1/s^2]."""

    amplitude: SignalValue
    growth: Frequency = 0.5

    def __call__(self, time):
        return self.amplitude * jnp.sin(jnp.pi * self.growth * jnp.asarray(time) ** 2)


class Eased(Controller):
    """A wrapped controller, whose commands are approached by a share of the distance in each period."""

    inner: Controller
    share: Delay = 0.5

    def init(self, measurement):
        return self.inner.init(measurement), measurement.pressures

    def step(self, state, setpoint, measurement, period):
        inner, wanted = self.inner.step(state[0], setpoint, measurement, period)
        commands = tuple(old + self.share * (new - old) for old, new in zip(state[1], wanted, strict=True))
        return (inner, commands), commands

    def telemetry(self, state):
        return self.inner.telemetry(state[0])


class Synergy(RobotController):
    """Controller of two joints: each differential pressure follows the angle errors of both."""

    gain: AngleGain = 3 * bar
    coupling: AngleGain = 1 * bar
    cocontraction: Pressure = 2.5 * bar

    def init(self, measurement):
        return ()

    def step(self, state, setpoint, measurement, period):
        first, second = (own.angle - angle for own, angle in zip(setpoint, measurement.angles, strict=True))
        commands = []
        for own, other in ((first, second), (second, first)):
            differential = self.gain * own + self.coupling * other
            commands += [self.cocontraction - differential, self.cocontraction + differential]
        return state, tuple(commands)


class Integral(Loop):
    """Integral control alone; its output is its state."""

    ki: IntegralGain

    def init(self, setpoint, measured, output):
        return jnp.asarray(output, float)

    def step(self, state, setpoint, measured, period):
        output = state + period * self.ki * (setpoint - measured)
        return output, output

    def track(self, state, output, achieved, period):
        return jnp.asarray(achieved, float)

    def telemetry(self, state):
        return {}


class SuperTwisting(PolePlacement):
    """Pole placement with a term in the square root of the error."""

    k1: Annotated[float, Quantity("rad^0.5/s^2", lower=0, upper=1e6)] = 0.0

    def step(self, state, error, rate, jerk, period):
        state, acceleration = super().step(state, error, rate, jerk, period)
        return state, acceleration + self.k1 * error / jnp.sqrt(jnp.abs(error) + 1e-6)


class Effort(StageCost):
    """Pressures cost, as they take air: the predictive controller trades them for stiffness."""

    pressure: Pressure = 20 * bar  # weighs as much as an angle error of `angle_scale`

    def residuals(self, stage):
        pressure1, pressure2 = stage.pressures
        return pressure1 / self.pressure, pressure2 / self.pressure


class AlphaBeta(Observer):
    """Constant gains of the angle and, per period, of the velocity."""

    alpha: Delay = 0.2
    beta: Delay = 0.02

    def gains(self, period):
        return self.alpha, self.beta / period, 0.0


@dataclass
class MyRig(SimulatedRig):
    """The simulated rig at a port."""

    port: Annotated[int, BoundedInt(0, 9)] = 0

    def __post_init__(self):
        muscle = mk.Muscle(mk.catalog.specimen("MAS-10-180N-AA-MC-O"), mk.catalog.law("lei-mas-10-180n"))
        SimulatedRig.__init__(self, muscle)

    @property
    def description(self):
        return {"kind": "custom", "port": str(self.port)}


@dataclass(frozen=True, kw_only=True)
class MyJoint(JointHardware):
    """A joint at a port."""

    port: Annotated[int, BoundedInt(0, 9)] = 0

    def backend(self, plant, run):
        return SimulatedJoint(plant, period=run.period, patience=run.patience)


softening = SofteningLaw(a=5e-5, eps0=0.3)
slider = Slider(half_width=10.0, stiffness=20e3)
creep = SlowCreep(stiffness=500.0, time_constant=5.0, arms=2)
tendon = StiffeningTendon(travel=5 * mm, scale=100.0)
spiral = Spiral(arm=25 * mm, growth=5 * mm, rest_length=165 * mm)
lags = TwoLags()
spool = Spool(5e-9, 7 * bar)
load = SpringLoad(0.5, 200 * mm, spring=2.0)
pressures = SmoothedPressures()
sway = Sway(0.1)
chirp = Chirp(5 * deg)
knee = mk.catalog.joint("knee-table-2")
eased = Eased(
    mk.PositionStiffnessControl(mk.PID(2 * bar, 60 * bar, 0.4 * bar), mk.PID(0.08 * bar, 5 * bar, 0.0), model=knee)
)
synergy = Synergy()
integral = Integral(60 * bar)
twisting = SuperTwisting(k1=2.0)
effort = Effort()
observer = AlphaBeta()
