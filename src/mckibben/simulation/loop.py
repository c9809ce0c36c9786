"""The sampled-data loop: the controller's step, then the plant under constant commands.

`episode` keeps a record of every control period; `streaming_episode` reduces each at once to metrics.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.codegen.native import over_periods
from mckibben.control.base import DiscreteTimeSystem
from mckibben.mechanism.base import joints_in, over_joints
from mckibben.numerics.compiled import jit_arrays
from mckibben.plant import Plant, PlantState
from mckibben.simulation.metrics import (
    Accumulation,
    Change,
    Metrics,
    angle_at_end,
    form_of_period,
    last_change,
    values_of,
)
from mckibben.simulation.trajectories import Record, Trajectory, column_of, trajectory

LoopState = tuple[PyTree, PyTree]
"""States of plant and controller at the start of a control period."""


def of_any_length(controller: DiscreteTimeSystem, setpoints: PyTree, every: int = 1) -> PyTree:
    """Setpoints of a run, of any number in one native program; not if it previews them, or keeps every n-th period."""
    return setpoints if every > 1 or controller.samples_ahead else over_periods(setpoints)


def initial_loop(plant: Plant, controller: DiscreteTimeSystem, start: PyTree) -> LoopState:
    """The plant at its start, and the controller initialised from the first measurement."""
    state = plant.begin(start)
    return state, controller.init(plant.sample(state, 0.0)[1])


def begun(
    plant: Plant, controller: DiscreteTimeSystem, setpoints: PyTree, start: PyTree, period: ArrayLike, step: Any = None
) -> tuple[LoopState, PyTree]:
    """`initial_loop` before the first of setpoints, and the setpoints that the controller gets in each period.

    With the length of the integration steps [s] the plant's state is one from which they take fewest evaluations.
    """
    state, held = initial_loop(plant, controller, start)
    state = state if step is None else plant.with_last_step(state, step)
    return (state, controller.foreseeing(held, setpoints, period)), controller.ahead(setpoints, period)


def control_period(
    plant: Plant, controller: DiscreteTimeSystem, state: LoopState, setpoint: PyTree, period: ArrayLike, substeps: int
) -> tuple[LoopState, Record]:
    """One control period: the controller's step, then the plant under the constant commands."""
    plant_state, controller_state = state
    plant_state, measurement = plant.sample(plant_state, period)
    controller_state, wanted = controller.step(controller_state, setpoint, measurement, period)
    commands = plant.clip_commands(wanted)
    limited = functools.reduce(operator.or_, map(operator.ne, commands, wanted))
    telemetry = controller.telemetry(controller_state) | plant.telemetry(plant_state, commands, period)
    record = Record(plant.observe(plant_state), commands, limited, telemetry)
    return (plant.follow(plant_state, commands, period, substeps), controller_state), record


def episode(
    plant: Plant, controller: DiscreteTimeSystem, setpoints: PyTree, initial: PyTree, period: ArrayLike, substeps: int
) -> tuple[PyTree, Record]:
    """Run a controller on a plant; a pure function, to be compiled, vmapped and differentiated.

    Setpoints at the start of each control period [s] are arrays of shape (periods,): those of the joint, a tuple of
    those of the joints, or the times. Returns the plant's state after the last period, and the record of shape
    (periods,).
    """

    def next_period(state: LoopState, setpoint: PyTree) -> tuple[LoopState, Record]:
        return control_period(plant, controller, state, setpoint, period, substeps)

    (final, _), record = lax.scan(next_period, *begun(plant, controller, setpoints, initial, period, period / substeps))
    return final, record


compiled_episode = jit_arrays(episode)
"""`episode`, compiled once for each structure of its arguments; give it `numeric` ones."""


def positions_over_time(
    plant: Plant,
    controller: DiscreteTimeSystem,
    setpoints: PyTree,
    initial: PyTree,
    period: ArrayLike,
    substeps: int,
    every: int,
) -> tuple[Array, ...]:
    """Return the positions at the start of every n-th control period of an episode.

    They are those of the plant's mechanism (angles [rad], then the position of a base [m]), each of shape
    (periods / n,); n has to divide the number of periods.
    """

    def next_period(state: LoopState, setpoint: PyTree) -> tuple[LoopState, tuple[Array, ...]]:
        following, _ = control_period(plant, controller, state, setpoint, period, substeps)
        return following, plant.mechanism.coordinates_of(state[0].position)

    return _scan_every(next_period, *begun(plant, controller, setpoints, initial, period, period / substeps), every)[1]


