"""Actuators that differ between muscles."""

from __future__ import annotations

import abc
import dataclasses
import fnmatch
import functools
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp

from mckibben.actuator.base import Actuator, Reservoir, Scalar, State
from mckibben.component.base import Component
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.numerics.elementary import Number
from mckibben.units import Conductance, Volume


class MuscleValves(Actuator):
    """Base of actuators that differ between muscles: all with air, or all without.

    Parameters
    ----------
    reservoir_volume, line_conductance
        As for an `AirValve`: a reservoir at the inlets of all, filled from the supply of the first.

    Raises `RangeError` for actuators that cannot drive one mechanism, such as one with air and one without.
    """

    together: ClassVar = (("reservoir_volume", "line_conductance"),)

    reservoir_volume: Volume | None = eqx.field(kw_only=True, default=None)
    line_conductance: Conductance | None = eqx.field(kw_only=True, default=None)

    @property
    @abc.abstractmethod
    def valves(self) -> dict[str, Actuator]:
        """The actuators, each by its field."""

    def __check_init__(self) -> None:
        super().__check_init__()
        own = type(self).__name__
        for (_, first), (field, second) in pairwise(self.valves.items()):
            if any(getattr(first, name) != getattr(second, name) for name in ("holds_air", "holds_pressure", "direct")):
                message = f"{own}: a {type(first).__name__} and a {type(second).__name__} cannot drive one mechanism"
                remedy = "give valves with air, valves without, or valves with `direct` commands"
                raise RangeError(message, field=field, remedy=remedy)
        for field, valve in self.valves.items():
            if valve.muscle_count is not None or valve.reservoir is not None:
                raise RangeError(
                    f"{own}: {field} has {'several valves' if valve.muscle_count is not None else 'a reservoir'}",
                    field=field,
                    remedy="give each muscle one valve, and the reservoir at the inlets of all beside them",
                )
        if self.reservoir_volume is not None and not self.holds_air:
            remedy = "leave it out, or give valves with a conductance"
            raise RangeError(f"{own}: a reservoir at valves without air", field="reservoir_volume", remedy=remedy)

    @property
    def _first(self) -> Any:
        return next(iter(self.valves.values()))

    @property
    def holds_air(self) -> bool:  # type: ignore[override]
        return self._first.holds_air

    @property
    def holds_pressure(self) -> bool:  # type: ignore[override]
        return self._first.holds_pressure

    @property
    def direct(self) -> bool:  # type: ignore[override]
        return self._first.direct

    @property
    def is_linear(self) -> bool:
        return all(valve.is_linear for valve in self.valves.values())

    @property
    def switches(self) -> bool:
        return any(valve.switches for valve in self.valves.values())

    @property
    def supply(self) -> Any:
        """Lowest supply pressure [Pa], which all muscles reach; None where no valve has one."""
        supplies = [supply for valve in self.valves.values() if (supply := getattr(valve, "supply", None)) is not None]
        return functools.reduce(jnp.minimum, supplies) if supplies else None

    @property
    def lag(self) -> Any:
        lags = [valve.lag for valve in self.valves.values()]
        return None if None in lags else sum(lags) / len(lags)

    @property
    def reservoir(self) -> Reservoir | None:
        if self.reservoir_volume is None or self.line_conductance is None:
            return None
        first: Any = getattr(self._first, "valve", self._first)  # of a tube
        volume, line = self.reservoir_volume, self.line_conductance
        return Reservoir(volume, line, first.supply, first.critical_ratio, first.polytropic_index)

    def init(self, pressure: Scalar) -> State:
        """Return the state of the first muscle; see `for_muscle`."""
        return self._first.init(pressure)

    def model_lag(self, joint: AntagonisticJoint, index: int | None = None) -> Number | None:
        """Return the mean of the lags of the muscles that are not springs, or that of one muscle."""
        chosen = [i for i in (0, 1) if not joint.springs[i]] if index is None else [index]
        lags = [self.for_muscle(i).model_lag(joint, i) for i in chosen]
        return None if None in lags else sum(lags) / len(lags)

    def fastest_rate_in(self, volume: float) -> float:
        valves: list[Any] = [self.for_muscle(i) for i in range(self.muscle_count or 0)]
        fastest = max(valve.fastest_rate_in(volume) for valve in valves)
        if self.reservoir is None:
            return fastest
        return max(fastest, self.reservoir.fastest_rate(sum(valve.widest for valve in valves)))


