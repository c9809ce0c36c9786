"""What a run is made of: plant, controller, reference and start, as one tree whose leaves have names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import SimulationError
from mckibben.numerics.batching import check_again, lanes_of, with_leaves
from mckibben.numerics.checks import whole_periods
from mckibben.numerics.compiled import compiled, compiled_as_given, numeric
from mckibben.numerics.elementary import floating
from mckibben.plant import JointPlant, PlantState


class AtRest(NamedTuple):
    """A start at rest: angle [rad], and stiffness [N*m/rad] (NaN: amid the attainable ones); numbers, or one a run."""

    angle: ArrayLike
    stiffness: ArrayLike = math.nan


class Run(NamedTuple):
    """All that a run is made of; its leaves are numbers, or arrays with one number a run."""

    plant: JointPlant
    controller: Controller
    reference: Reference
    initial: PlantState | AtRest

    def start(self, wish: Setpoint) -> tuple[PlantState, Array]:
        """The state to start from, for wishes of shape (periods,), and whether there is one."""
        if isinstance(self.initial, PlantState):
            return self.plant.complete_state(jax.tree.map(floating, self.initial)), jnp.asarray(True)
        return self.plant.find_equilibrium(*self.rest(wish))

    def rest(self, wish: Setpoint) -> tuple[Array, Array]:
        """The angle [rad] and the stiffness [N*m/rad] at which it is to rest at the start."""
        asked = self.initial
        assert isinstance(asked, AtRest)
        return jnp.where(jnp.isnan(asked.angle), wish.angle[0], asked.angle), jnp.asarray(asked.stiffness)


def described(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    initial: PlantState | AtRest | None,
    over: Mapping[str, ArrayLike],
) -> tuple[Run, Run, int | None]:
    """A run with other values at named leaves, in two parts: the leaves that vary over runs, and all others.

    With them comes the number of runs; None if no leaf varies.

    Raises
    ------
    ParameterError
        If there is no such leaf, or their arrays are of different lengths.
    RangeError
        If an object refuses a value.
    """
    run = Run(plant, controller, reference, AtRest(math.nan) if initial is None else initial)
    run = Run(**with_leaves(run._asdict(), over))
    count, varying = lanes_of(run)
    check_again(run)
    return *eqx.partition(numeric(run), varying), count


def check_names(what: str, names: Sequence[str], known: Sequence[str]) -> None:
    """Raise unless all names of a list are known."""
    for name in [names] if isinstance(names, str) else names:
        if name not in known or isinstance(names, str):
            raise SimulationError(
                f"{name!r} is no {what}" if name not in known else f"one {what} alone: {name!r}",
                value=name,
                remedy=f"give a list of {', '.join(known)}",
            )


Scalar = Float[Array, ""]


class Record(NamedTuple):
    """What is kept of every control period; each leaf has the shape of the time axis."""

    state: PlantState
    command1: Array
    command2: Array
    limited: Array  # whether the plant had to limit a command
    telemetry: dict[str, Array]


Running = tuple[PlantState, Any]
"""The plant's state and the controller's, at the start of a control period."""


def started(plant: JointPlant, controller: Controller, initial: PlantState) -> Running:
    """The plant at its initial state, and the controller as it takes over."""
    return initial, controller.init(plant.sample(initial, 0.0)[1])


def control_period(
    plant: JointPlant,
    controller: Controller,
    running: Running,
    setpoint: Setpoint,
    period: ArrayLike,
    substeps: int,
) -> tuple[Running, Record]:
    """One control period: the controller's step, then the plant under the commands that it holds."""
    state, memory = running
    state, measurement = plant.sample(state, period)
    memory, wanted = controller.step(memory, setpoint, measurement, period)
    commands = plant.clip_commands(wanted)
    limited = (commands[0] != wanted[0]) | (commands[1] != wanted[1])
    following = plant.advance(state, commands, period, substeps)
    return (following, memory), Record(state, *commands, limited, controller.telemetry(memory))


def episode(
    plant: JointPlant,
    controller: Controller,
    setpoints: Setpoint,
    initial: PlantState,
    period: ArrayLike,
    substeps: int,
) -> tuple[PlantState, Record]:
    """Run a controller on a plant: one pure function, to be compiled, vmapped and differentiated at will.

    Parameters
    ----------
    plant, controller
        Their numeric leaves may be traced.
    setpoints
        The wishes at the start of each control period, arrays of shape (periods,).
    initial
        The plant's state at the start.
    period
        The control period [s].
    substeps
        Runge-Kutta steps a control period.

    Returns
    -------
    final, record
        The state after the last period, and the record of shape (periods,): the state at the start of each period and
        the commands held over it.
    """

    def following(running: Running, setpoint: Setpoint) -> tuple[Running, Record]:
        return control_period(plant, controller, running, setpoint, period, substeps)

    (final, _), record = lax.scan(following, started(plant, controller, initial), setpoints)
    return final, record


@compiled_as_given
def compiled_episode(
    plant: JointPlant,
    controller: Controller,
    setpoints: Setpoint,
    initial: PlantState,
    period: ArrayLike,
    substeps: int,
) -> tuple[PlantState, Record]:
    """`episode`, compiled once for each structure of its arguments; give it `numeric` ones."""
    return episode(plant, controller, setpoints, initial, period, substeps)


def without_last_change(setpoints: Setpoint) -> Setpoint | None:
    """The same wishes without the last change of stiffness; None if it never changes, or never stops changing."""
    stiffness = np.asarray(setpoints.stiffness)
    changes = np.flatnonzero(stiffness[1:] != stiffness[:-1]) + 1
    if changes.size == 0 or changes[-1] == stiffness.size - 1:
        return None
    held = np.where(np.arange(stiffness.size) >= changes[-1], stiffness[changes[-1] - 1], stiffness)
    return setpoints._replace(stiffness=held)  # type: ignore[arg-type]  # compiled code takes it as it is


def sampled(reference: Reference, duration: float, period: float) -> tuple[NDArray[np.float64], Setpoint]:
    """The start times [s] of the control periods in a duration, and the wishes at them.

    Raises
    ------
    SimulationError
        If a time is not positive, or the duration no whole number of periods.
    """
    times = sampling_times(duration, period)
    return times, compiled_wishes(reference, times)


def wishes_at(reference: Reference, times: ArrayLike) -> Setpoint:
    """The wishes at times [s], with an explicit type: a weakly typed wish would compile everything anew."""
    return Setpoint(*(jnp.asarray(wish, float) for wish in reference(times)))


compiled_wishes = compiled(wishes_at)


def sampling_times(duration: float, period: float) -> NDArray[np.float64]:
    """The start times [s] of the control periods in a duration; raises as `sampled` does."""
    for name, value in (("duration", duration), ("control period", period)):
        if not (math.isfinite(value) and value > 0):
            raise SimulationError(f"the {name} is {value:g} s", value=value, unit="s", remedy="give a positive time")
    periods = whole_periods(duration, period)
    if periods is None:
        raise SimulationError(
            f"a duration of {duration:.12g} s is no whole number of control periods of {period:.12g} s",
            value=duration,
            unit="s",
            remedy=f"{max(round(duration / period), 1) * period:.12g} s would be",
        )
    return np.arange(periods, dtype=float) * period


def check_substeps(substeps: int) -> None:
    """Raise unless it is a whole number from 1 up."""
    if isinstance(substeps, bool) or not isinstance(substeps, int) or substeps < 1:
        raise SimulationError(
            f"{substeps} integration steps a control period", value=substeps, remedy="give a whole number from 1 up"
        )
