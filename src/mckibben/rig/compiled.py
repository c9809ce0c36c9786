"""Controller and plant as compiled functions of flat arrays."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.codegen.native import compile_native, warn_of_fallback
from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.errors import ExportError, SimulationError
from mckibben.numerics.compiled import jit, numeric
from mckibben.numerics.program_cache import ARRAYS
from mckibben.plant import JointPlant, PlantState


def vented_angle(plant: JointPlant) -> float:
    """Equilibrium angle [rad] of the vented joint without friction and creep, nearest to 0 within +-90 deg."""
    from scipy.optimize import brentq  # 0.1 s

    angles = np.linspace(-np.pi / 2, np.pi / 2, 721)
    torque = np.asarray(_torque(plant, angles, 0.0, 0.0))
    stable = np.flatnonzero((torque[:-1] >= 0) & (torque[1:] <= 0))
    if not stable.size:
        raise SimulationError(
            "the vented joint has no stable equilibrium within +-90 deg",
            remedy="give it a load with a stable equilibrium",
        )
    at = stable[np.argmin(np.abs(angles[stable]))]
    zero: Any = brentq(lambda angle: float(_torque(plant, angle, 0.0, 0.0)), angles[at], angles[at + 1], xtol=1e-12)
    return float(zero)


def probing_torques(plant: JointPlant, angle: float, pressure: float) -> tuple[float, float]:
    """Torque [N*m] by which a pressure [Pa] in each muscle alone moves the joint that rests at an angle [rad]."""
    return float(_torque(plant, angle, pressure, 0.0)), float(_torque(plant, angle, 0.0, pressure))


@jit
def _torque(plant: JointPlant, angles: ArrayLike, pressure1: ArrayLike, pressure2: ArrayLike) -> Array:
    return plant.joint.torque(angles, (pressure1, pressure2)) + plant.load.gravity_torque(angles)


@jit
def complete_state(plant: JointPlant, state: PlantState) -> PlantState:
    """`JointPlant.complete_state` as one program."""
    return plant.complete_state(state)


_ARRAYS = (*ARRAYS, jax.ShapeDtypeStruct)


@dataclass(frozen=True)
class FlatTree:
    """Layout of the numeric leaves of a pytree in one array of 64-bit floats; other leaves are part of it.

    Attributes
    ----------
    structure, fixed
        Structure of the tree, and its other leaves.
    kinds
        Shape and dtype of each numeric leaf; None for the others.

    Examples
    --------
    >>> flat = FlatTree.like((np.asarray(2.5), np.asarray([1, 2]), "fixed"))
    >>> flat.pack((np.asarray(2.5), np.asarray([1, 2]), "fixed")).tolist()
    [2.5, 1.0, 2.0]
    """

    structure: Any
    fixed: tuple[Any, ...]
    kinds: tuple[tuple[tuple[int, ...], Any] | None, ...]  # shape and dtype of the numeric leaves

    @classmethod
    def like(cls, tree: Any) -> FlatTree:
        """Layout of the trees with the structure of this one."""
        leaves, structure = jax.tree.flatten(tree)
        fixed = tuple(None if isinstance(leaf, _ARRAYS) else leaf for leaf in leaves)
        kinds = tuple((leaf.shape, leaf.dtype) if isinstance(leaf, _ARRAYS) else None for leaf in leaves)
        return cls(structure, fixed, kinds)

    @property
    def size(self) -> int:
        """Length of the array."""
        return sum(math.prod(kind[0]) for kind in self.kinds if kind)

    def pack(self, tree: Any, xp: Any = np) -> Any:
        """Numbers of a tree, shape (size,)."""
        leaves = [leaf for leaf, kind in zip(jax.tree.leaves(tree), self.kinds, strict=True) if kind]
        return xp.concatenate([xp.ravel(xp.asarray(leaf, float)) for leaf in leaves] or [xp.zeros(0)])

    def unpack(self, vector: Any) -> Any:
        """Tree of an array of shape (size,)."""
        leaves, at = [], 0
        for kind, fixed in zip(self.kinds, self.fixed, strict=True):
            if kind is None:
                leaves.append(fixed)
                continue
            shape, dtype = kind
            length = math.prod(shape)
            part = vector[at : at + length].reshape(shape)
            leaves.append(part != 0 if dtype.kind == "b" else part.astype(dtype))
            at += length
        return jax.tree.unflatten(self.structure, leaves)


class StepResult(NamedTuple):
    """Result of a step of a controller.

    Attributes
    ----------
    state
        Packed next state, shape (size,).
    values
        ``[command1, command2, *telemetry]``, the commands in Pa.
    """

    state: NDArray[np.float64] | Array
    values: NDArray[np.float64]


class ControlProgram:
    """Compiled controller, the same as in a simulation, one step per call.

    Parameters
    ----------
    controller
        The controller; its parameters are arguments of the program, so that controllers of one layout share it.

    Attributes
    ----------
    telemetry
        Names of its telemetry, in the order of `StepResult.values` after the two commands.
    """

    def __init__(self, controller: Controller) -> None:
        controller = numeric(controller)
        zero: Any = jax.ShapeDtypeStruct((), float)
        state = jax.eval_shape(controller.init, Measurement(zero, (zero, zero)))
        numbers, self._states = FlatTree.like(controller), FlatTree.like(state)
        self.layouts = numbers, self._states
        self.telemetry = tuple(sorted(jax.eval_shape(controller.telemetry, state)))
        self._controller, self.numbers = controller, numbers.pack(controller)
        self._step = flat_program(step_flat, numbers.size, self._states.size, 6, static=self.layouts)
        self.init(0.0, 0.0, 0.0)  # compiles it, too

    def init(self, angle: float, pressure1: float, pressure2: float) -> NDArray[np.float64]:
        """Return the packed initial state, shape (size,), at an angle [rad] and pressures [Pa]."""
        return self._states.pack(_begin(self._controller, angle, (pressure1, pressure2)))

    def step(self, state: ArrayLike, inputs: NDArray[np.float64]) -> StepResult:
        """Return the next state and the commands.

        Parameters
        ----------
        state
            Packed state, shape (size,).
        inputs
            Reference angle [rad] and stiffness [N*m/rad], measured angle [rad] and pressures [Pa], time since the last
            step [s]; shape (6,).
        """
        after, values = self._step(self.numbers, state, inputs)
        return StepResult(after, np.asarray(values))


class PlantProgram:
    """Compiled plant, one integration under constant commands per call.

    Parameters
    ----------
    plant
        The plant.
    substeps
        Runge-Kutta steps of an integration.
    """

    def __init__(self, plant: JointPlant, substeps: int) -> None:
        plant = numeric(plant)
        numbers = FlatTree.like(plant)
        self._states = FlatTree.like(jax.eval_shape(lambda: plant.init_state(0.0, (0.0, 0.0))))
        self.numbers = numbers.pack(plant)
        self.layouts = numbers, self._states, substeps
        self._advance = flat_program(advance_flat, numbers.size, self._states.size, 3, static=self.layouts)

    def state(self, state: PlantState) -> NDArray[np.float64]:
        """Packed state: angle [rad], velocity [rad/s], both pressures [Pa], internal states of the muscles."""
        return self._states.pack(state)

    def advance(self, state: Any, command1: float, command2: float, time: float) -> NDArray[np.float64]:
        """Packed state after a time [s] under commands [Pa]."""
        return np.asarray(self._advance(self.numbers, state, np.array([command1, command2, time])))


@jit
def _begin(controller: Controller, angle: Any, pressures: tuple[Any, Any]) -> Any:
    return controller.init(Measurement(angle, pressures))


def step_flat(numbers: FlatTree, states: FlatTree, packed: Array, memory: Array, inputs: Array) -> tuple[Array, Array]:
    """`ControlProgram.step` of all controllers of a layout."""
    control: Controller = numbers.unpack(packed)
    angle, stiffness, measured, pressure1, pressure2, period = inputs
    setpoint, measurement = Setpoint(angle, stiffness), Measurement(measured, (pressure1, pressure2))
    after, commands = control.step(states.unpack(memory), setpoint, measurement, period)
    reported = control.telemetry(after)
    values = jnp.stack([jnp.asarray(x, float) for x in (*commands, *(reported[n] for n in sorted(reported)))])
    return states.pack(after, jnp), values


def advance_flat(
    numbers: FlatTree, states: FlatTree, substeps: int, packed: Array, state: Array, inputs: Array
) -> Array:
    """`PlantProgram.advance` of all plants of a layout; inputs: both commands and the time."""
    plant: JointPlant = numbers.unpack(packed)
    return states.pack(plant.advance(states.unpack(state), (inputs[0], inputs[1]), inputs[2], substeps), jnp)


def compile_flat(function: Callable[..., Any], *sizes: int, static: tuple[Any, ...] = ()) -> Callable[..., Any]:
    """Compile a function of static arguments and arrays by the C compiler or, if that is not possible, by XLA."""
    try:
        return compile_native(function, *sizes, static=static)
    except ExportError as error:
        warn_of_fallback(error)
        shapes = [jax.ShapeDtypeStruct((size,), float) for size in sizes]
        with jax.default_device(jax.devices("cpu")[0]):
            return jax.jit(functools.partial(function, *static)).lower(*shapes).compile()


flat_program = functools.lru_cache(16)(compile_flat)
"""`compile_flat`, once per function, sizes and static arguments."""
