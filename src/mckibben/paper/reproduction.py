"""Reproduction of the paper, end to end: test, identification, validation, joint, control, claims.

The numbers of results.json and the report follow from `Reproduction` alone.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mckibben.export import export
from mckibben.identification import Validation
from mckibben.identification.reporting import fit_numbers
from mckibben.notebook import Progress, notebook_progress
from mckibben.paper.claims import Claim, evaluate_claims
from mckibben.paper.identification import Identification, run_identification, run_joint
from mckibben.paper.settings import PRE_CONTRACTED, SETTINGS, StiffnessReference
from mckibben.paper.tracking import TUNED_PID, ControllerRun, Tracking, run_tracking
from mckibben.reachability import StaticEnvelope
from mckibben.result import Result, TableColumns, row_columns, table
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import SimulationResult
from mckibben.simulation.metrics import METRICS
from mckibben.storage.files import json_ready
from mckibben.study.tune import TuneResult
from mckibben.units import bar, deg, factor


class Reproduction(Result):
    """All results of the reproduction of the paper.

    Parameters
    ----------
    identification, joint, tracking
        Results of test and identification, the static envelope of the knee by setting key, and the runs of Figs. 7, 8.
    leg
        Position and stiffness of all joints of the leg at once.
    claims
        The paper's claims, then our questions, with verdicts.
    quick
        Whether repeats, seeds and tuning were reduced.
    seconds
        Duration.
    """

    identification: Identification
    joint: dict[str, StaticEnvelope]
    tracking: Tracking
    leg: SimulationResult
    claims: tuple[Claim, ...]
    quick: bool
    seconds: float

    @property
    def paper_claims(self) -> list[Claim]:
        """The claims that the paper makes."""
        return [claim for claim in self.claims if claim.of_paper]

    @property
    def questions(self) -> list[Claim]:
        """Our own questions, which the paper does not address."""
        return [claim for claim in self.claims if not claim.of_paper]

    def verdict(self) -> str:
        """Return how many of the paper's testable claims hold, and how many rest on its muscle."""
        testable = [claim for claim in self.paper_claims if not claim.needs_muscle]
        hold, others = sum(claim.holds for claim in testable), len(self.paper_claims) - len(testable)
        counted = "and hold" if hold == len(testable) else f"of which {hold} hold"
        published = f"{others} rest on a muscle that was not published"
        return f"{len(testable)} of the paper's claims can be tested here {counted}; {published}."

    @table("The paper's claims")
    def paper_verdicts(self) -> TableColumns:
        """Verdicts on the paper's claims."""
        return _verdicts(self.paper_claims)

    @table("Our own questions")
    def own_verdicts(self) -> TableColumns:
        """Verdicts on our own questions."""
        return _verdicts(self.questions)

    def numbers(self) -> dict[str, Any]:
        """Return all numbers as plain data for JSON, in the units of their keys; NaN as None."""
        return json_ready(
            {
                "mckibben": version("mckibben"),
                "versions": {name: version(name) for name in ("jax", "numpy", "equinox")},
                "python": platform.python_version(),
                "quick": self.quick,
                "seconds": self.seconds,
                "seeds": self.tracking.seeds,
                "settings": {setting.key: asdict(setting) for setting in SETTINGS},
                "rig": _rig(self.identification),
                "identification": {name: fit_numbers(fit) for name, fit in self.identification.fits.items()},
                "validation": _validation(self.identification),
                "joint": {setting.key: _joint(self.joint[setting.key]) for setting in SETTINGS},
                "tracking": _tracking(self.tracking),
                "tuning": {key: _tuned(tuned) for key, tuned in self.tracking.tuned.items()},
                "coupling": {
                    key: {
                        "angle_by_step_deg": coupling.angle_by_step / deg,
                        "stiffness_by_motion": coupling.stiffness_by_motion,
                        "stiffness_at_rest": coupling.stiffness_at_rest,
                    }
                    for key, coupling in self.tracking.coupling.items()
                },
                "leg": _leg(self.leg),
                "claims": [asdict(claim) | {"of_paper": claim.of_paper} for claim in self.claims],
            }
        )

    def saved(self, names: Sequence[str]) -> dict[str, object]:
        """Return the numbers alone."""
        return self.numbers()

    def write(self, folder: Path) -> None:
        """Write fits, datasets, scenarios, trajectories and, unless quick, a knee to move to a folder.

        A scenario that is run alone gives its trajectory to the last bit.
        """
        for name in ("fits", "data", "scenarios", "trajectories"):
            (folder / name).mkdir(exist_ok=True)
        for name, fit in self.identification.fits.items():
            fit.to_yaml(folder / "fits" / f"{name}.yaml")
        self.identification.rig.test.to_netcdf(folder / "data" / "virtual-rig-test.nc")
        self.identification.rig.retest.to_netcdf(folder / "data" / "virtual-rig-retest.nc")
        for (key, reference, controller), run in self.tracking.runs.items():
            name = file_stem(key, reference, controller)
            run.scenario.to_yaml(folder / "scenarios" / f"{name}.yaml")
            run.result.to_netcdf(folder / "trajectories" / f"{name}.nc")
        RobotScenario.parse(self.leg.scenario).to_yaml(folder / "scenarios" / "leg.yaml")
        self.leg.to_netcdf(folder / "trajectories" / "leg.nc")
        if not self.quick:
            knee = self.tracking.runs[PRE_CONTRACTED.key, StiffnessReference.STEP, TUNED_PID].scenario
            export(knee, "page", folder / "knee", name="knee", overwrite=True)


