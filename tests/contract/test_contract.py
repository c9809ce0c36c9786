"""The contract: all built-in classes keep it, and one class for each check that breaks it is found."""

import ast
import dataclasses
import doctest
import functools
import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from runpy import run_path
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import mckibben
from mckibben import actuator, control, joint, muscle, plant, robot
from mckibben.actuator import FirstOrderValve, Valve
from mckibben.codegen.cuda import CudaFunction
from mckibben.codegen.native import Split, compiler
from mckibben.component.base import Component
from mckibben.component.classes import concrete_subclasses
from mckibben.contract import check_class, check_extension, checks
from mckibben.contract.probes import PERIOD, plant_scope, probes_of
from mckibben.control import Controller, Reference, Signal, Sine
from mckibben.control.base import DiscreteTimeSystem
from mckibben.errors import ParameterError, ScenarioError
from mckibben.joint import PendulumLoad
from mckibben.mechanism import wrapping
from mckibben.muscle import Domain, ForceLaw, MaxwellSlip
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import numeric
from mckibben.plant import Disturbance
from mckibben.rig.document import MountedMuscle
from mckibben.units import Bandwidth, Quantity, SignalValue, bar, deg, mm

for module in pkgutil.walk_packages(mckibben.__path__, "mckibben."):
    absent = ("mckibben.cli", "mckibben.web", "mckibben.__main__")
    if not module.name.startswith(absent):
        importlib.import_module(module.name)
CLASSES = {
    kind.__name__: kind
    for kind in concrete_subclasses(Component)
    if kind.__module__.startswith("mckibben.") and not kind.__name__.startswith("_")
}

