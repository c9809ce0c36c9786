"""Models made from runtime classes; classes of one's own in configuration files."""

import json
import textwrap
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from typer.testing import CliRunner

import mckibben as mk
from mckibben.actuator import Actuator, FirstOrderValve
from mckibben.cli import app
from mckibben.component import schema
from mckibben.component.classes import class_name, classes_of, default_class, find_class
from mckibben.component.extensions import load_extension
from mckibben.control import Controller, PositionStiffnessControl
from mckibben.errors import ScenarioError
from mckibben.joint import Geometry, MusclePath, ScaledArms, Tendon
from mckibben.muscle import Creep, ForceLaw, Friction, MartensBoblanLaw, NoFriction
from mckibben.plant import Disturbance, SampledSensors, Sensors, TorquePulses
from mckibben.scenario import Scenario, find_parameter, with_values
from mckibben.units import PositiveTime, Pressure, deg

BASE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
VALVE = "valve: {time_constant: 20 ms}"


class SlowValve(FirstOrderValve):
    """A lag with a dead time that is not simulated."""

    dead_time: PositiveTime = 0.01
    reverse: bool = eqx.field(static=True, default=False)


class OwnDecoupling(mk.DecouplingControl):
    """A user-defined controller that adds nothing."""


class Constantly(Controller):
    """Always the same pressure."""

    pressure: Pressure

    def init(self, measurement):
        return ()

    def step(self, state, reference, measurement, period):
        return (), (jnp.asarray(self.pressure), jnp.asarray(self.pressure))

    def telemetry(self, state):
        return {"stiffness_estimate": jnp.asarray(0.0)}


def test_keys_ranges_and_defaults_follow_from_the_class():
    model = schema.section_of(SampledSensors)
    keys = {"class_", "from_", "encoder", "pressure_noise", "delay", "seed", "encoder_offset"}
    assert set(model.model_fields) == keys
    part = model.model_validate({"encoder": "0.5 deg", "seed": "3"})
    assert {name: getattr(part, name) for name in part.model_fields_set} == {"encoder": 0.5 * deg, "seed": 3}
    with pytest.raises(ValueError, match="out of range"):
        model.model_validate({"encoder": "11 deg"})
    with pytest.raises(ValueError, match="time_constant"):
        schema.section_of(FirstOrderValve).model_validate({})


KNEE = mk.catalog.joint("knee-table-2")
MODEL = {"model": KNEE, "load": mk.catalog.load("knee-table-2"), "valve": mk.FirstOrderValve(0.03)}
LOOPS = PositionStiffnessControl(mk.PID(2e5, 60e5, 4e4), mk.PID(8e3, 5e5, 0.0), model=KNEE)
COMPONENTS = {
    "laws": (ForceLaw, mk.ExponentialLaw(-245.8, 1.09e-3, 321.6, -3.442e-3, 255.6, -1.318e-4, decay=30.0)),
    "a law whose fields have no unit of their own": (ForceLaw, MartensBoblanLaw(50.0, 1e4, 25 * deg, 0.01)),
    "muscles": (mk.Muscle, mk.Muscle(mk.Specimen("x", 0.3), mk.catalog.law("lei-mas-10-180n"), strength=0.9)),
    "friction": (Friction, mk.MaxwellSlip(7.5, 5e-4, viscous=20.0)),
    "no friction": (Friction, NoFriction()),
    "creep": (Creep, mk.MaxwellCreep(500.0, 8.0)),
    "tendons": (Tendon, mk.SeriesSpring(20e3, 50.0, 0.018)),
    "geometries": (Geometry, ScaledArms(mk.KneeGeometry(0.37, 0.03, 0.208), 1.02)),
    "paths": (Geometry, mk.PairedPaths(mk.TwoBonePath(-0.03, 0.16, -0.035, 0.0), mk.Pulley(0.03, 0.16))),
    "tables": (MusclePath, mk.TabulatedPath((-0.2, 0.0, 0.2, 0.4), lengths=(0.154, 0.16, 0.166, 0.172))),
    "loads": (mk.Load, mk.PendulumLoad(0.3, 0.25)),
    "general loads": (mk.Load, mk.GeneralLoad(0.02, 0.7)),
    "valves": (Actuator, mk.FirstOrderValve(0.02, supply=6e5)),
    "valves with air": (Actuator, mk.FlowValve(1e-8, 7e5, direct=True)),
    "sensors": (Sensors, SampledSensors(0.5 * deg, seed=3)),
    "disturbances": (Disturbance, TorquePulses(0.5)),
    "loops": (PositionStiffnessControl, LOOPS),
    "decoupling": (Controller, mk.DecouplingControl(**MODEL, feedback=mk.SlidingMode(30.0, 50.0))),
    "predictive": (Controller, mk.PredictiveControl(**MODEL, bandwidth=70.0)),
    "wrappers": (Controller, mk.DelayCompensation(**MODEL, controller=LOOPS, command_delay=5e-3)),
    "references": (mk.Reference, mk.Reference(mk.Sine(0.1, 0.5), mk.Samples([0.0, 1.0], [13.0, 14.0]))),
}


