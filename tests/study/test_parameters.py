"""What numbers are varied over, as text and as Python types; tables of values, and how evenly they fill the space."""

import itertools
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.errors import ParameterError
from mckibben.scenario import Scenario
from mckibben.study.parameters import (
    LogUniform,
    Normal,
    Range,
    Uniform,
    Values,
    parse_sweep,
    parse_sweeps,
    sample,
    sweep_parameters,
)
from mckibben.units import bar

EXAMPLES = Path(__file__).parents[2] / "examples"
BACKPROP = Scenario.read(EXAMPLES / "pre-contracted-step-backprop.yaml")


def spread(text, scenario=BACKPROP):
    return parse_sweep(text, scenario).distribution


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("load.mass2=0.2 kg..1.0 kg", Uniform(0.2, 1.0)),
        ("load.mass2=0.2..1.0 kg in 9", Uniform(0.2, 1.0, 9)),
        ("load.mass2=1 kg, 2 kg,4 kg", Values((1.0, 2.0, 4.0))),
        ("load.mass2=+-10 %", Uniform(0.45, 0.55)),
        ("controller.position.base.kp=1..100 bar/rad log in 3", LogUniform(1 * bar, 100 * bar, 3)),
        ("controller.position.base.kp=-100 bar/rad..-1 bar/rad log", LogUniform(-100 * bar, -1 * bar)),
        ("controller.position.seed=0..19", Values(tuple(range(20)))),
        ("controller.position.momentum=+-10 %", Uniform(0.45, 0.55)),  # a percentage is one of the nominal value
    ],
)
def test_texts_that_mean_something(text, expected):
    swept = parse_sweep(text, BACKPROP)
    read = swept.distribution
    assert type(read) is type(expected)
    for name, value in vars(expected).items():
        assert vars(read)[name] == (value if value is None else pytest.approx(value, rel=1e-12)), name
    assert parse_sweep(swept.text, BACKPROP) == swept
    values = read.ppf(np.linspace(0, 1, 21))
    assert np.all(np.diff(values) >= 0) and (values.min(), values.max()) == read.bounds
    if isinstance(read, Range):
        np.testing.assert_allclose(read.quantile(values), np.linspace(0, 1, 21), atol=1e-9)


def test_a_normal_distribution_is_cut_off_at_the_range_of_the_field():
    relative, absolute = spread("load.mass2=normal 10 %"), spread("load.mass2=normal 0.05 kg")
    assert relative == absolute == Normal(0.5, 0.05, 0.0, 1e4)
    wide = spread("valve.time_constant=normal 100 %")
    assert wide.bounds[0] > 0  # a valve of no time is none
    assert np.all(wide.ppf(np.linspace(0, 1, 1001)) > 0)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("load.mass2", ["load.mass2=0.2 kg..1.0 kg"]),
        ("load.mass2=", ["says nothing after '='", "a range"]),
        ("load.mas2=1 kg", ["did you mean 'load.mass2'"]),
        ("load.mass2=1 kg..0.2 kg", ["empty", "lower end first"]),
        ("load.mass2=1 N..2 N", ["'N'", "'kg'"]),
        ("load.mass2=4,5 kg", ["comma between digits", "point"]),
        ("load.mass2=1 kg, 1 kg", ["listed twice"]),
        ("load.mass2=0 kg..1 kg log", ["has no logarithm", "log"]),
        ("load.mass2=0..1 kg in 9.5", ["number of points", "in 9"]),
        ("load.mass2=+-200 %", ["reaches -0.5 kg", "out of range (0 to 10000 kg)"]),
        ("start.angle=+-10 %", ["nominal value of 0 deg", "give an amount in deg"]),
        ("controller.position.seed=+-10 %", ["is a whole number", "0..19"]),
        ("controller.position.seed=0..100000", ["more than 100000"]),
    ],
)
def test_texts_that_mean_nothing_are_told_what_to_do(text, parts):
    with pytest.raises(ParameterError) as caught:
        parse_sweep(text, BACKPROP)
    message = str(caught.value)
    assert message.startswith(repr(text)[:70])
    for part in parts:
        assert part in message
    assert len(message) < 500


def test_an_amount_around_nothing_is_an_error():
    scenario = Scenario.parse(
        (EXAMPLES / "pre-contracted-step-pid.yaml").read_text().replace(", stiffness: 12 N*m/rad", "")
    )
    with pytest.raises(ParameterError, match="no nominal value in the scenario"):
        parse_sweep("start.stiffness=+-1 N*m/rad", scenario)
    assert parse_sweep("start.stiffness=12..14 N*m/rad", scenario).distribution == Uniform(12.0, 14.0)


def test_the_ends_of_a_range_are_its_ends_to_the_bit():
    for low, high in itertools.pairwise([0.1, 0.3, 7.7, 1e5, 3.3e9]):
        assert Uniform(low, high).ppf([0.0, 1.0]).tolist() == [low, high]
        assert LogUniform(low, high).ppf([0.0, 1.0]).tolist() == [low, high]
        assert LogUniform(-high, -low).ppf([0.0, 1.0]).tolist() == [-high, -low]


def test_the_normal_distribution_is_one():
    from scipy import stats

    quantiles = (np.arange(200_000) + 0.5) / 200_000
    values = Normal(0.5, 0.2, 0.0, 0.9).ppf(quantiles)
    expected = stats.truncnorm(-2.5, 2.0, loc=0.5, scale=0.2)
    np.testing.assert_allclose(values[::1000], expected.ppf(quantiles[::1000]), rtol=1e-9)
    assert values.mean() == pytest.approx(expected.mean(), rel=1e-6)
    assert values.std() == pytest.approx(expected.std(), rel=1e-4)
    assert Normal(0.0, 1.0).ppf([0.0, 0.5, 1.0]) == pytest.approx([-8.2, 0.0, 8.2], abs=0.2)


@pytest.mark.parametrize(
    ("name", "spread", "why"),
    [
        ("load.mass2", Uniform(-1.0, 1.0), "reaches -1 kg"),
        ("controller.position.seed", Uniform(0.0, 3.0), "is a whole number"),
        ("valve.time_constant", Uniform(0.0, 1.0), "out of range"),
    ],
)
def test_a_spread_has_to_go_with_its_number(name, spread, why):
    with pytest.raises(ParameterError, match=why):
        sweep_parameters(BACKPROP, {name: spread})


# Tables of values -----------------------------------------------------------------------------------------------------

MIXED = sweep_parameters(
    BACKPROP,
    {
        "load.mass2": Uniform(0.2, 1.0),
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
    seeds, gains = "controller.position.seed=4..5", "controller.position.base.kp=1..100 bar/rad log in 3"
    table = sample(parse_sweeps(["load.mass2=1..3 kg in 3", seeds, gains], BACKPROP), "grid", samples=1)
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


@pytest.mark.parametrize("design", ["sobol", "random"])
def test_points_of_a_grid_belong_to_the_design_of_a_grid(design):
    with pytest.raises(ParameterError) as refused:
        sample(parse_sweeps(["load.mass2=1..3 kg in 3"], BACKPROP), design)
    assert "--design grid" in refused.value.remedy


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
