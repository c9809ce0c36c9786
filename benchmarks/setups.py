"""Tracking errors of the three set-ups of docs/first-day.md, in simulations with exactly their parts.

python benchmarks/setups.py
"""

import warnings
from pathlib import Path

from mckibben.errors import McKibbenWarning
from mckibben.scenario import Scenario
from mckibben.units import deg

FOLDER = Path(__file__).parents[1] / "examples" / "setups"

if __name__ == "__main__":
    warnings.simplefilter("ignore", McKibbenWarning)  # with a spring, the angle determines the stiffness
    for name in ("spring", "regulators", "card"):
        result = Scenario.read(FOLDER / f"{name}.yaml").simulate()
        print(f"{name}: {result.metrics['angle_rmse'] / deg:.2f} deg")
