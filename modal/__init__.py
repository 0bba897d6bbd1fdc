"""Modes of a machine or a structure from measured inputs and outputs, and what a simulation of it is missing.

This file is the public table and nothing else: no module of ours imports from it, because an unrelated cloud SDK has
the same import name and may overwrite it (see the README).
"""

import importlib.util
import warnings

from modal import discrepancy
from modal.acceptance import check_limits
from modal.comparison import compare_results
from modal.comparison_source import read_result
from modal.discrepancy.plant_model import PlantModel
from modal.elements import Element
from modal.extraction import extract_modes
from modal.geometry import Geometry, Sensor
from modal.geometry_file import read_geometry
from modal.identification import Choice, Fit, Identification, OrderEvidence, StabilisationPoint
from modal.mode import ModalModel, Mode
from modal.model_file import read_model, write_model
from modal.pipeline import identify
from modal.quality import check_quality
from modal.recording import log_diagnosis, log_identification, save_recording
from modal.report import write_report
from modal.search import OrderChoice, choose_orders
from modal.simulation import simulate
from modal.specification import read_specification
from modal.storage import load
from modal.structure import StructuralModel
from modal.uncertainty import Uncertainty

__all__ = [
    "Choice",
    "Element",
    "Fit",
    "Geometry",
    "Identification",
    "ModalModel",
    "Mode",
    "OrderChoice",
    "OrderEvidence",
    "PlantModel",
    "Sensor",
    "StabilisationPoint",
    "StructuralModel",
    "Uncertainty",
    "check_limits",
    "check_quality",
    "choose_orders",
    "compare_results",
    "discrepancy",
    "extract_modes",
    "identify",
    "load",
    "log_diagnosis",
    "log_identification",
    "read_geometry",
    "read_model",
    "read_result",
    "read_specification",
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
