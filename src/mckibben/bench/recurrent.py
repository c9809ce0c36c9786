"""A small recurrent network: one gated recurrent unit and a linear output, trained with Adam."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from mckibben.bench.task import Floats, Predict, Training
from mckibben.errors import IdentificationError

_HIDDEN, _CHUNK, _WARM = 16, 160, 40  # units; samples of a chunk; samples before the error counts
_STEPS, _BATCH, _RATE = 1500, 24, 5e-3
_LONGEST_STEP = 0.02  # s: faster recordings are thinned for the network


class _Network(eqx.Module):
    cell: eqx.nn.GRUCell
    output: eqx.nn.Linear
    direct: eqx.nn.Linear

    def __init__(self, inputs: int, key: Any) -> None:
        first, second, third = jax.random.split(key, 3)
        self.cell = eqx.nn.GRUCell(inputs, _HIDDEN, key=first)
        self.output = eqx.nn.Linear(_HIDDEN, 1, key=second)
        self.direct = eqx.nn.Linear(inputs, 1, key=third)

    def __call__(self, inputs: Any) -> Any:
        def step(state: Any, one: Any) -> tuple[Any, Any]:
            state = self.cell(one, state)
            return state, self.output(state)[0] + self.direct(one)[0]

        return lax.scan(step, jnp.zeros(_HIDDEN), inputs)[1]


def fit_recurrent(training: Training) -> Predict | None:
    """Fit a gated recurrent unit to recordings; None for data without time.

    K. Cho et al., "Learning phrase representations using RNN encoder-decoder", EMNLP 2014 (unit); D. P. Kingma and
    J. Ba, "Adam: a method for stochastic optimization", ICLR 2015.
    """
    if training.period is None:
        return None
    stride = max(1, round(_LONGEST_STEP / training.period))
    inputs, output = training.stacked
    middle, width = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-12)
    mean, spread = output.mean(), max(float(output.std()), 1e-12)
    blocks = [((one.inputs - middle) / width, (one.output - mean) / spread) for one in training.blocks]
    blocks = [(given[i::stride], wanted[i::stride]) for given, wanted in blocks for i in range(stride)]
    padded = [(_rested(given), np.pad(wanted, (_WARM, 0), mode="edge")) for given, wanted in blocks]
    starts = [(i, at) for i, (_, wanted) in enumerate(padded) for at in range(0, wanted.size - _CHUNK + 1, _CHUNK // 4)]
    if not starts:
        raise IdentificationError("the recordings are too short for a recurrent network", remedy="give longer ones")
    given = jnp.array([padded[i][0][at : at + _CHUNK] for i, at in starts], jnp.float32)
    wanted = jnp.array([padded[i][1][at : at + _CHUNK] for i, at in starts], jnp.float32)
    network = jax.tree.map(
        lambda one: one.astype(jnp.float32) if eqx.is_inexact_array(one) else one,
        _Network(inputs.shape[1], jax.random.key(0)),
    )
    weights, fixed = eqx.partition(network, eqx.is_inexact_array)
    weights = _trained(weights, fixed, given, wanted)
    trained = eqx.combine(weights, fixed)
    run = jax.jit(lambda one: trained(one))

    def predict(new: Floats) -> Floats:
        scaled = (new - middle) / width
        found = np.empty(len(new))
        for i in range(stride):
            found[i::stride] = np.asarray(run(jnp.asarray(_rested(scaled[i::stride]), jnp.float32)))[_WARM:]
        return mean + spread * found

    return predict


def _rested(inputs: Floats) -> Floats:
    """Inputs after a rest at the first ones."""
    return np.pad(inputs, ((_WARM, 0), (0, 0)), mode="edge")


@jax.jit
def _step(weights: Any, moments: Any, number: Any, gradient: Any) -> tuple[Any, Any]:
    rate = _RATE * 0.5 * (1 + jnp.cos(jnp.pi * number / _STEPS))
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, moments[0], gradient)
    second = jax.tree.map(lambda m, g: 0.999 * m + 0.001 * g**2, moments[1], gradient)

    def moved(w: Any, m: Any, v: Any) -> Any:
        return w - rate * (m / (1 - 0.9**number)) / (jnp.sqrt(v / (1 - 0.999**number)) + 1e-8)

    return jax.tree.map(moved, weights, first, second), (first, second)


def _trained(weights: Any, fixed: Any, given: Any, wanted: Any) -> Any:
    def error(weights: Any, chosen: Any) -> Any:
        found = jax.vmap(eqx.combine(weights, fixed))(given[chosen])
        return jnp.mean((found - wanted[chosen])[:, _WARM:] ** 2)

    @jax.jit
    def run(weights: Any) -> Any:
        def one(carry: Any, number: Any) -> tuple[Any, None]:
            weights, moments = carry
            chosen = jax.random.randint(jax.random.fold_in(jax.random.key(1), number), (_BATCH,), 0, len(given))
            gradient = jax.grad(error)(weights, chosen)
            size = jnp.sqrt(sum(jnp.sum(each**2) for each in jax.tree.leaves(gradient)))
            gradient = jax.tree.map(lambda each: each / jnp.maximum(size, 1.0), gradient)
            return _step(weights, moments, number + 1.0, gradient), None

        zero = jax.tree.map(jnp.zeros_like, weights)
        return lax.scan(one, (weights, (zero, zero)), jnp.arange(_STEPS, dtype=jnp.float32))[0][0]

    return run(weights)
