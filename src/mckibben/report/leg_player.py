"""Player of runs of a leg in a page: its muscles and the force of the ground, from inline data; it can be turned."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from typing import TYPE_CHECKING, Any

import markupsafe
import numpy as np
from numpy.typing import NDArray

from mckibben.numerics.calculus import evenly_spaced
from mckibben.report.leg_shapes import FULL, SLACK, muscle_shapes, place_of, skeleton, straight_paths

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.leg import LegPlant, LegResult

_FRAMES = 240
_FORCE = ("ground_forward", "ground_left", "ground_up")
_SCALE = 1e4
"""Numbers are stored as integers: lengths in 0.1 mm."""
_TURNED = '<label>View <input type="range" class="turn" min="-180" max="180" value="30" aria-label="View"></label>'
"""Angle of the view about the vertical [deg]: 0 from the right, 90 from behind."""


def leg_player(runs: Mapping[str, tuple[LegPlant, LegResult]], key: str = "leg") -> markupsafe.Markup:
    """HTML of a self-contained player of one or more runs side by side; `key` is its id in the page.

    Parameters
    ----------
    runs
        Plant and result of `simulate_leg`, by displayed title.
    """
    force = max(float(np.linalg.norm([run[name] for name in _FORCE], axis=0).max()) for _, run in runs.values()) or 1.0
    pressure = max(float(run["pressure"].max()) for _, run in runs.values()) or 1.0
    shown = [_run(title, plant, run.to_dataset(), force, pressure) for title, (plant, run) in runs.items()]
    corners = np.array([one.pop("corners") for one in shown])
    options = {
        "runs": shown,
        "scale": _SCALE,
        "left": corners[:, 0].min() - 0.12,
        "right": corners[:, 1].max() + 0.12,
        "top": corners[:, 2].max() + 0.1,
        "colours": [(255 * one).round().tolist() for one in (SLACK, FULL)],
    }
    script = (resources.files("mckibben.report") / "leg_player.js").read_text(encoding="utf-8")
    turned = "" if all(plant.leg.is_planar for plant, _ in runs.values()) else _TURNED
    canvases = "".join(f'<canvas role="img" aria-label="{markupsafe.escape(one["title"])}"></canvas>' for one in shown)
    data = json.dumps(options, separators=(",", ":")).replace("<", "\\u003c")
    name = markupsafe.escape(key)
    return markupsafe.Markup(
        f'<figure class="leg-player" id="{name}"><div class="stages">{canvases}</div>'
        '<div class="controls"><button type="button">Play</button>'
        '<input type="range" min="0" max="1000" value="0" aria-label="Time">'
        '<label>Speed <select><option value="1">1</option><option value="0.1" selected>1/10</option>'
        f'<option value="0.02">1/50</option></select></label>{turned}</div>'
        "<figcaption>Muscles are coloured by pressure; their width follows from their volume and is drawn at twice "
        "its size. The arrow is the ground force.</figcaption>"
        "<noscript><p>This part needs JavaScript.</p></noscript>"
        f"<script>\n{script}legPlayer({json.dumps(str(name))}, {data});\n</script></figure>"
    )


def _run(title: str, plant: LegPlant, run: xr.Dataset, force: float, pressure: float) -> dict[str, Any]:
    """Data of a run: one row of integers per frame, with points, paths, shapes and force."""
    chosen = evenly_spaced(run.sizes["time"], _FRAMES)
    at = run.isel(time=chosen)
    points, shapes, paths = skeleton(plant, at), muscle_shapes(plant, at, pressure), straight_paths(plant, at)
    columns = [points.reshape(len(chosen), -1)]
    for name, parts in paths.items():
        columns += [part.reshape(len(chosen), -1) for part in parts]
        one = shapes[name]
        columns.append(np.stack(one, -1))
    columns.append(np.stack([at[name] for name in _FORCE], -1) / force)
    times = at["time"].to_numpy()
    return {
        "title": title,
        "times": np.round(times * _SCALE).astype(int).tolist(),
        "rows": np.round(np.concatenate(columns, -1) * _SCALE).astype(int).tolist(),
        "points": points.shape[1],
        "muscles": [{"parts": len(parts), "place": place_of(plant, name)} for name, parts in paths.items()],
        "foot": float(plant.leg.foot_radius),
        "weights": force / float(plant.leg.total_mass * plant.gravity),
        "corners": _corners(plant, points),
    }


def _corners(plant: LegPlant, points: NDArray[np.float64]) -> list[float]:
    """Left, right and upper end of what is drawn [m], in any view of a leg that can be turned."""
    left, right = points[..., 0].min(), points[..., 0].max()
    if not plant.leg.is_planar:
        right = np.hypot(points[..., 0], points[..., 1]).max()
        left = -right
    return [float(left), float(right), float(points[..., 2].max())]
