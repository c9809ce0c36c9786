"""MJCF and plugin against JAX: torques of every law and geometry, loads, and runs with all states of the muscles."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import equinox as eqx
import jax
import mujoco
import numpy as np
import pytest

import mckibben as mk
from mckibben.actuator import SecondOrderValve
from mckibben.codegen.c import write_c
from mckibben.errors import ExportError
from mckibben.export import export
from mckibben.export.mjcf import mujoco_model
from mckibben.export.mujoco import build_plugin, import_mujoco, load_mujoco
from mckibben.export.muscle_plugin import plugin_source
from mckibben.joint import Slide, SlidingMass
from mckibben.muscle import ForceCorrection, MaxwellCreep, MaxwellSlip, no_muscle
from mckibben.scenario import run_scenario

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the plugin needs a C compiler")
LAGS = mk.FirstOrderValve(time_constant=0.02)
LOAD = mk.KneeLoad(0.5, 0.5, 0.1, 0.2, 0.02, 0.015)


def names(joints):
    return {joint: f"joint{number}" for number, joint in enumerate(joints)}


def build(folder, plants):
    """Models of plants by name, with all their plugins in one library."""
    made, sources = {}, []
    for name, plant in plants.items():
        model = mujoco_model(plant, name)
        written = write_c(model.module)
        here = folder / name
        here.mkdir()
        for file, text in ((f"{name}.h", written.header), (f"{name}.c", written.source)):
            (here / file).write_text(text)
        (here / "plugin.c").write_text(plugin_source(model.muscles, name))
        sources += [here / f"{name}.c", here / "plugin.c"]
        made[name] = model
    package = Path(mujoco.__file__).parent
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", f"-I{package / 'include'}"]
    library = folder / "libjoints.so"
    files = [library, *sources, *package.glob("libmujoco.so*")]
    subprocess.run([*command, "-o", *map(str, files), "-lm"], check=True)
    mujoco.mj_loadPluginLibrary(str(library))
    return made


@pytest.fixture(scope="session")
def models(tmp_path_factory, joints):
    """Every law and geometry with ideal valves, by the name of the joint."""
    plants = {name: mk.JointPlant(joints[joint](), LOAD, mk.IdealValve()) for joint, name in names(joints).items()}
    made = build(tmp_path_factory.mktemp("laws"), plants)
    return {joint: made[name] for joint, name in names(joints).items()}


@pytest.mark.slow
def test_every_law_and_geometry_gives_the_torque_and_none_pushes(request, known, models):
    joint = request.node.callspec.params["known"]
    model = mujoco.MjModel.from_xml_string(models[joint].xml)
    data = mujoco.MjData(model)
    for angle, pressures, torque in zip(known.angles, known.pressures, known.torque, strict=True):
        data.qpos[0], data.ctrl[:] = angle, pressures
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == pytest.approx(torque, abs=1e-9)
        arms = np.where(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, (1, -1), 1)  # there it is a torque
        assert np.all(data.actuator_force * arms <= 0)
    left_out = models[joint].left_out
    assert len(left_out) == 2 - model.ntendon
    assert all("tendon" in one for one in left_out)


@pytest.mark.parametrize(
    "load",
    [
        mk.KneeLoad(0.5, 0.5, 0.1, 0.2, 0.02, 0.015, hanging=False),
        mk.PendulumLoad(mass=0.3, length=0.25, damping=0.1, hanging_angle=np.pi),
        mk.GeneralLoad(inertia=0.02, greatest_gravity_torque=0.7, damping=0.05, hanging_angle=0.4),
        mk.GeneralLoad(inertia=0.02, greatest_gravity_torque=0.0),
    ],
    ids=["inverted knee", "pendulum", "general", "without gravity"],
)
@pytest.mark.slow
def test_loads_accelerate_as_they_should(load, models, joints):
    name, joint = names(joints)["knee"], joints["knee"]()
    made = mujoco_model(mk.JointPlant(joint, load, mk.IdealValve()), name)
    assert bool(made.left_out) == isinstance(load, mk.GeneralLoad)
    model = mujoco.MjModel.from_xml_string(made.xml)
    data = mujoco.MjData(model)
    for angle in (-0.3, 0.1, 0.25):
        data.qpos[0], data.qvel[0], data.ctrl[:] = angle, 1.5, (2e5, 3e5)
        mujoco.mj_forward(model, data)
        wanted = load.acceleration(angle, 1.5, joint.torque(angle, (2e5, 3e5)))
        assert data.qacc[0] == pytest.approx(float(wanted), rel=1e-9)


@pytest.mark.slow
def test_the_exported_scenario_runs_as_its_simulation(tmp_path):
    """Two seconds with the commands of the simulation."""
    scenario = mk.Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update={"substeps": 4})
    made = export(scenario, "mjcf", tmp_path)
    assert len(made.left_out) == 1  # the controller
    model = load_mujoco(tmp_path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    result = run_scenario(scenario)
    angles, commands = result["angle"], np.stack([result["command1"], result["command2"]], -1)
    for period in range(2000):
        assert data.qpos[0] == pytest.approx(angles[period], abs=1e-9)
        data.ctrl[:] = commands[period]
        mujoco.mj_step(model, data, nstep=scenario.substeps)
    assert np.ptp(angles[:2000]) > 0.3
    assert model.opt.timestep == scenario.control_period / scenario.substeps
    assert load_mujoco(tmp_path).nu == 2  # once more
    other = shutil.copytree(tmp_path, tmp_path / "other")
    for folder, name in (
        (other, ""),
        (other, "elbow"),
        (tmp_path / "other" / "empty", ""),
    ):  # loaded from another folder
        with pytest.raises(ExportError) as caught:
            load_mujoco(folder, name)
        assert caught.value.field == "name"


@eqx.filter_jit
def angles_of(plant, state, commands):
    """Angle after each control period."""

    def period(state, commands):
        state = plant.advance(state, (commands[0], commands[1]), 1e-3, 4)
        return state, state.angle

    return jax.lax.scan(period, state, commands)[1]


CAM = mk.PairedPaths(mk.Cam(0.03, 0.162, arm_slope=0.008), mk.Pulley(0.025, 0.16))
FRICTION = MaxwellSlip(12.0, 5e-4, viscous=30.0, elements=1)
SPRING = mk.SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
FLOW = mk.FlowValve(conductance=1e-9, supply=7e5)
WARM = mk.FlowValve(conductance=1e-9, supply=7e5, wall_conductance=0.3)
TUBE = mk.Tube(FLOW, volume=1e-5, conductance=5e-10)
REGULATOR = mk.PressureRegulator(conductance=1e-9, supply=7e5, time_constant=0.02)
CORRECTION = ForceCorrection((-20.0, 5.0), (1e-5, 0.0), 0.1, 0.05)
GROWING = MaxwellSlip(12.0, 5e-4, growth=1e-5, tension_growth=0.02, viscous=20.0, elements=4)
DELAYED = MaxwellCreep(900.0, 0.5, pressure_share=0.2, pressure_time_constant=0.3)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, knee):
    """Plants with friction, creep, and valves of all kinds, and their models."""
    parts = knee.muscle1.specimen, knee.muscle1.law
    slipping, creeping = (
        mk.Muscle(*parts, FRICTION),
        mk.Muscle(*parts, FRICTION, MaxwellCreep(900.0, 0.5, pressure_share=0.1)),
    )
    growing = mk.Muscle(*parts, GROWING, DELAYED, correction=CORRECTION)
    plants = {
        "lags": mk.JointPlant(mk.AntagonisticJoint(knee.geometry, creeping, creeping), LOAD, LAGS),
        "ideal": mk.JointPlant(mk.AntagonisticJoint(CAM, slipping, slipping), LOAD, mk.IdealValve()),
        "spring": mk.JointPlant(
            mk.AntagonisticJoint(CAM, mk.return_spring(4e3, 0.13), slipping), LOAD, mk.IdealValve()
        ),
        "flow": mk.JointPlant(mk.AntagonisticJoint(knee.geometry, slipping, knee.muscle2), LOAD, FLOW),
        "unequal": mk.JointPlant(knee, LOAD, mk.UnequalValves(FLOW, TUBE)),
        "warm": mk.JointPlant(knee, LOAD, mk.UnequalValves(WARM, TUBE)),
        "rate": mk.JointPlant(knee, LOAD, mk.FirstOrderValve(0.02, rate=2e6)),
        "regulator": mk.JointPlant(mk.AntagonisticJoint(knee.geometry, slipping, knee.muscle2), LOAD, REGULATOR),
        "second": mk.JointPlant(
            mk.AntagonisticJoint(knee.geometry, growing, creeping), LOAD, SecondOrderValve(60.0, damping=0.5)
        ),
        "slide": mk.JointPlant(
            mk.AntagonisticJoint(Slide(rest_length2=0.165), no_muscle(), knee.muscle2),
            SlidingMass(mass=2.0, damping=60.0, incline=0.5),
            mk.IdealValve(),
        ),
        "stretch": mk.JointPlant(mk.AntagonisticJoint(knee.geometry, knee.muscle1, knee.muscle2, SPRING), LOAD, FLOW),
    }
    return plants, build(tmp_path_factory.mktemp("runs"), plants)


ACTIVATIONS = {
    **{"lags": 6, "ideal": 0, "flow": 4, "unequal": 5, "warm": 6},
    **{"rate": 2, "regulator": 4, "second": 8, "stretch": 4},
}


@pytest.mark.parametrize("name", ACTIVATIONS)
@pytest.mark.slow
def test_friction_creep_and_air_are_states_of_the_plugin(name, runs):
    """Against the plant's own integration: friction slips after the same steps."""
    plants, models = runs
    plant = plants[name]
    state = plant.init_state(0.0, (0.0, 0.0))
    model = mujoco.MjModel.from_xml_string(models[name].xml)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert model.na == ACTIVATIONS[name]
    wave = 1e5 * np.sin(12e-3 * np.arange(400))
    commands = np.stack([2.5e5 + wave, 3e5 - wave], -1)
    for now, angle in zip(commands, np.asarray(angles_of(plant, state, commands)), strict=True):
        data.ctrl[:] = now
        mujoco.mj_step(model, data, nstep=4)
        # MuJoCo integrates the pressure, which the plant has in closed form: they differ where a limited rate ends, and
        # where creep meets its bound
        assert data.qpos[0] == pytest.approx(angle, abs={"rate": 1e-7, "lags": 1e-8}.get(name, 1e-9))
    assert abs(data.qpos[0]) > 0.02


