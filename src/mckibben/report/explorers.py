"""Parts of the report with sliders: functions of a scenario as JavaScript, evaluated in the page."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import markupsafe
import numpy as np

from mckibben.codegen import SourceModule, write_js
from mckibben.control import Setpoint
from mckibben.joint.geometry import KneeGeometry
from mckibben.scenario.parameters import find_parameter
from mckibben.scenario.values import changed
from mckibben.simulation.loop import control_period, initial_loop
from mckibben.simulation.metrics import trajectory
from mckibben.simulation.oscillation import Oscillation
from mckibben.units import bar, deg, factor, litre, mm

if TYPE_CHECKING:
    from mckibben.muscle import Muscle
    from mckibben.plant import JointPlant
    from mckibben.scenario import Scenario

_ANGLES = (-45.0, 45.0)  # deg
_GAINS = {"kp": ("proportional", "bar/rad"), "ki": ("integral", "bar/(rad*s)"), "kd": ("derivative", "bar*s/rad")}
_ERRORS = "Root mean square error: {angle}° and {stiffness} N·m/rad; {air} L of air."
_STIFFNESS_GAINS = {"kp": ("proportional", "bar/(N*m/rad)"), "ki": ("integral", "bar/(N*m*s/rad)")}


class Slider(NamedTuple):
    """A parameter of an explorer; `factor` is the size of its shown unit in SI."""

    name: str
    label: str
    unit: str
    factor: float
    value: float
    low: float
    high: float
    step: float


class Explorer(NamedTuple):
    """Title, text, sliders, and the scripts that compute and draw; `plays` if it has a joint in motion."""

    key: str
    title: str
    text: str
    sliders: list[Slider]
    script: markupsafe.Markup
    plays: bool = False


class Axis(NamedTuple):
    """Horizontal axis: label, ends in shown units (default: those of the data), column, and factor to shown units."""

    label: str
    low: float | None = None
    high: float | None = None
    column: str = "x"
    factor: float = 1.0


class Curve(NamedTuple):
    """Curve of a column; `fixed` ones are drawn dashed, `dots` as points. `x` is the column of its abscissas."""

    column: str
    label: str = ""
    fixed: bool = False
    dots: bool = False
    x: str = ""


class Chart(NamedTuple):
    """Chart of curves, and bands between two columns, times a factor; values beyond `limit` as shown are left out."""

    title: str
    label: str
    curves: Sequence[Curve]
    factor: float = 1.0
    limit: float | None = None
    low: float | None = None
    high: float | None = None
    across: Axis | None = None
    bands: Sequence[tuple[str, str]] = ()


class ComputedRows(NamedTuple):
    """Functions of the values of sliders, and the charts of their results.

    ``row(parameters, x)`` returns columns; with ``init(parameters)``, which returns a state, ``row(parameters, state,
    x)`` returns the following state and columns. `range` is first, last and number of x, of which each n-th is drawn.
    ``summary(parameters[, state])`` returns numbers of the text: the first of `says` whose number is positive, or
    without a name. ``points(parameters)`` returns columns of their own length.
    """

    row: Callable[..., Any]
    range: tuple[float, float, int]
    across: Axis
    charts: Sequence[Chart]
    says: Sequence[tuple[str, str]]
    init: Callable[..., Any] | None = None
    summary: Callable[..., dict[str, Any]] | None = None
    points: Callable[..., dict[str, Any]] | None = None
    every: int = 1


RUN_CHARTS = (
    Chart(
        "angle over time", "angle, °", (Curve("angle", "actual"), Curve("desired_angle", "desired", True)), 1 / deg, 90
    ),
    Chart(
        "stiffness over time",
        "stiffness, N·m/rad",
        (Curve("stiffness", "actual"), Curve("desired_stiffness", "desired", True)),
        limit=100,
    ),
)


def explorers(scenario: Scenario, keys: Sequence[str] = ("force", "attainable", "run")) -> dict[str, Explorer]:
    """Force law, attainable stiffness, and run of a scenario of the knee with two PID loops."""
    plant = scenario.plant()
    made = {
        "force": lambda: _force(plant.joint.muscle1),
        "attainable": lambda: _attainable(plant),
        "run": lambda: _run(scenario),
    }
    return {key: made[key]() for key in keys}


def _explorer(key: str, title: str, text: str, sliders: list[Slider], module: SourceModule, options: Any) -> Explorer:
    script = f'{write_js(module)}explorer.{key}("explore-{key}", {module.name}, {json.dumps(options)});'
    return Explorer(key, title, text, sliders, markupsafe.Markup(script))


def _around(name: str, label: str, unit: str, value: Any) -> Slider:
    """A slider from zero to twice a value [SI]."""
    size = factor(unit)
    number = float(f"{float(value) / size:.6g}")
    low, high = sorted((0.0, 2 * number)) if number else (0.0, 1.0)
    shown = unit.replace("*", "·").replace("percent", "%")
    return Slider(name, label, shown, size, number, low, high, abs(number) / 100 or 0.01)


def _parameters(sliders: list[Slider]) -> dict[str, Any]:
    return {one.name: np.asarray(one.value * one.factor) for one in sliders}


def _force(muscle: Muscle) -> Explorer:
    law, number = muscle.law, np.zeros(())
    known = (*law.linear_parameters, *law.shape_parameters)
    sliders = [_around(one.name, f"{one.name}: {one.meaning}", one.shown, getattr(law, one.name)) for one in known]
    module = SourceModule("forceLaw", _parameters(sliders))

    def force(parameters: Any, contraction: Any, pressure: Any) -> dict[str, Any]:
        def fields(law: Any) -> list[Any]:
            return [getattr(law, one.name) for one in known]

        changed = eqx.tree_at(fields, law, [parameters[one.name] for one in known])
        return {"force": eqx.tree_at(lambda muscle: muscle.law, muscle, changed).tension(contraction, pressure)}

    module.add("force", "force [N]", force, {"contraction": number, "pressure": number})
    domain = muscle.domain
    highest = round(float(domain.pressure_max) / bar)
    options = {
        "contractions": [float(domain.contraction_min), float(domain.contraction_max)],
        "pressures": [one * bar for one in range(1, highest + 1)],
    }
    text = "Force over contraction at each pressure. Dashed: the paper's coefficients."
    return _explorer("force", "Explore the force law over its coefficients", text, sliders, module, options)


def _attainable(plant: JointPlant) -> Explorer:
    geometry, domain = plant.joint.geometry, plant.joint.muscle1.domain
    assert isinstance(geometry, KneeGeometry)
    connector, radius = float(geometry.connector_length) / mm, float(geometry.joint_radius) / mm
    highest = float(domain.pressure_max) / bar
    sliders = [
        Slider("connector", "length of the connectors", "mm", mm, connector, connector - 20, connector + 10, 0.5),
        Slider("radius", "radius of the joint", "mm", mm, radius, radius / 2, 2 * radius, 0.5),
        Slider("supply", "highest pressure", "bar", bar, highest, 2.0, highest, 0.1),
    ]
    module = SourceModule("attainableSet", _parameters(sliders))

    def fields(joint: Any) -> list[Any]:
        limits = [muscle.specimen.domain.pressure_max for muscle in (joint.muscle1, joint.muscle2)]
        return [joint.geometry.connector_length, joint.geometry.joint_radius, *limits]

    def at(parameters: Any, angle: Any) -> dict[str, Any]:
        supply = parameters["supply"]
        joint = eqx.tree_at(fields, plant.joint, [parameters["connector"], parameters["radius"], supply, supply])
        lowest, highest = joint.attainable_stiffness(angle, -plant.load.gravity_torque(angle))
        return {"lowest": lowest, "highest": highest}

    module.add("at", "lowest and highest stiffness [N*m/rad] at an angle [rad]", at, {"angle": np.zeros(())})
    text = (
        "Attainable stiffness while the knee holds each angle against gravity. Dashed: the pre-contracted "
        "knee. Longer connectors contract the muscles more; the paper's 190 mm hardly contract them."
    )
    title = "Explore the attainable stiffness over the geometry"
    return _explorer("attainable", title, text, sliders, module, {"angles": _ANGLES})


def _run(scenario: Scenario) -> Explorer:
    text = (
        f"The run of {scenario.duration:g} s with a stiffness step, simulated again in this page with the same "
        f"numbers as mckibben's, and played. Gains start at those of the scenario."
    )
    sliders = [
        _around(
            f"controller.{loop}.{gain}", f"{loop}, {label}", unit, getattr(getattr(scenario.controller, loop), gain)
        )
        for loop, gains in {"position": _GAINS, "stiffness": _STIFFNESS_GAINS}.items()
        for gain, (label, unit) in gains.items()
    ]
    return run_explorer(scenario, "Explore a run over the gains of its two PID loops", text, sliders)


def run_explorer(
    scenario: Scenario,
    title: str,
    text: str,
    sliders: list[Slider],
    charts: Sequence[Chart] = RUN_CHARTS,
    every: int = 10,
) -> Explorer:
    """Explorer of a run of a scenario; sliders have addresses of its parameters.

    Charts have columns of `mckibben.SimulationResult`. A controller's model does not follow changes of the plant. The
    run starts in the equilibrium of the given scenario.
    """
    places = {one.name: find_parameter(scenario, one.name).places for one in sliders}
    sliders = [one._replace(name=one.name.replace(".", "_")) for one in sliders]
    fixed, period, substeps = scenario.with_fixed_model(), scenario.control_period, scenario.needed_substeps()
    longest = {one.name: one.high * one.factor for one in sliders if one.name == "command_delay"}
    nominal = scenario.model_copy(update=longest).plant().with_period(period)
    reference, initial = scenario.reference(), nominal.complete_state(scenario.initial(nominal))
    names = {curve.column for chart in charts for curve in chart.curves} | {"angle", "pressure1", "pressure2"}

    def of(parameters: Any) -> tuple[JointPlant, Any]:
        values = zip(places.values(), (parameters[one.name] for one in sliders), strict=True)
        found = changed(fixed, {place: value for each, value in values for place in each})
        plant = dataclasses.replace(found.plant(), delay_periods=nominal.delay_periods)
        return plant, found.controller.with_period(period)

    def init(parameters: Any) -> Any:
        zero = jnp.zeros(())
        return initial_loop(*of(parameters), initial), Oscillation.empty(zero), (zero,) * 6

    def row(parameters: Any, state: Any, time: Any) -> tuple[Any, dict[str, Any]]:
        loop, oscillation, (count, angle, stiffness, air, *before) = state
        plant, controller = of(parameters)
        setpoint = Setpoint(reference.angle(time), reference.stiffness(time))
        loop, record = control_period(plant, controller, loop, setpoint, period, substeps)
        now = trajectory(plant, setpoint, record, record.state.angle, controller.stiffness_amplitude)
        oscillation = oscillation.after(now.angle, now.desired_angle, count, plant.sensors.angle_resolution)
        held = (now.air1, now.air2)
        inflow = sum(jnp.maximum(new - old, 0.0) for new, old in zip(held, before, strict=True))
        sums = (
            count + 1,
            angle + (now.angle - now.desired_angle) ** 2,
            stiffness + (now.stiffness - now.desired_stiffness) ** 2,
            air + jnp.where(count > 0, inflow, 0.0),
            *held,
        )
        return (loop, oscillation, sums), {name: getattr(now, name) for name in sorted(names)}

    def summary(parameters: Any, state: Any) -> dict[str, Any]:
        _, oscillation, (count, angle, stiffness, air, *_) = state
        cycle = oscillation.limit_cycle(round(scenario.duration / period), period)
        error = jnp.sqrt(angle / count) / deg
        return {
            "angle": error,
            "stiffness": jnp.sqrt(stiffness / count),
            "air": air / litre,
            "amplitude": cycle.amplitude / deg,
            "frequency": 1 / cycle.period,
            "diverged": jnp.where(error < 1 / deg, 0.0, 1.0),
        }

    says = [
        ("diverged", "The joint diverges."),
        ("amplitude", "Limit cycle of {amplitude}° at {frequency} Hz. " + _ERRORS),
        ("", _ERRORS),
    ]
    times = (0.0, scenario.duration - period, round(scenario.duration / period))
    table = ComputedRows(row, times, Axis("time, s", 0.0, scenario.duration), charts, says, init, summary, every=every)
    picture = _picture(nominal) if isinstance(nominal.joint.geometry, KneeGeometry) else None
    return rows_explorer("run", title, text, sliders, table, picture)


def _picture(plant: JointPlant) -> Callable[..., dict[str, Any]]:
    def picture(parameters: Any, angle: Any, pressure1: Any, pressure2: Any) -> dict[str, Any]:
        """Ends of muscles and connectors, lengths and diameters of the muscles [m]."""
        joint, found = plant.joint, {}
        contractions = joint.contractions(angle, (pressure1, pressure2))
        pairs = zip((joint.muscle1, joint.muscle2), joint.geometry.anchors(angle), contractions, strict=True)
        for number, (muscle, ends, contraction) in enumerate(pairs, 1):
            assert ends is not None
            for end, place in zip(("fixed", "moving"), ends, strict=True):
                found |= {f"{end}_x{number}": place[0], f"{end}_y{number}": place[1]}
            length = muscle.specimen.length_at(contraction)
            diameter = jnp.sqrt(4 * muscle.specimen.volume(contraction) / (jnp.pi * length))
            found |= {f"length{number}": length, f"diameter{number}": diameter}
        return found

    return picture


def rows_explorer(
    key: str,
    title: str,
    text: str,
    sliders: list[Slider],
    rows: ComputedRows,
    picture: Callable[..., dict[str, Any]] | None = None,
) -> Explorer:
    """Explorer of a table of rows that functions of its sliders compute; `picture` draws a joint in motion."""
    number = np.zeros(())
    module = SourceModule("rows", _parameters(sliders))
    if rows.init is None:
        module.add("row", "columns of a row", rows.row, {"x": number})
        if rows.summary is not None:
            module.add("summary", "numbers of the text", rows.summary, {})
    else:
        init, row, summary = rows.init, rows.row, rows.summary
        state = jax.eval_shape(lambda: init(module.parameters))
        state = jax.tree.map(lambda one: np.zeros(one.shape, one.dtype), state)

        def next_row(parameters: Any, state: Any, x: Any) -> dict[str, Any]:
            following, columns = row(parameters, state, x)
            return {"state": following, **columns}

        module.add("init", "initial state", lambda parameters: {"state": init(parameters)}, {})
        module.add("row", "columns of the next row", next_row, {"state": state, "x": number})
        if summary is not None:
            module.add("summary", "numbers of the text", summary, {"state": state})
    if (points := rows.points) is not None:
        module.add("points", "arrays over points", lambda parameters: {"points": points(parameters)}, {})
    if picture is not None:
        given = {"angle": number, "pressure1": number, "pressure2": number}
        module.add("picture", "ends, lengths and diameters of the muscles [m]", picture, given)
    options = {
        "range": rows.range,
        "every": rows.every,
        "x": rows.across._asdict(),
        "charts": [_chart_options(one) for one in rows.charts],
        "says": rows.says,
        "picture": picture is not None,
    }
    script = f'{write_js(module)}explorer.table("explore-{key}", {module.name}, {json.dumps(options)});'
    return Explorer(key, title, text, sliders, markupsafe.Markup(script), picture is not None)


def _chart_options(chart: Chart) -> dict[str, Any]:
    """Options of a chart without those that are None, which the script has defaults for."""
    found = {name: value for name, value in chart._asdict().items() if value is not None}
    curves = [{name: value for name, value in one._asdict().items() if value} for one in chart.curves]
    return found | {"curves": curves} | ({} if chart.across is None else {"across": chart.across._asdict()})
