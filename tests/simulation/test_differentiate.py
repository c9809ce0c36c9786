"""Derivatives of metrics are those of finite differences of whole runs."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve
from mckibben.control import PID, BackpropPID, PositionStiffnessControl, Reference, Samples, Sine, Step
from mckibben.errors import ParameterError
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation import AtRest, differentiate, simulate_many
from mckibben.units import bar, deg

SHORT = {"duration": 0.06, "substeps": 2}
METRICS = ("angle_rmse", "angle_max", "stiffness_rmse", "coupling", "force_max")
REFERENCE = Reference(angle=Sine(5 * deg, 4.0), stiffness=Step(13.0, 15.0, 0.0205))
START = AtRest(1 * deg, 13.5)
NAMES = """
    load.mass2 load.damping load.hanging_angle valve.time_constant joint.geometry.joint_length
    joint.geometry.joint_radius joint.geometry.connector_length joint.muscle1.law.a1 joint.muscle2.law.b2
    joint.muscle2.law.c2 joint.muscle1.law.decay joint.muscle1.specimen.initial_length
    joint.muscle2.specimen.rated_force controller.position.kp controller.position.ki controller.position.kd
    controller.position.filter_time controller.stiffness.kp controller.model.muscle2.law.a2 reference.angle.amplitude
    reference.angle.frequency reference.angle.phase reference.stiffness.before reference.stiffness.after
    reference.stiffness.at initial.angle initial.stiffness
""".split()


def by_differences(plant, controller, reference, names, start, *, relative=3e-5, **options):
    """Derivatives by central differences of the fourth order, all runs in one batch; a row for each entry of a leaf."""
    of = {"plant": plant, "controller": controller, "reference": reference, "initial": start}
    leaves = {name: np.asarray(value_at(of, name), float) for name in names}
    places = [(name, place) for name in names for place in np.ndindex(leaves[name].shape)]
    columns = {name: [leaf] for name, leaf in leaves.items()}
    steps = []
    for name, place in places:
        step = relative * (abs(float(leaves[name][place])) or 1.0)
        steps.append(step)
        for times in (-2, -1, 1, 2):
            for other, leaf in leaves.items():
                moved = leaf.copy()
                if other == name:
                    moved[place] += times * step
                columns[other].append(moved)
    over = {name: np.stack(rows) for name, rows in columns.items()}
    for name, values in over.items():  # by hand: what is varied here must not hang on how names are found
        root, rest = name.split(".", 1) if name.split(".")[0] in of else ("plant", name)
        of[root] = eqx.tree_at(lambda tree, rest=rest: walk(tree, rest), of[root], values)
    batch = simulate_many(of["plant"], of["controller"], of["reference"], initial=of["initial"], **options)
    slopes = {}
    for metric, values in batch.metrics.items():
        low2, low1, high1, high2 = values[1:].reshape(-1, 4).T
        slopes[metric] = (8 * (high1 - low1) - (high2 - low2)) / (12 * np.array(steps))
    return {name: float(values[0]) for name, values in batch.metrics.items()}, places, slopes


def walk(tree, steps: str):
    for step in steps.split("."):
        tree = tree[int(step)] if step.isdigit() else getattr(tree, step)
    return tree


def value_at(of, name: str):
    root, rest = name.split(".", 1) if name.split(".")[0] in of else ("plant", name)
    return walk(of[root], rest)


def assert_slopes(found, differences, of, *, rtol: float, atol: float) -> None:
    """Derivatives agree, relative to themselves and to the metric a change of the parameter by all of itself."""
    values, places, slopes = differences
    for metric in found.values:
        assert float(found.values[metric]) == pytest.approx(values[metric], rel=1e-9, abs=1e-12), metric
        for (name, place), expected in zip(places, slopes[metric], strict=True):
            size = abs(float(np.asarray(value_at(of, name))[place])) or 1.0
            got = found.gradients[metric][name][place]
            assert got == pytest.approx(expected, rel=rtol, abs=atol * max(values[metric], 1e-3) / size), (metric, name)


@pytest.fixture(scope="module")
def parts(knee, load):
    loops = PID(2 * bar, 60 * bar, 0.4 * bar), PID(0.08 * bar, 5 * bar, 0.0)
    law = dataclasses.replace(knee.muscle1.law, a2=knee.muscle1.law.a2 * 1.01)
    model = eqx.tree_at(lambda joint: joint.muscle1.law, knee, law)  # a controller that errs
    return JointPlant(knee, load, FirstOrderValve(0.02)), PositionStiffnessControl(*loops, model=model)


@pytest.mark.slow
def test_they_are_those_of_finite_differences(parts):
    slopes = differentiate(*parts, REFERENCE, NAMES, metrics=METRICS, initial=START, **SHORT)
    found = by_differences(*parts, REFERENCE, NAMES, START, metrics=METRICS, **SHORT)
    of = dict(zip(("plant", "controller", "reference", "initial"), (*parts, REFERENCE, START), strict=True))
    assert_slopes(slopes, found, of, rtol=1e-6, atol=1e-8)


# Learning loops, samples, a state to start from.
KNOTS = np.array([13.0, 13.5, 14.0, 15.0, 15.0])


@pytest.fixture(scope="module")
def others(parts):
    plant, control = parts
    scales = {"signal_scale": 15.0, "error_scale": 1.0, "output_scale": 1 * bar, "gain_ratio": 2.0}
    learning = BackpropPID(control.position, learning_rate=30.0, **(scales | {"error_scale": 1 * deg}))
    control = PositionStiffnessControl(learning, BackpropPID(control.stiffness, **scales), model=control.model)
    times = np.linspace(0.0, 0.05, 5)
    reference = Reference(angle=Samples(times, [0.0, 0.03, 0.05, 0.02, 0.03]), stiffness=Samples(times, KNOTS))
    return plant, control, reference, PlantState(0.0, 0.05, (3.5e5, 3.6e5))


# What is refused


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["controller.position.seed"], "controller.position.seed is an integer"),
        (["controller.position.learning_rat"], "no parameter .*; did you mean 'controller.position.learning_rate'"),
        (["load"], "no parameter 'load'"),
    ],
)
def test_what_has_no_derivative_is_refused(others, names, message):
    *given, start = others
    with pytest.raises(ParameterError, match=message):
        differentiate(*given, names, initial=start, **SHORT)