BOX, ANGLE, DIAMETER = Domain(-0.03, 0.25, 0.0, 6e5), 25 * deg, 10 * mm
TESTS = Path(__file__).parents[1]
LAWS = run_path(str(TESTS / "muscle" / "test_law_contract.py"))["EXAMPLES"]
ACTUATORS = run_path(str(TESTS / "actuator" / "test_actuator_contract.py"))["EXAMPLES"]
CHOU = muscle.ChouLaw(ANGLE, DIAMETER, BOX)
TONDU = muscle.TonduLopezVariableLaw(ANGLE, DIAMETER, 0.2, 1.2, BOX)
CORRECTION = muscle.ForceCorrection((-20.0, 5.0), (1e-5, 0.0), 0.1, 0.05)
KNEE, LOAD = plant_scope()["joint"], plant_scope()["load"]
SPECIMEN = KNEE.muscle1.specimen
SLIP = MaxwellSlip(12.0, 0.5 * mm, growth=1e-5, tension_growth=0.02, viscous=20.0, elements=4)
BY_RATE = dataclasses.replace(SLIP, viscous_growth=1e-4, rate_growth=0.5, rate_speed=10 * mm)
ROUGH = dataclasses.replace(KNEE.muscle1, friction=SLIP)
TWO_BONES, PULLEY = joint.TwoBonePath(-0.02, 0.30, -0.03, 0.0), joint.Pulley(25 * mm, 0.3)
PID = control.PID(2 * bar, 60 * bar, 0.4 * bar)
LOOPS = control.PositionStiffnessControl(PID, control.PID(8e3, 5e5, 0.0), model=KNEE)
DECOUPLING = control.DecouplingControl(KNEE, LOAD, control.PolePlacement())
REFERENCE = Reference(Sine(0.1, 1.0), 15.0)
SPANNING = robot.PathMuscle(
    "x",
    ROUGH,
    (robot.OverJoint("hip", "lengthens", joint.Pulley(5 * mm, 20 * mm)),),
    (robot.BodyPoint("trunk", robot.Place(0.03, 0.0, 0.1)), robot.BodyPoint("thigh", robot.Place(0.03, 0.0, -0.05))),
)
LEG = robot.read_robot("lei-leg-planar")
ROBOT = dataclasses.replace(LEG, muscles=(*LEG.muscles, SPANNING))
EXAMPLES = [
    *(example() for example in LAWS.values()),
    muscle.SpringLaw(1000.0, 180 * mm),
    *(muscle.adjusted_law(law, strength=1.1) for law in (CHOU, TONDU)),
    *(muscle.adjusted_law(law, correction=CORRECTION) for law in (CHOU, TONDU)),
    muscle.ThresholdLaw(CHOU, 3e4),
    muscle.PiecewiseLaw((1e5, 3e5, 6e5), (200.0, 500.0, 1000.0), (2e3, 1e3, 2e3), BOX),
    CORRECTION,
    SLIP,
    BY_RATE,
    muscle.MaxwellCreep(500.0, 5.0, arms=2),
    muscle.MaxwellCreep(0.0, 5.0, arms=2, pressure_share=0.1, pressure_time_constant=2.0),
    Domain(0.0, 0.2),
    SPECIMEN,
    ROUGH,
    joint.SeriesSpring(20e3, 50.0, 5 * mm),
    KNEE.geometry,
    joint.ScaledArms(KNEE.geometry, 1.02),
    joint.PairedPaths(TWO_BONES, PULLEY),
    PULLEY,
    joint.Cam(25 * mm, 0.3, 1e-3, 2e-3),
    TWO_BONES,
    joint.TabulatedPath((-0.5, -0.2, 0.0, 0.2, 0.4), arms=(0.024, 0.0245, 0.025, 0.026, 0.0265), rest_length=0.3),
    LOAD,
    joint.PendulumLoad(0.3, 250 * mm),
    joint.Slide(0.2, 0.18),
    joint.SlidingMass(2.0, 50.0, 30 * deg),
    joint.GeneralLoad(0.02, 0.5),
    KNEE,
    *ACTUATORS,
    plant.SampledSensors(0.01 * deg, 1e3, 0.5, 3),
    plant.TorquePulses(0.5),
    plant.JointFriction(0.3, elements=3),
    plant.JointPlant(KNEE, LOAD, FirstOrderValve(0.02)),
    control.Constant(0.1),
    control.Step(0.0, 0.1, 1.0),
    control.Ramp(0.0, 0.1, 1.0, 2.0),
    control.RandomSteps(-0.1, 0.1, 0.5, 0.8, 3),
    Sine(0.1, 1.0),
    control.Multisine((0.1, 0.05), (1.0, 2.0), (0.0, 1.0)),
    control.Samples((0.0, 1.0, 3.0), (0.0, 0.1, 0.05)),
    control.Sum((control.Step(0.0, 0.1, 1.0), Sine(0.1, 1.0))),
    REFERENCE,
    PID,
    control.BackpropPID(PID, signal_scale=0.02, error_scale=0.02, output_scale=bar),
    control.PolePlacement(integral=True, damping=2.5),
    control.AngleLimits(-5 * deg, 5 * deg, 1 * deg),
    control.ExtendedStateObserver(damping=2.5),
    LOOPS,
    DECOUPLING,
    control.InverseModelControl(LOOPS, LOAD),
    control.OpenLoopControl(control.Step(2e5, 3e5, 1e-3), 2.5e5, KNEE),
    control.DelayCompensation(KNEE, LOAD, controller=LOOPS, command_delay=2.5e-3),
    control.Dither(controller=LOOPS, amplitude=5e3),
    robot.PressureSchedule(levels=((1e5, 4e5), (2e5,)), switches=((1.25e-3,), ())),
    robot.JointwiseControl((LOOPS, LOOPS)),
    robot.ComputedTorque(control.PolePlacement(30.0), robot=ROBOT, valve=FirstOrderValve(0.02)),
    ROBOT,
    ROBOT.bodies[0],
    ROBOT.bodies[0].centre,
    ROBOT.joints[0],
    ROBOT.muscles[0],
    ROBOT.foot,
    SPANNING,
    SPANNING.over[0],
    SPANNING.through[0],
    wrapping.WrapSphere("thigh", 20 * mm, side=robot.Place(0.05)),
    wrapping.WrapCylinder("thigh", 20 * mm),
    wrapping.TendonPulley(2.0),
    actuator.ValveGroup(("hip*",), FirstOrderValve(0.02)),
    robot.RobotPlant(ROBOT, FirstOrderValve(0.02)),
    MountedMuscle(SPECIMEN, CHOU, friction=SLIP),
]
INSTANCES = {type(one).__name__: one for one in EXAMPLES}


