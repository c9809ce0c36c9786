"""The predictive controller's solver against CasADi with fatrop, and what prediction and a known reference bring.

    python benchmarks/preview.py [--periods 1000]

Both solvers get the same problem in each control period of a closed loop: costs, horizon, stages, model, limits and
estimates of `PredictiveControl`. Ours takes one Newton step, in C; fatrop (an interior-point method for optimal
control) iterates to its tolerance, with CasADi's functions compiled. The times are those of a whole step of the
exported controller, and of the call of fatrop alone.
"""

import argparse
import contextlib
import dataclasses
import re
import subprocess
import tempfile
import time
from pathlib import Path
from unittest.mock import patch

import casadi
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import mckibben as mk
from mckibben.codegen.native import own_flags
from mckibben.control import predictive
from mckibben.control.ddp import FirstCommand
from mckibben.export import export
from mckibben.numerics.compiled import numeric
from mckibben.simulation import sampled
from mckibben.units import deg, ms

KNEE = eqx.tree_at(lambda j: j.geometry.connector_length, mk.catalog.joint("knee-table-2"), 0.208)
LOAD = mk.catalog.load("knee-table-2")
SCENARIO = Path(__file__).resolve().parents[1] / "examples" / "pre-contracted-step-pid.yaml"
PERIOD = 1 * ms
REFERENCES = {
    "sine of 10 deg, 1 Hz": mk.Reference(mk.Sine(10 * deg, 1.0, 0.0, np.pi / 2), 15.0),
    "ramp of 20 deg in 0.5 s": mk.Reference(mk.Ramp(-10 * deg, 10 * deg, 0.1, 0.5), 15.0),
    "step of 10 deg": mk.Reference(mk.Step(-5 * deg, 5 * deg, 0.2), 15.0),
    "random steps": mk.Reference(
        mk.RandomSteps(-8 * deg, 8 * deg, 0.3, seed=2), mk.RandomSteps(13.0, 17.0, 0.4, seed=1)
    ),
}


def controllers(lag, known):
    """Decoupling and predictive control of 80 rad/s, with a model of the valves."""
    valve = mk.FirstOrderValve(lag)
    return (
        mk.DecouplingControl(KNEE, LOAD, mk.PolePlacement(80.0), valve=valve, preview=0.1 if known else None),
        mk.PredictiveControl(KNEE, LOAD, valve=valve, preview=known),
    )


def errors(answer):
    """RMS errors of angle [deg] and stiffness [N*m/rad]."""
    angle, stiffness = (
        np.sqrt(np.mean((np.asarray(answer[name]) - np.asarray(answer[f"desired_{name}"])) ** 2))
        for name in ("angle", "stiffness")
    )
    return float(angle) / deg, float(stiffness)


def known_references(lags=(20 * ms,), duration=1.5, names=tuple(REFERENCES)):
    """RMS errors with the reference extrapolated and known ahead, by reference and valves."""
    print("| reference, valves | decoupling | known ahead | predictive | known ahead |\n|---|---|---|---|---|")
    for lag in lags:
        plant = mk.JointPlant(KNEE, LOAD, mk.FirstOrderValve(lag))
        for name in names:
            reference = REFERENCES[name]
            pairs = zip(controllers(lag, False), controllers(lag, True), strict=True)
            runs = [
                mk.simulate(plant, one, reference, duration=duration, warn_infeasible=False) for p in pairs for one in p
            ]
            cells = [f"{angle:.2g} deg, {stiffness:.2g} N\\*m/rad" for angle, stiffness in map(errors, runs)]
            print(f"| {name}, {lag / ms:.0f} ms | " + " | ".join(cells) + " |", flush=True)


