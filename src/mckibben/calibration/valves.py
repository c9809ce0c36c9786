"""Identification of valves: the simulated pressures are fitted to the measured ones, under the recorded commands."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from numbers import Real
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.actuator import Actuator, AirState, AirVolume, UnequalValves
from mckibben.actuator.base import air_volumes
from mckibben.calibration.fitting import (
    Calibration,
    LocalMinimum,
    OutputErrorFit,
    UncertainParameter,
    draws,
    fit_output_error,
    misfit_remarks,
    noise_of,
    root_mean_square,
)
from mckibben.calibration.recordings import (
    Floats,
    JointPrior,
    JointRecording,
    Number,
    Samplings,
    check_recording,
    evenly,
    local_cubic,
    sampling_period,
)
from mckibben.component.base import field_quantities
from mckibben.errors import IdentificationError
from mckibben.joint import AntagonisticJoint, ScaledArms
from mckibben.numerics.calculus import rk4
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.plant.base import STABILITY_LIMIT
from mckibben.result import Remark, column
from mckibben.units import bar, cm, kPa, ms

_KNOWN = frozenset({"period", "compensation", "reservoir_volume", "line_conductance"})  # not estimated
_PRIORS = {"supply": "supply", "polytropic_index": "polytropic_index", "critical_ratio": "critical_ratio"}
_SCALES = {
    "dead_volume": 10 * cm**3,
    "leak": 3e-11,
    "delay": 20 * ms,
    "opening_delay": 2 * ms,
}  # of what the first model lacks
_DEAD_ZONE = {"1": 0.05, "Pa": 0.1 * bar}  # scale by unit


class _Record(NamedTuple):
    """Samplings of a recording."""

    angle: Samplings  # smoothed [rad], shape (samples,)
    pressures: tuple[Samplings, Samplings]  # measured [Pa]
    commands: tuple[Samplings, Samplings]  # [Pa]
    period: Number  # [s]
    number: int  # of the recording


class ValveCalibration(Calibration):
    """Valves identified from commanded and measured pressures, by `calibrate_valves`.

    Attributes
    ----------
    quantities
        Estimates by name, such as ``valve1.conductance`` and ``valve2.delay``, and those that are uncertain about the
        joint: ``valve1.pressure_zero`` (reading of the pressure sensor at 0 bar), ``valve1.zero`` (encoder reading at
        angle 0), ``valve1.arm_scale``, ``valve1.volume`` (relative to that of the specimen).
    valves
        Valve of each muscle with the estimates (of one muscle with a return spring).
    recordings
        Those that were fitted.
    residual, noise
        Root mean square of the error of the simulated pressures [Pa], and of the noise of the sensors.
    """

    recordings: tuple[JointRecording, ...]
    valves: tuple[Actuator, ...]
    _problems: dict[int, _Problem]  # by muscle
    _minima: tuple[LocalMinimum, ...]
    residual: float = column("Pa", "residual pressure", shown="kPa", digits=3)
    noise: float = column("Pa", "noise of the pressure", shown="kPa", digits=3)

    figures = ("valve_calibration",)

    def remarks(self) -> list[Remark]:
        """Misfit, quantities that differ between the valves, and those that are far from the first model."""
        remedy = "class of the valve, units, which muscle"
        highest = max(float(recording.pressures.max()) for recording in self.recordings)
        remarks = misfit_remarks(self.residual, self.noise, highest, "kPa", remedy)
        for name in self.differing:
            both = " and ".join(str(self.quantities[f"valve{number}.{name}"]) for number in (1, 2))
            model = "the mean" if name == "delay" else "both valves"
            remarks.append(Remark.warning(name, f"the valves differ: {name} is {both}; the model has {model}"))
        return remarks + super().remarks()

    @property
    def valve(self) -> Actuator:
        """The valve of both muscles: the mean of the estimates, or of their logarithms.

        Where the valves differ significantly, or differed in the first model, `UnequalValves` of both.
        """
        if len(self.valves) == 1:
            return self.valves[0]
        first, second = self._problems.values()
        if first.parameters != second.parameters or set(self.differing) - {"delay"}:
            return UnequalValves(*self.valves)
        z = np.mean([minimum.z for minimum in self._minima], axis=0)
        return _valve_of(first, z, np.mean([minimum.deviations for minimum in self._minima], axis=0))

    @property
    def differing(self) -> tuple[str, ...]:
        """Names of the determined quantities in which the two valves differ by more than three standard deviations."""
        names = (parameter.name for parameter in next(iter(self._problems.values())).parameters)
        pairs = {name: [self.quantities.get(f"valve{number}.{name}") for number in (1, 2)] for name in names}
        return tuple(
            name
            for name, (first, second) in pairs.items()
            if first and second and first.determined and second.determined
            if abs(first.value - second.value) > 3 * math.hypot(first.deviation, second.deviation)
        )

    @property
    def muscles(self) -> tuple[int, ...]:
        """Index of the muscle of each valve: 0 and 1, or one of them with a return spring."""
        return tuple(self._problems)

    @property
    def delays(self) -> tuple[float, ...]:
        """Delay [s] of the commands of each valve."""
        return tuple(self.quantities[f"valve{muscle + 1}.delay"].value for muscle in self.muscles)

    @property
    def delay(self) -> float:
        """Mean delay of the commands [s]."""
        return float(np.mean(self.delays))

    def drawn(self, count: int) -> dict[str, Any]:
        """Return valve and delay of plants, with an array of shape (count,) for each number, as `JointCalibration`."""
        pairs = []
        for problem, minimum in zip(self._problems.values(), self._minima, strict=True):
            own = len(problem.parameters)
            rows = draws(LocalMinimum(minimum.z[:own], np.diag(minimum.deviations[:own] ** 2)), count)
            pairs.append(_valves(_traced(problem), jnp.where(problem.lacking, jnp.maximum(rows, 0.0), rows)))
        valves, delays = zip(*pairs, strict=True)
        return {
            "valve": UnequalValves(*valves) if len(valves) > 1 else valves[0],
            "command_delay": np.mean(delays, axis=0),
        }

    def simulate(self, recording: JointRecording) -> Floats:
        """Return the pressures [Pa] simulated from the commands and angles of a recording, shape (samples, valves)."""
        record = _record_of(recording)
        substeps = _substeps(self._problems, self.valves, [record])
        columns = []
        for (muscle, problem), minimum in zip(self._problems.items(), self._minima, strict=True):
            z = np.append(minimum.z[: len(problem.uncertain)], 0.0)
            columns.append(np.asarray(_sensitivities(_traced(problem), z, numeric(record), muscle, substeps)[0]))
        return np.stack(columns, axis=1)


class _Problem(NamedTuple):
    """First model, and what is uncertain about its valve and delay (the last one), and about the joint."""

    joint: AntagonisticJoint
    valve: Actuator
    parameters: tuple[UncertainParameter, ...]
    nuisances: tuple[UncertainParameter, ...]  # only the first for valves without a volume

    @property
    def uncertain(self) -> tuple[UncertainParameter, ...]:
        """All parameters."""
        return self.parameters + self.nuisances

    @property
    def lacking(self) -> NDArray[np.bool_]:
        """Mask of the parameters that the first model lacks, which are not negative."""
        return np.array([not parameter.logarithmic for parameter in self.parameters])


def calibrate_valves(
    joint: AntagonisticJoint,
    valve: Actuator,
    recordings: Sequence[JointRecording],
    prior: JointPrior | None = None,
    *,
    delay: float | None = None,
) -> ValveCalibration:
    r"""Identify the valve of each muscle from commanded and measured pressures (output-error method).

    Every number of the valve that has a unit and is not given by construction (a period of modulation, a compensation)
    is estimated for each muscle, and the delay of the commands. The pressure of a valve is simulated from the commands,
    and with air from the volume of its muscle along the measured motion:

    .. math:: \sum_k \frac{(p_k - \hat p_k(z))^2}{\sigma^2} + z^T z

    with the variance sigma^2 of `variance_of`. The first second is not fitted;
    docs/calibrate.md has the priors.

    Parameters
    ----------
    joint
        Model of the joint, for the volumes of the muscles.
    valve
        The first model, such as that of a data sheet.
    recordings
        At least one, with `commands`, at 100 Hz or more. Steps and a multisine that both fill and vent the muscles are
        most informative; see `ValveExperiment`.
    prior
        Prior standard deviations.
    delay
        Delay of the commands in the first model [s]; a half-normal prior with a scale of 20 ms by default.

    Raises
    ------
    IdentificationError
        If there is no recording, or one without commands, too short, with gaps, or with constant commands; for valves
        that take openings, or share a reservoir.

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 7 (output-error models, Gauss-Newton search); the
    procedure is this project's.

    Examples
    --------
    >>> import numpy as np
    >>> import mckibben as mk
    >>> time = np.arange(0.0, 6.0, 2e-3)
    >>> command = np.where(time % 2 < 1, 3e5, 1e5)
    >>> pressure, lag = np.full(time.size, 3e5), np.exp(-2e-3 / 0.04)
    >>> for k in range(time.size - 1):
    ...     pressure[k + 1] = command[k] + (pressure[k] - command[k]) * lag
    >>> pair = lambda column: np.stack([column, column], axis=1)
    >>> one = JointRecording(time, 0 * time, pair(pressure), commands=pair(command))
    >>> found = calibrate_valves(mk.catalog.joint("knee-table-2"), mk.FirstOrderValve(0.1), [one])
    >>> round(found.quantities["valve1.time_constant"].value, 4), round(found.delay, 4)
    (0.04, 0.0)
    """
    prior = prior or JointPrior()
    if not recordings:
        raise IdentificationError("there is no recording", remedy="give at least one")
    if valve.direct or valve.reservoir is not None:
        what = "takes openings in place of pressures" if valve.direct else "has a reservoir that all valves share"
        raise IdentificationError(f"the valve {what}, and cannot be identified", remedy="leave that out of its model")
    muscles = [index for index, spring in enumerate(joint.springs) if not spring]  # one beside a return spring
    problems = {index: _problem_of(joint, valve.for_muscle(index), prior, delay) for index in muscles}
    records = list(map(_record_of, recordings, range(len(recordings))))
    fits, valves = _fits(problems, records)
    minima, errors = tuple(fit.minimum for fit in fits), [error for fit in fits for error in fit.errors]
    quantities = {
        f"valve{muscle + 1}.{parameter.name}": parameter.estimate(at, float(deviation))
        for (muscle, problem), minimum in zip(problems.items(), minima, strict=True)
        for parameter, at, deviation in zip(problem.uncertain, minimum.z, minimum.deviations, strict=False)
    }
    parts = tuple(recordings), valves, problems, minima
    return ValveCalibration(quantities, *parts, root_mean_square(errors), noise_of(errors))


def _fits(problems: dict[int, _Problem], records: list[_Record]) -> tuple[list[OutputErrorFit], tuple[Actuator, ...]]:
    """Fits and valves of all muscles, with integration steps that resolve the estimates."""
    substeps, needed = 0, _substeps(problems, [problem.valve for problem in problems.values()], records)
    fits: list[OutputErrorFit] = []
    valves: tuple[Actuator, ...] = ()
    while needed > substeps:
        substeps = needed
        fits = [_solve(problem, records, muscle, substeps) for muscle, problem in problems.items()]
        pairs = zip(problems.values(), (fit.minimum for fit in fits), strict=True)
        valves = tuple(_valve_of(problem, minimum.z, minimum.deviations) for problem, minimum in pairs)
        needed = _substeps(problems, valves, records)
    return fits, valves


def _problem_of(joint: AntagonisticJoint, valve: Actuator, prior: JointPrior, delay: float | None) -> _Problem:
    parameters, kind = [], joint.joint_type
    for name, value, quantity in _numbers(valve):
        own, unit = name.rpartition(".")[2], quantity.unit
        scale = _DEAD_ZONE[unit] if own == "dead_zone" else _SCALES.get(own)
        if value and own not in _KNOWN:
            parameters.append(UncertainParameter(name, unit, float(value), getattr(prior, _PRIORS.get(own, "valve"))))
        elif scale is not None and own not in _KNOWN:
            parameters.append(UncertainParameter(name, unit, 0.0, scale, logarithmic=False))
    deviation = prior.delay if delay else _SCALES["delay"]
    parameters.append(UncertainParameter("delay", "s", delay or 0.0, deviation, logarithmic=bool(delay)))
    nuisances = (
        UncertainParameter("pressure_zero", "Pa", 0.0, prior.pressure_zero, logarithmic=False),
        UncertainParameter("zero", kind.unit("rad"), 0.0, prior.zero_of(kind), logarithmic=False),
        UncertainParameter("arm_scale", "1", 1.0, prior.arm_scale, logarithmic=False),
        UncertainParameter("volume", "1", 1.0, prior.volume, logarithmic=False),
    )
    return _Problem(joint, valve, tuple(parameters), nuisances if valve.holds_air else nuisances[:1])


def _numbers(part: Any, prefix: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Name, value and quantity of each number of a valve, and of one within it (`Tube`); None where there is none."""
    for field in dataclasses.fields(part):
        value, quantity = getattr(part, field.name), field_quantities(type(part)).get(field.name)
        if isinstance(value, Actuator):
            yield from _numbers(value, f"{prefix}{field.name}.")
        elif quantity is not None and (value is None or isinstance(value, Real)):
            lacking = value is None and field.name == "exhaust_conductance"
            yield f"{prefix}{field.name}", part.conductance if lacking else value, quantity


