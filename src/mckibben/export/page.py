"""Page of a scenario: one HTML file in which its run is computed, and its joint moves under a finger.

The programs are those of the simulation, emitted as JavaScript: plant with sensors, controller, metrics and attainable
stiffness. Sliders are parameters of the scenario, on which the numbers of its plant and controller depend linearly.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.javascript import write_js
from mckibben.codegen.source_module import Member, SourceModule, members_of
from mckibben.control import Setpoint
from mckibben.errors import ExportError, McKibbenError
from mckibben.export.targets import Exported, filled
from mckibben.joint.linkage import Strand, linkage_of, specimen_size
from mckibben.muscle import Muscle
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant
from mckibben.scenario import Scenario, StudiedScenario, list_parameters, with_values
from mckibben.simulation.feasibility import static_band, static_bands
from mckibben.simulation.loop import begun, control_period
from mckibben.simulation.metrics import Accumulation, Change, Metrics, angle_at_end, values_of
from mckibben.simulation.outcome import FOLLOWED, LEAST_MOTION, LEFT_REFERENCE_AT, OUTCOMES, STROKE, SWUNG_OVER_AT
from mckibben.simulation.trajectories import column_of, trajectory
from mckibben.study.parameters.sampling import SweptParameter, parse_sweeps
from mckibben.study.parameters.uncertainty import uncertainty
from mckibben.units import quantity

COLUMNS = (
    *("angle", "desired_angle", "stiffness", "desired_stiffness", "torque", "pressure1", "pressure2", "command1"),
    *("command2", "force1", "force2", "contraction1", "contraction2", "saturated", "slack", "outside_domain"),
)
"""Columns of a run on the page."""
_AROUND = 0.5, 1.5  # of its value, the ends of a slider that is not asked for
_POINTS = 49  # of the drawing, over the angle and over the contraction
_LEADS = "A pneumatic muscle sets the", "Two pneumatic muscles set stiffness and"
_EXACT = 1e-9  # of the largest change of a number by a slider: it is linear but for rounding


@dataclass(frozen=True)
class Slider:
    """A parameter of the scenario on the page, and by how much each number of the program changes with it.

    Attributes
    ----------
    swept
        The parameter with the ends of its range.
    nominal
        Its value in the scenario [SI].
    slopes
        Changes of the program's parameters by name, one for each of their elements.
    of_model
        Whether a change is one of the controller's model, which may know the value or not, by name.
    """

    swept: SweptParameter
    nominal: float
    slopes: Mapping[str, NDArray[np.float64]]
    of_model: Mapping[str, bool]


class _Parts(NamedTuple):
    """Plant, controller and reference of a scenario, and angle and stiffness at its start."""

    plant: PyTree
    controller: PyTree
    reference: PyTree
    start: PyTree


def page_files(scenario: StudiedScenario, name: str, folder: Path, *, over: Sequence[str] = ()) -> Exported:
    """A page of a scenario of a joint, which needs no other file and no network.

    Parameters
    ----------
    scenario
        Scenario of a joint with a controller.
    name
        Name of the program in the page.
    folder
        Folder of the export, to which paths in the scenario are relative.
    over
        Sliders: parameters of the scenario, with ranges such as ``load.mass2=0.2..2 kg``. Default: the numbers of the
        reference and the scenario's uncertainty, from half to one and a half times their values.

    Raises
    ------
    ExportError
        For a robot, for a controller that knows setpoints in advance, for parts that need 64-bit integers, and for a
        slider on which the numbers of plant or controller do not depend linearly.
    """
    if not isinstance(scenario, Scenario):
        remedy = "write its controller with --to js"
        raise ExportError("the page draws one joint", field="joints", remedy=remedy)
    parts = _parts(scenario)
    if parts.controller.samples_ahead:
        remedy = "leave out its preview"
        raise ExportError("the page's setpoints are not known in advance", field="controller", remedy=remedy)
    varied, sliders, left_out = _sliders(scenario, over)
    parts = _parts(varied)
    substeps = max(_needed_substeps(varied, corner) for corner in _corners(sliders))
    module = page_program(parts, name, scenario.control_period, substeps)
    text = scenario.dumps(folder=folder)
    program = write_js(module, f"Simulation of the scenario {scenario.name!r}: {substeps} steps per control period.")
    start, kind = (parts.start["angle"], parts.start["stiffness"]), scenario.joint_type
    first = parts.reference(0.0)
    stiffness = _stiffness_range(parts)
    settings = {
        "period": scenario.control_period,
        "periods": round(scenario.duration / scenario.control_period),
        "startsAtReference": bool(start[0] == first.angle and (np.isnan(start[1]) or start[1] == first.stiffness)),
        "columns": COLUMNS,
        "angle": {"name": kind.words("angle"), "unit": kind.shown("deg"), "scale": kind.size("deg")},
        "stiffness": stiffness | {"unit": kind.shown("N*m/rad"), "scale": kind.size("N*m/rad")},
        "rules": {
            "followed": FOLLOWED,
            "left": LEFT_REFERENCE_AT * kind.scale,
            "swungOver": SWUNG_OVER_AT * kind.scale,
            "stroke": STROKE,
            "leastAngle": LEAST_MOTION[0] * kind.scale,
            "leastStiffness": LEAST_MOTION[1],
        },
        "outcomes": {outcome.name: outcome.sentence(kind) for outcome in OUTCOMES},
        "sliders": [_described(slider) for slider in sliders],
        "drawing": _drawing(parts.plant),
    }
    values = {
        "title": scenario.name,
        "name": name,
        "lead": f"{_LEADS[int(stiffness['isAsked'])]} {kind.words('angle')}",
        "settings": _script(json.dumps(settings)),
        "program": _script(program),
    }
    values |= {"style": _resource("page.css"), "run": _resource("page-run.js"), "view": _resource("page-view.js")}
    return Exported({f"{name}.html": filled("page.html", values), "scenario.yaml": text}, tuple(left_out))


def _resource(name: str) -> str:
    return _script((files("mckibben.export") / "templates" / name).read_text(encoding="utf-8"))


def _script(text: str) -> str:
    """Text that may stand in a page's element."""
    return text.replace("</", "<\\/")


