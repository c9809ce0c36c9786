"""Identification and validation of the paper's muscle, and the attainable set of its knee."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import Fit, Validation, identify, validate
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import ChouLaw, ExponentialLaw, ForceLaw, Muscle
from mckibben.numerics.compiled import compiled
from mckibben.paper.settings import SETTINGS, Setting, StiffnessReference, pid_scenario
from mckibben.plant import JointPlant
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest, away_from_turns
from mckibben.units import bar, deg

TEST_PRESSURES = (2 * bar, 3 * bar, 4.5 * bar, 6 * bar)
"""Pressures of the paper's validation [Pa]; its identification uses them too."""

EXPERIMENTAL, CHOU = "experimental (Eq. 2)", "Chou (Eq. 1)"
CHOU_FITTED, PUBLISHED = "Chou (Eq. 1), fitted", "Eq. 3 as published"
RIG, MARTENS, FESTO = "virtual-rig", "dmsp-10-250-martens2017", "festo-tool-10mm"


@dataclass(frozen=True)
class SimulatedRigTest:
    """Isobaric test of the paper on the simulated rig.

    Attributes
    ----------
    muscle
        The paper's specimen, following Eq. 3.
    rig, protocol
        Simulated rig and its protocol.
    test
        Plateau means of the whole test (Fig. 3).
    settled
        Those away from the turning points, used in identification.
    retest
        Second test at the four pressures of the paper's validation, with other noise and offsets (Fig. 4).
    samples
        Number of raw samples of the test.
    """

    muscle: Muscle
    rig: SimulatedIsobaricTest
    protocol: IsobaricProtocol
    test: IsobaricDataset
    settled: IsobaricDataset
    retest: IsobaricDataset
    samples: int


@dataclass(frozen=True)
class Identification:
    """Fits and validations.

    Attributes
    ----------
    rig
        Test on the simulated rig.
    data, fits
        Points and Eq. 2 fitted to them, by dataset.
    retested
        Validation of the fitted law and Chou's on the retest.
    held_out_pressures, held_out_repeat
        Validation at the four pressures, and at the last repeat, of Eq. 2 fitted without them, and of Chou's law.
    measured
        Validation on each measured dataset of Eq. 2 fitted to it, Chou's law, Chou's law with fitted braid angle and
        diameter, and Eq. 3 as published.
    """

    rig: SimulatedRigTest
    data: dict[str, IsobaricDataset]
    fits: dict[str, Fit]
    retested: Validation
    held_out_pressures: Validation
    held_out_repeat: Validation
    measured: dict[str, Validation]


def run_identification(*, repeats: int = 5) -> Identification:
    """Run the isobaric test with so many repeats (five in the paper), fit and validate."""
    rig = _test(repeats)
    real = {name: catalog.dataset(name) for name in (MARTENS, FESTO)}
    fits = {RIG: identify(ExponentialLaw, rig.settled)} | {
        name: identify(ExponentialLaw, data) for name, data in real.items()
    }
    chou = ChouLaw.of(rig.muscle.specimen)
    published = catalog.law("lei-mas-10-180n")
    return Identification(
        rig=rig,
        data={RIG: rig.settled} | real,
        fits=fits,
        retested=validate({EXPERIMENTAL: fits[RIG].law, CHOU: chou}, rig.retest),
        held_out_pressures=_held_out(chou, *rig.settled.split(pressures=list(TEST_PRESSURES))),
        held_out_repeat=_held_out(chou, *rig.settled.split(repeats=[int(max(rig.settled.repeats))])),
        measured={
            name: validate(
                {
                    EXPERIMENTAL: fits[name].law,
                    CHOU: chou,
                    CHOU_FITTED: identify(ChouLaw, data).law,
                    PUBLISHED: published,
                },
                data,
            )
            for name, data in real.items()
        },
    )


def _held_out(chou: ChouLaw, train: IsobaricDataset, held_out: IsobaricDataset) -> Validation:
    return validate({EXPERIMENTAL: identify(ExponentialLaw, train).law, CHOU: chou}, held_out)


