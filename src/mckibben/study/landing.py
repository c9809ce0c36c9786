"""Drop landings over stiffness, drop height and valve, with the effect of scatter of muscles and masses."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from numpy.typing import NDArray

from mckibben.actuator import AirActuator, IdealValve
from mckibben.component.columns import attributes
from mckibben.control.robot_control import PressureSchedule
from mckibben.dataset.schema import write_netcdf
from mckibben.errors import McKibbenError, Problem, RangeError, ScenarioError
from mckibben.notebook import Progress
from mckibben.plant.base import MOST_SUBSTEPS
from mckibben.plant.robot_plant import RobotPlant, RobotStart
from mckibben.result import Column, Result, TableColumns
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation import simulate_many
from mckibben.simulation.accuracy import STEP_COLUMNS, StepCounts, integration_sentence
from mckibben.simulation.batch import Batch
from mckibben.simulation.robot_metrics import RobotMetrics
from mckibben.simulation.software import engine_of_job, software
from mckibben.study.robot_draws import drawn_plant, quantile_interval, take
from mckibben.study.study import Study, Table, select
from mckibben.units import ms

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

ISOBARIC, CLOSED = "constant pressures", "closed valves"
BEST_WITHIN = 0.02
"""The softest stiffness whose force on the trunk is within this part of the least one is the nominal best."""
_AXES = ("valve", "drop", "stiffness", "draw")
_COLUMNS = (*RobotMetrics._fields, *STEP_COLUMNS)
_SHUT = 1e-6  # of the conductance
EDGES = (5.0, 95.0)
"""Percentiles of the draws that are an interval."""


class LandingStudy(Result):
    """Landings of a robot.

    Attributes
    ----------
    scenario
        File of the robot.
    table
        `RobotMetrics`, ``substeps``, ``error_estimate`` [rad] and ``chaotic`` as in a `Batch`, over ``valve``, ``drop``
        [m], ``stiffness`` [N*m/rad] and ``draw``, of which 0 is nominal. Of fresh draws, at the robust and at the
        nominal best stiffness (``choice``), ``fresh_trunk_weights`` and ``fresh_stop_torque`` over ``fresh``.
    pressures
        Commands [Pa] for each stiffness, shape (stiffness, muscles).
    """

    figures = ("landing_forces",)
    files = ("robot.yaml", "landing.nc")

    scenario: RobotScenario
    table: xr.Dataset
    pressures: Floats

    @property
    def joint(self) -> str:
        """Name of the joint whose stiffness varies."""
        return self._landing.joint

    @property
    def angles(self) -> tuple[float, ...]:
        """Angles [rad] of the joints at touchdown."""
        return self.scenario.robot.posture_angles(self._landing.touchdown)

    def body_weights(self) -> Floats:
        """Largest force of the ground in weights of the robot, shape (valve, drop, stiffness, draw)."""
        return self.table["peak_force"].to_numpy() / self.table["weight"].to_numpy()

    def trunk_weights(self) -> Floats:
        """Largest force on the trunk in its weights, shape (valve, drop, stiffness, draw)."""
        return self.table["peak_trunk_force"].to_numpy() / self.table["trunk_weight"].to_numpy()

    def best(self) -> NDArray[np.int64]:
        """Index of the best stiffness: the softest commanded one with a force on the trunk within 2 % of the least.

        Shape (valve, drop, draw). It has no margin: a softer one may bottom out.
        """
        forces = np.moveaxis(self.table["peak_trunk_force"].to_numpy(), 2, -1)
        return np.argmax(forces <= forces.min(axis=-1, keepdims=True) * (1 + BEST_WITHIN), axis=-1)

    def robust(self) -> NDArray[np.int64]:
        """Index of the stiffness whose force on the trunk has the least 95 % quantile over the draws.

        Shape (valve, drop).
        """
        return np.argmin(self.trunk_quantile(), axis=-1)

    def trunk_quantile(self) -> Floats:
        """Quantile of 95 % over the draws of the force on the trunk [its weight], shape (valve, drop, stiffness)."""
        return np.percentile(self.trunk_weights()[..., 1:], EDGES[1], axis=-1)

    def declared(self) -> TableColumns:
        """Return columns with a row for each valve and drop, at the robust and at the nominal best stiffness.

        Forces are 95 % quantiles on the trunk in its weights with their 95 % interval, shares those of the draws in
        which the joint meets a stop, all of fresh draws, which did not choose the stiffness; of the nominal best
        stiffness there are 5 and 95 % of the draws.
        """
        best, levels, stopped = self.best(), self.table["stiffness"].to_numpy(), self.bottoms_out()
        weights, fresh_stops = (self.table[f"fresh_{name}"].to_numpy() for name in ("trunk_weights", "stop_torque"))
        ends = quantile_interval(weights, EDGES[1])
        valve, drop = np.meshgrid(self.table["valve"], self.table["drop"], indexing="ij")
        columns: dict[str, tuple[Column, Any]] = {
            "valve": (Column(), valve),
            "drop": (Column("m", "drop", "mm", digits=3), drop),
        }
        choices = ("robust", "robust", self.robust()), ("best", "nominal best", best[..., 0])
        for choice, (kind, title, at) in enumerate(choices):
            columns[f"{kind}_stiffness"] = Column("N*m/rad", f"{title} stiffness", digits=3), levels[at]
            force = np.percentile(weights[..., choice, :], EDGES[1], axis=-1)
            columns[f"{kind}_force"] = Column("1", "95 % trunk force", digits=3), force
            for end, word, bounds in zip(("low", "high"), ("from", "to"), ends, strict=True):
                columns[f"{kind}_force_{end}"] = Column("1", word, digits=3), bounds[..., choice]
            columns[f"{kind}_share"] = (
                Column("1", "bottoms out", "%", digits=3),
                (fresh_stops[..., choice, :] > 0).mean(axis=-1),
            )
        percentiles = np.percentile(levels[best[..., 1:]], EDGES, axis=-1)
        for name, edge, own in zip(("low", "high"), EDGES, percentiles, strict=True):
            columns[f"best_{name}"] = Column("N*m/rad", f"nominal best, {edge:g} % of draws", dims=("landing",)), own
        nominal = np.take_along_axis(stopped[..., 0], best[..., :1], axis=-1)[..., 0]
        remark = np.where(nominal, "the nominal best bottoms out", "")
        columns["remark"] = Column(), np.where(stopped[..., 0].all(axis=-1), "no stiffness avoids the stop", remark)
        rows = {name: (mark, np.ravel(values)) for name, (mark, values) in columns.items()}
        return rows | {
            "commanded": (Column("N*m/rad", "commanded stiffness", dims=("level",)), levels),
            "pressures": (Column("Pa", "commands", "bar", dims=("level", "muscle")), self.pressures),
        }

    def write(self, folder: Path) -> None:
        """Write the file of the robot, and the landings."""
        self.scenario.to_yaml(folder / "robot.yaml")
        write_netcdf(self.table, folder / "landing.nc")

    def bottoms_out(self) -> NDArray[np.bool_]:
        """Whether the joint whose stiffness varies meets a stop, shape (valve, drop, stiffness, draw)."""
        return self.table["stop_torque"].to_numpy() > 0

    def verdict(self) -> str:
        """Return the integration error of all landings."""
        return integration_sentence(self.integration())

    def integration(self) -> dict[str, Any]:
        """Return the steps and the integration error of all landings."""
        return StepCounts(*(self.table[name].to_numpy() for name in STEP_COLUMNS)).summary()

    @property
    def _landing(self) -> Any:
        return self.scenario.landing


def study_landing(
    scenario: RobotScenario,
    *,
    source: str = "",
    engine: str = "auto",
    out: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> LandingStudy:
    """Simulate the landings of a scenario.

    It touches the ground at the speed of the drop, in the posture `touchdown`; the commands are constant: those of
    the nominal robot for a stiffness without torque, as in free fall.

    Parameters
    ----------
    scenario, source, engine
        File of the robot, its name for errors, and the engine, as for `simulate_many`.
    out, resume
        Folder of the study, and whether to continue the one in it, as for `Study.run`.

    Raises
    ------
    ScenarioError
        If there is no section `landing`, or the stiffness of a joint is not attainable; with the attainable range.
    FileError, InterruptedStudy
        As for `Study.run`.
    """
    source = source or scenario.name
    if scenario.landing is None:
        raise ScenarioError(source, [Problem("lacks the section `landing`", remedy="see examples/robot/lei-leg.yaml")])
    study = Landings.of(scenario, source).with_known_engine(engine)
    records = study.run(out, resume=resume, progress=progress)
    result = LandingStudy(scenario, study.table(records.columns), study.pressures)
    chosen = np.stack([result.robust(), result.best()[..., 0]], axis=-1)
    return replace(result, table=result.table.assign(study.fresh(chosen)))


@dataclass(frozen=True, eq=False)
class Landings(Study):
    """Landings of a robot: rows are places on the axes of a `LandingStudy`, records are metrics."""

    scenario: RobotScenario
    source: str
    valves: Mapping[str, Any]
    stiffness: Floats
    pressures: Floats
    drawn: RobotPlant
    software: Mapping[str, str]

    unit = "landings"

    @classmethod
    def of(cls, scenario: RobotScenario, source: str) -> Landings:
        """Return the landings of a scenario."""
        landing, plant = scenario.landing, scenario.plant()
        assert landing is not None
        robot, angles = plant.robot, plant.robot.posture_angles(landing.touchdown)
        index = robot.index(landing.joint)
        low, high = (float(edge) for edge in robot.pair(index).attainable_stiffness(angles[index], 0.0))
        levels = np.linspace(low + 1e-6, high - 1e-6, landing.levels)
        stiffness = levels if landing.stiffness is None else np.sort(landing.stiffness)
        others: list[float | None] = [None] * len(robot.joints)
        try:
            rows = [[*others[:index], float(level), *others[index + 1 :]] for level in stiffness]
            pressures = np.array([robot.pressures_for(angles, [0.0] * len(angles), row) for row in rows])
            for row in pressures.tolist():
                plant.check_start(RobotStart(angles, row))  # within the supply
            valves = _valves(plant, landing.time_constants)
            for valve in valves.values():
                own = eqx.tree_at(lambda x: x.valve, plant, valve)
                own.check_substeps(angles, None, scenario.control_period, scenario.substeps or MOST_SUBSTEPS)
        except McKibbenError as error:
            fields = {"substeps": "control_period", "time_constants": "landing.time_constants"}
            field = fields.get(error.field, "landing.stiffness")
            raise ScenarioError(source, [Problem.of(error, field=field)]) from error
        drawn = drawn_plant(scenario)
        return cls(scenario, source, valves, stiffness, pressures, drawn, software())

    def about(self) -> dict[str, object]:
        """Return the file of the robot, and the software."""
        return {"format": "mckibben landings", "software": dict(self.software), "robot": self.scenario.dumps()}

    def rows(self) -> Table:
        """Return the place of each landing on each axis."""
        return dict(zip(_AXES, (axis.ravel() for axis in np.indices(self._shape)), strict=True))

    def block_size(self) -> int:
        """Return the number of landings that are computed and kept together."""
        return 512

    def compute(self, rows: Table, /) -> Table:
        """Return metrics of landings; raises `ScenarioError` if one diverges."""
        edges = [0, *(np.flatnonzero(np.diff(rows["valve"])) + 1), rows["valve"].size]
        spans = (slice(*pair) for pair in itertools.pairwise(edges))
        parts = [self._land(select(rows, span), self.software["engine"]) for span in spans]
        if any(batch.failed.any() for batch in parts):
            problem = Problem("landings diverge", field="control_period", remedy="give a shorter one")
            raise ScenarioError(self.source, [problem])
        tables = [batch.table.isel(joint=self.scenario.robot.index(self._landing.joint)) for batch in parts]
        return {name: np.concatenate([table[name].to_numpy() for table in tables]) for name in _COLUMNS}

    def with_known_engine(self, engine: str) -> Landings:
        """Return the study with the engine that computes all its landings, as a trial shows."""
        rows = self.rows()
        firsts = [select(rows, slice(at, at + 1)) for at in np.unique(rows["valve"], return_index=True)[1].tolist()]
        used = engine_of_job(lambda: {self._land(first, "auto").engine for first in firsts}, engine=engine)
        return replace(self, software=software(used))

    def table(self, columns: Table) -> xr.Dataset:
        """Return the records over the axes, with the weights of robot and trunk [N] of each draw."""
        import xarray as xr

        coords = {
            "valve": list(self.valves),
            "drop": ("drop", np.array(self._landing.drop), {"units": "m"}),
            "stiffness": ("stiffness", self.stiffness, {"units": "N*m/rad"}),
        }
        found: dict[str, tuple[Any, ...]] = {
            name: (_AXES, columns[name].reshape(self._shape), attributes(name)) for name in _COLUMNS
        }
        gravity = float(self.drawn.gravity)
        robot = self.drawn.robot
        for name, mass in {"weight": robot.total_mass, "trunk_weight": robot.bodies[0].mass}.items():
            found[name] = ("draw", np.broadcast_to(np.asarray(mass), self._shape[-1:]) * gravity, {"units": "N"})
        return xr.Dataset(found, coords=coords, attrs={"engine": self.software["engine"], "gravity": gravity})

    def fresh(self, chosen: NDArray[np.int64]) -> dict[str, tuple[Any, ...]]:
        """Return the columns of fresh draws at chosen places of the stiffness, of shape (valve, drop, choice)."""
        landings = replace(self, drawn=drawn_plant(self.scenario, fresh=True))
        shape = (*chosen.shape, self.scenario.uncertainty.draws)
        valve, drop, _, draw = np.indices(shape)
        places = valve, drop, np.broadcast_to(chosen[..., None], shape), draw + 1
        columns = landings.compute(dict(zip(_AXES, map(np.ravel, places), strict=True)))
        force, torque = (columns[name].reshape(shape) for name in ("peak_trunk_force", "stop_torque"))
        weight = np.broadcast_to(landings.drawn.robot.bodies[0].mass * landings.drawn.gravity, shape[-1] + 1)[1:]
        axes = *_AXES[:2], "choice", "fresh"
        return {
            "fresh_trunk_weights": (axes, force / weight, {"units": "1"}),
            "fresh_stop_torque": (axes, torque, attributes("stop_torque")),
        }

    @property
    def _landing(self) -> Any:
        return self.scenario.landing

    @property
    def _shape(self) -> tuple[int, ...]:
        return len(self.valves), len(self._landing.drop), self.stiffness.size, self.scenario.uncertainty.draws + 1

    def _land(self, rows: Table, engine: str) -> Batch:
        """Landings with one valve."""
        valve = list(self.valves.values())[int(rows["valve"][0])]
        commands = tuple(self.pressures[rows["stiffness"]].T)
        speeds = -np.sqrt(2 * self.drawn.gravity * np.array(self._landing.drop)[rows["drop"]])
        return simulate_many(
            take(eqx.tree_at(lambda x: x.valve, self.drawn, valve), rows["draw"]),
            PressureSchedule(tuple((command,) for command in commands)),
            initial=RobotStart(self.scenario.robot.posture_angles(self._landing.touchdown), commands, 0.0, speeds),
            **self.scenario.timing_over(self._landing.duration),
            engine=engine,
            workers=1,
        )


def _valves(plant: RobotPlant, time_constants: tuple[float, ...]) -> dict[str, Any]:
    """Valves by name: constant pressures, given time constants, and closed."""
    valve: Any = plant.valve
    found: dict[str, Any] = {ISOBARIC: IdealValve()}
    if valve.holds_air:
        found |= {f"{one / ms:g} ms": valve_with(valve, plant, one) for one in time_constants}
        found[CLOSED] = valve.scaled(_SHUT)
    return found


def valve_with(valve: AirActuator, plant: RobotPlant, time_constant: float) -> AirActuator:
    """Return a valve with a conductance for a time constant [s] at small changes of its command.

    For the first muscle of the robot, in the middle of its pressures and contractions (`AirActuator.time_constant_at`).

    Raises
    ------
    RangeError
        If the time constant is not above the valve's own lag.
    """
    muscle = plant.robot.all_muscles[0]
    domain = muscle.domain
    volume = float(muscle.specimen.volume((domain.contraction_min + domain.contraction_max) / 2))
    pressure = (domain.pressure_min + domain.pressure_max) / 2
    now, slower = (float(one.time_constant_at(pressure, volume)) for one in (valve, valve.scaled(0.5)))
    lag = 2 * now - slower  # what the flow adds to it is inversely proportional to the conductance
    if not time_constant > lag:
        raise RangeError(
            f"a time constant of {time_constant / ms:g} ms is not above the lag of the valve",
            field="time_constants",
            value=time_constant,
            lower=lag,
            unit="s",
            remedy="give a longer one, or a valve with less lag",
        )
    return valve.scaled((now - lag) / (time_constant - lag))
