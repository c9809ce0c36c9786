"""Calibration on recordings that obey the equation of motion of a known joint exactly, but for noise."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben import catalog
from mckibben.actuator import FirstOrderValve
from mckibben.calibration import (
    JointCalibration,
    JointEstimate,
    JointPrior,
    JointRecording,
    calibrate_joint,
    calibrate_robot,
    estimation,
    read_joint_recording,
)
from mckibben.calibration.equations import _errors, linearised, problem_of, samples_of
from mckibben.calibration.fitting import LocalMinimum
from mckibben.calibration.models import HingeModel, RobotModel, Weight
from mckibben.calibration.recordings import check_recording
from mckibben.calibration.service import Follower, Recursion, follow, write_posterior, write_settings
from mckibben.calibration.serving import InService, read_estimate, serve
from mckibben.control import DecouplingControl, PolePlacement, Reference
from mckibben.dataset import Recipe
from mckibben.errors import DatasetError, IdentificationError, RangeError, ScenarioError
from mckibben.joint import ScaledArms
from mckibben.mechanism import Body, Joint, MusclePair, Place, Robot
from mckibben.muscle import ForceCorrection, adjusted_law
from mckibben.numerics.compiled import jit
from mckibben.rig.channels import Channels
from mckibben.rig.compiled import ControlProgram
from mckibben.scenario import Scenario
from mckibben.units import SLIDE, deg
from tests.calibration import foreign

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


def recording(joint, load, mass, rng, *, seconds=14.0, rate=250.0, creep=0.0, fast=1.0):
    """Sweeps: one pressure is given, the other one is what the equation of motion asks for."""
    time = np.arange(0.0, seconds, 1 / rate)
    slow, fast = 2 * np.pi * round(seconds / 5) / seconds, 2 * np.pi * fast
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
    assert np.all(deviation < 0.35 * wide)
    mass = with_weight.quantities["load.mass"]
    assert abs(mass.value - 0.4) < 2 * mass.deviation < mass.prior * 2
    assert with_weight.unexplained < 0.1
    friction = with_weight.quantities["friction"]
    assert 0 < friction.value < 2.5  # N; there is none
    assert friction.deviation > 0.02  # at the least value, too


@pytest.mark.slow
def test_derivatives_are_difference_quotients(recorded):
    rng = np.random.default_rng(2)
    model = HingeModel(knee(), LOAD)
    recorded = samples_of(model, recorded[0][0])
    problem = problem_of(model, [recorded], JointPrior())
    z, direction = rng.standard_normal((2, problem.size)) * 0.5
    step = 1e-6
    errors, slopes = linearised(problem, z, recorded)
    at = jax.jit(lambda z: _errors(problem, z, recorded.samples, recorded.weight, 0.0))
    (above, high), (below, low), (_, gain) = (at(z + sign * step * direction) for sign in (1, -1, 0))
    np.testing.assert_allclose(slopes @ direction, (above / high - below / low) * gain / (2 * step), atol=1e-5)
    np.testing.assert_allclose(errors, at(z)[0])


@pytest.mark.slow
def test_a_model_that_is_right_keeps_its_stiffness():
    rng = np.random.default_rng(3)
    recordings = [recording(knee(), LOAD, mass, rng)[0] for mass in (0.0, 0.5)]
    found = calibrate_joint(knee(), LOAD, recordings)
    at = recordings[0].angle[::25], (recordings[0].pressures[::25, 0], recordings[0].pressures[::25, 1])
    (after, deviation), (before, wide) = found.stiffness(*at), found.prior_stiffness(*at)
    assert np.all(np.abs(after - before) < 1.96 * deviation) and np.all(deviation < 0.5 * wide)


WEIGHTS = 0.4, 2.0  # kg


@pytest.fixture(scope="module")
def foreign_rigs():
    """Rigs whose law, friction, creep and valves are no model's, 15 s each slow and fast, bare and with each weight.

    Of each: recordings by weight, the measured angles and pressures of some samples, and their true stiffness.
    """
    law, count = knee().muscle1.law, 8
    force = lambda e, p: np.asarray(law.force(e, p))  # noqa: E731
    inertia, moment, hanging = map(float, (LOAD.total_inertia, LOAD.gravity_moment, LOAD.hanging_angle))
    rng = np.random.default_rng(2)
    length = float(knee().muscle1.specimen.initial_length)
    rigs = foreign.draw(rng, count, force, length, 0.9 * length, 0.03, inertia, moment, hanging)
    masses = np.repeat([0.0, *WEIGHTS], 2)
    parts = foreign.Parts(masses, np.tile([False, True], 3))
    mean = 4.9e5, 0.6e5
    amplitude = foreign.adapted(rigs, parts, 0.0, mean)
    time, angles, pressures = foreign.simulate(rigs, parts, 0.0, mean, amplitude)
    angle, both = np.moveaxis(angles[::1000], 0, 1), np.moveaxis(pressures[::1000], 0, 1)
    true = rigs.stiffness(angle.reshape(count, -1), both.reshape(count, -1, 2), step=1 * deg).reshape(angle.shape)
    found = []
    for rig in range(count):
        recordings = {}
        for part, mass in enumerate(masses):
            read = foreign.measured(rng, angles[:, rig, part], pressures[:, rig, part], rigs.zero[rig, 0])
            own = JointRecording(time, *read, None, mass, parts.distance, mass * 0.02**2)
            recordings.setdefault(mass, []).append(own)
        at = (angle + rigs.zero[:, :, None])[rig], (both[rig, ..., 0], both[rig, ..., 1])
        found.append((recordings, at, true[rig]))
    return found


@pytest.mark.slow
def test_stiffness_of_rigs_of_another_law(foreign_rigs):
    errors, before, inside, distances = [], [], [], []
    for recordings, at, true in foreign_rigs:
        found = calibrate_joint(knee(), LOAD, [*recordings[0], *recordings[0.4]], JointPrior(mass=0.02, inertia=0.05))
        assert found.unexplained < 0.1
        distances += [each.distance for each in found.quantities.values() if each.expected is not None]
        (value, deviation), (prior, _) = found.stiffness(*at), found.prior_stiffness(*at)
        errors.append(np.mean(np.square(value - true)) / true.mean() ** 2)
        before.append(np.mean(np.square(prior - true)) / true.mean() ** 2)
        inside.append(np.mean(np.abs(value - true) < 1.96 * deviation))
    print(
        np.sqrt(np.mean(errors)),
        0.5 * np.sqrt(np.mean(before)),
        np.mean(inside),
        np.sqrt(np.mean(np.square(distances))),
    )
    assert np.sqrt(np.mean(errors)) < 0.05 < 0.5 * np.sqrt(np.mean(before)) + 0.01
    assert np.mean(inside) > 0.85
    assert np.sqrt(np.mean(np.square(distances))) < 1.4  # 1 for priors that are right


@pytest.mark.slow
def test_torques_do_not_shrink_together_where_the_recordings_count_for_more(foreign_rigs, monkeypatch):
    """All but the weight may: errors of the equation of motion as such would lose 20 to 28 % of stiffness."""
    recordings, at, true = foreign_rigs[2]
    variance = estimation._variance
    monkeypatch.setattr(estimation, "_variance", lambda *args: 0.03 * variance(*args))
    found = calibrate_joint(knee(), LOAD, [*recordings[0], *recordings[0.4]], JointPrior(mass=0.02, inertia=0.05))
    assert abs(np.mean(found.stiffness(*at)[0] / true) - 1) < 0.1


@pytest.mark.slow
def test_a_weight_that_is_not_the_stated_one_is_named(foreign_rigs):
    """It gives the scale of the stiffness, and motion whose inertia is known contradicts another one."""
    named = 0
    for recordings, _, _ in foreign_rigs[:4]:
        heavier = [dataclasses.replace(one, added_mass=1.25 * one.added_mass) for one in recordings[2.0]]
        prior = JointPrior(mass=0.02, inertia=0.05)
        remarks = calibrate_joint(knee(), LOAD, [*recordings[0], *heavier], prior).remarks()
        named += bool({"added_mass", "distance"} & {remark.field for remark in remarks})
    assert named >= 3


@pytest.mark.slow
def test_the_model_with_the_estimates_has_their_stiffness(with_weight):
    angle, pressures = np.array([0.05]), (np.array([4.8e5]), np.array([4.5e5]))
    value, _ = with_weight.stiffness(angle, pressures)
    assert np.asarray(with_weight.joint.evaluate(angle, pressures)[1]) == pytest.approx(value, rel=1e-9)
    assert not with_weight.joint.has_creep  # the model had none


@pytest.mark.slow
def test_under_one_load_the_stiffness_stays_uncertain(recorded, with_weight):
    alone = calibrate_joint(knee(), LOAD, [recorded[0][0]])
    assert np.mean(stiffness_errors(alone, recorded)[1]) > 1.2 * np.mean(stiffness_errors(with_weight, recorded)[1])
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
        assert 0.5 * creep < one.value < creep + 2 * one.deviation  # one arm of 2 s as arms of 1, 3 and 10 s


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


def test_a_recording_lasts_to_the_end_of_its_last_sample():
    """A part of 5 s at 250 Hz, the shortest of `mckibben calibrate`, ends at 4.996 s."""
    time = np.arange(1250) / 250
    check_recording(JointRecording(time, 0 * time, np.ones((time.size, 2))))
    with pytest.raises(IdentificationError) as caught:
        check_recording(JointRecording(time[1:], time[1:], np.ones((time.size - 1, 2))))
    assert caught.value.value == 1249


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
    assert "residual" not in {remark.field for remark in with_weight.remarks()}
    wrong = [dataclasses.replace(one, added_mass=0.5 - one.added_mass) for one, _, _ in recorded]
    found = calibrate_joint(knee(), LOAD, wrong)
    assert found.residual > 3 * with_weight.residual
    assert {"residual", "added_mass"} & {remark.field for remark in found.remarks()}
    pair = (np.array([4.8e5]), np.array([4.5e5]))
    assert found.stiffness(0.0, pair)[1] > 2 * with_weight.stiffness(0.0, pair)[1]


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
    (tmp_path / "prior.yaml").write_text("zero: 2 mm\n", encoding="utf-8")
    of_a_slide = JointPrior.read(tmp_path / "prior.yaml", SLIDE)
    assert (of_a_slide.zero_of(SLIDE), JointPrior().zero_of(SLIDE)) == pytest.approx((2e-3, 1.2e-3))
    (tmp_path / "prior.yaml").write_text("mas: 5 %\nzero: 0 deg\n", encoding="utf-8")
    with pytest.raises(ScenarioError) as refused:
        JointPrior.read(tmp_path / "prior.yaml")
    assert {problem.field for problem in refused.value.problems} == {"mas", "zero"}


@pytest.mark.parametrize(("scale", "named"), [(0.93, True), (0.97, False)])
def test_moment_arms_that_contradict_their_prior_are_named(scale, named):
    quantities = {"arm_scale": JointEstimate(scale, 0.005, 0.02, "1", expected=1.0)}
    found = JointCalibration(quantities, HingeModel(knee(), LOAD), (), None, None, 0.0, 0.0)
    assert ("arm_scale" in {remark.field for remark in found.remarks()}) == named


def test_a_recording_of_uneven_samples_with_named_columns_is_read(tmp_path):
    time = np.cumsum(np.random.default_rng(0).uniform(0.002, 0.012, 3000))
    rows = np.column_stack([1e3 * time, 10 * np.sin(time), 200 + 0 * time, 300 + 10 * np.cos(time)])
    path = tmp_path / "rig.csv"
    np.savetxt(path, rows, "%.5f", ";", header="millis;Winkel [deg];Druck links [kPa];p2 [kPa]", comments="")
    with pytest.raises(DatasetError, match="Druck links"):
        read_joint_recording(path)
    recording = read_joint_recording(path, Recipe(columns={"Druck links [kPa]": "pressure1_kPa"}))
    np.testing.assert_allclose(recording.pressures[:, 1], 1e3 * rows[:, 3])
    model = HingeModel(knee(), LOAD)
    samples = samples_of(model, recording).samples
    assert np.ptp(samples.angle) == pytest.approx(20 * deg, rel=1e-3)
    rest = (time < 5) | (time > 5.2)
    changes = {name: getattr(recording, name)[rest] for name in ("time", "angle", "pressures")}
    with pytest.raises(IdentificationError, match=r"ms apart at 4\.9"):
        samples_of(model, dataclasses.replace(recording, **changes))


LEG = Channels((".hip", ".left knee"), (".hip1", ".hip2", ".left knee1", ".left knee2"))


def test_columns_of_a_robot_have_the_names_of_its_joints_and_muscles(tmp_path):
    time = np.arange(1000) / 100
    names = ["Angle.left knee [deg]", "hip", *(f"pressure.{end[1:]}_kPa" for end in LEG.muscles)]
    rows = np.column_stack([time, 10 * np.sin(time), 5 * np.cos(time), *(100 * k + 0 * time for k in (1, 2, 3, 4))])
    path, recipe = tmp_path / "run.csv", Recipe(columns={"hip": "angle.hip_deg"})
    np.savetxt(path, rows, "%.5f", ",", header=",".join(["time_s", *names]), comments="")
    recording = read_joint_recording(path, recipe, LEG)
    np.testing.assert_allclose(recording.angle, np.radians(rows[:, [2, 1]]), atol=1e-6)
    np.testing.assert_allclose(recording.pressures, 1e3 * rows[:, 3:])
    with pytest.raises(DatasetError, match=r"angle\.hip"):
        read_joint_recording(path, None, LEG)
    with pytest.raises(DatasetError, match="command"):
        path.write_text(path.read_text(encoding="utf-8").replace("pressure.hip1", "command.hip1"), encoding="utf-8")
        read_joint_recording(path, recipe, LEG)


def robot_of(joint, load):
    """The joint as a robot with one hinge."""
    mass = float(load.mass1 + load.mass2)
    arm = float(load.gravity_moment) / GRAVITY / mass
    shank = Body("shank", mass, Place(z=-arm), (float(load.total_inertia) - mass * arm**2, 1e-4))
    hinge = Joint("knee", (0, -1, 0), -0.3, 0.3, "shank", offset=-float(load.hanging_angle), damping=load.damping)
    return Robot((Body("base", 1.0), shank), (hinge,), (MusclePair("knee", joint.geometry, *joint.muscles),))


@pytest.mark.slow
def test_a_robot_of_one_hinge_gives_what_the_joint_gives(recorded):
    motion = (0.1,), (0.3,), (2.0,), Weight()
    torques = [model.required(*motion) for model in (HingeModel(knee(), LOAD), RobotModel(robot_of(knee(), LOAD)))]
    np.testing.assert_allclose(*torques, rtol=1e-12)
    prior, recordings = JointPrior(arm_scale=1e-6), [recorded[0][0]]
    joint, robot = (
        calibrate_joint(knee(), LOAD, recordings, prior),
        calibrate_robot(robot_of(knee(), LOAD), recordings, prior),
    )
    at = np.array([-0.1, 0.0, 0.1]), (np.full(3, 4.8e5), np.full(3, 4.5e5))
    np.testing.assert_allclose(robot.stiffness(*at)[0], joint.stiffness(*at)[0], rtol=1e-2)  # of mass2, of the shank
    assert robot.quantities["knee.zero"].value == pytest.approx(joint.quantities["zero"].value, abs=0.2 * deg)
    sliding = dataclasses.replace(robot_of(knee(), LOAD), base="vertical")
    for refused, recording in ((robot_of(knee(), LOAD), recorded[1][0]), (sliding, recordings[0])):
        with pytest.raises(IdentificationError) as caught:  # a weight; a base that moves
            calibrate_robot(refused, [recording], prior)
        assert caught.value.remedy


def test_a_recording_of_other_joints_is_refused(recorded):
    one = recorded[0][0]
    with pytest.raises(IdentificationError) as caught:
        calibrate_joint(knee(), LOAD, [dataclasses.replace(one, pressures=np.tile(one.pressures, 2))])
    assert caught.value.value == (1, 4)


def weaker(force):
    return {
        name: dataclasses.replace(getattr(TRUE, name), law=adjusted_law(getattr(TRUE, name).law, strength=force))
        for name in ("muscle1", "muscle2")
    }


@pytest.mark.slow
@pytest.mark.parametrize(("force", "most"), [(1.0, 0.035), (0.9, 0.05)])
def test_stiffness_in_service_is_followed(with_weight, force, most):
    """Motion of 2 Hz and 0.2 Hz, which 30 s later tells muscles that are 10 % weaker, with an interval."""
    rng, aged = np.random.default_rng(8), dataclasses.replace(TRUE, **weaker(force))
    parts = [recording(joint, TRUE_LOAD, 0.0, rng, seconds=s, fast=2.0) for joint, s in ((TRUE, 10.0), (aged, 30.0))]
    first, second = (one for one, _, _ in parts)
    time = np.concatenate([first.time, first.time[-1] + 4e-3 + second.time])
    columns = {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in ("angle", "pressures")}
    found = follow(with_weight, JointRecording(time, **columns))
    last = (time > found.times[-1] - 2.0) & (time <= found.times[-1])
    angle, pressures = columns["angle"][last], columns["pressures"][last]
    true = np.mean(aged.evaluate(angle, tuple(pressures.T))[1])
    assert found.known[-1] and abs(found.stiffness[-1, 0] / true - 1) < most
    assert abs(found.stiffness[-1, 0] - true) < 1.96 * found.deviation[-1, 0]
    assert force == 1.0 or found.calibrated[-1, 0] / true > 1.07
    assert found.followed[-1] and not found.reasons[-1] and not found.followed[0]  # nothing had moved before


@pytest.mark.slow
def test_the_model_follows_what_is_known_and_within_its_limit(with_weight):
    """Samples of half a second at a time, as from a rig; at rest the stiffness is not known, and the model is kept."""
    rng, aged = np.random.default_rng(9), dataclasses.replace(TRUE, **weaker(0.9))
    one = recording(aged, TRUE_LOAD, 0.0, rng, seconds=20.0, fast=2.0)[0]
    followers = [Follower(with_weight.posterior, limit=limit) for limit in (0.25, 0.01)]
    before = with_weight.posterior.minimum.z
    for follower in followers:
        for part in np.array_split(np.arange(one.time.size), 40):
            follower.add(one.time[part], one.angle[part], one.pressures[part])
    (followed, limited), blocks = followers, followers[0].result()
    assert blocks.followed[-1] and np.any(followed.z != before)
    assert limited.z is before and "1%" in limited.result().reasons[-1]
    rest = one.time[-1] + np.arange(1, 15001) * 4e-3
    still = np.full(rest.size, one.angle[-1]), np.tile(one.pressures[-1], (rest.size, 1))
    z = followed.z
    followed.add(rest, *still)
    after = followed.result()
    assert not after.known[-1] and not after.followed[-1] and after.reasons[-1]
    assert np.all(np.diff(after.deviation[-5:, 0]) > 0)  # what is known is forgotten
    assert followed.z is z or not np.array_equal(followed.z, before)


@pytest.mark.slow
def test_the_model_of_a_controller_follows_the_estimate(with_weight, tmp_path):
    """From the files of a calibration, with samples as of a rig: the numbers of a controller that has the estimate."""
    scenario = Scenario(
        name="aged",
        joint=knee(),
        load=TRUE_LOAD,
        controller=DecouplingControl(knee(), LOAD, feedback=PolePlacement(40.0), valve=FirstOrderValve(0.02)),
        reference=Reference(0.0, 17.0),
        duration=1.0,
        control_period=2e-3,
    )
    write_posterior(scenario, with_weight.posterior, tmp_path / "estimate.json")
    write_settings(tmp_path / "service.yaml")
    settings = InService.read(tmp_path / "service.yaml")
    np.testing.assert_array_equal(
        read_estimate(settings.estimate).minimum.covariance, with_weight.posterior.minimum.covariance
    )
    joint = dataclasses.replace(TRUE, **weaker(0.9))
    one = recording(joint, TRUE_LOAD, 0.0, np.random.default_rng(9), seconds=20.0, fast=2.0)[0]
    samples = np.column_stack([one.time, one.angle, one.pressures])
    serving = serve(scenario, settings, elsewhere=False)
    before = ControlProgram(serving.scenario.control().with_period(2e-3)).numbers
    numbers = serving.add(samples)
    assert numbers.shape == before.shape and np.any(numbers != before)
    at = one.angle[-1], tuple(one.pressures[-1])
    models = serving._parts()["model"], serving.scenario.control().model
    followed, calibrated = (float(model.evaluate(*at)[1]) for model in models)
    told = serving.result()
    assert followed / calibrated == pytest.approx(told.stiffness[-1, 0] / told.calibrated[-1, 0], abs=0.01)
    assert followed < 0.99 * calibrated
    assert serving.add(samples[-1:] + np.array([2e-3, 0.0, 0.0, 0.0])) is None  # no further block
    assert serving.result().followed[-1]
    assert serve(scenario, dataclasses.replace(settings, follow=False), elsewhere=False).add(samples) is None
    (tmp_path / "estimate.json").write_text('{"scenario": 1}', encoding="utf-8")
    with pytest.raises(IdentificationError) as caught:
        read_estimate(settings.estimate)
    assert caught.value.field == "estimate" and caught.value.remedy


def test_a_recursion_forgets_measurements_but_not_the_calibration():
    """Measurements of one parameter, whose value changes from 1 to 3: the old ones fade by the factor of each block."""
    calibrated = LocalMinimum(np.zeros(2), np.eye(2))
    recursion = Recursion(calibrated, np.diag([9.0, 0.0]), 1, keep=0.5)
    assert recursion.update(np.zeros((0, 1)), np.zeros((0, 1, 2)), np.zeros(1)) is recursion.estimate  # no sample yet
    slopes, rng = np.zeros((200, 1, 2)), np.random.default_rng(0)
    slopes[..., 0] = 1.0

    def after(value, blocks):
        for _ in range(blocks):
            errors = recursion.estimate.z[:1] - value + 0.1 * rng.standard_normal((200, 1))
            recursion.update(errors, slopes, np.full(1, 1e-3))
        return recursion.estimate

    first = after(1.0, 8)
    assert first.z[0] == pytest.approx(1.0, abs=0.1) and first.z[1] == 0.0
    assert 1.3 < after(3.0, 1).z[0] < 2.7  # it has seen as much of the one as of the other
    assert after(3.0, 8).z[0] == pytest.approx(3.0, abs=0.1)
    known = recursion.estimate.deviations
    for _ in range(40):
        recursion.update(np.zeros((0, 1)), np.zeros((0, 1, 2)), np.zeros(1))
    assert known[0] < 0.5 and recursion.estimate.deviations == pytest.approx([np.sqrt(10), 1.0], rel=1e-3)