def _with(valve: Any, values: dict[str, Any]) -> Any:
    """The valve with other numbers, named as by `_numbers`."""
    own = {name: value for name, value in values.items() if "." not in name}
    inner = {name.partition(".")[::2]: value for name, value in values.items() if "." in name}
    for part in {part for part, _ in inner}:
        own[part] = _with(getattr(valve, part), {name: value for (of, name), value in inner.items() if of == part})
    return dataclasses.replace(valve, **own)


def _record_of(recording: JointRecording, number: int = 0) -> _Record:
    if recording.commands is None:
        remedy = "give columns command1_bar,command2_bar, and pressure1_bar,pressure2_bar"
        raise IdentificationError("a recording has no commands in addition to its pressures", remedy=remedy)
    check_recording(recording)
    period = sampling_period(recording)
    if not np.ptp(recording.commands, axis=0).any():
        raise IdentificationError("the commands of a recording are constant", remedy="record steps of the pressures")
    angle = local_cubic(evenly(recording.time, recording.angle, period), period)
    pressures, commands = (
        [evenly(recording.time, column, period) for column in pair.T]
        for pair in (recording.pressures, recording.commands)
    )
    return _Record(angle, (pressures[0], pressures[1]), (commands[0], commands[1]), np.float64(period), number)


def _substeps(
    problems: dict[int, _Problem], valves: Sequence[Actuator], records: Sequence[_Record], *, margin: float = 2.0
) -> int:
    """Integration steps per sample that resolve the valves at the smallest volume of a muscle.

    The margin is for estimates that are faster than the first model.
    """
    if not valves[0].holds_air:
        return 1
    joint = next(iter(problems.values())).joint
    angle = np.concatenate([record.angle for record in records])
    first, second = (jnp.asarray(np.mean([record.pressures[i].mean() for record in records])) for i in (0, 1))
    air = air_volumes(joint.routes(angle), (0.0,), (first, second))
    room = min(float(np.min(air[index].volume)) for index in problems)
    fastest = max(valve.fastest_rate_in(room) for valve in valves)
    return math.ceil(margin * fastest * max(float(record.period) for record in records) / STABILITY_LIMIT)


