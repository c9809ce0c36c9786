"""What the tests of controllers share: programs that are quicker to compile."""

import equinox as eqx
import pytest

from mckibben.numerics.batching import batched_program


@pytest.fixture(scope="session")
def barely_compiled():
    """Like `equinox.filter_jit`, in two thirds of its time; the answers are the same but for rounding."""

    def barely_compiled(function):
        program = eqx.filter_jit(function)

        def call(*args):
            with batched_program():
                return program(*args)

        return call

    return barely_compiled
