"""What is summed: the grammar of costs, and their arithmetic."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.errors import McKibbenError, ParameterError, RangeError
from mckibben.simulation import Metrics
from mckibben.study.tune import Cost, Term, parse_cost
from mckibben.units import deg

SIZES = st.floats(1e-30, 1e30)
COSTS = st.lists(st.sampled_from(Metrics._fields), min_size=1, unique=True).flatmap(
    lambda names: st.tuples(*(st.builds(Term, st.just(name), SIZES, SIZES) for name in names))
)


@given(COSTS)
def test_what_is_written_reads_back_to_the_last_bit(terms):
    assert parse_cost(Cost(terms).text).terms == terms


@given(st.text(max_size=40) | st.text("angle_rmse/+*0.1e degN- \n", max_size=40))
def test_any_text_is_a_cost_or_an_error_of_ours(text):
    try:
        assert parse_cost(parse_cost(text).text).terms == parse_cost(text).terms
    except McKibbenError as error:
        assert str(error)


@pytest.mark.parametrize("plus", [" + ", "+", " +", "+ ", "\n  + "])
def test_terms_with_units_weights_and_any_plus(plus):
    cost = parse_cost(f"angle_rmse/0.1 deg{plus}2*stiffness_rmse/50 N*cm/rad{plus}1e+1 * coupling / 1e+3 deg")
    assert [term.metric for term in cost.terms] == ["angle_rmse", "stiffness_rmse", "coupling"]
    assert [term.weight for term in cost.terms] == [1.0, 2.0, 10.0]
    np.testing.assert_allclose([term.scale for term in cost.terms], [0.1 * deg, 0.5, 1000 * deg], rtol=1e-15)
    assert cost.metrics == ("angle_rmse", "stiffness_rmse", "coupling")


def test_a_metric_alone_needs_no_scale():
    assert parse_cost(" angle_rmse ") == Cost((Term("angle_rmse", 1.0),))
    assert parse_cost("3*force_max").terms == (Term("force_max", 1.0, 3.0),)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "not a term"),
        ("angle_rms/1 deg", "did you mean 'angle_rmse'"),
        ("angle_rmse/1 N", "does not have the dimensions of 'rad'"),
        ("angle_rmse/1", "has no unit"),
        ("angle_rmse/1 deg + angle_rmse/2 deg", "angle_rmse appears twice"),
        ("angle_rmse + stiffness_rmse/1 N*m/rad", "angle_rmse has no scale.*write it like angle_rmse/0.1 deg"),
        ("angle_rmse/1 deg +", "'' is not a term"),
        ("angle_rmse/-1 deg", "scale is -0.01"),
        ("0*angle_rmse", "weight is 0"),
        ("2-*angle_rmse", "'2-' is not a number"),
        ("angle_rmse - coupling", "not a term"),
    ],
)
def test_what_is_wrong_is_named(text, named):
    with pytest.raises((ParameterError, RangeError), match=named):
        parse_cost(text)
