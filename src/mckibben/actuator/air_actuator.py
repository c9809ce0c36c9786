"""Base of actuators whose pressures follow from mass flow and volume."""

from __future__ import annotations

import abc
from typing import Any, Self

from jaxtyping import Array, ArrayLike

from mckibben.actuator.base import Actuator, AirVolume, Scalar
from mckibben.joint import AntagonisticJoint


class AirActuator(Actuator):
    """Actuator that lets air into a muscle and out; pressures are integrated with the volumes of the muscles.

    It has a gauge pressure `supply` [Pa] and a `polytropic_index`, as fields or properties.
    """

    default_class = ""
    holds_air = True

    @abc.abstractmethod
    def muscle_rate(
        self, pressure: Scalar, state: Any, command: ArrayLike, volume: AirVolume, inlet: ArrayLike
    ) -> tuple[Array, Any, Array]:
        """Return the rates of the pressure [Pa/s] and of the state, and the mass flow [kg/s] drawn from the supply.

        The supply has an absolute pressure `inlet` [Pa].
        """

    @abc.abstractmethod
    def command_for(self, pressure: ArrayLike, rate: ArrayLike, volume: AirVolume) -> Array:
        """Return the command [Pa] at which a pressure [Pa] changes at a rate [Pa/s], with a full supply.

        Infinite where the open valve or the supply is too small.
        """

    @abc.abstractmethod
    def time_constant_at(self, pressure: Any, volume: Any) -> Any:
        """Return the first-order time constant [s] of a small change of the command at a pressure [Pa].

        It is the area between a step of the command and the response of the pressure in a fixed volume [m^3] around a
        gauge pressure [Pa], over the step; the mean of filling and venting. For the valve model of a controller.
        """

    def model_lag(self, joint: AntagonisticJoint, index: int | None = None) -> Any:
        """Return `time_constant_at` the middle of a muscle's pressures and contractions; default: of the first one."""
        index = int(joint.springs[0]) if index is None else index
        muscle = (joint.muscle1, joint.muscle2)[index]
        domain = muscle.domain
        volume = muscle.specimen.volume((domain.contraction_min + domain.contraction_max) / 2)
        return self.time_constant_at((domain.pressure_min + domain.pressure_max) / 2, volume)

    @property
    @abc.abstractmethod
    def widest(self) -> float:
        """Largest conductance [m^3/(s*Pa)] of the open valve."""

    @abc.abstractmethod
    def scaled(self, factor: float) -> Self:
        """Return the actuator with conductances of the valve that are larger by a factor."""

    def before_step(self, state: Any, command: ArrayLike, pressure: ArrayLike, step: ArrayLike) -> Any:
        """Return the state before an integration step [s]; for valves that switch."""
        return state
