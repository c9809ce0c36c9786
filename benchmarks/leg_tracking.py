"""Angle and stiffness of three joints at once through valves with air: PID per joint against models of joint and leg.

    python benchmarks/leg_tracking.py [--setup NAME ...] [--runs 128] [--tune [CONTROLLER ...]]

The catalog's leg with its trunk held: all joints follow sines at once, in half of the runs at constant stiffness, in
the others with a step of the stiffness of each joint, at different times. Each valve has a tube, commands are late,
encoders are quantised, pressures noisy, and the muscles have friction. In each run all of `SCATTER` differs from what
the controllers' models hold. The gains are those of leg_tracking.json, written by `--tune`: differential evolution with
the same population, generations and runs for each controller, in which each joint selects its own gains by its own
cost; one candidate begins in the middle of the ranges, and one of a controller that adds a model to another at the
gains that were found for that. The table is of other runs: medians, with the 90th percentile, and the
median ratio to the PID with compensation of its delay in the same run, with its 95 % interval (bootstrap). Failed runs
count as infinite.
"""

import argparse
import dataclasses
import json
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import mckibben as mk
from mckibben.actuator import Actuator
from mckibben.component.schema import parse_component
from mckibben.control import DelayCompensation, ExtendedStateObserver, PressureObserver, Reference, Sine, Step
from mckibben.leg import CoupledControl, JointwiseControl, LegPlant, LegStart, TimedReference, read_leg
from mckibben.leg.dynamics import joint_equations
from mckibben.leg.simulate import LegProblem
from mckibben.muscle.air import DENSITY
from mckibben.muscle.friction import MaxwellSlip
from mckibben.numerics.batching import named_leaves
from mckibben.plant import SampledSensors
from mckibben.simulation.engine import BatchFunction, compute_chunks
from mckibben.simulation.loop import control_period, initial_loop
from mckibben.simulation.problem import sampling_times, split_runs
from mckibben.units import bar, deg, kPa, ms

GAINS = Path(__file__).with_name("leg_tracking.json")
DURATION, PERIOD, FROM = 3.0, 1 * ms, 0.5  # errors count from that time [s] on
JOINTS = "side swing", "hip", "knee"
LARGEST = 6 * deg, 3 * deg, 8 * deg  # amplitudes of the sines
STIFFNESS = 13.5, 16.0  # N*m/rad
STEP_TIMES = 1.2, 1.6, 2.0  # s, of side, hip and knee
COST = {"angle": 0.2 * deg, "stiffness": 0.5, "air": 0.1e-3}  # rad, N*m/rad, m^3: quantities of a cost of 1


@dataclasses.dataclass(frozen=True)
class Setup:
    """Valves of the muscles, delay of the commands [s], and integration steps per period."""

    valve: str
    command_delay: float
    substeps: int
    fastest: float  # of the sines [rad/s]
    highest: float  # of the sines [Hz]
    scatter: dict[str, tuple[float, float]]  # factors


SETUPS = {
    "SMC ITV0050, 8 ms": Setup(
        "{class: tube, volume: 3 cm^3, conductance: 0.2 L/(s*bar), valve: "
        "{from: smc-itv0050, supply: 8 bar, dead_volume: 1 cm^3, hysteresis: 0.05 bar}}",
        8 * ms,
        4,
        12 * deg,
        1.0,
        {"valve.valve.time_constant": (0.67, 1.5), "valve.valve.band": (0.5, 2.0), "valve.valve.hysteresis": (0.2, 2)},
    ),
    "Festo MPYE-5-M5, 2 ms": Setup(
        "{class: tube, volume: 12 cm^3, conductance: 1 L/(s*bar), valve: "
        "{from: festo-mpye-5-m5, supply: 7 bar, dead_zone: 3 %, dead_volume: 1 cm^3}}",
        2 * ms,
        10,
        60 * deg,
        2.0,
        {"valve.valve.spool_lag": (0.7, 3.0), "valve.valve.dead_zone": (0.33, 2.0)},
    ),
}
SCATTER = {  # factors; of muscles and links each on its own
    "muscles.muscle1.strength": (0.85, 1.05),
    "muscles.muscle2.strength": (0.85, 1.05),
    "muscles.muscle1.friction.half_width": (0.001, 2.0),
    "muscles.muscle2.friction.half_width": (0.001, 2.0),
    "link": (0.7, 1.3),  # mass and inertia
    "valve.valve.conductance": (0.7, 1.3),
    "valve.conductance": (0.7, 1.3),
    "valve.volume": (0.7, 1.3),
    "command_delay": (0.6, 1.0),
    "sensors.encoder": (1.0, 4.0),
}


