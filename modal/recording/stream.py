"""One result into one stream, and one stream into one file."""

import hashlib
import os
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from modal.discrepancy.results import Diagnosis
from modal.identification.result import Identification
from modal.recording.blueprint import blueprint
from modal.recording.discrepancy.discrepancy_plan import planned_diagnosis
from modal.recording.discrepancy.discrepancy_steps import log_steps_page
from modal.recording.discrepancy.page import log_discrepancy_page
from modal.recording.discrepancy_blueprint import diagnosis_blueprint
from modal.recording.evidence import gather
from modal.recording.identification.fit import log_fit_page
from modal.recording.identification.modes import log_modes_page
from modal.recording.identification.order import log_order_page
from modal.recording.identification.record import log_record_page
from modal.recording.identification.validation import log_validation_page
from modal.recording.names import label
from modal.recording.plan import planned
from okid.arguments import require
from okid.errors import InvalidDataError
from okid.record import Record

if TYPE_CHECKING:
    import rerun

    from modal.geometry.sensors import Geometry
    from modal.quality.findings import DataQuality

__all__ = ["APPLICATION", "log_diagnosis", "log_identification", "save_recording", "strict_errors"]

APPLICATION: Final = "modal-report"


def log_identification(
    identification: Identification,
    recording: "rerun.RecordingStream",
    *,
    layout: Literal["send", "leave"] = "send",
    geometry: "Geometry | None" = None,
    quality: "DataQuality | None" = None,
) -> None:
    """Log a whole identification into a Rerun stream: "Record", "Observer fit", "Order", "Modes" and "Validation".

    Everything drawn is also stored as numbers: series on the timeline "time", tables on "mode", "model_order", "lag",
    "output", "record", "channel", "finding" and "frequency_line". Series of more than 200 000 samples (less with many
    channels) are stored as the smallest and the largest of each bucket of samples, but for their start and what lies
    around the largest residual (`modal.recording.levels` has the budget). Views are bounded in number, what is stored
    is not.

    Args:
        identification: from `modal.identify`.
        recording: any stream of the caller: to a file, to a viewer, in memory.
        layout: "send" the blueprint as well, or "leave" the layout of the stream as it is.
        geometry: where the sensors are; unless given, shapes are drawn as sticks.
        quality: of the records as they were read; unless given, that of the records as used is found and shown.

    Raises:
        InvalidDataError: `layout` is neither of the two.

    Example:
        >>> import rerun
        >>> stream = rerun.RecordingStream("survey", recording_id="today")
        >>> log_identification(identification, stream)  # doctest: +SKIP
    """
    if layout not in {"send", "leave"}:
        raise InvalidDataError(f"layout must be 'send' or 'leave', but is {layout!r}.")
    with strict_errors():
        plan = planned(identification, geometry)
        evidence = gather(identification, quality)
        log_record_page(identification.records, recording, plan.data, evidence.quality)
        log_fit_page(identification, recording, plan)
        log_order_page(identification, recording, plan, evidence)
        log_modes_page(identification, recording, plan)
        log_validation_page(identification, recording, plan, evidence)
        if layout == "send":
            recording.send_blueprint(blueprint(identification, plan, evidence))


def log_diagnosis(
    diagnosis: Diagnosis, recording: "rerun.RecordingStream", *, layout: Literal["send", "leave"] = "send"
) -> None:
    """Log a whole diagnosis into a Rerun stream: "Discrepancy", "Step by step", "Laws", "Outputs" and "Numbers".

    Everything drawn is also stored as numbers: series of the held-out records on the timeline "time", the gap shrinking
    on the timeline "step" (and on "time", spread over the records), tables on "parameter", "finding", "hypothesis",
    "gap", "part", "linear_parameter" and "limit".

    Args:
        diagnosis: from `modal.discrepancy.diagnose`.
        recording: any stream of the caller: to a file, to a viewer, in memory.
        layout: "send" the blueprint as well, or "leave" the layout of the stream as it is.

    Raises:
        InvalidDataError: `layout` is neither of the two.
    """
    require(diagnosis, Diagnosis, where="log_diagnosis", made_by="modal.discrepancy.diagnose")
    if layout not in {"send", "leave"}:
        raise InvalidDataError(f"layout must be 'send' or 'leave', but is {layout!r}.")
    with strict_errors():
        plan = planned_diagnosis(diagnosis)
        log_discrepancy_page(diagnosis, recording, plan)
        log_steps_page(diagnosis, recording, plan)
        if layout == "send":
            recording.send_blueprint(diagnosis_blueprint(diagnosis, plan))


