"""Identification of creep after steps of the pressure, from recordings at fixed lengths."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

from mckibben.dataset import Recording
from mckibben.identification.delayed_share import CreepStructure, DelayedShareFit
from mckibben.identification.estimator import t_quantile
from mckibben.identification.pressure_plateaus import RecordedBins
from mckibben.muscle import MaxwellCreep, NoCreep
from mckibben.units import percent, show

_ROUNDS = 2
_SIGNIFICANT = 0.01
_WIDE = 2.5  # ratio of the ends of its interval above which a time constant is not determined


@dataclass(frozen=True, eq=False, repr=False)
class PressureCreepFit:
    """Creep after steps of the pressure, or its absence; returned by `identify_pressure_creep`.

    Attributes
    ----------
    creep
        `MaxwellCreep` with a `pressure_share` and without stiffness; `NoCreep` if no creep is significant.
    p_value
        Upper bound of the probability of this reduction of the squares if there is no creep (test of the nested models,
        with errors that are correlated within plateaus). Creep is significant below 0.01.
    share, share_interval
        Share of the law that follows with a delay [-], and its 95 % interval; infinite where the data impose no bound
        on the time constant, with which the share varies.
    time_constant, time_constant_interval
        Time constant [s] and its 95 % profile interval; 0 or infinite where the data impose no bound.
    residual, creep_force
        Root mean square [N] of the residuals within plateaus, averaged to 16 blocks each, and of the fitted creep.
    common_rate
        Rate of the force common to all plateaus, such as sensor drift [N/s].
    plateaus, contractions
        Number of plateaus used, and contractions [-] at which they were measured (NaN if unknown).
    structure
        Dependences that the residuals show, from the strongest.
    warnings
        Reasons not to rely on the results, without those of `structure`.
    """

    creep: MaxwellCreep | NoCreep
    p_value: float
    share: float
    share_interval: tuple[float, float]
    time_constant: float
    time_constant_interval: tuple[float, float]
    residual: float
    creep_force: float
    common_rate: float
    plateaus: int
    contractions: tuple[float, ...]
    structure: tuple[CreepStructure, ...]
    warnings: tuple[str, ...]

    @property
    def is_significant(self) -> bool:
        """True if creep is significant."""
        return isinstance(self.creep, MaxwellCreep)

    def records(self) -> dict[str, object]:
        """Results as plain data in SI units."""
        time_constant = {"value": self.time_constant, "interval": list(self.time_constant_interval), "unit": "s"}
        return {
            "significant": self.is_significant,
            "p_value": self.p_value,
            "pressure_share": {"value": self.share, "interval": list(self.share_interval), "unit": "1"},
            "pressure_time_constant": time_constant,
            "residual": self.residual,
            "creep_force": self.creep_force,
            "common_rate": self.common_rate,
            "plateaus": self.plateaus,
            "contractions": list(self.contractions),
            "structure": [dataclasses.asdict(one) for one in self.structure],
            "warnings": list(self.warnings),
        }

    def report(self) -> str:
        """Fit as text."""
        known = [show(one, "%", 3) for one in self.contractions if math.isfinite(one)]
        lines = [f"{self.plateaus} plateaus" + (f" at {', '.join(known)} contraction" if known else "")]
        if self.is_significant:
            (low, high), (short, long) = self.share_interval, self.time_constant_interval
            bounds = (
                f"95 % interval {low / percent:.3g} .. {high / percent:.3g} %" if low > -math.inf else "not determined"
            )
            lines += [
                f"significant creep after steps of the pressure (p = {self.p_value:.1g})",
                f"pressure share  {self.share / percent:.3g} %, {bounds}",
                f"time constant   {self.time_constant:.3g} s, 95 % interval {short:.3g} .. {long:.3g} s",
                f"RMS residual {show(self.residual, 'N', 2)}; RMS creep {show(self.creep_force, 'N', 2)}",
            ]
        else:
            lines.append(f"no significant creep after steps of the pressure (p = {self.p_value:.2g})")
        warnings = [*(one.describe() for one in self.structure), *self.warnings]
        return "\n".join([*lines, *(f"warning: {one}" for one in warnings)])

    def __repr__(self) -> str:
        found = "not significant"
        if self.is_significant:
            found = f"{self.share / percent:.3g} %, {self.time_constant:.3g} s"
        return f"<PressureCreepFit: {found}, {self.plateaus} plateaus>"


def identify_pressure_creep(recordings: Recording | Sequence[Recording]) -> PressureCreepFit:
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
    >>> identify_pressure_creep(Recording.of(time=time, pressure=pressure, force=force, contraction=0.05))
    <PressureCreepFit: 8.02 %, 4 s, 6 plateaus>
    """
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    fit = DelayedShareFit.of([RecordedBins.of(one) for one in given])
    tau = fit.search()
    for _ in range(_ROUNDS):
        fit = fit.corrected(tau)
        tau = fit.search()
    solution = fit.solve(tau)
    inflation = fit.inflation(tau)
    p_value = fit.p_value(tau, inflation)
    interval = fit.time_constant_interval(tau, inflation)
    share, (error, freedom) = solution.values[0], fit.error(tau)
    determined = 0 < interval[0] and interval[1] < math.inf
    half = float(t_quantile(0.95, freedom)) * error if determined else math.inf
    significant = p_value < _SIGNIFICANT
    warnings = []
    if significant and not interval[1] < _WIDE * interval[0]:
        warnings.append(_undetermined(interval, fit.longest))
    creep: MaxwellCreep | NoCreep = NoCreep()
    if significant:
        kept = min(max(share, -0.5), 0.5)
        if kept != share:
            warnings.append(f"the share of {share / percent:.3g} % is beyond the 50 % of the form")
        creep = MaxwellCreep(0.0, tau, pressure_share=kept)
    return PressureCreepFit(
        creep=creep,
        p_value=p_value,
        share=share,
        share_interval=(share - half, share + half),
        time_constant=tau,
        time_constant_interval=interval,
        residual=fit.root_mean_square(solution.residuals),
        creep_force=fit.root_mean_square(share * fit.column(tau)),
        common_rate=solution.values[1],
        plateaus=len(fit.plateaus),
        contractions=tuple(dict.fromkeys(one.contraction for one in fit.groups)),
        structure=fit.structure(tau) if significant else (),
        warnings=tuple(warnings),
    )


def _undetermined(interval: tuple[float, float], longest: float) -> str:
    low, high = interval
    if high == math.inf:
        return (
            f"the time constant and the share are not determined: at least {low:.3g} s, as plateaus of {longest:.3g} s "
            "are too short"
        )
    if low == 0:
        return f"the time constant and the share are not determined: at most {high:.3g} s; a slow valve may hide it"
    return f"the time constant is not determined: {low:.3g} to {high:.3g} s; record longer or more plateaus"
