"""Contract of own geometries under control: every kind of controller, batches, derivatives, and the envelope."""

from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

import mckibben as mk
from mckibben.control import PID, ExtendedStateObserver, PolePlacement, PositionStiffnessControl, PressureObserver
from mckibben.simulation import AtRest
from mckibben.units import bar, deg, mm

PATHS = run_path(str(Path(__file__).with_name("test_paths.py")))
LOAD = mk.KneeLoad(0.5, 0.5, 0.1, 0.2, 0.02, 0.015)
AIR = mk.FlowValve(conductance=4e-9, supply=9 * bar)
REFERENCE = mk.Reference(angle=mk.Sine(4 * deg, 1.0), stiffness=17.0)
TIMES = {"duration": 0.5, "control_period": 2e-3, "initial": AtRest(0.0, 17.0)}
GEOMETRIES = {
    "bone and cam": mk.PairedPaths(mk.TwoBonePath(*PATHS["ANCHORS"][1]), mk.Cam(28 * mm, 161 * mm, arm_slope=-5 * mm)),
    "table and pulley": mk.PairedPaths(PATHS["TABLES"][0], mk.Pulley(28 * mm, 161 * mm)),
}


def plant_of(name, valve):
    return mk.JointPlant(mk.AntagonisticJoint(GEOMETRIES[name], PATHS["MUSCLE"], PATHS["MUSCLE"]), LOAD, valve)


def controller_of(kind, plant):
    model = {"model": plant.joint, "load": plant.load, "valve": mk.FirstOrderValve(0.02)}
    position = PID(2 * bar, 60 * bar, 0.4 * bar)
    loops = PositionStiffnessControl(position, PID(0.1 * bar, 5 * bar, 0.0), model=plant.joint)
    pressures = PressureObserver(200.0)
    return {
        "loops": lambda: loops,
        "inverse": lambda: mk.InverseModelControl(loops, load=plant.load, valve=mk.FirstOrderValve(0.02)),
        "decoupling": lambda: mk.DecouplingControl(
            **model,
            observer=ExtendedStateObserver(120.0),
            pressure_observer=pressures,
            feedback=PolePlacement(40.0),
        ),
        "predictive": lambda: mk.PredictiveControl(**model, pressure_observer=pressures),
    }[kind]()


@pytest.mark.parametrize(
    ("name", "kind", "valve", "largest"),
    [
        ("bone and cam", "decoupling", mk.FirstOrderValve(0.02), 0.2),
        ("bone and cam", "loops", AIR, 2.0),
        ("table and pulley", "predictive", mk.FirstOrderValve(0.02), 0.2),
        ("table and pulley", "inverse", mk.FirstOrderValve(0.02), 0.5),
    ],
)
@pytest.mark.slow
def test_controllers_follow_and_runs_of_a_batch_are_the_same(name, kind, valve, largest):
    plant = plant_of(name, valve)
    controller = controller_of(kind, plant)
    alone = mk.simulate(plant, controller, REFERENCE, **TIMES)
    assert alone.metrics["angle_rmse"] < largest * deg
    assert alone.metrics["time_slack"] == 0
    many = mk.simulate_many(
        plant, controller, REFERENCE, over={"load.mass2": [0.5, 0.6]}, metrics=["angle_rmse"], **TIMES
    )
    np.testing.assert_allclose(many["angle_rmse"][0], alone.metrics["angle_rmse"], rtol=1e-6)


@pytest.mark.slow
def test_derivatives_by_the_numbers_of_a_path():
    plant, step = plant_of("bone and cam", mk.FirstOrderValve(0.02)), 1e-5
    controller, name = controller_of("loops", plant), "joint.geometry.path2.arm"
    found = mk.differentiate(plant, controller, REFERENCE, [name], metrics=["angle_rmse"], **TIMES)
    moved = mk.simulate_many(
        plant, controller, REFERENCE, over={name: [0.028 - step, 0.028 + step]}, metrics=["angle_rmse"], **TIMES
    )["angle_rmse"]
    expected = float(moved[1] - moved[0]) / (2 * step)
    assert float(np.squeeze(found.gradients["angle_rmse"][name])) == pytest.approx(expected, rel=1e-4)
