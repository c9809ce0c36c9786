"""Remarks on the laws of a joint's muscles."""

import pytest

from mckibben import catalog
from mckibben.joint import AntagonisticJoint, PairedPaths, Pulley
from mckibben.muscle import Domain, Muscle, ReynoldsLaw, Specimen
from mckibben.result import Severity
from mckibben.units import bar, mm


@pytest.mark.parametrize(("slope", "severe"), [(-280, 1), (280, 0)])
def test_a_muscle_that_pulls_more_the_shorter_it_is_is_severe(slope, severe):
    law = ReynoldsLaw(f0=3, f1=60 / bar, k0=0, k1=slope / bar, domain=Domain(pressure_max=6 * bar))
    muscle = Muscle(Specimen("mine", 300 * mm), law)
    pulley = Pulley(radius=30 * mm, rest_length=275 * mm)
    remarks = AntagonisticJoint(PairedPaths(pulley, pulley), muscle, muscle).remarks
    assert [remark.severity for remark in remarks] == [Severity.SEVERE] * severe


@pytest.mark.parametrize("name", catalog.names("joints"))
def test_the_joints_of_the_catalog_have_laws_of_muscles(name):
    assert all(remark.severity is not Severity.SEVERE for remark in catalog.joint(name).remarks)
