"""A file of MJCF or URDF in MuJoCo, compiled without what is only shown; its joints as coordinates of ours."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError, Problem, ScenarioError
from mckibben.mechanism.bodies import MOTIONS, Freedom
from mckibben.mechanism.dynamics import SLIDES, TURNS

Floats = NDArray[np.float64]


class Coordinate(NamedTuple):
    """A joint of ours: a hinge of the file, or the turn of a ball about one of its axes."""

    joint: int
    axis: int | None = None


class ModelFile:
    """Model of a file at its pose, without meshes and textures.

    Attributes
    ----------
    dropped
        Equalities, actuators and keyframes, which are none of a robot of ours, and slides that are held.
    driven
        Names of the tendons that actuators drive.
    corrected
        Inertias that no body has.

    Raises
    ------
    ScenarioError
        If MuJoCo cannot read it, or a body that moves has no inertia but that of a mesh that is missing.
    """

    def __init__(self, path: Path, *, hold_slides: bool = False) -> None:
        try:
            import mujoco
        except ImportError as error:
            raise ParameterError("MuJoCo is not installed", remedy="pip install 'mckibben[mujoco]'") from error
        self.path, self.mujoco = path, mujoco
        self._text = path.read_text("utf-8", "replace") if path.is_file() else ""
        needed = list[Problem]()
        self.dropped: list[str] = []
        try:
            self.spec = mujoco.MjSpec.from_file(str(path))
            self.spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE  # of muscles that ours replace
            self.driven = {actuator.target for actuator in self.spec.actuators}
            self._drop_elements(hold_slides=hold_slides)
            needed, self.corrected = self._drop_shapes(), list(self._correct_inertias())
            self.model = self.spec.compile()
        except (ValueError, OSError, mujoco.FatalError) as error:
            text = "; ".join(" ".join(line.split()) for line in str(error).splitlines())
            line = re.search(r"\bline (\d+)", text) or re.search(r"name '([^']+)'", text)
            number = None if line is None else int(line[1]) if line[1].isdigit() else self._line_of_name(line[1])
            remedy = "correct the file, which MuJoCo reads"
            if "mujocoinclude" in text:
                text, remedy = "it is a part that other files include", "name the file that includes it"
            raise self.refusal(*needed or [Problem(text, number, remedy=remedy)]) from error
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)

    def disabled(self, flag: str) -> bool:
        """Whether the file switches a kind of force off."""
        bit = getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}")
        return bool(self.model.opt.disableflags & int(bit))

    def _drop_elements(self, *, hold_slides: bool) -> None:
        """Note what is not of a robot of ours, and drop slides with what acts on them."""
        spec, free = self.spec, self.mujoco.mjtJoint.mjJNT_SLIDE
        slides = [joint for joint in spec.joints if joint.type == free] if hold_slides else []
        groups = {"actuator": spec.actuators, "keyframe": spec.keys, "held slide": slides, "equality": spec.equalities}
        for noun, elements in groups.items():
            if elements:
                first, line = elements[0], self.line(elements[0])
                kind = f" {self.mujoco.mjtEq(first.type).name[5:].lower()}" if noun == "equality" else ""
                more = f", and {len(elements) - 1} more" if len(elements) > 1 else ""
                self.dropped.append(f"{noun}{kind} {first.name}".rstrip() + (f" (line {line})" if line else "") + more)
        for element in [element for elements in groups.values() for element in elements] if slides else ():
            spec.delete(element)

    def _drop_shapes(self) -> list[Problem]:
        """Drop meshes, height fields, textures, skins and sensors; return a problem for each mesh that is needed."""
        spec, needed, kept = self.spec, list[Problem](), set[str]()
        for element in [*spec.sensors, *spec.pairs, *spec.skins]:
            spec.delete(element)
        for element in [*spec.geoms, *spec.sites, *spec.tendons]:
            element.material = ""
        for geom in list(spec.geoms):
            if (geom.meshname or geom.hfieldname) and self._gives_inertia(geom):
                kept.add(geom.meshname)
                body = f"body {geom.parent.name or 'without a name'}"
                message = f"{body} has no inertia but that of the mesh {geom.meshname}, which cannot be read"
                remedy = "give it an `inertial`, or put the file of the mesh where the model names it"
                needed.append(Problem(message, self.line(geom.parent) or self.line(geom), remedy=remedy))
            elif geom.meshname or geom.hfieldname:
                spec.delete(geom)
        unused = [mesh for mesh in spec.meshes if mesh.name not in kept]
        for element in [*spec.materials, *spec.textures, *spec.hfields, *unused]:
            spec.delete(element)
        return needed

    def _gives_inertia(self, geom) -> bool:
        """Whether the inertia of a body that moves is that of a geom."""
        body, compiler = geom.parent, self.spec.compiler
        low, high = compiler.inertiagrouprange
        weightless = geom.mass == 0 or (np.isnan(geom.mass) and geom.density == 0) or not low <= geom.group <= high
        always = compiler.inertiafromgeom == self.mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        if weightless or (body.explicitinertial and not always):
            return False
        return self._moves(body)

    @staticmethod
    def _moves(body) -> bool:
        """Whether a body is on a joint."""
        while body is not None:
            if body.joints:
                return True
            body = body.parent
        return False

    def _correct_inertias(self) -> Iterator[str]:
        """Replace inertias that no body has by the nearest distribution of mass; yield the name of each that moves."""
        for body in self.spec.bodies if not self.spec.compiler.balanceinertia else ():
            if not body.explicitinertial:
                continue
            xx, yy, zz, xy, xz, yz = body.fullinertia if np.isfinite(body.fullinertia[0]) else (*body.inertia, 0, 0, 0)
            given = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            squares, axes = np.linalg.eigh(np.trace(given) / 2 * np.eye(3) - given)  # second moments of the mass
            if squares[0] >= 0 and squares[1] > 0:
                continue
            squares = np.maximum(squares, max(1e-6 * squares[-1], 1e-9))  # the least for a point
            made = squares.sum() * np.eye(3) - axes @ np.diag(squares) @ axes.T
            if np.isfinite(body.fullinertia[0]):
                body.fullinertia = made[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            else:
                body.inertia = np.diag(made)
            if self._moves(body):
                change, line = np.abs(made - given).max(), self.line(body)
                where = f" (line {line})" if line else ""
                yield f"no body has the inertia of {body.name}{where}: the nearest differs by {change:.2g} kg*m^2"

    def line(self, element) -> int | None:
        """Line of an element; None where it is that of another file."""
        found = re.search(r"\bline (\d+)", element.info or "")
        if found is None:
            return self._line_of_name(element.name)
        number = int(found[1])
        near = "\n".join(self._text.splitlines()[max(number - 2, 0) : number + 4])
        return number if "<include" not in self._text or f'"{element.name}"' in near else None

    def _line_of_name(self, name: str) -> int | None:
        return self._line_of(rf"""\bname\s*=\s*["']{re.escape(name)}["']""") if name else None

    def _line_of(self, pattern: str) -> int | None:
        match = re.search(pattern, self._text)
        return self._text.count("\n", 0, match.start()) + 1 if match else None

    def name(self, kind: str, number: int) -> str:
        """Name of an element, else its kind and number."""
        return getattr(self.model, kind)(number).name or f"{kind}{number}"

    def element(self, kind: str, number: int):
        """Element of the file."""
        elements = {"body": self.spec.bodies, "joint": self.spec.joints, "tendon": self.spec.tendons}[kind]
        return next((element for element in elements if element.id == number), None)

    def line_of(self, kind: str, number: int) -> int | None:
        """Line of an element by its number."""
        element = self.element(kind, number)
        return None if element is None else self.line(element)

    def named(self, kind: str, number: int) -> str:
        """Kind, name and line of an element."""
        line = self.line_of(kind, number)
        return f"{kind} {self.name(kind, number)}" + (f" (line {line})" if line else "")

    def problem(self, kind: str, number: int, message: str, remedy: str) -> Problem:
        """Return a problem of an element, at its line."""
        named = f"{kind} {self.name(kind, number)}"
        return Problem(f"{named}: {message}", self.line_of(kind, number), remedy=remedy)

    def refusal(self, *problems: Problem) -> ScenarioError:
        """Return the error of problems; one that is of the whole model has the line of its first body."""
        line = self._line_of(r"<(worldbody|robot|mujocoinclude|mujoco)\b")
        located = [problem if problem.line else dataclasses.replace(problem, line=line) for problem in problems]
        return ScenarioError(str(self.path), located)

    def joints_of(self, body: int) -> range:
        """Numbers of the joints of a body."""
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    def kinds_of(self, body: int) -> list[str]:
        """Kinds of the joints of a body: free, ball, slide, hinge."""
        kind = self.mujoco.mjtJoint
        return [kind(int(self.model.jnt_type[number])).name[6:].lower() for number in self.joints_of(body)]

    def move(self, coordinates: Sequence[Coordinate], angles: Sequence[float], rates: Iterable[float] = ()) -> None:
        """Move the joints of ours to angles [rad] and rates [rad/s]; balls have none."""
        model, data, mujoco = self.model, self.data, self.mujoco
        data.qpos[:], data.qvel[:] = model.qpos0, 0.0
        for (joint, axis), angle in zip(coordinates, angles, strict=True):
            at = model.jnt_qposadr[joint]
            if axis is None:
                data.qpos[at] = angle
            else:
                turn, turned = np.zeros(4), np.zeros(4)
                mujoco.mju_axisAngle2Quat(turn, np.eye(3)[axis], angle)
                mujoco.mju_mulQuat(turned, data.qpos[at : at + 4], turn)
                data.qpos[at : at + 4] = turned
        for (joint, axis), rate in zip(coordinates, rates, strict=False):
            data.qvel[model.jnt_dofadr[joint]] += rate if axis is None else 0.0
        mujoco.mj_kinematics(model, data)

    def jacobian(self, base: int, freedom: Freedom, coordinates: Sequence[Coordinate]) -> Floats:
        """Velocities of MuJoCo per rate of the motions of the base, at its pose, and of the joints."""
        model, data = self.model, self.data
        columns = np.zeros((model.nv, len(MOTIONS[freedom]) + len(coordinates)))
        for joint, kind in zip(self.joints_of(base), self.kinds_of(base), strict=True) if freedom != "fixed" else ():
            own = {"free": [*np.eye(3), *data.xmat[base].reshape(3, 3).T]}.get(kind, [data.xaxis[joint]])
            for row, axis in enumerate(own, int(model.jnt_dofadr[joint])):
                slides = kind == "slide" or row - int(model.jnt_dofadr[joint]) < len(own) - 3
                for column, motion in enumerate(MOTIONS[freedom]):
                    if (motion in SLIDES) == slides:
                        columns[row, column] = np.dot(axis, (SLIDES | TURNS)[motion])
        for column, (joint, axis) in enumerate(coordinates, len(MOTIONS[freedom])):
            row = model.jnt_dofadr[joint]
            if axis is None:
                columns[row, column] = 1.0
            else:  # in the axes of the body: turned back by the hinges after it
                columns[row : row + 3, column] = self._turned_back(joint, axis)
        return columns

    def _turned_back(self, joint: int, axis: int) -> Floats:
        """Axis of a hinge of a ball in those of its body, from the quaternion of turns about x, y and z."""
        at, matrix = self.model.jnt_qposadr[joint], np.zeros(9)
        self.mujoco.mju_quat2Mat(matrix, self.data.qpos[at : at + 4])
        turned = matrix.reshape(3, 3)
        last = np.arctan2(-turned[0, 1], turned[0, 0])
        across = np.array([np.sin(last), np.cos(last), 0.0])
        return (turned[0], across, np.array([0.0, 0.0, 1.0]))[axis]
