"""Feedforward by an inverse model of the joint, learned on line by a small network, in addition to two loops."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from mckibben.actuator import FirstOrderValve
from mckibben.component.columns import Label
from mckibben.control.allocation import keep_taut, linearise, pressure_range, prioritise_torque
from mckibben.control.backprop import Network
from mckibben.control.base import Controller, LoadModel, Measurement, Setpoint, ValveModel, check_valve_model
from mckibben.control.position_stiffness import Feedforward, PositionStiffnessControl, PositionStiffnessState
from mckibben.control.reference import ReferenceDerivatives
from mckibben.joint.attainable import pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.numerics.compiled import cached_trace
from mckibben.numerics.elementary import exp, floating
from mckibben.units import AngleScale, AngularAcceleration, Bandwidth, Count, PressureScale, Rate, Seed, StiffnessScale

Scalar = Float[Array, ""]

_WEIGHT_LIMIT = 5.0
_TAUT = 1.0  # N: below it a pressure does not determine the motion, and learning stops


class FilteredSignal(NamedTuple):
    """Signal behind two equal first-order filters, and the output of the first."""

    value: Scalar
    first: Scalar


class MeasuredMotion(NamedTuple):
    """Filtered angle [rad], model stiffness [N*m/rad], pressures [Pa], and the velocity of the angle [rad/s]."""

    angle: FilteredSignal
    stiffness: FilteredSignal
    pressure1: FilteredSignal
    pressure2: FilteredSignal
    velocity: Scalar


class InverseInput(NamedTuple):
    """Input of the inverse: angle [rad], velocity [rad/s], acceleration [rad/s^2], stiffness [N*m/rad]."""

    angle: Scalar
    velocity: Scalar
    acceleration: Scalar
    stiffness: Scalar


class InitialOffset(NamedTuple):
    """Initial stiffness [N*m/rad], and pressures [Pa] minus those of the model there."""

    stiffness: Scalar
    differential: Scalar
    cocontraction: Scalar


class InverseModelState(NamedTuple):
    """State of loops, reference, filters and network; feedforward and error of the inverse [Pa] as (pd, pc)."""

    loops: PositionStiffnessState
    reference: ReferenceDerivatives
    path: Scalar
    measured: MeasuredMotion
    network: Network
    offset: InitialOffset
    feedforward: Pair
    error: Pair


class InverseModelControl(Controller[InverseModelState]):
    r"""Feedforward pressures from a learned inverse of the joint, in addition to a position and a stiffness loop.

    The inverse is that of a model, if there is a `load`, plus a network with one hidden layer,

    .. math:: (p_d, p_c) = M(x) + p_0 + p_s\,[W (\tanh(V \bar x), 1)], \quad
              x = (\theta, \dot\theta, \ddot\theta, K), \quad \bar x = (x / x_s, 1)

    M maps the torque of the motion (`Load.required_torque`) and the stiffness to pressures, with priority to the
    torque; p_0 makes it exact at the start. The feedforward uses x of the reference after the lag of the valves. The
    training uses x of the *measured* motion and the measured pressures as the target (direct inverse learning), behind
    the same two filters, whose differences are velocity and acceleration. Each period both layers take one normalised
    gradient step on the squared error e, with the Jacobian J of the network:

    .. math:: \Delta w = \eta h\, \frac{J^T e / p_s}{1 + |J|^2}

    so that a step removes at most the fraction :math:`\eta h \le 1` of the error. Weights are bounded, an error is
    clipped to p_s, and nothing is learned from a slack muscle. The output layer starts at zero, the hidden one at
    random. The learned inverse includes friction.

    Parameters
    ----------
    loops
        The two loops, with their model and minimum tension.
    load
        Model of inertia, damping and gravity; None for the network alone.
    learning_rate, hidden, seed
        eta [1/s], 0 for none; number of hidden neurons, and seed of their weights.
    valve
        Model of the valves, with the lag that the feedforward previews; default: first-order, 20 ms.
    filter_bandwidth
        Bandwidth of the filters [rad/s]: above the motion, below the noise of the encoder.
    angle_scale, velocity_scale, acceleration_scale, stiffness_scale, pressure_scale
        x_s and p_s [Pa], typical magnitudes of inputs and outputs, in SI; of the stiffness relative to its initial
        value.

    References
    ----------
    D. Psaltis, A. Sideris and A. Yamamura, A multilayered neural network controller, IEEE Control Systems Magazine 8,
    1988 ("generalized learning"). Normalised steps: G. Goodwin and K. Sin, Adaptive Filtering, Prediction and Control,
    Prentice-Hall 1984, ch. 3; filters on both sides of a model: J.-J. Slotine and W. Li, Applied Nonlinear Control,
    Prentice-Hall 1991, sec. 9.2.
    """

    short_name = "inverse_model"
    telemetry_labels: ClassVar = {
        "feedforward_differential": Label("Pa", "feedforward differential pressure"),
        "feedforward_cocontraction": Label("Pa", "feedforward co-contraction"),
        "inverse_error_differential": Label("Pa", "error of the learned inverse in differential pressure"),
        "inverse_error_cocontraction": Label("Pa", "error of the learned inverse in co-contraction"),
    }

    loops: PositionStiffnessControl
    load: LoadModel | None = None
    learning_rate: Rate = eqx.field(kw_only=True, default=10.0)
    hidden: Count = eqx.field(kw_only=True, static=True, default=8)
    valve: ValveModel = eqx.field(kw_only=True, default=FirstOrderValve(0.02))
    filter_bandwidth: Bandwidth = eqx.field(kw_only=True, default=60.0)
    angle_scale: AngleScale = eqx.field(kw_only=True, default=0.15)
    velocity_scale: Bandwidth = eqx.field(kw_only=True, default=1.0)
    acceleration_scale: AngularAcceleration = eqx.field(kw_only=True, default=8.0)
    stiffness_scale: StiffnessScale = eqx.field(kw_only=True, default=3.0)
    pressure_scale: PressureScale = eqx.field(kw_only=True, default=1e5)
    seed: Seed | Int[Array, ""] = eqx.field(kw_only=True, default=0)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_valve_model("InverseModelControl", self.valve, self.loops.model)

    def init(self, measurement: Measurement) -> InverseModelState:
        angle, pressures = measurement
        zero = jnp.zeros_like(floating(angle))
        stiffness = self.loops.model.evaluate(angle, pressures)[1]
        weights = jax.random.uniform(jax.random.key(self.seed), (self.hidden, 5), minval=-1.0, maxval=1.0)
        network = Network(weights.astype(zero.dtype), jnp.zeros((2, self.hidden + 1), zero.dtype))
        differential, cocontraction = self._model_inverse(InverseInput(angle, zero, zero, stiffness), pressures)
        pressure1, pressure2 = pressures
        feedforward = Feedforward((pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2, zero)

        def constant(x: ArrayLike) -> FilteredSignal:
            return FilteredSignal(floating(x), floating(x))

        return InverseModelState(
            loops=self.loops.init_with(feedforward, measurement),
            reference=ReferenceDerivatives.init(angle),
            path=zero,
            measured=MeasuredMotion(
                constant(angle), constant(stiffness), constant(pressure1), constant(pressure2), zero
            ),
            network=network,
            offset=InitialOffset(
                floating(stiffness), feedforward.differential - differential, feedforward.cocontraction - cocontraction
            ),
            feedforward=feedforward[:2],
            error=(zero, zero),
        )

    def step(
        self, state: InverseModelState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[InverseModelState, Pair]:
        reference, offset = state.reference.update(setpoint.angle, period), state.offset
        path = state.path + jnp.where(reference.samples_since_jump >= 1.0, period * reference.velocity, 0.0)
        added = self._added_stiffness(measurement)
        target = self._preview(reference, setpoint.stiffness - added, period)
        differential, cocontraction = self._model_inverse(target, measurement.pressures)
        learned, _ = self._network_output(state.network, target, offset)
        feedforward = Feedforward(
            differential + offset.differential + learned[0], cocontraction + offset.cocontraction + learned[1], path
        )
        loops, commands = self.loops.step_with(feedforward, state.loops, setpoint, measurement, period)

        measured, acceleration = self._filter(state.measured, measurement, loops.estimate - added, period)
        network, error = self._train(state.network, measured, acceleration, offset, period)
        return InverseModelState(loops, reference, path, measured, network, offset, feedforward[:2], error), commands

    def telemetry(self, state: InverseModelState) -> dict[str, Scalar]:
        return {
            **self.loops.telemetry(state.loops),
            "feedforward_differential": state.feedforward[0],
            "feedforward_cocontraction": state.feedforward[1],
            "inverse_error_differential": state.error[0],
            "inverse_error_cocontraction": state.error[1],
        }

    def _added_stiffness(self, measurement: Measurement) -> Scalar | float:
        """Stiffness of the loops minus the isobaric one, which the inverse uses [N*m/rad]."""
        model, amplitude = self.loops.model, self.loops.stiffness_amplitude
        if amplitude is None:
            return 0.0
        return model.secant_stiffness(*measurement, amplitude) - model.evaluate(*measurement)[1]

    def _preview(self, reference: ReferenceDerivatives, stiffness: Scalar, period: ArrayLike) -> InverseInput:
        """Reference after the valves' lag."""
        lag = jnp.asarray(self.valve.model_lag(self.loops.model))
        velocity = reference.velocity + lag * reference.acceleration
        angle = reference.angle + lag * (reference.velocity + lag / 2 * reference.acceleration)
        return InverseInput(angle, velocity, reference.acceleration_after(lag, period), stiffness)

    def _model_inverse(self, x: InverseInput, pressures: Pair) -> Pair:
        """Differential pressure and co-contraction [Pa] by the model, within limits; zero without a load."""
        if self.load is None:
            return jnp.zeros_like(x.angle), jnp.zeros_like(x.angle)
        pressure1, pressure2 = self._limited_inverse(self.load, x, pressures)
        return (pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2

    @cached_trace
    def _limited_inverse(self, load: LoadModel, x: InverseInput, pressures: Pair) -> Pair:
        """Pressures [Pa] of the model within limits."""
        tension = _TAUT if self.minimum_tension is None else self.minimum_tension
        lowest, highest = pressure_range(self.loops.model, x.angle, tension)
        affine = linearise(self.loops.model, x.angle, keep_taut(pressures, lowest))
        torque = load.required_torque(x.angle, x.velocity, x.acceleration)
        return prioritise_torque(affine, torque, x.stiffness, lowest, highest, self.loops.model.springs).pressures

    @cached_trace
    def _unlimited_inverse(self, load: LoadModel, x: InverseInput, pressures: Pair) -> Pair:
        """Pressures [Pa] of the model without limits."""
        torque, model = load.required_torque(x.angle, x.velocity, x.acceleration), self.loops.model
        affine = linearise(model, x.angle, pressures)
        if any(model.springs):
            return prioritise_torque(affine, torque, x.stiffness, *pressure_limits_of(model), model.springs).pressures
        return affine.pressures_for(torque, x.stiffness)

    @cached_trace
    def _is_taut(self, angle: Scalar, pressures: Pair) -> Array:
        """Whether both muscles are taut by the model."""
        tension1, tension2 = self.loops.model.tensions(angle, pressures)
        return (tension1 > _TAUT) & (tension2 > _TAUT)

    def _network_output(
        self, network: Network, x: InverseInput, offset: InitialOffset
    ) -> tuple[Pair, tuple[Array, tuple[Scalar, ...]]]:
        """Differential pressure and co-contraction [Pa] by the network; its hidden layer and inputs."""
        inputs = (
            x.angle / self.angle_scale,
            x.velocity / self.velocity_scale,
            x.acceleration / self.acceleration_scale,
            (x.stiffness - offset.stiffness) / self.stiffness_scale,
            jnp.ones_like(offset.stiffness),
        )
        hidden = jnp.tanh(sum(network.hidden[:, i] * value for i, value in enumerate(inputs)))
        outputs = network.output[:, -1] + jnp.sum(network.output[:, :-1] * hidden, axis=1)
        return (self.pressure_scale * outputs[0], self.pressure_scale * outputs[1]), (hidden, inputs)

    def _filter(
        self, last: MeasuredMotion, measurement: Measurement, stiffness: Scalar, period: ArrayLike
    ) -> tuple[MeasuredMotion, Scalar]:
        """Filtered motion after a further measurement, and its acceleration [rad/s^2]."""
        fraction = 1 - exp(-jnp.asarray(self.filter_bandwidth) * period)

        def filtered_signal(before: FilteredSignal, now: ArrayLike) -> FilteredSignal:
            first = before.first + fraction * (now - before.first)
            return FilteredSignal(before.value + fraction * (first - before.value), first)

        angle, (pressure1, pressure2) = filtered_signal(last.angle, measurement.angle), measurement.pressures
        velocity = (angle.value - last.angle.value) / period
        filtered = MeasuredMotion(
            angle,
            filtered_signal(last.stiffness, stiffness),
            filtered_signal(last.pressure1, pressure1),
            filtered_signal(last.pressure2, pressure2),
            velocity,
        )
        return filtered, (velocity - last.velocity) / period

    def _train(
        self, network: Network, measured: MeasuredMotion, acceleration: Scalar, offset: InitialOffset, period: ArrayLike
    ) -> tuple[Network, Pair]:
        """Weights after one step, and the error of the inverse [Pa]."""
        angle, stiffness, pressure1, pressure2 = (signal.value for signal in measured[:4])
        x, pressures = InverseInput(angle, measured.velocity, acceleration, stiffness), (pressure1, pressure2)
        is_taut = self._is_taut(angle, pressures)

        differential, cocontraction = (pressure2 - pressure1) / 2, (pressure1 + pressure2) / 2
        if self.load is not None:
            first, second = self._unlimited_inverse(self.load, x, pressures)
            differential, cocontraction = differential - (second - first) / 2, cocontraction - (first + second) / 2
        targets = differential - offset.differential, cocontraction - offset.cocontraction
        outputs, (hidden, inputs) = self._network_output(network, x, offset)
        error = jax.tree.map(lambda target, output: jnp.where(is_taut, target - output, 0.0), targets, outputs)
        clipped = jnp.stack([jnp.clip(signal / self.pressure_scale, -1.0, 1.0) for signal in error])

        hidden_and_bias = jnp.concatenate([hidden, jnp.ones_like(hidden[:1])])
        by_hidden = network.output[:, :-1] * (1 - hidden**2)
        norm_sq = jnp.sum(hidden_and_bias**2) + jnp.sum(by_hidden**2) * sum(value**2 for value in inputs)
        step = jnp.minimum(self.learning_rate * period, 1.0) / (1 + norm_sq) * clipped
        hidden_step = jnp.sum(by_hidden * step[:, None], axis=0)
        network = Network(
            network.hidden + jnp.stack([hidden_step * value for value in inputs], axis=1),
            network.output + step[:, None] * hidden_and_bias,
        )
        return jax.tree.map(lambda weights: jnp.clip(weights, -_WEIGHT_LIMIT, _WEIGHT_LIMIT), network), error
