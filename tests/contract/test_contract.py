"""The contract: all built-in classes keep it, and one class for each check that breaks it is found."""

import dataclasses
import importlib
import pkgutil
import textwrap
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import mckibben
from mckibben import catalog, control, joint, leg, muscle, plant
from mckibben.component.base import Component
from mckibben.component.classes import concrete_subclasses
from mckibben.contract import check_class, check_extension
from mckibben.contract.probes import plant_scope
from mckibben.control import Constant, Reference, Setpoint, Signal, Sine
from mckibben.errors import ParameterError
from mckibben.joint import Geometry, KneeLoad, MusclePath, PendulumLoad
from mckibben.leg.mechanism import BiarticularMuscle, Leg, LegJoint, Link, Trunk
from mckibben.leg.plant import LegPlant
from mckibben.muscle import Creep, Domain, ForceLaw, Friction, MaxwellSlip, NoCreep, NoFriction
from mckibben.plant import FirstOrderValve, Valve
from mckibben.study.rig.document import MountedMuscle
from mckibben.units import Bandwidth, Length, MomentArm, PositiveTime, Quantity, SignalValue, bar, deg, mm

for module in pkgutil.walk_packages(mckibben.__path__, "mckibben."):
    if not module.name.startswith(("mckibben.cli", "mckibben.web", "mckibben.__main__")):
        importlib.import_module(module.name)
CLASSES = {
    kind.__name__: kind
    for kind in concrete_subclasses(Component)
    if kind.__module__.startswith("mckibben.") and not kind.__name__.startswith("_")
}

BOX, ANGLE, DIAMETER = Domain(-0.03, 0.25, 0.0, 6e5), 25 * deg, 10 * mm
EQ_3 = [getattr(catalog.law("lei-mas-10-180n"), p.name) for p in muscle.ExponentialLaw.parameters()]
S0, S1, S2 = (np.array([[8.0, -20.0, 30.0, 10.0, -15.0, 5.0]]) * [[1.0], [0.3e-5], [0.05e-10]]).tolist()
CHOU = muscle.ChouLaw(ANGLE, DIAMETER, BOX)
TONDU = muscle.TonduLopezVariableLaw(ANGLE, DIAMETER, 0.2, 1.2, BOX)
CORRECTION = muscle.ForceCorrection((-20.0, 5.0), (1e-5, 0.0), 0.1, 0.05)
KNEE, LOAD = plant_scope()["joint"], plant_scope()["load"]
SPECIMEN = KNEE.muscle1.specimen
SLIP = MaxwellSlip(12.0, 0.5 * mm, growth=1e-5, tension_growth=0.02, viscous=20.0, elements=4)
ROUGH = dataclasses.replace(KNEE.muscle1, friction=SLIP)
TWO_BONES, PULLEY = joint.TwoBonePath(-0.02, 0.30, -0.03, 0.0), joint.Pulley(25 * mm, 0.3)
PID = control.PID(2 * bar, 60 * bar, 0.4 * bar)
LOOPS = control.PositionStiffnessControl(PID, control.PID(8e3, 5e5, 0.0), model=KNEE)
REFERENCE = Reference(Sine(0.1, 1.0), 15.0)
TIMED = leg.TimedReference((REFERENCE, REFERENCE))
PHASES = [(Setpoint(0.1 * k, 15.0), Setpoint(0.2 * k, 20.0)) for k in range(4)]
EXAMPLES = [
    CHOU,
    muscle.TonduLopezLaw(ANGLE, DIAMETER, 1.25, BOX),
    TONDU,
    muscle.TsagarakisCaldwellLaw(2e4, ANGLE, DIAMETER, 5e-4, 0.1, BOX),
    muscle.MartensBoblanLaw(300.0, 20.0, ANGLE, DIAMETER, BOX),
    muscle.ReppergerLaw(200.0, 3e-3, 0.28, BOX),
    muscle.ReynoldsLaw(100.0, 1.4e-3, 1400.0, 3e-3, BOX),
    muscle.HuntLaw(254.3e3, 1230.0, 192e3, 0.22, Domain(0.0, 0.2, 0.0, 5e5)),
    catalog.law("sarosi-dmsp-10"),
    catalog.law("lei-mas-10-180n"),
    muscle.SmoothAffineLaw(*EQ_3[:6], *S0, *S1, EQ_3[6], 0.11, 0.28, BOX),
    muscle.SmoothLaw(*EQ_3[:6], *S0, *S1, EQ_3[6], 0.11, 0.28, *S2, BOX),
    muscle.SpringLaw(1000.0, 180 * mm),
    *(muscle.scaled_law(law, 1.1) for law in (CHOU, TONDU)),
    *(muscle.corrected_law(law, CORRECTION) for law in (CHOU, TONDU)),
    CORRECTION,
    SLIP,
    muscle.MaxwellCreep(500.0, 5.0, arms=2),
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
    joint.GeneralLoad(0.02, 0.5),
    KNEE,
    plant.FirstOrderValve(0.05, rate=10 * bar),
    plant.SecondOrderValve(60.0, damping=0.5),
    plant.FlowValve(5e-9, 7 * bar),
    plant.PressureRegulator(5e-9, 7 * bar, time_constant=0.02, reservoir_volume=1e-3, line_conductance=5e-9),
    plant.SwitchingValves(5e-9, 7 * bar, period=0.02),
    plant.SampledSensors(0.01 * deg, 1e3, 0.5, 3),
    plant.TorquePulses(0.5),
    plant.JointFriction(0.3, elements=3),
    plant.JointPlant(KNEE, LOAD, FirstOrderValve(0.02)),
    Constant(0.1),
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
    control.ExtendedStateObserver(damping=2.5),
    LOOPS,
    control.DecouplingControl(KNEE, LOAD, control.PolePlacement()),
    control.InverseModelControl(LOOPS, LOAD),
    control.FrictionCompensation(LOOPS, model=joint.AntagonisticJoint(KNEE.geometry, ROUGH, ROUGH)),
    control.SupplyLimit(LOOPS),
    leg.PressureSchedule(levels=((1e5, 4e5), (2e5,)), switches=((1.25e-3,), ())),
    TIMED,
    leg.JointwiseControl((LOOPS, LOOPS), TIMED),
    leg.PhasedReference(*PHASES),
]
INSTANCES = {type(one).__name__: one for one in EXAMPLES}
SLOW = {
    name
    for name, kind in CLASSES.items()
    if issubclass(kind, control.Controller | leg.LegController) and kind is not leg.PressureSchedule
} | {"HuntLaw", "BackpropPID"}


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, id=name, marks=[pytest.mark.slow] * (name in SLOW)) for name, kind in CLASSES.items()]
)
def test_every_built_in_class_keeps_it(kind):
    instances = [INSTANCES[kind.__name__]] if kind.__name__ in INSTANCES else []
    findings = check_class(kind, instances=instances)
    assert [one for one in findings if one.passed is not True] == []
    assert {"units", "tree"} <= {one.check for one in findings}
