"""Identification of creep: the course of the force within plateaus of the pressure at fixed lengths."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from mckibben.dataset import Recording
from mckibben.identification.estimator import Floats, t_quantile
from mckibben.identification.pressure_plateaus import DelayedForce, RecordedBins
from mckibben.identification.relaxation import RelaxationFit
from mckibben.muscle import MaxwellCreep, NoCreep
from mckibben.result import Remark, Result, column
from mckibben.units import percent

_SIGNIFICANT = 0.01
_WIDE = 2.5  # ratio of the ends of its interval above which a time constant is not determined
_ROUNDS = 2
_LARGEST = 0.5  # share of the form


class CreepFit(Result):
    """Creep within plateaus, or its absence; returned by `identify_pressure_creep`.

    Attributes
    ----------
    creep
        `MaxwellCreep` with a `pressure_share`; `NoCreep` if no creep is significant.
    p_value
        Upper bound of the probability of this reduction of the squares if there is no creep (test of the nested models,
        with errors that are correlated within plateaus). Creep is significant below 0.01.
    share, share_interval
        Share of the law that follows with a delay [-], and its 95 % interval; infinite where the data impose no bound
        on the time constant, with which it varies.
    time_constant, time_constant_interval
        Time constant [s] and its 95 % profile interval; 0 or infinite where the data impose no bound.
    residual, creep_force
        Root mean square [N] of the residuals within plateaus, averaged to 16 blocks each, and of the fitted creep.
    common_rate
        Rate of the force common to all plateaus, such as sensor drift [N/s].
    plateaus
        Number of plateaus used.
    notes
        Reasons not to rely on the results.
    """

    creep: MaxwellCreep | NoCreep
    p_value: float = column("1", "probability without creep", digits=2)
    share: float = column("1", "delayed share")
    share_interval: tuple[float, float]
    time_constant: float = column("s", "time constant", digits=3)
    time_constant_interval: tuple[float, float]
    residual: float = column("N", "RMS residual", digits=2)
    creep_force: float = column("N", "RMS creep", digits=2)
    common_rate: float = column("N/s", "rate common to all plateaus", digits=2)
    plateaus: int = column("", "plateaus used")
    notes: tuple[Remark, ...] = ()

    @property
    def is_significant(self) -> bool:
        """True if creep is significant."""
        return isinstance(self.creep, MaxwellCreep)

    def verdict(self) -> str:
        """Return amplitude and time constant with their intervals."""
        if not self.is_significant:
            return f"no significant creep in {self.plateaus} plateaus (p = {self.p_value:.2g})"
        (low, high), (short, long) = self.share_interval, self.time_constant_interval
        span = f"{low / percent:.3g} .. {high / percent:.3g}" if math.isfinite(low) else "not determined"
        return (
            f"creep with a share of {self.share / percent:.3g} % ({span}) and a time constant of "
            f"{self.time_constant:.3g} s ({short:.3g} .. {long:.3g}), 95 % intervals in parentheses"
        )

    def remarks(self) -> Iterable[Remark]:
        """Return the notes."""
        return self.notes


def _result(fit: RelaxationFit, notes: Sequence[Remark]) -> CreepFit:
    """Result of a fit, with the creep if it is significant."""
    share, rate, residuals, _ = fit.solution
    tau, (low, high) = fit.time_constant, fit.time_constant_interval
    half = float(t_quantile(0.95, fit.error[2])) * fit.error[0] if 0 < low and high < math.inf else math.inf
    significant = fit.p_value < _SIGNIFICANT
    notes = list(notes)
    if significant and not high < _WIDE * low:
        bounds = f"at least {low:.3g} s" if high == math.inf else f"{low:.3g} to {high:.3g} s"
        bounds = f"at most {high:.3g} s" if low == 0 else bounds
        remedy = "record longer plateaus, sooner after the step, or more of them"
        notes.append(Remark.warning("time_constant", f"the time constant is not determined: {bounds}", remedy))
    return CreepFit(
        creep=MaxwellCreep(0.0, tau, pressure_share=min(max(share, -_LARGEST), _LARGEST)) if significant else NoCreep(),
        p_value=fit.p_value,
        share=share,
        share_interval=(share - half, share + half),
        time_constant=tau,
        time_constant_interval=(low, high),
        residual=fit.root_mean_square(residuals),
        creep_force=fit.root_mean_square(share * fit.columns(np.array([tau]))[:, 0]),
        common_rate=rate,
        plateaus=int(fit.owner.max()) + 1,
        notes=tuple(notes),
    )


_STRUCTURED, _LEAST_PART = 1e-3, 0.05  # p-value, and part of the creep, of a dependence that is reported
_FURTHER = 4.0  # ratio to the time constant of further ones that are tested


def identify_pressure_creep(recordings: Recording | Sequence[Recording]) -> CreepFit:
    r"""Identify the share of the force that follows steps of the pressure with a delay, at fixed lengths.

    Within plateau j of the pressure

    .. math:: F = a_j + b_j p + f(p) + \varphi \big(f(y) - f(p)\big) + v t, \qquad \dot y = \frac{p - y}{\tau}

    with a free line over the pressure per plateau, a rate v common to all, and the force f over the pressure at each
    length, interpolated between the means of the plateaus (docs/hysteresis.md).

    Parameters
    ----------
    recordings
        Recordings of isometric tests: each at one fixed length, or at several lengths one after another.

    Raises
    ------
    IdentificationError
        If there are fewer than 3 levels of the pressure at each length, or fewer than 6 plateaus.

    Examples
    --------
    Steps between 1, 2 and 3 bar at 100 N/bar, of which 8 % follow with 4 s:

    >>> import numpy as np
    >>> time = np.arange(0, 120, 0.01)
    >>> pressure, delayed = 1e5 * (1 + np.array([0, 1, 2, 1, 0, 2])[(time // 20).astype(int)]), np.full(len(time), 1e5)
    >>> for k in range(1, len(time)):
    ...     delayed[k] = delayed[k - 1] + 0.01 / 4 * (pressure[k - 1] - delayed[k - 1])
    >>> noise = np.random.default_rng(1).normal(0, 0.2, len(time))
    >>> force = 1e-3 * (pressure + 0.08 * (delayed - pressure)) + noise
    >>> fit = identify_pressure_creep(Recording.of(time=time, pressure=pressure, force=force, contraction=0.05))
    >>> round(fit.share, 2), round(fit.time_constant, 1), fit.plateaus
    (0.08, 4.0, 6)
    """
    recordings = [recordings] if isinstance(recordings, Recording) else recordings
    delayed = DelayedForce.of([RecordedBins.of(recording) for recording in recordings])
    fit = delayed.fit()
    for _ in range(_ROUNDS):
        delayed = delayed.corrected(fit)
        fit = delayed.fit()
    share = fit.solution[0]
    notes = [] if fit.p_value >= _SIGNIFICANT else list(_structure(fit, delayed.conditions()))
    if abs(share) > _LARGEST and fit.p_value < _SIGNIFICANT:
        text = f"the share of {share / percent:.3g} % is beyond the 50 % of the form"
        notes.append(Remark.warning("creep", text))
    return _result(fit, notes)


def _structure(fit: RelaxationFit, conditions: dict[str, Floats]) -> Iterable[Remark]:
    """Remarks on significant dependences that the residuals show, and that the form lacks."""
    from scipy.special import fdtrc

    base = fit.columns(np.array([fit.time_constant]))
    base = np.column_stack([base, fit.line])
    creep, scale = base[:, 0], fit.root_mean_square(fit.solution[0] * base[:, 0])
    further = {
        f"the share depends on the {name}": creep[:, None] * (values - values.mean())[fit.owner][:, None]
        for name, values in conditions.items()
    }
    tau = fit.time_constant
    others = np.array([tau * math.exp(1e-3), tau / _FURTHER, tau * _FURTHER])
    further["the relaxation has more than one time constant"] = fit.columns(others)
    for text, columns in further.items():
        every = np.column_stack([base, columns])
        values, residuals, _ = fit.least_squares(every)
        variance, freedom = fit.errors(every, residuals)
        chances = fdtrc(1, freedom[2:], values[2:] ** 2 / variance[2:])
        p_value = min(1.0, len(chances) * float(chances.min()))
        part = fit.root_mean_square(columns @ values[2:]) / scale
        if p_value < _STRUCTURED and part > _LEAST_PART:
            size = f"({part / percent:.2g} % of the creep, p = {p_value:.1g})"
            yield Remark.warning("creep", f"the residuals are structured: {text}, which the form lacks {size}")
