"""Robots from MJCF and URDF: MuJoCo reads a file, and bodies, hinges, inertias and spatial tendons become ours."""

from __future__ import annotations

import dataclasses
import fnmatch
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from mckibben.component.schema import ComponentField, parse_component
from mckibben.config.document import LONGEST_TEXT, read_document
from mckibben.config.model import read_text, validated
from mckibben.errors import ParameterError, Problem, RangeError, ScenarioError, quoted, suggest
from mckibben.mechanism.bodies import Body, BodyPoint, Foot, Freedom, Joint, PathElement, Place
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.mechanism.muscles import PathMuscle
from mckibben.mechanism.robot import Robot
from mckibben.mechanism.wrapping import TendonPulley, WrapCylinder, WrapSphere, check_path
from mckibben.muscle import Muscle, return_spring
from mckibben.result import Column, Listing, Remark, Result, table
from mckibben.scenario.model_comparison import differences, is_spring, path_ranges
from mckibben.scenario.model_file import Coordinate, ModelFile
from mckibben.scenario.robot import RobotScenario
from mckibben.units import GRAVITY, deg, mm

Floats = NDArray[np.float64]

_BASES: dict[tuple[str, ...], Freedom] = {
    ("z",): "vertical",
    ("x", "z"): "planar",
    ("x", "z", "turn about y"): "free",
    ("x", "y", "z"): "spatial",
}
"""Motions of the base by the axes of its slides, and of a hinge after them."""


class ReadRobot(Result):
    """A robot read from MJCF or URDF.

    Attributes
    ----------
    name
        Name of the model.
    robot
        Bodies, joints, springs, and the muscles of tendons if they were given.
    tendons
        Points, surfaces and pulleys of each spatial tendon by its name.
    paths
        Shortest and longest path [m] of each, within the ranges of the joints.
    left_out
        What is not carried over, with the line of the file, and what differs from the model of the file.
    assumed
        Ranges that the file does not give.
    """

    files = ("robot.yaml",)

    name: str
    robot: Robot
    tendons: dict[str, tuple[PathElement, ...]]
    paths: dict[str, tuple[float, float]]
    left_out: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()

    def scenario(self) -> RobotScenario:
        """Return the robot as a file; `ParameterError` if the muscles of its tendons were not given."""
        if set(self.tendons).difference(self.robot.muscle_names):
            message = "a tendon has points but no muscle"
            remedy = "give the muscle of all tendons: mckibben robot read ROBOT.xml MUSCLE.yaml --out DIR"
            raise ParameterError(message, field="muscle", remedy=remedy)
        return RobotScenario(name=self.name, robot=self.robot)

    def verdict(self) -> str:
        """Return the numbers of its parts."""
        return f"{len(self.robot.bodies)} bodies, {len(self.robot.joints)} joints, {len(self.tendons)} tendons"

    def remarks(self) -> Iterator[Remark]:
        """Yield a warning for each part that is not carried over."""
        for part in self.left_out:
            yield Remark.warning("left_out", f"not carried over: {part}")
        for part in self.assumed:
            yield Remark.warning("assumed", f"assumed: {part}")

    @table()
    def joints_and_tendons(self) -> Iterator[Listing]:
        """Yield tables of joints and tendons."""
        joints, frames = self.robot.joints, self.robot.frame_names
        columns: dict[str, tuple[Column, Sequence[object]]] = {
            "joint": (Column(), [joint.name for joint in joints]),
            "on": (Column(), [frames[parent] for parent in self.robot.parents]),
            "body": (Column(), [joint.body or "" for joint in joints]),
            "lower": (Column("rad", "lower", "deg", digits=4), [float(joint.lower) for joint in joints]),
            "upper": (Column("rad", "upper", "deg", digits=4), [float(joint.upper) for joint in joints]),
        }
        yield Listing("joints", columns)
        if self.tendons:
            through = [", ".join(element.label for element in path) for path in self.tendons.values()]
            shortest, longest = zip(*self.paths.values(), strict=True)
            columns = {
                "tendon": (Column(), list(self.tendons)),
                "through": (Column(), through),
                "shortest": (Column("m", "shortest path", "mm", digits=4), list(shortest)),
                "longest": (Column("m", "longest path", "mm", digits=4), list(longest)),
            }
            yield Listing("tendons", columns)

    def write(self, folder: Path) -> None:
        """Write the file of the robot."""
        self.scenario().to_yaml(folder / "robot.yaml")


