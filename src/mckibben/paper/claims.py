"""The paper's claims, each with a verdict worked out from the run: it holds, or it does not, and why."""

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
from mckibben.paper.settings import SETTINGS, Wish
from mckibben.paper.tracking import BP, FREE_TUNED_BP, PID, TUNED_BP, TUNED_PID, Tracking
from mckibben.simulation import SETTLING_PART
from mckibben.units import bar, deg, quantity

_SIMILAR = 0.1  # loading and unloading are similar if they differ by less than this part of the largest force
_KNEE_RANGE = 55 * deg
_AT_A_GLANCE = 0.05  # two errors that differ by less look the same in the paper's figures
_VISIBLE = 0.01  # a disturbance below this part of the amplitude, or of the step, is not seen in a figure


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, or one of ours beside it, held against the run.

    Attributes
    ----------
    claim, source
        What it says, and where.
    of_paper
        Whether the paper says so; else it is a question that the paper leaves.
    holds
        The verdict.
    evidence
        The numbers behind it.
    """

    claim: str
    source: str
    holds: bool
    evidence: str
    of_paper: bool = True


def judge(identification: Identification, joint: dict[str, JointMap], tracking: Tracking) -> tuple[Claim, ...]:
    """All claims."""
    return (
        _closer_than_chou(identification),
        _closer_on_real_muscles(identification),
        _directions_similar(identification),
        *(_smaller_angle_error(tracking, wish, PID, BP, "the same moderate gains in both") for wish in Wish),
        *(_smaller_angle_error(tracking, wish, TUNED_PID, TUNED_BP, "gains tuned by an optimiser") for wish in Wish),
        _settles_sooner(tracking, PID, BP, "the same moderate gains in both"),
        _settles_sooner(tracking, TUNED_PID, TUNED_BP, "gains tuned by an optimiser"),
        _coupled(tracking),
        _range(joint),
        _learning_is_safe(tracking),
    )


def _closer_than_chou(identification: Identification) -> Claim:
    found = {
        p: (
            identification.retested.of(EXPERIMENTAL, pressure=p).rmse,
            identification.retested.of(CHOU, pressure=p).rmse,
        )
        for p in TEST_PRESSURES
    }
    return Claim(
        "The experimental law is closer to the measured force than Chou's",
        "Fig. 4",
        all(law < chou for law, chou in found.values()),
        "RMSE on a second test, Eq. 2 against Chou: "
        + ", ".join(f"{law:.1f} against {chou:.1f} N at {p / bar:g} bar" for p, (law, chou) in found.items())
        + " (on the simulated rig, whose muscle follows Eq. 3 with friction; for real muscles see our question below)",
    )


def _closer_on_real_muscles(identification: Identification) -> Claim:
    numbers = []
    for name in (MARTENS, FESTO):
        unseen = identification.fits[name].leave_one_pressure_out
        measured = identification.measured[name]
        numbers.append(
            (name, unseen.rmse if unseen else math.nan, measured.of(CHOU).rmse, measured.of(CHOU_FITTED).rmse)
        )
    return Claim(
        "Eq. 2 is closer than Chou's law on a measured map and a maker's chart, at pressures that the fit has not seen",
        "asked by us, of Fig. 4",
        all(law < min(chou, fitted) for _, law, chou, fitted in numbers),
        "; ".join(
            f"{name}: Eq. 2 {law:.2f} N, Chou {chou:.1f} N (with braid angle and diameter fitted to these very points "
            f"{fitted:.1f} N)"
            for name, law, chou, fitted in numbers
        ),
        of_paper=False,
    )


def _directions_similar(identification: Identification) -> Claim:
    gap, span = direction_gap(identification.data[RIG])
    band = identification.rig.rig.hysteresis
    return Claim(
        "Loading and unloading are similar",
        "Fig. 3",
        abs(gap) < _SIMILAR * span,
        f"they differ by {gap:.1f} N on average, {gap / span:.1%} of the largest force; the rig's friction of "
        f"+-{band:g} N is taken from the literature, so this checks the scale, not the paper's muscle",
    )


def _smaller_angle_error(tracking: Tracking, wish: Wish, pid: str, bp: str, gains: str) -> Claim:
    parts, holds = [], True
    for setting in SETTINGS:
        base, learned = tracking.runs[setting.key, wish, pid], tracking.runs[setting.key, wish, bp]
        before, after = base.median("angle_rmse"), learned.median("angle_rmse")
        holds = holds and after < (1 - _AT_A_GLANCE) * before and learned.lost == 0
        parts.append(
            f"{setting.name}: PID {before / deg:.3f} deg, BP {after / deg:.3f} deg "
            f"(worst of {tracking.seeds} seeds {learned.worst('angle_rmse') / deg:.3f})"
        )
    return Claim(
        f"BP's position error is smaller than PID's under {wish.value} stiffness ({gains})",
        "Fig. 8 (a)" if wish is Wish.CONSTANT else "Fig. 8 (b)",
        holds,
        f"angle RMSE, {'; '.join(parts)}; smaller means by {_AT_A_GLANCE * 100:g} % or more, as seen in a figure",
    )


def _settles_sooner(tracking: Tracking, pid: str, bp: str, gains: str) -> Claim:
    parts, sooner, later = [], 0, 0
    for setting in SETTINGS:
        for wish in Wish:
            base, learned = tracking.runs[setting.key, wish, pid], tracking.runs[setting.key, wish, bp]
            before, after = base.median("stiffness_settling"), learned.median("stiffness_settling")
            first, second = (math.inf if math.isnan(time) else time for time in (before, after))
            sooner += second < (1 - _AT_A_GLANCE) * first
            later += learned.lost > 0 or first < (1 - _AT_A_GLANCE) * second
            parts.append(f"{setting.name}, {wish.value}: PID {_seconds(before)}, BP {_seconds(after)}")
    return Claim(
        f"BP's stiffness settles sooner ({gains})",
        "Fig. 8 (c), (d)",
        later == 0 and sooner > len(parts) / 2,
        f"into {SETTLING_PART * 100:g} % of the change asked for; {'; '.join(parts)}; it holds where BP is sooner by "
        f"{_AT_A_GLANCE * 100:g} % or more in most cases, and later in none",
    )


def _learning_is_safe(tracking: Tracking) -> Claim:
    parts, holds = [], True
    for setting in SETTINGS:
        for wish in Wish:
            run, base = tracking.runs[setting.key, wish, FREE_TUNED_BP], tracking.runs[setting.key, wish, TUNED_PID]
            after, before = run.median("angle_rmse"), base.median("angle_rmse")
            holds = holds and run.lost == 0 and after <= before
            lost = f"{run.lost} of {tracking.seeds} seeds lost" if run.lost else f"RMSE {after / deg:.3g} deg"
            parts.append(f"{setting.name}, {wish.value}: {lost} (PID {before / deg:.3f} deg)")
    return Claim(
        "BP can be put on any PID (tuned gains, free to move by a factor of 2)",
        "asked by us",
        holds,
        "; ".join(parts)
        + ". Learning raises the gains as long as an error is left, whatever the stability of the loop",
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
            f"{setting.name}: the stiffness step moves the angle by up to {found.angle_by_step / deg:.3g} deg "
            f"({angle:.1%} of the amplitude), the motion disturbs the stiffness by {found.stiffness_by_motion:.3g} "
            f"N*m/rad RMS ({stiffness:.1%} of the step; {found.stiffness_at_rest + 0.0:.3f} at rest)"
        )
    return Claim(
        "Position and stiffness are coupled with each other",
        "Results and analysis",
        holds,
        f"{'; '.join(parts)}; it holds where both can be seen in a geometry ({_VISIBLE:.0%} or more)",
    )


def _range(joint: dict[str, JointMap]) -> Claim:
    printed = joint[SETTINGS[0].key].holdable
    parts = []
    for setting in SETTINGS:
        low, high = joint[setting.key].holdable
        parts.append(f"{setting.name}: {low / deg:.1f}..{high / deg:.1f} deg")
    return Claim(
        "The knee's rotating range is 55 deg (Table 2 as printed, no stretch structure)",
        "Musculoskeletal leg",
        printed[1] - printed[0] >= _KNEE_RANGE,
        "angles that pressures within limits can hold, with the load of Table 2 and contractions within -3..25 %; "
        + "; ".join(parts),
    )


def _seconds(value: float) -> str:
    return "never" if math.isnan(value) else f"{value:.3f} s"
