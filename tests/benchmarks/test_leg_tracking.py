"""Three joints of a leg through valves with air: models of single joints, the gains that are kept, and short runs."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from mckibben.leg.dynamics import at_rest, motion, posture_of


@pytest.fixture
def tracking(monkeypatch):
    monkeypatch.syspath_prepend("benchmarks")
    return importlib.import_module("leg_tracking")


@pytest.mark.slow
def test_a_pendulum_has_the_weight_of_the_leg_below_its_joint(tracking):
    plant = tracking.plant_of(next(iter(tracking.SETUPS.values())))
    for joint, load in enumerate(tracking.pendulums(plant)):
        energies = []
        for angle in (0.1, 0.1 + 1e-5):
            posture = posture_of(plant.leg, [angle if i == joint else 0.0 for i in range(3)])
            energies.append(float(motion(plant.leg, posture, at_rest(posture), 9.81).potential))
        assert float(load.gravity_torque(0.1)) == pytest.approx(-np.diff(energies)[0] / 1e-5, abs=1e-4)


def test_the_gains_that_are_kept_are_of_the_search(tracking):
    assert set(tracking.kept()) == set(tracking.SETUPS)
    for gains in tracking.kept().values():
        assert set(gains) == set(tracking.NAMES)
        for name, own in gains.items():
            for gain, (begin, factor) in tracking.gains_of(name).items():
                assert len(own[gain]) == 3
                assert begin / factor * 0.999 <= min(own[gain]) <= max(own[gain]) <= begin * factor * 1.001


def test_a_search_begins_at_the_gains_of_the_simpler_controller_as_well(tracking, monkeypatch):
    """Without generations, the cheapest of all candidates for a cost that only these gains make small."""
    name, setup = next(iter(tracking.SETUPS.items()))
    known = tracking.simpler_gains(name, tracking.REFERENCE)
    assert set(known) == {f"controller.{one}" for one in tracking.PID}
    wanted = np.log(known["controller.position.kp"])

    def simulated(_setup, _plant, _controller, over):
        columns = [over[f"controller.controllers.{joint}.controller.position.kp"] for joint in range(3)]
        return {one: np.abs(np.log(columns) - wanted[:, None]) for one in tracking.COST}

    monkeypatch.setattr(tracking, "simulated", simulated)
    monkeypatch.setattr(tracking, "draws", lambda *_: {})
    search = {"population": 8, "generations": 0, "runs": 2}
    found = tracking.tuned(setup, None, tracking.REFERENCE, None, known, **search)
    for gain, values in known.items():
        np.testing.assert_allclose(found[gain], values, rtol=1e-3)
    assert found["observer.bandwidth"] == [tracking.PREDICTION["observer.bandwidth"][0]] * 3


@pytest.mark.slow
def test_with_models_the_joints_follow_better_through_slow_valves(tracking, monkeypatch):
    monkeypatch.setattr(tracking, "DURATION", 1.5)
    name, setup = next(iter(tracking.SETUPS.items()))
    plant, runs, found = tracking.plant_of(setup), 8, {}
    over = tracking.draws(setup, plant, runs, 5)
    for one in (tracking.REFERENCE, "decoupling of the leg"):
        gains = tracking.addressed(tracking.kept()[name][one], runs)
        found[one] = tracking.simulated(setup, plant, tracking.controllers(plant)[one], over | gains)
    rival, ours = found.values()
    assert all(np.isfinite(one).all() for one in (*rival.values(), *ours.values()))
    assert (np.median(ours["angle"], 1) < np.median(rival["angle"], 1)).all()
