"""Trajectories and metrics of an episode: the plant's true torque, stiffness and muscle forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.actuator.base import at_room_temperature
from mckibben.component.columns import Label, labelled
from mckibben.control.base import Setpoint
from mckibben.joint.antagonistic import NO_STATES
from mckibben.numerics.batching import fusion_barrier
from mckibben.plant import JointPlant
from mckibben.simulation.oscillation import find_limit_cycle
from mckibben.simulation.reduction import (
    Duration,
    Largest,
    LargestError,
    RootMeanSquare,
    Run,
    StandardDeviation,
    Total,
    Totals,
    Tracked,
    larger,
    metrics_of,
    root,
    values_of,
)
from mckibben.units import atm

if TYPE_CHECKING:
    from mckibben.simulation.loop import Record


@labelled
class Trajectory(NamedTuple):
    """An episode over time; every leaf has shape (periods,), SI units.

    Stiffness, torque, forces and contractions are those of the plant. Torque and forces include the muscles' friction
    and creep; stiffness is that of the force laws, or of the controller's `stiffness_amplitude` if it has one.
    """

    angle: Annotated[Array, Label("rad", "joint angle")]
    velocity: Annotated[Array, Label("rad/s", "angular velocity")]
    desired_angle: Annotated[Array, Label("rad", "desired joint angle")]
    angle_without_step: Annotated[
        Array, Label("rad", "joint angle of the same run without the last change of the desired stiffness")
    ]
    desired_stiffness: Annotated[Array, Label("N*m/rad", "desired joint stiffness")]
    stiffness: Annotated[Array, Label("N*m/rad", "isobaric joint stiffness of the plant's muscles")]
    total_stiffness: Annotated[Array, Label("N*m/rad", "joint stiffness of the plant's muscles and gravity")]
    stiffness_estimate: Annotated[Array, Label("N*m/rad", "controller's estimate of the joint stiffness")]
    torque: Annotated[Array, Label("N*m", "torque of the muscles")]
    pressure1: Annotated[Array, Label("Pa", "gauge pressure in muscle 1")]
    pressure2: Annotated[Array, Label("Pa", "gauge pressure in muscle 2")]
    command1: Annotated[Array, Label("Pa", "commanded pressure of muscle 1")]
    command2: Annotated[Array, Label("Pa", "commanded pressure of muscle 2")]
    force1: Annotated[Array, Label("N", "tension of muscle 1")]
    force2: Annotated[Array, Label("N", "tension of muscle 2")]
    contraction1: Annotated[Array, Label("1", "contraction of muscle 1")]
    contraction2: Annotated[Array, Label("1", "contraction of muscle 2")]
    saturated: Annotated[Array, Label("1", "a command is at a pressure limit")]
    slack: Annotated[Array, Label("1", "a muscle is slack")]
    outside_domain: Annotated[Array, Label("1", "a muscle's contraction or pressure is outside its domain")]
    overloaded: Annotated[Array, Label("1", "a muscle's tension is above its rating")]
    excursion: Annotated[Array, Label("1", "distance of a contraction from its domain")]
    air1: Annotated[Array, Label("m^3", "air in muscle 1, as a volume at atmospheric pressure")]
    air2: Annotated[Array, Label("m^3", "air in muscle 2, as a volume at atmospheric pressure")]


def trajectory(
    plant: JointPlant,
    setpoints: Setpoint,
    record: Record,
    angle_without_step: Array,
    stiffness_amplitude: ArrayLike | None = None,
) -> Trajectory:
    """Trajectory of a record; elementwise, of one control period or of all."""
    state, joint = record.state, plant.joint
    torque, stiffness = fusion_barrier(joint.torque_and_stiffness, state.angle, state.pressures)
    if stiffness_amplitude is not None:
        stiffness = fusion_barrier(joint.secant_stiffness, state.angle, state.pressures, stiffness_amplitude)
    pressure1, pressure2 = state.pressures
    if state.muscles != NO_STATES:
        forces = fusion_barrier(joint.forces, state.angle, state.velocity, state.pressures, state.muscles)
        (force1, force2), torque, (contraction1, contraction2) = forces
    else:
        contraction1, contraction2 = fusion_barrier(joint.contractions, state.angle, state.pressures)
        force1 = joint.muscle1.tension(contraction1, pressure1)
        force2 = joint.muscle2.tension(contraction2, pressure2)
    muscles = ((joint.muscle1, contraction1, pressure1), (joint.muscle2, contraction2, pressure2))
    dead = [plant.valve.for_muscle(i).dead_volume for i in (0, 1)]
    air1, air2 = (
        at_room_temperature((m.specimen.volume(contraction) + dead[i]) * (pressure + atm) / atm, state.air, i)
        if m.specimen.has_volume
        else jnp.full_like(stiffness, jnp.nan)
        for i, (m, contraction, pressure) in enumerate(muscles)
    )
    inside = [muscle.domain.contains(contraction, pressure) for muscle, contraction, pressure in muscles]
    beyond = [
        jnp.maximum(muscle.domain.contraction_min - contraction, contraction - muscle.domain.contraction_max)
        for muscle, contraction, _ in muscles
    ]
    rated1, rated2 = joint.muscle1.specimen.force_limit, joint.muscle2.specimen.force_limit
    return Trajectory(
        angle=state.angle,
        velocity=state.velocity,
        desired_angle=setpoints.angle,
        angle_without_step=angle_without_step,
        desired_stiffness=setpoints.stiffness,
        stiffness=stiffness,
        total_stiffness=stiffness + plant.load.gravity_stiffness(state.angle),
        stiffness_estimate=record.telemetry.get("stiffness_estimate", jnp.full_like(stiffness, jnp.nan)),
        torque=torque,
        pressure1=pressure1,
        pressure2=pressure2,
        command1=record.commands[0],
        command2=record.commands[1],
        force1=force1,
        force2=force2,
        contraction1=contraction1,
        contraction2=contraction2,
        saturated=record.limited | record.telemetry.get("saturated", False),
        slack=(force1 <= 0) | (force2 <= 0),
        outside_domain=~(inside[0] & inside[1]),
        overloaded=(force1 > rated1) | (force2 > rated2),
        excursion=jnp.maximum(jnp.maximum(beyond[0], beyond[1]), 0.0),
        air1=air1,
        air2=air2,
    )


SETTLING_PART = 0.1
"""Half the width of the settling band, as a fraction of the step of the desired stiffness."""
_END = 10  # the last 1/10 of a run is its end
_SETTLED = 10  # the last 1/10 of the time since the change has to be inside the band
_BAND_FLOOR = 1e-3  # least half width of the band, as a fraction of the setpoint


class SettlingTime(Largest):
    """Time [s] from the last change until a quantity, the number of the period from 1 if outside a band, stays 0."""

    def value(self, totals: Totals, run: Any) -> Any:
        change: Change = run.tracked.change
        unsettled = jnp.maximum(totals.maxima[self.of] - 1, change.at - 1)
        in_band = run.periods - 1 - unsettled  # periods at the end
        never = (_SETTLED * in_band < run.periods - change.at) | ((change.at > 0) & ~change.ends)
        return jnp.where(never, jnp.nan, (unsettled + 1 - change.at) * run.period)


class LargestAfterChange(Largest):
    """Largest value of a quantity since the last change of the setpoint; NaN without one."""

    def value(self, totals: Totals, run: Any) -> Any:
        return jnp.where(run.tracked.change.ends, totals.maxima[self.of], jnp.nan)


@labelled
class Metrics(NamedTuple):
    """Scalars in SI; errors are those of the plant's true angle and stiffness from the setpoints."""

    angle_rmse: Annotated[
        Array, RootMeanSquare("rad", "root mean square error of the angle", of="angle_error", shown="deg")
    ]
    angle_max: Annotated[Array, LargestError("rad", "largest error of the angle", of="angle_error", shown="deg")]
    stiffness_rmse: Annotated[
        Array, RootMeanSquare("N*m/rad", "root mean square error of the stiffness", of="stiffness_error")
    ]
    stiffness_max: Annotated[Array, LargestError("N*m/rad", "largest error of the stiffness", of="stiffness_error")]
    stiffness_ripple: Annotated[
        Array,
        StandardDeviation(
            "N*m/rad",
            "root mean square of the stiffness error about its mean",
            of="stiffness_error",
            note="at a constant setpoint, the effect of motion, without the constant error of a wrong force law",
        ),
    ]
    stiffness_settling: Annotated[
        Array,
        SettlingTime(
            "s",
            "settling time of the stiffness",
            of="unsettled",
            note="from the last change of the desired stiffness, or from the start if it never changes; NaN if the "
            "stiffness is not in the settling band for at least the last tenth of the time since the change (a limit "
            "cycle, or an entry just before the end), or if the setpoint ends with a ramp or changes until the "
            "very end",
        ),
    ]
    coupling: Annotated[
        Array,
        LargestAfterChange(
            "rad",
            "largest change of the angle by the last change of the desired stiffness",
            of="coupling",
            shown="deg",
            note="from the same run without that change; NaN if the desired stiffness never changes, ends with a ramp "
            "or changes until the very end",
        ),
    ]
    estimate_rmse: Annotated[
        Array,
        RootMeanSquare(
            "N*m/rad",
            "root mean square error of the estimated stiffness",
            of="estimate_error",
            note="NaN if the controller has no estimate",
        ),
    ]
    time_saturated: Annotated[Array, Duration("s", "time with a command at a pressure limit", of="saturated")]
    time_slack: Annotated[Array, Duration("s", "time with a muscle slack", of="slack")]
    time_outside_domain: Annotated[Array, Duration("s", "time with a muscle outside its domain", of="outside_domain")]
    time_overloaded: Annotated[Array, Duration("s", "time with a muscle above its rated force", of="overloaded")]
    excursion_max: Annotated[
        Array, Largest("1", "largest distance of a contraction from its domain", of="excursion", shown="%")
    ]
    force_max: Annotated[Array, Largest("N", "largest tension", of="force")]
    air: Annotated[
        Array,
        Total(
            "m^3",
            "air consumption, as a volume at atmospheric pressure",
            of="inflow",
            shown="L",
            note="sum of the rises of the muscles' contents at room temperature, as what is let out is lost; NaN where "
            "the volumes are not known",
        ),
    ]
    oscillation_amplitude: Annotated[
        Array,
        Tracked(
            "rad",
            "amplitude of a limit cycle of the angle",
            of="amplitude",
            shown="deg",
            note="0 without one (`mckibben.simulation.oscillation`)",
        ),
    ]
    oscillation_period: Annotated[
        Array, Tracked("s", "period of a limit cycle of the angle", of="cycle_period", note="NaN without one")
    ]


