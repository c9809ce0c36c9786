"""Safety monitor of a rig: limits, lost sensors, stale samples, heartbeat, and the stop that vents."""

from __future__ import annotations

import contextlib
import math
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from mckibben.errors import RigError, SignalledError, StoppedError
from mckibben.rig.backend import SHOWN, Backend, Block, Channel, MovingBackend
from mckibben.rig.bench import JointLimits, RigLimits
from mckibben.rig.channels import Channels
from mckibben.storage.files import handle_signals
from mckibben.units import bar, ms

_BUSY = "find out what delayed the device or the host"
_SLOW = "connect it directly, and find out what else delays the line, the device or this computer"
_PLUG = "check its plug and its supply"


class SignalLimits(NamedTuple):
    """Limits of one input, in its unit.

    Attributes
    ----------
    name, column, unit
        Name, column in a block, and unit.
    low, high
        Range of a working sensor.
    lower, upper
        Allowed range.
    rate
        Highest rate [unit/s] between the means over two windows.
    """

    name: str
    column: int
    unit: str
    low: float
    high: float
    lower: float = -math.inf
    upper: float = math.inf
    rate: float = math.inf

    @classmethod
    def of(cls, channel: Channel, column: int, **limits: float) -> SignalLimits:
        """Limits of a channel."""
        name = {"pressure1": "pressure 1", "pressure2": "pressure 2"}.get(channel.name, channel.name)
        return cls(name, column, channel.unit, channel.low, channel.high, **limits)


class StopFlag:
    """Flag that a signal sets, checked once per period or cycle.

    Attributes
    ----------
    signal
        Number of the signal; 0 for none.

    Examples
    --------
    >>> flag = StopFlag()
    >>> flag.check()
    >>> flag.signal = signal.SIGINT
    >>> flag.error().message
    'interrupted by SIGINT (Ctrl-C)'
    """

    def __init__(self) -> None:
        self.signal = 0

    def check(self) -> None:
        """Raise `SignalledError` after a signal."""
        if self.signal:
            raise self.error()

    def error(self) -> SignalledError:
        """Return the error of the signal."""
        name = signal.Signals(self.signal).name + (" (Ctrl-C)" if self.signal == signal.SIGINT else "")
        return SignalledError(f"interrupted by {name}", signal=self.signal)


@contextlib.contextmanager
def stop_on_signals() -> Iterator[StopFlag]:
    """Set a flag on the signals that `handle_signals` handles."""
    flag = StopFlag()

    def note(number: int) -> None:
        flag.signal = number

    with handle_signals(note):
        yield flag


class VentResult(NamedTuple):
    """Result of an emergency stop; None for what was not observed.

    Attributes
    ----------
    pressure
        Highest pressure, as last measured [Pa].
    duration
        Time until all pressures were below the threshold [s].
    position
        Position of the motor at rest [m], since it was opened.
    """

    pressure: float | None = None
    duration: float | None = None
    position: float | None = None


