"""What a run answers: its outcome in words, units, and files."""

import dataclasses
import re

import equinox as eqx
import numpy as np
import pytest

import mckibben as mk
from mckibben.component.columns import attributes
from mckibben.control import Measurement
from mckibben.errors import FileError, ReachabilityWarning, SimulationError
from mckibben.plant import PlantState
from mckibben.simulation import Outcome, run_episode, sampled
from mckibben.simulation.result import BAND
from mckibben.simulation.trajectories import column_names
from mckibben.units import bar, deg

POSITION, STIFFNESS = mk.PID(2 * bar, 60 * bar, 0.4 * bar), mk.PID(0.08 * bar, 5 * bar, 0.0)


@pytest.fixture(scope="module")
def completed(plant, knee):
    reference = mk.Reference(angle=mk.Sine(10 * deg, 0.5), stiffness=mk.Constant(15.0))
    return mk.simulate(
        plant,
        mk.PositionStiffnessControl(POSITION, STIFFNESS, model=knee),
        reference,
        duration=0.2,
        scenario="name: α\n",
    )


@pytest.fixture(scope="module")
def saturated(plant, knee):
    reference = mk.Reference(
        angle=mk.Sine(0.0, 0.5), stiffness=mk.Constant(30.0)
    )  # no motion; same structure as the others
    with pytest.warns(ReachabilityWarning):
        return mk.simulate(plant, mk.PositionStiffnessControl(POSITION, STIFFNESS, model=knee), reference, duration=0.2)


@pytest.fixture(scope="module")
def left_domain(as_printed, load, playback):
    """All pressure on one side, from rest: the joint swings over to where the other muscle is stretched too far."""
    reference = mk.Reference(angle=mk.Constant(0.0), stiffness=mk.Constant(6 * bar))  # playback: p1 = 0, p2 = 6 bar
    with pytest.warns(ReachabilityWarning):
        return mk.simulate(mk.JointPlant(as_printed, load, mk.IdealValve()), playback, reference, duration=0.2)


@pytest.fixture(scope="module")
def diverged(knee, load):
    """Damping with a time constant of under 1 ms, integrated in steps of 50 ms, at which Runge-Kutta is unstable."""
    stiff = mk.JointPlant(knee, dataclasses.replace(load, damping=1000 * load.total_inertia), mk.FirstOrderValve(0.02))
    reference = mk.Reference(angle=mk.Sine(0.0, 0.5, offset=1 * deg), stiffness=mk.Constant(15.0))
    control = mk.PositionStiffnessControl(POSITION, STIFFNESS, model=knee)
    _, setpoints = sampled(reference, 40.0, 0.2)  # 200 periods, as in the other runs
    run = run_episode(stiff, control, setpoints, stiff.equilibrium(1 * deg), 0.2, 4)  # `simulate` refuses it
    return mk.SimulationResult({**run.columns, **dict.fromkeys(BAND, np.full(200, np.nan))}, 0.2)


def said(text: str, what: str) -> tuple[float, float]:
    """For how long and from when on."""
    return tuple(float(x) for x in re.search(rf"{what}[^;]*? for ([\d.e-]+) s, first at ([\d.e-]+) s", text).groups())


@pytest.mark.parametrize(("frequency", "poor"), [(0.5, False), (8.0, True)])
def test_a_reference_too_fast_for_the_joint_is_not_followed(plant, knee, frequency, poor):
    reference = mk.Reference(angle=mk.Sine(10 * deg, frequency), stiffness=mk.Constant(15.0))
    result = mk.simulate(plant, mk.PositionStiffnessControl(POSITION, STIFFNESS, model=knee), reference, duration=1.0)
    assert result.outcome is (Outcome.NOT_FOLLOWED if poor else Outcome.COMPLETED) and result.ok != poor
    assert ("mckibben envelope" in result.to_text(), "reference -10..10 deg" in result.verdict()) == (poor, poor)


def test_five_numbers_are_shown_and_neither_zeros_nor_dashes(completed, saturated):
    shown, details = completed.listings()
    assert list(shown.columns) == ["angle_rmse", "angle_max", "stiffness_rmse", "air", "command_travel"]
    assert details.detail and not shown.detail and not set(shown.columns) & set(details.columns)
    assert set(shown.columns) | set(details.columns) == set(completed.metrics)
    still = next(iter(saturated.listings())).columns
    assert "angle_rmse" in still and all(np.nan_to_num(values[0]) != 0 for _, values in still.values())


def test_a_run_whose_reference_is_not_attainable_is_not_ok(saturated):
    assert not saturated.ok and saturated.verdict().startswith("the reference is not attainable")


def test_missed_deadlines_are_kept_with_the_run(completed, tmp_path):
    late = dataclasses.replace(completed, missed=3044, deadlines=6000)
    assert late.outcome is Outcome.LATE and not late.ok and "3044 of 6000" in late.verdict()
    late.to_netcdf(tmp_path / "late.nc")
    assert mk.SimulationResult.from_netcdf(tmp_path / "late.nc").verdict() == late.verdict()


