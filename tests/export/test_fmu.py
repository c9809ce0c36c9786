"""FMUs against the simulation, in fmpy."""

import importlib.util
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from mckibben.errors import ExportError
from mckibben.export import export
from mckibben.export.controller import controller_module
from mckibben.export.hardware import Hardware
from mckibben.numerics.compiled import jit, numeric
from mckibben.robot import RobotScenario
from mckibben.scenario import Scenario
from mckibben.serial_protocol import FaultCode, FirmwareState
from mckibben.simulation.loop import compiled_episode
from mckibben.simulation.problem import sampled
from tests.robot.test_control import AIR, DECOUPLING, LAG, ONE, TORQUE, TWO

fmpy = pytest.importorskip("fmpy", reason="needs the extra fmu")
validation = pytest.importorskip("fmpy.validation", reason="needs the extra fmu")
build = pytest.importorskip("fmpy.build", reason="needs the extra fmu")
pytestmark = pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler, for the FMU's binary")

TEXT = Path(__file__).with_name("knee-with-friction.yaml").read_text(encoding="utf-8")
PERIOD = 1e-3
STATE = ("angle", "velocity", "pressure1", "pressure2")


class Instance:
    """An FMU for co-simulation, with its variables by name."""

    def __init__(self, path, *, initialized=True):
        description = fmpy.read_model_description(path)
        self.references = {one.name: one.valueReference for one in description.modelVariables}
        self.folder = fmpy.extract(path)
        self.fmu = fmpy.simulation.instantiate_fmu(self.folder, description, "CoSimulation")
        self.fmu.setupExperiment()
        self.fmu.enterInitializationMode()
        if initialized:
            self.fmu.exitInitializationMode()

    def set(self, **values):
        names = [name.replace("__", ".") for name in values]
        self.fmu.setReal([self.references[name] for name in names], list(map(float, values.values())))

    def get(self, *names):
        return np.array(self.fmu.getReal([self.references[name] for name in names]))

    def close(self):
        self.fmu.freeInstance()
        shutil.rmtree(self.folder)


@pytest.fixture
def opened():
    """Opens FMUs, and closes them after the test."""
    instances = []

    def open_fmu(path, **options):
        instances.append(Instance(path, **options))
        return instances[-1]

    yield open_fmu
    for one in instances:
        one.close()


@pytest.fixture(scope="module")
def scenario():
    return Scenario.parse(TEXT).model_copy(update={"name": "knee\x01 & <b>"})


@pytest.fixture(scope="module")
def folder(scenario, tmp_path_factory):
    """Plant and controller."""
    folder = tmp_path_factory.mktemp("fmus")
    for target in ("fmu", "fmu-controller"):
        assert not any("binary" in part for part in export(scenario, target, folder).left_out)
    return folder


@pytest.mark.parametrize("name", ["plant", "controller"])
@pytest.mark.slow
def test_files_are_valid_and_their_sources_have_no_warnings(folder, tmp_path, name):
    file = folder / f"{name}.fmu"
    assert validation.validate_fmu(str(file)) == []
    description = fmpy.read_model_description(file)
    assert description.fmiVersion == "2.0"
    assert (description.modelExchange is None) == (name == "controller")
    sources = Path(fmpy.extract(file, tmp_path / name)) / "sources"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]
    subprocess.run(["cc", *flags, *map(str, sources.glob("*.c"))], check=True)


@pytest.fixture(scope="module")
def simulated(scenario):
    """Setpoints of the scenario, and states and commands of its simulation."""
    plant, controller = scenario.plant(), scenario.control()
    plant, controller, initial = numeric((plant, controller, plant.complete_state(scenario.initial(plant))))
    _, setpoints = sampled(scenario.reference(), scenario.duration, PERIOD)
    _, record = compiled_episode(plant, controller, setpoints, initial, PERIOD, scenario.needed_substeps())
    expected = np.stack([record.state.angle, record.state.velocity, *record.state.pressures, record.commands[0],
                         record.commands[1]], 1)  # fmt: skip
    return setpoints, expected


@pytest.mark.slow
def test_closed_loop_is_the_simulation(simulated, folder, opened):
    setpoints, expected = simulated
    signals = {"setpoint.angle": setpoints.angle, "setpoint.stiffness": setpoints.stiffness}
    rows = closed_loop(signals, folder, opened, (*STATE, "command1", "command2"), PERIOD)
    assert np.ptp(expected[:, 0]) > 0.1
    assert np.max(np.abs(rows - expected) / np.max(np.abs(expected), 0)) < 1e-9


