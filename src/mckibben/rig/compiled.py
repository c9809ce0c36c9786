"""Controller and plant as compiled functions of flat arrays."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.native import compile_native, warn_of_fallback
from mckibben.control.base import Controller, Measurement, Setpoint
from mckibben.control.robot_control import RobotController
from mckibben.errors import ExportError, SimulationError
from mckibben.mechanism.base import RobotMeasurement
from mckibben.muscle import MuscleState
from mckibben.numerics.compiled import jit, numeric
from mckibben.numerics.program_cache import ARRAYS
from mckibben.plant import JointPlant, Plant, PlantState
from mckibben.rig.channels import Channels
from mckibben.scenario import StudiedScenario


def rated_commands(plant: Plant) -> tuple[tuple[float, float], ...]:
    """Range of the commands [Pa] of each muscle: its rated pressures, and the supply if known."""
    ranges = (plant.valve.for_muscle(i).command_range(one.specimen.domain) for i, one in enumerate(plant.muscles))  # type: ignore[attr-defined]
    return tuple((float(low), float(high)) for low, high in ranges)


def starting_state(scenario: StudiedScenario, plant: Plant) -> PyTree:
    """State of a plant at the start of a scenario."""
    return complete_state(plant, scenario.initial(plant))


def vented_state(plant: Plant, start: PyTree = None) -> PyTree:
    """State without pressure at the equilibrium of the vented plant; the base of a robot is where it starts.

    Raises `SimulationError` if there is none, or the base of a robot can fall.
    """
    if isinstance(plant, JointPlant):
        return complete_state(plant, plant.init_state(vented_angle(plant), (0.0, 0.0)))
    robot = plant.robot  # type: ignore[attr-defined]
    if robot.motions:
        remedy = "give it `base: fixed`, as a stand holds it"
        raise SimulationError("a robot on a rig is vented, and its base would fall", field="robot.base", remedy=remedy)
    start = _relaxed(plant, plant.unpressurised() if start is None else start)
    return _at_angles(plant, start, _equilibrium(plant, start))[0]


def angles_of(plant: Plant, state: PyTree) -> tuple[float, ...]:
    """Angles [rad] of the joints in a state."""
    return tuple(map(float, plant.mechanism.by_joint(state.position)))


def _relaxed(plant: Plant, state: PyTree) -> PyTree:
    """A state without pressures, velocities and internal states."""
    zero = np.zeros(())
    velocity, count = jax.tree.map(lambda _: zero, state.velocity), len(plant.muscles)
    return PlantState(state.position, velocity, (zero,) * count, (MuscleState((), ()),) * count)


@jit
def _at_angles(plant: Plant, relaxed: PyTree, angles: tuple[ArrayLike, ...]) -> tuple[PyTree, tuple[Array, ...]]:
    """A state at other angles [rad], and the accelerations [rad/s^2] of the joints in it."""
    position = plant.mechanism.like_joints(tuple(map(jnp.asarray, angles)), relaxed.position)
    state = plant.complete_state(relaxed._replace(position=position))
    return state, plant.mechanism.by_joint(plant.rate(state).velocity)


_OVERDAMPED = 1e3  # s for which the joints creep toward their equilibrium, at a rate of 1/s per rad/s^2
_STILL = 1e-6  # rad/s^2


def _equilibrium(plant: Plant, relaxed: PyTree) -> tuple[float, ...]:
    """Angles [rad] of the stable equilibrium to which a plant without inertia creeps from its start."""
    from scipy.integrate import solve_ivp  # 0.1 s

    def rates(_: float, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(_at_angles(plant, relaxed, tuple(angles))[1])

    begun = np.array(angles_of(plant, relaxed))
    found = solve_ivp(rates, (0.0, _OVERDAMPED), begun, method="BDF", rtol=1e-8, atol=1e-10)
    if not (found.success and np.abs(rates(0.0, found.y[:, -1])).max() < _STILL):
        remedy = "give its joints stops, or loads with a stable equilibrium"
        raise SimulationError("the vented robot has no stable equilibrium", remedy=remedy)
    return tuple(found.y[:, -1].tolist())


def probing_torques(plant: Plant, vented: PyTree, pressure: float) -> NDArray[np.float64]:
    """Torque [N*m] of each muscle alone at a pressure [Pa] on each vented joint, shape (muscles, joints)."""
    return np.array([_torques(plant, vented, pressure, number) for number in range(len(plant.muscles))])


@jit
def _torques(plant: Plant, vented: PyTree, pressure: ArrayLike, number: ArrayLike) -> tuple[Array, ...]:
    """Torques [N*m] by joint of a plant with a pressure [Pa] in one muscle, less those without."""
    pressures = tuple(jnp.where(number == i, pressure, 0.0) for i in range(len(plant.muscles)))
    filled = plant.forces(vented._replace(pressures=pressures)).torques
    return tuple(a - b for a, b in zip(filled, plant.forces(vented).torques, strict=True))


def vented_angle(plant: JointPlant) -> float:
    """Equilibrium angle [rad] of the vented joint without friction and creep, nearest to 0 within +-90 deg."""
    from scipy.optimize import brentq  # 0.1 s

    angles = np.linspace(-np.pi / 2, np.pi / 2, 721)
    torque = np.asarray(_resting_torque(plant, angles))
    stable = np.flatnonzero((torque[:-1] >= 0) & (torque[1:] <= 0))
    if not stable.size:
        raise SimulationError(
            "the vented joint has no stable equilibrium within +-90 deg",
            remedy="give it a load with a stable equilibrium",
        )
    at = stable[np.argmin(np.abs(angles[stable]))]
    zero: PyTree = brentq(lambda angle: float(_resting_torque(plant, angle)), angles[at], angles[at + 1], xtol=1e-12)
    return float(zero)


@jit
def _resting_torque(plant: JointPlant, angles: ArrayLike) -> Array:
    return plant.joint.torque(angles, (0.0, 0.0)) + plant.load.gravity_torque(angles)


@jit
def complete_state(plant: Plant, state: PyTree) -> PyTree:
    """`Plant.complete_state` as one program."""
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

    structure: PyTree
    fixed: tuple[PyTree, ...]
    kinds: tuple[tuple[tuple[int, ...], np.dtype] | None, ...]  # shape and dtype of the numeric leaves

    @classmethod
    def like(cls, tree: PyTree) -> FlatTree:
        """Layout of the trees with the structure of this one."""
        leaves, structure = jax.tree.flatten(tree)
        fixed = tuple(None if isinstance(leaf, _ARRAYS) else leaf for leaf in leaves)
        kinds = tuple((leaf.shape, leaf.dtype) if isinstance(leaf, _ARRAYS) else None for leaf in leaves)
        return cls(structure, fixed, kinds)

    @property
    def size(self) -> int:
        """Length of the array."""
        return sum(math.prod(kind[0]) for kind in self.kinds if kind)

    def pack(self, tree: PyTree, xp: PyTree = np) -> PyTree:
        """Numbers of a tree, shape (size,)."""
        leaves = [leaf for leaf, kind in zip(jax.tree.leaves(tree), self.kinds, strict=True) if kind]
        return xp.concatenate([xp.ravel(xp.asarray(leaf, float)) for leaf in leaves] or [xp.zeros(0)])

    def unpack(self, vector: PyTree) -> PyTree:
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
        ``[*commands, *telemetry]``, the commands in Pa.
    """

    state: NDArray[np.float64] | Array
    values: NDArray[np.float64]


