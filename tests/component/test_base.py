"""Checks of the fields of components by their types."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.component.base import Component, field_quantities
from mckibben.errors import RangeError, UnitError
from mckibben.joint import PendulumLoad
from mckibben.muscle import Domain
from mckibben.units import BoundedInt, Length, Mass, Quantity


class Part(Component):
    length: Length


class Whole(Component):
    part: Part
    mass: Mass = 1.0
    spare: Part | None = None
    lengths: tuple[Length, ...] | None = None
    limit: Annotated[float, Quantity("m", "mm", 0, 10)] = np.inf
    count: Annotated[int, BoundedInt(1, 9)] = eqx.field(default=3, static=True)
    side: Literal["left", "right"] = "left"


PART = Part(0.2)


@pytest.mark.parametrize(
    ("fields", "name", "value", "upper"),
    [
        ({"part": 0.2}, "part", 0.2, None),
        ({"spare": "none"}, "spare", "none", None),
        ({"mass": -1.0}, "mass", -1.0, 1e4),
        ({"mass": np.nan}, "mass", np.nan, 1e4),
        ({"mass": True}, "mass", True, None),
        ({"mass": np.array([1.0, 2e4])}, "mass", 2e4, 1e4),
        ({"lengths": (0.1, 20.0)}, "lengths", 20.0, 10.0),
        ({"limit": 5.0}, "limit", 5.0, 0.01),
        ({"count": 10}, "count", 10.0, 9),
        ({"count": 3.0}, "count", 3.0, None),
        ({"count": True}, "count", True, None),
        ({"mass": None}, "mass", None, None),
        ({"side": "up"}, "side", "up", None),
        ({"mass": (1.0, 2.0)}, "mass", (1.0, 2.0), None),
    ],
)
def test_a_field_of_another_type_or_out_of_range_is_refused(fields, name, value, upper):
    with pytest.raises(RangeError, match=f"Whole: {name} is ") as refused:
        Whole(**{"part": PART, **fields})
    assert refused.value.field == name
    np.testing.assert_equal(refused.value.value, value)
    assert refused.value.upper == (upper if upper is None else pytest.approx(upper))


def test_what_is_right_passes_and_so_do_defaults_and_tracers():
    assert Whole(PART, lengths=(0.1, 0.2), spare=PART, limit=np.inf).limit == np.inf
    made = jax.jit(lambda mass: Whole(PART, mass).mass)(-1.0)
    assert float(made) == -1.0
    assert jax.vmap(lambda mass: Whole(PART, mass=mass).mass)(jnp.array([1.0, 2.0])).shape == (2,)


def test_all_that_is_wrong_is_told_at_once():
    with pytest.raises(RangeError, match="2 problems") as refused:
        Whole(PART, mass=-1.0, count=0)
    assert "mass: is -1 kg" in str(refused.value) and "count: is 0" in str(refused.value)
    assert (refused.value.field, refused.value.value) == ("mass", -1.0)


def test_a_check_of_ones_own_does_not_take_the_place_of_it():
    class Heavy(Whole):
        def __check_init__(self) -> None:
            assert self.mass > 1

    assert Heavy(PART, mass=2.0).mass == 2.0
    with pytest.raises(RangeError):
        Heavy(PART, mass=2e4)


def test_a_type_that_is_not_found_leaves_the_checks_of_other_fields():
    class Local(PendulumLoad):
        inner: NotThere = 0  # noqa: F821
        pair: tuple[Mass, Length] = (1.0, 0.3)  # neither holds for both
        extra: Length = None

    assert "pair" not in field_quantities(Local) and "extra" in field_quantities(Local)
    assert Local(2.0, 0.3, pair=(1.0, 300.0)).extra is None
    with pytest.raises(RangeError) as refused:
        Local(-2.0, 0.3)
    assert refused.value.field == "mass"


def test_an_infinite_default_may_be_in_an_array():
    limits = jax.device_put(Domain(pressure_max=6e5))
    assert dataclasses.replace(limits, contraction_max=np.array([0.3, np.inf])).contraction_min == -np.inf
    with pytest.raises(RangeError):
        dataclasses.replace(limits, contraction_max=np.array([30.0, np.inf]))


class Gains(Component):
    stiffness: Annotated[float, Quantity("N*m/rad")]
    ratio: Annotated[float, Quantity("1", "percent")]
    share: Annotated[float, Quantity("1")]


def test_a_text_with_a_unit_is_a_number_in_si_as_in_files():
    assert Gains("3 N*m/rad", ratio="40 %", share="0.5") == Gains(3.0, 0.4, 0.5)
    assert Whole(Part("20 cm"), lengths=["1 m", 0.2]) == Whole(PART, lengths=(1.0, 0.2))
    with pytest.raises(UnitError) as caught:
        Gains("3", ratio=0.4, share=0.5)
    assert caught.value.field == "stiffness" and "'3 N*m/rad'" in caught.value.remedy
