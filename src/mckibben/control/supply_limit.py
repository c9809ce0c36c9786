"""Pressure limits of a controller from an estimate of the supply."""

from __future__ import annotations

import dataclasses
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator import FirstOrderValve
from mckibben.actuator.base import lag_fraction
from mckibben.component.checks import check_kind
from mckibben.component.columns import Label
from mckibben.control.actuator_adaptation import arriving
from mckibben.control.base import (
    Controller,
    Measurement,
    Setpoint,
    ValveModel,
    check_valve_model,
    controllers_within,
)
from mckibben.control.model_based import StatePrediction
from mckibben.control.observer import lagged
from mckibben.joint import AntagonisticJoint
from mckibben.joint.attainable import pressure_limits_of
from mckibben.joint.geometry import Pair
from mckibben.muscle import Domain
from mckibben.units import PositiveTime, PressureRate, bar

Scalar = Float[Array, ""]

_AT_LIMIT = 0.999  # of the limit: a command above it is one at the limit
_SLOWER = 4.0  # lag of a valve beyond that of the model, relative to it, that is no shortfall


class SupplyLimitState(NamedTuple):
    """State of the inner controller, estimated supply and commands on their way [Pa], and first-order lags of pairs."""

    inner: PyTree
    supply: Scalar
    sent: tuple[Pair, ...]  # the last first
    expected: Pair  # pressures [Pa] by the commands
    filtered: Pair  # measured pressures [Pa]


class SupplyLimit(Controller[SupplyLimitState]):
    r"""Wrapper that limits the pressures of a controller's model to an estimate of the supply.

    Commands at the estimate :math:`\hat p_s` that are not reached lower it; otherwise it rises, up to the limit of the
    model's domain:

    .. math:: \dot{\hat p}_s = r - \frac1T \max\big(\hat p_i - p_i - 4 \max(p_i - \bar p_i, 0), 0\big), \quad
              \tau_v \dot{\hat p}_i = u_i - \hat p_i, \quad \tau_v \dot{\bar p}_i = p_i - \bar p_i

    with the larger shortfall of the muscles whose command is at the limit. The commands :math:`u_i` are those that have
    arrived after the `command_delay` of the controller, or of the one that it wraps, if it has one.

    Parameters
    ----------
    controller
        Controller with a model of the joint.
    valve
        Model of the valves, with the lag tau_v; default: first-order, 20 ms.
    time_constant
        T [s], by which a shortfall lowers the estimate.
    recovery
        r [Pa/s].
    """

    short_name = "supply_limit"
    telemetry_labels: ClassVar = {"supply_estimate": Label("Pa", "controller's estimate of the supply pressure")}

    controller: Controller
    valve: ValveModel = eqx.field(kw_only=True, default=FirstOrderValve(0.02))
    time_constant: PositiveTime = eqx.field(kw_only=True, default=0.03)
    recovery: PressureRate = eqx.field(kw_only=True, default=0.2 * bar)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_kind("SupplyLimit", "model", self._model, AntagonisticJoint)
        check_valve_model("SupplyLimit", self.valve, self._model)

    def init(self, measurement: Measurement) -> SupplyLimitState:
        pressures = measurement.pressures
        sent = (pressures,) * (1 + (getattr(self._predicting, "periods", None) or 0))
        return SupplyLimitState(self.controller.init(measurement), self._rated, sent, pressures, pressures)

    def step(
        self, state: SupplyLimitState, setpoint: Setpoint, measurement: Measurement, period: ArrayLike
    ) -> tuple[SupplyLimitState, Pair]:
        fraction = lag_fraction(self.valve.model_lag(self._model), period)

        def shortfall(i: int) -> Scalar:
            pressure = measurement.pressures[i]
            short = expected[i] - pressure - _SLOWER * jnp.maximum(pressure - filtered[i], 0.0)
            return jnp.where(arrived[i] >= _AT_LIMIT * state.supply, jnp.maximum(short, 0.0), 0.0)

        arrived = self._arrived(state.sent, period)
        expected = lagged(state.expected, arrived, fraction)
        filtered = lagged(state.filtered, measurement.pressures, fraction)
        short = jnp.maximum(shortfall(0), shortfall(1))
        supply = state.supply + period * (self.recovery - short / self.time_constant)
        supply = jnp.clip(supply, jnp.minimum(jnp.maximum(*measurement.pressures), self._rated), self._rated)
        inner, commands = self._limited(supply).step(state.inner, setpoint, measurement, period)
        return SupplyLimitState(inner, supply, (commands, *state.sent[:-1]), expected, filtered), commands

    def telemetry(self, state: SupplyLimitState) -> dict[str, Scalar]:
        return {**self.controller.telemetry(state.inner), "supply_estimate": state.supply}

    def _arrived(self, sent: tuple[Pair, ...], period: ArrayLike) -> Pair:
        """Commands [Pa] that arrived over the last period [s]."""
        delay = getattr(self._predicting, "command_delay", None)
        if delay is None:
            return sent[0]
        first, second = (arriving([pair[i] for pair in sent], delay, period) for i in (0, 1))
        return first, second

    @property
    def _model(self) -> AntagonisticJoint:
        """First model of a joint within the controller."""
        parts = jax.tree.leaves(self.controller, is_leaf=lambda part: isinstance(part, AntagonisticJoint))
        return next((part for part in parts if isinstance(part, AntagonisticJoint)), None)  # type: ignore[return-value]

    @property
    def _predicting(self) -> StatePrediction | None:
        """The controller, or the one that it wraps, that predicts over the delay; None without one."""
        return next((part for part in controllers_within(self.controller) if isinstance(part, StatePrediction)), None)

    @property
    def _rated(self) -> Scalar:
        """Largest pressure of the model's domains [Pa]."""
        return jnp.maximum(*pressure_limits_of(self._model)[1])

    def _limited(self, supply: Scalar) -> Controller:
        """The controller, with its model's pressures limited [Pa]."""

        def limited(part: PyTree) -> PyTree:
            if not isinstance(part, Domain):
                return part
            return dataclasses.replace(part, pressure_max=jnp.minimum(part.pressure_max, supply))

        return jax.tree.map(limited, self.controller, is_leaf=lambda part: isinstance(part, Domain))
