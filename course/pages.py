"""Explorers of the labs' pages: parts with sliders that run in the browser."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from mckibben import Constant, PressureRegulator, Reference, Sine, Step, catalog
from mckibben.leg import Ground, LegPlant, LegStart, PressureSchedule, read_leg
from mckibben.leg.metrics import MetricSums
from mckibben.muscle import MaxwellSlip, Muscle
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.report.explorers import (
    RUN_CHARTS,
    Axis,
    Chart,
    ComputedRows,
    Curve,
    Explorer,
    Slider,
    explorers,
    rows_explorer,
    run_explorer,
)
from mckibben.scenario import Scenario
from mckibben.simulation.loop import control_period, initial_loop
from mckibben.units import bar, deg, mm, ms

EXAMPLES = Path(__file__).parents[1] / "examples"


def _knee(key: str) -> Explorer:
    return explorers(Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml"), [key])[key]


def _uncertainty() -> Explorer:
    """Fits of Eq. 2 with a known decay to simulated forces; all of them are linear in the sizes of the errors."""
    law = catalog.law("lei-mas-10-180n")
    at, pressure = (np.ravel(each) for each in np.meshgrid(np.linspace(0, 0.12, 8), np.arange(2.0, 7.0)))
    decay, draws = float(law.decay), np.random.default_rng(2)

    def features(contraction: Any, pressure: Any) -> list[Any]:
        shapes = contraction * 0 + 1, contraction, jnp.exp(-decay * contraction)
        return [column for shape in shapes for column in (shape, shape * pressure)]

    matrix = np.column_stack([np.asarray(one) for one in features(at, pressure)])
    solve, free = np.linalg.pinv(matrix), len(at) - 6
    covariance, quantile = solve @ solve.T, stats.t.ppf(0.975, free)
    single = np.eye(len(at))[19]

    def errors() -> np.ndarray:
        """Unit errors of an experiment: independent, common to each pressure, and of one point; shape (points, 3)."""
        common = draws.normal(size=5)[np.unique(pressure, return_inverse=True)[1]]
        return np.column_stack([draws.normal(size=len(at)), common, single])

    def fitted(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Errors of the parameters, (6, 3), and products of the residuals, (3, 3)."""
        residuals = unit - matrix @ solve @ unit
        return solve @ unit, residuals.T @ residuals

    shown = errors()
    parameters_of, products = fitted(shown)
    place = np.array([float(one) for one in features(np.array(0.05), 4.5)])
    others = [(place @ of, products) for of, products in (fitted(errors()) for _ in range(200))]
    estimates, scatters = np.array([one for one, _ in others]), np.array([two.ravel() for _, two in others])
    leverage = float(place @ covariance @ place)

    def sizes(parameters: Any) -> list[Any]:
        return [parameters[name] for name in ("scatter", "common", "outlier")]

    def row(parameters: Any, x: Any) -> dict[str, Any]:
        size, phi = sizes(parameters), features(x, parameters["pressure"] / bar)
        estimate = sum(size[j] * sum(phi[i] * parameters_of[i, j] for i in range(6)) for j in range(3))
        variance = sum(size[i] * size[j] * products[i, j] for i in range(3) for j in range(3)) / free
        spread = sum(phi[i] * phi[j] * covariance[i, j] for i in range(6) for j in range(6))
        half, wide = (quantile * jnp.sqrt(variance * each) for each in (spread, spread + 1))
        ends = {"low": estimate - half, "high": estimate + half, "lowest": estimate - wide, "highest": estimate + wide}
        return {"estimate": estimate, "truth": 0 * x, **ends}

    def points(parameters: Any) -> dict[str, Any]:
        return {"at": jnp.asarray(at), "measured": sum(a * b for a, b in zip(sizes(parameters), shown.T, strict=True))}

    def summary(parameters: Any) -> dict[str, Any]:
        size = sizes(parameters)
        products = [size[i] * size[j] for i in range(3) for j in range(3)]

        def count(so_far: Any, experiment: Any) -> tuple[Any, None]:
            estimate, scatter = experiment
            error = sum(size[j] * estimate[j] for j in range(3))
            variance = sum(one * scatter[j] for j, one in enumerate(products)) / free
            return so_far + jnp.where(jnp.abs(error) <= quantile * jnp.sqrt(variance * leverage), 1.0, 0.0), None

        inside, _ = jax.lax.scan(count, 0.0 * size[0], (jnp.asarray(estimates), jnp.asarray(scatters)))
        at_place = row(parameters, jnp.asarray(0.05))
        return {
            "coverage": 100 * inside / len(estimates),
            "confidence": (at_place["high"] - at_place["low"]) / 2,
            "prediction": (at_place["highest"] - at_place["lowest"]) / 2,
        }

    sliders = [
        Slider("scatter", "scatter of a point", "N", 1.0, 2.0, 0.1, 5.0, 0.1),
        Slider("common", "error common to a pressure", "N", 1.0, 0.0, 0.0, 5.0, 0.1),
        Slider("outlier", "error of one point", "N", 1.0, 0.0, 0.0, 40.0, 1.0),
        Slider("pressure", "pressure of the intervals", "bar", bar, 4.5, 1.0, 8.0, 0.1),
    ]
    chart = Chart(
        "Deviation from the true force over contraction",
        "deviation, N",
        (Curve("estimate", "fit"), Curve("truth", "truth", fixed=True), Curve("measured", dots=True, x="at")),
        low=-8.0,
        high=8.0,
        bands=[("lowest", "highest"), ("low", "high")],
    )
    words = (
        "At 5 % contraction the confidence interval is ± {confidence} N, the prediction interval ± {prediction} N. In "
        "200 experiments with such errors, at 4.5 bar, {coverage} % of the confidence intervals contain the true force."
    )
    text = (
        "A fit to 40 simulated forces, measured at 2, 3, 4, 5 and 6 bar: its deviation from the true law, with the "
        "95 % intervals that assume independent errors (dark: confidence; light: prediction)."
    )
    across = Axis("contraction, %", 0.0, 20.0, factor=100.0)
    table = ComputedRows(row, (0.0, 0.2, 81), across, [chart], [("", words)], summary=summary, points=points)
    return rows_explorer("uncertainty", "Explore the intervals over the errors", text, sliders, table)


