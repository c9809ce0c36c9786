"""Muscles as an actuator of Newton, on the CPU, against the plant in 64 bits; without Newton, most is skipped."""

import dataclasses
import importlib
import re
from importlib import metadata
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import ExportError
from mckibben.export.episodes import plants_of

VARIED = ["valve.time_constant=10..50 ms", "command_delay=3 ms"]
KNEE = "examples/pre-contracted-step-pid.yaml", [*VARIED, "joint.muscle.strength=+-10 %"], 5e4
FIT = "examples/your-muscle/joint.yaml", [*VARIED, "joint.muscle.law=fit"], 2e4  # with friction, on pulleys
PERIOD, STEPS, DELAY, WORLDS, SEED = 1e-3, 5, 3, 3, 4
STEP = PERIOD / STEPS
TOLERANCE = 1e-5  # rad


def commands_of(swing, periods):
    swing = swing * np.sin(12 * PERIOD * np.arange(periods))
    return np.stack([2.5e5 + swing, 3e5 - swing], -1)


@pytest.fixture
def newton():
    return pytest.importorskip("newton", reason="the extra newton is not installed")


class Simulated:
    """Joints of a scenario in Newton, one per world."""

    def __init__(self, newton, scenario, random_plant):
        from mckibben.export.newton import muscle_joint

        self.joint = muscle_joint(scenario, STEP, random_plant, plants=WORLDS, seed=SEED)
        one, builder = newton.ModelBuilder(), newton.ModelBuilder()
        one.add_articulation([self.joint.add_to(one)])
        one.joint_armature[0] = float(self.joint.plant.load.damping) * STEP / 2  # the solver's velocity is that late
        builder.replicate(one, WORLDS)
        self.model = builder.finalize()  # on a GPU if there is one
        self.solver = newton.solvers.SolverFeatherstone(self.model)
        self.states = [self.model.state(), self.model.state()]
        self.control, (self.actuator,) = self.model.control(), self.model.actuators
        self.held = [self.actuator.state(), self.actuator.state()]

    def angles(self, commands):
        from mckibben.export.newton import COMMANDS

        found = []
        for now in commands:
            for name, values in zip(COMMANDS, now, strict=True):
                getattr(self.control, name).fill_(values)
            for _ in range(STEPS):
                self.control.joint_f.zero_()
                self.actuator.step(self.states[0], self.control, *self.held, dt=STEP)
                self.solver.step(*self.states, self.control, None, STEP)
                self.states.reverse()
                self.held.reverse()
            found.append(self.states[0].joint_q.numpy().copy())
        return np.array(found)


@eqx.filter_jit
def wanted(plant, state, commands):
    """Angles of a plant without delay after each control period."""

    def period(state, commands):
        state = plant.advance(state, (commands[0], commands[1]), PERIOD, STEPS)
        return state, state.angle

    return jax.lax.scan(period, state, commands)[1]


@pytest.mark.slow
@pytest.mark.parametrize("given", [KNEE, FIT])
def test_a_second_in_newton_agrees_in_every_world(given, newton):
    scenario, plants = mk.Scenario.read(given[0]), plants_of(mk.Scenario.read(given[0]), given[1], WORLDS, SEED)
    start = scenario.initial(scenario.plant())
    commands = commands_of(given[2], 1000)
    late = np.concatenate([np.repeat(commands[:1], DELAY, axis=0), commands[:-DELAY]])
    angles = []
    for row in range(WORLDS):
        plant = dataclasses.replace(plants.row(row)[0].plant, command_delay=None)
        angles.append(np.asarray(wanted(plant, plant.complete_state(start), late)))
    angles = np.stack(angles, -1)
    assert np.min(np.ptp(angles, axis=0)) > 0.05
    assert np.max(np.abs(angles[:, 0] - angles[:, 1])) > 1e-3
    np.testing.assert_allclose(Simulated(newton, *given[:2]).angles(commands), angles, atol=TOLERANCE)