def page_program(parts: PyTree, name: str, period: float, substeps: int) -> SourceModule:
    """Program of a run: its start, a control period, its metrics, its reference and the attainable stiffness.

    The parameters are all real numbers of the parts: plant, controller, reference, and the angle and stiffness at the
    start, NaN for any.
    """
    numbers, fixed = eqx.partition(parts, eqx.is_inexact_array_like)
    zero, whole = jnp.zeros(()), jnp.zeros((), int)

    def started(parameters: PyTree, start: PyTree) -> tuple[PyTree, Array]:
        plant, controller, *_ = eqx.combine(parameters, fixed)
        state, exists = plant.find_equilibrium(start["angle"], start["stiffness"])
        loop, _ = begun(plant, controller, None, state, period, period / substeps)  # it foresees no setpoints
        return loop, exists

    def moved(parameters: PyTree, loop: PyTree, setpoint: Setpoint) -> tuple[PyTree, PyTree]:
        plant, controller, *_ = eqx.combine(parameters, fixed)
        following, record = control_period(plant, controller, loop, setpoint, period, substeps)
        amplitude = controller.stiffness_amplitude
        return following, trajectory(plant, setpoint, record, loop[0].angle, amplitude)

    def change_of(change: PyTree) -> Change:
        return Change(change["at"], change["before"], change["after"], change["ends"] > 0)

    def init(parameters: PyTree, start: PyTree) -> dict[str, PyTree]:
        loop, exists = started(parameters, start)
        return {"state": {"loop": loop, "sums": empty}, "exists": exists}

    def step(parameters: PyTree, state: PyTree, setpoint: Setpoint, run: PyTree, change: PyTree) -> dict[str, PyTree]:
        plant = eqx.combine(parameters, fixed)[0]
        following, now = moved(parameters, state["loop"], setpoint)
        resolution = plant.sensors.angle_resolution
        sums = state["sums"].after(now, run["index"], run["periods"], change_of(change), resolution)
        seen = {column: jnp.asarray(column_of(now, column), float) for column in COLUMNS}
        return {"state": {"loop": following, "sums": sums}, "seen": seen}

    def measure(parameters: PyTree, state: PyTree, run: PyTree, change: PyTree) -> dict[str, PyTree]:
        totals = state["sums"].totals
        whole = state["sums"].run(run["periods"], period, change_of(change))
        metrics = values_of(Metrics, totals, whole)._asdict() | {"angle_at_end": angle_at_end(totals, whole)}
        del metrics["coupling"]  # needs a second run
        return {"metrics": {name: jnp.asarray(value, float) for name, value in metrics.items()}}

    def reference(parameters: PyTree, time: Array) -> dict[str, PyTree]:
        setpoint = eqx.combine(parameters, fixed)[2](time)
        return {"setpoint": {"angle": jnp.asarray(setpoint.angle), "stiffness": jnp.asarray(setpoint.stiffness)}}

    def attainable(parameters: PyTree, angle: Array) -> dict[str, PyTree]:
        plant, controller, *_ = eqx.combine(parameters, fixed)
        low, high = static_bands.function((plant, controller.stiffness_amplitude, 0.0), angle)
        return {"band": {"lowest": low, "highest": high}}

    setpoint, start = Setpoint(zero, zero), {"angle": zero, "stiffness": zero}
    loop = jax.eval_shape(lambda numbers: started(numbers, start)[0], numbers)
    one_period = jax.eval_shape(moved, numbers, loop, setpoint)[1]
    empty = Accumulation.empty(one_period)
    state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), {"loop": loop, "sums": empty})
    of_run = {
        "run": {"index": whole, "periods": whole},
        "change": {"at": whole, "before": zero, "after": zero, "ends": whole},
    }
    module = SourceModule(name, numbers)
    text = "state at rest at an angle [rad] and a stiffness [N*m/rad]; whether it exists"
    module.add("init", text, init, {"start": start})
    module.add("step", "one control period", step, {"state": state, "setpoint": setpoint} | of_run)
    module.add("measure", "metrics of the run", measure, {"state": state} | of_run)
    module.add("reference", "setpoint at a time [s]", reference, {"time": zero})
    module.add("attainable", "attainable stiffness [N*m/rad] at an angle [rad]", attainable, {"angle": zero})
    return module


