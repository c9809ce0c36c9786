"""What is drawn: shares, ranges, the same runs for the same seed; and a run of the arrays is that of its scenario."""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

from mckibben.errors import SimulationError
from mckibben.plant import PerfectSensors
from mckibben.scenario import Scenario
from mckibben.study.compare import NOMINAL_JOINT, Suite, draw
from mckibben.units import deg, ms

TEXT = (Path(__file__).parents[1] / "small-suite.yaml").read_text(encoding="utf-8")
TIMES = np.arange(60) * 2 * ms


@pytest.fixture(scope="module")
def suite():
    return Suite.parse(TEXT)


@pytest.fixture(scope="module")
def runs(suite):
    return draw(suite, 64, 1)


def lane(tree, run):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[run] if np.ndim(leaf) else leaf, tree)


def counted(names):
    return {name: names.count(name) for name in dict.fromkeys(sorted(names))}


@pytest.mark.slow
def test_joints_and_references_come_in_their_shares(suite, runs):
    assert counted(runs.joint) == {NOMINAL_JOINT: 48, "longer": 16}  # 3 to 1
    assert counted(runs.reference_name) == {"angle step": 16, "both move": 16, "sine and step": 32}  # 1 to 1 to 2
    few = draw(suite, 6, 1)
    assert counted(few.joint) == {NOMINAL_JOINT: 5, "longer": 1}
    assert counted(few.reference_name) == {"angle step": 1, "both move": 1, "sine and step": 4}
    assert runs.count == 64
    assert len(set(zip(runs.joint, runs.reference_name, strict=True))) == 6, "one does not follow from the other"


def test_conditions_fill_their_ranges(runs):
    found = runs.conditions
    assert list(found)[:-1] == [
        "load.mass2",
        "valve.time_constant",
        "sensors.delay",
        "disturbance.height",
    ]
    for name, low, high in (("load.mass2", 0.25, 0.75), ("valve.time_constant", 0.01, 0.05)):
        cells = np.floor((found[name] - low) / (high - low) * 64)
        assert sorted(cells) == list(range(64)), "a Sobol sequence has one point in each 64th"
    assert counted(found["sensors.delay"].tolist()) == {0.0: 32, 1.0: 32}
    assert counted(found["disturbance.height"].tolist()) == {0.0: 32, 0.5: 32}


def test_fast_sines_are_made_smaller(suite, runs):
    sine = runs.reference_values["sine and step"]
    amplitude, frequency = sine["reference.angle.amplitude"], sine["reference.angle.frequency"]
    max_angular_acceleration = amplitude * (2 * np.pi * frequency) ** 2
    assert max_angular_acceleration.max() == pytest.approx(60.0)
    cut = max_angular_acceleration > 60.0 * (1 - 1e-9)
    assert 0 < cut.sum() < 16
    assert np.all(amplitude[~cut] >= 2 * deg)
    free = draw(suite.model_copy(update={"max_angular_acceleration": None}), 64, 1).reference_values["sine and step"]
    assert np.array_equal(free["reference.angle.frequency"], frequency)
    assert np.array_equal(free["reference.angle.amplitude"][~cut], amplitude[~cut])
    assert np.all(free["reference.angle.amplitude"][cut] > amplitude[cut])


def test_the_same_seed_draws_the_same(suite, runs):
    again, other = draw(suite, 64, 1), draw(suite, 64, 2)
    assert again.joint == runs.joint
    assert again.reference_name == runs.reference_name
    for mine, same in zip(*(jax.tree.leaves(each.groups[0].plant) for each in (runs, again)), strict=True):
        assert np.array_equal(mine, same)
    assert other.reference_name != runs.reference_name
    assert not np.array_equal(other.conditions["load.mass2"], runs.conditions["load.mass2"])


def test_each_run_has_noise_of_its_own(suite, runs):
    seeds = runs.conditions["sensors.seed"]
    assert len(set(seeds.tolist())) == 64
    assert not set(seeds.tolist()) & set(draw(suite, 64, suite.tuning.seed).conditions["sensors.seed"].tolist())
    assert (
        "sensors.seed"
        not in draw(suite.model_copy(update={"sensors": PerfectSensors(), "conditions": ()}), 8, 1).conditions
    )
    given = suite.model_copy(update={"conditions": ("sensors.seed=7, 8",)})
    assert set(draw(given, 8, 1).conditions["sensors.seed"].tolist()) == {7, 8}


