"""A joint for OpenSim: muscles at constant pressures as forces given by expressions of their path lengths.

Forces are texts (`ExpressionBasedPathForce`, or `ExpressionBasedCoordinateForce` for a path that OpenSim does not
support), so that the model needs nothing but OpenSim. Valves, friction and creep are omitted.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple, TypeAlias

from jaxtyping import PyTree

from mckibben.actuator import IdealValve
from mckibben.codegen.graph import FOLDED as NUMERIC
from mckibben.errors import ExportError
from mckibben.export.drives import Transmission, muscle_drive, muscle_functions, transmissions
from mckibben.export.evaluation import evaluate, find_function
from mckibben.export.mjcf import gravity_of, mass_point
from mckibben.export.targets import Exported, filled
from mckibben.muscle.creep import NoCreep
from mckibben.muscle.friction import NoFriction
from mckibben.plant import JointPlant
from mckibben.scenario import Scenario
from mckibben.units import bar

_LONGEST = 40  # characters of an expression without a name
_MOST = 100_000  # characters with all names expanded, as OpenSim does: a million took 20 s to read


class OsimModel(NamedTuple):
    """Text of an .osim file, the expressions of both muscles, and the omitted parts.

    An expression gives the tension [N] as a function of the stretch ``s`` [m] of the path beyond `rest` [m] or, if
    OpenSim does not support the path, the torque [N*m] as a function of the coordinate ``q`` [rad].
    """

    text: str
    expressions: tuple[str, ...]
    rest: tuple[float | None, ...]
    left_out: tuple[str, ...]


def osim_model(plant: JointPlant, pressures: tuple[float, float], name: str = "joint") -> OsimModel:
    """The joint and load of a plant for OpenSim 4.6, at constant gauge pressures [Pa] of both muscles.

    Raises `ExportError` for a force without a closed form, paths of tables, and loads with a torque other than gravity.
    """
    joint = plant.joint
    muscles = [
        dataclasses.replace(muscle, friction=NoFriction(), creep=NoCreep()) for muscle in (joint.muscle1, joint.muscle2)
    ]
    static = dataclasses.replace(joint, muscle1=muscles[0], muscle2=muscles[1])
    plant_without = JointPlant(static, plant.load, IdealValve())
    moved = [path if path.points else Transmission() for path in transmissions(joint.geometry)]
    start = plant_without.init_state(0.0, (0.0, 0.0))
    drives = [
        muscle_drive(f"muscle{i + 1}", i, lambda plant: plant.joint, i, path.offset, "" if path.points else "joint")
        for i, path in enumerate(moved)
    ]
    module, _ = muscle_functions(plant_without, name, drives, start)
    left_out = ["valves: the pressures are constant"]
    left_out += [] if plant.has_ideal_io else ["sensors and disturbance of the plant"]
    left_out += ["friction and creep of the muscles"] if joint.has_friction or joint.has_creep else []
    left_out += [] if plant.friction is None else ["friction of the joint"]
    expressions, rests, drawn = [], [], []
    for number, (path, muscle, pressure) in enumerate(zip(moved, muscles, pressures, strict=True), 1):
        rest = float(muscle.specimen.initial_length - path.offset) if path.points else None
        lines = _Expression()
        arguments = {"length": "q" if rest is None else f"(s+{rest!r})", "velocity": 0.0, "command": float(pressure)}
        inputs = {f"input{number}.{key}": value for key, value in arguments.items()}
        try:
            force = evaluate(module, find_function(module.functions, f"force{number}"), lines, inputs)["force"][0]
            expressions.append(lines.text(force if rest is None else lines["neg"](force)))
        except ExportError as error:
            parts = f"{type(muscle.law).__name__}, {type(joint.geometry).__name__}"
            message = f"OpenSim cannot express the force of muscle {number} ({parts}): {error.message}"
            remedy = "use a law with a closed-form force, and paths without tables"
            raise ExportError(message, field=f"muscle{number}", value=parts, remedy=remedy) from None
        rests.append(rest)
        if rest is None:
            left_out.append(f"path of muscle {number}: not supported by OpenSim; its torque acts on the joint")
        values = {"number": number, "pressure": f"{pressure / bar:.6g}", "expression": escape(expressions[-1])}
        ends = (f"{x!r} {y!r}" for x, y in path.points)
        drawn.append(values | {"rest": rest} | dict(zip(("fixed", "moving"), ends, strict=False)))
    text = _osim(plant, name, drawn)
    return OsimModel(text, tuple(expressions), tuple(rests), (*left_out, *mass_point(plant.load).assumed))


Atom: TypeAlias = PyTree
"""A number, the text of an expression, or a condition."""


class _Condition(NamedTuple):
    """A condition as an expression that is 1 or 0; for a comparison, its lower and upper side."""

    share: str
    below: str = ""
    above: str = ""


class _Expression(dict[str, Callable[..., PyTree]]):
    """Operations that write an expression for OpenSim, with folded constants and names of long subexpressions."""

    _SAME = ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "abs", "floor",
             "ceil", "max", "min")  # fmt: skip
    _INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "^"}  # noqa: RUF012

    def __init__(self) -> None:
        self._names: dict[str, str] = {}
        written: dict[str, Callable[..., PyTree]] = {
            name: lambda *xs, name=name: f"{name}({','.join(xs)})" for name in self._SAME
        }
        written |= {name: lambda x, y, sign=sign: f"({x}{sign}{y})" for name, sign in self._INFIX.items()}
        written |= dict.fromkeys(("lt", "le"), lambda x, y: _Condition(f"step({y}-{x})", x, y))
        written |= dict.fromkeys(("gt", "ge"), lambda x, y: _Condition(f"step({x}-{y})", y, x))
        written["eq"] = lambda x, y: _Condition(f"(step({x}-{y})*step({y}-{x}))")
        written |= {"neg": lambda x: f"(-{x})" if not x.startswith("(-") else x[2:-1], "real": lambda x: x}
        super().__init__({name: self._folded(name, function) for name, function in written.items()})
        self["select"] = self._select

    def text(self, result: Atom) -> str:
        """The whole expression."""
        sizes: dict[str, int] = {}
        for text, name in [*self._names.items(), (str(result), "")]:
            sizes[name] = len(text) + sum(sizes[name] for name in re.findall(r"\bv\d+", text))
        if sizes[""] > _MOST:
            raise ExportError(f"expanded, it has {sizes['']} characters, more than {_MOST}", field="expression")
        definitions = [f"{name}={text}" for text, name in self._names.items()]
        return ";".join([str(result), *reversed(definitions)])  # definitions follow their use

    def _folded(self, name: str, function: Callable[..., PyTree]) -> Callable[..., PyTree]:
        """Operation that is computed if all its arguments are numbers, and written otherwise."""

        def operation(*arguments: PyTree) -> Atom:
            if not any(isinstance(argument, str) for argument in arguments):
                return NUMERIC[name](*arguments)
            if name in ("add", "sub") and 0 in arguments[1:]:
                return arguments[0]
            return self._named(function(*map(_number, arguments)))

        return operation

    def _named(self, text: Atom) -> Atom:
        """An expression by its name, if it is long."""
        if isinstance(text, str) and len(text) > _LONGEST:
            return self._names.setdefault(text, f"v{len(self._names) + 1}")
        return text

    def _select(self, condition: Atom, yes: Atom, no: Atom) -> Atom:
        """Choice by a condition: the maximum with 0, or a sum of both sides with the shares 1 and 0."""
        if not isinstance(condition, _Condition):
            return yes if condition else no
        share, below, above = condition
        if above == _number(0.0) and yes == 0.0 and no == below:  # keeps a muscle from pushing
            return self._named(f"max(0,{no})")
        return self._named(f"({share}*{_number(yes)}+(1-{share})*{_number(no)})")


def _number(value: Atom) -> str:
    """Text of an atom."""
    if isinstance(value, str):
        return value
    return repr(float(value)) if value >= 0 or math.isnan(value) else f"({float(value)!r})"


def _osim(plant: JointPlant, name: str, muscles: Sequence[dict[str, object]]) -> str:
    """The document; gravity is rotated by the hanging angle, as the limb hangs along -y at angle 0."""
    hanging, gravity, point = float(plant.load.hanging_angle), gravity_of(plant.load), mass_point(plant.load)
    values = {
        "name": name,
        "gravity": f"{gravity * math.sin(hanging)!r} {-gravity * math.cos(hanging)!r}",
        "mass": repr(point.mass),
        "centre": repr(-point.distance),
        "inertia": repr(point.inertia),
        "damping": repr(float(plant.load.damping)),
        "muscles": muscles,
    }
    return filled("model.osim", values)


def osim_files(scenario: Scenario, name: str, folder: Path) -> Exported:
    """The joint of a scenario at its initial pressures.

    Raises `ExportError` as `osim_model` does.
    """
    plant = scenario.plant()
    pressure1, pressure2 = (float(pressure) for pressure in scenario.initial(plant).pressures)
    model = osim_model(plant, (pressure1, pressure2), name)
    left_out = ("controller and reference of the scenario", *model.left_out)
    return Exported({f"{name}.osim": model.text, "scenario.yaml": scenario.dumps(folder=folder)}, left_out)
