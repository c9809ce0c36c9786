"""Lanes: which leaves vary, how they are named, and that pieces of work are done in order and a few at a time."""

import threading
import time
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.component.checks import check_positive
from mckibben.errors import ParameterError, RangeError
from mckibben.numerics.batching import (
    RANK,
    lanes_of,
    map_chunks,
    named_leaves,
    recheck,
    replace_leaves,
    select_leaves,
    with_leaves,
)


class Inner(eqx.Module):
    size: float
    count: int = 3
    samples: object = eqx.field(default=None, metadata={RANK: 1})
    name: str = eqx.field(static=True, default="inner")

    def __check_init__(self) -> None:
        check_positive("Inner", "m", size=self.size)


class Outer(eqx.Module):
    first: Inner
    several: tuple = ()


class Pair(NamedTuple):
    left: object
    right: object


def outer(size=1.0, **more) -> Outer:
    return Outer(Inner(size, **more), (2.0, Inner(3.0)))


# Which leaves vary


def test_leaves_with_one_more_axis_vary():
    tree = Pair(outer(np.arange(1.0, 5), count=np.arange(4)), 2.0)
    count, varying = lanes_of(tree)
    assert count == 4
    assert (varying.left.first.size, varying.left.first.count, varying.right) == (True, True, False)
    lanes, shared = eqx.partition(tree, varying)
    assert lanes.right is None
    assert shared.left.first.size is None
    assert shared.right == 2.0


def test_samples_are_an_array_by_nature():
    assert lanes_of(outer(samples=np.zeros(7)))[0] is None
    count, varying = lanes_of(outer(samples=np.zeros((2, 7))))
    assert count == 2
    assert varying.first.samples is True
    with pytest.raises(ParameterError, match=r"first.samples has the shape \(2, 3, 7\)"):
        lanes_of(outer(samples=np.zeros((2, 3, 7))))


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (Pair(outer(np.ones(2)), np.ones(3)), "right has 3 values, left.first.size has 2"),
        (outer(np.ones((2, 2))), r"first.size has the shape \(2, 2\)"),
        (outer(np.ones(0)), "first.size is empty"),
    ],
)
def test_shapes_that_do_not_fit_are_named(tree, message):
    with pytest.raises(ParameterError, match=f"^{message}"):
        lanes_of(tree)


# Names


def test_values_by_name_come_where_they_belong_and_nowhere_else():
    before = {"a": outer(), "b": Pair(1.0, 2.0)}
    after = with_leaves(before, {"a.several.1.size": [5.0, 6.0], "b.right": 7, "a.several.0": [8.0]})
    expected = named_leaves(before) | {"b.right": 7}
    found = named_leaves(after)
    np.testing.assert_array_equal(found.pop("a.several.1.size"), [5.0, 6.0])
    np.testing.assert_array_equal(found.pop("a.several.0"), [8.0])
    assert found == {name: expected[name] for name in found}
    assert named_leaves(before)["a.several.1.size"] == 3.0


def test_whole_numbers_are_floats_where_a_float_stood():
    after = named_leaves(with_leaves({"a": outer()}, {"a.first.size": [1, 2], "a.first.count": [1, 2]}))
    assert after["a.first.size"].dtype == np.float64
    assert after["a.first.count"].dtype == np.int64


@pytest.mark.parametrize(
    "bad",
    ["0.4", ["0.4", "0.5"], [1j], [True, False], True, None, [None], [[1.0], [1.0, 2.0]], {"a": 1}, [10**30], object()],
    ids=lambda value: type(value).__name__,
)
@pytest.mark.parametrize("leaf", ["size", "count"])
def test_values_that_are_no_numbers_are_refused(bad, leaf):
    with pytest.raises(ParameterError, match=rf"a\.first\.{leaf}") as caught:
        with_leaves({"a": outer()}, {f"a.first.{leaf}": bad})
    assert caught.value.value is bad


class Seeded(eqx.Module):
    seed: "int | Int[Array, '']" = 0  # noqa: F821


