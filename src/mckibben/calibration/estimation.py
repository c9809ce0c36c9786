"""Identification on the joint: muscle laws, loads and encoder zeros from recordings of its motion."""

from __future__ import annotations

import math
import warnings
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import field
from functools import cache, cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, PyTree
from scipy import sparse

from mckibben.calibration.equations import (
    RATE,
    CalibrationProblem,
    Recorded,
    corrected,
    creep_stiffness,
    is_spring,
    linearised,
    names_of,
    problem_of,
    samples_of,
    swings_of,
)
from mckibben.calibration.fitting import (
    Calibration,
    JointEstimate,
    LocalMinimum,
    draws,
    root_mean_square,
    variance_of_samples,
)
from mckibben.calibration.models import HingeModel, Moved, RobotModel
from mckibben.calibration.recordings import Floats, JointPrior, JointRecording
from mckibben.codegen.engine import compiled
from mckibben.errors import IdentificationError, McKibbenWarning, RangeError
from mckibben.joint import AntagonisticJoint, Load
from mckibben.mechanism import Robot
from mckibben.numerics.batching import recheck
from mckibben.result import Column, Listing, Remark, column, table
from mckibben.units import JointType

_FILTER = 0.04  # s, standard deviation of the filter of the equations
EDGE = int(4 * _FILTER * RATE)  # samples that the filter needs on either side
_CHECK = "check units and signs of the columns, and which is muscle 1 (it lengthens as the angle grows)"
_APART = 100  # samples, of the stiffness along recordings
_UNEXPLAINED = 0.2
"""Share of the torque that moves the joint which the equation of motion may leave unexplained."""
_LEAST = 0.02
"""Least error of a model, relative to the torques that move the joint."""
_DETERMINED = 20.0  # parameters, at the first variance
_LOGARITHMIC = ("friction", "presliding")  # quantities of which the logarithm is estimated
_UNITS = {"friction": "N", "presliding": "m", "creep": "N/m", "mass": "kg", "zero": "rad"}  # of quantities; else "1"
_UNITS |= {"damping": "N*m*s/rad", "inertia": "kg*m^2"}


class Posterior(NamedTuple):
    """Estimates of a model for its use in service.

    Attributes
    ----------
    problem, minimum
        The model before, and its parameters with their covariance.
    tube
        Lag [s] of the pressures in the muscles behind the sensors.
    """

    problem: CalibrationProblem
    minimum: LocalMinimum
    tube: float = 0.0


