"""Hopping in place: position and stiffness of both joints by phase, with detection of touchdown and take-off.

Run it with `python examples/robot/hopping.py`; it prints the time in the air of each hop.
"""

from pathlib import Path

import numpy as np

import mckibben as mk
from mckibben.control import Setpoint
from mckibben.robot import JointwiseControl, PhasedReference, RobotScenario, RobotStart, simulate_robot
from mckibben.units import bar, deg, ms

FILE = Path(__file__).with_name("lei-leg.yaml")


def hop(duration: float = 4.0):
    """Simulate the leg on its slider, dropped from 30 mm, for a duration [s]."""
    plant = RobotScenario.read(FILE).plant()

    hip = Setpoint(angle=0 * deg, stiffness=16.0)
    folded, stretched = Setpoint(angle=-8 * deg, stiffness=14.0), Setpoint(angle=16 * deg, stiffness=17.0)
    reference = PhasedReference(
        flight=(hip, folded),
        touchdown=(hip, folded),
        stance=(hip, folded),
        push_off=(hip, stretched),
        blanking=60 * ms,
    )
    controllers = tuple(
        mk.PositionStiffnessControl(
            mk.PID(kp=6 * bar, ki=40 * bar, kd=0.1 * bar),
            mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0),
            model=joint.muscles,
            minimum_tension=5.0,
        )
        for joint in plant.robot.joints
    )
    angles = (0 * deg, -8 * deg)
    pressures = plant.robot.pressures_for(angles, (0.0, 0.0), (16.0, 14.0))
    start = RobotStart(angles, pressures, clearance=0.03)
    return simulate_robot(plant, JointwiseControl(controllers, reference), start, duration=duration, accuracy=1e-4)


def flights(run):
    """Return the time in the air [s] of each hop of a run."""
    times = run["flight_time"]
    return times[1:][np.diff(times) != 0]


if __name__ == "__main__":
    found = flights(hop())
    print("time in the air [ms]:", ", ".join(f"{time / ms:.0f}" for time in found))
    print(f"the last six hops: {found[-6:].mean() / ms:.0f} +- {found[-6:].std() / ms:.0f} ms")
