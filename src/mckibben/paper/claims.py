"""The paper's claims and our own questions, each with a verdict and evidence from the results.

The limits of the verdicts, such as 5 % for errors that a figure shows as different, are ours, and the same for all
controllers.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

from mckibben.paper.identification import (
    CHOU,
    CHOU_FITTED,
    EXPERIMENTAL,
    FESTO,
    MARTENS,
    RIG,
    TEST_PRESSURES,
    Identification,
    direction_gap,
)
from mckibben.paper.settings import SETTINGS, StiffnessReference
from mckibben.paper.tracking import BP, DOUBLED_PID, FREE_TUNED_BP, PID, TUNED_BP, TUNED_PID, ControllerRun, Tracking
from mckibben.reachability import StaticEnvelope
from mckibben.result import column, number
from mckibben.simulation import SETTLING_PART
from mckibben.units import bar, deg, quantity

_SIMILAR = 0.1  # of the largest force: loading and unloading that differ by less are similar
_KNEE_RANGE = 55 * deg
_DISTINGUISHABLE = 0.05  # relative difference of two errors that shows in the paper's figures
_VISIBLE = 0.01  # of the amplitude or the step: a smaller disturbance does not show in a figure

_ACCURATE = (
    "the experimental model curve (purple) is very close to the loading data (blue) and the unloading (red) data. But "
    "the experimental model curve (purple) is quite different with the theoretical model curve (green)"
)
_SMALL_ERRORS = (
    "When the PID control method is adopted, under two kinds of the desired stiffness, the tracking errors of the "
    "joint position are large. When the BP control method is adopted, the tracking errors of the joint position are "
    "all small under two kinds of the desired stiffness"
)
_SHORT_ADJUSTMENT = "The joint stiffness adjustment time by PID is relatively longer than that of the BP control method"


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, or a question of ours, with its verdict and evidence.

    Parameters
    ----------
    claim, source
        The statement, and the section or figure that makes it, or that raises the question.
    words
        Quotation of the paper; None marks a question of ours.
    holds
        Whether the numbers agree with the statement.
    evidence
        These numbers.
    needs_muscle
        Whether only the paper's own muscle can test it: here that muscle is simulated with the law that the paper
        fitted to it, and with a friction from the literature, so that the evidence shows consistency and no more.
    """

    claim: str = column(title="statement")
    source: str = column(title="source")
    words: str | None
    holds: bool
    evidence: str
    needs_muscle: bool = False

    @property
    @number(title="verdict")
    def verdict(self) -> str:
        """The verdict in words; of a claim that needs the paper's muscle there is none."""
        if self.needs_muscle:
            return "needs the paper's muscle"
        return "holds" if self.holds else "does not hold"

    @property
    def of_paper(self) -> bool:
        """Whether the paper itself makes the claim."""
        return self.words is not None


def evaluate_claims(
    identification: Identification, joint: dict[str, StaticEnvelope], tracking: Tracking
) -> tuple[Claim, ...]:
    """The six claims of the paper, then our six questions, with their verdicts and evidence.

    Each verdict is a comparison of numbers of the results, which the evidence quotes; it may come out either way.

    Parameters
    ----------
    identification, joint, tracking
        Results of `run_identification`, `run_joint` and `run_tracking`.
    """
    return (
        _closer_than_chou(identification),
        _directions_similar(identification),
        *(_smaller_angle_error(tracking, reference, tuned=False) for reference in StiffnessReference),
        _settles_sooner(tracking, tuned=False),
        _coupled(tracking),
        _closer_on_real_muscles(identification),
        *(_smaller_angle_error(tracking, reference, tuned=True) for reference in StiffnessReference),
        _settles_sooner(tracking, tuned=True),
        _range(joint),
        _learning_is_safe(tracking),
    )


def _closer_than_chou(identification: Identification) -> Claim:
    """Holds if Eq. 2 has the smaller RMSE at each of the four pressures of the second test."""
    retested = identification.retested
    errors = {
        p: (retested.of(EXPERIMENTAL, pressure=p).rmse, retested.of(CHOU, pressure=p).rmse) for p in TEST_PRESSURES
    }
    return Claim(
        "The experimental law is closer to the measured force than Chou's",
        "Model validation, Fig. 4",
        _ACCURATE,
        all(law < chou for law, chou in errors.values()),
        "RMSE on a second test, Eq. 2 / Chou: "
        + ", ".join(f"{law:.1f} / {chou:.1f} N at {p / bar:g} bar" for p, (law, chou) in errors.items())
        + " (simulated rig, muscle of Eq. 3 with friction; our own questions include measured muscles)",
        needs_muscle=True,
    )


