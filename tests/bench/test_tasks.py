"""Fixed splits, scores of perfect and of poor submissions, and no way to the test data."""

import dataclasses
import functools

import numpy as np
import pytest

from mckibben.bench import KINDS, TASKS, DataBlock, Task, Training, compare_submissions, recurrent, task_named
from mckibben.bench.baselines import BASELINES
from mckibben.bench.foreign import ForeignMuscle
from mckibben.bench.submission import predictions
from mckibben.bench.tasks import JOINT, SOFT
from mckibben.errors import ParameterError

DIGESTS = {
    "map-dmsp-10": "0b11e34224112a59",
    "map-dmsp-20": "29e7822fc9337528",
    "map-wall": "ac6ababdcd6ebb86",
    "map-four-lengths": "b04cc29af4c5a42a",
    "hysteresis": "2f1ed8d6b057c263",
    "isometric": "6aa64090c3a8bc59",
    "transfer": "bd652ce27442a9cb",
    "joint": "a7191cd9c0f2afcf",
}
task_of = functools.cache(task_named)  # recordings are simulated in seconds, and cannot be changed
QUICK = ("map-dmsp-10", "map-dmsp-20", "map-wall", "map-four-lengths", "transfer")


@pytest.fixture(scope="module")
def map_task() -> Task:
    return task_named("map-wall")


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in TASKS]
)
def test_a_split_is_fixed(name):
    task = task_of(name)
    assert task.digest() == DIGESTS[name]
    assert task.source
    assert {one.name for one in task.training.blocks}.isdisjoint(one.name for one in task.tests)
    trained = {row.tobytes() for one in task.training.blocks for row in one.inputs}
    if task.training.period is None:  # recordings may pass through the same point
        assert trained.isdisjoint(row.tobytes() for one in task.tests for row in one.inputs)


def test_every_kind_has_a_task():
    assert {"map", "hysteresis", "isometric", "transfer", "joint"} == set(KINDS)
    assert len(TASKS) >= len(KINDS)


def test_a_perfect_submission_of_a_map_has_no_error(map_task):
    found = predictions(lambda training: lambda new: SOFT.static_force(new[:, 0], new[:, 1]), map_task)
    assert map_task.score(found).nrmse == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hysteresis", "isometric"])
def test_a_perfect_submission_of_a_recording_has_no_error(name):
    whole, muscle = task_of(name), ForeignMuscle()
    task = dataclasses.replace(whole, tests=tuple(sorted(whole.tests, key=lambda one: one.output.size)[:2]))
    found = predictions(lambda training: lambda new: muscle.force(training.period, new[:, 0], new[:, 1]), task)
    assert task.score(found).nrmse.value < 1e-12
    known = min(task.training.blocks, key=lambda one: one.output.size)
    noise = muscle.force(task.training.period, *known.inputs.T) - known.output
    assert noise.std() == pytest.approx(0.5, rel=0.05)  # N: training data have noise, test data do not


@pytest.mark.slow
def test_a_perfect_submission_of_the_joint_has_no_error():
    task = task_of("joint")
    found = predictions(lambda training: lambda new: JOINT.angles(training.period, new[:, 0], new[:, 1]), task)
    assert task.score(found).nrmse.value < 1e-9


def test_a_submission_sees_no_output_of_the_test(map_task):
    seen = []

    def fit(training):
        seen.append(training)

        def predict(inputs):
            seen.append(inputs)
            return np.zeros(len(inputs))

        return predict

    predictions(fit, map_task)
    hidden = {value for one in map_task.tests for value in one.output.tolist() if value}
    training, *given = seen
    assert not hidden & set(np.concatenate([one.ravel() for one in given]).tolist())
    assert not hidden & set(training.stacked[1].tolist())
    assert "tests" not in {one.name for one in dataclasses.fields(training)}


def test_a_digest_covers_inputs_and_outputs(map_task):
    first, *others = map_task.tests
    changed = first.output.copy()
    changed[0] *= 1.01
    swapped = first.output.copy()
    swapped[[0, -1]] = swapped[[-1, 0]]
    blocks = (DataBlock.of(first.name, first.inputs, one) for one in (changed, swapped))
    altered = [dataclasses.replace(map_task, tests=(block, *others)) for block in blocks]
    assert len({one.digest() for one in (map_task, *altered)}) == 3


def test_a_submission_cannot_change_the_data(map_task):
    before = map_task.digest()

    def fit(training):
        with pytest.raises(ValueError):
            training.blocks[0].output[:] = 0
        with pytest.raises(TypeError):
            training.facts["initial_length"] = 1.0

        def predict(inputs):
            inputs[:] = 0  # a copy
            return inputs[:, 0]

        return predict

    predictions(fit, map_task)
    assert map_task.digest() == before


