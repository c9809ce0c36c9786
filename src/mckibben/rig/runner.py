"""Runs the steps of a test on a rig: reads, watches, records; and vents when anything is wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mckibben.errors import StoppedError
from mckibben.muscle import Muscle, forces
from mckibben.rig.backend import MovingBackend
from mckibben.rig.bench import Bench
from mckibben.rig.record import PLACE, POINT, Column, Point
from mckibben.rig.recorder import Recorder
from mckibben.rig.session import ProgressCallback, RigSession
from mckibben.rig.steps import Acquire, Dwell, HoldForce, Move, Pressurise, Repeat, Step, Vent, Walk
from mckibben.units import bar, mm, percent

DONE, RESUMED = "done", "resumed"
"""Kinds of event."""

_TURNING = 5 * mm  # way before a turn that is gone again, so that friction has changed sides at it


def columns_of(inputs: Sequence[str]) -> tuple[Column, ...]:
    """The columns of a test's record: what was read, as it was read."""
    volts = (Column(name, "V", "float32") for name in inputs)
    return (Column("time", "s"), *volts, Column("pulses", "1", "int32"), Column("plateau", "1", "int32"))


@dataclass
class _Target:
    """What the steps have asked for; where a test goes on, it is brought about before the first point that lacks.

    `turn` is where the way now followed began, `before` where the one before that did, and `via` the pressure before
    the one that is set, so that a test that goes on comes from the same side. `pressed` is where it was set: the muscle
    has been there at `via`, and may not bear it elsewhere.
    """

    pulses: int = 0
    pressed: int = 0
    turn: int = 0
    before: int = 0
    pressure: float = 0.0
    via: float = 0.0
    holding: float | None = None
    hold: HoldForce | None = None
    speed: float = 0.0
    rest: float = 0.0


