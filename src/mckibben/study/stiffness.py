"""Stiffness of joints at the setpoint held by their controller: over amplitude and rate of motion, and of pushes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.actuator import IdealValve
from mckibben.control import Setpoint
from mckibben.joint.route import closed_valve_stiffness, secant_stiffness
from mckibben.mechanism.base import joints_in, over_joints
from mckibben.muscle.air import HEAT_CAPACITY_RATIO
from mckibben.notebook import Progress, silent
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.plant import Plant, PlantState
from mckibben.result import Column, Listing, Remark, Result, TableColumns, table
from mckibben.scenario import StudiedScenario
from mckibben.simulation import DynamicStiffness, closed_valves, compiled_episode, dynamic_stiffness
from mckibben.study.felt import Felt, felt_stiffness, first_setpoints
from mckibben.units import JointType, bar

Values = NDArray[np.float64]

HELD, CLOSED, COMMANDED, CONTROLLED = "pressures held", "valves closed", "commands constant", "controller at work"
SHOWN = {
    HELD: "constant pressures",
    CLOSED: "closed valves",
    COMMANDED: "constant commands",
    CONTROLLED: "controller active",
}
"""Names of the tests in tables and figures."""


_STIFFNESS = Column("N*m/rad")
_PUMPED = 0.1  # relative change of the mean stiffness under a push that is worth a remark


class FeltStiffness(Result):
    """Stiffness [N*m/rad] that a push of each joint feels, held at its setpoint by its controller."""

    figures = ("felt_stiffness",)

    scenario: StudiedScenario
    felt: dict[str, Felt]
    """By the name of the joint, which is empty in a scenario of one joint."""

    @property
    def joint_type(self) -> JointType:
        return self.scenario.joint_type

    def verdict(self) -> str:
        """Return the stiffness that is felt at the lowest and the highest frequency, beside the setpoint."""
        texts, show = [], self.scenario.joint_type.show
        for name, felt in self.felt.items():
            ends = zip(felt.magnitude[[0, -1]], felt.frequency[[0, -1]], strict=True)
            pushes = " and ".join(f"{show(stiffness, 'N*m/rad', 3)} at {rate:.2g} Hz" for stiffness, rate in ends)
            setpoint = f"setpoint {show(felt.setpoint, 'N*m/rad', 3)}, " if np.isfinite(felt.setpoint) else ""
            push = f"{setpoint}a push of {show(felt.torque, 'N*m')} feels {pushes}"
            texts.append(f"{name}: {push}" if name else push)
        return "; ".join(texts)

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on pushes that change the mean stiffness, and on motion that does not settle."""
        show = self.scenario.joint_type.show
        for name, felt in self.felt.items():
            of, change = f"{name}: " * bool(name), felt.pushed / felt.isobaric - 1
            at = int(np.argmax(np.abs(change)))
            if abs(change[at]) > _PUMPED:
                before, after = (show(value, "N*m/rad", 3) for value in (felt.isobaric, felt.pushed[at]))
                text = f"{of}a push of {show(felt.torque, 'N*m')} at {felt.frequency[at]:.2g} Hz changes the mean "
                text += f"isobaric stiffness from {before} to {after}: the loop works against it"
                yield Remark.warning("pushed", text, "lower the bandwidth of the feedback, or use impedance control")
            if not felt.settled.all():
                rates = ", ".join(f"{rate:.2g}" for rate in felt.frequency[~felt.settled])
                yield Remark.warning(
                    "felt", f"{of}at {rates} Hz the motion does not repeat to 2 %", "push less or more"
                )

    @table("Stiffness of the joint, and what a push feels")
    def comparison(self) -> TableColumns:
        """The isobaric stiffness and that of small motion beside what is felt."""
        pushes, stiffness = list(self.felt.values()), Column("N*m/rad", digits=3)
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
        show = self.joint_type.show
        return [
            Listing(f"Push of {show(push.torque, 'N*m')}{' on ' * bool(name)}{name}", push.columns(), detail=True)
            for name, push in self.felt.items()
        ]