def direction_gap(data: IsobaricDataset) -> tuple[float, float]:
    """Difference of force between loading and unloading at the same state.

    Returns
    -------
    gap, largest
        Mean of loading minus unloading, and the largest force of the data [N].
    """
    forces: dict[tuple[float, float], dict[str, list[float]]] = {}
    taut = data.taut
    for level, contraction, direction, force in zip(
        taut.levels, taut.contraction, taut.table["direction"].to_numpy(), taut.force, strict=True
    ):
        place = (float(level), round(float(contraction), 6))
        forces.setdefault(place, {}).setdefault(str(direction), []).append(float(force))
    gaps = [np.mean(f["loading"]) - np.mean(f["unloading"]) for f in forces.values() if len(f) == 2]
    return float(np.mean(gaps)), float(taut.force.max())


def _test(repeats: int) -> SimulatedRigTest:
    law: ForceLaw = catalog.law("lei-mas-10-180n")
    muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), law)
    rig, protocol = SimulatedIsobaricTest(muscle), IsobaricProtocol(repeats=repeats)
    raw = rig.run(protocol, seed=1)
    test = raw.plateau_means()
    retest = rig.run(IsobaricProtocol(pressures=TEST_PRESSURES, repeats=1), seed=2).plateau_means()
    samples = raw.table["force_samples"].size
    return SimulatedRigTest(muscle, rig, protocol, test, away_from_turns(test), retest, samples)


@dataclass(frozen=True)
class JointMap:
    """Attainable stiffness of a joint.

    Attributes
    ----------
    angles
        Shape (angles,) [rad].
    lowest, highest
        Attainable stiffness under gravity, shape (angles,) [N*m/rad]; NaN outside the static range.
    torques
        Shape (torques,) [N*m].
    lowest_at, highest_at
        Attainable stiffness at each muscle torque, shape (torques, angles) [N*m/rad].
    gravity_torque
        Muscle torque that balances gravity, shape (angles,) [N*m].
    static_range
        Contiguous range of static angles around 0 [rad]; NaN if 0 is not static.
    """

    angles: NDArray[np.float64]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    torques: NDArray[np.float64]
    lowest_at: NDArray[np.float64]
    highest_at: NDArray[np.float64]
    gravity_torque: NDArray[np.float64]
    static_range: tuple[float, float]

    def at(self, angle: float) -> tuple[float, float]:
        """Attainable stiffness [N*m/rad] at the tabulated angle nearest to one [rad]."""
        index = int(np.argmin(np.abs(self.angles - angle)))
        return float(self.lowest[index]), float(self.highest[index])


def run_joint(*, resolution: int = 241) -> dict[str, JointMap]:
    """Attainable stiffness of both geometries, by setting key, at an odd number of angles (with 0)."""
    return {setting.key: _map(setting, resolution) for setting in SETTINGS}


def _map(setting: Setting, resolution: int) -> JointMap:
    plant = plant_of(setting)
    angles = jnp.linspace(-40 * deg, 40 * deg, resolution)
    balancing = -plant.load.gravity_torque(angles)
    torques = jnp.linspace(-8.0, 8.0, resolution)
    lowest, highest = _attainable(plant.joint, angles, balancing)
    lowest_at, highest_at = _attainable(plant.joint, angles[None, :], torques[:, None])
    maps = (np.asarray(x) for x in (angles, lowest, highest, torques, lowest_at, highest_at, balancing))
    return JointMap(*maps, static_range=_static_range(plant, np.asarray(angles), np.isnan(np.asarray(lowest))))


def _static_range(plant: JointPlant, angles: NDArray[np.float64], infeasible: NDArray[np.bool_]) -> tuple[float, float]:
    """First infeasible angle on either side of 0, refined once between grid points."""
    zero = int(np.argmin(np.abs(angles)))
    if infeasible[zero]:
        return float("nan"), float("nan")

    def edge(outwards: NDArray[np.float64], outside: NDArray[np.bool_]) -> float:
        if not outside.any():
            return float(outwards[-1])
        first = int(np.argmax(outside))
        between = jnp.linspace(outwards[first - 1], outwards[first], len(angles))  # as many: compiled once
        lowest, _ = _attainable(plant.joint, between, -plant.load.gravity_torque(between))
        return float(between[int(jnp.argmax(jnp.isnan(lowest))) - 1])

    return edge(angles[zero::-1], infeasible[zero::-1]), edge(angles[zero:], infeasible[zero:])


@compiled
def _attainable(joint: AntagonisticJoint, angle: Array, torque: Array) -> tuple[Array, Array]:
    return joint.attainable_stiffness(angle, torque)


def plant_of(setting: Setting) -> JointPlant:
    """Plant of a setting."""
    return pid_scenario(setting, StiffnessReference.CONSTANT).plant()
