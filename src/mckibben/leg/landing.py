"""Drop landings over stiffness, drop height and valve, with the effect of scatter of muscles and masses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from numpy.typing import NDArray

from mckibben.actuator import AirActuator, IdealValve
from mckibben.component.columns import attributes
from mckibben.errors import McKibbenError, Problem, RangeError, ScenarioError, SimulationError
from mckibben.leg.control import PressureSchedule
from mckibben.leg.metrics import LegMetrics
from mckibben.leg.plant import LegPlant, LegStart
from mckibben.leg.scenario import LegScenario
from mckibben.leg.simulate import simulate_legs
from mckibben.leg.study_journal import StudyJournal, StudyKind, check_continued
from mckibben.leg.uncertainty import drawn_air, drawn_plant, take
from mckibben.notebook import Progress, silent
from mckibben.plant.base import MOST_SUBSTEPS
from mckibben.simulation.accuracy import STEP_COLUMNS, StepCounts, integration_sentence
from mckibben.simulation.batch import Batch
from mckibben.simulation.software import engine_of_job
from mckibben.units import bar, deg, mm, ms

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

ISOBARIC, CLOSED = "constant pressures", "closed valves"
BEST_WITHIN = 0.02
"""The softest stiffness whose force on the trunk is within this part of the least one is the best."""
ROWS = 4096
"""Landings of a block, which a journal keeps."""
_KIND = StudyKind("mckibben landings", 4, "landings")
_COLUMNS = (*LegMetrics._fields, *STEP_COLUMNS)
_SHUT = 1e-6  # of the conductance
EDGES = (5.0, 95.0)
"""Percentiles of the draws that are an interval."""


@dataclass(frozen=True)
class LandingStudy:
    """Landings of a leg.

    Attributes
    ----------
    scenario
        File of the leg.
    table
        `LegMetrics`, ``substeps``, ``error_estimate`` [rad] and ``chaotic`` as in a `Batch`, over ``valve``, ``drop``
        [m], ``stiffness`` [N*m/rad] and ``draw``, of which 0 is nominal.
    pressures
        Commands [Pa] for each stiffness, shape (stiffness, muscles).
    attainable
        Attainable stiffness [N*m/rad] of the joint at touchdown.
    """

    scenario: LegScenario
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
        return self.scenario.leg.posture_angles(self._landing.touchdown)

    def body_weights(self, name: str = "peak_force") -> Floats:
        """A force in weights of the leg, shape (valve, drop, stiffness, draw)."""
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

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headers and rows of a table: one for each valve and drop, at its best stiffness."""
        headers = (
            "valve",
            "drop",
            "best stiffness [N*m/rad]",
            "force on the trunk [its weight]",
            "force of the ground [weight of the leg]",
            "deflection [mm]",
            f"{self.joint} bottoms out",
            "rebound [mm]",
        )
        rows: list[tuple[str, ...]] = []
        for record in self.records()["landings"]:
            low, high = record["best_stiffness_interval"]
            best = f"{record['best_stiffness']:.3g} ({low:.3g} to {high:.3g})"
            if record["influence"] < BEST_WITHIN:
                best = "no influence"
            if not record["avoids_stop"]:
                best += ", none avoids the stop"
            elif record["best_bottoms_out"]:
                best += ", bottoms out"
            rows.append(
                (
                    record["valve"],
                    f"{record['drop_mm']:g} mm",
                    best,
                    f"{record['peak_trunk_force_weights']:.2f}",
                    f"{record['peak_force_weights']:.2f}",
                    f"{record['deflection_mm']:.0f}",
                    f"{record['bottoms_out_share'] * 100:.0f} % of draws",
                    f"{record['rebound_mm']:.0f}",
                )
            )
        return headers, rows

    def records(self) -> dict[str, Any]:
        """The results as plain data; intervals are 5 to 95 % of the draws."""
        best, table = self.best(), self.table
        stiffness = table["stiffness"].to_numpy()
        forces, late, trunk = self.body_weights(), self.body_weights("peak_force_late"), self.trunk_weights()
        deflection, speed = table["deflection"].to_numpy(), table["take_off_speed"].to_numpy()
        bottoms = self.bottoms_out()
        landings = []
        for v, valve in enumerate(table["valve"].to_numpy()):
            for d, drop in enumerate(table["drop"].to_numpy()):
                at = int(best[v, d, 0])
                low, high = np.percentile(stiffness[best[v, d, 1:]], EDGES)
                nominal = trunk[v, d, :, 0]
                landings.append(
                    {
                        "valve": str(valve),
                        "drop_mm": float(drop / mm),
                        "best_stiffness": float(stiffness[at]),
                        "best_stiffness_interval": [float(low), float(high)],
                        "influence": float(nominal.max() / nominal.min() - 1),
                        "avoids_stop": bool((~bottoms[v, d, :, 0]).any()),
                        "best_bottoms_out": bool(bottoms[v, d, at, 0]),
                        "peak_trunk_force_weights": float(trunk[v, d, at, 0]),
                        "peak_trunk_force_interval": np.percentile(trunk[v, d, at, 1:], EDGES).tolist(),
                        "peak_force_weights": float(forces[v, d, at, 0]),
                        "peak_force_interval": np.percentile(forces[v, d, at, 1:], EDGES).tolist(),
                        "peak_force_late_weights": float(late[v, d, at, 0]),
                        "softest_peak_force_weights": float(forces[v, d, 0, 0]),
                        "deflection_mm": float(deflection[v, d, at, 0] / mm),
                        "bottoms_out_share": float(bottoms[v, d, at, 1:].mean()),
                        "rebound_mm": float(speed[v, d, at, 0] ** 2 / (2 * table.attrs["gravity"]) / mm),
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

    def describe(self) -> str:
        """Integration error of all landings, as text."""
        return integration_sentence(self._integration())

    def _integration(self) -> dict[str, Any]:
        return StepCounts(*(self.table[name].to_numpy() for name in STEP_COLUMNS)).summary()

    @property
    def _landing(self) -> Any:
        return self.scenario.landing

    def __repr__(self) -> str:
        return f"<LandingStudy of {self.scenario.name!r}: {self.table['peak_force'].size} landings>"


def study_landing(
    scenario: LegScenario,
    *,
    source: str = "",
    engine: str = "auto",
    journal: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> LandingStudy:
    """Simulate the landings of a scenario.

    The leg touches the ground at the speed of the drop, in the posture `touchdown`; the commands are constant: those of
    the nominal leg for a stiffness without torque, as in free fall.

    Parameters
    ----------
    scenario, source, engine
        File of the leg, its name for errors, and the engine, as for `simulate_legs`.
    journal, resume
        File that keeps finished blocks of landings, and whether to continue one.

    Raises
    ------
    ScenarioError
        If there is no section `landing`, or the stiffness of a joint is not attainable; with the attainable range.
    FileError
        If the journal exists, or, with `resume`, does not exist or belongs to another leg or version; if another
        process is computing the study; or if the disk is full.
    """
    landing = scenario.landing
    source = source or scenario.name
    if landing is None:
        raise ScenarioError(source, [Problem("lacks the section `landing`", remedy="see examples/leg/lei-leg.yaml")])
    check_continued(journal, resume)
    nominal = scenario.plant()
    leg = nominal.leg
    index = leg.index(landing.joint)
    angles = leg.posture_angles(landing.touchdown)
    pair = leg.joints[index].muscles
    low, high = (float(one) for one in pair.attainable_stiffness(angles[index], 0.0))
    given = landing.stiffness
    stiffness = np.linspace(low + 1e-6, high - 1e-6, landing.levels) if given is None else np.sort(given)

    def pressures_at(wanted: float) -> tuple[float, ...]:
        each = [wanted if at == index else None for at in range(len(leg.joints))]
        return leg.pressures_for(angles, [0.0] * len(angles), each)

    try:
        pressures = np.array([pressures_at(float(one)) for one in stiffness])
        for each in pressures:
            nominal.init_state(angles, tuple(map(float, each)))  # within the supply
        valves = _valves(nominal, landing.time_constants)
        for valve in valves.values():
            own = eqx.tree_at(lambda x: x.valve, nominal, valve)
            own.check_substeps(angles, None, scenario.step, scenario.substeps or MOST_SUBSTEPS)
    except SimulationError as error:
        raise ScenarioError(source, [Problem(error.message, field="step", remedy="give a shorter `step`")]) from error
    except McKibbenError as error:
        field = "landing.time_constants" if error.field == "time_constants" else "landing.stiffness"
        raise ScenarioError(source, [Problem.of(error, field=field)]) from error

    drops, draws = np.array(landing.drop), scenario.uncertainty.draws + 1
    drop, level, draw = (x.ravel() for x in np.indices((drops.size, stiffness.size, draws)))
    drawn = drawn_plant(scenario)
    blocks = [slice(begin, begin + ROWS) for begin in range(0, draw.size, ROWS)]
    total, engines = len(valves) * len(blocks), set()
    tables: list[dict[str, Floats]] = []

    def land(valve: Any, rows: slice, engine: str, report: Progress) -> Batch:
        commands = tuple(pressures[level[rows]].T)
        speeds = -np.sqrt(2 * nominal.gravity * drops[drop[rows]])
        return simulate_legs(
            take(eqx.tree_at(lambda x: x.valve, drawn, drawn_air(valve, scenario.uncertainty)), draw[rows]),
            PressureSchedule(tuple((one,) for one in commands)),
            LegStart(angles, commands, 0.0, speeds),
            duration=scenario.whole_steps(landing.duration),
            **scenario.steps,
            engine=engine,
            progress=report,
        )

    def engines_used() -> set[str]:
        return {land(valve, slice(0, 1), "auto", silent).engine for valve in valves.values()}

    if journal is not None:
        engine = engine_of_job(engines_used, _KIND.software(journal) if resume else None, engine)
        engines.add(engine)
    with StudyJournal(journal, _KIND, scenario, engine, resume) as kept:
        for place, (name, valve) in enumerate(valves.items()):
            parts = []
            for block, rows in enumerate(blocks):
                number = place * len(blocks) + block
                if (columns := kept.found(number)) is None:
                    found = land(
                        valve,
                        rows,
                        engine,
                        lambda what, part, n=name, k=number: (progress or silent)(f"{n}: {what}", (k + part) / total),
                    )
                    if found.failed.any():
                        remedy = "give a shorter `step`"
                        raise ScenarioError(source, [Problem("landings diverge", field="step", remedy=remedy)])
                    engines.add(found.engine)
                    of_joint = found.table.isel(joint=index)
                    columns = {name: of_joint[name].to_numpy() for name in _COLUMNS}
                    kept.keep(number, columns)
                parts.append(columns)
            tables.append({name: np.concatenate([one[name] for one in parts]) for name in _COLUMNS})
    shape = (len(valves), drops.size, stiffness.size, draws)
    table = _table(tables, shape, list(valves), drops, stiffness)
    table.attrs["engine"] = ", ".join(sorted(engines))
    masses = {"weight": drawn.leg.total_mass, "trunk_weight": drawn.leg.trunk.mass}
    for name, mass in masses.items():
        table[name] = ("draw", np.broadcast_to(np.asarray(mass), (draws,)) * nominal.gravity, {"units": "N"})
    table.attrs["gravity"] = float(nominal.gravity)
    return LandingStudy(scenario, table, pressures, (low, high))


def _valves(plant: LegPlant, time_constants: tuple[float, ...]) -> dict[str, Any]:
    """Valves by name: constant pressures, given time constants, and closed."""
    valve: Any = plant.valve
    found: dict[str, Any] = {ISOBARIC: IdealValve()}
    if valve.holds_air:
        found |= {f"{one / ms:g} ms": valve_with(valve, plant, one) for one in time_constants}
        found[CLOSED] = valve.scaled(_SHUT)
    return found


def valve_with(valve: AirActuator, plant: LegPlant, time_constant: float) -> AirActuator:
    """Return a valve with a conductance for a time constant [s] at small changes of its command.

    For the first muscle of the leg, in the middle of its pressures and contractions (`AirActuator.time_constant_at`).

    Raises
    ------
    RangeError
        If the time constant is not above the valve's own lag.
    """
    muscle = plant.leg.muscles[0]
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


def _table(
    tables: list[dict[str, Floats]], shape: tuple[int, ...], valves: list[str], drops: Floats, stiffness: Floats
) -> xr.Dataset:
    import xarray as xr

    dims = ("valve", "drop", "stiffness", "draw")
    columns = {
        name: (dims, np.stack([table[name] for table in tables]).reshape(shape), attributes(name)) for name in _COLUMNS
    }
    coords = {
        "valve": valves,
        "drop": ("drop", drops, {"units": "m"}),
        "stiffness": ("stiffness", stiffness, {"units": "N*m/rad"}),
    }
    return xr.Dataset(columns, coords=coords)