class MotionTests(NamedTuple):
    """Stiffness [N*m/rad] of a joint over amplitude and rate of a motion about the angle that its controller holds."""

    angle: float
    """Held [rad]."""
    pressures: tuple[float, ...]
    """Held by the muscles of the joint, gauge [Pa]."""
    setpoint: float
    isobaric: float
    """At constant pressures, without friction (Eq. 8)."""
    closed_valve: float
    """With closed valves, without friction."""
    polytropic_index: float
    """Of the closed valves; for air with a temperature that of fast motion."""
    amplitude: Values
    """Amplitudes [rad]."""
    secant: Values
    """Over the amplitude at constant pressures, with friction (`secant_stiffness`)."""
    closed_secant: Values
    """Likewise with closed valves."""
    tests: dict[str, DynamicStiffness]
    """Simulated, by name."""

    def verdict(self, kind: JointType) -> str:
        """Return what is held, and the range of the stiffness over the amplitudes."""
        pressures = " and ".join(f"{pressure / bar:.3g}" for pressure in self.pressures)
        held = f"held at {round(self.angle / kind.size('deg'), 3) + 0.0:g} {kind.shown('deg')} by {pressures} bar"
        return f"{held}: {kind.span((self.secant.min(), self.secant.max()), 'N*m/rad')} at constant pressures"

    def listings(self, name: str, closed_depends_on_rate: bool) -> Iterator[Listing]:
        """Yield the closed forms over the amplitude, and each simulated test over the rates; a name is of the joint."""
        of = f"{name}: " * bool(name)
        amplitude = Column("rad", "amplitude", "deg", digits=3), self.amplitude
        over = {"amplitude": amplitude, SHOWN[HELD]: (_STIFFNESS, self.secant)}
        yield Listing(f"{of}Closed forms, with friction", over | {SHOWN[CLOSED]: (_STIFFNESS, self.closed_secant)})
        for test, found in self.tests.items():
            stiffness = found.magnitude if test == CONTROLLED else found.stiffness
            columns: TableColumns = {"amplitude": amplitude}
            for rate, values, loss in zip(found.frequency, stiffness, found.loss, strict=True):
                columns[f"{rate:.3g} Hz"] = _STIFFNESS, values
                columns[f"loss at {rate:.3g} Hz"] = _STIFFNESS, loss
            detail = not (test == CONTROLLED or (test == CLOSED and closed_depends_on_rate))
            yield Listing(f"{of}Simulated: {SHOWN[test]}", columns, detail=detail)


class StiffnessTests(FeltStiffness):
    """Stiffness [N*m/rad] over amplitude and rate of a motion about the angles held by a scenario's controller."""

    figures = ("felt_stiffness", "stiffness")

    motions: dict[str, MotionTests]
    """By the name of the joint, which is empty in a scenario of one joint."""

    def verdict(self) -> str:
        """Return what is held, and the range of the stiffness over the amplitudes."""
        kind = self.scenario.joint_type
        texts = [f"{name or self.scenario.name}, {motion.verdict(kind)}" for name, motion in self.motions.items()]
        return "; ".join([*texts, super().verdict()])

    @table("Stiffness of small motion, without friction")
    def held(self) -> TableColumns:
        """What is held, and the closed forms without friction."""
        motions = list(self.motions.values())
        columns: TableColumns = {"joint": (Column(), list(self.motions))} if all(self.motions) else {}
        columns["angle"] = Column("rad", "angle held", "deg"), [motion.angle for motion in motions]
        columns["setpoint"] = _STIFFNESS, [motion.setpoint for motion in motions]
        columns["isobaric"] = Column("N*m/rad", SHOWN[HELD]), [motion.isobaric for motion in motions]
        columns["closed_valve"] = Column("N*m/rad", SHOWN[CLOSED]), [motion.closed_valve for motion in motions]
        columns["polytropic_index"] = Column("1"), [motion.polytropic_index for motion in motions]
        return columns

    @table()
    def simulated(self) -> list[Listing]:
        """The tests of each joint."""
        warm = getattr(self.scenario.valve, "wall_conductance", None) is not None
        return [listing for name, motion in self.motions.items() for listing in motion.listings(name, warm)]