class SafetyMonitor:
    """Checks every sample, sends the heartbeat while all is well, and vents when it is not.

    Parameters
    ----------
    backend
        Backend that is vented.
    signals
        Limits of its inputs.
    maximum_age
        Highest age of the newest sample, and longest time without one [s].
    frozen
        Longest time for which an input may have the same value [s].
    window
        Calls of `check` per window of the rates.
    """

    def __init__(
        self,
        backend: Backend,
        signals: Sequence[SignalLimits],
        *,
        maximum_age: float,
        frozen: float = math.inf,
        window: int = 1,
    ) -> None:
        self.backend = backend
        self.signals = tuple(signals)
        self.stopped_at: float | None = None  # by the clock of the backend [s]
        self._stopped = False
        self._maximum_age, self._frozen, self._width = maximum_age, frozen, window
        self._time: float | None = None  # of the newest sample
        self._constant: dict[str, tuple[float, float]] = {}  # value, and since when
        self._rates_from = -math.inf
        self._window: list[list[float]] = []  # times and values of the present window
        self._before: list[float] | None = None  # means of the window before

    def check(
        self,
        first: float,
        last: float,
        lowest: Sequence[float],
        highest: Sequence[float],
        means: Sequence[float],
        clock: float | None,
    ) -> list[float]:
        """Check consecutive samples.

        Parameters
        ----------
        first, last
            Times of the first and the last sample [s].
        lowest, highest, means
            Values of each input: lowest, highest and mean over the samples.
        clock
            Time of the backend after reading [s]; None to leave the age unchecked.

        Returns
        -------
        list of float
            Means of the inputs with limits.

        Raises
        ------
        StoppedError
            If a limit is exceeded, a sensor is lost, or samples are late, missing or repeated.
        """
        for name, column, unit, low, high, lower, upper, _ in self.signals:
            least, most = lowest[column], highest[column]
            if not (least >= low and most <= high):  # NaN too
                bad = least if not least >= low else most
                raise _exceeded(f"{name} sensor is lost: its reading", bad, low, high, unit, remedy=_PLUG)
            if not (lower <= least and most <= upper):
                remedy = "check the sensor and its calibration, and what moved it; then the limits"
                raise _exceeded(name, least if not lower <= least else most, lower, upper, unit, remedy=remedy)
        if self._frozen < math.inf:
            self._check_constant(lowest, highest, last)
        self._check_time(first, last, clock)
        values = [means[one.column] for one in self.signals]
        self._check_rates((first + last) / 2, values)
        return values

    def heartbeat(self) -> None:
        """Reset the watchdog of the rig; not after a stop, so that a rig whose `vent` failed vents by itself."""
        if not self._stopped:
            self.backend.heartbeat()

    def stop(self) -> None:
        """Vent, and end the heartbeat."""
        self._stopped = True
        self.backend.vent()
        if self.stopped_at is None:
            with contextlib.suppress(Exception):
                self.stopped_at = self.backend.clock()

    @contextlib.contextmanager
    def guard(self) -> Iterator[None]:
        """Stop before any exception leaves the block."""
        try:
            yield
        except BaseException:
            self.stop()
            raise

    def observe_venting(
        self, record: Callable[[Block], object], *, threshold: float, duration: float, samples: int
    ) -> VentResult:
        """Read and record after `stop` until all pressures are below a threshold, by samples taken after it.

        Parameters
        ----------
        record
            Is called with each block.
        threshold
            Pressure below which a muscle is vented [Pa].
        duration
            Longest observation [s].
        samples
            Samples per block, for which it waits longer than before the vent: a late one costs nothing now.
        """
        backend, rate, found = self.backend, self.backend.rate, VentResult()
        pressures = [one for one in self.signals if one.name.startswith("pressure")]
        try:
            begun = backend.clock() if self.stopped_at is None else self.stopped_at
            newest = self._time if self._time is not None else begun
            left = round((max(begun - newest, 0.0) + 3 * duration) * rate)  # even if its clock stands still
            while left > 0:
                waiting = int((backend.clock() - newest) * rate)
                block = backend.read(min(max(waiting, samples), MOST_READ))
                backend.vent()
                record(block)
                newest, left = float(block.time[-1]), left - len(block.time)
                fresh = block.values[block.time > begun - 1 / rate]
                if not len(fresh):
                    continue
                read = fresh[:, [one.column for one in pressures]]
                low, high = ([getattr(one, end) for one in pressures] for end in ("low", "high"))
                if not ((low <= read) & (read <= high)).all():
                    return VentResult()
                highest = float(read.mean(axis=0).max())
                empty = highest <= threshold
                still = float(block.position[-1]) if np.ptp(block.position) < STILL else None
                found = VentResult(highest, max(newest - begun, 0.0) if empty else None, still)
                if empty or newest >= begun + duration:
                    return found
        except (Exception, KeyboardInterrupt):  # it was vented before
            return VentResult()
        return found

    def _check_constant(self, lowest: Sequence[float], highest: Sequence[float], time: float) -> None:
        for one in self.signals:
            least, most = lowest[one.column], highest[one.column]
            value, since = self._constant.get(one.name, (math.nan, time))
            since = since if least == most == value else time
            self._constant[one.name] = least, since
            if time - since > self._frozen and one.low > -math.inf:
                message = f"the {one.name} sensor is lost: it has given {value:.6g} {one.unit} for {time - since:.3g} s"
                raise StoppedError(message, field=one.name, value=value, unit=one.unit, remedy=_PLUG)

    def _check_time(self, first: float, last: float, clock: float | None) -> None:
        before, self._time = self._time, last
        if before is not None and not first > before:
            raise StoppedError(
                f"the time of the samples jumps back, from {before:.6g} s to {first:.6g} s",
                remedy="check the device and its driver",
            )
        if before is not None and not first - before <= self._maximum_age:
            dropped = round((first - before) * self.backend.rate) - 1
            message = f"{dropped} samples were dropped: the gap is {first - before:.3g} s"
            raise StoppedError(message, value=first - before, upper=self._maximum_age, unit="s", remedy=_BUSY)
        if clock is not None and not abs(clock - last) <= self._maximum_age:
            message = f"the newest sample is {clock - last:.3g} s old"
            raise StoppedError(message, value=clock - last, upper=self._maximum_age, unit="s", remedy=_BUSY)

    def check_latency(self, age: float = 0.0) -> None:
        """Check how old a sample can be that arrived an age [s] ago; `StoppedError` beyond the limit."""
        latency = self.backend.latency
        if not age + latency <= self._maximum_age:
            message = f"the line is slow: a message and its answer take {latency:.3g} s"
            raise StoppedError(message, value=latency, upper=self._maximum_age, unit="s", remedy=_SLOW)

    def _check_rates(self, time: float, values: Sequence[float]) -> None:
        """Check the rates of change between the means over two consecutive windows."""
        self._window.append([time, *values])
        if len(self._window) < self._width:
            return
        means = [sum(column) / self._width for column in zip(*self._window, strict=True)]
        self._window.clear()
        before, self._before = self._before, means
        if before is None or time <= self._rates_from:
            return
        for one, new, old in zip(self.signals, means[1:], before[1:], strict=True):
            rate = abs(new - old) / max(means[0] - before[0], 1e-9)
            if not rate <= one.rate:
                raise _exceeded(f"rate of {one.name}", rate, -math.inf, one.rate, one.unit, per="/s")