def save_recording(
    result: Identification | Diagnosis,
    path: str | os.PathLike[str],
    *,
    existing: Literal["refuse", "replace"] = "refuse",
    geometry: "Geometry | None" = None,
    quality: "DataQuality | None" = None,
) -> Path:
    """Write a Rerun recording of a result, to be opened with `rerun FILE`.

    The file appears under its name only once it is complete. The same result gives the same recording: its identity
    follows from its content and no clock is stored.

    Args:
        result: from `modal.identify`, or from `modal.discrepancy.diagnose`.
        path: of the file; the usual ending is `.rrd`.
        existing: "refuse" to touch a file that is there, or "replace" it.
        geometry: where the sensors are, for the shapes of an identification.
        quality: of the records of an identification as they were read; see `log_identification`.

    Returns:
        The path.

    Raises:
        InvalidDataError: the file exists and is not to be replaced, or its folder does not exist.
    """
    import rerun as rr

    if not isinstance(result, Diagnosis):
        require(result, Identification, where="save_recording", made_by="modal.identify")
    target = Path(path)
    if existing not in {"refuse", "replace"}:
        raise InvalidDataError(f"existing must be 'refuse' or 'replace', but is {existing!r}.")
    if not target.parent.is_dir():
        raise InvalidDataError(f"the folder {target.parent} for the recording does not exist; make it first.")
    _check_free(target, existing)
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        identity, name = _identity(result)
        # not the name of the file: the same input gives the same recording wherever it is written
        kind = "diagnosis" if isinstance(result, Diagnosis) else "identification"
        recording = rr.RecordingStream(APPLICATION, recording_id=identity)
        recording.set_log_time_enabled(False)
        recording.save(part)
        recording.send_recording_name(label(name or kind, 60))
        if isinstance(result, Diagnosis):
            log_diagnosis(result, recording)
        else:
            log_identification(result, recording, geometry=geometry, quality=quality)
        recording.flush(timeout_sec=600)
        recording.disconnect()
        _check_free(target, existing)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)
    return target


def _identity(result: Identification | Diagnosis) -> tuple[str, str]:
    """The identity of the recording, and the name of its first record."""
    if isinstance(result, Diagnosis):
        return diagnosis_id(result), result.held_out[0].name
    return content_id(result), result.records[0].name


def content_id(identification: Identification) -> str:
    """A name for the recording that follows from what is in it: the model, the channels and a sample of the data."""
    digest = hashlib.blake2b(digest_size=12)
    model = identification.realisation
    for matrix in (model.A, model.B, model.C, model.D, identification.fit.cross_validated):
        digest.update(matrix.tobytes())
    _digest_records(digest, identification.records)
    return digest.hexdigest()


def diagnosis_id(diagnosis: Diagnosis) -> str:
    """The same of a diagnosis: the levels of all steps, what was found, and a sample of all records."""
    digest = hashlib.blake2b(digest_size=12)
    levels = [(step.name, step.fit_level, step.held_out_level) for step in diagnosis.steps]
    values = [(one.effect, one.where, [p.value for p in one.parameters]) for one in diagnosis.findings]
    digest.update(repr((diagnosis.status, levels, values)).encode("utf-8", "backslashreplace"))
    _digest_records(digest, (*diagnosis.fit, *diagnosis.held_out))
    return digest.hexdigest()


def _digest_records(digest: "hashlib.blake2b", records: Sequence[Record]) -> None:
    """Names, times and a sample of the values of every record."""
    for record in records:
        names = (record.name, *record.input_names, *record.output_names, *record.input_units, *record.output_units)
        digest.update(repr((names, record.dt, record.start_time, record.n_samples)).encode("utf-8", "backslashreplace"))
        # every sample went into the model; a thousand rows tell records of the same model apart
        step = max(1, record.n_samples // 1000)
        digest.update(record.inputs[::step].tobytes())
        digest.update(record.outputs[::step].tobytes())


def _check_free(target: Path, existing: Literal["refuse", "replace"]) -> None:
    if target.is_dir():
        raise InvalidDataError(f"{target} is a folder; name a file for the recording.")
    if existing == "refuse" and target.exists():
        raise InvalidDataError(f"{target} exists already; name another file or pass existing='replace'.")


@contextmanager
def strict_errors() -> Iterator[None]:
    """Errors of the SDK raise instead of leaving data out with a warning; the caller's setting comes back after."""
    import rerun as rr

    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)
