"""Controllers on a knee that is not what they believe: the table of docs/control.md.

    python benchmarks/control.py [--runs 512] [--tune]

Sines of 0.25 to 2 Hz and up to 10 deg with a step of the stiffness, 3 s each; encoder of 0.022 deg, pressure noise of
4 kPa, valves of 10 to 50 ms (20 believed), mass +-50 %, the law of each muscle +-10 %, hysteresis of 0 to 15 N. The
same runs for every controller, none of which was tuned on them. With --tune the gains of the PID are sought again, by
CMA-ES from four starts on 32 other runs; that takes some minutes, the table half of one.
"""

import argparse
import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mckibben import catalog
from mckibben.control import (
    PID,
    Controller,
    DecouplingControl,
    ExtendedStateObserver,
    Measurement,
    PolePlacement,
    PositionStiffnessControl,
    Reference,
    Sine,
    SlidingMode,
    Step,
    VelocityObserver,
)
from mckibben.muscle import MaxwellSlip
from mckibben.plant import FirstOrderValve, JointPlant
from mckibben.simulation import simulate_many
from mckibben.units import bar, deg, kPa, mm, ms

KNEE = eqx.tree_at(lambda j: j.geometry.connector_length, catalog.joint("knee-table-2"), 208 * mm)
LOAD = catalog.load("knee-table-2")
SLIPPING = dataclasses.replace(KNEE.muscle1, friction=MaxwellSlip(1e-6, 0.5 * mm, elements=1))
PLANT = JointPlant(dataclasses.replace(KNEE, muscle1=SLIPPING, muscle2=SLIPPING), LOAD, FirstOrderValve(20 * ms))
WISH = Reference(angle=Sine(0.1, 0.5, 0.0, np.pi / 2), stiffness=Step(13.0, 17.0, 1.5))
LAW = ("a1", "a2", "b1", "b2", "c1", "c2")
TUNED = (1.165e5, 1.223e8, 1.567e5, 3.027e4, 1.129e6)
"""Of the PID, as --tune found them: kp, ki, kd of the angle, kp and ki of the stiffness."""
STARTS = ((2e5, 6e6, 4e4, 8e3, 5e5), (6e5, 2e7, 6e4, 2e3, 2e5), (1e5, 1e8, 1.5e5, 2e3, 1e6), (1e6, 1e7, 1e5, 5e3, 5e5))


class Sensed(Controller):
    """A controller that is told what sensors would tell: the angle in steps, the pressures with noise."""

    inner: Controller
    encoder: float = 0.022 * deg
    noise: float = 4 * kPa
    seed: int = 0

    def sensed(self, measurement, count):
        key = jax.random.fold_in(jax.random.key(self.seed), count)
        noise = jax.random.normal(key, (2,), measurement.angle.dtype) * self.noise
        angle = jnp.round(measurement.angle / self.encoder) * self.encoder
        return Measurement(angle, tuple(p + n for p, n in zip(measurement.pressures, noise, strict=True)))

    def init(self, measurement):
        return self.inner.init(measurement), jnp.asarray(1)

    def step(self, state, setpoint, measurement, period):
        inner, count = state
        inner, commands = self.inner.step(inner, setpoint, self.sensed(measurement, count), period)
        return (inner, count + 1), commands

    def telemetry(self, state):
        return self.inner.telemetry(state[0])


def conditions(runs, seed):
    """What differs from run to run, for `simulate_many`."""
    draw = np.random.default_rng(seed)
    scales = 1 + 0.1 * draw.uniform(-1, 1, (2, runs))
    over = {
        "controller.seed": np.arange(runs) + 1000 * seed,
        "plant.load.mass2": 0.5 * (1 + 0.5 * draw.uniform(-1, 1, runs)),
        "plant.valve.time_constant": draw.uniform(0.01, 0.05, runs),
    }
    width = np.maximum(draw.uniform(0, 15, runs), 1e-6)
    for muscle, scale in zip(("muscle1", "muscle2"), scales, strict=True):
        law = getattr(PLANT.joint, muscle).law
        over |= {f"plant.joint.{muscle}.law.{name}": getattr(law, name) * scale for name in LAW}
        over[f"plant.joint.{muscle}.friction.half_width"] = width
    frequency = np.exp(draw.uniform(np.log(0.25), np.log(2.0), runs))
    over["reference.angle.frequency"] = frequency
    largest = np.minimum(10 * deg, 60 / (2 * np.pi * frequency) ** 2)
    over["reference.angle.amplitude"] = largest * draw.uniform(0.5, 1, runs)
    over["reference.stiffness.before"], over["reference.stiffness.after"] = draw.uniform(13.5, 17.5, (2, runs))
    return over


