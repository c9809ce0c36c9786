"""docs/paper.md, decisions 1, 2 and 9: Eqs. 1 and 3 in numbers worked out by hand."""

import math

import numpy as np
import pytest

from mckibben.errors import RangeError
from mckibben.muscle import ChouLaw
from mckibben.units import bar, deg, mm, percent


@pytest.mark.parametrize(
    ("contraction", "pressure", "force", "tolerance"),
    [(0, 6, 584.72, 0.005), (10, 6, 242.6, 0.05), (-8, 6, 2493.5, 0.05), (5, 0, -173, 0.5), (23.4, 6, 0, 1)],
)
def test_equation_3_gives_the_numbers_that_we_publish(law, contraction, pressure, force, tolerance):
    assert float(law.force(contraction * percent, pressure * bar)) == pytest.approx(force, abs=tolerance)


def test_equation_3_is_the_papers_over_its_whole_domain(law, paper):
    contraction, pressure = np.linspace(-0.03, 0.25, 29)[:, None], np.linspace(0, 6e5, 13)
    np.testing.assert_allclose(
        law.force(contraction, pressure), paper.eq3(contraction, pressure), rtol=1e-12, atol=1e-10
    )
    np.testing.assert_allclose(
        law.slope(contraction, pressure), paper.eq3_slope(contraction, pressure), rtol=1e-12, atol=1e-9
    )


def test_equation_1_by_hand():
    law = ChouLaw(braid_angle=25 * deg, initial_diameter=10 * mm)
    beta1, beta2 = 3 / math.tan(math.radians(25)) ** 2, 1 / math.sin(math.radians(25)) ** 2
    area = math.pi * 0.01**2 / 4
    assert float(law.force(0.0, 6 * bar)) == pytest.approx(6e5 * area * (beta1 - beta2), rel=1e-13)
    assert float(law.force(0.0, 6 * bar)) == pytest.approx(386, abs=0.5)
    assert float(law.force(0.1, 3 * bar)) == pytest.approx(3e5 * area * (beta1 * 0.81 - beta2), rel=1e-13)
    assert float(law.slope(0.1, 3 * bar)) == pytest.approx(-3e5 * area * 2 * beta1 * 0.9, rel=1e-13)


@pytest.mark.parametrize("contraction", [-0.03, 0.0, 0.1, 0.2, 0.35])
def test_equation_1_is_the_virtual_work_of_the_braid(specimen, contraction):
    pressure, step = 4 * bar, 1e-6
    volume = lambda c: float(specimen.volume(c))  # noqa: E731
    length = lambda c: float(specimen.length_at(c))  # noqa: E731
    work = -pressure * (volume(contraction + step) - volume(contraction - step))
    travel = length(contraction + step) - length(contraction - step)
    assert work / travel == pytest.approx(float(ChouLaw.of(specimen).force(contraction, pressure)), rel=1e-7)


def test_the_volume_is_that_of_a_cylinder_of_constant_thread(specimen):
    assert float(specimen.volume(0.0)) == pytest.approx(math.pi * 0.01**2 / 4 * 0.18, rel=1e-14)
    thread, contraction = 0.18 / math.cos(math.radians(25)), 0.17
    turns = 0.18 * math.tan(math.radians(25)) / (math.pi * 0.01)
    length = 0.18 * (1 - contraction)
    diameter = math.sqrt(thread**2 - length**2) / (turns * math.pi)
    assert float(specimen.volume(contraction)) == pytest.approx(math.pi * diameter**2 / 4 * length, rel=1e-12)


def test_a_braid_angle_from_which_a_muscle_extends_is_refused():
    with pytest.raises(RangeError) as refused:
        ChouLaw(braid_angle=66 * deg, initial_diameter=10 * mm)
    assert refused.value.field == "braid_angle" and refused.value.upper == pytest.approx(54.7 * deg, abs=1e-3)
