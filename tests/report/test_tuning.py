"""The figure of a search: drawn for whatever a search may have been."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from mckibben.report import tuning
from mckibben.study.tune import Trial, TuneResult
from mckibben.study.tune.objective import FAILED_COST


def searched(numbers, trials=40, *, lost=0, before=30.0, seed=0, named="controller.position.gain"):
    """What a search of so many numbers leaves, the first trials lost."""
    rng = np.random.default_rng(seed)
    points = rng.random((trials, numbers))
    costs = np.where(np.arange(trials) < lost, FAILED_COST, rng.uniform(1, 100, trials))
    tried = tuple(Trial(tuple(p), float(c)) for p, c in zip(points.tolist(), costs, strict=True))
    values = {f"{named}{i}": 1.0 for i in range(numbers)}
    return TuneResult(values, (), (), float(costs.min()), before, trials, trials=tried)


def drawn(tuned):
    figure = tuning(tuned)
    assert isinstance(figure, Figure)
    return figure, *figure.axes


def line(axes, label):
    return next(each for each in axes.lines if each.get_label() == label)


@pytest.mark.parametrize("numbers", [1, 12, 60])
def test_one_row_a_number_with_its_best_place(numbers):
    tuned = searched(numbers)
    _, _, places = drawn(tuned)
    best = min(tuned.trials, key=lambda trial: trial.cost)
    (diamonds,) = [each for each in places.lines if each.get_marker() == "D"]
    assert tuple(diamonds.get_xdata()) == best.point
    assert list(diamonds.get_ydata()) == list(range(numbers))[::-1]
    names = [label.get_text() for label in places.get_yticklabels()]
    assert names == ([f"position.gain{i}" for i in range(numbers)] if numbers <= 12 else [""] * numbers)


@pytest.mark.parametrize("lost", [0, 39])
def test_what_was_lost_is_counted_and_not_drawn(lost):
    tuned = searched(3, lost=lost)
    _, costs, _ = drawn(tuned)
    points, best = line(costs, "point"), line(costs, "lowest so far")
    assert len(points.get_xdata()) == 40 - lost
    assert points.get_xdata()[0] == lost + 1
    assert np.isnan(best.get_ydata()[:lost]).all()
    kept = [trial.cost for trial in tuned.trials][lost:]
    np.testing.assert_array_equal(best.get_ydata()[lost:], np.minimum.accumulate(kept))
    assert costs.get_xlabel() == (
        f"evaluated points; {lost} not drawn: invalid or unstable" if lost else "evaluated points"
    )
