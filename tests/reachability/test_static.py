"""Static envelope against the paper's equations in plain NumPy, and what changes a reference to a feasible one."""

import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve, FlowValve, IdealValve
from mckibben.control import Reference
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.plant import JointPlant
from mckibben.reachability import static_envelope
from mckibben.simulation import check_reference
from mckibben.units import bar, deg


@pytest.mark.slow
def test_static_envelope_over_the_angle(plant, paper_precontracted):
    found = static_envelope(plant)
    assert (found.angle_min / deg, found.angle_max / deg) == pytest.approx((-36.49, 38.57), abs=0.01)
    zero = int(np.argmin(np.abs(found.angles)))
    edges = [edge[zero] for edge in (*found.torque_range, *found.stiffness)]
    assert edges == pytest.approx([-7.28, 7.28, 9.96, 19.53], abs=0.01)
    rows = found.table_rows()
    assert 5 <= len(rows) <= 11 and zero in rows
    for k in rows:
        for stiffness, pressures in (
            (found.stiffness.lowest[k], found.pressures_at_lowest[:, k]),
            (found.stiffness.highest[k], found.pressures_at_highest[:, k]),
        ):
            assert paper_precontracted.torque(found.angles[k], pressures) == pytest.approx(found.torque[k], abs=1e-5)
            assert paper_precontracted.stiffness(found.angles[k], pressures) == pytest.approx(stiffness, abs=1e-4)
            assert pressures.min() > -1e-3 and pressures.max() < 6 * bar + 1e-3
    assert found.map_stiffness.width.shape == found.map_torques.shape
    assert np.nanmin(found.map_stiffness.width) > -1e-9


@pytest.mark.parametrize("valve", [FlowValve(0.4 * L_PER_S_BAR, 3 * bar), FirstOrderValve(0.02, supply=3 * bar)])
@pytest.mark.slow
def test_feasibility_and_envelope_end_at_the_supply(as_printed, load, valve):
    plant = JointPlant(as_printed, load, valve)
    reference = Reference(0.0, 72.8)
    band, envelope = check_reference(plant, reference, duration=2.0, control_period=0.01), static_envelope(plant)
    at_rest = int(np.argmin(np.abs(envelope.angles)))
    assert band.lowest[0] == pytest.approx(envelope.stiffness.lowest[at_rest], abs=0.01)
    assert band.highest[0] == pytest.approx(envelope.stiffness.highest[at_rest], abs=0.01)
    assert np.nanmax(envelope.pressures_at_lowest) == pytest.approx(3 * bar)
    assert (
        envelope.stiffness.lowest[at_rest]
        > static_envelope(JointPlant(as_printed, load, IdealValve())).stiffness.lowest[at_rest] + 1
    )
