import math

import numpy as np
import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.errors import UnitError
from mckibben.units import UNITS, Percent, Quantity, factor, justified, quantity, show


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("6 bar", "Pa", 6e5),
        ("1 psi", "Pa", 6894.757293168361),
        ("25 deg", "rad", 25 * math.pi / 180),
        ("25 °", "rad", 25 * math.pi / 180),
        ("0.05 dm^3/(s*bar)", "m^3/(s*Pa)", 5e-10),
        ("0.5 Hz", "1/s", 0.5),
        ("-3 %", "1", -0.03),
        ("0.25", "1", 0.25),
        ("6bar", "Pa", 6e5),
        ("  +6.0e0\tbar \n", "Pa", 6e5),
        (".5 m", "m", 0.5),
        ("13 N*m/deg", "N*m/rad", 13 * 180 / math.pi),
        ("-3.442 N/(bar*percent)", "N/Pa", -3.442e-3),
        ("0.3 /percent", "1", 30.0),
        ("0.02 kg*m**2", "kg*m^2", 0.02),
        ("2 kg*m*s^-2", "N", 2.0),
    ],
)
def test_a_number_and_a_unit_is_read_to_si(text, unit, expected):
    assert quantity(text, unit) == pytest.approx(expected, rel=1e-14)


# Without a unit, no plain number, more than one of them, and units that are none here.
REFUSED = """|m|5|4,5 m|1_000 mm|9**9**9 m|-1e400 m|1e308 kN*m/N*m/mm|nan m|0x10 m|5 m 5|5 m//s*s|5 m/1|5 m^0|\
5 m; import os|5 µm|٥ m|5 Mm|5 km"""


@pytest.mark.parametrize("text", REFUSED.split("|"))
def test_anything_else_is_refused_with_a_unit_error(text):
    with pytest.raises(UnitError):
        quantity(text, "m")


@pytest.mark.parametrize(
    ("text", "unit"), [("13 N*m", "N*m/rad"), ("3 deg", "1"), ("3", "rad"), ("6 kg", "N"), ("2 rad/s", "Hz")]
)
def test_a_unit_of_another_kind_is_refused_and_both_kinds_are_named(text, unit):
    with pytest.raises(UnitError) as caught:
        quantity(text, unit)
    assert unit in str(caught.value)
    assert caught.value.unit == unit


def test_megamolar_is_no_millimetre_and_the_known_units_are_listed():
    with pytest.raises(UnitError, match=r"unknown unit 'MM'.*\bmm\b"):
        quantity("180 MM", "m")


_SHOWN = ["Pa", "kPa", "bar", "psi", "m", "mm", "deg", "%", "ratio", "N*m/rad", "N/(bar*percent)", "1/percent", "ms"]


@given(st.floats(-1e9, 1e9, allow_subnormal=False), st.sampled_from(_SHOWN))
def test_showing_and_reading_back_changes_nothing(value, unit):
    kind = {"psi": "Pa", "mm": "m", "deg": "rad", "%": "1", "ratio": "1", "ms": "s"}.get(unit, unit)
    back = quantity(show(value, unit, digits=17), kind) * factor(kind)
    assert back == pytest.approx(value, rel=1e-14, abs=1e-300)


REGISTRY = pint.UnitRegistry()


@pytest.mark.parametrize(
    "unit", [*UNITS, "N*m/rad", "bar*s/rad", "kg*m^2", "bar/(N*m*s/rad)", "N/(bar*percent)", "m/s^2"]
)
def test_every_unit_is_as_large_as_pint_has_it(unit):
    theirs = REGISTRY.parse_expression(unit.replace("percent", "(0.01)").replace("ratio", "(1.0)"))
    size = theirs.to_base_units().magnitude if hasattr(theirs, "to_base_units") else theirs
    assert factor(unit) == pytest.approx(float(size), rel=1e-12)


@pytest.mark.parametrize("mark", [Quantity("N/Pa", "N/bar", -1e6, 1e6), Quantity("rad", "deg"), Percent("1", "%")])
def test_every_float_is_written_in_the_unit_shown(mark):
    """Also those that are no float times the factor of the unit."""
    rng = np.random.default_rng(0)
    for value in (rng.standard_normal(2000) * 10.0 ** rng.integers(-9, 3, 2000)).tolist():
        text = mark.write(value)
        assert text.endswith(f" {mark.shown}")
        assert quantity(text, mark.unit) == value


@given(st.floats(1e-3, 1e3), st.floats(1e-6, 1e2))
def test_digits_that_an_error_justifies_move_a_quantity_by_little(value, error):
    moved = abs(quantity(justified(f"{value!r} mm", error * 1e-3), "m") - value * 1e-3)
    assert moved <= (0.0501 * min(error, value) + 1e-12 * value) * 1e-3
    assert quantity(justified(f"{value!r} mm"), "m") == pytest.approx(value * 1e-3, rel=1e-5)
    assert justified("0 N", error) == "0 N"
