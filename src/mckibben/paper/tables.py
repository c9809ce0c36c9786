"""Tables and decisions of the report of the paper, from the numbers in results.json.

Captions and headings are in tables.toml; numbers are rounded to three significant digits, estimates to the second digit
of their standard error.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

from mckibben import catalog
from mckibben.control import Sine
from mckibben.paper.identification import FESTO, MARTENS, RIG, TEST_PRESSURES, plant_of
from mckibben.paper.settings import AS_PRINTED, BOUND, FREE, LEARNING, SETTINGS, STEP_TIME, Setting, StiffnessReference
from mckibben.paper.tracking import CONTROLLERS, PID
from mckibben.units import bar, deg, factor, mm, ms, percent

if TYPE_CHECKING:
    from mckibben.paper import Reproduction

Numbers = Mapping[str, Any]
"""Nested numbers of `Reproduction.to_dict`, by name."""

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
    "leg": "Leg: all joints at once",
}
"""Sections of the report."""


def name_of(dataset: str) -> str:
    """Name of a dataset. Default: its key."""
    return NAMES.get(dataset, dataset)


def decision_context(reproduction: Reproduction) -> dict[str, object]:
    """Objects of the template that states open points of the paper, and our decisions.

    ``force`` and ``contraction`` are functions: of a contraction [%] and a pressure [bar], the force of Eq. 3 [N]; of a
    plant, the contraction [%] of its muscles at 0 deg and 3 bar.
    """
    law, rig = catalog.law("lei-mas-10-180n"), reproduction.identification.rig
    printed, contracted = (plant_of(setting) for setting in SETTINGS)
    at_rest = reproduction.joint[AS_PRINTED.key]
    lag = printed.valve.model_lag(printed.joint)
    return {
        "force": lambda contraction, pressure: law.force(contraction=contraction * percent, pressure=pressure * bar),
        "contraction": lambda plant: round(float(plant.joint.contractions(0.0, (3 * bar, 3 * bar))[0]) / percent, 6),
        "specimen": rig.muscle.specimen,
        "percent": percent,
        "range": [at_rest.angle_min / deg, at_rest.angle_max / deg],
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
    """Table of a page, with cells as text.

    Parameters
    ----------
    caption
        What the numbers are, and under which conditions.
    head
        Heading of each column, with its unit.
    rows
        Cells of each row; a row of one cell is the title of a group.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


_TEXTS = tomllib.loads((resources.files("mckibben.paper") / "tables.toml").read_text(encoding="utf-8"))


def _columns(key: str) -> Sequence[str]:
    """Names of the numbers of a table."""
    return list(_TEXTS[key]["columns"].values())


def _table(key: str, rows: Sequence[Sequence[str]], *head: str, **values: object) -> Table:
    """Table with the texts of `tables.toml`, whose braces `values` fill, and further headings."""
    texts = _TEXTS[key]
    return Table(texts["caption"].format(**values), (*texts["head"], *(head or texts.get("columns", ()))), rows)


def number(value: float | None, digits: int = 3) -> str:
    """Number with significant digits and a typographic minus; "–" for None and numbers that are not finite.

    Parameters
    ----------
    value
        Number; an integer is written in full, with commas.
    digits
        Significant digits, at most six of them after the point; below 1e-4 and from 1e5 on with a power of ten.

    Examples
    --------
    >>> number(-0.012345), number(123456.0), number(1234567), number(float("nan"))
    ('−0.0123', '1.23·10^5', '1,234,567', '–')
    """
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
    """Estimate and its standard error, both to the second digit of the error.

    Parameters
    ----------
    estimate
        Value of a parameter, in its unit.
    error
        Standard error; None for a parameter at a bound of its range, which has none.

    Examples
    --------
    >>> with_error(-237.4431, 3.817), with_error(0.34, None)
    ('−237.4 ± 3.8', '0.3400 (at bound)')
    """
    if error is None or not error > 0:
        return f"{number(estimate, 4)} (at bound)" if error is None else number(estimate, 5)
    places = max(1 - math.floor(math.log10(error)), 0)
    return f"{estimate:.{places}f} ± {error:.{places}f}".replace("-", "−")


def unit_text(unit: str) -> str:
    """Typographic form of a unit.

    >>> unit_text("N*m/rad"), unit_text("N/percent")
    ('N·m/rad', 'N/%')
    """
    return unit.replace("percent", "%").replace("*", "·")


def fit_table(results: Numbers) -> Table:
    """Errors of Eq. 2 [N] by dataset, of fitted points and of held-out pressures."""
    rows = [
        (name_of(name), number(fit["decay_per_percent"], 4), *(number(fit[key]) for key in _columns("fit")))
        for name, fit in results["identification"].items()
    ]
    return _table("fit", rows)


def parameter_table(results: Numbers) -> Table:
    """Estimates of Eq. 2 with standard errors by dataset, beside the values of Eq. 3, in its units (bar, %, N)."""
    fits = results["identification"]
    law = catalog.law("lei-mas-10-180n")
    units = {p.name: p.shown for p in type(law).parameters()}
    rows = []
    for name, unit in units.items():
        published = float(getattr(law, name)) / factor(unit)
        symbol = name.replace("decay", "μ").translate(str.maketrans("12", "₁₂"))
        cells = [f"{symbol} [{unit_text(unit)}]", f"{published:g}".replace("-", "−")]
        for fit in fits.values():
            parameter = fit["parameters"][name]
            cells.append(with_error(parameter["estimate"], parameter["standard_error"]))
        rows.append(cells)
    return _table("parameters", rows, *map(name_of, fits))