def file_stem(key: str, reference: StiffnessReference, controller: str) -> str:
    """Return the file name of a run without its extension.

    >>> file_stem("as_printed", StiffnessReference.STEP, "BP on tuned gains, free")
    'as-printed-step-bp-on-tuned-gains-free'
    """
    return "-".join((key, reference.value, controller)).lower().replace(",", "").replace(" ", "-").replace("_", "-")


def reproduce(*, quick: bool = False, progress: Progress | None = None) -> Reproduction:
    """Reproduce the paper: test, identification, validation, joint, and control of position and stiffness.

    Parameters
    ----------
    quick
        Two repeats of the test instead of five, 5 seeds of BP instead of 20, and a shorter tuning.
    progress
        Called with the current step and the completed fraction, 0 to 1. Default: a progress bar in notebooks.

    Returns
    -------
    Reproduction
        All results; it takes some minutes, as both geometries are compiled and tuned.
    """
    progress = progress or notebook_progress()
    start = time.perf_counter()

    def report(what: str, fraction: float) -> None:
        if progress:
            progress(what, fraction)

    with ThreadPoolExecutor(max_workers=1) as pool:  # both spend most time compiling, on one core each
        muscle = pool.submit(run_identification, repeats=2 if quick else 5)
        knee = pool.submit(run_joint)
        leg = pool.submit(run_leg)
        what = "isobaric test and identification; control of position and stiffness"
        report(what, 0.0)

        def tracked(fraction: float) -> None:
            report(what, 0.95 * fraction)
            for other in (muscle, knee, leg):
                if other.done():
                    other.result()  # raises its error

        tracking = run_tracking(
            seeds=5 if quick else 20, generations=4 if quick else 30, population=16 if quick else 32, progress=tracked
        )
        identification, joint, robot = muscle.result(), knee.result(), leg.result()
    report("claims", 0.95)
    claims = evaluate_claims(identification, joint, tracking)
    return Reproduction(identification, joint, tracking, robot, claims, quick, time.perf_counter() - start)


def _verdicts(claims: Sequence[Claim]) -> TableColumns:
    """Columns of claims, the verdict first."""
    columns = row_columns(Claim, claims)
    return {"verdict": columns.pop("verdict")} | columns