def _parts(scenario: Scenario) -> _Parts:
    """Numeric parts of a scenario; all of their numbers are arrays of one element or more."""
    period, start = scenario.control_period, scenario.start
    plant, controller = scenario.plant().with_period(period), scenario.control().with_period(period)
    begin = {"angle": start.angle, "stiffness": np.nan if start.stiffness is None else start.stiffness}
    return _Parts(*numeric((plant, controller, scenario.reference(), begin)))


def _sliders(scenario: Scenario, texts: Sequence[str]) -> tuple[Scenario, list[Slider], list[str]]:
    """The scenario with the values of its sliders; those that are asked for, or the `_usual` ones; those left out."""
    swept = parse_sweeps(texts or [*_usual(scenario)], scenario)
    nominal = {parameter.name: _nominal(parameter) for parameter in swept}
    varied = with_values(scenario, nominal, model_follows="all")
    numbers, sliders, left_out = _numbers(varied), [], []
    for parameter in swept:
        try:
            sliders.append(_slider(varied, numbers, parameter))
        except ExportError as error:
            if texts:
                raise
            left_out.append(f"the slider of {parameter.name}: {error}")
    return varied, sliders, left_out


def _usual(scenario: Scenario) -> Iterable[str]:
    """Texts of the numbers of the reference that are not 0, and of what is uncertain, around their values."""
    references = [parameter for parameter in list_parameters(scenario) if parameter.part == "reference"]
    uncertain = [swept.parameter for group in uncertainty(scenario) for swept in group]
    for parameter in references + uncertain:
        if parameter.nominal:
            low, high = sorted(parameter.nominal * share for share in _AROUND)
            yield f"{parameter.name}={parameter.write(low)}..{parameter.write(high)}"


def _nominal(swept: SweptParameter) -> float:
    """Value of a parameter in its scenario, or the middle of its range."""
    value = swept.parameter.nominal
    return float(np.mean(swept.distribution.bounds) if value is None else value)


def _slider(scenario: Scenario, numbers: _Numbers, swept: SweptParameter) -> Slider:
    """Slider of a parameter; `ExportError` if numbers do not depend on it linearly, or have another form."""
    low, high = (float(bound) for bound in swept.distribution.bounds)
    nominal, values = _nominal(swept), []
    for value in (low, high, (low + high) / 2):
        changed = _numbers(with_values(scenario, {swept.name: value}, model_follows="all"))
        if changed.form != numbers.form:
            remedy = "give another slider"
            raise ExportError(f"the form of the program depends on {swept.name}", field=swept.name, remedy=remedy)
        values.append(changed.values)
    slopes, of_model = {}, {}
    of_plant = swept.parameter.part in scenario.plant_parts
    for member, base, first, last, middle in zip(numbers.members, numbers.values, *values, strict=True):
        with np.errstate(invalid="ignore"):  # limits that are infinite, and stay so
            slope, moved = (last - first) / (high - low), np.nan_to_num(np.abs(last - first))
            bent = np.abs(middle - (first + last) / 2) + np.abs(base - first - slope * (nominal - low))
        if np.any(np.nan_to_num(bent) > _EXACT * moved):
            text = f"{member.path} does not depend on {swept.name} linearly"
            raise ExportError(text, field=swept.name, remedy="give another slider")
        if np.any(np.nan_to_num(slope)):
            slopes[member.name] = np.ravel(slope)
            of_model[member.name] = of_plant and member.path.startswith("controller.")
    return Slider(swept, nominal, slopes, of_model)


class _Numbers(NamedTuple):
    """Real numbers of the parts of a scenario, their names in the program, and the form of all that is fixed."""

    members: list[Member]
    values: list[NDArray[np.float64]]
    form: object


def _numbers(scenario: Scenario) -> _Numbers:
    numbers, fixed = eqx.partition(_parts(scenario), eqx.is_inexact_array_like)
    values, form = [np.asarray(leaf) for leaf in jax.tree.leaves(numbers)], jax.tree.structure(numbers)
    return _Numbers(members_of(numbers), values, (form, [np.shape(x) for x in values], repr(jax.tree.leaves(fixed))))


