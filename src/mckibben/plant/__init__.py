"""The plant: valve, inertia and gravity (Eq. 6); what is simulated."""

from mckibben.plant.joint_plant import JointPlant, PlantState
from mckibben.plant.load import Load
from mckibben.plant.valve import FirstOrderValve, IdealValve, Valve

__all__ = ["FirstOrderValve", "IdealValve", "JointPlant", "Load", "PlantState", "Valve"]
