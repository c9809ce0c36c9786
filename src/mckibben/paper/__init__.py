"""The paper, end to end: its test, its law, its knee, its control, and what of its claims holds."""

from mckibben.paper.claims import Claim
from mckibben.paper.reproduction import Reproduction, file_stem, reproduce

__all__ = ["Claim", "Reproduction", "file_stem", "reproduce"]