def stiffness_tests(
    scenario: StudiedScenario,
    amplitudes: ArrayLike,
    rates: ArrayLike,
    *,
    torque: float | None = None,
    progress: Progress | None = None,
) -> StiffnessTests:
    """Hold the first setpoints of a scenario, test the stiffness over amplitudes and rates of a motion, and push.

    The tests are simulated with constant pressures (ideal valves), with closed valves, with constant commands if the
    valves hold air, and with the controller active, from the state after 2 s. A machine moves one joint after the
    other, and holds the others.

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
        Stiffness and loss [N*m/rad] of each test, shape (m, n), and the closed forms, by joint.

    Raises
    ------
    RangeError
        If an amplitude or rate is not positive, or too high.
    SimulationError
        If the plant needs more substeps.
    """
    report = progress or silent
    plant: PyTree = scenario.plant()
    controller = scenario.control()
    closed = closed_valves(plant)
    period, substeps = scenario.control_period, scenario.needed_substeps()
    setpoint = first_setpoints(scenario)
    count = round(2.0 / period)
    held = over_joints(lambda values: Setpoint(*(jnp.full(count, float(value)) for value in values)), setpoint)
    report("settling", 0.0)
    start = plant.complete_state(scenario.initial(plant))
    arguments = numeric((plant, controller, held, start))
    state, _ = compiled_episode(*arguments, period=np.asarray(period), substeps=substeps)

    plants: dict[str, Plant] = {
        HELD: dataclasses.replace(plant, valve=IdealValve()),
        CLOSED: closed,
        **({COMMANDED: plant} if plant.valve.holds_air else {}),
        CONTROLLED: plant,
    }
    valve: PyTree = closed.valve
    index = valve.polytropic_index if valve.wall_conductance is None else HEAT_CAPACITY_RATIO
    names = scenario.joint_names or ("",)
    motions, done = {}, 0
    for joint, name in enumerate(names):
        tests = {}
        for test, tested in plants.items():
            report(f"{name} {test}".strip(), done / (len(plants) * len(names)))
            done += 1
            control: dict[str, PyTree] = {"controller": controller, "setpoint": setpoint} if test == CONTROLLED else {}
            started = state if tested.valve_of(0) is plant.valve_of(0) else state._replace(air=())
            times = {"control_period": period, "substeps": substeps}
            tests[test] = dynamic_stiffness(tested, started, amplitudes, rates, joint=joint, **control, **times)
        amplitude = tests[HELD].amplitude
        numbers = _closed_forms(*numeric((plant, state, amplitude, index, valve.dead_volume)), joint=joint)
        isobaric, closed_valve, secant, closed_secant = map(np.asarray, numbers)
        routes = zip(plant.mechanism.routes(state.position), state.pressures, strict=True)
        motions[name] = MotionTests(
            angle=float(plant.mechanism.by_joint(state.position)[joint]),
            pressures=tuple(float(pressure) for route, pressure in routes if joint in route.slopes),
            setpoint=float(joints_in(setpoint)[joint].stiffness),
            isobaric=float(isobaric),
            closed_valve=float(closed_valve),
            polytropic_index=float(index),
            amplitude=amplitude,
            secant=secant,
            closed_secant=closed_secant,
            tests=tests,
        )
    felt = felt_stiffness(scenario, torque=torque, progress=progress)
    return StiffnessTests(scenario=scenario, felt=felt, motions=motions)


@jit_arrays
def _closed_forms(
    plant: Plant,
    state: PlantState,
    amplitudes: ArrayLike,
    index: ArrayLike,
    dead_volume: ArrayLike,
    joint: int,
) -> tuple:
    mechanism, position, pressures = plant.mechanism, state.position, state.pressures
    angle, over = mechanism.by_joint(position)[joint], mechanism.routes_over(position, joint)

    def secants(index: ArrayLike | None) -> PyTree:
        air: PyTree = {"polytropic_index": index, "dead_volume": dead_volume}
        return jax.vmap(lambda amplitude: secant_stiffness(over, joint, angle, pressures, amplitude, **air))(amplitudes)

    routes, indices = mechanism.routes(position), (index,) * len(pressures)
    return (
        mechanism.stiffness(position, pressures)[joint],
        closed_valve_stiffness(routes, joint, pressures, indices, dead_volume),
        secants(None),
        secants(index),
    )
