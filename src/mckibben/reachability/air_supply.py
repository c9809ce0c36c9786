"""Air of a cyclic motion: flow through the valves, valve, tube, reservoir and compressor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben import catalog
from mckibben.actuator import AirValve, FlowValve
from mckibben.catalog import entries
from mckibben.errors import UnreachableError
from mckibben.muscle.air import ATMOSPHERE, DENSITY, ENERGY, L_PER_S_BAR, mass_flow
from mckibben.plant import JointPlant
from mckibben.units import mm


class AirSupply(NamedTuple):
    """Air supply of a joint, in SI; ANR: at 20 degrees C and 1 bar."""

    needed: float  # largest conductance C of filling and venting in the worse muscle [m^3/(s*Pa)]
    valve: AirValve  # smallest proportional valve of the catalog with twice that
    valve_name: str
    tube: float  # least inner diameter, with four times that for the length [m]
    air: float  # of a cycle [m^3 (ANR)]
    reservoir: float  # volume from which a cycle takes 5 % of the absolute pressure [m^3]
    compressor: float  # flow, 1.3 times the mean consumption [m^3/s (ANR)]


def tube_conductance(diameter: float, length: float) -> float:
    r"""Return the sonic conductance [m^3/(s*Pa)] of a tube with an inner diameter and a length [m].

    .. math:: C = \frac{0.029\, d^2}{\sqrt{l / d^{1.25} + 510}}

    P. Beater, Pneumatic Drives, Springer 2007, after Eckersten. The coefficients were not checked against the source; a
    test finds them within 25 % of choked adiabatic flow with friction.

    >>> round(tube_conductance(4 * mm, 1.0) / L_PER_S_BAR, 2)
    1.2
    """
    return 0.029 * diameter**2 / math.sqrt(length / diameter**1.25 + 510.0)


def air_supply(
    plant: JointPlant,
    times: NDArray[np.float64],
    motion: tuple[NDArray[np.float64], ...],
    stiffness: NDArray[np.float64],
    cycle: float,
    supply: float,
    tube_length: float,
) -> AirSupply:
    """Size the air supply for a motion whose last cycle [s] is periodic; isothermal air in the muscles.

    The motion is angle [rad], velocity and acceleration at times [s], with a stiffness [N*m/rad] of the joint.
    Valve and tube have two and four times the needed conductance, of a critical pressure ratio of 0.3; the compressor
    has 30 % more than the mean for leaks and its rests. In a cycle the absolute pressure of the reservoir drops by 5 %.
    Raises `UnreachableError` if no pressures give the motion, or no valve of the catalog is large enough.
    """
    torque = plant.load.required_torque(*motion)
    pressures = plant.joint.pressures_for(motion[0], torque, stiffness)
    contractions = plant.joint.contractions(motion[0], pressures)
    last = times >= times[-1] - cycle * (1 + 1e-9)
    needed = taken = 0.0
    for muscle, pressure, contraction in zip(plant.muscles, pressures, contractions, strict=True):
        absolute = np.asarray(pressure, float) + ATMOSPHERE
        mass = absolute * np.asarray(muscle.specimen.volume(contraction)) / ENERGY
        flow = np.gradient(mass, times)
        fill = np.asarray(mass_flow(1.0, 0.3, supply + ATMOSPHERE, absolute))
        vent = np.asarray(mass_flow(1.0, 0.3, absolute, ATMOSPHERE))
        needed = max(needed, float((flow / fill).max()), float((-flow / np.maximum(vent, 1e-12)).max()))
        taken += float(np.maximum(np.diff(mass[last]), 0.0).sum())
    name, valve = _valve(2 * needed, supply)
    return AirSupply(
        needed,
        valve,
        name,
        _tube(4 * needed, tube_length),
        taken / DENSITY,
        taken * ENERGY / (0.05 * (supply + ATMOSPHERE)),
        1.3 * taken / DENSITY / cycle,
    )


def _valve(needed: float, supply: float) -> tuple[str, AirValve]:
    kinds = {name: entries.find("valves", name)[0]["class"] for name in catalog.names("valves")}
    valves = [(name, catalog.valve(name, supply=supply)) for name, kind in kinds.items() if kind == FlowValve.__name__]
    valves.sort(key=lambda entry: float(entry[1].conductance))
    for name, valve in valves:
        if float(valve.conductance) >= needed:
            return name, valve
    most = float(valves[-1][1].conductance) / L_PER_S_BAR
    message = f"the valves need a conductance of {needed / L_PER_S_BAR:.3g} L/(s*bar), twice that of the motion"
    remedy = f"the largest of the catalog, {valves[-1][0]}, has {most:.3g} L/(s*bar): allow a longer cycle"
    raise UnreachableError(message, value=needed, upper=most * L_PER_S_BAR, remedy=remedy)


def _tube(needed: float, length: float) -> float:
    """Least inner diameter [m], to 0.1 mm, of a tube of a length [m] with a conductance."""
    from scipy.optimize import root_scalar  # 0.2 s

    least = root_scalar(lambda d: tube_conductance(d, length) - needed, bracket=(1 * mm, 100 * mm)).root
    return math.ceil(least / (0.1 * mm)) * 0.1 * mm
