"""Controllers and models for other programs.

Modules that need another package: `casadi`, `gym`, `mujoco`.
"""

from mckibben.export.targets import export

__all__ = ["export"]