def _corners(sliders: Sequence[Slider]) -> list[dict[str, float]]:
    """Values at which all sliders, or each alone, are at an end."""
    ends = [{slider.swept.name: float(slider.swept.distribution.bounds[end]) for slider in sliders} for end in (0, 1)]
    alone = [{name: value} for end in ends for name, value in end.items()]
    return [{}, *alone, *(ends if sliders else [])]


def _needed_substeps(scenario: Scenario, values: Mapping[str, float]) -> int:
    """Integration steps of a scenario with other values; 1 where it cannot start, as nothing is computed there."""
    if scenario.substeps is not None:
        return scenario.substeps
    try:
        changed = with_values(scenario, values, model_follows=()) if values else scenario
        return changed.needed_substeps()
    except McKibbenError:
        return 1


def _described(slider: Slider) -> dict[str, object]:
    """A slider as the page needs it."""
    parameter, (low, high) = slider.swept.parameter, slider.swept.distribution.bounds
    return {
        "name": parameter.name,
        "unit": parameter.shown,
        "scale": quantity(f"1 {parameter.shown}".removesuffix(" 1"), parameter.unit),
        "nominal": slider.nominal,
        "low": low,
        "high": high,
        "slopes": {name: slope.tolist() for name, slope in slider.slopes.items()},
        "ofModel": [name for name, of_model in slider.of_model.items() if of_model],
    }


def _stiffness_range(parts: _Parts) -> dict[str, float | bool]:
    """Lowest and highest stiffness [N*m/rad] at which the joint holds its load as drawn; whether one is asked for."""
    low, high = static_band(parts.plant, _drawn(parts.plant), None)
    lowest, highest = float(np.nanmin(low)), float(np.nanmax(high))
    return {"low": lowest, "high": highest, "isAsked": bool(np.isfinite(parts.reference(0.0).stiffness))}


def _drawn(plant: JointPlant) -> NDArray[np.float64]:
    """Angles [rad] of the drawing."""
    joint = plant.joint
    (low, high), limits = joint.geometry.span(joint.muscles), joint.geometry.angle_range
    return np.linspace(max(low, limits[0]), min(high, limits[1]), _POINTS)


def _drawing(plant: JointPlant) -> dict[str, object]:
    """Bodies, pulleys and muscles over the angle, and sizes of the muscles over the contraction.

    Points are in the picture: its unit is a thousandth of the mechanism, y points down, and the fixed limb upwards.
    """
    joint, angles = plant.joint, _drawn(plant)
    linkage = linkage_of(joint.geometry, angles.tolist(), plant.load)
    scale, (x, y) = 1000 / linkage.height, linkage.up
    frame = scale * np.array([[y, -x], [-x, -y]])

    def placed(points: ArrayLike) -> list:
        return np.round(np.asarray(points) @ frame.T, 1).tolist()

    def described(strand: Strand | None) -> dict[str, list] | None:
        if strand is None:
            return None
        return {"start": placed(strand.start), "end": placed(strand.end), "wrap": placed(strand.wrap[::5])}

    bodies = [linkage.bodies(angle) for angle in angles.tolist()]
    return {
        "angles": angles.tolist(),
        "strands": [list(map(described, linkage.strands(angle))) for angle in angles.tolist()],
        "cams": [[placed(cam[::4]) for cam in linkage.cams(angle)] for angle in angles.tolist()],
        "thick": [list(map(placed, each.thick)) for each in bodies],
        "thin": [list(map(placed, each.thin)) for each in bodies],
        "moving": [placed(linkage.moving(angle)) for angle in angles.tolist()],
        "tips": [placed(linkage.tip(angle)) for angle in angles.tolist()],
        "masses": [placed(linkage.masses(angle)) for angle in angles.tolist()],
        "pivots": placed(linkage.pivots),
        "muscles": [_muscle_sizes(muscle, scale) for muscle in joint.muscles],
    }


def _muscle_sizes(muscle: Muscle, scale: float) -> dict[str, object]:
    """Highest pressure of a muscle, and its length and width in the picture over the contraction; none for a spring."""
    highest = float(muscle.domain.pressure_max)
    if muscle.law.is_passive:
        return {"spring": True, "highest": highest}
    contractions = np.linspace(muscle.domain.contraction_min, muscle.domain.contraction_max, _POINTS)
    length, width = specimen_size(muscle.specimen, contractions)
    return {
        "spring": False,
        "highest": highest,
        "contractions": np.round(contractions, 5).tolist(),
        "lengths": np.round(scale * length, 1).tolist(),
        "widths": None if width is None else np.round(scale * width, 1).tolist(),
    }
