"""Controllers and models for other programs."""

from mckibben.export.controller import ControllerModule, controller_module
from mckibben.export.targets import TARGETS, Exported, export

__all__ = ["TARGETS", "ControllerModule", "Exported", "controller_module", "export"]
