"""Estimation shared by the model-based controllers: adapted strengths act like a model that has them."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.control import (
    DecouplingControl,
    ExtendedStateObserver,
    LawAdaptation,
    Measurement,
    PolePlacement,
    PredictiveControl,
    Setpoint,
)
from mckibben.control import base as control_base
from mckibben.control.adaptation import with_strengths
from mckibben.numerics.compiled import numeric

PERIOD = 1e-3
SPREAD = 0.06


@pytest.fixture(scope="module")
def decoupling(load):
    observer = ExtendedStateObserver(200.0)
    return lambda model: DecouplingControl(model, load, PolePlacement(60.0), observer, adaptation=LawAdaptation(SPREAD))


@pytest.fixture(scope="module")
def predictive(load):
    return lambda model: PredictiveControl(model, load, adaptation=LawAdaptation(SPREAD))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["decoupling", "predictive"])
def test_strengths_that_were_learned_are_as_good_as_a_model_that_has_them(kind, request, barely_compiled, knee):
    """In motion, stiffness estimate and commands."""
    make = request.getfixturevalue(kind)
    seen = Measurement(jnp.asarray(0.1), (jnp.asarray(4.2e5), jnp.asarray(4.6e5)))
    setpoint = Setpoint(jnp.asarray(0.105), jnp.asarray(15.5))

    @barely_compiled
    def stepped(control, deviations):
        state = control.init(seen)
        before = state.estimates
        adaptation, motion = (
            before.adaptation._replace(deviations=deviations),
            before.motion._replace(known=jnp.asarray(0.0)),
        )
        state = state._replace(estimates=before._replace(adaptation=adaptation, motion=motion))
        state, commands = control.step(state, setpoint, seen, PERIOD)
        return commands, state.estimates.motion, control.telemetry(state)

    def answer(strengths, *, learned):
        """Commands [Pa], what is expected of the motion, and the estimate."""
        model = jax.tree.map(np.asarray, with_strengths(knee, (1.0, 1.0) if learned else strengths))
        off = (*((s - 1) / SPREAD for s in strengths), 0.0) if learned else (0.0, 0.0, 0.0)
        commands, motion, told = stepped(numeric(make(model)), tuple(map(np.asarray, off)))
        assert float(told["strength1_estimate"]) == pytest.approx(strengths[0] if learned else 1.0)
        return np.array([*commands, 1e3 * motion.known, 1e3 * told["stiffness_estimate"]])

    by_learning, by_model, neither = (
        answer((1.03, 0.96), learned=True),
        answer((1.03, 0.96), learned=False),
        answer((1.0, 1.0), learned=True),
    )
    np.testing.assert_allclose(by_learning, by_model, atol=0.5)
    assert (np.abs(by_learning - neither) > 50.0).all()


def test_a_valve_without_a_known_lag_is_not_inherited_as_a_model():
    """A file has to give one; `KeyError` says that there is nothing to inherit."""
    unknown, known = (SimpleNamespace(holds_air=False, lag=lag) for lag in (None, 0.02))
    with pytest.raises(KeyError):
        control_base._valve_model({"valve": unknown})
    assert control_base._valve_model({"valve": known}) is known
