"""Linear state-space model of a scenario's sampled loop at an operating point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import checked_call
from mckibben.errors import ParameterError
from mckibben.result import Column, Listing
from mckibben.scenario import Scenario, with_run
from mckibben.simulation import linear_loop

Floats = NDArray[np.float64]

INPUTS = ("command1", "command2")
"""Commands of both valves [Pa], or disturbances of them in a closed loop."""
_STATES = {"angle": "plant.angle", "velocity": "plant.velocity"}


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Deviations from an operating point over a control period, in SI: x' = A x + B u, y = C x + D u.

    For n states, 2 inputs and 4 outputs, `a` has shape (n, n), `b` (n, 2), `c` (4, n) and `d` (4, 2). The closed loop
    is stable if all poles but those of integrators without effect have a modulus below 1.
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats
    states: tuple[str, ...]  # names, such as "plant.angle"
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]  # commands of the controller [Pa], angle [rad] and velocity [rad/s]
    period: float  # of the control [s]
    time: float  # operating point, the start of a control period [s]
    closed: bool  # or open: the inputs are the commands that the valves receive

    def __repr__(self) -> str:
        kind = "closed" if self.closed else "open"
        return f"<LinearSystem: {kind} loop at {self.time:g} s, {len(self.states)} states, period {self.period:g} s>"

    def _repr_html_(self) -> str:
        poles = self.poles()
        columns = {"pole": (Column(), [f"{pole:.4g}" for pole in poles]), "modulus": (Column(), np.abs(poles))}
        return Listing(repr(self), columns).to_html()

    def poles(self) -> NDArray[np.complex128]:
        """Return the poles in discrete time, the largest first."""
        poles = np.linalg.eigvals(self.a).astype(np.complex128)
        return poles[np.argsort(-np.abs(poles))]

    def to_control(self) -> Any:
        """Return a `control.StateSpace` of python-control with the same names; `ParameterError` if it is missing."""
        try:
            import control  # type: ignore[import-not-found]
        except ImportError as error:
            raise ParameterError("python-control is not installed", remedy="pip install control") from error
        named = {"states": list(self.states), "inputs": list(self.inputs), "outputs": list(self.outputs)}
        return control.ss(self.a, self.b, self.c, self.d, self.period, **named)


@checked_call
def linearize(scenario: Scenario, time: float = 0.0, *, closed: bool = False) -> LinearSystem:
    """Linearise the sampled loop of a scenario at an operating point, as `mckibben margins` does.

    Parameters
    ----------
    scenario
        Plant, controller and reference; sensor noise and disturbances are left out.
    time
        Operating point on the run [s], between 0 and its duration; the start of the nearest control period is taken.
    closed
        False for the loop opened at the commands, from the commands that the valves receive to those of the controller;
        True for the closed loop, from disturbances of the commands.

    Raises
    ------
    ParameterError
        If the time is not within the run.
    """
    substeps = scenario.needed_substeps()
    loop, sampled, names = with_run(scenario, linear_loop, substeps=substeps, time=time)
    a, b, c = (np.asarray(matrix, float) for matrix in loop)
    rows = [np.eye(len(names))[names.index(name)] for name in _STATES.values()]
    return LinearSystem(
        a if closed else a - b @ c,
        b,
        np.vstack([c, *rows]),
        np.zeros((len(INPUTS) + len(_STATES), len(INPUTS))),
        tuple(names),
        INPUTS,
        (*INPUTS, *_STATES),
        scenario.control_period,
        sampled,
        closed,
    )
