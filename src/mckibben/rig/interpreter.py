"""Iteration over the steps of a test."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence

from mckibben.rig.bench import Bench
from mckibben.rig.steps import Acquire, Dwell, HoldForce, Move, Pressurise, ProtocolStep, Repeat, Vent, Walk


class StepInterpreter(abc.ABC):
    """Iteration over the steps of a test: the same on a rig (`Runner`) and in a dry run (`DryRun`)."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.position = 0.0
        self._repeat = 0
        self._walked_from = 0.0

    def _do(self, steps: Sequence[ProtocolStep], place: str = "") -> None:
        for index, step in enumerate(steps):
            here = f"{place}[{index}]"
            self._begin(step, here)
            match step:
                case Repeat():
                    around = self._repeat
                    for number in range(step.times):
                        self._repeat = number
                        self._do(step.steps, f"{here}.repeat.steps")
                    self._repeat = around
                case Move():
                    self._move_to(self.bench.position_at(step.to), step.speed)
                case Dwell():
                    self._rest(step.duration)
                case Pressurise():
                    self._pressurise(step.pressure, step.rate, step.holding)
                case HoldForce():
                    self._hold(step)
                case Acquire():
                    self._acquire(step)
                case Walk():
                    self._walk(step)
                case Vent():
                    self._vent()

    def _walk(self, walk: Walk) -> None:
        begin = self.position
        to = self._walk_end(walk)
        self._walked_from = begin
        sign = 1 if to > begin else -1
        forces = [self._acquire(walk.acquire)]
        slack = 0
        for count in range(1, math.floor(abs(to - begin) / walk.step + 0.01) + 1):
            if walk.force is not None and forces[-1] + 1.5 * (forces[-1] - (forces[-2:][0])) > walk.force:
                return  # the force rises progressively with the stretch: half of a rise is added
            slack = slack + 1 if forces[-1] <= walk.slack_force else 0
            if walk.slack is not None and slack >= walk.slack:
                return
            self._move_to(begin + sign * walk.step * count, walk.speed)
            self._rest(walk.dwell)
            forces.append(self._acquire(walk.acquire))

    def _walk_end(self, walk: Walk) -> float:
        return self._walked_from if walk.to is None else self.bench.position_at(walk.to)

    def _begin(self, step: ProtocolStep, place: str) -> None:
        """Prepare a step at a place of the protocol."""
        return

    @abc.abstractmethod
    def _move_to(self, position: float, speed: float) -> None: ...

    @abc.abstractmethod
    def _rest(self, duration: float) -> None: ...

    @abc.abstractmethod
    def _pressurise(self, pressure: float, rate: float | None, holding: float | None) -> None: ...

    @abc.abstractmethod
    def _hold(self, step: HoldForce) -> None: ...

    @abc.abstractmethod
    def _acquire(self, acquire: Acquire) -> float: ...

    @abc.abstractmethod
    def _vent(self) -> None: ...
