"""Models of structures and machines: masses, springs, elements, plants with ports, model files."""

from modal.structure.plant_model import PlantModel
from modal.structure.structural_model import StructuralModel

__all__ = ["PlantModel", "StructuralModel"]