def optimal_control(stages, leaves):
    """The problem of `mckibben.control.ddp` as an NLP with the structure that fatrop detects, and its solver."""
    symbols = [casadi.SX.sym(f"p{i}", *(np.shape(leaf) or (1,))) for i, leaf in enumerate(leaves[0])]
    problem = jax.tree.unflatten(leaves[1], symbols)
    h, (mu1, mu2), d, rho = problem.stage, problem.hold_weights, problem.damping, problem.bandwidth_ratio_sq

    def value(quadratic, at):
        return quadratic.value + at * (quadratic.slope + at * quadratic.curvature / 2)

    first, variables, constraints, equality, cost = casadi.SX.sym("first", 6), [], [], [], 0
    x = casadi.SX.sym("x0", 6)  # errors, and the pressures before
    start = x - first
    for k in range(stages):
        u = casadi.SX.sym(f"u{k}", 2)
        r, after = ([signal[i] for signal in problem.reference] for i in (k, k + 1))
        change = after[2] - r[2]
        turned, speed = r[0] + x[0] + h * (r[1] + x[1]), r[1] + x[1] + h * (r[2] + x[2] + mu1 * change)
        end = turned + h**2 / 2 * (r[2] + x[2] + mu2 * change)
        lower, upper = [], []
        for i in range(2):
            reach = problem.attainable[i]
            slowest, fastest = reach.keep * x[4 + i] + reach.lower, reach.keep * x[4 + i] + reach.upper
            highest = casadi.fmax(casadi.fmin(value(problem.pressure_upper[i], end), fastest), slowest)
            lowest = casadi.fmin(casadi.fmax(value(problem.pressure_lower[i], end), slowest), highest)
            lower.append(u[i] - lowest)
            upper.append(highest - u[i])
        acceleration, stiffness = (
            value(row[0], end) + value(row[1], end) * u[0] + value(row[2], end) * u[1]
            for row in (problem.acceleration, problem.stiffness)
        )
        acceleration -= problem.drag * speed
        mine = x[2] + r[2]
        y = (
            turned + h**2 / 2 * (mine + mu2 * (acceleration - mine)) - after[0],
            r[1] + x[1] + h * (mine + mu1 * (acceleration - mine)) - after[1],
            acceleration - after[2],
            stiffness - problem.setpoints[k + 1],
        )
        rates = (y[2] - x[2]) / h, (stiffness - x[3] - problem.setpoints[k]) / h
        squares = y[0] ** 2 + d * (d - 2) * (y[1] ** 2 + y[2] ** 2) + y[3] ** 2
        cost += h / 2 * (squares + rates[0] ** 2 + rho * rates[1] ** 2)
        expected = casadi.vertcat(*y, u)
        variables += [x, u]
        following = casadi.SX.sym(f"x{k + 1}", 6)
        constraints += [following - expected, *([start] if k == 0 else []), *lower, *upper]
        equality += [True] * 6 + [True] * (6 if k == 0 else 0) + [False] * 4
        x = following
    e = x[0], x[1], x[2]
    weights = ((d, d, 1), (d, d**2 - 1, d), (1, d, d))
    cost += sum(weights[i][j] * e[i] * e[j] for i in range(3) for j in range(3)) / 2 + casadi.sqrt(rho) * x[3] ** 2 / 2
    variables.append(x)
    parameters = casadi.vertcat(first, *(casadi.reshape(symbol, -1, 1) for symbol in symbols))
    nlp = {"x": casadi.vertcat(*variables), "f": cost, "g": casadi.vertcat(*constraints), "p": parameters}
    options = {"structure_detection": "auto", "equality": equality, "print_time": False, "expand": True}
    options |= {"fatrop": {"print_level": 0, "mu_init": 1e-3, "tol": 1e-8}, "jit": True, "compiler": "shell"}
    options["jit_options"] = {"flags": ["-O3", "-march=native", *own_flags()], "verbose": False}
    solver = casadi.nlpsol("solver", "fatrop", nlp, options)
    bounds = np.zeros(len(equality)), np.where(equality, 0.0, np.inf)
    return solver, *bounds


def fatrop_loop(plant, control, reference, periods):
    """RMS errors of a closed loop whose problems fatrop solves, times of its calls [s], and failures."""
    plant, control = numeric((plant.with_period(PERIOD), control.with_period(PERIOD)))
    _, setpoints = sampled(reference, periods * PERIOD, PERIOD)
    free = (jnp.asarray(False),) * 2
    captured = {}

    def remember(problem, errors, pressures, policy, iterations):
        captured.update(problem=problem, first=(*errors, *pressures))
        return policy, FirstCommand(pressures, free)

    @jax.jit
    def posed(state, setpoint, measurement):
        with patch.object(predictive, "solve", remember):
            control.step(state, setpoint, measurement, PERIOD)
        return captured["problem"], captured["first"]

    @jax.jit
    def applied(plant_state, state, setpoint, measurement, pressures):
        with patch.object(predictive, "solve", lambda *arguments: (arguments[3], FirstCommand(pressures, free))):
            state, commands = control.step(state, setpoint, measurement, PERIOD)
        after = plant.follow(plant_state, plant.clip_commands(commands), PERIOD, 2)
        return (*plant.sample(after, PERIOD), state, plant.joint.stiffness(after.angle, after.pressures))

    now, measurement = plant.sample(plant.begin(plant.complete_state(start_of(plant, reference))), PERIOD)
    known = jax.tree.map(jnp.asarray, setpoints)
    state, given = control.foreseeing(control.init(measurement), known, PERIOD), control.ahead(known, PERIOD)
    solver, spent, failed, signals = None, [], 0, []
    for k in range(periods):
        setpoint = jax.tree.map(lambda signal, k=k: signal[k], given)
        problem, first = posed(state, setpoint, measurement)
        leaves = jax.tree.flatten(problem)
        if solver is None:
            solver, low, high = optimal_control(control.stages, leaves)
            guess = np.tile([*first, *first[4:]], control.stages + 1)[:-2]
        values = np.concatenate([np.ravel(leaf) for leaf in (first, *leaves[0])])
        begun = time.thread_time()
        solution = solver(x0=guess, p=values, lbg=low, ubg=high)
        spent.append(time.thread_time() - begun)
        failed += not solver.stats()["success"]
        guess = np.asarray(solution["x"]).ravel()
        now, measurement, state, stiffness = applied(now, state, setpoint, measurement, tuple(guess[6:8]))
        signals.append((float(now.angle), float(stiffness)))
    angle, stiffness = np.transpose(signals)[:, :-1]
    wanted = {f"desired_{name}": values[1:] for name, values in setpoints._asdict().items()}
    return errors({"angle": angle, "stiffness": stiffness, **wanted}), spent, failed


