"""Drop landings over stiffness, drop height and valve, with the effect of scatter of muscles and masses."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from numpy.typing import NDArray

from mckibben.actuator import AirActuator, IdealValve
from mckibben.component.columns import attributes
from mckibben.dataset.schema import write_netcdf
from mckibben.errors import McKibbenError, Problem, RangeError, ScenarioError
from mckibben.notebook import Progress
from mckibben.plant.base import MOST_SUBSTEPS
from mckibben.result import Column, Listing, Result
from mckibben.robot.control import PressureSchedule
from mckibben.robot.metrics import RobotMetrics
from mckibben.robot.plant import RobotPlant, RobotStart
from mckibben.robot.scenario import RobotScenario
from mckibben.robot.simulate import simulate_robots
from mckibben.robot.uncertainty import drawn_air, drawn_plant, take
from mckibben.simulation.accuracy import STEP_COLUMNS, StepCounts, integration_sentence
from mckibben.simulation.batch import Batch
from mckibben.simulation.software import engine_of_job, software
from mckibben.study.study import Study, Table, select
from mckibben.units import bar, deg, mm, ms

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
        [m], ``stiffness`` [N*m/rad] and ``draw``, of which 0 is nominal.
    pressures
        Commands [Pa] for each stiffness, shape (stiffness, muscles).
    attainable
        Attainable stiffness [N*m/rad] of the joint at touchdown.
    """

    figures = ("landing_forces",)
    files = ("robot.yaml", "landing.nc")

    scenario: RobotScenario
    table: xr.Dataset
    pressures: Floats
    attainable: tuple[float, float]

    @property
    def joint(self) -> str:
        """Name of the joint whose stiffness varies."""
        return self._landing.joint

    @property
    def angles(self) -> tuple[float, ...]:
        """Angles [rad] of the joints at touchdown."""
        return self.scenario.robot.posture_angles(self._landing.touchdown)

    def body_weights(self, name: str = "peak_force") -> Floats:
        """A force in weights of the robot, shape (valve, drop, stiffness, draw)."""
        return self.table[name].to_numpy() / self.table["weight"].to_numpy()

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

    def listings(self) -> Iterator[Listing]:
        """Yield a table with a row for each valve and drop, at the robust and at the nominal best stiffness.

        Forces are 95 % quantiles on the trunk in its weights, shares those of the draws in which the joint meets a
        stop.
        """
        landings = self.to_dict()["landings"]

        def column(name: str, key: str, unit: str, title: str, shown: str = "") -> dict[str, tuple[Column, Any]]:
            return {name: (Column(unit, title, shown, digits=3), [landing[key] for landing in landings])}

        columns = column("valve", "valve", "", "valve") | column("drop", "drop_mm", "mm", "drop")
        for kind, title in (("robust", "robust stiffness"), ("best", "nominal best stiffness")):
            columns |= column(f"{kind}_stiffness", f"{kind}_stiffness", "N*m/rad", title)
            columns |= column(f"{kind}_force", f"{kind}_trunk_force_95_weights", "1", "95 % force")
            columns |= column(f"{kind}_share", f"{kind}_bottoms_out_share", "1", "bottoms out", "%")
        remarks = [_remark(landing) for landing in landings]
        title = f"{self.scenario.name}: force on the trunk in its weights"
        yield Listing(title, columns | {"remark": (Column(), remarks)})

    def write(self, folder: Path) -> None:
        """Write the file of the robot, and the landings."""
        self.scenario.to_yaml(folder / "robot.yaml")
        write_netcdf(self.table, folder / "landing.nc")

    def to_dict(self) -> dict[str, Any]:
        """The results as plain data; intervals are 5 to 95 % of the draws."""
        best, robust, table = self.best(), self.robust(), self.table
        stiffness, quantile = table["stiffness"].to_numpy(), self.trunk_quantile()
        trunk = self.trunk_weights()
        bottoms = self.bottoms_out()
        landings = []
        for v, valve in enumerate(table["valve"].to_numpy()):
            for d, drop in enumerate(table["drop"].to_numpy()):
                at, sure = int(best[v, d, 0]), int(robust[v, d])
                low, high = np.percentile(stiffness[best[v, d, 1:]], EDGES)
                landings.append(
                    {
                        "valve": str(valve),
                        "drop_mm": float(drop / mm),
                        "best_stiffness": float(stiffness[at]),
                        "best_stiffness_interval": [float(low), float(high)],
                        "best_trunk_force_95_weights": float(quantile[v, d, at]),
                        "robust_stiffness": float(stiffness[sure]),
                        "robust_trunk_force_95_weights": float(quantile[v, d, sure]),
                        "robust_bottoms_out_share": float(bottoms[v, d, sure, 1:].mean()),
                        "avoids_stop": bool((~bottoms[v, d, :, 0]).any()),
                        "best_bottoms_out": bool(bottoms[v, d, at, 0]),
                        "peak_trunk_force_interval": np.percentile(trunk[v, d, at, 1:], EDGES).tolist(),
                        "best_bottoms_out_share": float(bottoms[v, d, at, 1:].mean()),
                    }
                )
        return {
            "scenario": self.scenario.name,
            "touchdown_deg": {name: angle / deg for name, angle in self._landing.touchdown.items()},
            "attainable_stiffness": list(self.attainable),
            "stiffness": stiffness.tolist(),
            "pressures_bar": (self.pressures / bar).tolist(),
            "runs": int(table["peak_force"].size),
            "engine": table.attrs["engine"],
            "integration": self._integration(),
            "landings": landings,
        }

    def bottoms_out(self) -> NDArray[np.bool_]:
        """Whether the joint whose stiffness varies meets a stop, shape (valve, drop, stiffness, draw)."""
        return self.table["stop_torque"].to_numpy() > 0

    def verdict(self) -> str:
        """Return the integration error of all landings."""
        return integration_sentence(self._integration())

    def _integration(self) -> dict[str, Any]:
        return StepCounts(*(self.table[name].to_numpy() for name in STEP_COLUMNS)).summary()

    @property
    def _landing(self) -> Any:
        return self.scenario.landing