@pytest.mark.parametrize("kind", CLASSES.values(), ids=CLASSES)
@pytest.mark.slow
def test_every_built_in_class_keeps_it(kind, tmp_path):
    samples = tmp_path / "samples.csv"
    samples.write_text("time_s,angle_deg\n0,1\n1,5\n", encoding="utf-8")
    instances = {**INSTANCES, "SamplesFile": control.SamplesFile(samples, "angle")}
    findings = check_class(kind, instances=[instances[kind.__name__]] if kind.__name__ in instances else [])
    failed = [one for one in findings if one.passed is False]
    assert [one for one in failed if (one.kind, one.check) != ("ValvesByMuscle", "file")] == []  # a robot assigns them
    assert {"units"} <= {one.check for one in findings}


EMITTED = {
    name: kind for name, kind in CLASSES.items() if not inspect.isabstract(kind) and kind is not control.SamplesFile
}


def emitted_functions():
    """Functions of the built-in classes and their components that together have all operations, each with samples."""
    seen: set[str] = set()
    for name, kind in EMITTED.items():
        component = INSTANCES.get(name) or checks._built(kind, {})
        probes = probes_of(component)
        if isinstance(component, DiscreteTimeSystem):
            component = component.with_period(PERIOD)
        for probe in probes.functions if probes.emitted else ():
            rows = checks._samples(probes.ranges(probe, component))
            program = jax.make_jaxpr(functools.partial(probe, component))(*rows[0])
            operations = set(re.findall(r" = (\w+)", str(program)))
            if not operations <= seen:
                seen |= operations
                yield probe, component, rows


@pytest.mark.slow
def test_every_operation_of_the_built_in_classes_has_the_same_numbers_in_cuda(cuda_here, nvrtc):
    for probe, component, rows in emitted_functions():
        lanes = tuple(rows.T.copy())
        function = CudaFunction(lambda shared, lane, probe=probe: probe(shared, *lane))
        found = function(numeric(component), lanes)
        # the C that the test above compares with JAX, at the same samples
        alone = [checks._NATIVE((probe, numeric(component), *row)) for row in rows]
        for one, others in zip(jax.tree.leaves(found), zip(*map(jax.tree.leaves, alone), strict=True), strict=True):
            other = np.stack(others, axis=-1)
            scale = np.nanmax(np.abs(other), initial=1e-9, where=np.isfinite(other))
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * scale)
        shared = Split.of(numeric(cast(component, np.float32)))
        given = Split.of(tuple(x.astype(np.float32) for x in lanes), lanes=True)
        with jax.enable_x64(False):  # some probes have numbers of their own
            in_32_bits = function.written(shared, given, single=True)
        for source in (cuda_here.compiler.sources[-1], in_32_bits.source):
            assert nvrtc.compile(source, 90).startswith(b"\x7fELF")


class _Valve(Valve):
    def command_for(self, pressure, rate):
        return jnp.asarray(pressure)


class SecondOrderLag(_Valve):
    """Critically damped from rest: the rate of the pressure is lost between two intervals."""

    bandwidth: Bandwidth = 60.0

    def pressure_after(self, pressure, command, elapsed):
        phase = self.bandwidth * elapsed
        return command + (pressure - command) * (1 + phase) * jnp.exp(-phase)


class WithState(SecondOrderLag):
    def init(self, pressure):
        return jnp.zeros_like(pressure)

    def after(self, pressure, state, command, elapsed):
        return actuator.SecondOrderValve(self.bandwidth, damping=1.0).after(pressure, state, command, elapsed)


class Moving(WithState):
    """It starts with a pressure that rises."""

    def init(self, pressure):
        return jnp.full_like(pressure, 1e5)


class OneSignal(Signal):
    amplitude: SignalValue = 0.1


class Stopped(OneSignal):
    def __call__(self, time):
        return self.amplitude * lax.stop_gradient(jnp.sin(time))


class NotANumber(OneSignal):
    def __call__(self, time):
        return self.amplitude * jnp.log(time - 1.0)


