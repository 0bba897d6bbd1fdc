"""Modes of a machine or a structure from measured inputs and outputs, and what a simulation of it is missing.

This file is the public table and nothing else: no module of ours imports from it, because an unrelated cloud SDK has
the same import name and may overwrite it (see the README).
"""

import importlib
import importlib.util
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modal import discrepancy, plots
    from modal.acceptance.check import check_limits
    from modal.acceptance.test_file import read_specification
    from modal.batch import Batch, identify_batch
    from modal.comparison.changes import compare_results
    from modal.comparison.shifts import read_result
    from modal.geometry.file import read_geometry
    from modal.geometry.sensors import Geometry, Sensor
    from modal.identification.more_modes import with_modal_mass, with_modes
    from modal.identification.order_search import OrderChoice, choose_orders
    from modal.identification.pipeline import identify
    from modal.identification.result import Identification, OrderEvidence, load
    from modal.identification.synthesis import frequency_response
    from modal.modes.extraction import extract_modes
    from modal.modes.modal_mass import (
        BaseParticipation,
        ReciprocityError,
        ScaledResponse,
        ScaledShapes,
        base_participation,
        normalise_shapes,
        reciprocity_error,
        scaled_response,
    )
    from modal.modes.mode import Choice, Fit, ModalModel, Mode, Uncertainty
    from modal.modes.shape_comparison import (
        ModePairs,
        RepeatedModes,
        Shapes,
        assurance,
        coordinate_assurance,
        mean_modes,
        pair_modes,
        read_shapes,
    )
    from modal.quality import check_quality
    from modal.recording import log_diagnosis, log_identification, save_recording
    from modal.report import write_report
    from modal.structure.given import PlantModel, simulate
    from modal.structure.model_file import read_model, write_model
    from modal.structure.structural_model import StructuralModel
    from modal.structure.structural_plant import Element
    from modal.tracking import Alarm, Track, Tracks, track
    from modal.tracking.live import LiveEstimate, follow
    from modal.verdict.stabilisation import StabilisationPoint

__all__ = [
    "Alarm",
    "BaseParticipation",
    "Batch",
    "Choice",
    "Element",
    "Fit",
    "Geometry",
    "Identification",
    "LiveEstimate",
    "ModalModel",
    "Mode",
    "ModePairs",
    "OrderChoice",
    "OrderEvidence",
    "PlantModel",
    "ReciprocityError",
    "RepeatedModes",
    "ScaledResponse",
    "ScaledShapes",
    "Sensor",
    "Shapes",
    "StabilisationPoint",
    "StructuralModel",
    "Track",
    "Tracks",
    "Uncertainty",
    "assurance",
    "base_participation",
    "check_limits",
    "check_quality",
    "choose_orders",
    "compare_results",
    "coordinate_assurance",
    "discrepancy",
    "extract_modes",
    "follow",
    "frequency_response",
    "identify",
    "identify_batch",
    "load",
    "log_diagnosis",
    "log_identification",
    "mean_modes",
    "normalise_shapes",
    "pair_modes",
    "plots",
    "read_geometry",
    "read_model",
    "read_result",
    "read_shapes",
    "read_specification",
    "reciprocity_error",
    "save_recording",
    "scaled_response",
    "simulate",
    "track",
    "with_modal_mass",
    "with_modes",
    "write_model",
    "write_report",
]

_PLACES = {
    "Alarm": "modal.tracking",
    "BaseParticipation": "modal.modes.modal_mass",
    "Batch": "modal.batch",
    "Choice": "modal.modes.mode",
    "Element": "modal.structure.structural_plant",
    "Fit": "modal.modes.mode",
    "Geometry": "modal.geometry.sensors",
    "Identification": "modal.identification.result",
    "LiveEstimate": "modal.tracking.live",
    "ModalModel": "modal.modes.mode",
    "Mode": "modal.modes.mode",
    "ModePairs": "modal.modes.shape_comparison",
    "OrderChoice": "modal.identification.order_search",
    "OrderEvidence": "modal.identification.result",
    "PlantModel": "modal.structure.given",
    "ReciprocityError": "modal.modes.modal_mass",
    "RepeatedModes": "modal.modes.shape_comparison",
    "ScaledResponse": "modal.modes.modal_mass",
    "ScaledShapes": "modal.modes.modal_mass",
    "Sensor": "modal.geometry.sensors",
    "Shapes": "modal.modes.shape_comparison",
    "StabilisationPoint": "modal.verdict.stabilisation",
    "StructuralModel": "modal.structure.structural_model",
    "Track": "modal.tracking",
    "Tracks": "modal.tracking",
    "Uncertainty": "modal.modes.mode",
    "assurance": "modal.modes.shape_comparison",
    "base_participation": "modal.modes.modal_mass",
    "check_limits": "modal.acceptance.check",
    "check_quality": "modal.quality",
    "choose_orders": "modal.identification.order_search",
    "compare_results": "modal.comparison.changes",
    "coordinate_assurance": "modal.modes.shape_comparison",
    "discrepancy": "modal.discrepancy",
    "extract_modes": "modal.modes.extraction",
    "follow": "modal.tracking.live",
    "frequency_response": "modal.identification.synthesis",
    "identify": "modal.identification.pipeline",
    "identify_batch": "modal.batch",
    "load": "modal.identification.result",
    "log_diagnosis": "modal.recording",
    "log_identification": "modal.recording",
    "mean_modes": "modal.modes.shape_comparison",
    "normalise_shapes": "modal.modes.modal_mass",
    "pair_modes": "modal.modes.shape_comparison",
    "plots": "modal.plots",
    "read_geometry": "modal.geometry.file",
    "read_model": "modal.structure.model_file",
    "read_result": "modal.comparison.shifts",
    "read_shapes": "modal.modes.shape_comparison",
    "read_specification": "modal.acceptance.test_file",
    "reciprocity_error": "modal.modes.modal_mass",
    "save_recording": "modal.recording",
    "scaled_response": "modal.modes.modal_mass",
    "simulate": "modal.structure.given",
    "track": "modal.tracking",
    "with_modal_mass": "modal.identification.more_modes",
    "with_modes": "modal.identification.more_modes",
    "write_model": "modal.structure.model_file",
    "write_report": "modal.report",
}
"""Modules of the names above: each is imported when it is first asked for, so that a script pays for what it uses."""


def __getattr__(name: str) -> Any:
    """The public name, imported when first asked for."""
    if name not in _PLACES:
        raise AttributeError(f"module 'modal' has no attribute {name!r}")
    place = importlib.import_module(_PLACES[name])
    globals()[name] = found = place if place.__name__ == f"modal.{name}" else getattr(place, name)
    return found


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])


if importlib.util.find_spec("modal_proto") is not None:
    warnings.warn(
        "the cloud SDK of the same import name 'modal' is installed in this environment; the two overwrite each other: "
        "use okid-modal in an environment of its own.",
        stacklevel=2,
    )
