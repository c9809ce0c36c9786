"""Words of the report: its sections, and what the paper leaves open with how it is decided here."""

from __future__ import annotations

from dataclasses import dataclass

from mckibben import catalog
from mckibben.plant import FirstOrderValve
from mckibben.study.paper import Reproduction
from mckibben.study.paper.identification import FESTO, MARTENS, RIG, TEST_PRESSURES
from mckibben.study.paper.joint import plant_of
from mckibben.study.paper.settings import AS_PRINTED, BOUND, FREE, PRE_CONTRACTED, SETTINGS
from mckibben.units import bar, deg, mm, ms, percent

NAMES = {
    RIG: "virtual rig (follows Eq. 3, with friction)",
    MARTENS: "DMSP-10-250, measured",
    FESTO: "10 mm muscle, maker's chart",
}
"""What the datasets are called, by key."""

SECTIONS = {
    "identification": "Muscle: test, identification, validation",
    "joint": "Knee: what it can hold",
    "tracking": "Control of position and stiffness",
}
"""The parts that have figures, by key."""


def name_of(dataset: str) -> str:
    """What a dataset is called; its key where it has no name."""
    return NAMES.get(dataset, dataset)


@dataclass(frozen=True)
class Decision:
    """Something that the paper leaves open or prints in a way that cannot be meant, and what is done here."""

    question: str
    answer: str


def decisions(reproduction: Reproduction) -> tuple[Decision, ...]:
    """All of them; their numbers are worked out here from the catalog and the run."""
    rig = reproduction.identification.rig
    law, specimen = catalog.law("lei-mas-10-180n"), rig.muscle.specimen
    domain = specimen.domain

    def force(contraction: float, pressure: float) -> float:
        return float(law.force(contraction=contraction, pressure=pressure))

    printed, contracted = (plant_of(setting) for setting in SETTINGS)
    valve = printed.valve
    lag = f"{valve.time_constant / ms:g} ms" if isinstance(valve, FirstOrderValve) else "none"
    first, last = (limit / deg for limit in reproduction.joint[AS_PRINTED.key].holdable)
    pressed = float(printed.joint.contractions(0.0, (3 * bar, 3 * bar))[0]) / percent
    short = float(contracted.joint.contractions(0.0, (3 * bar, 3 * bar))[0]) / percent
    gravity = float(printed.load.gravity_torque(0.0))
    hanging = float(printed.load.hanging_angle) / deg
    return (
        Decision(
            "Units of Eq. 3",
            f"The paper gives none. Pressure in bar, contraction in percent, force in N: F(0 %, 6 bar) = "
            f"{force(0, 6 * bar):.1f} N, below the rating of {specimen.rated_force:g} N. Read as a ratio or in MPa it "
            "gives plausible nonsense.",
        ),
        Decision(
            "Range of the law",
            f"{domain.contraction_min / percent:g} to {domain.contraction_max / percent:g} % contraction. Beyond, the "
            f"exponential explodes ({force(-0.08, 6 * bar):.0f} N at −8 %, 6 bar) and at low pressure the law turns "
            f"negative ({force(0.05, 0):.0f} N at 5 %, 0 bar). A muscle cannot push: its force ends at zero, and every "
            "run says for how long a muscle was slack or outside the range.",
        ),
        Decision(
            "Table 2, taken literally",
            f"leaves the muscles at {pressed:.2g} % contraction at 0°, so that one is soon stretched past its limit: "
            f"the knee can be held from {first:.1f}° to {last:.1f}° only. The paper's remedy, a “mechanical stretch "
            f"structure”, is not described. Everything is therefore run twice: {AS_PRINTED.name} (connectors "
            f"{printed.joint.geometry.connector_length / mm:g} mm) and {PRE_CONTRACTED.name} "
            f"({contracted.joint.geometry.connector_length / mm:g} mm, {short:.3g} % contraction at 0°).",
        ),
        Decision(
            "Sign of gravity",
            "Eqs. 6 and 7 have it on opposite sides; equated literally it cancels. Here the muscles' torque and that "
            f"of gravity, G sin(π/6 − θ), are kept apart, and {hanging:.0f}° is the stable hanging position. At 0° "
            f"gravity gives {gravity:.2f} N·m.",
        ),
        Decision(
            "Sign of the stiffness",
            "Eq. 8, K = dτ/dθ, is negative for a stable joint; here it is minus that, at constant pressures, of the "
            f"muscles alone. Gravity would add {float(printed.load.gravity_stiffness(0.0)):.2f} N·m/rad at 0°.",
        ),
        Decision(
            "Damping",
            f"Table 2 prints N·s/m; it must be N·m·s/rad ({float(printed.load.damping):g}).",
        ),
        Decision(
            "Valves", f"The paper's simulation names none. Each pressure follows its command with a lag of {lag}."
        ),
        Decision(
            "Amplitude, frequency, set-points, gains, start",
            "None is in the paper's text: all are ours, listed below. PID is shown on moderate gains, as the paper's "
            "comparison implies, and on gains tuned by an optimiser.",
        ),
        Decision(
            "BP",
            "The paper does not say what it is. Here, as is usual: one small network a loop whose outputs multiply the "
            "gains of a PID, trained while it runs on the tracking error, with the plant's Jacobian replaced by its "
            f"sign. It starts at the PID's gains and may move them by a factor of {FREE:g} about moderate gains and "
            f"{BOUND:g} about tuned ones.",
        ),
        Decision(
            "Stiffness feedback",
            "Stiffness cannot be measured. The controller works it out from its own model of the joint, here without "
            "error; all errors in this report are those of the plant's true stiffness.",
        ),
        Decision(
            "Test pressures",
            f"The paper validates at {', '.join(f'{p / bar:g}' for p in TEST_PRESSURES)} bar, all of them among the "
            "pressures that it identified from. The same pressures are therefore also held out, and so is a whole "
            "repeat.",
        ),
        Decision(
            "The muscle of the test",
            "There is no raw data of the paper. A virtual rig runs its protocol on a muscle that follows Eq. 3, with "
            f"friction of ±{rig.rig.hysteresis:g} N (taken from the literature on 10 mm muscles), sensor noise and "
            "regulator offsets. What is found from it tests the method; the measured datasets test the law.",
        ),
    )