IDEAL = re.sub(r"(sensors|command_delay):.*\n", "", ONE)
SLIP = "law: lei-mas-10-180n, friction: {half_width: 12 N, presliding_length: 0.5 mm, elements: 2}}"
ROBOTS = {
    "fine steps": IDEAL.replace("substeps: 4", "substeps: 40") + DECOUPLING,  # a run has other ones if nothing slips
    "friction, air and a base that falls": IDEAL.replace("law: lei-mas-10-180n}", SLIP)
    .replace(LAG, AIR)
    .replace("robot:", "robot:\n  base: vertical\n  foot: {body: shank}")
    + TORQUE,
}


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.slow
def test_a_robot_in_a_closed_loop_is_its_simulation(name, tmp_path, opened):
    scenario = RobotScenario.parse(ROBOTS[name])
    for target in ("fmu", "fmu-controller"):
        export(scenario, target, tmp_path)
    owners = described(tmp_path / "plant.fmu") | described(tmp_path / "controller.fmu")
    joint, second = f"joint {scenario.joint_names[0]}", f"muscle {scenario.muscle_names[1]}"
    assert {owners[name] for name in ("angles[1]", "velocities[1]", "torques[1]", "stiffness[1]")} == {joint}
    assert {owners[name] for name in ("setpoint.angles[1]", "measurement.angles[1]", "der(angles[1])")} == {joint}
    assert {owners[name] for name in ("pressure2", "tension2", "command2", "measurement.pressure2")} == {second}
    run = scenario.run_once()
    signals = {"setpoint.angles[1]": run["desired_angle"][0], "setpoint.stiffness[1]": run["desired_stiffness"][0]}
    names = ("angles[1]", "velocities[1]", "pressure1", "pressure2", "tension1", "tension2", "command1", "command2")
    rows = closed_loop(signals, tmp_path, opened, names, scenario.control_period)
    columns = [*run["angle"], *run["velocity"], *run["pressure"], *run["force"], *run["command"]]
    expected = np.stack(columns, 1)
    assert np.ptp(expected[:, 0]) > 0.05
    assert np.max(np.abs(rows - expected) / np.max(np.abs(expected), 0)) < 1e-9


def described(path):
    """Descriptions of the variables of an FMU that have one."""
    with zipfile.ZipFile(path) as archive:
        tree = ElementTree.fromstring(archive.read("modelDescription.xml"))
    variables = (variable.attrib for variable in tree.iter("ScalarVariable"))
    return {variable["name"]: variable["description"] for variable in variables if "description" in variable}


def closed_loop(setpoints, folder, opened, names, period):
    """Outputs of the FMUs of plant and controller in a loop; a measurement is the output of the plant of that name."""
    plant, loop = opened(folder / "plant.fmu"), opened(folder / "controller.fmu", initialized=False)
    measured = [name.partition(".")[2] for name in loop.references if name.startswith("measurement.")]
    sent = [name for name in names if name.startswith("command")]
    rows = []
    for number, row in enumerate(zip(*map(np.asarray, setpoints.values()), strict=True)):
        loop.set(**dict(zip(setpoints, row, strict=True)))
        loop.set(**dict(zip((f"measurement.{name}" for name in measured), plant.get(*measured), strict=True)))
        if number == 0:
            loop.fmu.exitInitializationMode()
        commands = loop.get(*sent)
        rows.append([*plant.get(*names[: -len(sent)]), *commands])
        plant.set(**dict(zip(sent, commands, strict=True)))
        for one in (loop, plant):
            one.fmu.doStep(number * period, period)
        assert np.array_equal(loop.get(*sent), commands)  # held for masters that read outputs after the step
    assert plant.get("time") == pytest.approx(len(rows) * period)
    return np.array(rows)


