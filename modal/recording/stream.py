"""One result into one stream, one stream into one file; the table of a batch as a recording of its own.

How a recording opens stands here too: a page is a container of views with a name, made beside what the page draws; a
further page is one function more in `_pages` or in `diagnosis_blueprint`.
"""

import hashlib
import os
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from modal.discrepancy.results import Diagnosis, in_words
from modal.geometry.sensors import Geometry
from modal.identification.result import Identification
from modal.plots.histories import frequencies_of_records, places_of_records
from modal.quality.check import DataQuality
from modal.recording.discrepancy import (
    GAP_TEXT,
    HYPOTHESES,
    LAW_TEXT,
    LEVELS,
    STEP_GAP,
    STEP_PARTS,
    STEP_SPECTRUM,
    STEP_TEXT,
    VERDICT_TEXT,
    DiscrepancyPlan,
    diagnosis_tables,
    law_panes,
    law_title,
    log_discrepancy_page,
    log_steps_page,
    planned_diagnosis,
    spectrum_pane,
)
from modal.recording.figure import (
    Blueprint,
    Pane,
    RecordingStream,
    document_view,
    log_chart,
    plot_view,
    rr,
    rrb,
    series_view,
    tabs,
)
from modal.recording.identification.fit import (
    fit_page,
    log_fit_page,
    log_response_page,
    log_validation_page,
    response_page,
    validation_page,
)
from modal.recording.identification.modes import log_modes_page, modes_page
from modal.recording.identification.order import ORDER_FIT, ORDER_TEXT, SINGULAR_VALUES, STABILISATION, log_order_page
from modal.recording.identification.record import log_record_page, record_page
from modal.recording.identification.shapes import Swinging
from modal.recording.plan import (
    Gathered,
    Plan,
    WordLimits,
    bullets,
    cell,
    gather,
    label,
    log_table,
    log_text,
    name_with_unit,
    planned,
    table,
)
from modal.recording.series import TIMELINE, StoredRecords
from modal.sections.discrepancy_stages import level_lines
from okid.arrays import require
from okid.errors import InvalidDataError
from okid.readers.guard import Existing, complete_file
from okid.record import Record

GLOBAL_AXIS: Final = uuid.UUID("5c0dca6a-e63f-9cf7-f657-2602590474cc")
"""The view whose time range all linked views share, by its fixed identity in Rerun's viewer (`GLOBAL_VIEW_ID`)."""

SECONDS_A_PERIOD: Final = 2.0
SECONDS_AN_ORDER: Final = 0.25
"""Play the oscillating shapes and the growing order so fast."""


def blueprint(identification: Identification, plan: Plan, evidence: Gathered) -> Blueprint:
    """The whole layout for one identification."""
    return whole_blueprint(_pages(identification, plan, evidence), plan.data)


