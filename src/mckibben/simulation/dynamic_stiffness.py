"""Dynamic stiffness of a joint: tests in which a machine moves it along a sine and measures its torque."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.actuator import FlowValve
from mckibben.component.checks import check_positive
from mckibben.control.base import Controller, Setpoint
from mckibben.control.open_loop import OpenLoopControl
from mckibben.errors import RangeError
from mckibben.joint import Load
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.loop import LoopState, control_period, initial_loop
from mckibben.units import bar

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


class _ImposedMotion(Load):
    """A machine that moves the joint along a sine about a centre [rad] at a rate [rad/s], whatever the torque."""

    centre: Any
    rate: Any

    damping = 0.0
    hanging_angle = 0.0
    total_inertia = 1.0  # type: ignore
    gravity_moment = 0.0  # type: ignore

    def acceleration(self, angle: ArrayLike, velocity: ArrayLike, torque: ArrayLike) -> Array:
        return self.rate**2 * (self.centre - jnp.asarray(angle))


def closed_valves(plant: JointPlant, *, polytropic_index: float | None = None) -> JointPlant:
    """Return a plant whose valves are closed; n, dead volume and wall stay those of its valves.

    With a given n, the air has no temperature. Raises `RangeError` where these differ between the muscles.
    """
    for muscle in (plant.joint.muscle1, plant.joint.muscle2):
        muscle.specimen.check_volume("the stiffness with closed valves")
    shut = FlowValve(_SHUT, 10 * bar)
    known: Any = [plant.valve.for_muscle(i) if plant.valve.holds_air else shut for i in (0, 1)]
    index = [first.polytropic_index if polytropic_index is None else polytropic_index for first in known]
    dead = [first.dead_volume for first in known]
    wall = [first.wall_conductance if polytropic_index is None else None for first in known]
    pairs: Any = (index, dead, wall)
    if not all(np.array_equal(first, other) for first, other in pairs):
        raise RangeError(
            "the closed valves of the muscles have different polytropic indices, dead volumes or wall conductances",
            field="valve",
            remedy="give both the same",
        )
    closed = dataclasses.replace(shut, polytropic_index=index[0], dead_volume=dead[0], wall_conductance=wall[0])
    return dataclasses.replace(plant, valve=closed)


def dynamic_stiffness(
    plant: JointPlant,
    initial: PlantState,
    amplitude: ArrayLike,
    frequency: ArrayLike,
    *,
    controller: Controller | None = None,
    setpoint: Setpoint | None = None,
    control_period: float = 1e-3,
    substeps: int = 4,
    cycles: int = 4,
) -> DynamicStiffness:
    """Move the joint of a plant along sines and return the stiffness of the last cycle: torque over deflection.

    The load is replaced by a machine that imposes the motion, so that the torque is the muscles' alone, without
    inertia and gravity. An `IdealValve` holds the pressures, `closed_valves` the air.

    Parameters
    ----------
    plant, initial
        Plant, and its state at the start, in the middle of the motion.
    amplitude, frequency
        Of the motion [rad], [Hz]. A cycle is rounded to a multiple of 100 control periods.
    controller, setpoint
        Active controller, and its constant setpoint; without it the commands remain the pressures at the start,
        or openings of 0.
    control_period, substeps, cycles
        Control period [s], integration steps in it, and number of cycles.

    Raises
    ------
    RangeError
        If a number is not positive, or a cycle is shorter than 100 control periods.

    Examples
    --------
    Constant pressures, and closed valves:

    >>> from mckibben import IdealValve, catalog
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
    check_positive("dynamic_stiffness", "rad", amplitude=amplitudes)
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
    held = (0.0, 0.0) if plant.valve.direct else initial.pressures  # openings, or pressures
    control = controller or OpenLoopControl(*held, model=plant.joint)
    plant, control = plant.with_period(control_period), control.with_period(control_period)
    wanted = Setpoint(jnp.asarray(0.0), jnp.asarray(0.0)) if setpoint is None else setpoint
    parts = numeric((plant, control, wanted, plant.complete_state(initial), amplitudes, control_period))
    cycles_of_rates = [
        _last_cycle(*parts, rate=rate, periods=count, cycles=cycles, substeps=substeps)
        for rate, count in zip(rates, counts, strict=True)
    ]
    stiffness, loss = (np.stack([np.asarray(cycle[i]) for cycle in cycles_of_rates]) for i in (0, 1))
    return DynamicStiffness(rates / (2 * np.pi), amplitudes, stiffness, loss)


@jit_arrays
def _last_cycle(
    plant: JointPlant,
    controller: Controller,
    setpoint: Setpoint,
    initial: PlantState,
    amplitudes: Array,
    period: Array,
    rate: Array,
    periods: Array,  # in a sample
    cycles: int,
    substeps: int,
) -> tuple[Array, Array]:
    """Stiffness and loss stiffness [N*m/rad] in the last cycle, shape (amplitudes,)."""
    moved = dataclasses.replace(plant, load=_ImposedMotion(initial.angle, rate))

    def measure(amplitude: Array) -> tuple[Array, Array]:
        def sample(loop: LoopState, _: None) -> tuple[LoopState, tuple[Array, Array]]:
            def advance(_: Array, loop: LoopState) -> LoopState:
                return control_period(moved, controller, loop, setpoint, period, substeps)[0]

            angle, velocity, pressures, muscles = loop[0][:4]
            torque = plant.joint.forces(angle, velocity, pressures, muscles).torque
            if plant.friction is not None:
                torque = torque - plant.friction.resisting_torque(loop[0].friction, angle)
            return lax.fori_loop(0, periods, advance, loop), (velocity, torque)

        start = initial._replace(velocity=amplitude * rate)
        _, (velocity, torque) = lax.scan(sample, initial_loop(moved, controller, start), None, cycles * _SAMPLES)
        velocity, torque = velocity[-_SAMPLES:], torque[-_SAMPLES:]
        stiffness = (torque[3 * _SAMPLES // 4] - torque[_SAMPLES // 4]) / (2 * amplitude)
        return stiffness, -2 * jnp.mean(torque * velocity) / (rate * amplitude**2)  # times 2 pi / rate / (pi a^2)

    with batched_program():
        return jax.vmap(measure)(amplitudes)
