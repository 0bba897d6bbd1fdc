"""Modes of a machine or a structure from measured inputs and outputs, and what a simulation of it is missing.

This file is the public table and nothing else: no module of ours imports from it, because an unrelated cloud SDK has
the same import name and may overwrite it (see the README).
"""

import importlib.util
import warnings

from modal import discrepancy
from modal.discrepancy.plant_model import PlantModel
from modal.elements import Element
from modal.extraction import extract_modes
from modal.identification import Choice, Fit, Identification, OrderEvidence, StabilisationPoint
from modal.mode import ModalModel, Mode
from modal.model_file import read_model, write_model
from modal.pipeline import identify
from modal.recording import log_diagnosis, log_identification, save_recording
from modal.report import write_report
from modal.simulation import simulate
from modal.storage import load
from modal.structure import StructuralModel
from modal.uncertainty import Uncertainty

__all__ = [
    "Choice",
    "Element",
    "Fit",
    "Identification",
    "ModalModel",
    "Mode",
    "OrderEvidence",
    "PlantModel",
    "StabilisationPoint",
    "StructuralModel",
    "Uncertainty",
    "discrepancy",
    "extract_modes",
    "identify",
    "load",
    "log_diagnosis",
    "log_identification",
    "read_model",
    "save_recording",
    "simulate",
    "write_model",
    "write_report",
]

if importlib.util.find_spec("modal_proto") is not None:
    warnings.warn(
        "the cloud SDK of the same import name 'modal' is installed in this environment; the two overwrite each other: "
        "use okid-modal in an environment of its own.",
        stacklevel=2,
    )
