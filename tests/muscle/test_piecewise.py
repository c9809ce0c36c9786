"""A law of tables over the pressure: interpolation, its inverse, and tables that are refused."""

import numpy as np
import pytest
import yaml

from mckibben.component.schema import read_component
from mckibben.errors import McKibbenError
from mckibben.muscle import ForceLaw, PiecewiseLaw, ReynoldsLaw
from mckibben.units import bar, kPa

AT, FORCES, SPRINGS = np.array([1.0, 3.0, 6.0]) * bar, [200.0, 500.0, 1000.0], [2e3, 1e3, 2e3]
FILE = """\
class: piecewise
pressures: [1 bar, 3 bar, 6 bar]
forces: [200 N, 500 N, 1 kN]
springs: [2 kN, 1 kN, 2 kN]
"""


@pytest.mark.slow
def test_a_table_in_a_file_is_interpolated_and_inverted(tmp_path):
    (tmp_path / "law.yaml").write_text(FILE)
    law = read_component(ForceLaw, tmp_path / "law.yaml")
    pressure, contraction = np.linspace(1, 6, 41) * bar, 0.12
    expected = np.interp(pressure, AT, FORCES) - contraction * np.interp(pressure, AT, SPRINGS)
    np.testing.assert_allclose(law.force(contraction, pressure), expected, rtol=1e-12)
    np.testing.assert_allclose(law.pressure_for(expected, contraction), pressure, rtol=1e-6)


def test_a_table_of_one_piece_is_the_law_of_reynolds_also_beyond_it():
    one = PiecewiseLaw((1e5, 2e5), (179.2 + 139, 179.2 + 278), (1427.5 + 767.5, 1427.5 + 1535.0))
    law = ReynoldsLaw(f0=179.2, f1=1.39 / kPa, k0=1427.5, k1=7.675 / kPa)
    np.testing.assert_allclose(one.force(0.1, [0.0, 4e5]), law.force(0.1, [0.0, 4e5]), rtol=1e-12)


@pytest.mark.parametrize(("key", "value"), [("springs", "[2 kN, 1 kN]"), ("pressures", "[1 bar, 6 bar, 3 bar]")])
def test_columns_that_are_no_table_are_refused(key, value, tmp_path):
    section = yaml.safe_load(FILE) | {key: yaml.safe_load(value)}
    (tmp_path / "law.yaml").write_text(yaml.safe_dump(section))
    with pytest.raises(McKibbenError) as refused:
        read_component(ForceLaw, tmp_path / "law.yaml")
    assert "pressures" in str(refused.value) and "law.yaml" in str(refused.value)