def _remark(landing: dict[str, Any]) -> str:
    """Remarks on limits of the chosen stiffness."""
    if not landing["avoids_stop"]:
        return "no stiffness avoids the stop"
    return "the nominal best bottoms out" if landing["best_bottoms_out"] else ""


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
        File of the robot, its name for errors, and the engine, as for `simulate_robots`.
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
    study, attainable = Landings.of(scenario, source)
    study = study.with_known_engine(engine)
    records = study.run(out, resume=resume, progress=progress)
    return LandingStudy(scenario, study.table(records.columns), study.pressures, attainable)


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
    def of(cls, scenario: RobotScenario, source: str) -> tuple[Landings, tuple[float, float]]:
        """Return the landings of a scenario, and the attainable stiffness [N*m/rad] of the joint."""
        landing, plant = scenario.landing, scenario.plant()
        assert landing is not None
        robot, angles = plant.robot, plant.robot.posture_angles(landing.touchdown)
        index = robot.index(landing.joint)
        low, high = (float(edge) for edge in robot.pair(index).attainable_stiffness(angles[index], 0.0))
        wanted = landing.stiffness
        stiffness = np.linspace(low + 1e-6, high - 1e-6, landing.levels) if wanted is None else np.sort(wanted)
        others: list[float | None] = [None] * len(robot.joints)
        try:
            rows = [[*others[:index], float(level), *others[index + 1 :]] for level in stiffness]
            pressures = np.array([robot.pressures_for(angles, [0.0] * len(angles), row) for row in rows])
            for row in pressures.tolist():
                plant.init_state(angles, row)  # within the supply
            valves = _valves(plant, landing.time_constants)
            for valve in valves.values():
                own = eqx.tree_at(lambda x: x.valve, plant, valve)
                own.check_substeps(angles, None, scenario.control_period, scenario.substeps or MOST_SUBSTEPS)
        except McKibbenError as error:
            fields = {"substeps": "control_period", "time_constants": "landing.time_constants"}
            field = fields.get(error.field, "landing.stiffness")
            raise ScenarioError(source, [Problem.of(error, field=field)]) from error
        drawn = drawn_plant(scenario)
        return cls(scenario, source, valves, stiffness, pressures, drawn, software()), (low, high)

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

    @property
    def _landing(self) -> Any:
        return self.scenario.landing

    @property
    def _shape(self) -> tuple[int, ...]:
        return len(self.valves), len(self._landing.drop), self.stiffness.size, self.scenario.uncertainty.draws + 1

    def _land(self, rows: Table, engine: str) -> Batch:
        """Landings with one valve."""
        valve = drawn_air(list(self.valves.values())[int(rows["valve"][0])], self.scenario.uncertainty)
        commands = tuple(self.pressures[rows["stiffness"]].T)
        speeds = -np.sqrt(2 * self.drawn.gravity * np.array(self._landing.drop)[rows["drop"]])
        return simulate_robots(
            take(eqx.tree_at(lambda x: x.valve, self.drawn, valve), rows["draw"]),
            PressureSchedule(tuple((command,) for command in commands)),
            RobotStart(self.scenario.robot.posture_angles(self._landing.touchdown), commands, 0.0, speeds),
            duration=self.scenario.whole_steps(self._landing.duration),
            **self.scenario.steps,
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
