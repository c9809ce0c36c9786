"""Remarks on the laws of a joint's muscles."""

import pytest

from mckibben import catalog
from mckibben.errors import McKibbenWarning, UnreachableError
from mckibben.joint import AntagonisticJoint, PairedPaths, Pulley
from mckibben.muscle import Domain, ForceLaw, Muscle, PiecewiseLaw, ReynoldsLaw, Specimen
from mckibben.result import Severity
from mckibben.units import bar, mm


def joint_of(law: ForceLaw) -> AntagonisticJoint:
    muscle = Muscle(Specimen("mine", 300 * mm), law)
    pulley = Pulley(radius=30 * mm, rest_length=275 * mm)
    return AntagonisticJoint(PairedPaths(pulley, pulley), muscle, muscle)


SIX_BAR = Domain(pressure_max=6 * bar)
WRONG = {
    "rises with contraction": ReynoldsLaw(f0=3, f1=60 / bar, k0=0, k1=-280 / bar, domain=SIX_BAR),
    "falls with pressure": ReynoldsLaw(f0=300, f1=-10 / bar, k0=500, k1=100 / bar, domain=SIX_BAR),
    "falls with pressure at 0 % and 3 bar": PiecewiseLaw(
        (1 * bar, 3 * bar, 6 * bar), (200.0, 500.0, 400.0), (1e3, 1e3, 1e3), SIX_BAR
    ),
    "does not pull": ReynoldsLaw(f0=-30, f1=-10 / bar, k0=500, k1=100 / bar, domain=SIX_BAR),
}


@pytest.mark.slow
@pytest.mark.parametrize("words", WRONG)
def test_a_law_that_no_muscle_has_is_named_where_it_enters_and_with_its_joint(words):
    with pytest.warns(McKibbenWarning, match=f"'mine'.*{words}"):
        joint = joint_of(WRONG[words])
    assert [(remark.severity, words in remark.text) for remark in joint.remarks] == [(Severity.SEVERE, True)]


@pytest.mark.parametrize("spring", [280 / bar, -5 / bar], ids=["stiffens", "softens"])
def test_a_muscle_whose_spring_stiffens_or_softens_under_pressure_is_right(spring):
    law = ReynoldsLaw(f0=3, f1=60 / bar, k0=100, k1=spring, domain=SIX_BAR)
    assert joint_of(law).remarks == []


@pytest.mark.slow
def test_why_nothing_holds_the_joint_is_its_law():
    with pytest.warns(McKibbenWarning):
        joint = joint_of(WRONG["falls with pressure"])
    with pytest.raises(UnreachableError, match="falls with pressure"):
        joint.pressures_for(0.0, torque=0.0)


@pytest.mark.parametrize("name", catalog.names("joints"))
def test_the_joints_of_the_catalog_have_laws_of_muscles(name):
    assert all(remark.severity is not Severity.SEVERE for remark in catalog.joint(name).remarks)