def pid(gains):
    kp, ki, kd, stiffness_kp, stiffness_ki = gains
    return PositionStiffnessControl(PID(kp, ki, kd), PID(stiffness_kp, stiffness_ki, 0.0), model=KNEE)


def tuned(start, seed, generations=40, population=16, runs=32):
    """The best gains of the PID that CMA-ES finds, and their cost: angle RMSE / 0.1 deg + stiffness RMSE / 0.5."""
    from cmaes import CMA

    train, start = conditions(runs, 99), np.array(start)
    search = CMA(mean=np.zeros(5), sigma=0.6, population_size=population, seed=seed)
    best = np.inf, start
    for _ in range(generations):
        points = [search.ask() for _ in range(population)]
        gains = np.array([start * np.exp(point) for point in points])
        over = {name: np.tile(values, population) for name, values in train.items()}
        controller = Sensed(pid([jnp.asarray(np.repeat(column, runs)) for column in gains.T]))
        batch = simulate_many(
            PLANT, controller, WISH, over=over, duration=2.5, metrics=("angle_rmse", "stiffness_rmse"), substeps=2
        )
        cost = batch.metrics["angle_rmse"] / (0.1 * deg) + batch.metrics["stiffness_rmse"] / 0.5
        cost = np.where(batch.lost | ~np.isfinite(cost), 1e3, cost).reshape(population, runs).mean(axis=1)
        search.tell(list(zip(points, cost, strict=True)))
        if cost.min() < best[0]:
            best = float(cost.min()), gains[cost.argmin()]
    return best


def row(name, controller, over):
    """One line of the table; `moved` is by how much a pressure goes up and down in a second, at the median."""
    batch = simulate_many(
        PLANT,
        Sensed(controller),
        WISH,
        over=over,
        duration=3.0,
        metrics=("angle_rmse", "stiffness_rmse"),
        keep=("pressure1", "pressure2"),
        substeps=2,
    )
    ways = [np.abs(np.diff(batch.table[name].to_numpy(), axis=1)).sum(axis=1) for name in ("pressure1", "pressure2")]
    angle, stiffness = batch.metrics["angle_rmse"] / deg, batch.metrics["stiffness_rmse"]
    cells = (
        name,
        f"{np.nanmedian(angle):.2g} deg",
        f"{np.nanpercentile(angle, 95):.2g} deg",
        f"{np.nanmedian(stiffness):.2f} N*m/rad",
        f"{np.median(sum(ways)) / 2 / 3.0 / bar:.1f} bar/s",
        str(int(batch.lost.sum())),
    )
    print("| " + " | ".join(cells) + " |", flush=True)


def main():
    parser = argparse.ArgumentParser(description="Controllers on a knee that is not what they believe.")
    parser.add_argument("--runs", type=int, default=512, help="of each controller")
    parser.add_argument("--tune", action="store_true", help="seek the gains of the PID again")
    asked = parser.parse_args()
    gains = TUNED
    if asked.tune:
        found = [tuned(start, seed) for seed, start in enumerate(STARTS)]
        for cost, point in found:
            print(f"cost {cost:.4f}: {', '.join(f'{value:.4g}' for value in point)}")
        gains = tuple(min(found, key=lambda pair: pair[0])[1].tolist())

    def decoupling(feedback, observer):
        return DecouplingControl(KNEE, LOAD, feedback, observer, valve_time_constant=20 * ms)

    def poles(bandwidth, observer, *, integral=False):
        return decoupling(PolePlacement(bandwidth, integral=integral), observer)

    sliding = SlidingMode(40.0, 80.0, 1.0, 5 * ms)
    over = conditions(asked.runs, 1)
    print(
        "| | angle RMSE, median | 95th percentile | stiffness RMSE, median | moved | lost |\n|---|---|---|---|---|---|"
    )
    row("PID, tuned", pid(gains), over)
    for bandwidth, observer in ((60.0, 200.0), (80.0, 250.0), (120.0, 300.0)):
        name = f"poles {bandwidth:.0f}, disturbance observer {observer:.0f} rad/s"
        row(name, poles(bandwidth, ExtendedStateObserver(observer)), over)
    row(
        "poles 60 with integral, velocity observer 200 rad/s", poles(60.0, VelocityObserver(200.0), integral=True), over
    )
    row("poles 60, velocity observer 200 rad/s", poles(60.0, VelocityObserver(200.0)), over)
    row("sliding mode, disturbance observer 200 rad/s", decoupling(sliding, ExtendedStateObserver(200.0)), over)
    row("sliding mode, velocity observer 200 rad/s", decoupling(sliding, VelocityObserver(200.0)), over)


if __name__ == "__main__":
    main()
