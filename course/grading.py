"""Checks of the labs. A check that fails raises `AssertionError` with a hint, which fails the cell in nbgrader too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

_FACTORS = {
    1e5: "is a pressure in bar where Pa is expected, or the reverse?",
    100.0: "is a contraction in percent where a ratio is expected, or the reverse?",
    1e3: "is a length in mm where m is expected, or the reverse?",
    2 * np.pi: "is a frequency in Hz where rad/s is expected, or the reverse?",
    2.0: "is a whole width or amplitude given where a half is expected, or the reverse?",
    180 / np.pi: "is an angle in deg where rad is expected, or the reverse?",
}


def close(answer: Any, expected: Any, *, tolerance: float, unit: str = "") -> None:
    """Compare numbers or arrays; `tolerance` is relative to the largest magnitude expected."""
    try:
        found = np.asarray(answer, float)
    except (TypeError, ValueError):
        raise AssertionError(f"The answer is not a number or an array of numbers: {answer!r}") from None
    expected = np.asarray(expected, float)
    assert found.shape == expected.shape, f"The answer has the shape {found.shape}; expected: {expected.shape}."
    assert np.all(np.isfinite(found)), "The answer is not finite."
    deviation = np.abs(found - expected)
    allowed = tolerance * np.max(np.abs(expected))
    if np.all(deviation <= allowed):
        return
    worst = np.unravel_index(np.argmax(deviation), deviation.shape)
    hint = _hint(found, expected, tolerance)
    raise AssertionError(
        f"The answer {found[worst]:.6g} {unit} is off by more than {allowed:.3g} {unit}. {hint}".strip()
    )


def agree(
    answer: Callable[..., Any], other: Callable[..., Any], *inputs: Any, tolerance: float, unit: str = ""
) -> None:
    """Compare a function with another implementation at the same inputs."""
    close(answer(*inputs), other(*inputs), tolerance=tolerance, unit=unit)


def ensure(condition: Any, reason: str) -> None:
    """Require a condition."""
    assert bool(condition), reason


def below(values: Any, bound: float, *, unit: str = "") -> None:
    """Require all values, such as errors of several runs, to be finite and at most a bound."""
    found = np.atleast_1d(np.asarray(values, float))
    assert np.all(np.isfinite(found)), "A value is not finite: did a run diverge?"
    assert np.all(found <= bound), f"The largest value is {np.max(found):.4g} {unit}; allowed: {bound:g} {unit}."


def _hint(found: np.ndarray, expected: np.ndarray, tolerance: float) -> str:
    """Likely cause, if one factor relates all values."""
    if np.all(np.abs(found + expected) <= tolerance * np.max(np.abs(expected))):
        return "Hint: the sign is wrong."
    for factor, cause in _FACTORS.items():
        for scaled in (found * factor, found / factor):
            if np.all(np.abs(scaled - expected) <= max(tolerance, 1e-3) * np.max(np.abs(expected))):
                return f"Hint: {cause}"
    return ""