def _hysteresis() -> Explorer:
    """A muscle that is moved along a sine at constant pressure."""
    muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    sliders = [
        Slider("half_width", "half width of the loop", "N", 1.0, 9.0, 0.5, 20.0, 0.5),
        Slider("presliding", "presliding length", "mm", mm, 0.6, 0.1, 2.0, 0.05),
        Slider("amplitude", "amplitude of the motion", "mm", mm, 3.0, 0.05, 6.0, 0.05),
        Slider("contraction", "mean contraction", "%", 0.01, 8.0, 3.0, 12.0, 0.5),
        Slider("pressure", "pressure", "bar", bar, 4.0, 2.0, 6.0, 0.1),
    ]
    initial_length = muscle.specimen.initial_length

    def at(parameters: Any, length: Any, friction: MaxwellSlip, state: Any) -> Any:
        tension = muscle.tension(1 - length / initial_length, parameters["pressure"])
        return tension, friction.force(state, length, tension, parameters["pressure"])

    def friction_of(parameters: Any) -> MaxwellSlip:
        return MaxwellSlip(parameters["half_width"], parameters["presliding"])

    def init(parameters: Any) -> Any:
        length = initial_length * (1 - parameters["contraction"])
        return friction_of(parameters).initial(length), length, 0.0 * length, 0.0 * length

    def row(parameters: Any, state: Any, x: Any) -> Any:
        anchors, before, force_before, energy = state
        friction, middle = friction_of(parameters), initial_length * (1 - parameters["contraction"])
        length = middle + parameters["amplitude"] * jnp.sin(2 * jnp.pi * x)
        tension, force = at(parameters, length, friction, anchors)
        energy = jnp.where(x > 1.75, energy + (force + force_before) / 2 * (length - before), 0.0)
        push = 2 * mm * (x + 0.01)
        (low, _), (high, resisting) = (
            at(parameters, middle + move, friction, friction.initial(middle)) for move in (-push, push)
        )
        isobaric = (high - low) / (2 * push)
        columns = {
            "contraction": 1 - length / initial_length,
            "force": jnp.where(x > 1.25, tension + force, jnp.nan),  # the closed loop
            "law": jnp.where(x > 2.25, tension, jnp.nan),
            "push": push,
            "isobaric": isobaric,
            "secant": isobaric + resisting / push,
        }
        following = friction.project(anchors, length, tension, parameters["pressure"])
        return (following, length, force, energy), columns

    def summary(parameters: Any, state: Any) -> dict[str, Any]:
        friction, middle, tiny = friction_of(parameters), initial_length * (1 - parameters["contraction"]), 1e-3 * mm
        (low, _), (high, resisting) = (
            at(parameters, middle + move, friction, friction.initial(middle)) for move in (-tiny, tiny)
        )
        isobaric = (high - low) / (2 * tiny)
        return {
            "energy": 1e3 * state[3],
            "isobaric": isobaric * mm,
            "small": (isobaric + resisting / tiny) * mm,
            "width": 2 * friction.half_width_at((low + high) / 2, parameters["pressure"]),
        }

    charts = (
        Chart(
            "Force over contraction",
            "force, N",
            (Curve("force", "loop"), Curve("law", "law", fixed=True)),
            across=Axis("contraction, %", column="contraction", factor=100.0),
        ),
        Chart(
            "Stiffness to a push from rest",
            "stiffness, N/mm",
            (Curve("secant", "secant"), Curve("isobaric", "isobaric", fixed=True)),
            mm,
            low=0.0,
            across=Axis("push, mm", 0.0, 5.5, "push", 1 / mm),
        ),
    )
    words = (
        "The loop is up to {width} N wide and loses {energy} mJ per cycle. The muscle has {small} N/mm to a tiny push, "
        "and {isobaric} N/mm by its law alone."
    )
    table = ComputedRows(row, (0.0, 2.75, 441), Axis("cycle"), charts, [("", words)], init, summary)
    text = (
        "A muscle moved along a sine at constant pressure, and its stiffness to a push. Dashed: the law without "
        "friction, and, thin, the values at the start."
    )
    return rows_explorer("hysteresis", "Explore the loop over friction and motion", text, sliders, table)


