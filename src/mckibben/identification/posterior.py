r"""Bayesian posterior of a law's parameters, sampled by NUTS.

.. math:: F_i = F_\theta(\varepsilon_i, p_i) + u_{g(i)} + e_i, \qquad u_g \sim N(0, \tau^2)

The errors :math:`e_i` are Gaussian with standard deviation :math:`\sigma`, or Student t with unknown degrees of
freedom; the random effects :math:`u_g` of groups of points are optional. Priors: flat for linear parameters, the prior
of the fit for the deviations of `SmoothLaw`, uniform in the unit cube for the shape, 1/sigma for sigma, half-normal of
twice the residual standard deviation for tau, Gamma(2, 0.1) for the degrees of freedom.

It needs the package numpyro: ``pip install 'mckibben[bayes]'``.

References
----------
M. Hoffman and A. Gelman, "The No-U-Turn Sampler", J. Machine Learning Research 15 (2014) 1593-1623; M. Juarez and M.
Steel, J. Business and Economic Statistics 28 (2010) 52-66, for the prior of the degrees of freedom.
"""

from __future__ import annotations

import enum
import functools
import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mckibben.errors import IdentificationError, ParameterError, RangeError
from mckibben.identification.fit import Fit
from mckibben.identification.intervals import Interval, check_level
from mckibben.identification.least_squares import UnitCube
from mckibben.identification.regression import Regression
from mckibben.identification.uncertainty import Floats, Grouping, group_labels
from mckibben.muscle import ForceLaw

_RHAT = 1.05
_FEWEST_EFFECTIVE = 100