class UnequalValves(MuscleValves):
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
    muscle_count = 2

    muscle1: Actuator
    muscle2: Actuator

    @property
    def valves(self) -> dict[str, Actuator]:
        return {"muscle1": self.muscle1, "muscle2": self.muscle2}

    def for_muscle(self, index: int) -> Any:
        return (self.muscle1, self.muscle2)[index]

    def averaged(self) -> UnequalValves:
        return dataclasses.replace(self, muscle1=self.muscle1.averaged(), muscle2=self.muscle2.averaged())

    def scaled(self, factor: float) -> Self:
        """Return the pair with conductances that are larger by a factor, if both are valves with air."""
        first: Any = self.muscle1
        second: Any = self.muscle2
        return dataclasses.replace(self, muscle1=first.scaled(factor), muscle2=second.scaled(factor))


class ValveGroup(Component):
    """Muscles with valves of one kind, one each.

    Parameters
    ----------
    muscles
        Their names, or patterns of names such as ``elbow*``.
    valve
        The valve of each.
    """

    muscles: tuple[str, ...] = eqx.field(static=True)
    valve: Actuator


class ValvesByMuscle(MuscleValves):
    """Actuators of the muscles of a robot, by names of muscles: a valve for each, from the first group that names it.

    Parameters
    ----------
    groups
        Muscles with valves of one kind.
    reservoir_volume, line_conductance
        As for an `AirValve`: a reservoir at the inlets of all, filled from the supply of the first group.
    assigned
        Number of the group of each muscle, set by `for_muscles`.

    Examples
    --------
    >>> from mckibben import FirstOrderValve
    >>> fast, slow = ValveGroup(("wrist*",), FirstOrderValve(0.01)), ValveGroup(("*",), FirstOrderValve(0.03))
    >>> valves = ValvesByMuscle((fast, slow)).for_muscles(["elbow1", "wrist1"])
    >>> [round(float(valves.for_muscle(i).lag), 3) for i in (0, 1)]
    [0.03, 0.01]
    """

    short_name = "by_muscle"

    groups: tuple[ValveGroup, ...]
    assigned: tuple[int, ...] = eqx.field(static=True, default=())

    def __check_init__(self) -> None:
        if not self.groups:
            raise RangeError(
                "ValvesByMuscle: there are no groups", field="groups", remedy="give muscles and their valve"
            )
        super().__check_init__()

    @property
    def valves(self) -> dict[str, Actuator]:
        return {f"groups.{number}.valve": group.valve for number, group in enumerate(self.groups)}

    @property
    def muscle_count(self) -> int:  # type: ignore[override]
        return len(self.assigned)

    def for_muscle(self, index: int) -> Any:
        return self.groups[self.assigned[index]].valve

    def for_muscles(self, names: Sequence[str]) -> ValvesByMuscle:
        assigned = []
        for name in names:
            fits = [any(fnmatch.fnmatchcase(name, one) for one in group.muscles) for group in self.groups]
            if True not in fits:
                remedy = f"name it in a group, or give a last one with '*'; there are {', '.join(names)}"
                raise RangeError(f"muscle {name} has no valve", field="groups", value=name, remedy=remedy)
            assigned.append(fits.index(True))
        unused = set(range(len(self.groups))).difference(assigned)
        if unused and not self.assigned:  # the first time, of all muscles
            number = min(unused)
            message = f"no muscle has its valve from {', '.join(self.groups[number].muscles)}"
            remedy = f"leave the group out, or place it before the others; there are {', '.join(names)}"
            raise RangeError(message, field=f"groups.{number}.muscles", remedy=remedy)
        return dataclasses.replace(self, assigned=tuple(assigned))

    def averaged(self) -> ValvesByMuscle:
        groups = (dataclasses.replace(group, valve=group.valve.averaged()) for group in self.groups)
        return dataclasses.replace(self, groups=tuple(groups))