def _model_based() -> Explorer:
    scenario = Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml")
    muscle = dataclasses.replace(scenario.joint.muscle1, strength=1.0)
    stiffness = Step(before=13.0, after=16.0, at=1.5)
    scenario = scenario.replace(
        joint=dataclasses.replace(scenario.joint, muscle1=muscle, muscle2=muscle),
        controller={
            "class": "decoupling",
            "feedback": {"bandwidth": 50.0, "damping": 2.5},
            "observer": {"bandwidth": 150.0},
        },
        reference=Reference(angle=Sine(amplitude=8 * deg, frequency=1.0), stiffness=stiffness),
        start={"stiffness": 13.0},
        duration=3.0,
    )
    sliders = [
        Slider("controller.feedback.bandwidth", "bandwidth of the poles", "rad/s", 1.0, 50.0, 10.0, 100.0, 1.0),
        Slider("controller.observer.bandwidth", "bandwidth of the observer", "rad/s", 1.0, 150.0, 20.0, 400.0, 5.0),
        Slider("joint.muscle.strength", "strength of the muscles", "%", 0.01, 100.0, 80.0, 120.0, 1.0),
        Slider("load.mass2", "second mass of the load", "kg", 1.0, 0.5, 0.1, 1.0, 0.05),
        Slider("valve.time_constant", "time constant of the valves", "ms", ms, 20.0, 5.0, 80.0, 1.0),
    ]
    text = (
        "Decoupling control of the knee on a sine with a stiffness step. The last three change the plant alone; the "
        "model of the controller keeps 100 %, 0.5 kg and 20 ms."
    )
    return run_explorer(scenario, "Explore decoupling control and errors of its model", text, sliders)


def _valves() -> Explorer:
    reference = Reference(angle=Sine(amplitude=5 * deg, frequency=0.5), stiffness=Constant(14.0))
    scenario = Scenario.read(EXAMPLES / "pre-contracted-step-pid.yaml").replace(
        command_delay=5 * ms, reference=reference, start={"stiffness": 14.0}, duration=4.0
    )
    sliders = [
        Slider("command_delay", "delay of the commands", "ms", ms, 5.0, 0.0, 25.0, 0.5),
        Slider("valve.time_constant", "time constant of the valves", "ms", ms, 20.0, 2.0, 60.0, 1.0),
        Slider("controller.position.kp", "proportional gain", "bar/rad", bar, 2.0, 0.0, 8.0, 0.1),
        Slider("controller.position.ki", "integral gain", "bar/(rad·s)", bar, 60.0, 0.0, 200.0, 5.0),
    ]
    text = (
        "The knee of the lab on a sine of 5 deg: raise the delay until it oscillates, then make the valves faster, or "
        "the gains smaller."
    )
    pressures = Chart(
        "Command and pressure over time",
        "muscle 1, bar",
        (Curve("pressure1", "pressure"), Curve("command1", "command", fixed=True)),
        1 / bar,
    )
    return run_explorer(
        scenario, "Explore a loop with slow valves and a delay", text, sliders, [RUN_CHARTS[0], pressures]
    )