class JointCalibration(Calibration):
    """Joint or robot identified from recordings of its motion, by `calibrate_joint`.

    Attributes
    ----------
    quantities
        Estimates by name: ``muscle1.force`` (relative to the model, at the middle contraction and the mean pressure),
        ``muscle1.friction``, ``muscle1.presliding``, ``muscle1.creep`` (total stiffness of its Maxwell arms),
        ``friction`` (sum of all half widths), ``load.mass``, ``load.inertia``, ``added_mass`` and ``distance``
        (relative to their stated values), ``zero`` (encoder reading at angle 0), ``damping`` (in excess of the
        model's), ``arm_scale``. A robot has masses and inertias by body, zeros and dampings by joint.
    model
        The model with the estimates.
    recordings, held_out
        Those that were fitted, and those that were not.
    residual
        Root mean square of the error of the equations of motion [N*m], low-pass filtered. Deviations contain it.
    unexplained
        Residual relative to the torque of the muscles about its mean.
    """

    model: Any  # Moved
    recordings: tuple[JointRecording, ...]
    held_out: tuple[JointRecording, ...] = field(default=(), kw_only=True)
    _problem: CalibrationProblem
    _posterior: LocalMinimum
    residual: float = column("N*m", "residual torque", digits=2)
    unexplained: float = column("1", "share of the torque that is unexplained", shown="%", digits=2)

    figures = ("calibration",)

    @property
    def joint(self) -> AntagonisticJoint:
        """The joint with the estimates."""
        return self.model.joint

    @property
    def load(self) -> Load:
        """The load with the estimates."""
        return self.model.load

    def stiffness(self, angle: ArrayLike, pressures: Sequence[ArrayLike]) -> tuple[Floats, Floats]:
        """Return stiffness [N*m/rad] and its standard deviation at angles [rad] and gauge pressures [Pa].

        Angles are an array, of a robot one for each joint, and the stiffness has a last axis for them.
        """
        return stiffness_of(self._problem, self._posterior, angle, pressures)

    def prior_stiffness(self, angle: ArrayLike, pressures: Sequence[ArrayLike]) -> tuple[Floats, Floats]:
        """Return `stiffness` before the calibration."""
        return stiffness_of(self._problem, _prior(self._problem), angle, pressures)

    def stiffness_along(self) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Return stiffness and deviation along the recordings, before and after."""
        angle, pressures = (
            np.concatenate([np.reshape(column, (len(column), -1))[::_APART] for column in columns]).T
            for columns in zip(*((each.angle, each.pressures) for each in self.recordings), strict=True)
        )
        at = (angle if len(angle) > 1 else angle[0], tuple(pressures))
        return self.prior_stiffness(*at), self.stiffness(*at)

    def drawn(self, count: int) -> dict[str, Any]:
        """Return the parts of plants by name, with an array of shape (count,) for each number.

        The first plant has the estimates, the others are drawn from their distribution, always the same ones.
        """
        return models_of(self._problem, draws(self._posterior, count).T).parts

    def errors(self, recording: JointRecording) -> tuple[float, float]:
        """Return the root mean square errors of the torque [N*m] by the model before and after the calibration."""
        recorded, joints = samples_of(self._problem.model, recording), len(self._problem.model.joint_names)
        before, after = (
            _filtered(linearised(self._problem, z, recorded)[0], recorded)[:, :joints]
            for z in (np.zeros(self._problem.size), self._posterior.z)
        )
        return root_mean_square([before]), root_mean_square([after])

    @property
    def posterior(self) -> Posterior:
        """The estimates as a start for those in service, see `mckibben.calibration.service`."""
        return Posterior(self._problem, self._posterior, self.recordings[0].tube)

    @cached_property
    def held_out_errors(self) -> tuple[float, float]:
        """Root mean square errors [N*m] of the recordings that were held out, by the model before and after."""
        before, after = np.sqrt(np.mean([np.square(self.errors(recording)) for recording in self.held_out], axis=0))
        return float(before), float(after)

    @property
    def predicts(self) -> bool:
        """Whether the recordings that were held out, if any, are described better than by the model before."""
        before, after = self.held_out_errors
        return after < before

    @table()
    def errors_of_recordings(self) -> list[Listing]:
        """Errors of each recording by the model before and after."""
        recordings = (*self.recordings, *self.held_out)
        before, after = zip(*(self.errors(recording) for recording in recordings), strict=True)
        error = Column("N*m", digits=3)
        columns: dict[str, tuple[Column, Any]] = {
            "recording": (Column(), [str(i + 1) for i in range(len(recordings))]),
            "used as": (Column(), ["fitted"] * len(self.recordings) + ["held out"] * len(self.held_out)),
            "model before": (error, before),
            "calibrated": (error, after),
        }
        return [Listing("root mean square error", columns)]

    def verdict(self) -> str:
        """Mean stiffness along the recordings, after and before with 95 % intervals, and the determined quantities."""
        kind = self.model.joint_type
        size = kind.size("N*m/rad")
        before, after = (
            ", ".join(
                f"{mean / size:.3g} +- {1.96 * deviation / size:.2g}"
                for mean, deviation in zip(
                    np.atleast_1d(value.mean(axis=0)),
                    np.atleast_1d(np.sqrt(np.mean(np.square(deviations), axis=0))),
                    strict=True,
                )
            )
            for value, deviations in self.stiffness_along()
        )
        held_out = ""
        if self.held_out:
            earlier, later = (kind.show(error, "N*m", 2) for error in self.held_out_errors)
            held_out = f"; {kind.words('torques')} held out err by {later}, {earlier} before"
        found = f"stiffness {after} {kind.shown('N*m/rad')} (95 %), {before} before{held_out}"
        return f"{found}; {super().verdict()}"

    @property
    def joint_type(self) -> JointType:
        return self.model.joint_type

    def remarks(self) -> list[Remark]:
        """Contradictions of model and recordings, laws that are no muscle's, and quantities far from the model."""
        remarks = []
        if self.unexplained > _UNEXPLAINED:
            what = self.model.joint_type.words("torque")
            text = f"the recordings contradict the model: {self.unexplained:.0%} of the {what} is unexplained"
            remarks.append(Remark.warning("residual", text, f"{_CHECK}, and which recordings had the weight"))
        if self.held_out and not self.predicts:
            text = "the model before predicts the recordings that were held out better, and is kept in the files"
            remarks.append(Remark.warning("held_out", text, _CHECK))
        for name, muscle in zip(self.model.muscle_names, self.model.muscles, strict=True):
            if muscle.violation:
                text = f"{name}: {muscle.violation}, where no recording holds the correction"
                remarks.append(Remark.note(name, text, "record larger angles, or stay within these"))
        return remarks + super().remarks()


