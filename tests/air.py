"""The air of muscles behind valves, by SciPy, with the equations written anew."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

from mckibben.actuator import FlowValve

ATMOSPHERE, GAS, ROOM, DENSITY, KAPPA = 101325.0, 288.0, 293.15, 1.185, 1.4


def flow(conductance, inlet, outlet, critical=0.3, temperature=ROOM):
    """Mass flow by ISO 6358 [kg/s] between absolute pressures [Pa], from air at a temperature [K] if it returns."""
    if outlet > inlet:
        return -flow(conductance, outlet, inlet, critical) * math.sqrt(ROOM / temperature)
    ratio = outlet / inlet
    share = math.sqrt(1 - max((min(ratio, 0.999) - critical) / (1 - critical), 0.0) ** 2)
    return conductance * DENSITY * inlet * share * min((1 - ratio) / 0.001, 1.0)


def clip(opening):
    return min(max(opening, -1.0), 1.0)


def beyond(error, width):
    return math.copysign(max(abs(error) - (width or 0.0), 0.0), error)


def follow(actuators: Sequence, start, commands, times, volumes, growth=0.0, reservoir=None):
    """Muscles behind valves, or tubes of valves, from the start [Pa] at room temperature.

    Returns pressures of muscles, their temperatures [K], states of valves and pressures of tubes, each of shape
    (muscles, times), and the pressure of the `reservoir` (volume, conductance of its line), of shape (times,).
    """

    def rate(t, y):
        *rows, store = *y[:-1].reshape(4, -1), y[-1]
        changes, drawn = [], 0.0
        for actuator, muscle, temperature, held, tube, command, volume in zip(
            actuators, *rows, commands, volumes, strict=True
        ):
            valve, volume = getattr(actuator, "valve", actuator), volume + growth * t
            has_tube = valve is not actuator
            outlet, outlet_temperature = (tube, ROOM) if has_tube else (muscle, temperature)
            if isinstance(valve, FlowValve):  # of whose dead zone a part is skipped
                zone, skipped = valve.dead_zone, valve.compensation * valve.dead_zone
                opening = beyond(held, zone) / (1 - zone)
                wanted = clip((command + ATMOSPHERE - outlet) / valve.band)
                wanted = (1 - skipped) * wanted + skipped * clip(wanted / (zone - skipped))
                lagging = (wanted - held) / valve.spool_lag
            else:
                opening = clip(beyond(held + ATMOSPHERE - outlet, valve.dead_zone) / valve.band)
                lagging = beyond(command - held, (valve.hysteresis or 0.0) / 2) / valve.time_constant
            conductance = valve.conductance if opening > 0 else valve.exhaust_conductance or valve.conductance
            source = store if opening > 0 else ATMOSPHERE
            inflow = flow(conductance * abs(opening), source, outlet, temperature=outlet_temperature)
            drawn += max(inflow, 0.0)
            through, filling = inflow, 0.0
            if has_tube:
                through = flow(actuator.conductance, tube, muscle, actuator.critical_ratio, temperature)
                filling = valve.polytropic_index * GAS * ROOM * (inflow - through)
                filling /= actuator.volume + valve.dead_volume
            leaked = flow(valve.leak or 0.0, ATMOSPHERE, muscle, temperature=temperature)
            if valve.wall_conductance is None:
                energy = GAS * ROOM * (through + leaked)
                slope, warming = valve.polytropic_index / volume * (energy - muscle * growth), 0.0
            else:
                energy = sum(one * (ROOM if one > 0 else temperature) for one in (through, leaked))
                heat = valve.wall_conductance * (ROOM - temperature)
                slope = (KAPPA * (GAS * energy - muscle * growth) + (KAPPA - 1) * heat) / volume
                lost = (through + leaked) * GAS * temperature / (muscle * volume)
                warming = temperature * (slope / muscle + growth / volume - lost)
            changes.append([slope, warming, lagging, filling])
        line = 0.0
        if reservoir:
            line = 1.2 * GAS * ROOM * (flow(reservoir[1], supply, store) - drawn) / reservoir[0]
        return [*np.ravel(np.transpose(changes)), line]

    supply = actuators[0].supply + ATMOSPHERE
    gauge = np.asarray(start, float)
    states = gauge * [not isinstance(actuator, FlowValve) for actuator in actuators]
    first = [*gauge + ATMOSPHERE, *np.full(len(gauge), ROOM), *states, *gauge + ATMOSPHERE, supply]
    tight = {"method": "LSODA", "rtol": 1e-11, "atol": 1e-9, "max_step": times[-1] / 500}
    found = solve_ivp(rate, (0, times[-1]), first, t_eval=times, **tight).y
    muscles, temperatures, held, tubes = found[:-1].reshape(4, len(gauge), -1)
    return muscles - ATMOSPHERE, temperatures, held, tubes - ATMOSPHERE, found[-1] - ATMOSPHERE
