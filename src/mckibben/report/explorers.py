"""Parts of the report with sliders: functions of a scenario as JavaScript, evaluated in the page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import markupsafe
import numpy as np

from mckibben.codegen import SourceModule, write_js
from mckibben.control import Setpoint
from mckibben.joint.geometry import KneeGeometry
from mckibben.simulation.loop import control_period, initial_loop
from mckibben.units import bar, factor, mm

if TYPE_CHECKING:
    from mckibben.muscle import Muscle
    from mckibben.plant import JointPlant
    from mckibben.scenario import Scenario

KEYS = ("force", "attainable", "run")
_ANGLES = (-45.0, 45.0)  # deg
_GAINS = {
    "kp": ("proportional", "bar/rad"),
    "ki": ("integral", "bar/(rad*s)"),
    "kd": ("derivative", "bar*s/rad"),
}
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
    """Title, text, sliders, and the scripts that compute and draw."""

    key: str
    title: str
    text: str
    sliders: list[Slider]
    script: markupsafe.Markup


def explorers(scenario: Scenario, keys: Sequence[str] = KEYS) -> dict[str, Explorer]:
    """Force law, attainable stiffness, and run of a scenario of the knee with two PID loops."""
    plant = scenario.plant()
    made = {
        "force": lambda: _force(plant.joint.muscle1),
        "attainable": lambda: _attainable(plant),
        "run": lambda: _run(scenario, plant),
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


def _run(scenario: Scenario, plant: JointPlant) -> Explorer:
    controller: Any = scenario.control()
    substeps = scenario.needed_substeps()
    initial = plant.complete_state(scenario.initial(plant))
    reference, loops = scenario.reference(), {"position": _GAINS, "stiffness": _STIFFNESS_GAINS}
    places = [(loop, gain) for loop, gains in loops.items() for gain in gains]
    sliders = [
        _around(f"{loop}_{gain}", f"{loop}, {label}", unit, getattr(getattr(controller, loop), gain))
        for loop, gains in loops.items()
        for gain, (label, unit) in gains.items()
    ]
    module = SourceModule("closedLoop", _parameters(sliders))

    def of(parameters: Any) -> Any:
        def fields(controller: Any) -> list[Any]:
            return [getattr(getattr(controller, loop), gain) for loop, gain in places]

        return eqx.tree_at(fields, controller, [parameters[one.name] for one in sliders])

    def init(parameters: Any) -> dict[str, Any]:
        return {"state": initial_loop(plant, of(parameters), initial)}

    def period(parameters: Any, state: Any, time: Any) -> dict[str, Any]:
        setpoint = Setpoint(reference.angle(time), reference.stiffness(time))
        given = scenario.control_period, substeps
        state, record = control_period(plant, of(parameters), state, setpoint, *given)
        at = record.state
        stiffness = plant.joint.evaluate(at.angle, at.pressures)[1]
        return {
            "state": state,
            "angle": at.angle,
            "stiffness": stiffness,
            "pressure1": at.pressures[0],
            "pressure2": at.pressures[1],
            "desired_angle": setpoint.angle,
            "desired_stiffness": setpoint.stiffness,
        }

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

    state = jax.eval_shape(lambda: init(module.parameters)["state"])
    state = jax.tree.map(lambda one: np.zeros(one.shape, one.dtype), state)
    module.add("init", "initial state", init, {})
    module.add("period", "one control period", period, {"state": state, "time": np.zeros(())})
    number = np.zeros(())
    given = {"angle": number, "pressure1": number, "pressure2": number}
    module.add("picture", "ends, lengths and diameters of the muscles [m]", picture, given)
    count = round(scenario.duration / scenario.control_period)
    text = (
        f"The run of {scenario.duration:g} s with a stiffness step, simulated again in this page with the same "
        f"numbers as mckibben's, and played. Gains start at those of the scenario."
    )
    options = {"period": scenario.control_period, "count": count}
    return _explorer("run", "Explore a run over the gains of its two PID loops", text, sliders, module, options)
