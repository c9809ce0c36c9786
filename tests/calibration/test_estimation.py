"""Calibration on recordings that obey the equation of motion of a known joint exactly, but for noise."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from mckibben import catalog
from mckibben.calibration import (
    JointCalibration,
    JointEstimate,
    JointPrior,
    JointRecording,
    calibrate_joint,
    read_joint_recording,
)
from mckibben.calibration.equations import COEFFICIENTS, OF_MUSCLE, PARAMETERS, derivatives, halves_of, problem_of
from mckibben.calibration.estimation import minimised, quantities_of, supported
from mckibben.calibration.fitting import LocalMinimum
from mckibben.dataset import Recipe
from mckibben.errors import DatasetError, IdentificationError, RangeError, ScenarioError
from mckibben.joint import ScaledArms
from mckibben.muscle import ForceCorrection, adjusted_law
from mckibben.numerics.compiled import jit
from mckibben.units import deg

pytestmark = pytest.mark.usefixtures("optimized")
NOISE = 2e3  # Pa
DISTANCE, GRAVITY = 0.2, 9.81


def knee(*corrections):
    joint = catalog.joint("knee-table-2")
    muscles = {
        name: dataclasses.replace(
            getattr(joint, name), law=adjusted_law(getattr(joint, name).law, correction=correction)
        )
        for name, correction in zip(("muscle1", "muscle2"), corrections, strict=False)
    }
    return dataclasses.replace(joint, geometry=dataclasses.replace(joint.geometry, connector_length=0.208), **muscles)


def creep_of(lengths, period, stiffness, time_constant=2.0):
    """Force of a Maxwell arm along a path, by the closed form for a constant rate over each period."""
    force, decay = np.zeros(lengths.size), np.exp(-period / time_constant)
    gain = stiffness * time_constant / period * (1 - decay)
    for k, moved in enumerate(np.diff(lengths)):
        force[k + 1] = decay * force[k] + gain * moved
    return force


@jit
def balanced(joint, load, motion, first, mass, creeping):
    """Pressures, of which the first is given, and tensions that the equation of motion asks for."""
    angle, _, acceleration = motion
    needed = load.required_torque(*motion) + mass * DISTANCE**2 * acceleration
    needed = needed - mass * DISTANCE * GRAVITY * jnp.sin(load.hanging_angle - angle)
    arm1, arm2 = joint.geometry.moment_arms(angle)
    needed = needed - arm2 * creeping[:, 1] + arm1 * creeping[:, 0]
    torque = joint.affine_map(angle).torque
    pressures = first, (needed - torque.offset - torque.slope1 * first) / torque.slope2
    each = zip((joint.muscle1, joint.muscle2), joint.contractions(angle, pressures), pressures, strict=True)
    tensions = [muscle.tension(contraction, pressure) for muscle, contraction, pressure in each]
    return jnp.stack(pressures, axis=1), jnp.stack(tensions, axis=1)


def recording(joint, load, mass, rng, *, seconds=14.0, rate=250.0, creep=0.0):
    """Sweeps: one pressure is given, the other one is what the equation of motion asks for."""
    time = np.arange(0.0, seconds, 1 / rate)
    slow, fast = 2 * np.pi * 3 / seconds, 2 * np.pi
    angle = 7 * deg * np.sin(slow * time) + 1 * deg * np.sin(fast * time)
    acceleration = -(slow**2) * 7 * deg * np.sin(slow * time) - fast**2 * 1 * deg * np.sin(fast * time)
    velocity = np.gradient(angle, time)
    first = 4.7e5 + 0.5e5 * np.sin(2 * np.pi * 2 / seconds * time)
    paths = joint.geometry.paths_and_arms(angle)[0]
    creeping = np.stack([creep_of(np.asarray(path), 1 / rate, creep) for path in paths], axis=1)
    pressures, tensions = map(np.asarray, balanced(joint, load, (angle, velocity, acceleration), first, mass, creeping))
    assert tensions.min() > 10.0
    noisy = pressures + NOISE * rng.standard_normal(pressures.shape)
    return JointRecording(time, angle, noisy, None, mass, DISTANCE), pressures, tensions + creeping


LOAD = catalog.load("knee-table-2")
TRUE = knee(
    ForceCorrection((12.0, -8.0, 0.0), (2e-5, -4e-5, 0.0), 0.1, 0.04),
    ForceCorrection((-6.0, -10.0, 0.0), (-1e-5, -3e-5, 0.0), 0.1, 0.04),
)
TRUE_LOAD = dataclasses.replace(LOAD, mass2=0.4)


@pytest.fixture(scope="module")
def recorded():
    rng = np.random.default_rng(5)
    return [recording(TRUE, TRUE_LOAD, mass, rng) for mass in (0.0, 0.5)]


@pytest.fixture(scope="module")
def with_weight(recorded):
    return calibrate_joint(knee(), LOAD, [one for one, _, _ in recorded])


def stiffness_errors(found, recorded):
    one, pressures, _ = recorded[0]
    pair, angle = (pressures[::25, 0], pressures[::25, 1]), one.angle[::25]
    true = np.asarray(TRUE.evaluate(angle, pair)[1])
    (value, deviation), (before, wide) = found.stiffness(angle, pair), found.prior_stiffness(angle, pair)
    return value - true, deviation, before - true, wide


@pytest.mark.slow
def test_a_weight_tells_the_stiffness_and_the_mass(with_weight, recorded):
    error, deviation, before, wide = stiffness_errors(with_weight, recorded)
    assert np.sqrt(np.mean(error**2)) < 0.35 * np.sqrt(np.mean(before**2))
    assert np.mean(np.abs(error) < 1.96 * deviation) > 0.8
    assert np.all(deviation < 0.3 * wide)
    mass = with_weight.quantities["load.mass"]
    assert abs(mass.value - 0.4) < 2 * mass.deviation < mass.prior * 2
    assert with_weight.residual < 0.02  # N*m, that of the noise
    friction = with_weight.quantities["friction"]
    assert 0 < friction.value < 1.0  # N; there is none
    assert friction.deviation > 0.02  # at the least value, too


@pytest.mark.slow
def test_derivatives_are_difference_quotients(recorded):
    rng = np.random.default_rng(2)
    halves = halves_of(recorded[0][0])
    problem = problem_of(knee(), LOAD, [halves], JointPrior())
    z, directions = rng.standard_normal((2, PARAMETERS, 1))
    step = 1e-6

    def errors(z):
        return derivatives((problem, z[:, 0], halves[0]), directions)

    _, slope = errors(z)
    quotient = (errors(z + step * directions)[0] - errors(z - step * directions)[0]) / (2 * step)
    np.testing.assert_allclose(slope, quotient, atol=1e-5)


@pytest.mark.parametrize(("change", "kept"), [(1.5, True), (2.0, False)])
def test_a_quantity_that_is_hardly_told_from_that_before_stays_as_before(change, kept):
    """Deviation 0.5, of 1 before: the density at no change over that before is 2 exp(-(change / 0.5)^2 / 2)."""
    covariance = np.array([[0.25, 0.2], [0.2, 1.0]])
    before = LocalMinimum(np.array([change * 0.5, 1.0]), covariance)
    slopes = np.array([[3.0, 0.0], [4.0, 0.0]])
    (after,), found = supported([before], lambda z: (slopes @ z, slopes))
    assert found == kept == (2 * np.exp(-(change**2) / 2) > 10**-0.5)
    moved = covariance[:, 0] / covariance[0, 0] * before.z[0] if kept else np.zeros(2)  # that of the conditional mean
    np.testing.assert_allclose(after.z, before.z - moved, atol=1e-12)
    np.testing.assert_allclose(after.covariance, covariance + np.outer(moved, moved), atol=1e-12)


@pytest.mark.slow
def test_a_model_that_is_right_keeps_its_stiffness_and_its_muscles_hardly_scatter():
    rng = np.random.default_rng(3)
    recordings = [recording(knee(), LOAD, mass, rng)[0] for mass in (0.0, 0.5)]
    found = calibrate_joint(knee(), LOAD, recordings)
    at = recordings[0].angle[::25], (recordings[0].pressures[::25, 0], recordings[0].pressures[::25, 1])
    (after, _), (before, deviation) = found.stiffness(*at), found.prior_stiffness(*at)
    stated = calibrate_joint(knee(), LOAD, recordings[:1], JointPrior(strength=0.1)).prior_stiffness(*at)[1]
    assert found.kept and after == pytest.approx(before, abs=0.05)
    assert np.all(deviation < 0.5 * stated)


def test_the_model_with_the_estimates_has_their_stiffness(with_weight):
    angle, pressures = np.array([0.05]), (np.array([4.8e5]), np.array([4.5e5]))
    value, _ = with_weight.stiffness(angle, pressures)
    assert np.asarray(with_weight.joint.evaluate(angle, pressures)[1]) == pytest.approx(value, rel=1e-9)
    assert not with_weight.joint.has_creep  # the model had none


@pytest.mark.slow
def test_under_one_load_the_stiffness_stays_uncertain(recorded, with_weight):
    alone = calibrate_joint(knee(), LOAD, [recorded[0][0]])
    assert np.mean(stiffness_errors(alone, recorded)[1]) > 1.5 * np.mean(stiffness_errors(with_weight, recorded)[1])
    assert not alone.quantities["added_mass"].determined


@pytest.mark.slow
def test_load_cells_take_the_place_of_the_weight_and_tell_creep():
    rng, creep = np.random.default_rng(7), 1200.0
    made = recording(TRUE, TRUE_LOAD, 0.0, rng, seconds=20.0, creep=creep)
    tensions = made[2] + 0.5 * rng.standard_normal(made[2].shape)
    cells = dataclasses.replace(made[0], tensions=tensions)
    found, blind = (calibrate_joint(knee(), LOAD, [cells], JointPrior(creep=share)) for share in (0.05, 1e-6))
    error, deviation, before, _ = stiffness_errors(found, [made])
    assert np.sqrt(np.mean(error**2)) < 0.35 * np.sqrt(np.mean(before**2))
    assert np.mean(np.abs(error) < 1.96 * deviation) > 0.8
    assert np.mean(stiffness_errors(blind, [made])[0] ** 2) > 4 * np.mean(error**2)
    for name in ("muscle1.creep", "muscle2.creep"):
        one = found.quantities[name]
        assert one.determined
        assert one.value == pytest.approx(creep, rel=0.25)  # one arm of 2 s as arms of 1, 3 and 10 s


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda r: [dataclasses.replace(r, time=r.time[:450], angle=r.angle[:450], pressures=r.pressures[:450])], 450),
        (lambda r: [dataclasses.replace(r, angle=0 * r.angle)], None),
        (lambda r: [dataclasses.replace(r, angle=np.where(np.arange(r.angle.size) == 7, np.nan, r.angle))], None),
        (lambda _: [], None),
    ],
)
def test_recordings_that_tell_nothing_are_refused(recorded, change, field):
    with pytest.raises(IdentificationError) as caught:
        calibrate_joint(knee(), LOAD, change(recorded[0][0]))
    assert caught.value.remedy
    if field is not None:
        assert caught.value.value == field


@pytest.mark.slow
@pytest.mark.parametrize(
    "change", [lambda r: {"angle": -r.angle}, lambda r: {"pressures": r.pressures[:, ::-1]}], ids=["sign", "order"]
)
def test_recordings_that_contradict_the_model_are_told_from_others(recorded, change):
    wrong = [dataclasses.replace(one, **change(one)) for one, _, _ in recorded]
    try:
        texts = " ".join(remark.text for remark in calibrate_joint(knee(), LOAD, wrong).remarks())
    except IdentificationError as error:
        texts = str(error)
    assert "contradict the model" in texts or "does not describe" in texts


@pytest.mark.slow
def test_a_misfit_is_remarked_and_widens_all_deviations(recorded, with_weight):
    """The weight was in the other recording: estimates near the prior, and large errors."""
    assert with_weight.misfit < 0.5 * with_weight.noise
    assert "residual" not in {remark.field for remark in with_weight.remarks()}
    wrong = [dataclasses.replace(one, added_mass=0.5 - one.added_mass) for one, _, _ in recorded]
    found = calibrate_joint(knee(), LOAD, wrong)
    assert found.misfit**2 == pytest.approx(found.residual**2 - found.noise**2) and found.misfit > 3 * found.noise
    assert "residual" in {remark.field for remark in found.remarks()}
    pair = (np.array([4.8e5]), np.array([4.5e5]))
    assert found.stiffness(0.0, pair)[1] > 3 * with_weight.stiffness(0.0, pair)[1]


@pytest.mark.slow
def test_a_recording_that_was_held_out_tells_which_model_predicts_better(recorded, with_weight):
    rng = np.random.default_rng(11)
    of_the_model_before = recording(knee(), LOAD, 0.0, rng)[0]
    for held_out, better in ((recorded[0][0], True), (of_the_model_before, False)):
        fit = dataclasses.replace(with_weight, held_out=(held_out,))
        before, after = fit.errors(held_out)
        assert fit.predicts == (after < before) == better
        assert ("held_out" in {remark.field for remark in fit.remarks()}) != better
        assert list(fit.listings())[-1].rows()[-1][1] == "held out"


def test_friction_that_two_minima_exchange_is_determined_in_sum_only(recorded):
    """Each minimum alone has small deviations."""
    halves = halves_of(recorded[0][0])
    problem = problem_of(knee(), LOAD, [halves], JointPrior())
    z, narrow = np.zeros(PARAMETERS), 0.05**2 * np.eye(PARAMETERS)
    first, second = 2 * COEFFICIENTS, 2 * COEFFICIENTS + OF_MUSCLE  # friction of each muscle
    minima = []
    for exchange in (1.2, -1.2):
        at = z.copy()
        at[[first, second]] = exchange, -exchange
        minima.append(LocalMinimum(at, narrow, 0.5))
    quantities = quantities_of(problem, minima)
    assert not quantities["muscle1.friction"].determined and not quantities["muscle2.friction"].determined
    assert quantities["friction"].determined
    fit = JointCalibration(quantities, knee(), LOAD, (), problem, tuple(minima), 0.0, 0.0, 0.0)
    ratios = fit.combinations()
    assert len(ratios) == 2 and all("muscle1.friction" in name and "muscle2.friction" in name for name in ratios)
    traded = next(name for name, ratio in ratios.items() if ratio > 0.5)
    assert ("+" in traded) and ("-" in traded), "one grows as the other falls"
    together = next(name for name, ratio in ratios.items() if ratio < 0.5)
    assert ("+" in together) != ("-" in together), "their product is determined"
    assert min(ratios.values()) < 0.1
    alone = quantities_of(problem, minima[:1])
    assert alone["muscle1.friction"].determined and alone["muscle2.friction"].determined


def test_scaled_arms_keep_the_length_at_their_angle():
    geometry = catalog.joint("knee-table-2").geometry
    scaled = ScaledArms(geometry, 0.98, angle=0.1)
    assert scaled.path_lengths(0.1)[0] == pytest.approx(float(geometry.path_lengths(0.1)[0]))
    arms, before = scaled.moment_arms(0.3), geometry.moment_arms(0.3)
    assert [float(a / b) for a, b in zip(arms, before, strict=True)] == pytest.approx([0.98, 0.98])


@pytest.mark.parametrize(("name", "value"), [("mass", 0.0), ("zero", -1e-3), ("strength", np.nan), ("supply", np.inf)])
def test_prior_deviations_are_above_0_and_finite(name, value):
    with pytest.raises(RangeError) as caught:
        JointPrior(**{name: value})
    assert caught.value.field == name


def test_a_prior_is_read_from_a_file_with_units(tmp_path):
    (tmp_path / "prior.yaml").write_text("mass: 5 %\nzero: 1.2 deg\npressure_zero: 2 kPa\n", encoding="utf-8")
    found = JointPrior.read(tmp_path / "prior.yaml")
    assert found == JointPrior(mass=0.05, zero=1.2 * deg, pressure_zero=2e3)
    (tmp_path / "prior.yaml").write_text("mas: 5 %\nzero: 0 deg\n", encoding="utf-8")
    with pytest.raises(ScenarioError) as refused:
        JointPrior.read(tmp_path / "prior.yaml")
    assert {problem.field for problem in refused.value.problems} == {"mas", "zero"}


@pytest.mark.parametrize(("scale", "named"), [(0.93, True), (0.97, False)])
def test_moment_arms_that_contradict_their_prior_are_named(scale, named):
    quantities = {"arm_scale": JointEstimate(scale, 0.005, 0.02, "1", expected=1.0)}
    minima = (LocalMinimum(np.zeros(1), np.eye(1)),)
    problem = SimpleNamespace(prior={"scatter": 1.0})
    found = JointCalibration(quantities, knee(), LOAD, (), problem, minima, 0.0, 0.0, 0.0)
    assert ("arm_scale" in {remark.field for remark in found.remarks()}) == named


def test_the_search_finds_the_minimum_that_scipy_finds_and_stops_above_a_ceiling():
    def terms(z):
        """A curved valley, Rosenbrock's, with a prior."""
        x, y = z
        value = 50 * (y - x**2) ** 2 + (1 - x) ** 2 + z @ z / 2
        gradient = np.array([-200 * x * (y - x**2) - 2 * (1 - x), 100 * (y - x**2)]) + z
        curvature = np.array([[600 * x**2 - 200 * y + 2, -200 * x], [-200 * x, 100.0]]) + np.eye(2)
        return value, gradient, curvature

    start = np.array([-1.2, 1.0])
    found, value, _ = minimised(terms, start, iterations=100, tolerance=1e-12)
    np.testing.assert_allclose(found, minimize(lambda z: terms(z)[0], start, tol=1e-10).x, atol=1e-5)
    assert minimised(terms, start, ceiling=value - 1)[1] > value