PID = {  # where the search begins, and the factor to either end of its range
    "position.kp": (1 * bar, 30.0),
    "position.ki": (60 * bar, 30.0),
    "position.kd": (0.2 * bar, 30.0),
    "position.filter_time": (5 * ms, 10.0),
    "position.tracking_time": (50 * ms, 20.0),
    "stiffness.kp": (0.1 * bar, 30.0),
    "stiffness.ki": (4 * bar, 20.0),
}
PREDICTION = {"observer.bandwidth": (80.0, 10.0), "pressure_observer.bandwidth": (100.0, 10.0)}
POLES = {"feedback.bandwidth": (25.0, 6.0)}
REFERENCE = "PID, delay compensated"
NAMES = "PID", REFERENCE, "decoupling per joint", "decoupling of the leg"
SIMPLER = {REFERENCE: ("PID", "controller."), "decoupling of the leg": ("decoupling per joint", "")}
"""Controller whose gains a search begins at, and what stands before their names."""
SEARCH = {"population": 16, "generations": 16, "runs": 8}


def plant_of(setup: Setup) -> LegPlant:
    """The nominal leg, with its trunk held."""
    leg = read_leg("lei-leg")
    trunk = dataclasses.replace(leg.trunk, freedom="fixed")
    joints = []
    for joint in leg.joints:
        muscle = dataclasses.replace(joint.muscles.muscle1, strength=1.0, friction=MaxwellSlip(7.5, 0.5e-3))
        pair = dataclasses.replace(joint.muscles, muscle1=muscle, muscle2=muscle)
        joints.append(dataclasses.replace(joint, muscles=pair))
    held = dataclasses.replace(leg, trunk=trunk, joints=tuple(joints))
    valve = parse_component(Actuator, setup.valve, source="valve")
    sensors = SampledSensors(0.022 * deg, 4 * kPa, seed=1)
    return LegPlant(held, valve, sensors=sensors, command_delay=setup.command_delay)


def pendulums(plant: LegPlant) -> list[mk.GeneralLoad]:
    """Load of each joint while the others rest at 0: what a model of the joint alone can hold."""
    rest = jnp.zeros(3)
    mass = joint_equations(plant.leg, tuple(rest), tuple(rest), plant.gravity).matrix

    def weight(angles):
        return jnp.stack(joint_equations(plant.leg, tuple(angles), tuple(rest), plant.gravity).bias)

    torques, slopes = np.asarray(weight(rest)), np.diag(jax.jacfwd(weight)(rest))
    return [
        mk.GeneralLoad(float(mass[i][i]), float(np.hypot(torques[i], slopes[i])), joint.damping,
                       float(np.arctan2(-torques[i], slopes[i])))
        for i, joint in enumerate(plant.leg.joints)
    ]  # fmt: skip


