"""Models of structures and machines: masses, springs, elements, plants with ports, model files."""

from modal.structure.given import PlantModel
from modal.structure.structural_model import StructuralModel

__all__ = ["PlantModel", "StructuralModel"]
