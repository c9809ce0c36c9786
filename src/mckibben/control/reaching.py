"""References of a point: angles of the joints by inverse kinematics, and their stiffness for that of the point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array
from pydantic import Field

from mckibben.component.base import Units
from mckibben.component.checks import check_count
from mckibben.component.schema import ComponentField
from mckibben.config.model import ConfigModel
from mckibben.control import Reference, Samples, Signal
from mckibben.errors import UnreachableError
from mckibben.mechanism.bodies import BodyPoint
from mckibben.mechanism.point_stiffness import Floats, place_of, point_of, stiffness_matrix
from mckibben.mechanism.robot import Robot
from mckibben.mechanism.tree import solve_symmetric
from mckibben.numerics.compiled import jit
from mckibben.result import Remark
from mckibben.statics.posture import holding_torques
from mckibben.statics.pressures import pressures_for_point_stiffness
from mckibben.units import Angle, Quantity, deg, mm

Length = Annotated[float, Quantity("m", "mm", -1e4, 1e4)]
PositionPart = Annotated[Signal, ComponentField(Signal, Units(signal=Length))]
PointStiffnessValue = Annotated[float, Quantity("N/m", "N/m", 0, 1e6, open_lower=True)]

_ITERATIONS = 6  # per sample
_REACHED = 1e-6  # m
_DAMPING, _STEP = 1e-9, 0.2  # m^2, and rad per iteration: where a robot is stretched, or a position out of reach
_POSTURES = 25  # at which the stiffness of the joints is computed


class PointReference(ConfigModel):
    """Position of a point over time, from the base: forwards and up, or in space forwards, to the left and up.

    Its stiffness is given by main axes, see `stiffness_matrix`.
    """

    position: Annotated[tuple[PositionPart, ...], Field(min_length=2, max_length=3)]
    principal: tuple[PointStiffnessValue, PointStiffnessValue]
    direction: Angle = 0.0
    sideways: PointStiffnessValue | None = None
    point: Annotated[BodyPoint, ComponentField(BodyPoint)] | None = None  # default: the foot

    def of_joints(
        self, robot: Robot, start: Sequence[float], times: Floats, supply: float, minimum_tension: float
    ) -> tuple[dict[str, Reference], list[Remark]]:
        """Return references of all joints at times [s], from a posture [rad] near the first, and what is not exact.

        Raises `UnreachableError` for a position that the point does not reach within the ranges of the joints.
        """
        point = point_of(robot, self.point)
        positions = np.stack([np.asarray(part(times)) for part in self.position], axis=-1)
        check_count("position", positions.shape[1], 2 if robot.is_planar else 3, "direction")
        angles, left = map(np.asarray, _followed(robot, point, jnp.asarray(start, float), jnp.asarray(positions)))
        self._check_reached(robot, angles, left, times)
        chosen = np.unique(np.linspace(0, times.size - 1, _POSTURES).astype(int))
        matrix, stiffness, errors = stiffness_matrix(self.principal, self.direction, self.sideways), [], []
        for posture in angles[chosen].tolist():
            held = {"torques": holding_torques(robot, posture), "supply": supply, "minimum_tension": minimum_tension}
            found = pressures_for_point_stiffness(robot, posture, matrix, point=point, **held)
            stiffness.append(np.diag(found.joint_stiffness))
            errors.append(found.error)
        worst = int(np.argmax(errors))
        text = f"relative error of the point's stiffness: up to {errors[worst]:.2g}, at {times[chosen[worst]]:.3g} s"
        columns = zip(robot.joints, angles.T, np.array(stiffness).T, strict=True)
        references = {
            joint.name: Reference(Samples(times, angle), Samples(times[chosen], values))
            for joint, angle, values in columns
        }
        return references, [Remark.note("reference", text)]

    def _check_reached(self, robot: Robot, angles: Floats, left: Floats, times: Floats) -> None:
        """Raise `UnreachableError` where the point stays away, or a joint would be beyond a stop."""
        parts = [("the point {:.3g} mm away from its reference", left / mm, left > _REACHED)]
        for joint, angle in zip(robot.joints, angles.T, strict=True):
            beyond = (angle < joint.lower) | (angle > joint.upper)
            parts.append((joint.name + " at {:.3g} deg, beyond its stops", angle / deg, beyond))
        for text, values, wrong in parts:
            if wrong.any():
                first = int(np.argmax(wrong))
                message = f"at {times[first]:.3g} s the reference of the point would have {text.format(values[first])}"
                remedy = "choose positions within reach, or `start` nearer to the first"
                raise UnreachableError(message, field="reference", remedy=remedy)


@jit
def _followed(robot: Robot, point: BodyPoint, start: Array, positions: Array) -> tuple[Array, Array]:
    """Angles [rad] at which a point is at positions [m], (samples, directions), and the distances left.

    Newton's method with the least change of the angles, from one sample to the next.
    """

    def nearer(_: int, at: tuple[Array, Array]) -> tuple[Array, Array]:
        angles, position = at
        jacobian = jax.jacfwd(lambda q: place_of(robot, point, q))(angles)
        square = jacobian @ jacobian.T + _DAMPING * jnp.eye(len(position))
        rows = [list(row[: i + 1]) for i, row in enumerate(square)]
        step = jacobian.T @ jnp.stack(solve_symmetric(rows, list(position - place_of(robot, point, angles))))
        return angles + jnp.clip(step, -_STEP, _STEP), position

    def follow(angles: Array, position: Array) -> tuple[Array, tuple[Array, Array]]:
        angles, _ = lax.fori_loop(0, _ITERATIONS, nearer, (angles, position))
        return angles, (angles, jnp.linalg.norm(position - place_of(robot, point, angles)))

    first, _ = lax.scan(follow, start, jnp.broadcast_to(positions[0], (10, positions.shape[1])))
    return lax.scan(follow, first, positions)[1]
