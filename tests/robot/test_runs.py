"""Runs of a robot: single and batches, both engines, controllers, and starts that are not possible."""

import dataclasses
import pickle
import runpy

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import mckibben as mk
from mckibben.control import Controller
from mckibben.errors import RangeError, SimulationError
from mckibben.robot import (
    JointwiseControl,
    PressureSchedule,
    RobotMeasurement,
    RobotPlant,
    RobotStart,
    simulate_robot,
    simulate_robots,
)
from mckibben.simulation import Outcome
from mckibben.simulation.robot_metrics import BodySample
from mckibben.units import deg
from tests.robot.conftest import over_two, with_unit

STEP = {"duration": 0.1, "control_period": 0.25e-3}
PULLEYS = mk.Pulley(0.03, 0.08), mk.Pulley(0.02, 0.082)


@pytest.fixture(scope="module")
def start(plant):
    angles = (0.0, 0.0)
    return RobotStart(angles, plant.robot.pressures_for(angles, (0.0, 0.0), (None, 15.0)), upward_speed=-1.0)


@pytest.mark.slow
def test_single_runs_and_batches_with_a_series_spring_agree_in_both_engines(plant, start):
    tendon = mk.SeriesSpring(stiffness=2e4, preload=60.0, travel=8e-3)
    springy = dataclasses.replace(plant, robot=with_unit(plant.robot, 1, tendon=tendon))
    schedule = PressureSchedule(tuple((p,) for p in start.pressures))
    given = {"substeps": 2, **STEP}
    run = simulate_robot(springy, schedule, start, **given)
    again = simulate_robot(springy, schedule, start, engine="xla", **given)
    assert run.engine == "native" and again.engine == "xla"
    assert float(abs(run["z"] - again["z"]).max()) < 1e-12
    over = {"initial.upward_speed": [-0.5, -1.0]}
    native, xla = (
        simulate_robots(springy, schedule, start, over=over, engine=engine, **given) for engine in ("native", "xla")
    )
    for name in native.table:
        np.testing.assert_allclose(native[name], xla[name], rtol=1e-9, atol=1e-10, err_msg=name)
    assert native.engine == "native"
    assert float(native["peak_force"][1]) == pytest.approx(float(run["ground_up"].max()), rel=1e-9)
    assert (np.diff(native["deflection"]) > 0).all()


@pytest.mark.slow
def test_robots_on_cuda_are_those_of_the_c_compiler(plant, start, cuda_device, nvrtc):
    schedule = PressureSchedule(tuple((p,) for p in start.pressures))
    over = {"initial.upward_speed": np.linspace(-1.4, -0.5, 5)}
    tables = [
        simulate_robots(plant, schedule, start, over=over, engine=engine, **STEP) for engine in ("native", "cuda")
    ]
    assert tables[1].engine == "cuda"
    for name in tables[0].metrics:
        assert np.allclose(tables[0][name], tables[1][name], rtol=1e-9, atol=1e-12, equal_nan=True), name
    if cuda_device is not None:
        assert nvrtc.compile(cuda_device.sources[0], 90).startswith(b"\x7fELF")


@pytest.mark.slow
def test_a_run_that_diverges_in_the_air_has_diverged(plant, start):
    joints = tuple(dataclasses.replace(one, damping=1000.0) for one in plant.robot.joints)
    stiff = dataclasses.replace(plant, robot=dataclasses.replace(plant.robot, joints=joints))
    high = start._replace(clearance=0.3, angles=(0.02, 0.0))  # not at rest, where only rounding would grow
    schedule, over = (
        PressureSchedule(tuple((p,) for p in start.pressures)),
        {"initial.upward_speed": [-0.5, -1.0, -1.4]},
    )
    for one, diverged in ((stiff, True), (plant, False)):
        assert (simulate_robots(one, schedule, high, over=over, substeps=4, **STEP).failed == diverged).all()