def whole_blueprint(
    pages: Sequence[Any],
    plan: StoredRecords,
    *,
    length: float = Swinging.PERIODS * SECONDS_A_PERIOD,
    a_place: float = SECONDS_AN_ORDER,
) -> Blueprint:
    """The pages as tabs on the timeline "time", paused at its start, everything else out of the way.

    Args:
        pages: in their order.
        plan: of the recording.
        length: seconds in which "time" plays from its start to its end.
        a_place: seconds for each place of the timeline that counts ("model_order", "step"): the speed holds there too.
    """
    speed = max(plan.stop - plan.start, 1e-6) / length
    return rrb.Blueprint(
        rrb.Tabs(*pages, active_tab=0),
        rrb.TimePanel(
            timeline=TIMELINE,
            state="collapsed",
            play_state="paused",
            loop_mode="all",
            playback_speed=speed,
            fps=1.0 / (a_place * speed),
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _pages(identification: Identification, plan: Plan, evidence: Gathered) -> list[Any]:
    pages = [
        record_page(identification.records, plan.data, evidence.quality),
        fit_page(identification, plan),
        _order_page(identification),
        modes_page(identification, plan),
        validation_page(identification, plan, evidence),
    ]
    show_whole_record(pages[0], plan.data)
    return pages


def show_whole_record(page: Any, plan: StoredRecords) -> None:
    """Let all linked views open on the whole timeline: their common range is kept with one view of a fixed identity."""
    views = [page]
    while not isinstance(views[0], rrb.TimeSeriesView):
        views = [*views[0].contents, *views[1:]] if isinstance(views[0], rrb.api.Container) else views[1:]
    margin = 0.004 * (plan.stop - plan.start)
    at = rrb.TimeRangeBoundary
    span = rrb.TimeRange(start=at.absolute(seconds=plan.start - margin), end=at.absolute(seconds=plan.stop + margin))
    views[0].id = GLOBAL_AXIS
    views[0].properties["TimeAxis"] = rrb.TimeAxis(link="LinkToGlobal", view_range=span)


def _order_page(identification: Identification) -> Any:
    left: list[Any] = [plot_view(SINGULAR_VALUES, "Hankel singular values")]
    if identification.order_evidence.candidate_orders.size:
        left.append(plot_view(ORDER_FIT, "Fit against order"))
    shares = [1.15, 1.0][: len(left)]
    column = rrb.Vertical(*left, row_shares=shares, name="How many states")
    return rrb.Horizontal(
        column,
        plot_view(STABILISATION, "Stabilisation"),
        document_view(ORDER_TEXT, "This order"),
        column_shares=[1.0, 1.75, 0.75],
        name="Order",
    )


SECONDS_A_STEP = 1.5
"""Let a step stand so long while the page plays."""


def diagnosis_blueprint(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Blueprint:
    """The whole layout for one diagnosis."""
    pages = [_discrepancy_page(diagnosis, plan)]
    if plan.step_gaps:
        pages.append(_steps_page(diagnosis, plan))
    pages += [
        _law_page(diagnosis),
        *_levels_page(diagnosis),
        _outputs_page(diagnosis, plan),
        _numbers_page(diagnosis, plan),
    ]
    length = SECONDS_A_STEP * max(1, len(plan.step_gaps) - 1)
    return whole_blueprint(pages, plan, length=length, a_place=SECONDS_A_STEP)


def _discrepancy_page(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Any:
    """Gap over time on the whole width; below it spectrum, hypotheses, verdict."""
    outputs = _in_front(plan)
    above = [_gap_view(diagnosis, plan, output) for output in outputs]
    verdict = document_view(VERDICT_TEXT, "Verdict")
    below: list[Any] = []
    if plan.stages:
        below.append(tabs([plot_view(spectrum_pane(i), _spectrum_name(diagnosis, i)) for i in outputs], "Spectra"))
    if diagnosis.hypotheses:
        below.append(plot_view(HYPOTHESES, "What was tried"))
    lower = rrb.Horizontal(*below, verdict, column_shares=[1.0] * len(below) + [1.15], name="What is missing")
    page = rrb.Vertical(tabs(above, "Outputs"), lower, row_shares=[1.0, 1.25], name="Discrepancy")
    show_whole_record(page, plan)
    return page


def _steps_page(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Any:
    name = label(diagnosis.held_out[0].output_names[plan.output])
    below = rrb.Horizontal(
        plot_view(STEP_SPECTRUM, f"Spectrum of the gap of {name}"),
        plot_view(STEP_PARTS, "Gap by part"),
        document_view(STEP_TEXT, "This step"),
        column_shares=[1.0, 1.0, 0.9],
        name="By part",
    )
    above = plot_view(STEP_GAP, f"Gap of {name}: press play")
    return rrb.Vertical(above, below, row_shares=[1.0, 1.25], name="Step by step")


def _law_page(diagnosis: Diagnosis) -> Any:
    words = document_view(LAW_TEXT, "Findings")
    views = [plot_view(pane, law_title(law)) for pane, law in zip(law_panes(diagnosis), diagnosis.laws, strict=False)]
    if not views:
        return rrb.Vertical(words, name="Laws")
    grid = rrb.Grid(*views, grid_columns=1 if len(views) < 3 else 2, name="Laws over the data")
    return rrb.Horizontal(grid, words, column_shares=[1.9, 1.0], name="Laws")


def _levels_page(diagnosis: Diagnosis) -> list[Any]:
    """Modes against level, where they tell something; else no page."""
    known = bool(level_lines(diagnosis))
    return [rrb.Vertical(plot_view(LEVELS, "Modes against level"), name="Levels")] if known else []


def _outputs_page(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Any:
    first = diagnosis.held_out[0]
    views = [
        series_view(
            f"{plan.output_paths[i]}/run", name_with_unit(first.output_names[i], first.output_units[i]), ["$origin/**"]
        )
        for i in plan.shown_outputs
    ]
    grid = rrb.Grid(*views, grid_columns=1 if len(views) < 4 else 2, name="Measured and simulated")
    words = document_view(GAP_TEXT, "Gap in numbers")
    return rrb.Horizontal(grid, words, column_shares=[1.9, 1.0], name="Outputs")


def _numbers_page(diagnosis: Diagnosis, plan: DiscrepancyPlan) -> Any:
    views = []
    for one in diagnosis_tables(diagnosis, plan):
        columns = [one.timeline, *(f"/{one.path}:{name}" for name in one.columns)]
        query = rrb.archetypes.DataframeQuery(timeline=one.timeline, select=columns)
        views.append(rrb.DataframeView(origin=one.path, name=one.title, query=query))
    return rrb.Tabs(*views, active_tab=0, name="Numbers")


def _in_front(plan: DiscrepancyPlan) -> list[int]:
    """The shown outputs, the one with the largest gap first."""
    return [plan.output, *(i for i in plan.shown_outputs if i != plan.output)]


def _gap_view(diagnosis: Diagnosis, plan: DiscrepancyPlan, output: int) -> Any:
    first = diagnosis.held_out[0]
    name = name_with_unit(first.output_names[output], first.output_units[output])
    return series_view(f"{plan.output_paths[output]}/gap", f"Measured minus simulated: {name}", ["$origin/**"])


def _spectrum_name(diagnosis: Diagnosis, output: int) -> str:
    return f"Gap over frequency: {label(diagnosis.held_out[0].output_names[output], 18)}"


APPLICATION: Final = "modal-report"


def log_identification(
    identification: Identification,
    recording: RecordingStream,
    *,
    layout: Literal["send", "leave"] = "send",
    geometry: Geometry | None = None,
    quality: DataQuality | None = None,
) -> None:
    """Log a whole identification into a Rerun stream: "Record", "Observer fit", "Order", "Modes" and "Validation".

    Everything drawn is also stored as numbers: series on the timeline "time", tables on "mode", "model_order", "lag",
    "output", "record", "channel", "finding" and "frequency_line". Series of more than 200 000 samples (less with many
    channels) are stored as the smallest and the largest of each bucket of samples, but for their start and what lies
    around the largest residual (`modal.recording.series` has the budget). Views are bounded in number, what is stored
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
        if identification.response is not None:
            log_response_page(identification, identification.response, recording)
            log_order_page(identification, recording, plan)
            log_modes_page(identification, recording, plan)
            if layout == "send":
                pages = [response_page(), _order_page(identification), modes_page(identification, plan)]
                recording.send_blueprint(whole_blueprint(pages, plan.data))
            return
        evidence = gather(identification, quality)
        log_record_page(identification.records, recording, plan.data, evidence.quality)
        log_fit_page(identification, recording, plan)
        log_order_page(identification, recording, plan)
        log_modes_page(identification, recording, plan)
        log_validation_page(identification, recording, plan, evidence)
        if layout == "send":
            recording.send_blueprint(blueprint(identification, plan, evidence))


def log_diagnosis(
    diagnosis: Diagnosis, recording: RecordingStream, *, layout: Literal["send", "leave"] = "send"
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
        diagnosis = in_words(diagnosis)
        plan = planned_diagnosis(diagnosis)
        log_discrepancy_page(diagnosis, recording, plan)
        log_steps_page(diagnosis, recording, plan)
        if layout == "send":
            recording.send_blueprint(diagnosis_blueprint(diagnosis, plan))


def save_recording(
    result: Identification | Diagnosis,
    path: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    geometry: Geometry | None = None,
    quality: DataQuality | None = None,
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
        OSError: the file cannot be written.
    """
    if not isinstance(result, Diagnosis):
        require(result, Identification, where="save_recording", made_by="modal.identify")
    target = Path(path)
    if existing not in {"refuse", "replace"}:
        raise InvalidDataError(f"existing must be 'refuse' or 'replace', but is {existing!r}.")
    if not target.parent.is_dir():
        raise InvalidDataError(f"the folder {target.parent} for the recording does not exist; make it first.")
    _check_free(target, existing)

    def log(recording: RecordingStream) -> None:
        if isinstance(result, Diagnosis):
            log_diagnosis(result, recording)
        else:
            log_identification(result, recording, geometry=geometry, quality=quality)

    identity, name = _identity(result)
    # not the name of the file: the same input gives the same recording wherever it is written
    kind = "diagnosis" if isinstance(result, Diagnosis) else "identification"
    return write_stream(target, identity, label(name or kind, 60), log, existing=existing)


def write_stream(
    path: Path,
    identity: str,
    name: str,
    log: Callable[[RecordingStream], None],
    *,
    existing: Existing = "replace",
) -> Path:
    """One recording into one file, which appears under its name when it is complete.

    The recording is made in memory, where it is small (see `row_budget`), and its bytes are written here: Rerun's own
    writer, a thread, cuts a file off in silence at a limit on its size, and waits ten minutes at a full disk.

    Args:
        path: of the file.
        identity: of the recording: the same content, the same identity.
        name: of the recording, for the viewer.
        log: logs all of it.
        existing: "refuse" to touch a file that has come to be there, or "replace" it.

    Raises:
        OSError: the file cannot be written.
    """
    recording = rr.RecordingStream(APPLICATION, recording_id=identity)
    recording.set_log_time_enabled(False)
    memory = recording.memory_recording()
    recording.send_recording_name(name)
    with strict_errors():
        log(recording)
    content = memory.drain_as_bytes()
    recording.disconnect()
    with complete_file(path) as part:
        part.write_bytes(content)
        _check_free(path, existing)
    return path


def _identity(result: Identification | Diagnosis) -> tuple[str, str]:
    """The identity of the recording, and the name of its first record."""
    if isinstance(result, Diagnosis):
        return diagnosis_id(result), result.held_out[0].name
    return content_id(result), result.channels.name


def content_id(identification: Identification) -> str:
    """A name for the recording that follows from what is in it: the model, the channels and a sample of the data."""
    digest = hashlib.blake2b(digest_size=12)
    model = identification.realisation
    for matrix in (model.A, model.B, model.C, model.D, identification.fit.cross_validated):
        digest.update(matrix.tobytes())
    _digest_records(digest, identification.records)
    if identification.response is not None:
        table = identification.response
        digest.update(repr((table.name, table.input_names, table.output_names)).encode("utf-8", "backslashreplace"))
        digest.update(table.frequencies.tobytes() + table.response.tobytes())
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


def _check_free(target: Path, existing: Existing) -> None:
    if target.is_dir():
        raise InvalidDataError(f"{target} is a folder; name a file for the recording.")
    if existing == "refuse" and target.exists():
        raise InvalidDataError(f"{target} exists already; name another file or pass existing='replace'.")


@contextmanager
def strict_errors() -> Iterator[None]:
    """Errors of the SDK raise instead of leaving data out with a warning; the caller's setting comes back after."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)


FREQUENCIES: Final = Pane(path="batch/frequencies", width=1500.0, height=760.0)
WORDS: Final = "batch/words"
MODES: Final = "batch/modes"
RECORDS: Final = "batch/records"


def save_batch_recording(names: Sequence[str], modes: Any, records: Any, path: Path) -> Path:
    """Write the recording of a batch; the same tables give the same recording.

    Raises:
        OSError: the file cannot be written.
    """
    frequency, deviation, damping, probability = (
        modes.column(name).to_numpy(zero_copy_only=False)
        for name in ("frequency", "frequency_std", "damping_ratio", "probability")
    )
    verdicts, number = modes.column("verdict").to_pylist(), {name: place for place, name in enumerate(names)}
    row = np.array([number[name] for name in modes.column("record").to_pylist()], dtype=np.intp)
    starts = np.zeros(len(names))
    starts[row] = modes.column("start_time").to_numpy(zero_copy_only=False)
    seen = np.unique(row)
    along, label = places_of_records(starts[seen], seen + 1)
    places = np.full(len(names), np.nan)
    places[seen] = along
    digest = hashlib.blake2b(repr(names).encode("utf-8", "backslashreplace"), digest_size=12)
    digest.update(frequency.tobytes() + deviation.tobytes())

    def log(recording: RecordingStream) -> None:
        chart = frequencies_of_records(places[row], frequency, verdicts, along=label)
        log_chart(recording, FREQUENCIES, chart)
        log_table(
            recording,
            MODES,
            "mode_row",
            np.arange(row.size),
            {
                "record": modes.column("record").to_pylist(),
                "frequency": frequency,
                "frequency_std": deviation,
                "damping_ratio": damping,
                "probability": probability,
                "verdict": verdicts,
            },
        )
        told = {name: records.column(name).to_pylist() for name in ("record", "path", "hash", "status", "message")}
        log_table(recording, RECORDS, "record_row", np.arange(len(names)), told)
        log_text(recording, WORDS, _words(told))
        views = [plot_view(FREQUENCIES, "Frequencies"), document_view(WORDS, "Summary")]
        for entity, timeline in ((MODES, "mode_row"), (RECORDS, "record_row")):
            query = rrb.archetypes.DataframeQuery(timeline=timeline)
            views.append(rrb.DataframeView(origin=entity, name=entity.rpartition("/")[2].capitalize(), query=query))
        page = rrb.Vertical(views[0], rrb.Tabs(*views[1:], active_tab=0), row_shares=[1.4, 1.0], name="Batch")
        recording.send_blueprint(
            rrb.Blueprint(page, rrb.TimePanel(state="hidden"), auto_views=False, auto_layout=False)
        )

    return write_stream(path, digest.hexdigest(), "batch", log)


def _words(told: dict[str, list[str]]) -> str:
    failed = [row for row in zip(told["record"], told["status"], told["message"], strict=True) if row[2]]
    n_failed = told["status"].count("failed")
    head = f"### {len(told['record'])} records, {n_failed} failed"
    if not failed:
        return head
    rows = [[cell(name, 60), status, cell(message)] for name, status, message in failed[: WordLimits.LISTED]]
    more = (
        bullets([f"and {len(failed) - WordLimits.LISTED} more in the table"]) if len(failed) > WordLimits.LISTED else []
    )
    return "\n\n".join([head, table(["record", "status", "message"], rows), *more])
