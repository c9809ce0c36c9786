"""Position and stiffness of all three joints at once: PID per joint, decoupling per joint, and with the whole leg.

The trunk is held and the foot hangs in the air. Each joint follows a sine and a step of its stiffness while the others
move; valves with a lag of 20 ms, encoders of 0.022 deg, noise of the pressures of 2 kPa. Run it with
`python examples/robot/three_joints.py [DIR]`; it prints the errors of each joint, and writes the controllers as C to
folders of DIR.
"""

import dataclasses
import sys
from pathlib import Path

import numpy as np

import mckibben as mk
from mckibben.actuator import FirstOrderValve
from mckibben.control import Reference, Sine, Step
from mckibben.export import export_robot_controller
from mckibben.plant import SampledSensors
from mckibben.robot import (
    CoupledControl,
    JointwiseControl,
    RobotPlant,
    RobotStart,
    TimedReference,
    read_robot,
    simulate_robot,
)
from mckibben.robot.dynamics import joint_equations
from mckibben.units import bar, deg, kPa, ms

SINES = {"side": (5 * deg, 0.7), "hip": (3 * deg, 1.1), "knee": (8 * deg, 0.9)}  # amplitude, Hz
STEPS = {"side": (14.0, 15.5), "hip": (15.5, 14.0), "knee": (14.5, 16.0)}  # N*m/rad, at half of the time
POSITION_LOOPS = {  # the best of 18 by trial
    "side": mk.PID(kp=4 * bar, ki=12 * bar, kd=0.1 * bar),
    "hip": mk.PID(kp=2 * bar, ki=5 * bar, kd=0.05 * bar),
    "knee": mk.PID(kp=2 * bar, ki=12 * bar, kd=0.05 * bar),
}
DURATION, PERIOD = 2.0, 2 * ms


def plant() -> RobotPlant:
    """The paper's leg with its trunk held, valves of first order and sensors."""
    robot = read_robot("lei-leg")
    held = dataclasses.replace(robot, base="fixed")
    return RobotPlant(held, FirstOrderValve(20 * ms), sensors=SampledSensors(0.022 * deg, 2 * kPa, seed=1))


def references() -> tuple[Reference, ...]:
    """A sine of the angle and a step of the stiffness of each joint."""
    return tuple(Reference(Sine(*SINES[name]), Step(*STEPS[name], DURATION / 2)) for name in SINES)


def controllers(of: RobotPlant) -> dict[str, JointwiseControl]:
    """The controllers that are compared, by name."""
    joints, together = of.robot.joints, TimedReference(references())
    loops = tuple(
        mk.PositionStiffnessControl(
            POSITION_LOOPS[joint.name],
            mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0),
            model=of.robot.pair(i),
            minimum_tension=5.0,
        )
        for i, joint in enumerate(joints)
    )
    at_rest = joint_equations(of.robot, (0.0,) * 3, (0.0,) * 3, of.gravity)
    decoupling = tuple(
        mk.DecouplingControl(
            of.robot.pair(i),
            mk.GeneralLoad(float(at_rest.matrix[i][i]), 0.0, joint.damping),
            mk.PolePlacement(30.0),
            valve=of.valve,
        )
        for i, joint in enumerate(joints)
    )
    return {
        "PID per joint": JointwiseControl(loops, together),
        "decoupling per joint": JointwiseControl(decoupling, together),
        "decoupling of the leg": CoupledControl(decoupling, together, robot=of.robot),
    }


def start(of: RobotPlant) -> RobotStart:
    """All joints at 0 with the first stiffness of their steps."""
    pressures = of.robot.pressures_for((0.0,) * 3, (0.0,) * 3, [STEPS[joint.name][0] for joint in of.robot.joints])
    return RobotStart((0.0,) * 3, pressures, clearance=0.5)


def errors(of: RobotPlant, controller: JointwiseControl) -> dict[str, tuple[float, float]]:
    """RMS errors of the angle [rad] and of the stiffness [N*m/rad] of each joint by its name, after 0.3 s."""
    run = simulate_robot(of, controller, start(of), duration=DURATION, control_period=PERIOD, substeps=4)
    late, found = run["time"] > 0.3, {}
    for i, (joint, reference) in enumerate(zip(of.robot.joints, references(), strict=True)):
        angle, wanted = run["angle"][i], reference(run["time"])
        stiffness = of.robot.pair(i).evaluate(angle, tuple(run["pressure"][2 * i : 2 * i + 2]))[1]
        both = (np.asarray(one)[late] for one in (angle - wanted.angle, stiffness - wanted.stiffness))
        found[joint.name] = tuple(float(np.sqrt(np.mean(np.square(one)))) for one in both)
    return found


if __name__ == "__main__":
    robot = plant()
    for name, controller in controllers(robot).items():
        rows = errors(robot, controller).items()
        print(f"{name}:", "; ".join(f"{joint} {angle / deg:.3f} deg, {k:.3f} N*m/rad" for joint, (angle, k) in rows))
        if sys.argv[1:]:
            folder = Path(sys.argv[1]) / name.replace(" ", "-")
            export_robot_controller(robot, controller, start(robot), folder, duration=DURATION, control_period=PERIOD)