@pytest.mark.slow
def test_air_with_a_temperature_keeps_its_mass_in_a_landing_and_is_between_isothermal_and_adiabatic_air(plant, start):
    closed, runs = mk.FlowValve(1e-30, 8e5), {}
    schedule = PressureSchedule(tuple((p,) for p in start.pressures))
    for name, parts in {
        "warm": {"wall_conductance": 5.0},
        "adiabatic": {"wall_conductance": 0.0},
        "isothermal": {"polytropic_index": 1.0},
        "polytropic": {"polytropic_index": 1.4},
    }.items():
        valve = dataclasses.replace(closed, **parts)
        runs[name] = simulate_robot(dataclasses.replace(plant, valve=valve), schedule, start, **STEP)
    mass, polytropic = runs["warm"]["air_mass"], runs["polytropic"]["air_mass"]
    np.testing.assert_allclose(mass, np.broadcast_to(mass[:, :1], mass.shape), rtol=1e-6)
    assert np.ptp(polytropic, axis=1).max() > 0.02 * polytropic.max()  # counted at room temperature
    lowest = {name: float(run["z"].min()) for name, run in runs.items()}
    assert lowest["adiabatic"] == pytest.approx(lowest["polytropic"], abs=1e-6)
    assert lowest["isothermal"] < lowest["warm"] < lowest["adiabatic"]


@pytest.mark.slow
def test_energy_is_kept_without_damping_and_valves(plant):
    """On an elastic ground with constant pressures: bodies, muscles and ground exchange energy alone."""
    robot = dataclasses.replace(
        plant.robot, joints=tuple(dataclasses.replace(one, damping=0.0, stop_damping=0.0) for one in plant.robot.joints)
    )
    ground = dataclasses.replace(plant.ground, damping=0.0)
    elastic = RobotPlant(robot, mk.IdealValve(), ground)
    angles = (0.0, 0.1)
    pressures = robot.pressures_for(angles, (0.0, 0.0), (None, None))
    start = RobotStart(angles, pressures, upward_speed=-0.5)
    run = simulate_robot(elastic, PressureSchedule(tuple((p,) for p in pressures)), start, substeps=4, **STEP)
    power = run["muscle_power"]
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2)])
    force = run["ground_up"]
    spring = force**2 / (2 * ground.stiffness)
    stops = np.sum(run["stop_torque"] ** 2, axis=0) / (2 * robot.joints[0].stop_stiffness)
    potential = 9.81 * float(robot.total_mass) * run["mass_height"]
    total = run["kinetic"] + potential + spring + stops - work * 0.25e-3
    assert np.ptp(total) < 2e-3 * run["kinetic"].max()


def test_schedule_is_the_mean_over_the_period():
    schedule = PressureSchedule(((1e5, 4e5, 2e5),), ((1.25e-3, 3e-3),))
    at = lambda t: float(schedule.step((), t, RobotMeasurement((), (), jnp.zeros(())), 1e-3)[1][0])  # noqa: E731
    assert [at(t * 1e-3) for t in range(5)] == pytest.approx([1e5, 3.25e5, 4e5, 2e5, 2e5])


@pytest.mark.parametrize(
    ("levels", "switches", "field"),
    [
        (((1e5,),), ((0.1,),), "levels"),
        (((1e5, 2e5, 3e5),), ((0.2, 0.1),), "switches"),
        (((1e5,),) * 2, ((),), "switches"),
    ],
)
def test_schedules_that_do_not_fit(levels, switches, field):
    with pytest.raises(RangeError) as caught:
        PressureSchedule(levels, switches)
    assert caught.value.field == field and caught.value.remedy


