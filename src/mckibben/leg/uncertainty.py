"""Legs that differ as muscles and bodies scatter: draws of the laws, of their strength, and of masses."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.identification.fit import Fit
from mckibben.identification.storage import read_fit
from mckibben.leg.plant import LegPlant
from mckibben.leg.scenario import LegScenario
from mckibben.muscle import ForceLaw, Muscle, SpringLaw, scaled_law
from mckibben.scenario.muscle import MuscleSpec


def drawn_plant(scenario: LegScenario) -> LegPlant:
    """Return the plant of a scenario with arrays over draws in place of what is uncertain; the first is nominal."""
    spec, plant = scenario.uncertainty, scenario.plant()
    rng = np.random.default_rng(spec.seed)
    count = spec.draws + 1

    def factors(spread: float) -> NDArray[np.float64]:
        """Factors with a standard deviation, not below a tenth; the first is 1."""
        found = np.maximum(1 + spread * rng.standard_normal(count), 0.1)
        found[0] = 1.0
        return found

    leg = plant.leg
    fits: dict[Path, ForceLaw] = {}  # one draw of a fit for all muscles that have it

    def drawn(own: MuscleSpec | None, muscle: Muscle) -> Muscle:
        """A muscle with arrays in its law; springs do not scatter."""
        if own is None or isinstance(muscle.law, SpringLaw):
            return muscle
        if isinstance(own.law, Path):
            if own.law not in fits:
                fit = read_fit(own.law)
                fits[own.law] = dataclasses.replace(fit.law, **_fit_draws(fit, rng, count))
            muscle = own.build(fits[own.law])
        return eqx.tree_at(lambda x: x.law, muscle, scaled_law(muscle.law, factors(spec.strength)))

    trunk = _with_mass(leg.trunk, factors(spec.mass))
    links = tuple(_with_mass(link, factors(spec.mass)) for link in leg.links)
    joints = []
    for joint, part in zip(leg.joints, scenario.leg.joints, strict=True):
        given = (part.muscle1 or part.muscle, part.muscle2 or part.muscle)
        muscles = list(map(drawn, given, (joint.muscles.muscle1, joint.muscles.muscle2)))
        pair = eqx.tree_at(lambda one: (one.muscle1, one.muscle2), joint.muscles, tuple(muscles))
        joints.append(eqx.tree_at(lambda one: one.muscles, joint, pair))
    biarticular = tuple(
        eqx.tree_at(lambda x: x.muscle, one, drawn(part.muscle, one.muscle))
        for one, part in zip(leg.biarticular, scenario.leg.biarticular, strict=True)
    )
    leg = eqx.tree_at(lambda x: (x.trunk, x.links, x.joints), leg, (trunk, links, tuple(joints)))
    if biarticular:
        leg = eqx.tree_at(lambda x: x.biarticular, leg, biarticular)
    return eqx.tree_at(lambda x: x.leg, plant, leg)


def _with_mass(body: Any, factors: NDArray[np.float64]) -> Any:
    """A body with mass and inertia times factors."""
    return eqx.tree_at(lambda x: (x.mass, x.inertia), body, (body.mass * factors, body.inertia * factors))


def _fit_draws(fit: Fit, rng: np.random.Generator, count: int) -> dict[str, NDArray[np.float64]]:
    """Draws of a fit's parameters by name, the first as identified; robust standard errors where the fit has them."""
    covariance = fit.robust_covariance
    known = np.diag(covariance) > 0
    draws = np.tile(np.array(list(fit.estimates.values())), (count, 1))
    draws[1:, known] += rng.multivariate_normal(np.zeros(known.sum()), covariance[np.ix_(known, known)], count - 1)
    return dict(zip(fit.estimates, draws.T, strict=True))


def take(tree: Any, index: NDArray[np.int64]) -> Any:
    """Return a tree whose arrays over draws are those of runs, each with the index of its draw."""
    return jax.tree.map(lambda x: x[index] if eqx.is_array(x) and np.ndim(x) else x, tree)