@pytest.mark.slow
def test_a_return_spring_needs_no_command(runs):
    plants, models = runs
    model = mujoco.MjModel.from_xml_string(models["spring"].xml)
    data = mujoco.MjData(model)
    for angle in (-0.2, 0.0, 0.3):
        mujoco.mj_resetData(model, data)
        data.qpos[0], data.ctrl[:] = angle, (0.0, 3e5)
        mujoco.mj_forward(model, data)
        wanted = float(plants["spring"].joint.torque(angle, (0.0, 3e5)))
        assert data.qfrc_actuator[0] == pytest.approx(wanted, abs=1e-9)


@pytest.mark.slow
def test_a_mass_on_a_slope_accelerates_as_it_should(runs):
    plants, models = runs
    model = mujoco.MjModel.from_xml_string(models["slide"].xml)
    data, plant = mujoco.MjData(model), plants["slide"]
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    for position in (-0.01, 0.0, 0.01):
        data.qpos[0], data.qvel[0], data.ctrl[:] = position, 0.2, (0.0, 3e5)
        mujoco.mj_forward(model, data)
        force = plant.joint.torque(position, (0.0, 3e5))
        assert data.qacc[0] == pytest.approx(float(plant.load.acceleration(position, 0.2, force)), rel=1e-9)