_SUFFIXES = {"N*m/rad": "", "%": "_percent"}
METRICS: dict[str, tuple[str, str, float]] = {
    f"{name}{_SUFFIXES.get(shown, f'_{shown}')}": (name, shown, size)
    for name, label in metrics_of(Metrics).items()
    for shown, size in [label.displayed]
}
"""Field of `Metrics`, shown unit and its factor to SI, by the name in results."""


def in_shown_units(metrics: Mapping[str, float]) -> dict[str, float]:
    """Metrics by their names and in their units in results."""
    return {name: metrics[metric] / unit for name, (metric, _, unit) in METRICS.items()}


def measure(moved: Trajectory, period: ArrayLike, *, angle_resolution: ArrayLike = 0.0) -> Metrics:
    """Metrics of a trajectory with a control period [s], and a step of the sensor of the angle [rad]."""
    change = last_change(moved.desired_stiffness)
    at_change = jnp.asarray(moved.stiffness)[change.at]
    return measure_since(moved, change, at_change, period, angle_resolution)


def measure_since(
    moved: Trajectory, change: Change, at_change: ArrayLike, period: ArrayLike, angle_resolution: ArrayLike
) -> Metrics:
    """`measure` with the last change of the desired stiffness, and the stiffness [N*m/rad] at it."""
    moved = Trajectory(*map(jnp.asarray, moved))
    periods = moved.angle.shape[0]
    zero = jnp.zeros_like(moved.stiffness[0])

    def following(so_far: Any, at: tuple[Array, Trajectory]) -> tuple[Any, None]:
        totals, air = so_far
        index, now = at
        before = [jnp.where(index == 0, new, old) for new, old in zip((now.air1, now.air2), air, strict=True)]
        sample = MetricSample.of(now, index, periods, change, at_change, before)
        return (totals.merge(sample.totals()), (now.air1, now.air2)), None

    start = MetricSample.empty(zero).totals().empty(), (zero, zero)
    (totals, _), _ = lax.scan(following, start, (jnp.arange(periods), moved))
    cycle = find_limit_cycle(moved.angle, moved.desired_angle, period, angle_resolution)
    return values_of(Metrics, totals, Run(periods, period, Course(*cycle, change)))


