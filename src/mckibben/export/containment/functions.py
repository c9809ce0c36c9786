"""Functions of a contained controller, as the programs generated from it compute them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, PyTree

from mckibben.export import containment
from mckibben.export.containment import ContainedState, Containment, ControlSample
from mckibben.numerics.compiled import numeric
from mckibben.plant import Plant

_SAME_PERIOD = 1e-6  # relative difference of the period that `init` accepts


class ControllerFunctions(NamedTuple):
    """Functions of a controller with its containment over their parameters, and examples of their arguments.

    The functions are pure, and take the parameters first. ``begin(parameters, measurement)`` returns the ``state`` of
    the controller at a start, ``init(parameters, period, measurement)`` all other parts of the ``state``, and whether
    the control period [s] and the measurement are ``valid``; if not, it is vented. ``check(parameters, state, setpoint,
    measurement)`` returns the state after the checks, and the ``action``: `containment.USE`, `HOLD` or `RESTART`.
    ``step(parameters, state, setpoint, measurement)`` and, for a period without a usable sample, ``hold(parameters,
    state)`` return the next ``state``, the ``commands`` [Pa] and the ``telemetry``.
    """

    parameters: dict[str, PyTree]
    of: Callable[[PyTree], PyTree]  # the controller with these parameters
    begin: Callable[[PyTree, PyTree], dict[str, PyTree]]
    init: Callable[[PyTree, PyTree, PyTree], dict[str, PyTree]]
    check: Callable[[PyTree, PyTree, PyTree, PyTree], dict[str, PyTree]]
    step: Callable[[PyTree, PyTree, PyTree, PyTree], dict[str, PyTree]]
    hold: Callable[[PyTree, PyTree], dict[str, PyTree]]
    state: PyTree
    setpoint: PyTree
    measurement: PyTree  # the first one
    plant: Plant
    initial: PyTree  # state of the plant
    period: float  # s

    def start(self, parameters: PyTree, measurement: PyTree) -> PyTree:
        """State after `begin` and `init`."""
        controller = self.begin(parameters, measurement)["state"].controller
        state = self.init(parameters, jnp.asarray(self.period), measurement)["state"]
        return state._replace(controller=controller)

    def contained(self, parameters: PyTree, state: PyTree, setpoint: PyTree, measurement: PyTree) -> dict[str, PyTree]:
        """A period as the generated programs compute it: check, then step or hold, possibly after a new beginning."""
        checked = self.check(parameters, state, setpoint, measurement)
        state, action = checked["state"], checked["action"]
        again = self.begin(parameters, measurement)["state"].controller
        controller = jax.tree.map(
            lambda new, old: jnp.where(action == containment.RESTART, new, old), again, state.controller
        )
        state = state._replace(controller=controller)
        return lax.cond(
            action == containment.HOLD,
            lambda: self.hold(parameters, state),
            lambda: self.step(parameters, state, setpoint, measurement),
        )


def functions_of(
    plant: Plant,
    controller: PyTree,
    initial: PyTree,
    period: float,
    setpoint: PyTree,
    limits: Containment,
    stepped: Callable[..., PyTree] = lambda controller, *sample: controller.step(*sample),
) -> ControllerFunctions:
    """Functions of a controller of a joint or a robot, all of whose real numbers but the period are parameters.

    Parameters
    ----------
    plant, initial
        Plant and its state at the start, for the first measurement.
    period
        Control period [s].
    setpoint
        Example of a setpoint.
    limits
        Limits of samples and commands.
    stepped
        ``stepped(controller, state, setpoint, measurement, period)`` returns the next state and the commands.
    """
    numbers, fixed = eqx.partition(controller, eqx.is_inexact_array_like)
    parameters = {"controller": numbers, "limits": numeric(limits)}
    direct = bool(np.min(np.asarray(limits.vent)) < 0)  # openings

    def of(parameters: PyTree) -> PyTree:
        return eqx.combine(parameters["controller"], fixed)

    def begin(parameters: PyTree, measurement: PyTree) -> dict[str, PyTree]:
        return {"state": ContainedState(of(parameters).init(measurement), *[()] * 8)}  # type: ignore

    def first(measurement: PyTree) -> tuple[Array, ...]:
        pressures = tuple(map(jnp.asarray, measurement.pressures))
        return tuple(map(jnp.zeros_like, pressures)) if direct else pressures  # closed, or as they are

    def init(parameters: PyTree, period: PyTree, measurement: PyTree) -> dict[str, PyTree]:
        same = jnp.abs(period - exported) <= _SAME_PERIOD * exported
        state, valid = containment.begin(parameters["limits"], same, measurement, first(measurement))
        return {"state": state, "valid": valid}

    def check(parameters: PyTree, state: ContainedState, setpoint: PyTree, measurement: PyTree) -> dict[str, PyTree]:
        sample = ControlSample(setpoint, measurement)
        state, action = containment.check(parameters["limits"], state, sample, first(measurement), exported)
        return {"state": state, "action": action}

    def step(parameters: PyTree, state: ContainedState, setpoint: PyTree, measurement: PyTree) -> dict[str, PyTree]:
        following, commands = stepped(of(parameters), state.controller, setpoint, measurement, np.asarray(exported))
        return answer(parameters, containment.send(parameters["limits"], state, following, commands, exported))

    def hold(parameters: PyTree, state: ContainedState) -> dict[str, PyTree]:
        return answer(parameters, containment.hold(parameters["limits"], state, exported))

    def answer(parameters: PyTree, state: ContainedState) -> dict[str, PyTree]:
        commands = OrderedDict(
            (f"pressure{number}", x) for number, x in enumerate(state.commands, 1)
        )  # dicts are sorted
        telemetry = of(parameters).telemetry(state.controller) | {"status": state.status, "fault": state.fault}
        return {"state": state, "commands": commands, "telemetry": telemetry}

    exported = period
    measurement = plant.sample(initial, 0.0)[1]
    functions = of, begin, init, check, step, hold
    program = ControllerFunctions(parameters, *functions, (), setpoint, measurement, plant, initial, period)
    state = jax.eval_shape(lambda measurement: program.start(parameters, measurement), measurement)
    return program._replace(state=jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), state))