def _valve_of(problem: _Problem, z: Floats, deviations: Floats) -> Actuator:
    """Valve with the estimates; what the first model lacks is left out within two deviations of zero."""
    own, ranges = {}, {name: quantity for name, _, quantity in _numbers(problem.valve)}
    for parameter, at, wide in zip(problem.parameters[:-1], z, deviations, strict=False):
        if parameter.logarithmic or abs(at) > 2 * wide:
            lower, upper = ranges[parameter.name].limits
            own[parameter.name] = float(np.clip(float(parameter.at(at)), lower, upper))
    return _with(problem.valve, own)


def _valve_by(problem: _Problem, z: Array) -> tuple[Any, Array]:
    """Valve, and delay of its commands [s], for parameters in prior standard deviations."""
    *own, delay = (parameter.at(z[number]) for number, parameter in enumerate(problem.parameters))
    fields = {parameter.name: value for parameter, value in zip(problem.parameters[:-1], own, strict=True)}
    return _with(problem.valve, fields), delay


_valves = jit_arrays(jax.vmap(_valve_by, (None, 0)))


def _simulated(problem: _Problem, z: Array, record: _Record, muscle: int, substeps: int) -> Array:
    """Pressure [Pa] of a muscle at the samples, for parameters in prior standard deviations."""
    values = [parameter.at(z[number]) for number, parameter in enumerate(problem.uncertain)]
    (valve, delay), (offset, *others) = _valve_by(problem, z), values[len(problem.parameters) :]
    steps = jnp.arange(record.angle.shape[0])
    late = steps - delay / record.period  # between two samples a valve gets their mean over the period
    commands = jnp.interp(late, steps, jnp.asarray(record.commands[muscle]))
    error = 10 * kPa * z[len(values) + record.number]  # of the first sample, as the pressure at the start
    pressure = jnp.asarray(record.pressures[muscle])[0] - offset + error
    step = record.period / substeps
    if not valve.holds_air:

        def follow(carry: Any, command: Array) -> tuple[Any, Array]:
            (after,), states = valve.all_after((carry[0],), carry[1], (command,), record.period)  # type: ignore[attr-defined]
            return (after, states), carry[0] + offset

        return lax.scan(follow, (pressure, valve.init_states((pressure,))), commands)[1]

    zero, arms, volume = others
    joint = dataclasses.replace(problem.joint, geometry=ScaledArms(problem.joint.geometry, arms))
    pressures = tuple(map(jnp.asarray, record.pressures))
    air = air_volumes(joint.routes(record.angle - zero), (0.0,), pressures)[muscle]  # type: ignore[arg-type]
    room = air.volume * volume + valve.attached_volume
    rate = jnp.diff(room, append=room[-1:]) / record.period  # exactly the changes of the volume: errors do not add up
    air = AirVolume(room, rate, air.by_pressure)

    def follow_air(carry: tuple[Array, AirState], row: tuple[Array, AirVolume]) -> tuple[Any, Array]:
        command, at = row

        def one_step(number: Array, carry: tuple[Array, AirState]) -> tuple[Array, AirState]:
            pressure, state = carry
            state = state._replace(valves=(valve.before_step(state.valves[0], command, pressure, step),))  # type: ignore[attr-defined]

            def rate(carry: tuple[Array, AirState], passed: Array) -> tuple[Array, AirState]:
                moved = at._replace(volume=at.volume + at.rate * passed)
                (slope,), rates = valve.rates((carry[0],), carry[1], (command,), lambda: (moved,))
                return slope, rates

            times = tuple(((number + part) * step,) for part in (0.0, 0.5, 1.0))
            return rk4(rate, (pressure, state), step, times)  # type: ignore[arg-type]

        return lax.fori_loop(0, substeps, one_step, carry), carry[0] + offset

    return lax.scan(follow_air, (pressure, valve.init_states((pressure,))), (commands, air))[1]  # type: ignore[arg-type]


