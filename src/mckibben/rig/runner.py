"""Runner of a test: steps on a rig, resumable, vented in any case."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from mckibben.errors import StoppedError
from mckibben.muscle import Muscle, forces
from mckibben.rig.backend import Channel
from mckibben.rig.bench import Bench
from mckibben.rig.record import PLACE, POINT, Point
from mckibben.rig.session import RigSession
from mckibben.rig.steps import TURNING, Acquire, Dwell, HoldForce, Move, Pressurise, ProtocolStep, Repeat, Vent, Walk
from mckibben.storage.mcap import Column
from mckibben.units import bar, percent

DONE, RESUMED = "done", "resumed"
"""Kinds of event."""


def columns_of(inputs: Sequence[Channel]) -> tuple[Column, ...]:
    """Return the columns of the record of a test.

    >>> [column.name for column in columns_of([Channel("force", "N"), Channel("pressure", "Pa")])]
    ['time', 'force', 'pressure', 'pulses', 'plateau']
    """
    values = (Column(channel.name, channel.unit, "float32") for channel in inputs)
    return (Column("time", "s"), *values, Column("pulses", "1", "int32"), Column("plateau", "1", "int32"))


class StepInterpreter(abc.ABC):
    """Iteration over the steps of a test: the same on a rig (`Runner`) and in a dry run (`DryRun`)."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.position = 0
        self._repeat = 0
        self._walked_from = 0

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
                    self._move_to(self.bench.pulses_at(step.to), step.speed)
                case Dwell():
                    self._rest(step.duration)
                case Pressurise():
                    self._pressurise(step.pressure, step.rate, step.holding, step.shut)
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
        step = max(1, self.bench.drive.nearest(walk.step))
        sign = 1 if to > begin else -1
        forces = [self._acquire(walk.acquire)]
        slack = 0
        for count in range(1, (abs(to - begin) + step // 100) // step + 1):
            if walk.force is not None and forces[-1] + 1.5 * (forces[-1] - (forces[-2:][0])) > walk.force:
                return  # the force rises progressively with the stretch: half of a rise is added
            slack = slack + 1 if forces[-1] <= walk.slack_force else 0
            if walk.slack is not None and slack >= walk.slack:
                return
            self._move_to(begin + sign * step * count, walk.speed)
            self._rest(walk.dwell)
            forces.append(self._acquire(walk.acquire))

    def _walk_end(self, walk: Walk) -> int:
        return self._walked_from if walk.to is None else self.bench.pulses_at(walk.to)

    @abc.abstractmethod
    def _begin(self, step: ProtocolStep, place: str) -> None: ...

    @abc.abstractmethod
    def _move_to(self, pulses: int, speed: float) -> None: ...

    @abc.abstractmethod
    def _rest(self, duration: float) -> None: ...

    @abc.abstractmethod
    def _pressurise(self, pressure: float, rate: float | None, holding: float | None, shut: float | None) -> None: ...

    @abc.abstractmethod
    def _hold(self, step: HoldForce) -> None: ...

    @abc.abstractmethod
    def _acquire(self, acquire: Acquire) -> float: ...

    @abc.abstractmethod
    def _vent(self) -> None: ...


@dataclass
class _Target:
    """State that the steps have requested; on resuming, reached from the same side before the first missing point."""

    pressed: int = 0  # position at which the pressure was set
    turn: int = 0  # start of the present motion
    before: int = 0  # start of the one before
    pressure: float = 0.0
    via: float = 0.0  # pressure before the set one
    holding: float | None = None
    shut: float | None = None
    hold: HoldForce | None = None
    speed: float = 0.0
    rest: float = 0.0


class Runner(StepInterpreter):
    """Runs the steps of a test in a session; in any case the muscle is vented at the end.

    Parameters
    ----------
    session
        Session of the rig.
    done
        Points that an earlier session has recorded. Their steps are skipped; before the first missing point the rig is
        brought to the state of the completed steps, from the same side.
    """

    def __init__(self, session: RigSession, *, done: Sequence[Point] = ()) -> None:
        super().__init__(session.bench)
        self._rig = session
        self._done = done
        self._target = _Target()
        self._live = not done
        self._number = 0
        self._speed = self.bench.drive.fastest / self.bench.drive.pulses_per_metre / 4  # unless a step has set one

    def run(self, steps: Sequence[ProtocolStep]) -> None:
        """Open the backend, do the steps, vent, close.

        Parameters
        ----------
        steps
            Steps of the test, as `dry_run` has checked them.

        Raises
        ------
        StoppedError
            If a limit was exceeded, or anything failed; the muscle was vented, and the reason recorded.
        SignalledError
            If the reason was a signal.
        """
        rig = self._rig
        with rig.backend.opened():
            try:
                with rig.monitor.guard():
                    rig.begin()
                    if self._live:  # the steps begin where the muscle was mounted
                        rig.move_to(0, self._speed)
                    self._do(steps)
                    self._vent()
                    for _ in range(2):  # a chunk that is damaged later must not cause a finished test to move again
                        rig.recorder.event(DONE, "all steps are done", points=self._number, pulses=rig.pulses)
                        rig.recorder.flush()
            except BaseException as error:
                raise rig.record_stop(error) from error

    def _begin(self, step: ProtocolStep, place: str) -> None:
        return

    def _acquire(self, acquire: Acquire) -> float:
        number, self._number = self._number, self._number + 1
        if number < len(self._done):
            point = self._done[number]
            if self._target.holding is not None:
                self._target.before = self._target.turn = self._target.pressed = point.pulses
            self.position = point.pulses
            return point.force
        self._go_live()
        self._rig.measure_length()
        bench, recorder = self.bench, self._rig.recorder
        every = max(1, round(bench.rate * acquire.duration / acquire.samples))
        rows = (acquire.samples - 1) * every + 1
        first, pulses = recorder.rows, self._rig.pulses
        begun, means = self._rig.acquire(rows, number)
        point = Point(
            number=number,
            first=first,
            rows=rows,
            every=every,
            samples=acquire.samples,
            time=begun,
            pulses=pulses,
            contraction=bench.contraction_at(pulses),
            force=means["force"],
            pressure=means["pressure"],
            set_pressure=self._target.pressure,
            set_force=self._target.hold.force if self._target.hold else None,
            direction=acquire.direction,
            phase=acquire.phase,
            repeat=self._repeat,
            keep=acquire.keep,
        )
        self._check_against_law(point)
        recorder.event(POINT if acquire.keep else PLACE, **asdict(point))
        return point.force

    def _check_against_law(self, point: Point) -> None:
        """Raise if the force deviates from the law by more than the limit."""
        of, most = self.bench.of, self.bench.limits.deviation
        if most == math.inf or not isinstance(of, Muscle):
            return
        there = float(forces(of, point.contraction, point.pressure))
        if not abs(point.force - there) <= most:
            raise StoppedError(
                f"the force of {point.force:.4g} N at {point.contraction / percent:.4g} % and "
                f"{point.pressure / bar:.3g} bar deviates from the law, {there:.4g} N",
                value=point.force,
                unit="N",
                remedy="check its clamps, the motor and the force sensor, or raise limits.deviation",
            )

    def _move_to(self, pulses: int, speed: float) -> None:
        target = self._target
        if (pulses - self.position) * (self.position - target.turn) < 0:
            target.before, target.turn = target.turn, self.position
        self.position, target.speed, target.rest = pulses, speed, 0.0
        if self._live:
            self._rig.move_to(pulses, speed)

    def _rest(self, duration: float) -> None:
        self._target.rest += duration
        if self._live:
            self._rig.wait(duration)

    def _pressurise(self, pressure: float, rate: float | None, holding: float | None, shut: float | None) -> None:
        target = self._target
        target.via, target.pressure, target.holding, target.rest = target.pressure, pressure, holding, 0.0
        target.hold, target.pressed, target.shut = None, self.position, shut
        if holding is None:
            target.before = target.turn = self.position
        if self._live:
            self._rig.set_pressure(target.via, pressure, rate, holding, shut)

    def _vent(self) -> None:
        self._target.via = self._target.pressure = self._target.rest = 0.0
        self._target.holding = self._target.hold = self._target.shut = None
        self._target.before = self._target.turn = self._target.pressed = self.position
        if self._live:
            self._rig.vent_and_wait()

    def _hold(self, step: HoldForce) -> None:
        self._target.rest, self._target.hold = 0.0, step
        if not self._live or self._rig.hang(step.force):
            return
        deadline = self._rig.now + step.longest
        while abs(self._rig.read_cycle().force - step.force) > step.tolerance or self._rig.backend.moving:
            self._rig.step_towards(step.force, step.speed)
            if self._rig.now > deadline:
                raise StoppedError(
                    f"the force of {step.force:g} N was not reached within {step.longest:g} s",
                    remedy="choose one that the muscle has at this pressure within its range",
                )
        self.position = self._target.turn = self._target.before = self._rig.pulses

    def _go_live(self) -> None:
        """On resuming, reach the state of the completed steps, from the same side."""
        if self._live:
            return
        self._live = True
        target = self._target
        rest = target.rest
        speed = target.speed or self._speed
        self._rig.recorder.event(RESUMED, f"at point {self._number - 1}", point=self._number - 1)
        self._rig.vent_and_wait()
        self._rig.move_to(target.pressed, speed)
        if target.via > 0:
            self._rig.set_pressure(0.0, target.via, 1 * bar, target.holding)
        if target.pressure != 0:
            rate = 1 * bar if target.holding is not None else None
            self._rig.set_pressure(target.via, target.pressure, rate, target.holding, target.shut)
        if target.hold is not None:
            self._hold(target.hold)
        else:
            most = round(TURNING * self.bench.drive.pulses_per_metre)
            self._rig.move_to(target.turn + max(-most, min(most, target.before - target.turn)), speed)
            self._rig.move_to(target.turn, speed)
            self._rig.move_to(self.position, speed)
        self._rig.wait(rest)
