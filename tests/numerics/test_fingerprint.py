"""Names that mean the same in every process, and only what is known has one."""

import collections
import dataclasses
import enum
import functools
import itertools

import jax
import numpy as np
import pytest

from mckibben.actuator import IdealValve
from mckibben.control import PID, Constant, Sine
from mckibben.numerics.program_cache import FingerprintError, code_fingerprint, fingerprint, structure_fingerprint
from mckibben.simulation.outcome import Outcome

VALUES = (
    *(None, True, False, 1, 0, 1.0, 0.0, -0.0, 1e-300, "1", "", b"1", 1j),
    *((1,), [1], {1}, frozenset({1}), (1, 2), (1, (2,)), {"a": 1}, {"a": 1.0}, {"b": 1}, ()),
    *(np.dtype("f4"), np.dtype("f8"), Outcome.COMPLETED, IdealValve, PID, IdealValve(), Constant(1.0), Constant(2.0)),
    *(Sine(1.0, 2.0), Sine(2.0, 1.0), code_fingerprint, fingerprint),
)


def test_different_values_have_different_names():
    names = [fingerprint(value) for value in VALUES]
    for (one, first), (other, second) in itertools.combinations(zip(VALUES, names, strict=True), 2):
        assert first != second, (one, other)


def test_the_order_of_a_set_is_not_in_its_name():
    one, other = {0, 8}, {8, 0}
    assert list(one) != list(other)
    assert fingerprint(one) == fingerprint(other)


class Colour(enum.Enum):
    RED = 1


@dataclasses.dataclass(frozen=True)
class Owned:
    number: float = 1.0


class Plain:
    pass


class Wrong(float):
    pass


Pair = collections.namedtuple("Pair", "a b")


@pytest.mark.parametrize(
    "value",
    [
        *(Colour.RED, Owned(), Owned, Plain(), Wrong(1.0), Pair(1, 2), test_different_values_have_different_names),
        *(lambda: 0, functools.partial(print, 1), [].append, [Plain()], {"a": {"b": Owned}}, np.random.default_rng(1)),
        *(object(), np.add, jax.jit(abs)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_not_known_has_no_name(value):
    with pytest.raises(FingerprintError):
        fingerprint(value)


def test_structures_name_their_classes_in_full():
    text = structure_fingerprint(jax.tree.structure({"a": Constant(1.0), "b": (2.0, None)}))
    assert "mckibben.control.reference.Constant" in text
    assert text != structure_fingerprint(jax.tree.structure({"a": Constant(1.0), "c": (2.0, None)}))
    with pytest.raises(FingerprintError, match="Pair"):
        structure_fingerprint(jax.tree.structure([Pair(1.0, 2.0)]))
