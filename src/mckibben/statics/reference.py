"""References of a robot's joints at rest: postures that muscles cannot hold, and stiffness that they do not attain."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mckibben.errors import McKibbenError, RangeError
from mckibben.mechanism.robot import Robot
from mckibben.result import Remark
from mckibben.statics.attainable import held_statics
from mckibben.statics.posture import EXACT, Floats, HeldPostures, holding_torques, is_affine
from mckibben.statics.pressures import held_joint_stiffness

POSTURES = 25
"""Postures along a reference at which linear programs check it."""


def check_postures(
    robot: Robot, times: Floats, angles: Floats, stiffness: Floats, *, supply: float = np.inf
) -> Iterator[Remark]:
    """Yield severe remarks on postures that taut muscles do not hold, and on stiffness that they do not attain there.

    Parameters
    ----------
    times
        Times [s] of the postures, shape (postures,).
    angles, stiffness
        Angles [rad] and stiffness [N*m/rad] of the joints, shape (postures, joints).
    supply
        Highest gauge pressure of the supply [Pa].
    """
    if not is_affine(robot):
        yield Remark.note("reference", "not checked: a law is not affine in pressure, or a tendon not rigid")
        return
    postures = HeldPostures.of(robot, angles, holding_torques(robot, angles), supply)
    worst: dict[str, tuple[float, Remark]] = {}
    for index, (time, desired) in enumerate(zip(times, stiffness.tolist(), strict=True)):
        at = f"at {time:.3g} s"
        try:
            robot.check_posture(angles[index].tolist())
        except RangeError as error:
            yield Remark.severe("reference", f"the reference leaves the range {at}: {error.message}", error.remedy)
            return
        try:
            held = postures.posture(index)
            nearest = held_joint_stiffness(held, desired)
            attained = np.diag(nearest.joint_stiffness)
            joints = zip(robot.joint_names, attained, desired, strict=True)
            missed = [name for name, value, aim in joints if abs(value - aim) > EXACT * aim]
            ranges = {} if nearest.exact else held_statics(held, missed)
        except McKibbenError as error:
            yield Remark.severe("reference", f"{at}: {error.message}", error.remedy)
            return
        aims = {joint.name: value for joint, value in zip(robot.joints, desired, strict=True) if joint.name in ranges}
        for name, value in aims.items():
            (low, high), limits = ranges[name].stiffness, ranges[name].limits
            if (excess := max(low - value, value - high)) > max(EXACT * value, worst.get(name, (0.0,))[0]):
                text = f"{name}: {value:.3g} N*m/rad is outside of {low:.3g}..{high:.3g} N*m/rad that it attains {at}"
                by = limits[2 if value < low else 3]
                worst[name] = excess, Remark.severe("reference", f"{text} ({by})", "choose a stiffness between")
        if not (nearest.exact or worst):
            text = f"{at} the joints do not attain their stiffness together: relative error {nearest.error:.2g}"
            worst["all"] = nearest.error, Remark.severe("reference", text, "the nearest is given")
    yield from (remark for _, remark in worst.values())
