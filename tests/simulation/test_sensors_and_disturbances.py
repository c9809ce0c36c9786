"""Real sensors and pushes in the loop: alike in single runs, batches, 32 bits, and beside a run without its step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import IdealValve
from mckibben.control import Constant, Controller, Reference, Step
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, NoDisturbance, PerfectSensors, PlantState, SampledSensors, TorquePulses
from mckibben.simulation import compiled_episode, episode, sampled, simulate_many, without_last_change
from mckibben.units import deg

PERIOD, PERIODS, AT = 1e-3, 60, 30
COUNT, NOISE = 0.022 * deg, 4e3
REAL = SampledSensors(encoder=COUNT, pressure_noise=NOISE, delay=1.0, seed=5)
PULSES = TorquePulses(0.5, 0.01, 0.02, 0.005)
START = PlantState(0.05, 0.0, (4e5, 3.6e5))
REFERENCE = Reference(angle=Constant(0.0), stiffness=Step(13.0, 17.0, AT * PERIOD))


class Listener(Controller):
    """Follows its sensors, and `share` of the desired stiffness; it reports its measurements."""

    share: float = 0.0
    pick: int = 0

    def init(self, measurement):
        return measurement

    def step(self, state, setpoint, measurement, period):
        pressure1, pressure2 = measurement.pressures
        differential = 1e5 * measurement.angle + 0.3 * (pressure2 - pressure1)
        both = 3.8e5 + 1e4 * self.share * (setpoint.stiffness - 13.0)
        return measurement, (both - differential, both + differential)

    def telemetry(self, state):
        told = jnp.stack([state.angle, *state.pressures])
        picked = jnp.where(self.pick == 0, told[0], jnp.where(self.pick == 1, told[1], told[2]))
        return {"stiffness_estimate": picked, "told": told}


@pytest.fixture(scope="module")
def plant(knee, load):
    return JointPlant(knee, load, IdealValve(), sensors=REAL, disturbance=PULSES)


@pytest.fixture(scope="module")
def heard(plant):
    """The record of a short run, what was told in it, and the plant's last state; of 32 bits its types."""
    setpoints = sampled(REFERENCE, PERIODS * PERIOD, PERIOD)[1]

    def heard(sensors=REAL, disturbance=PULSES, *, share=0.0, start=START, step=True, kind=jnp.float64):
        other = JointPlant(plant.joint, plant.load, plant.valve, sensors=sensors, disturbance=disturbance)
        asked = setpoints if step else without_last_change(setpoints)
        given = numeric(other), numeric(Listener(share)), asked, other.complete_state(numeric(start)), PERIOD
        given = cast(jax.tree.map(jnp.asarray, numeric(given)), kind)
        if kind == jnp.float32:
            return jax.eval_shape(lambda *given: episode(*given, 2), *given)[::-1]
        final, record = compiled_episode(*given, 2)
        return record, np.asarray(record.telemetry["told"]), final

    return heard


@pytest.fixture(scope="module")
def alone(heard):
    return heard()


