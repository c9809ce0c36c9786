"""Reproduction of the paper: test, identification, knee, control, and verdicts on its claims.

`reproduce` runs all of it; `mckibben reproduce` and `make reproduce` write the report. docs/paper.md lists where the
paper leaves a choice, and the choice that was made.
"""

from mckibben.paper.claims import Claim
from mckibben.paper.reproduction import Reproduction, file_stem, reproduce

__all__ = ["Claim", "Reproduction", "file_stem", "reproduce"]