class ControlProgram:
    """Compiled controller, the same as in a simulation, one step per call.

    Parameters
    ----------
    controller
        The controller; its parameters are arguments of the program, so that controllers of one layout share it.
    channels
        Names of joints and muscles.

    Attributes
    ----------
    telemetry
        Names of its telemetry, in the order of `StepResult.values` after the commands.
    """

    def __init__(self, controller: Controller | RobotController, channels: Channels = Channels()) -> None:  # noqa: B008
        controller = numeric(controller)
        joints, muscles = len(channels.joints), len(channels.muscles)
        zero = jax.ShapeDtypeStruct((), float)
        measurement = _measurement(channels.is_named, (zero,) * joints, (zero,) * muscles)
        state = jax.eval_shape(controller.init, measurement)
        numbers, self._states = FlatTree.like(controller), FlatTree.like(state)
        self.layouts = numbers, self._states, channels
        self.telemetry = tuple(_telemetry(jax.eval_shape(controller.telemetry, state), channels))
        self._controller, self.numbers, self._channels = controller, numbers.pack(controller), channels
        size = 3 * joints + muscles + 1
        self._step = flat_program(step_flat, numbers.size, self._states.size, size, static=self.layouts)
        self.init(*[0.0] * (joints + muscles))  # compiles it, too

    def init(self, *reading: float) -> NDArray[np.float64]:
        """Return the packed initial state, shape (size,), at angles [rad] and pressures [Pa]."""
        joints = len(self._channels.joints)
        measurement = _measurement(self._channels.is_named, reading[:joints], reading[joints:])
        return self._states.pack(_begin(self._controller, measurement))

    def step(self, state: ArrayLike, inputs: NDArray[np.float64]) -> StepResult:
        """Return the next state and the commands.

        Parameters
        ----------
        state
            Packed state, shape (size,).
        inputs
            Reference angles [rad] and stiffnesses [N*m/rad], measured angles [rad] and pressures [Pa], time since the
            last step [s]; shape (3 * joints + muscles + 1,).
        """
        after, values = self._step(self.numbers, state, inputs)
        return StepResult(after, np.asarray(values))


