"""Tables of values: their order, their determinism, and how evenly they fill the space."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.errors import ParameterError
from mckibben.scenario import Scenario
from mckibben.study.parameters import parse_sweeps, sample, sweep_parameters
from mckibben.study.parameters.distributions import LogUniform, Normal, Uniform, Values

BACKPROP = Scenario.read(Path(__file__).parents[2] / "examples" / "pre-contracted-step-backprop.yaml")
MIXED = sweep_parameters(
    BACKPROP,
    {
        "load.mass2": Uniform(0.2, 1.0, points=5),
        "controller.position.base.kp": LogUniform(1e4, 1e6),
        "controller.position.seed": Values(tuple(range(10))),
        "valve.time_constant": Normal(0.02, 0.005),
        "load.distance2": Values((0.1, 0.2, 0.4)),
    },
)


def same(one, other):
    return list(one) == list(other) and all(np.array_equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("kind", ["sobol", "random"])
@pytest.mark.parametrize("samples", [1, 100, 128])
def test_a_table_has_as_many_rows_as_asked_for_and_no_warning(kind, samples):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = sample(MIXED, kind, samples, seed=3)
    assert list(table) == [each.name for each in MIXED]
    for each in MIXED:
        column = table[each.name]
        assert column.shape == (samples,)
        assert column.dtype == (np.int64 if each.parameter.is_integer else np.float64)
        assert np.all(each.parameter.holds(column))


@given(st.integers(1, 300), st.integers(1, 300), st.integers(0, 2**63 - 1), st.sampled_from(["sobol", "random"]))
def test_the_first_rows_do_not_depend_on_how_many_follow(samples, more, seed, kind):
    short, long = sample(MIXED, kind, samples, seed), sample(MIXED, kind, samples + more, seed)
    assert same(short, {name: column[:samples] for name, column in long.items()})


def test_a_sobol_table_puts_one_row_into_each_of_as_many_slices():
    table = sample(MIXED, "sobol", 256, seed=5)
    for each in MIXED[:2]:
        slices = np.floor(each.distribution.quantile(table[each.name]) * 256).astype(int)
        assert sorted(slices) == list(range(256))
    counts = np.unique(table["load.distance2"], return_counts=True)[1]
    assert np.all(np.abs(counts - 256 / 3) < 2)


def test_a_grid_is_every_combination_the_last_number_fastest():
    table = sample(
        parse_sweeps(
            [
                "load.mass2=1..3 kg in 3",
                "controller.position.seed=4..5",
                "controller.position.base.kp=1..100 bar/rad log in 3",
            ],
            BACKPROP,
        ),
        "grid",
        samples=1,
    )
    np.testing.assert_array_equal(table["load.mass2"], np.repeat([1.0, 2.0, 3.0], 6))
    np.testing.assert_array_equal(table["controller.position.seed"], np.tile([4, 4, 4, 5, 5, 5], 3))
    np.testing.assert_allclose(table["controller.position.base.kp"], np.tile([1e5, 1e6, 1e7], 6), rtol=1e-14)
    assert table["controller.position.seed"].dtype == np.int64


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        (["load.mass2=1..3 kg"], r"load\.mass2=1 kg\.\.3 kg: .* in 9"),
        (["load.mass2=normal 10 %"], "has no grid"),
        (["load.mass2=1..3 kg in 4000", "load.mass1=1..3 kg in 4000"], "16000000 combinations"),
        (["controller.position.seed=0..2000000000"], "more than"),
    ],
)
def test_a_grid_that_is_none_is_refused(texts, why):
    with pytest.raises(ParameterError, match=why):
        sample(parse_sweeps(texts, BACKPROP), "grid")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"swept": ()}, "nothing is varied"),
        ({"swept": [MIXED[0], MIXED[0]]}, "varied twice"),
        ({"method": "lattice"}, "no design 'lattice'"),
        ({"samples": 0}, "samples is 0"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_designs_that_are_none_are_refused(options, why):
    with pytest.raises(ParameterError, match=why):
        sample(**{"swept": MIXED, "method": "sobol", "samples": 8, "seed": 0, **options})