@pytest.mark.slow
def test_sensors_without_faults_and_pushes_of_nothing_change_nothing(heard, plant):
    """And where neither is given nothing of them is in the program: state and reading pass as they are."""
    plain, ours = heard(PerfectSensors(), NoDisturbance()), heard(SampledSensors(), TorquePulses(0.0))
    assert plain[0].state.io == () and ours[0].state.io != ()
    for name in ("angle", "velocity", "pressures"):
        np.testing.assert_allclose(getattr(plain[0].state, name), getattr(ours[0].state, name), rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(plain[1], np.stack([plain[0].state.angle, *plain[0].state.pressures], axis=1))
    np.testing.assert_allclose(plain[1], ours[1], rtol=1e-12)
    ideal = JointPlant(plant.joint, plant.load, plant.valve)
    state, told = ideal.sample(START, PERIOD)
    assert ideal.complete_state(START) == state == START
    assert told == (START.angle, START.pressures)


@pytest.mark.slow
def test_a_run_that_goes_on_hears_and_feels_what_comes_next(heard, alone):
    _, _, final = alone
    record, seen, _ = heard(start=final)
    assert np.asarray(record.state.io.sample).tolist() == list(range(PERIODS + 1, 2 * PERIODS + 1))
    np.testing.assert_array_equal(seen[0], np.stack(jax.tree.leaves(final.io.sensors)))
    off = seen[1:, 1] - np.asarray(record.state.pressures[0])[:-1]
    before = alone[1][1:, 1] - np.asarray(alone[0].state.pressures[0])[:-1]
    assert np.abs(off - before).min() > 0  # the noise does not begin anew
    went_on = np.concatenate([alone[0].state.io.disturbance, record.state.io.disturbance])
    since = np.arange(2 * PERIODS) - 5  # 10 periods to, 10 of rest, 10 fro, 10 of rest
    np.testing.assert_array_equal(
        went_on, np.select([since < 0, since % 40 < 10, since // 10 % 4 == 2], [0, 0.5, -0.5])
    )


KEPT = ("stiffness_estimate", "angle", "stiffness", "desired_stiffness", "pressure1", "pressure2", "air1", "air2")


@pytest.fixture(scope="module")
def batch(plant):
    """Seeds, noise, the part of the reference that is followed, and what is reported differ."""
    return simulate_many(
        plant,
        Listener(),
        REFERENCE,
        over={
            "sensors.seed": [5, 6, 5, 5],
            "sensors.pressure_noise": [NOISE, NOISE, 0.0, NOISE],
            "controller.pick": [1, 2, 2, 0],
            "controller.share": [0.0, 0.0, 0.0, 1.0],
        },
        duration=PERIODS * PERIOD,
        substeps=2,
        initial=START,
        metrics=("angle_rmse", "coupling", "air"),
        keep=KEPT,
        workers=1,
    )


@pytest.mark.slow
def test_runs_side_by_side_hear_what_each_hears_alone(batch, heard):
    kept = {name: batch.table[name].to_numpy() for name in ("stiffness_estimate", "angle")}
    for run, (seed, size, pick, share) in enumerate(
        [(5, NOISE, 1, 0.0), (6, NOISE, 2, 0.0), (5, 0.0, 2, 0.0), (5, NOISE, 0, 1.0)]
    ):
        sensors = SampledSensors(encoder=COUNT, pressure_noise=size, delay=1.0, seed=seed)
        record, seen, _ = heard(sensors, share=share)
        np.testing.assert_allclose(kept["stiffness_estimate"][run], seen[:, pick], rtol=1e-12)
        np.testing.assert_allclose(kept["angle"][run], record.state.angle, rtol=1e-12)
    assert len(set(batch.metrics["angle_rmse"].tolist())) == 4


@pytest.mark.slow
def test_the_run_without_the_step_has_the_same_noise_and_the_same_pushes(batch, heard):
    """Where the step does nothing the coupling is none, to the last bit; else it is the step's doing alone."""
    coupling = batch.metrics["coupling"]
    assert coupling[:3].tolist() == [0.0] * 3
    with_step, without = (np.asarray(heard(share=1.0, step=step)[0].state.angle) for step in (True, False))
    np.testing.assert_array_equal(with_step[: AT + 1], without[: AT + 1])
    assert coupling[3] == pytest.approx(np.abs(with_step - without)[AT:].max(), rel=1e-9)
    assert coupling[3] > 1e-4


@pytest.mark.slow
def test_air_is_what_each_braid_takes_in(batch, specimen, paper_precontracted):
    kept = {name: batch.table[name].to_numpy() for name in KEPT}
    thread = specimen.initial_length / np.cos(specimen.braid_angle)
    radius = specimen.initial_diameter / 2
    turned = thread * np.sin(specimen.braid_angle) / radius  # the angle that a thread goes round [rad]
    taken = 0.0
    for i, contraction in enumerate(paper_precontracted.contractions(kept["angle"]), start=1):
        length = specimen.initial_length * (1 - contraction)
        volume = np.pi * (thread**2 - length**2) / turned**2 * length
        held = volume * (kept[f"pressure{i}"] + 101325.0) / 101325.0
        np.testing.assert_allclose(kept[f"air{i}"], held, rtol=1e-10)
        taken = taken + np.maximum(np.diff(held, axis=1), 0.0).sum(axis=1)
    np.testing.assert_allclose(batch.metrics["air"], taken, rtol=1e-9)
    net = np.maximum(np.diff(kept["air1"] + kept["air2"], axis=1), 0.0).sum(axis=1)
    assert (batch.metrics["air"] > 1.5 * net).all()  # while one fills the other empties
