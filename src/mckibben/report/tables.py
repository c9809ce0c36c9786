"""Tables, sections and decisions of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mckibben import catalog
from mckibben.control import Sine
from mckibben.paper.identification import FESTO, MARTENS, RIG, TEST_PRESSURES, plant_of
from mckibben.paper.settings import AS_PRINTED, BOUND, FREE, LEARNING, SETTINGS, STEP_TIME, Setting, StiffnessReference
from mckibben.paper.tracking import CONTROLLERS, PID
from mckibben.units import bar, deg, factor, mm, ms, percent

if TYPE_CHECKING:
    from mckibben.paper import Reproduction
    from mckibben.result import Listing

Numbers = Mapping[str, Any]
"""Nested numbers of `Reproduction.results`, by name."""

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
    """Name of a dataset. Default: its key."""
    return NAMES.get(dataset, dataset)


def decision_context(reproduction: Reproduction) -> dict[str, object]:
    """Names of the template of the decisions: objects, and functions of contraction in percent and pressure in bar."""
    law, rig = catalog.law("lei-mas-10-180n"), reproduction.identification.rig
    printed, contracted = (plant_of(setting) for setting in SETTINGS)
    lag = printed.valve.model_lag(printed.joint)
    return {
        "force": lambda contraction, pressure: law.force(contraction=contraction * percent, pressure=pressure * bar),
        "contraction": lambda plant: round(float(plant.joint.contractions(0.0, (3 * bar, 3 * bar))[0]) / percent, 6),
        "specimen": rig.muscle.specimen,
        "percent": percent,
        "range": [limit / deg for limit in reproduction.joint[AS_PRINTED.key].static_range],
        "printed": printed,
        "contracted": contracted,
        "load": printed.load,
        "hanging": printed.load.hanging_angle / deg,
        "mm": mm,
        "lag": f"{lag / ms:g} ms" if lag else "none",
        "factors": (FREE, BOUND),
        "pressures": ", ".join(f"{p / bar:g}" for p in TEST_PRESSURES),
        "friction": rig.rig.hysteresis,
    }


@dataclass(frozen=True)
class Table:
    """Table of the report, cells as text; a row of one cell is a group title."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def table_of(listing: Listing) -> Table:
    """Table of a listing of a result, with units in the head."""
    head = [f"{title} [{unit}]" if unit not in ("", "1") else title for title, unit in listing.header()]
    return Table(listing.title, head, listing.rows())


def number(value: float | None, digits: int = 3) -> str:
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
    """An estimate and its standard error to the second digit of the error, such as ``−237.4 ± 3.8``."""
    if error is None or not error > 0:
        return f"{number(estimate, 4)} (at bound)" if error is None else number(estimate, 5)
    places = max(1 - math.floor(math.log10(error)), 0)
    return f"{estimate:.{places}f} ± {error:.{places}f}".replace("-", "−")


def unit_text(unit: str) -> str:
    """Typographic form of a unit."""
    return unit.replace("percent", "%").replace("*", "·")


def fit_table(results: Numbers) -> Table:
    """Fit errors of Eq. 2 by dataset."""
    columns = {
        "RMSE [N]": "rmse_N",
        "maximum [N]": "max_N",
        "RMSE, held-out pressure [N]": "leave_one_pressure_out_rmse_N",
        "maximum, held-out pressure [N]": "leave_one_pressure_out_max_N",
        "points": "points_used",
        "slack, excluded": "points_slack",
    }
    rows = [
        (name_of(name), number(fit["decay_per_percent"], 4), *(number(fit[key]) for key in columns.values()))
        for name, fit in results["identification"].items()
    ]
    caption = "Eq. 2 fitted to each dataset. Held-out pressure: leave-one-pressure-out cross-validation."
    return Table(caption, ("dataset", "decay μ [1/%]", *columns), rows)


def parameter_table(results: Numbers) -> Table:
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
            parameter = fit["parameters"][name]
            cells.append(with_error(parameter["estimate"], parameter["standard_error"]))
        rows.append(cells)
    return Table(
        "Parameters of Eq. 2: estimate ± standard error, in the units of Eq. 3. They are strongly correlated: "
        "different sets can describe nearly the same force.",
        ("parameter", "Eq. 3, published", *(name_of(name) for name in fits)),
        rows,
    )


