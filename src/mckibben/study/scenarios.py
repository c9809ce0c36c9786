"""Studies of a scenario over its parameters: a class with one method, `compute`, is such a study."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from mckibben.errors import FileError, McKibbenWarning, ParameterError, Problem
from mckibben.scenario import StudiedScenario, batched
from mckibben.simulation.software import software
from mckibben.storage.store import STUDY, check_study, open_store
from mckibben.study.parameters import (
    Distribution,
    SamplingMethod,
    SweptParameter,
    parse_sweeps,
    sample,
    sweep_parameters,
)
from mckibben.study.study import Records, Study, Table, digest, select

Sweepable = Sequence[str | SweptParameter] | Mapping[str, Distribution]
"""Parameters and their distributions: texts for `parse_sweep`, or objects."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ScenarioStudy(Study):
    """A study of a scenario: its rows are values [SI] of varied parameters by name; a subclass computes its records.

    Examples
    --------
    >>> class Gravity(ScenarioStudy):
    ...     "Stiffness of gravity [N*m/rad] at 0 deg."
    ...
    ...     def compute(self, rows):
    ...         return {"gravity": self.scenarios(rows).plant().load.gravity_stiffness(0.0)}
    >>> from mckibben.scenario import Scenario
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
    >>> records = Gravity.carry_out(scenario, ["load.mass2=0.2 kg..0.8 kg"], samples=4)
    >>> records.rows["load.mass2"].shape == records.columns["gravity"].shape == (4,)
    True
    """

    format: ClassVar[str] = ""
    """Name of the kind of study in its file. Default: module and class."""

    scenario: StudiedScenario
    swept: tuple[SweptParameter, ...]
    design: SamplingMethod
    samples: int
    seed: int
    folder: str = "."  # base of paths in the settings

    @classmethod
    def of(
        cls,
        scenario: StudiedScenario,
        over: Sweepable | None,
        begun: Mapping[str, Any] | None = None,
        *,
        design: str | None = None,
        samples: int | None = None,
        seed: int | None = None,
        **settings: Any,
    ) -> Self:
        """Return a study; arguments that are None are taken from the settings of a `begun` one, or have their defaults.

        Raises `ParameterError` for invalid arguments, or if a row of values does not give a valid scenario.
        """
        begun = begun or {}
        method: Any = design or begun.get("design", "sobol")
        swept = _swept(begun.get("over") if over is None else over, scenario)
        if method == "grid" and samples is not None:
            message, remedy = "the points of a grid determine the number of runs", "leave the number of samples out"
            raise ParameterError(message, value=samples, remedy=f"{remedy}, or choose another design")
        samples = begun.get("samples", 1024) if samples is None else samples
        seed = 0 if method == "grid" else begun.get("seed", 0) if seed is None else seed
        table = sample(swept, method, samples, seed)
        batched(scenario, table)  # finds invalid combinations before the computation
        rows = len(next(iter(table.values())))
        return cls(scenario=scenario, swept=swept, design=method, samples=rows, seed=seed, **settings)

    @classmethod
    def carry_out(
        cls,
        scenario: StudiedScenario,
        over: Sweepable | None = None,
        *,
        out: str | os.PathLike[str] | None = None,
        resume: bool = False,
        design: str | None = None,
        samples: int | None = None,
        seed: int | None = None,
        **running: Any,
    ) -> Records:
        """Return the records of a study.

        Parameters
        ----------
        scenario
            Scenario with the nominal values.
        over
            Varied parameters: texts such as "load.mass2=0.2 kg..1.0 kg" (see `parse_sweep`), or distributions [SI].
        out, resume
            Folder of the study, and whether to continue it: arguments left out are taken from it, others must match.
        design, samples, seed
            Sampling as for `mckibben.study.parameters.sample`. Defaults: "sobol", 1024 and 0.
        running
            Options of `Study.run`.

        Raises
        ------
        ParameterError, FileError, InterruptedStudy
            As `mckibben.sweep`.
        """
        begun = begun_settings(out, cls._format(), resume=resume)
        sampling: dict[str, Any] = {"design": design, "samples": samples, "seed": seed}
        study = cls.of(scenario, over, begun, **sampling, folder="." if out is None else os.fspath(out))
        return study.run(out, resume=resume, **running)

    @classmethod
    def _format(cls) -> str:
        return cls.format or f"{cls.__module__}.{cls.__qualname__}"

    def about(self) -> dict[str, object]:
        """Return scenario, parameters, sampling and software, for JSON."""
        first = self.scenarios(select(self.rows(), slice(1)))
        return {
            "format": self._format(),
            "scenario": self.scenario.dumps(folder=self.folder),
            "over": [parameter.text for parameter in self.swept],
            "design": self.design,
            "samples": self.samples,
            "seed": self.seed,
            "software": software(),
            "digest of values": digest(self.rows()),
            "digest of model": digest((first.plant(), first.control(), first.references())),
        }

    def rows(self) -> Table:
        """Return the values of the varied parameters [SI], shape (samples,)."""
        return sample(self.swept, self.design, self.samples, self.seed)

    def scenarios(self, rows: Table) -> StudiedScenario:
        """Return the scenarios of some rows as one, whose plant, controller and reference have arrays (`batched`)."""
        return batched(self.scenario, rows)


def begun_settings(out: str | os.PathLike[str] | None, kind: str, *, resume: bool) -> dict[str, Any]:
    """Return the settings of the study of a kind in a folder that is continued; none of a new one.

    A study that was killed before its settings were recorded has none, which is a warning. Raises `ParameterError`
    without a folder to continue; `FileError` as `open_store`, or if the study is of another kind.
    """
    if out is None:
        if resume:
            raise ParameterError("there is no study to continue", remedy="give its folder")
        return {}
    path = Path(out) / STUDY
    check_study(path, resume=resume)
    if not resume:
        return {}
    with open_store(path, resume=True) as store:
        about, blank = store.about(), store.is_blank()
    if about is None and blank:
        text = f"{path}: nothing was recorded before, it begins with the options that are given now"
        warnings.warn(text, McKibbenWarning, stacklevel=1)
        return {}
    if about is None or about.get("format") != kind:
        raise FileError(str(path), [Problem("it is a study of another kind", remedy="choose another folder")])
    return about


def _swept(over: Sweepable | None, scenario: StudiedScenario) -> tuple[SweptParameter, ...]:
    if isinstance(over, str):
        over = [over]
    if isinstance(over, Mapping) and over:
        return sweep_parameters(scenario, over)
    if not over:
        raise ParameterError("nothing is varied", remedy="give a parameter, such as --over 'load.mass2=0.2 kg..1.0 kg'")
    parsed = iter(parse_sweeps([text for text in over if isinstance(text, str)], scenario))
    return tuple(next(parsed) if isinstance(item, str) else item for item in over)
