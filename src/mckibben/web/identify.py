"""Page of the muscle."""

from dataclasses import dataclass
from typing import Any


@dataclass
class Identification:
    """x."""

    muscle: Any = None


def page() -> None:
    """x."""