@jit_arrays
def _sensitivities(problem: _Problem, z: ArrayLike, record: _Record, muscle: int, substeps: int) -> tuple[Array, Array]:
    """Pressures [Pa] of a muscle, shape (samples,), and their derivatives, shape (samples, parameters)."""

    def simulated(z: Array) -> tuple[Array, Array]:
        pressures = _simulated(problem, z, record, muscle, substeps)
        return pressures, pressures

    slopes, pressures = jax.jacfwd(simulated, has_aux=True)(jnp.asarray(z))
    return pressures, slopes


def _traced(problem: _Problem) -> _Problem:
    """The problem with the numbers of joint and valve as arrays; the others are part of the program."""
    joint, valve = numeric((problem.joint, problem.valve))
    return problem._replace(joint=joint, valve=valve)


def _solve(
    problem: _Problem, records: list[_Record], muscle: int, substeps: int, *, settling: float = 1.0, share: float = 0.3
) -> OutputErrorFit:
    """The fit of the pressures of a muscle: the problem's parameters, then the starts of the recordings.

    The samples of a settling time [s] are simulated, but not fitted, until the state of the valves at the start is
    forgotten. What the first model lacks begins at a share of its scale.
    """
    begins = [round(settling / float(record.period)) for record in records]
    model, traced = _traced(problem), list(map(numeric, records))
    lacking = np.append(problem.lacking, np.zeros(len(problem.nuisances) + len(records), bool))
    measured = [np.asarray(record.pressures[muscle])[begin:] for record, begin in zip(records, begins, strict=True)]

    def simulated(z: Floats) -> list[tuple[Floats, Floats]]:
        whole = (_sensitivities(model, z, record, muscle, substeps) for record in traced)
        return [
            (np.asarray(pressures)[begin:], np.asarray(slopes)[begin:])
            for (pressures, slopes), begin in zip(whole, begins, strict=True)
        ]

    start = np.where(lacking, share, 0.0)
    return fit_output_error(simulated, measured, start, (5 * kPa) ** 2, (0.05 * kPa) ** 2, positive=lacking)