def controllers(plant: LegPlant) -> dict[str, JointwiseControl]:
    """The controllers by name, each with gains to begin from."""
    reference = TimedReference((Reference(Sine(0.05, 1.0), Step(14.0, 15.0, 1.0)),) * 3)
    given = {name: value for name, (value, _) in PID.items()}
    loops = {
        part: mk.PID(*(given[f"{part}.{gain}"] for gain in ("kp", "ki")), given.get(f"{part}.kd", 0.0), **more)
        for part, more in {
            "position": {"filter_time": 5 * ms, "tracking_time": 50 * ms, "derivative_on_error": True},
            "stiffness": {},
        }.items()
    }
    observers = {"observer": ExtendedStateObserver(80.0, 2.0), "pressure_observer": PressureObserver(100.0)}
    pid, late, alone = [], [], []
    for joint, load in zip(plant.leg.joints, pendulums(plant), strict=True):
        model = joint.muscles
        known = {"valve": plant.valve, "command_delay": plant.command_delay, **observers}
        pid.append(mk.PositionStiffnessControl(**loops, model=model, minimum_tension=5.0))
        late.append(DelayCompensation(model, load, controller=pid[-1], **known))
        alone.append(
            mk.DecouplingControl(model, load, mk.PolePlacement(25.0, damping=2.5), friction_compensation=True, **known)
        )
    each = (
        *(JointwiseControl(tuple(one), reference) for one in (pid, late, alone)),
        CoupledControl(tuple(alone), reference, leg=plant.leg, gravity=plant.gravity),
    )
    return dict(zip(NAMES, each, strict=True))


def gains_of(name: str) -> dict[str, tuple[float, float]]:
    """Gains of a joint by name: where the search begins, and the factor to either end of its range."""
    if name == "PID":
        return PID
    if name == REFERENCE:
        return PREDICTION | {f"controller.{one}": value for one, value in PID.items()}
    return PREDICTION | POLES


def draws(setup: Setup, plant: LegPlant, runs: int, seed: int) -> dict[str, np.ndarray]:
    """Values of all that differs between runs, by the address of the number."""
    rng = np.random.default_rng(seed)
    nominal = named_leaves({"plant": plant})
    found = {}

    def scatter(names, low, high):
        factor = rng.uniform(low, high, runs)
        found.update({name: float(nominal[name]) * factor for name in names})

    for name, limits in (SCATTER | setup.scatter).items():
        if name == "link":
            for link in (1, 2):
                scatter([f"leg.links.{link}.{one}" for one in ("mass", "inertia", "axial_inertia")], *limits)
        elif name.startswith("muscles"):
            for joint in range(3):
                scatter([f"leg.joints.{joint}.{name}"], *limits)
        else:
            scatter([name], *limits)
    before = rng.uniform(*STIFFNESS, (3, runs))
    after = np.where(np.arange(runs) % 2, rng.uniform(*STIFFNESS, (3, runs)), before)
    for joint, largest in enumerate(LARGEST):
        amplitude = rng.uniform(0.3, 1.0, runs) * largest
        frequency = np.minimum(setup.highest, setup.fastest / (2 * np.pi * amplitude)) * rng.uniform(0.3, 1.0, runs)
        at = f"controller.reference.references.{joint}"
        found |= {f"{at}.angle.amplitude": amplitude, f"{at}.angle.frequency": frequency}
        found |= {f"{at}.stiffness.before": before[joint], f"{at}.stiffness.after": after[joint]}
        found[f"{at}.stiffness.at"] = np.full(runs, STEP_TIMES[joint])
    rest = joint_equations(plant.leg, (0.0,) * 3, (0.0,) * 3, plant.gravity).bias
    held = [plant.leg.pressures_for((0.0,) * 3, tuple(map(float, rest)), tuple(map(float, one))) for one in before.T]
    return found | {f"start.pressures.{i}": np.array(one) for i, one in enumerate(zip(*held, strict=True))}