def calibrate_joint(
    joint: AntagonisticJoint, load: Load, recordings: Sequence[JointRecording], prior: JointPrior | None = None
) -> JointCalibration:
    r"""Identify a joint from recordings of its motion, preferably some with a known added weight.

    The equation of motion (Eq. 6) of both muscles, with friction and creep along the measured path, is fitted to all
    recordings at once; docs/calibrate.md describes the estimate:

    .. math::

        (I + m_w l_w^2)\,\ddot\theta + c\dot\theta = \tau(\theta - \theta_0, p_1, p_2) + (G + m_w l_w g)
        \sin(\theta_h - \theta + \theta_0)

    Each muscle's law gets a `ForceCorrection`, friction with free shares of six slip lengths, and creep, Maxwell arms
    of 1, 3 and 10 s. Parameters have Gaussian priors.

    Parameters
    ----------
    joint, load
        The initial model, the mean of the prior. A muscle without friction gets a band with an estimated width.
    recordings
        At least one. Slow sweeps and motion of 1 to 4 Hz, each without and with a weight, at several co-contractions,
        are most informative.
    prior
        Prior standard deviations.

    Raises
    ------
    IdentificationError
        If a recording is too short, too slowly sampled or at rest, contains non-finite numbers, or does not give the
        load a positive mass.

    References
    ----------
    M. Gautier and W. Khalil, "Direct calculation of minimum set of inertial parameters of serial robots", IEEE Trans.
    Robotics and Automation 6 (1990) 368-373 (equation error of the inverse dynamics); the procedure is this project's.
    """
    return calibrate_model(HingeModel(joint, load), recordings, prior)


def calibrate_robot(
    robot: Robot, recordings: Sequence[JointRecording], prior: JointPrior | None = None
) -> JointCalibration:
    """Identify a robot on a fixed base as `calibrate_joint` does, by an equation of motion for each joint.

    Angles of the recordings have shape (samples, joints), pressures (samples, muscles). Quantities have the names of
    joints, muscles and bodies. Raises `IdentificationError` also for locked joints, and for an added weight.
    """
    return calibrate_model(RobotModel(robot), recordings, prior)


