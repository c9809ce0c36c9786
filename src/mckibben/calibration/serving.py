"""The estimate in service of a calibration, alongside the control loop of a rig."""

from __future__ import annotations

import json
import os
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from mckibben.calibration.equations import CalibrationProblem, Scales, with_friction
from mckibben.calibration.estimation import Posterior
from mckibben.calibration.experiment import first_model_of
from mckibben.calibration.fitting import Floats, LocalMinimum
from mckibben.calibration.service import Follower, Service, model_at
from mckibben.component.base import Checked
from mckibben.component.schema import read_component
from mckibben.control.base import field_of, with_fields
from mckibben.errors import IdentificationError, ParameterError
from mckibben.numerics.compiled import numeric
from mckibben.rig.compiled import FlatTree
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.units import Duration, Strength

_FIELDS = {"joint": "model"}  # of a controller, of parts of a plant that have another name

AnyScenario = Scenario | RobotScenario


@dataclass(frozen=True)
class InService(Checked):
    """Settings of the estimate in service; a file has these fields with units.

    Attributes
    ----------
    estimate
        File of the calibration, `estimate.json`.
    follow
        Whether the controller's model follows the estimate; else it is only told.
    limit
        Most change of a muscle's force since the calibration that the model follows, relative.
    block, forgetting
        Time between two estimates [s], and time constant with which measurements are forgotten [s].
    """

    estimate: Path
    follow: bool = True
    limit: Strength = 0.25
    block: Duration = 2.0
    forgetting: Duration = 15.0

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> InService:
        """Read a file; raises `ScenarioError` with every problem: line, field, value, range and remedy."""
        return read_component(cls, Path(path))


def read_estimate(path: Path) -> Posterior:
    """Read a calibration; raises `IdentificationError` if the file is not that of one."""
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        model = first_model_of(Scenario.parse(read["scenario"], source=str(path), folder=path.parent))
        scales = tuple(Scales(*map(float, row)) for row in read["scales"])
        problem = CalibrationProblem(with_friction(model, scales), scales, read["muscles"], tuple(read["others"]))
        z, covariance = (np.array(read[name], float) for name in ("z", "covariance"))
        if covariance.shape != (problem.size,) * 2 or z.shape != (problem.size,):
            raise ValueError("its numbers do not match its scenario")
    except (OSError, ValueError, KeyError, TypeError) as error:
        message, remedy = f"{path} is not the estimate of a calibration: {error}", "give that of `mckibben calibrate`"
        raise IdentificationError(message, field="estimate", remedy=remedy) from None
    return Posterior(problem, LocalMinimum(z, covariance), float(read["tube"]))


class Serving:
    """Estimate alongside a control loop, whose controller's model follows it.

    Attributes
    ----------
    scenario
        The scenario, whose controller has the calibrated model.
    """

    def __init__(self, scenario: AnyScenario, settings: InService) -> None:
        posterior = read_estimate(settings.estimate)
        self._settings, self._problem, self._fixed = settings, posterior.problem, scenario.with_fixed_model()
        self._follower = Follower(posterior, block=settings.block, forgetting=settings.forgetting, limit=settings.limit)
        if not any(field_of(self._fixed.control(), name) is not None for name in self._parts()):
            message, remedy = "its controller has no model that could follow the estimate", "say `follow: false`"
            if settings.follow:
                raise ParameterError(f"{scenario.name}: {message}", field="follow", remedy=f"{remedy} in the file")
        self.scenario = self._with_model()

    def _parts(self) -> dict[str, object]:
        """Parts of the model of the last estimate, by fields of a controller."""
        return {_FIELDS.get(name, name): part for name, part in model_at(self._problem, self._follower.z).parts.items()}

    def _with_model(self) -> AnyScenario:
        control = with_fields(self._fixed.control(), self._parts())
        return self._fixed.model_copy(update=self._fixed.controlled_by(control))

    def add(self, samples: Floats) -> Floats | None:
        """Take rows of time [s], angles [rad] and pressures [Pa]; return numbers of a controller that changes."""
        joints, before = len(self._follower.names[0]), self._follower.z
        angles = samples[:, 1 : joints + 1]
        self._follower.add(samples[:, 0], angles if joints > 1 else angles[:, 0], samples[:, joints + 1 :])
        if not self._settings.follow or self._follower.z is before:
            return None
        controller = numeric(self._with_model().control().with_period(self._fixed.control_period))
        return FlatTree.like(controller).pack(controller)

    def result(self) -> Service:
        """Return the estimates."""
        return self._follower.result()


_here: list[Serving] = []  # of a process that estimates


def _begin(scenario: str, settings: InService) -> None:
    _here.append(Serving(Scenario.parse(scenario), settings))


def _add(samples: Floats) -> Floats | None:
    return _here[0].add(samples)


def _result() -> Service:
    return _here[0].result()


class ServingElsewhere:
    """`Serving` in another process, so that the control loop never waits for it."""

    def __init__(self, scenario: AnyScenario, settings: InService) -> None:
        self.scenario = Serving(scenario, settings).scenario
        context, arguments = get_context("spawn"), (scenario.dumps(), settings)
        self._pool = ProcessPoolExecutor(1, context, _begin, arguments)
        self._pool.submit(_result).result()  # it is ready
        self._waiting: list[Future[Floats | None]] = []

    def add(self, samples: Floats) -> Floats | None:
        """Take rows of samples, and return what those before have given, if they are done."""
        self._waiting.append(self._pool.submit(_add, samples))
        numbers = None
        while self._waiting[0].done():
            latest = self._waiting.pop(0).result()
            numbers = numbers if latest is None else latest
            if not self._waiting:
                break
        return numbers

    def result(self) -> Service:
        """Return the estimates, when all samples are used."""
        with self._pool:
            return self._pool.submit(_result).result()


def serve(scenario: AnyScenario, settings: InService, *, elsewhere: bool) -> Serving | ServingElsewhere:
    """Return the estimate alongside a run of a scenario, for a paced loop in another process."""
    return (ServingElsewhere if elsewhere else Serving)(scenario, settings)