@pytest.mark.slow
def test_a_joint_begins_anew_after_a_reset_and_the_others_go_on(newton):
    import warp as wp

    simulated, again = Simulated(newton, *FIT[:2]), Simulated(newton, *FIT[:2])
    commands = commands_of(5e4, 40)
    found = simulated.angles(commands)
    assert np.min(np.abs(found[-1] - found[0])) > 1e-3
    again.angles(commands[:15])
    again.held[0].reset(wp.array([False, True, False], dtype=bool))
    first = simulated.model.joint_q.numpy()[1], simulated.model.joint_qd.numpy()[1]
    for name, value in zip(("joint_q", "joint_qd"), first, strict=True):
        values = getattr(again.states[0], name).numpy()
        values[1] = value
        getattr(again.states[0], name).assign(values)
    newton.eval_fk(again.model, again.states[0].joint_q, again.states[0].joint_qd, again.states[0])
    np.testing.assert_allclose(again.angles(commands[:25])[:, 1], found[:25, 1], atol=1e-7)
    kept, copied = again.held
    copied.assign(kept)
    np.testing.assert_array_equal(copied.drive_state.act.numpy(), kept.drive_state.act.numpy())


@pytest.mark.slow
def test_the_example_of_the_documentation_runs(newton):
    page = Path("docs/export-simulators.md").read_text()
    (example,) = re.findall(r"## Newton\n.*?```py\n(.*?)```", page, re.DOTALL)
    names = {}
    exec(example, names)
    angles = names["state"].joint_q.numpy()
    assert np.all(angles > 0.02)
    assert np.ptp(angles) > 1e-3


@pytest.mark.slow
def test_draws_of_a_fit_have_its_covariance_and_are_those_of_both_muscles():
    scenario = mk.Scenario.read(FIT[0])
    joint = plants_of(
        scenario, ["joint.muscle.law=fit", "joint.muscle.strength=+-10 %"], 2000, SEED
    ).varying.plant.joint
    fit = read_fit(Path("examples/your-muscle/fit/fit.yaml"))
    draws = np.stack([getattr(joint.muscle1.law, name) for name in fit.estimates])
    scale = np.sqrt(np.diag(fit.robust_covariance))
    deviation = (draws - np.array(list(fit.estimates.values()))[:, None]) / scale[:, None]
    np.testing.assert_allclose(np.cov(deviation), fit.robust_covariance / np.outer(scale, scale), atol=0.1)
    np.testing.assert_allclose(np.mean(deviation, axis=1), 0, atol=0.1)
    np.testing.assert_array_equal(joint.muscle1.law.decay, joint.muscle2.law.decay)  # type: ignore[attr-defined]
    for path, varied in ((KNEE[0], "joint.muscle.law=fit"), (FIT[0], "load.mass=fit")):
        with pytest.raises(ExportError) as caught:
            plants_of(mk.Scenario.read(path), [varied], 3, SEED)
        assert (caught.value.field, caught.value.value) == ("random_plant", varied)


@pytest.mark.parametrize(
    ("package", "version"), [("newton", "1.6.1"), ("newton", "2.0.0"), ("mjlab", "1.5.2"), ("mjlab", "1.7rc1")]
)
def test_other_versions_are_refused(package, version, monkeypatch):
    pytest.importorskip("warp", reason="the extra warp is not installed")
    monkeypatch.setattr(metadata, "version", lambda name: version)
    monkeypatch.delitem(importlib.sys.modules, f"mckibben.export.{package}", raising=False)  # type: ignore[attr-defined]
    with pytest.raises(ExportError) as caught:
        importlib.import_module(f"mckibben.export.{package}")
    assert (caught.value.field, caught.value.value) == (package, version)


def test_another_time_step_and_parts_that_cannot_be_exported_are_refused(newton, tmp_path):
    from mckibben.export.newton import muscle_joint

    simulated = Simulated(newton, *KNEE[:2])
    assert simulated.joint.left_out[0].startswith("controller")
    with pytest.raises(ExportError) as caught:
        simulated.actuator.step(simulated.states[0], simulated.control, *simulated.held, dt=2 * STEP)
    assert (caught.value.field, caught.value.value) == ("timestep", 2 * STEP)
    path = tmp_path / "springs.yaml"
    text = Path(KNEE[0]).read_text()
    path.write_text(text.replace("  # tendon: {", "  tendon: {"))
    with pytest.raises(ExportError) as caught:
        muscle_joint(path, STEP)
    assert caught.value.field == "tendon"
    assert "variation of load.mass2" in muscle_joint(KNEE[0], STEP, ["load.mass2=+-50 %"], plants=4).left_out