@pytest.mark.slow
def test_the_controller_of_a_leg_repeats_the_recorded_run(tmp_path, opened):
    scenario = RobotScenario.parse(TWO)
    export(scenario, "fmu-controller", tmp_path)
    recorded = controller_module(scenario)
    short = (
        re.sub(r"(angles|stiffness)_(\d+)", lambda at: f"{at[1]}[{int(at[2]) + 1}]", name) for name in recorded.columns
    )
    names = [re.sub(r"pressures_(\d+)", lambda at: f"pressure{int(at[1]) + 1}", name) for name in short]
    names = [name.replace("commands.pressure", "command") for name in names]
    first, *rows = (dict(zip(names, row, strict=True)) for row in recorded.recording)
    loop, found = opened(tmp_path / "controller.fmu", initialized=False), []
    sent = [name for name in names if name.startswith("command")]
    loop.set(**{name: value for name, value in first.items() if name.startswith("measurement")})
    loop.fmu.exitInitializationMode()
    for number, row in enumerate(rows):
        loop.set(**{name: value for name, value in row.items() if name not in sent})
        found.append(loop.get(*sent))
        loop.fmu.doStep(number * scenario.control_period, scenario.control_period)
    expected = np.array([[row[name] for name in sent] for row in rows])
    assert len(sent) == 4 and np.ptp(expected, 0).min() > 1e4
    assert np.max(np.abs(found - expected)) < 1e-9 * expected.max()


def commands(plant, end=0.4):
    """A step of the commands [Pa] from those at the start."""
    names = ("command1", "command2")
    starts = plant.get(*names)
    times = [0.0, 0.1, 0.1, end]
    signal = np.zeros(4, [("time", float), *((name, float) for name in names), ("torque", float)])
    signal["time"] = times
    for name, start, factor in zip(names, starts, (1.1, 0.9), strict=True):
        signal[name] = start * np.array([1, 1, factor, factor])
    return signal


@pytest.mark.slow
def test_model_exchange_agrees_with_co_simulation(folder, opened):
    signal = commands(opened(folder / "plant.fmu"))
    common = {"stop_time": 0.4, "output_interval": PERIOD, "input": signal, "output": ["angle", "tension1"]}
    fixed = fmpy.simulate_fmu(folder / "plant.fmu", fmi_type="CoSimulation", step_size=PERIOD, **common)
    adaptive = fmpy.simulate_fmu(folder / "plant.fmu", fmi_type="ModelExchange", relative_tolerance=1e-8, **common)
    for name, tolerance in (("angle", 1e-5), ("tension1", 1e-2)):
        found = np.interp(fixed["time"], adaptive["time"], adaptive[name])
        away = np.abs(fixed["time"] - 0.1) > 2 * PERIOD  # rows around the step are before or after it
        assert np.ptp(fixed[name]) > 1e3 * tolerance
        assert np.max(np.abs(found - fixed[name])[away]) < tolerance


@pytest.mark.slow
def test_a_parameter_can_be_changed(folder, opened, tmp_path):
    text = TEXT.replace("load: knee-table-2", "load: {from: knee-table-2, mass2: 0.8 kg}")
    export(Scenario.parse(text), "fmu", tmp_path)
    changed, other = opened(folder / "plant.fmu"), opened(tmp_path / "plant.fmu", initialized=False)
    changed.set(load__mass2=0.8)
    starts = dict(zip(STATE, changed.get(*STATE), strict=True))
    other.set(**starts, command1=starts["pressure1"], command2=starts["pressure2"])
    other.fmu.exitInitializationMode()
    for number in range(50):
        for one in (changed, other):
            one.fmu.doStep(number * PERIOD, PERIOD)
    assert abs(changed.get("angle").item()) > 1e-3
    assert changed.get(*STATE, "tension1") == pytest.approx(other.get(*STATE, "tension1"), rel=1e-12)


@pytest.mark.slow
def test_a_state_can_be_restored(folder, opened):
    plant = opened(folder / "plant.fmu")
    plant.set(torque=1.0)
    plant.fmu.doStep(0.0, 0.02)
    held = plant.fmu.serializeFMUState(plant.fmu.getFMUState())
    results = []
    for _ in range(2):
        plant.fmu.doStep(0.02, 0.02)
        results.append(plant.get(*STATE, "tension1"))
        plant.fmu.setFMUState(plant.fmu.deserializeFMUState(held))
    assert np.array_equal(*results)
    assert not np.array_equal(results[0][:2], plant.get("angle", "velocity"))


@pytest.mark.slow
def test_steps_of_a_controller_are_whole_periods(folder, opened):
    loop = opened(folder / "controller.fmu")
    loop.fmu.doStep(0.0, 2 * PERIOD)
    with pytest.raises(fmpy.fmi1.FMICallException):
        loop.fmu.doStep(2 * PERIOD, 1.5 * PERIOD)