def test_a_column_is_an_array_and_an_unknown_one_is_named(completed):
    assert isinstance(completed["torque"], np.ndarray) and completed["torque"] is completed.columns["torque"]
    assert "torque" in completed and "wrench" not in completed
    with pytest.raises(SimulationError, match="angle, velocity") as caught:
        completed["wrench"]
    assert caught.value.value == "wrench"


def test_a_limit_cycle_counts_from_the_resolution_of_its_sensor(completed):
    cycle = 0.3 * deg * np.sin(2 * np.pi * 50 * 1e-3 * np.arange(200))
    columns = {**completed.columns, "angle": completed["desired_angle"] + cycle}
    for resolution, expected in (({}, 0.3 * deg), ({"angle_resolution": 1 * deg}, 0.0)):
        found = mk.SimulationResult(columns, completed.control_period, **resolution)
        assert found.metrics["oscillation_amplitude"] == pytest.approx(expected, rel=0.1)


def test_saturated(saturated, knee):
    assert saturated.outcome is Outcome.SATURATED
    top = 6 * bar
    at_top = (saturated["command1"] >= top - 1) | (saturated["command2"] >= top - 1)
    assert at_top.any()
    np.testing.assert_array_equal(saturated["saturated"], at_top)
    assert "at a pressure limit" in saturated.verdict()
    times = saturated.times
    assert said(saturated.verdict(), "saturated") == pytest.approx(
        (int(at_top.sum()) * 1e-3, times[at_top][0]), rel=1e-3
    )


@pytest.mark.slow
def test_left_domain(left_domain, paper):
    assert left_domain.outcome is Outcome.LEFT_REFERENCE, "the angle 0 is not tracked"
    table = left_domain
    outside = np.zeros(table.times.size, bool)
    for k, eps in enumerate(paper.contractions(table["angle"]), start=1):
        np.testing.assert_allclose(table[f"contraction{k}"], eps, atol=1e-12)
        outside |= (eps < -0.03) | (eps > 0.25)
    np.testing.assert_array_equal(table["outside_domain"], outside)
    assert 0 < outside.sum() < outside.size
    assert said(left_domain.verdict(), "outside the domain") == pytest.approx(
        (outside.sum() * 1e-3, outside.argmax() * 1e-3), rel=1e-3
    )
    assert left_domain.metrics["time_outside_domain"] == pytest.approx(outside.sum() * 1e-3)


def test_diverged(diverged):
    assert diverged.outcome is Outcome.DIVERGED
    finite = np.isfinite(diverged["angle"])
    assert finite.any()
    assert not finite.all()
    when = float(re.search(r"after ([\d.]+) s", diverged.verdict())[1])
    assert when == pytest.approx((finite.sum() - 1) * 0.2)
    assert np.isnan(diverged.metrics["angle_rmse"])


@pytest.mark.slow
def test_slack_is_said_of_a_run_that_completed(plant, knee, playback):
    reference = mk.Reference(angle=mk.Constant(0.0), stiffness=mk.Constant(3e5))  # playback: p1 = 0, p2 = 3 bar
    with pytest.warns(ReachabilityWarning):
        result = mk.simulate(plant, playback, reference, duration=0.2, initial=PlantState(0.0, 0.0, (0.0, 1e5)))
    slack = (result["force1"] <= 0) | (result["force2"] <= 0)
    assert slack.any()
    np.testing.assert_array_equal(result["slack"], slack)
    assert said(result.verdict(), "slack")[0] == pytest.approx(int(slack.sum()) * 1e-3, rel=1e-3)


def test_forces_and_torque_are_those_of_the_papers_equations(completed, paper_precontracted):
    table = completed
    angle, pressures = table["angle"], (table["pressure1"], table["pressure2"])
    np.testing.assert_allclose(table["torque"], paper_precontracted.torque(angle, pressures), atol=1e-9)
    np.testing.assert_allclose(table["stiffness"], paper_precontracted.stiffness(angle, pressures), rtol=1e-9)
    for k, eps in enumerate(paper_precontracted.contractions(angle)):
        np.testing.assert_allclose(table[f"force{k + 1}"], paper_precontracted.eq3(eps, pressures[k]), rtol=1e-9)


def test_every_variable_of_a_run_has_a_unit_and_a_meaning(completed):
    for name in completed.to_dataset().variables:
        assert completed.to_dataset()[name].attrs["units"], name
        assert completed.to_dataset()[name].attrs["long_name"], name
    assert set(column_names(())) <= set(completed.to_dataset().variables)
    units = {name: completed.to_dataset()[name].attrs["units"] for name in completed.to_dataset().variables}
    assert units["angle"] == "rad"
    assert units["pressure1"] == units["command2"] == "Pa"
    assert units["stiffness"] == units["highest_stiffness"] == "N*m/rad"