def _closer_on_real_muscles(identification: Identification) -> Claim:
    """Holds if Eq. 2, at pressures left out of its fit, has a smaller RMSE than Chou's law fitted to all points."""
    numbers = []
    for name in (MARTENS, FESTO):
        held_out = identification.fits[name].leave_one_pressure_out
        measured = identification.measured[name]
        numbers.append(
            (name, held_out.rmse if held_out else math.nan, measured.of(CHOU).rmse, measured.of(CHOU_FITTED).rmse)
        )
    return Claim(
        "Eq. 2 is closer than Chou's law on a measured map and a manufacturer's chart, at held-out pressures",
        "on Fig. 4",
        None,
        all(law < min(chou, fitted) for _, law, chou, fitted in numbers),
        "; ".join(
            f"{name}: Eq. 2 {law:.2f} N, Chou {chou:.1f} N (braid angle and diameter fitted to these points: "
            f"{fitted:.1f} N)"
            for name, law, chou, fitted in numbers
        ),
    )


def _directions_similar(identification: Identification) -> Claim:
    """Holds if loading and unloading differ by less than 10 % of the largest force."""
    gap, largest = direction_gap(identification.data[RIG])
    band = identification.rig.rig.hysteresis
    return Claim(
        "Loading and unloading are similar",
        "Parameters identification, Fig. 3",
        "PAM exhibits similar mechanical properties during the process of loading and unloading",
        abs(gap) < _SIMILAR * largest,
        f"mean difference {gap:.1f} N, {gap / largest:.1%} of the largest force; the simulated friction of "
        f"+-{band:g} N is taken from the literature, so this checks the order of magnitude, not the paper's muscle",
        needs_muscle=True,
    )


def _compared(tuned: bool) -> tuple[str, str, str]:
    """Names of the PID and BP that are compared, and their gains in words."""
    if tuned:
        return TUNED_PID, TUNED_BP, "gains tuned by an optimiser"
    return PID, BP, "the same moderate gains in both"


def _smaller_angle_error(tracking: Tracking, reference: StiffnessReference, *, tuned: bool) -> Claim:
    """Holds if in both geometries the median RMSE of BP is 5 % below that of PID, and no seed is unstable."""
    pid, bp, gains = _compared(tuned)
    findings, holds = [], True
    for setting in SETTINGS:
        base, learned = tracking.runs[setting.key, reference, pid], tracking.runs[setting.key, reference, bp]
        before, after = base.median("angle_rmse"), learned.median("angle_rmse")
        holds = holds and after < (1 - _DISTINGUISHABLE) * before and learned.unstable == 0
        findings.append(
            f"{setting.name}: PID {before / deg:.3f} deg, BP {after / deg:.3f} deg "
            f"(worst of {tracking.seeds} seeds {learned.worst('angle_rmse') / deg:.3f})"
        )
        if not tuned:  # a higher PID gain explains much of the improvement
            alone = tracking.runs[setting.key, reference, DOUBLED_PID].median("angle_rmse")
            findings[-1] += f", PID with its position gains doubled {alone / deg:.3f} deg"
    return Claim(
        f"BP's position error is smaller than PID's under {reference.value} stiffness ({gains})",
        ("on Fig. 8 " if tuned else "Results and analysis, Fig. 8 ")
        + ("(a)" if reference is StiffnessReference.CONSTANT else "(b)"),
        None if tuned else _SMALL_ERRORS,
        holds,
        f"angle RMSE, median over seeds: {'; '.join(findings)}; smaller means by {_DISTINGUISHABLE * 100:g} % or more, "
        "visible in a figure",
    )


def _cases(tracking: Tracking, *controllers: str) -> Iterator[tuple[str, list[ControllerRun]]]:
    """Both geometries with both stiffness references: a title, and the runs of controllers."""
    for setting, reference in itertools.product(SETTINGS, StiffnessReference):
        yield (
            f"{setting.name}, {reference.value}",
            [tracking.runs[setting.key, reference, name] for name in controllers],
        )