STILL = 5e-6
"""Differences of positions of the motor [m] below which it stands still."""

MOST_READ = 1000
"""Samples that are read at once."""

PROBED = 0.5 * bar
"""Pressure [Pa] at which sensors, valves and supply are checked before a run of hardware."""


def _exceeded(
    name: str, value: float, lower: float, upper: float, unit: str, *, per: str = "", remedy: str = ""
) -> StoppedError:
    shown, scale = SHOWN.get(unit, (unit, 1.0))
    limits = (
        "not a number"
        if math.isnan(value)
        else f"beyond the limit of {upper / scale:.4g} {shown}{per}"
        if lower == -math.inf
        else f"outside the limits of {lower / scale:.4g} to {upper / scale:.4g} {shown}{per}"
    )
    return StoppedError(
        f"the {name} of {value / scale:.4g} {shown}{per} is {limits}",
        field=name,
        value=value,
        lower=lower,
        upper=upper,
        unit=unit + per,
        remedy=remedy,
    )


class BlockMeans(NamedTuple):
    """Means of a block.

    Attributes
    ----------
    time
        Time of the last sample [s].
    force, pressure
        Mean force [N] and pressure [Pa].
    position
        Position of the motor at the end [m], positive = stretched.
    """

    time: float
    force: float
    pressure: float
    position: float


class RigMonitor(SafetyMonitor):
    """Safety monitor of a test rig: also the travel of the motor, and the settling of the set pressure.

    Parameters
    ----------
    backend, limits
        Backend and its limits.
    origin
        Position of the motor when it was opened [m], from the mounted one.
    """

    def __init__(self, backend: MovingBackend, limits: RigLimits, origin: float = 0.0) -> None:
        bounds = {
            "force": {"upper": limits.force},
            "pressure": {"upper": limits.pressure, "rate": limits.pressure_rate},
        }
        signals = [SignalLimits.of(one, k, **bounds.get(one.name, {})) for k, one in enumerate(backend.inputs)]
        names = [signal.name for signal in signals]
        if missing := bounds.keys() - {*names}:
            raise RigError(f"the rig has no {' and no '.join(sorted(missing))}", remedy="connect them by these names")
        self._force, self._pressure = names.index("force"), names.index("pressure")
        ends = -limits.shorten - 1e-9, limits.stretch + 1e-9
        signals.append(SignalLimits("travel", len(signals), "m", -math.inf, math.inf, *ends))
        super().__init__(backend, signals, maximum_age=limits.gap, frozen=limits.frozen)
        self.limits = limits
        self.sums = np.zeros(len(backend.inputs))
        self._motor, self._origin = backend, origin
        self._setpoint: float | None = None
        self._set_at = 0.0

    def stop(self) -> None:
        try:
            super().stop()
        finally:
            self._motor.stop()

    def expect(self, pressure: float | None, time: float, *, venting: bool = False) -> None:
        """Take a pressure [Pa] set at a time [s] as the setpoint; None for none."""
        self._setpoint, self._set_at = pressure, time
        if venting:
            self._rates_from = time + self.limits.settling

    def check_block(self, block: Block, clock: float) -> BlockMeans:
        """Return the means of a block.

        Parameters
        ----------
        block
            Samples of all inputs.
        clock
            Time of the backend after reading [s].

        Raises
        ------
        StoppedError
            As `SafetyMonitor.check`; or if the travel is outside the limits, or the pressure does not settle.
        """
        columns = np.ascontiguousarray(block.values.T)  # NumPy is several times as fast along the last axis
        self.sums = columns.sum(axis=1)
        first, last = float(block.time[0]), float(block.time[-1])
        start, end = (float(position) + self._origin for position in block.position[[0, -1]])
        values = self.check(
            first,
            last,
            [*columns.min(axis=1).tolist(), min(start, end)],
            [*columns.max(axis=1).tolist(), max(start, end)],
            [*(self.sums / columns.shape[1]).tolist(), end],
            clock,
        )
        pressure, setpoint = values[self._pressure], self._setpoint
        since = last - self._set_at
        error = 0.0 if setpoint is None or since <= self.limits.settling else abs(pressure - setpoint)
        if setpoint is not None and error > self.limits.pressure_error:
            message = (
                f"the pressure does not follow: {pressure / bar:.3g} bar {since:.3g} s after {setpoint / bar:.3g} "
                "bar were set"
            )
            raise StoppedError(message, value=pressure, unit="Pa", remedy="check the supply, the valve and the muscle")
        return BlockMeans(last, values[self._force], pressure, values[-1])