@pytest.mark.parametrize("name", COMPONENTS)
def test_any_component_is_written_and_read_back(name):
    base, component = COMPONENTS[name]
    again = schema.parse_component(base, schema.write_text(component, base=base), source="test")
    assert type(again) is type(component) and again == component
    assert schema.write(again, schema.ComponentField(base)) == schema.write(component, schema.ComponentField(base))


@pytest.mark.parametrize("base", sorted({base for base, _ in COMPONENTS.values()}, key=lambda one: one.__name__))
def test_all_classes_of_a_base_have_names_of_their_own(base):
    ours = [kind for kind in classes_of(base).values() if kind.__module__.startswith("mckibben.")]
    assert ours and all(find_class(base, kind.__name__) is kind is find_class(base, class_name(kind)) for kind in ours)
    default = default_class(base)
    assert default is None or default in ours


def test_a_users_controller_gets_the_model_of_the_plant_as_ours_does():
    start, end = BASE.index("controller:"), BASE.index("reference:")
    own = "controller: {class: OwnDecoupling, feedback: {bandwidth: 50 rad/s}}\n"
    text = changed(VALVE, "valve: {time_constant: 80 ms}")
    scenario = Scenario.parse(text[:start] + own + text[text.index("reference:") :])
    control = scenario.control()
    assert type(control) is OwnDecoupling and control.valve.time_constant == 0.08
    assert control.load == scenario.load and control.model == scenario.joint and control.model is not scenario.joint
    assert schema.inherited_fields(scenario.controller) == {"model", "load", "valve", "command_delay"}
    slower = with_values(scenario, {"valve.time_constant": 0.1})
    assert slower.control().valve.time_constant == 0.1
    assert with_values(scenario, {"valve.time_constant": 0.1}, model_follows=()).control().valve.time_constant == 0.08
    assert with_values(scenario, {"command_delay": 4e-3}).control().command_delay == 4e-3
    assert with_values(scenario, {"command_delay": 4e-3}, model_follows=()).control().command_delay is None
    assert end > start


def test_what_is_read_by_name_knows_its_origin_until_it_is_changed():
    scenario = Scenario.parse(BASE)
    assert schema.origin_of(scenario.load) == "knee-table-2"
    heavier = with_values(scenario, {"load.mass2": 0.8})
    assert schema.origin_of(heavier.load) == "" and "mass2: 0.8 kg" in heavier.dumps()
    leaves = jax.tree.structure(scenario.load), jax.tree.structure(mk.catalog.load("knee-table-2"))
    assert leaves[0] == leaves[1], "its origin is no part of the tree"


def changed(old, new):
    assert old in BASE
    return BASE.replace(old, new)