def _settles_sooner(tracking: Tracking, *, tuned: bool) -> Claim:
    """Holds if BP settles sooner by 5 % in most of the four cases, and later in none; a run may never settle."""
    pid, bp, gains = _compared(tuned)
    findings, sooner, later = [], 0, 0
    for title, (base, learned) in _cases(tracking, pid, bp):
        before, after = base.median("stiffness_settling"), learned.median("stiffness_settling")
        first, second = (math.inf if math.isnan(time) else time for time in (before, after))
        sooner += second < (1 - _DISTINGUISHABLE) * first
        later += learned.unstable > 0 or first < (1 - _DISTINGUISHABLE) * second
        findings.append(f"{title}: PID {_seconds(before)}, BP {_seconds(after)}")
    return Claim(
        f"BP's stiffness settles sooner ({gains})",
        "on Fig. 8 (c), (d)" if tuned else "Results and analysis, Fig. 8 (c), (d)",
        None if tuned else _SHORT_ADJUSTMENT,
        later == 0 and sooner > len(findings) / 2,
        f"settling to {SETTLING_PART * 100:g} % of the step size: {'; '.join(findings)}; holds if BP is sooner by "
        f"{_DISTINGUISHABLE * 100:g} % or more in most cases, and later in none",
    )


def _learning_is_safe(tracking: Tracking) -> Claim:
    """Holds if BP on tuned gains, free to double them, is never unstable and nowhere worse than PID."""
    findings, holds = [], True
    for title, (pid, run) in _cases(tracking, TUNED_PID, FREE_TUNED_BP):
        before, after = pid.median("angle_rmse"), run.median("angle_rmse")
        holds = holds and run.unstable == 0 and after <= before
        unstable = f"{run.unstable} of {tracking.seeds} seeds unstable"
        findings.append(
            f"{title}: {unstable if run.unstable else f'RMSE {after / deg:.3g} deg'} (PID {before / deg:.3f} deg)"
        )
    return Claim(
        "BP can be added to any PID (tuned gains, free to change by a factor of 2)",
        "on the choice of BP",
        None,
        holds,
        "; ".join(findings) + ". Learning raises the gains as long as there is an error, whatever the stability margin",
    )


def _coupled(tracking: Tracking) -> Claim:
    """Holds if in one geometry angle and stiffness disturb each other by 1 % or more of amplitude and step."""
    findings, holds = [], False
    for setting in SETTINGS:
        coupling = tracking.coupling[setting.key]
        angle = coupling.angle_by_step / quantity(setting.amplitude, "rad")
        step = abs(quantity(setting.after, "N*m/rad") - quantity(setting.before, "N*m/rad"))
        stiffness = (coupling.stiffness_by_motion - coupling.stiffness_at_rest) / step
        holds = holds or (angle > _VISIBLE and stiffness > _VISIBLE)
        findings.append(
            f"{setting.name}: the stiffness step disturbs the angle by up to {coupling.angle_by_step / deg:.3g} deg "
            f"({angle:.1%} of the amplitude), the motion disturbs the stiffness by {coupling.stiffness_by_motion:.3g} "
            f"N*m/rad RMS ({stiffness:.1%} of the step; {coupling.stiffness_at_rest + 0.0:.3f} at rest)"
        )
    return Claim(
        "Position and stiffness are coupled with each other",
        "Results and analysis",
        "The joint position and stiffness are coupled with each other",
        holds,
        f"{'; '.join(findings)}; holds if both are visible in one geometry ({_VISIBLE:.0%} or more)",
    )


def _range(joint: dict[str, StaticEnvelope]) -> Claim:
    """Holds if the static range of angles of Table 2 as printed is 55 deg or more."""
    printed, statics = joint[SETTINGS[0].key], [(setting.name, joint[setting.key]) for setting in SETTINGS]
    findings = [f"{name}: {static.angle_min / deg:.1f}..{static.angle_max / deg:.1f} deg" for name, static in statics]
    return Claim(
        "The knee reaches 55 deg without the stretch structure (Table 2 as printed)",
        'on "Musculoskeletal leg" (55 deg with the structure)',
        None,
        printed.angle_max - printed.angle_min >= _KNEE_RANGE,
        "static range of angles, with the load of Table 2 and contractions within -3..25 %: " + "; ".join(findings),
    )


def _seconds(value: float) -> str:
    """A settling time in words.

    >>> _seconds(0.1234), _seconds(math.nan)
    ('0.123 s', 'never')
    """
    return "never" if math.isnan(value) else f"{value:.3f} s"
