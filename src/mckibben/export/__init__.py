"""Controllers and models for other programs.

Modules that need another package: `casadi`, `gym`, `mujoco`.
"""

from mckibben.export.controller import ControllerModule, controller_module
from mckibben.export.plant import PlantModule, plant_module
from mckibben.export.targets import ROBOT_TARGETS, TARGETS, Exported, export

__all__ = [
    "ROBOT_TARGETS",
    "TARGETS",
    "ControllerModule",
    "Exported",
    "PlantModule",
    "controller_module",
    "export",
    "plant_module",
]
