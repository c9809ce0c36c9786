"""Identification of the air in a muscle from tests with a shut valve: heat to the wall, leak and dead volume."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.calibration.fitting import (
    Calibration,
    JointEstimate,
    OutputErrorFit,
    fit_output_error,
    misfit_remarks,
    noise_of,
    with_derivatives,
)
from mckibben.component.checks import check_positive
from mckibben.errors import IdentificationError
from mckibben.muscle import Specimen
from mckibben.muscle.air import (
    ATMOSPHERE,
    HEAT_CAPACITY_RATIO,
    L_PER_S_BAR,
    TEMPERATURE,
    flow_of_warm_air,
    heat_as_flow,
    mass_flow,
    pressure_rate,
    temperature_rate,
)
from mckibben.numerics.calculus import rk4
from mckibben.numerics.compiled import jit
from mckibben.result import Remark, column
from mckibben.units import bar, cm, kPa, ms, percent, show

if TYPE_CHECKING:
    from mckibben.dataset import Recording

Floats = NDArray[np.float64]

_LOWEST = 0.2 * bar  # of a muscle that is not open to the atmosphere
_LEAK, _DEAD = 1e-3 * L_PER_S_BAR, 1 * cm**3  # units of the search
_ZERO = 20e-3 * bar  # prior standard deviation of the zero of the sensor
_SHARED = 4  # parameters that all phases share


class ShutPhase(NamedTuple):
    """Part of a recording with a shut valve, between two times [s]; pressures [Pa] in blocks, and the muscle's volume.

    `period` is the time between blocks [s].
    """

    begin: float
    end: float
    contraction: float
    volume: float
    pressures: Floats
    period: float


class AirFit(Calibration):
    """Air of a muscle identified from tests with a shut valve, by `identify_air`.

    Attributes
    ----------
    quantities
        Estimates by the names of the fields of valves with air: ``wall_conductance``, h A [W/K] of the wall at
        `contraction` (valves with air take it as constant; its interval is logarithmic), ``leak``, conductance C of the
        leak [m^3/(s*Pa)], negative within the noise if there is none, and ``dead_volume`` [m^3] of tube and fittings,
        if it is observable.
    phases
        Parts of the recordings with a shut valve.
    contraction
        Mean contraction of the phases.
    time_constants
        Time constant [s] of the temperature in each phase.
    residual, noise
        Root mean square of the error of the pressures [Pa], and of the noise of the sensor, after averaging over 5 ms.
    assumed
        Dead volume [m^3] that is assumed because it is not observable at one length; None if it is estimated.
    """

    phases: tuple[ShutPhase, ...]
    contraction: float = column("1", "mean contraction", shown="%", digits=3)
    time_constants: Floats = column("s", "time constant", digits=3)
    residual: float = column("Pa", "residual pressure", shown="kPa", digits=2)
    noise: float = column("Pa", "noise of the pressure", shown="kPa", digits=2)
    assumed: float | None = column("m^3", "assumed dead volume", shown="cm^3", digits=3)

    def verdict(self) -> str:
        """The heat conductance of the wall, and the number of phases."""
        return f"{len(self.phases)} phases with a shut valve, wall conductance {self.quantities['wall_conductance']}"

    def remarks(self) -> list[Remark]:
        """Misfit, short phases, and an assumed dead volume."""
        highest = max(float(phase.pressures.max()) for phase in self.phases)
        remedy = "that the valve was shut, and that length and room stayed the same"
        remarks = misfit_remarks(self.residual, self.noise, highest, "kPa", remedy)
        if all(phase.end - phase.begin < 2 * tau for phase, tau in zip(self.phases, self.time_constants, strict=True)):
            text = f"no phase lasts two time constants of the temperature, {max(self.time_constants):.2g} s"
            remarks.append(Remark.warning("phases", text, "watch the pressure for longer"))
        if self.assumed is not None:
            text = f"the dead volume is not observable at one length, and {show(self.assumed, 'cm^3', 3)} is assumed: "
            text += "the conductances are proportional to the volume"
            remarks.append(Remark.warning("dead_volume", text, "add tests at another length"))
        return remarks


def identify_air(
    recordings: Sequence[Recording], specimen: Specimen, *, contraction: float | None = None, dead_volume: float = 0.0
) -> AirFit:
    r"""Identify the heat to the wall, the leak and the dead volume from tests in which a valve is shut.

    The pressures while the valve is shut are fitted by the energy balance of `AirActuator` in a constant volume, with
    the conductance h A of the wall, a leak to the atmosphere, and pressure and temperature at the start of each phase
    (output-error method; the test is that of docs/valves.md). Without a leak,

    .. math:: p = p_\infty + (p_0 - p_\infty) e^{-t/\tau}, \qquad \tau = \frac{p_\infty V}{(\kappa - 1) h A\, T_0}

    so that tests at one length determine h A / V and C / V; the dead volume is estimated if there are tests at lengths
    whose volumes differ by 10 % or more. A is proportional to the lateral area of the muscle as a cylinder: the result
    holds at the mean contraction of the phases. The intervals contain standard deviations of 5 K of the room, about 20
    degrees C, and of 20 mbar of the zero of the sensor.

    Parameters
    ----------
    recordings
        At least one, sampled at 100 Hz or more. A phase follows a change of the pressure faster than a tenth of the
        fastest one. It begins 20 ms after a tenth of the slow change, as a regulator may hold the pressure until then,
        and lasts 0.5 s or more.
    specimen
        Muscle, for its volume.
    contraction
        Contraction, where the recordings have none.
    dead_volume
        Volume [m^3] of tube and fittings between valve and muscle, where it is not estimated.

    Raises
    ------
    IdentificationError
        If there is no recording, no phase with a shut valve, a saturated sensor, a length that changes, or a gap;
        or if the time constants contradict the volumes, so that a dead volume is negative or without bound.
    RangeError
        If the volume of the specimen is not known.

    References
    ----------
    L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, ch. 7 (output-error models, Gauss-Newton search); the
    procedure is this project's.

    Examples
    --------
    >>> from mckibben import Recording, catalog
    >>> specimen = catalog.specimen("MAS-10-180N-AA-MC-O")
    >>> time = np.arange(0.0, 6.0, 1e-3)
    >>> pressure = 4e5 + 1e5 * np.exp(-(time - 0.5) / 0.5)  # filled within 0.1 s, shut at 0.5 s
    >>> pressure = np.interp(time, [0.0, 0.4, 0.5], [0.0, 0.0, 5e5]) * (time < 0.5) + pressure * (time >= 0.5)
    >>> found = identify_air([Recording.of(time=time, pressure=pressure, force=0 * time, contraction=0.1)], specimen)
    >>> round(float(found.time_constants[0]), 2)
    0.5
    """
    check_positive("identify_air", "m^3", zero=True, dead_volume=dead_volume)
    if not recordings:
        raise IdentificationError("there is no recording", remedy="give at least one")
    specimen.check_volume("the heat to the wall")
    phases = [phase for recording in recordings for phase in _shut_phases(recording, specimen, contraction)]
    if not phases:
        raise IdentificationError(
            "the recordings have no phase in which the pressure relaxes behind a shut valve",
            remedy="fill the muscle fast, shut the valve (a regulator must not hold the pressure) and record 3 s; "
            "then vent in part, shut, and record 3 s",
        )
    volumes = np.array([phase.volume for phase in phases]) + dead_volume
    observable = bool(volumes.max() > 1.1 * volumes.min())
    at = float(np.mean([phase.contraction for phase in phases]))
    areas = np.array([_wall_area(specimen, phase.contraction) for phase in phases]) / _wall_area(specimen, at)
    try:
        fit = _solve(phases, _Problem.of(phases, volumes, areas), observable=observable)
    except np.linalg.LinAlgError as error:
        raise IdentificationError(
            "the pressures do not determine the heat to the wall", remedy="check the contraction of each recording"
        ) from error
    z, unit = fit.minimum.z, np.array([1.0, _LEAK, _DEAD * observable])
    conductance, leak, more = math.exp(float(z[0])), float(z[1]) * _LEAK, float(z[2] * unit[2])
    # the pressures determine h A T0 and C sqrt(T0), where T0 is the temperature of the room, known to 5 K
    room = 5 / TEMPERATURE * np.array([1.0, leak / 2, 0.0])
    spread = np.sqrt(np.diag(np.outer(unit, unit) * fit.minimum.covariance[:3, :3] + np.outer(room, room)))
    _check(
        dead_volume + more, float(spread[2]), max(phase.volume for phase in phases), finite=bool(np.isfinite(z).all())
    )
    rate = (HEAT_CAPACITY_RATIO - 1) * TEMPERATURE * conductance
    ends = np.array([phase.pressures[-1] for phase in phases]) + ATMOSPHERE
    quantities = {
        "wall_conductance": JointEstimate(conductance, conductance * spread[0], math.inf, "W/K", logarithmic=True),
        "leak": JointEstimate(leak, float(spread[1]), math.inf, "m^3/(s*Pa)"),
    }
    if observable:
        quantities["dead_volume"] = JointEstimate(dead_volume + more, float(spread[2]), math.inf, "m^3")
    constants, assumed = ends * (volumes + more) / (rate * areas), None if observable else dead_volume
    return AirFit(quantities, tuple(phases), at, constants, fit.residual, noise_of(fit.errors), assumed)


def _wall_area(specimen: Specimen, contraction: float) -> float:
    """Lateral area [m^2] of a cylinder with the volume and length of a muscle."""
    return 2 * math.sqrt(math.pi * float(specimen.volume(contraction)) * float(specimen.length_at(contraction)))


def _check(dead: float, spread: float, highest: float, *, finite: bool) -> None:
    """Raise `IdentificationError` for a dead volume [m^3] below zero, or that is not determined."""
    if not (finite and -3 * spread <= dead and dead + 2 * spread <= 10 * highest):
        raise IdentificationError(
            "the time constants of the temperature contradict the volumes: dead volume "
            f"{show(dead, 'cm^3', 3)} +- {show(spread, 'cm^3', 3)}",
            value=dead,
            lower=0.0,
            upper=10 * highest,
            unit="m^3",
            remedy="check the contraction of each recording and the volume of the specimen; if the heat to the wall "
            "does not grow with its area, identify each length by itself with a measured dead volume",
        )


def _shut_phases(
    recording: Recording,
    specimen: Specimen,
    contraction: float | None,
    *,
    slowest: float = 10 * ms,
    block: float = 5 * ms,
    fast: float = 0.1,
    shortest: float = 0.5,
    still: float = 0.005,
) -> list[ShutPhase]:
    """Parts of a recording between fast changes of the pressure in which this relaxes.

    Samples, no farther apart than `slowest` [s], are averaged over a `block` [s]. Changes over 20 ms at more than a
    part `fast` of the highest rate are filling or venting. Shorter phases than `shortest` [s] are left out; during a
    phase the contraction changes by no more than `still`.
    """
    from mckibben.dataset.points import saturated_samples  # 0.1 s

    time, pressure = recording.time, recording.table["pressure"].to_numpy()
    if time.size < 2:
        return []
    for end, where in saturated_samples(pressure).items():
        if where.mean() > 1 * percent and pressure[where].mean() > _LOWEST:
            message = f"the pressure sensor is saturated: {int(where.sum())} samples are at the {end} of its range"
            remedy = "fill to a lower pressure, or use a sensor with a wider range"
            raise IdentificationError(message, value=float(pressure[where][0]), unit="Pa", remedy=remedy)
    lengths = recording.contraction
    if lengths is None and contraction is None:
        remedy = "record the length, or give the contraction (--read 'contraction=10 %')"
        raise IdentificationError("the contraction is not known", remedy=remedy)
    period, longest = float(np.median(np.diff(time))), float(np.diff(time).max())
    if round(period, 6) > slowest or longest > 1.5 * period:
        message = f"the samples of a recording are up to {show(longest, 'ms', 3)} apart"
        remedy = "sample at a constant rate of 100 Hz or more, without gaps"
        raise IdentificationError(message, value=longest, upper=slowest, unit="s", remedy=remedy)
    count, window = max(round(block / period), 1), max(round(4 * block / period), 1)
    smooth = np.convolve(pressure, np.ones(window) / window, mode="valid")
    rate = np.pad(np.abs(smooth[window:] - smooth[:-window]), window, mode="constant", constant_values=np.inf)
    slow = rate < fast * rate[np.isfinite(rate)].max(initial=0.0)
    edges = np.flatnonzero(np.diff(slow.astype(int), prepend=0, append=0))
    phases = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        begin, means = _relaxation(pressure[first:last], count)
        begin += first
        if means.size * count * period < shortest:
            continue
        part = slice(begin, begin + means.size * count)
        at = float(lengths[part].mean()) if lengths is not None else contraction
        moved = 0.0 if lengths is None else float(np.ptp(lengths[part]))
        if moved > still:
            message = f"the contraction changes by {moved / percent:.2g} % while the valve is shut"
            remedy = "hold the muscle at a fixed length"
            raise IdentificationError(message, value=moved, upper=still, unit="1", remedy=remedy)
        assert at is not None
        volume = float(specimen.volume(at))
        phases.append(ShutPhase(float(time[begin]), float(time[last - 1]), at, volume, means, count * period))
    return phases


def _relaxation(pressure: Floats, count: int, *, noises: float = 5.0, part: float = 0.005) -> tuple[int, Floats]:
    """First sample, and means of `count` samples, from a tenth of a slow change and 20 ms on; none without a change.

    A change is at least so many times the noise, and such a part of the absolute pressure.
    """
    means = pressure[: pressure.size // count * count].reshape(-1, count).mean(axis=1)
    if means.size < 2 or means.min() < _LOWEST:
        return 0, means[:0]
    tenth = max(means.size // 10, 1)
    distance, noise = np.abs(means - means[-tenth:].mean()), noise_of([means])
    if distance[:tenth].mean() < max(noises * noise, part * (means.mean() + ATMOSPHERE)):
        return 0, means[:0]
    held = int(np.flatnonzero(distance > 0.9 * distance.max())[-1]) + 5  # as noise decides when the tenth is reached
    return held * count, means[held:]


class _Problem(NamedTuple):
    """Phases; parameters: wall, leak, more dead volume, sensor's zero, and pressure and temperature at each start."""

    blocks: NDArray[np.bool_]  # (blocks,), as many as the longest phase has at least
    volumes: Floats  # with the dead volume as stated
    areas: Floats  # of the wall, relative to that at which the conductance holds
    periods: Floats
    start: Floats  # of the search

    @classmethod
    def of(cls, phases: Sequence[ShutPhase], volumes: Floats, areas: Floats, *, multiple: int = 256) -> _Problem:
        """The phases, padded to a multiple of blocks, as each length needs its own program."""
        blocks = np.ones(-(-max(len(phase.pressures) for phase in phases) // multiple) * multiple, bool)
        first, conductances = [], []
        for phase, volume in zip(phases, volumes, strict=True):
            begin, end = phase.pressures[0], phase.pressures[-max(len(phase.pressures) // 10, 1) :].mean()
            left = np.abs(phase.pressures - end) < abs(begin - end) / math.e
            constant = max(float(np.argmax(left)), 1.0) * phase.period
            conductances.append((end + ATMOSPHERE) * volume / ((HEAT_CAPACITY_RATIO - 1) * TEMPERATURE * constant))
            first += [begin / bar, math.log((begin + ATMOSPHERE) / (end + ATMOSPHERE))]
        start = np.array([math.log(float(np.median(np.array(conductances) / areas))), 0.0, 0.0, 0.0, *first])
        return cls(blocks, volumes, areas, np.array([phase.period for phase in phases]), start)


@jit
def _sensitivities(z: Array, problem: _Problem, observable: ArrayLike) -> tuple[Array, Array]:
    """Pressures [Pa] of all phases, shape (phases, blocks), and their derivatives."""

    def simulated(z: Array) -> Array:
        conductance, leak = jnp.exp(z[0]) * problem.areas, z[1] * _LEAK
        room, substeps = problem.volumes + observable * z[2] * _DEAD, 2
        step = problem.periods / substeps

        def rates(state: tuple[Array, Array]) -> tuple[Array, Array]:
            gauge, temperature = state
            absolute = gauge + ATMOSPHERE
            leaking = flow_of_warm_air(-mass_flow(leak, 0.3, absolute, ATMOSPHERE), temperature)  # critical ratio 0.3
            filling = leaking * temperature / TEMPERATURE + heat_as_flow(conductance, temperature)
            rate = pressure_rate(HEAT_CAPACITY_RATIO, absolute, filling, room, 0.0)
            return rate, temperature_rate(temperature, absolute, rate, leaking, room, 0.0)

        def follow(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
            return lax.fori_loop(0, substeps, lambda _, state: rk4(rates, state, step), state), state[0] + _ZERO * z[3]

        begin = z[_SHARED::2] * bar, TEMPERATURE * jnp.exp(z[_SHARED + 1 :: 2])
        return lax.scan(follow, begin, None, problem.blocks.size)[1].T

    return with_derivatives(simulated, z)


def _solve(phases: Sequence[ShutPhase], problem: _Problem, *, observable: bool) -> OutputErrorFit:
    """The fit of the pressures of all phases; only the zero of the sensor, and what is not observable, have a prior."""
    prior = np.zeros(problem.start.size)
    prior[[2, 3]] = float(not observable), 1.0
    measured = [phase.pressures for phase in phases]

    def simulated(z: Floats) -> list[tuple[Floats, Floats]]:
        parts: Any = z, problem, float(observable)
        pairs = zip(*map(np.asarray, _sensitivities(*parts)), strict=True)
        return [
            (pressures[: own.size], slopes[: own.size])
            for (pressures, slopes), own in zip(pairs, measured, strict=True)
        ]

    return fit_output_error(simulated, measured, [problem.start], (1 * kPa) ** 2, (10e-3 * kPa) ** 2, prior=prior)
