"""Controller and joint as compiled functions of flat arrays."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.errors import SimulationError
from mckibben.numerics.compiled import compiled, numeric
from mckibben.plant import JointPlant, PlantState

_FURTHEST = np.pi / 2  # rad
_POINTS = 721


def vented_angle(plant: JointPlant) -> float:
    """The angle [rad] where gravity and empty muscles balance, the one nearest to 0 if there are more.

    Friction and creep have no say in it: a joint may rest anywhere near.

    Raises
    ------
    SimulationError
        If there is none within 90 deg either way.

    Examples
    --------
    >>> from mckibben import FirstOrderValve, catalog
    >>> plant = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> round(vented_angle(plant) / np.pi * 180, 1)
    0.6
    """
    nearly = _zero(plant, -_FURTHEST, _FURTHEST)
    width = 2 * _FURTHEST / (_POINTS - 1)
    return _zero(plant, nearly - width, nearly + width)


def _zero(plant: JointPlant, low: float, high: float) -> float:
    """Where the torque falls through zero, or stays there."""
    angles = np.linspace(low, high, _POINTS)
    torque = np.asarray(_torque(plant, angles))
    stable = np.flatnonzero((torque[:-1] >= 0) & (torque[1:] <= 0))
    if not stable.size:
        raise SimulationError(
            "the joint has no place to rest within 90 deg when both muscles are vented",
            remedy="give it a load that hangs",
        )
    at = stable[np.argmin(np.abs(angles[stable]))]
    drop = float(torque[at] - torque[at + 1])
    part = float(torque[at]) / drop if drop > 0 else 0.0
    return float(angles[at] + part * (angles[at + 1] - angles[at]))


@compiled
def _torque(plant: JointPlant, angles: ArrayLike) -> Array:
    return plant.joint.torque(angles, (0.0, 0.0)) + plant.load.gravity_torque(angles)


_ARRAYS = (jax.Array, np.ndarray, np.generic, jax.ShapeDtypeStruct)


class Packing:
    """Where the numbers of a tree lie in one array of 64-bit floats; flags and whole numbers come back as such.

    Parameters
    ----------
    like
        A tree of the structure; leaves that are no arrays are kept with it.

    Examples
    --------
    >>> packing = Packing((np.asarray(2.5), np.asarray([1, 2]), np.asarray(True)))
    >>> packing.packed((np.asarray(2.5), np.asarray([1, 2]), np.asarray(True)))
    array([2.5, 1. , 2. , 1. ])
    >>> packing.unpacked(np.array([2.5, 1.0, 2.0, 1.0]))
    (array(2.5), array([1, 2]), np.True_)
    """

    def __init__(self, like: Any) -> None:
        leaves, self._structure = jax.tree.flatten(like)
        self._fixed = [None if isinstance(leaf, _ARRAYS) else leaf for leaf in leaves]
        self._kinds = [(leaf.shape, leaf.dtype) if isinstance(leaf, _ARRAYS) else None for leaf in leaves]
        self.size = sum(math.prod(kind[0]) for kind in self._kinds if kind)

    def packed(self, tree: Any, xp: Any = np) -> Any:
        """The numbers of a tree, shape (size,)."""
        leaves = [leaf for leaf, kind in zip(jax.tree.leaves(tree), self._kinds, strict=True) if kind]
        return xp.concatenate([xp.ravel(xp.asarray(leaf, float)) for leaf in leaves] or [xp.zeros(0)])

    def unpacked(self, vector: Any) -> Any:
        """The tree, of an array of shape (size,)."""
        leaves, at = [], 0
        for kind, fixed in zip(self._kinds, self._fixed, strict=True):
            if kind is None:
                leaves.append(fixed)
                continue
            shape, dtype = kind
            length = math.prod(shape)
            part = vector[at : at + length].reshape(shape)
            leaves.append(part != 0 if dtype.kind == "b" else part.astype(dtype))
            at += length
        return jax.tree.unflatten(self._structure, leaves)


class Answer(NamedTuple):
    """What a step of a controller gives: its next state, and ``[command1, command2, *telemetry]``."""

    state: Array
    values: NDArray[np.float64]


class ControlProgram:
    """The very controller of a simulation, one step a call.

    Parameters
    ----------
    controller
        Its numbers go along as arguments: another controller of the same structure would compile to the same.

    Attributes
    ----------
    telemetry
        The names of what it reports of itself, in the order of the answers' values after the two commands.
    """

    def __init__(self, controller: Controller) -> None:
        controller = numeric(controller)
        zero: Any = jax.ShapeDtypeStruct((), float)
        state = jax.eval_shape(controller.init, Measurement(zero, (zero, zero)))
        numbers, states = Packing(controller), Packing(state)
        self.telemetry = tuple(jax.eval_shape(controller.telemetry, state))

        def init(packed: Array, measured: Array) -> Array:
            angle, pressure1, pressure2 = measured
            return states.packed(numbers.unpacked(packed).init(Measurement(angle, (pressure1, pressure2))), jnp)

        def step(packed: Array, memory: Array, told: Array) -> tuple[Array, Array]:
            control: Controller = numbers.unpacked(packed)
            angle, stiffness, measured, pressure1, pressure2, period = told
            wish, measurement = Setpoint(angle, stiffness), Measurement(measured, (pressure1, pressure2))
            after, commands = control.step(states.unpacked(memory), wish, measurement, period)
            reported = control.telemetry(after)
            values = jnp.stack([jnp.asarray(x, float) for x in (*commands, *(reported[n] for n in self.telemetry))])
            return states.packed(after, jnp), values

        self._numbers = jnp.asarray(numbers.packed(controller))
        self._init = _made(init, numbers.size, 3)
        self._step = _made(step, numbers.size, states.size, 6)

    def init(self, angle: float, pressure1: float, pressure2: float) -> Array:
        """The state before the first step, as it takes over from an angle [rad] and pressures [Pa]."""
        return self._init(self._numbers, np.array([angle, pressure1, pressure2]))

    def step(self, state: Array, told: NDArray[np.float64]) -> Answer:
        """One step.

        Parameters
        ----------
        state
            From `init` or the last step.
        told
            Wished angle [rad] and stiffness [N*m/rad], measured angle [rad] and pressures [Pa], and the time [s] since
            the last step; shape (6,).
        """
        after, values = self._step(self._numbers, state, told)
        return Answer(after, np.asarray(values))


class PlantProgram:
    """The plant of a simulation, over one stretch of time a call, under commands that are held.

    Parameters
    ----------
    plant
        What is simulated.
    substeps
        Runge-Kutta steps a call.
    """

    def __init__(self, plant: JointPlant, substeps: int) -> None:
        plant = numeric(plant)
        still = jax.eval_shape(lambda: plant.init_state(0.0, (0.0, 0.0)))
        numbers, self._states = Packing(plant), Packing(still)
        states = self._states

        def over(packed: Array, state: Array, told: Array) -> Array:
            joint: JointPlant = numbers.unpacked(packed)
            return states.packed(joint.advance(states.unpacked(state), (told[0], told[1]), told[2], substeps), jnp)

        self._numbers = jnp.asarray(numbers.packed(plant))
        self._over = _made(over, numbers.size, states.size, 3)

    def state(self, state: PlantState) -> NDArray[np.float64]:
        """A state, packed: angle [rad], velocity [rad/s], both pressures [Pa], and what the muscles remember."""
        return self._states.packed(state)

    def over(self, state: Any, command1: float, command2: float, time: float) -> NDArray[np.float64]:
        """The packed state after a time [s] under commands [Pa]."""
        return np.asarray(self._over(self._numbers, state, np.array([command1, command2, time])))


def compute_in_this_thread() -> None:
    """Have JAX compute on the CPU in the thread that asks, from now on; it has to come before anything is computed.

    Else each call of a program is handed to another thread, which costs more than a small program itself, and comes
    back when the system lets that thread run.
    """
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def _made(function: Callable[..., Any], *sizes: int) -> Callable[..., Any]:
    """Compiled beforehand, for arrays of these sizes, and for the CPU: no transfer is worth so little work.

    The function becomes the body of a loop that is gone through once: XLA compiles a small loop as one piece, and all
    else as dozens that it calls one after the other, which takes ten times longer than the work. How often it is gone
    through is told at the call, and the arguments change with it, so that nothing is taken out of the loop.
    """
    shapes = [jax.ShapeDtypeStruct((size,), float) for size in sizes]

    def looped(times: Array, *args: Array) -> Any:
        def body(carried: Any) -> Any:
            i, given, _ = carried
            return i + 1, [jnp.where(i > 0, -one, one) for one in given], function(*given)

        zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(function, *args))
        return lax.while_loop(lambda carried: carried[0] < times, body, (0, list(args), zeros))[2]

    with jax.default_device(jax.devices("cpu")[0]):
        program = jax.jit(looped).lower(jax.ShapeDtypeStruct((), int), *shapes).compile()
    return functools.partial(program, np.asarray(1))