def _measurement(is_named: bool, angles: Sequence[PyTree], pressures: Sequence[PyTree]) -> PyTree:
    """Measurement of a joint or a robot, of which the force of the ground is not measured."""
    if is_named:
        return RobotMeasurement(tuple(angles), tuple(pressures), jnp.zeros(()))
    return Measurement(angles[0], tuple(pressures))  # type: ignore[arg-type]


def _telemetry(reported: Mapping[str, PyTree], channels: Channels) -> dict[str, PyTree]:
    """Telemetry of a controller by column."""
    columns: dict[str, PyTree] = {}
    for name in sorted(reported):
        values = reported[name]
        if isinstance(values, tuple):
            names = channels.by_joint(name) if len(values) == len(channels.joints) else channels.by_muscle(name)
            columns |= dict(zip(names, values, strict=True))
        else:
            columns[name] = values
    return columns


class PlantProgram:
    """Compiled plant, one integration under constant commands per call.

    Parameters
    ----------
    plant
        The plant.
    substeps
        Runge-Kutta steps of an integration.
    start
        A state, of whose form are all. Default: that of a joint.
    """

    def __init__(self, plant: Plant, substeps: int, start: PyTree = None) -> None:
        plant = numeric(plant)
        numbers = FlatTree.like(plant)
        start = jax.eval_shape(lambda: plant.init_state(0.0, (0.0, 0.0))) if start is None else numeric(start)  # type: ignore[attr-defined]
        self._states = FlatTree.like(start)
        self.numbers = numbers.pack(plant)
        self.layouts = numbers, self._states, substeps
        self._advance = flat_program(
            advance_flat, numbers.size, self._states.size, len(plant.muscles) + 1, static=self.layouts
        )
        places = plant.true_measurement(self._states.unpack(np.arange(self._states.size, dtype=float)))
        self.places = np.array(jax.tree.leaves(tuple(places)[:2]), int)
        """Places of the angles and pressures in a packed state."""

    def state(self, state: PyTree) -> NDArray[np.float64]:
        """Packed state: angles [rad], velocities [rad/s], pressures [Pa], internal states of the muscles."""
        return self._states.pack(state)

    def advance(self, state: NDArray[np.float64], commands: Sequence[float], time: float) -> NDArray[np.float64]:
        """Packed state after a time [s] under commands [Pa]."""
        return np.asarray(self._advance(self.numbers, state, np.array([*commands, time])))


@jit
def _begin(controller: Controller | RobotController, measurement: PyTree) -> PyTree:
    return controller.init(measurement)


def step_flat(
    numbers: FlatTree, states: FlatTree, channels: Channels, packed: Array, memory: Array, inputs: Array
) -> tuple[Array, Array]:
    """`ControlProgram.step` of all controllers of a layout."""
    control, joints = numbers.unpack(packed), len(channels.joints)
    *values, period = inputs
    setpoints = tuple(map(Setpoint, values[:joints], values[joints : 2 * joints]))
    measurement = _measurement(channels.is_named, values[2 * joints : 3 * joints], values[3 * joints :])
    setpoint: PyTree = setpoints if channels.is_named else setpoints[0]
    after, commands = control.step(states.unpack(memory), setpoint, measurement, period)
    reported = _telemetry(control.telemetry(after), channels)
    values = jnp.stack([jnp.asarray(x, float) for x in (*commands, *reported.values())])
    return states.pack(after, jnp), values


def advance_flat(
    numbers: FlatTree, states: FlatTree, substeps: int, packed: Array, state: Array, inputs: Array
) -> Array:
    """`PlantProgram.advance` of all plants of a layout; inputs: all commands and the time."""
    plant, (*commands, time) = numbers.unpack(packed), inputs
    return states.pack(plant.advance(states.unpack(state), tuple(commands), time, substeps), jnp)


def compile_flat(
    function: Callable[..., PyTree], *sizes: int, static: tuple[PyTree, ...] = ()
) -> Callable[..., PyTree]:
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
