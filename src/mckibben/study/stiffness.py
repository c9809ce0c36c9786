"""Stiffness of joints at the setpoint held by their controller: over amplitude and rate of motion, and of pushes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.actuator import IdealValve
from mckibben.control import Setpoint
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.muscle.air import HEAT_CAPACITY_RATIO
from mckibben.notebook import Progress, silent
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import JointPlant
from mckibben.result import Column, Listing, Remark, Result, TableColumns, column, table
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import DynamicStiffness, closed_valves, compiled_episode, dynamic_stiffness
from mckibben.study.felt import Felt, felt_stiffness
from mckibben.units import HINGE, bar, deg

Values = NDArray[np.float64]

HELD, CLOSED, COMMANDED, CONTROLLED = "pressures held", "valves closed", "commands constant", "controller at work"
SHOWN = {
    HELD: "constant pressures",
    CLOSED: "closed valves",
    COMMANDED: "constant commands",
    CONTROLLED: "controller active",
}
"""Names of the tests in tables and figures."""


_PUMPED = 0.1  # relative change of the mean stiffness under a push that is worth a remark


class FeltStiffness(Result):
    """Stiffness [N*m/rad] that a push of each joint feels, held at its setpoint by its controller."""

    figures = ("felt_stiffness",)

    scenario: Scenario | RobotScenario
    felt: dict[str, Felt]
    """By the name of the joint, which is empty in a scenario of one joint."""

    def verdict(self) -> str:
        """Return the stiffness that is felt at the lowest and the highest frequency, beside the setpoint."""
        texts = []
        for name, felt in self.felt.items():
            ends = zip(felt.magnitude[[0, -1]], felt.frequency[[0, -1]], strict=True)
            pushes = " and ".join(f"{stiffness:.3g} N*m/rad at {rate:.2g} Hz" for stiffness, rate in ends)
            of = f"{name}: " * bool(name)
            texts.append(f"{of}setpoint {felt.setpoint:.3g} N*m/rad, a push of {felt.torque:g} N*m feels {pushes}")
        return "; ".join(texts)

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on pushes that change the mean stiffness, and on motion that does not settle."""
        for name, felt in self.felt.items():
            of, change = f"{name}: " * bool(name), felt.pushed / felt.isobaric - 1
            at = int(np.argmax(np.abs(change)))
            if abs(change[at]) > _PUMPED:
                text = f"{of}a push of {felt.torque:g} N*m at {felt.frequency[at]:.2g} Hz changes the mean isobaric "
                text += (
                    f"stiffness from {felt.isobaric:.3g} to {felt.pushed[at]:.3g} N*m/rad: the loop works against it"
                )
                yield Remark.warning("pushed", text, "lower the bandwidth of the feedback, or use impedance control")
            if not felt.settled.all():
                rates = ", ".join(f"{rate:.2g}" for rate in felt.frequency[~felt.settled])
                yield Remark.warning(
                    "felt", f"{of}at {rates} Hz the motion does not repeat to 2 %", "push less or more"
                )

    @table("Stiffness of the joint, and what a push feels")
    def comparison(self) -> TableColumns:
        """The isobaric stiffness and that of small motion beside what is felt."""
        stiffness, pushes = Column("N*m/rad", digits=3), list(self.felt.values())
        columns: TableColumns = {"joint": (Column(), list(self.felt))} if all(self.felt) else {}
        columns["push"] = Column("N*m", digits=2), [push.torque for push in pushes]
        for name in ("setpoint", "isobaric", "small_motion"):
            columns[name] = stiffness, [getattr(push, name) for push in pushes]
        for place, rate in enumerate(pushes[0].frequency):
            columns[f"felt at {rate:.2g} Hz"] = stiffness, [push.magnitude[place] for push in pushes]
        return columns

    @table(detail=True)
    def pushes(self) -> list[Listing]:
        """The pushes of each joint."""
        return [
            Listing(f"Push of {push.torque:g} N*m{' on ' * bool(name)}{name}", push.columns(), detail=True)
            for name, push in self.felt.items()
        ]


class StiffnessTests(FeltStiffness):
    """Stiffness [N*m/rad] over amplitude and rate of a motion about the angle held by a scenario's controller."""

    figures = ("felt_stiffness", "stiffness")

    angle: float = column("rad", "angle held", "deg")
    pressures: tuple[float, float]
    """Held, gauge [Pa]."""
    setpoint: float = column("N*m/rad", "setpoint")
    isobaric: float = column("N*m/rad", "without friction, at constant pressures (Eq. 8)")
    closed_valve: float = column("N*m/rad", "without friction, with closed valves")
    polytropic_index: float = column("1", "polytropic index of the closed valves")
    """For air with a temperature that of fast motion."""
    amplitude: Values = column("rad", "amplitude", "deg", digits=3)
    secant: Values = column("N*m/rad", "constant pressures")
    """With friction (`AntagonisticJoint.secant_stiffness`)."""
    closed_secant: Values = column("N*m/rad", "closed valves")
    tests: dict[str, DynamicStiffness]
    """Simulated, by name."""

    def verdict(self) -> str:
        """Return what is held, and the range of the stiffness over the amplitudes."""
        pressures = " and ".join(f"{pressure / bar:.3g}" for pressure in self.pressures)
        low, high = self.secant.min(), self.secant.max()
        held = f"{self.scenario.name}, held at {round(self.angle / deg, 3) + 0.0:g} deg by {pressures} bar"
        return f"{held}: {low:.4g} to {high:.4g} N*m/rad at constant pressures; {super().verdict()}"

    @table()
    def simulated(self) -> list[Listing]:
        """Each simulated test over the rates; for a controller the magnitude."""
        listings = []
        for name, test in self.tests.items():
            stiffness = test.magnitude if name == CONTROLLED else test.stiffness
            columns: TableColumns = {"amplitude": (Column("rad", "amplitude", "deg"), self.amplitude)}
            for rate, values, loss in zip(test.frequency, stiffness, test.loss, strict=True):
                columns[f"{rate:.3g} Hz"] = Column("N*m/rad"), values
                columns[f"loss at {rate:.3g} Hz"] = Column("N*m/rad"), loss
            shown = name == CONTROLLED or (name == CLOSED and self.scenario.valve.wall_conductance is not None)
            listings.append(Listing(f"Simulated: {SHOWN[name]}", columns, detail=not shown))
        return listings