def start_of(plant, reference):
    """The joint at rest at the beginning of a reference."""
    return numeric(plant).equilibrium(float(reference(0.0).angle), stiffness=float(reference(0.0).stiffness))


def step_time(known):
    """Time of a step of the exported controller [s], the shortest of five replays."""
    section = f"{{class: predictive, preview: {str(known).lower()}}}"
    text = SCENARIO.read_text(encoding="utf-8")
    edited = re.sub(r"controller:.*?(?=reference:)", f"controller: {section}\n", text, flags=re.S)
    scenario = mk.Scenario.parse(edited, folder=SCENARIO.parent)
    with tempfile.TemporaryDirectory() as folder:
        export(scenario, "c", folder)
        build = "cc", "-O3", "-march=native", "-std=c99", "replay.c", "controller.c", "-lm", "-o", "replay"
        subprocess.run(build, cwd=folder, check=True)
        runs = [
            subprocess.run(("./replay", "replay.csv"), cwd=folder, capture_output=True, text=True) for _ in range(5)
        ]
    return min(float(re.search(r"(\d+) ns per step", run.stdout)[1]) for run in runs) * 1e-9


def against_fatrop(periods=1000, names=tuple(REFERENCES)[:3]):
    """Errors in closed loop and times, by reference: one Newton step, ten, and fatrop to its tolerance."""
    print("| reference | one step per period, ours | ten steps | fatrop | time of fatrop, median (99 %) | not solved |")
    print("|---|---|---|---|---|---|")
    plant = mk.JointPlant(KNEE, LOAD, mk.FirstOrderValve(20 * ms))
    for name in names:
        for known in (False, True):
            control, reference = controllers(20 * ms, known)[1], REFERENCES[name]
            cells, options = [], {"duration": periods * PERIOD, "warn_infeasible": False}
            for iterations in (1, 10):
                once = dataclasses.replace(control, iterations=iterations)
                run = mk.simulate(plant, once, reference, initial=start_of(plant, reference), **options)
                cells.append("{:.4g} deg, {:.2g}".format(*errors(run)))
            found, spent, failed = fatrop_loop(plant, control, reference, periods)
            median, late = np.percentile(spent, [50, 99]) * 1e6
            cells += ["{:.4g} deg, {:.2g}".format(*found), f"{median:.0f} us ({late:.0f} us)", str(failed)]
            print(f"| {name}{', known' if known else ''} | " + " | ".join(cells) + " |", flush=True)


def looking_ahead(steps=((20, 100), (40, 100), (40, 20))):
    """How far beyond the reference a joint goes after a step of an angle [deg], with valves of a lag [ms]."""
    print("| | inverse | predictive | and 120 ms ahead |\n|---|---|---|---|")
    for step, lag in steps:
        plant = mk.JointPlant(KNEE, LOAD, mk.FirstOrderValve(lag * ms))
        believed = {"valve": mk.FirstOrderValve(lag * ms)}
        parts = KNEE, LOAD, mk.ExtendedStateObserver(250.0)
        controllers = (
            mk.DecouplingControl(KNEE, LOAD, mk.PolePlacement(80.0), mk.ExtendedStateObserver(250.0), **believed),
            mk.PredictiveControl(*parts, bandwidth=80.0, **believed),
            mk.PredictiveControl(*parts, bandwidth=80.0, horizon=120 * ms, **believed),
        )
        half = step / 2 * deg
        reference = mk.Reference(angle=mk.Step(-half, half, 0.5), stiffness=16.5)
        cells = []
        for control in controllers:
            angle = mk.simulate(plant, control, reference, duration=1.5).columns["angle"]
            cells.append(f"{(angle[500:].max() - half) / deg:.2g} deg")
        print(f"| step of {step} deg, valves of {lag} ms: overshoot | " + " | ".join(cells) + " |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--periods", type=int, default=1000)
    periods = parser.parse_args().periods
    looking_ahead()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):  # CasADi compiles in the working folder
        against_fatrop(periods)
    for known in (False, True):
        print(f"a step of the exported controller, known={known}: {step_time(known) * 1e6:.2f} us")
    known_references()


if __name__ == "__main__":
    main()
