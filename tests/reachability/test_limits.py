"""What limits the attainable stiffness, extrapolated laws, and stiffness with friction."""

import dataclasses

import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve, FlowValve
from mckibben.joint.antagonistic import SMALL_MOTION
from mckibben.muscle import Domain, MaxwellSlip
from mckibben.reachability import envelope, static_envelope
from mckibben.report.joint import envelope as draw_envelope
from mckibben.report.tracking import tracking
from mckibben.scenario import Scenario, run_scenario
from mckibben.units import bar, percent

BASE = Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(
    update={"valve": FirstOrderValve(0.02), "duration": 0.2}
)
MEASURED = Domain(-3 * percent, 25 * percent, 2 * bar, 5 * bar)


def scenario(**changes) -> Scenario:
    """The scenario with a law measured at 2 to 5 bar, of a muscle rated for 8 bar."""
    muscle = BASE.joint.muscle1
    law = dataclasses.replace(muscle.law, domain=MEASURED)
    muscle = dataclasses.replace(muscle, law=law, **changes)
    return BASE.model_copy(update={"joint": dataclasses.replace(BASE.joint, muscle1=muscle, muscle2=muscle)})


def test_measured_pressures_limit_a_muscle_unless_its_law_is_extrapolated():
    muscle = scenario().joint.muscle1
    assert (muscle.domain.pressure_min, muscle.domain.pressure_max) == (2 * bar, 5 * bar)
    assert not muscle.extrapolation
    further = scenario(extrapolate=True).joint.muscle1
    assert (further.domain.pressure_min, further.domain.pressure_max) == (0.0, 8 * bar)
    assert further.domain.contraction_max == MEASURED.contraction_max
    assert "2..5 bar" in further.extrapolation and "0..8 bar" in further.extrapolation


def test_extrapolation_is_part_of_a_file():
    further = scenario(extrapolate=True)
    assert Scenario.parse(further.dumps()).joint.muscle1 == further.joint.muscle1
    assert "extrapolate" in further.dumps() and "extrapolate" not in scenario().dumps()


@pytest.mark.slow
def test_the_envelope_names_what_limits_it():
    found = envelope(scenario())
    lowest, highest, offer = (remark.text for remark in found.remarks())
    assert "the lowest measured pressure (2 bar)" in lowest and "the highest measured pressure (5 bar)" in highest
    assert "extrapolate: true" in offer
    further = envelope(scenario(extrapolate=True))
    texts = [remark.text for remark in further.remarks()]
    assert "measured pressure" not in " ".join(texts[:2])
    assert further.scenario.joint.muscle1.extrapolation in texts
    inside = ~np.isnan(found.static.stiffness.lowest)
    assert (further.static.stiffness.lowest[inside] <= found.static.stiffness.lowest[inside] + 1e-6).all()
    assert np.nanmax(further.static.stiffness.highest) > np.nanmax(found.static.stiffness.highest) + 1
    supplied = envelope(BASE.model_copy(update={"valve": FlowValve(conductance=1e-9, supply=4 * bar)}))
    assert any("the supply (4 bar)" in remark.text for remark in supplied.remarks())


@pytest.mark.slow
def test_simulation_and_envelope_have_the_same_limits():
    for each in (scenario(), scenario(extrapolate=True)):
        result = run_scenario(each)
        feasibility = result.feasibility
        static = static_envelope(each.plant(), about=float(result["desired_angle"][0]))
        at = feasibility.desired_angle[0]
        for edge, band in zip(static.stiffness, (feasibility.lowest[0], feasibility.highest[0]), strict=True):
            assert np.interp(at, static.angles, edge) == pytest.approx(band, rel=1e-3)
        domain = each.joint.muscle1.domain
        assert result["pressure1"].max() <= domain.pressure_max + 1
        assert result.domains() == (domain, domain)


@pytest.mark.slow
def test_small_motion_stiffness_stands_next_to_the_isobaric_one(tmp_path):
    rubbing = scenario(friction=MaxwellSlip(12.0, 0.5e-3))
    found = envelope(rubbing)
    static, at = found.static, int(found.static.table_rows()[0])
    columns = [*found.listings()][-1].columns
    small = static.small_motion
    assert small is not None
    pressures = static.pressures_at_lowest[:, at]
    expected = rubbing.joint.secant_stiffness(static.angles[at], (pressures[0], pressures[1]), SMALL_MOTION)
    assert small.lowest[at] == pytest.approx(float(expected))
    assert small.lowest[at] > static.stiffness.lowest[at] + 5
    shown = [columns[f"{end} small-motion stiffness"][1][0] for end in ("lowest", "highest")]
    assert shown == [small.lowest[at], small.highest[at]]
    assert any("friction" in remark.text for remark in found.remarks())
    result = run_scenario(rubbing)
    assert (result["small_motion_stiffness"] > result["stiffness"] + 5).all()
    result.to_netcdf(tmp_path / "run.nc")
    (edge,) = [one for one in draw_envelope(found).axes[1].lines if str(one.get_label()).startswith("small motion")]
    assert np.nanmax(edge.get_ydata()) == pytest.approx(np.nanmax(small.lowest[static.inside]))
    assert draw_envelope(found).axes[1].get_yscale() == "log"
    _, _, isobaric, small_motion, _ = tracking({"PID": result}).axes
    (line,) = small_motion.lines
    np.testing.assert_array_equal(line.get_ydata(), result["small_motion_stiffness"])
    assert isobaric.get_ylim()[1] < small_motion.get_ylim()[0]
    plain = envelope(scenario())
    assert plain.static.small_motion is None
    assert "lowest small-motion stiffness" not in [*plain.listings()][-1].columns
    assert "small_motion_stiffness" not in run_scenario(scenario()).columns