@pytest.mark.slow
def test_a_controller_contains_a_bad_input(folder, opened):
    loop, names = opened(folder / "controller.fmu"), ("command1", "command2", "status", "fault")
    good = loop.get("measurement.pressure1").item()
    loop.fmu.doStep(0.0, PERIOD)
    last = loop.get("command1", "command2")
    found = []
    for number, value in enumerate([np.nan] * 60 + [good] * 60):
        loop.set(measurement__pressure1=value)
        found.append(loop.get(*names))
        loop.fmu.doStep((1 + number) * PERIOD, PERIOD)
    assert found[0].tolist() == [*last, FirmwareState.HOLDING, FaultCode.NOT_FINITE]
    assert found[59].tolist() == [0, 0, FirmwareState.VENTED, FaultCode.NOT_FINITE]
    assert found[-1][2:].tolist() == [FirmwareState.RAMPING, FaultCode.NONE]
    assert 0 < found[-1][0] < 2 * good


@pytest.mark.slow
def test_switching_valves_are_for_co_simulation_only(tmp_path):
    valve = "{class: SwitchingValves, conductance: 0.1 L/(s*bar), supply: 7 bar, period: 5 ms}"
    made = export(Scenario.parse(TEXT.replace("{time_constant: 20 ms}", valve)), "fmu", tmp_path, name="switched")
    description = fmpy.read_model_description(tmp_path / "switched.fmu")
    assert description.modelExchange is None and description.coSimulation is not None
    assert any("model exchange" in one for one in made.left_out)


@pytest.mark.slow
def test_parameters_that_are_not_finite_are_left_out(tmp_path):
    limit = "joint.muscle{}.law.domain.contraction_max"
    made = export(Scenario.read("examples/linear-axis.yaml"), "fmu", tmp_path, name="instance")
    assert any(limit.format(1) in one for one in made.left_out)
    assert not any("binary" in one for one in made.left_out)
    assert validation.validate_fmu(str(tmp_path / "instance.fmu")) == []
    starts = {one.name: one.start for one in fmpy.read_model_description(tmp_path / "instance.fmu").modelVariables}
    assert limit.format(1) not in starts and limit.format(2) in starts
    assert all(np.isfinite(float(one)) for one in starts.values() if one is not None)


def test_nothing_is_written_for_numbers_of_32_bits(scenario, tmp_path):
    with pytest.raises(ExportError) as caught:
        export(scenario, "fmu", tmp_path / "out", hardware=Hardware(single=True))
    assert caught.value.field == "hardware"
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_headers_of_the_standard_are_those_of_fmpy(scenario, folder, tmp_path, monkeypatch):
    sources = Path(fmpy.extract(folder / "plant.fmu", tmp_path / "plant")) / "sources"
    for name in ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"):
        assert (sources / name).read_text() == (Path(fmpy.__file__).parent / "c-code" / name).read_text()
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ExportError) as caught:
        export(scenario, "fmu", tmp_path / "without")
    assert caught.value.field == "fmpy" and "mckibben[fmu]" in caught.value.remedy
    assert not (tmp_path / "without").exists()


@pytest.mark.slow
def test_the_temperature_of_the_air_is_a_state(tmp_path, opened):
    """Against the plant's own integration, with air that filling has warmed."""
    valve = "{class: FlowValve, conductance: 0.1 L/(s*bar), supply: 7 bar, wall_conductance: 0.3 W/K}"
    scenario = Scenario.parse(TEXT.replace("{time_constant: 20 ms}", valve))
    export(scenario, "fmu", tmp_path, name="warm")
    units = {one.name: one.unit for one in fmpy.read_model_description(tmp_path / "warm.fmu").modelVariables}
    assert units["temperature1"] == "K" and units["valve.wall_conductance"] == "W/K"
    plant = numeric(scenario.plant().with_ideal_io())
    state, one = scenario.initial(plant), opened(tmp_path / "warm.fmu")
    commands = (float(state.pressures[0]) + 2e5, float(state.pressures[1]))
    one.set(command1=commands[0], command2=commands[1])
    substeps = scenario.needed_substeps()
    advance = jit(lambda plant, state: plant.advance(state, commands, PERIOD, substeps))
    for number in range(50):
        state = advance(plant, state)
        one.fmu.doStep(number * PERIOD, PERIOD)
    temperatures = [float(temperature) for temperature in state.air.temperatures]
    assert temperatures[0] > 300
    assert one.get("temperature1", "temperature2") == pytest.approx(temperatures, rel=1e-9)
    assert one.get("angle").item() == pytest.approx(float(state.angle), rel=1e-9)


@pytest.mark.slow
def test_a_control_character_in_a_name_leaves_the_description_valid(folder):
    assert "knee\\x01 & <b>" in fmpy.read_model_description(folder / "controller.fmu").description