class Noise(enum.Enum):
    """Error distribution of plateau means; Student t gives outliers less weight."""

    GAUSSIAN = "gaussian"
    STUDENT = "student"


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws from the posterior.

    Attributes
    ----------
    law
        Least-squares fit, where the chains started.
    draws
        Shape (draws, parameters), in SI, in the order of the law's parameters.
    noise
        Draws of the noise parameters: ``sigma`` [N], with groups ``tau`` [N], with Student ``freedom`` [-].
    r_hat, effective, divergences
        Largest potential scale reduction, smallest effective sample size, and number of divergent transitions.
    """

    law: ForceLaw
    draws: Floats = field(repr=False)
    noise: Mapping[str, Floats] = field(repr=False)
    by: Grouping | None
    r_hat: float
    effective: float
    divergences: int
    warnings: tuple[str, ...]

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """Equal-tailed credible intervals by parameter, in SI."""
        check_level(level)
        ends = np.quantile(self.draws, [(1 - level) / 2, (1 + level) / 2], axis=0).T.tolist()
        return {p.name: Interval(*one) for p, one in zip(type(self.law).parameters(), ends, strict=True)}


def posterior(
    fit: Fit,
    *,
    noise: Noise = Noise.GAUSSIAN,
    by: Grouping | None = None,
    draws: int = 1000,
    warmup: int = 500,
    chains: int = 2,
    seed: int = 0,
) -> Posterior:
    """Sample the posterior of the parameters of a `Fit`; the chains start at the fit and run one after the other.

    Parameters
    ----------
    by
        Grouping of the random effects, such as `Grouping.STROKE`. Default: none.
    draws, warmup
        Draws of each chain, and discarded adaptation steps before them.

    Raises
    ------
    ParameterError
        If the package numpyro is missing.
    IdentificationError
        If the fit was read from a file, a parameter is at its bound, or the groups are not recorded.
    RangeError
        If `draws`, `warmup` or `chains` is too small.
    """
    if importlib.util.find_spec("numpyro") is None:
        raise ParameterError("a posterior needs the package numpyro", remedy="pip install 'mckibben[bayes]'")
    for name, value, lowest in (("draws", draws, 100), ("warmup", warmup, 100), ("chains", chains, 1)):
        if value < lowest:
            raise RangeError(f"{name} = {value} is too few", value=value, lower=lowest, remedy=f"give {lowest} or more")
    regression = fit.require_regression()
    if regression.at_bound.any():
        at_bound = ", ".join(
            name for name, out in zip(regression.problem.names, regression.at_bound, strict=True) if out
        )
        raise IdentificationError(
            f"{at_bound} of {type(fit.law).__name__} is at its bound: the posterior would concentrate there",
            remedy="use a law that the data determine, or measure where the force depends on the parameter",
        )

    if by is Grouping.POINT:
        by = None
    data = _data(regression, by)

    import jax
    from numpyro.diagnostics import effective_sample_size, split_gelman_rubin
    from numpyro.infer import MCMC, NUTS, init_to_value

    model = _model(type(fit.law), noise, by is not None)
    start = {"white": np.zeros(len(regression.problem.names)), "log_sigma": np.zeros(())}
    if by is not None:
        start |= {"tau": np.asarray(0.5)}
    if noise is Noise.STUDENT:
        start |= {"freedom": np.asarray(10.0)}
    kernel = NUTS(model, init_strategy=init_to_value(values=start))
    sampler = MCMC(
        kernel, num_warmup=warmup, num_samples=draws, num_chains=chains, chain_method="sequential", progress_bar=False
    )
    sampler.run(jax.random.PRNGKey(seed), **data, extra_fields=("diverging",))
    found = {name: np.asarray(values) for name, values in sampler.get_samples(group_by_chain=True).items()}
    divergences = int(np.sum(np.asarray(sampler.get_extra_fields()["diverging"])))
    found.pop("common", None)
    scale = float(data["deviation"])
    scatter = {"sigma": scale * np.exp(found["log_sigma"]).ravel()}
    if by is not None:
        scatter["tau"] = scale * found["tau"].ravel()
    if noise is Noise.STUDENT:
        scatter["freedom"] = found["freedom"].ravel()
    r_hat = max(float(np.max(split_gelman_rubin(values))) for values in found.values())
    effective = min(float(np.min(effective_sample_size(values))) for values in found.values())
    white = found["white"].reshape(-1, found["white"].shape[-1])
    coordinates = data["centre"] + white @ data["whitening"].T
    linear = regression.problem.linear
    values = coordinates.copy()
    for column, shape in enumerate(regression.problem.cube.values(coordinates[:, linear:].T), start=linear):
        values[:, column] = shape
    return Posterior(
        fit.law, values, scatter, by, r_hat, effective, divergences, _warnings(r_hat, effective, divergences)
    )


def _warnings(r_hat: float, effective: float, divergences: int) -> tuple[str, ...]:
    warnings = []
    if not r_hat < _RHAT:
        warnings.append(f"the chains have not converged (r_hat {r_hat:.3f}): draw more")
    if effective < _FEWEST_EFFECTIVE:
        warnings.append(f"the effective sample size is {effective:.0f}: draw more")
    if divergences:
        warnings.append(f"{divergences} transitions diverged: the draws may be biased")
    return tuple(warnings)


def _data(regression: Regression, by: Grouping | None) -> dict[str, Any]:
    """Arguments of the model; its coordinates are whitened at the fit: centre + whitening @ white."""
    problem, solution, points = regression.problem, regression.solution, regression.points
    rates = np.concatenate([np.ones(problem.linear), problem.cube.rates(solution.position)])
    residuals, jacobian = solution.augmented[0], solution.augmented[1] * rates
    deviation = float(np.sqrt(residuals @ residuals / (len(residuals) - len(rates))))
    lengths = np.linalg.norm(jacobian, axis=0)
    triangle = np.linalg.qr(jacobian / lengths, mode="r")
    whitening = deviation * np.linalg.inv(triangle) / lengths[:, None]
    labels = group_labels(points, by) if by is not None else np.zeros(len(points), np.int64)
    order = np.argsort(labels, kind="stable")
    return {
        "contraction": points.contraction[order],
        "pressure": points.pressure[order],
        "force": points.force[order],
        "labels": labels[order],
        "counts": np.bincount(labels).astype(float),
        "centre": np.concatenate([solution.values[: problem.linear], solution.position]),
        "whitening": whitening,
        "constants": problem.constants,
        "prior": np.empty((0, len(rates))) if problem.prior is None else problem.prior,
        "deviation": deviation,
    }


@functools.cache
def _model(law_type: type[ForceLaw], noise: Noise, grouped: bool) -> Callable[..., None]:
    import numpyro
    from numpyro import distributions as dist

    count = len(law_type.parameters())
    log_likelihood = _log_likelihood(law_type, noise)

    def model(**data: Any) -> None:
        real = dist.constraints
        white = numpyro.sample("white", dist.ImproperUniform(real.real_vector, (), event_shape=(count,)))
        log_sigma = numpyro.sample("log_sigma", dist.ImproperUniform(real.real, (), ()))
        tau = numpyro.sample("tau", dist.HalfNormal(2.0)) if grouped else 0.0
        freedom, common = 0.0, np.zeros_like(data["counts"])
        if noise is Noise.STUDENT:
            freedom = numpyro.sample("freedom", dist.Gamma(2.0, 0.1))
            if grouped:
                normal = dist.Normal(0.0, 1.0).expand([data["counts"].shape[0]]).to_event(1)
                common = numpyro.sample("common", normal)
        numpyro.factor("likelihood", log_likelihood(white, log_sigma, tau, freedom, common, data))

    return model


def _log_likelihood(law_type: type[ForceLaw], noise: Noise) -> Callable[..., Any]:
    """Compiled log-likelihood: the sampler also evaluates its model outside compiled code."""
    import jax
    import jax.numpy as jnp
    from numpyro import distributions as dist

    names = [p.name for p in law_type.parameters()]
    linear = len(law_type.linear_parameters)
    cube = UnitCube(law_type.shape_parameters)

    @jax.jit
    def log_likelihood(white: Any, log_sigma: Any, tau: Any, freedom: Any, common: Any, data: dict[str, Any]) -> Any:
        coordinates = data["centre"] + data["whitening"] @ white
        position = coordinates[linear:]
        outside = jnp.where(jnp.all((position >= 0) & (position <= 1)), 0.0, -jnp.inf)
        values = [*coordinates[:linear], *cube.values(jnp.clip(position, 0.0, 1.0))]
        sigma = jnp.exp(log_sigma)
        law = law_type(**dict(zip(names, values, strict=True)), **data["constants"])
        prior = data["prior"] @ jnp.stack(values) / (data["deviation"] * sigma)
        outside = outside - 0.5 * jnp.sum(prior**2) - len(prior) * log_sigma
        residuals = (data["force"] - law.force(data["contraction"], data["pressure"])) / data["deviation"]
        if noise is Noise.STUDENT:
            residuals = residuals - tau * jnp.asarray(common)[data["labels"]]
            return outside + jnp.sum(dist.StudentT(freedom, 0.0, sigma).log_prob(residuals))
        # The random effects are integrated out: each group has the covariance sigma^2 I + tau^2 1 1^T.
        counts = data["counts"]
        within = jnp.sum(residuals**2) / sigma**2 + 2 * len(residuals) * jnp.log(sigma)
        sums = jnp.zeros_like(counts).at[data["labels"]].add(residuals)
        ratio = tau**2 / sigma**2
        between = jnp.sum(jnp.log1p(counts * ratio) - ratio / (1 + counts * ratio) * (sums / sigma) ** 2)
        return outside - 0.5 * (within + between)

    return log_likelihood
