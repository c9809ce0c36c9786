"""Columns of results: each is declared once, with its unit and meaning."""

from typing import Annotated, NamedTuple

import pytest

from mckibben.component.columns import Label, attributes, declare, labelled, labels_of
from mckibben.control import Controller
from mckibben.errors import ParameterError


def test_the_telemetry_of_a_class_has_the_units_that_it_declares():
    class Winding(Controller):
        telemetry_labels = {"wind_up_of_a_test": Label("Pa", "integral of the error")}  # noqa: RUF012

    assert attributes("wind_up_of_a_test") == {"units": "Pa", "long_name": "integral of the error"}
    assert attributes("of_no_class") == {"long_name": "of no class"}


def test_one_column_has_one_unit_whoever_makes_it():
    declare("one", {"shared_by_a_test": Label("N", "pull")})
    declare("other", {"shared_by_a_test": Label("N", "pull of the other")})
    with pytest.raises(ParameterError) as caught:
        declare("other yet", {"shared_by_a_test": Label("Pa", "pressure")})
    assert (caught.value.value, caught.value.unit) == ("shared_by_a_test", "Pa")
    declare("other", {"shared_by_a_test": Label("kg", "its mass")})  # a notebook cell that is run again
    assert attributes("shared_by_a_test")["units"] == "kg"


def test_labelled_fields_are_in_the_docstring_and_have_a_size_in_tables():
    @labelled
    class Kept(NamedTuple):
        """Two columns."""

        swing_of_a_test: Annotated[float, Label("rad", "swing", shown="deg", note="of the joint")]
        plain: int

    (label,) = labels_of(Kept).values()
    assert (label.shown_unit, label.size) == ("deg", pytest.approx(0.0174533, rel=1e-5))
    assert "swing_of_a_test\n    Swing [rad]; of the joint." in Kept.__doc__
    assert "plain" not in Kept.__doc__
