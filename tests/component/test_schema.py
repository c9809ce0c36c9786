"""Models made from runtime classes; classes of one's own in configuration files."""

import json
import pickle
import textwrap
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import pytest
from typer.testing import CliRunner

from mckibben.cli import app
from mckibben.component.extensions import load_extension
from mckibben.component.schema import default_of, model_of
from mckibben.control import Controller, Signal
from mckibben.errors import RangeError, ScenarioError
from mckibben.plant import FirstOrderValve, SampledSensors, Valve
from mckibben.study.parameters import find_parameter, with_values
from mckibben.study.scenario import Scenario
from mckibben.units import Bandwidth, PositiveTime, Pressure, Quantity, SignalValue, deg

BASE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
VALVE = "valve: {time_constant: 20 ms}"


class SlowValve(FirstOrderValve):
    """A lag with a dead time that is not simulated."""

    dead_time: PositiveTime = 0.01
    reverse: bool = eqx.field(static=True, default=False)


class Bump(Signal):
    """A bump of a height at a time."""

    height: SignalValue
    at: PositiveTime = 1.0

    def __call__(self, time):
        return self.height * jnp.exp(-((jnp.asarray(time) - self.at) ** 2))


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
    model = model_of(SampledSensors)
    assert list(model.model_fields) == ["encoder", "pressure_noise", "delay", "seed", "encoder_offset"]
    part = model.model_validate({"encoder": "0.5 deg", "seed": "3"})
    assert part.build() == SampledSensors(encoder=0.5 * deg, seed=3)
    assert part.effective("delay") == default_of(SampledSensors, "delay") == 0.0
    with pytest.raises(ValueError, match="outside 0 to 90 deg"):
        model.model_validate({"encoder": "91 deg"})
    with pytest.raises(ValueError, match="time_constant"):
        model_of(FirstOrderValve).model_validate({})


def test_a_quantity_says_its_range():
    mass = Quantity("kg", "g", 0, 500, open_lower=True)
    with pytest.raises(RangeError) as caught:
        mass.read("600 g")
    assert (caught.value.value, caught.value.lower, caught.value.upper, caught.value.unit) == (0.6, 0.0, 0.5, "kg")


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


def test_a_signal_of_ones_own():
    scenario = Scenario.parse(
        changed("{sine: {amplitude: 10 deg, frequency: 0.5 Hz}}", "{class: Bump, height: 5 deg, at: 2 s}")
    )
    assert float(scenario.reference()(2.0).angle) == pytest.approx(5 * deg)
    assert Scenario.parse(scenario.dumps()) == scenario


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
        ("{class: SlowValve, time_constant: 20 mm}", "valve.time_constant", "like ms"),
        ("{class: SlowValve}", "valve.time_constant", "is missing"),
        ("{class: SlowValve, time_constant: 20 ms, dead_tme: 1 ms}", "valve.dead_tme", "did you mean 'dead_time'"),
        ("{class: SampledSensors}", "valve", "there is no class 'SampledSensors' of Valve"),
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
            from mckibben.plant import FirstOrderValve
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


def test_types_of_fields_are_floats_to_the_class():
    assert SlowValve.__annotations__["dead_time"] == PositiveTime
    assert isinstance(Bandwidth.__metadata__[0], Quantity)
    assert issubclass(SlowValve, Valve)


def test_scenarios_go_to_other_processes():
    for path in sorted((Path(__file__).parents[2] / "examples").glob("*.yaml")):
        scenario = Scenario.read(path)
        assert pickle.loads(pickle.dumps(scenario)) == scenario


def test_the_command_line_runs_an_extension_before_it_reads_a_file(tmp_path):
    (tmp_path / "late.py").write_text(
        "from mckibben.plant import FirstOrderValve\n\nclass LateValve(FirstOrderValve):\n    pass\n"
    )
    text = changed(VALVE, "valve: {class: LateValve, time_constant: 30 ms}").replace(
        "duration: 10 s", "duration: 50 ms"
    )
    (tmp_path / "s.yaml").write_text(text.replace("at: 5 s", "at: 20 ms"))
    command = ["simulate", str(tmp_path / "s.yaml"), "--json"]
    with pytest.raises(ScenarioError, match="no class 'LateValve'"):
        CliRunner().invoke(app, command, catch_exceptions=False)
    done = CliRunner().invoke(app, ["--extension", str(tmp_path / "late.py"), *command], catch_exceptions=False)
    assert done.exit_code == 0
    assert json.loads(done.stdout)["outcome"] == "completed"