def validation_tables(results: Numbers) -> list[Table]:
    """Validation errors by pressure on the rig, and over all points on measured muscles."""
    validation = results["validation"]
    retest = validation["retest_rmse_N"]
    columns = {f"second test: {law}": values for law, values in retest.items()}
    columns |= {f"pressures held out: {law}": values for law, values in validation["held_out_pressures_rmse_N"].items()}
    columns |= {f"repeat held out: {law}": values for law, values in validation["held_out_repeat_rmse_N"].items()}
    rows = [place for place in next(iter(columns.values())) if place[0].isdigit()]  # by pressure, also by direction
    pressures = sorted(rows, key=lambda place: float(place.split()[0]))
    by_pressure = Table(
        "Simulated rig, RMSE [N] at the paper's four pressures: second test with new noise and offsets, and held-out "
        "points. The second test includes points near stroke reversals, fits and held-out points do not: "
        "the two are not comparable. All include half of the friction band, since a law has one curve for both "
        "directions.",
        ("pressure", *(f"{name} [N]" for name in columns)),
        [(p, *(number(values[p]) for values in columns.values())) for p in pressures],
    )
    measured = validation["measured_rmse_N"]
    laws = list(next(iter(measured.values())))
    overall = Table(
        "Measured muscles, RMSE [N] over all taut points: laws fitted to these points, and laws from other sources.",
        ("dataset", *(f"{law} [N]" for law in laws)),
        [(name_of(name), *(number(values[law]["all"]) for law in laws)) for name, values in measured.items()],
    )
    return [by_pressure, overall]


def joint_table(results: Numbers) -> Table:
    """Attainable set of the knee."""
    attainable = {setting: results["joint"][setting.key] for setting in SETTINGS}
    rows = [
        (s.name, s.connectors, *map(number, [*of["attainable_stiffness_at_0_deg"], *of["static_range_deg"]]))
        for s, of in attainable.items()
    ]
    head = ("geometry", "connectors", "K_min at 0° [N·m/rad]", "K_max at 0° [N·m/rad]",
            "equilibrium from [deg]", "to [deg]")  # fmt: skip
    return Table("Knee with its load, pressures and contractions within their limits.", head, rows)


def tracking_tables(results: Numbers) -> list[Table]:
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
                "Settling: to within 10 % of the step size. Unstable: worse than not moving, or not finite.",
                ("controller", *columns, "unstable"),
                rows,
            )
        )
    return tables


def _tracking_row(name: str, run: Numbers, columns: Mapping[str, str], seeds: int) -> tuple[str, ...]:
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
        f"{run['unstable']} of {seeds}" if "unstable" in run else "–",
    )


def gains_table(reproduction: Reproduction, results: Numbers) -> Table:
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
    """Simulation settings that the paper does not give."""
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
        "Simulation settings that the paper does not give; ours.",
        ("setting", *(s.name for s in SETTINGS)),
        [tuple(cell.replace("N*m/rad", "N·m/rad") for cell in row) for row in rows],
    )


def coupling_table(results: Numbers) -> Table:
    """Coupling of position and stiffness."""
    keys = ("angle_by_step_deg", "stiffness_by_motion", "stiffness_at_rest")
    rows = [(s.name, *(number(results["coupling"][s.key][key]) for key in keys)) for s in SETTINGS]
    head = ("geometry", "peak angle deviation after a stiffness step [deg]", "stiffness RMSE in motion [N·m/rad]",
            "stiffness RMSE at rest [N·m/rad]")  # fmt: skip
    return Table("Coupling of position and stiffness under PID with moderate gains.", head, rows)


def _sine(reproduction: Reproduction, setting: Setting) -> str:
    angle = reproduction.tracking.runs[setting.key, StiffnessReference.STEP, PID].scenario.reference().angle
    assert isinstance(angle, Sine)
    return f"sine of {float(angle.amplitude) / deg:g} deg, {float(angle.frequency):g} Hz"