def test_the_mean_scores_one(map_task):
    outputs = np.concatenate([one.output for one in map_task.tests])
    score = map_task.score({one.name: np.full(one.output.size, outputs.mean()) for one in map_task.tests})
    assert score.nrmse.value == pytest.approx(1.0)
    assert score.nrmse.lower < 1.0 < score.nrmse.upper
    assert score.relative_to(score) == (1.0, 1.0, 1.0)


def test_the_interval_holds_the_true_error():
    """Blocks whose errors scatter: the 95 % interval of the RMSE holds that of many more blocks."""
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(200):
        blocks = tuple(
            DataBlock.of(str(i), np.zeros((20, 2)), rng.normal(0, scale, 20))
            for i, scale in enumerate(rng.uniform(0.5, 1.5, 20))
        )
        training = Training("a", "map", (DataBlock.of("known", np.zeros((1, 2)), np.zeros(1)),))
        task = Task(training, blocks)
        score = task.score({one.name: np.zeros(20) for one in blocks})
        low, high = (end * score.scale for end in score.nrmse[1:])
        held += low < np.sqrt(1 + 1 / 12) < high
    assert 0.85 < held / 200 < 0.99


def test_what_our_laws_do_badly_on_is_in_the_tasks():
    """A plain Gaussian process beats Eq. 2 on a measured map, and where threads stretch and the bladder is stiff."""
    table = compare_submissions([task_named("map-dmsp-10"), task_named("map-wall")], baselines=("eq2", "gp"))
    error = {(one.task, one.method): one.score.nrmse.value for one in table.entries}
    assert error["map-dmsp-10", "gp"] < 0.7 * error["map-dmsp-10", "eq2"]
    assert error["map-wall", "gp"] < error["map-wall", "eq2"]
    assert error["map-wall", "eq2"] > 0.025  # of test data without noise


def test_baselines_name_what_they_cannot_do(map_task):
    table = compare_submissions([map_task], baselines=("gru",))
    assert table.entries[0].score is None and table.entries[0].reason
    assert table.rows()[0][2] == "-"


@pytest.mark.slow
def test_friction_is_identified_along_the_recorded_paths():
    task = task_of("hysteresis")
    assert task.score(predictions(BASELINES["friction"], task)).nrmse.value < 0.06


@pytest.mark.slow
def test_the_network_learns_a_recording(optimized, monkeypatch):
    """A quarter of the steps, and tests of two lengths, each of which is a program: the mean has an error of 1."""
    monkeypatch.setattr(recurrent, "_STEPS", 400)
    whole = task_of("isometric")
    task = dataclasses.replace(whole, tests=(whole.tests[0], whole.tests[3]))
    found = predictions(BASELINES["gru"], task)
    assert task.score(found).nrmse.value < 0.15


@pytest.mark.slow
def test_the_joint_is_calibrated_from_its_commands(optimized):
    """From steps and a multisine: the other recordings are of steps, too."""
    whole = task_of("joint")
    blocks = whole.training.blocks[0], whole.training.blocks[3]
    task = dataclasses.replace(whole, training=dataclasses.replace(whole.training, blocks=blocks))
    assert task.score(predictions(BASELINES["eq2"], task)).nrmse.value < 0.4


@pytest.mark.parametrize("inputs, output", [(np.zeros(3), np.zeros(3)), (np.zeros((3, 2)), np.zeros(2))])
def test_blocks_of_wrong_shape_are_refused(inputs, output):
    with pytest.raises(ParameterError) as error:
        DataBlock.of("rows", inputs, output)
    assert error.value.field == "rows"


def test_tests_without_a_score_are_refused():
    training = Training("a", "map", (DataBlock.of("known", np.zeros((1, 2)), np.zeros(1)),))
    for names, outputs in ((("x", "x"), (0.0, 1.0)), (("x", "y"), (1.0, 1.0))):
        blocks = tuple(
            DataBlock.of(*one) for one in zip(names, np.zeros((2, 1, 2)), np.array(outputs)[:, None], strict=True)
        )
        with pytest.raises(ParameterError):
            Task(training, blocks)


def test_unknown_tasks_and_kinds_are_refused():
    with pytest.raises(ParameterError) as error:
        task_named("map-wal")
    assert "map-wall" in error.value.remedy
    with pytest.raises(ParameterError) as error:
        Training("a", "chart", ())
    assert error.value.value == "chart"