def simulated(setup, plant, controller, over):
    """RMS errors of angle [rad] and stiffness [N*m/rad], and air [m^3], shape (joints, runs); infinite if failed."""
    start = LegStart((0.0,) * 3, (3e5,) * 6, clearance=0.5)
    lanes, shared, count = split_runs(LegProblem(plant, controller, start), over, PERIOD, "simulate_leg")
    given = shared, sampling_times(DURATION, PERIOD), np.asarray(PERIOD), np.asarray(setup.substeps)
    found, _ = compute_chunks(lambda lane: _run("auto", given, lane), lanes, count)
    late = round((DURATION - FROM) / PERIOD)
    angle, stiffness, air = (np.stack(one) for one in found)
    errors = {"angle": np.sqrt(angle / late), "stiffness": np.sqrt(stiffness / late), "air": air / DENSITY}
    failed = ~np.isfinite(sum(errors.values()).sum(0))
    return {name: np.where(failed, np.inf, one) for name, one in errors.items()}


@BatchFunction
def _run(given, lane):
    """Sums of squared errors of each joint from `FROM` on, and the mass of the air [kg] that its muscles take in."""
    shared, times, period, substeps = given
    plant, controller, start = eqx.combine(lane, shared)

    def advance(carry, time):
        loop, sums, mass = carry
        loop, record = control_period(plant, controller, loop, time, period, substeps)
        sample, setpoints = record.state, controller.reference.step((), time, None, period)[1]
        counts, following = jnp.where(time >= FROM, 1.0, 0.0), []
        for i, (joint, setpoint) in enumerate(zip(plant.leg.joints, setpoints, strict=True)):
            pair = slice(2 * i, 2 * i + 2)
            stiffness = joint.muscles.evaluate(sample.angle[i], sample.pressure[pair])[1]
            inflow = [jnp.maximum(new - old, 0.0) for new, old in zip(sample.air_mass[pair], mass[pair], strict=True)]
            squares = (sample.angle[i] - setpoint.angle) ** 2, (stiffness - setpoint.stiffness) ** 2
            following.append([*(counts * one for one in squares), inflow[0] + inflow[1]])
        sums = jax.tree.map(jnp.add, sums, tuple(map(tuple, zip(*following, strict=True))))
        return (loop, sums, sample.air_mass), None

    loop = initial_loop(plant, controller, start)
    zeros = ((jnp.zeros(()),) * 3,) * 3
    return lax.scan(advance, (loop, zeros, plant.observe(loop[0]).air_mass), times)[0][1]


def cost(errors):
    """Cost of each joint and run."""
    return np.minimum(sum(errors[name] / one for name, one in COST.items()), 100.0)


def addressed(gains, runs):
    """Gains of the joints, shape (joints, candidates), by address, each candidate for so many runs."""
    return {
        f"controller.controllers.{joint}.{name}": np.repeat(one, runs)
        for name, values in gains.items()
        for joint, one in enumerate(values)
    }


def simpler_gains(setup_name, name):
    """Gains of the joints by name at which the search of a controller begins as well; none without a simpler one."""
    simpler, before = SIMPLER.get(name, ("", ""))
    return {f"{before}{gain}": values for gain, values in kept().get(setup_name, {}).get(simpler, {}).items()}


def tuned(setup, plant, name, controller, known, *, population, generations, runs, seed=99):
    """Gains of each joint by differential evolution (rand/1/bin); each joint selects by its own cost.

    One candidate has the `known` gains, others in the middle.
    """
    rng, ranges = np.random.default_rng(seed), gains_of(name)
    begin, spread = (np.array([one[i] for one in ranges.values()]) for i in (0, 1))
    over = draws(setup, plant, runs, seed)
    repeated = {address: np.tile(one, population) for address, one in over.items()}

    def costs(points):
        values = begin * spread ** (2 * points - 1)  # shape (joints, candidates, gains)
        gains = addressed(dict(zip(ranges, np.moveaxis(values, -1, 0), strict=True)), runs)
        return cost(simulated(setup, plant, controller, repeated | gains)).reshape(3, population, runs).mean(-1)

    points = rng.uniform(size=(3, population, len(ranges)))
    points[:, 0] = 0.5
    if known:
        points[:, 1] = 0.5
        for i, gain in enumerate(ranges):
            if gain in known:
                points[:, 1, i] += np.log(np.array(known[gain]) / begin[i]) / (2 * np.log(spread[i]))
    best = costs(points)
    for _ in range(generations):
        chosen = np.argsort(rng.uniform(size=(3, population, population)), axis=-1)[..., :3]
        one, two, three = (np.take_along_axis(points, chosen[..., i, None], axis=1) for i in range(3))
        mutant = one + rng.uniform(0.4, 0.9, (3, population, 1)) * (two - three)
        mutant = np.where((mutant < 0) | (mutant > 1), rng.uniform(size=mutant.shape), mutant)
        trial = np.where(rng.uniform(size=mutant.shape) < 0.8, mutant, points)
        found = costs(trial)
        points = np.where((found < best)[..., None], trial, points)
        best = np.minimum(found, best)
    winners = np.take_along_axis(points, best.argmin(1)[:, None, None], axis=1)[:, 0]
    values = begin * spread ** (2 * winners - 1)
    print(f"  {name}: cost {', '.join(f'{one:.2f}' for one in best.min(1))} of {', '.join(JOINTS)}", flush=True)
    return {gain: [float(f"{one:.4g}") for one in values[:, i]] for i, gain in enumerate(ranges)}