class Runner:
    """Runs steps. `run` returns when all are done, vented; whatever else happens, it vents, records why, and raises.

    Parameters
    ----------
    backend
        Opened by `run` and closed by it.
    bench
        What stands on it.
    recorder
        Takes the samples; closed by whoever opened it.
    done
        Points that were recorded before, where a test goes on: those from the first to the one before the first that
        lacks. They are not done again.
    origin
        Where the motor stands when the backend is opened [pulses], from where the muscle was mounted.
    since
        The record's clock when this begins [s].
    report
        Is told of progress.

    Notes
    -----
    What comes after a stop is watched and recorded for up to 10 s, until the muscle is empty; see `RigSession` for the
    cycle.
    """

    def __init__(
        self,
        backend: MovingBackend,
        bench: Bench,
        recorder: Recorder,
        *,
        done: Sequence[Point] = (),
        origin: int = 0,
        since: float = 0.0,
        report: ProgressCallback | None = None,
    ) -> None:
        self.backend = backend
        self.bench = bench
        self.recorder = recorder
        self._rig = RigSession(backend, bench, recorder, origin=origin, since=since, report=report)
        self._done = done
        self._target = _Target()
        self._live = not done
        self._number = 0
        self._repeat = 0
        self._walked_from = 0
        self._speed = bench.drive.fastest / bench.drive.pulses_per_metre / 4  # where no step says another

    def interrupt(self, signal: int, name: str) -> None:
        """Stop after the cycle that runs; may be called from a signal handler."""
        self._rig.interrupt(signal, name)

    def run(self, steps: Sequence[Step]) -> None:
        """Open the backend, do the steps, vent, close.

        Raises
        ------
        RigError
            If the backend cannot be opened.
        SignalledError
            If it was interrupted.
        StoppedError
            If it was stopped for any other reason; the cause is chained. The muscle has been vented, and the reason
            recorded.
        """
        backend = self.backend
        try:
            backend.open()
        except BaseException:
            backend.close()
            raise
        try:
            with self._rig.monitor.guard():
                self._rig.begin()
                if self._live:  # the steps begin where the muscle was mounted
                    self._rig.move_to(0, self._speed)
                self._do(steps)
                self._vent()
                self.recorder.event(DONE, "all steps are done", points=self._number, pulses=self._rig.pulses)
        except BaseException as error:
            raise self._rig.record_stop(error) from error
        finally:
            try:
                backend.vent()
            finally:  # even where another signal comes in between
                backend.close()

    # the steps

    def _do(self, steps: Sequence[Step]) -> None:
        for step in steps:
            match step:
                case Repeat():
                    around = self._repeat
                    for number in range(step.times):
                        self._repeat = number
                        self._do(step.steps)
                    self._repeat = around
                case Move():
                    self._move_to(self.bench.pulses_at(step.to), step.speed)
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
        begin = self._target.pulses
        to = self._walked_from if walk.to is None else self.bench.pulses_at(walk.to)
        self._walked_from = begin
        step = self.bench.drive.nearest(walk.step)
        sign = 1 if to > begin else -1
        forces = [self._acquire(walk.acquire).force]
        slack = 0
        for count in range(1, (abs(to - begin) + step // 100) // step + 1):
            if walk.force is not None and forces[-1] + 1.5 * (forces[-1] - (forces[-2:][0])) > walk.force:
                return  # the force rises ever faster with the stretch: half of a rise comes on top
            slack = slack + 1 if forces[-1] <= walk.slack_force else 0
            if walk.slack is not None and slack >= walk.slack:
                return
            self._move_to(begin + sign * step * count, walk.speed)
            self._rest(walk.dwell)
            forces.append(self._acquire(walk.acquire).force)

    def _acquire(self, acquire: Acquire) -> Point:
        number, self._number = self._number, self._number + 1
        if number < len(self._done):
            point = self._done[number]
            if self._target.holding is not None:
                self._target.before = self._target.turn = self._target.pressed = point.pulses
            self._target.pulses = point.pulses
            return point
        self._go_live()
        bench, recorder = self.bench, self.recorder
        every = max(1, round(bench.rate * acquire.duration / acquire.samples))
        rows = (acquire.samples - 1) * every + 1
        first, pulses = recorder.rows, self._rig.pulses
        taken = self._rig.acquire(rows, number)
        force, pressure = (float(bench.calibrations[name].si(taken.means[name])) for name in ("force", "pressure"))
        point = Point(
            number=number,
            first=first,
            rows=rows,
            every=every,
            samples=acquire.samples,
            time=taken.begun,
            pulses=pulses,
            contraction=bench.contraction_at(pulses),
            force=force,
            pressure=pressure,
            set_pressure=self._target.pressure,
            direction=acquire.direction,
            phase=acquire.phase,
            repeat=self._repeat,
            keep=acquire.keep,
        )
        self._hold_against_law(point)
        recorder.event(POINT if acquire.keep else PLACE, **point.to_json())
        return point

    def _hold_against_law(self, point: Point) -> None:
        """Raise where the muscle pulls otherwise than it should."""
        of, most = self.bench.of, self.bench.limits.deviation
        if most == math.inf or not isinstance(of, Muscle):
            return
        there = float(forces(of, point.contraction, point.pressure))
        if not abs(point.force - there) <= most:
            raise StoppedError(
                f"the muscle pulls {point.force:.4g} N at {point.contraction / percent:.4g} % and "
                f"{point.pressure / bar:.3g} bar, and by its law {there:.4g} N",
                value=point.force,
                unit="N",
                remedy="check its clamps, the motor and the force sensor, or raise limits.deviation",
            )

    def _move_to(self, pulses: int, speed: float) -> None:
        target = self._target
        if (pulses - target.pulses) * (target.pulses - target.turn) < 0:
            target.before, target.turn = target.turn, target.pulses
        target.pulses, target.speed, target.rest = pulses, speed, 0.0
        if self._live:
            self._rig.move_to(pulses, speed)

    def _rest(self, duration: float) -> None:
        self._target.rest += duration
        if self._live:
            self._rig.wait(duration)

    def _pressurise(self, pressure: float, rate: float | None, holding: float | None) -> None:
        target = self._target
        target.via, target.pressure, target.holding, target.rest = target.pressure, pressure, holding, 0.0
        target.hold, target.pressed = None, target.pulses
        if holding is None:
            target.before = target.turn = target.pulses
        if self._live:
            self._rig.set_pressure(target.via, pressure, rate, holding)

    def _vent(self) -> None:
        self._target.via = self._target.pressure = self._target.rest = 0.0
        self._target.holding = self._target.hold = None
        self._target.before = self._target.turn = self._target.pressed = self._target.pulses
        if self._live:
            self._rig.vent_and_wait()

    def _hold(self, step: HoldForce) -> None:
        self._target.rest, self._target.hold = 0.0, step
        if not self._live:
            return
        deadline = self._rig.now + step.longest
        while abs(self._rig.read_cycle().force - step.force) > step.tolerance or self.backend.moving:
            self._rig.step_towards(step.force, step.speed)
            if self._rig.now > deadline:
                raise StoppedError(
                    f"the force of {step.force:g} N was not reached within {step.longest:g} s",
                    remedy="choose one that the muscle has at this pressure within its range",
                )
        self._target.pulses = self._target.turn = self._target.before = self._rig.pulses

    def _go_live(self) -> None:
        """Where a test goes on: bring about what the steps done before had, from the side they had it from."""
        if self._live:
            return
        self._live = True
        target = self._target
        rest = target.rest
        speed = target.speed or self._speed
        self.recorder.event(RESUMED, f"at point {self._number - 1}", point=self._number - 1)
        self._rig.vent_and_wait()
        self._rig.move_to(target.pressed, speed)
        if target.via > 0:
            self._rig.set_pressure(0.0, target.via, 1 * bar, target.holding)
        if target.pressure != 0:
            self._rig.set_pressure(
                target.via, target.pressure, 1 * bar if target.holding is not None else None, target.holding
            )
        if target.hold is not None:
            self._hold(target.hold)
        else:
            most = round(_TURNING * self.bench.drive.pulses_per_metre)
            self._rig.move_to(target.turn + max(-most, min(most, target.before - target.turn)), speed)
            self._rig.move_to(target.turn, speed)
            self._rig.move_to(target.pulses, speed)
        self._rig.wait(rest)