def calibrate_model(
    model: Moved, recordings: Sequence[JointRecording], prior: JointPrior | None = None
) -> JointCalibration:
    """Identify a joint or a robot as `calibrate_joint` does, by an equation of motion for each joint."""
    if not recordings:
        raise IdentificationError("there is no recording", remedy="give at least one")
    model.check(recordings)
    sizes = len(model.joint_names), len(model.muscle_names)
    for number, recording in enumerate(recordings, 1):
        columns = tuple(np.reshape(each, (len(each), -1)).shape[1] for each in (recording.angle, recording.pressures))
        if columns != sizes:
            message = f"recording {number} has {columns[0]} angles and {columns[1]} pressures"
            remedy = f"record {sizes[0]} angles and {sizes[1]} pressures, of all joints and muscles"
            raise IdentificationError(message, value=columns, remedy=remedy)
    prior = prior or JointPrior()
    recorded = [samples_of(model, recording) for recording in recordings]
    problem = problem_of(model, recorded, prior)
    posterior, errors = _solve(problem, recorded)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", McKibbenWarning)  # `remarks` has them
        after = jax.tree.map(np.ndarray.item, models_of(problem, posterior.z[:, None]))
        try:
            recheck(after)
        except RangeError as error:
            raise IdentificationError(f"the recordings contradict the model: {error.message}", remedy=_CHECK) from None
    residual = root_mean_square([errors])
    unexplained = residual / root_mean_square([swings_of(model, recorded)])
    quantities = quantities_of(problem, posterior)
    parts = quantities, after, tuple(recordings), problem, posterior, residual, unexplained
    return JointCalibration(*parts)


def predicted_deviation(
    model: Moved, recordings: Sequence[JointRecording], prior: JointPrior, *, error: float = 0.04
) -> float:
    """Return the deviation of the stiffness along recordings that they leave, relative to its mean.

    They are of the model, simulated; its error is assumed to leave a residual relative to the torques that move it.
    """
    recorded = [samples_of(model, recording) for recording in recordings]
    problem = problem_of(model, recorded, prior)
    slopes = filtered_rows(problem, np.zeros(problem.size), recorded)[1]
    squares = (error / _LEAST * least_errors(problem, recorded)) ** 2
    variance = _variance(slopes, squares, squares * len(slopes) / _DETERMINED)
    posterior = _posterior(np.zeros(problem.size), slopes, np.zeros(slopes.shape[:2]), variance)
    fit = JointCalibration({}, model, tuple(recordings), problem, posterior, 0.0, 0.0)
    value, deviation = fit.stiffness_along()[1]
    return float(np.sqrt(np.mean(deviation**2)) / value.mean())


def _prior(problem: CalibrationProblem) -> LocalMinimum:
    """The model before, with its deviations."""
    return LocalMinimum(np.zeros(problem.size), np.eye(problem.size))


def quantities_of(problem: CalibrationProblem, posterior: LocalMinimum) -> dict[str, JointEstimate]:
    """Return estimates by name, with their deviations."""
    values, slopes = _quantities(problem, posterior.z)
    expected, wide = _quantities(problem, np.zeros(problem.size))
    estimates = {}
    for name, value in values.items():
        deviation = math.sqrt(slopes[name] @ posterior.covariance @ slopes[name])
        unit = problem.model.joint_type.unit(_UNITS.get(name.rpartition(".")[2], "1"))
        logarithmic = name.endswith(_LOGARITHMIC)
        number = math.exp(value) if logarithmic else float(value)
        scale = number if logarithmic else 1.0
        of_muscle = name.rpartition(".")[0] in problem.model.muscle_names
        compared = None if of_muscle or logarithmic or name.endswith("damping") else float(expected[name])
        deviations = deviation * scale, float(np.linalg.norm(wide[name])) * scale
        estimates[name] = JointEstimate(number, *deviations, unit, logarithmic, compared)
    return estimates


@compiled
def models_of(problem: CalibrationProblem, z: Array) -> Moved:
    """The model at parameters, with what cannot be negative at 0 or above."""
    return corrected(problem, z).model.physical


