"""Verdicts of the claims, each able to come out either way."""

import dataclasses
import math

import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset
from mckibben.paper.claims import evaluate_claims
from mckibben.paper.identification import CHOU, EXPERIMENTAL, FESTO, MARTENS, RIG
from mckibben.paper.settings import SETTINGS, StiffnessReference
from mckibben.paper.tracking import (
    BP,
    CONTROLLERS,
    DOUBLED_PID,
    FREE_TUNED_BP,
    PID,
    TUNED_BP,
    TUNED_PID,
    ControllerRun,
    Coupling,
    Tracking,
)
from mckibben.simulation import Metrics
from mckibben.units import deg

pytestmark = pytest.mark.slow  # they need the identification of all muscles

CHOU_CLAIM = "The experimental law is closer to the measured force than Chou's"
REAL_CLAIM = "Eq. 2 is closer than Chou's law on a measured map"
SIMILAR_CLAIM = "Loading and unloading are similar"
SAFE_CLAIM = "BP can be added to any PID"
COUPLED_CLAIM = "Position and stiffness are coupled"
RANGE_CLAIM = "The knee reaches 55 deg"
MODERATE, OPTIMISED = "the same moderate gains in both", "gains tuned by an optimiser"


def angle_claim(reference: StiffnessReference, gains: str) -> str:
    return f"BP's position error is smaller than PID's under {reference.value} stiffness ({gains})"


def settling_claim(gains: str) -> str:
    return f"BP's stiffness settles sooner ({gains})"


def of(claims, start: str):
    found = [claim for claim in claims if claim.claim.startswith(start)]
    assert len(found) == 1, [claim.claim for claim in claims]
    return found[0]


def run(*, angle_rmse=1.0, settling=0.5) -> ControllerRun:
    """A run over seeds whose metrics are known, in degrees and seconds; single numbers are those of every seed.

    The reference is a sine of 10 deg.
    """
    given = {"angle_rmse": angle_rmse, "stiffness_settling": settling}
    columns = {name: np.zeros(3) for name in Metrics._fields}
    for name, value in given.items():
        columns[name] = np.broadcast_to(np.asarray(value, float), (3,)) * (1 if name == "stiffness_settling" else deg)
    reference = 10 * deg * np.sin(np.linspace(0, 2 * np.pi, 1000, endpoint=False))
    result = {"desired_angle": reference}
    return ControllerRun(None, result, Metrics(**columns))


@pytest.fixture(scope="module")
def judged(identification, joint_maps):
    """The verdict on a claim, with some of the inputs replaced; by default BP is better at everything."""
    better = {PID: run(angle_rmse=2.0, settling=0.6), BP: run(), TUNED_PID: run(angle_rmse=0.3, settling=0.3)}
    better |= {TUNED_BP: run(angle_rmse=0.2, settling=0.2), FREE_TUNED_BP: run(angle_rmse=0.3)}
    better[DOUBLED_PID] = run(angle_rmse=0.7)
    standard = {(s.key, w, name): better[name] for s in SETTINGS for w in StiffnessReference for name in CONTROLLERS}
    coupling = {s.key: Coupling(0.1 * deg, 0.1, 0.001) for s in SETTINGS}

    def judge_with(start: str, *, runs=None, muscles=identification, maps=joint_maps, coupled=coupling):
        tracking = Tracking(standard | (runs or {}), {}, coupled, seeds=3)
        return of(evaluate_claims(muscles, maps, tracking), start)

    return judge_with


def relabelled(validation, swap: dict[str, str]):
    return dataclasses.replace(
        validation, errors=tuple(dataclasses.replace(e, law=swap.get(e.law, e.law)) for e in validation.errors)
    )


def test_chou_may_be_closer(judged, identification):
    assert judged(CHOU_CLAIM).holds
    swapped = relabelled(identification.retested, {EXPERIMENTAL: CHOU, CHOU: EXPERIMENTAL})
    assert not judged(CHOU_CLAIM, muscles=dataclasses.replace(identification, retested=swapped)).holds
    one = dataclasses.replace(  # at one pressure of four is enough
        identification.retested,
        errors=tuple(
            dataclasses.replace(e, rmse=1e3) if e.law == EXPERIMENTAL and e.pressure == 3e5 else e
            for e in identification.retested.errors
        ),
    )
    assert not judged(CHOU_CLAIM, muscles=dataclasses.replace(identification, retested=one)).holds


@pytest.mark.parametrize("name", [MARTENS, FESTO])
def test_the_law_may_fail_on_unseen_pressures_of_a_real_muscle(judged, identification, name):
    assert judged(REAL_CLAIM).holds
    fit = identification.fits[name]
    for worse in (dataclasses.replace(fit.leave_one_pressure_out, rmse=80.0), None):
        fits = identification.fits | {name: dataclasses.replace(fit, leave_one_pressure_out=worse)}
        assert not judged(REAL_CLAIM, muscles=dataclasses.replace(identification, fits=fits)).holds


