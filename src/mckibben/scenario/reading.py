"""Robots from MJCF and URDF: MuJoCo reads a file, and bodies, hinges, inertias and spatial tendons become ours."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.config.document import LONGEST_TEXT
from mckibben.errors import ParameterError, Problem, ScenarioError, quoted
from mckibben.mechanism.bodies import Body, BodyPoint, Foot, Freedom, Joint, Place
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.mechanism.muscles import PathMuscle
from mckibben.mechanism.robot import Robot
from mckibben.muscle import Muscle
from mckibben.result import Column, Listing, Remark, Result, table
from mckibben.scenario.robot import RobotScenario
from mckibben.units import GRAVITY

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
        Bodies and joints; and muscles, if one was given for all tendons.
    tendons
        Points of each spatial tendon by its name.
    paths
        Shortest and longest path [m] of each, within the ranges of the joints.
    left_out
        What is not carried over, with the line of the file.
    """

    files = ("robot.yaml",)

    name: str
    robot: Robot
    tendons: dict[str, tuple[BodyPoint, ...]]
    paths: dict[str, tuple[float, float]]
    left_out: tuple[str, ...] = ()

    def scenario(self) -> RobotScenario:
        """Return the robot as a file; `ParameterError` if the muscles of its tendons were not given."""
        if self.tendons and not self.robot.muscles:
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
            through = [", ".join(point.body for point in points) for points in self.tendons.values()]
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


def read_mjcf(path: Path, muscle: Muscle | None = None, *, confined: bool = False) -> ReadRobot:
    """Return the robot of a file of MJCF or URDF.

    Carried over are bodies with their inertias, hinges with range, damping, armature and friction, spatial tendons
    through sites, a base that is fixed, free, or on slides (`_BASES`), and spheres (geoms) whose names
    begin with ``foot``. Axes are those of the world at the pose of the file.

    Parameters
    ----------
    muscle
        Muscle of all tendons. Its connectors have the length with which it has its initial length where its path is
        longest within the ranges of the joints.
    confined
        Whether the file may name only files of its folder.

    Raises
    ------
    ScenarioError
        If MuJoCo cannot load the file, it names files that it must not, or for joints that we do not have; with the
        line.
    RangeError
        If the muscle does not permit the paths.
    """
    _check_named_files(path, confined=confined)
    reader = _Reader(path)
    robot = reader.robot()
    tendons = dict(reader.tendons())
    paths = {name: _range_of(robot, points) for name, points in tendons.items()}
    if muscle is not None and tendons:
        length = float(muscle.specimen.initial_length)
        units = (
            PathMuscle(name, muscle, through=points, connector_length=_rounded(paths[name][1] - length))
            for name, points in tendons.items()
        )
        robot = dataclasses.replace(robot, muscles=tuple(units))
    return ReadRobot(reader.name, robot, tendons, paths, tuple(reader.left_out))


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


def _range_of(robot: Robot, points: tuple[BodyPoint, ...]) -> tuple[float, float]:
    """Shortest and longest path [m] at the ends and in the middle of the ranges of its joints."""
    middle = [(float(joint.lower) + float(joint.upper)) / 2 for joint in robot.joints]
    turned = sorted(robot.path_through(points, middle)[1])
    levels = ((float(robot.joints[i].lower), middle[i], float(robot.joints[i].upper)) for i in turned)
    angles: list[ArrayLike] = list(middle)
    for index, column in zip(turned, np.array(list(itertools.product(*levels))).T, strict=True):
        angles[index] = column
    lengths = np.asarray(robot.path_through(points, angles)[0])
    return float(lengths.min()), float(lengths.max())


def _rounded(number: float) -> float:
    return float(f"{number:.12g}") if abs(number) > 1e-12 else 0.0


def _place(point: Floats) -> Place:
    return Place(*map(_rounded, point.tolist()))


