"""Tables, sections and decisions of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mckibben import catalog
from mckibben.control import Sine
from mckibben.joint import KneeGeometry
from mckibben.paper import Reproduction
from mckibben.paper.identification import FESTO, MARTENS, RIG, TEST_PRESSURES, plant_of
from mckibben.paper.settings import (
    AS_PRINTED,
    BOUND,
    FREE,
    LEARNING,
    PRE_CONTRACTED,
    SETTINGS,
    STEP_TIME,
    Setting,
    StiffnessReference,
)
from mckibben.paper.tracking import CONTROLLERS, PID
from mckibben.plant import FirstOrderValve, JointPlant
from mckibben.units import bar, deg, factor, mm, ms, percent

NAMES = {
    RIG: "simulated rig (Eq. 3 with friction)",
    MARTENS: "DMSP-10-250, measured",
    FESTO: "10 mm muscle, manufacturer's chart",
}
"""Names of the datasets."""

SECTIONS = {
    "identification": "Muscle: test, identification, validation",
    "joint": "Knee: attainable set",
    "tracking": "Control of position and stiffness",
}
"""Sections of the report."""


def name_of(dataset: str) -> str:
    """Name of a dataset, by default its key."""
    return NAMES.get(dataset, dataset)


@dataclass(frozen=True)
class Decision:
    """Open or inconsistent point of the paper, and our decision."""

    question: str
    answer: str


def _connectors(plant: JointPlant) -> float:
    """Connector length [m] of a knee."""
    assert isinstance(plant.joint.geometry, KneeGeometry)
    return plant.joint.geometry.connector_length


def decisions(reproduction: Reproduction) -> tuple[Decision, ...]:
    """Decisions with numbers from the catalog and the run."""
    rig = reproduction.identification.rig
    law, specimen = catalog.law("lei-mas-10-180n"), rig.muscle.specimen
    domain = specimen.domain

    def force(contraction: float, pressure: float) -> float:
        return float(law.force(contraction=contraction, pressure=pressure))

    printed, contracted = (plant_of(setting) for setting in SETTINGS)
    valve = printed.valve
    lag = f"{valve.time_constant / ms:g} ms" if isinstance(valve, FirstOrderValve) else "none"
    first, last = (limit / deg for limit in reproduction.joint[AS_PRINTED.key].static_range)
    pressed = round(float(printed.joint.contractions(0.0, (3 * bar, 3 * bar))[0]) / percent, 6) + 0.0
    short = float(contracted.joint.contractions(0.0, (3 * bar, 3 * bar))[0]) / percent
    gravity = float(printed.load.gravity_torque(0.0))
    hanging = float(printed.load.hanging_angle) / deg
    return (
        Decision(
            "Units of Eq. 3",
            f"The paper gives none. Pressure in bar, contraction in percent, force in N: F(0 %, 6 bar) = "
            f"{force(0, 6 * bar):.1f} N, below the rating of {specimen.rated_force:g} N. A ratio or "
            "MPa would give plausible but wrong forces.",
        ),
        Decision(
            "Range of the law",
            f"{domain.contraction_min / percent:g} to {domain.contraction_max / percent:g} % contraction. Outside, the "
            f"exponential diverges ({force(-0.08, 6 * bar):.0f} N at −8 %, 6 bar) and at low pressure the law turns "
            f"negative ({force(0.05, 0):.0f} N at 5 %, 0 bar). The force is limited to "
            "zero from below, and each result reports how long a muscle was slack or outside the domain.",
        ),
        Decision(
            "Table 2, taken literally",
            f"leaves the muscles at {pressed:.2g} % contraction at 0°, so that one is soon stretched beyond its limit: "
            f"static equilibrium exists from {first:.1f}° to {last:.1f}° only. The paper's remedy, a “mechanical "
            "stretch "
            f"structure”, is not described. Both variants are run: {AS_PRINTED.name} (connectors "
            f"{_connectors(printed) / mm:g} mm) and {PRE_CONTRACTED.name} "
            f"({_connectors(contracted) / mm:g} mm, {short:.3g} % contraction at 0°).",
        ),
        Decision(
            "Sign of gravity",
            "Eqs. 6 and 7 have it on opposite sides; equated literally it cancels. Here muscle torque and gravity "
            f"torque, G sin(π/6 − θ), are separate, and {hanging:.0f}° is the stable equilibrium. At 0° "
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
            "Valves", f"Not specified in the paper. Each pressure follows its command with a first-order lag of {lag}."
        ),
        Decision(
            "Amplitude, frequency, set-points, gains, start",
            "Not in the paper: ours are listed below. PID is shown with moderate gains, as the paper's comparison "
            "implies, "
            "and with gains tuned by an optimiser.",
        ),
        Decision(
            "BP",
            "Not specified in the paper. The usual form: a small network per loop scales the gains of a PID and is "
            "trained "
            "online on the tracking error, with the sign of the plant's Jacobian. It starts at the PID's gains and may "
            f"change moderate gains by a factor of {FREE:g}, tuned ones by {BOUND:g}.",
        ),
        Decision(
            "Stiffness feedback",
            "Stiffness is not measured. The controller estimates it with its model of the joint, here without model "
            "error; "
            "all errors in this report are those of the plant's stiffness.",
        ),
        Decision(
            "Test pressures",
            f"The paper validates at {', '.join(f'{p / bar:g}' for p in TEST_PRESSURES)} bar, all of them among the "
            "identification pressures. Cross-validation holds out these pressures, and a whole repeat.",
        ),
        Decision(
            "The muscle of the test",
            "The paper's raw data are not published. A simulated rig runs its protocol on a muscle that follows Eq. "
            "3, with "
            f"friction of ±{rig.rig.hysteresis:g} N (from the literature on 10 mm muscles), sensor noise and regulator "
            "offsets. It tests the method; the measured datasets test the law.",
        ),
    )


@dataclass(frozen=True)
class Table:
    """Table of the report.

    Attributes
    ----------
    caption
        Caption.
    head
        Column titles.
    rows
        Cells as text; a row of one cell is a group title.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def number(value: Any, digits: int = 3) -> str:
    """Format a number with significant digits and a typographic minus; None and NaN are "–"."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, int):
        return f"{value:,}"
    size = abs(value)
    if size != 0 and not 1e-4 <= size < 1e5:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}·10^{int(exponent)}"
    else:
        places = max(digits - 1 - math.floor(math.log10(size)), 0) if size else 0
        text = f"{value:.{min(places, 6)}f}"
    return text.replace("-", "−")


def with_error(estimate: float, error: float | None) -> str:
    """Format an estimate and its standard error to the second digit of the error.

    >>> with_error(-237.362, 3.81)
    '−237.4 ± 3.8'
    """
    if error is None or not error > 0:
        return f"{number(estimate, 4)} (at bound)" if error is None else number(estimate, 5)
    places = max(1 - math.floor(math.log10(error)), 0)
    return f"{estimate:.{places}f} ± {error:.{places}f}".replace("-", "−")


def unit_text(unit: str) -> str:
    """Typographic form of a unit."""
    return unit.replace("percent", "%").replace("*", "·")


def fit_table(results: Mapping[str, Any]) -> Table:
    """Fit errors of Eq. 2 by dataset."""
    rows = []
    for name, fit in results["identification"].items():
        rows.append(
            (
                name_of(name),
                number(fit["decay_per_percent"], 4),
                number(fit["rmse_N"]),
                number(fit["max_N"]),
                number(fit["leave_one_pressure_out_rmse_N"]),
                number(fit["leave_one_pressure_out_max_N"]),
                number(fit["points_used"]),
                number(fit["points_slack"]),
            )
        )
    head = ("dataset", "decay μ [1/%]", "RMSE [N]", "maximum [N]", "RMSE, held-out pressure [N]",
            "maximum, held-out pressure [N]", "points", "slack, excluded")  # fmt: skip
    return Table(
        "Eq. 2 fitted to each dataset. Held-out pressure: leave-one-pressure-out cross-validation.",
        head,
        rows,
    )


def parameter_table(results: Mapping[str, Any]) -> Table:
    """Estimates with standard errors, and the published values of Eq. 3, in its units."""
    fits = results["identification"]
    law = catalog.law("lei-mas-10-180n")
    shown = {p.name: p.shown for p in type(law).parameters()}
    rows = []
    for name, unit in shown.items():
        published = float(getattr(law, name)) / factor(unit)
        symbol = name.replace("decay", "μ").translate(str.maketrans("12", "₁₂"))
        cells = [f"{symbol} [{unit_text(unit)}]", f"{published:g}".replace("-", "−")]
        for fit in fits.values():
            found = fit["parameters"][name]
            cells.append(with_error(found["estimate"], found["standard_error"]))
        rows.append(cells)
    return Table(
        "Parameters of Eq. 2: estimate ± standard error, in the units of Eq. 3. They are strongly correlated: "
        "different "
        "sets can describe nearly the same force.",
        ("parameter", "Eq. 3, published", *(name_of(name) for name in fits)),
        rows,
    )


def validation_tables(results: Mapping[str, Any]) -> list[Table]:
    """Validation errors by pressure on the rig, and over all points on measured muscles."""
    found = results["validation"]
    retest = found["retest_rmse_N"]
    columns = {f"second test: {law}": values for law, values in retest.items()}
    columns |= {f"pressures held out: {law}": values for law, values in found["held_out_pressures_rmse_N"].items()}
    columns |= {f"repeat held out: {law}": values for law, values in found["held_out_repeat_rmse_N"].items()}
    rows = [
        place for place in next(iter(columns.values())) if place[0].isdigit()
    ]  # a pressure, or one in one direction
    pressures = sorted(rows, key=lambda place: float(place.split()[0]))
    by_pressure = Table(
        "Simulated rig, RMSE [N] at the paper's four pressures: second test with other noise and offsets, and held-out "
        "points. The second test includes points near the reversals of the stroke, fits and held-out points do not: "
        "the two are not comparable. All contain half of the friction band, since a law has one curve for both "
        "directions.",
        ("pressure", *(f"{name} [N]" for name in columns)),
        [(p, *(number(values[p]) for values in columns.values())) for p in pressures],
    )
    measured = found["measured_rmse_N"]
    laws = list(next(iter(measured.values())))
    overall = Table(
        "Measured muscles, RMSE [N] over all taut points: laws fitted to these points, and laws from other sources.",
        ("dataset", *(f"{law} [N]" for law in laws)),
        [(name_of(name), *(number(values[law]["all"]) for law in laws)) for name, values in measured.items()],
    )
    return [by_pressure, overall]


def joint_table(results: Mapping[str, Any]) -> Table:
    """Attainable set of the knee."""
    rows = []
    for setting in SETTINGS:
        found = results["joint"][setting.key]
        low, high = found["attainable_stiffness_at_0_deg"]
        first, last = found["static_range_deg"]
        rows.append((setting.name, setting.connectors, number(low), number(high), number(first), number(last)))
    head = ("geometry", "connectors", "K_min at 0° [N·m/rad]", "K_max at 0° [N·m/rad]",
            "equilibrium from [deg]", "to [deg]")  # fmt: skip
    return Table("Knee with its load, pressures and contractions within their limits.", head, rows)


def tracking_tables(results: Mapping[str, Any]) -> list[Table]:
    """Tracking errors by geometry, stiffness reference and controller; median and worst over seeds."""
    columns = {
        "angle RMSE [deg]": "angle_rmse_deg",
        "angle maximum [deg]": "angle_max_deg",
        "stiffness RMSE [N·m/rad]": "stiffness_rmse",
        "settling [s]": "stiffness_settling_s",
        "outside the range [s]": "time_outside_domain_s",
    }
    tables = []
    for setting in SETTINGS:
        rows: list[tuple[str, ...]] = []
        for reference in StiffnessReference:
            rows.append((f"{reference.value} stiffness",))
            runs = results["tracking"][setting.key][reference.value]
            rows += [_tracking_row(name, runs[name], columns, results["seeds"]) for name in CONTROLLERS if name in runs]
        tables.append(
            Table(
                f"Geometry {setting.name}. BP: median over {results['seeds']} seeds, the worst in brackets. "
                "Settling: into 10 % of the step size. Unstable: worse than not moving, or not finite.",
                ("controller", *columns, "unstable"),
                rows,
            )
        )
    return tables


def _tracking_row(name: str, run: Mapping[str, Any], columns: Mapping[str, str], seeds: int) -> tuple[str, ...]:
    def cell(key: str) -> str:
        never = "never" if "settling" in key else "–"
        median = never if run[key] is None else number(run[key])
        if "worst" not in run:
            return median
        worst = run["worst"][key]
        return f"{median} ({never if worst is None else number(worst)})"

    return (
        name,
        *(cell(key) for key in columns.values()),
        f"{run['unstable']} of {seeds}" if "unstable" in run else "no seeds",
    )


def gains_table(reproduction: Reproduction, results: Mapping[str, Any]) -> Table:
    """Moderate and tuned gains of both loops, in the same units."""
    units = {
        "position": ("bar/rad", "bar/(rad*s)", "bar*s/rad"),
        "stiffness": ("bar/(N*m/rad)", "bar*rad/(N*m*s)", "bar*s/(N*m/rad)"),
    }
    rows: list[tuple[str, ...]] = []
    for setting in SETTINGS:
        tuned = results["tuning"][setting.key]
        bounds = f"; at bound: {', '.join(tuned['at_bound'])}" if tuned["at_bound"] else ""
        rows.append(
            (
                f"{setting.name}: cost {number(tuned['cost_before'])} with moderate gains, {number(tuned['cost'])} "
                f"tuned, {tuned['evaluated']:,} evaluations{bounds}",
            )
        )
        moderate = reproduction.tracking.runs[setting.key, StiffnessReference.CONSTANT, PID].scenario.control()
        for loop, names in units.items():
            for gain, unit in zip(("kp", "ki", "kd"), names, strict=True):
                scale = factor(unit)
                label = f"{loop} loop, {gain} [{unit_text(unit)}]"
                before = getattr(getattr(moderate, loop), gain)
                rows.append((label, number(before / scale), number(tuned[loop][gain] / scale)))
    return Table(
        "Gains of the two PID loops: moderate ones, set by hand, and tuned ones, optimised on both references.",
        ("gain", "moderate (ours)", "tuned"),
        rows,
    )


def settings_table(reproduction: Reproduction) -> Table:
    """Settings of the simulations that the paper does not give."""
    scenario = reproduction.tracking.runs[SETTINGS[0].key, StiffnessReference.STEP, PID].scenario
    rows = [
        ("connectors (Table 2 and ours)", *(s.connectors for s in SETTINGS)),
        ("desired angle", *(_sine(reproduction, s) for s in SETTINGS)),
        ("desired stiffness, constant", *(s.constant for s in SETTINGS)),
        (f"desired stiffness, step at {STEP_TIME}", *(f"{s.before} to {s.after}" for s in SETTINGS)),
        ("initial stiffness", *(s.start for s in SETTINGS)),
        ("learning of BP", *(LEARNING for _ in SETTINGS)),
        (
            "duration, control period",
            *(f"{scenario.duration:g} s, {scenario.control_period * 1e3:g} ms" for _ in SETTINGS),
        ),
    ]
    return Table(
        "Settings of the simulations, which the paper does not give; ours.",
        ("setting", *(s.name for s in SETTINGS)),
        [tuple(cell.replace("N*m/rad", "N·m/rad") for cell in row) for row in rows],
    )


def coupling_table(results: Mapping[str, Any]) -> Table:
    """Coupling of position and stiffness."""
    rows = []
    for setting in SETTINGS:
        found = results["coupling"][setting.key]
        rows.append(
            (
                setting.name,
                number(found["angle_by_step_deg"]),
                number(found["stiffness_by_motion"]),
                number(found["stiffness_at_rest"]),
            )
        )
    head = ("geometry", "peak angle deviation after a stiffness step [deg]", "stiffness RMSE in motion [N·m/rad]",
            "stiffness RMSE at rest [N·m/rad]")  # fmt: skip
    return Table("Coupling of position and stiffness under PID with moderate gains.", head, rows)


def _sine(reproduction: Reproduction, setting: Setting) -> str:
    angle = reproduction.tracking.runs[setting.key, StiffnessReference.STEP, PID].scenario.reference().angle
    assert isinstance(angle, Sine)
    return f"sine of {float(angle.amplitude) / deg:g} deg, {float(angle.frequency):g} Hz"