def stiffness_of(
    problem: CalibrationProblem, at: LocalMinimum, angle: ArrayLike, pressures: Sequence[ArrayLike]
) -> tuple[Floats, Floats]:
    """Stiffness [N*m/rad] at angles and pressures, and its standard deviation; with an axis of several joints."""
    joints = len(problem.model.joint_names)
    angles = tuple(np.asarray(angle, float)) if joints > 1 else (angle,)
    points = np.broadcast_arrays(*(np.asarray(x, float) for x in (*angles, *pressures)))
    flat = np.stack([point.ravel() for point in points], axis=1)
    values, slopes = _stiffnesses((problem, at.z, flat), np.eye(at.z.size))
    deviation = np.sqrt(np.einsum("...i,ij,...j->...", slopes, at.covariance, slopes))
    shape = points[0].shape if joints == 1 else (*points[0].shape, joints)
    return values[..., 0].reshape(shape), deviation.reshape(shape)


@compiled
def _stiffnesses(shared: tuple[CalibrationProblem, Array, Array], direction: Array) -> tuple[Array, Array]:
    """Stiffness of each joint at each point, and its derivative in a direction of the parameters."""
    problem, z, points = shared
    joints = len(problem.model.joint_names)

    def at(_: tuple[()], point: Array) -> PyTree:
        def evaluate(z: Array) -> Array:
            return jnp.stack(list(corrected(problem, z).model.stiffness(tuple(point[:joints]), tuple(point[joints:]))))

        return (), jax.jvp(evaluate, (z,), (direction,))

    return lax.scan(at, (), points)[1]


