"""Prediction over a known delay of the commands, for controllers without a model of the joint's motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, NamedTuple, cast

import equinox as eqx
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.component.base import Inherited
from mckibben.control.base import Controller, Measurement, Setpoint, controllers_within
from mckibben.control.model_based import Estimates, PairPrediction, StatePrediction
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver
from mckibben.errors import RangeError
from mckibben.joint.geometry import Pair
from mckibben.units import CommandDelay

Scalar = Float[Array, ""]


def _plant_delay(scope: Mapping[str, float | None]) -> float:
    """Delay of the plant's commands [s]."""
    delay = scope.get("command_delay")
    return 0.0 if delay is None else delay


class DelayState(NamedTuple):
    """State of the inner controller, and estimates at the last sample."""

    inner: PyTree
    estimates: Estimates


class DelayCompensation(PairPrediction[DelayState]):
    r"""Wrapper that gives a controller, such as a PID, the measurement to be expected when its commands arrive.

    The prediction is that of `StatePrediction`. The controller gets the predicted angle and pressures in place of the
    measurement, and the extrapolated setpoint; it is therefore tuned as if there were no delay. Controllers that are
    model-based themselves have a `command_delay` of their own.

    Parameters
    ----------
    controller
        Any controller that is not model-based.
    command_delay
        Time from a command to the valves [s]; in a file, by default, that of the plant.
    model, load, valve
        Models of the joint, its load and its valves.
    observer, pressure_observer
        As for `DecouplingControl`.
    """

    short_name = "delay_compensation"

    controller: Controller = eqx.field(kw_only=True)
    command_delay: Annotated[CommandDelay, Inherited(_plant_delay)] = eqx.field(kw_only=True)  # type: ignore[override]
    observer: Observer = ExtendedStateObserver()
    pressure_observer: PressureObserver = PressureObserver()

    def __check_init__(self) -> None:
        super().__check_init__()
        for inner in controllers_within(self.controller):
            if isinstance(inner, StatePrediction):
                raise RangeError(
                    f"DelayCompensation: a {type(inner).__name__} predicts over the delay itself",
                    field="controller",
                    remedy="give it command_delay and leave DelayCompensation out: its observers replace both pairs",
                )

    def init(self, measurement: Measurement) -> DelayState:
        return DelayState(
            self.controller.init(measurement), self.init_estimates((measurement.angle,), measurement.pressures)
        )

    def step(
        self, state: DelayState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[DelayState, Pair]:
        angles, measured = (measurement.angle,), measurement.pressures
        estimates, expected = self.update(state.estimates, (setpoint,), angles, measured, period)
        predicted = Measurement(expected.angles[0], cast(Pair, expected.estimates.pressures))
        inner, commands = self.controller.step(state.inner, expected.setpoints[0], predicted, period)
        unused = ("torque", "stiffness", "added_stiffness", "saturated")  # not computed in exported C
        estimates = estimates._replace(**{name: getattr(state.estimates, name) for name in unused})
        return DelayState(inner, estimates._replace(sent=(commands, *estimates.sent[:-1]))), commands

    def telemetry(self, state: DelayState) -> dict[str, Scalar]:
        return self.controller.telemetry(state.inner)
