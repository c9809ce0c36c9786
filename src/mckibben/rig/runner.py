"""Runner of a test: steps on a rig, resumable, vented in any case."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from dataclasses import asdict

from mckibben.errors import StoppedError
from mckibben.muscle import Muscle, forces
from mckibben.rig.backend import Channel
from mckibben.rig.bench import Bench
from mckibben.rig.record import PLACE, POINT, Point
from mckibben.rig.session import RigSession
from mckibben.rig.steps import Acquire, Dwell, HoldForce, Move, Pressurise, ProtocolStep, Repeat, Vent, Walk
from mckibben.storage.mcap import Column
from mckibben.units import bar, percent

DONE, RESUMED, BLOCK = "done", "resumed", "block"
"""Kinds of event; a block begins at a `Vent`, from which a test is resumed."""


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


class Runner(StepInterpreter):
    """Runs the steps of a test in a session; in any case the muscle is vented at the end.

    Parameters
    ----------
    session
        Session of the rig.
    done
        Points that earlier sessions have recorded, up to a `Vent`: the steps before it are skipped.
    """

    def __init__(self, session: RigSession, *, done: Sequence[Point] = ()) -> None:
        super().__init__(session.bench)
        self._rig = session
        self._done = done
        self._live = not done
        self._number = 0
        self._held: float | None = None  # force
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
        if not self._live:
            self.position = self._done[number].pulses
            return self._done[number].force
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
            set_pressure=self._rig.set_point,
            set_force=self._held,
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
        self.position = pulses
        if self._live:
            self._rig.move_to(pulses, speed)

    def _rest(self, duration: float) -> None:
        if self._live:
            self._rig.wait(duration)

    def _pressurise(self, pressure: float, rate: float | None, holding: float | None, shut: float | None) -> None:
        self._held = None
        if self._live:
            self._rig.set_pressure(pressure, rate, holding, shut)

    def _vent(self) -> None:
        self._held = None
        if not self._live and self._number >= len(self._done):
            self._live = True
            self._rig.recorder.event(RESUMED, f"at point {self._number}", point=self._number)
        if self._live:
            self._rig.recorder.event(BLOCK, points=self._number)
            self._rig.vent_and_wait()

    def _hold(self, step: HoldForce) -> None:
        self._held = step.force
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
        self.position = self._rig.pulses
