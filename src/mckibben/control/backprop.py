"""PID with gains from a neural network trained on line by backpropagation (BP)."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from mckibben.component.checks import check_positive
from mckibben.control.base import Loop
from mckibben.control.pid import PID, PIDState
from mckibben.numerics.elementary import floating
from mckibben.units import Count, Quantity, Rate, Ratio, Seed

Momentum = Annotated[float, Quantity("1", "1", 0, 0.999999)]
ControlledScale = Annotated[float, Quantity("scale")]

OutputRate = Annotated[float, Quantity("Pa/s", "bar/s", 0, 1e6, open_lower=True)]

Scalar = Float[Array, ""]


class Network(NamedTuple):
    """Weights of the hidden and the output layer."""

    hidden: Float[Array, "hidden inputs"]
    output: Float[Array, "gains hidden_and_bias"]


class BackpropState(NamedTuple):
    """State of the PID, weights, their last change (for the momentum), last error and gain factors."""

    pid: PIDState
    network: Network
    change: Network
    error: Scalar
    factors: Float[Array, "3"]


class BackpropPID(Loop[BackpropState]):
    r"""PID whose three gains are outputs of a network with one hidden layer.

    The inputs of the network are setpoint, measurement, error and a constant, each scaled; its outputs :math:`o`
    modulate the base gains,

    .. math:: K_j = K_{j,base}\, R^{\tanh o_j}, \quad j = p, i, d,

    within a factor R of them and with their sign; initially they are the base gains (output layer zero, hidden layer
    random). The PID is in velocity form, :math:`\Delta u = K_p \Delta e + K_i e h + K_d \Delta \dot e`, so that a
    change of gain causes no jump. Each period the weights :math:`w` take one step of gradient descent on the squared
    error, with momentum :math:`\alpha`,

    .. math:: \Delta w = \eta h \frac{e}{e_s}\, \mathcal{J}\, \frac{1}{u_s} \frac{\partial (\Delta u / h)}{\partial w}
              + \alpha \Delta w_{previous},

    with the plant Jacobian :math:`\mathcal{J} = \partial y/\partial u` replaced by its sign, that of the base gains,
    as in most of the literature. The paper says no more than "BP"; this is the usual reading.

    Parameters
    ----------
    base
        The PID whose gains are modulated: "the same PID controller parameters are used in two methods".
    signal_scale, error_scale, output_scale
        Typical magnitude of the controlled quantity, e_s of a relevant error, u_s of the rate of the output; in SI.
    learning_rate, momentum
        eta [1/s]; alpha, 0 to 0.999999.
    gain_ratio
        R, above 1.
    hidden
        Number of hidden neurons.
    seed
        Seed of the hidden layer's weights.

    References
    ----------
    Fig. 5 and 7 of the paper; the scheme is that of J. Liu, Intelligent Control Design and MATLAB Simulation,
    Springer 2018, ch. 7 (gains from a BP network, sign of the Jacobian).
    """

    short_name = "backprop"

    base: PID
    signal_scale: ControlledScale = eqx.field(kw_only=True)
    error_scale: ControlledScale = eqx.field(kw_only=True)
    output_scale: OutputRate = eqx.field(kw_only=True)
    learning_rate: Rate = eqx.field(kw_only=True, default=10.0)
    momentum: Momentum = eqx.field(kw_only=True, default=0.5)
    gain_ratio: Ratio = eqx.field(kw_only=True, default=5.0)
    hidden: Count = eqx.field(kw_only=True, static=True, default=6)
    seed: Seed | Int[Array, ""] = eqx.field(kw_only=True, default=0)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_positive("BackpropPID", signal_scale=self.signal_scale, error_scale=self.error_scale)

    def init(self, setpoint: ArrayLike, measured: ArrayLike, output: ArrayLike) -> BackpropState:
        weights = jax.random.uniform(jax.random.key(self.seed), (self.hidden, 4), minval=-1.0, maxval=1.0)
        kind = floating(output).dtype  # the same draw in any precision
        network = Network(weights.astype(kind), jnp.zeros((3, self.hidden + 1), kind))
        return BackpropState(
            pid=self.base.init(setpoint, measured, output),
            network=network,
            change=jax.tree.map(jnp.zeros_like, network),
            error=jnp.zeros_like(floating(output)),
            factors=jnp.ones(3, kind),
        )

    def step(
        self, state: BackpropState, setpoint: ArrayLike, measured: ArrayLike, period: ArrayLike
    ) -> tuple[BackpropState, Scalar]:
        error = jnp.asarray(setpoint) - measured
        derivative = self.base.derivative(state.pid, setpoint, measured, period)
        inputs = (
            jnp.asarray(setpoint) / self.signal_scale,
            jnp.asarray(measured) / self.signal_scale,
            error / self.error_scale,
        )

        # Velocity form: the gain factors multiply these.
        parts = (
            self.base.kp * (error - state.error),
            self.base.ki * period * error,
            self.base.kd * (derivative - state.pid.derivative),
        )

        def increment(network: Network) -> tuple[Scalar, Array]:
            factors = self.gain_ratio ** jnp.tanh(_outputs(network, inputs))
            return sum(factor * part for factor, part in zip(factors, parts, strict=True)), factors  # type: ignore

        (change, factors), gradient = jax.value_and_grad(increment, has_aux=True)(state.network)
        rate = self.learning_rate * error / self.error_scale * self._jacobian() / self.output_scale
        update = jax.tree.map(lambda g, last: rate * g + self.momentum * last, gradient, state.change)
        network = jax.tree.map(jnp.add, state.network, update)

        output = state.pid.integral + change
        pid = PIDState(output, self.base.sample(state.pid, setpoint, measured), derivative)
        return BackpropState(pid, network, update, error, factors), output

    def track(self, state: BackpropState, output: ArrayLike, achieved: ArrayLike, period: ArrayLike) -> BackpropState:
        return state._replace(pid=self.base.track(state.pid, output, achieved, period))

    def telemetry(self, state: BackpropState) -> dict[str, Scalar]:
        return {
            "kp": state.factors[0] * self.base.kp,
            "ki": state.factors[1] * self.base.ki,
            "kd": state.factors[2] * self.base.kd,
        }

    def _jacobian(self) -> Array:
        """Sign of the plant's Jacobian."""
        ki, kp, kd = self.base.ki, self.base.kp, self.base.kd
        return jnp.sign(jnp.where(ki != 0, ki, jnp.where(kp != 0, kp, kd)))


def _outputs(network: Network, inputs: tuple[Scalar, ...]) -> Array:
    """Three outputs of the network; sums of products fuse at this size, matrix products do not."""
    inner = network.hidden[:, 3] + sum(network.hidden[:, i] * x for i, x in enumerate(inputs))
    activation = jnp.tanh(inner)
    return network.output[:, -1] + jnp.sum(network.output[:, :-1] * activation, axis=1)
