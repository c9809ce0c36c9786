"""A selection meets its requirement: by hand, with the forces at both ends, in a run; or it says what is possible."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq

import mckibben as mk
from mckibben import catalog
from mckibben.errors import ParameterError, UnreachableError
from mckibben.identification import fit_law
from mckibben.mechanism.disturbance import TorquePulses
from mckibben.muscle import ChouLaw, Muscle
from mckibben.muscle.air import DENSITY, L_PER_S_BAR
from mckibben.reachability import Make, Requirement, catalog_makes, read_make, size
from mckibben.reachability.air_supply import tube_conductance
from mckibben.units import bar, deg, mm

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("optimized")]  # programs run for long

LOAD = mk.PendulumLoad(2.0, 250 * mm)
NEED = Requirement(LOAD, (-30 * deg, 30 * deg), 2.0, 6 * bar, stiffness=(15.0, 18.0), torque=1.0)


@pytest.fixture(scope="module")
def twenty():
    return catalog_makes()[1]  # fitted to data: not where each worker imports the file


@pytest.fixture(scope="module")
def found():
    return size(NEED)


def eq2(law, eps, p):
    """Force of Eq. 2, written out."""
    a1, a2, b1, b2, c1, c2, mu = (float(getattr(law, n)) for n in ("a1", "a2", "b1", "b2", "c1", "c2", "decay"))
    return (a1 + a2 * p) + (b1 + b2 * p) * eps + (c1 + c2 * p) * np.exp(-mu * eps)


def test_the_reserve_is_the_torque_and_the_inertia_of_the_sine_by_hand():
    """2 kg at 0.25 m, 30 deg at 0.5 Hz: I A w^2 = 0.125 * 0.5236 * 9.87 = 0.646 N*m."""
    assert NEED.reserve == pytest.approx(1.0 + 2.0 * 0.25**2 * np.pi / 6 * np.pi**2, rel=1e-12)


def test_the_torque_of_a_candidate_is_that_of_a_hand_calculation(found, twenty):
    """At an end of the motion: the working muscle at 90 % of the supply, the other at its lowest pressure."""
    one = next(one for one in found.candidates if one.name == twenty.name)
    length, radius = one.lengths["muscle_length"], one.lengths["radius"]
    law, shift = twenty.muscle.law, radius * 30 * deg / length
    contraction = 1 - one.lengths["path1.rest_length"] / length
    highest, lowest = 5.4 * bar, 0.65 * bar
    pulling, lengthened = contraction + shift, contraction - shift
    force = eq2(law, pulling, highest) - max(eq2(law, lengthened, lowest), 5.0)
    gravity = 2.0 * 9.81 * 0.25 * np.sin(30 * deg)
    assert one.torque[1] == pytest.approx(radius * force - gravity, rel=1e-6)
    assert one.torque[0] < one.torque[1] < one.torque[2]
    assert one.torque[0] >= NEED.reserve


def test_candidates_attain_the_stiffness_with_forces_at_both_ends_of_their_uncertainty(found):
    angles = np.linspace(*NEED.angles, 41)
    for one in found.candidates:
        assert 0.1 <= one.uncertainty <= 0.3
        for factor in (1 - one.uncertainty, 1.0, 1 + one.uncertainty):
            joint = one.plant.joint
            muscle = dataclasses.replace(joint.muscle1, strength=factor * float(joint.muscle1.strength or 1.0))
            joint = dataclasses.replace(joint, muscle1=muscle, muscle2=muscle)
            for reserve in (-NEED.reserve, NEED.reserve):
                low, high = joint.attainable_stiffness(angles, reserve - LOAD.gravity_torque(angles))
                assert np.all(low <= 15.0) and np.all(high >= 18.0)


def test_candidates_are_in_the_order_of_their_air_and_rejected_makes_have_a_reason(found):
    air = [one.supply.air for one in found.candidates]
    assert air == sorted(air) and found.best is found.candidates[0]
    assert {one.name for one in found.candidates} | {name for name, _ in found.rejected} == {
        make.name for make in catalog_makes()
    }
    assert all(reason for _, reason in found.rejected)
    candidates, parts = found.listings()
    assert len(candidates.rows()) == len(found.candidates) and len(parts.rows()) == 6


def test_pulleys_are_not_wider_and_muscles_not_longer_than_allowed(found, twenty):
    widest = found.best.lengths["radius"] - 0.2 * mm
    assert size(dataclasses.replace(NEED, widest=widest, stiffness=None), [twenty]).best.lengths["radius"] <= widest
    shorter = dataclasses.replace(NEED, longest=found.best.lengths["muscle_length"] - 20 * mm)
    with pytest.raises(UnreachableError):
        size(shorter, [twenty])


def test_the_scenario_of_each_candidate_meets_the_requirement(found, tmp_path):
    for one in found.candidates:
        file = tmp_path / f"{one.name}.yaml"
        found.scenario(one).to_yaml(file)
        scenario = mk.Scenario.read(file)
        assert scenario == found.scenario(one)
        result = scenario.simulate()
        assert all(check.met for check in found.verify(result))
        angle, stiffness = np.asarray(result["angle"]), np.asarray(result["stiffness"])
        assert angle.min() == pytest.approx(-30 * deg, abs=0.2 * deg)
        assert angle.max() == pytest.approx(30 * deg, abs=0.2 * deg)
        assert stiffness[0] == pytest.approx(15.0, rel=0.02) and stiffness[-1] == pytest.approx(18.0, rel=0.02)
        held = 2.0 * 9.81 * 0.25 * np.sin(30 * deg) - 2.0 * 0.25**2 * np.pi / 6 * np.pi**2  # gravity less inertia
        assert np.asarray(result["torque"])[angle.argmax()] == pytest.approx(held, rel=0.05)
        consumed = result.metrics["air"] / 3  # of a cycle, at 1 atm and a polytropic index of 1.2
        assert one.supply.air == pytest.approx(consumed, rel=0.15)


def test_the_scenario_bears_the_required_torque(found):
    """As a disturbance over most of the run, in both directions."""
    for sign in (-1, 1):
        pushed = mk.Scenario.parse(found.scenario().dumps()).model_copy(
            update={"disturbance": TorquePulses(height=sign * NEED.torque, width=3.0, interval=10.0, start=1.0)}
        )
        result = pushed.simulate()
        assert not result.outcome.failed
        assert result.metrics["angle_rmse"] < 0.5 * deg


def test_air_supply_by_hand(found):
    """A cycle takes 5 % of the absolute supply from the reservoir; the compressor gives 1.3 times the mean."""
    supply = found.best.supply
    mass = supply.air * DENSITY
    assert supply.reservoir == pytest.approx(mass * 288.0 * 293.15 / (0.05 * (6 * bar + 101325.0)))
    assert supply.compressor == pytest.approx(1.3 * supply.air / 2.0)
    assert float(supply.valve.conductance) >= 2 * supply.needed
    assert tube_conductance(supply.tube, 1.0) >= 4 * supply.needed


@pytest.mark.parametrize("diameter", [2.5, 4.0, 5.7, 8.0, 11.0])
def test_the_conductance_of_a_tube_is_that_of_choked_flow_with_friction(diameter):
    """Fanno flow of 1 m: friction factor of a smooth tube at the Reynolds number of the choked flow from 6 bar."""
    d, kappa, gas, temperature, viscosity = diameter * mm, 1.4, 287.0, 293.15, 1.82e-5
    area, inlet, mach = np.pi / 4 * d**2, 7e5, 0.3
    for _ in range(50):  # friction factor and Mach number at the inlet, in turn
        density = inlet / (gas * temperature)
        reynolds = density * mach * np.sqrt(kappa * gas * temperature) * d / viscosity
        length = 0.316 * reynolds**-0.25 * 1.0 / d  # Blasius

        def excess(m, length=length):
            expansion = np.log((kappa + 1) * m**2 / (2 + (kappa - 1) * m**2))
            return (1 - m**2) / (kappa * m**2) + (kappa + 1) / (2 * kappa) * expansion - length

        mach = brentq(excess, 1e-3, 1.0)
    flow = inlet * area * mach * np.sqrt(kappa / (gas * temperature))
    total = inlet * (1 + (kappa - 1) / 2 * mach**2) ** (kappa / (kappa - 1))  # pressure at rest, before the tube
    assert tube_conductance(d, 1.0) == pytest.approx(flow / (1.185 * total), rel=0.25)
    assert tube_conductance(d, 4.0) < tube_conductance(d, 1.0)


LIGHT = {"load": mk.PendulumLoad(0.1, 0.1), "angles": (-5 * deg, 5 * deg), "torque": 0.0, "stiffness": None}


@pytest.mark.parametrize(
    ("change", "make", "limit"),
    [
        ({"torque": 300.0}, 1, "Festo 20 mm: limited by"),
        ({"stiffness": (400.0, 500.0)}, 1, "Festo 20 mm: limited by"),
        ({"longest": 0.1}, 1, "Festo 20 mm: limited by"),
        ({"longest": 0.1, "stiffness": None, "torque": 0.0}, 2, "the shortest of these muscles"),
        ({"widest": 3 * mm, "stiffness": None}, 1, "the narrowest pulley"),
        ({"supply": 0.6 * bar, **LIGHT}, 1, "law begins at"),
    ],
)
def test_an_impossible_requirement_names_the_limits_of_each_make(change, make, limit):
    with pytest.raises(UnreachableError) as caught:
        size(dataclasses.replace(NEED, **change), [catalog_makes()[make]])
    assert limit in str(caught.value) and caught.value.remedy


def test_a_fast_motion_is_limited_by_the_valves(twenty):
    need = dataclasses.replace(NEED, load=mk.GeneralLoad(inertia=1e-3, greatest_gravity_torque=0.0), torque=0.5)
    slow = size(need, [twenty]).best.supply
    fast = size(dataclasses.replace(need, cycle=1.0), [twenty]).best.supply
    assert fast.needed == pytest.approx(2 * slow.needed, rel=0.3)
    with pytest.raises(UnreachableError):
        size(dataclasses.replace(need, cycle=0.05), [twenty])


def test_without_a_required_stiffness_the_run_takes_the_middle_of_the_attainable_range():
    need = dataclasses.replace(NEED, stiffness=None, angles=(-20 * deg, 50 * deg))
    found = size(need)
    assert {one.name for one in found.candidates} == {make.name for make in catalog_makes()}
    for one in found.candidates:
        assert float(one.plant.joint.contractions(15 * deg, (2 * bar, 2 * bar))[0]) == pytest.approx(
            1 - (one.lengths["path1.rest_length"] + one.lengths["radius"] * 15 * deg) / one.lengths["muscle_length"]
        )
        low, high = one.plant.joint.attainable_stiffness(-20 * deg, -LOAD.gravity_torque(-20 * deg))
        assert low < found.scenario(one).start.stiffness < high
        assert all(check.met for check in found.verify(found.scenario(one).simulate()))


def test_a_muscle_file_is_a_make_with_the_uncertainty_of_its_fit(tmp_path):
    data = catalog.dataset("dmsp-10-250-martens2017")
    fit = fit_law(mk.ExponentialLaw, data)
    fit.to_yaml(tmp_path / "fit.yaml")
    (tmp_path / "muscle.yaml").write_text("specimen: DMSP-10-250\nlaw: fit.yaml\n")
    make = read_make(tmp_path / "muscle.yaml", 0.0)
    at_points = fit.force_intervals(data.taut.contraction, data.taut.pressure).prediction
    least = np.mean(np.asarray(at_points.upper - at_points.lower)) / 2
    between = fit.force_intervals(0.1, 4 * bar).prediction
    rms = float(np.sqrt(np.mean(data.taut.force**2)))
    assert least / rms < make.uncertainty < float(between.upper - between.lower) / rms
    assert read_make(tmp_path / "muscle.yaml", 0.1).uncertainty == pytest.approx(np.hypot(0.1, make.uncertainty))


def gravity_excess(plant, need):
    """Torque in either direction in excess of gravity, without friction."""
    angles = np.linspace(*need.angles, 61)
    low, high = plant.joint.attainable_torque(angles, minimum_tension=5.0)
    held = -LOAD.gravity_torque(angles)
    return float(np.minimum(high - held, held - low).min())


def test_friction_takes_its_torque():
    """The band of the working muscle is nearly its half width, that of the other one nearly its tension, 5 N."""
    ten = catalog_makes()[0]
    rubbing = Muscle(ten.muscle.specimen, ten.muscle.law, mk.MaxwellSlip(12.0, 0.5 * mm))
    need = dataclasses.replace(NEED, stiffness=None, torque=0.0)
    plain, found = (size(need, [Make("ten", muscle, 0.0)]).best for muscle in (ten.muscle, rubbing))
    lost = gravity_excess(found.plant, need) - found.torque[1]
    assert lost == pytest.approx((12.0 + 12.0 * np.tanh(5.0 / 12.0)) * found.lengths["radius"], rel=1e-3)
    assert found.lengths["muscle_length"] >= plain.lengths["muscle_length"] and found.torque[1] >= need.reserve


def test_friction_is_that_of_the_highest_pressure_and_speed():
    """For the largest torque one muscle has 90 % of the supply; its tension makes the band narrower than B."""
    ten = catalog_makes()[0]
    growing = mk.MaxwellSlip(7.0, 0.5 * mm, growth=60 / bar, reference_pressure=3.5 * bar)
    viscous = mk.MaxwellSlip(12.0, 0.5 * mm, viscous=100.0)
    need = dataclasses.replace(NEED, stiffness=None, torque=0.0)
    muscles = [Muscle(ten.muscle.specimen, ten.muscle.law, friction) for friction in (growing, viscous)]
    first, second = (size(need, [Make("ten", muscle, 0.0)]).best for muscle in muscles)
    lost = [(gravity_excess(one.plant, need) - one.torque[1]) / one.lengths["radius"] for one in (first, second)]
    highest = 7.0 + 60 * (5.4 - 3.5)
    assert 0.8 * highest < lost[0] < highest
    damping = 100.0 * second.lengths["radius"] * np.pi / 6 * np.pi
    band = 12.0 * np.tanh(5.0 / 12.0)
    opposing = band + min(damping, 5.0 - band)  # a muscle under 5 N never pushes
    assert lost[1] == pytest.approx(12.0 + damping + opposing, rel=1e-2)


def test_a_braid_gives_a_make_by_chous_law():
    braid = mk.Specimen(
        "braid", 200 * mm, initial_diameter=12 * mm, braid_angle=25 * deg, domain=mk.Domain(-0.03, 0.25, 0.0, 5 * bar)
    )
    light = dataclasses.replace(NEED, load=mk.PendulumLoad(0.5, 150 * mm), torque=0.0, stiffness=(3.0, 3.0))
    found = size(light, [Make.of("braid", Muscle(braid, ChouLaw.of(braid)), None)])
    assert found.best.name == "braid" and found.best.uncertainty == pytest.approx(0.1)
    assert L_PER_S_BAR * 0.01 < found.best.supply.needed < L_PER_S_BAR


def test_a_law_that_is_not_affine_and_no_makes_are_refused():
    smooth = fit_law(mk.SmoothLaw, catalog.dataset("festo-tool-10mm")).law
    for makes in ([Make.of("smooth", Muscle(catalog.specimen("DMSP-10-250"), smooth), None)], []):
        with pytest.raises(ParameterError):
            size(NEED, makes)


def test_makes_without_a_volume_or_with_an_impossible_spread_are_refused():
    muscle = catalog_makes()[0].muscle
    unknown = dataclasses.replace(muscle.specimen, initial_diameter=None, braid_angle=None, volume_terms=None)
    for field, given, spread in (
        ("specimen", dataclasses.replace(muscle, specimen=unknown), 0.1),
        ("spread", muscle, -0.1),
        ("spread", muscle, 1.2),
    ):
        with pytest.raises(ParameterError) as refused:
            Make.of("mine", given, None, spread)
        assert refused.value.field == field
