"""Compliance of ground and stops in terms of MuJoCo's solver.

The force of a soft constraint is (k_ref r - b_ref v - a) / (A + R) at a depth r, with R = w (1 - d)/d, where w is a
mobility at the model's zero posture, and A and a are mobility and acceleration without the constraint (MuJoCo's
documentation, Computation, "Solver parameters"). With a small impedance d, R outweighs A, and the constraint acts as a
spring and a damper in any posture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mckibben.mechanism.bodies import BodyPoint, Foot, Joint, Place
from mckibben.mechanism.dynamics import mobilities
from mckibben.plant import PlantState
from mckibben.plant.robot_plant import RobotPlant

TOUCH_SPEED, LIMIT_SPEED = 1.0, 3.0
"""Speeds [m/s], [rad/s] at which the restitution equals that of the plant."""
_IMPEDANCE = 1e-3
FRICTION_RATIO = 1000.0
"""Ratio of normal to tangential R (impratio); at 1, friction would raise the normal force in MuJoCo's cone."""


class Compliance(NamedTuple):
    """Stiffness and damping of a soft constraint, multiplied by its mobility.

    Attributes
    ----------
    stiffness, damping
        In 1/s^2 and 1/s. The attribute ``solref`` has them with a minus, else MuJoCo takes them for a time constant and
        a damping ratio.
    """

    stiffness: float
    damping: float

    @property
    def reference(self) -> str:
        """The attribute solref of MJCF."""
        return f"{-self.stiffness!r} {-self.damping!r}"

    @property
    def impedance(self) -> str:
        """The attribute solimp of MJCF."""
        return f"{_IMPEDANCE!r} {_IMPEDANCE!r} 0.001"


def compliance(plant: RobotPlant, start: PlantState) -> dict[str, Compliance]:
    """Compliance of the stops of each moving joint, by name, and of ground and friction of each sphere, by number."""
    robot = plant.robot
    zero = [0.0] * len(robot.joints)
    softness: dict[str, Compliance] = {}
    for number, sphere in enumerate(robot.spheres):
        softness |= _of_ground(plant, start, sphere, zero, number)
    for joint, mobility in zip(robot.joints, mobilities(robot, zero)[1].diagonal().tolist(), strict=True):
        if joint.locked is None:
            softness[joint.name] = _stop(joint, mobility)
    return softness


def _of_ground(
    plant: RobotPlant, start: PlantState, foot: Foot, zero: Sequence[float], number: int
) -> dict[str, Compliance]:
    """Compliance "ground" and "friction" of a sphere, with its number."""
    robot, ground = plant.robot, plant.ground
    carrying = robot.frame_bodies[robot.frame_names.index(foot.body)]
    centre = BodyPoint(foot.body, Place() if carrying is None else carrying.centre)
    body = float(mobilities(robot, zero, centre)[0].trace()) / 3  # MuJoCo's mean over x, y and z
    normal = np.array([float(component) for component in ground.normal])
    mobility = float(normal @ mobilities(robot, start.angle, foot)[0] @ normal)
    if robot.base == "fixed":  # a stretched robot below a fixed base has no mobility along itself
        mobility = max(mobility, 1 / float(robot.total_mass))
    stiffness = float(ground.stiffness)
    damper = _damper(stiffness, float(ground.damping), 1 / mobility, TOUCH_SPEED)
    weight = float(robot.total_mass * plant.gravity)
    slope = float(ground.friction * weight / ground.slip_speed) or 1.0
    return {
        f"ground {number}": _scaled(stiffness, damper, body),
        f"friction {number}": _scaled(0.0, slope / FRICTION_RATIO, body),
    }


def _stop(joint: Joint, mobility: float) -> Compliance:
    """Compliance of the stops of a joint with a mobility [rad/(N*m*s^2)]."""
    stiffness = float(joint.stop_stiffness)
    return _scaled(stiffness, _damper(stiffness, float(joint.stop_damping), 1 / mobility, LIMIT_SPEED), mobility)


def _scaled(stiffness: float, damping: float, mobility: float) -> Compliance:
    """Compliance of a spring and a damper on a mobility."""
    return Compliance(*(number * mobility * (1 - _IMPEDANCE) for number in (stiffness, damping)))


def _damper(stiffness: float, damping: float, mass: float, speed: float) -> float:
    """Damping [N*s/m] with the restitution of k d (1 + c d') at a speed, to first order 1 - 2/3 c v."""
    restitution = max(1 - 2 / 3 * damping * speed, 0.05)
    logarithm = -math.log(restitution)
    return 2 * logarithm / math.hypot(math.pi, logarithm) * math.sqrt(stiffness * mass)
