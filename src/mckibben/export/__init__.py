"""Controllers and models for other programs.

What needs another package is in a module of its own: `casadi`, `gym`, `mujoco`.
"""

from mckibben.export.controller import ControllerModule, controller_module
from mckibben.export.plant import PlantModule, plant_module
from mckibben.export.targets import TARGETS, Exported, export

__all__ = ["TARGETS", "ControllerModule", "Exported", "PlantModule", "controller_module", "export", "plant_module"]