@pytest.mark.parametrize("bad", [0.5, [1.0, 2.0], [np.nan], jnp.ones(2)], ids=repr)
def test_a_whole_number_by_nature_takes_no_float(bad):
    for tree, name in ((outer(), "a.first.count"), (Seeded(), "a.seed")):
        with pytest.raises(ParameterError, match=f"^{name} is an integer"):
            with_leaves({"a": tree}, {name: bad})


def test_a_float_that_was_written_without_a_point_takes_floats():
    after = named_leaves(with_leaves({"a": outer(2), "b": Pair(1, 2)}, {"a.first.size": [0.5], "b.left": [0.5]}))
    assert (after["a.first.size"].tolist(), after["b.left"].tolist()) == ([0.5], [0.5])


def test_a_name_that_does_not_exist_is_told_with_the_nearest():
    with pytest.raises(ParameterError, match=r"no parameter 'a.first.sise'; did you mean 'a.first.size'\?") as caught:
        select_leaves({"a": outer()}, ["a.first.count", "a.first.sise"])
    assert caught.value.value == "a.first.sise"
    with pytest.raises(ParameterError, match=r"there are a\.first\.size, a\.first\.count, a\.several\.0"):
        with_leaves({"a": outer()}, {"zzzzzzzzzzzzzzzz": 1.0})
    with pytest.raises(ParameterError, match=r"no parameter 'a\.first'"):
        with_leaves({"a": outer()}, {"a.first": 1.0})


# Checks


@pytest.mark.parametrize("name", ["a.first.size", "a.several.1.size"])
@pytest.mark.parametrize("bad", [-1.0, 0.0, np.nan])
def test_numbers_are_checked_again_at_any_depth(name, bad):
    with pytest.raises(RangeError, match="Inner: size is"):
        with_leaves({"a": outer()}, {name: [1.0, bad]})
    wrong = replace_leaves({"a": outer()}, {name: np.array([1.0, bad])})
    with pytest.raises(RangeError, match="Inner: size is"):
        recheck(Pair(1.0, wrong))
    recheck(with_leaves({"a": outer()}, {name: [1.0, 2.0]}))


# Types


# Pieces


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize(("count", "size"), [(1, 1), (7, 3), (9, 3), (10, 100), (40, 1)])
def test_answers_come_in_order_and_cover_all(count, size, workers):
    def slower_first(piece):
        time.sleep(0.002 * (count - piece.start) / count)
        return list(range(count))[piece]

    got = list(map_chunks(slower_first, count, size, workers))
    assert [lane for piece, answer in got for lane in answer] == list(range(count))
    assert all(answer == list(range(count))[piece] for piece, answer in got)
    assert {piece.stop - piece.start for piece, _ in got[:-1]} <= {size}


class Watch:
    """Counts calls that have begun and answers that are alive."""

    def __init__(self):
        self.lock = threading.Lock()
        self.begun = self.running = self.most = 0

    def __call__(self, piece):
        with self.lock:
            self.begun += 1
            self.running += 1
            self.most = max(self.most, self.running)
        time.sleep(0.001)
        with self.lock:
            self.running -= 1
        return piece.start


def test_an_error_in_a_piece_is_raised_and_stops_the_rest():
    watch = Watch()

    def call(piece):
        if piece.start == 5:
            raise ZeroDivisionError("piece 5")
        return watch(piece)

    got = []
    with pytest.raises(ZeroDivisionError, match="piece 5"):
        got.extend(start for _, start in map_chunks(call, 1000, 1, 2))
    assert watch.begun <= 5 + 4
    assert watch.running == 0


def test_a_name_of_files_for_several_parts_sets_them_all(plant):
    after = with_leaves({"plant": plant}, {"joint.muscle.specimen.rated_force": [500.0, 600.0], "load.mass2": 0.4})
    for name in ("joint.muscle1.specimen.rated_force", "joint.muscle2.specimen.rated_force"):
        np.testing.assert_array_equal(named_leaves(after)[name], [500.0, 600.0])
    assert named_leaves(after)["load.mass2"] == 0.4
