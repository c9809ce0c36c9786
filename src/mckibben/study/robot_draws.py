"""Draws of robots with scatter of muscles and bodies: laws, their strength, and masses."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from mckibben.component.schema import ENDINGS, origin_of
from mckibben.mechanism.bodies import Body
from mckibben.muscle import ForceLaw, Muscle
from mckibben.plant.robot_plant import RobotPlant
from mckibben.scenario.robot import RobotScenario


def drawn_plant(scenario: RobotScenario, *, fresh: bool = False) -> RobotPlant:
    """Return the plant of a scenario with arrays over draws in place of uncertain numbers; the first is nominal.

    `fresh` draws are others: what was chosen on the first ones is judged by these.
    """
    spec, plant = scenario.uncertainty, scenario.plant()
    rng = np.random.default_rng([spec.seed, 1] if fresh else spec.seed)
    count = spec.draws + 1

    def factors(spread: float) -> NDArray[np.float64]:
        """Factors with a standard deviation, not below a tenth; the first is 1."""
        found = np.maximum(1 + spread * rng.standard_normal(count), 0.1)
        found[0] = 1.0
        return found

    robot = plant.robot
    fits: dict[str, ForceLaw] = {}  # one draw of a fit for all muscles that have it

    def drawn(muscle: Muscle) -> Muscle:
        """A muscle with arrays in its law; springs do not scatter."""
        from mckibben.identification import Fit  # pandas: only where muscles are drawn

        if muscle.law.is_passive:
            return muscle
        file = origin_of(muscle.law)
        if file.endswith(ENDINGS):
            if file not in fits:
                fit = Fit.from_yaml(file)
                draws = fit.draws(rng, spec.draws)
                draws = {name: np.append(fit.estimates[name], values) for name, values in draws.items()}
                fits[file] = dataclasses.replace(fit.law, **draws)  # pyrefly: ignore[bad-argument-type]
            muscle = eqx.tree_at(lambda x: x.law, muscle, fits[file])
        strength = factors(spec.strength) * (1.0 if muscle.strength is None else muscle.strength)
        return dataclasses.replace(muscle, strength=strength)  # pyrefly: ignore[bad-argument-type]

    varied = {}
    for body in robot.frame_bodies:
        by = factors(spec.mass)  # also of a joint without a body, so that draws do not depend on how one is written
        if body is not None:
            varied[body.name] = with_mass(body, by)
    bodies = tuple(varied[body.name] for body in robot.bodies)
    known = lambda part: isinstance(part, Muscle)  # noqa: E731
    muscles = jax.tree.map(lambda part: drawn(part) if known(part) else part, robot.muscles, is_leaf=known)
    robot = eqx.tree_at(lambda x: (x.bodies, x.muscles), robot, (bodies, muscles))
    return dataclasses.replace(plant, robot=robot)


def with_mass(body: Body, factors: NDArray[np.float64]) -> Body:
    """A body with mass and inertias times factors."""
    inertia = tuple(number * factors for number in body.inertia)
    return eqx.tree_at(lambda x: (x.mass, x.inertia), body, (body.mass * factors, inertia))


def take(tree: Any, index: NDArray[np.int64]) -> Any:
    """Return a tree with arrays over runs in place of draws; each run has the index of its draw."""
    return jax.tree.map(lambda x: x[index] if eqx.is_array(x) and np.ndim(x) else x, tree)


def quantile_interval(draws: NDArray[np.float64], percent: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the 95 % interval of a quantile over draws, which are along the last axis.

    Its ends are order statistics, so that it holds for any distribution; infinite where the draws are too few for one.

    >>> [float(end) for end in quantile_interval(np.arange(400.0), 95)]
    [370.0, 388.0]
    """
    from scipy.stats import binom

    count = draws.shape[-1]
    low, high = np.add(binom.ppf([0.025, 0.975], count, percent / 100), (-1, 0)).astype(int)
    beyond = np.full((*draws.shape[:-1], 1), np.inf)
    ordered = np.concatenate([-beyond, np.sort(draws, axis=-1), beyond], axis=-1)
    return ordered[..., low + 1], ordered[..., high + 1]