@pytest.mark.slow
def test_biarticular_muscle_turns_both_joints(plant):
    muscle = plant.robot.all_muscles[0]
    one = over_two(muscle, PULLEYS, ("hip", "knee"), ("lengthens", "shortens"), "rectus")
    robot = dataclasses.replace(plant.robot, muscles=(*plant.robot.muscles, one))
    pressures = (3e5,) * 5
    with_it, without = robot.torques((0.0, 0.0), pressures), plant.robot.torques((0.0, 0.0), pressures[:4])
    added = [float(a - b) for a, b in zip(with_it, without, strict=True)]
    tension = float(muscle.force(muscle.specimen.contraction_at(0.162), 3e5))
    assert added == pytest.approx([-0.03 * tension, 0.02 * tension])
    held = robot.pressures_for((0.0, 0.0), (0.0, 0.0), (None, None), others=(1e5,))
    assert [float(x) for x in robot.torques((0.0, 0.0), held)] == pytest.approx([0.0, 0.0], abs=1e-6)
    both = RobotPlant(robot, plant.valve, plant.ground)
    start = RobotStart((0.0, 0.0), held, upward_speed=-0.5)
    run = simulate_robot(both, PressureSchedule(tuple((p,) for p in held)), start, substeps=1, **STEP)
    assert run.muscles[-1] == "rectus" and np.isfinite(run["z"]).all()


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"joints": ("ankle", "knee")}, "muscles.2.over.0.joint"),
        ({"joints": ("hip", "hip")}, "muscles.2.over.1.joint"),
        ({"actions": ("pulls", "shortens")}, "action"),
        ({"paths": (mk.Pulley(0.03, 0.2), mk.Pulley(0.02, 0.082))}, "muscles.2"),
        ({"name": "knee2"}, "muscles.2.name"),
    ],
)
def test_biarticular_muscles_that_do_not_fit(plant, change, field):
    given = {"paths": PULLEYS, "joints": ("hip", "knee"), "actions": ("lengthens", "shortens"), "name": "x"}
    with pytest.raises(RangeError) as caught:
        other = over_two(plant.robot.all_muscles[0], **(given | change))
        dataclasses.replace(plant.robot, muscles=(*plant.robot.muscles, other))
    assert caught.value.field == field and caught.value.remedy


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"angles": (0.0, 60 * deg)}, "angles"),
        ({"angles": (0.0,)}, "angles"),
        ({"pressures": (1e5,) * 3}, "pressures"),
        ({"pressures": (1e5, 1e5, 1e5, 9e5)}, "pressures"),
        ({"clearance": -0.01}, "clearance"),
    ],
)
def test_starts_that_are_not_possible(plant, start, change, field):
    schedule = PressureSchedule(tuple((p,) for p in start.pressures))
    with pytest.raises(RangeError) as caught:
        simulate_robot(plant, schedule, start._replace(**change), **STEP)
    assert caught.value.field.partition(".")[0] == field


@pytest.mark.slow
@pytest.mark.parametrize("change", [{"stiffness": 1e8}, {"friction": 1.0, "slip_speed": 0.01}])
def test_steps_that_do_not_resolve_the_ground(plant, start, change):
    hard = dataclasses.replace(plant, ground=dataclasses.replace(plant.ground, **change))
    schedule = PressureSchedule(tuple((p,) for p in start.pressures))
    with pytest.raises(SimulationError) as caught:
        simulate_robot(hard, schedule, start, substeps=1, **STEP)
    assert caught.value.field == "substeps" and caught.value.lower is not None
    with pytest.raises(SimulationError):
        simulate_robots(hard, schedule, start, over={"initial.upward_speed": [-1.0, -0.5]}, substeps=1, **STEP)


def test_controllers_of_another_robot(plant, start):
    with pytest.raises(RangeError) as caught:
        simulate_robot(plant, PressureSchedule(((1e5,),) * 3), start, substeps=1, **STEP)
    assert caught.value.field == "commands" and caught.value.value == 3
    with pytest.raises(RangeError) as caught:
        simulate_robot(plant, JointwiseControl(()), start, substeps=1, **STEP)
    assert caught.value.field == "controllers"


def test_a_fixed_base_has_no_speed(plant, start):
    robot = dataclasses.replace(plant.robot, base="fixed")
    with pytest.raises(RangeError) as caught:
        dataclasses.replace(plant, robot=robot).init_state(start.angles, start.pressures, upward_speed=-1.0)
    assert caught.value.field == "upward_speed"


@pytest.mark.slow
def test_hopping_in_place_settles_to_equal_hops():
    example = runpy.run_path("examples/robot/hopping.py")
    run = example["hop"]()
    assert run.engine == "native"
    flights = example["flights"](run)
    assert flights.size >= 8
    assert flights[-5:].std() < 0.03 * flights[-5:].mean()
    assert set(np.unique(run["phase"])) == {0, 1, 2, 3}


