"""Dynamic stiffness that a push feels: torque over angle of a joint in closed loop, over the frequency."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree
from numpy.typing import NDArray

from mckibben.component.checks import check_positive
from mckibben.joint.antagonistic import SMALL_MOTION
from mckibben.joint.route import secant_stiffness
from mckibben.mechanism.base import joints_in
from mckibben.mechanism.disturbance import Disturbance
from mckibben.notebook import Progress, silent
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.numerics.elementary import floating
from mckibben.plant import Plant
from mckibben.result import Column, TableColumns
from mckibben.scenario import StudiedScenario
from mckibben.simulation import simulate

Values = NDArray[np.float64]

FREQUENCIES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Frequencies of pushes [Hz]."""
_SETTLING, _MEASURED = 2.0, 1.0  # s: least time before the measured cycles, and of these
_LONGEST = 16  # times the settling
_STEADY = 0.02  # relative change between two measurements
_FEWEST = 8  # control periods in a cycle
_SHARE = 0.1  # of the attainable torque


class Felt(NamedTuple):
    """Resistance of a joint to a sinusoidal torque, held at its setpoint by its controller.

    A robot's other joints are held by the controller, too. Inertia, gravity and friction take part.
    """

    angle: float
    """Held [rad]."""
    setpoint: float
    """Stiffness [N*m/rad] that is asked for."""
    isobaric: float
    """Isobaric stiffness [N*m/rad] of the muscles, held without a push."""
    small_motion: float
    """Stiffness [N*m/rad] of slow motion by 0.1 deg, or 0.1 mm, at constant pressures, with friction."""
    torque: float
    """Amplitude of the push [N*m]."""
    frequency: Values
    """Frequencies of the pushes [Hz], shape (n,)."""
    impedance: NDArray[np.complex128]
    """Torque over angle [N*m/rad] at these, shape (n,)."""
    pushed: Values
    """Mean isobaric stiffness [N*m/rad] meanwhile, shape (n,)."""
    settled: NDArray[np.bool_]
    """Whether the motion repeats to 2 %, shape (n,)."""

    @property
    def magnitude(self) -> Values:
        """Stiffness that is felt [N*m/rad]: the amplitude of the torque over that of the angle."""
        return np.abs(self.impedance)

    @property
    def deflection(self) -> Values:
        """Amplitude of the angle [rad]."""
        return self.torque / self.magnitude

    def columns(self) -> TableColumns:
        """Felt stiffness over the frequency."""
        stiffness = Column("N*m/rad", digits=3)
        return {
            "frequency": (Column("Hz", digits=2), self.frequency),
            "felt": (stiffness, self.magnitude),
            "phase": (Column("rad", "", "deg", digits=3, phase=True), np.angle(self.impedance)),
            "deflection": (Column("rad", "", "deg", digits=2), self.deflection),
            "isobaric": (stiffness, self.pushed),
        }