class JointMonitor(SafetyMonitor):
    """Safety monitor of a joint rig: also the deviation of the pressures from their commands.

    Parameters
    ----------
    backend, limits
        Backend with the inputs of `channels`, and its limits.
    period
        Sampling period [s].
    channels
        Names of joints and muscles.
    ranges
        Lowest and highest value by input, in place of those of `limits`.
    """

    def __init__(
        self,
        backend: Backend,
        limits: JointLimits,
        period: float,
        channels: Channels = Channels(),  # noqa: B008
        ranges: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    ) -> None:
        angle = limits.lowest_angle, limits.highest_angle, limits.angle_rate
        pressure = -math.inf, limits.pressure, limits.pressure_rate
        bounds = dict.fromkeys(channels.by_joint("angle"), angle)
        bounds |= dict.fromkeys(channels.by_muscle("pressure"), pressure)
        columns = {channel.name: column for column, channel in enumerate(backend.inputs)}
        signals = []
        for name, (low, high, rate) in bounds.items():
            lower, upper = ranges.get(name, (low, high))
            channel = backend.inputs[columns[name]]
            signals.append(SignalLimits.of(channel, columns[name], lower=lower, upper=upper, rate=rate))
        super().__init__(backend, signals, maximum_age=limits.late, window=max(1, round(limits.window / period)))
        self.limits = limits
        self.share = min(1.0, period / limits.following)  # of a new error in the filtered one
        self._first = len(channels.joints)  # pressure among the signals
        self.errors = [0.0] * len(channels.muscles)  # of the pressures from their commands, filtered [Pa]

    def check_sample(
        self, time: float, values: Sequence[float], commands: Sequence[float] | None, clock: float | None
    ) -> None:
        """Check one sample.

        Parameters
        ----------
        time
            Its time [s].
        values
            Values of all inputs.
        commands
            Commands until then [Pa]; None where the pressures need not follow.
        clock
            Time of the backend after reading [s]; None to leave the age unchecked.

        Raises
        ------
        StoppedError
            As `SafetyMonitor.check`; or if a pressure stays off its command.
        """
        checked = self.check(time, time, values, values, values, clock)
        if commands is None:
            return
        errors, share, limit = self.errors, self.share, self.limits.pressure_error
        for i, (pressure, command) in enumerate(zip(checked[self._first :], commands, strict=True)):
            errors[i] += share * (pressure - command - errors[i])
            if abs(errors[i]) > limit:
                raise StoppedError(
                    f"{self.signals[self._first + i].name} does not follow its command: it is {pressure / bar:.3g} "
                    f"bar, and was {abs(errors[i]) / bar:.3g} bar {'above' if errors[i] > 0 else 'below'} the command "
                    f"on average over {self.limits.following / ms:.3g} ms",
                    value=pressure,
                    unit="Pa",
                    remedy="check the supply, the valve, the muscle and the sensor",
                )