@pytest.mark.slow
def test_a_run_of_the_arrays_is_that_of_its_scenario(runs):
    """Every leaf of the plant, and the references at all times; the scenario is written down and read again."""
    for run in range(0, 64, 5):
        scenario = Scenario.parse(runs.scenario("PID 3", run).dumps())
        plant = scenario.plant()
        group = next(group for group in runs.groups if run in group.rows)
        row = int(np.searchsorted(group.rows, run))
        drawn = lane(group.plant, row)
        assert jax.tree.structure(plant) == jax.tree.structure(drawn)
        for a, b in zip(jax.tree.leaves(plant), jax.tree.leaves(drawn), strict=True):
            assert np.asarray(a) == pytest.approx(np.asarray(b), rel=1e-14)
        reference, expected = scenario.reference(), group.reference
        for quantity in ("angle", "stiffness"):
            wanted = np.asarray(getattr(reference, quantity)(TIMES))
            assert wanted == pytest.approx(np.asarray(getattr(expected, quantity).values[row]), rel=1e-13, abs=1e-15)
        assert scenario.start.angle == pytest.approx(float(reference.angle(0.0)), abs=1e-15)


@pytest.mark.slow
def test_any_signal_is_a_reference(tmp_path):
    """Each run has what its scenario says: other random steps for another seed, ramps, samples, single sines."""
    (tmp_path / "recorded.csv").write_text("time_s,angle_deg\n0,1\n0.05,3\n0.1,-2\n")
    text = TEXT[: TEXT.index("references:")] + TEXT[TEXT.index("max_angular_acceleration") :]
    text = re.sub(r"other_joints:\n(  .*\n)+", "", text)
    text += """
references:
  random:
    reference:
      angle: {class: random_steps, low: -8 deg, high: 8 deg, dwell: 10 ms, longest_dwell: 30 ms}
      stiffness: {class: ramp, before: 14 N*m/rad, after: 16 N*m/rad, start: 20 ms, duration: 40 ms}
    over: [reference.angle.seed=0..9999, reference.stiffness.duration=10..80 ms]
  recorded:
    reference: {angle: {class: samples_file, file: recorded.csv}, stiffness: 15 N*m/rad}
  sines:
    reference:
      angle: {class: multisine, amplitudes: [3 deg, 1 deg], frequencies: [2 Hz, 5 Hz]}
      stiffness: 15 N*m/rad
    over: [reference.angle.amplitudes.0=1..3 deg]
"""
    drawn = draw(Suite.parse(text, folder=tmp_path), 12, 1)
    (group,) = drawn.groups
    for run in range(drawn.count):
        reference = drawn.scenario("PID 3", run).reference()
        np.testing.assert_allclose(group.reference.angle.values[run], reference.angle(TIMES), rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(group.reference.stiffness.values[run], reference.stiffness(TIMES), rtol=1e-13)
    random = [
        np.asarray(group.reference.angle.values[row])
        for row in np.flatnonzero(np.array(drawn.reference_name) == "random")
    ]
    assert len({values.tobytes() for values in random}) == len(random) == 4


def test_a_frequency_that_no_control_period_resolves_is_refused():
    with pytest.raises(SimulationError) as caught:
        draw(Suite.parse(TEXT.replace("frequencies: [2 Hz, 5 Hz]", "frequencies: [2 Hz, 250 Hz]")), 8, 1)
    assert caught.value.upper == pytest.approx(250.0)


OTHER_PLANTS = """other_joints:
  other law:
    joint:
      geometry: {from: knee-table-2, connector_length: 208 mm}
      muscle: {specimen: MAS-10-180N-AA-MC-O, law: chou}
  flow valves: {valve: {class: FlowValve, conductance: 0.4 L/(s*bar), supply: 5 bar}}
"""


@pytest.fixture(scope="module")
def mixed():
    """A suite whose plants are of three kinds."""
    start, end = TEXT.index("other_joints:"), TEXT.index("load: knee")
    return Suite.parse(TEXT[:start] + OTHER_PLANTS + TEXT[end:].replace("substeps: 1", "substeps: 8"))


@pytest.mark.slow
def test_plants_of_other_kinds_are_groups_of_their_own(mixed):
    drawn = draw(mixed, 20, 1)
    assert [group.joint for group in drawn.groups] == list(dict.fromkeys(drawn.joint))
    assert np.array_equal(np.sort(np.concatenate([group.rows for group in drawn.groups])), np.arange(20))
    for group in drawn.groups:
        for i, row in enumerate(group.rows):
            plant = drawn.scenario("PID 3", int(row)).plant()
            assert jax.tree.structure(plant) == jax.tree.structure(group.plant)
            for a, b in zip(jax.tree.leaves(plant), jax.tree.leaves(lane(group.plant, i)), strict=True):
                assert np.asarray(a) == pytest.approx(np.asarray(b), rel=1e-14)


def test_a_plant_needs_as_many_substeps_as_its_valve(mixed):
    few = mixed.model_copy(update={"substeps": 1})
    with pytest.raises(SimulationError) as caught:
        draw(few, 20, 1)
    assert caught.value.field == "substeps" and 1 < caught.value.lower <= 8