def _scan_every(step: Callable[..., PyTree], start: PyTree, values: PyTree, every: int) -> tuple[PyTree, PyTree]:
    """`lax.scan` that keeps the result of every n-th step; n has to divide their number."""
    if every == 1:
        return lax.scan(step, start, values)

    def block(state: PyTree, values: PyTree) -> tuple[PyTree, PyTree]:
        state, results = lax.scan(step, state, values)
        return state, jax.tree.map(lambda x: x[0], results)

    return lax.scan(block, start, jax.tree.map(lambda x: x.reshape(-1, every, *x.shape[1:]), values))


class Streamed(NamedTuple):
    """Metrics of a whole episode, the RMS angle errors at its end, and the kept columns."""

    metrics: PyTree
    angle_at_end: PyTree
    kept: dict[str, PyTree]


class _Carry(NamedTuple):
    loop: LoopState
    without_change: LoopState
    so_far: Accumulation


def streaming_episode(
    plant: Plant,
    controller: DiscreteTimeSystem,
    setpoints: PyTree,
    initial: PlantState,
    period: ArrayLike,
    substeps: int,
    *,
    change: PyTree = None,  # of the desired stiffness; in 32 bits setpoints may round to one number
    coupling: bool = False,  # whether the run without that change is computed alongside
    keep: tuple[str, ...] = (),  # columns of a trajectory
    every: int = 1,
) -> Streamed:
    """Run an `episode` and accumulate its metrics: memory does not grow with the duration, except for what is kept.

    Parameters
    ----------
    plant, controller, initial
        Plant, controller, and state at the start.
    setpoints
        Angle [rad] and stiffness [N*m/rad] of each joint at each control period, shape (periods,).
    period, substeps
        Control period [s], and integration steps in it.
    change
        Last change of the desired stiffness of each joint, for the settling time and the coupling.
    coupling
        Whether the same run without these changes is computed as well, from them on; else there is no coupling.
    keep, every
        Columns of a `Trajectory` to keep over time, at every n-th control period; n has to divide their number.
    """
    count = jax.tree.leaves(setpoints)[0].shape[0]
    periods = jnp.asarray(count)
    change = over_joints(lambda own: last_change(own.stiffness), setpoints) if change is None else change
    amplitude, early = getattr(controller, "stiffness_amplitude", None), controller.samples_ahead
    scale = plant.mechanism.joint_type.scale

    @functools.partial(jax.jit, inline=True)  # traced once for both runs
    def step(state: LoopState, setpoint: PyTree) -> tuple[LoopState, Record]:
        return control_period(plant, controller, state, setpoint, period, substeps)

    def step_without_change(carry: _Carry, following: LoopState, setpoint: PyTree, index: Array) -> LoopState:
        """The next state of the run without the last changes; until the first of these, the two runs are identical."""
        if not coupling:
            return following

        def begun(change: Change) -> Array:
            return change.ends & (index >= change.at - early)

        unchanged = over_joints(
            lambda own, change: own._replace(stiffness=jnp.where(begun(change), change.before, own.stiffness)),
            setpoint,
            change,
        )
        changed = functools.reduce(operator.or_, map(begun, joints_in(change)))
        return lax.cond(changed, lambda: step(carry.without_change, unchanged)[0], lambda: following)

    def moved(state: LoopState, without: LoopState, setpoint: PyTree, seen: PyTree) -> tuple[LoopState, Trajectory]:
        following, record = step(state, seen)
        return following, trajectory(plant, setpoint, record, without[0].angle, amplitude)

    def next_period(carry: _Carry, at: tuple[Array, PyTree, PyTree]) -> tuple[_Carry, dict[str, PyTree]]:
        index, setpoint, seen = at
        following, now = moved(carry.loop, carry.without_change, setpoint, seen)
        so_far = carry.so_far.after(now, index, periods, change, plant.sensors.angle_resolution, scale)
        without = step_without_change(carry, following, seen, index)
        return _Carry(following, without, so_far), {name: column_of(now, name) for name in keep}

    loop, seen = begun(plant, controller, setpoints, initial, period, period / substeps)
    one_period = jax.eval_shape(moved, loop, loop, *form_of_period((setpoints, seen)))[1]
    start = _Carry(loop, loop, Accumulation.empty(one_period))
    carry, columns = _scan_every(next_period, start, (lax.iota(int, count), setpoints, seen), every)
    totals, run = carry.so_far.totals, carry.so_far.run(periods, period, change)
    metrics = values_of(Metrics, totals, run)
    if not coupling:
        metrics = metrics._replace(coupling=jax.tree.map(lambda own: jnp.full_like(own, jnp.nan), metrics.coupling))
    return Streamed(metrics, angle_at_end(totals, run), columns)
