"""Tracking errors of the three set-ups of docs/first-day.md, in simulations with exactly their parts.

python benchmarks/setups.py
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

from mckibben.errors import McKibbenWarning
from mckibben.scenario import Scenario
from mckibben.units import deg

FOLDER = Path(__file__).parents[1] / "examples" / "setups"
SETUPS = "spring", "regulators", "card"


def errors() -> dict[str, float]:
    """Root mean square error of the angle [deg] of each set-up."""
    found = {}
    for name in SETUPS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", McKibbenWarning)  # with a spring, the angle determines the stiffness
            result = Scenario.read(FOLDER / f"{name}.yaml").simulate()
        found[name] = float(result.metrics["angle_rmse"]) / deg
    return found


def main() -> int:
    """Print the errors."""
    for name, error in errors().items():
        print(f"{name}: {error:.2f} deg")
    return 0


if __name__ == "__main__":
    sys.exit(main())
