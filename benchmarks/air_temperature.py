"""Air with a temperature: its cost in batches, and what leaving out the temperature of the air in a tube costs.

    python benchmarks/air_temperature.py [--rounds 9] [--lanes 1024]

The cost is the processor time of a batch of the PID episode of `benchmarks/reference.py` (1 s, one core) relative to
the same valve with polytropic air, with 4 substeps and with as many as an accuracy of 1e-6 rad needs: median and
quartiles over rounds in turns. The tube is 2 m long, with 4 mm of inner
diameter: the error of the muscle's pressure is that against a tube whose air has a temperature of its own, by SciPy,
with a heat transfer of 50 to 500 W/(m^2 K), in steps from 1 to 5 bar and back.
"""

import argparse
import itertools
import math
import statistics
import time
from dataclasses import replace

import numpy as np
import ours
from reference import SUBSTEPS, reference_problem
from scipy.integrate import solve_ivp

from mckibben import FlowValve, PressureRegulator
from mckibben.muscle.air import (
    ATMOSPHERE,
    ENERGY,
    FLOATS,
    GAS_CONSTANT,
    HEAT_CAPACITY_RATIO,
    L_PER_S_BAR,
    TEMPERATURE,
    mass_flow,
)
from mckibben.units import bar, cm, mm, ms

WALL = 0.5  # W/K
MUSCLE = 23.8 * cm**3
LENGTH, DIAMETER = 2.0, 4 * mm
VALVE, TUBE = 0.4 * L_PER_S_BAR, 0.3 * L_PER_S_BAR
PERIODS = 1000


def cost(lanes: int, rounds: int) -> None:
    """Print the relative cost of batches."""
    problem = reference_problem().shortened(PERIODS)
    conductance, supply = 0.4 * L_PER_S_BAR, 7 * bar
    valves = {
        "FlowValve": FlowValve(conductance, supply),
        "PressureRegulator": PressureRegulator(conductance, supply, time_constant=20 * ms),
    }
    masses = np.linspace(0.3, 0.7, lanes)
    for (name, valve), substeps in itertools.product(valves.items(), (SUBSTEPS, None)):
        plants = [replace(problem.plant, valve=one) for one in (valve, replace(valve, wall_conductance=WALL))]
        runs = [ours.batch(replace(problem, plant=one), masses, np.float64, substeps=substeps) for one in plants]
        for run in runs:
            run()
        ratios = []
        for _ in range(rounds):
            seconds = []
            for run in runs:
                begin = time.process_time()
                run()
                seconds.append(time.process_time() - begin)
            ratios.append(seconds[1] / seconds[0])
        spread = statistics.quantiles(ratios, n=4)
        steps = "1e-6 rad" if substeps is None else f"{substeps} substeps"
        print(
            f"{name}, {steps}: {statistics.median(ratios):.2f} of polytropic air ({spread[0]:.2f} to {spread[2]:.2f})"
        )


def passed(conductance: float, inlet: float, outlet: float, ahead: float, behind: float) -> tuple[float, float]:
    """Mass flow [kg/s] from air at a temperature [K] to air at another, and its temperature."""
    flow = mass_flow(conductance, 0.3, inlet, outlet, FLOATS)
    upstream = ahead if flow > 0 else behind
    return flow * math.sqrt(TEMPERATURE / upstream), upstream


def pressures(transfer: float, index: float | None, times: np.ndarray) -> np.ndarray:
    """Pressure of a muscle behind a tube [Pa], by SciPy: with a temperature of the tube, or with its index n."""
    volume, surface = math.pi / 4 * DIAMETER**2 * LENGTH, math.pi * DIAMETER * LENGTH

    def chamber(pressure: float, warm: float, room: float, wall: float, flows: list) -> tuple[float, float]:
        """Rates of the pressure [Pa/s] and temperature [K/s]."""
        energy = sum(flow * temperature for flow, temperature in flows) * GAS_CONSTANT
        heat = (HEAT_CAPACITY_RATIO - 1) * wall * (TEMPERATURE - warm)
        rate = (HEAT_CAPACITY_RATIO * energy + heat) / room
        net = sum(flow for flow, _ in flows)
        return rate, warm * (rate / pressure - net * GAS_CONSTANT * warm / (pressure * room))

    def rates(t: float, state: np.ndarray) -> list[float]:
        muscle, warm, tube, lukewarm = state
        lukewarm = lukewarm if index is None else TEMPERATURE
        filling = t % 1.0 < 0.5
        target = (5 if filling else 1) * bar + ATMOSPHERE
        opening = min(max((target - tube) / (0.5 * bar), -1.0), 1.0)
        source = 7 * bar + ATMOSPHERE if opening > 0 else ATMOSPHERE
        valve = passed(VALVE * abs(opening), source, tube, TEMPERATURE, lukewarm)
        through = passed(TUBE, tube, muscle, lukewarm, warm)
        moved = chamber(muscle, warm, MUSCLE, WALL, [through])
        if index is not None:
            return [*moved, index * ENERGY / volume * (valve[0] - through[0]), 0.0]
        return [*moved, *chamber(tube, lukewarm, volume, transfer * surface, [valve, (-through[0], through[1])])]

    first = [1 * bar + ATMOSPHERE, TEMPERATURE, 1 * bar + ATMOSPHERE, TEMPERATURE]
    return solve_ivp(rates, (0, times[-1]), first, "LSODA", times, rtol=1e-8, atol=1e-3, max_step=1e-3).y[0]


def tube() -> None:
    """Print the error of a tube without a temperature of its own."""
    times = np.arange(0.0, 2.0, 1e-3)
    for transfer in (50.0, 500.0):
        true = pressures(transfer, None, times)
        for index in (1.0, 1.2, 1.4):
            error = (pressures(0.0, index, times) - true) / bar
            print(
                f"tube, {transfer:g} W/(m^2 K), n = {index:g} instead: RMS {np.sqrt(np.mean(error**2)):.3f} bar, "
                f"at most {np.abs(error).max():.3f} bar"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--lanes", type=int, default=1024)
    options = parser.parse_args()
    tube()
    cost(options.lanes, options.rounds)