def test_a_valve_of_ones_own():
    text = changed(VALVE, "valve: {class: SlowValve, time_constant: 30 ms, reverse: true}")
    scenario = Scenario.parse(text)
    assert scenario.plant().valve == SlowValve(0.03, 0.01, reverse=True)
    assert Scenario.parse(scenario.dumps()) == scenario
    assert find_parameter(scenario, "valve.dead_time").nominal == 0.01
    assert with_values(scenario, {"valve.dead_time": 0.02}).plant().valve.dead_time == 0.02


def test_a_controller_of_ones_own_runs():
    start, end = BASE.index("controller:"), BASE.index("reference:")
    text = BASE[:start] + "controller: {class: Constantly, pressure: 2 bar}\n" + BASE[end:]
    scenario = Scenario.parse(text)
    assert Scenario.parse(scenario.dumps()) == scenario
    command = scenario.control().step((), None, None, 0.001)[1]
    assert [float(one) for one in command] == [2e5, 2e5]
    assert find_parameter(scenario, "controller.pressure").nominal == 2e5


@pytest.mark.parametrize(
    ("valve", "field", "words"),
    [
        ("{class: SlwValve, time_constant: 20 ms}", "valve", "did you mean 'SlowValve'"),
        ("{class: [SlowValve], time_constant: 20 ms}", "valve", "there is no class"),
        ("{class: SlowValve, time_constant: 20 mm}", "valve.time_constant", "such as ms"),
        ("{class: SlowValve}", "valve.time_constant", "is missing"),
        ("{class: SlowValve, time_constant: 20 ms, dead_tme: 1 ms}", "valve.dead_tme", "did you mean 'dead_time'"),
        ("{class: SampledSensors}", "valve", "there is no class 'SampledSensors' of Actuator"),
        ("{class: os.system}", "valve", "--extension"),
    ],
)
def test_a_mistake_in_a_part_of_ones_own_is_told_with_its_line(valve, field, words):
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(changed(VALVE, f"valve: {valve}"))
    (problem,) = caught.value.problems
    assert (problem.field, problem.line) == (field, BASE[: BASE.index(VALVE)].count("\n") + 1)
    assert words in str(problem)


def test_an_extension_is_a_file(tmp_path):
    path = tmp_path / "lag.py"
    path.write_text(
        textwrap.dedent("""
            from mckibben.actuator import FirstOrderValve
            from mckibben.units import Bandwidth

            class LoadedValve(FirstOrderValve):
                bandwidth: Bandwidth = 3.0
        """)
    )
    load_extension(path)
    text = changed(VALVE, "valve: {class: LoadedValve, time_constant: 30 ms}")
    assert Scenario.parse(text).plant().valve.bandwidth == 3.0
    path.write_text("1 / 0")
    with pytest.raises(ScenarioError, match="division by zero"):
        load_extension(path)
    with pytest.raises(ScenarioError):
        load_extension(tmp_path / "missing.py")
    with pytest.raises(ScenarioError, match=r"\.py"):
        load_extension(tmp_path / "lag.txt")


@pytest.mark.slow
def test_the_command_line_runs_an_extension_before_it_reads_a_file(tmp_path):
    (tmp_path / "late.py").write_text(
        "from mckibben.actuator import FirstOrderValve\n\nclass LateValve(FirstOrderValve):\n    pass\n"
    )
    text = changed(VALVE, "valve: {class: LateValve, time_constant: 30 ms}").replace(
        "duration: 10 s", "duration: 50 ms"
    )
    (tmp_path / "s.yaml").write_text(text.replace("at: 5 s", "at: 20 ms"))
    command = ["simulate", str(tmp_path / "s.yaml"), "--json"]
    with pytest.raises(ScenarioError, match="no class 'LateValve'"):
        CliRunner().invoke(app, command, catch_exceptions=False)
    done = CliRunner().invoke(app, ["--extension", str(tmp_path / "late.py"), *command], catch_exceptions=False)
    assert done.exit_code == 1
    assert "does not follow" in json.loads(done.stdout)["verdict"]  # in 50 ms
