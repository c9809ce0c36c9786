"""Write rig.csv, the measurements of the tutorial: a muscle 300 mm long and 20 mm in diameter, as a laboratory logs it.

The file has semicolons and decimal commas, force noise of 1.2 N, 7 N of friction, a load cell offset of 3.4 N, and
pressures that scatter by 0.01 bar. `python examples/your-muscle/make_data.py` writes the same file again.
"""

from pathlib import Path

import numpy as np

LENGTH, FRICTION, OFFSET, NOISE, SCATTER = 300.0, 7.0, 3.4, 1.2, 0.01  # mm, N, N, N, bar
LAW = {"a1": -430.0, "a2": 290.0, "b1": 3.0, "b2": -9.6, "c1": 310.0, "c2": -8.0, "decay": 0.33}  # N, bar, percent


def force(percent: float, pressure: float) -> float:
    """Eq. 2 of the paper."""
    constant, linear, exponential = (LAW[f"{name}1"] + LAW[f"{name}2"] * pressure for name in "abc")
    return float(constant + linear * percent + exponential * np.exp(-LAW["decay"] * percent))


def text(seed: int, longest: float = 30.0) -> str:
    """Loading and unloading between 0 and a contraction [%] at six pressures."""
    rng = np.random.default_rng(seed)
    rows = ["Druck [bar];Kraft [N];Laenge [mm]"]
    stroke = np.linspace(0, longest, 21)
    for level in range(1, 7):
        for side, pass_ in ((-1, stroke), (1, stroke[::-1])):
            for percent in pass_:
                pressure = level + rng.normal(0, SCATTER)
                pull = max(force(percent, pressure) + side * FRICTION, 0.0) + OFFSET + rng.normal(0, NOISE)
                rows.append(f"{pressure:.3f};{pull:.2f};{LENGTH * (1 - percent / 100):.2f}".replace(".", ","))
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    Path(__file__).with_name("rig.csv").write_text(text(2026), encoding="utf-8")