class _Push(Disturbance):
    """A sine of torque."""

    amplitude: ArrayLike = 0.0
    frequency: ArrayLike = 1.0

    def torque(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(self.amplitude) * jnp.sin(2 * jnp.pi * self.frequency * floating(time))


class _Run(NamedTuple):
    """Angles [rad] and isobaric stiffness [N*m/rad] of a run, shape (joints, periods), and pressures [Pa]."""

    angles: Values
    stiffness: Values
    pressures: Values


class _Loop:
    """A closed loop that holds the first setpoints of a scenario, and whose joints are pushed."""

    def __init__(self, scenario: StudiedScenario) -> None:
        plant, asked = scenario.plant(), first_setpoints(scenario)
        self._plant, self._controller, self._start = plant, scenario.control(), scenario.starts()
        references = scenario.references()
        self._reference = {name: references[name].held() for name in scenario.joint_names} or references.held()
        self._position = plant.complete_state(scenario.initial(plant)).position
        self._times = {"control_period": scenario.control_period, "substeps": scenario.needed_substeps()}
        self.setpoints, self.period = joints_in(asked), scenario.control_period

    def run(self, joint: int, torque: float, frequency: float, duration: float) -> _Run:
        """Push a joint by a sine [N*m] of a frequency [Hz]."""
        pushes = [_Push(torque * (number == joint), frequency) for number in range(len(self.setpoints))]
        options: dict[str, PyTree] = {"initial": self._start, "duration": duration, "warn_infeasible": False}
        result = simulate(
            self._plant.with_disturbances(pushes), self._controller, self._reference, **options, **self._times
        )
        angles, pressures = np.atleast_2d(result["angle"]), result["pressure"]
        stiffness = _isobaric(*numeric((self._plant, self._position, angles, pressures)))
        return _Run(angles, np.asarray(stiffness), pressures)

    def felt(self, joint: int, amplitude: float, frequencies: Sequence[float], tell: Callable[[], None]) -> Felt:
        """Push one of the joints by an amplitude [N*m]."""
        at_rest = self.run(joint, 0.0, 1.0, _SETTLING)
        counts = np.unique([max(round(1 / (f * self.period)), _FEWEST) for f in frequencies])[::-1]
        impedance, pushed, settled = [], [], []
        for count in counts:
            tell()
            cycle = count * self.period
            cycles = max(int(np.ceil(_MEASURED / cycle)), 1)
            before = max(int(np.ceil(_SETTLING / cycle)), 1)
            moved, change, run, more = 0j, np.inf, at_rest, 1
            while change >= _STEADY and more <= _LONGEST:
                run = self.run(joint, amplitude, 1 / cycle, (more * before + 2 * cycles) * cycle)
                windows = run.angles[joint, -2 * cycles * count :].reshape(2, -1)
                earlier, moved = 2 * np.mean(windows * np.exp(-2j * np.pi * np.arange(cycles * count) / count), axis=1)
                change = abs(moved - earlier) / abs(moved)
                more *= 4
            held = np.sinc(1 / count) * np.exp(-1j * np.pi / count)  # the torque is constant over control periods
            impedance.append(-1j * amplitude * held / moved)
            pushed.append(run.stiffness[joint, -cycles * count :].mean())
            settled.append(change < _STEADY)
        last = at_rest.angles[:, -1], at_rest.pressures[:, -1]
        return Felt(
            float(at_rest.angles[joint, -1]),
            float(self.setpoints[joint].stiffness),
            float(at_rest.stiffness[joint, -round(0.5 / self.period) :].mean()),
            float(_small_motion(*numeric((self._plant, self._position, *last)), joint=joint)),
            amplitude,
            1 / (counts * self.period),
            np.array(impedance),
            np.array(pushed),
            np.array(settled),
        )


def felt_stiffness(
    scenario: StudiedScenario,
    *,
    torque: float | None = None,
    frequencies: Sequence[float] = FREQUENCIES,
    progress: Progress | None = None,
) -> dict[str, Felt]:
    """Hold the first setpoints of a scenario, and push each joint with sines of torque.

    Of the angle the component with the frequency of the push counts, once it repeats to 2 %, after 2 s at least.

    Parameters
    ----------
    scenario
        Plant, controller and reference; its disturbances are left out.
    torque
        Amplitude of the push [N*m]. Default: a tenth of half the attainable range of torque.
    frequencies
        Frequencies of the pushes [Hz], of which each cycle is rounded to control periods.
    progress
        Called with the name of the joint and the completed fraction, 0 to 1.

    Returns
    -------
    dict
        By the name of the joint, which is empty in a scenario of one joint; locked joints are left out.

    Raises
    ------
    RangeError
        If torque or frequency is not positive.
    SimulationError
        If the plant needs more substeps.
    """
    check_positive("felt_stiffness", "Hz", frequencies=frequencies)
    if torque is not None:
        check_positive("felt_stiffness", scenario.joint_type.unit("N*m"), torque=torque)
    report, loop = progress or silent, _Loop(scenario)
    ranges, names = scenario.attainable_torques(), scenario.joint_names or ("",)
    felt, done = {}, 0
    for name, (low, high) in ranges.items():

        def tell(name: str = name) -> None:
            nonlocal done
            report(f"pushing {name}".strip(), done / (len(frequencies) * len(ranges)))
            done += 1

        amplitude = float(f"{_SHARE * (high - low) / 2:.1g}") if torque is None else torque
        felt[name] = loop.felt(names.index(name), amplitude, frequencies, tell)
    return felt


def first_setpoints(scenario: StudiedScenario) -> PyTree:
    """Return the first setpoint of an unnamed joint, or a tuple of those of all joints."""
    references: PyTree = scenario.references()
    if not scenario.joint_names:
        return references(0.0)
    return tuple(references[name](0.0) for name in scenario.joint_names)


@jit_arrays
def _isobaric(plant: Plant, position: PyTree, angles: Array, pressures: Array) -> Array:
    """Isobaric stiffness [N*m/rad] in the form of a position, by joint, at angles and pressures over the last axis."""

    def at(angles: Array, pressures: Array) -> Array:
        return jnp.stack(plant.mechanism.stiffness(plant.mechanism.like_joints(tuple(angles), position), (*pressures,)))

    return jax.vmap(at, in_axes=1, out_axes=1)(angles, pressures)


@jit_arrays
def _small_motion(plant: Plant, position: PyTree, angles: Array, pressures: Array, joint: int) -> Array:
    """Stiffness [N*m/rad] of small motion of one joint, with friction, at constant pressures."""
    mechanism = plant.mechanism
    over = mechanism.routes_over(mechanism.like_joints(tuple(angles), position), joint)
    amplitude = SMALL_MOTION * mechanism.joint_type.scale
    return secant_stiffness(over, joint, angles[joint], tuple(pressures), amplitude)