class Change(NamedTuple):
    """Last change of the desired stiffness."""

    at: Array  # first control period with the new setpoint; 0 if it never changes
    before: Array  # setpoint [N*m/rad]
    after: Array  # setpoint at the end of the run [N*m/rad]
    ends: Array  # whether there is a change, a step and not the end of a ramp, and a time after it without one


def first_of_end(periods: int) -> int:
    """First control period of the end of a run, its last tenth."""
    return periods - max(periods // _END, 1)


def last_change(setpoints: ArrayLike, xp: Any = jnp) -> Change:
    """The last change of setpoints of shape (periods,); `xp` computes it, `jax.numpy` or `numpy`."""
    desired: Any = xp.asarray(setpoints)
    changed = xp.concatenate([xp.zeros(1, bool), desired[1:] != desired[:-1]])
    index = xp.max(xp.where(changed, xp.arange(desired.size), 0))
    ends = (index > 0) & (index < desired.size - 1) & ~changed[index - 1]
    return Change(index, desired[xp.maximum(index - 1, 0)], desired[-1], ends)


class Course(NamedTuple):
    """Limit cycle of a run [rad], [s], and the last change of its desired stiffness."""

    amplitude: Array
    cycle_period: Array
    change: Change


class MetricSample(NamedTuple):
    """Quantities of a control period that metrics are made of; flags are 0 or 1."""

    angle_error: Array  # [rad]
    angle_error_at_end: Array  # [rad], 0 before the end of the run
    stiffness_error: Array  # [N*m/rad]
    estimate_error: Array  # [N*m/rad]
    unsettled: Array  # number of the period from 1, if the stiffness is outside its band; else 0
    coupling: Array  # [rad], 0 before the change
    saturated: Array
    slack: Array
    outside_domain: Array
    overloaded: Array
    excursion: Array  # [-]
    force: Array  # [N]
    inflow: Array  # [m^3]

    @classmethod
    def empty(cls, like: Array) -> MetricSample:
        """Sample of zeros, with the float type of `like`."""
        return cls(*[jnp.zeros_like(like)] * len(cls._fields))

    @classmethod
    def of(
        cls,
        moved: Trajectory,
        index: ArrayLike,
        periods: int,
        change: Change,
        stiffness_at_change: ArrayLike,
        air_before: Sequence[ArrayLike],
    ) -> MetricSample:
        """Samples of single control periods, elementwise: scalars or shape (periods,)."""
        index = jnp.asarray(index)
        angle_error = jnp.asarray(moved.angle) - moved.desired_angle
        stiffness_error = jnp.asarray(moved.stiffness) - moved.desired_stiffness
        since = index >= change.at
        settled = jnp.abs(stiffness_error) <= _band(change, stiffness_at_change)
        coupling = jnp.abs(jnp.asarray(moved.angle) - moved.angle_without_step)

        def number(flag: Any) -> Array:
            return jnp.asarray(flag).astype(stiffness_error.dtype)

        return cls(
            angle_error=angle_error,
            angle_error_at_end=jnp.where(index >= first_of_end(periods), angle_error, 0.0),
            stiffness_error=stiffness_error,
            estimate_error=jnp.asarray(moved.stiffness_estimate) - moved.stiffness,
            unsettled=number(jnp.where(since & ~settled, index + 1, 0)),
            coupling=jnp.where(since, coupling, 0.0),
            saturated=number(moved.saturated),
            slack=number(moved.slack),
            outside_domain=number(moved.outside_domain),
            overloaded=number(moved.overloaded),
            excursion=jnp.asarray(moved.excursion),
            force=larger(moved.force1, moved.force2),
            inflow=larger(moved.air1 - air_before[0], 0.0) + larger(moved.air2 - air_before[1], 0.0),
        )

    def totals(self) -> Totals:
        """Terms of the metrics, and of `angle_at_end`."""
        return Totals.of((*metrics_of(Metrics).values(), _ANGLE_AT_END), self)


_ANGLE_AT_END = RootMeanSquare("rad", "root mean square error of the angle at the end", of="angle_error_at_end")


def angle_at_end(totals: Totals, run: Run) -> Array:
    """Root mean square error of the angle [rad] over the end of a run."""
    return _ANGLE_AT_END.value(totals, run._replace(periods=run.periods - first_of_end(run.periods)))


def rms(error: ArrayLike) -> Array:
    """The root mean square; its derivative at zero error is 0."""
    return root(jnp.mean(jnp.square(jnp.asarray(error))))


def settling_band(desired_stiffness: ArrayLike, stiffness: ArrayLike) -> Array:
    """Half the width of the settling band of the stiffness [N*m/rad]: a fraction of the step of its setpoint."""
    change = last_change(desired_stiffness)
    return _band(change, jnp.asarray(stiffness)[change.at])


def _band(change: Change, stiffness_at_change: ArrayLike) -> Array:
    step = jnp.abs(change.after - stiffness_at_change)
    return jnp.maximum(SETTLING_PART * step, _BAND_FLOOR * jnp.abs(change.after))