def test_a_recording_of_uneven_samples_with_named_columns_is_read(tmp_path):
    time = np.cumsum(np.random.default_rng(0).uniform(0.002, 0.012, 3000))
    rows = np.column_stack([1e3 * time, 10 * np.sin(time), 200 + 0 * time, 300 + 10 * np.cos(time)])
    path = tmp_path / "rig.csv"
    np.savetxt(path, rows, "%.5f", ";", header="millis;Winkel [deg];Druck links [kPa];p2 [kPa]", comments="")
    with pytest.raises(DatasetError, match="Druck links"):
        read_joint_recording(path)
    recording = read_joint_recording(path, Recipe(columns={"Druck links [kPa]": "pressure1_kPa"}))
    np.testing.assert_allclose(recording.pressures[:, 1], 1e3 * rows[:, 3])
    first, second = halves_of(recording)
    np.testing.assert_allclose(first.angle, second.angle, atol=1e-5)
    assert np.ptp(first.angle) == pytest.approx(20 * deg, rel=1e-3)
    rest = (time < 5) | (time > 5.2)
    changes = {name: getattr(recording, name)[rest] for name in ("time", "angle", "pressures")}
    with pytest.raises(IdentificationError, match=r"ms apart at 4\.9"):
        halves_of(dataclasses.replace(recording, **changes))
