"""Legs that differ as muscles and bodies scatter: draws of the laws, of their strength, and of masses."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.identification.storage import read_fit
from mckibben.leg.plant import LegPlant
from mckibben.leg.scenario import LegScenario
from mckibben.muscle import ForceLaw, SpringLaw, scaled_law
from mckibben.study.scenario.muscle import MuscleSpec


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
    trunk = _heavier(leg.trunk, factors(spec.mass))
    links = tuple(_heavier(link, factors(spec.mass)) for link in leg.links)
    joints = []
    for joint, part in zip(leg.joints, scenario.leg.joints, strict=True):
        given = (part.muscle1 or part.muscle, part.muscle2 or part.muscle)
        muscles = [
            muscle if isinstance(muscle.law, SpringLaw) else _drawn(own, muscle, factors(spec.strength), rng, count)
            for own, muscle in zip(given, (joint.muscles.muscle1, joint.muscles.muscle2), strict=True)
        ]
        pair = eqx.tree_at(lambda one: (one.muscle1, one.muscle2), joint.muscles, tuple(muscles))
        joints.append(eqx.tree_at(lambda one: one.muscles, joint, pair))
    biarticular = tuple(
        eqx.tree_at(lambda x: x.muscle, one, _drawn(part.muscle, one.muscle, factors(spec.strength), rng, count))
        for one, part in zip(leg.biarticular, scenario.leg.biarticular, strict=True)
    )
    leg = eqx.tree_at(lambda x: (x.trunk, x.links, x.joints), leg, (trunk, links, tuple(joints)))
    if biarticular:
        leg = eqx.tree_at(lambda x: x.biarticular, leg, biarticular)
    return eqx.tree_at(lambda x: x.leg, plant, leg)


def _heavier(body: Any, factors: NDArray[np.float64]) -> Any:
    """A body with mass and inertia times factors."""
    return eqx.tree_at(lambda x: (x.mass, x.inertia), body, (body.mass * factors, body.inertia * factors))


def _drawn(spec: MuscleSpec, muscle: Any, strengths: NDArray[np.float64], rng: np.random.Generator, count: int) -> Any:
    """A muscle with arrays in its law: the parameters of a fit within their covariance, and the strength."""
    law: ForceLaw | None = None
    if isinstance(spec.law, Path):
        fit = read_fit(spec.law)
        means = np.array(list(fit.estimates.values()))
        known = np.isfinite(np.diag(fit.covariance))
        draws = np.tile(means, (count, 1))
        covariance = fit.covariance[np.ix_(known, known)]
        draws[1:, known] = rng.multivariate_normal(means[known], covariance, count - 1)
        law = dataclasses.replace(fit.law, **dict(zip(fit.estimates, draws.T, strict=True)))
    base = muscle if law is None else spec.build(law)
    return eqx.tree_at(lambda x: x.law, base, scaled_law(base.law, strengths))


def take(tree: Any, index: NDArray[np.int64]) -> Any:
    """Return a tree whose arrays over draws are those of runs, each with the index of its draw."""
    return jax.tree.map(lambda x: x[index] if eqx.is_array(x) and np.ndim(x) else x, tree)
