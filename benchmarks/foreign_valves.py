"""Controllers on valves that share no equation with their models, before and after `mckibben calibrate --valves`.

    python benchmarks/foreign_valves.py [--plants 8] [--runs 24] [--duration 60] [--seed 5] [--setup NAME]
        [--bandwidths FEEDBACK OBSERVER PRESSURES]

The plants are those of examples/comparison/valves.yaml, drawn from its conditions, with another regulator: the flow is
that of an isentropic nozzle, which chokes at 0.528, in place of the ellipse of ISO 6358; the command passes a
second-order lag with a damping of 0.6 to 1; the regulator senses the pressure at its outlet, with a dead zone of up to
3 kPa, and a tube with a volume and pressure of its own and turbulent flow leads to the muscle. The joint has dry
friction of 0.02 to 0.1 N*m. The controllers have the gains of examples/valves/ and the model of the data sheet, or that
of the calibration of each plant; `--bandwidths` [rad/s] gives other gains of decoupling. The table has the median angle
RMSE over all runs, in which failed runs (diverged or limit cycles) count as infinite, and the number of these.
"""

import argparse
import dataclasses
import warnings
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from valves import recordings

from mckibben.actuator import AirState, AirValve
from mckibben.calibration import JointPrior, ValveExperiment, calibrate_scenario_valves, scenario_with_valves
from mckibben.muscle.air import ATMOSPHERE, DENSITY, ENERGY
from mckibben.numerics.batching import lanes_of
from mckibben.plant import JointFriction, NoDisturbance, PerfectSensors
from mckibben.scenario import Scenario, with_values
from mckibben.simulation import simulate_many
from mckibben.study.compare import Suite, draw
from mckibben.units import Bandwidth, Pressure, Quantity, cm, deg, kPa

SUITE, GAINS = Path("examples/comparison/valves.yaml"), Path("examples/valves")
SETUPS = {"SMC ITV0050": "itv0050", "regulator of 0.05 L/(s*bar)": "regulator", "Festo VPPE-6": "vppe-6"}
BANDWIDTHS = tuple(f"controller.{name}.bandwidth" for name in ("feedback", "observer", "pressure_observer"))
SUBSTEPS = 40
HEAT_RATIO = 1.4
CHOKED = (2 / (HEAT_RATIO + 1)) ** (HEAT_RATIO / (HEAT_RATIO - 1))
PRIOR = JointPrior(supply=0.2)


class Held(NamedTuple):
    """Filtered command [Pa], its rate [Pa/s], and the pressure at the outlet of the regulator [Pa]."""

    command: Any
    rate: Any
    outlet: Any


class NozzleRegulator(AirValve):
    """Regulator with a nozzle, a second-order lag, and a tube."""

    bandwidth: Bandwidth = eqx.field(kw_only=True)
    damping: Annotated[float, Quantity("1", "1", 0, 10)] = eqx.field(kw_only=True)
    shut: Pressure = eqx.field(kw_only=True)
    tube_conductance: Annotated[float, Quantity("m^3/(s*Pa)", "L/(s*bar)", 0, 10)] = eqx.field(kw_only=True)
    tube_volume: Annotated[float, Quantity("m^3", "cm^3", 0, 100)] = eqx.field(kw_only=True)

    def init(self, pressure):
        held = jnp.asarray(pressure) * 1.0
        return Held(held, jnp.zeros_like(held), held)

    def opening(self, state, command, pressure):
        error = state.command - state.outlet
        return jnp.clip((error - jnp.clip(error, -self.shut, self.shut)) / self.band, -1.0, 1.0)

    def rate(self, state, command, pressure):
        raise NotImplementedError

    def air_rate(self, pressures, air, commands, volumes):
        rates, states, index = [], [], self.polytropic_index
        for pressure, state, command, volume in zip(pressures, air.valves, commands, volumes, strict=True):
            opening = self.opening(state, command, pressure)
            muscle, outlet = pressure + ATMOSPHERE, state.outlet + ATMOSPHERE
            through_valve = jnp.where(
                opening > 0,
                nozzle(self.conductance * opening, self.supply + ATMOSPHERE, outlet),
                nozzle(self.exhaust_conductance * -opening, ATMOSPHERE, outlet),
            )
            through_tube = pipe(self.tube_conductance, outlet, muscle)
            room = volume.effective(index, muscle)
            rates.append(index / room * (ENERGY * through_tube - muscle * volume.rate))
            squared, speed = self.bandwidth**2, 2 * self.damping * self.bandwidth
            states.append(
                Held(
                    state.rate,
                    squared * (command - state.command) - speed * state.rate,
                    index * ENERGY * (through_valve - through_tube) / self.tube_volume,
                )
            )
        return tuple(rates), AirState(tuple(states))


def nozzle(conductance, inlet, outlet):
    """Mass flow [kg/s] between absolute pressures [Pa], C rho0 p1 where it is choked."""
    above, below = jnp.maximum(inlet, outlet), jnp.minimum(inlet, outlet)

    def share(ratio):
        return jnp.sqrt(ratio ** (2 / HEAT_RATIO) - ratio ** ((HEAT_RATIO + 1) / HEAT_RATIO))

    full = conductance * DENSITY * above * share(jnp.clip(below / above, CHOKED, 0.9995)) / share(CHOKED)
    return full * jnp.clip((inlet - outlet) / above / 0.0005, -1.0, 1.0)


