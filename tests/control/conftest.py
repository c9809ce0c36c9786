"""What the tests of controllers share: programs for a few short runs, which are quicker to compile."""

import equinox as eqx
import pytest

from mckibben.numerics.batching import batched_program
from mckibben.simulation.loop import episode


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


@pytest.fixture(scope="session")
def short_episode(barely_compiled):
    """`episode`, compiled once for each structure of its arguments; give it `numeric` ones."""
    return barely_compiled(episode)
