"""Reproduction of the paper: test, identification, knee, control, and verdicts on its claims."""

from mckibben.paper.claims import Claim
from mckibben.paper.reproduction import Reproduction, file_stem, reproduce

__all__ = ["Claim", "Reproduction", "file_stem", "reproduce"]