def test_all_that_controllers_by_a_model_report_has_units(knee, load):
    loops = mk.PositionStiffnessControl(mk.PID(1e5, 1e5, 0.0), mk.PID(1e4, 1e4, 0.0), model=knee)
    for control in (
        mk.DecouplingControl(knee, load, mk.PolePlacement(60.0), mk.ExtendedStateObserver()),
        mk.PredictiveControl(knee, load),
        mk.InverseModelControl(loops, load),
    ):
        seen = Measurement(np.array(0.1), (np.array(4e5), np.array(4.4e5)))
        told = eqx.filter_eval_shape(lambda control, seen: control.telemetry(control.init(seen)), control, seen)
        assert len(told) > 3
        assert all(attributes(name).get("units") for name in told)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["completed", "saturated", "left_domain", "diverged"])
def test_netcdf_gives_the_same_run_back(which, request, tmp_path):
    result = request.getfixturevalue(which)
    result.to_netcdf(tmp_path / "run.nc")
    back = mk.SimulationResult.from_netcdf(tmp_path / "run.nc")
    assert back.to_dataset().identical(result.to_dataset())
    for name in result.columns:
        assert back[name].dtype == result[name].dtype, name
    assert back.outcome is result.outcome
    assert back.verdict() == result.verdict()
    assert back.control_period == result.control_period
    np.testing.assert_equal(back.metrics, result.metrics)
    assert [p.name for p in tmp_path.iterdir()] == ["run.nc"]  # nothing half-written is left


@pytest.mark.slow
def test_a_missing_broken_or_foreign_file_is_an_error_of_ours(completed, tmp_path):
    with pytest.raises(FileError, match="nowhere"):
        mk.SimulationResult.from_netcdf(tmp_path / "nowhere.nc")
    (tmp_path / "text.nc").write_text("no NetCDF at all")
    with pytest.raises(FileError, match="cannot be read as NetCDF"):
        mk.SimulationResult.from_netcdf(tmp_path / "text.nc")
    (tmp_path / "empty.nc").write_bytes(b"")
    with pytest.raises(FileError):
        mk.SimulationResult.from_netcdf(tmp_path / "empty.nc")
    completed.to_netcdf(tmp_path / "run.nc")
    whole = (tmp_path / "run.nc").read_bytes()
    for part in (0.1, 0.5, 0.9):
        (tmp_path / "cut.nc").write_bytes(whole[: int(len(whole) * part)])
        with pytest.raises(FileError):
            mk.SimulationResult.from_netcdf(tmp_path / "cut.nc")
    mk.catalog.dataset("festo-tool-10mm").to_netcdf(tmp_path / "data.nc")
    with pytest.raises(FileError, match=r"lacks angle, .*highest_stiffness"):
        mk.SimulationResult.from_netcdf(tmp_path / "data.nc")


@pytest.mark.parametrize("change", ["unknown outcome", "no band", "a word for the control period"])
def test_a_file_that_is_nearly_a_result_is_an_error_of_ours(completed, tmp_path, change):
    table = completed.to_dataset()
    if change == "unknown outcome":
        table = table.assign_attrs(outcome="SPLENDID")
    elif change == "no band":
        table = table.drop_vars("lowest_stiffness")
    else:
        table = table.assign_attrs(control_period="soon")
    table.to_netcdf(tmp_path / "odd.nc", engine="h5netcdf")
    try:
        mk.SimulationResult.from_netcdf(tmp_path / "odd.nc").metrics["angle_rmse"]
    except FileError:
        return
    raise AssertionError("it was taken for a result")


@pytest.mark.slow
def test_a_run_that_never_was_finite_can_be_described(plant, knee, playback):
    reference = mk.Reference(angle=mk.Constant(0.0), stiffness=mk.Constant(15.0))
    start = PlantState(np.nan, 0.0, (1e5, 1e5))
    with pytest.raises(SimulationError) as caught:
        mk.simulate(plant, playback, reference, duration=0.2, initial=start)
    assert caught.value.field == "initial.position"
    result = run_episode(plant, playback, sampled(reference, 0.2, 1e-3)[1], start, 1e-3, 4)
    assert result.outcome is Outcome.DIVERGED
    assert "diverged" in result.verdict()


def test_a_pressure_outside_the_domain_is_not_silent(plant, knee):
    reference = mk.Reference(angle=mk.Constant(0.0), stiffness=mk.Constant(15.0))
    control = mk.PositionStiffnessControl(POSITION, STIFFNESS, model=knee)
    result = mk.simulate(plant, control, reference, duration=0.2, initial=PlantState(0.0, 0.0, (9 * bar, 9 * bar)))
    assert float(result["pressure1"][0]) > float(eqx.filter(knee, True).muscle1.domain.pressure_max)
    assert result.outcome is Outcome.LEFT_DOMAIN


def test_a_column_as_an_attribute_is_an_error_that_names_the_item(completed):
    with pytest.raises(AttributeError) as caught:
        completed.angle  # noqa: B018
    assert 'result["angle"]' in str(caught.value)
    assert not hasattr(completed, "angel")
    assert {"time", "angle"} <= set(completed._ipython_key_completions_())
