"""Emitted C, of one run and of many side by side, against JAX."""

import functools
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.codegen import SourceModule, write_c
from mckibben.codegen.native import NativeFunction, Split, compiler, over_periods
from mckibben.errors import ExportError
from mckibben.numerics import elementary

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
X = np.random.default_rng(1).normal(size=21)
PLAIN = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-c")


def elementwise(x):
    """Every operation that has a counterpart in C."""
    y = jnp.abs(x) + 0.1
    small, whole = jnp.tanh(x), (x * 4).astype(int)
    return (
        jnp.sin(x) * jnp.cos(x) - jnp.tan(small),
        jnp.exp(-y) + jnp.expm1(small) + jnp.log(y) + jnp.log1p(y),
        jnp.arcsin(small) + jnp.arccos(small) + jnp.arctan(x) + jnp.arctan2(x, y),
        jnp.sinh(small) + jnp.cosh(small) + jnp.cbrt(x) + jnp.sqrt(y) + y**1.3 + lax.rsqrt(y),
        jnp.floor(x) + jnp.ceil(x) + jnp.round(3 * x) + jnp.sign(x) + x**3 + y**-2 + lax.rem(x, y),
        jnp.where((x > 0) & ~(y < 1) | (x == y), x, -y) + jnp.clip(x, -0.5, 0.5) + jax.nn.sigmoid(x),
        (x > 0) ^ (y > 1),
        jnp.stack([jnp.maximum(x > 0, y > 1), jnp.minimum(x > 0, y > 1), (x > 0) < (y > 1), (x > 0) >= (y > 1)]),
        jnp.where(x > 0, 2, 3) + jnp.maximum(whole, 2) + jnp.abs(whole) // 3 + (~jnp.minimum(whole, 2**24 + 1) >> 1),
        lax.reduce_precision(x, 8, 23) + lax.reduce_precision(y, 11, 52),
    )


def shapes(x):
    a = jnp.stack([x, 2 * x, x * x])
    b = jnp.outer(a, a + 1.0)
    padded = jnp.pad(a, (1, 2), constant_values=3.0)
    return (
        b @ a,
        b.T[1:, ::-1].ravel(),
        jnp.sum(b, axis=0) + jnp.max(b, axis=1),
        jnp.concatenate([padded, jnp.flip(a)]).reshape(3, 3),
        jnp.all(b > -1.0) | jnp.any(a > 2.0),
        jnp.arange(3) * x,
        jnp.stack([jnp.argmin(jnp.abs(b - x), axis=1), jnp.argmax(b, axis=0)]),
        a[jnp.argmin(a)],
        lax.dynamic_slice(b, ((10 * x).astype(int), jnp.asarray(1)), (2, 2)),
        jnp.argmin(jnp.array([1.0, jnp.nan, 0.0]) * x),
    )


def loops(x):
    def body(carry, row):
        a, b = carry
        a, b = b, a * 0.9 + jnp.sin(row)  # swapped: both are of the pass before
        return (a, b), (a - row, jnp.stack([a, b]))

    rows = x + jnp.linspace(0.0, 1.0, 60)
    first, (single, double) = lax.scan(body, (x, 2 * x), rows)
    last, back = lax.scan(lambda c, r: (c + r[0] * r[1].sum(), c), x, (single, double), reverse=True)

    def outer(k, total):
        return total + lax.fori_loop(0, 40, lambda i, c: c * 0.5 + jnp.cos(i * x + k), total)

    return first, last, back, lax.fori_loop(0, 50, outer, x), double


def branches(x):
    def body(total, index):
        here = lax.cond(index >= 70, lambda t: (jnp.sin(t), t), lambda t: (t, t * 0.5), total)  # of all lanes alike
        there = lax.cond(x > 0, lambda t: t + 1.0, lambda t: t - 1.0, here[0])
        return there * 0.9 + here[1] * 0.01, there

    return lax.scan(body, x, jnp.arange(100))


def random(x):
    """A key, and one folded into it; x as a seed too."""
    key = jax.random.key((x * 100).astype(int))
    folded = jax.random.fold_in(key, jnp.asarray(7, jnp.uint32))
    return jax.random.uniform(key, (2,)), jax.random.normal(folded, (3,), jnp.float32)