class Branched(OneSignal):
    def __call__(self, time):
        return self.amplitude if time > 1.0 else 0.0 * time


class Summed(OneSignal):
    def __call__(self, time):
        return self.amplitude * jnp.sum(time)


class Raising(OneSignal):
    def __call__(self, time):
        raise KeyError("no such thing")


class Drawn(OneSignal):
    def __call__(self, time):
        return self.amplitude * jnp.sin(time) + np.random.default_rng().normal()


class Called(OneSignal):
    """Random numbers within a compiled program."""

    def __call__(self, time):
        shape = jax.ShapeDtypeStruct(jnp.shape(time), float)
        draw = lambda time: np.random.default_rng().normal(size=np.shape(time))  # noqa: E731
        noise = jax.pure_callback(draw, shape, lax.stop_gradient(time), vmap_method="expand_dims")
        return self.amplitude * jnp.sin(time) + noise


class WithoutUnit(Sine):
    gain: float = 1.0


class NotSI(Sine):
    limit: Annotated[float, Quantity("bar", lower=0, upper=10)] = 1.0


class Unresolved(Sine):
    gain: "Missing" = 1.0  # noqa: F821


class Lost(Sine):
    count: int = eqx.field(static=True, default=3)


class Sorted(Disturbance):
    def torque(self, time):
        return jnp.sort(jnp.stack([1.0 + time, 2.0 - time]), axis=0)[0]


class TorsionSpring(PendulumLoad):
    def gravity_torque(self, angle):
        return super().gravity_torque(angle) - 2.0 * angle


class Square(ForceLaw):
    domain: Domain = BOX

    def force(self, contraction, pressure):
        return 1e-8 * jnp.asarray(pressure) ** 2 * (1 - jnp.asarray(contraction))

    def pressure_for(self, force, contraction):
        return 1e3 * jnp.asarray(force)


class NumericInverse(Square):
    def pressure_for(self, force, contraction):
        return muscle.pressure_for(self, force, contraction)


class Sticking(MaxwellSlip):
    def project(self, state, length, tension, pressure):
        return state


class Unfinished(Controller):
    def init(self, measurement):
        return ()


class Restless(Controller):
    """Its state does not keep its structure."""

    def init(self, measurement):
        return ()

    def step(self, state, setpoint, measurement, period):
        return (*state, setpoint.angle), measurement.pressures

    def telemetry(self, state):
        return {}


@pytest.mark.parametrize(
    ("kind", "instances", "broken"),
    [
        (SecondOrderLag, [], {"composition"}),
        (WithState, [], set()),
        (Moving, [], {"rest"}),
        (Stopped, [], {"derivatives"}),
        (NotANumber, [], {"derivatives"}),
        (Branched, [], {"batch"}),
        (Summed, [], {"batch"}),
        (Raising, [], {"batch"}),
        (Drawn, [], {"determinism"}),
        (Called, [], {"determinism"}),
        (WithoutUnit, [WithoutUnit(0.1, 1.0)], {"units"}),
        (NotSI, [NotSI(0.1, 1.0)], {"units"}),
        (Unresolved, [Unresolved(0.1, 1.0)], {"units", "file"}),
        (Lost, [Lost(0.1, 1.0), Lost(0.1, 1.0, count=4)], {"file"}),
        pytest.param(Sorted, [], {"C"}, marks=pytest.mark.skipif(compiler() is None, reason="there is no C compiler")),
        (TorsionSpring, [TorsionSpring(0.3, 0.25)], {"slope"}),
        (Square, [], {"inverse"}),
        (NumericInverse, [], set()),
        (Sticking, [Sticking(12.0, 0.5 * mm)], {"path"}),
        (Unfinished, [], {"instance"}),
        (Restless, [], {"batch"}),
        (Sine, [], {"instance"}),  # its fields have no default
    ],
    ids=lambda one: one.__name__ if isinstance(one, type) else "",
)
@pytest.mark.slow
def test_the_check_finds_what_breaks_it(kind, instances, broken):
    findings = check_class(kind, instances=instances)
    assert {one.check for one in findings if one.passed is False} == broken
    assert all(one.found for one in findings if one.passed is False)