def run_leg() -> SimulationResult:
    """The experiment on the knee, on all joints of the leg at once, with computed torque."""
    text = (resources.files("mckibben.paper") / "leg.yaml").read_text(encoding="utf-8")
    return RobotScenario.parse(text).run_once()


def _rig(identification: Identification) -> dict[str, object]:
    """Size of the test on the simulated rig, its friction [N], and the law that it measures, in the units of Eq. 3."""
    test = identification.rig
    return {
        "plateaus": len(test.test),
        "samples": test.samples,
        "points_away_from_turns": len(test.settled),
        "repeats": test.protocol.repeats,
        "hysteresis_N": test.rig.hysteresis,
        "published": {
            p.name: getattr(test.muscle.law, p.name) / factor(p.shown, p.unit) for p in test.muscle.law.parameters()
        },
    }


def _validation(identification: Identification) -> dict[str, object]:
    """RMSE [N] of the laws on the second test, on held-out points, and on the measured muscles."""
    on_rig = {
        "retest": identification.retested,
        "held_out_pressures": identification.held_out_pressures,
        "held_out_repeat": identification.held_out_repeat,
    }
    return {f"{name}_rmse_N": _errors(validation) for name, validation in on_rig.items()} | {
        "measured_rmse_N": {name: _errors(validation) for name, validation in identification.measured.items()}
    }


def _errors(validation: Validation) -> dict[str, dict[str, float]]:
    """RMSE [N] of each law over all points, by direction, by pressure, and by both."""
    table: dict[str, dict[str, float]] = {}
    for errors in validation.errors:
        place = [] if errors.pressure is None else [f"{errors.pressure / bar:g} bar"]
        place += [errors.direction] if errors.direction else []
        table.setdefault(errors.law, {})[", ".join(place) or "all"] = errors.rmse
    return table


def _joint(static: StaticEnvelope) -> dict[str, object]:
    """Attainable stiffness [N*m/rad] at 0 deg and static range [deg] of a geometry."""
    limits = [static.angle_min / deg, static.angle_max / deg]
    return {"attainable_stiffness_at_0_deg": list(static.at(0.0)), "static_range_deg": limits}


def _tracking(tracking: Tracking) -> dict[str, dict[str, dict[str, object]]]:
    """Metrics of all runs by geometry, stiffness reference and controller."""
    table: dict[str, dict[str, dict[str, object]]] = {}
    for (key, reference, controller), run in tracking.runs.items():
        table.setdefault(key, {}).setdefault(reference.value, {})[controller] = _run(run)
    return table


def _run(run: ControllerRun) -> dict[str, object]:
    """Metrics of a run in shown units: median and worst over seeds, and the number of unstable seeds."""
    numbers: dict[str, object] = {name: run.median(metric) / unit for name, (metric, _, unit) in METRICS.items()}
    if run.seeds is not None:
        numbers["worst"] = {name: run.worst(metric) / unit for name, (metric, _, unit) in METRICS.items()}
        numbers["unstable"] = run.unstable
    return numbers | {"outcome": run.result.verdict()}


def _leg(run: SimulationResult) -> dict[str, object]:
    """RMS errors of angle [deg] and stiffness [N*m/rad] of each joint of the leg."""
    errors = zip(run.metrics["angle_rmse"] / deg, run.metrics["stiffness_rmse"], strict=True)
    return {
        joint: {"angle_rmse_deg": float(angle), "stiffness_rmse": float(stiffness)}
        for joint, (angle, stiffness) in zip(run.joints, errors, strict=True)
    }


def _tuned(tuned: TuneResult) -> dict[str, object]:
    """Tuned gains in SI, and the costs before and after."""
    control: Any = tuned.scenarios[0].control()
    return {
        "position": {name: getattr(control.position, name) for name in ("kp", "ki", "kd")},
        "stiffness": {name: getattr(control.stiffness, name) for name in ("kp", "ki", "kd")},
        "cost": tuned.cost,
        "cost_before": tuned.cost_before,
        "evaluated": tuned.evaluated,
        "at_bound": list(tuned.at_bound),
    }
