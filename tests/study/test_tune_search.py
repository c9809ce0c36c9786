"""The ways to search, on functions that cost nothing."""

import threading

import numpy as np
import pytest

from mckibben.errors import ParameterError
from mckibben.study.tune.search import Method, by_cma, by_evolution, by_gradient, check_method, side_by_side

GOAL = np.array([0.3, 0.8])


def bowl(points):
    return np.sum((points - GOAL) ** 2 * [1.0, 30.0], axis=1)


def bowl_and_slope(points):
    return bowl(points), 2 * (points - GOAL) * [1.0, 30.0]


def ran_by(method, first, *, seed=0, rounds=40, function=bowl):
    """All points that were asked for, and what was reported."""
    points, said = [], []

    def asked(some):
        points.extend(some.tolist())
        return function(some)

    options = {"seed": seed, "progress": said.append}
    if method is Method.GRADIENT:
        with_slope = lambda some: (asked(some), bowl_and_slope(some)[1])  # noqa: E731
        by_gradient(with_slope, first, starts=3, iterations=rounds, **options)
    else:
        search = by_cma if method is Method.CMA else by_evolution
        search(asked, first, population=8, generations=rounds, **options)
    return np.array(points), said


@pytest.mark.parametrize("method", Method)
def test_each_method_finds_the_bottom_of_a_bowl_within_the_cube(method):
    points, said = ran_by(method, np.array([0.9, 0.1]))
    assert points.min() >= 0.0
    assert points.max() <= 1.0
    np.testing.assert_allclose(points[np.argmin(bowl(points))], GOAL, atol=1e-3)
    assert said == sorted(said)
    assert said[-1] == 1.0


@pytest.mark.parametrize("method", Method)
def test_each_method_tries_the_first_point_and_repeats_itself(method):
    first = np.array([1.0, 0.0])  # a corner
    points, _ = ran_by(method, first, rounds=2, seed=5)
    assert first.tolist() in points.tolist()
    again, _ = ran_by(method, first, rounds=2, seed=5)
    assert again.tolist() == points.tolist()
    other, _ = ran_by(method, first, rounds=2, seed=6)
    assert other.tolist() != points.tolist()


@pytest.mark.parametrize("method", [Method.EVOLUTION, Method.CMA])
def test_more_rounds_begin_with_the_same_points(method):
    few, _ = ran_by(method, GOAL, rounds=2)
    many, _ = ran_by(method, GOAL, rounds=5)
    assert len(few) < len(many)
    assert many[: len(few)].tolist() == few.tolist()


@pytest.mark.parametrize("method", Method)
def test_where_all_costs_the_same_the_search_ends_all_the_same(method):
    _, said = ran_by(method, GOAL, rounds=3, function=lambda points: np.ones(len(points)))
    assert said[-1] == 1.0


def test_what_a_method_cannot_do_is_said():
    check_method(Method.EVOLUTION, numbers=1, population=5)
    check_method(Method.CMA, numbers=2, population=4)
    check_method(Method.GRADIENT, numbers=1, population=1)
    with pytest.raises(ParameterError, match=r"at least two parameters.*use gradient or evolution"):
        check_method(Method.CMA, numbers=1, population=8)
    with pytest.raises(ParameterError, match="cma with 3 points per generation; give at least 4"):
        check_method(Method.CMA, numbers=2, population=3)
    with pytest.raises(ParameterError, match="evolution with 4 points per generation; give at least 5"):
        check_method(Method.EVOLUTION, numbers=2, population=4)
    check_method(Method.EVOLUTION, numbers=2, population=5)


class Failure(BaseException):
    """Not even an Exception."""


def asking(times, got):
    """A search that asks so often, and remembers the answers."""

    def search(ask):
        for i in range(times):
            got.append(ask(np.array([float(times), float(i)])))

    return search


def left():
    return [thread for thread in threading.enumerate() if thread is not threading.main_thread()]


def test_searches_of_different_lengths_get_their_own_answers_together():
    batches, got = [], [[], [], [], []]

    def function(points):
        batches.append(len(points))
        return points[:, 0] * 100 + points[:, 1], points + 0.5

    side_by_side(function, [asking(times, mine) for times, mine in zip((3, 1, 0, 5), got, strict=True)])
    assert batches == [3, 2, 2, 1, 1]
    for times, mine in zip((3, 1, 0, 5), got, strict=True):
        assert [cost for cost, _ in mine] == [100.0 * times + i for i in range(times)]
        assert [slope.tolist() for _, slope in mine] == [[times + 0.5, i + 0.5] for i in range(times)]


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), Failure()])
def test_what_the_function_raises_ends_all_searches(error):
    before, calls, got = left(), [], []

    def function(points):
        calls.append(len(points))
        if len(calls) == 3:
            raise error
        return points[:, 0], points

    with pytest.raises(type(error)) as raised:
        side_by_side(function, [asking(100, got), asking(2, got), asking(100, got)])
    assert raised.value is error
    assert calls == [3, 3, 2]
    assert left() == before


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), Failure()])
def test_what_a_search_raises_ends_the_others_too(error):
    before, calls, got = left(), [], []

    def failing(ask):
        ask(np.zeros(2))
        raise error

    def function(points):
        calls.append(len(points))
        return points[:, 0], points

    with pytest.raises(type(error)) as raised:
        side_by_side(function, [asking(10_000, got), failing, asking(10_000, got)])
    assert raised.value is error
    assert len(calls) < 5
    assert left() == before


def test_an_interruption_while_waiting_for_searches_ends_them(monkeypatch):
    """The main thread is interrupted wherever it is; mostly it waits."""
    before, waits, got = left(), [], []
    wait_for = threading.Condition.wait_for

    def interrupted(condition, predicate, timeout=None):
        if threading.current_thread() is threading.main_thread() and predicate() is not True:
            waits.append(1)
            if len(waits) == 1:
                raise KeyboardInterrupt
        return wait_for(condition, predicate, timeout)

    gate = threading.Event()

    def late(ask):
        gate.wait(0.2)  # so that somebody is waited for
        ask(np.zeros(2))

    monkeypatch.setattr(threading.Condition, "wait_for", interrupted)
    with pytest.raises(KeyboardInterrupt):
        side_by_side(lambda points: (points[:, 0], points), [asking(3, got), late])
    assert waits
    assert left() == before