class _Reader:
    """A model of MuJoCo at the pose of its file. Bodies that are welded together are one."""

    def __init__(self, path: Path) -> None:
        try:
            import mujoco
        except ImportError as error:
            raise ParameterError("MuJoCo is not installed", remedy="pip install 'mckibben[mujoco]'") from error
        self._path, self._mujoco = path, mujoco
        try:
            self._spec = mujoco.MjSpec.from_file(str(path))
            self._spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE  # of muscles that ours replace
            self._model = self._spec.compile()
        except (ValueError, OSError, mujoco.FatalError) as error:
            text = "; ".join(" ".join(line.split()) for line in str(error).splitlines())
            line = re.search(r"\bline (\d+)", text)
            problem = Problem(text, int(line[1]) if line else None, remedy="correct the file, which MuJoCo reads")
            raise ScenarioError(str(path), [problem]) from error
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)
        self.name = self._spec.modelname or path.stem
        self.left_out: list[str] = []
        self._origins: dict[int, tuple[str, Floats]] = {}  # of a body: its name, and the hinge that carries it
        self._before = ""  # name of what the joint before carries

    def _named(self, kind: str, number: int) -> str:
        return getattr(self._model, kind)(number).name or f"{kind}{number}"

    def _line(self, elements: Iterable, number: int) -> str:
        """Line of an element of the file."""
        return next((f" ({one.info})" for one in elements if one.id == number and one.info), "")

    def _refuse(self, what: str, remedy: str) -> ScenarioError:
        return ScenarioError(str(self._path), [Problem(what, remedy=remedy)])

    def robot(self) -> Robot:
        """Return bodies and joints, and note what is not carried over."""
        model = self._model
        moving = [body for body in range(1, model.nbody) if model.body_weldid[body] == body]
        first = [body for body in moving if model.body_weldid[model.body_parentid[body]] == 0]
        base, freedom = 0, self._freedom(first[0]) if first else "fixed"
        if freedom != "fixed":
            base = first[0]
            if len(first) > 1:
                remedy = "give one file for each robot"
                raise self._refuse("several bodies move in the world, beside one that moves freely", remedy)
        still = [body for body in range(1, model.nbody) if model.body_weldid[body] == 0]
        name = self._named("body", base or still[0]) if base or still else "base"
        origin = np.zeros(3) if base == 0 else self._data.xpos[base].copy()
        bodies, joints = [self._body(name, base, origin)], list[Joint]()
        self._origins[base], self._before = (name, origin), name
        for body in moving:
            if body != base:
                joints += self._joints(body, bodies)
        if not joints:
            raise self._refuse("the model has no hinge", "give it one or more")
        self._note_rest()
        spheres = tuple(self._spheres())
        return Robot(tuple(bodies), tuple(joints), (), freedom, spheres[0] if spheres else None, spheres[1:])

    def _freedom(self, body: int) -> Freedom:
        """Kind of base, from the joints of the first body that moves in the world."""
        model, kinds = self._model, self._mujoco.mjtJoint
        numbers = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        types = [model.jnt_type[number] for number in numbers]
        if types == [kinds.mjJNT_FREE]:
            return "floating"
        if kinds.mjJNT_SLIDE not in types:
            return "fixed"
        for number in numbers:
            parts = {"range": model.jnt_limited, "stiffness": model.jnt_stiffness}
            of_dof = {"damping": model.dof_damping, "friction": model.dof_frictionloss, "armature": model.dof_armature}
            given = [what for what, values in parts.items() if np.any(values[number])]
            given += [what for what, values in of_dof.items() if np.any(values[model.jnt_dofadr[number]])]
            self.left_out += [f"{what} of the base's {self._joint(number)}" for what in given]
        axes = [np.abs(self._data.xaxis[number]) for number in numbers]
        turns = ["turn about " if kind == kinds.mjJNT_HINGE else "" for kind in types]
        along = tuple(
            turn + "xyz"[int(axis.argmax())] for turn, axis in zip(turns, axes, strict=True) if axis.max() > 1 - 1e-9
        )
        if len(along) == len(types) and along in _BASES:
            return _BASES[along]
        found = ", ".join(map(self._joint, numbers))
        known = "; ".join(", ".join(names) for names in _BASES)
        raise self._refuse(f"{found}: no base of ours moves so", f"give a freejoint, or slides along: {known}")

    def _joint(self, number: int) -> str:
        """Name of a joint, and its line."""
        return f"joint {self._named('joint', number)}{self._line(self._spec.joints, number)}"

    def _joints(self, body: int, bodies: list[Body]) -> Iterator[Joint]:
        """Yield the hinges of a body, the last of which carries it, and add the body."""
        model, data = self._model, self._data
        name = self._named("body", body)
        above, at = self._origins[int(model.body_weldid[model.body_parentid[body]])]
        numbers = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        for number in numbers:
            joint, named = self._named("joint", number), self._joint(number)
            if model.jnt_type[number] != self._mujoco.mjtJoint.mjJNT_HINGE:
                remedy = "we have hinges: give it successive ones, or leave it out"
                raise self._refuse(f"{named} is not a hinge", remedy)
            if not model.jnt_limited[number]:
                raise self._refuse(f"{named} has no range", "give it a `range`, within which muscles act")
            if np.any(model.jnt_stiffness[number]):
                self.left_out.append(f"stiffness of {named}")
            dof, anchor = model.jnt_dofadr[number], data.xanchor[number]
            loss, rotor = float(model.dof_frictionloss[dof]), float(model.dof_armature[dof])
            low, high = model.jnt_range[number].tolist()
            yield Joint(
                joint,
                tuple(map(_rounded, data.xaxis[number].tolist())),
                *(low, high),
                body=name if number == numbers[-1] else None,
                parent=None if above == self._before else above,
                place=_place(anchor - at),
                offset=_rounded(-float(model.qpos0[model.jnt_qposadr[number]])),
                damping=float(np.ravel(model.dof_damping[dof])[0]),
                rotor_inertia=rotor or None,
                friction=JointFriction(loss) if loss else None,
            )
            above, at = joint, anchor.copy()
            self._before = name if number == numbers[-1] else joint
        bodies.append(self._body(name, body, at))
        self._origins[body] = name, at

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
            sphere = self._model.geom_type[number] == self._mujoco.mjtGeom.mjGEOM_SPHERE
            if self._model.geom(number).name.startswith("foot") and sphere:
                name, origin = self._origins[int(self._model.body_weldid[self._model.geom_bodyid[number]])]
                radius = float(self._model.geom_size[number, 0])
                yield Foot(name, _place(self._data.geom_xpos[number] - origin), _rounded(radius))

    def tendons(self) -> Iterator[tuple[str, tuple[BodyPoint, ...]]]:
        """Yield name and points of each tendon that is a line through sites; note the others."""
        model, wraps = self._model, self._mujoco.mjtWrap
        for number in range(model.ntendon):
            parts = range(model.tendon_adr[number], model.tendon_adr[number] + model.tendon_num[number])
            name, line = self._named("tendon", number), self._line(self._spec.tendons, number)
            others = {int(model.wrap_type[part]) for part in parts} - {int(wraps.mjWRAP_SITE)}
            if others:
                what = ", ".join(sorted(wraps(kind).name.removeprefix("mjWRAP_").lower() for kind in others))
                self.left_out.append(f"tendon {name}{line}: it has a {what}")
                continue
            points = []
            for site in (int(model.wrap_objid[part]) for part in parts):
                body, origin = self._origins[int(model.body_weldid[model.site_bodyid[site]])]
                points.append(BodyPoint(body, _place(self._data.site_xpos[site] - origin)))
            if len({point.body for point in points}) < 2:
                self.left_out.append(f"tendon {name}{line}: all its points are on one body")
                continue
            yield name, tuple(points)

    def _note_rest(self) -> None:
        """Note constraints and springs that are not carried over."""
        model, spec = self._model, self._spec
        for number in range(model.neq):
            kind = self._mujoco.mjtEq(int(model.eq_type[number])).name.removeprefix("mjEQ_").lower()
            name = model.equality(number).name
            self.left_out.append(f"equality {kind} {name}".rstrip() + self._line(spec.equalities, number))
        moving = model.body_weldid[model.geom_bodyid] > 0
        touching = np.flatnonzero(moving & ((model.geom_contype > 0) | (model.geom_conaffinity > 0)))
        others = [number for number in touching.tolist() if not model.geom(number).name.startswith("foot")]
        if others:
            first = self._named("geom", others[0]) + self._line(spec.geoms, others[0])
            self.left_out.append(f"contact of {len(others)} geoms, but for spheres named foot...; the first is {first}")
        for number in range(model.nu):
            self.left_out.append(f"actuator {self._named('actuator', number)}{self._line(spec.actuators, number)}")
        parts = {"stiffness": "stiffness", "damping": "damping", "frictionloss": "friction", "limited": "range"}
        for number, (part, what) in itertools.product(range(model.ntendon), parts.items()):
            if np.any(getattr(model, f"tendon_{part}")[number]):
                named = self._named("tendon", number) + self._line(spec.tendons, number)
                self.left_out.append(f"{what} of tendon {named}")
        x, y, z = model.opt.gravity.tolist()
        if abs(x) + abs(y) > 1e-9 or abs(z + GRAVITY) > 1e-3:
            self.left_out.append(f"gravity {x:g} {y:g} {z:g}: ours is {GRAVITY} m/s^2 downwards")
