"""Dynamic stiffness of joints: tests in which a machine moves it along a sine and measures its torque."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.actuator import Actuator, FlowValve
from mckibben.component.calls import checked_call
from mckibben.component.checks import check_positive
from mckibben.control.base import DiscreteTimeSystem, Setpoint
from mckibben.errors import RangeError
from mckibben.mechanism.base import Mechanism, over_joints
from mckibben.mechanism.disturbance import Disturbance
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.plant import Plant, PlantState
from mckibben.simulation.loop import LoopState, control_period, initial_loop
from mckibben.units import Angle, Frequency, ShortTime, bar

_SAMPLES = 100  # a cycle, a multiple of 4: two of them are the reversals
_SHUT = 1e-30  # m^3/(s*Pa)


class DynamicStiffness(NamedTuple):
    """Stiffness [N*m/rad] over frequency and amplitude, shape (frequencies, amplitudes).

    `stiffness` is the change of the torque from one reversal to the other over that of the angle, and `loss` the energy
    dissipated in a cycle over pi times the amplitude squared, negative where a controller drives the motion.
    """

    frequency: NDArray[np.float64]  # of the motion, shape (frequencies,) [Hz]
    amplitude: NDArray[np.float64]  # shape (amplitudes,) [rad]
    stiffness: NDArray[np.float64]
    loss: NDArray[np.float64]

    @property
    def magnitude(self) -> NDArray[np.float64]:
        """Magnitude of stiffness + i loss [N*m/rad]: the amplitude of the torque over that of the angle."""
        return np.hypot(self.stiffness, self.loss)


class _TestStand(Plant):
    """A plant on a machine that moves one joint along a sine of a circular frequency [rad/s], and holds the rest.

    Each joint has a share of 0 or 1 in the motion about the centres [rad].
    """

    plant: Plant
    share: tuple[ArrayLike, ...]
    centre: tuple[ArrayLike, ...]
    circular_frequency: ArrayLike

    @property
    def _valve(self) -> Actuator:
        return self.plant._valve

    @property
    def mechanism(self) -> Mechanism:
        return self.plant.mechanism

    @property
    def disturbances(self) -> tuple[Disturbance, ...]:
        return self.plant.disturbances

    def with_disturbances(self, disturbances: Sequence[Disturbance]) -> _TestStand:
        return dataclasses.replace(self, plant=self.plant.with_disturbances(disturbances))

    def fastest_rates(self, angles: PyTree, stiffness: ArrayLike | None = 0.0) -> dict[str, float]:
        return self.plant.fastest_rates(angles, stiffness)

    def unpressurised(self) -> PlantState:
        return self.plant.unpressurised()

    def sample(self, state: PlantState, period: ArrayLike) -> tuple[PlantState, PyTree]:
        return self.plant.sample(state, period)

    def acceleration(self, state: PlantState, torques: Sequence[Array]) -> PyTree:
        joints = zip(self.share, self.centre, self.mechanism.by_joint(state.position), strict=True)
        return self.moving(
            [share * self.circular_frequency**2 * (centre - angle) for share, centre, angle in joints], state
        )

    def moving(self, values: Sequence[ArrayLike], state: PlantState) -> PyTree:
        """Return rates [rad/s] or accelerations of the joints as those of a state whose base is at rest."""
        return self.mechanism.like_joints(values, jax.tree.map(jnp.zeros_like, state.velocity))

    def torque(self, state: PlantState) -> Array:
        """Return the torque [N*m] of muscles and friction on the joint that moves."""
        torques = self.forces(state._replace(io=())).torques
        return jnp.asarray(sum(share * torque for share, torque in zip(self.share, torques, strict=True)))


class _Holding(DiscreteTimeSystem):
    """Constant commands [Pa], or openings."""

    commands: tuple[ArrayLike, ...]

    def init(self, measurement: PyTree) -> tuple[()]:
        return ()

    def step(self, state: PyTree, setpoint: PyTree, measurement: PyTree, period: ArrayLike) -> tuple[tuple[()], PyTree]:
        return (), self.commands


Plants = TypeVar("Plants", bound=Plant)


def closed_valves(plant: Plants, *, polytropic_index: float | None = None) -> Plants:
    """Return a plant whose valves are closed; n, dead volume and wall stay those of its valves.

    With a given n, the air has no temperature. Raises `RangeError` where these differ between the muscles.
    """
    for muscle in plant.muscles:
        muscle.specimen.check_volume("the stiffness with closed valves")
    shut = FlowValve(_SHUT, 10 * bar)
    valves = [plant.valve_of(i) for i in range(len(plant.muscles))]
    own: Sequence[PyTree] = [valve if valve.holds_air else shut for valve in valves]
    index = [valve.polytropic_index if polytropic_index is None else polytropic_index for valve in own]
    dead = [valve.dead_volume for valve in own]
    wall = [valve.wall_conductance if polytropic_index is None else None for valve in own]
    if any(value != values[0] for values in (index, dead, wall) for value in values):
        raise RangeError(
            "the closed valves of the muscles have different polytropic indices, dead volumes or wall conductances",
            field="valve",
            remedy="give all the same",
        )
    closed = dataclasses.replace(shut, polytropic_index=index[0], dead_volume=dead[0], wall_conductance=wall[0])
    return dataclasses.replace(plant, valve=closed)


@checked_call
def dynamic_stiffness(
    plant: Plant,
    initial: PlantState,
    amplitude: Angle | ArrayLike,
    frequency: Frequency | ArrayLike,
    *,
    joint: int = 0,
    controller: DiscreteTimeSystem | None = None,
    setpoint: Setpoint | Sequence[Setpoint] | None = None,
    control_period: ShortTime = 1e-3,
    substeps: int = 4,
    cycles: int = 4,
) -> DynamicStiffness:
    """Move a joint of a plant along sines and return the stiffness of the last cycle: torque over deflection.

    A machine imposes the motion, and holds the other joints and a base at rest, so that the torque is that of muscles
    and friction, without inertia and gravity. An `IdealValve` holds the pressures, `closed_valves` the air.

    Parameters
    ----------
    plant, initial
        Plant, and its state at the start, in the middle of the motion.
    amplitude, frequency
        Of the motion [rad], [Hz]. A cycle is rounded to a multiple of 100 control periods.
    joint
        Number of the joint that moves.
    controller, setpoint
        Active controller, and its constant setpoint (of a robot one of each joint); without it the commands remain the
        pressures at the start, or openings of 0.
    control_period, substeps, cycles
        Control period [s], integration steps in it, and number of cycles.

    Raises
    ------
    RangeError
        If a number is not positive, or a cycle is shorter than 100 control periods.

    Examples
    --------
    Constant pressures, and closed valves:

    >>> from mckibben import IdealValve, JointPlant, catalog
    >>> from mckibben.units import deg
    >>> plant = JointPlant(catalog.joint("knee-table-2"), catalog.load("knee-table-2"), IdealValve())
    >>> state = plant.init_state(0.0, (3e5, 3e5))
    >>> for one in (plant, closed_valves(plant, polytropic_index=1.4)):
    ...     dynamic_stiffness(one, state, 0.1 * deg, 1.0).stiffness.round(2).tolist()
    [[71.93]]
    [[116.06]]
    """
    if (controller is None) != (setpoint is None):
        raise RangeError("a controller and its setpoint go together", remedy="give both, or neither")
    amplitudes, frequencies = (np.atleast_1d(np.asarray(counts, float)) for counts in (amplitude, frequency))
    check_positive("dynamic_stiffness", plant.mechanism.joint_type.unit("rad"), amplitude=amplitudes)
    check_positive("dynamic_stiffness", "Hz", frequency=frequencies)
    counts = np.round(1 / (frequencies * _SAMPLES * control_period)).astype(int)
    if np.any(counts < 1):
        highest = 1 / (_SAMPLES * control_period)
        raise RangeError(
            f"a frequency of {frequencies.max():g} Hz has fewer than {_SAMPLES} control periods in a cycle",
            field="frequency",
            value=float(frequencies.max()),
            upper=highest,
            unit="Hz",
            remedy=f"give at most {highest:g} Hz, or a shorter control period",
        )
    rates = 2 * np.pi / (counts * _SAMPLES * control_period)
    state = plant.complete_state(initial)
    count = len(plant.muscles)
    held = (0.0,) * count if plant.valve_of(0).direct else tuple(state.pressures)
    control = _Holding(held) if controller is None else controller.with_period(control_period)
    centre = plant.mechanism.by_joint(state.position)
    share = tuple(float(number == joint) for number in range(len(centre)))
    io = {"sensors": plant.sensors, "command_delay": plant.command_delay}
    stand = _TestStand(plant, share, centre, 0.0, **io).with_period(control_period)
    steady = over_joints(lambda own: Setpoint(*map(jnp.asarray, own)), () if setpoint is None else setpoint)
    arguments = numeric((stand, control, steady, state, amplitudes, control_period))
    cycles_of_rates = [
        _last_cycle(*arguments, rate=rate, periods=count, cycles=cycles, substeps=substeps)
        for rate, count in zip(rates, counts, strict=True)
    ]
    stiffness, loss = (np.stack([np.asarray(cycle[i]) for cycle in cycles_of_rates]) for i in (0, 1))
    return DynamicStiffness(rates / (2 * np.pi), amplitudes, stiffness, loss)


@jit_arrays
def _last_cycle(
    stand: _TestStand,
    controller: DiscreteTimeSystem,
    setpoint: PyTree,
    initial: PlantState,
    amplitudes: Array,
    period: Array,
    rate: Array,
    periods: Array,  # in a sample
    cycles: int,
    substeps: int,
) -> tuple[Array, Array]:
    """Stiffness and loss stiffness [N*m/rad] in the last cycle, shape (amplitudes,)."""
    stand = dataclasses.replace(stand, circular_frequency=rate)

    def measure(amplitude: Array) -> tuple[Array, Array]:
        def sample(loop: LoopState, _: None) -> tuple[LoopState, tuple[Array, Array]]:
            def advance(_: Array, loop: LoopState) -> LoopState:
                return control_period(stand, controller, loop, setpoint, period, substeps)[0]

            rates = stand.mechanism.by_joint(loop[0].velocity)
            velocity = sum(share * rate for share, rate in zip(stand.share, rates, strict=True))
            return lax.fori_loop(0, periods, advance, loop), (jnp.asarray(velocity), stand.torque(loop[0]))

        start = initial._replace(velocity=stand.moving([share * amplitude * rate for share in stand.share], initial))
        _, (velocity, torque) = lax.scan(sample, initial_loop(stand, controller, start), None, cycles * _SAMPLES)
        velocity, torque = velocity[-_SAMPLES:], torque[-_SAMPLES:]
        stiffness = (torque[3 * _SAMPLES // 4] - torque[_SAMPLES // 4]) / (2 * amplitude)
        return stiffness, -2 * jnp.mean(torque * velocity) / (rate * amplitude**2)  # times 2 pi / rate / (pi a^2)

    with batched_program():
        return jax.vmap(measure)(amplitudes)
