"""Stiffness of a scenario's joint over amplitude and rate of a motion, at the setpoint held by its controller."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from mckibben.control import Setpoint
from mckibben.muscle.air import HEAT_CAPACITY_RATIO
from mckibben.notebook import Progress, silent
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import IdealValve, JointPlant
from mckibben.scenario import Scenario
from mckibben.simulation import DynamicStiffness, closed_valves, compiled_episode, dynamic_stiffness
from mckibben.units import bar, deg

Values = NDArray[np.float64]

_SETTLING = 2.0  # s
HELD, CLOSED, COMMANDED, CONTROLLED = "pressures held", "valves closed", "commands constant", "controller at work"
SHOWN = {
    HELD: "constant pressures",
    CLOSED: "closed valves",
    COMMANDED: "constant commands",
    CONTROLLED: "controller active",
}
"""Names of the tests in tables and figures."""


@dataclass(frozen=True)
class StiffnessTests:
    """Stiffness [N*m/rad] over amplitude and rate of a motion about the angle held by a scenario's controller."""

    scenario: Scenario
    angle: float  # held [rad]
    pressures: tuple[float, float]  # held, gauge [Pa]
    asked: float  # setpoint
    isobaric: float  # slope without friction (Eq. 8), at constant pressures
    closed_valve: float  # likewise, with closed valves
    polytropic_index: float  # of the closed valves; for air with a temperature that of fast motion
    secant: Values  # with friction, over the amplitudes (`AntagonisticJoint.secant_stiffness`)
    closed_secant: Values
    tests: dict[str, DynamicStiffness]  # simulated, by name
    closed_dynamic: NDArray[np.complex128] | None = None  # K' + i K'' over the rates, for air with a temperature

    def __repr__(self) -> str:
        low, high = self.secant.min(), self.secant.max()
        return (
            f"<StiffnessTests of {self.scenario.name!r}: isobaric {self.isobaric:.4g}, {low:.4g}..{high:.4g} N*m/rad>"
        )

    @property
    def amplitudes(self) -> Values:
        """Amplitudes of the motion [rad]."""
        return self.tests[HELD].amplitude

    def describe(self) -> str:
        """Setpoint of the tests and stiffness without friction, as text."""
        angle, pressures = round(self.angle / deg, 3) + 0.0, ", ".join(f"{p / bar:.3g}" for p in self.pressures)
        return (
            f"held: {angle:g} deg at {pressures} bar, setpoint {self.asked:.4g} N*m/rad; without friction "
            f"{self.isobaric:.4g} N*m/rad at constant pressures, {self.closed_valve:.4g} with closed valves (n = "
            f"{self.polytropic_index:g})"
        )

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headers and rows of a table of every other amplitude and rate; for a controller, the magnitude."""
        constant = (HELD, CLOSED) if self.closed_dynamic is None else (HELD,)
        varied = [(name, test) for name, test in self.tests.items() if name not in constant]
        headers = ["amplitude", *(SHOWN[name] for name in constant)]
        headers += [f"{SHOWN[name]}, {rate:.2g} Hz" for name, test in varied for rate in test.frequency[::2]]
        columns = [self.secant, self.closed_secant][: len(constant)]
        for name, test in varied:
            columns += [*(test.magnitude if name == CONTROLLED else test.stiffness)[::2]]
        rows: list[tuple[str, ...]] = [
            (f"{amplitude / deg:.3g} deg", *(f"{column[i]:.4g}" for column in columns))
            for i, amplitude in enumerate(self.amplitudes)
        ]
        return tuple(headers), rows[::2]

    def records(self) -> dict[str, Any]:
        """The results as plain data; angles in deg, pressures in bar, stiffness in N*m/rad."""
        dynamic = self.closed_dynamic
        closed = (
            {} if dynamic is None else {"closed_storage": dynamic.real.tolist(), "closed_loss": dynamic.imag.tolist()}
        )
        return {
            "scenario": self.scenario.name,
            "angle_deg": self.angle / deg,
            "pressures_bar": [p / bar for p in self.pressures],
            "asked": self.asked,
            "isobaric": self.isobaric,
            "closed_valve": self.closed_valve,
            "polytropic_index": self.polytropic_index,
            "amplitude_deg": (self.amplitudes / deg).tolist(),
            "secant": self.secant.tolist(),
            "closed_secant": self.closed_secant.tolist(),
            **closed,
            "tests": {
                name: {key: getattr(test, key).tolist() for key in ("frequency", "stiffness", "loss")}
                for name, test in self.tests.items()
            },
        }


def stiffness_tests(
    scenario: Scenario, amplitudes: ArrayLike, rates: ArrayLike, *, progress: Progress | None = None
) -> StiffnessTests:
    """Hold the first setpoint of a scenario for 2 s, and test the stiffness over amplitudes [rad] and rates [Hz].

    Raises `RangeError` for one that is not positive or too high, `SimulationError` if the plant needs more substeps.
    """
    report = progress or silent
    plant, controller = scenario.plant(), scenario.control()
    closed = closed_valves(plant)
    period, substeps = scenario.control_period, scenario.needed_substeps()
    setpoint = scenario.reference()(0.0)
    plant.check_substeps(setpoint.angle, setpoint.stiffness, period, substeps)
    held = Setpoint(*(jnp.full(round(_SETTLING / period), float(value)) for value in setpoint))
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
    dead, dynamic = valve.dead_volume, None
    if valve.wall_conductance is not None:
        dynamic = np.asarray(_closed_dynamic(*numeric((closed, state, tests[CLOSED].frequency))))
    numbers = _closed_forms(plant.joint, state.angle, state.pressures, tests[HELD].amplitude, index, dead)
    isobaric, closed_valve, secant, closed_secant = map(np.asarray, numbers)
    return StiffnessTests(
        scenario,
        float(state.angle),
        (float(state.pressures[0]), float(state.pressures[1])),
        float(setpoint.stiffness),
        float(isobaric),
        float(closed_valve),
        float(index),
        secant,
        closed_secant,
        tests,
        dynamic,
    )


@jit
def _closed_forms(joint: Any, angle: Any, pressures: Any, amplitudes: Any, index: Any, dead_volume: Any) -> tuple:
    air = {"polytropic_index": index, "dead_volume": dead_volume}
    return (
        joint.stiffness(angle, pressures),
        joint.closed_valve_stiffness(angle, pressures, **air),
        joint.secant_stiffness(angle, pressures, amplitudes),
        joint.secant_stiffness(angle, pressures, amplitudes, **air),
    )


@jit
def _closed_dynamic(plant: JointPlant, state: Any, rates: Any) -> Any:
    """Complex stiffness [N*m/rad] of small motions at rates [Hz] with closed valves, without friction."""
    volumes = [one.volume for one in plant.air_volumes(state)]
    valve: Any = plant.valve
    pairs = zip(state.pressures, volumes, strict=True)
    indices = tuple(valve.index_at(pressure, volume, rates) for pressure, volume in pairs)
    return plant.joint.closed_valve_stiffness(
        state.angle, state.pressures, polytropic_index=indices, dead_volume=valve.dead_volume
    )