def read_mjcf(
    path: Path,
    muscle: Muscle | Mapping[str, Muscle] | None = None,
    *,
    root: str | None = None,
    angles: tuple[float, float] = (-math.pi, math.pi),
    hold_slides: bool = False,
    confined: bool = False,
) -> ReadRobot:
    """Return the robot of a file of MJCF or URDF.

    Carried over are bodies with their inertias, hinges with range, spring, damping, armature and friction, balls as
    three hinges, gravity, spatial tendons with their sites, geoms and pulleys, a base that is fixed, free, or on slides
    (`_BASES`), and spheres (geoms) whose names begin with ``foot``. Axes are those of the world at the pose of the
    file. Masses, forces and lengths of the robot are compared with those of the file at random states: `left_out` names
    what differs.

    Parameters
    ----------
    muscle
        Muscle of all tendons, or muscles by patterns of their names such as ``biceps*``, of which the first counts. Its
        connectors have the length with which it has its initial length where its path is longest within the ranges of
        the joints. A tendon with a stiffness that no actuator drives is a spring.
    root
        Name of the base, or of the first body of the robot. Default: the only one that carries hinges.
    angles
        Range [rad] of hinges without one.
    hold_slides
        Whether slides are held where they are in the file.
    confined
        Whether the file may name only files of its folder.

    Raises
    ------
    ScenarioError
        If MuJoCo cannot load the file, it names files that it must not, for joints that we do not have, and for muscles
        that do not fit; with the line.
    """
    _check_named_files(path, confined=confined)
    file = ModelFile(path, hold_slides=hold_slides)
    reader = _Reader(file, root, angles)
    robot = reader.robot()
    tendons = dict(reader.tendons())
    names = {number: file.name("tendon", number) for number in tendons}
    paths = path_ranges(file, reader.coordinates, robot, tendons)
    units = list[PathMuscle]()
    for number, points in tendons.items():
        if is_spring(file, number):
            try:
                units.append(_spring(names[number], points, file.model, number, paths[number][1]))
            except RangeError as error:
                raise file.refusal(Problem.of(error, file.line_of("tendon", number), error.field)) from error
    springs = {unit.name for unit in units}
    if muscle is not None:
        muscles = muscle if isinstance(muscle, Mapping) else {"*": muscle}
        driven = {number: points for number, points in tendons.items() if names[number] not in springs}
        units += _fitted(file, driven, muscles, paths)
    try:
        robot = dataclasses.replace(robot, muscles=tuple(units))
    except RangeError as error:
        of_units = [next(number for number, name in names.items() if name == unit.name) for unit in units]
        index = error.field.removeprefix("muscles.").split(".")[0]
        line = file.line_of("tendon", of_units[int(index)]) if index.isdigit() else None
        raise file.refusal(Problem.of(error, line, error.field)) from error
    left_out = *reader.left_out, *differences(file, robot, reader.base, reader.coordinates, tendons)
    lines = {names[number]: points for number, points in tendons.items()}
    lengths = {names[number]: paths[number] for number in tendons}
    return ReadRobot(file.spec.modelname or path.stem, robot, lines, lengths, left_out, tuple(reader.assumed))


