"""Find where a simulation and measurements disagree, name the missing effect, add it to the model."""

from modal.discrepancy.diagnosis import calibrate, decide, diagnose, fit, screen
from modal.discrepancy.noise.floor import noise_floor
from modal.discrepancy.results import Diagnosis, Finding
from modal.effects.catalogue import CATALOGUE, register
from modal.localisation.evidence import locate

__all__ = [
    "CATALOGUE",
    "Diagnosis",
    "Finding",
    "calibrate",
    "decide",
    "diagnose",
    "fit",
    "locate",
    "noise_floor",
    "register",
    "screen",
]