def pipe(conductance, inlet, outlet):
    """Turbulent mass flow [kg/s] through a pipe, laminar at small differences."""
    difference = inlet**2 - outlet**2
    return conductance * DENSITY * difference / (difference**2 + (1e-3 * inlet**2) ** 2) ** 0.25


def taken(tree, rows):
    """Rows of a batch; what does not vary is unchanged."""
    _, varying = lanes_of(tree)
    return jax.tree.map(lambda leaf, varies: np.asarray(leaf)[rows] if varies else leaf, tree, varying)


def foreign(plant, count, rng):
    """Plants with the other regulator and friction of the joint."""

    def drawn(low, high):
        return rng.uniform(low, high, count)

    def each(value):
        return np.broadcast_to(np.asarray(value, float), (count,))

    valve = plant.valve
    regulator = NozzleRegulator(
        each(valve.conductance),
        each(valve.supply),
        exhaust_conductance=each(valve.conductance) * drawn(0.7, 1.3),
        band=each(valve.band),
        polytropic_index=each(valve.polytropic_index),
        dead_volume=each(valve.dead_volume) / 2,
        bandwidth=1.6 / each(valve.time_constant),
        damping=drawn(0.6, 1.0),
        shut=drawn(0.0, 3 * kPa),
        tube_conductance=drawn(0.1e-8, 0.2e-8),
        tube_volume=drawn(2 * cm**3, 6 * cm**3),
    )
    return dataclasses.replace(plant, valve=regulator, friction=JointFriction(drawn(0.02, 0.1)))


def errors(suite, plant, scenario, reference):
    """Angle RMSE [deg] of runs, infinite for failed ones."""
    batch = simulate_many(
        plant,
        scenario.control(),
        reference,
        duration=suite.duration,
        control_period=suite.control_period,
        substeps=SUBSTEPS,
        metrics=["angle_rmse"],
    )
    return np.where(batch.usable, batch.metrics["angle_rmse"], np.inf) / deg


def main():
    """Print a table."""
    options = argparse.ArgumentParser()
    options.add_argument("--plants", type=int, default=8)
    options.add_argument("--runs", type=int, default=24)
    options.add_argument("--duration", type=float, default=60.0)
    options.add_argument("--seed", type=int, default=5)
    options.add_argument("--setup", default="")
    options.add_argument("--bandwidths", type=float, nargs=3, metavar=("FEEDBACK", "OBSERVER", "PRESSURES"))
    given = options.parse_args()
    if given.bandwidths and not given.setup:
        options.error("--bandwidths needs --setup")
    whole, count, runs = Suite.read(SUITE), given.plants, given.runs
    print("| setup | controller | median angle RMSE | failed runs | residual over noise |")
    print("|---|---|---|---|---|")
    for setup in [given.setup] if given.setup else SETUPS:
        suite, rng = whole.of_setup(setup), np.random.default_rng(given.seed)
        (group,) = draw(suite, count * runs, given.seed).groups
        plants = foreign(taken(group.plant, np.arange(count) * runs), count, rng)
        nominal = suite.scenario("PID", next(iter(suite.references)))
        parts = ValveExperiment(-10 * deg, 10 * deg, given.duration).scenarios(nominal)
        quiet = dataclasses.replace(plants, sensors=PerfectSensors(), disturbance=NoDisturbance())
        sets = recordings(quiet, parts, np.zeros(count), rng, substeps=SUBSTEPS)
        tuned = {path.stem: Scenario.read(path) for path in sorted(GAINS.glob(f"{SETUPS[setup]}-*.yaml"))}
        if given.bandwidths:
            name = f"{SETUPS[setup]}-decoupling"
            tuned[name] = with_values(tuned[name], dict(zip(BANDWIDTHS, given.bandwidths, strict=True)))
        found, ratios = {}, []
        for i, one in enumerate(sets):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                valves = calibrate_scenario_valves(nominal, one, PRIOR)
            ratios.append(valves.residual / valves.noise)
            plant = taken(plants, np.full(runs, i))
            reference = taken(group.reference, np.arange(i * runs, (i + 1) * runs))
            for name, scenario in tuned.items():
                own = {"valve": valves.valve, "command_delay": valves.delay}
                calibrated = scenario_with_valves(scenario.model_copy(update=own), valves)
                for model, of in (("data sheet", scenario), ("calibrated", calibrated)):
                    found.setdefault(f"{name}, {model}", []).append(errors(suite, plant, of, reference))
        for name, column in found.items():
            every = np.concatenate(column)
            residual, lost = f"{min(ratios):.2f} to {max(ratios):.2f}", np.isinf(every).sum()
            print(f"| {setup} | {name} | {np.median(every):.2f} deg | {lost} of {every.size} | {residual} |")
        print(end="", flush=True)


if __name__ == "__main__":
    main()