def read_tendon_muscles(path: Path) -> Muscle | dict[str, Muscle]:
    """Return the muscle of a file, or muscles by patterns of names of tendons such as ``{biceps*: biceps.yaml}``."""
    text = read_text(path, "a muscle", "docs/robot-files.md")
    document = read_document(text)
    if not isinstance(document.data, dict) or "muscles" not in document.data:
        return parse_component(Muscle, text, source=str(path), folder=path.parent)
    muscles = TypeAdapter(dict[str, Annotated[Muscle, ComponentField(Muscle)]]).validate_python
    context, document = {"folder": path.parent}, document.below("muscles")
    return validated(muscles, document, str(path), context, (), "patterns with muscles")


def _fitted(
    file: ModelFile,
    tendons: Mapping[int, tuple[PathElement, ...]],
    muscles: Mapping[str, Muscle],
    paths: Mapping[int, tuple[float, float]],
) -> list[PathMuscle]:
    """Return the muscles of tendons; `ScenarioError` for those without one, and for muscles longer than their paths."""
    units, problems = list[PathMuscle](), list[Problem]()
    for number, points in tendons.items():
        name, longest = file.name("tendon", number), paths[number][1]
        muscle = next((one for pattern, one in muscles.items() if fnmatch.fnmatchcase(name, pattern)), None)
        if muscle is None:
            remedy = f"add {quoted(name)} or a pattern to `muscles`, which has {', '.join(map(quoted, muscles))}"
            problems.append(file.problem("tendon", number, "it has no muscle", remedy))
            continue
        length = float(muscle.specimen.initial_length)
        if length > longest + 1e-9:
            message = f"its muscle of {length / mm:.4g} mm is longer than its longest path, {longest / mm:.4g} mm"
            fits = math.floor(longest / mm * 10) / 10
            remedy = f"give it one with `initial_length: {fits:g} mm` or less, by its name in a file of `muscles`"
            problems.append(file.problem("tendon", number, message, remedy))
            continue
        units.append(PathMuscle(name, muscle, through=points, connector_length=_rounded(max(longest - length, 0.0))))
    if problems:
        raise file.refusal(*problems)
    return units


def _spring(name: str, points: tuple[PathElement, ...], model, number: int, longest: float) -> PathMuscle:
    """Tension spring in place of a tendon; it begins to pull where the tendon does."""
    unloaded, rate = float(model.tendon_lengthspring[number, 1]), float(np.ravel(model.tendon_stiffness[number])[0])
    free = 4 * max(longest, unloaded)  # the reference of its contraction, which stays small
    return PathMuscle(name, return_spring(rate, free), through=points, connector_length=_rounded(unloaded - free))


_NAMED_FILE = re.compile(rb"""\b(?:file\w*|(?:mesh|texture|asset)dir)\s*=\s*(["'])([^\0]*?)\1""")


def _check_named_files(path: Path, *, confined: bool) -> None:
    """Raise `ScenarioError` for names of pipes and devices, where MuJoCo would wait; if `confined`, of other folders.

    Any text that MuJoCo could take for an attribute that names a file counts, in comments, too.
    """
    files, problems = [path.resolve()], list[Problem]()
    for file in files:  # which grow
        content = file.read_bytes() if file.is_file() else b""
        if confined and len(content) > LONGEST_TEXT:
            problems.append(Problem(f"{file.name} is longer than {LONGEST_TEXT} bytes", remedy="give a shorter one"))
            continue
        for match in _NAMED_FILE.finditer(content):
            name = match[2].decode("utf-8", "replace")
            target = (file.parent / name).resolve()
            message = "is a pipe or device" if target.exists() and not (target.is_file() or target.is_dir()) else ""
            if confined and not target.is_relative_to(files[0].parent):
                message = "is in another folder"
            if message:
                line, remedy = content.count(b"\n", 0, match.start()) + 1, "leave it out, or run it on the command line"
                problems.append(Problem(f"{quoted(name)} {message}", line, remedy=remedy))
            elif target.is_file() and target not in files and (confined or target.suffix == ".xml"):
                files.append(target)
    if problems:
        raise ScenarioError(path.name, problems)


def _rounded(number: float) -> float:
    return float(f"{number:.12g}") if abs(number) > 1e-12 else 0.0


