"""One reduced reproduction for all tests of a worker."""

from __future__ import annotations

import pytest

from mckibben.paper.claims import evaluate_claims
from mckibben.paper.identification import run_identification, run_joint
from mckibben.paper.reproduction import Reproduction
from mckibben.paper.tracking import run_tracking


@pytest.fixture(scope="session")
def identification():
    return run_identification(repeats=2)


@pytest.fixture(scope="session")
def joint_maps():
    return run_joint(resolution=121)


@pytest.fixture(scope="session")
def reported():
    """Progress reported by `tracking`."""
    return []


@pytest.fixture(scope="session")
def tracking(reported):
    return run_tracking(seeds=2, generations=2, population=8, progress=reported.append)


@pytest.fixture(scope="session")
def reproduction(identification, joint_maps, tracking):
    claims = evaluate_claims(identification, joint_maps, tracking)
    return Reproduction(identification, joint_maps, tracking, claims, quick=True, seconds=1.0)