@pytest.mark.parametrize("function", [elementwise, shapes, loops, branches, random])
@pytest.mark.slow
def test_emitted_functions_are_those_of_jax(function):
    expected = jax.jit(jax.vmap(function))(X)
    many = NativeFunction(lambda _, x: function(x))(None, X)
    alone = NativeFunction(lambda x, _: function(x))
    tolerance = 3e-7 if function is random else 1e-12  # normal numbers are of 32 bits
    for one, all_, column in zip(jax.tree.leaves(alone(X[3])), *map(jax.tree.leaves, (expected, many)), strict=True):
        assert np.moveaxis(column, -1, 0).dtype == np.asarray(all_).dtype
        np.testing.assert_allclose(np.moveaxis(column, -1, 0), all_, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(one, all_[3], rtol=tolerance, atol=tolerance)


def test_what_is_not_a_number_stays_so():
    values = np.array([np.nan, np.inf, -np.inf, -0.0, 1e-300])

    def function(x):
        return jnp.maximum(x, 0.0), jnp.minimum(x, 0.0), jnp.isfinite(x), x * jnp.inf, jnp.clip(x, -1.0, 1.0)

    many = NativeFunction(lambda _, x: function(x))(None, values)
    alone = NativeFunction(lambda x, _: function(x))
    one = np.transpose([alone(x) for x in values])
    for found, single, expected in zip(many, one, jax.jit(function)(values), strict=True):
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(single, expected)


@pytest.mark.parametrize("operation", [jnp.sort, jnp.linalg.inv, lambda x: lax.top_k(x, 1)])
def test_what_cannot_be_emitted_is_named(operation):
    with pytest.raises(ExportError) as caught:
        NativeFunction(lambda x, _: operation(x))(np.eye(2))
    assert caught.value.field
    assert "test_emitted.py" in str(caught.value)


def test_what_depends_on_parameters_alone_is_prepared(tmp_path):
    module = SourceModule("gain", {"gain": np.asarray(2.0), "table": np.array([1.0, 2.0])})

    def step(parameters, state, error):
        lag = jnp.exp(-parameters["gain"])
        state = state + lag * error
        return {"state": state, "command": state * parameters["table"].sum(), "saturated": state > 1.0}

    module.add("step", "one period", step, {"state": np.asarray(0.0), "error": np.asarray(0.0)})
    header, source = write_c(module, "a comment")
    (tmp_path / "gain.h").write_text(header)
    (tmp_path / "gain.c").write_text(source)
    (tmp_path / "main.c").write_text(
        """#include "gain.h"
        #include <stdio.h>
        int main(void)
        {
            gain self;
            double command;
            bool saturated;
            gain_defaults(&self);
            self.state.value = 0.5;
            gain_step(&self, 1.0, &command, &saturated);
            printf("%.17g %d ", command, saturated);
            self.parameters.gain = 0.0;
            self.parameters.table[1] = 0.0;
            gain_prepare(&self);
            gain_step(&self, 1.0, &command, &saturated);
            printf("%.17g %d", command, saturated);
            return 0;
        }"""
    )
    subprocess.run([compiler(), *PLAIN[:-2], "gain.c", "main.c", "-o", "main", "-lm"], cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout.split()
    state = 0.5 + np.exp(-2.0)
    assert [float(x) for x in printed] == pytest.approx([3 * state, 0, state + 1, 1], rel=1e-15)
    assert "exp" not in source[source.index("void gain_step") :]  # it is computed once


def test_in_single_precision_what_depends_on_the_reference_alone_is_double(tmp_path):
    module = SourceModule("filter", {"period": np.asarray(1e-3)})

    def step(parameters, state, setpoint, measured):
        rate = (setpoint - state["last"]) / parameters["period"]
        total = state["total"] + (setpoint - measured)
        return {"state": {"last": setpoint, "total": total}, "command": rate - total}

    number = np.asarray(0.0)
    module.add("step", "", step, {"state": {"last": number, "total": number}, "setpoint": number, "measured": number})
    header, source = write_c(module, single=True, wide=("setpoint",))
    assert "double last" in header
    assert "float total" in header
    (tmp_path / "filter.h").write_text(header)
    (tmp_path / "filter.c").write_text(source)
    subprocess.run([compiler(), *PLAIN, "filter.c"], cwd=tmp_path, check=True)


def test_a_short_loop_may_pass_on_an_array_in_memory():
    given = np.arange(4.0)
    found = NativeFunction(lambda x, _: jax.lax.scan(lambda carry, _: (x, carry + x), x * 0, length=2))(given)
    np.testing.assert_array_equal(found[0], given)
    np.testing.assert_array_equal(found[1], [given, 2 * given])


def test_functions_of_one_run_are_right_to_about_an_ulp():
    @NativeFunction
    def values(x, _):
        return lax.map(lambda x: jnp.stack([elementary.exp(x), *elementary.sincos(x), jnp.tanh(x)]), x)

    ends = [-np.inf, -708.1, 0.0, 709.7827, 709.79, np.inf]
    x = np.concatenate([np.linspace(-708, 709.7, 20001), np.random.default_rng(2).uniform(-30, 30, 20000), ends])
    with np.errstate(over="ignore", invalid="ignore"):
        exact = [f(x.astype(np.longdouble)).astype(float) for f in (np.exp, np.sin, np.cos, np.tanh)]
        exp, sine, cosine, tanh = values(x).T
        np.testing.assert_allclose(exp[:-6], exact[0][:-6], rtol=4e-16)
    for found, right in zip((sine, cosine, tanh), exact[1:], strict=True):
        np.testing.assert_allclose(found[1:-1], right[1:-1], rtol=0, atol=3e-16)
    assert exp[-6:].tolist() == [0.0, 0.0, 1.0, pytest.approx(exact[0][-3], rel=4e-16), np.inf, np.inf]
    assert np.isnan(values(np.array([np.nan]))).all()


def test_an_array_in_two_places_of_a_tree_is_one_argument():
    array = np.array(2.0)
    split = Split.of({"model": array, "other": np.array(2.0), "plant": array})
    assert len(split.arrays) == 2
    assert split.filled([3.0, 5.0]) == {"model": 3.0, "other": 5.0, "plant": 3.0}
    assert split.key != Split.of({"model": np.array(2.0), "other": array, "plant": array}).key


@pytest.mark.parametrize("many", [False, True])
def test_one_program_serves_runs_of_any_number_of_periods(many):
    def function(shared, lane):
        factor, rows = shared
        x = lane if many else rows

        def following(total, at):
            index, value = at
            return total + factor * value, (total, index + 1)

        columns = lax.iota(int, x.shape[0]), x.astype(jnp.float32)
        total, rows = lax.scan(following, jnp.zeros((), jnp.float32), columns)
        return total / jnp.asarray(x.shape[0]), rows

    emitted = NativeFunction(function)
    for length in (3, 400):
        x = np.random.default_rng(3).normal(size=(length, 5))
        shared = np.array(2.0, np.float32), over_periods(x[:, 0])
        found = emitted(shared, over_periods(x) if many else None, single=many)
        right = jax.vmap(function, (None, -1), -1)(shared, x) if many else function(shared, None)
        jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-5), found, right)
    assert len(emitted._programs) == 1