@pytest.mark.slow
def test_the_air_of_a_run_is_that_which_flows_in(plant, start):
    """One muscle is filled, its antagonist emptied: what leaves is no consumption, nor does it count against it."""
    filled = tuple((p, p + (0.5e5 if number % 2 else -0.5e5)) for number, p in enumerate(start.pressures))
    schedule = PressureSchedule(filled, tuple((0.02,) for _ in filled))
    high = start._replace(clearance=0.3)
    run = simulate_robot(plant, schedule, high, substeps=1, **STEP)
    steps = np.diff(run["air_mass"], axis=1)
    table = simulate_robots(plant, schedule, high, over={"initial.upward_speed": [-1.0, -0.9]}, substeps=1, **STEP)
    assert -steps[steps < 0].sum() > 0.2 * steps[steps > 0].sum() > 0
    assert float(table["air_mass"][0]) == pytest.approx(steps[steps > 0].sum(), rel=2e-3)


def test_parts_of_a_controller_are_prepared_for_the_control_period():
    class Prepared(Controller):
        periods: int = eqx.field(static=True, default=0)

        def with_period(self, period):
            return dataclasses.replace(self, periods=round(0.01 / period))

        def init(self, measurement):
            return ()

        def step(self, state, setpoint, measurement, period):
            return (), measurement.pressures

        def telemetry(self, state):
            return {}

    control = JointwiseControl((Prepared(), Prepared())).with_period(1e-3)
    assert [one.periods for one in control.controllers] == [10, 10]


@pytest.mark.slow
def test_a_finished_run_has_the_metrics_of_a_batch(plant, start, tmp_path):
    """A jump: all metrics are finite, and equal whether they are accumulated or taken from the samples."""
    levels = tuple((p, 5.5e5 if number % 2 else 0.2e5) for number, p in enumerate(start.pressures))
    schedule = PressureSchedule(levels, tuple((5e-3,) for _ in levels))
    run = simulate_robot(plant, schedule, start, duration=0.3, substeps=1, control_period=0.5e-3)
    over = {"initial.upward_speed": [-1.0, -0.5]}
    batch = simulate_robots(plant, schedule, start, over=over, duration=0.3, control_period=0.5e-3, substeps=1)
    assert np.isfinite(run.metrics["apex"]) and run.metrics["muscle_work"] != 0
    for name, value in run.metrics.items():
        np.testing.assert_allclose(value, batch[name][..., 0], rtol=1e-10, atol=1e-15, err_msg=name)
    assert set(run.metrics) == set(batch.metrics) and batch.outcomes == [Outcome.COMPLETED] * 2
    np.testing.assert_array_equal(batch["initial.upward_speed"], [-1.0, -0.5])
    assert pickle.loads(pickle.dumps(run)).metrics["apex"] == run.metrics["apex"]
    run.to_netcdf(tmp_path / "run.nc")
    table = xr.load_dataset(tmp_path / "run.nc")
    assert table["angle"].dims == ("joint", "time") and table["command"].dims == ("muscle", "time")
    assert all(table[name].attrs["units"] for name in (*BodySample._fields, "command", "time"))
    assert run._repr_html_().count("<tr>") >= len(run.metrics)
    assert batch._repr_html_().count("<tr>") == 1 + len(run.metrics) + 1  # the stops of two joints


@pytest.mark.slow
def test_steps_follow_from_the_accuracy_of_the_positions(plant, start):
    schedule = PressureSchedule(tuple((p,) for p in start.pressures))
    low = start._replace(clearance=0.0, upward_speed=-0.3)
    found, fine = (
        simulate_robot(plant, schedule, low, **STEP, **given) for given in ({"accuracy": 1e-5}, {"substeps": 64})
    )
    apart = max(float(np.abs(found[name] - fine[name]).max()) for name in ("angle", "z", "x", "pitch"))
    assert found.resolution.error <= 1e-5 and apart <= 2e-5 and not found.resolution.chaotic
    given = {"over": {"initial.upward_speed": [-0.3, -0.2]}} | STEP
    table = simulate_robots(plant, schedule, low, accuracy=1e-5, **given)
    assert np.ptp(table["substeps"]) == 0 and np.all(table["error_estimate"] <= 1e-5)
    with pytest.raises(SimulationError) as caught:
        simulate_robots(plant, schedule, low, accuracy=1e-15, **given)
    assert caught.value.field == "accuracy"
