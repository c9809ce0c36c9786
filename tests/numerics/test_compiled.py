import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mckibben.control import Constant
from mckibben.numerics.compiled import jit, numeric


class Thing(eqx.Module):
    number: float
    whole: int
    flag: bool
    text: str = eqx.field(static=True, default="a")


def test_numbers_become_arrays_and_all_else_stays():
    thing = numeric(Thing(1.5, 2, True))
    assert isinstance(thing.number, np.ndarray)
    assert thing.number.dtype == np.float64
    assert isinstance(thing.whole, np.ndarray)
    assert thing.whole.dtype == np.int64
    assert thing.flag is True
    assert thing.text == "a"
    assert numeric(jnp.float32(1.0)).dtype == jnp.float32


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