def _place(point: Floats) -> Place:
    return Place(*map(_rounded, point.tolist()))


class _Reader:
    """A model of MuJoCo at the pose of its file. Bodies that are welded together are one."""

    def __init__(self, file: ModelFile, root: str | None, angles: tuple[float, float]) -> None:
        self._file, self._model, self._data = file, file.model, file.data
        self._angles = angles
        self.left_out: list[str] = []
        self.assumed = list(file.corrected)
        self.coordinates: list[Coordinate] = []
        self._origins: dict[int, tuple[str, Floats]] = {}  # of a body: its name, and the hinge that carries it
        self._bodies = {file.name("body", body) for body in range(file.model.nbody)}
        self._before = ""  # name of what the joint before carries
        self.base, self.freedom, self._carried = self._choose(root)

    def _choose(self, root: str | None) -> tuple[int, Freedom, list[int]]:
        """Return the base, how it moves, and the bodies on joints; note the bodies beside them."""
        model, weld = self._model, self._model.body_weldid
        moving = [body for body in range(1, model.nbody) if weld[body] == body]
        body, others = self._beside(root, moving)
        self.left_out += [self._file.named("body", top) for top in others]
        freedom = self._freedom(body) if body else "fixed"
        on_joint = freedom == "fixed" and weld[body] == body and body > 0
        base = int(weld[model.body_parentid[body]] if on_joint else weld[body])
        carried = [one for one in moving if one != base and self._is_on(one, body)]
        carried = [one for one in carried if not any(self._is_on(one, top) for top in others)]
        if not self._hinges(carried, base):
            message = "the model has no hinge that is not of a base that slides"
            raise self._file.refusal(Problem(message, remedy="give it one, or another --root"))
        return base, freedom, carried

    def _beside(self, root: str | None, moving: Sequence[int]) -> tuple[int, list[int]]:
        """Return the first body of the robot, and those on the world that are left out with all that they carry."""
        tops = [body for body in moving if self._model.body_weldid[self._model.body_parentid[body]] == 0]
        if root is not None:
            body = self._root(root)
            return body, [top for top in tops if not self._is_on(body, top) and not self._is_on(top, body)]
        carried: dict[int, list[int]] = {top: [] for top in tops}
        for body in moving:
            carried[self._top(body)].append(body)
        robots = [top for top in tops if self._hinges(carried[top], top)]
        return self._base_of(robots), [top for top in tops if top not in robots]

    def _top(self, body: int) -> int:
        """The body on the world that carries a body."""
        above = body
        while above:
            body, above = above, int(self._model.body_weldid[self._model.body_parentid[above]])
        return body

    def _base_of(self, robots: Sequence[int]) -> int:
        """Return the only body that moves of those that carry hinges, or the world if all are on hinges."""
        free = [top for top in robots if {"free", "slide"} & set(self._file.kinds_of(top))]
        if free and len(robots) > 1:
            names = ", ".join(quoted(self._file.name("body", top)) for top in robots)
            remedy = (
                f"name the body that is the base, or the first of the robot: --root, one of {names}; or --hold-slides"
            )
            raise self._file.refusal(self._file.problem("body", free[0], "it moves, beside others with hinges", remedy))
        return free[0] if free else 0

    def _root(self, name: str) -> int:
        names = [self._file.name("body", body) for body in range(self._model.nbody)]
        if name not in names:
            raise ParameterError(f"there is no body {quoted(name)}", field="root", remedy=suggest(name, names))
        return names.index(name)

    def _is_on(self, body: int, top: int) -> bool:
        """Whether a body is another, or carried by it."""
        while body and body != top:
            body = int(self._model.body_parentid[body])
        return body == top

    def _hinges(self, bodies: Sequence[int], base: int) -> bool:
        """Whether there is a joint that is not of a base that moves."""
        moves = {"free", "slide"} & set(self._file.kinds_of(base)) if base else set()
        kinds = [kind for body in bodies if not (moves and body == base) for kind in self._file.kinds_of(body)]
        return bool({"hinge", "ball"} & set(kinds))

    def robot(self) -> Robot:
        """Return bodies and joints, and note what is not carried over."""
        model, base = self._model, self.base
        still = [body for body in range(1, model.nbody) if model.body_weldid[body] == base]
        name = self._file.name("body", base or still[0]) if base or still else "base"
        origin = self._data.xpos[base].copy()
        self._origins[base], self._before = (name, origin), name
        bodies, joints, problems = list[Body](), list[Joint](), list[Problem]()
        for body in [base, *self._carried]:
            try:
                if body == base:
                    bodies.append(self._body(name, base, origin))
                else:
                    joints += self._joints(body, bodies)
            except RangeError as error:
                problem = Problem.of(error, self._file.line_of("body", body), error.field)
                problems.append(
                    dataclasses.replace(problem, message=f"{self._file.name('body', body)}: {error.message}")
                )
            except ScenarioError as error:
                problems += error.problems
        if problems:
            raise self._file.refusal(*problems)
        self._note_rest()
        spheres = tuple(self._spheres())
        feet = spheres[0] if spheres else None, spheres[1:]
        off = self._file.disabled("gravity")
        gravity = tuple(0.0 if off else _rounded(one / GRAVITY) for one in model.opt.gravity.tolist())
        try:
            return Robot(tuple(bodies), tuple(joints), (), self.freedom, *feet, gravity)
        except RangeError as error:
            raise self._file.refusal(self._where(error, joints)) from error

    def _where(self, error: RangeError, joints: Sequence[Joint]) -> Problem:
        """Problem of a robot, at the line of the joint that it names."""
        kind, _, rest = error.field.partition(".")
        number = rest.split(".")[0]
        line = None
        if kind == "joints" and number.isdigit() and int(number) < len(joints):
            line = self._file.line_of("joint", self.coordinates[int(number)].joint)
        return Problem.of(error, line, error.field)

    def _freedom(self, body: int) -> Freedom:
        """Kind of base, from the joints of a body."""
        model, types, numbers = self._model, self._file.kinds_of(body), self._file.joints_of(body)
        if "slide" not in types and types != ["free"]:
            return "fixed"
        for number in numbers:
            given = ["range"] if model.jnt_limited[number] else []
            given += ["friction"] if np.any(model.dof_frictionloss[model.jnt_dofadr[number]]) else []
            self.left_out += [f"{what} of the base's {self._file.named('joint', number)}" for what in given]
        if types == ["free"]:
            return "floating"
        axes = [np.abs(self._data.xaxis[number]) for number in numbers]
        turns = ["turn about " if kind == "hinge" else "" for kind in types]
        order = sorted(zip(turns, axes, strict=True), key=lambda pair: (pair[0], int(pair[1].argmax())))
        along = tuple(turn + "xyz"[int(axis.argmax())] for turn, axis in order if axis.max() > 1 - 1e-9)
        if len(along) == len(types) and along in _BASES:
            return _BASES[along]
        moved = ", ".join(self._file.name("joint", number) for number in numbers)
        known = "; ".join(", ".join(names) for names in _BASES)
        message, remedy = f"no base of ours moves so ({moved})", f"give a freejoint, or slides along: {known}"
        raise self._file.refusal(self._file.problem("joint", numbers[0], message, remedy))

    def _joints(self, body: int, bodies: list[Body]) -> Iterator[Joint]:
        """Yield the hinges of a body, the last of which carries it, and add the body."""
        model, name = self._model, self._file.name("body", body)
        above, at = self._origins[int(model.body_weldid[model.body_parentid[body]])]
        numbers, kinds = self._file.joints_of(body), self._file.kinds_of(body)
        self._origins[body] = name, self._data.xanchor[numbers[-1]].copy()
        bodies.append(self._body(name, body, self._origins[body][1]))
        coordinates = [
            Coordinate(number, axis)
            for number, kind in zip(numbers, kinds, strict=True)
            for axis in (range(3) if kind == "ball" else (None,))
        ]
        for number, kind in zip(numbers, kinds, strict=True):
            if kind in ("slide", "free"):
                remedy = "hold it where it is, by --hold-slides; or name another robot by --root"
                raise self._file.refusal(self._file.problem("joint", number, f"it is a {kind}, not a hinge", remedy))
        for coordinate in coordinates:
            joint = self._hinge(body, coordinate)
            anchor, carries = self._data.xanchor[coordinate.joint], coordinate == coordinates[-1]
            yield dataclasses.replace(
                joint,
                body=name if carries else None,
                parent=None if above == self._before else above,
                place=_place(anchor - at),
            )
            self.coordinates.append(coordinate)
            above, at = joint.name, anchor.copy()
            self._before = name if carries else joint.name

    def _hinge(self, body: int, coordinate: Coordinate) -> Joint:
        """Return a hinge, or that of a ball about one of its axes, without what carries it."""
        model, (number, axis) = self._model, coordinate
        dof, at = model.jnt_dofadr[number] + (axis or 0), model.jnt_qposadr[number]
        name, low, high = self._file.name("joint", number), *model.jnt_range[number].tolist()
        if number != self._file.joints_of(body)[-1] and name in self._bodies:  # what it carries has its name
            name = f"{name} joint"
        if not model.jnt_limited[number]:
            low, high = self._angles
            self.assumed.append(f"joint {name} has no range: {low / deg:.4g}..{high / deg:.4g} deg; see --range")
        if axis is not None:
            high = min(high, 85 * deg if axis == 1 else 2 * np.pi)
            low, direction = -high, self._data.xmat[body].reshape(3, 3)[:, axis]
            name = f"{name} {'xyz'[axis]}"
            self.assumed.append(f"the ball is the hinge {name}: {low / deg:.4g}..{high / deg:.4g} deg")
        else:
            direction = self._data.xaxis[number]
        if low < -2 * np.pi or high > 2 * np.pi:
            low, high = max(low, -2 * np.pi), min(high, 2 * np.pi)
            self.assumed.append(f"joint {name} turns by {low / deg:g}..{high / deg:g} deg alone")
        spring = (
            0.0
            if axis is not None or self._file.disabled("spring")
            else float(np.ravel(model.jnt_stiffness[number])[0])
        )
        damping = 0.0 if self._file.disabled("damper") else float(np.ravel(model.dof_damping[dof])[0])
        loss = 0.0 if self._file.disabled("frictionloss") else float(model.dof_frictionloss[dof])
        return Joint(
            name,
            tuple(map(_rounded, direction.tolist())),
            *(low, high),
            offset=_rounded(-float(model.qpos0[at])) if axis is None else 0.0,
            damping=damping,
            rotor_inertia=float(model.dof_armature[dof]) or None,
            friction=JointFriction(loss) if loss else None,
            spring=spring or None,
            spring_angle=_rounded(float(model.qpos_spring[at])) if spring else 0.0,
        )

    def _body(self, name: str, number: int, origin: Floats) -> Body:
        """Bodies that are welded to one, as one."""
        model, data = self._model, self._data
        parts = [part for part in range(model.nbody) if model.body_weldid[part] == number and model.body_mass[part] > 0]
        mass = float(model.body_mass[parts].sum())
        if not mass:
            return Body(name, 0.0)
        centre = model.body_mass[parts] @ data.xipos[parts] / mass
        whole = np.zeros((3, 3))
        for part in parts:
            axes, arm = data.ximat[part].reshape(3, 3), data.xipos[part] - centre
            whole += axes @ np.diag(model.body_inertia[part]) @ axes.T
            whole += model.body_mass[part] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        xx, yy, zz = (_rounded(whole[i, i]) for i in range(3))
        off = [
            _rounded(whole[i, j]) if abs(whole[i, j]) > 1e-12 * whole.max() else 0.0
            for i, j in ((0, 1), (0, 2), (1, 2))
        ]
        inertia = (xx, yy, zz, *off) if any(off) else (xx, zz) if xx == yy else (xx, yy, zz)
        return Body(name, _rounded(mass), _place(centre - origin), inertia)

    def _spheres(self) -> Iterator[Foot]:
        """Yield the spheres whose names begin with foot, the first of which is the foot."""
        for number in range(self._model.ngeom):
            sphere = self._model.geom_type[number] == self._file.mujoco.mjtGeom.mjGEOM_SPHERE
            if self._model.geom(number).name.startswith("foot") and sphere:
                carrier = int(self._model.body_weldid[self._model.geom_bodyid[number]])
                if carrier not in self._origins:
                    continue
                name, origin = self._origins[carrier]
                radius = float(self._model.geom_size[number, 0])
                yield Foot(name, _place(self._data.geom_xpos[number] - origin), _rounded(radius))

    def tendons(self) -> Iterator[tuple[int, tuple[PathElement, ...]]]:
        """Yield number and path of each spatial tendon; note the others."""
        model = self._model
        for number in range(model.ntendon):
            named, first = self._file.named("tendon", number), int(model.tendon_adr[number])
            try:
                path = tuple(self._path_element(part) for part in range(first, first + int(model.tendon_num[number])))
                check_path(named, path)
            except RangeError as error:
                self.left_out.append(f"{named}: {error.message.removeprefix(f'{named}: ')}")
            else:
                yield number, path

    def _path_element(self, part: int) -> PathElement:
        """Return a part of a path; `RangeError` if we do not have it."""
        model, data, kinds = self._model, self._data, self._file.mujoco.mjtWrap
        kind, number, parameter = model.wrap_type[part], int(model.wrap_objid[part]), float(model.wrap_prm[part])
        if kind == kinds.mjWRAP_JOINT:
            raise RangeError("it has a joint", field="tendon")
        if kind == kinds.mjWRAP_PULLEY:
            return TendonPulley(_rounded(parameter))
        if kind == kinds.mjWRAP_SITE:
            body, origin = self._carrier(model.site_bodyid[number])
            return BodyPoint(body, _place(data.site_xpos[number] - origin))
        body, origin = self._carrier(model.geom_bodyid[number])
        side = None
        if parameter >= 0:
            if self._carrier(model.site_bodyid[int(parameter)])[0] != body:
                raise RangeError(f"the side of its surface on {body} is on another body", field="tendon")
            side = _place(data.site_xpos[int(parameter)] - origin)
        surface = _rounded(model.geom_size[number, 0]), _place(data.geom_xpos[number] - origin), side
        if kind == kinds.mjWRAP_SPHERE:
            return WrapSphere(body, *surface)
        return WrapCylinder(body, *surface, tuple(map(_rounded, data.geom_xmat[number][2::3])))

    def _carrier(self, body: int) -> tuple[str, Floats]:
        """Return the name of a body and the place of its origin; `RangeError` for one that is left out."""
        carrier = int(self._model.body_weldid[body])
        if carrier not in self._origins:
            raise RangeError("it is tied to a body that is left out", field="tendon")
        return self._origins[carrier]

    def _note_rest(self) -> None:
        """Note elements that act on neither the masses nor the passive forces."""
        model = self._model
        self.left_out += self._file.dropped
        touching = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
        others = [n for n in np.flatnonzero(touching).tolist() if not model.geom(n).name.startswith("foot")]
        others = [n for n in others if int(model.body_weldid[model.geom_bodyid[n]]) in self._origins]
        if others and any(model.body_weldid[model.geom_bodyid[n]] for n in others):
            self.left_out.append(f"contact of {len(others)} geoms, but for spheres named foot...")
        for number, (field, what) in itertools.product(
            range(model.ntendon), {"frictionloss": "friction", "limited": "range"}.items()
        ):
            if np.any(getattr(model, f"tendon_{field}")[number]):
                self.left_out.append(f"{what} of {self._file.named('tendon', number)}")
