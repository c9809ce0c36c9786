"""Actuators that differ between the two muscles of a joint."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Self

import equinox as eqx

from mckibben.actuator.base import Actuator, Reservoir, Scalar, State
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.numerics.elementary import Number
from mckibben.units import Conductance, Volume


class UnequalValves(Actuator):
    """Actuators of the two muscles of a joint, such as two valves of one type whose numbers differ.

    Parameters
    ----------
    muscle1, muscle2
        Actuators of muscle 1 and 2: both with air, or both without. In a file, `muscle` gives both.
    reservoir_volume, line_conductance
        As for an `AirValve`: a reservoir at the inlets of both, filled from the supply of muscle 1.

    Raises `RangeError` for two actuators that cannot drive one joint, such as one with air and one without.

    Examples
    --------
    >>> from mckibben import FirstOrderValve
    >>> pair = UnequalValves(FirstOrderValve(0.02), FirstOrderValve(0.03))
    >>> [round(float(pair.for_muscle(i).lag), 3) for i in (0, 1)]
    [0.02, 0.03]
    """

    short_name = "unequal"
    aliases: ClassVar = {"muscle": ("muscle1", "muscle2")}
    together: ClassVar = (("reservoir_volume", "line_conductance"),)
    muscle_count = 2

    muscle1: Actuator
    muscle2: Actuator
    reservoir_volume: Volume | None = eqx.field(kw_only=True, default=None)
    line_conductance: Conductance | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        super().__check_init__()
        first, second = self.muscle1, self.muscle2
        for name in ("holds_air", "holds_pressure", "direct"):
            if getattr(first, name) != getattr(second, name):
                message = (
                    f"UnequalValves: a {type(first).__name__} and a {type(second).__name__} cannot drive one joint"
                )
                remedy = "give two valves with air, two without, or two with `direct` commands"
                raise RangeError(message, field="muscle2", remedy=remedy)
        for number, valve in enumerate((first, second), 1):
            if valve.muscle_count is not None or valve.reservoir is not None:
                raise RangeError(
                    f"UnequalValves: muscle{number} has a {'pair of valves' if valve.muscle_count else 'reservoir'}",
                    field=f"muscle{number}",
                    remedy="give each muscle one valve, and the reservoir at the inlets of both to the pair",
                )
        if self.reservoir_volume is not None and not self.holds_air:
            message = "UnequalValves: a reservoir at valves without air"
            remedy = "leave it out, or give valves with a conductance"
            raise RangeError(message, field="reservoir_volume", remedy=remedy)

    def for_muscle(self, index: int) -> Any:
        return (self.muscle1, self.muscle2)[index]

    @property
    def holds_air(self) -> bool:  # type: ignore[override]
        return self.muscle1.holds_air

    @property
    def holds_pressure(self) -> bool:  # type: ignore[override]
        return self.muscle1.holds_pressure

    @property
    def direct(self) -> bool:  # type: ignore[override]
        return self.muscle1.direct

    @property
    def is_linear(self) -> bool:
        return self.muscle1.is_linear and self.muscle2.is_linear

    @property
    def switches(self) -> bool:
        return self.muscle1.switches or self.muscle2.switches

    def averaged(self) -> UnequalValves:
        return dataclasses.replace(self, muscle1=self.muscle1.averaged(), muscle2=self.muscle2.averaged())

    @property
    def lag(self) -> Any:
        first, second = self.muscle1.lag, self.muscle2.lag
        return None if first is None or second is None else (first + second) / 2

    @property
    def reservoir(self) -> Reservoir | None:
        if self.reservoir_volume is None or self.line_conductance is None:
            return None
        first: Any = getattr(self.muscle1, "valve", self.muscle1)  # of a tube
        volume, line = self.reservoir_volume, self.line_conductance
        return Reservoir(volume, line, first.supply, first.critical_ratio, first.polytropic_index)

    def init(self, pressure: Scalar) -> State:
        """Return the state of muscle 1; see `for_muscle`."""
        return self.muscle1.init(pressure)

    def scaled(self, factor: float) -> Self:
        """Return the pair with conductances that are larger by a factor, if both are valves with air."""
        first: Any = self.muscle1
        second: Any = self.muscle2
        return dataclasses.replace(self, muscle1=first.scaled(factor), muscle2=second.scaled(factor))

    def model_lag(self, joint: AntagonisticJoint, index: int | None = None) -> Number | None:
        """Return the mean of the lags of the muscles that are not springs, or that of one muscle."""
        chosen = [i for i in (0, 1) if not joint.springs[i]] if index is None else [index]
        lags = [self.for_muscle(i).model_lag(joint, i) for i in chosen]
        return None if None in lags else sum(lags) / len(lags)

    def fastest_rate_in(self, volume: float) -> float:
        valves: Any = (self.muscle1, self.muscle2)
        fastest = max(valve.fastest_rate_in(volume) for valve in valves)
        if self.reservoir is None:
            return fastest
        return max(fastest, self.reservoir.fastest_rate(sum(valve.widest for valve in valves)))