@pytest.mark.slow
def test_a_finding_names_the_place_and_a_remedy():
    (missing,) = [one for one in check_class(SecondOrderLag) if not one.passed]
    assert "SecondOrderValve" in missing.remedy and "elapsed" in missing.found
    (branched,) = [one for one in check_class(Branched) if not one.passed]
    assert "jnp.where" in branched.remedy and "__call__" in branched.found


@pytest.mark.slow
def test_without_a_compiler_c_is_not_checked(monkeypatch):
    monkeypatch.setattr("mckibben.contract.checks.compiler", lambda: None)
    results = {one.check: one.passed for one in check_class(WithState)}
    assert results.pop("C") is None and set(results.values()) == {True}


GOOD = """
from mckibben.control import Sine
from mckibben.actuator import FirstOrderValve

class Named(FirstOrderValve):
    pass

class Given(Sine):
    pass

class _Private(Sine):
    pass

EXAMPLE = Given(0.1, 2.0)
"""


@pytest.mark.slow
def test_instances_of_the_module_and_given_fields_are_checked(tmp_path):
    (tmp_path / "contract_good.py").write_text(textwrap.dedent(GOOD), encoding="utf-8")
    path = tmp_path / "contract_good.py"
    findings = check_extension(path, {"time_constant": "20 ms"})
    assert {one.kind for one in findings} == {"Named", "Given"}
    assert [one for one in findings if not one.passed] == []
    (missing,) = [one for one in check_extension(path) if not one.passed]
    assert (missing.kind, missing.check) == ("Named", "instance") and "time_constant" in missing.found
    (wrong,) = [one for one in check_extension(path, {"time_constant": "20 mm"}) if not one.passed]
    assert wrong.check == "instance"
    with pytest.raises(ParameterError) as refused:
        check_extension(path, {"lag": "20 ms"})
    assert refused.value.value == "lag"


def test_a_module_without_components_or_with_a_mistake_is_bad_input(tmp_path):
    (tmp_path / "contract_empty.py").write_text("from mckibben.control import Sine\n", encoding="utf-8")
    with pytest.raises(ParameterError):
        check_extension(tmp_path / "contract_empty.py")
    (tmp_path / "contract_broken.py").write_text("1 / 0\n", encoding="utf-8")
    with pytest.raises(ScenarioError):
        check_extension(tmp_path / "contract_broken.py")


HARDWARE = {"MyRig", "MyJoint"}  # without a contract to run
ROOT = Path(__file__).parents[2]


def module_of_the_page() -> str:
    """The classes of docs/extending.md, and the instances that it makes."""
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    nodes = [node for example in doctest.DocTestParser().get_examples(page) for node in ast.parse(example.source).body]
    sources = [ast.unparse(node) for node in nodes if isinstance(node, ast.ClassDef | ast.Import | ast.ImportFrom)]
    instances = ["linear = LinearLaw(a=1e-3, b=-2e-3, k=500.0)", "pulley = PulleyGeometry(25 * mm, 165 * mm)"]
    return "\n".join([*sources, *instances])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "failures", "classes"),
    [
        pytest.param(module_of_the_page(), [("Overshooting", "composition")], 5, id="page"),
        pytest.param((ROOT / "examples" / "components.py").read_text(encoding="utf-8"), [], 17, id="examples"),
    ],
)
def test_the_classes_of_the_documentation_keep_it(text, failures, classes, tmp_path):
    path = tmp_path / "user_defined_classes.py"
    path.write_text(text, encoding="utf-8")
    code = "from mckibben.cli import main; main()"  # in a process of its own: the page is run as a doctest, too
    run = subprocess.run([sys.executable, "-c", code, "check", path, "--json"], capture_output=True, text=True)
    answer = json.loads(run.stdout)
    columns = answer["columns"]
    findings = list(zip(*(columns[name]["values"] for name in ("kind", "check", "result")), strict=True))
    assert [row[:2] for row in findings if row[2] != "passed"] == failures, answer["remarks"]
    defined = {node.name for node in ast.parse(text).body if isinstance(node, ast.ClassDef)} - HARDWARE
    assert {row[0] for row in findings} == defined and len(defined) == classes
