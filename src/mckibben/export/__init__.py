"""Controllers and models for other programs.

Modules that need another package: `casadi`, `gym`, `mujoco`.
"""

from mckibben.export.controller import ControllerModule, controller_module
from mckibben.export.leg_controller import export_leg_controller
from mckibben.export.plant import PlantModule, plant_module
from mckibben.export.targets import LEG_TARGETS, TARGETS, Exported, export

__all__ = [
    "LEG_TARGETS",
    "TARGETS",
    "ControllerModule",
    "Exported",
    "PlantModule",
    "controller_module",
    "export",
    "export_leg_controller",
    "plant_module",
]
