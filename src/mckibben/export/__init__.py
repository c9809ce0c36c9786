"""Controllers and models for other programs."""

from mckibben.export.controller import ControllerProgram, controller_program
from mckibben.export.targets import TARGETS, Exported, export

__all__ = ["TARGETS", "ControllerProgram", "Exported", "controller_program", "export"]