@pytest.mark.parametrize(
    ("error", "remedy"),
    [(ModuleNotFoundError(name="mujoco"), "mckibben"), (ImportError("core bindings are missing"), "mujoco-core")],
    ids=["missing", "damaged"],
)
def test_a_missing_or_damaged_mujoco_is_an_error_with_its_remedy(error, remedy, monkeypatch):
    def fails(name):
        raise error

    monkeypatch.setattr("mckibben.export.mujoco.import_module", fails)
    with pytest.raises(ExportError) as caught:
        import_mujoco()
    assert caught.value.field == "mujoco"
    assert remedy in caught.value.remedy


def test_what_mujoco_cannot_hold_is_refused(knee):
    reservoir = mk.FlowValve(conductance=1e-9, supply=7e5, reservoir_volume=1e-3, line_conductance=1e-8)
    switching = mk.SwitchingValves(conductance=1e-9, supply=7e5, period=0.01)

    class Sprung(mk.PendulumLoad):
        def gravity_torque(self, angle):
            return super().gravity_torque(angle) - 2.0 * angle

    for plant, field in (
        (mk.JointPlant(knee, LOAD, reservoir), "reservoir_volume"),
        (mk.JointPlant(knee, LOAD, switching), "valve"),
        (mk.JointPlant(knee, Sprung(mass=0.3, length=0.25), LAGS), "load"),
    ):
        with pytest.raises(ExportError) as caught:
            mujoco_model(plant)
        assert caught.value.remedy
        assert caught.value.field == field
    with pytest.raises(ExportError) as caught:
        mujoco_model(mk.JointPlant(knee, Sprung(mass=0.3, length=0.25), switching))
    assert caught.value.message.count("MuJoCo does not support") == caught.value.remedy.count("give") == 2


def test_the_compiler_of_a_plugin_may_have_options(tmp_path, monkeypatch):
    (tmp_path / "plugin.c").write_text("int from_options(void) { return GIVEN; }\n")
    package, library = Path(mujoco.__file__).parent, tmp_path / "plugin.so"
    monkeypatch.setenv("CC", "cc -g0 -DGIVEN=7")
    build_plugin(library, [tmp_path / "plugin.c"], package)
    assert ctypes.CDLL(str(library)).from_options() == 7
    monkeypatch.setenv("CC", "no-such-compiler -O3")
    with pytest.raises(ExportError) as caught:
        build_plugin(library, [tmp_path / "plugin.c"], package)
    assert caught.value.field == "CC"
