"""The muscle's half of the paper: an isobaric test, the law identified from it, its validation; and real muscles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import Fit, Validation, identify, validate
from mckibben.muscle import ChouLaw, ExponentialLaw, ForceLaw, Muscle
from mckibben.rig import IsobaricProtocol, VirtualRig, away_from_turns
from mckibben.units import bar

TEST_PRESSURES = (2 * bar, 3 * bar, 4.5 * bar, 6 * bar)
"""Those of the paper's validation; they are also on the grid of its identification."""

EXPERIMENTAL, CHOU = "experimental (Eq. 2)", "Chou (Eq. 1)"
CHOU_FITTED, PUBLISHED = "Chou (Eq. 1), fitted", "Eq. 3 as published"
RIG, MARTENS, FESTO = "virtual-rig", "dmsp-10-250-martens2017", "festo-tool-10mm"


@dataclass(frozen=True)
class RigTest:
    """The isobaric test of the paper on the virtual rig.

    Attributes
    ----------
    muscle
        What the rig tests: the paper's specimen, following Eq. 3.
    rig, protocol
        The virtual rig, and what it ran.
    test
        Plateau means of the whole test (Fig. 3).
    settled
        Those away from the turning points: what is identified from.
    retest
        A second test at the four pressures of the paper's validation, with other noise and offsets (Fig. 4).
    samples
        How many raw samples the test recorded.
    """

    muscle: Muscle
    rig: VirtualRig
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
        The test on the virtual rig.
    data
        The points behind each fit, by dataset.
    fits
        Eq. 2 fitted to each.
    retested
        The fitted law and Chou's against the retest, which neither has seen.
    held_out_pressures, held_out_repeat
        Errors at the four pressures, and at the last repeat, of Eq. 2 fitted without them, and of Chou's law.
    measured
        On each real dataset: Eq. 2 fitted to it, Chou's law of the specimen and Chou's law with braid angle and
        diameter fitted, and Eq. 3 as published.
    """

    rig: RigTest
    data: dict[str, IsobaricDataset]
    fits: dict[str, Fit]
    retested: Validation
    held_out_pressures: Validation
    held_out_repeat: Validation
    measured: dict[str, Validation]


def run_identification(*, repeats: int = 5) -> Identification:
    """Run the test, fit and validate.

    Parameters
    ----------
    repeats
        Of the isobaric test; the paper has five.
    """
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


def _held_out(chou: ChouLaw, train: IsobaricDataset, unseen: IsobaricDataset) -> Validation:
    return validate({EXPERIMENTAL: identify(ExponentialLaw, train).law, CHOU: chou}, unseen)


def direction_gap(data: IsobaricDataset) -> tuple[float, float]:
    """How far loading and unloading are apart at the same pressure and contraction.

    Returns
    -------
    gap, span
        The mean difference of force, loading minus unloading [N], and the largest force of the data [N].
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


def _test(repeats: int) -> RigTest:
    law: ForceLaw = catalog.law("lei-mas-10-180n")
    muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), law)
    rig, protocol = VirtualRig(muscle), IsobaricProtocol(repeats=repeats)
    raw = rig.run(protocol, seed=1)
    test = raw.plateau_means()
    retest = rig.run(IsobaricProtocol(pressures=TEST_PRESSURES, repeats=1), seed=2).plateau_means()
    samples = raw.table["force_samples"].size
    return RigTest(muscle, rig, protocol, test, away_from_turns(test), retest, samples)