HARDWARE = _table("hardware", _TEXTS["hardware"]["rows"])
"""Table 1 of the paper, with what stands for it here."""


def validation_tables(results: Numbers) -> list[Table]:
    """Errors of laws [N]: by pressure on the simulated rig, and over all taut points of the measured muscles.

    The rig has a second test, held-out pressures and a held-out repeat, each with the law of the paper and Chou's.
    """
    validation = results["validation"]
    columns = {
        f"{test}: {law}": values
        for test, key in _TEXTS["validation"]["columns"].items()
        for law, values in validation[key].items()
    }
    rows = [place for place in next(iter(columns.values())) if place[0].isdigit()]  # by pressure, also by direction
    pressures = sorted(rows, key=lambda place: float(place.split()[0]))
    by_pressure = [(p, *(number(values[p]) for values in columns.values())) for p in pressures]
    measured = validation["measured_rmse_N"]
    laws = list(next(iter(measured.values())))
    overall = [(name_of(name), *(number(values[law]["all"]) for law in laws)) for name, values in measured.items()]
    return [
        _table("validation", by_pressure, *(f"{name} [N]" for name in columns)),
        _table("measured", overall, *(f"{law} [N]" for law in laws)),
    ]


def joint_table(results: Numbers) -> Table:
    """Attainable stiffness [N*m/rad] at 0 deg, and static range of angles [deg], by geometry."""
    keys = "attainable_stiffness_at_0_deg", "static_range_deg"
    rows = [
        (s.name, s.connectors, *(number(limit) for key in keys for limit in results["joint"][s.key][key]))
        for s in SETTINGS
    ]
    return _table("joint", rows)


def tracking_tables(results: Numbers) -> list[Table]:
    """Tracking errors by stiffness reference and controller, one table per geometry; median and worst over seeds."""
    tables = []
    for setting in SETTINGS:
        rows: list[tuple[str, ...]] = []
        for reference in StiffnessReference:
            rows.append((f"{reference.value} stiffness",))
            runs = results["tracking"][setting.key][reference.value]
            rows += [_tracking_row(name, runs[name], results["seeds"]) for name in CONTROLLERS if name in runs]
        head = *_TEXTS["tracking"]["columns"], "unstable"
        tables.append(_table("tracking", rows, *head, setting=setting, seeds=results["seeds"]))
    return tables


def _tracking_row(name: str, run: Numbers, seeds: int) -> tuple[str, ...]:
    """Cells of a controller: median over seeds and, in brackets, the worst of each metric."""

    def cell(key: str) -> str:
        never = "never" if "settling" in key else "–"
        median = never if run[key] is None else number(run[key])
        if "worst" not in run:
            return median
        worst = run["worst"][key]
        return f"{median} ({never if worst is None else number(worst)})"

    return name, *map(cell, _columns("tracking")), f"{run['unstable']} of {seeds}" if "unstable" in run else "–"


def gains_table(reproduction: Reproduction, results: Numbers) -> Table:
    """Moderate and tuned gains of both loops, in the same units, with the cost of the tuning."""
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
    return _table("gains", rows)


def settings_table(reproduction: Reproduction) -> Table:
    """Amplitudes, setpoints, start, learning and timing, which the paper does not give, by geometry."""
    scenario = reproduction.tracking.runs[SETTINGS[0].key, StiffnessReference.STEP, PID].scenario
    rows = [
        ("connectors (Table 2 and ours)", *(s.connectors for s in SETTINGS)),
        ("desired angle", *(_sine(reproduction, s) for s in SETTINGS)),
        ("desired stiffness, constant", *(s.constant for s in SETTINGS)),
        (f"desired stiffness, step at {STEP_TIME}", *(f"{s.before} to {s.after}" for s in SETTINGS)),
        ("initial stiffness", *(s.start for s in SETTINGS)),
        ("learning of BP", *(LEARNING for _ in SETTINGS)),
        ("duration, control period", *[f"{scenario.duration:g} s, {scenario.control_period * 1e3:g} ms"] * 2),
    ]
    cells = [tuple(cell.replace("N*m/rad", "N·m/rad") for cell in row) for row in rows]
    return _table("settings", cells, *(s.name for s in SETTINGS))


def coupling_table(results: Numbers) -> Table:
    """Change of the angle [deg] by the stiffness step, and stiffness errors [N*m/rad] in motion and at rest."""
    keys = _columns("coupling")
    rows = [(s.name, *(number(results["coupling"][s.key][key]) for key in keys)) for s in SETTINGS]
    return _table("coupling", rows)


def _sine(reproduction: Reproduction, setting: Setting) -> str:
    """Amplitude and frequency of the desired angle of a setting."""
    angle = reproduction.tracking.runs[setting.key, StiffnessReference.STEP, PID].scenario.reference().angle
    assert isinstance(angle, Sine)
    return f"sine of {float(angle.amplitude) / deg:g} deg, {float(angle.frequency):g} Hz"
