"""Identification and validation of the paper's muscle, and the attainable set of its knee."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import Fit, Validation, fit_law, validate
from mckibben.muscle import ChouLaw, ExponentialLaw, ForceLaw, Muscle
from mckibben.paper.settings import SETTINGS, Setting, StiffnessReference, pid_scenario
from mckibben.plant import JointPlant
from mckibben.reachability import StaticEnvelope, static_envelope
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest, away_from_turns
from mckibben.units import bar, deg

TEST_PRESSURES = (2 * bar, 3 * bar, 4.5 * bar, 6 * bar)
"""Pressures of the paper's validation [Pa]; its identification uses them too."""

EXPERIMENTAL, CHOU = "experimental (Eq. 2)", "Chou (Eq. 1)"
CHOU_FITTED, PUBLISHED = "Chou (Eq. 1), fitted", "Eq. 3 as published"
RIG, MARTENS, FESTO = "virtual-rig", "dmsp-10-250-martens2017", "festo-tool-10mm"


@dataclass(frozen=True)
class SimulatedRigTest:
    """Isobaric test of the paper on the simulated rig (Fig. 3), and a second test with different noise (Fig. 4).

    Parameters
    ----------
    muscle, rig, protocol
        Muscle with the law of Eq. 3, the rig with its friction, and pressures, contractions and repeats.
    test
        Mean of each plateau.
    settled
        Those away from turns, where friction is fully developed.
    retest
        Means of the second test, at the paper's four pressures.
    samples
        Number of force samples of the first test.
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
    """Points, Eq. 2 fitted to them, and validations, by dataset.

    `retested` validates on the second test, `held_out_pressures` and `held_out_repeat` on points left out of a further
    fit, and `measured` on two measured muscles, with Chou's law and Eq. 3 as published for comparison.
    """

    rig: SimulatedRigTest
    data: dict[str, IsobaricDataset]
    fits: dict[str, Fit]
    retested: Validation
    held_out_pressures: Validation
    held_out_repeat: Validation
    measured: dict[str, Validation]


def run_identification(*, repeats: int = 5) -> Identification:
    """Run the isobaric test with a number of repeats (five in the paper), fit Eq. 2 and validate it.

    The simulated muscle has the law of Eq. 3 and a friction from the literature. Two measured muscles of the catalog
    are fitted in the same way.
    """
    rig = _test(repeats)
    real = {name: catalog.dataset(name) for name in (MARTENS, FESTO)}
    fits = {RIG: fit_law(ExponentialLaw, rig.settled)} | {
        name: fit_law(ExponentialLaw, data) for name, data in real.items()
    }
    chou = ChouLaw.of(rig.muscle.specimen)
    published = catalog.law("lei-mas-10-180n")
    return Identification(
        rig=rig,
        data={RIG: rig.settled} | real,
        fits=fits,
        retested=validate({EXPERIMENTAL: fits[RIG].law, CHOU: chou}, rig.retest),
        held_out_pressures=_held_out(chou, rig.settled, np.isin(rig.settled.levels, TEST_PRESSURES)),
        held_out_repeat=_held_out(chou, rig.settled, rig.settled.table["repeat"].to_numpy() == rig.settled.repeats[-1]),
        measured={
            name: validate(
                {
                    EXPERIMENTAL: fits[name].law,
                    CHOU: chou,
                    CHOU_FITTED: fit_law(ChouLaw, data).law,
                    PUBLISHED: published,
                },
                data,
            )
            for name, data in real.items()
        },
    )


def _held_out(chou: ChouLaw, data: IsobaricDataset, out: NDArray[np.bool_]) -> Validation:
    return validate({EXPERIMENTAL: fit_law(ExponentialLaw, data.select(~out)).law, CHOU: chou}, data.select(out))


def direction_gap(data: IsobaricDataset) -> tuple[float, float]:
    """Difference between loading and unloading at the same pressure and contraction.

    Parameters
    ----------
    data
        Points; taut ones count at which both directions were measured.

    Returns
    -------
    tuple of float
        Mean force of loading minus unloading, and the largest force of all taut points [N].
    """
    import pandas as pd  # 0.3 s

    taut = data.taut
    places = {"level": taut.levels, "contraction": np.round(taut.contraction, 6), "force": taut.force}
    points = pd.DataFrame({**places, "direction": taut.table["direction"].to_numpy()})
    means = points.pivot_table("force", ["level", "contraction"], "direction").dropna()
    return float((means["loading"] - means["unloading"]).mean()), float(taut.force.max())


def _test(repeats: int) -> SimulatedRigTest:
    law: ForceLaw = catalog.law("lei-mas-10-180n")
    muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), law)
    rig, protocol = SimulatedIsobaricTest(muscle), IsobaricProtocol(repeats=repeats)
    test = rig.run(protocol, seed=1)
    retest = rig.run(IsobaricProtocol(pressures=TEST_PRESSURES, repeats=1), seed=2)
    samples = len(test) * protocol.samples
    return SimulatedRigTest(muscle, rig, protocol, test, away_from_turns(test), retest, samples)


def run_joint(*, resolution: int = 241) -> dict[str, StaticEnvelope]:
    """Return the static envelope of both geometries, by setting key, at an odd number of angles (with 0)."""
    angles = np.linspace(-40 * deg, 40 * deg, resolution)
    return {setting.key: static_envelope(plant_of(setting), angles=angles) for setting in SETTINGS}


def plant_of(setting: Setting) -> JointPlant:
    """Plant of a setting."""
    return pid_scenario(setting, StiffnessReference.CONSTANT).plant()