def unseen(setup, plant, name, gains, runs, seed=1):
    """Errors and air of a controller with gains, on runs other than those of the search."""
    over = draws(setup, plant, runs, seed) | addressed(gains, runs)
    return simulated(setup, plant, controllers(plant)[name], over)


def table(found, runs, seed=1):
    """Rows of the errors and the air of each controller."""
    rng = np.random.default_rng(seed)
    for quantity, unit, scale in (("angle", "deg", deg), ("stiffness", "N\\*m/rad", 1.0), ("air", "L", 1e-3)):
        for joint, where in enumerate(JOINTS):
            base = found[REFERENCE][quantity][joint]
            cells = []
            for name, errors in found.items():
                values = errors[quantity][joint]
                text = f"{np.median(values) / scale:.3g} ({np.percentile(values, 90, method='higher') / scale:.3g})"
                if name != REFERENCE:
                    with np.errstate(invalid="ignore"):
                        ratio = np.nan_to_num(values / base, nan=1.0)
                    again = np.median(ratio[rng.integers(0, runs, (2000, runs))], axis=1)
                    low, high = np.percentile(again, [2.5, 97.5])
                    text += f", x {np.median(ratio):.2f} ({low:.2f} to {high:.2f})"
                cells.append(text)
            print(f"| {where}: {quantity} [{unit}] |", " | ".join(cells), "|", flush=True)
    failed = [str(int((~np.isfinite(errors["angle"][0])).sum())) for errors in found.values()]
    print("| failed runs |", " | ".join(failed), "|", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--setup", choices=SETUPS, nargs="+", default=list(SETUPS))
    parser.add_argument("--runs", type=int, default=128, help="of the table")
    parser.add_argument("--tune", choices=NAMES, nargs="*", help="tune these, or all in turn, and write the gains")
    given = parser.parse_args()
    for name in given.setup:
        setup = SETUPS[name]
        plant = plant_of(setup)
        made = controllers(plant)
        for one in () if given.tune is None else given.tune or NAMES:
            begin = time.perf_counter()
            gains = tuned(setup, plant, one, made[one], simpler_gains(name, one), **SEARCH)
            keep(name, one, gains)
            print(f"  {time.perf_counter() - begin:.0f} s", flush=True)
        if given.runs:
            print(f"\n| {name} |", " | ".join(NAMES), "|")
            print("|---" * (1 + len(NAMES)), "|", sep="")
            table({one: unseen(setup, plant, one, kept()[name][one], given.runs) for one in NAMES}, given.runs)


def kept():
    """Gains by setup, controller and name, one for each joint."""
    return json.loads(GAINS.read_text()) if GAINS.is_file() else {}


def keep(setup, name, gains):
    """Write the gains of a controller."""
    found = kept()
    found.setdefault(setup, {})[name] = gains
    GAINS.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
