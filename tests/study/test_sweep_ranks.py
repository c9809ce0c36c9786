"""Quantiles and ranks of distributed columns against NumPy and SciPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from mckibben.study.sweep import ranks
from mckibben.study.sweep.ranks import RankedColumn, rank_correlation, spearman


def pieces(values, size):
    return lambda: (values[start : start + size] for start in range(0, len(values), size))


def columns(name, count=5000):
    random = np.random.default_rng(2)
    return {
        "normal": random.normal(size=count),
        "few values": random.integers(0, 4, count).astype(float),
        "one value mostly": np.where(random.random(count) < 0.9, 2.0, random.normal(size=count)),
        "sorted": np.arange(count, dtype=float),
        "wide": np.exp(random.normal(0, 20, count)),
        "constant": np.full(count, 3.0),
        "with infinities": np.where(random.random(count) < 0.1, np.inf, random.normal(size=count)),
    }[name]


NAMES = ["normal", "few values", "one value mostly", "sorted", "wide", "constant", "with infinities"]


@pytest.fixture(params=[1 << 20, 300, 7], ids=["one bucket", "some buckets", "most buckets"])
def bucket(request, monkeypatch):
    monkeypatch.setattr(ranks, "_BUCKET", request.param)
    monkeypatch.setattr(ranks, "_PIECE", 100)


@pytest.mark.parametrize("name", NAMES)
def test_ranks_and_quantiles_are_those_of_scipy_and_numpy(bucket, name):
    values = columns(name)
    ranked = RankedColumn(pieces(values, 640), 2 * len(values))
    expected = stats.rankdata(values) - (len(values) + 1) / 2
    for _ in range(2):
        np.testing.assert_array_equal(np.concatenate(list(ranked.ranks())), expected)
    for share in (0.0, 0.05, 0.333, 0.5, 0.95, 1.0) if np.isfinite(values).all() else ():
        assert ranked.quantile(share) == np.quantile(values, share)
    assert ranked.count == len(values)


@pytest.mark.parametrize("name", NAMES)
def test_the_pieces_do_not_determine_the_ranks(bucket, name):
    values = columns(name, 900)
    one, other = (np.concatenate(list(RankedColumn(pieces(values, size), 900).ranks())) for size in (900, 37))
    np.testing.assert_array_equal(one, other)


def test_a_design_fills_the_buckets_evenly(monkeypatch):
    """Every eighth point of a Sobol sequence is in one eighth of the range."""
    monkeypatch.setattr(ranks, "_BUCKET", 1 << 11)
    monkeypatch.setattr(ranks, "_SAMPLE", 1 << 11)
    values = stats.qmc.Sobol(1, scramble=False).random(1 << 15)[:, 0]
    assert RankedColumn(pieces(values, 1 << 12), len(values))._sizes.max() < 2 << 11


def test_rank_correlations_are_those_of_scipy(bucket):
    x, y = columns("few values"), columns("normal")
    found = rank_correlation(*(RankedColumn(pieces(values, 640), len(x)) for values in (x, x + y)))
    assert found == pytest.approx(stats.spearmanr(x, x + y).statistic, abs=1e-12)


@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=60))
@settings(deadline=None)
def test_any_values_have_their_ranks(values):
    column = np.array(values)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ranks, "_BUCKET", 5)
        found = np.concatenate(list(RankedColumn(pieces(column, 8), len(column)).ranks()))
    np.testing.assert_array_equal(found, stats.rankdata(column) - (len(column) + 1) / 2)


def test_correlations_of_whole_columns_are_those_of_scipy():
    random = np.random.default_rng(1)
    for ties in (False, True):
        x, y = random.random((2, 50))
        x, y = (np.round(x, 1), np.round(y, 1)) if ties else (x, y + x)
        assert spearman(x, y) == pytest.approx(stats.spearmanr(x, y).statistic, abs=1e-12)
    assert np.isnan(spearman([1, 1, 1], [1, 2, 3]))
    assert np.isnan(spearman([], []))
    assert np.isnan(spearman([1, np.nan, 2], [1, 2, 3]))
