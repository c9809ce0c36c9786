import jax.numpy as jnp

from mckibben.control import Constant
from mckibben.numerics.compiled import jit


def test_a_new_value_compiles_nothing_and_a_new_structure_does():
    traced = []

    @jit
    def double(signal, *, time):
        traced.append(1)
        return 2 * signal(time)

    assert float(double(Constant(1.5), time=0.0)) == 3.0
    assert float(double(Constant(2.5), time=1.0)) == 5.0
    assert float(double(Constant(-1.0), time=7.0)) == -2.0
    assert len(traced) == 1
    double(Constant(1.0), time=jnp.zeros(3))
    assert len(traced) == 2