def test_loading_and_unloading_may_differ(judged, identification):
    table = identification.data[RIG].table
    loading = table["direction"].to_numpy() == "loading"
    assert judged(SIMILAR_CLAIM).holds
    for shift, holds in ((30.0, True), (80.0, False), (-130.0, False)):
        further = IsobaricDataset(table.assign(force=table["force"] + shift * loading))
        found = judged(SIMILAR_CLAIM, muscles=dataclasses.replace(identification, data={RIG: further}))
        assert found.holds is holds, found.evidence


@pytest.mark.parametrize("reference", StiffnessReference)
@pytest.mark.parametrize(
    ("pid", "bp", "gains"), [(PID, BP, MODERATE), (TUNED_PID, TUNED_BP, OPTIMISED)], ids=["moderate", "tuned"]
)
def test_bp_may_have_the_larger_angle_error(judged, reference, pid, bp, gains):
    claim = angle_claim(reference, gains)
    other = next(w for w in StiffnessReference if w is not reference)
    assert judged(claim).holds
    for setting in SETTINGS:  # one geometry of two is enough
        assert not judged(claim, runs={(setting.key, reference, bp): run(angle_rmse=5.0)}).holds
        assert judged(claim, runs={(setting.key, other, bp): run(angle_rmse=5.0)}).holds
        before = 2.0 if pid == PID else 0.3
        assert not judged(claim, runs={(setting.key, reference, bp): run(angle_rmse=0.97 * before)}).holds
        assert judged(claim, runs={(setting.key, reference, bp): run(angle_rmse=0.9 * before)}).holds
        one_unstable = run(angle_rmse=[0.1, 0.1, 50.0])
        assert not judged(claim, runs={(setting.key, reference, bp): one_unstable}).holds
        assert not judged(claim, runs={(setting.key, reference, bp): run(angle_rmse=math.nan)}).holds


@pytest.mark.parametrize("reference", StiffnessReference)
@pytest.mark.parametrize(
    ("pid", "bp", "gains"), [(PID, BP, MODERATE), (TUNED_PID, TUNED_BP, OPTIMISED)], ids=["moderate", "tuned"]
)
def test_bp_may_settle_later_or_never(judged, reference, pid, bp, gains):
    claim = settling_claim(gains)
    assert judged(claim).holds
    for setting in SETTINGS:
        here = (setting.key, reference)
        assert not judged(claim, runs={(*here, bp): run(settling=0.9)}).holds
        never = judged(claim, runs={(*here, bp): run(settling=math.nan)})
        assert not never.holds
        assert "BP never" in never.evidence
        assert judged(claim, runs={(*here, pid): run(settling=math.nan)}).holds
        same = {(*here, name): run(settling=0.4) for name in (pid, bp)}
        assert judged(claim, runs=same).holds  # no later there, and sooner in the other three cases
    half = {(s.key, reference, name): run(settling=0.4) for s in SETTINGS for name in (pid, bp)}
    assert not judged(claim, runs=half).holds  # sooner in two cases of four


def test_bp_may_be_safe_or_not(judged):
    assert judged(SAFE_CLAIM).holds
    key = SETTINGS[1].key
    unstable = judged(
        SAFE_CLAIM, runs={(key, StiffnessReference.STEP, FREE_TUNED_BP): run(angle_rmse=[0.1, 0.1, 50.0])}
    )
    assert not unstable.holds
    assert "1 of 3 seeds unstable" in unstable.evidence
    assert not judged(SAFE_CLAIM, runs={(key, StiffnessReference.STEP, FREE_TUNED_BP): run(angle_rmse=0.31)}).holds


def test_position_and_stiffness_may_be_uncoupled(judged):
    good = Coupling(0.5 * deg, 0.1, 0.001)
    assert judged(COUPLED_CLAIM).holds
    for bad in (Coupling(0.0, 0.1, 0.001), Coupling(0.1 * deg, 0.001, 0.001), Coupling(0.1 * deg, 0.1, math.nan)):
        assert not judged(COUPLED_CLAIM, coupled={s.key: bad for s in SETTINGS}).holds
        for setting in SETTINGS:  # to be seen in one geometry is to be there
            assert judged(COUPLED_CLAIM, coupled={s.key: bad for s in SETTINGS} | {setting.key: good}).holds


def test_the_knee_may_have_its_range(judged, joint_maps):
    assert not judged(RANGE_CLAIM).holds
    key = SETTINGS[0].key
    swapped = joint_maps | {key: joint_maps[SETTINGS[1].key]}
    assert judged(RANGE_CLAIM, maps=swapped).holds
    assert not judged(RANGE_CLAIM, maps=joint_maps | {SETTINGS[1].key: joint_maps[key]}).holds