def stiffness_tests(
    scenario: Scenario,
    amplitudes: ArrayLike,
    rates: ArrayLike,
    *,
    torque: float | None = None,
    progress: Progress | None = None,
) -> StiffnessTests:
    """Hold the first setpoint of a scenario, test the stiffness over amplitudes and rates of a motion, and push.

    The tests are simulated with constant pressures (ideal valves), with closed valves, with constant commands if the
    valves hold air, and with the controller active, from the state after 2 s.

    Parameters
    ----------
    scenario
        Plant, controller and reference.
    amplitudes
        Amplitudes of the imposed motion [rad], shape (n,).
    rates
        Frequencies of the imposed motion [Hz], shape (m,).
    torque
        Amplitude of the pushes [N*m], see `felt_stiffness`.
    progress
        Called with the current step and the completed fraction, 0 to 1.

    Returns
    -------
    StiffnessTests
        Stiffness and loss [N*m/rad] of each test, shape (m, n), and the closed forms.

    Raises
    ------
    RangeError
        If an amplitude or rate is not positive, or too high, or the joint is a slide.
    SimulationError
        If the plant needs more substeps.
    """
    report = progress or silent
    if scenario.joint_type is not HINGE:
        message, remedy = "the motion of these tests is imposed on a hinge", "see the stiffness in `mckibben envelope`"
        raise RangeError(message, field="joint", remedy=remedy)
    plant, controller = scenario.plant(), scenario.control()
    closed = closed_valves(plant)
    period, substeps = scenario.control_period, scenario.needed_substeps()
    setpoint = scenario.reference()(0.0)
    plant.check_substeps(setpoint.angle, setpoint.stiffness, period, substeps)
    held = Setpoint(*(jnp.full(round(2.0 / period), float(value)) for value in setpoint))
    start = plant.complete_state(scenario.initial(plant))
    report("settling", 0.0)
    parts = numeric((plant, controller, held, start))
    state, _ = compiled_episode(*parts, period=np.asarray(period), substeps=substeps)

    plants: dict[str, JointPlant] = {HELD: dataclasses.replace(plant, valve=IdealValve()), CLOSED: closed}
    plants |= {COMMANDED: plant} if plant.valve.holds_air else {}
    tests = {}
    for name in (*plants, CONTROLLED):
        report(name, (len(tests) + 1) / (len(plants) + 2))
        control: dict[str, Any] = {"controller": controller, "setpoint": setpoint} if name == CONTROLLED else {}
        own = plants.get(name, plant)
        started = state if own.valve is plant.valve else state._replace(air=())
        times = {"control_period": period, "substeps": substeps}
        tests[name] = dynamic_stiffness(own, started, amplitudes, rates, **control, **times)
    valve: Any = closed.valve
    index = valve.polytropic_index if valve.wall_conductance is None else HEAT_CAPACITY_RATIO
    held_at = state.angle, state.pressures, tests[HELD].amplitude
    numbers = _closed_forms(plant.joint, *held_at, index, valve.dead_volume)
    isobaric, closed_valve, secant, closed_secant = map(np.asarray, numbers)
    return StiffnessTests(
        scenario=scenario,
        felt=felt_stiffness(scenario, torque=torque, progress=progress),
        angle=float(state.angle),
        pressures=(float(state.pressures[0]), float(state.pressures[1])),
        setpoint=float(setpoint.stiffness),
        isobaric=float(isobaric),
        closed_valve=float(closed_valve),
        polytropic_index=float(index),
        amplitude=tests[HELD].amplitude,
        secant=secant,
        closed_secant=closed_secant,
        tests=tests,
    )


@jit
def _closed_forms(
    joint: AntagonisticJoint,
    angle: ArrayLike,
    pressures: tuple[ArrayLike, ArrayLike],
    amplitudes: ArrayLike,
    index: ArrayLike,
    dead_volume: float,
) -> tuple:
    air = {"polytropic_index": index, "dead_volume": dead_volume}
    return (
        joint.stiffness(angle, pressures),
        joint.closed_valve_stiffness(angle, pressures, **air),
        joint.secant_stiffness(angle, pressures, amplitudes),
        joint.secant_stiffness(angle, pressures, amplitudes, **air),
    )
