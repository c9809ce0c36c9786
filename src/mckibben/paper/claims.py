"""Claims of the paper, each with a verdict and evidence from the results."""

from __future__ import annotations

import math
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
    JointMap,
    direction_gap,
)
from mckibben.paper.settings import SETTINGS, StiffnessReference
from mckibben.paper.tracking import BP, DOUBLED_PID, FREE_TUNED_BP, PID, TUNED_BP, TUNED_PID, Tracking
from mckibben.simulation import SETTLING_PART
from mckibben.units import bar, deg, quantity

_SIMILAR = 0.1  # of the largest force: loading and unloading that differ by less are similar
_KNEE_RANGE = 55 * deg
_DISTINGUISHABLE = 0.05  # relative difference of two errors that shows in the paper's figures
_VISIBLE = 0.01  # of the amplitude or the step: a smaller disturbance does not show in a figure


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, or a question of ours, with a verdict and the numbers behind it."""

    claim: str
    source: str
    holds: bool
    evidence: str
    of_paper: bool = True


def evaluate_claims(
    identification: Identification, joint: dict[str, JointMap], tracking: Tracking
) -> tuple[Claim, ...]:
    """All claims with their verdicts."""
    moderate, tuned = "the same moderate gains in both", "gains tuned by an optimiser"
    return (
        _closer_than_chou(identification),
        _closer_on_real_muscles(identification),
        _directions_similar(identification),
        *(_smaller_angle_error(tracking, reference, PID, BP, moderate) for reference in StiffnessReference),
        *(_smaller_angle_error(tracking, reference, TUNED_PID, TUNED_BP, tuned) for reference in StiffnessReference),
        _settles_sooner(tracking, PID, BP, moderate),
        _settles_sooner(tracking, TUNED_PID, TUNED_BP, tuned),
        _coupled(tracking),
        _range(joint),
        _learning_is_safe(tracking),
    )


def _closer_than_chou(identification: Identification) -> Claim:
    retested = identification.retested
    found = {
        p: (retested.of(EXPERIMENTAL, pressure=p).rmse, retested.of(CHOU, pressure=p).rmse) for p in TEST_PRESSURES
    }
    return Claim(
        "The experimental law is closer to the measured force than Chou's",
        "Fig. 4",
        all(law < chou for law, chou in found.values()),
        "RMSE on a second test, Eq. 2 / Chou: "
        + ", ".join(f"{law:.1f} / {chou:.1f} N at {p / bar:g} bar" for p, (law, chou) in found.items())
        + " (simulated rig, muscle of Eq. 3 with friction; for measured muscles see our question below)",
    )


def _closer_on_real_muscles(identification: Identification) -> Claim:
    numbers = []
    for name in (MARTENS, FESTO):
        held_out = identification.fits[name].leave_one_pressure_out
        measured = identification.measured[name]
        numbers.append(
            (name, held_out.rmse if held_out else math.nan, measured.of(CHOU).rmse, measured.of(CHOU_FITTED).rmse)
        )
    return Claim(
        "Eq. 2 is closer than Chou's law on a measured map and a manufacturer's chart, at held-out pressures",
        "asked by us, of Fig. 4",
        all(law < min(chou, fitted) for _, law, chou, fitted in numbers),
        "; ".join(
            f"{name}: Eq. 2 {law:.2f} N, Chou {chou:.1f} N (braid angle and diameter fitted to these points: "
            f"{fitted:.1f} N)"
            for name, law, chou, fitted in numbers
        ),
        of_paper=False,
    )


def _directions_similar(identification: Identification) -> Claim:
    gap, largest = direction_gap(identification.data[RIG])
    band = identification.rig.rig.hysteresis
    return Claim(
        "Loading and unloading are similar",
        "Fig. 3",
        abs(gap) < _SIMILAR * largest,
        f"mean difference {gap:.1f} N, {gap / largest:.1%} of the largest force; the simulated friction of "
        f"+-{band:g} N is taken from the literature, so this checks the order of magnitude, not the paper's muscle",
    )


def _smaller_angle_error(tracking: Tracking, reference: StiffnessReference, pid: str, bp: str, gains: str) -> Claim:
    parts, holds = [], True
    for setting in SETTINGS:
        base, learned = tracking.runs[setting.key, reference, pid], tracking.runs[setting.key, reference, bp]
        before, after = base.median("angle_rmse"), learned.median("angle_rmse")
        holds = holds and after < (1 - _DISTINGUISHABLE) * before and learned.unstable == 0
        parts.append(
            f"{setting.name}: PID {before / deg:.3f} deg, BP {after / deg:.3f} deg "
            f"(worst of {tracking.seeds} seeds {learned.worst('angle_rmse') / deg:.3f})"
        )
        if pid == PID:  # much of what BP gains is gain
            alone = tracking.runs[setting.key, reference, DOUBLED_PID].median("angle_rmse")
            parts[-1] += f", PID with its position gains doubled {alone / deg:.3f} deg"
    return Claim(
        f"BP's position error is smaller than PID's under {reference.value} stiffness ({gains})",
        "Fig. 8 (a)" if reference is StiffnessReference.CONSTANT else "Fig. 8 (b)",
        holds,
        f"angle RMSE, median over seeds: {'; '.join(parts)}; smaller means by {_DISTINGUISHABLE * 100:g} % or more, "
        "visible in a figure",
    )


def _settles_sooner(tracking: Tracking, pid: str, bp: str, gains: str) -> Claim:
    parts, sooner, later = [], 0, 0
    for setting in SETTINGS:
        for reference in StiffnessReference:
            base, learned = tracking.runs[setting.key, reference, pid], tracking.runs[setting.key, reference, bp]
            before, after = base.median("stiffness_settling"), learned.median("stiffness_settling")
            first, second = (math.inf if math.isnan(time) else time for time in (before, after))
            sooner += second < (1 - _DISTINGUISHABLE) * first
            later += learned.unstable > 0 or first < (1 - _DISTINGUISHABLE) * second
            parts.append(f"{setting.name}, {reference.value}: PID {_seconds(before)}, BP {_seconds(after)}")
    return Claim(
        f"BP's stiffness settles sooner ({gains})",
        "Fig. 8 (c), (d)",
        later == 0 and sooner > len(parts) / 2,
        f"settling to {SETTLING_PART * 100:g} % of the step size: {'; '.join(parts)}; holds if BP is sooner by "
        f"{_DISTINGUISHABLE * 100:g} % or more in most cases, and later in none",
    )


def _learning_is_safe(tracking: Tracking) -> Claim:
    parts, holds = [], True
    for setting in SETTINGS:
        for reference in StiffnessReference:
            run = tracking.runs[setting.key, reference, FREE_TUNED_BP]
            after = run.median("angle_rmse")
            before = tracking.runs[setting.key, reference, TUNED_PID].median("angle_rmse")
            holds = holds and run.unstable == 0 and after <= before
            unstable = f"{run.unstable} of {tracking.seeds} seeds unstable"
            found = unstable if run.unstable else f"RMSE {after / deg:.3g} deg"
            parts.append(f"{setting.name}, {reference.value}: {found} (PID {before / deg:.3f} deg)")
    return Claim(
        "BP can be added to any PID (tuned gains, free to change by a factor of 2)",
        "asked by us",
        holds,
        "; ".join(parts) + ". Learning raises the gains as long as there is an error, whatever the stability margin",
        of_paper=False,
    )


def _coupled(tracking: Tracking) -> Claim:
    parts, holds = [], False
    for setting in SETTINGS:
        found = tracking.coupling[setting.key]
        angle = found.angle_by_step / quantity(setting.amplitude, "rad")
        step = abs(quantity(setting.after, "N*m/rad") - quantity(setting.before, "N*m/rad"))
        stiffness = (found.stiffness_by_motion - found.stiffness_at_rest) / step
        holds = holds or (angle > _VISIBLE and stiffness > _VISIBLE)
        parts.append(
            f"{setting.name}: the stiffness step disturbs the angle by up to {found.angle_by_step / deg:.3g} deg "
            f"({angle:.1%} of the amplitude), the motion disturbs the stiffness by {found.stiffness_by_motion:.3g} "
            f"N*m/rad RMS ({stiffness:.1%} of the step; {found.stiffness_at_rest + 0.0:.3f} at rest)"
        )
    return Claim(
        "Position and stiffness are coupled with each other",
        "Results and analysis",
        holds,
        f"{'; '.join(parts)}; holds if both are visible in one geometry ({_VISIBLE:.0%} or more)",
    )


def _range(joint: dict[str, JointMap]) -> Claim:
    printed = joint[SETTINGS[0].key].static_range
    parts = []
    for setting in SETTINGS:
        low, high = joint[setting.key].static_range
        parts.append(f"{setting.name}: {low / deg:.1f}..{high / deg:.1f} deg")
    return Claim(
        "The knee's rotating range is 55 deg (Table 2 as printed, no stretch structure)",
        "Musculoskeletal leg",
        printed[1] - printed[0] >= _KNEE_RANGE,
        "static range of angles, with the load of Table 2 and contractions within -3..25 %: " + "; ".join(parts),
    )


def _seconds(value: float) -> str:
    return "never" if math.isnan(value) else f"{value:.3f} s"
