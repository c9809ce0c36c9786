"""BP as a feed-forward: a small network that learns the inverse of the joint on line, in parallel with two loops."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from mckibben.control.allocation import map_at, pressures_between, torque_first
from mckibben.control.backprop import Network
from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.control.position_stiffness import Forward, PositionStiffnessControl, PositionStiffnessState
from mckibben.control.reference import Course, followed, standing
from mckibben.joint import Load
from mckibben.joint.geometry import Pair
from mckibben.numerics.batching import apart
from mckibben.numerics.checks import check_kind, check_positive
from mckibben.numerics.elementary import exp, floating
from mckibben.units import (
    AngleScale,
    AngularAcceleration,
    Bandwidth,
    Count,
    PressureScale,
    Rate,
    Seed,
    ShortTime,
    StiffnessScale,
)

Scalar = Float[Array, ""]

_WEIGHTS = 5.0  # no weight goes beyond it
_TAUT = 1.0  # N: below it a pressure says nothing about the motion, and nothing is learned from it


class Smoothed(NamedTuple):
    """A signal behind two equal filters of first order, and what came out of the first."""

    value: Scalar
    between: Scalar


class Moved(NamedTuple):
    """What there was, all behind the same filters: motion, pressures and the model's stiffness.

    Attributes
    ----------
    angle, stiffness, pressure1, pressure2
        [rad], [N*m/rad], [Pa].
    velocity
        Of the angle [rad/s].
    """

    angle: Smoothed
    stiffness: Smoothed
    pressure1: Smoothed
    pressure2: Smoothed
    velocity: Scalar


class Motion(NamedTuple):
    """What pressures are wanted for: angle [rad], velocity [rad/s], acceleration [rad/s^2], stiffness [N*m/rad]."""

    angle: Scalar
    velocity: Scalar
    acceleration: Scalar
    stiffness: Scalar


class Start(NamedTuple):
    """Where it all began: the stiffness [N*m/rad], and what the model had wrong about the pressures [Pa] there."""

    stiffness: Scalar
    differential: Scalar
    cocontraction: Scalar


class InverseModelState(NamedTuple):
    """The state of the loops, how the wish moves and how far it came, what there was, the weights; and what is told.

    That is the feed-forward, and what the learned inverse was off for the last motion: differential pressure and
    co-contraction [Pa].
    """

    loops: PositionStiffnessState
    course: Course
    path: Scalar
    moved: Moved
    network: Network
    start: Start
    forward: Pair
    off: Pair


class InverseModelControl(Controller):
    r"""Two loops, and beside them the pressures that a learned inverse of the joint gives for the wish.

    The inverse is that of a model, if there is a `load`, and a network with one hidden layer on top of it (without a
    load the network alone),

    .. math:: (p_d, p_c) = M(x) + p_0 + p_s\,[W (\tanh(V \bar x), 1)], \quad
              x = (\theta, \dot\theta, \ddot\theta, K), \quad \bar x = (x / x_s, 1)

    M turns the torque :math:`I \ddot\theta + c \dot\theta - \tau_g(\theta)` and the stiffness into pressures, the
    torque first; p_0 is what makes it right where it starts, so that the loops begin with nothing to do. As
    feed-forward x is the wish where it will be after the lag of the valves. To learn, x is what the joint *did*, and
    the target the pressures that were there (direct inverse learning): whatever moved the joint, the network is told
    which pressures go with that motion. Angle, stiffness (by the model) and pressures pass the same two filters, whose
    differences are velocity and acceleration, so that no signal lags behind another. Each period both layers take one
    step down the gradient of the squared error e of that, with the network's slope J normalised by its size:

    .. math:: \Delta w = \eta h\, \frac{J^T e / p_s}{1 + |J|^2}

    A step takes away at most the part :math:`\eta h` of the error, and not more than all of it: that is why it does
    not run away. Beside that the weights are bounded, an error counts up to p_s, and nothing is learned from a slack
    muscle. Learning needs not stop at a limit of the pressures: there, too, they are what made the motion. The output
    layer starts at zero, the hidden one at random.

    Feedback-error learning (Kawato), where the output of the loops is the error, was tried on the same conditions: at
    every rate that lowered the median it made the worst runs worse or lost some. A momentum of 0.9 made the error
    larger, and there is none.

    A feed-forward that knows how the wish moves must not be held back by a derivative of the measurement. The position
    loop therefore sees wish and measurement from a place that moves along with the wish (jumps left out). With a
    learning rate of zero, no load, and a wish that stands or jumps, this is the `PositionStiffnessControl` that it
    wraps; with one that moves, it is the same with `derivative_on_error`. Of a `BackpropPID` the network sees no more
    than jumps and errors then. What is learned has the friction in it: `FrictionCompensation` around this would make up
    for that twice.

    Parameters
    ----------
    loops
        The two loops, their model, and the minimum tension.
    load
        What it believes of inertia, damping and gravity; None for a network that starts from nothing.
    learning_rate
        eta [1/s]; 0 to learn nothing.
    hidden
        The number of hidden neurons.
    valve_time_constant
        The lag [s] of the valves, as it believes: how far the feed-forward looks ahead.
    filter_bandwidth
        Of the filters [rad/s]: faster than the motion, slower than the noise of the encoder.
    angle_scale, velocity_scale, acceleration_scale, stiffness_scale
        The usual size of what the network sees, in SI; the stiffness is counted from where it starts.
    pressure_scale
        p_s [Pa], the usual size of what the inverse has to give (or of what the model has wrong).
    seed
        Of the hidden layer's weights.

    References
    ----------
    D. Psaltis, A. Sideris and A. Yamamura, A multilayered neural network controller, IEEE Control Systems Magazine 8,
    1988 ("generalized learning"); the alternative: M. Kawato, K. Furukawa and R. Suzuki, A hierarchical neural-network
    model for control and learning of voluntary movement, Biological Cybernetics 57, 1987. Normalised steps: G. Goodwin
    and K. Sin, Adaptive Filtering, Prediction and Control, Prentice-Hall 1984, ch. 3; filters on both sides of a model:
    J.-J. Slotine and W. Li, Applied Nonlinear Control, Prentice-Hall 1991, sec. 9.2.
    """

    loops: PositionStiffnessControl
    load: Load | None = None
    learning_rate: Rate = eqx.field(kw_only=True, default=10.0)
    hidden: Count = eqx.field(kw_only=True, static=True, default=8)
    valve_time_constant: ShortTime = eqx.field(kw_only=True, default=0.02)
    filter_bandwidth: Bandwidth = eqx.field(kw_only=True, default=60.0)
    angle_scale: AngleScale = eqx.field(kw_only=True, default=0.15)
    velocity_scale: Bandwidth = eqx.field(kw_only=True, default=1.0)
    acceleration_scale: AngularAcceleration = eqx.field(kw_only=True, default=8.0)
    stiffness_scale: StiffnessScale = eqx.field(kw_only=True, default=3.0)
    pressure_scale: PressureScale = eqx.field(kw_only=True, default=1e5)
    seed: Seed | Int[Array, ""] = eqx.field(kw_only=True, default=0)

    def __check_init__(self) -> None:
        owner = "InverseModelControl"
        check_kind(owner, loops=(self.loops, PositionStiffnessControl))
        if self.load is not None:
            check_kind(owner, load=(self.load, Load))
        check_positive(owner, "1/s", zero=True, learning_rate=self.learning_rate)
        check_positive(owner, "s", zero=True, valve_time_constant=self.valve_time_constant)
        check_positive(
            owner,
            filter_bandwidth=self.filter_bandwidth,
            angle_scale=self.angle_scale,
            velocity_scale=self.velocity_scale,
            acceleration_scale=self.acceleration_scale,
            stiffness_scale=self.stiffness_scale,
            pressure_scale=self.pressure_scale,
            hidden=self.hidden,
        )

    @property
    def minimum_tension(self) -> float | None:
        """Below which no muscle shall go [N]: that of the loops."""
        return self.loops.minimum_tension

    def init(self, measurement: Measurement) -> InverseModelState:
        angle, pressures = measurement
        nothing = jnp.zeros_like(floating(angle))
        estimate = self.loops.model.stiffness(angle, pressures)
        weights = jax.random.uniform(jax.random.key(self.seed), (self.hidden, 5), minval=-1.0, maxval=1.0)
        network = Network(weights.astype(nothing.dtype), jnp.zeros((2, self.hidden + 1), nothing.dtype))
        differential, cocontraction = self._modelled(Motion(angle, nothing, nothing, estimate), pressures, 1.0)
        pressure1, pressure2 = pressures
        forward = Forward((pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2, nothing)
        start = Start(floating(estimate), forward.differential - differential, forward.cocontraction - cocontraction)

        def still(x: ArrayLike) -> Smoothed:
            return Smoothed(floating(x), floating(x))

        return InverseModelState(
            loops=self.loops.init_beside(forward, measurement),
            course=standing(angle),
            path=nothing,
            moved=Moved(still(angle), still(estimate), still(pressure1), still(pressure2), nothing),
            network=network,
            start=start,
            forward=forward[:2],
            off=(nothing, nothing),
        )

    def step(
        self, state: InverseModelState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[InverseModelState, Pair]:
        course = followed(state.course, setpoint.angle, period)
        # What the wish did since the last sample is on its path unless it jumped, or never was there before.
        path = state.path + jnp.where(course.since >= 1.0, period * course.velocity, 0.0)
        wish = self._ahead(course, setpoint.stiffness, period)
        modelled = self._modelled(wish, measurement.pressures, period)
        learned, _ = self._learned(state.network, wish, state.start)
        differential = modelled[0] + state.start.differential + learned[0]
        forward = Forward(differential, modelled[1] + state.start.cocontraction + learned[1], path)
        loops, commands = self.loops.step_beside(forward, state.loops, setpoint, measurement, period)

        moved, acceleration = self._moved(state.moved, measurement, loops.estimate, period)
        network, off = self._taught(state.network, moved, acceleration, state.start, period)
        return InverseModelState(loops, course, path, moved, network, state.start, forward[:2], off), commands

    def telemetry(self, state: InverseModelState) -> dict[str, Scalar]:
        return {
            **self.loops.telemetry(state.loops),
            "forward_differential": state.forward[0],
            "forward_cocontraction": state.forward[1],
            "inverse_error_differential": state.off[0],
            "inverse_error_cocontraction": state.off[1],
        }

    def _ahead(self, course: Course, stiffness: Scalar, period: ArrayLike) -> Motion:
        """The wish after the valves' lag."""
        lag = jnp.asarray(self.valve_time_constant)
        velocity = course.velocity + lag * course.acceleration
        angle = course.angle + lag * (course.velocity + lag / 2 * course.acceleration)
        return Motion(angle, velocity, course.ahead(lag, period), stiffness)

    def _torque(self, load: Load, motion: Motion) -> Scalar:
        """What a motion takes, as the load is believed to be [N*m]."""
        resisting = load.gravity_torque(motion.angle) - load.damping * motion.velocity
        return load.total_inertia * motion.acceleration - resisting

    def _modelled(self, motion: Motion, pressures: Pair, period: ArrayLike) -> Pair:
        """Differential pressure and co-contraction [Pa] for a motion, by the model, within the limits."""
        load, model = self.load, self.loops.model
        if load is None:
            return jnp.zeros_like(motion.angle), jnp.zeros_like(motion.angle)
        tension = _TAUT if self.minimum_tension is None else self.minimum_tension

        def chosen(motion: Motion, pressures: Pair) -> Pair:
            lowest, highest = pressures_between(model, motion.angle, tension)
            taut = jnp.maximum(pressures[0], lowest[0]), jnp.maximum(pressures[1], lowest[1])
            affine = map_at(model, motion.angle, taut)
            return torque_first(affine, self._torque(load, motion), motion.stiffness, lowest, highest).pressures

        pressure1, pressure2 = apart(chosen, motion, pressures, witness=period)
        return (pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2

    def _learned(self, network: Network, motion: Motion, start: Start) -> tuple[Pair, tuple[Array, tuple[Scalar, ...]]]:
        """Differential pressure and co-contraction [Pa] by the network; what its hidden layer says, and what it saw."""
        inputs = (
            motion.angle / self.angle_scale,
            motion.velocity / self.velocity_scale,
            motion.acceleration / self.acceleration_scale,
            (motion.stiffness - start.stiffness) / self.stiffness_scale,
            jnp.ones_like(start.stiffness),
        )
        hidden = jnp.tanh(sum(network.hidden[:, i] * x for i, x in enumerate(inputs)))
        outputs = network.output[:, -1] + jnp.sum(network.output[:, :-1] * hidden, axis=1)
        return (self.pressure_scale * outputs[0], self.pressure_scale * outputs[1]), (hidden, inputs)

    def _moved(
        self, moved: Moved, measurement: Measurement, stiffness: Scalar, period: ArrayLike
    ) -> tuple[Moved, Scalar]:
        """What there was, with one measurement more, and the acceleration [rad/s^2]."""
        share = 1 - exp(-jnp.asarray(self.filter_bandwidth) * period)

        def one(before: Smoothed, now: ArrayLike) -> Smoothed:
            between = before.between + share * (now - before.between)
            return Smoothed(before.value + share * (between - before.value), between)

        angle = one(moved.angle, measurement.angle)
        pressure1, pressure2 = measurement.pressures
        velocity = (angle.value - moved.angle.value) / period
        after = Moved(
            angle,
            one(moved.stiffness, stiffness),
            one(moved.pressure1, pressure1),
            one(moved.pressure2, pressure2),
            velocity,
        )
        return after, (velocity - moved.velocity) / period

    def _taught(
        self, network: Network, moved: Moved, acceleration: Scalar, start: Start, period: ArrayLike
    ) -> tuple[Network, Pair]:
        """The weights after one step, and how far the inverse was off [Pa]."""
        model, load = self.loops.model, self.load
        angle, stiffness, pressure1, pressure2 = (each.value for each in moved[:4])
        motion = Motion(angle, moved.velocity, acceleration, stiffness)
        pressures = pressure1, pressure2
        tension1, tension2 = apart(model.tensions, angle, pressures, witness=period)
        taut = (tension1 > _TAUT) & (tension2 > _TAUT)

        differential, cocontraction = (pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2
        if load is not None:

            def inverted(motion: Motion, pressures: Pair) -> Pair:
                return map_at(model, motion.angle, pressures).pressures_for(
                    self._torque(load, motion), motion.stiffness
                )

            first, second = apart(inverted, motion, pressures, witness=period)
            differential, cocontraction = differential - (second - first) / 2, cocontraction - (first + second) / 2

        differential, cocontraction = differential - start.differential, cocontraction - start.cocontraction
        learned, (hidden, inputs) = self._learned(network, motion, start)
        off = tuple(jnp.where(taut, x - y, 0.0) for x, y in zip((differential, cocontraction), learned, strict=True))
        errors = jnp.stack([jnp.clip(x / self.pressure_scale, -1.0, 1.0) for x in off])

        seen, slope = jnp.concatenate([hidden, jnp.ones_like(hidden[:1])]), 1 - hidden**2
        through = network.output[:, :-1] * slope
        size = jnp.sum(seen**2) + jnp.sum(through**2) * sum(x**2 for x in inputs)
        push = jnp.minimum(self.learning_rate * period, 1.0) / (1 + size) * errors
        back = jnp.sum(through * push[:, None], axis=0)
        moved_hidden = network.hidden + jnp.stack([back * x for x in inputs], axis=1)
        moved_output = network.output + push[:, None] * seen
        network = Network(jnp.clip(moved_hidden, -_WEIGHTS, _WEIGHTS), jnp.clip(moved_output, -_WEIGHTS, _WEIGHTS))
        return network, (off[0], off[1])
