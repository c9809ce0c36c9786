"""Tracking errors of the three set-ups of docs/first-day.md, in simulations with exactly their parts.

python benchmarks/setups.py
"""

import warnings
from pathlib import Path

from mckibben.errors import McKibbenWarning
from mckibben.scenario import Scenario
from mckibben.units import deg

FOLDER = Path(__file__).parents[1] / "examples" / "setups"


def errors() -> dict[str, float]:
    """Root mean square error of the angle [deg] of each set-up."""
    warnings.simplefilter("ignore", McKibbenWarning)  # with a spring, the angle determines the stiffness
    results = {name: Scenario.read(FOLDER / f"{name}.yaml").simulate() for name in ("spring", "regulators", "card")}
    return {name: result.metrics["angle_rmse"] / deg for name, result in results.items()}


if __name__ == "__main__":
    print(*(f"{name}: {error:.2f} deg" for name, error in errors().items()), sep="\n")