def _quantities(problem: CalibrationProblem, z: Floats) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Quantities by name, and their derivatives with respect to the parameters."""
    values, slopes = _directional((problem, z), np.eye(z.size))
    return {name: value[0] for name, value in values.items()}, slopes


@compiled
def _directional(
    shared: tuple[CalibrationProblem, Array], direction: Array
) -> tuple[OrderedDict[str, Array], OrderedDict[str, Array]]:
    """Quantities and their derivatives in a direction; other dictionaries would come back sorted."""
    problem, z = shared

    def values(z: Array) -> OrderedDict[str, Array]:
        model, values = corrected(problem, z)
        quantities: Any = OrderedDict()
        bands = []
        creep = creep_stiffness(problem, z).sum(axis=1)
        names, pairs = model.muscle_names, zip(model.muscles, problem.model.muscles, strict=True)
        for i, (name, (muscle, before)) in enumerate(zip(names, pairs, strict=True)):
            if is_spring(muscle):
                continue
            point = problem.scales[i].centre, problem.scales[i].pressure
            bands.append(muscle.friction.half_width)
            quantities[f"{name}.force"] = muscle.law.force(*point) / before.law.force(*point)
            quantities[f"{name}.friction"] = jnp.log(bands[-1])
            quantities[f"{name}.presliding"] = jnp.log(muscle.friction.presliding_length)
            quantities[f"{name}.creep"] = creep[i]
        quantities["friction"] = jnp.log(jnp.stack(bands).sum())
        absolute = problem.model.absolute
        for name in names_of(problem.model):
            quantities[name] = values[name] * absolute.get(name, 1.0)
        return quantities

    return jax.jvp(values, (z,), (direction,))


def filtered_rows(
    problem: CalibrationProblem, z: Floats, recorded: Sequence[Recorded], pushing: float = 0.0
) -> tuple[Floats, Floats]:
    """Filtered errors, shape (samples, groups), and their Jacobian."""
    pairs = [linearised(problem, z, each, pushing=pushing) for each in recorded]
    errors, slopes = (
        np.concatenate([_filtered(column, each) for column, each in zip(columns, recorded, strict=True)])
        for columns in zip(*pairs, strict=True)
    )
    return errors, slopes


def _solve(problem: CalibrationProblem, recorded: Sequence[Recorded]) -> tuple[LocalMinimum, Floats]:
    """Posterior, and errors of the torques, shape (samples, joints).

    What the recordings leave where they may move all parameters, as if the model had its least error, is the error of
    the model. That of the estimate itself contains the pull of the prior: if it were the deviation of the samples, they
    would determine less, the estimate would move towards the prior, and the error would grow until nothing is
    determined.
    """
    least = least_errors(problem, recorded)
    firm = least**2 * (filtered_rows(problem, np.zeros(problem.size), recorded)[0].shape[0] / _DETERMINED)
    free = _minimum(problem, recorded, np.zeros(problem.size), firm, pushing=4)
    errors, slopes = filtered_rows(problem, free.z, recorded)
    variance = _variance(slopes, np.maximum(np.mean(errors**2, axis=0), least**2), firm)
    posterior = _minimum(problem, recorded, free.z, variance)
    return posterior, filtered_rows(problem, posterior.z, recorded)[0][:, : len(problem.model.joint_names)]


def _minimum(
    problem: CalibrationProblem,
    recorded: Sequence[Recorded],
    z: Floats,
    variance: Floats,
    *,
    pushing: int = 0,
    steps: int = 40,
    longest: float = 3.0,
) -> LocalMinimum:
    """Posterior by Gauss-Newton steps from parameters, with a variance of the samples of each group.

    The equations are nearly linear in the parameters, so that there is one minimum. In a number of first steps muscles
    that the model has slack are let push, as they may be taut. Steps have at most a length in prior standard
    deviations, which shrinks, as slack muscles would let them oscillate.
    """
    posterior = LocalMinimum(z, np.eye(z.size))
    for number in range(steps):
        errors, slopes = filtered_rows(problem, z, recorded, pushing=float(number < pushing))
        posterior = _posterior(z, slopes, errors, variance)
        step = posterior.z - z
        length = float(np.linalg.norm(step))
        if length < 0.01 and number >= pushing:
            break
        z, longest = z + step * min(1.0, longest / length), 0.95 * longest
    return posterior


def _posterior(z: Floats, slopes: Floats, errors: Floats, variance: Floats) -> LocalMinimum:
    """Posterior of parameters by errors linearised at z, shape (samples, groups), with a standard normal prior."""
    weighted = slopes / variance[:, None]
    covariance = np.linalg.inv(np.eye(z.size) + np.einsum("sgi,sgj->ij", weighted, slopes))
    return LocalMinimum(z - covariance @ (z + np.einsum("sgi,sg->i", weighted, errors)), covariance)


def _variance(slopes: Floats, squares: Floats, firm: Floats) -> Floats:
    information = np.einsum("sgi,sgj->gij", slopes, slopes)
    return variance_of_samples(information, len(slopes), squares, firm, np.eye(slopes.shape[2]))


def least_errors(problem: CalibrationProblem, recorded: Sequence[Recorded]) -> Floats:
    """Errors [N*m] and [N] below which no model is trusted, relative to torques, and to a tenth of highest forces."""
    torques = np.sqrt(np.mean(swings_of(problem.model, recorded) ** 2, axis=0))
    cells = [scales.force / 10 for scales in problem.scales][: recorded[0].samples.tensions.shape[1]]
    return _LEAST * np.array([*torques, *cells])


def _filtered(column: Floats, recorded: Recorded) -> Floats:
    """Low-pass filtered rows of samples from the first one of interest on, without the edge of the filter."""
    rows = _filter(len(column), recorded.begin + EDGE) @ column.reshape(len(column), -1)
    return rows.reshape(-1, *column.shape[1:])


@cache
def _filter(samples: int, begin: int) -> PyTree:
    """Gaussian filter as a sparse matrix, shape (filtered samples, samples)."""
    width = _FILTER * RATE
    places = np.arange(2 * int(4 * width) + 1)
    weights = np.exp(-(((places - places.size // 2) / width) ** 2) / 2)
    rows = sparse.diags_array(weights / weights.sum(), offsets=places, shape=(samples - places.size + 1, samples))
    return rows.tocsr()[begin - places.size // 2 :: max(int(width / 2), 1)]
