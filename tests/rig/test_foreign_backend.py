"""A rig backend of one's own: a dataclass that a protocol names."""

from dataclasses import dataclass
from typing import Annotated

import pytest

from mckibben import catalog
from mckibben.errors import ScenarioError
from mckibben.muscle import Muscle
from mckibben.rig.backend import MovingBackend
from mckibben.rig.document import RigTest
from mckibben.rig.running import check, run_test
from mckibben.rig.simulated import SimulatedRig
from mckibben.units import BoundedInt
from tests.rig.joint.conftest import Borrowed

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
TEXT = """name: a short test
muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
rig: {class: BorrowedRig, port: 3}
limits: {pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm, deviation: 20 N}
protocol:
  isobaric: {pressures: [3 bar, 4 bar], contraction_min: 2 %, contraction_max: 4 %, repeats: 1, speed: 4 mm/s,
    dwell: 200 ms, acquisition: 100 ms, samples: 100}
"""


@dataclass
class BorrowedRig(Borrowed, MovingBackend):
    """Hardware of one's own: the volts come from elsewhere, all optional members are the defaults."""

    port: Annotated[int, BoundedInt(0, 9)] = 0

    def __post_init__(self):
        MovingBackend.__post_init__(self)
        Borrowed.__init__(self, SimulatedRig(MUSCLE, seed=1), self.port)

    moving = property(lambda self: self.other.moving)

    def move(self, distance, speed):
        self.other.move(distance, speed)

    def stop(self):
        self.other.stop()


def test_a_backend_of_ones_own_runs_a_test(tmp_path):
    checked = check(RigTest.parse(TEXT))
    assert checked.backend.port == 3
    data = run_test(checked, tmp_path)
    assert sorted({round(float(one) / 1e5) for one in data.pressures}) == [3, 4]
    assert checked.rig == "borrowed"
    assert RigTest.read(tmp_path / "protocol.yaml") == checked.test
    assert [not one.problem for one in checked.backend.status()] == [True] * 4


def test_a_rig_that_cannot_vent_is_none():
    @dataclass
    class Unventable(BorrowedRig):
        vent = MovingBackend.vent

    with pytest.raises(ScenarioError, match="no class 'Unventable'"):
        RigTest.parse(TEXT.replace("BorrowedRig", "Unventable"))


def test_another_port_is_the_same_test_and_another_kind_of_rig_is_not():
    test = RigTest.parse(TEXT)
    assert test.is_same(RigTest.parse(TEXT.replace("port: 3", "port: 4")))
    assert not test.is_same(RigTest.parse(TEXT.replace("class: BorrowedRig, port: 3", "simulated: {}")))