def _leg() -> Explorer:
    """A jump of the leg of the lab from a squat, and its landing."""
    valve = PressureRegulator(0.5 * L_PER_S_BAR, 7 * bar, time_constant=5 * ms, dead_volume=3e-6)
    plant = LegPlant(read_leg("lei-leg-planar"), valve, Ground(20e3, 0.5, friction=0.0))
    period, count, weight = 0.5 * ms, 1400, float(plant.leg.total_mass) * plant.gravity
    start = LegStart((0.0, -20 * deg), (1 * bar,) * 4)
    substeps = plant.needed_substeps(start.angles, None, period)
    sliders = [
        Slider("knee2", "knee, muscle that stretches", "bar", bar, 6.0, 1.0, 6.0, 0.1),
        Slider("knee1", "knee, muscle that bends", "bar", bar, 0.0, 0.0, 3.0, 0.1),
        Slider("hip2", "hip, muscle 2 (1: 0 bar)", "bar", bar, 6.0, 0.0, 6.0, 0.1),
        Slider("wait", "wait at 1 bar", "ms", ms, 20.0, 5.0, 250.0, 5.0),
    ]

    def controller(parameters: Any) -> PressureSchedule:
        levels = tuple((1 * bar, parameters.get(name, 0.0)) for name in plant.leg.muscle_names)
        return PressureSchedule(levels, ((parameters["wait"],),) * 4)

    def init(parameters: Any) -> Any:
        loop = initial_loop(plant, controller(parameters), start)
        return loop, MetricSums.of(plant.observe(loop[0]))

    def row(parameters: Any, state: Any, time: Any) -> Any:
        loop, sums = state
        loop, _ = control_period(plant, controller(parameters), loop, time, period, substeps)
        now = plant.observe(loop[0])
        columns = {
            "height": now.mass_height,
            "force": now.ground_up / weight,
            "knee": now.angle[1],
            "stretching": now.pressure[3],
            "bending": now.pressure[2],
        }
        return (loop, sums.after(now, period, plant)), columns

    def summary(parameters: Any, state: Any) -> dict[str, Any]:
        found = state[1].finished(count, period)
        return {
            "rise": found.take_off_speed**2 / (2 * plant.gravity) / mm,
            "landing": found.peak_landing_force / weight,
            "work": found.muscle_work,
            "stops": found.stop_energy,
            "flies": jnp.where(found.take_off_speed > 0.05, 1.0, 0.0),
        }

    charts = (
        Chart("Height of the centre of mass over time", "centre of mass, mm", (Curve("height", "height"),), 1 / mm),
        Chart("Force of the ground over time", "ground, weights", (Curve("force", "force"),), low=0.0),
        Chart(
            "Pressures of the knee over time",
            "knee, bar",
            (Curve("stretching", "stretches"), Curve("bending", "bends")),
            1 / bar,
        ),
    )
    words = (
        "The centre of mass rises by {rise} mm after take-off; the leg lands with {landing} weights. Until take-off "
        "the muscles do {work} J of work, and the stops take {stops} J."
    )
    says = [("flies", words), ("", "The leg stays on the ground.")]
    times = (0.0, (count - 1) * period, count)
    table = ComputedRows(row, times, Axis("time, s", 0.0, 0.7), charts, says, init, summary, every=4)
    text = "The leg squats at 1 bar in all muscles; after a wait, the pressures change. Wait longer: it sinks first."
    return rows_explorer("leg", "Explore a jump over pressures and timing", text, sliders, table)


EXPLORERS = {
    "force_law": lambda: _knee("force"),
    "uncertainty": _uncertainty,
    "hysteresis": _hysteresis,
    "attainable_stiffness": lambda: _knee("attainable"),
    "position_control": lambda: _knee("run"),
    "model_based_control": _model_based,
    "valves_and_delay": _valves,
    "jumping_leg": _leg,
}
"""Explorers by lab, in the order of the course."""
