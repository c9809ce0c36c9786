"""Motion of the bodies of a robot, and metrics of landings and jumps that are accumulated along a run."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator.base import at_room_temperature
from mckibben.codegen.engine import BatchFunction
from mckibben.component.columns import Label, labelled, labels_of
from mckibben.control.base import DiscreteTimeSystem
from mckibben.mechanism.dynamics import motion
from mckibben.muscle.air import ATMOSPHERE, ENERGY
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import PlantState
from mckibben.plant.robot_plant import RobotPlant
from mckibben.simulation.loop import begun, control_period
from mckibben.simulation.metrics import (
    Duration,
    Largest,
    LargestError,
    Run,
    Totals,
    Tracked,
    metrics_of,
    values_of,
)

Scalar = Float[Array, ""]


@labelled
class BodySample(NamedTuple):
    """Bodies of a robot at the start of a control period; tuples are over joints or muscles."""

    x: Annotated[Scalar, Label("m", "position of the base, forwards")]
    y: Annotated[Scalar, Label("m", "position of the base, to the left")]
    z: Annotated[Scalar, Label("m", "height of the base")]
    speed: Annotated[Scalar, Label("m/s", "upward speed of the base")]
    pitch: Annotated[Scalar, Label("rad", "pitch of the base")]
    yaw: Annotated[Scalar, Label("rad", "yaw of the base")]
    roll: Annotated[Scalar, Label("rad", "roll of the base")]
    stop_torque: Annotated[tuple[Scalar, ...], Label("N*m", "torque of the stops", along="joint")]
    ground_forward: Annotated[Scalar, Label("N", "force of the ground on the foot, forwards")]
    ground_left: Annotated[Scalar, Label("N", "force of the ground on the foot, to the left")]
    ground_up: Annotated[Scalar, Label("N", "force of the ground on the foot, upwards")]
    mass_height: Annotated[Scalar, Label("m", "height of the centre of mass")]
    mass_speed: Annotated[Scalar, Label("m/s", "upward speed of the centre of mass")]
    kinetic: Annotated[Scalar, Label("J", "kinetic energy")]
    muscle_power: Annotated[Scalar, Label("W", "power of the muscles")]
    stop_power: Annotated[Scalar, Label("W", "power of the stops")]
    air_mass: Annotated[tuple[Scalar, ...], Label("kg", "mass of the air", along="muscle")]
    outside: Annotated[Array, Label("1", "a muscle's contraction is outside its domain")]


BODY = labels_of(BodySample)


def body_sample(plant: RobotPlant, state: PlantState) -> BodySample:
    """Return the motion of the bodies in a state, with forces and powers."""
    forces, volumes = plant.forces(state), plant.air_volumes(state)
    stops = plant.mechanism.stop_torques(state.position, state.velocity)
    moving = motion(plant.robot, state.position, state.velocity, plant.gravity)
    inside = map(lambda muscle, at: muscle.domain.contains_contraction(at), plant.muscles, forces.contractions)
    zero, ground = jnp.zeros_like(state.position.x), plant.ground_force(state)
    base = {name: getattr(state.position, name) for name in ("x", "y", "z", "pitch", "yaw", "roll")}
    return BodySample(
        **{name: zero if value is None else value for name, value in base.items()},
        speed=state.velocity.z,
        stop_torque=stops,
        ground_forward=ground.x,
        ground_left=ground.y,
        ground_up=ground.z,
        mass_height=moving.height,
        mass_speed=moving.upward_speed,
        kinetic=moving.kinetic,
        muscle_power=-_power(forces.tensions, forces.path_rates),
        stop_power=_power(stops, state.velocity.angles),
        air_mass=tuple(
            at_room_temperature((pressure + ATMOSPHERE) * air.volume / ENERGY, state.air, i)
            for i, (pressure, air) in enumerate(zip(state.pressures, volumes, strict=True))
        ),
        outside=~functools.reduce(operator.and_, inside),
    )


def _power(forces: Sequence[Array], rates: Sequence[Array]) -> Array:
    """Power [W] of forces at the rates of their coordinates."""
    return jnp.asarray(sum(force * rate for force, rate in zip(forces, rates, strict=True)))


@BatchFunction
def _bodies(plant: RobotPlant, state: PlantState) -> BodySample:
    return body_sample(plant, state)


def body_columns(plant: RobotPlant, states: PlantState) -> dict[str, PyTree]:
    """Return the quantities of `BodySample` in states over time, by name; those of joints and muscles as tuples."""
    lanes = jax.tree.map(lambda x: np.moveaxis(np.asarray(x), 0, -1), states)
    return jax.tree.map(np.asarray, _bodies("auto", numeric(plant), lanes)[0]._asdict())


def measure_landing(plant: PyTree, states: PlantState, final: PlantState, period: float) -> RobotMetrics:
    """Return the metrics of a finished run, from its states of shape (periods,) and that at its end."""
    samples = BodySample(**body_columns(plant, states))
    return _measured(samples, final, np.asarray(period), plant)


@jit
def _measured(samples: BodySample, final: PlantState, period: ArrayLike, plant: RobotPlant) -> RobotMetrics:
    return measure(samples, body_sample(plant, final), period, plant)


def landing_metrics(
    plant: RobotPlant, controller: DiscreteTimeSystem, times: PyTree, start: PyTree, period: ArrayLike, substeps: int
) -> RobotMetrics:
    """Run a robot and return its metrics alone; a pure function, whose memory does not grow with the duration."""

    def advance(carry: tuple[PyTree, MetricSums], time: Array) -> tuple[PyTree, None]:
        state, sums = carry
        state, _ = control_period(plant, controller, state, time, period, substeps)
        return (state, sums.after(body_sample(plant, state[0]), period, plant)), None

    loop, times = begun(plant, controller, times, start, period)
    sums = MetricSums.of(body_sample(plant, loop[0]))
    count = jax.tree.leaves(times)[0].shape[0]
    return lax.scan(advance, (loop, sums), times)[0][1].finished(jnp.asarray(count), period)


@labelled
class RobotMetrics(NamedTuple):
    """Metrics of a run of a robot, in SI."""

    peak_force: Annotated[Scalar, Largest("N", "largest upward force of the ground", of="ground_up")]
    peak_trunk_force: Annotated[
        Scalar,
        Largest(
            "N",
            "largest upward force on the trunk",
            of="trunk_force",
            note="its mass times the acceleration of the base, gravity included",
        ),
    ]
    deflection: Annotated[Scalar, Largest("m", "depth of the base below its height at the first touch", of="depth")]
    stop_torque: Annotated[
        tuple[Scalar, ...],
        LargestError(
            "N*m", "torque of the stops", of="stop_torque", along="joint", note="above 0 the joint has bottomed out"
        ),
    ]
    apex: Annotated[
        Scalar,
        Tracked(
            "m",
            "greatest height of the centre of mass in flight",
            of="apex",
            note="that the run reaches or is on its way to, after the first touch, in any flight; NaN if the "
            "foot stays on the ground",
        ),
    ]
    peak_landing_force: Annotated[
        Scalar,
        Tracked(
            "N",
            "largest upward force of the ground after the flight",
            of="landing_force",
            note="that `apex` is of; 0 if the run ends before it lands",
        ),
    ]
    muscle_work: Annotated[
        Scalar,
        Tracked(
            "J",
            "work of the muscles",
            of="muscle_work",
            note="the integral of tension times rate of shortening, until the take-off of the flight that `apex` is "
            "of, or, without one, to the end of the run",
        ),
    ]
    stop_energy: Annotated[
        Scalar, Tracked("J", "energy that the stops have absorbed", of="stop_energy", note="until then")
    ]
    air_mass: Annotated[
        Scalar,
        Tracked(
            "kg",
            "mass of the air",
            of="air_mass",
            note="that flows into the muscles until then, at room temperature",
        ),
    ]
    time_outside_domain: Annotated[Scalar, Duration("s", "time with a muscle outside its domain", of="outside")]


class RobotMetricSample(NamedTuple):
    """Quantities of a sample that metrics are made of; flags are 0 or 1."""

    ground_up: Scalar  # [N]
    trunk_force: Scalar  # [N]
    depth: Scalar  # of the base below its height at the first touch [m], 0 before
    stop_torque: tuple[Scalar, ...]  # [N*m]
    outside: Scalar


class Flight(NamedTuple):
    """Contact with the ground and the highest flight so far, tracked from sample to sample."""

    touched: Scalar  # time since the first touch [s], below 0 before
    height: Scalar  # of the base at the first touch [m]
    speed: Scalar  # of the base, upwards [m/s]
    work: Scalar  # of the muscles so far [J]
    absorbed: Scalar  # by the stops so far [J]
    drawn: Scalar  # air so far [kg]
    air: tuple[Scalar, ...]
    apex: Scalar  # -inf before a flight
    landing_force: Scalar
    muscle_work: Scalar
    stop_energy: Scalar
    air_mass: Scalar

    @classmethod
    def of(cls, first: BodySample) -> Flight:
        zero = jnp.zeros_like(first.z)
        none = zero - jnp.inf
        return cls(zero - 1, first.z, first.speed, zero, zero, zero, first.air_mass, none, *[zero] * 4)

    def after(self, sample: BodySample, period: ArrayLike, plant: RobotPlant) -> tuple[Flight, RobotMetricSample]:
        """Return the state after a further sample, a period [s] later, and what metrics are made of."""
        gravity, force = plant.gravity, sample.ground_up
        before = self.touched < 0
        touched = jnp.where(before, jnp.where(force > 0, 0.0, -1.0), self.touched + period)
        height = jnp.where(touched < 0, sample.z, self.height)  # at touchdown, that of the previous sample
        rising = jnp.maximum(sample.mass_speed, 0.0)
        ballistic = sample.mass_height + rising * rising / (2 * gravity)
        flying = (touched > 0) & (force <= 0)
        higher = flying & (ballistic > self.apex + 1e-6)  # in flight it is constant except for rounding
        rises = [jnp.maximum(new - old, 0.0) for new, old in zip(sample.air_mass, self.air, strict=True)]
        work, drawn = self.work + sample.muscle_power * period, self.drawn + sum(rises)
        absorbed = self.absorbed - sample.stop_power * period
        counts = higher | (self.apex == -jnp.inf)
        following = Flight(
            touched=touched,
            height=height,
            speed=sample.speed,
            work=work,
            absorbed=absorbed,
            drawn=drawn,
            air=sample.air_mass,
            apex=jnp.where(higher, ballistic, self.apex),
            landing_force=jnp.where(counts, 0.0, jnp.maximum(self.landing_force, force)),
            muscle_work=jnp.where(counts, work, self.muscle_work),
            stop_energy=jnp.where(counts, absorbed, self.stop_energy),
            air_mass=jnp.where(counts, drawn, self.air_mass),
        )
        return following, RobotMetricSample(
            ground_up=force,
            trunk_force=plant.robot.bodies[0].mass * ((sample.speed - self.speed) / period + gravity),
            depth=jnp.where(touched >= 0, height - sample.z, 0.0),
            stop_torque=sample.stop_torque,
            outside=sample.outside.astype(sample.z.dtype),
        )


class MetricSums(NamedTuple):
    """Accumulated sums and maxima, and the state that is tracked."""

    totals: Totals
    flight: Flight

    @classmethod
    def of(cls, first: BodySample) -> MetricSums:
        zero = jnp.zeros_like(first.z)
        nothing = RobotMetricSample(zero, zero, zero, tuple(zero for _ in first.stop_torque), zero)
        return cls(_totals(nothing).empty(), Flight.of(first))

    def after(self, sample: BodySample, period: ArrayLike, plant: RobotPlant) -> MetricSums:
        """Return the sums with a further sample, a period [s] later."""
        flight, quantities = self.flight.after(sample, period, plant)
        return MetricSums(self.totals.merge(_totals(quantities)), flight)

    def finished(self, periods: Array, period: ArrayLike) -> RobotMetrics:
        """Return the metrics of a whole run; NaN for the apex of a foot that never left the ground."""
        apex = jnp.where(self.flight.apex > -jnp.inf, self.flight.apex, jnp.nan)
        return values_of(RobotMetrics, self.totals, Run(periods, period, self.flight._replace(apex=apex)))


def measure(samples: BodySample, last: BodySample, period: ArrayLike, plant: RobotPlant) -> RobotMetrics:
    """Return the metrics of a finished run, from its samples of shape (periods,) and that at its end."""

    def advance(sums: MetricSums, sample: BodySample) -> tuple[MetricSums, None]:
        return sums.after(sample, period, plant), None

    first, rest = (jax.tree.map(lambda x, at=at: x[at], samples) for at in (0, slice(1, None)))
    sums = lax.scan(advance, MetricSums.of(first), rest)[0]
    return sums.after(last, period, plant).finished(jnp.asarray(samples.z.shape[0]), period)


def _totals(quantities: Any) -> Totals:
    return Totals.of(metrics_of(RobotMetrics).values(), quantities)
