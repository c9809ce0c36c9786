"""Hopping in place: position and stiffness of both joints by phase, with detection of touchdown and take-off.

Run it with `python examples/robot/hopping.py`; it prints the time in the air of each hop.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

import mckibben as mk
from mckibben.component.checks import check_count
from mckibben.component.columns import Label
from mckibben.control import Setpoint
from mckibben.numerics.elementary import exp
from mckibben.robot import (
    JointwiseControl,
    RobotController,
    RobotMeasurement,
    RobotScenario,
    RobotStart,
)
from mckibben.units import PositiveTime, ShortTime, Tension, bar, deg, ms

Scalar = Float[Array, ""]

FILE = Path(__file__).with_name("lei-leg.yaml")


FLIGHT, TOUCHDOWN, STANCE, PUSH_OFF = range(4)
"""Phases: foot in the air; a set time from its touch on; until the leg lengthens; until the foot leaves the ground."""


class PhaseState(NamedTuple):
    """Controllers, phase and its time [s], setpoints, angle of the extensor [rad], and last flight [s]."""

    controllers: PyTree
    phase: Array
    since: Scalar
    setpoints: tuple[Setpoint, ...]
    extension: Scalar
    flight: Scalar


class HopControl(RobotController):
    """Position and stiffness of the joints by phase of a hop: touchdown, deepest point and take-off are detected.

    Phases are flight; touchdown, from the first force on the foot for a set time; stance, until the angle of the
    `extensor` joint reverses; push-off, until the force on the foot is zero. Setpoints follow those of the phase
    with a first-order lag. A push-off that is the same in each hop leads to hops of equal height, at which it
    adds the energy that a hop loses: M. H. Raibert, Legged Robots That Balance, MIT Press 1986, ch. 2.

    Parameters
    ----------
    joints
        Controllers of the joints.
    flight, touchdown, stance, push_off
        Setpoint of each joint in each phase: angle [rad] and stiffness [N*m/rad].
    threshold
        Force [N] on the foot that counts as contact.
    touchdown_time, blanking, lag
        Duration of the touchdown [s], time [s] after an event in which the foot may bounce without another one, and
        time constant [s] of the setpoints.
    extensor
        Index of the joint whose angle grows as the robot gets longer.
    """

    telemetry_labels: ClassVar = {
        "phase": Label("1", "phase of the hop: 0 flight, 1 touchdown, 2 stance, 3 push-off"),
        "flight_time": Label("s", "duration of the last flight"),
    }

    follows_reference = False

    joints: JointwiseControl
    flight: tuple[Setpoint, ...]
    touchdown: tuple[Setpoint, ...]
    stance: tuple[Setpoint, ...]
    push_off: tuple[Setpoint, ...]
    threshold: Tension = 5.0
    touchdown_time: ShortTime = 20 * ms
    blanking: ShortTime = 30 * ms
    lag: PositiveTime = 5 * ms
    extensor: int = eqx.field(static=True, default=-1)

    def __check_init__(self) -> None:
        super().__check_init__()
        for name in ("touchdown", "stance", "push_off"):
            check_count(name, len(getattr(self, name)), len(self.flight), "joint, as for the flight")

    def init(self, measurement: RobotMeasurement) -> PhaseState:
        zero = jnp.zeros(())
        setpoints = tuple(Setpoint(*map(jnp.asarray, one)) for one in self.flight)
        begun = jnp.where(measurement.ground_force > self.threshold, STANCE, FLIGHT)
        held = self.joints.init(measurement)
        return PhaseState(held, begun, zero, setpoints, measurement.angles[self.extensor], zero)

    def step(
        self, state: PhaseState, setpoint: ArrayLike, measurement: RobotMeasurement, period: ArrayLike
    ) -> tuple[PhaseState, tuple[Array, ...]]:
        touching = measurement.ground_force > self.threshold
        extension = measurement.angles[self.extensor]
        phase = state.phase
        settled = state.since >= self.blanking
        landed = (phase == FLIGHT) & touching & settled
        ended = (
            landed
            | ((phase == TOUCHDOWN) & (state.since >= self.touchdown_time))
            | ((phase == STANCE) & (extension > state.extension) & settled)
            | ((phase == PUSH_OFF) & ~touching & settled)
        )
        flight = jnp.where(landed, state.since, state.flight)
        phase = jnp.where(ended, (phase + 1) % 4, phase)
        since = jnp.where(ended, 0.0, state.since + period)
        part = 1 - exp(-jnp.asarray(period) / self.lag)
        setpoints = []
        for index, held in enumerate(state.setpoints):
            each = [getattr(self, name)[index] for name in ("flight", "touchdown", "stance", "push_off")]
            angle = _select(phase, [one.angle for one in each])
            stiffness = _select(phase, [one.stiffness for one in each])
            setpoints.append(
                Setpoint(held.angle + part * (angle - held.angle), held.stiffness + part * (stiffness - held.stiffness))
            )
        held, commands = self.joints.step(state.controllers, setpoints, measurement, period)
        return PhaseState(held, phase, since, tuple(setpoints), extension, flight), commands

    def telemetry(self, state: PhaseState) -> dict[str, PyTree]:
        return {"phase": state.phase, "flight_time": state.flight} | self.joints.telemetry(state.controllers)


def _select(phase: Array, values: Sequence[ArrayLike]) -> Array:
    """Value of a phase."""
    chosen = jnp.asarray(values[0])
    for number, value in enumerate(values[1:], 1):
        chosen = jnp.where(phase == number, value, chosen)
    return chosen


def hop(duration: float = 4.0):
    """Simulate the leg on its slider, dropped from 30 mm, for a duration [s]."""
    plant = RobotScenario.read(FILE).plant()

    hip = Setpoint(angle=0 * deg, stiffness=16.0)
    folded, stretched = Setpoint(angle=-8 * deg, stiffness=14.0), Setpoint(angle=16 * deg, stiffness=17.0)
    controllers = tuple(
        mk.PositionStiffnessControl(
            mk.PID(kp=6 * bar, ki=40 * bar, kd=0.1 * bar),
            mk.PID(kp=0.08 * bar, ki=5 * bar, kd=0.0),
            model=plant.robot.pair(index),
            minimum_tension=5.0,
        )
        for index in plant.robot.pairs
    )
    control = HopControl(
        JointwiseControl(controllers),
        flight=(hip, folded),
        touchdown=(hip, folded),
        stance=(hip, folded),
        push_off=(hip, stretched),
        blanking=60 * ms,
    )
    angles = (0 * deg, -8 * deg)
    pressures = plant.robot.pressures_for(angles, (0.0, 0.0), (16.0, 14.0))
    start = RobotStart(angles, pressures, clearance=0.03)
    return mk.simulate(plant, control, initial=start, duration=duration, accuracy=1e-4)


def flights(run):
    """Return the time in the air [s] of each hop of a run."""
    times = run["flight_time"]
    return times[1:][np.diff(times) != 0]


if __name__ == "__main__":
    found = flights(hop())
    print("time in the air [ms]:", ", ".join(f"{time / ms:.0f}" for time in found))
    print(f"the last six hops: {found[-6:].mean() / ms:.0f} +- {found[-6:].std() / ms:.0f} ms")
