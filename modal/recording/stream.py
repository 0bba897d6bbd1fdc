"""One identification into one stream, and one stream into one file."""

import hashlib
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from modal.identification import Identification
from modal.recording.names import label
from okid.arguments import require
from okid.errors import InvalidDataError

if TYPE_CHECKING:
    import rerun

__all__ = ["log_identification", "save_recording"]

APPLICATION: Final = "modal-report"


def log_identification(
    identification: Identification, recording: "rerun.RecordingStream", *, layout: Literal["send", "leave"] = "send"
) -> None:
    """Log a whole identification into a Rerun stream: pages "Observer fit", "Order" and "Modes".

    Everything drawn is also stored as numbers: series on the timeline "time", tables on "mode", "model_order", "lag",
    "output" and "record". Series of more than 200 000 samples (less with many channels) are stored as the smallest
    and the largest of each bucket of samples. Views are bounded in number, what is stored is not.

    Args:
        identification: from `modal.identify`.
        recording: any stream of the caller: to a file, to a viewer, in memory.
        layout: "send" the blueprint as well, or "leave" the layout of the stream as it is.

    Raises:
        InvalidDataError: `layout` is neither of the two.

    Example:
        >>> import rerun
        >>> stream = rerun.RecordingStream("survey", recording_id="today")
        >>> log_identification(identification, stream)  # doctest: +SKIP
    """
    from modal.recording.blueprint import blueprint
    from modal.recording.fit_page import log_fit_page
    from modal.recording.modes_page import log_modes_page
    from modal.recording.order_page import log_order_page
    from modal.recording.plan import planned

    if layout not in {"send", "leave"}:
        raise InvalidDataError(f"layout must be 'send' or 'leave', but is {layout!r}.")
    with _strict():
        plan = planned(identification)
        log_fit_page(identification, recording, plan)
        log_order_page(identification, recording, plan)
        log_modes_page(identification, recording, plan)
        if layout == "send":
            recording.send_blueprint(blueprint(identification, plan))


def save_recording(
    result: Identification, path: str | os.PathLike[str], *, existing: Literal["refuse", "replace"] = "refuse"
) -> Path:
    """Write a Rerun recording of a result, to be opened with `rerun FILE`.

    The file appears under its name only once it is complete. The same result gives the same recording: its identity
    follows from its content and no clock is stored.

    Args:
        result: from `modal.identify`.
        path: of the file; the usual ending is `.rrd`.
        existing: "refuse" to touch a file that is there, or "replace" it.

    Returns:
        The path.

    Raises:
        InvalidDataError: the file exists and is not to be replaced, or its folder does not exist.
    """
    import rerun as rr

    require(result, Identification, where="save_recording", made_by="modal.identify")
    target = Path(path)
    if existing not in {"refuse", "replace"}:
        raise InvalidDataError(f"existing must be 'refuse' or 'replace', but is {existing!r}.")
    if not target.parent.is_dir():
        raise InvalidDataError(f"the folder {target.parent} for the recording does not exist; make it first.")
    _check_free(target, existing)
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        recording = rr.RecordingStream(APPLICATION, recording_id=content_id(result))
        recording.set_log_time_enabled(False)
        recording.save(part)
        recording.send_recording_name(label(result.records[0].name or target.stem, 60))
        log_identification(result, recording)
        recording.flush(timeout_sec=600)
        recording.disconnect()
        _check_free(target, existing)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)
    return target


def content_id(identification: Identification) -> str:
    """A name for the recording that follows from what is in it: the model, the channels and a sample of the data."""
    digest = hashlib.blake2b(digest_size=12)
    model = identification.realisation
    for matrix in (model.A, model.B, model.C, model.D, identification.fit.cross_validated):
        digest.update(matrix.tobytes())
    for record in identification.records:
        names = (record.name, *record.input_names, *record.output_names, *record.input_units, *record.output_units)
        digest.update(repr((names, record.dt, record.start_time, record.n_samples)).encode("utf-8", "backslashreplace"))
        # every sample went into the model; a thousand rows tell records of the same model apart
        step = max(1, record.n_samples // 1000)
        digest.update(record.inputs[::step].tobytes())
        digest.update(record.outputs[::step].tobytes())
    return digest.hexdigest()


def _check_free(target: Path, existing: Literal["refuse", "replace"]) -> None:
    if target.is_dir():
        raise InvalidDataError(f"{target} is a folder; name a file for the recording.")
    if existing == "refuse" and target.exists():
        raise InvalidDataError(f"{target} exists already; name another file or pass existing='replace'.")


@contextmanager
def _strict() -> Iterator[None]:
    """Errors of the SDK raise instead of leaving data out with a warning; the caller's setting comes back after."""
    import rerun as rr

    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)
